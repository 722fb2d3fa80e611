"""CWELD: its patches by corners, by shells or by properties, or two nodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ringtrue.decks.nastran.fields import Card, Files, Reader, places
from ringtrue.decks.nastran.writer import Value, format_card
from ringtrue.errors import UnsupportedCard
from ringtrue.model.cards import columns
from ringtrue.model.model import Table

_CORNERS = ("GA1", "GA2", "GA3", "GA4", "GB1", "GB2", "GB3", "GB4")
_AT = {"EID": 0, "GS": 2, "GA": 4, "GB": 5}
_MORE = {
    "GRIDID": {name: 8 + i + 4 * (i // 4) for i, name in enumerate(_CORNERS)},
    "ELEMID": {"SHIDA": 8, "SHIDB": 9},
    "ALIGN": {},
    "PARTPAT": {"PIDA": 8, "PIDB": 9},
    "ELPAT": {"SHIDA": 8, "SHIDB": 9},
}
_PLACE = {"XS": 16, "YS": 17, "ZS": 18}  # of PARTPAT and ELPAT
_MIDSIDES = (*range(12, 16), *range(20, 24))


def cweld(cards: Sequence[Card], files: Files) -> Table:
    """CWELD by GRIDID, ELEMID, ALIGN, PARTPAT or ELPAT.

    Raises
    ------
    UnsupportedCard
        On other types, and on patches with midside nodes.
    """
    specs = columns("CWELD")
    rows: list[dict[str, int | float | str]] = []
    for c in cards:
        r = Reader(c, files)
        kind = r.text(3).upper()
        if kind not in _MORE or (kind == "GRIDID" and any(r.text(i).strip("0") for i in _MIDSIDES)):
            why = f"type {kind or 'blank'}" if kind not in _MORE else "patches with midside nodes"
            why += f"; allowed are {', '.join(_MORE)} on corners"
            raise UnsupportedCard("CWELD", path=files[c.file], line=c.line, why=why)
        row: dict[str, int | float | str] = {s.name: s.default for s in specs} | {
            "TYPE": kind,
            "SPTYP": r.text(6),
        }
        row |= {name: r.whole(i, name, 0) for name, i in (_AT | _MORE[kind]).items()}
        row["PID"] = r.whole(1, "PID", int(row["EID"]))
        if kind in ("PARTPAT", "ELPAT"):
            row |= {name: r.real(i, name, float("nan")) for name, i in _PLACE.items()}
        rows.append(row)
    return Table(
        "CWELD", {s.name: np.array([row[s.name] for row in rows]) for s in specs}, *places(cards)
    )


def write_cweld(t: Table) -> Iterator[str]:
    """The cards of a table."""
    for i, kind in enumerate(t["TYPE"].tolist()):
        fields: list[Value] = [None] * 24
        fields[1], fields[3], fields[6] = int(t["PID"][i]), kind, str(t["SPTYP"][i]) or None
        for name, k in (_AT | _MORE[kind]).items():
            fields[k] = int(t[name][i]) or None
        for name, k in _PLACE.items():
            if not np.isnan(t[name][i]):
                fields[k] = float(t[name][i])
        yield format_card("CWELD", fields)
