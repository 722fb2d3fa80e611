"""CQUAD4: MITC4 bending and shear, membrane with incompatible modes, drilling, flat with rigid arms to the nodes.

Bathe and Dvorkin (1985) for the transverse shear; Taylor, Beresford and Wilson (1976) for the membrane. Every part
is linear in E and in t or t³, so that the parts of a thickness parameter are exact.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.algebra import condense, unit
from ringtrue.fem.elements.shell import Plate, drilling, finish, place, plate
from ringtrue.fem.isotropy import elastic, gram, incompatible, jacobian
from ringtrue.fem.mesh import Matrices, Mesh, error

_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_POINTS = _SIGNS / np.sqrt(3)
_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # slopes (βx, βy) = (θy, -θx)


def _shape(p: Float) -> tuple[Float, Float]:
    f = 1 + p[:, None, :] * _SIGNS
    d = np.stack([_SIGNS[:, 0] * f[..., 1], _SIGNS[:, 1] * f[..., 0]], axis=2)
    return f.prod(axis=2) / 4, d / 4


_N, _DN = _shape(_POINTS)
_BUBBLES = -2 * _POINTS[:, :, None] * np.eye(2)
_CENTRE = _shape(np.zeros((1, 2)))[1]
_MID = _shape(np.array([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [1.0, 0.0]]))  # of the sides η = ∓1, ξ = ∓1


def flatten(x: Float) -> tuple[Float, Float, Float]:
    """Axes (e, 3, 3), plane coordinates (e, 4, 2) and heights (e, 4) of nodes (e, 4, 3)."""
    n = unit(np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]))
    e1 = x[:, 1] + x[:, 2] - x[:, 0] - x[:, 3]
    e1 = unit(e1 - np.einsum("ei,ei->e", e1, n)[:, None] * n)
    axes = np.stack([e1, np.cross(n, e1), n], axis=1)
    local = np.einsum("eij,ekj->eki", axes, x - x.mean(axis=1, keepdims=True))
    return axes, local[..., :2], local[..., 2]


def _assumed_shear(xy: Float, J: Float) -> Float:
    """Rows (e, gp, 2, 12) of the Cartesian shear strains over (w, βx, βy) of each node."""
    _, d = _MID
    N = _MID[0]
    tangent = np.einsum("gnr,ena->egra", d, xy)
    cov = np.empty((len(xy), 4, 4, 3))  # e, side, node, (w, βx, βy)
    for side, r in enumerate((0, 0, 1, 1)):
        cov[:, side, :, 0] = d[side, :, r]
        cov[:, side, :, 1:] = N[side, :, None] * tangent[:, side, r, None, :]
    xi, eta = _POINTS[:, 0], _POINTS[:, 1]
    mix = np.zeros((4, 2, 4))
    mix[:, 0, 0], mix[:, 0, 1] = (1 - eta) / 2, (1 + eta) / 2
    mix[:, 1, 2], mix[:, 1, 3] = (1 - xi) / 2, (1 + xi) / 2
    rows = np.einsum("grs,esnc->egrnc", mix, cov).reshape(len(xy), 4, 2, 12)
    return np.asarray(np.linalg.solve(J, rows))


def kernel(xy: Float, s: Plate) -> Any_:
    """Local stiffness (e, 4, 6, 4, 6) of a flat element with corners xy (e, 4, 2)."""
    J, det, g = jacobian(_DN, xy)
    J0, det0, _ = jacobian(_CENTRE, xy)
    soft = incompatible(_BUBBLES, J0[:, 0], det0[:, 0], det, det)
    stretch = elastic(gram(np.concatenate([g, soft], axis=2), det), *s.membrane)
    rows = _assumed_shear(xy, J)
    both = (rows * det[..., None, None]).reshape(-1, 8, 12).swapaxes(1, 2) @ rows.reshape(-1, 8, 12)
    K = np.zeros((len(xy), 4, 6, 4, 6), dtype=np.result_type(stretch, s.bending[0], s.shear, s.drill))
    place(K, [0, 1], _membrane(stretch))
    shear = (s.shear[:, None, None] * both).reshape(-1, 4, 3, 4, 3)
    slopes = elastic(gram(g, det), *s.bending).reshape(-1, 4, 2, 4, 2) + shear[:, :, 1:, :, 1:]
    K[:, :, 2, :, 2] += shear[:, :, 0, :, 0]
    K[:, :, 3:5, :, 3:5] += np.einsum("ai,ekalb,bj->ekilj", _TURN, slopes, _TURN, optimize=True)
    K[:, :, 2, :, 3:5] += np.einsum("eklb,bj->eklj", shear[:, :, 0, :, 1:], _TURN)
    K[:, :, 3:5, :, 2] += np.einsum("ai,ekal->ekil", _TURN, shear[:, :, 1:, :, 0])
    place(K, [0, 1, 5], s.drill[:, None, None] * drilling(_N, g, det))
    return K


def _membrane(K: Any_) -> Any_:
    """Condense the bubbles out; elements without membrane stiffness stay zero."""
    live = np.abs(K).max(axis=(1, 2)) > 0
    out = np.zeros((len(K), 8, 8), dtype=K.dtype)
    out[live] = condense(K[live], np.arange(8), np.arange(8, 12))
    return out


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CQUAD4.

    Raises
    ------
    DeckError
        If an element is not convex.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("G1", "G2", "G3", "G4")[at], t, at)
    axes, xy, heights = flatten(m.xyz[nodes])
    det = jacobian(_SIGNED, xy)[1]
    if not (det > 0).all():
        bad = int(at[np.flatnonzero(~(det > 0).all(axis=1))[0]])
        raise error(m.model, t, bad, "a corner of 180 degrees or more, or sides that cross; check its node order")
    section = plate(m, card, at, 4)
    share = np.einsum("eg,gn->en", jacobian(_DN, xy)[1], _N)
    return finish(m, nodes, kernel(xy, section), section, axes, heights, share)


_SIGNED = _shape(_SIGNS)[1]
