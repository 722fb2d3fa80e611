"""Where to measure and hit, and for how long: known optima of a bar and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.errors import InputError
from ringtrue.planning.exciters import (
    ambient_std,
    frf_averages,
    reached,
    resolution,
    select_references,
)
from ringtrue.planning.geometry import spacing_of_points
from ringtrue.planning.sensors import (
    Spacing,
    independence,
    lower_auto_mac,
    select_points,
)
from ringtrue.shapes import auto_mac, worst_off_diagonal


def string(n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Modes of a taut string at n inner points: (n, 1, m) and positions (n, 3)."""
    s = np.arange(1, n + 1) / (n + 1)
    xyz = np.stack([s, 0 * s, 0 * s], axis=1)
    return np.sin(np.pi * np.outer(s, np.arange(1, m + 1)))[:, None, :], xyz


def test_independence_sums_to_the_number_of_modes() -> None:
    rng = np.random.default_rng(0)
    shapes = rng.standard_normal((20, 3, 7))
    share = independence(shapes)
    assert share.sum() == pytest.approx(7)
    np.testing.assert_allclose(independence(2 * shapes), share, rtol=1e-10)


def test_chosen_points_tell_the_modes_apart() -> None:
    shapes, xyz = string(59, 4)
    at = select_points(shapes, xyz, 4)
    assert np.unique(at).size == 4
    # as many points as modes: well conditioned, far better than four neighbours
    assert np.linalg.cond(shapes[at, 0]) < 2
    assert worst_off_diagonal(auto_mac(shapes[at, 0])) < 0.1


def test_fixed_points_stay_and_distances_hold() -> None:
    shapes, xyz = string(59, 4)
    fixed = np.zeros(59, dtype=bool)
    fixed[7] = True
    at = select_points(shapes, xyz, 6, fixed=fixed, min_distance=0.1)
    assert 7 in at
    assert np.diff(np.sort(xyz[at, 0])).min() > 0.1
    # more than are asked for, and nearer to each other than others may be
    fixed[:5] = True
    assert select_points(shapes, xyz, 4, fixed=fixed, min_distance=0.1).tolist() == [
        0,
        1,
        2,
        3,
        4,
        7,
    ]
    with pytest.raises(InputError, match="lower min_distance"):
        select_points(shapes, xyz, 20, min_distance=0.2)
    with pytest.raises(InputError, match="cannot distinguish 4 modes"):
        select_points(shapes, xyz, 3)


def test_selection_does_not_depend_on_the_order_of_candidates() -> None:
    rng = np.random.default_rng(1)
    shapes, xyz = rng.standard_normal((40, 3, 5)), rng.standard_normal((40, 3))
    mix = rng.permutation(40)
    plain, mixed = (
        select_points(shapes, xyz, 6),
        select_points(shapes[mix], xyz[mix], 6),
    )
    assert set(plain.tolist()) == set(mix[mixed].tolist())


def test_points_are_added_until_the_auto_mac_is_low() -> None:
    shapes, _ = string(59, 4)
    poor = np.array([27, 28, 29, 30])
    assert worst_off_diagonal(auto_mac(shapes[poor, 0])) > 0.9
    at = lower_auto_mac(shapes, poor, 0.1, 20)
    assert set(poor.tolist()) <= set(at.tolist())
    assert at.size < 20
    assert worst_off_diagonal(auto_mac(shapes[at, 0])) <= 0.1
    assert lower_auto_mac(shapes, poor, 0.0, 6).size == 6


def test_additions_that_hardly_lower_the_auto_mac_are_left_out() -> None:
    """Near its end a string moves alike in modes 1 and 2: no number of points there tells them
    apart.
    """
    shapes, _ = string(59, 2)
    end, start = shapes[:15], np.array([0, 1, 2])
    many = lower_auto_mac(end, start, 0.25, 12)
    few = lower_auto_mac(end, start, 0.25, 12, worth=0.02)
    worst = [worst_off_diagonal(auto_mac(end[at, 0])) for at in (many, few)]
    assert worst[0] > 0.25
    assert few.size < many.size == 12
    assert worst[1] <= worst[0] + 0.02
    reached = lower_auto_mac(shapes, start, 0.25, 12, worth=0.02)
    assert worst_off_diagonal(auto_mac(shapes[reached, 0])) <= 0.25


