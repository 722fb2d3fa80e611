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
    nearest_nodes,
    select_candidates,
    surface_normals,
)
from ringtrue.planning.information import (
    Aim,
    gains,
    greedy_logdet,
    informed,
    mode_aim,
    parameter_aim,
    prior_shapes,
)
from ringtrue.planning.sensors import (
    add_redundancy,
    auto_mac_points,
    kinetic_weighted,
    prior_auto_mac,
    qr_points,
    select_points,
    worst_sensor_loss,
)
from ringtrue.shapes.mac import auto_mac, worst_off_diagonal

Array = npt.NDArray[np.float64]


def string(n: int, m: int) -> tuple[Array, Array]:
    s = np.arange(1, n + 1) / (n + 1)
    xyz = np.stack([s, 0 * s, 0 * s], axis=1)
    return np.sqrt(2) * np.sin(np.pi * np.outer(s, np.arange(1, m + 1)))[:, None, :], xyz


def random(n: int, d: int, m: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal((n, d, m))


def worst(shapes: Array, at: Array) -> float:
    return worst_off_diagonal(auto_mac(shapes[at].reshape(-1, shapes.shape[2])))


def test_qr_is_that_of_lapack_and_starts_again_when_the_modes_are_spanned() -> None:
    shapes = random(40, 1, 6)
    _, pivots = linalg.qr(shapes[:, 0].T, mode="r", pivoting=True)
    assert qr_points(shapes, 6).tolist() == pivots[:6].tolist()
    nine = qr_points(shapes, 9)
    assert np.unique(nine).size == 9
    rest = np.setdiff1d(np.arange(40), pivots[:6])
    _, again = linalg.qr(shapes[rest, 0].T, mode="r", pivoting=True)
    assert nine[6:].tolist() == rest[again[:3]].tolist()


def test_qr_keeps_fixed_points_distances_and_counts_cost() -> None:
    shapes, xyz = string(59, 4)
    fixed = np.zeros(59, dtype=bool)
    fixed[7] = True
    at = qr_points(shapes, 6, xyz=xyz, min_distance=0.1, fixed=fixed)
    assert at[0] == 7
    assert np.diff(np.sort(xyz[at, 0])).min() > 0.1
    free = qr_points(shapes, 1)[0]
    cost = np.ones(59)
    cost[free] = 10.0
    assert qr_points(shapes, 1, cost=cost)[0] != free
    with pytest.raises(InputError, match="lower min_distance"):
        qr_points(shapes, 20, xyz=xyz, min_distance=0.2)
    with pytest.raises(InputError, match="do not move"):
        qr_points(shapes * 0, 3)


def test_a_triaxial_point_counts_as_one() -> None:
    """Point 0 spans three modes by itself; each of the others sees one, though twice as strongly in
    one.
    """
    shapes = np.zeros((4, 3, 3))
    shapes[0] = np.eye(3)
    shapes[1:, 0] = 1.2 * np.eye(3)
    assert qr_points(shapes, 1).tolist() == [0]


def test_kinetic_weighting_prefers_mass() -> None:
    """Two like beams side by side, one ten times as heavy: both move alike, the energy is in the
    heavy one.
    """
    shapes, _ = string(20, 3)
    both = np.concatenate([shapes, shapes])
    mass = np.repeat([1.0, 10.0], 20)
    weighted = kinetic_weighted(both, mass)
    xyz = np.zeros((40, 3))
    assert (select_points(weighted, xyz, 6) >= 20).all()
    energy = (weighted[20:] ** 2).sum() / (weighted**2).sum()
    assert energy == pytest.approx(10 / 11)


def test_auto_mac_points_come_close_to_the_best_there_are() -> None:
    shapes = random(12, 1, 3, seed=3)
    best = min(worst(shapes, np.array(c)) for c in combinations(range(12), 5))
    got = worst(shapes, auto_mac_points(shapes, 5))
    assert got >= best - 1e-12
    assert got < best + 0.05
    assert got <= worst(shapes, select_points(shapes, np.zeros((12, 3)), 5)) + 1e-12
    with pytest.raises(InputError, match="ask for"):
        auto_mac_points(shapes, 2)


def test_gain_is_the_difference_of_log_determinants() -> None:
    for r, k in ((2, 5), (7, 3)):  # both ways round
        aim = Aim(random(6, r, k), 0.5 * np.eye(k))
        now = informed(aim, np.array([4]))
        direct = [np.linalg.slogdet(informed(aim, np.array([4, i])))[1] for i in range(6)]
        np.testing.assert_allclose(
            gains(aim, now), np.array(direct) - np.linalg.slogdet(now)[1], rtol=1e-9
        )


def test_greedy_information_reaches_what_theory_promises() -> None:
    aim = mode_aim(random(10, 1, 4, seed=5))

    def value(at: tuple[int, ...]) -> float:
        return float(
            np.linalg.slogdet(informed(aim, np.array(at)))[1] - np.linalg.slogdet(aim.prior)[1]
        )

    best = max(value(c) for c in combinations(range(10), 4))
    got = value(tuple(greedy_logdet([aim], 4).tolist()))
    assert (1 - 1 / np.e) * best < got <= best * (1 + 1e-12)


def test_costs_and_budget() -> None:
    shapes = random(10, 1, 3, seed=6)
    cost = np.ones(10)
    cost[greedy_logdet([mode_aim(shapes)], 1)[0]] = 5.0
    cheap = greedy_logdet([mode_aim(shapes)], 8, cost=cost, budget=4.0)
    assert cheap.size == 4
    assert cost[cheap].sum() == 4.0
    with pytest.raises(InputError, match="lower min_distance"):
        greedy_logdet([mode_aim(shapes)], 8, xyz=np.zeros((10, 3)), min_distance=0.1)


def test_parameters_draw_points_to_where_shapes_tell_of_them() -> None:
    """Only point 8 moves with the parameter in a way that the scale of the shape does not
    explain.
    """
    shapes = np.ones((10, 1, 1))
    slope = 3.0 * shapes[..., None].copy()
    modes_alone = parameter_aim(shapes, slope, np.ones(1))
    np.testing.assert_allclose(modes_alone.rows, 0, atol=1e-12)
    slope[8] += 1.0
    aim = parameter_aim(shapes, slope, np.ones(1))
    assert greedy_logdet([mode_aim(shapes), aim], 1).tolist() == [8]
    known = parameter_aim(shapes, slope, np.ones(1), relative=np.ones((1, 1)), frequency_std=0.01)
    assert known.prior[0, 0] == pytest.approx(1 + (1 / 0.02) ** 2)


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
            gram - np.einsum("ndi,ndj->ij", some[list(c)], some[list(c)]), gram, eigvals_only=True
        )[0]
        for c in combinations(range(9), 3)
    )
    loss = worst_sensor_loss(some, 3)
    assert loss.exact
    assert loss.left == pytest.approx(left, rel=1e-9)
    # the combination that suffers keeps just that share
    q = loss.combination
    kept = np.delete(some, loss.points, axis=0)
    assert ((kept @ q) ** 2).sum() / ((some @ q) ** 2).sum() == pytest.approx(left, rel=1e-9)


