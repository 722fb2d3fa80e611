"""CFAST: six springs between two surfaces of shells, each end on a square as large as the fastener."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.algebra import arm, congruent, rotation, unit
from ringtrue.fem.elements.patch import End, Skin, on_square, place, surface
from ringtrue.fem.elements.weld import assembled
from ringtrue.fem.mesh import Matrices, Mesh, error, lookup
from ringtrue.fem.place import frame

_STIFFNESS = ("KT1", "KT2", "KT3", "KR1", "KR2", "KR3")


def _axes(axis: Float) -> Float:
    """Frames (e, 3, 3) of MCID -1: x along the axis, y in the plane of it and the axis of basic most across it.

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
    skin = Skin.of(m)
    D = m.model["PFAST"]["D"][lookup(m.model, "PFAST", t["PID"][at], t, at)].real
    made = []
    for side in "AB":
        ids = t[f"ID{side}"][at]
        pid = ids.copy()
        shell = kind == "ELEM"
        pid[shell] = surface(m, t, at[shell], skin, ids[shell])
        made.append(on_square(m, t, at, skin, pid, place(m, t, at, side), D))
    return made[0], made[1]


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CFAST: KT, KR half way between the ends, half of MASS at each.

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
    d = b.place - a.place
    L = np.linalg.norm(d, axis=1)
    axis = np.where((L > 0)[:, None], d / np.where(L > 0, L, 1.0)[:, None], a.normal)
    cid, absolute = p["MCID"][row], p["MFLAG"][row] > 0
    relative = (cid >= 0) & ~absolute & ((k[:, 1] != k[:, 2]) | (k[:, 4] != k[:, 5]))
    if relative.any():
        why = "MFLAG = 0 with a frame and KT2, KT3 or KR2, KR3 that differ; give MFLAG = 1"
        raise error(m.model, p, int(row[relative][0]), why)
    fixed = (cid >= 0) & absolute
    middle = (a.place + b.place) / 2
    R = np.where(fixed[:, None, None], frame(m, np.where(fixed, cid, 0), middle), _axes(axis))
    move = [rotation(R, 1) @ arm(middle - end.place) @ end.follow for end in (a, b)]
    K = congruent(np.concatenate([-move[0], move[1]], axis=2), k[:, :, None] * np.eye(6))
    return assembled(a, b, K, p["MASS"][row] / 2, p["GE"][row])
