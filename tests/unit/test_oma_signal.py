"""Spectra, correlations, bands, sensors: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.channel_checks import check_channels, usable
from ringtrue.signal.spectra import (
    Band,
    Geophone,
    Welch,
    band_signals,
    block_bounds,
    block_correlations,
    block_weights,
    correlations,
    csd,
    deconvolve,
    lowest_frequency,
)
from ringtrue.signal.tonal_lines import harmonics


def history(
    data: np.ndarray, rate: float, quantity: str = "acceleration"
) -> TimeHistory:
    channels = tuple(Channel(f"{i + 1}+Z", quantity) for i in range(len(data)))  # type: ignore[arg-type]
    return TimeHistory(data, rate, channels, "made")


def test_samples_of_a_channel_are_side_by_side_however_the_table_came():
    table = np.random.default_rng(0).standard_normal((50, 3))
    turned, rows = (
        history(table.T, 100.0).data,
        history(np.ascontiguousarray(table.T), 100.0).data,
    )
    assert turned.strides[1] == turned.itemsize
    np.testing.assert_array_equal(turned, rows)
    assert np.shares_memory(
        history(rows[:, 10:30], 100.0).data, rows
    )  # a part of a record is not copied


def test_spectrum_of_white_noise_has_its_variance_and_no_cross_terms():
    y = np.random.default_rng(1).standard_normal((3, 60000)) * np.array(
        [[1.0], [2.0], [3.0]]
    )
    s = csd(history(y, 100.0), Welch(0.5))
    power = s.data.real[:, range(3), range(3)].sum(0) * 0.5
    assert power == pytest.approx(
        [1, 4, 9], rel=0.03
    )  # 600 segments: 3 % is two standard deviations of the sum
    assert (
        np.abs(s.data[:, 0, 2]).mean()
        < 0.1 * np.sqrt((s.data[:, 0, 0] * s.data[:, 2, 2]).real).mean()
    )


def test_spectrum_needs_one_segment():
    with pytest.raises(DataError, match="too short"):
        csd(history(np.zeros((1, 50)), 100.0), Welch(1.0))


@pytest.mark.parametrize("samples", [500, 1237])
def test_correlations_are_exact_to_the_last_sample(samples: int):
    y = np.random.default_rng(2).standard_normal((3, samples))
    refs = np.array([2, 0])
    want = np.stack(
        [y[:, k:] @ y[refs, : samples - k].T / (samples - k) for k in range(31)]
    )
    assert correlations(y, refs, 30) == pytest.approx(want, abs=1e-12)
    r, count = block_correlations(y, refs, 30, block_bounds(samples, 7))
    assert np.einsum("bk,bkij->kij", count / count.sum(0), r) == pytest.approx(
        want, abs=1e-12
    )


def test_bands_keep_a_sine_and_its_phase():
    rate, t = 200.0, np.arange(60000) / 200.0
    y = np.sin(2 * np.pi * 3.0 * t) + np.sin(2 * np.pi * 40.0 * t) + 5.0 + 0.01 * t
    ((low, new),) = band_signals(y[None], rate, [Band(1.0, 5.0, 20.0)])
    want = np.sin(2 * np.pi * 3.0 * np.arange(low.shape[1]) / new)
    middle = slice(
        low.shape[1] // 10, -low.shape[1] // 10
    )  # away from the ends, where the record is cut
    assert low[0, middle] == pytest.approx(want[middle], abs=2e-3)
    assert new == pytest.approx(20.0, rel=0.01)


def test_bad_channels_are_named_and_left_out():
    y = np.random.default_rng(3).standard_normal((4, 5000))
    y[1] = 2.5
    y[2, 7] = np.nan
    y[3] = np.clip(y[3], -1, 1)
    found = {n.subject: (n.code, n.severity) for n in check_channels(history(y, 10.0))}
    assert found == {
        "2+Z": ("channel dead", "error"),
        "3+Z": ("channel not finite", "error"),
        "4+Z": ("channel clipped", "warning"),
    }
    assert [c.id for c in usable(history(y, 10.0))[0].channels] == ["1+Z", "4+Z"]
    with pytest.raises(DataError, match="no usable channel"):
        usable(history(np.zeros((2, 100)), 10.0))


def test_a_loud_block_counts_as_a_typical_one():
    w = block_weights(np.array([1.0, 1.0, 100.0, 1.0, 0.5]))
    assert w.sum() == pytest.approx(1.0)
    assert w[2] * 100 == pytest.approx(w[0])
    assert w[4] == w[0]


def test_machines_are_found_and_noise_is_none():
    rng, t = np.random.default_rng(4), np.arange(120000) / 100.0
    noise = rng.standard_normal((3, t.size))
    tone = (
        np.sin(2 * np.pi * 12.5 * t)
        + 0.8 * np.sin(2 * np.pi * 25.0 * t)
        + np.sin(2 * np.pi * 16.667 * t)
    )
    assert harmonics(history(noise, 100.0)) == ()
    found = harmonics(history(noise + tone, 100.0))
    assert [h.frequency for h in found] == pytest.approx([12.5, 16.667, 25.0], abs=0.05)
    assert "mains" in found[1].why
    assert "2 x 12.5" in found[2].why


def test_modes_in_three_directions_are_no_line():
    """Each as narrow as the window; the sum of their powers has a normalised second moment of 4/3
    only.
    """
    t, found = np.arange(120000) / 100.0, 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        slow = np.array(
            [
                np.interp(t, np.arange(0, 1220, 20.0), x)
                for x in rng.standard_normal((6, 61))
            ]
        )
        y = slow[:3] * np.cos(2 * np.pi * 12.5 * t) + slow[3:] * np.sin(
            2 * np.pi * 12.5 * t
        )
        found += bool(
            harmonics(history(y + 1e-3 * rng.standard_normal(y.shape), 100.0))
        )
    assert found <= 1


def test_geophone_is_undone_within_its_band():
    sensor, rate, t = Geophone(4.5, 0.56), 100.0, np.arange(20000) / 100.0
    envelope = np.exp(-(((t - 100) / 30) ** 2))
    velocity = envelope * np.cos(2 * np.pi * 1.3 * t)
    spectrum = np.fft.rfft(velocity) * sensor.response(
        np.fft.rfftfreq(t.size, 1 / rate)
    )
    recorded = np.fft.irfft(spectrum, t.size)
    back = deconvolve(history(recorded[None], rate, "unknown"), sensor, low=0.8)
    assert back.data[0] == pytest.approx(velocity, abs=2e-3)
    assert back.channels[0].quantity == "velocity"
    h = sensor.response(np.array([4.5, 1e4]))
    assert abs(h[0]) == pytest.approx(1 / (2 * 0.56))
    assert abs(h[1]) == pytest.approx(1.0, abs=1e-3)


def test_band_of_a_geophone_ends_where_noise_takes_over():
    f = np.linspace(0.0, 50.0, 5001)
    signal = np.minimum(f, 5.0) ** 4
    low = lowest_frequency(f, signal + 1.0, 1.0, snr_db=0.0)
    assert low == pytest.approx(1.0, rel=0.2)  # a third-octave is 26 % wide
    with pytest.raises(DataError, match="dB at most"):
        lowest_frequency(f, np.full(f.size, 1.01), 1.0)
