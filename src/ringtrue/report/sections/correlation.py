"""Correlation: test against test, and the model's stages against the test."""

from __future__ import annotations

from collections.abc import Sequence

from ringtrue.core.modes import ModeSet
from ringtrue.correlate.pairing import CorrelationTable
from ringtrue.plots import correlation as plots
from ringtrue.report.parts import Block, Cell, Diff, Plot, Section, Table, Text, fixed
from ringtrue.report.sections.summary import figures_of
from ringtrue.report.stages import Stages


def pairs(table: CorrelationTable, data: Stages, caption: str, heads: tuple[str, str], updating: bool) -> Table:
    """The table of pairs, with acceptance per mode and flags."""
    rows = []
    for i, r in enumerate(table.rows):
        ok = data.acceptance.holds(r.deviation_percent, r.deviation_hz, r.mac_percent)
        flags = (
            [Cell("subspace", "chip", "MAC of the subspace: the mode is close to another")] if r.subspace else [""]
        )
        row: list[str | Cell] = [str(i + 1), str(r.test_mode + 1), str(r.fe_mode + 1)]
        row += [fixed(r.frequency_test, 3), fixed(r.frequency_fe, 3)]
        row += [fixed(r.deviation_percent, 2, sign=True), fixed(r.deviation_hz, 3, sign=True)]
        row += [fixed(r.mac_percent, 1), Cell("accepted", "good") if ok else Cell("outside", "bad")]
        row += [("used" if r.used else Cell("left out", "chip"))] if updating else []
        rows.append([*row, *flags])
    a, b = heads
    names = ["#", f"{a} #", f"{b} #", f"f {a}, Hz", f"f {b}, Hz", "Δf, %", "Δf, Hz", "MAC, %", "|Acceptance"]
    names += ["|Updating"] if updating else []
    _, mean, _, mac = figures_of(table)
    foot = ["", "", "", "", "mean, of |Δf|", fixed(mean, 2), "", fixed(mac, 1), ""]
    text = f"{caption} Accepted: {data.acceptance.words()}."
    return Table((*names, "|"), rows, text, [*foot, *([""] * (len(names) + 1 - len(foot)))])


def unpaired(table: CorrelationTable, names: tuple[str, str]) -> list[Block]:
    """The modes without a partner, with the reasons."""
    rows = [
        (names[0] if u.side == "test" else names[1], str(u.mode + 1), fixed(u.frequency, 3), u.reason)
        for u in table.unpaired
    ]
    return [Table(("|Set", "#", "f, Hz", "|Reason"), rows, "Modes without a partner.")] if rows else []


def blocks(
    table: CorrelationTable,
    a: ModeSet,
    b: ModeSet,
    data: Stages,
    caption: str,
    names: tuple[str, str],
    updating: bool,
) -> list[Block]:
    """Pairs, MAC matrix, unpaired."""
    out: list[Block] = [pairs(table, data, caption, names, updating)]
    if table.mac.size:
        fig = plots.table_matrix(table, a.frequencies, b.frequencies, names)
        out.append(Plot(fig, f"MAC between {names[0]} (rows) and {names[1]} (columns) modes; numbers from 10 %."))
    return out + unpaired(table, names)


def tests(data: Stages) -> Section | None:
    """Ambient against hammer."""
    if data.compare is None or data.identify is None or data.identify.hammer is None:
        return None
    caption = "Ambient and hammer tests, common channels."
    names = ("ambient", "hammer")
    ident = data.identify
    assert ident.hammer is not None
    body = blocks(data.compare.table, ident.ambient, ident.hammer, data, caption, names, updating=False)
    return Section("tests", "Ambient against hammer", body)


def initial(data: Stages) -> Section | None:
    """The model as delivered."""
    c = data.correlate
    if c is None:
        return None
    caption = "The model as delivered against the test."
    body = blocks(c.initial, c.reference, c.fe_initial, data, caption, ("test", "FE"), updating=True)
    return Section("initial", "Initial correlation", body)


def remodelled(data: Stages) -> Section | None:
    """The stated change of the deck before updating."""
    c = data.correlate
    if c is None or not (c.diff or c.remodelling):
        return None
    body: list[Block] = [Text(c.remodelling)] if c.remodelling else []
    body += [Diff(c.diff, "The remodelling as a change of the deck.")] if c.diff else []
    caption = "The remodelled deck against the test."
    body += blocks(c.remodelled, c.reference, c.fe_remodelled, data, caption, ("test", "FE"), updating=True)
    return Section("remodelled", "Remodelling", body)


def final(data: Stages) -> Section | None:
    """The delivered deck, read back."""
    f, reference = data.final, data.reference
    if f is None or reference is None:
        return None
    body: list[Block] = [Text("Computed from the delivered deck, read back from its files after all changes.")]
    caption = "The final model against the test."
    body += blocks(f.table, reference, f.observed, data, caption, ("test", "FE"), updating=True)
    body += changes(f.files, f.changes)
    return Section("final", "Final correlation", body)


def changes(files: Sequence[str], lines: Sequence[str]) -> list[Block]:
    """The changed fields of the deck."""
    rows = [(x,) for x in lines]
    return [Table(("|Field",), rows, f"Changed fields in {', '.join(files)}.", scroll=True)] if rows else []
