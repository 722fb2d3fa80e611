"""The test plan."""

from __future__ import annotations

import math

from ringtrue.core.arrays import Int
from ringtrue.planning.virtual_test import VirtualTest, rarely_found_modes
from ringtrue.plots import correlation, diagram
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Fact,
    Facts,
    Fold,
    Items,
    Plot,
    ReportTable,
    Section,
    Stages,
    Text,
    fixed,
    number,
    sentence,
)
from ringtrue.study.messages import lost_points_sentence, missed_modes, setup_sentences
from ringtrue.study.results import IdentifyStage, PlanStage, SuspensionPlan
from ringtrue.study.summary import precision

SURE = 0.9  # of the virtual tests


def section(data: Stages) -> Section | None:
    """Chosen sensors, auto-MAC, resolution and the precision to expect."""
    plan = data.plan
    if plan is None:
        return None
    facts = [
        Fact("Points", str(plan.sensors.test.points.size)),
        Fact("Channels", str(len(plan.sensors.test.channels))),
        Fact("Worst auto-MAC", fixed(100 * plan.sensors.worst_auto_mac, 1), "%"),
        Fact("Frequency step", number(plan.acquisition.frequency_step, 3), "Hz"),
        Fact("Block", number(plan.acquisition.block, 4), "s"),
        Fact("Ambient record", number(plan.acquisition.record_length / 60, 3), "min"),
    ]
    if plan.acquisition.averages:
        facts.insert(5, Fact("Averages", str(plan.acquisition.averages)))
    references = f"Hammer references: {', '.join(plan.excitation.references)}."
    if len(plan.excitation.references) > 1:
        references += " All are channels, too: each pair of them checks reciprocity."
    blocks: list[Block] = [
        Facts(facts),
        Text(
            f"{sentence(plan.rule)} {sentence(lost_points_sentence(plan))} {references}"
        ),
    ]
    blocks += [
        Text(sentence(n))
        for n in (*setup_sentences(plan), *plan.notes, *missed_modes(plan))
    ]
    side = correlation.MatrixSide([str(i + 1) for i in plan.target_modes], "FE mode")
    auto = correlation.matrix(
        plan.sensors.auto_mac, side, side, height=430, diagonal=False
    )
    left: list[Block] = [
        Plot(auto, "Auto-MAC of the target modes at the chosen channels.")
    ]
    right = _precision(data, plan)
    blocks += [Columns([left, right])] if right else left
    if plan.suspension is not None:
        blocks.append(Text(_hung(plan.suspension)))
    if plan.virtual_test is not None:
        blocks += _foreseen(
            plan.target_modes,
            plan.virtual_test,
            "Virtual test of the plan",
            "target modes",
        )
    if (r := plan.virtual_ambient_test) is not None:
        blocks += _foreseen(
            plan.acquisition.modes,
            r,
            "Virtual ambient test",
            "modes of the ambient plan",
        )
    if plan.excitation.sets:
        blocks.append(_ranked(plan))
    lists: list[Block] = [_points(plan)]
    if plan.target_frequencies.size:
        lists.insert(0, _targets(plan))
    if plan.virtual_ambient_test is not None:
        lists.append(_ambient(plan, plan.virtual_ambient_test))
    if data.identify is None:
        return Section("plan", "Test plan", [*blocks, *lists])
    if plan.sensors.loaded.size or plan.virtual_test is not None:
        blocks.append(lists.pop(0))
    if len(data.identify.ambient):
        lists.append(_verified(plan, data.identify))
    blocks.append(Fold("Measuring points, target modes and the precision found", lists))
    return Section("plan", "Test plan", blocks)


