"""Delays between channels from the phases of their cross spectra, on modes whose shapes are
real.
"""

from __future__ import annotations

import numpy as np
import pytest
from five_modes import PHI, RATE, F, motion, record
from scipy.signal import butter, sosfilt

from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.identification.ambient.record_checks import in_phase
from ringtrue.shapes import mac
from ringtrue.signal.clock_alignment import at_positions, channel_phases, in_step


def test_channels_of_one_clock_have_no_delay():
    found = channel_phases(record(motion()), [2] * 7)
    assert found.known.all()
    assert not found.delay.any()
    assert not found.drift.any()
    assert not found.odd.any()


def test_the_later_recorder_is_found_to_a_twentieth_of_a_sample():
    y = motion().copy()
    y[5:] = np.roll(y[5:], 20, axis=1)
    y[1] = np.roll(y[1], -3)
    found = channel_phases(record(y), [2] * 7)
    late = np.array([0, -3, 0, 0, 0, 20, 20]) / RATE
    assert found.known.sum() >= 6
    assert found.delay[found.known] == pytest.approx(late[found.known], abs=0.05 / RATE)
    assert not found.odd.any()


@pytest.mark.parametrize(("samples", "told"), [(0.15, False), (0.4, True)])
def test_parts_of_a_sample_are_told_where_they_are_more_than_scatter(
    samples: float, told: bool
):
    y = motion().copy()
    y[3] = at_positions(y[[3]], np.arange(y.shape[1]) - samples)[0]
    moved, notes = in_phase(record(y), mend=True)
    assert [n.subject for n in notes] == told * ["4+Z"]
    assert (moved.data.shape != y.shape) == told


@pytest.mark.parametrize("unit", [1e-14, 1e8])
def test_the_unit_of_a_record_does_not_matter(unit):
    """Counts of a converter, and displacements in m: fourth powers leave the range of single
    precision.
    """
    y = motion().copy()
    y[5:] = np.roll(y[5:], 20, axis=1)
    plain, other = (channel_phases(record(s * y), [2] * 7) for s in (1.0, unit))
    assert plain.delay[5:].all()
    assert other.delay == pytest.approx(plain.delay, abs=1e-3 / RATE)
    np.testing.assert_array_equal(other.known, plain.known)


@pytest.mark.parametrize("ppm", [20.0, -150.0])
def test_a_clock_that_runs_apart_is_found_to_a_tenth_of_a_sample_at_the_ends(ppm):
    y = motion().copy()
    n = y.shape[1]
    middle = (n - 1) / 2
    y[5:] = at_positions(
        y[5:], np.arange(n) + 20 + 1e-6 * ppm * (np.arange(n) - middle)
    )
    found = channel_phases(record(y), [2] * 7)
    moved = found.delay * RATE + found.drift * middle
    assert found.drift[:5] == pytest.approx(0)
    assert moved[5:] == pytest.approx(-20 - 1e-6 * ppm * middle, abs=0.1)
    assert not found.odd.any()


def test_noise_says_nothing():
    found = channel_phases(
        record(np.random.default_rng(0).standard_normal((5, 60000))), [2] * 5
    )
    assert not found.known.any()
    assert not found.delay.any()


def test_a_velocity_that_is_called_an_acceleration_is_odd():
    y = motion().copy()
    y[1] -= y[1].mean()
    y[1] = np.cumsum(y[1]) - 0.5 * y[1]  # by the trapezoidal rule, which shifts nothing
    found = channel_phases(record(y), [2] * 7)
    assert np.flatnonzero(found.odd).tolist() == [1]
    right = channel_phases(record(y), [2, 1, 2, 2, 2, 2, 2])
    assert not right.odd.any()
    assert not right.delay.any()


@pytest.mark.parametrize("seed", [1, 4, 5, 6])
def test_waves_that_push_all_modes_turn_no_channel(seed):
    """Below the modes all of them answer one force, each with a lag of its own."""
    rng = np.random.default_rng(seed)
    n = motion().shape[1]
    wave = sosfilt(
        butter(2, [0.8, 1.6], btype="band", fs=RATE, output="sos"),
        rng.standard_normal(n),
    )
    lagged = np.stack([np.roll(wave, k) for k in range(0, 15, 3)])
    y = motion() + 2 * motion().std() / wave.std() * (
        PHI @ (rng.standard_normal((5, 1)) * lagged)
    )
    assert not channel_phases(record(y), [2] * 7).odd.any()


def test_channels_are_moved_between_their_samples():
    t = np.arange(3000) / RATE

    def wave(t: np.ndarray) -> np.ndarray:
        return np.sin(2 * np.pi * 3.1 * t) + np.cos(2 * np.pi * 27 * t)

    y = in_step(
        record(np.array([wave(t), wave(t - 0.2137), wave(t + 0.0531)])),
        np.array([0, 0.2137, -0.0531]),
    ).data
    assert y[1:] == pytest.approx(y[[0, 0]], abs=2e-4)


def test_modes_of_two_clocks_that_run_apart_are_those_of_one():
    y = motion().copy()
    n = y.shape[1]
    y[4:] = at_positions(
        y[4:], np.arange(n) + 1e-4 * np.arange(n)[::-1]
    )  # over half a turn of the highest mode
    one, two = identify_ambient(record(motion())), identify_ambient(record(y))
    assert len(two.modes) == 5, two.notes
    assert two.modes.frequencies == pytest.approx(one.modes.frequencies, rel=5e-4)
    assert two.modes.damping == pytest.approx(one.modes.damping, rel=0.05)
    assert np.diag(mac(two.modes.shapes, one.modes.shapes)).min() > 0.999
    assert any(
        "channel 5+Z 6+Z 7+Z: a clock +1" in n and "ppm" in n for n in two.notes
    ), two.notes


def test_modes_of_two_recorders_are_those_of_one():
    y = motion().copy()
    y[4:] = np.roll(y[4:], 20, axis=1)
    r = identify_ambient(record(y))
    assert len(r.modes) == 5, r.notes
    assert r.modes.frequencies == pytest.approx(F, rel=5e-3)
    assert np.diag(mac(r.modes.shapes, PHI.astype(complex))).min() > 0.99
    assert any("channel 5+Z 6+Z 7+Z: 0.2 s after the others" in n for n in r.notes)


def test_interpolation_is_exact_within_the_band() -> None:
    rng = np.random.default_rng(0)
    frequencies, phases = rng.uniform(1, 35, 150), rng.uniform(0, 2 * np.pi, 150)

    def sines(t: np.ndarray) -> np.ndarray:
        return np.sin(2 * np.pi * np.outer(t, frequencies) + phases).sum(axis=1)

    positions = np.linspace(100, 2800, 1777)
    got = at_positions(sines(np.arange(3000) / 100.0)[None], positions)[0]
    # 90 dB below 150 sines
    np.testing.assert_allclose(got, sines(positions / 100.0), atol=1e-3)
