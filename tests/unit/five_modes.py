"""Five modes of 1 to 2 % between 2 and 10 Hz under forces of their own, seven sensors, noise 30 dB
below.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory

RATE, SECONDS = 100.0, 600
F, Z = np.array([2.2, 3.7, 4.1, 6.9, 9.4]), np.array([0.012, 0.008, 0.015, 0.01, 0.02])
PHI = np.linalg.qr(np.random.default_rng(14).standard_normal((7, 5)))[0]


@cache
def motion() -> np.ndarray:
    rng = np.random.default_rng(3)
    y = np.zeros((7, int(RATE * SECONDS)))
    for phi, f, z in zip(PHI.T, F, Z, strict=True):
        s = 2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2))
        q = lfilter(
            [1.0],
            [1.0, -np.exp(s / RATE)],
            rng.standard_normal(y.shape[1]).astype(complex),
        )
        y += np.outer(phi, (s * q).imag)
    return y + 0.03 * y.std() * rng.standard_normal(y.shape)


def record(y: np.ndarray) -> TimeHistory:
    return TimeHistory(
        y,
        RATE,
        tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(len(y))),
        "made",
    )
