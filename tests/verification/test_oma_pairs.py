"""Pairs of equal frequency in ambient records: a record that cannot separate them says so."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identify.ambient import AmbientResult, identify_ambient

RATE, DAMPING = 50.0, 0.01


def identified(frequencies: tuple[float, ...], seconds: float = 600.0) -> AmbientResult:
    """Accelerations of modes under independent white forces at six sensors, exact for forces held over a sample."""
    rng = np.random.default_rng(0)
    shapes = np.random.default_rng(99).standard_normal((6, len(frequencies)))
    y = np.zeros((6, int(RATE * seconds)))
    for phi, f in zip(shapes.T, frequencies, strict=True):
        w = 2 * np.pi * f
        a = np.array([[0.0, 1.0], [-(w**2), -2 * DAMPING * w]])
        ad, b, c, d, _ = cont2discrete((a, np.array([[0.0], [1.0]]), a[1:], np.eye(1)), 1 / RATE)
        top = np.poly(ad - b @ c) + (d[0, 0] - 1) * np.poly(ad)
        y += np.outer(phi, lfilter(top, np.poly(ad), rng.standard_normal(y.shape[1])))
    y += 0.02 * y.std() * rng.standard_normal(y.shape)
    return identify_ambient(TimeHistory(y, RATE, tuple(Channel(f"{i}+Z", "acceleration", "m/s^2") for i in range(6))))


def said(result: AmbientResult) -> list[str]:
    return [n for n in result.notes if "closer than this record can separate" in n]


def test_an_equal_pair_is_reported_or_said():
    result = identified((5.0, 5.0, 8.0))
    assert result.modes.frequencies[-1] == pytest.approx(8.0, rel=5e-3)
    here = np.abs(result.modes.frequencies / 5.0 - 1) < 0.01
    assert here.any() or len(said(result)) == 1


def test_separate_modes_are_not_called_a_pair():
    result = identified((3.0, 5.0, 5.15, 8.0))
    assert len(result.modes) == 4
    assert not said(result)
