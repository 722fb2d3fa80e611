"""CTRIA3: discrete Kirchhoff bending (DKT; Batoz, Bathe and Ho 1980), constant membrane strain, drilling.

It has no transverse shear flexibility: its bending stiffness is exactly proportional to t³.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.algebra import unit
from ringtrue.fem.elements.shell import Plate, drilling, finish, place, plate
from ringtrue.fem.isotropy import elastic, gram
from ringtrue.fem.mesh import Matrices, Mesh, error

_P = np.array([[1, 1], [4, 1], [1, 4]]) / 6  # three points, degree 2
_L = np.stack([1 - _P.sum(1), _P[:, 0], _P[:, 1]], axis=1)
_DL = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
_SIDES = ((0, 1), (1, 2), (2, 0))


def flatten(x: Float) -> tuple[Float, Float, Float]:
    """Axes (e, 3, 3), plane coordinates (e, 3, 2) and areas (e,) of nodes (e, 3, 3)."""
    e1 = unit(x[:, 1] - x[:, 0])
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    area = np.linalg.norm(n, axis=1) / 2
    n = n / np.where(area == 0, 1.0, 2 * area)[:, None]
    axes = np.stack([e1, np.cross(n, e1), n], axis=1)
    return axes, np.einsum("eij,ekj->eki", axes, x - x.mean(axis=1, keepdims=True))[..., :2], area


def _slopes(xy: Float) -> Float:
    """(βx, βy) at corners and mid-sides over (w, θx, θy) of each node: (e, 6, 2, 3, 3).

    At a mid-side the slope along it is that of a cubic w, the slope across it the mean of its ends.
    """
    H = np.zeros((len(xy), 6, 2, 3, 3))
    for k in range(3):
        H[:, k, 0, k, 2], H[:, k, 1, k, 1] = 1.0, -1.0
    for s, (i, j) in enumerate(_SIDES):
        d = xy[:, j] - xy[:, i]
        length = np.linalg.norm(d, axis=1)
        t = d / length[:, None]
        along = np.einsum("ea,eb->eab", t, t)
        mean = (H[:, i] + H[:, j]) / 2
        # β = -∇w for a Kirchhoff plate; along a side -∂w/∂s = -1.5 (wj - wi)/l - (βi + βj)/4
        H[:, 3 + s] = mean - 1.5 * np.einsum("eab,ebnc->eanc", along, mean)
        H[:, 3 + s, :, i, 0] += 1.5 * t / length[:, None]
        H[:, 3 + s, :, j, 0] -= 1.5 * t / length[:, None]
    return H


def _quadratic(L: Float) -> Float:
    """Natural derivatives (gp, 6, 2) of the quadratic triangle."""
    corner = (4 * L - 1)[..., None] * _DL
    i, j = np.array(_SIDES).T
    return np.concatenate([corner, 4 * (L[:, i, None] * _DL[j] + L[:, j, None] * _DL[i])], axis=1)


def kernel(xy: Float, area: Float, s: Plate) -> Any_:
    """Local stiffness (e, 3, 6, 3, 6) of triangles with corners xy (e, 3, 2)."""
    e = len(xy)
    J = np.einsum("nr,ena->era", _DL, xy)
    back = np.linalg.inv(J)
    g1 = np.broadcast_to(np.einsum("ear,nr->ena", back, _DL)[:, None], (e, 3, 3, 2))
    g2 = np.einsum("ear,gnr->egna", back, _quadratic(_L))
    w = np.repeat(area[:, None] / 3, 3, axis=1)
    stretch = elastic(gram(g1, w), *s.membrane)
    H = _slopes(xy).reshape(e, 12, 9)
    bend = H.swapaxes(1, 2) @ elastic(gram(g2, w), *s.bending) @ H
    K = np.zeros((e, 3, 6, 3, 6), dtype=np.result_type(stretch, bend, s.drill))
    place(K, [0, 1], stretch)
    place(K, [2, 3, 4], bend)
    place(K, [0, 1, 5], s.drill[:, None, None] * drilling(_L, g1, w))
    return K


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CTRIA3.

    Raises
    ------
    DeckError
        If an element has no area.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("G1", "G2", "G3")[at], t, at)
    axes, xy, area = flatten(m.xyz[nodes])
    if (area == 0).any():
        raise error(m.model, t, int(at[area == 0][0]), "it has no area; check its nodes")
    section = plate(m, card, at, 3)
    share = np.repeat(area[:, None] / 3, 3, axis=1)
    return finish(m, nodes, kernel(xy, area, section), section, axes, np.zeros((len(at), 3)), share)
