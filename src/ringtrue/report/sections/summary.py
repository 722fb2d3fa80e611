"""Summary and provenance."""

from __future__ import annotations

import re
from collections import Counter

from ringtrue.correlation.measures import CompleteCorrelation
from ringtrue.correlation.orthogonality import OrthogonalityCheck
from ringtrue.correlation.table import CorrelationTable
from ringtrue.plots import correlation as plots
from ringtrue.report.parts import (
    MISSING,
    Block,
    Cell,
    Code,
    Columns,
    Fact,
    Facts,
    Heading,
    Plot,
    ReportTable,
    Section,
    Stages,
    fixed,
    number,
)
from ringtrue.report.sections import shapes, system
from ringtrue.report.sections.correlation import verdict
from ringtrue.study.acceptance import in_both

GOOD = Cell("passed", "good")
BAD = Cell("failed", "bad")


def summary(data: Stages) -> Section | None:
    """The summary, of whatever was run."""
    blocks: list[Block] = []
    if data.final is not None:
        blocks += _outcome(data)
    elif data.correlate is not None:
        blocks += [_facts(data.correlate.initial, None), _deviations(data)]
    else:
        facts = _inventory(data)
        blocks += [Facts(facts)] if facts else []
    return Section("summary", "Summary", blocks) if blocks else None


def _inventory(data: Stages) -> list[Fact]:
    facts: list[Fact] = []
    if data.model is not None:
        mass, unit = system.weight(data.model)
        facts += [
            Fact("Total mass", number(mass, 4), unit),
            Fact("DOF", f"{data.model.dof:,}"),
        ]
        facts += [Fact("Modes of the model", str(len(data.model.modes)))]
    if data.identify is not None:
        facts += [Fact("Records", str(len(data.identify.records)))]
        ambient = data.identify.ambient
        facts += [Fact("Ambient modes", str(len(ambient)))]
        counts = Counter(ambient.others.classes)
        facts += [Fact(kind.capitalize(), str(n)) for kind, n in sorted(counts.items())]
        if data.identify.hammer is not None:
            source = data.identify.source
            name = "Hammer modes" if source == "hammer test" else f"Modes of {source}"
            facts += [Fact(name, str(len(data.identify.hammer)))]
    return facts


def _facts(now: CorrelationTable, before: CorrelationTable | None) -> Facts:
    old = _figures(before) if before is not None else ("",) * 5
    labels = (
        ("Mean |Δf|", "%"),
        ("Largest |Δf|", "%"),
        ("Mean MAC", "%"),
        ("Mean subspace MAC", "%"),
        ("Paired modes", ""),
    )
    both = zip(labels, _figures(now), old, strict=True)
    return Facts(
        [
            Fact(label, value, unit, was)
            for (label, unit), value, was in both
            if value != MISSING
        ]
    )


def _figures(table: CorrelationTable) -> tuple[str, ...]:
    return (
        fixed(table.mean_deviation(), 2),
        fixed(table.max_deviation(), 1),
        fixed(table.mean_mac(), 1),
        fixed(table.mean_subspace_mac(), 1),
        str(len(table)),
    )


def _tables(data: Stages) -> list[tuple[str, CorrelationTable]]:
    """The initial model, remodelled if it was, and updated."""
    out: list[tuple[str, CorrelationTable]] = []
    if (c := data.correlate) is not None:
        out.append(("initial", c.initial))
        if c.remodelling is not None:
            out.append(("remodelled", c.remodelled))
    if data.final is not None:
        out.append(("final", data.final.table))
    return out


def _deviations(data: Stages) -> Plot:
    stages = _tables(data)
    caption = "Frequency deviation of the model from the test, mode by mode."
    if not all(t.frequency_only for _, t in stages):
        caption = (
            "Frequency deviation of the model from the test, MAC and subspace MAC of the pairs, "
            "mode by mode. The two differ where close modes are compared as one subspace."
        )
    if data.final is not None:
        caption += " Hollow marks: modes left out of the updating, chosen before it."
    return Plot(plots.deviations(stages), caption)


def _outcome(data: Stages) -> list[Block]:
    final = data.final
    assert final is not None
    before = data.correlate.initial if data.correlate is not None else None
    left = _evidence(data)
    picture = shapes.first(data)
    if left and picture is not None:
        left = [Columns([left, [picture]])]
    elif picture is not None:
        left = [picture]
    return [_facts(final.table, before), *left, _deviations(data), stages_table(data)]


