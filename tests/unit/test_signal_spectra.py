"""Shaker FRFs: a static 3 x 2 gain with a one-sample delay, known noise; passivity and reciprocity
of a modal model.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.signal.frf import frf_variance, independent_segments, shaker_frfs
from ringtrue.signal.spectra import Welch, csd, psd

RATE, N = 256.0, 64 * 256
GAIN = np.array([[1.0, -0.5], [0.3, 2.0], [-1.2, 0.7]])
SETTINGS = Welch(1.0)


def record(
    seed: int, *, inputs: int = 2, noise: float = 0.5, mixed: float = 0.6
) -> TimeHistory:
    rng = np.random.default_rng(seed)
    f = rng.standard_normal((inputs, N))
    f[-1] += mixed * f[0] if inputs > 1 else 0.0  # the shakers are not independent
    y = GAIN[:, :inputs] @ np.roll(f, 1, axis=1) + noise * rng.standard_normal((3, N))
    channels = [Channel(f"F:{i + 1}+Z", "force", "N") for i in range(inputs)]
    channels += [Channel(f"{i + 1}+Z", "acceleration", "m/s^2") for i in range(3)]
    return TimeHistory(np.vstack([f, y]), RATE, tuple(channels), "r")


def truth(freqs: np.ndarray, inputs: int = 2) -> np.ndarray:
    return np.exp(-2j * np.pi * freqs / RATE)[:, None, None] * GAIN[:, :inputs]


def test_densities_are_the_diagonal_of_the_cross_spectra() -> None:
    """Their sum over the lines, of segments of even and odd length, is the power of the record."""
    history = record(0)
    for resolution in (1.0, 256 / 255):
        freqs, density = psd(history, Welch(resolution))
        whole = csd(history, Welch(resolution))
        np.testing.assert_array_equal(freqs, whole.freqs)
        auto = np.einsum("fii->if", whole.data)
        np.testing.assert_allclose(density, auto.real, rtol=1e-12)
        power = density.sum(axis=1) * freqs[1]
        np.testing.assert_allclose(power, history.data.var(axis=1), rtol=0.03)


def test_several_shakers_and_their_variance() -> None:
    """The stated variance of each part holds the scatter of 24 records, and there is no bias."""
    results = [shaker_frfs(record(s), SETTINGS) for s in range(24)]
    f = results[0].frfs.freqs
    use = (f > 4) & (f < 120)
    off = np.stack([r.frfs.data - truth(f) for r in results])[:, use]
    assert np.abs(off.mean(axis=(0, 1))).max() < 0.01
    stated = np.mean([frf_variance(r.frfs)[use] for r in results], axis=(0, 1))
    np.testing.assert_allclose((off.real**2).mean(axis=(0, 1)) / stated, 1.0, atol=0.15)
    multiple = np.mean([r.multiple[use] for r in results], axis=(0, 1))
    power = np.einsum("oi,ij,oj->o", GAIN, np.array([[1, 0.6], [0.6, 1.36]]), GAIN)
    np.testing.assert_allclose(multiple, power / (power + 0.25), atol=0.02)
    assert [c.id for c in results[0].frfs.inputs] == ["1+Z", "2+Z"]
    assert results[0].frfs.driving_points() == [(0, 0), (1, 1)]


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_one_shaker(estimator: str) -> None:
    found = shaker_frfs(record(1, inputs=1), SETTINGS, estimator=estimator)  # type: ignore[arg-type]
    g = found.frfs.coherence[:, :, 0]
    np.testing.assert_allclose(g, found.ordinary[:, :, 0], rtol=1e-9)
    np.testing.assert_allclose(g, found.multiple, rtol=1e-9)
    h1 = shaker_frfs(record(1, inputs=1), SETTINGS).frfs.data[:, :, 0]
    want = {"H1": h1, "H2": h1 / g, "Hv": h1 / np.sqrt(g)}[estimator]
    np.testing.assert_allclose(found.frfs.data[:, :, 0], want, rtol=1e-8)


def test_hv_has_less_bias_with_noise_on_the_forces() -> None:
    clean = record(2, noise=0.0)
    rng = np.random.default_rng(3)
    loud = np.array(clean.data) + 0.3 * clean.data.std(
        axis=1, keepdims=True
    ) * rng.standard_normal(clean.data.shape)
    noisy = replace(clean, data=loud)
    off = {}
    for estimator in ("H1", "Hv"):
        frfs = shaker_frfs(noisy, SETTINGS, estimator=estimator).frfs  # type: ignore[arg-type]
        off[estimator] = np.abs((frfs.data / truth(frfs.freqs)).mean(axis=0) - 1).max()
    assert off["H1"] > 0.05
    assert off["Hv"] < 0.6 * off["H1"]


def test_bad_records_are_told() -> None:
    r = record(0)
    with pytest.raises(DataError, match="0 forces"):
        shaker_frfs(r.pick([c.id for c in r.channels[2:]]), SETTINGS)
    with pytest.raises(DataError, match="independent segments"):
        shaker_frfs(replace(r, data=r.data[:, :300]), SETTINGS)
    with pytest.raises(DataError, match="constant"):
        shaker_frfs(
            replace(r, data=np.where(np.arange(5)[:, None] == 3, 1.0, r.data)), SETTINGS
        )
    with pytest.raises(ConfigError, match="H2"):
        shaker_frfs(r, SETTINGS, estimator="H2")
    with pytest.raises(ConfigError, match="Allowed: H1"):
        shaker_frfs(r, SETTINGS, estimator="H3")  # type: ignore[arg-type]


def test_dependent_shakers_show_in_the_condition() -> None:
    r = record(0)
    twin = np.array(r.data)
    twin[1] = twin[0] + 1e-4 * twin[1]
    assert np.median(shaker_frfs(r, SETTINGS).condition) < 10
    assert np.median(shaker_frfs(replace(r, data=twin), SETTINGS).condition) > 1e6


def test_independent_segments_of_a_hann_window() -> None:
    """Half overlap of a Hann window: 1/(1 + 2/36) of the segments (Welch 1967)."""
    n = 256 * 200
    count = 2 * 200 - 1
    assert independent_segments(n, 256, Welch(1.0)) == pytest.approx(
        count / (1 + 2 / 36), rel=2e-3
    )
