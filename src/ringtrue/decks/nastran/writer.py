"""Cards as text, and whole models as decks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.beams import WELD_ENDS, WELD_POINT, WELD_TYPES, bend_places
from ringtrue.decks.nastran.lists import BUSH
from ringtrue.errors import InputError, UnsupportedError
from ringtrue.model.cards import CARDS, END_A, END_B, MADE, FieldSpec, columns
from ringtrue.model.case_control import METHODS
from ringtrue.model.model import Model, Table

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
    count = min(len(_digits(exact)[0].lstrip("-")), width)
    rounded = (f"{value:.{k - 1}e}" for k in range(count, 0, -1))
    for digits in (exact, *rounded):
        for text in _forms(*_digits(digits)):
            if len(text) <= width:
                return text
    raise InputError(f"{value} does not fit into a field of {width} characters")


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


def _rows(t: Table, *names: str) -> Iterator[tuple[Any, ...]]:
    """Values of plain columns, row by row."""
    return zip(*(t[name].tolist() for name in names), strict=True)


def _entries(t: Table, row: int, *names: str) -> list[tuple[Any, ...]]:
    """Values of ragged columns of equal length, entry by entry of one row."""
    return list(zip(*(t.ragged(name).row(row).tolist() for name in names), strict=True))


def _real(value: float) -> float | None:
    """None, a blank field, for nan."""
    return None if np.isnan(value) else float(value)


def _spc(t: Table) -> Iterator[str]:
    for sid, g, c, d in _rows(t, "SID", "G", "C", "D"):
        yield format_card("SPC", (sid, g, c if c != "0" else None, d))


def _mpc(t: Table) -> Iterator[str]:
    for i, sid in enumerate(t["SID"].tolist()):
        fields: list[Value] = [sid]
        for k, (node, component, factor) in enumerate(_entries(t, i, "G", "C", "A")):
            if k and k % 2 == 0:  # two terms on a pair of lines
                fields += [None, None]
            fields += [node, component or None, factor]
        yield large_card("MPC", fields)


def _rbe3(t: Table) -> Iterator[str]:
    dependent = [name for name in ("GM", "CM") if name in t.columns]
    for i, (eid, ref, refc) in enumerate(_rows(t, "EID", "REFGRID", "REFC")):
        fields: list[Value] = [eid, None, ref, refc]
        before: tuple[float, str] | None = None
        for node, comp, weight in _entries(t, i, "G", "C", "WT"):
            if (weight, comp) != before:
                fields += [weight, comp]
                before = (weight, comp)
            fields.append(node)
        for k, pair in enumerate(_entries(t, i, *dependent)):
            if k % 3 == 0:  # UM opens a line, three pairs stand on each
                fields += [*[None] * (-len(fields) % 8), None if k else "UM"]
            fields += pair
        yield format_card("RBE3", fields)


def _pbush(t: Table) -> Iterator[str]:
    for i, pid in enumerate(t["PID"].tolist()):
        lines: list[list[Value]] = []
        for flag, names in BUSH.items():
            values = [float(t[n][i]) for n in names if n in t.columns]
            if np.nan_to_num(values).any():
                if flag != "GE":  # a 0 in GE counts
                    values = [v or np.nan for v in values]
                lines.append([flag, *map(_real, values), *[None] * (6 - len(values))])
        first, *others = lines or [["K"]]
        fields: list[Value] = [pid, *first]
        for line in others:
            fields += [None, *line]
        yield large_card("PBUSH", fields)


_BEAM_X = ("X", "AX", "I1X", "I2X", "I12X", "JX", "NSMX")
_BEAM_TAIL = ("K1", "K2", "S1", "S2", "NSIA", "NSIB")
_BEAM_AXIS = ("M1A", "M2A", "M1B", "M2B", "N1A", "N2A", "N1B", "N2B")


def _pbeam(t: Table) -> Iterator[str]:
    ends_a, ends_b, tail, axis = (
        t.stack(*names).astype(float).tolist() for names in (END_A, END_B, _BEAM_TAIL, _BEAM_AXIS)
    )
    along = [name for name in _BEAM_X if name in t.columns]
    blank: list[Value] = [None] * 8
    for i, head in enumerate(_rows(t, "PID", "MID")):
        fields: list[Value] = [*head, *ends_a[i], *blank]
        for station in _entries(t, i, *along):
            fields += ["NO", *map(_real, station)]
        fields += ["YES", 1.0, *ends_b[i], *blank]
        fields += [*tail[i], None, None, *axis[i]]
        yield large_card("PBEAM", fields)


def _pbend(t: Table) -> Iterator[str]:
    for i, pipe in enumerate((t["FSI"] > 0).tolist()):
        at = bend_places(["", "", "1" if pipe else ""])
        fields: list[Value] = [int(t["PID"][i]), int(t["MID"][i]), *[None] * max(at.values())]
        for name, k in at.items():
            fields[k] = int(t[name][i]) if name == "FSI" else _real(t[name][i])
        yield large_card("PBEND", fields)


def _nsm_pairs(t: Table) -> Iterator[str]:
    for row in _rows(t, "SID", "TYPE", "ID", "VALUE"):
        yield large_card(t.card, row)


def _nsm_lists(t: Table) -> Iterator[str]:
    for i, head in enumerate(_rows(t, "SID", "TYPE", "VALUE")):
        ids = t.ragged("ID").row(i).tolist()
        yield large_card(t.card, [*head, *(g or "ALL" for g in ids)])


def _rbe1(t: Table) -> Iterator[str]:
    for i, eid in enumerate(t["EID"].tolist()):
        fields: list[Value] = [eid]
        for flag, names in ((None, ("GN", "CN")), ("UM", ("GM", "CM"))):
            terms = _entries(t, i, *names)
            for k in range(0, len(terms), 3):  # three on a line, behind the number, UM or a blank
                if flag or k:
                    fields.append(None if k else flag)
                fields += [v for term in terms[k : k + 3] for v in term]
                fields += [None] * (-len(fields) % 8)
        yield format_card("RBE1", fields)


def _rspline(t: Table) -> Iterator[str]:
    for i, (eid, ratio) in enumerate(_rows(t, "EID", "DL")):
        first, *others = _entries(t, i, "G", "C")
        rest = (v or None for pair in others for v in pair)
        yield format_card("RSPLINE", [eid, ratio, first[0], *rest])


def _genel(t: Table) -> Iterator[str]:
    for i, (eid, form) in enumerate(_rows(t, "EID", "FORM")):
        ui, ud = ([v for pair in _entries(t, i, f"U{k}", f"C{k}") for v in pair] for k in "ID")
        kz, s = (t.ragged(name).row(i).tolist() for name in ("KZ", "S"))
        fields: list[Value] = [eid, None, *ui]
        for name, values in (("UD", [None, *ud] if ud else []), (form, kz), ("S", s)):
            if values:
                fields += [*[None] * (-len(fields) % 8), name, *values]
        yield large_card("GENEL", fields)


def _laminate(t: Table) -> Iterator[str]:
    names = (("GPLYID",) if t.card == "PCOMPG" else ()) + ("MID", "T", "THETA", "SOUT")
    head = ("PID", "Z0", "NSM", "SB", "FT", "TREF", "GE", "LAM")
    for i, (pid, z0, nsm, sb, ft, tref, ge, lam) in enumerate(_rows(t, *head)):
        fields: list[Value] = [pid, _real(z0), float(nsm), float(sb), ft or None]
        fields += [float(tref), float(ge), lam or None]
        for ply in _entries(t, i, *names):
            fields += [*ply, *([None] * 3 if t.card == "PCOMPG" else [])]
        yield large_card(t.card, fields)


def _dmig(t: Table) -> Iterator[str]:
    head = ("NAME", "IFO", "TIN", "TOUT", "POLAR", "NCOL")
    term = ("GJ", "CJ", "GI", "CI", "A", "B")
    for i, (name, *kinds, count) in enumerate(_rows(t, *head)):
        yield format_card("DMIG", (name, 0, *(k or None for k in kinds), None, count or None))
        by_column: dict[tuple[int, int], list[Value]] = {}
        for gj, cj, gi, ci, a, b in _entries(t, i, *term):
            by_column.setdefault((gj, cj), []).extend((gi, ci, float(a), float(b) or None))
        for column, terms in sorted(by_column.items()):
            yield large_card("DMIG", (name, *column, None, *terms))


def _cweld(t: Table) -> Iterator[str]:
    """The cards of a table."""
    for i, kind in enumerate(t["TYPE"].tolist()):
        fields: list[Value] = [None] * 24
        fields[1], fields[3], fields[6] = int(t["PID"][i]), kind, str(t["SPTYP"][i]) or None
        for name, k in (WELD_ENDS | WELD_TYPES[kind]).items():
            fields[k] = int(t[name][i]) or None
        for name, k in WELD_POINT.items():
            if not np.isnan(t[name][i]):  # else the place is that of a corner
                fields[k] = float(t[name][i])
        yield format_card("CWELD", fields)


SPECIAL: dict[str, Callable[[Table], Iterator[str]]] = {
    "SPC": _spc,
    "MPC": _mpc,
    "RBE3": _rbe3,
    "PBUSH": _pbush,
    "PBEAM": _pbeam,
    "PBEND": _pbend,
    "NSM": _nsm_pairs,
    "NSML": _nsm_pairs,
    "NSM1": _nsm_lists,
    "NSML1": _nsm_lists,
    "RBE1": _rbe1,
    "RSPLINE": _rspline,
    "GENEL": _genel,
    "CWELD": _cweld,
    "PCOMP": _laminate,
    "PCOMPG": _laminate,
    "DMIG": _dmig,
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
    if not len(table) or table.card in MADE:  # the PBAR or PBEAM is written in its place
        return
    if table.card in SPECIAL:
        yield "".join(SPECIAL[table.card](table))
    elif table.card in CARDS:
        yield from _uniform(table)
    else:
        raise UnsupportedError(f"{table.card} cards cannot be written for another solver")


def _uniform(table: Table) -> Iterator[str]:
    """Cards of `model.cards`, all rows at once."""
    specs = columns(table.card)
    if any(s.tail for s in specs):
        yield "".join(_lists(table, specs))
        return
    small = _fields(table, specs, 8)
    if _exact(table, specs, small):
        yield _lines(table.card, small, 8)
    else:
        yield _lines(table.card, _fields(table, specs, 16), 16)


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
    return np.where(values == spec.default, "", text) if spec.default in (0, -1) else text


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
            back = np.array([_value(t) for t in text[given].tolist()])
            if (back != table[spec.name][first[given]]).any():
                return False
            if np.unique(table[spec.name]).size > text.size:
                return False
    return True


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # 1.2-8
        sign = text[0] if text[0] in "+-" else ""
        body = text.lstrip("+-")
        cut = max(body.rfind("+"), body.rfind("-"))
        return float(f"{sign}{body[:cut]}e{body[cut:]}") if cut > 0 else float("inf")


def _lines(card: str, cells: Text, width: int) -> str:
    """Cards of (row, field) text in fixed columns; blank lines at the end of a card are left
    out.
    """
    per_line = 64 // width
    n = -(-cells.shape[1] // per_line)
    padded = np.full((len(cells), n * per_line), "", dtype=cells.dtype)
    padded[:, : cells.shape[1]] = cells
    used = np.where(padded != "", np.arange(padded.shape[1]) // per_line + 1, 1).max(axis=1)
    if width == 16:
        used += used % 2  # large-field lines come in pairs
    star = "" if width == 8 else "*"
    head = [(card + star).ljust(8), *[star.ljust(8)] * n]
    out = np.empty(len(cells), dtype=object)
    for k in np.unique(used).tolist():
        rows = np.flatnonzero(used == k)
        block = np.strings.rjust(padded[rows, : min(k, n) * per_line], width)
        made = []
        for row in block.tolist():
            starts = range(0, k * per_line, per_line)
            bodies = ("".join(row[start : start + per_line]) for start in starts)
            made.append("\n".join((h + b).rstrip() for h, b in zip(head, bodies, strict=False)))
        out[rows] = made
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
            yield format_card(table.card, [t or None for t in head] + tail.row(i).tolist())
