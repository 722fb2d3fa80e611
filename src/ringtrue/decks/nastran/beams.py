"""Beam properties: PBEAM with its stations, PBCOMP from its areas, PBARL and PBEAML from their
sections; and welds.

A row of the PBEAM table holds both ends; its ragged columns hold the stations between them in the
order of the card, `X` their place over the length, `AX` .. `NSMX` the values there, nan for a
blank: on the straight line between the ends (MSC Nastran Quick Reference Guide, PBEAM, remark 5).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.decks.nastran.lexer import Card, Files, Reader, Row, table_of_rows
from ringtrue.model.cards import END_A, END_B, properties
from ringtrue.model.edit import ply_field
from ringtrue.model.model import Table
from ringtrue.model.sections import FALLBACK, SECTIONS

BETWEEN = ("AX", "I1X", "I2X", "I12X", "JX", "NSMX")
# behind the stations; CWA and CWB count with SA and SB of a CBEAM only
BEAM_TAIL = (
    *("K1", "K2", "S1", "S2", "NSIA", "NSIB", "CWA", "CWB"),
    *("M1A", "M2A", "M1B", "M2B", "N1A", "N2A", "N1B", "N2B"),
)
_STATION = ("YES", "YESA", "NO")


def pbeam(r: Reader) -> Iterator[Row]:
    """PBEAM: a blank end B is that of end A."""
    yield _named(r, _beam_row(r))


def pbcomp(r: Reader) -> Iterator[Row]:
    """PBCOMP as a row of PBEAM; lumped areas of other materials than the card's own are refused."""
    yield _named(r, _lumped(r))


def section_properties(r: Reader) -> Iterator[Row]:
    """PBARL as a row of PBAR, PBEAML as one of PBEAM."""
    yield _named(r, _made(r))


def _named(r: Reader, row: Row) -> Row:
    return {"PID": r.whole(0, "PID"), "MID": r.whole(1, "MID"), **row}


def beam_stations(r: Reader) -> tuple[list[tuple[float, int]], int]:
    """Stations behind end A of a PBEAM: x / length with the place of A, and the field behind the
    stations.

    Raises
    ------
    DeckError
        If a station is not between 0 and 1.
    """
    at = 8 if r.text(8).upper() in _STATION else 16  # the stress points may be left out
    found = []
    while (flag := r.text(at).upper()) in _STATION:
        found.append((_place(r, at + 1), at + 2))
        # YESA and NO: no stress points
        at += 16 if flag == "YES" and r.text(at + 8).upper() not in _STATION else 8
    return found, at


def beam_tail_place(field: str) -> int:
    """Number of a field behind the stations of a PBEAM, from the first of them on."""
    return BEAM_TAIL.index(field)


def _place(r: Reader, at: int) -> float:
    x = r.real(at, "X/XB", 1.0)
    if not 0 < x <= 1:
        raise r.fail(
            "X/XB",
            f"a station at {x:g} of the length; allowed are places behind 0 up to 1, end B",
        )
    return x


def _beam_row(r: Reader) -> Row:
    row = {n: r.real(2 + k, n, 0.0) for k, n in enumerate(END_A)}
    row |= dict(zip(END_B, row.values(), strict=True))
    stations, at = beam_stations(r)
    for x, place in stations:
        if x == 1.0:
            row |= {
                b: r.real(place + k, b, row[a])
                for k, (a, b) in enumerate(zip(END_A, END_B, strict=True))
            }
    for name in BEAM_TAIL:
        place = at + beam_tail_place(name)
        blank = 1.0 if name in ("K1", "K2") else 0.0
        if name.endswith("B"):
            blank = row[f"{name[:-1]}A"]
        row[name] = r.real(place, name, blank)
    between = [(x, place) for x, place in stations if x < 1.0]
    inner = {
        n: [r.real(p + k, n, np.nan) for _, p in between] for k, n in enumerate(BETWEEN)
    }
    return row | {"X": [x for x, _ in between]} | inner


