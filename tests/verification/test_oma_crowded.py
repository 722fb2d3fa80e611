"""A band with more modes than the usual largest order is made for: panels, satellites, engines with many sensors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identify import ambient_band
from ringtrue.identify.ambient import AmbientSettings, identify_ambient
from ringtrue.shapes.mac import mac

RATE, SECONDS, CHANNELS = 40.0, 600, 20
F = np.geomspace(3.2, 12.5, 14)
SHAPES = np.random.default_rng(3).standard_normal((CHANNELS, F.size))
SMALL = AmbientSettings(fmin=3.0, order_max=38)  # little more than two for each mode


def record() -> TimeHistory:
    rng = np.random.default_rng(6)
    s = 2 * np.pi * F * (-0.012 + 1j)
    force = rng.standard_normal((F.size, int(RATE * SECONDS))).astype(complex)
    q = [(x * lfilter([1.0], [1.0, -np.exp(x / RATE)], p)).imag for x, p in zip(s, force, strict=True)]
    y = SHAPES @ np.array(q)
    y += 0.05 * y.std() * rng.standard_normal(y.shape)
    return TimeHistory(y, RATE, tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(CHANNELS)), "made")


def found() -> tuple[int, int]:
    """Modes that are there, and those that are not."""
    m = identify_ambient(record(), SMALL).modes
    like = (np.abs(m.frequencies[:, None] / F - 1) < 0.01) & (mac(m.shapes, SHAPES) > 0.9)
    return int(like.any(axis=0).sum()), int((~like.any(axis=1)).sum())


def test_a_crowded_band_is_given_more_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    assert found() == (F.size, 0)
    monkeypatch.setattr(ambient_band, "SHARES", ambient_band.SHARES[:2])
    assert found()[0] < F.size
