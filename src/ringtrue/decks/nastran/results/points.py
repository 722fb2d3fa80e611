"""Points and frames of an OP2 file without cards: BGPDT, EQEXIN and CSTM (DMAP Programmer's Guides
of MSC Nastran and NX Nastran).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.decks.nastran.results.op2 import Op2Table
from ringtrue.model.model import Ragged, Table, stacked, table
from ringtrue.model.references import FRAMES

POINT_BLOCKS = ("BGPDT", "EQEXIN", "CSTM")
_SHORT = 4  # words of a point in BGPDT: its frame and three single-precision coordinates
_KINDS = {1: "CORD2R", 2: "CORD2C", 3: "CORD2S"}
_FRAME = 12  # numbers of a frame: its origin, and by rows the rotation from it to basic


def grids(places: Mapping[str, Op2Table]) -> dict[str, Table]:
    """GRID and SPOINT without GEOM1: displacement frame and basic coordinates of BGPDT, numbers of
    EQEXIN.

    Parameters
    ----------
    places : mapping of str to Op2Table
        The blocks BGPDT and EQEXIN by these names.
    """
    if "BGPDT" not in places or "EQEXIN" not in places:
        return {}
    numbers = places["EQEXIN"].ints(places["EQEXIN"].bodies()[0])
    if numbers.size % 2:
        return {}
    outer, inner = numbers.reshape(-1, 2).T
    if not np.array_equal(np.sort(inner), np.arange(1, inner.size + 1)):
        return {}
    found = _placed(places["BGPDT"], inner.size)
    if found is None:
        return {}
    cd, xyz = (values[inner - 1] for values in found)
    grid = cd >= 0  # -1 for scalar points
    n = int(grid.sum())
    zero = np.zeros(n, dtype=np.int64)
    made: dict[str, Any] = {"ID": outer[grid], "CP": zero}
    made |= {f"X{k + 1}": xyz[grid, k] for k in range(3)}
    made |= {"CD": cd[grid], "PS": np.full(n, ""), "SEID": zero}
    out = {"GRID": table("GRID", **made)}
    if not grid.all():
        scalar = outer[~grid]
        out["SPOINT"] = table("SPOINT", ID=Ragged(scalar, np.array([0, scalar.size])))
    return out


def _placed(block: Op2Table, count: int) -> tuple[Int, Float] | None:
    """Displacement frames (n,) and basic coordinates (n, 3) of so many points of BGPDT; None of a
    form that is not known.

    Older versions give a frame and three reals, newer ones six integers and three numbers of double
    precision.
    """
    body = block.bodies()[0]
    if len(body) == count * _SHORT * block.word:
        reals = block.decimals(block.floats(body)).reshape(count, _SHORT)
        return block.ints(body).reshape(count, _SHORT)[:, 0], reals[:, 1:]
    row = np.dtype([("ints", f"{block.order}i{block.word}", 6), ("xyz", f"{block.order}f8", 3)])
    if len(body) != count * row.itemsize:
        return None
    rows = np.frombuffer(body, row)
    return rows["ints"][:, 0].astype(np.int64), rows["xyz"].astype(np.float64)


def frames(places: Mapping[str, Op2Table], given: Mapping[str, Table]) -> dict[str, Table]:
    """The frames of CSTM that no card defines, as tables of CORD2R, CORD2C and CORD2S.

    Parameters
    ----------
    places : mapping of str to Op2Table
        The block CSTM by this name.
    given : mapping of str to Table
        Cards that are known.

    Returns
    -------
    dict of str to Table
        Of each kind of frame that gains some, those that were given first.
    """
    if "CSTM" not in places:
        return {}
    number, kind, values = _frame_rows(places["CSTM"])
    known = [given[card].ids for card in FRAMES if card in given]
    new = ~np.isin(number, np.concatenate([[0], *known]))
    out = {}
    for code, card in _KINDS.items():
        rows = np.flatnonzero(new & (kind == code))
        if not rows.size:
            continue
        origin = values[rows, :3]
        turned = values[rows, 3:].reshape(-1, 3, 3)
        corners = {"A": origin, "B": origin + turned[:, :, 2], "C": origin + turned[:, :, 0]}
        made: dict[str, Any] = {"CID": number[rows], "RID": np.zeros(rows.size, dtype=np.int64)}
        made |= {f"{c}{k + 1}": at[:, k] for c, at in corners.items() for k in range(3)}
        own = table(card, **made)
        out[card] = stacked(given[card], own) if card in given else own
    return out


def _frame_rows(block: Op2Table) -> tuple[Int, Int, Float]:
    """Numbers (n,), kinds (n,), and origins and rotations (n, 12) of CSTM.

    Older versions give number, kind and the values of a frame in one record; newer ones number,
    kind, a word, and where its values of double precision begin in the record behind, from 1.
    """
    bodies = block.bodies()
    ints = block.ints(bodies[0]) if bodies else np.empty(0, dtype=np.int64)
    nothing = np.empty(0, dtype=np.int64)
    if len(bodies) > 1 and ints.size % 4 == 0:
        heads = ints.reshape(-1, 4)
        numbers = block.doubles(bodies[1])
        at = heads[:, 3, None] - 1 + np.arange(_FRAME)
        if (at >= 0).all() and (at < numbers.size).all():
            return heads[:, 0], heads[:, 1], numbers[at]
    elif len(bodies) == 1 and ints.size % (2 + _FRAME) == 0:
        heads = ints.reshape(-1, 2 + _FRAME)
        numbers = block.decimals(block.floats(bodies[0])).reshape(heads.shape)
        return heads[:, 0], heads[:, 1], numbers[:, 2:]
    return nothing, nothing, np.empty((0, _FRAME))