def _lumped(r: Reader) -> Row:
    """The PBEAM of a PBCOMP; lumped areas give A, I1, I2, I12 and the neutral axis (QRG, PBCOMP,
    remark 7).
    """
    row = {n: r.real(2 + k, n, 0.0) for k, n in enumerate(END_A)}
    row |= {n: r.real(8 + k, n, 1.0) for k, n in enumerate(("K1", "K2"))}
    at = {n: r.real(10 + k, n, 0.0) for k, n in enumerate(("M1", "M2", "N1", "N2"))}
    y, z, share = _areas(r)
    if total := share.sum():
        at["N1"], at["N2"] = share @ y / total, share @ z / total
        y = y - at["N1"]
        z = z - at["N2"]
        row |= {
            n: row["A"] * float(share @ v)
            for n, v in (("I1", y * y), ("I2", z * z), ("I12", y * z))
        }
        row["A"] *= float(total)
    row |= {b: row[a] for a, b in zip(END_A, END_B, strict=True)}
    row |= {"CWA": 0.0, "CWB": 0.0}
    return {**row, **{f"{n}{end}": float(v) for n, v in at.items() for end in "AB"}}


def _areas(r: Reader) -> NDArray[np.float64]:
    """y, z and share of the area of each lumped area of a PBCOMP, (3, n)."""
    at = range(16, len(r.card.fields), 8)
    given = np.array(
        [[r.real(i + k, n, 0.0) for i in at] for k, n in enumerate(("Yi", "Zi", "Ci"))]
    )
    symmetry = r.whole(14, "SYMOPT", 0)
    other = any(
        r.text(i + 3) and r.whole(i + 3, "MIDi") != r.whole(1, "MID") for i in at
    )
    why = (
        "lumped areas of several materials; give PBEAM with A, I1, I2, I12 weighted by the moduli"
        if other
        else ""
    )
    if given.any() and symmetry not in (0, 1, 5):
        why = f"SYMOPT {symmetry}; give all areas (SYMOPT 0), or those of a quarter (1)"
    if why:
        raise r.unsupported(why)
    if symmetry == 1:
        given = np.hstack(
            [
                given * np.array([[a], [b], [1.0]])
                for a in (1.0, -1.0)
                for b in (1.0, -1.0)
            ]
        )
    return given


def _dimensions(r: Reader, at: int) -> tuple[list[float], float, int]:
    """Dimensions from field `at` on, nan for a blank that is that of another, NSM, and the field
    behind.
    """
    kind = r.text(3).upper()
    if kind not in SECTIONS:
        raise r.unsupported(
            f"section {kind!r}; supported are {', '.join(sorted(SECTIONS))}"
        )
    count = SECTIONS[kind][0]
    may = FALLBACK.get(kind, {})
    dims = [
        r.real(at + k, f"DIM{k + 1}", np.nan if k in may else None)
        for k in range(count)
    ]
    return dims, r.real(at + count, "NSM", 0.0), at + count + 1


def _stations(r: Reader, at: int) -> list[tuple[float, list[float], float, int]]:
    """Places over the length of the sections behind end A, their dimensions and NSM, and where the
    first stands.
    """
    found = []
    while r.text(at).upper() in _STATION:
        x = _place(r, at + 1)
        if not r.text(at + 2):  # a blank section is that of end A
            break
        dims, nsm, behind = _dimensions(r, at + 2)
        found.append((x, dims, nsm, at + 2))
        at = behind
    return found


def _made(r: Reader) -> Row:
    """The PBAR or PBEAM of a PBARL or PBEAML."""
    name = r.card.name
    kind = r.text(3).upper()
    dims, nsm, at = _dimensions(r, 8)
    stations = _stations(r, at) if name == "PBEAML" else []
    end_b = next(((d, m) for x, d, m, _ in stations if x == 1.0), None)
    try:
        row = properties(name, kind, (dims, nsm), end_b)
        inner = [
            (x, properties("PBARL", kind, (d, m), None))
            for x, d, m, _ in stations
            if x < 1.0
        ]
    except (ValueError, ArithmeticError) as e:
        raise r.fail("DIM1", str(e)) from None
    between = {
        b: [p.get(a, 0.0) for _, p in inner]
        for a, b in zip(END_A, BETWEEN, strict=True)
    }
    return row | {"X": [x for x, _ in inner]} | between


def dimensions(cards: Sequence[Card], files: Files) -> Table:
    """The dimensions that PBARL or PBEAML give, for the ends of the beam; a row a property."""
    rows = []
    for c in cards:
        r = Reader(c, files)
        dims, nsm, at = _dimensions(r, 8)
        row: dict[str, Any] = {"TYPE": r.text(3).upper(), "NSM": nsm, "DIM": dims}
        for x, dims_b, nsm_b, _ in _stations(r, at):
            if x == 1.0:
                row |= {"NSMB": nsm_b, "DIMB": dims_b}
        rows.append((c, {"PID": r.whole(0, "PID"), **row}))
    return table_of_rows(cards[0].name, rows)


