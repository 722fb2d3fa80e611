"""Exciters, suspension, loading and the wireframe: a string, a plate of springs, and systems with
known answers.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy import linalg, sparse
from scipy.sparse import csgraph

from ringtrue.errors import InputError
from ringtrue.planning import exciters, geometry
from ringtrue.planning.exciters import rank_sets, reciprocity_pairs
from ringtrue.planning.geometry import (
    drawn_mac,
    mesh_edges,
    relative_neighbours,
    wireframe,
)
from ringtrue.planning.plan_files import loaded_frequencies, quiet, suspension_points


def sines(n: int, m: int) -> np.ndarray:
    s = np.arange(1, n + 1) / (n + 1)
    return np.sqrt(2) * np.sin(np.pi * np.outer(s, np.arange(1, m + 1)))


def test_sets_are_ranked_exactly_where_they_are_few() -> None:
    phi = np.random.default_rng(0).standard_normal((9, 6))
    share = phi**2 / (phi**2).max(axis=0)
    best = max(share[list(c)].max(axis=0).min() for c in combinations(range(9), 2))
    assert rank_sets(phi, 2)[0].worst == pytest.approx(best)
    with pytest.raises(InputError, match="sets of 10 of 9"):
        rank_sets(phi, 10)


def test_a_pool_of_rows_comes_close_to_all(monkeypatch: pytest.MonkeyPatch) -> None:
    phi = np.random.default_rng(1).standard_normal((40, 5))
    best = rank_sets(phi, 3)[0].worst
    monkeypatch.setattr(exciters, "_MOST_SETS", 600)
    assert rank_sets(phi, 3)[0].worst > 0.95 * best


def test_reciprocity_needs_both_ways() -> None:
    assert reciprocity_pairs(("1+Z", "2+Z", "9+Z"), ("1+Z", "2+Z", "3+Z")) == (
        ("1+Z", "2+Z"),
    )


def test_a_free_beam_hangs_where_its_modes_have_nodes() -> None:
    """First bending mode of a free beam: nodes at 0.2242 of the length from the ends (Blevins
    1979).
    """
    x = np.linspace(0, 1, 401)
    k = 4.730040744862704
    sigma = (np.cosh(k) - np.cos(k)) / (np.sinh(k) - np.sin(k))
    y = np.cosh(k * x) + np.cos(k * x) - sigma * (np.sinh(k * x) + np.sin(k * x))
    shapes = y[:, None, None]
    xyz = np.column_stack([x, 0 * x, 0 * x])
    hung = suspension_points(shapes, xyz, 2, np.array([0.5, 0, 0]), min_distance=0.2)
    np.testing.assert_allclose(x[hung.points], [0.2242, 0.7758], atol=0.003)
    assert hung.motion < 1e-4
    assert quiet(shapes)[0] == pytest.approx(1.0)


def test_the_centre_of_gravity_hangs_between_the_points() -> None:
    """On a square grid the quietest corner points lie to one side; the set chosen encloses the
    centre.
    """
    g = np.linspace(0, 1, 5)
    xyz = np.array([[a, b, 0.0] for a in g for b in g])
    motion = (0.1 + xyz[:, 0])[:, None, None]
    hung = suspension_points(
        motion, xyz, 3, np.array([0.5, 0.5, 0.3]), min_distance=0.3
    )
    assert hung.steady
    a, b, c = xyz[hung.points][:, :2] - 0.5
    turns = [
        a[0] * b[1] - a[1] * b[0],
        b[0] * c[1] - b[1] * c[0],
        c[0] * a[1] - c[1] * a[0],
    ]
    assert min(turns) >= -1e-12 or max(turns) <= 1e-12
    with pytest.raises(InputError, match="lower min_distance"):
        suspension_points(motion, xyz, 3, np.zeros(3), min_distance=5.0)


def test_mass_loading_is_exact_with_all_modes() -> None:
    rng = np.random.default_rng(3)
    a = rng.standard_normal((6, 6))
    K, M = a @ a.T + 6 * np.eye(6), np.diag(rng.uniform(1, 2, 6))
    lam, phi = linalg.eigh(K, M)
    f = np.sqrt(lam) / (2 * np.pi)
    added = np.array([0.3, 0, 0, 0.1, 0, 0])
    want = np.sqrt(linalg.eigh(K, M + np.diag(added), eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(
        loaded_frequencies(f, phi[:, None, :], added), want, rtol=1e-10
    )
    small = loaded_frequencies(f, phi[:, None, :], 1e-6 * added) / f - 1
    np.testing.assert_allclose(small, -0.5e-6 * (added @ phi**2), rtol=1e-3)
    with pytest.raises(InputError, match=">= 0"):
        loaded_frequencies(f, phi[:, None, :], -added)


def grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A square of n x n nodes in triangles."""
    xyz = np.array([[i, j, 0.0] for j in range(n) for i in range(n)])
    low = np.array([i + n * j for j in range(n - 1) for i in range(n - 1)])
    tri = np.concatenate(
        [
            np.column_stack([low, low + 1, low + n + 1]),
            np.column_stack([low, low + n + 1, low + n]),
        ]
    )
    return xyz, mesh_edges(tri, np.zeros((0, 2), dtype=int))


