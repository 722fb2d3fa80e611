"""CPENTA with six nodes as Nastran's: the stiffness that recorded deflections of MSC Nastran show.

Transverse shear is tied along the edges of the middle triangle and is linear between them (Lee and
Bathe 2004, MITC3). It is integrated at the points where the inscribed circle touches the edges:
they follow from the deflections of one wedge under four loads, to their seven digits, and were
recorded of no other shape of triangle. Constant shear goes through a mesh of prisms whose triangles
are those of the layer below, and not through other meshes.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.elements.elasticity import (
    PAIRS,
    Anisotropic,
    elasticity_matrix,
    in_cartesian,
    jacobian,
)
from ringtrue.fem.elements.shape_functions import SolidRule, line, triangle
from ringtrue.fem.mesh import Isotropic, condense
from ringtrue.model.cards import TRIANGLE, WEDGE

_SIDES = np.array([[0, 1], [1, 2], [2, 0]])
_SHEAR = (PAIRS.index((2, 0)), PAIRS.index((1, 2)))  # of ζ with r and s


def product(
    flat: tuple[Float, Float], along: tuple[Float, Float]
) -> tuple[Float, Float]:
    """Points (gp, 3) and weights of a triangle's times a line's."""
    (p, w), (z, v) = flat, along
    points = np.concatenate([np.column_stack([p, np.full(len(p), zi)]) for zi in z])
    return points, (v[:, None] * w).ravel()


POINTS, _WEIGHTS = product(triangle(2), line(2))
RULE = SolidRule(*WEDGE.functions(1, POINTS), _WEIGHTS)
_MIDDLE_OF_SIDES = WEDGE.functions(
    1, np.array([[0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0]])
)[1]
CENTRE = WEDGE.functions(1, np.array([[1 / 3, 1 / 3, 0.0]]))[1]
_BUBBLE = TRIANGLE.functions(2, POINTS[:, :2])[1][:, 3:].sum(axis=1) / 4


def natural_strains(derivatives: Any_, J: Any_) -> Any_:
    """Covariant engineering strains (e, gp, 6, n, 3) of displacements, in the order of PAIRS."""
    rows = []
    for i, j in PAIRS:
        row = np.einsum("gn,ega->egna", derivatives[..., i], J[:, :, j])
        if i != j:
            row = row + np.einsum("gn,ega->egna", derivatives[..., j], J[:, :, i])
        rows.append(row)
    return np.stack(rows, axis=2)


def _touching(x: Any_) -> Any_:
    """Where the circle in the middle triangle of wedges x (e, 6, 3) touches its sides: (e, 3, 2),
    in r and s.
    """
    middle = (x[:, :3] + x[:, 3:]) / 2
    sides = middle[:, _SIDES[:, 1]] - middle[:, _SIDES[:, 0]]
    length = np.sqrt((sides * sides).sum(axis=2))
    share = (
        1 + (np.roll(length, 1, axis=1) - np.roll(length, -1, axis=1)) / length
    ) / 2
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    first, second = corners[_SIDES.T]
    return np.asarray(first + share[:, :, None] * (second - first))


def _tied_shear(x: Any_) -> tuple[Any_, Any_]:
    """Covariant shear of ζ with r and with s, (e, gp, 18) each, from its values along the sides."""
    J = np.einsum("gnr,ena->egra", _MIDDLE_OF_SIDES, x)
    shear = natural_strains(_MIDDLE_OF_SIDES, J)[:, :, list(_SHEAR)].reshape(
        len(x), 3, 2, 18
    )
    along_r = shear[:, 0, 0]
    along_s = shear[:, 2, 1]
    across = shear[:, 1, 1] - shear[:, 1, 0]
    turn = along_s - along_r - across
    r, s = np.tile(_touching(x), (1, 2, 1)).transpose(2, 0, 1)[..., None]
    return along_r[:, None] + s * turn[:, None], along_s[:, None] - r * turn[:, None]


def kernel(x: Any_, material: Isotropic | Anisotropic) -> Any_:
    """Stiffness (e, 18, 18) of wedges with nodes x (e, 6, 3).

    Of two incompatible modes the first is 1 - ζ² along the wedge, as a strain alone, the second the
    bubble L1 L2 + L2 L3 + L3 L1 in the triangle.
    """
    J, det, _ = jacobian(RULE.derivatives, x)
    w = det * RULE.weights
    e = len(x)
    strains = natural_strains(RULE.derivatives, J).reshape(e, len(POINTS), 6, 18)
    strains[:, :, _SHEAR[0]], strains[:, :, _SHEAR[1]] = _tied_shear(x)
    of_nodes = in_cartesian(np.linalg.inv(J).swapaxes(2, 3)) @ strains
    soft = np.zeros((len(POINTS), 6, 3))
    soft[:, PAIRS.index((2, 2)), 0] = POINTS[:, 2]
    for k in range(2):
        soft[:, k, 1 + k] = _BUBBLE[:, k]
        soft[:, PAIRS.index((0, 1)), 1 + k] = _BUBBLE[:, 1 - k]
    J0, det0, _ = jacobian(CENTRE, x)
    within = (
        in_cartesian(np.linalg.inv(J0).swapaxes(2, 3))
        @ soft
        * (det0 / det)[:, :, None, None]
    )
    mean = np.einsum("eg,egpm->epm", w, within) / w.sum(axis=1)[:, None, None]
    B = np.concatenate([of_nodes, within - mean[:, None]], axis=3)
    stress = elasticity_matrix(material)[:, None] @ B * w[:, :, None, None]
    rows = (e, len(POINTS) * 6, 21)
    K = B.reshape(rows).swapaxes(1, 2) @ stress.reshape(rows)
    return condense(K, slice(18), slice(18, None))
