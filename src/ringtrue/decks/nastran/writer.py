"""Cards as text, and whole models as decks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.beams import WELD_ENDS, WELD_POINT, WELD_TYPES, bend_places
from ringtrue.decks.nastran.lists import BUSH
from ringtrue.errors import InputError, UnsupportedError
from ringtrue.model.cards import CARDS, FieldSpec, columns
from ringtrue.model.case_control import METHODS
from ringtrue.model.dimensions import MADE
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
    digits, exponent = _digits(repr(float(value)))
    for text in _forms(digits, exponent):
        if len(text) <= width:
            return text
    for count in range(min(len(digits.lstrip("-")), width), 0, -1):
        digits, exponent = _digits(f"{value:.{count - 1}e}")
        for text in _forms(digits, exponent):
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
        whole, fraction = d[: exponent + 1].ljust(exponent + 1, "0"), d[exponent + 1 :]
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
        head = (f"{name}*" if large else name) if start == 0 else ("*" if large else "")
        body = "".join(
            format_field(v, width).rjust(width) for v in values[start : start + per_line]
        )
        lines.append((head.ljust(8) + body).rstrip() or "+")
    return "\n".join(lines) + "\n"


def large_card(card: str, fields: Sequence[Value]) -> str:
    """A card in large fields, whose lines come in pairs."""
    text = format_card(card, fields, large=True)
    return text if text.count("\n") % 2 == 0 else text + "*\n"


def _spc(t: Table) -> Iterator[str]:
    for sid, g, c, d in zip(*(t[k].tolist() for k in ("SID", "G", "C", "D")), strict=True):
        yield format_card("SPC", (sid, g, c if c != "0" else None, d))


def _mpc(t: Table) -> Iterator[str]:
    g, c, a = (t.ragged(k) for k in "GCA")
    for i, sid in enumerate(t["SID"].tolist()):
        terms = list(zip(g.row(i).tolist(), c.row(i).tolist(), a.row(i).tolist(), strict=True))
        fields: list[Value] = [sid]
        for k, term in enumerate(terms):
            fields += [*(term[0], term[1] or None, term[2])]
            if k % 2 and k + 1 < len(terms):
                fields += [None, None]
        yield large_card("MPC", fields)


def _rbe3(t: Table) -> Iterator[str]:
    g, c, w = (t.ragged(k) for k in ("G", "C", "WT"))
    for i, (eid, ref, refc) in enumerate(
        zip(*(t[k].tolist() for k in ("EID", "REFGRID", "REFC")), strict=True)
    ):
        fields: list[Value] = [eid, None, ref, refc]
        before: tuple[float, str] | None = None
        for node, comp, weight in zip(
            g.row(i).tolist(), c.row(i).tolist(), w.row(i).tolist(), strict=True
        ):
            if (weight, comp) != before:
                fields += [weight, comp]
                before = (weight, comp)
            fields.append(node)
        dependent = [
            v for k in ("GM", "CM") if k in t.columns for v in [t.ragged(k).row(i).tolist()]
        ]
        for k, pair in enumerate(zip(*dependent, strict=True)):
            if k % 3 == 0:  # UM opens a line, three pairs stand on each
                fields += [None] * (-len(fields) % 8) + (["UM"] if not k else [None])
            fields += pair
        yield format_card("RBE3", fields)


def _pbush(t: Table) -> Iterator[str]:
    for i, pid in enumerate(t["PID"].tolist()):
        lines: list[list[Value]] = []
        for flag, names in BUSH.items():
            values = [float(t[n][i]) for n in names if n in t.columns]
            if np.nan_to_num(values).any():
                written = (
                    None if np.isnan(v) or (v == 0 and flag != "GE") else v for v in values
                )  # a 0 in GE counts
                lines.append([flag, *written, *[None] * (6 - len(values))])
        fields: list[Value] = [pid]
        for k, line in enumerate(lines or _NO_STIFFNESS):
            fields += [*([None] if k else []), *line]
        yield large_card("PBUSH", fields)


_NO_STIFFNESS: list[list[Value]] = [["K"]]
_BEAM_A, _BEAM_B = ("A", "I1", "I2", "I12", "J", "NSM"), ("AB", "I1B", "I2B", "I12B", "JB", "NSMB")
_BEAM_X = ("X", "AX", "I1X", "I2X", "I12X", "JX", "NSMX")
_BEAM_TAIL = ("K1", "K2", "S1", "S2", "NSIA", "NSIB")
_BEAM_AXIS = ("M1A", "M2A", "M1B", "M2B", "N1A", "N2A", "N1B", "N2B")


def _pbeam(t: Table) -> Iterator[str]:
    for i in range(len(t)):

        def values(names: Sequence[str], i: int = i) -> list[Value]:
            return [float(t[n][i]) for n in names]

        blank: list[Value] = [None] * 8
        fields = [int(t["PID"][i]), int(t["MID"][i]), *values(_BEAM_A), *blank]
        for station in zip(
            *(t.ragged(n).row(i).tolist() for n in _BEAM_X if n in t.columns), strict=True
        ):
            fields += ["NO", *(None if np.isnan(v) else v for v in station)]
        fields += ["YES", 1.0, *values(_BEAM_B), *blank]
        fields += [*values(_BEAM_TAIL), None, None, *values(_BEAM_AXIS)]
        yield large_card("PBEAM", fields)


def _pbend(t: Table) -> Iterator[str]:
    for i, pipe in enumerate((t["FSI"] > 0).tolist()):
        at = bend_places(["", "", "1" if pipe else ""])
        fields: list[Value] = [int(t["PID"][i]), int(t["MID"][i]), *[None] * max(at.values())]
        for name, k in at.items():
            fields[k] = (
                int(t[name][i])
                if name == "FSI"
                else None
                if np.isnan(t[name][i])
                else float(t[name][i])
            )
        yield large_card("PBEND", fields)


def _nsm_pairs(t: Table) -> Iterator[str]:
    for row in zip(*(t[k].tolist() for k in ("SID", "TYPE", "ID", "VALUE")), strict=True):
        yield large_card(t.card, row)


def _nsm_lists(t: Table) -> Iterator[str]:
    for i, head in enumerate(zip(*(t[k].tolist() for k in ("SID", "TYPE", "VALUE")), strict=True)):
        yield large_card(
            t.card, [*head, *("ALL" if g == 0 else g for g in t.ragged("ID").row(i).tolist())]
        )


def _rbe1(t: Table) -> Iterator[str]:
    pairs = {k: t.ragged(k) for k in ("GN", "CN", "GM", "CM")}
    for i, eid in enumerate(t["EID"].tolist()):
        fields: list[Value] = [eid]
        for flag, (g, c) in ((None, ("GN", "CN")), ("UM", ("GM", "CM"))):
            terms = list(zip(pairs[g].row(i).tolist(), pairs[c].row(i).tolist(), strict=True))
            for k in range(0, len(terms), 3):
                fields += [flag if k == 0 else None] if flag or k else []
                line = [v for term in terms[k : k + 3] for v in term]
                fields += [*line, *[None] * (-len(fields) - len(line) & 7)]
        yield format_card("RBE1", fields)


def _rspline(t: Table) -> Iterator[str]:
    g, c = t.ragged("G"), t.ragged("C")
    for i, (eid, ratio) in enumerate(zip(t["EID"].tolist(), t["DL"].tolist(), strict=True)):
        pairs = list(zip(g.row(i).tolist(), c.row(i).tolist(), strict=True))
        yield format_card(
            "RSPLINE", [eid, ratio, pairs[0][0], *(v or None for pair in pairs[1:] for v in pair)]
        )


def _genel(t: Table) -> Iterator[str]:
    lists = {k: t.ragged(k) for k in ("UI", "CI", "UD", "CD", "KZ", "S")}
    for i, (eid, form) in enumerate(zip(t["EID"].tolist(), t["FORM"].tolist(), strict=True)):
        row = {k: v.row(i).tolist() for k, v in lists.items()}
        ui, ud = (
            [v for p in zip(row[f"U{k}"], row[f"C{k}"], strict=True) for v in p] for k in "ID"
        )
        fields: list[Value] = [eid, None, *ui]
        for name, values in (("UD", [None, *ud] if ud else []), (form, row["KZ"]), ("S", row["S"])):
            if values:
                fields += [*[None] * (-len(fields) % 8), name, *values]
        yield large_card("GENEL", fields)


def _laminate(t: Table) -> Iterator[str]:
    names = (("GPLYID",) if t.card == "PCOMPG" else ()) + ("MID", "T", "THETA", "SOUT")
    plies = [t.ragged(n) for n in names]
    for i in range(len(t)):
        fields: list[Value] = [int(t["PID"][i])]
        fields += [None if np.isnan(t["Z0"][i]) else float(t["Z0"][i])]
        fields += [float(t[n][i]) for n in ("NSM", "SB")] + [str(t["FT"][i]) or None]
        fields += [float(t[n][i]) for n in ("TREF", "GE")] + [str(t["LAM"][i]) or None]
        for ply in zip(*(p.row(i).tolist() for p in plies), strict=True):
            fields += [*ply, *([None] * 3 if t.card == "PCOMPG" else [])]
        yield large_card(t.card, fields)


def _dmig(t: Table) -> Iterator[str]:
    terms = {k: t.ragged(k) for k in ("GJ", "CJ", "GI", "CI", "A", "B")}
    for i, name in enumerate(t["NAME"].tolist()):
        head = [int(t[k][i]) for k in ("IFO", "TIN", "TOUT", "POLAR")]
        yield format_card(
            "DMIG", (name, 0, *(h or None for h in head), None, int(t["NCOL"][i]) or None)
        )
        rows = {k: v.row(i) for k, v in terms.items()}
        column = rows["GJ"] * 8 + rows["CJ"]
        for key in np.unique(column).tolist():
            fields: list[Value] = [name, key // 8, key % 8, None]
            for at in np.flatnonzero(column == key).tolist():
                fields += [
                    int(rows["GI"][at]),
                    int(rows["CI"][at]),
                    float(rows["A"][at]),
                    float(rows["B"][at]) or None,
                ]
            yield large_card("DMIG", fields)


def _cweld(t: Table) -> Iterator[str]:
    """The cards of a table."""
    for i, kind in enumerate(t["TYPE"].tolist()):
        fields: list[Value] = [None] * 24
        fields[1], fields[3], fields[6] = int(t["PID"][i]), kind, str(t["SPTYP"][i]) or None
        for name, k in (WELD_ENDS | WELD_TYPES[kind]).items():
            fields[k] = int(t[name][i]) or None
        for name, k in WELD_POINT.items():
            if not np.isnan(t[name][i]):
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
TOO_LONG = 10**8  # an id of more than eight characters
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
    params = [
        format_card("PARAM", (name, value if not isinstance(value, float) else _short(value)))
        for name, value in model.params.items()
        if name not in without
    ]
    return "".join(
        [
            *params,
            *(
                text
                for card, t in model.tables.items()
                if card not in without
                for text in _cards(t)
            ),
        ]
    )


def _short(value: float) -> str:
    return format_real(value, 8)


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
        if spec.kind == "i" and not spec.blank and table[spec.name].max(initial=0) >= TOO_LONG:
            return False
        if spec.kind == "f" and not spec.blank:
            text, first = np.unique(small[:, j], return_index=True)
            given = text != ""
            back = np.array([_value(t) for t in text[given].tolist()])
            if (back != table[spec.name][first[given]]).any() or np.unique(
                table[spec.name]
            ).size > text.size:
                return False
    return True


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # 1.2-8
        sign, body = text[0] if text[0] in "+-" else "", text.lstrip("+-")
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
    head = [card.ljust(8) if width == 8 else f"{card}*".ljust(8)] + [
        ("" if width == 8 else "*").ljust(8)
    ] * n
    out = np.empty(len(cells), dtype=object)
    for k in np.unique(used).tolist():
        rows = np.flatnonzero(used == k)
        block = np.strings.rjust(padded[rows, : min(k, n) * per_line], width)
        text = "".join
        out[rows] = [
            "\n".join(
                (head[i] + text(row[i * per_line : (i + 1) * per_line])).rstrip() for i in range(k)
            )
            for row in block.tolist()
        ]
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