def _precision(data: Stages, plan: PlanStage) -> list[Block]:
    """Standard deviations of the ambient modes: planned and found, else those to expect."""
    if data.identify is not None and len(data.identify.ambient):
        fig = diagram.verified(precision(plan, data.identify))
        text = (
            "The plan verified: standard deviations planned for one ambient record (lines) and "
            "found of the merged "
            "ambient modes (marks)."
        )
        return [Plot(fig, text)]
    if data.model is None or not plan.acquisition.modes.size:
        return []
    modes = data.model.modes.take(plan.acquisition.modes)
    fig = diagram.precision(
        modes, plan.acquisition.std_frequency, plan.acquisition.std_damping
    )
    fig.update_layout(height=430)
    return [
        Plot(
            fig,
            "Standard deviations to expect from the planned length of the ambient record.",
        )
    ]


def _hung(found: SuspensionPlan) -> str:
    nodes = ", ".join(map(str, found.nodes))
    steady = (
        "between them"
        if found.steady
        else "not between them: the structure needs a guy"
    )
    return (
        f"Suspension at nodes {nodes}, whose RMS motion is at most "
        f"{number(100 * math.sqrt(found.motion), 2)} % of the largest vertical motion "
        "of any target mode; "
        f"the centre of gravity hangs {steady}."
    )


def _foreseen(modes: Int, r: VirtualTest, what: str, whose: str) -> list[Block]:
    """What the virtual test says in a sentence, and the modes that it misses."""
    names = [str(k + 1) for k in modes]
    missed = rarely_found_modes(r, names, SURE)
    described = (
        f"{what}: {len(names) - len(missed)} of {len(names)} {whose} were found in at least "
        f"{100 * SURE:.0f} % of "
        f"{r.trials} tests."
    )
    blocks: list[Block] = [Text(described)]
    if missed:
        blocks.append(Items(missed, "Modes that the test may miss"))
    return blocks


def _targets(plan: PlanStage) -> ReportTable:
    """Target modes: how well they are excited and shown, and what the virtual test made of them."""
    heads = ["FE mode", "f, Hz", "reach, %"]
    columns: list[list[str | Cell]] = [
        [str(k + 1) for k in plan.target_modes],
        [fixed(f, 3) for f in plan.target_frequencies],
        [
            Cell(fixed(100 * r, 0), "bad" if lost else "")
            for r, lost in zip(
                plan.excitation.reach, plan.excitation.missed, strict=True
            )
        ],
    ]
    if plan.sensors.shown.size:
        heads.append("shown, %")
        columns.append([fixed(100 * s, 0) for s in plan.sensors.shown])
    if plan.sensors.loaded.size:
        heads.append("shift by sensors, %")
        columns.append([fixed(100 * x, 2, sign=True) for x in plan.sensors.loaded])
    if len(set(plan.reasons)) > 1:
        heads.insert(1, "|why")
        columns.insert(1, list(plan.reasons))
    caption = (
        "Target modes. Reach: best driving-point residue of the references over that of all "
        "channels; shown: MAC of "
        "the mode with its drawing on the measuring points."
    )
    if (trial := plan.virtual_test) is not None:
        heads += ["found, %", "σ of f, %", "σ of ζ, %", "MAC, %"]
        columns += _found(trial)
        caption += (
            f" Found and the standard deviations: {trial.trials} virtual tests with "
            "blows up to "
            f"{number(trial.force, 2)} N under {number(trial.background, 2)} "
            "N/√Hz of noise at each "
            f"reference, {number(trial.invented, 2)} modes a test invented."
        )
    return ReportTable(heads, list(zip(*columns, strict=True)), caption, scroll=True)


def _ambient(plan: PlanStage, r: VirtualTest) -> ReportTable:
    """What virtual ambient tests made of the modes expected of them, with the floor of their
    errors.
    """
    columns: list[list[str | Cell]] = [
        [str(k + 1) for k in plan.acquisition.modes],
        [fixed(f, 3) for f in r.frequencies],
        *_found(r),
        [number(100 * x, 2) for x in plan.acquisition.std_frequency],
        [number(100 * x, 2) for x in plan.acquisition.std_damping],
    ]
    heads = (
        "FE mode",
        "f, Hz",
        "found, %",
        "σ of f, %",
        "σ of ζ, %",
        "MAC, %",
        "least σ of f, %",
        "least σ of ζ, %",
    )
    caption = (
        f"{r.trials} virtual ambient tests under white forces of {number(r.force, 2)} N/√Hz "
        "along each channel, "
        f"{number(r.invented, 2)} modes a test invented; least: the statistical floor for the "
        "planned record."
    )
    return ReportTable(heads, list(zip(*columns, strict=True)), caption, scroll=True)