def _evidence(data: Stages) -> list[Block]:
    """What the final correlation rests on, in a few lines."""
    final = data.final
    if final is None or final.evidence is None:
        return []
    e = final.evidence.measures
    table = final.table
    missed = len(data.acceptance.missed(table))
    kept = f"{len(table) - missed} of {len(table)}"
    rows: list[tuple[str, str, str | Cell]] = [
        (f"Pairs with {data.acceptance.words()}", kept, BAD if missed else GOOD)
    ]
    rows += [_orthogonality(e.cross, e)] if e.cross else []
    names = ", ".join(dict.fromkeys(s.channel for s in e.suspects))
    rows.append(
        (
            "Channels that look faulty",
            names or "none",
            Cell("look", "warn") if names else GOOD,
        )
    )
    if (frfs := final.evidence.frfs) is not None:
        change = f"{100 * frfs.initial.shape.mean():.0f} → {100 * frfs.final.shape.mean():.0f} %"
        rows.append(("Shape correlation of the FRFs, mean of the lines", change, ""))
    caption = "The evidence of the final correlation, in short."
    return [
        Heading("What it rests on"),
        ReportTable(("|Evidence", "|Found", "|"), rows, caption),
    ]


def _orthogonality(
    cross: OrthogonalityCheck, measures: CompleteCorrelation
) -> tuple[str, str, Cell]:
    """What the mass at the channels says, if it distinguishes the model's own modes."""
    v = cross.verdict
    name = f"Cross-orthogonality, {cross.mass} mass, gate {v.gate.name}"
    found = f"pairs ≥ {100 * v.least_diagonal:.0f} %, others ≤ {100 * v.largest_off_diagonal:.0f} %"
    if not measures.judges(cross):
        found = "not to be judged: at these channels it does not distinguish the model's own modes"
    return name, found, verdict(cross, measures)


def stages_table(data: Stages) -> ReportTable:
    """Deviations and MAC of each state of the model; means of the same modes in the first and the
    last.
    """
    rows = []
    named = _tables(data)
    used, out = (in_both(*(t for _, t in named), used=u) for u in (True, False))
    for (name, table), seen, unseen in zip(named, used, out, strict=True):
        for label, which in (
            ("all", None),
            ("used in the updating", seen),
            ("left out", unseen),
        ):
            count = len(table) if which is None else int(which.sum())
            if not count:
                continue
            row = (
                name.capitalize() if which is None else "",
                label,
                str(count),
                fixed(table.mean_deviation(which), 2),
                fixed(table.max_deviation(which), 2),
                fixed(table.mean_mac(which), 1),
                fixed(table.min_mac(which), 1),
                fixed(table.mean_subspace_mac(which), 1),
                fixed(table.min_subspace_mac(which), 1),
            )
            rows.append(row)
    heads = ["|Model", "|Modes", "Pairs", "Mean |Δf|, %", "Max |Δf|, %", "Mean MAC, %"]
    heads += ["Min MAC, %", "Mean subspace MAC, %", "Min subspace MAC, %"]
    text = (
        "The stages of the model against the test. Modes that were used or left out are those "
        "with a partner in the first stage and the last; the ones left out judge the prediction."
    )
    if not all(t.frequency_only for _, t in named):
        text += " Subspace MAC: close modes are rotated inside their subspace towards the test."
    return ReportTable(heads, rows, text).without_blank("MAC")


LONG = re.compile(r"\[\s*((?:[\d.+-]+,\s*){6})((?:[\d.+-]+,\s*){20,}[\d.+-]+,?)\s*\]")


def _shortened(text: str) -> str:
    """Settings with long lists of numbers cut; the store holds them in full."""
    return LONG.sub(lambda m: f"[{m[1]}… {m[2].rstrip(',').count(',') + 1} more]", text)


def provenance(data: Stages) -> Section | None:
    """Inputs, versions, seed, settings, timings."""
    p = data.provenance
    if p is None:
        return None
    run = [("ringtrue", p.version), ("Python", p.python), ("Platform", p.platform)]
    run += [
        ("Seed", str(p.seed)),
        ("Started", p.started.replace("T", " ")),
        *p.packages.items(),
    ]
    spent = [(k, fixed(v, 1)) for k, v in p.timings.items()]
    total = ("total", fixed(sum(p.timings.values()), 1))
    inputs = [(name, Cell(sha, "mono")) for name, sha in p.inputs.items()]
    versions = ReportTable(("|What", "|Version or value"), run, "The run.")
    timings = ReportTable(("|Stage", "Time, s"), spent, "Timings.", total)
    files = ReportTable(
        ("|Input", "|SHA-256"), inputs, "The input files.", scroll=len(inputs) > 16
    )
    settings = Code("Resolved settings", _shortened(p.settings))
    return Section(
        "provenance", "Provenance", [Columns([[versions], [timings]]), files, settings]
    )
