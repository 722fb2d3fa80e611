"""The test plan."""

from __future__ import annotations

import math

from ringtrue.core.arrays import Int
from ringtrue.planning.virtual_test import VirtualTest, rarely_found_modes
from ringtrue.plots import correlation, identification
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Fact,
    Facts,
    Fold,
    Items,
    Plot,
    Section,
    Table,
    Text,
    fixed,
    number,
    sentence,
)
from ringtrue.report.stages import Stages
from ringtrue.study.messages import lost_points_sentence, missed_modes, setup_sentences
from ringtrue.study.results import IdentifyStage, PlanStage
from ringtrue.study.summary import precision

SURE = 0.9  # of the virtual tests


def section(data: Stages) -> Section | None:
    """Chosen sensors, auto-MAC, resolution and the precision to expect."""
    plan = data.plan
    if plan is None:
        return None
    facts = [
        Fact("Points", str(plan.test.points.size)),
        Fact("Channels", str(len(plan.test.channels))),
        Fact("Worst auto-MAC", fixed(100 * plan.worst_off_diagonal, 1), "%"),
        Fact("Frequency step", number(plan.frequency_step, 3), "Hz"),
        Fact("Block", number(plan.block, 4), "s"),
        Fact("Ambient record", number(plan.record_length / 60, 3), "min"),
    ]
    if plan.averages:
        facts.insert(5, Fact("Averages", str(plan.averages)))
    blocks: list[Block] = [
        Facts(facts),
        Text(f"{sentence(plan.rule)} {sentence(lost_points_sentence(plan))} {_references(plan)}"),
    ]
    blocks += [
        Text(sentence(n)) for n in (*setup_sentences(plan), *plan.notes, *missed_modes(plan))
    ]
    names = [str(i + 1) for i in plan.target_modes.tolist()]
    auto = correlation.matrix(
        plan.auto_mac, names, names, "FE mode", "FE mode", height=430, diagonal=False
    )
    left: list[Block] = [Plot(auto, "Auto-MAC of the target modes at the chosen channels.")]
    right = _precision(data, plan)
    blocks += [Columns([left, right])] if right else left
    if plan.suspension:
        blocks.append(Text(_hung(plan)))
    if plan.rehearsal is not None:
        blocks += _foreseen(
            plan.target_modes, plan.rehearsal, "Virtual test of the plan", "target modes"
        )
    if (r := plan.ambient_rehearsal) is not None:
        blocks += _foreseen(
            plan.expected_modes, r, "Virtual ambient test", "modes of the ambient plan"
        )
    if plan.indicator.size:
        blocks.append(_appropriated(plan))
    if plan.sets:
        blocks.append(_ranked(plan))
    lists: list[Block] = [
        *([_targets(plan)] if plan.target_frequencies.size else []),
        _points(plan),
    ]
    if plan.ambient_rehearsal is not None:
        lists.append(_ambient(plan, plan.ambient_rehearsal))
    if data.identify is None:
        return Section("plan", "Test plan", [*blocks, *lists])
    if plan.loaded.size or plan.rehearsal is not None:
        blocks.append(lists.pop(0))
    if len(data.identify.ambient):
        lists.append(_verified(plan, data.identify))
    blocks.append(Fold("Measuring points, target modes and the precision found", lists))
    return Section("plan", "Test plan", blocks)


def _references(plan: PlanStage) -> str:
    both = (
        " All are channels, too: each pair of them checks reciprocity."
        if len(plan.references) > 1
        else ""
    )
    return f"Hammer references: {', '.join(plan.references)}.{both}"