def _found(r: VirtualTest) -> list[list[str | Cell]]:
    hints = [f"at least {100 * p:.0f} % with 95 % confidence" for p in r.at_least]
    found: list[str | Cell] = [
        Cell(fixed(100 * p, 0), "" if p >= SURE else "bad", hint)
        for p, hint in zip(r.found, hints, strict=True)
    ]
    rest = (100 * r.frequency_std, 100 * r.damping_std)
    spread: list[list[str | Cell]] = [[number(x, 2) for x in c] for c in rest]
    return [found, *spread, [fixed(100 * x, 1) for x in r.mac]]


def _ranked(plan: PlanStage) -> ReportTable:
    """Sets of points to strike: the best of so many, and what they miss."""
    names = (plan.target_modes + 1).tolist()
    rows = [
        (
            str(len(s)),
            ", ".join(s),
            fixed(100 * least, 0),
            ", ".join(f"{names[i]}" for i in missed) or "none",
        )
        for s, least, missed in zip(
            plan.excitation.sets,
            plan.excitation.least_reach,
            plan.excitation.missed_by_sets,
            strict=True,
        )
    ]
    caption = (
        "Points to strike, ranked by the mode that they excite worst, of those that a point can "
        "reach: what fewer and "
        "more of them reach."
    )
    return ReportTable(
        ("points", "|strike", "least reach, %", "|modes missed"), rows, caption
    )


def _points(plan: PlanStage) -> ReportTable:
    """Measuring points, and what is struck there; the struck ones first."""
    test = plan.sensors.test
    setups = plan.sensors.setups
    read: dict[int, list[str]] = {}
    for p, name in zip(test.at, test.channels, strict=True):
        read.setdefault(p, []).append(name.removeprefix(str(p)))
    there = {}
    if setups:
        there = {
            p: str(k + 1) for k in range(setups.count) for p in plan.sensors.roving(k)
        }
    parts = any(test.groups)
    rows: list[tuple[str, ...]] = []
    for p, xyz, group in zip(test.points, test.xyz, test.groups, strict=True):
        setup = (there.get(p, "all"),) if setups else ()
        part = (group,) if parts else ()
        place = (fixed(v, 3) for v in xyz)
        ends = (f"{p}+", f"{p}-")
        struck = [r for r in plan.excitation.references if r.startswith(ends)]
        rows.append(
            (str(p), *part, *place, " ".join(read.get(p, [])), *setup, " ".join(struck))
        )
    rows.sort(key=lambda row: not row[-1])
    part = ("|part",) if parts else ()
    setup = ("setup",) if setups else ()
    heads = ("point", *part, "x, m", "y, m", "z, m", "|channels", *setup, "|strike")
    return ReportTable(
        heads, rows, "Measuring points, on nodes of the model.", scroll=True
    )


def _verified(plan: PlanStage, found: IdentifyStage) -> ReportTable:
    """Planned precision against that of the modes found."""
    rows = [
        (fixed(r.pop("frequency_hz"), 3), *(number(v, 2) for v in r.values()))
        for r in precision(plan, found)
    ]
    heads = ("f, Hz", "planned σ of f, %", "found, %", "planned σ of ζ, %", "found, %")
    caption = (
        "The plan verified: standard deviations of one ambient record with "
        f"{100 * plan.acquisition.damping:g} % damping as "
        "planned, and those of the merged ambient modes."
    )
    return ReportTable(heads, rows, caption)