def test_edges_are_those_of_the_grid() -> None:
    _, edges = grid(4)
    assert len(edges) == 2 * 4 * 3 + 9
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert (edges[:, 0] < edges[:, 1]).all()


def test_the_wireframe_follows_the_mesh_and_not_the_air() -> None:
    """A horseshoe: its ends are near in space and far along the mesh."""
    t = np.linspace(0.1, 2 * np.pi - 0.1, 60)
    xyz = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    edges = np.column_stack([np.arange(59), np.arange(1, 60)])
    lines = wireframe(xyz, edges, np.array([0, 20, 40, 59]))
    assert lines.tolist() == [[0, 1], [1, 2], [2, 3]]


def test_a_part_of_the_mesh_that_no_point_sits_on_has_no_lines() -> None:
    xyz = np.array([[x, 0.0, z] for z in (0.0, 5.0) for x in (0.0, 1.0, 2.0)])
    edges = np.array([[0, 1], [1, 2], [3, 4], [4, 5]])
    assert wireframe(xyz, edges, np.array([0, 2])).tolist() == [[0, 1]]


def test_the_wireframe_of_a_plate_is_its_grid() -> None:
    xyz, edges = grid(9)
    chosen = np.array([i + 9 * j for j in (0, 4, 8) for i in (0, 4, 8)])
    lines = {tuple(x) for x in wireframe(xyz, edges, chosen).tolist()}
    sides = {(a, a + 1) for a in (0, 1, 3, 4, 6, 7)} | {(a, a + 3) for a in range(6)}
    assert sides <= lines
    assert lines - sides <= {
        (0, 4),
        (1, 5),
        (3, 7),
        (4, 8),
    }  # diagonals along the edges of the mesh
    with pytest.raises(InputError, match="3 positions, 2 different"):
        wireframe(xyz, edges, np.array([0, 4, 4]))


def test_a_line_that_cuts_through_the_air_is_left_out_unless_nothing_else_holds_the_drawing_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A trough: floor and two walls; a line from wall to wall over the floor is straight in the air
    only.
    """
    y, z = (
        np.r_[np.zeros(4), np.arange(1, 4), np.full(4, 4.0)],
        np.r_[3.0, 2, 1, 0, 0, 0, 0, 0, 1, 2, 3],
    )
    x = np.arange(7)
    xyz = np.array([[a, b, c] for a in x for b, c in zip(y, z, strict=True)])
    at = np.arange(xyz.shape[0]).reshape(7, 11)
    pairs = [
        np.stack([p.ravel(), q.ravel()], 1)
        for p, q in ((at[:-1], at[1:]), (at[:, :-1], at[:, 1:]))
    ]
    edges = np.concatenate(pairs)
    chosen = at[[0, 0, 3, 3, 6, 6], [0, 10, 0, 10, 0, 10]]  # on the tops of both walls
    lines = {tuple(v) for v in wireframe(xyz, edges, chosen).tolist()}
    along = {(0, 2), (2, 4), (1, 3), (3, 5)}
    assert along <= lines
    assert len(lines - along) == 1  # one way over the floor joins the walls
    monkeypatch.setattr(geometry, "BEND", np.inf)
    every = {tuple(v) for v in wireframe(xyz, edges, chosen).tolist()}
    assert lines < every


def test_neighbours_hold_each_part_together_and_join_no_two_parts() -> None:
    rng = np.random.default_rng(4)
    xyz = rng.uniform(size=(60, 3))
    groups = ["frame"] * 25 + ["vessel"] * 34 + ["alone"]
    lines = relative_neighbours(xyz, groups)
    graph = sparse.coo_array((np.ones(len(lines)), tuple(lines.T)), shape=(60, 60))
    count, part = csgraph.connected_components(graph, directed=False)
    assert count == 3
    assert len({(g, int(k)) for g, k in zip(groups, part, strict=True)}) == 3
    ladder = np.array([[a, b, 0.0] for a in range(4) for b in (0.0, 1.0)])
    want = {(2 * a, 2 * a + 1) for a in range(4)} | {(k, k + 2) for k in range(6)}
    assert {tuple(v) for v in relative_neighbours(ladder, ["l"] * 8).tolist()} == want
    assert relative_neighbours(ladder[:1], ["l"]).shape == (0, 2)


def test_drawings_show_slow_modes_and_hide_fast_ones() -> None:
    n = 61
    xyz = np.column_stack([np.linspace(0, 1, n), np.zeros(n), np.zeros(n)])
    edges = np.column_stack([np.arange(n - 1), np.arange(1, n)])
    shapes = np.cos(np.pi * np.outer(xyz[:, 0], [1, 2, 12]))[:, None, :]
    chosen = np.arange(0, n, 10)  # six spans: the twelfth mode moves all points alike
    quality = drawn_mac(xyz, edges, chosen, shapes)
    assert quality[0] > 0.98
    assert quality[1] > 0.95
    assert quality[2] < 0.05
    # between the points the drawing is straight
    straight = np.interp(xyz[:, 0], xyz[chosen, 0], shapes[chosen, 0, 0])
    want = (
        (straight @ shapes[:, 0, 0]) ** 2
        / (straight @ straight)
        / (shapes[:, 0, 0] @ shapes[:, 0, 0])
    )
    assert quality[0] == pytest.approx(want)
    np.testing.assert_allclose(drawn_mac(xyz, edges, np.arange(n), shapes), 1.0)
