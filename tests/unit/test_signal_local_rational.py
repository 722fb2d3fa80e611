"""FRFs by local rational models: two modes under random, swept and periodic forces, against their
exact FRFs.

The record is filtered sample by sample, so that its transients, at both ends, are those of the
system.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import chirp, lfilter

from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.frf.pipeline import HammerModes, identify_hammer
from ringtrue.signal.frf import frf_variance, shaker_frfs
from ringtrue.signal.local_rational import (
    is_continuous,
    local_frfs,
    period,
    periodic_frfs,
    spacing,
)
from ringtrue.signal.spectra import Welch

RATE, N = 128.0, 40 * 128
FN, ZETA = np.array([9.0, 23.0]), np.array([0.005, 0.01])
PHI = np.array([[1.0, 0.8], [0.6, -1.0], [-0.3, 0.5]])
DENOMINATORS = [
    np.array(
        [1, -2 * np.exp(-z * w) * np.cos(w * np.sqrt(1 - z**2)), np.exp(-2 * z * w)]
    )
    for w, z in zip(2 * np.pi * FN / RATE, ZETA, strict=True)
]


def record(
    force: np.ndarray,
    rng: np.random.Generator,
    *,
    response: float = 0.0,
    on_force: float = 0.0,
) -> TimeHistory:
    """Responses at three points to forces (in, sample), seen in their second half, noise as shares
    of the rms.
    """
    n = force.shape[1] // 2
    y = np.zeros((3, force.shape[1]))
    for k, a in enumerate(DENOMINATORS):
        y += np.outer(PHI[:, k], lfilter([0.0, 1.0], a, PHI[: len(force), k] @ force))
    y = y[:, -n:] + response * y.std() * rng.standard_normal((3, n))
    force = force[:, -n:] + on_force * force.std() * rng.standard_normal(
        (len(force), n)
    )
    channels = [Channel(f"F:{i + 1}+Z", "force", "N") for i in range(len(force))]
    channels += [Channel(f"{i + 1}+Z", "displacement", "m") for i in range(3)]
    return TimeHistory(np.vstack([force, y]), RATE, tuple(channels), "r")


def exact(f: np.ndarray, inputs: int) -> np.ndarray:
    z = np.exp(-2j * np.pi * f / RATE)
    h = np.array([z / np.polyval(a[::-1], z) for a in DENOMINATORS])
    return np.einsum("kf,ok,ik->foi", h, PHI, PHI[:inputs])


def forces(kind: str, rng: np.random.Generator) -> np.ndarray:
    """They ran before the record began."""
    t = np.arange(2 * N) / RATE
    if kind == "sweep":
        return chirp(t - N / RATE, 2.0, N / RATE, 50.0)[None]
    if kind == "periodic":
        return np.tile(rng.standard_normal((1, N // 8)), 16)
    return rng.standard_normal((2 if kind == "two" else 1, 2 * N))


@pytest.mark.parametrize("kind", ["random", "two", "sweep", "periodic"])
def test_no_leakage(kind: str) -> None:
    """Half-power bandwidths of 0.09 and 0.46 Hz under lines of 0.25 Hz: Hann windows are off by a
    fifth and more.
    """
    r = record(forces(kind, np.random.default_rng(1)), np.random.default_rng(2))
    (frfs,) = local_frfs([r], 0.25)
    use = (frfs.freqs > 4) & (frfs.freqs < 40)
    h = exact(frfs.freqs[use], frfs.data.shape[2])
    assert use.sum() > 130
    assert np.linalg.norm(frfs.data[use] - h) < 5e-3 * np.linalg.norm(h)
    assert not any(
        "short" in n for n in identify_hammer(frfs, HammerModes(4.0, 40.0)).notes
    )
    if kind == "random":
        welch = shaker_frfs(r, Welch(0.25)).frfs
        at = np.isin(np.round(welch.freqs, 3), np.round(frfs.freqs[use], 3))
        assert np.linalg.norm(welch.data[at] - h) > 0.2 * np.linalg.norm(h)
        found = identify_hammer(welch, HammerModes(4.0, 40.0))
        assert any("under a Hann window" in n for n in found.notes)
        assert found.modes.damping == pytest.approx(
            ZETA, rel=0.2
        )  # twice as high without the window in the model


def test_the_coherence_holds_the_variance() -> None:
    """Noise on the responses: the scatter of 30 records about the truth, rms over the lines."""
    ratio = []
    for k in range(30):
        rng = np.random.default_rng(k)
        (frfs,) = local_frfs([record(forces("two", rng), rng, response=0.02)], 0.25)
        use = (frfs.freqs > 4) & (frfs.freqs < 40)
        assert use.sum() > 140
        g = frfs.coherence[use]
        stated = np.abs(frfs.data[use]) ** 2 * (1 - g) / (frfs.averages * g)
        ratio.append(
            (np.abs(frfs.data[use] - exact(frfs.freqs[use], 2)) ** 2 / stated).mean(
                axis=0
            )
        )
    np.testing.assert_allclose(np.sqrt(np.mean(ratio, axis=0)), 1.0, atol=0.15)


def modes(frfs: FrfSet) -> np.ndarray:
    found = identify_hammer(frfs, HammerModes(4.0, 40.0))
    f, z = found.modes.frequencies, found.modes.damping
    assert f.size == 2
    std = found.uncertainty
    return np.concatenate([(f - FN) / std.frequency, (z - ZETA) / std.damping])


def test_noise_on_the_force_is_in_the_deviations() -> None:
    """An error that all responses share: the scores of frequency and damping have the size of
    one.
    """
    scores = []
    for k in range(24):
        rng = np.random.default_rng(100 + k)
        r = record(rng.standard_normal((1, 10 * N)), rng, response=1e-4, on_force=0.03)
        scores.append(modes(local_frfs([r], 0.05)[0]))
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_lines_without_force_are_left_out() -> None:
    rng = np.random.default_rng(3)
    spectrum = np.fft.rfft(rng.standard_normal(N)) * (np.fft.rfftfreq(N, 1 / RATE) < 30)
    force = np.tile(np.fft.irfft(spectrum), 2)[None]
    f = local_frfs([record(force, rng, response=1e-3)], 0.25)[0].freqs
    assert 29 < f[-1] < 31


def test_short_records_are_told() -> None:
    r = record(forces("random", np.random.default_rng(4)), np.random.default_rng(5))
    with pytest.raises(DataError, match="too short for 1 inputs"):
        local_frfs([TimeHistory(r.data[:, :60], RATE, r.channels, "r")], 1.0)


def test_records_of_other_lengths_share_their_lines() -> None:
    """Lines of the two records do not meet; the second force ends at 30 Hz."""
    rng = np.random.default_rng(6)
    long = record(forces("random", rng), rng, response=1e-3)
    spectrum = np.fft.rfft(rng.standard_normal(N)) * (np.fft.rfftfreq(N, 1 / RATE) < 30)
    short = record(np.tile(np.fft.irfft(spectrum), 2)[None], rng, response=1e-3)
    both = local_frfs([long, replace(short, data=short.data[:, : N - 333])], 0.4)
    np.testing.assert_array_equal(both[0].freqs, both[1].freqs)
    assert 29 < both[0].freqs[-1] < 64
    use = (both[0].freqs > 4) & (both[0].freqs < 28)
    h = exact(both[0].freqs[use], 1)
    for f in both:
        assert np.linalg.norm(f.data[use] - h) < 0.02 * np.linalg.norm(h)


def test_forces_that_run_all_the_time_are_told_from_blows() -> None:
    rng = np.random.default_rng(7)
    for kind in ("random", "two", "sweep", "periodic"):
        r = record(forces(kind, rng), rng)
        assert is_continuous(r)
        assert (
            0.15 < spacing(r) < 1.2
        )  # 16 and more lines of 0.025 Hz to a window, some 40 times as many as periods
    blows = np.exp(-(((np.arange(2 * N) % (4 * 128)) - 60.0) ** 2) / 8)[
        None
    ] + 0.005 * rng.standard_normal((1, 2 * N))
    assert not is_continuous(record(blows, rng))


@pytest.mark.parametrize("start", ["steady", "at rest"])
def test_a_force_that_repeats_itself_has_the_lines_of_its_period(start: str) -> None:
    """Ten seconds, four times: lines of 0.1 Hz for a bandwidth of 0.09 Hz, and transients where it
    begins at rest.
    """
    scores = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        one = rng.standard_normal((1, N // 4))
        force = np.tile(one, 8)
        force[:, :N] *= start == "steady"
        r = record(force, rng, response=0.01)
        assert period(r) == N // 4
        (frfs,) = periodic_frfs([r], period(r))
        use = (frfs.freqs > 4) & (frfs.freqs < 40)
        assert use.sum() > 200
        h = exact(frfs.freqs, 1)
        error = (frfs.data - h)[use]
        assert np.linalg.norm(error) < 0.03 * np.linalg.norm(h[use])
        scores.append(np.mean(np.abs(error) ** 2 / (2 * frf_variance(frfs)[use])))
    assert 0.9 < np.sqrt(np.mean(scores)) < 1.1


def test_forces_that_do_not_repeat_or_are_several() -> None:
    rng = np.random.default_rng(0)
    assert period(record(rng.standard_normal((1, 2 * N)), rng)) == 0
    assert (
        period(record(np.sin(2 * np.pi * 7 * np.arange(2 * N) / RATE)[None], rng)) == 0
    )
    two = record(np.tile(rng.standard_normal((2, N // 4)), 8), rng)
    with pytest.raises(DataError, match="are one force at each line"):
        periodic_frfs([two], period(two))
