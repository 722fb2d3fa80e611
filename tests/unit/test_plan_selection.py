"""Measuring points by QR, kinetic energy, auto-MAC and information; candidates; lost sensors:
against closed forms.

The structure is a taut string of unit length and mass: φ_k(s) = √2 sin kπs, ω_k = kπc.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import numpy.typing as npt
import pytest
from scipy import linalg

from ringtrue.errors import InputError
from ringtrue.planning.geometry import (
    along,
    in_boxes,
    select_candidates,
    surface_normals,
)
from ringtrue.planning.sensors import (
    Spacing,
    add_redundancy,
    select_points,
    worst_sensor_loss,
)
from ringtrue.shapes import auto_mac, worst_off_diagonal

Array = npt.NDArray[np.float64]


def string(n: int, m: int) -> tuple[Array, Array]:
    s = np.arange(1, n + 1) / (n + 1)
    xyz = np.stack([s, 0 * s, 0 * s], axis=1)
    return np.sqrt(2) * np.sin(np.pi * np.outer(s, np.arange(1, m + 1)))[
        :, None, :
    ], xyz


def random(n: int, d: int, m: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal((n, d, m))


def worst(shapes: Array, at: Array) -> float:
    return worst_off_diagonal(auto_mac(shapes[at].reshape(-1, shapes.shape[2])))


def test_loss_by_closed_form_and_by_brute_force() -> None:
    # orthonormal rows in pairs: without one point half of the information about its mode is left
    shapes = np.repeat(np.eye(3), 2, axis=0)[:, None, :] / np.sqrt(2)
    assert worst_sensor_loss(shapes, 1).left == pytest.approx(0.5)
    two = worst_sensor_loss(shapes, 2)
    assert two.left == pytest.approx(0.0, abs=1e-12)
    assert two.points[0] // 2 == two.points[1] // 2
    assert worst_sensor_loss(shapes, 0).left == 1.0
    some = random(9, 2, 4, seed=7)
    gram = np.einsum("ndi,ndj->ij", some, some)
    left = min(
        linalg.eigh(
            gram - np.einsum("ndi,ndj->ij", some[list(c)], some[list(c)]),
            gram,
            eigvals_only=True,
        )[0]
        for c in combinations(range(9), 3)
    )
    loss = worst_sensor_loss(some, 3)
    assert loss.exact
    assert loss.left == pytest.approx(left, rel=1e-9)
    # the combination that suffers keeps just that share
    q = loss.combination
    kept = np.delete(some, loss.points, axis=0)
    assert ((kept @ q) ** 2).sum() / ((some @ q) ** 2).sum() == pytest.approx(
        left, rel=1e-9
    )


def test_redundant_layouts_survive_any_loss() -> None:
    shapes, _ = string(59, 4)
    few = select_points(shapes, np.zeros((59, 3)), 4)
    assert worst_sensor_loss(shapes[few], 1).left < 1e-9
    safe = add_redundancy(shapes, few, 2)
    assert safe[:4].tolist() == few.tolist()
    for c in combinations(range(safe.size), 2):
        assert (
            np.linalg.matrix_rank(np.delete(shapes[safe, 0], c, axis=0), tol=1e-6) == 4
        )
    assert worst_sensor_loss(shapes[safe], 2).left >= 0.1
    with pytest.raises(InputError, match="allow more points or"):
        add_redundancy(shapes, few, 2, most=5)


def test_points_added_for_redundancy_keep_their_distance() -> None:
    shapes, xyz = string(59, 4)
    few = select_points(shapes, xyz, 4, min_distance=0.08)
    close = xyz[add_redundancy(shapes, few, 2), 0]
    assert np.diff(np.sort(close)).min() < 0.08
    apart = add_redundancy(shapes, few, 2, spacing=Spacing(xyz, 0.08))
    assert np.diff(np.sort(xyz[apart, 0])).min() > 0.08
    assert worst_sensor_loss(shapes[apart], 2).left >= 0.1
    with pytest.raises(InputError, match=r"a distance below 0\.2 m"):
        add_redundancy(shapes, few, 3, spacing=Spacing(xyz, 0.2))


def test_layouts_that_cannot_tell_modes_apart_have_nothing_to_lose() -> None:
    shapes, _ = string(59, 4)
    assert worst_sensor_loss(shapes[[0, 1, 58]], 1).left == 0.0
    assert worst_sensor_loss(shapes[:3], 1).points.size == 0
    assert (
        worst_sensor_loss(
            shapes[add_redundancy(shapes, np.array([3, 9, 20]), 1)], 1
        ).left
        >= 0.1
    )


def test_candidates_by_boxes_and_exclusions() -> None:
    nodes = np.arange(1, 11)
    xyz = np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)])
    assert select_candidates(nodes, xyz).all()
    keep = select_candidates(
        nodes,
        xyz,
        boxes=[[8, 1, 1, 4, -1, -1]],
        exclude=[6],
        keep_out=[[7, 0, 0, 7.5, 0, 0]],
    )
    assert nodes[keep].tolist() == [5, 7, 9]
    with pytest.raises(InputError, match=r"not there: \[99\]"):
        select_candidates(nodes, xyz, exclude=[99])
    with pytest.raises(InputError, match="widen"):
        select_candidates(nodes, xyz, boxes=[[20, 0, 0, 21, 1, 1]])
    with pytest.raises(InputError, match="x0 y0 z0"):
        in_boxes(xyz, [[0, 1]])


def test_normals_of_a_pyramid_and_uniaxial_shapes() -> None:
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    sides = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    normal = surface_normals(xyz, sides)
    np.testing.assert_allclose(normal[4], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1)
    shapes = random(5, 3, 2)
    np.testing.assert_allclose(along(shapes, normal[:, None])[4, 0], shapes[4, 2])