def test_redundant_layouts_survive_any_loss() -> None:
    shapes, _ = string(59, 4)
    few = select_points(shapes, np.zeros((59, 3)), 4)
    assert worst_sensor_loss(shapes[few], 1).left < 1e-9
    safe = add_redundancy(shapes, few, 2, least=0.2)
    assert safe[:4].tolist() == few.tolist()
    for c in combinations(range(safe.size), 2):
        assert np.linalg.matrix_rank(np.delete(shapes[safe, 0], c, axis=0), tol=1e-6) == 4
    assert worst_sensor_loss(shapes[safe], 2).left >= 0.2
    with pytest.raises(InputError, match="allow more points or"):
        add_redundancy(shapes, few, 2, most=5)


def test_points_added_for_redundancy_keep_their_distance() -> None:
    shapes, xyz = string(59, 4)
    few = select_points(shapes, xyz, 4, min_distance=0.08)
    close = xyz[add_redundancy(shapes, few, 2), 0]
    assert np.diff(np.sort(close)).min() < 0.08
    apart = add_redundancy(shapes, few, 2, xyz=xyz, min_distance=0.08)
    assert np.diff(np.sort(xyz[apart, 0])).min() > 0.08
    assert worst_sensor_loss(shapes[apart], 2).left >= 0.1
    with pytest.raises(InputError, match=r"a distance below 0\.2 m"):
        add_redundancy(shapes, few, 3, xyz=xyz, min_distance=0.2)


