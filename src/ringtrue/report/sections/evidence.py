"""What a correlation rests on: orthogonality, channels, close modes, and whether deviations are
beyond the scatter.
"""

from __future__ import annotations

import math

from ringtrue.correlation.measures import CloseSubspace, CompleteCorrelation
from ringtrue.correlation.orthogonality import OrthogonalityCheck
from ringtrue.correlation.table import CorrelationTable
from ringtrue.plots import correlation as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Fold,
    Heading,
    Plot,
    ReportTable,
    Text,
    fixed,
    sentence,
)
from ringtrue.study.results import Evidence

WHOSE = {"model": "the model's own modes", "self": "test modes", "cross": "test against model"}
MOST = 6  # entries beyond the gate that are named
TURNED = math.radians(30)  # angle from which two spaces of close modes are called different


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
        out += [Heading("Modes followed"), Plot(plots.followed(e.tracks, table), caption)]
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
    heads = ("|Mass", "|Of", "Least pair, %", "Largest other, %", "|Verdict", "|Beyond the gate")
    out: list[Block] = [ReportTable(heads, [_check(c, e.measures) for c in checks], caption)]
    side = plots.MatrixSide(plots.labels(table.all_test_hz), f"{table.names[0]} mode, Hz")
    auto = plots.matrix(e.auto_mac, side, side, height=440, diagonal=False)
    left: list[Block] = [Plot(auto, f"Auto-MAC of the {table.names[0]} shapes; numbers from 10 %.")]
    shown = e.measures.cross or checks[0]
    what = f"{shown.name[:1].upper()}{shown.name[1:]}; outlined: beyond the gate."
    return [*out, Columns([left, [Plot(plots.orthogonality(shown, table, 440), what)]])]


def _check(c: OrthogonalityCheck, measures: CompleteCorrelation) -> list[str | Cell]:
    v = c.verdict
    least = fixed(100 * v.least_diagonal, 1) if c.kind != "self" else "–"
    most = fixed(100 * v.largest_off_diagonal, 1)
    # the worst first; those of a symmetric matrix once
    once = [f for f in v.failures if c.kind == "cross" or f.a < f.b]
    left, right = {"model": ("FE ", "FE "), "self": ("", ""), "cross": ("", "FE ")}[c.kind]
    named = ", ".join(
        f"{left}{f.a + 1} – {right}{f.b + 1}: {100 * f.value:.0f} %" for f in once[:MOST]
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
    every = Fold(f"All {len(rows)} channels", [ReportTable(heads, rows, text, scroll=True)])
    return [Plot(plots.channels(c), caption), every]


def close(c: CompleteCorrelation, table: CorrelationTable) -> list[Block]:
    """Groups of close modes compared as spaces."""
    if not c.subspaces:
        return []
    a, b = table.names
    heads = (f"|{a} modes", f"|f {a}, Hz", f"|{b} modes", f"|f {b}, Hz", "|Principal angles, °")
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
