"""Pairs of equal frequency in ambient records: two modes of a plane of shapes."""

from __future__ import annotations

import numpy as np
from scipy.linalg import subspace_angles
from scipy.signal import cont2discrete, lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import AmbientResult, identify_ambient

RATE, DAMPING = 50.0, 0.01


def response(
    phi: np.ndarray, f: float, zeta: float, rate: float, force: np.ndarray
) -> np.ndarray:
    """Accelerations (ch, sample) of a mode under a modal force (sample,) held over a sample."""
    w = 2 * np.pi * f
    a = np.array([[0.0, 1.0], [-(w**2), -2 * zeta * w]])
    ad, b, c, d, _ = cont2discrete(
        (a, np.array([[0.0], [1.0]]), a[1:], np.eye(1)), 1 / rate
    )
    top = np.poly(ad - b @ c) + (d[0, 0] - 1) * np.poly(ad)
    return np.outer(phi, lfilter(top, np.poly(ad), force))


def heard(y: np.ndarray, rate: float, rng: np.random.Generator) -> AmbientResult:
    y = y + 0.02 * y.std() * rng.standard_normal(y.shape)
    channels = tuple(Channel(f"{i}+Z", "acceleration", "m/s^2") for i in range(len(y)))
    return identify_ambient(TimeHistory(y, rate, channels))


def identified(
    frequencies: tuple[float, ...], seconds: float = 600.0, seed: int = 0
) -> AmbientResult:
    """Modes under independent white forces at six sensors."""
    rng = np.random.default_rng(seed)
    shapes = np.random.default_rng(99).standard_normal((6, len(frequencies)))
    y = np.zeros((6, int(RATE * seconds)))
    for phi, f in zip(shapes.T, frequencies, strict=True):
        y += response(phi, f, DAMPING, RATE, rng.standard_normal(y.shape[1]))
    return heard(y, RATE, rng)


def test_an_equal_pair_is_two_modes_of_one_plane():
    """The plane of the shapes is known to a degree, the turn within it is not: the deviations hold
    that.
    """
    result = identified((5.0, 5.0, 8.0), 1200.0)
    modes, std = result.modes, result.uncertainty
    np.testing.assert_allclose(modes.frequencies, [5.0, 5.0, 8.0], rtol=3e-3)
    assert (np.abs(modes.damping - DAMPING) < 3 * std.damping).all()
    true = np.random.default_rng(99).standard_normal((6, 3))[:, :2]
    assert np.degrees(subspace_angles(modes.shapes[:, :2], true)).max() < 3
    assert (std.shape[:, :2].max(axis=0) > 0.3).all()
    assert all("any turn" in x for x in result.reasons[:2])
    assert "any turn" not in result.reasons[2]


def test_separate_modes_are_not_called_a_pair():
    result = identified((3.0, 5.0, 5.15, 8.0))
    assert len(result.modes) == 4
    assert not any("any turn" in x for x in result.reasons)


def test_few_channels_have_no_planes_and_their_modes_all_the_same():
    """Any shape lies in the plane of two channels."""
    rng = np.random.default_rng(7)
    for phi in (np.ones((1, 2)), np.array([[1.0, 1.0], [0.6, -0.8]])):
        force = rng.standard_normal((2, int(RATE * 600)))
        parts = zip(phi.T, (3.0, 8.0), force, strict=True)
        result = heard(
            sum(response(x, f, DAMPING, RATE, w) for x, f, w in parts), RATE, rng
        )
        np.testing.assert_allclose(result.modes.frequencies, [3.0, 8.0], rtol=5e-3)
        assert not any("any turn" in x for x in result.reasons)


def test_the_bending_of_a_slender_tower_is_two_modes_and_no_machine():
    """Two directions, 0.3 % apart, one damped twice as much as the other, an hour of it: 1000
    cycles.

    Amplitudes of so few independent values look steady, and those of two directions together more
    so.
    """
    height = np.array([0.35, 0.6, 0.8, 1.0]) ** 2
    along, across = np.kron([1.0, 0.0], height), np.kron([0.0, 1.0], height)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        force = rng.standard_normal((2, 18000 + 3000))
        y = response(along, 0.300, 0.008, 5.0, force[0]) + response(
            across, 0.301, 0.004, 5.0, force[1]
        )
        result = heard(y[:, 3000:], 5.0, rng)
        assert len(result.modes) == 2, (seed, result.notes)
        assert (
            np.degrees(
                subspace_angles(result.modes.shapes, np.stack([along, across], axis=1))
            ).max()
            < 1
        )
