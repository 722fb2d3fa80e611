"""CFAST: six springs between two surfaces of shells, each end on a square as large as the
fastener.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.algebra import unit
from ringtrue.fem.elements.patch import End, on_squares
from ringtrue.fem.elements.weld import between, joined
from ringtrue.fem.mesh import Matrices, Mesh, error, lookup
from ringtrue.fem.place import frame

_STIFFNESS = ("KT1", "KT2", "KT3", "KR1", "KR2", "KR3")


def _axes(axis: Float) -> Float:
    """Frames (e, 3, 3) of MCID -1: x along the axis, y in the plane of it and the axis of basic
    most across it.

    Of two that are equally across the first is taken (MSC Nastran Quick Reference Guide, PFAST).
    """
    b = np.eye(3)[np.round(np.abs(axis), 6).argmin(axis=1)]
    y = unit(b - np.einsum("ei,ei->e", b, axis)[:, None] * axis)
    return np.stack([axis, y, np.cross(axis, y)], axis=1)


def ends(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Both ends of the rows `at` (e,) of CFAST."""
    t = m.model[card]
    kind = t["TYPE"][at]
    if (bad := ~np.isin(kind, ("PROP", "ELEM"))).any():
        raise error(m.model, t, int(at[bad][0]), f"type {kind[bad][0]!r}: allowed are PROP, ELEM")
    D = m.model["PFAST"]["D"][lookup(m.model, "PFAST", t["PID"][at], t, at)].real
    return on_squares(m, t, at, D, kind == "ELEM", ("IDA", "IDB"), ("IDA", "IDB"))


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CFAST: KT, KR half way between the ends, half of MASS at
    each.

    Raises
    ------
    DeckError
        If an end or its frame is not determined, or a node or property is absent.
    """
    t = m.model[card]
    row = lookup(m.model, "PFAST", t["PID"][at], t, at)
    p = m.model["PFAST"]
    k = p.stack(*_STIFFNESS)[row]
    a, b = ends(m, card, at)
    axis = between(a, b)[1]
    cid, absolute = p["MCID"][row], p["MFLAG"][row] > 0
    relative = (cid >= 0) & ~absolute & ((k[:, 1] != k[:, 2]) | (k[:, 4] != k[:, 5]))
    if relative.any():
        why = "MFLAG = 0 with a frame and KT2, KT3 or KR2, KR3 that differ; give MFLAG = 1"
        raise error(m.model, p, int(row[relative][0]), why)
    fixed = (cid >= 0) & absolute
    own = frame(m, np.where(fixed, cid, 0), (a.place + b.place) / 2)
    axes = np.where(fixed[:, None, None], own, _axes(axis))
    return joined(a, b, axes, k, p["MASS"][row] / 2, p["GE"][row])
