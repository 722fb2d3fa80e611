"""A curved free shell strip as model tables, regions of different thickness; optionally clamped
along one edge.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.model import cards
from ringtrue.model.model import CaseControl, Model, Ragged, Table, table


def _full(card: str, n: int, **columns: object) -> Table:
    """A table with the card's defaults in the columns that are not given."""
    made = {}
    for f in cards.columns(card):
        if f.blank or f.tail:
            continue
        for name in filter(None, (f.name, f.other)):
            made[name] = np.full(n, f.default if name == f.name else 0)
    return table(
        card,
        **{
            **made,
            **{k: np.broadcast_to(np.asarray(v), n).copy() for k, v in columns.items()},
        },
    )


def shell(nx: int, ny: int, *, regions: int = 3, clamped: bool = False) -> Model:
    """2 m by 1.3 m steel, 10 mm and up; region r has PSHELL and MAT1 r."""
    i, j = (
        a.ravel()
        for a in np.meshgrid(np.arange(nx + 1), np.arange(ny + 1), indexing="ij")
    )
    ex, ey = (
        a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    )

    def node(a: Int, b: Int) -> Int:
        return a * (ny + 1) + b + 1

    x = 2.0 * i / nx
    part = np.arange(1, regions + 1)
    tables = {
        "GRID": _full(
            "GRID", i.size, ID=node(i, j), X1=x, X2=1.3 * j / ny, X3=0.3 * np.sin(2 * x)
        ),
        "CQUAD4": _full(
            "CQUAD4",
            ex.size,
            EID=np.arange(ex.size) + 1,
            PID=ex * regions // nx + 1,
            G1=node(ex, ey),
            G2=node(ex + 1, ey),
            G3=node(ex + 1, ey + 1),
            G4=node(ex, ey + 1),
        ),
        "PSHELL": _full(
            "PSHELL", regions, PID=part, MID1=part, MID2=part, T=0.009 + 0.001 * part
        ),
        "MAT1": _full("MAT1", regions, MID=part, E=2.1e11, NU=0.3, RHO=7850.0),
    }
    if clamped:
        edge = node(np.zeros(ny + 1, dtype=np.int64), np.arange(ny + 1))
        tables["SPC1"] = table(
            "SPC1", SID=[1], C=["123456"], G=Ragged(edge, np.array([0, edge.size]))
        )
    return Model(tables, case=CaseControl(spc=1 if clamped else 0))


def parameters(regions: int = 3) -> ParameterSet:
    """The thickness of the first region and Young's modulus of the others."""
    first = Parameter("t1", (CardField("PSHELL", 1, "T"),))
    return ParameterSet(
        (
            first,
            *(
                Parameter(f"E{r}", (CardField("MAT1", r, "E"),))
                for r in range(2, regions + 1)
            ),
        )
    )
