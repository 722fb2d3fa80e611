"""Lost stretches of a record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from five_modes import PHI, F, Z, motion, record

from ringtrue.core.notes import sentence
from ringtrue.identification.ambient.pipeline import (
    identify_ambient,
    identify_stretches,
)
from ringtrue.identification.ambient.spectral_bins import SpectralBins
from ringtrue.identification.methods import identify_ambient_by
from ringtrue.shapes import mac
from ringtrue.signal.channel_checks import bridge_gaps
from ringtrue.signal.transients import NONE


def lossy() -> np.ndarray:
    """Sensors with an offset that all fall to zero for 40 s; one of them stands still for 100 s."""
    y = motion() + 30 * motion().std()
    y[:, 20000:24000] = 0.0
    y[4, 35000:45000] = y[4, 35000]
    return y


def test_a_sound_record_stays_as_it_is():
    h = record(motion())
    whole, gaps = bridge_gaps(h)
    assert whole is h
    assert not gaps.lost.any()
    assert not gaps.notes


def test_lost_stretches_are_found_to_the_sample_and_bridged():
    whole, gaps = bridge_gaps(record(lossy()))
    expected = np.zeros(60000, dtype=bool)
    expected[20000:24000] = expected[35000:45000] = True
    assert np.array_equal(gaps.lost, expected)
    assert np.abs(np.diff(whole.data)).max() < np.ptp(motion())  # no step is left
    assert np.array_equal(whole.data[:, ~expected], lossy()[:, ~expected])


def test_modes_are_those_of_what_is_left():
    r = identify_ambient(record(lossy()))
    assert len(r.modes) == 5, r.notes
    assert (np.abs(r.modes.frequencies - F) < 4 * r.uncertainty.frequency).all()
    assert (np.abs(r.modes.damping - Z) < 4 * r.uncertainty.damping).all()
    assert np.diag(mac(r.modes.shapes, PHI.astype(complex))).min() > 0.99
    assert (
        sum(
            "lost stretches: 2 (a value is held), the first at 200 s, 140 s in all" in n
            for n in r.notes
        )
        == 1
    )
    assert not any("clipped" in n or "event" in n for n in r.notes)


def test_other_methods_and_later_stretches_leave_them_out_too():
    assert any(
        "140 s in all" in n for n in identify_ambient_by("fdd", record(lossy())).notes
    )
    whole = record(motion())
    both = identify_stretches((whole, record(lossy())))
    assert len(both.modes) == 5, both.notes
    assert np.diag(mac(both.modes.shapes, PHI.astype(complex))).min() > 0.99


def test_missing_samples_are_left_out_as_held_ones_are():
    y = lossy()
    y[:, 20000:24000] = np.nan
    y[4, 35000:45000] = np.nan
    whole, gaps = bridge_gaps(record(y))
    expected = bridge_gaps(record(lossy()))
    assert np.array_equal(gaps.lost, expected[1].lost)
    assert np.abs(whole.data - expected[0].data).max() < 1e-9
    assert "(samples are missing), the first at 200 s, 140 s in all" in sentence(
        gaps.notes[0]
    )
    again = gaps.marked(whole)
    assert np.array_equal(np.isnan(again.data).all(axis=0), expected[1].lost)


def test_a_few_missing_samples_are_interpolated_in_their_channel_and_a_silent_one_is_left_out():
    y = motion().copy()
    y[2, 5000::7000] = np.nan
    y[3, 30000:30004] = np.inf
    y[6] = np.nan
    whole, gaps = bridge_gaps(record(y))
    assert np.isfinite(whole.data).all()
    assert not gaps.lost.any()
    assert np.array_equal(whole.data[[0, 1, 4, 5]], motion()[[0, 1, 4, 5]])
    assert tuple(map(sentence, gaps.notes)) == (
        "channel 3+Z: missing samples interpolated: 8",
        "channel 4+Z: missing samples interpolated: 4",
        "channel 7+Z: 100 % of its samples are lost; left out",
    )


def test_windows_tell_what_lost_stretches_do_to_the_spectrum_of_a_mode():
    """Expected periodogram of a decaying correlation under a mask of 300 random losses, against the
    model of it.
    """
    n, f, zeta = 1 << 16, 0.05, 0.004
    there = np.ones(n)
    for a in np.random.default_rng(2).integers(0, n - 60, 300):
        there[a : a + 60] = 0.0
    events = replace(NONE, gone=there == 0, rate=1.0)
    bins = SpectralBins(
        np.empty(0),
        np.empty(0),
        np.empty((0, 1, 1)),
        float(n),
        1 - events.kept,
        events.breaks,
    )
    pairs = np.fft.irfft(np.abs(np.fft.rfft(there, 2 * n)) ** 2)[:n] / there.sum()
    nu = f + np.linspace(-5, 5, 41) * zeta * f
    rate = 2 * np.pi * (zeta * f + 1j * (nu - f))
    tau = np.arange(n)
    seen = np.array([(pairs * np.exp(-r * tau)).real.sum() for r in rate])
    told = sum(
        w * ((1 - (1 - np.exp(-rate * t)) / (rate * t)) / rate).real
        for w, t in bins.windows
    )
    plain = ((1 - (1 - np.exp(-rate * n)) / (rate * n)) / rate).real
    # by chance the losses of one mask lie in steps
    assert np.abs(told / seen - 1).max() < 0.1
    assert np.abs(plain / seen - 1).max() > 0.25


def test_many_short_losses_do_not_raise_the_damping():
    """Of 60 at random, 2 s each: the spectra by themselves say a third more."""
    y = motion().copy()
    for a in np.random.default_rng(6).integers(0, y.shape[1] - 200, 60):
        y[:, a : a + 200] = np.nan
    r = identify_ambient(record(y))
    assert len(r.modes) == 5, r.notes
    assert (np.abs(r.modes.frequencies - F) < 4 * r.uncertainty.frequency).all()
    assert (np.abs(r.modes.damping - Z) < 3 * r.uncertainty.damping).all()
    assert (r.modes.damping / Z).mean() < 1.12  # five modes known to 15 % each


@pytest.mark.parametrize("held", [False, True])
def test_radio_links_that_lose_packets_of_their_own_keep_the_rest_of_the_record(held):
    """Of each channel 5 %, 0.5 s at a time: 30 % of the record without some channel."""
    y, rng = motion().copy(), np.random.default_rng(8)
    for x in y:
        for a in rng.integers(0, x.size - 50, 60):
            x[a : a + 50] = x[a] if held else np.nan
    y[:, 20000:22000] = np.nan
    whole, gaps = bridge_gaps(record(y))
    assert gaps.lost[20000:22000].all()
    assert gaps.lost.sum() < 2200  # by chance most are lost together
    assert np.isfinite(whole.data).all()
    assert any(
        "7 channels lost parts at times of their own" in sentence(n) for n in gaps.notes
    )
    r = identify_ambient(record(y))
    assert len(r.modes) == 5, r.notes
    assert (np.abs(r.modes.damping - Z) < 3 * r.uncertainty.damping).all()
    assert np.diag(mac(r.modes.shapes, PHI.astype(complex))).min() > 0.99


def test_a_channel_lost_for_most_of_the_record_is_left_out():
    y = motion().copy()
    y[2, 10000:40000] = y[2, 10000]
    whole, gaps = bridge_gaps(record(y))
    assert [c.id for c in whole.channels] == ["1+Z", "2+Z", "4+Z", "5+Z", "6+Z", "7+Z"]
    assert tuple(map(sentence, gaps.notes)) == (
        "channel 3+Z: 50 % of its samples are lost; left out",
    )
    assert not gaps.lost.any()


@pytest.mark.parametrize("slow", [1, 20])
def test_clipping_coarse_recorders_and_rest_between_events_are_no_loss(slow):
    y = np.repeat(motion()[:, : 60000 // slow], slow, axis=1)
    level = 0.7 * y.std()
    _, clipped = bridge_gaps(record(np.clip(np.cumsum(y, axis=1) / 30, -level, level)))
    _, coarse = bridge_gaps(record(np.round(y / level)))
    _, rest = bridge_gaps(
        record(np.round(y / level * (0.3 + 3 * (np.arange(y.shape[1]) % 20000 < 4000))))
    )
    assert not clipped.lost.any()
    assert not coarse.lost.any()
    assert not rest.lost.any()
