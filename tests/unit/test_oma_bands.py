"""The pyramid of bands: what a pass gives, what is kept of many stretches, deviations and mixing of
shapes.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import oaconvolve

from ringtrue.identification.ambient.close_modes import unmix
from ringtrue.identification.ambient.maximum_likelihood import EstimatedModes
from ringtrue.identification.ambient.record_bands import (
    MOST_BLOCKS,
    first_sums,
    joined_sums,
    stretch_sums,
)
from ringtrue.identification.ambient.spectral_bins import SpectralBins
from ringtrue.identification.ambient.ssi_cov import SsiCov
from ringtrue.identification.common import uncertainty as var
from ringtrue.signal import band_correlations
from ringtrue.signal.band_correlations import (
    UNDER_WAY,
    Signals,
    detrended,
    map_in_threads,
    segments,
    threads,
)
from ringtrue.signal.spectra import Band, decimator, detrend, high_passer

HIGH, DOWN = high_passer(4.0, 100.0), decimator(4)


def filtered(y: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """(ch, sample) with the delay of a symmetric filter taken out."""
    half = taps.size // 2
    return oaconvolve(y, taps[None], axes=1)[:, half : half + y.shape[1]]


@pytest.mark.parametrize("samples", [20_000, 19_937])
def test_a_pass_gives_the_correlations_of_the_filtered_signals(samples):
    y = np.random.default_rng(1).standard_normal((3, samples))
    lags, refs = 20, np.array([0, 2])
    cut = segments(samples, 4, lags, HIGH, DOWN, references=2)
    r, lower = band_correlations.run(Signals(y, np.zeros(3)), cut, HIGH, DOWN, refs)
    # of the signal that leaves the filter on one side and of that which comes to it on the other
    twice = filtered(filtered(np.pad(y, ((0, 0), (500, 500))), HIGH.taps), HIGH.taps)[
        :, 500:-500
    ]
    block = cut.each * cut.hop
    for b in (0, 2):
        t = np.arange(b * block, (b + 1) * block)
        direct = (
            np.stack([twice[:, t + k] @ y[refs][:, t].T for k in range(lags + 1)])
            / block
        )
        assert np.abs(r[b] - direct).max() < 1e-4 * np.abs(direct).max()
    assert lower == pytest.approx(filtered(y, DOWN.taps)[:, ::4], abs=1e-4)


@pytest.mark.parametrize(("said", "want"), [("1", 1), ("2,1", 2), ("0", 1), ("40", 2)])
def test_threads_are_as_many_as_the_environment_says(monkeypatch, said, want):
    monkeypatch.setenv("OMP_NUM_THREADS", said)
    assert threads() == want


@pytest.mark.parametrize("said", ["", "many"])
def test_threads_are_as_many_as_the_cores(monkeypatch, said):
    monkeypatch.setenv("OMP_NUM_THREADS", said)
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    assert threads() == 1
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    assert threads() == UNDER_WAY


def test_a_part_beyond_the_end_is_empty():
    s = Signals(np.ones((2, 10)), np.zeros(2))
    assert (s.part(8, 12) == [[1, 1, 0, 0]] * 2).all()
    assert (s.part(-2, 2) == [[0, 0, 1, 1]] * 2).all()
    assert (s.part(15, 18) == 0).all()


def test_detrended_signals_have_no_line():
    t = np.arange(3000)
    wave = np.sin(0.3 * t) + 0.0 * t
    line = 1e3 - 2e-2 * t
    s = detrended(np.stack([wave + line, 5 * wave]).astype(np.float32))
    want = detrend(np.stack([wave, 5 * wave]))
    assert s.part(100, 2000, np.array([1, 0])) == pytest.approx(
        want[[1, 0], 100:2000], abs=1e-3
    )
    assert s.power() == pytest.approx((want**2).mean(1), rel=1e-4)


def test_many_stretches_keep_few_blocks_of_one_length():
    y = np.random.default_rng(2).standard_normal((3, 4000))
    sums = first_sums(
        y, 100.0, (Band(6.0, 34.0, 100.0),), SsiCov(10, 20, blocks=4), None
    )
    once = sums[0].r.mean(0)
    for _ in range(22):
        sums = joined_sums(sums, stretch_sums(sums, y, 100.0))
    assert len(sums[0].r) == 23 <= MOST_BLOCKS
    assert sums[0].blocks == 1
    assert np.abs(sums[0].r - once).max() < 0.01
    assert sums[0].stretches == 23


def test_a_stretch_that_was_begun_with_shorter_blocks_joins_as_one_with_long_ones():
    y = np.random.default_rng(2).standard_normal((3, 4000))
    sums = first_sums(
        y, 100.0, (Band(6.0, 34.0, 100.0),), SsiCov(10, 20, blocks=4), None
    )
    early = stretch_sums(sums, y, 100.0)
    for _ in range(8):
        sums = joined_sums(sums, stretch_sums(sums, y, 100.0))
    assert sums[0].blocks == 2
    late = stretch_sums(sums, y, 100.0)
    a, b = joined_sums(sums, early)[0].parts[-1], late[0].parts[0]
    assert a.shape == b.shape
    assert np.abs(a - b).max() < 0.02  # the blocks end at other samples


def test_items_abreast_are_taken_late_and_given_in_order():
    taken = []

    def items():
        for k in range(5):
            taken.append(k)
            yield k

    seen = [(x, len(taken)) for x in map_in_threads(lambda k: k * k, items())]
    assert [x for x, _ in seen] == [0, 1, 4, 9, 16]
    assert [n for _, n in seen] == [2, 3, 4, 5, 5]


def test_an_error_abreast_is_raised():
    with pytest.raises(ZeroDivisionError):
        list(map_in_threads(lambda k: 1 / k, [1, 2, 0, 3]))


def test_deviation_of_a_modulus_near_zero_and_far_from_it():
    rng, n = np.random.default_rng(3), 20_000
    psi = np.array([[1.0], [0.5], [0.0]], np.complex128)
    noise = 0.01 * (rng.standard_normal((3, n)) + 1j * rng.standard_normal((3, n)))
    noise[0] = 0.0
    stated = var.modulus_std(psi, noise[None] / np.sqrt(n))[:, 0]
    seen = np.sqrt(((np.abs(psi + noise) - np.abs(psi)) ** 2).mean(1))
    assert stated[0] == 0.0
    assert stated[1:] == pytest.approx(seen[1:], rel=0.03)


def test_the_interval_of_a_modulus_reaches_to_zero_as_often_as_it_should():
    rng, n = np.random.default_rng(5), 4000
    node = 0.01 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    d = np.broadcast_to(np.array([[0.0, 0.0], [0.01, 0.01j]]), (n, 2, 2))
    stated = var.modulus_std(np.stack([np.ones(n), node]), d)[1]
    assert (np.abs(node) < 1.96 * stated).mean() == pytest.approx(0.95, abs=0.02)


def test_the_scale_of_a_shape_does_not_change_its_deviation():
    rng = np.random.default_rng(4)
    psi = rng.standard_normal((5, 2)) + 0.1j * rng.standard_normal((5, 2))
    d = 0.01 * (rng.standard_normal((2, 5, 9)) + 1j * rng.standard_normal((2, 5, 9)))
    turn = np.array([2.0, 3j])
    turned = var.modulus_std(psi * turn, d * turn[:, None, None])
    assert turned == pytest.approx(var.modulus_std(psi, d), rel=1e-12)
    assert (turned.min(0) == 0).all()  # the largest component is held


def test_shapes_of_a_close_pair_are_told_apart():
    f, z = np.array([2.00, 2.04]), np.array([0.010, 0.012])
    psi = np.array([[1.0, 0.4], [0.7, -1.0], [-0.2, 0.6], [0.5, 0.3]], np.complex128)
    freqs = np.arange(1.5, 2.6, 0.0005)
    nu = freqs[:, None] / f
    q = np.abs(2 * z * nu**2 / (1 - nu**2 + 2j * z * nu)) ** 2
    cross = np.einsum("ci,fi,di->fcd", psi, q, psi.conj()) + 1e-4 * np.eye(4)
    bins = SpectralBins(
        freqs, np.full(freqs.size, 4.0), cross.astype(np.complex64), 2000.0
    )
    mixed = psi @ np.array([[1.0, 0.1], [-0.08j, 1.0]])
    found = unmix(bins, EstimatedModes(f, z, mixed), 4.0)
    found = unmix(bins, EstimatedModes(f, z, mixed), 4.0, start=found.matrix)
    out = mixed @ found.matrix
    for k in range(2):
        like = (
            abs(np.vdot(psi[:, k], out[:, k])) ** 2
            / (np.linalg.norm(psi[:, k]) * np.linalg.norm(out[:, k])) ** 2
        )
        was = (
            abs(np.vdot(psi[:, k], mixed[:, k])) ** 2
            / (np.linalg.norm(psi[:, k]) * np.linalg.norm(mixed[:, k])) ** 2
        )
        assert 1 - like < 0.05 * (1 - was)
    assert (found.variance[[0, 1], [1, 0]] > 0).all()
