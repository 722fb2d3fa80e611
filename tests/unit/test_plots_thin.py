"""Fewer nodes to draw: a flat plate stays the plate."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.plots.scene import thinned
from ringtrue.plots.updating import factor_ticks
from ringtrue.study.results import Scene


def plate(n: int) -> Scene:
    """n × n nodes of the unit square, two groups of triangles, a line along one edge, and a bush
    drawn as a point.
    """
    s = np.linspace(0, 1, n)
    x, y = np.meshgrid(s, s, indexing="ij")
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    group = (x.ravel()[triangles].mean(axis=1) > 0.5).astype(np.int64)
    lines = np.concatenate([np.stack([k[0, :-1], k[0, 1:]], 1), [[5, 5]]])
    xyz = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    lgroup = np.r_[np.zeros(n - 1), 1].astype(np.int64)
    return Scene(
        100 + np.arange(n * n), xyz, triangles, group, lines, lgroup, ("left", "right")
    )


def area(s: Scene, group: int) -> float:
    a, b, c = np.moveaxis(s.xyz[s.triangles[s.triangle_group == group]], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_a_thinned_plate_keeps_its_area_and_groups() -> None:
    whole = plate(60)
    few = thinned(whole, 400)
    assert 200 < few.node.size <= 400
    assert np.isin(few.node, whole.node).all()
    np.testing.assert_array_equal(few.xyz, whole.xyz[few.node - 100])
    assert (np.diff(np.sort(few.triangles, axis=1), axis=1) > 0).all()
    for group in (0, 1):
        # a cell at the rim is drawn by a node inside it
        assert abs(area(few, group) - 0.5) < 0.06
    assert (
        few.lines[few.line_group == 1][:, 0] == few.lines[few.line_group == 1][:, 1]
    ).all()
    assert len(few.lines[few.line_group == 0]) < 59


def test_what_is_small_enough_stays() -> None:
    whole = plate(10)
    assert thinned(whole, 100) is whole


@pytest.mark.parametrize(
    ("low", "high"),
    [(0.93, 1.21), (0.999, 1.002), (0.4, 2.5), (0.05, 20.0), (3.0, 5.5), (1.0, 1.0)],
)
def test_factors_have_ticks_to_read_them_by(low: float, high: float) -> None:
    ticks = np.array(factor_ticks(low, high))
    inside = ticks[(ticks >= low * (1 - 1e-9)) & (ticks <= high * (1 + 1e-9))]
    assert min(2, 1 + (high > low)) <= inside.size <= 15