def _precision(data: Stages, plan: PlanStage) -> list[Block]:
    """Standard deviations of the ambient modes: planned and found, else those to expect."""
    if data.identify is not None and len(data.identify.ambient):
        fig = identification.verified(precision(plan, data.identify))
        text = (
            "The plan verified: standard deviations planned for one ambient record (lines) and "
            "found of the merged "
            "ambient modes (marks)."
        )
        return [Plot(fig, text)]
    if data.model is None or not plan.expected_modes.size:
        return []
    modes = data.model.modes.take(plan.expected_modes)
    fig = identification.precision(modes, plan.expected_std_frequency, plan.expected_std_damping)
    fig.update_layout(height=430)
    return [
        Plot(fig, "Standard deviations to expect from the planned length of the ambient record.")
    ]


def _hung(plan: PlanStage) -> str:
    nodes = ", ".join(map(str, plan.suspension))
    steady = "between them" if plan.steady else "not between them: the structure needs a guy"
    return (
        f"Suspension at nodes {nodes}, whose RMS motion is at most "
        f"{number(100 * math.sqrt(plan.suspension_motion), 2)} % of the largest vertical motion "
        "of any target mode; "
        f"the centre of gravity hangs {steady}."
    )


def _foreseen(modes: Int, r: VirtualTest, what: str, whose: str) -> list[Block]:
    """What the virtual test says in a sentence, and the modes that it misses."""
    names = [str(k + 1) for k in modes.tolist()]
    missed = rarely_found_modes(r, names, SURE)
    told = (
        f"{what}: {len(names) - len(missed)} of {len(names)} {whose} were found in at least "
        f"{100 * SURE:.0f} % of "
        f"{r.trials} tests."
    )
    return [
        Text(told),
        *([Items(missed, "Modes that the test may miss")] if missed else []),
    ]


def _targets(plan: PlanStage) -> Table:
    """Target modes: how well they are excited and shown, and what the virtual test made of them."""
    heads = ["FE mode", "f, Hz", "reach, %"]
    columns: list[list[str | Cell]] = [
        [str(k + 1) for k in plan.target_modes.tolist()],
        [fixed(f, 3) for f in plan.target_frequencies.tolist()],
        [
            Cell(fixed(100 * r, 0), "bad" if lost else "")
            for r, lost in zip(plan.reach.tolist(), plan.missed.tolist(), strict=True)
        ],
    ]
    if plan.shown.size:
        heads.append("shown, %")
        columns.append([fixed(100 * s, 0) for s in plan.shown.tolist()])
    if plan.loaded.size:
        heads.append("shift by sensors, %")
        columns.append([fixed(100 * x, 2, sign=True) for x in plan.loaded.tolist()])
    if len(set(plan.reasons)) > 1:
        heads.insert(1, "|why")
        columns.insert(1, list(plan.reasons))
    caption = (
        "Target modes. Reach: best driving-point residue of the references over that of all "
        "channels; shown: MAC of "
        "the mode with its drawing on the measuring points."
    )
    if plan.rehearsal is not None:
        heads += ["found, %", "σ of f, %", "σ of ζ, %", "MAC, %"]
        columns += _found(plan.rehearsal)
        caption += (
            f" Found and the standard deviations: {plan.rehearsal.trials} virtual tests with "
            "blows up to "
            f"{number(plan.rehearsal.force, 2)} N under {number(plan.rehearsal.background, 2)} "
            "N/√Hz of noise at each "
            f"reference, {number(plan.rehearsal.invented, 2)} modes a test invented."
        )
    return Table(heads, list(zip(*columns, strict=True)), caption, scroll=True)


