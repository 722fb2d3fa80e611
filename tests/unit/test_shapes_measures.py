"""MAC, subspaces, complexity and scaling of shapes: closed forms and invariances."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import InputError
from ringtrue.shapes import (
    auto_mac,
    close_groups,
    mac,
    mcf,
    mean_phase,
    modal_scale_factor,
    mpc,
    mpd,
    paired_mac,
    principal_angles,
    realise,
    realise_modes,
    rotation,
    subspace_mac,
    worst_off_diagonal,
)

ROUND = 1e-12  # rounding only


def some(rng: np.random.Generator, n: int, m: int) -> np.ndarray:
    return rng.standard_normal((n, m)) + 1j * rng.standard_normal((n, m))


def test_mac_is_the_squared_cosine() -> None:
    angle = np.deg2rad([0, 30, 60, 90])
    b = np.stack([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(
        mac(np.array([[1.0], [0.0]]), b)[0], [1, 0.75, 0.25, 0], atol=ROUND
    )


def test_mac_is_blind_to_scale_and_phase_but_not_to_conjugation() -> None:
    rng = np.random.default_rng(1)
    a, b = some(rng, 7, 3), some(rng, 7, 2)
    turned = a * np.array([2.0, -3j, 0.1 + 0.2j])
    np.testing.assert_allclose(mac(turned, b), mac(a, b), rtol=1e-12)
    np.testing.assert_allclose(paired_mac(turned, a), 1, rtol=1e-12)
    assert mac(a.conj(), a)[0, 0] < 0.9


def test_mac_of_a_zero_shape_is_zero_and_rows_must_agree() -> None:
    assert mac(np.zeros((3, 1)), np.ones((3, 1)))[0, 0] == 0
    with pytest.raises(InputError, match="same channels"):
        mac(np.ones((3, 1)), np.ones((4, 1)))


def test_worst_off_diagonal() -> None:
    a = np.array([[1.0, 1.0], [0.0, 1.0]])
    assert worst_off_diagonal(auto_mac(a)) == pytest.approx(0.5)
    assert worst_off_diagonal(auto_mac(a[:, :1])) == 0


def test_principal_angles_small_and_large() -> None:
    a = np.eye(4)[:, :2]
    t = 1e-9  # far below what the arc cosine resolves
    b = np.stack(
        [[np.cos(t), 0, np.sin(t), 0], [0, np.cos(1.2), 0, np.sin(1.2)]], axis=1
    )
    np.testing.assert_allclose(principal_angles(a, b), [t, 1.2], rtol=1e-6)
    np.testing.assert_allclose(principal_angles(b[:, :1], a), [t], rtol=1e-6)


def test_subspace_mac_and_rotation_undo_a_rotated_pair() -> None:
    rng = np.random.default_rng(2)
    b = rng.standard_normal((9, 2))
    c, s = np.cos(0.7), np.sin(0.7)
    a = b @ np.array([[c, -s], [s, c]]) * np.array([5.0, -0.1])
    assert paired_mac(a, b).max() < 0.9
    np.testing.assert_allclose(subspace_mac(a, b), 1, rtol=1e-12)
    t = rotation(a, b)
    np.testing.assert_allclose(t.T @ t, np.eye(2), atol=ROUND)
    np.testing.assert_allclose(paired_mac(a, b @ t), 1, rtol=1e-10)


def test_subspace_mac_of_one_shape_is_the_mac() -> None:
    rng = np.random.default_rng(3)
    a, b = some(rng, 6, 4), some(rng, 6, 1)
    np.testing.assert_allclose(subspace_mac(a, b), mac(a, b)[:, 0], rtol=1e-12)


def test_close_groups_split_long_chains_at_the_widest_gap() -> None:
    f = np.array([10.0, 20.0, 10.1, 50.0, 50.4, 51.0, 51.2])
    assert set(map(frozenset, close_groups(f, 0.02, 3))) == {
        frozenset(g) for g in ({0, 2}, {1}, {3, 4}, {5, 6})
    }
    assert close_groups(np.zeros(0), 0.02) == ()


def test_complexity_of_real_circular_and_elliptic_shapes() -> None:
    real = np.array([1.0, -2.0, 0.5, 0.3])
    circle = np.exp(2j * np.pi * np.arange(64) / 64)
    ellipse = circle.real + 0.5j * circle.imag
    z = np.stack([np.resize(real, 64) * np.exp(0.4j), circle, ellipse], axis=1)
    np.testing.assert_allclose(mpc(z), [1, 0, (0.75 / 1.25) ** 2], atol=1e-12)
    assert mcf(z)[0] == pytest.approx(0, abs=1e-12)
    # polygon of 64 corners inscribed in the unit circle
    polygon = 64 * np.sin(2 * np.pi / 64) / 2 / np.pi
    np.testing.assert_allclose(mcf(z)[1:], [polygon, polygon / 2], rtol=1e-12)
    assert mpd(z)[0] == pytest.approx(0, abs=1e-12)
    assert mpd(z)[1] == pytest.approx(
        np.pi / 4, rel=1e-3
    )  # mean of |angle| folded to 0..π/2, 64 points
    assert abs(mean_phase(z)[0]) == pytest.approx(0.4)


def test_modal_scale_factor() -> None:
    rng = np.random.default_rng(4)
    b = some(rng, 5, 2)
    np.testing.assert_allclose(
        modal_scale_factor(b * [2, -3j], b), [2, -3j], rtol=1e-12
    )


def test_realise_recovers_a_real_shape_at_any_phase() -> None:
    rng = np.random.default_rng(5)
    real = rng.standard_normal((8, 3))
    got = realise(real * np.exp(1j * np.array([0.3, 2.0, -1.4])))
    assert got.dtype == np.float64
    np.testing.assert_allclose(np.abs(got), np.abs(real), rtol=1e-10)
    np.testing.assert_allclose(paired_mac(got, real), 1, rtol=1e-12)


def test_realised_modes_have_no_scale_of_complex_ones() -> None:
    z = ModeSet(
        np.ones(1), np.ones(1), np.array([[1j], [2j]]), ("a", "b"), Norm.MODAL_A
    )
    assert realise_modes(z).norm is Norm.UNSCALED
    assert not np.iscomplexobj(realise_modes(z).shapes)
