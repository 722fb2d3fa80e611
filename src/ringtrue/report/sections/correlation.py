"""Test against test, model against test, and the other configurations; and what a correlation rests
on: orthogonality, channels, close modes, and whether deviations are beyond the scatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.display import standard_deviations
from ringtrue.correlation.measures import CloseSubspace, CompleteCorrelation
from ringtrue.correlation.orthogonality import OrthogonalityCheck
from ringtrue.correlation.table import (
    CorrelationRow,
    CorrelationTable,
    Significance,
    table_significance,
)
from ringtrue.plots import correlation as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Diff,
    Fold,
    Heading,
    Items,
    Plot,
    ReportTable,
    Section,
    Stages,
    Text,
    fixed,
    number,
    sentence,
    signs,
)
from ringtrue.study.results import (
    ConfiguredTest,
    DeliveredConfiguration,
    Evidence,
    FinalStage,
    RemodelStep,
    Seat,
)

FOLDED = "Orthogonality, channels and close modes"
QUALITY = (
    "Pairs",
    "Mean |Δf|, %",
    "Max |Δf|, %",
    "Mean MAC, %",
    "Mean subspace MAC, %",
)
FEW = 8  # modes above the other set's band that are still listed one by one


def pairs(
    table: CorrelationTable,
    data: Stages,
    caption: str,
    updating: bool,
    judged: Significance | None = None,
) -> ReportTable:
    """The table of pairs, with acceptance, significance and flags; with `updating` whether the
    updating used them.

    `judged` is the significance of the deviations where both sets are uncertain; else that of the
    test decides.
    """
    a, b = table.names
    deviations = judged or table_significance(table, data.repeats)
    floor = data.repeats if judged is None else float("nan")
    heads = ["#", f"{a} #", f"{b} #", f"f {a}, Hz", f"f {b}, Hz", "Δf, %", "Δf, Hz"]
    heads += ["MAC, %", "Subspace MAC, %", "Δf/σ", "|Acceptance"]
    heads += ["|Updating", "|"] if updating else ["|"]
    scatter = zip(deviations.z.tolist(), deviations.significant.tolist(), strict=True)
    every = zip(table.rows(), scatter, strict=True)
    rows = [_row(i, r, data, updating, s) for i, (r, s) in enumerate(every, start=1)]
    _, deviation, _, *macs = _means(table)
    foot = ["Mean, of |Δf|", deviation, "", *macs, *[""] * (len(heads) - 9)]
    text = (
        f"{caption} Accepted: {data.acceptance.words()}.{_scatter(deviations, floor)}"
    )
    lead = 5
    names = [data.names.get(r.test_hz, "") for r in table.rows()]
    if any(names):
        lead += 1
        heads.insert(2, "|Mode")
        for row, name in zip(rows, names, strict=True):
            row.insert(2, name)
    table_of_pairs = ReportTable(heads, rows, text, foot if rows else (), lead=lead)
    return table_of_pairs.without_blank("MAC").without_blank("Δf/σ")


def _scatter(deviations: Significance, repeats: float) -> str:
    """What the deviations are divided by; `repeats` is the least that it is, relative."""
    known = np.isfinite(deviations.z)
    if not known.any():
        return ""
    inside = int((known & ~deviations.significant).sum())
    text = (
        f" Δf/σ: in standard deviations of the measurement; {inside} of {int(known.sum())} are "
        f"within its scatter (false discovery rate {100 * deviations.rate:g} %)."
    )
    if np.isfinite(repeats):
        least = number(100 * repeats, 2)
        text += f" σ is at least {least} %: so far the two tests repeat a frequency."
    return text


def _row(
    number: int,
    r: CorrelationRow,
    data: Stages,
    updating: bool,
    scatter: tuple[float, bool],
) -> list[str | Cell]:
    ok = data.acceptance.holds(
        r.deviation_percent, r.deviation_hz, r.subspace_mac_percent
    )
    row: list[str | Cell] = [
        str(number),
        str(r.test),
        str(r.fe),
        fixed(r.test_hz, 3),
        fixed(r.fe_hz, 3),
        fixed(r.deviation_percent, 2, sign=True),
        fixed(r.deviation_hz, 3, sign=True),
        fixed(r.mac_percent, 1),
        fixed(r.subspace_mac_percent, 1),
    ]
    z, beyond = scatter
    shown = standard_deviations(z)
    within = np.isfinite(z) and not beyond
    row.append(Cell(shown, "good", "within the scatter") if within else shown)
    row.append(Cell("accepted", "good") if ok else Cell("outside", "bad"))
    if updating:
        row.append("used" if r.used else Cell("left out", "chip"))
    flag: str | Cell = (
        Cell("close modes", "chip", "compared as a subspace") if r.subspace else ""
    )
    if r.beyond:
        why = "beyond the frequency gate, with similar shapes, and like no other mode"
        flag = Cell("beyond the gate", "chip", why)
    return [*row, flag]


def unpaired(table: CorrelationTable) -> list[Block]:
    """The modes without a partner, with the reasons."""
    p = table.pairing
    top = float(table.all_test_hz.max(initial=0.0))
    out: list[Block] = []
    for name, lone, reasons, f in (
        (table.names[0], p.unpaired_a, p.reasons_a, table.all_test_hz),
        (table.names[1], p.unpaired_b, p.reasons_b, table.all_fe_hz),
    ):
        every = list(zip(lone.tolist(), reasons, strict=True))
        above = int((f[lone] > top).sum())
        caption = f"{name[:1].upper()}{name[1:]} modes without a partner."
        if above > FEW:
            every = [(k, why) for k, why in every if f[k] <= top]
            caption += f" {above} more lie above the highest {table.names[0]} mode."
        rows = [(str(k + 1), fixed(f[k], 3), signs(why)) for k, why in every]
        if rows:
            out.append(ReportTable(("#", "f, Hz", "|Reason"), rows, caption))
    return out


def blocks(
    table: CorrelationTable,
    data: Stages,
    caption: str,
    updating: bool,
    judged: Significance | None = None,
) -> list[Block]:
    """Pairs, MAC matrix, unpaired."""
    a, b = table.names
    out: list[Block] = [pairs(table, data, caption, updating, judged)]
    if table.mac.size:
        text = (
            f"MAC of single shapes between {a} (rows) and {b} (columns) modes; numbers from "
            "10 %, pairs outlined."
        )
        out.append(Plot(plots.table_matrix(table), text))
    return out + unpaired(table)


def tests(data: Stages) -> Section | None:
    """Ambient against hammer."""
    if data.compare is None:
        return None
    table = data.compare.table
    e = data.compare.evidence
    caption = "The two tests at their common channels."
    judged = e.measures.significance if e else table_significance(table)
    body = blocks(table, data, caption, updating=False, judged=judged)
    body += brief(e, table, "Channels and close modes")
    return Section("tests", "Ambient against hammer", body)


def initial(data: Stages) -> Section | None:
    """The initial model."""
    c = data.correlate
    if c is None:
        return None
    body: list[Block] = [Text(sentence(m.text)) for m in c.sensors.mendings]
    body += [
        Text(
            f"Channel {s.channel} looks {s.fault} in the rigid-body modes: {s.message}."
        )
        for s in c.sensors.rigid
    ]
    if c.sensors.alignment:
        body.append(Text(sentence(c.sensors.alignment)))
    if c.notes:
        body.append(
            Items([sentence(n) for n in c.notes], f"Notes on the test ({len(c.notes)})")
        )
    if read := c.sensors.seats:
        body.append(
            Fold(f"Where the sensors are read ({len(read)} channels)", [seats(read)])
        )
    body += blocks(
        c.initial, data, "The initial model against the test.", updating=True
    )
    body += brief(c.evidence_initial, c.initial, FOLDED)
    return Section("initial", "Initial correlation", body)


def seats(found: Sequence[Seat]) -> ReportTable:
    """The map from the points of the sheet to the nodes of the deck."""
    rows = [
        [
            s.channel,
            s.sensor + (" turned" if s.sign < 0 else ""),
            str(s.point),
            " ".join(map(str, s.nodes)),
            fixed(1e3 * s.distance, 1),
        ]
        for s in found
    ]
    text = (
        "The nodes of the deck at which each channel is read; numbers of points are those of "
        "the sensor sheet."
    )
    heads = ("|Channel", "|On the sheet", "Point", "|Node", "Distance, mm")
    return ReportTable(heads, rows, text, scroll=len(rows) > 20)


def remodelled(data: Stages) -> Section | None:
    """The stated change of the deck before updating."""
    c = data.correlate
    if c is None or c.remodelling is None:
        return None
    r = c.remodelling
    body: list[Block] = [Text(sentence(r.reason))] if r.reason else []
    body += [_history(r.history)] if len(r.history) > 2 else []
    body += [Diff(r.diff, "The remodelling as a change of the deck.")] if r.diff else []
    body += blocks(
        c.remodelled, data, "The remodelled deck against the test.", updating=True
    )
    body += brief(c.evidence, c.remodelled, FOLDED)
    return Section("remodelled", "Remodelling", body)


def _history(steps: Sequence[RemodelStep]) -> ReportTable:
    """Each step of the remodelling against the test."""
    rows = [
        [
            str(i),
            s.reason,
            str(s.pairs),
            fixed(s.mean_deviation, 2),
            fixed(s.max_deviation, 2),
            fixed(s.mean_mac, 1),
            fixed(s.mean_subspace_mac, 1),
        ]
        for i, s in enumerate(steps)
    ]
    heads = ("Step", "|What", *QUALITY)
    text = "The initial deck and that after each step of the remodelling, against the test."
    return ReportTable(heads, rows, text).without_blank("MAC")


def final(data: Stages) -> Section | None:
    """The delivered deck, read back."""
    f = data.final
    if f is None:
        return None
    body: list[Block] = [
        Text(
            "The final model is the delivered deck, read back from its files after all changes."
        )
    ]
    body += blocks(f.table, data, "The final model against the test.", updating=True)
    if len(f.rigid):
        body.append(
            pairs(f.rigid, data, "Rigid-body modes of the final model.", updating=False)
        )
    body += whole(f.evidence, f.table)
    if deck := changes(f.files, f.changes):
        body += [Heading("Changes of the deck"), *deck]
    return Section("final", "Final correlation", body)


def changes(files: Sequence[str], lines: Sequence[str]) -> list[Block]:
    """The changed fields of the deck."""
    caption = f"Changed fields of the deck ({', '.join(Path(f).name for f in files)})."
    parts = [x.split() for x in lines]
    if all(len(p) == 7 and p[5] == "->" for p in parts):
        rows = [
            (place, f"{card} {ident}", field, old, new)
            for place, card, ident, field, old, _, new in parts
        ]
        heads: tuple[str, ...] = ("|File:line", "|Card", "|Field", "Initial", "Updated")
        return (
            [ReportTable(heads, rows, caption, scroll=len(rows) > 20)] if rows else []
        )
    return [
        ReportTable(("|Change",), [(signs(x),) for x in lines], caption, scroll=True)
    ]


def configurations(data: Stages) -> Section | None:
    """One line a configuration, then the tables of each."""
    if data.configurations is None:
        return None
    after = {c.name: c for c in data.configured.items} if data.configured else {}
    items = data.configurations.items
    done = "Nothing has been updated yet."
    if after:
        done = (
            "One parameter set was updated over all of them and over the deck of the study; every "
            "deck that has a changed field was edited in place, read back and judged by its own "
            "test."
        )
    lead = f"Each configuration has a deck and a test of its own. {done}"
    body: list[Block] = [Text(lead, "lead"), _configuration_table(data, items, after)]
    for c in items:
        body += _configuration(data, c, after.get(c.name))
    return Section("configurations", "Other configurations", body)


def _configuration_table(
    data: Stages,
    items: tuple[ConfiguredTest, ...],
    after: dict[str, DeliveredConfiguration],
) -> ReportTable:
    rows = []
    if (c := data.correlate) is not None:
        deck = Path(data.model.files[0]).name if data.model else ""
        values = _before_after(c.remodelled, data.final)
        modes = f"{len(c.reference.elastic)} modes"
        rows.append(["the deck of the study", deck, modes, *values])
    for item in items:
        values = _before_after(item.initial, after.get(item.name))
        rows.append([item.name, Path(item.files[0]).name, item.source, *values])
    text = "Every configuration before → after the updating; modes left out are counted, too."
    return ReportTable(("|Configuration", "|Deck", "|Test", *QUALITY), rows, text)


def _before_after(
    before: CorrelationTable, after: FinalStage | DeliveredConfiguration | None
) -> list[str]:
    now = _means(before)
    if after is None:
        return now
    return [f"{one} → {two}" for one, two in zip(now, _means(after.table), strict=True)]


def _means(table: CorrelationTable) -> list[str]:
    """The columns of `QUALITY`."""
    return [
        str(len(table)),
        fixed(table.mean_deviation(), 2),
        fixed(table.max_deviation(), 2),
        fixed(table.mean_mac(), 1),
        fixed(table.mean_subspace_mac(), 1),
    ]


def _configuration(
    data: Stages, c: ConfiguredTest, after: DeliveredConfiguration | None
) -> list[Block]:
    caption = f"{c.name}: the deck before the updating against its test."
    before = blocks(c.initial, data, caption, updating=True)
    out: list[Block] = [Heading(c.name)]
    out += [Text(sentence(m.text)) for m in c.sensors.mendings]
    out += (
        [Items([sentence(n) for n in c.notes], "Where its deck differs")]
        if c.notes
        else []
    )
    if after is None:
        return [*out, *before]
    caption = f"{c.name}: the delivered deck against its test."
    out += blocks(after.table, data, caption, updating=True)
    out.append(Fold(f"{c.name}: before the updating", before))
    return [*out, *changes(after.files, after.changes)]


WHOSE = {
    "model": "the model's own modes",
    "self": "test modes",
    "cross": "test against model",
}
MOST = 6  # entries beyond the gate that are named
# angle from which two spaces of close modes are called different
TURNED = math.radians(30)


def brief(e: Evidence | None, table: CorrelationTable, title: str) -> list[Block]:
    """Suspected channels in the open, all else folded away."""
    if e is None:
        return []
    m = e.measures
    inner = [*orthogonality(e, table), *channels(m), *close(m, table), *_notes(m)]
    return [suspects(m, table), *([Fold(title, inner)] if inner else [])]


def whole(e: Evidence | None, table: CorrelationTable) -> list[Block]:
    """Everything in the open but the long tables."""
    if e is None:
        return []
    parts = orthogonality(e, table)
    out: list[Block] = [Heading("Orthogonality"), *parts] if parts else []
    out += [Heading("Channels"), suspects(e.measures, table), *channels(e.measures)]
    if near := close(e.measures, table):
        out += [Heading("Close modes"), *near]
    if e.tracks is not None:
        caption = (
            "The modes of the final model followed back to the initial one by their shapes at "
            "the channels, besides the "
            "test. Grey: no partner; dotted: the shapes have less than 60 % MAC, the mode may be "
            "another one."
        )
        out += [
            Heading("Modes followed"),
            Plot(plots.followed(e.tracks, table), caption),
        ]
    return out + _notes(e.measures)


def orthogonality(e: Evidence, table: CorrelationTable) -> list[Block]:
    """The verdicts, and the matrices of the best mass at hand."""
    checks = e.measures.checks
    if not checks:
        return []
    gate = checks[0].verdict.gate
    caption = (
        f"Orthogonality at the channels with the gate {gate.name}: at least "
        f"{100 * gate.diagonal:g} % of a pair, at "
        f"most {100 * gate.off_diagonal:g} % between different modes. Close modes are turned as "
        "they were paired."
    )
    if any(c.kind == "model" for c in checks):
        caption += (
            " A mass that does not distinguish the model's own modes, read with an error "
            "of 2 %, is not fit to judge by."
        )
    heads = (
        "|Mass",
        "|Of",
        "Least pair, %",
        "Largest other, %",
        "|Verdict",
        "|Beyond the gate",
    )
    out: list[Block] = [
        ReportTable(heads, [_check(c, e.measures) for c in checks], caption)
    ]
    side = plots.MatrixSide(
        plots.labels(table.all_test_hz), f"{table.names[0]} mode, Hz"
    )
    auto = plots.matrix(e.auto_mac, side, side, height=440, diagonal=False)
    left: list[Block] = [
        Plot(auto, f"Auto-MAC of the {table.names[0]} shapes; numbers from 10 %.")
    ]
    shown = e.measures.cross or checks[0]
    what = f"{shown.name[:1].upper()}{shown.name[1:]}; outlined: beyond the gate."
    return [*out, Columns([left, [Plot(plots.orthogonality(shown, table, 440), what)]])]


def _check(c: OrthogonalityCheck, measures: CompleteCorrelation) -> list[str | Cell]:
    v = c.verdict
    least = fixed(100 * v.least_diagonal, 1) if c.kind != "self" else "–"
    most = fixed(100 * v.largest_off_diagonal, 1)
    # the worst first; those of a symmetric matrix once
    once = [f for f in v.failures if c.kind == "cross" or f.a < f.b]
    left, right = {"model": ("FE ", "FE "), "self": ("", ""), "cross": ("", "FE ")}[
        c.kind
    ]
    named = ", ".join(
        f"{left}{f.a + 1} – {right}{f.b + 1}: {100 * f.value:.0f} %"
        for f in once[:MOST]
    )
    if len(once) > MOST:
        named += f" and {len(once) - MOST} more"
    return [c.mass, WHOSE[c.kind], least, most, verdict(c, measures), named]


def verdict(c: OrthogonalityCheck, measures: CompleteCorrelation) -> Cell:
    """Whether a check has passed, where it can be judged."""
    if not measures.judges(c):
        return Cell("no verdict", "warn")
    return Cell("passed", "good") if c.verdict.passed else Cell("failed", "bad")


def suspects(c: CompleteCorrelation, table: CorrelationTable) -> ReportTable | Text:
    """Channels that contradict the other set: named, never mended."""
    if not c.suspects and len(table) < 3:
        return Text("With fewer than 3 pairs channels are not judged.")
    if not c.suspects:
        clean = "no channel looks reversed, swapped, mis-scaled or dead"
        return Text(f"Against the {table.names[1]} modes {clean}.")
    caption = (
        "Channels to look at; nothing was mended. A region that is wrong in the model may "
        "look like a fault."
    )
    heads = ("|Channel", "|Looks", "|What is seen", "MAC now, %", "MAC if mended, %")
    rows = [
        (
            s.channel,
            Cell(s.fault, "warn"),
            sentence(s.message.split("; ")[0]),
            fixed(100 * s.mac_now, 1),
            fixed(100 * s.mac_mended, 1),
        )
        for s in c.suspects
    ]
    return ReportTable(heads, rows, caption)


def channels(c: CompleteCorrelation) -> list[Block]:
    """The worst channels, and all of them in a fold."""
    if not c.scale.size:
        return []
    caption = (
        "The channels with the lowest CoMAC; those with the highest eCoMAC, which sees signs and "
        "what moves; the mean MAC of the pairs if the channels that spoil it most were left out "
        "one by one. Nothing was left out."
    )
    by = c.by_channel
    rows = [
        (
            c.channels[i],
            fixed(100 * by.comac[i], 1),
            fixed(100 * by.ecomac[i], 2),
            fixed(100 * by.contribution[i], 2),
        )
        for i in by.comac.argsort(kind="stable")
    ]
    heads = ("|Channel", "CoMAC, %", "eCoMAC, %", "Contribution to the MAC, %")
    text = (
        "All channels, the worst first. The contributions add up to the mean MAC; a negative "
        "one works against it."
    )
    every = Fold(
        f"All {len(rows)} channels", [ReportTable(heads, rows, text, scroll=True)]
    )
    return [Plot(plots.channels(c), caption), every]


def close(c: CompleteCorrelation, table: CorrelationTable) -> list[Block]:
    """Groups of close modes compared as spaces."""
    if not c.subspaces:
        return []
    a, b = table.names
    heads = (
        f"|{a} modes",
        f"|f {a}, Hz",
        f"|{b} modes",
        f"|f {b}, Hz",
        "|Principal angles, °",
    )
    caption = (
        "Close modes compared as spaces: principal angles, 0° where one set can be turned into "
        "the other; a large one "
        "means that a shape of one set is missing in the other."
    )
    return [ReportTable(heads, [_close(s, table) for s in c.subspaces], caption)]


def _close(s: CloseSubspace, table: CorrelationTable) -> list[str | Cell]:
    sides: list[str | Cell] = []
    for modes, f in ((s.a, table.all_test_hz), (s.b, table.all_fe_hz)):
        sides += [
            ", ".join(str(i + 1) for i in modes),
            ", ".join(fixed(f[i], 2) for i in modes),
        ]
    described = ", ".join(fixed(math.degrees(x), 1) for x in s.angles)
    return [*sides, Cell(described, "warn" if max(s.angles) > TURNED else "")]


def _notes(c: CompleteCorrelation) -> list[Block]:
    return [Text(sentence(n), "note") for n in c.notes]
