"""Cards of special layout as text: constraints, laminates, beams, bushes and matrices, a card at a
time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ringtrue.decks.nastran.beams import bend_places
from ringtrue.decks.nastran.lists import BUSH
from ringtrue.decks.nastran.welds import write_cweld
from ringtrue.decks.nastran.writer import Value, format_card
from ringtrue.model.model import Table


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
    "CWELD": write_cweld,
    "PCOMP": _laminate,
    "PCOMPG": _laminate,
    "DMIG": _dmig,
}
