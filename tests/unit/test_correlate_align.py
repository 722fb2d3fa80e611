"""A test geometry turned, shifted and scaled is laid back onto the model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.sensor_mapping import best_fit, nearest_fit
from ringtrue.errors import InputError


def body(rng: np.random.Generator) -> np.ndarray:
    """Nodes of a box with a tower off its middle: no symmetry."""
    box = rng.uniform(0, [4, 2, 1], (1500, 3))
    tower = rng.uniform([3, 1.2, 1], [3.6, 1.9, 3], (500, 3))
    return np.concatenate([box, tower])


def away(
    xyz: np.ndarray, rng: np.random.Generator, scale: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points elsewhere, and the rotation that brings them back."""
    turn = Rotation.random(rng=rng).as_matrix()
    return (xyz - rng.uniform(-5, 5, 3)) @ turn / scale, turn


def test_named_points_with_noise_and_scale() -> None:
    rng = np.random.default_rng(0)
    nodes = body(rng)[:40]
    test, turn = away(nodes, rng, 1e3)
    fit = best_fit(test, nodes, scale=True)
    assert fit.scale == pytest.approx(1e3)
    np.testing.assert_allclose(fit.rotation, turn, atol=1e-9)
    np.testing.assert_allclose(fit(test), nodes, atol=1e-8)
    assert fit.used.all()


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_gross_errors_are_set_aside(share: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):  # over tests
        nodes = body(rng)[:40]
        test, turn = away(nodes + 0.005 * rng.standard_normal((40, 3)), rng)
        wrong = rng.permutation(40)[: int(40 * share)]
        test[wrong] += rng.uniform(-3, 3, (wrong.size, 3))
        fit = best_fit(test, nodes)
        assert np.linalg.norm(fit.rotation - turn) < 0.02
        assert fit.used[np.setdiff1d(np.arange(40), wrong)].mean() > 0.7
        assert fit.rms < 0.02
        assert not fit.used[wrong][fit.residual[wrong] > 0.1].any()


def test_no_mirror_image() -> None:
    flat = np.random.default_rng(2).uniform(0, 1, (12, 3)) * [1, 1, 0]
    fit = best_fit(flat, flat * [1, -1, 1])
    assert np.linalg.det(fit.rotation) == pytest.approx(1)


def test_nearest_points_from_anywhere() -> None:
    rng = np.random.default_rng(3)
    for _ in range(2):  # over tests
        nodes = body(rng)
        test, turn = away(
            nodes[rng.permutation(2000)[:120]] + 0.01 * rng.standard_normal((120, 3)),
            rng,
        )
        test[:4] += 2.0
        fit = nearest_fit(test, nodes)
        assert np.linalg.norm(fit.rotation - turn) < 0.03
        assert fit.rivals == 0
        assert not fit.used[:4].any()
        assert fit.used[4:].mean() > 0.95
        assert nearest_fit(nodes[::20], nodes).used.all()


def test_symmetric_geometry_has_rivals() -> None:
    """A brick comes to lie on itself by half a turn about each axis."""
    x = np.linspace(-1, 1, 9)
    brick = np.stack(np.meshgrid(3 * x, 2 * x, x), axis=-1).reshape(-1, 3)
    assert nearest_fit(brick[::7], brick).rivals == 3
    # nor do a few points decide that come to lie on others, wherever they start
    some = brick[np.random.default_rng(5).choice(len(brick), 20, replace=False)]
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert nearest_fit(some, brick).rivals >= 3
    assert nearest_fit(some @ turn.T + [1, 2, 3], brick).rivals >= 3


def test_moving_a_test_model() -> None:
    rng = np.random.default_rng(4)
    nodes = body(rng)[:6]
    test, turn = away(nodes, rng)
    model = TestModel(
        np.arange(6),
        test,
        ("a", "b"),
        np.array([0, 3]),
        np.eye(3)[:2],
        np.zeros((0, 2), dtype=np.int64),
    )
    moved = best_fit(test, nodes).move(model)
    np.testing.assert_allclose(moved.xyz, nodes, atol=1e-9)
    np.testing.assert_allclose(moved.axes, turn.T[:2], atol=1e-9)


def test_points_on_a_line_fix_nothing() -> None:
    line = np.outer(np.arange(5.0), [1, 2, 3])
    with pytest.raises(InputError, match="on a line"):
        best_fit(line, line)
    rng = np.random.default_rng(5)
    with pytest.raises(InputError, match="6 source points for 5"):
        best_fit(body(rng)[:6], body(rng)[:5])


def test_three_points_with_small_errors_are_all_used() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        source = rng.standard_normal((3, 3))
        target = source + 0.002 * rng.standard_normal((3, 3))
        fit = best_fit(source, target)
        assert fit.used.all()
        assert fit.rms < 0.01
