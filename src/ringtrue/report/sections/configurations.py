"""The other configurations that were updated together with the deck of the study, before and
after.
"""

from __future__ import annotations

from pathlib import Path

from ringtrue.correlation.table import CorrelationTable
from ringtrue.report.parts import Block, Fold, Heading, Items, Section, Table, Text, fixed, sentence
from ringtrue.report.sections.correlation import blocks, changes
from ringtrue.report.stages import Stages
from ringtrue.study.results import ConfiguredTest, DeliveredConfiguration

HEADS = (
    "|Configuration",
    "|Deck",
    "|Test",
    "Pairs",
    "Mean |Δf|, %",
    "Max |Δf|, %",
    "Mean MAC, %",
    "Mean subspace MAC, %",
)


def section(data: Stages) -> Section | None:
    """One line a configuration, then the tables of each."""
    if data.configurations is None:
        return None
    after = {c.name: c for c in data.configured.items} if data.configured else {}
    items = data.configurations.items
    lead = "Each configuration has a deck and a test of its own. "
    lead += (
        "One parameter set was updated over all of them and over the deck of the study; every "
        "deck that has a changed "
        "field was edited in place, read back and judged by its own test."
        if after
        else "Nothing has been updated yet."
    )
    body: list[Block] = [Text(lead, "lead"), _overview(data, items, after)]
    for c in items:
        body += _one(data, c, after.get(c.name))
    return Section("configurations", "Other configurations", body)


def _overview(
    data: Stages, items: tuple[ConfiguredTest, ...], after: dict[str, DeliveredConfiguration]
) -> Table:
    rows = []
    if data.correlate is not None:
        last = data.final.table if data.final else None
        deck = Path(data.model.files[0]).name if data.model else ""
        modes = f"{len(data.correlate.reference)} modes"
        rows.append(
            ["the deck of the study", deck, modes, *_values(data.correlate.remodelled, last)]
        )
    for c in items:
        done = after.get(c.name)
        rows.append(
            [
                c.name,
                Path(c.files[0]).name,
                c.source,
                *_values(c.initial, done.table if done else None),
            ]
        )
    return Table(
        HEADS,
        rows,
        "Every configuration before → after the updating; modes left out are counted, too.",
    )


def _values(before: CorrelationTable, after: CorrelationTable | None) -> list[str]:
    def both(one: str, two: str) -> str:
        return f"{one} → {two}" if after is not None else one

    b, a = before, after or before
    return [
        both(str(len(b)), str(len(a))),
        both(fixed(b.mean_deviation(), 2), fixed(a.mean_deviation(), 2)),
        both(fixed(b.max_deviation(), 2), fixed(a.max_deviation(), 2)),
        both(fixed(b.mean_mac(), 1), fixed(a.mean_mac(), 1)),
        both(fixed(b.mean_subspace_mac(), 1), fixed(a.mean_subspace_mac(), 1)),
    ]


def _one(data: Stages, c: ConfiguredTest, after: DeliveredConfiguration | None) -> list[Block]:
    before = blocks(
        c.initial, data, f"{c.name}: the deck before the updating against its test.", updating=True
    )
    out: list[Block] = [Heading(c.name)]
    out += [Text(sentence(m.text)) for m in c.mendings]
    out += [Items([sentence(n) for n in c.notes], "Where its deck differs")] if c.notes else []
    if after is None:
        return [*out, *before]
    out += blocks(
        after.table, data, f"{c.name}: the delivered deck against its test.", updating=True
    )
    out.append(Fold(f"{c.name}: before the updating", before))
    return [*out, *changes(after.files, after.changes)]
