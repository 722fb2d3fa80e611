"""PBARL and PBEAML: dimensions of sections, and the PBAR and PBEAM that they make."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Int
from ringtrue.errors import DeckError
from ringtrue.model.model import Table
from ringtrue.model.sections import section

MADE = {"PBARL": "PBAR", "PBEAML": "PBEAM"}
END_A = ("A", "I1", "I2", "I12", "J", "NSM")
END_B = ("AB", "I1B", "I2B", "I12B", "JB", "NSMB")
CENTRE = ("N1", "N2")  # of a section: neutral axis from shear centre, which a PBARL leaves out
_BOTH = ("K1", "K2")  # shear factors of the whole beam


def properties(
    card: str, kind: str, end_a: tuple[Any, Any], end_b: tuple[Any, Any] | None
) -> dict[str, Any]:
    """Fields of the PBAR or PBEAM; what a section does not tell is left out.

    Parameters
    ----------
    card : {"PBARL", "PBEAML"}
    kind : str
        TYPE of the section.
    end_a, end_b : (dimensions, NSM)
        End B None: as end A.

    Raises
    ------
    ValueError
        If the dimensions do not make a section.
    """
    a = section(kind, end_a[0]) | {"NSM": end_a[1]}
    made = {n: a[n] for n in (*END_A, *_BOTH) if n in a}
    if card == "PBARL":
        return made
    b = a if end_b is None else section(kind, end_b[0]) | {"NSM": end_b[1]}
    made |= {n: b[m] for m, n in zip(END_A, END_B, strict=True) if m in b}
    return made | {f"{n}{end}": s[n] for end, s in (("A", a), ("B", b)) for n in CENTRE if n in s}


def resectioned(tables: Mapping[str, Table], card: str, ids: Int) -> Table:
    """The table of PBAR or PBEAM with the rows that PBARL or PBEAML `ids` (k,) make computed anew.

    Raises
    ------
    DeckError
        If the dimensions do not make a section.
    """
    given = tables[card]
    made = tables[MADE[card]]
    new: dict[str, NDArray[Any]] = {}
    for i in np.unique(ids).tolist():  # the few that a parameter names
        row, at = (int(t.find(np.array([i]))[0]) for t in (given, made))
        for name, value in _properties(given, row).items():
            column = new.get(name, made[name])
            column = column.astype(np.result_type(column, type(value)))
            column[at] = value
            new[name] = column
    for name, column in new.items():
        made = made.with_column(name, column)
    return made


def _properties(t: Table, row: int) -> dict[str, Any]:
    ends = [(t.ragged("DIM").row(row).tolist(), t["NSM"][row].item()), None]
    if "DIMB" in t.columns and t.ragged("DIMB").row(row).size:
        ends[1] = (t.ragged("DIMB").row(row).tolist(), t["NSMB"][row].item())
    try:
        return properties(t.card, str(t["TYPE"][row]), ends[0], ends[1])  # type: ignore[arg-type]
    except ValueError as e:
        raise DeckError(str(e), card=f"{t.card} {t.ids[row]}") from None