def test_layouts_that_cannot_tell_modes_apart_have_nothing_to_lose() -> None:
    shapes, _ = string(59, 4)
    assert worst_sensor_loss(shapes[[0, 1, 58]], 1).left == 0.0
    assert worst_sensor_loss(shapes[:3], 1).points.size == 0
    assert worst_sensor_loss(shapes[add_redundancy(shapes, np.array([3, 9, 20]), 1)], 1).left >= 0.1


def test_candidates_by_sets_boxes_and_exclusions() -> None:
    nodes = np.arange(1, 11)
    xyz = np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)])
    assert select_candidates(nodes, xyz).all()
    keep = select_candidates(
        nodes,
        xyz,
        sets=[[1, 2]],
        boxes=[[8, 1, 1, 4, -1, -1]],
        exclude=[6],
        keep_out=[[7, 0, 0, 7.5, 0, 0]],
    )
    assert nodes[keep].tolist() == [1, 2, 5, 7, 9]
    with pytest.raises(InputError, match=r"not there: \[99\]"):
        select_candidates(nodes, xyz, sets=[[99]])
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


def test_places_coincide_with_nodes() -> None:
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    at, gap = nearest_nodes(np.array([[1.9, 0, 0], [0.0, 0.2, 0]]), xyz)
    assert at.tolist() == [2, 0]
    np.testing.assert_allclose(gap, [0.1, 0.2])
    with pytest.raises(InputError, match="same nearest node"):
        nearest_nodes(np.array([[0.1, 0, 0], [0.2, 0, 0]]), xyz)
    with pytest.raises(InputError, match=r"0\.2 m from the nearest node"):
        nearest_nodes(np.array([[0.0, 0.2, 0]]), xyz, tolerance=0.1)


def test_layout_over_the_prior() -> None:
    """A string whose modes swap places and sign with the parameter: the samples stay in the nominal
    order.
    """
    from types import SimpleNamespace

    from ringtrue.core.parameters import Parameter, ParameterSet

    shapes = string(19, 3)[0][:, 0]
    two = ParameterSet((Parameter("a", std=0.5),))

    def modes(x: Array) -> SimpleNamespace:
        return SimpleNamespace(
            shapes=shapes if x[0] == 0 else -shapes[:, [1, 0, 2]] * (1 + 0.1 * x[0])
        )

    model = SimpleNamespace(parameters=two, modes=modes)
    samples = prior_shapes(model, 4, np.random.default_rng(0))  # type: ignore[arg-type]
    assert samples.shape == (5, 19, 3)
    for s in samples:
        ratio = s / shapes
        np.testing.assert_allclose(ratio, np.broadcast_to(ratio[0], ratio.shape), rtol=1e-9)
        assert (ratio > 0).all()
    got = prior_auto_mac(samples[:, :, None, :], np.array([3, 8, 14]))
    np.testing.assert_allclose(got, worst(shapes[:, None], np.array([3, 8, 14])), rtol=1e-9)