def dimension_place(fields: Sequence[str], field: str) -> int | None:
    """Field of NSM, DIM1 .. or, at end B, of NSMB, DIMB1 .. on a PBARL or PBEAML; None without."""
    r = Reader(Card("PBEAML", list(fields), 0, 0), ("",))
    count, (_, _, behind) = SECTIONS[r.text(3).upper()][0], _dimensions(r, 8)
    end_b = next((at for x, _, _, at in _stations(r, behind) if x == 1.0), None)
    name, number = ply_field(field) or (field, count + 1)
    at = {"DIM": 8, "NSM": 8, "DIMB": end_b, "NSMB": end_b}.get(name)
    return None if at is None else at + number - 1


_BEND = {
    "A": 2,
    "I1": 3,
    "I2": 4,
    "J": 5,
    "RB": 6,
    "THETAB": 7,
    "K1": 16,
    "K2": 17,
    "NSM": 18,
    "RC": 19,
    "ZC": 20,
    "DELTAN": 21,
}
_PIPE = {
    "FSI": 2,
    "RM": 3,
    "T": 4,
    "P": 5,
    "RB": 6,
    "THETAB": 7,
    "NSM": 10,
    "RC": 11,
    "ZC": 12,
}


def bend_places(fields: Sequence[str]) -> Mapping[str, int]:
    """Where the fields of a PBEND stand: a pipe if the first behind MID is an integer."""
    return _PIPE if len(fields) > 2 and fields[2].isdigit() else _BEND


def pbend(r: Reader) -> Iterator[Row]:
    """PBEND of either form; a pipe with flexibility factors other than 1, or as NX has it, is
    refused.
    """
    at = bend_places(r.card.fields)
    pipe = at is _PIPE
    foreign = any(r.text(i) for i in (8, 9, *range(13, len(r.card.fields))))
    if pipe and (foreign or r.whole(2, "FSI") != 1):
        raise r.unsupported(
            "of pipes FSI = 1, NSM, RC and ZC are; give A, I1, I2, J with the flexibility in "
            "I1 and I2"
        )
    row: dict[str, Any] = {
        "PID": r.whole(0, "PID"),
        "MID": r.whole(1, "MID"),
        "FSI": int(pipe),
    }
    for name, i in at.items():
        if name != "FSI":
            row[name] = r.real(i, name, np.nan if name == "DELTAN" else 0.0)
    yield row


_CORNERS = ("GA1", "GA2", "GA3", "GA4", "GB1", "GB2", "GB3", "GB4")
WELD_ENDS = {"EID": 0, "GS": 2, "GA": 4, "GB": 5}
WELD_TYPES = {
    "GRIDID": {name: 8 + i + 4 * (i // 4) for i, name in enumerate(_CORNERS)},
    "ELEMID": {"SHIDA": 8, "SHIDB": 9},
    "ALIGN": {},
    "PARTPAT": {"PIDA": 8, "PIDB": 9},
    "ELPAT": {"SHIDA": 8, "SHIDB": 9},
}
WELD_POINT = {"XS": 16, "YS": 17, "ZS": 18}  # of PARTPAT and ELPAT
_MIDSIDES = (*range(12, 16), *range(20, 24))


def cweld(r: Reader) -> Iterator[Row]:
    """CWELD by GRIDID, ELEMID, ALIGN, PARTPAT or ELPAT.

    Raises
    ------
    UnsupportedCard
        On other types, and on patches with midside nodes.
    """
    kind = r.text(3).upper()
    midsides = kind == "GRIDID" and any(r.text(i).strip("0") for i in _MIDSIDES)
    if kind not in WELD_TYPES or midsides:
        why = "patches with midside nodes" if midsides else f"type {kind or 'blank'}"
        raise r.unsupported(f"{why}; allowed are {', '.join(WELD_TYPES)} on corners")
    row: dict[str, Any] = {"TYPE": kind, "SPTYP": r.text(6)}
    for name, i in (WELD_ENDS | WELD_TYPES[kind]).items():
        row[name] = r.whole(i, name, 0)
    row["PID"] = r.whole(1, "PID", row["EID"])
    if kind in ("PARTPAT", "ELPAT"):
        row |= {name: r.real(i, name, np.nan) for name, i in WELD_POINT.items()}
    yield row
