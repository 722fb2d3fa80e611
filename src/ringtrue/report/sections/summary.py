"""Headline: what must hold, before and after."""

from __future__ import annotations

import numpy as np

from ringtrue.correlate.pairing import CorrelationTable
from ringtrue.plots import correlation as plots
from ringtrue.report.parts import Block, Checks, Fact, Facts, Heading, Plot, Section, Table, fixed, number
from ringtrue.report.stages import Stages


def figures_of(table: CorrelationTable, used: bool | None = None) -> tuple[int, float, float, float]:
    """Pairs, mean and largest |Δf| %, mean MAC %; of all pairs, of those used or of those left out."""
    rows = [r for r in table.rows if used is None or r.used == used]
    if not rows:
        return 0, float("nan"), float("nan"), float("nan")
    deviation = np.abs([r.deviation_percent for r in rows])
    mac = float(np.mean([r.mac_percent for r in rows]))
    return len(rows), float(deviation.mean()), float(deviation.max()), mac


def section(data: Stages) -> Section | None:
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
        facts += [Fact("Total mass", number(data.model.mass / 1000, 4), "t"), Fact("DOF", f"{data.model.dof:,}")]
        facts += [Fact("Modes of the model", str(len(data.model.modes)))]
    if data.identify is not None:
        facts += [Fact("Records", str(len(data.identify.records)))]
        facts += [Fact("Ambient modes", str(len(data.identify.ambient)))]
        if data.identify.hammer is not None:
            facts += [Fact("Hammer modes", str(len(data.identify.hammer)))]
    return facts


def _facts(now: CorrelationTable, before: CorrelationTable | None) -> Facts:
    pairs, mean, peak, mac = figures_of(now)
    old = figures_of(before) if before is not None else None
    was = ["", "", "", ""] if old is None else [str(old[0]), fixed(old[1], 2), fixed(old[2], 1), fixed(old[3], 1)]
    return Facts(
        [
            Fact("Mean |Δf|", fixed(mean, 2), "%", was[1]),
            Fact("Largest |Δf|", fixed(peak, 1), "%", was[2]),
            Fact("Mean MAC", fixed(mac, 1), "%", was[3]),
            Fact("Paired modes", str(pairs), "", was[0]),
        ]
    )


def _deviations(data: Stages) -> Plot:
    stages: list[tuple[str, CorrelationTable]] = []
    if data.correlate is not None:
        stages = [("initial", data.correlate.initial), ("remodelled", data.correlate.remodelled)]
    if data.final is not None:
        stages.append(("final", data.final.table))
    caption = "Frequency deviation of the model from the test, mode by mode."
    if data.final is not None:
        caption += " Hollow marks: modes left out of the updating, chosen before it."
    return Plot(plots.deviations(stages), caption)


def _outcome(data: Stages) -> list[Block]:
    final = data.final
    assert final is not None
    before = data.correlate.initial if data.correlate is not None else None
    blocks: list[Block] = [
        _facts(final.table, before),
        Heading("What must hold"),
        Checks(list(final.checks.items())),
    ]
    blocks += [_deviations(data), _stages_table(data)]
    if final.facts:
        rows = [(k, number(v, 4)) for k, v in final.facts.items()]
        blocks.append(Table(("|Fact", "Value"), rows, "Facts of the run."))
    return blocks


def _stages_table(data: Stages) -> Table:
    tables = []
    if data.correlate is not None:
        tables += [("Initial", data.correlate.initial), ("Remodelled", data.correlate.remodelled)]
    if data.final is not None:
        tables.append(("Final", data.final.table))
    rows = []
    used = {r.test_mode: r.used for r in data.final.table.rows} if data.final is not None else {}
    for name, table in tables:
        for label, which in (("all", None), ("used in the updating", True), ("left out", False)):
            some = [r for r in table.rows if which is None or used.get(r.test_mode, r.used) == which]
            if not some:
                continue
            d = np.abs([r.deviation_percent for r in some])
            mac = np.array([r.mac_percent for r in some])
            text = [fixed(float(v), n) for v, n in ((d.mean(), 2), (d.max(), 2), (mac.mean(), 1), (mac.min(), 1))]
            rows.append((name if label == "all" else "", label, str(len(some)), *text))
    heads = ("|Model", "|Modes", "Pairs", "Mean |Δf|, %", "Max |Δf|, %", "Mean MAC, %", "Min MAC, %")
    return Table(heads, rows, "The stages of the model against the test; the modes left out judge the prediction.")
