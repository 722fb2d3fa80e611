"""Cards as text, and whole models as decks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.beams import (
    BEAM_TAIL,
    BETWEEN,
    WELD_ENDS,
    WELD_POINT,
    WELD_TYPES,
    bend_places,
)
from ringtrue.decks.nastran.lexer import real
from ringtrue.decks.nastran.special import BUSH, NSM_LISTS, NSM_PAIRS, PLY
from ringtrue.errors import InputError, UnsupportedError
from ringtrue.model.cards import CARDS, END_A, END_B, MADE, FieldSpec, columns
from ringtrue.model.case_control import METHODS
from ringtrue.model.model import Model, Ragged, Table

Value = int | float | str | None


def format_real(value: float, width: int = 8) -> str:
    """A real in Nastran's shortest forms, at most `width` characters, as near to `value` as they
    allow.

    Exact where the shortest decimal that names the double fits; `-1.234-5`, `12346.+7` and
    `.12346-9` else.

    Raises
    ------
    InputError
        If the value is not finite.
    """
    if not math.isfinite(value):
        raise InputError(f"{value} cannot stand in a bulk data field")
    if value == 0:
        return "0.0"
    exact = repr(float(value))
    if len(exact) <= width and "e" not in exact:
        return exact
    plain = _rounded(value, width)
    if plain:
        return plain
    count = min(len(_digits(exact)[0].lstrip("-")), width)
    rounded = (f"{value:.{k - 1}e}" for k in range(count, 0, -1))
    for digits in (exact, *rounded):
        for text in _forms(*_digits(digits)):
            if len(text) <= width:
                return text
    raise InputError(f"{value} does not fit into a field of {width} characters")


def _rounded(value: float, width: int) -> str:
    """A real of usual size, of which no form holds all digits, as a decimal number; "" if that may
    not be its best form.
    """
    size = abs(value)
    if not 1e-3 <= size < 10.0 ** (width - 3):
        return ""
    room = width - (value < 0)
    whole = len(str(int(size))) if size >= 1 else 0
    text = f"{size:.{room - 1 - whole}f}"
    if whole == 0:
        text = text.removeprefix("0")
    rounded_up = len(text) > room or (whole == 0 and not text.startswith("."))
    if rounded_up:  # to a digit more
        return ""
    text = text.rstrip("0")
    if text.endswith("."):
        return ""
    if whole == 0 and len(text) < room:
        text = "0" + text
    return "-" + text if value < 0 else text


def _digits(text: str) -> tuple[str, int]:
    """Signed significant digits and the exponent of the first: -0.0125 -> ("-125", -2)."""
    mantissa, _, power = text.partition("e")
    sign = "-" if mantissa.startswith("-") else ""
    whole, _, fraction = mantissa.lstrip("-").partition(".")
    digits = (whole + fraction).lstrip("0")
    lead = len(whole) if whole.strip("0") else len(fraction.lstrip("0")) - len(fraction)
    return sign + (digits.rstrip("0") or "0"), int(power or 0) + lead - 1


def _forms(digits: str, exponent: int) -> Iterator[str]:
    """Spellings, the pleasant ones first."""
    sign, d = ("-", digits[1:]) if digits.startswith("-") else ("", digits)
    if 0 <= exponent < 16:
        whole = d[: exponent + 1].ljust(exponent + 1, "0")
        fraction = d[exponent + 1 :]
        yield f"{sign}{whole}.{fraction or '0'}"
        yield f"{sign}{whole}.{fraction}"
    elif -16 < exponent < 0:
        fraction = "0" * (-exponent - 1) + d
        yield f"{sign}0.{fraction}"
        yield f"{sign}.{fraction}"
    for point in (1, *range(2, 8), 0):
        power = exponent + 1 - point
        yield f"{sign}{d[:point].ljust(point, '0')}.{d[point:]}{f'{power:+d}' if power else ''}"


def format_field(value: Value, width: int = 8) -> str:
    """One field, not padded.

    Raises
    ------
    InputError
        If an integer or text does not fit, or a real is not finite.
    """
    if value is None:
        return ""
    text = format_real(value, width) if isinstance(value, float) else str(value)
    if len(text) > width:
        raise InputError(f"{text!r} does not fit into a field of {width} characters")
    return text


def format_card(name: str, fields: Sequence[Value], *, large: bool = False) -> str:
    """A card with its continuation lines, small (8) or large (16) fields.

    Parameters
    ----------
    name : str
    fields : sequence of int, float, str or None
        Field 2 onward, eight to a small line; None is blank.

    Raises
    ------
    InputError
        If a value does not fit into its field.
    """
    values = list(fields)
    while values and values[-1] is None:
        values.pop()
    width, per_line = (16, 4) if large else (8, 8)
    lines = []
    for start in range(0, max(len(values), 1), per_line):
        head = "" if start else name
        if large:
            head += "*"
        fitting = (format_field(v, width) for v in values[start : start + per_line])
        body = "".join(text.rjust(width) for text in fitting)
        lines.append((head.ljust(8) + body).rstrip() or "+")
    return "\n".join(lines) + "\n"


def large_card(card: str, fields: Sequence[Value]) -> str:
    """A card in large fields, whose lines come in pairs."""
    text = format_card(card, fields, large=True)
    return text if text.count("\n") % 2 == 0 else text + "*\n"


Row = Mapping[str, Any]  # of a table: numbers, texts, and lists of ragged columns


def _rows(table: Table) -> Iterator[Row]:
    for i in range(len(table)):
        row = {}
        for name, column in table.columns.items():
            value = column.row(i) if isinstance(column, Ragged) else column[i]
            row[name] = value.tolist()
        yield row


def _terms(row: Row, *names: str) -> list[tuple[Any, ...]]:
    """Entries of ragged columns of equal length, side by side."""
    return list(zip(*(row[name] for name in names), strict=True))


def _real(value: float) -> float | None:
    """None, a blank field, for nan."""
    return None if np.isnan(value) else float(value)


def _filled(fields: list[Value]) -> list[Value]:
    """The fields and blanks up to the end of their line."""
    return [*fields, *[None] * (-len(fields) % 8)]


def _spc(row: Row) -> list[Value]:
    component = row["C"] if row["C"] != "0" else None
    return [row["SID"], row["G"], component, row["D"]]


def _mpc(row: Row) -> list[Value]:
    fields: list[Value] = [row["SID"]]
    for k, (node, component, factor) in enumerate(_terms(row, "G", "C", "A")):
        if k and k % 2 == 0:  # two terms on a pair of lines
            fields += [None, None]
        fields += [node, component or None, factor]
    return fields


def _rbe3(row: Row) -> list[Value]:
    fields: list[Value] = [row["EID"], None, row["REFGRID"], row["REFC"]]
    before: tuple[float, str] | None = None
    for node, component, weight in _terms(row, "G", "C", "WT"):
        if (weight, component) != before:
            fields += [weight, component]
            before = (weight, component)
        fields.append(node)
    if "GM" in row:
        for k, pair in enumerate(_terms(row, "GM", "CM")):
            if k % 3 == 0:  # UM opens a line, three pairs stand on each
                fields = [*_filled(fields), None if k else "UM"]
            fields += pair
    return fields


def _pbush(row: Row) -> list[Value]:
    fields: list[Value] = []
    for flag, names in BUSH.items():
        values = [float(row[name]) for name in names if name in row]
        if np.nan_to_num(values).any():
            if flag != "GE":  # a 0 in GE counts
                values = [v or np.nan for v in values]
            fields = [*_filled(fields), None, flag, *map(_real, values)]
    return [row["PID"], *(fields[1:] or ["K"])]


def _pbeam(row: Row) -> list[Value]:
    ends_a, ends_b, tail = (
        [float(row[n]) for n in names] for names in (END_A, END_B, BEAM_TAIL)
    )
    blank: list[Value] = [None] * 8
    fields: list[Value] = [row["PID"], row["MID"], *ends_a, *blank]
    along = [name for name in ("X", *BETWEEN) if name in row]
    for station in _terms(row, *along):
        fields += ["NO", *map(_real, station)]
    fields += ["YES", 1.0, *ends_b, *blank]
    return [*fields, *map(_real, tail)]


def _pbend(row: Row) -> list[Value]:
    at = bend_places(["", "", "1" if row["FSI"] > 0 else ""])
    fields: list[Value] = [row["PID"], row["MID"], *[None] * max(at.values())]
    for name, k in at.items():
        fields[k] = row["FSI"] if name == "FSI" else _real(row[name])
    return fields


def _nsm_pair(row: Row) -> list[Value]:
    return [row["SID"], row["TYPE"], row["ID"], row["VALUE"]]


def _nsm_list(row: Row) -> list[Value]:
    return [row["SID"], row["TYPE"], row["VALUE"], *(g or "ALL" for g in row["ID"])]


def _rbe1(row: Row) -> list[Value]:
    fields: list[Value] = [row["EID"]]
    for flag, names in ((None, ("GN", "CN")), ("UM", ("GM", "CM"))):
        terms = _terms(row, *names)
        # three on a line, behind the number, UM or a blank
        for k in range(0, len(terms), 3):
            if flag or k:
                fields.append(None if k else flag)
            fields += [v for term in terms[k : k + 3] for v in term]
            fields = _filled(fields)
    return fields


def _rspline(row: Row) -> list[Value]:
    first, *others = _terms(row, "G", "C")
    return [
        row["EID"],
        row["DL"],
        first[0],
        *(v or None for pair in others for v in pair),
    ]


def _genel(row: Row) -> list[Value]:
    ui, ud = ([v for pair in _terms(row, f"U{k}", f"C{k}") for v in pair] for k in "ID")
    fields: list[Value] = [row["EID"], None, *ui]
    blocks = (
        ("UD", [None, *ud] if ud else []),
        (row["FORM"], row["KZ"]),
        ("S", row["S"]),
    )
    for name, values in blocks:
        if values:
            fields = [*_filled(fields), name, *values]
    return fields


def _laminate(row: Row) -> list[Value]:
    fields: list[Value] = [
        row["PID"],
        _real(row["Z0"]),
        float(row["NSM"]),
        float(row["SB"]),
    ]
    fields += [
        row["FT"] or None,
        float(row["TREF"]),
        float(row["GE"]),
        row["LAM"] or None,
    ]
    numbered = "GPLYID" in row  # PCOMPG: a ply takes a line
    for ply in _terms(row, *PLY["PCOMPG" if numbered else "PCOMP"]):
        fields += ply
        if numbered:
            fields = _filled(fields)
    return fields


def _dmig(table: Table) -> Iterator[str]:
    for row in _rows(table):
        name = row["NAME"]
        kinds = [row[k] or None for k in ("IFO", "TIN", "TOUT", "POLAR")]
        yield format_card("DMIG", [name, 0, *kinds, None, row["NCOL"] or None])
        by_column: dict[tuple[int, int], list[Value]] = {}
        for gj, cj, gi, ci, a, b in _terms(row, "GJ", "CJ", "GI", "CI", "A", "B"):
            by_column.setdefault((gj, cj), []).extend(
                (gi, ci, float(a), float(b) or None)
            )
        for column, terms in sorted(by_column.items()):
            yield large_card("DMIG", [name, *column, None, *terms])


def _cweld(row: Row) -> list[Value]:
    fields: list[Value] = [None] * 24
    fields[1] = row["PID"]
    fields[3] = row["TYPE"]
    fields[6] = row["SPTYP"] or None
    for name, k in (WELD_ENDS | WELD_TYPES[row["TYPE"]]).items():
        fields[k] = row[name] or None
    for name, k in WELD_POINT.items():
        if not np.isnan(row[name]):  # else the place is that of a corner
            fields[k] = row[name]
    return fields


_SMALL: dict[str, Callable[[Row], list[Value]]] = {  # in small fields
    "SPC": _spc,
    "RBE3": _rbe3,
    "RBE1": _rbe1,
    "RSPLINE": _rspline,
    "CWELD": _cweld,
}
_LARGE: dict[str, Callable[[Row], list[Value]]] = {
    "MPC": _mpc,
    "PBUSH": _pbush,
    "PBEAM": _pbeam,
    "PBEND": _pbend,
    **dict.fromkeys(NSM_PAIRS, _nsm_pair),
    **dict.fromkeys(NSM_LISTS, _nsm_list),
    "GENEL": _genel,
    **dict.fromkeys(PLY, _laminate),
}
NOT_MODEL = frozenset(METHODS)  # the caller's choice, not the model's
Text = NDArray[np.str_]


def write_bulk(model: Model, *, without: Collection[str] = NOT_MODEL) -> str:
    """The model as bulk data cards: small fields where they hold the values exactly, large ones
    elsewhere.

    Parameters
    ----------
    model : Model
    without : collection of str
        Cards and PARAMs that are left out.

    Returns
    -------
    str
        Cards only: no BEGIN BULK, no ENDDATA, no case control. Reals keep at least nine digits.

    Raises
    ------
    UnsupportedError
        If the model holds a card that this writer does not know.
    """
    made = [
        format_card("PARAM", (name, value))
        for name, value in model.params.items()
        if name not in without
    ]
    for card, t in model.tables.items():
        if card not in without:
            made += _cards(t)
    return "".join(made)


def _cards(table: Table) -> Iterator[str]:
    # the PBAR or PBEAM is written in its place
    if not len(table) or table.card in MADE:
        return
    if table.card in _SMALL:
        yield from (
            format_card(table.card, _SMALL[table.card](row)) for row in _rows(table)
        )
    elif table.card in _LARGE:
        yield from (
            large_card(table.card, _LARGE[table.card](row)) for row in _rows(table)
        )
    elif table.card == "DMIG":
        yield from _dmig(table)
    elif table.card in CARDS:
        yield from _uniform(table)
    else:
        raise UnsupportedError(
            f"{table.card} cards cannot be written for another solver"
        )


def _uniform(table: Table) -> Iterator[str]:
    """Cards of `model.cards`, all rows at once."""
    specs = columns(table.card)
    if any(s.tail for s in specs):
        yield "".join(_lists(table, specs))
        return
    if not _surely_large(table, specs):
        small = _fields(table, specs, 8)
        if _exact(table, specs, small):
            yield _lines(table.card, small, 8)
            return
    yield _lines(table.card, _fields(table, specs, 16), 16)


def _surely_large(table: Table, specs: Sequence[FieldSpec]) -> bool:
    """Whether a real of the first rows loses digits in eight characters: then all are not tried."""
    if any(s.other for s in specs):
        return False
    names = [s.name for s in specs if s.kind == "f" and not s.blank]
    first = np.unique([table[name][:100] for name in names])
    return any(real(format_real(v)) != v for v in first[~np.isnan(first)].tolist())


def _fields(table: Table, specs: Sequence[FieldSpec], width: int) -> Text:
    """All data fields as text, (row, field) str."""
    made = [_column(table, s, width) for s in specs]
    return np.stack(_either(table, specs, made), axis=1)


def _column(table: Table, spec: FieldSpec, width: int) -> Text:
    if spec.blank:
        return np.full(len(table), "", dtype=f"U{width}")
    values = table[spec.name]
    if spec.kind == "f":
        return _reals(values, width)
    text = values.astype(f"U{width}")
    return (
        np.where(values == spec.default, "", text) if spec.default in (0, -1) else text
    )


def _reals(values: Float, width: int) -> Text:
    """Reals as text, defaults too: MYSTRAN has 0 for a blank S of a CBUSH. Each different value is
    formatted once.
    """
    unique, at = np.unique(values, return_inverse=True)
    text = ["" if np.isnan(v) else format_real(v, width) for v in unique.tolist()]
    return np.array(text, dtype=f"U{width}")[at.reshape(-1)]


def _either(table: Table, specs: Sequence[FieldSpec], made: list[Text]) -> list[Text]:
    """Fields that hold a number of a node or frame, or a real: `G0|X1`, `MCID|THETA`."""
    for j, spec in enumerate(specs):
        if not spec.other:
            continue
        chosen = table[spec.other]
        vector = spec.other == "G0"  # the rest of the vector follows
        none = np.zeros(len(table), dtype=bool)
        if vector:
            none = ~np.any([table[f"X{k}"] for k in (1, 2, 3)], axis=0)
            for k in (1, 2):
                made[j + k] = np.where((chosen > 0) | none, "", made[j + k])
        real = np.where(none, "", made[j])
        made[j] = np.where(chosen > spec.other_default, chosen.astype(real.dtype), real)
    return made


def _exact(table: Table, specs: Sequence[FieldSpec], small: Text) -> bool:
    """Whether all numbers keep their value in eight characters."""
    for j, spec in enumerate(specs):
        if spec.blank:
            continue
        if spec.kind == "i" and table[spec.name].max(initial=0) >= 10**8:
            return False
        if spec.kind == "f":
            text, first = np.unique(small[:, j], return_index=True)
            given = text != ""
            back = np.array([real(t) for t in text[given].tolist()])
            if (back != table[spec.name][first[given]]).any():
                return False
            if np.unique(table[spec.name]).size > text.size:
                return False
    return True


def _lines(card: str, cells: Text, width: int) -> str:
    """Cards of (row, field) text in fixed columns; blank lines at the end of a card are left
    out.
    """
    per_line = 64 // width
    n = -(-cells.shape[1] // per_line)
    padded = np.full((len(cells), n * per_line), "", dtype=f"U{width}")
    padded[:, : cells.shape[1]] = cells
    used = np.where(padded != "", np.arange(padded.shape[1]) // per_line + 1, 1).max(
        axis=1
    )
    if width == 16:
        used += used % 2  # large-field lines come in pairs
    bodies = np.strings.rjust(padded, width).view("U64")  # (row, line)
    star = "" if width == 8 else "*"
    out = np.empty(len(cells), dtype=object)
    for k in np.unique(used).tolist():
        rows = np.flatnonzero(used == k)
        lines = [[star] * len(rows)] * k
        for line in range(min(k, n)):
            head = star if line else card + star
            whole = np.strings.add(head.ljust(8), bodies[rows, line])
            lines[line] = np.strings.rstrip(whole).tolist()
        out[rows] = list(map("\n".join, zip(*lines, strict=True)))
    return "\n".join(out.tolist()) + "\n"


def _lists(table: Table, specs: Sequence[FieldSpec]) -> Iterator[str]:
    """Cards that end in a list of integers, such as SPC1 and RBE2."""
    heads = [_column(table, s, 8).tolist() for s in specs[:-1]]
    tail = table.ragged(specs[-1].name)
    if len(specs) == 1:  # SPOINT: points in lines of eight
        for a in range(0, tail.values.size, 8):
            yield format_card(table.card, tail.values[a : a + 8].tolist())
        return
    for i, head in enumerate(zip(*heads, strict=True)):
        if tail.row(i).size:
            yield format_card(
                table.card, [t or None for t in head] + tail.row(i).tolist()
            )