def test_additions_keep_their_distance() -> None:
    shapes, xyz = string(59, 4)
    poor = np.array([0, 1, 2, 3, 4])
    at = lower_auto_mac(shapes, poor, 0.0, 40, spacing=Spacing(xyz, 0.1))
    new = xyz[np.setdiff1d(at, poor), 0]
    assert 5 < at.size <= 5 + 9  # what the string has room for
    assert np.diff(np.sort(np.append(new, xyz[4, 0]))).min() > 0.1


def test_half_the_even_spacing_of_a_plate_is_always_possible() -> None:
    """A unit square keeps nine points 1/2 apart, its corners, middles of edges and centre."""
    x, y = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    xyz = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    assert spacing_of_points(xyz, 9) == pytest.approx(0.25, rel=0.1)
    assert spacing_of_points(xyz, 1) == 0.0
    rng = np.random.default_rng(5)
    for count in (4, 9, 25, 70):  # scores that would cluster at random places
        near = np.exp(-5 * np.abs(xyz - rng.uniform(size=3)).max(axis=1))
        shapes = rng.standard_normal((len(xyz), 1, 3)) * near[:, None, None]
        apart = spacing_of_points(xyz, count)
        at = select_points(shapes, xyz, count, min_distance=apart)
        gap = np.linalg.norm(xyz[at, None] - xyz[at], axis=2) + np.eye(count)
        assert at.size == count
        assert gap.min() > apart


def test_hammer_points_avoid_the_nodes_of_the_modes() -> None:
    shapes, _ = string(59, 4)
    phi = shapes[:, 0]
    one = select_references(phi, 1)
    middle = 29  # where half of the modes have a node
    assert reached(phi, one).min() > 0.2
    assert reached(phi, np.array([middle])).min() < 1e-12
    two = select_references(phi, 2)
    assert two[0] == one[0]
    assert (reached(phi, two) >= reached(phi, one)).all()


def test_resolution_closed_forms() -> None:
    f, z = ambient_std(np.array([2.0]), 0.01, 600.0)
    assert f[0] == pytest.approx(np.sqrt(0.01 / (2 * np.pi * 2 * 600)))
    assert z[0] == pytest.approx(np.sqrt(1 / (2 * np.pi * 0.01 * 2 * 600)))
    r = resolution(np.array([2.0, 40.0]), 0.01, precision=0.1)
    assert r.step == pytest.approx(
        0.25 * 2 * 0.01 * 2.0
    )  # a quarter of the half-power bandwidth 2ζf
    # after one block the slowest mode has decayed to 1 %
    assert np.exp(-0.01 * 2 * np.pi * 2.0 * r.block) <= 0.01 * (1 + 1e-9)
    assert r.std_damping[0] <= 0.1
    assert r.std_damping[1] < r.std_damping[0]


def test_averages_give_the_wanted_error_of_an_frf() -> None:
    """Against the scatter of H1 over simulated averages."""
    rng = np.random.default_rng(0)
    n = frf_averages(0.1, 0.8)
    force, noise = (rng.standard_normal((20_000, n, 2)) @ [1, 1j] for _ in range(2))
    response = force + np.sqrt(1 / 0.8 - 1) * noise  # |H| = 1, coherence 0.8
    h = np.abs((response * force.conj()).sum(axis=1) / (np.abs(force) ** 2).sum(axis=1))
    assert h.std() == pytest.approx(0.1, rel=0.1)  # the formula holds for many averages
    assert frf_averages(0.05, 0.98) == 5
    assert frf_averages(0.5, 0.99) == 1


def test_an_addition_is_the_best_of_all() -> None:
    rng = np.random.default_rng(4)
    shapes = rng.standard_normal((300, 3, 30))
    shapes[:, :, 29] = 0.0  # a mode that nothing moves in
    first = np.arange(11)
    (added,) = np.setdiff1d(lower_auto_mac(shapes, first, 0.0, 12), first)
    worst = [
        worst_off_diagonal(auto_mac(shapes[[*first, k]].reshape(-1, 30)[:, :29]))
        if k not in first
        else np.inf
        for k in range(300)
    ]
    assert added == np.argmin(worst)