def _ambient(plan: PlanStage, r: VirtualTest) -> Table:
    """What virtual ambient tests made of the modes expected of them, beside the floor of their
    errors.
    """
    columns: list[list[str | Cell]] = [
        [str(k + 1) for k in plan.expected_modes.tolist()],
        [fixed(f, 3) for f in r.frequencies.tolist()],
        *_found(r),
        [number(100 * x, 2) for x in plan.expected_std_frequency.tolist()],
        [number(100 * x, 2) for x in plan.expected_std_damping.tolist()],
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
    return Table(heads, list(zip(*columns, strict=True)), caption, scroll=True)


def _found(r: VirtualTest) -> list[list[str | Cell]]:
    hints = [f"at least {100 * p:.0f} % with 95 % confidence" for p in r.at_least.tolist()]
    found: list[str | Cell] = [
        Cell(fixed(100 * p, 0), "" if p >= SURE else "bad", hint)
        for p, hint in zip(r.found.tolist(), hints, strict=True)
    ]
    rest = (100 * r.frequency_std, 100 * r.damping_std)
    spread: list[list[str | Cell]] = [[number(x, 2) for x in c.tolist()] for c in rest]
    return [found, *spread, [fixed(100 * x, 1) for x in r.mac.tolist()]]


def _ranked(plan: PlanStage) -> Table:
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
            plan.sets, plan.least_reach.tolist(), plan.missed_by_sets, strict=True
        )
    ]
    caption = (
        "Points to strike, ranked by the mode that they excite worst, of those that a point can "
        "reach: what fewer and "
        "more of them reach."
    )
    return Table(("points", "|strike", "least reach, %", "|modes missed"), rows, caption)


def _appropriated(plan: PlanStage) -> Table:
    """Real forces that isolate each target mode."""
    rows = [
        (str(k + 1), fixed(f, 3), fixed(v, 3), *(fixed(x, 2, sign=True) for x in force))
        for k, f, v, force in zip(
            plan.target_modes.tolist(),
            plan.target_frequencies.tolist(),
            plan.indicator.tolist(),
            plan.forces.tolist(),
            strict=True,
        )
    ]
    caption = (
        "Force appropriation: forces at all references at once that drive each mode, and the "
        "mode indicator that they "
        "reach with the expected damping; 0: the mode responds alone."
    )
    return Table(("FE mode", "f, Hz", "indicator", *plan.references), rows, caption, scroll=True)


def _points(plan: PlanStage) -> Table:
    """Measuring points, and what is struck there; the struck ones first."""
    struck = {
        p: [r for r in plan.references if r.startswith((f"{p}+", f"{p}-"))]
        for p in plan.test.points.tolist()
    }
    read: dict[int, list[str]] = {}
    for p, name in zip(plan.test.at.tolist(), plan.test.channels, strict=True):
        read.setdefault(p, []).append(name.removeprefix(str(p)))
    there = (
        {p: str(k + 1) for k in range(plan.setups.count) for p in plan.roving(k)}
        if plan.setups
        else {}
    )
    parts = any(plan.test.groups)
    rows: list[tuple[str, ...]] = []
    for p, xyz, group in zip(
        plan.test.points.tolist(), plan.test.xyz.tolist(), plan.test.groups, strict=True
    ):
        setup, part = (there.get(p, "all"),) if plan.setups else (), (group,) if parts else ()
        place = (fixed(v, 3) for v in xyz)
        rows.append((str(p), *part, *place, " ".join(read.get(p, [])), *setup, " ".join(struck[p])))
    rows.sort(key=lambda row: not row[-1])
    part, setup = ("|part",) if parts else (), ("setup",) if plan.setups else ()
    heads = ("point", *part, "x, m", "y, m", "z, m", "|channels", *setup, "|strike")
    return Table(heads, rows, "Measuring points, on nodes of the model.", scroll=True)


def _verified(plan: PlanStage, found: IdentifyStage) -> Table:
    """Planned precision against that of the modes found."""
    rows = [
        (fixed(r.pop("frequency_hz"), 3), *(number(v, 2) for v in r.values()))
        for r in precision(plan, found)
    ]
    heads = ("f, Hz", "planned σ of f, %", "found, %", "planned σ of ζ, %", "found, %")
    caption = (
        "The plan verified: standard deviations of one ambient record with "
        f"{100 * plan.damping:g} % damping as "
        "planned, and those of the merged ambient modes."
    )
    return Table(heads, rows, caption)
