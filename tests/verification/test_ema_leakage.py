"""FRFs of random forces in blocks under a Hann window: the fading of the responses is no damping.

A structure of four modes with 1.5 to 5 lines in their half-power bandwidth, driven by white noise;
G_xf/G_ff by Welch's method. A fit by poles alone has 10 to 60 % too much damping there.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.signal import csd, welch

from ringtrue.core.signals import Channel, FrfSet
from ringtrue.identification.frf.lines import faded
from ringtrue.identification.frf.pipeline import HammerModes, identify_hammer

RATE, BLOCK = 256.0, 512
FN = np.array([17.0, 31.0, 46.0, 70.0])
ZETA = np.array([0.022, 0.02, 0.021, 0.018])
PHI = np.sin(np.pi * np.outer(np.linspace(0.1, 0.9, 8), np.arange(1, 5)))
POINT = 1
RESPONSES = tuple(Channel(f"{k + 1}+Z", "acceleration", "m/s^2") for k in range(8))
FORCE = (Channel(f"{POINT + 1}+Z", "force", "N"),)


def accelerance(freqs: np.ndarray) -> np.ndarray:
    """(f, response)."""
    s, w = 2j * np.pi * freqs[:, None], 2 * np.pi * FN
    return np.asarray((s**2 / (s**2 + 2 * ZETA * w * s + w**2) * PHI[POINT]) @ PHI.T)


def of_noise(seed: int, window: str) -> FrfSet:
    rng, n = np.random.default_rng(seed), 1 << 17
    force = rng.standard_normal(n)
    y = np.fft.irfft(
        accelerance(np.fft.rfftfreq(n, 1 / RATE)).T * np.fft.rfft(force), n
    )  # periodic: stationary
    y += 1e-3 * y.std() * rng.standard_normal(y.shape)
    options = {"fs": RATE, "nperseg": BLOCK, "window": window, "detrend": False}
    freqs, power = welch(force, **options)
    h = csd(force, y, **options)[1].T / power[:, None]
    coherence = np.abs(h) ** 2 * power[:, None] / welch(y, **options)[1].T
    at = (freqs > 0) & (freqs < 90)
    averages = np.array([2 * n / BLOCK - 1])
    return FrfSet(
        h[at, :, None],
        freqs[at],
        RESPONSES,
        FORCE,
        np.minimum(coherence[at, :, None], 1.0),
        averages,
    )


def test_the_share_that_a_hann_window_takes() -> None:
    length, poles = 2.0, np.array([-1.3 + 64j, -0.2 + 126j])
    s = 2j * np.pi * np.arange(3.0, 40.0, 0.3)
    x = np.linspace(0, 1, 20001)
    r = (1 - x) * (2 + np.cos(2 * np.pi * x)) / 3 + np.sin(2 * np.pi * x) / (2 * np.pi)
    window = np.hanning(4001)
    lags = np.correlate(window, window, "full")[4000:] / (window @ window)
    np.testing.assert_allclose(r[::5], lags, atol=1e-6)
    decay = r * np.exp((poles - s[:, None])[..., None] * x * length)
    share, slope = faded(s, poles, length)
    np.testing.assert_allclose(
        share, 1 - (s[:, None] - poles) * length * simpson(decay, x=x), atol=1e-9
    )
    step = 1e-6
    np.testing.assert_allclose(
        slope, (faded(s, poles + step, length)[0] - share) / step, rtol=1e-4, atol=1e-7
    )


def test_damping_of_blocks_under_a_hann_window() -> None:
    found = [
        identify_hammer(of_noise(seed, "hann"), HammerModes(fmin=5))
        for seed in range(6)
    ]
    assert all(any("Hann window" in x for x in r.notes) for r in found)
    f, zeta = (
        np.array([getattr(r.modes, k) for r in found])
        for k in ("frequencies", "damping")
    )
    std = np.array([r.uncertainty.damping for r in found])
    np.testing.assert_allclose(f, np.tile(FN, (6, 1)), rtol=2e-3)
    # without: 10 to 60 %
    np.testing.assert_allclose(zeta.mean(axis=0), ZETA, rtol=0.02)
    z = (zeta - ZETA) / std
    assert np.sqrt(np.mean(z**2)) < 1.6
    np.testing.assert_allclose(
        np.abs(found[0].modes.shapes), np.abs(PHI), atol=0.02
    )  # unit modal mass


@pytest.mark.parametrize("decay", [0.0, 4.0])
def test_blows_with_and_without_an_exponential_window_are_not_taken_for_noise(
    decay: float,
) -> None:
    """The same lines, free of leakage; what the window adds to the damping nobody can know."""
    rng = np.random.default_rng(1)
    freqs = np.arange(1, 180) * RATE / BLOCK
    s, w = decay + 2j * np.pi * freqs[:, None], 2 * np.pi * FN
    h = (s**2 / (s**2 + 2 * ZETA * w * s + w**2) * PHI[POINT]) @ PHI.T
    h = h * (
        1 + 0.01 * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    )
    r = identify_hammer(
        FrfSet(h[:, :, None], freqs, RESPONSES, FORCE), HammerModes(fmin=5)
    )
    assert not any("Hann" in x for x in r.notes)
    np.testing.assert_allclose(
        r.modes.damping, ZETA + decay / (2 * np.pi * FN), rtol=0.02
    )
