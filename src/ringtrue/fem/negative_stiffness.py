"""Negative stiffness: fields of a deck that make one, refused unless the deck asks for it.

Moduli and sizes of sections below 0 are no valid fields (MSC Nastran Quick Reference Guide); what
they make takes energy out when it deforms. Springs (CELAS, PELAS, PBUSH, PBUSH1D, PGAP, PFAST) and
matrices (DMIG, GENEL) may be negative there, and who writes one asks for it: gravity of a pendulum,
magnets, a correction of a stiffness. For all else PARAM,NEGSTIFF,YES in the deck asks, which
Nastran passes over as a parameter of the user.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.errors import DeckError
from ringtrue.model.model import Model, Ragged, Table

ASKED = "NEGSTIFF"  # the PARAM that asks for negative stiffness
POSITIVE = {  # fields below 0 that make a negative stiffness
    "MAT1": ("E", "G"),
    "MAT8": ("E1", "E2", "G12", "G1Z", "G2Z"),
    **dict.fromkeys(("PROD", "CONROD"), ("A", "J")),
    "PTUBE": ("OD", "T"),
    "PBAR": ("A", "I1", "I2", "J"),
    "PBEAM": ("A", "I1", "I2", "J", "AB", "I1B", "I2B", "JB"),
    **dict.fromkeys(("PSHELL", "PSHEAR", "PCOMP", "PCOMPG"), ("T",)),
    **dict.fromkeys(("CQUAD4", "CQUADR", "CQUAD8"), ("T1", "T2", "T3", "T4")),
    **dict.fromkeys(("CTRIA3", "CTRIAR", "CTRIA6"), ("T1", "T2", "T3")),
}
SPRINGS = {  # springs whose stiffness may be below 0
    **dict.fromkeys(("PELAS", "CELAS2", "CELAS4", "PBUSH1D"), ("K",)),
    "PBUSH": ("K1", "K2", "K3", "K4", "K5", "K6"),
    "PGAP": ("KA", "KB", "KT"),
    "PFAST": ("KT1", "KT2", "KT3", "KR1", "KR2", "KR3"),
}
# of the largest eigenvalue: entries of a deck have fewer digits than a double
_ZERO = 1e-9
_MATRICES = {"MAT2": 3, "MAT9": 6}


@dataclass(frozen=True, slots=True, eq=False)
class Negative:
    """A field of a card that makes a negative stiffness.

    Attributes
    ----------
    table : Table
    rows : (k,) int64, k >= 1
    field : str
    text : str
        What it is, of the first row.
    """

    table: Table
    rows: Int
    field: str
    text: str


def negative_stiffness(model: Model) -> Iterator[Negative]:
    """Moduli, matrices of elasticity and sizes of sections that make a negative stiffness."""
    yield from _below(model, POSITIVE)
    for card in (c for c in _MATRICES if c in model):
        lam = np.linalg.eigvalsh(elasticity(model[card], _MATRICES[card]))
        rows = np.flatnonzero(lam[:, 0] < -_ZERO * np.abs(lam).max(axis=1))
        if rows.size:
            yield Negative(
                model[card],
                rows,
                "G11 ...",
                "its elasticity matrix has a negative eigenvalue",
            )
    if "PBAR" in model:
        t = model["PBAR"]
        rows = np.flatnonzero(t["I12"] ** 2 > t["I1"] * t["I2"] * (1 + _ZERO))
        if rows.size:
            yield Negative(
                t, rows, "I12", f"I12 {t['I12'][rows[0]]:g} is over the root of I1 I2"
            )


def negative_springs(model: Model) -> Iterator[Negative]:
    """Springs of a stiffness below 0, which are taken as they are given."""
    yield from _below(model, SPRINGS)


def _below(model: Model, fields: dict[str, tuple[str, ...]]) -> Iterator[Negative]:
    for card in (c for c in fields if c in model):
        for name in (n for n in fields[card] if n in model[card].columns):
            column = model[card].columns[name]
            values = column.values if isinstance(column, Ragged) else column
            if (at := np.flatnonzero(values < 0)).size:
                rows = np.unique(column.owner[at]) if isinstance(column, Ragged) else at
                yield Negative(
                    model[card], rows, name, f"{name} is {values[at[0]]:g}, below 0"
                )


def asks_for_negative_stiffness(model: Model) -> bool:
    """Whether the deck asks to take negative stiffness as it is."""
    return str(model.params.get(ASKED, "NO")).upper() == "YES"


def refuse_negative(model: Model) -> None:
    """Refuse negative stiffness that the deck does not ask for.

    Raises
    ------
    DeckError
        With the card and the field.
    """
    if asks_for_negative_stiffness(model):
        return
    for found in negative_stiffness(model):
        row = int(found.rows[0])
        path, line = model.place(found.table, row)
        raise DeckError(
            f"{found.text}: it makes a negative stiffness. Correct it; or ask for it by "
            f"PARAM,{ASKED},YES in the deck, "
            "or give it as a spring (CELAS2, PELAS, PBUSH), which may be below 0",
            path=path,
            line=line,
            card=f"{found.table.card} {found.table.ids[row]}",
            field=found.field,
        )


def elasticity(table: Table, size: int) -> Any_:
    """The symmetric matrices (n, size, size) of a table of MAT2 (3) or MAT9 (6)."""
    i, j = np.triu_indices(size)
    values = table.stack(*(f"G{a}{b}" for a, b in zip(i + 1, j + 1, strict=True)))
    out = np.zeros((len(values), size, size), dtype=values.dtype)
    out[:, i, j] = out[:, j, i] = values
    return out
