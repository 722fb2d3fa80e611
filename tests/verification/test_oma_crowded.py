"""A band with more modes than the usual largest order is made for: panels, satellites, engines with
many sensors.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient import band_modes
from ringtrue.identification.ambient.pipeline import AmbientSettings, identify_ambient
from ringtrue.shapes import mac

RATE, SECONDS, CHANNELS = 40.0, 600, 20
F = np.geomspace(3.2, 12.5, 14)
SMALL = AmbientSettings(fmin=3.0, order_max=32)  # hardly more than two for each mode


DENSE = np.linspace(8.0, 16.0, 35)  # 0.6 of the resolution of the usual lags apart


def record(
    f: np.ndarray = F, damping: float = 0.012, seconds: int = SECONDS
) -> TimeHistory:
    rng = np.random.default_rng(6)
    s = 2 * np.pi * f * (-damping + 1j)
    force = rng.standard_normal((f.size, int(RATE * seconds))).astype(complex)
    q = [
        (x * lfilter([1.0], [1.0, -np.exp(x / RATE)], p)).imag
        for x, p in zip(s, force, strict=True)
    ]
    y = shapes(f.size) @ np.array(q)
    y += 0.05 * y.std() * rng.standard_normal(y.shape)
    return TimeHistory(
        y,
        RATE,
        tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(CHANNELS)),
        "made",
    )


def shapes(modes: int) -> np.ndarray:
    return np.random.default_rng(3).standard_normal((CHANNELS, modes))


def found(
    h: TimeHistory | None = None, settings: AmbientSettings = SMALL, f: np.ndarray = F
) -> tuple[int, int]:
    """Modes that are there, and those that are not."""
    m = identify_ambient(h or record(), settings).modes
    like = (np.abs(m.frequencies[:, None] / f - 1) < 0.01) & (
        mac(m.shapes, shapes(f.size)) > 0.9
    )
    return int(like.any(axis=0).sum()), int((~like.any(axis=1)).sum())


def never(*_: object) -> bool:
    return False


def test_a_crowded_band_is_given_more_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    assert found() == (F.size, 0)
    monkeypatch.setattr(band_modes, "crowded", never)
    assert found()[0] < F.size


def test_modes_closer_than_the_lags_resolve_are_found() -> None:
    h, low = record(DENSE, 0.005, 1800), AmbientSettings(fmin=3.0)
    assert found(h, low, DENSE) == (DENSE.size, 0)
