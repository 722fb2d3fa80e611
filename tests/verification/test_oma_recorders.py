"""What a recorder does to an ambient record: the edge of its filter is no mode, a mode near it
stays one.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import firwin, lfilter, upfirdn

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.identification.methods import filter_edges, identify_ambient_by

RATE, F, Z = 50.0, np.array([1.4, 2.5, 4.6, 7.8]), np.array([0.06, 0.09, 0.12, 0.08])


def accelerations(
    f: np.ndarray, z: np.ndarray, channels: int, seconds: float, rate: float
) -> np.ndarray:
    """Modes of orthonormal shapes under white forces."""
    rng = np.random.default_rng(2)
    phi, q = (
        np.linalg.qr(np.random.default_rng(16).standard_normal((channels, f.size)))[0],
        [],
    )
    for s in 2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2)):
        force, a = rng.standard_normal(int(seconds * rate)), np.exp(s / rate)
        q.append(
            2
            * np.real(s**2 / (2j * s.imag) * lfilter([0, (a - 1) / s], [1, -a], force))
            + force
        )
    return np.asarray(phi @ np.array(q))


def wrap(y: np.ndarray) -> TimeHistory:
    return TimeHistory(
        y,
        RATE,
        tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(len(y))),
        "made",
    )


def sampled(y: np.ndarray) -> np.ndarray:
    """Every other sample behind a steep filter at 0.45 of the new rate, with sensor noise 30 dB
    below.
    """
    y = upfirdn(firwin(81, 0.45, window=("kaiser", 9.0)), y, 1, 2, axis=1)
    return y + 0.03 * y.std() * np.random.default_rng(3).standard_normal(y.shape)


def test_the_edge_of_the_recorders_filter_is_no_mode() -> None:
    record = wrap(sampled(accelerations(F, Z, 6, 1800, 2 * RATE)))
    r = identify_ambient(record)
    assert len(r.modes) == 4, r.reasons
    np.testing.assert_allclose(r.modes.frequencies, F, rtol=0.02)
    assert identify_ambient_by("era", record).modes.frequencies.max() < 10


def test_a_mode_near_the_end_of_the_spectrum_is_none() -> None:
    f, z = np.array([21.0]), np.array([0.05])
    assert not filter_edges(wrap(accelerations(f, z, 3, 600, RATE)), f, z).any()
    cut = wrap(sampled(accelerations(F, Z, 4, 600, 2 * RATE)))
    assert filter_edges(cut, np.array([22.2]), np.array([0.1])).all()
