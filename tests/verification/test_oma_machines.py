"""Machines that stamp or change their speed beside random forces, and motions of much damping that
overlap.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.confidence import line_remainders
from ringtrue.identification.ambient.pipeline import AmbientResult, identify_ambient
from ringtrue.signal.tonal_lines import remove_run_ups
from ringtrue.signal.transients import remove_regular_impacts

RATE, F, Z = (
    50.0,
    np.array([2.2, 3.7, 4.1, 6.9, 9.4]),
    np.array([0.012, 0.008, 0.015, 0.01, 0.02]),
)
N = int(900 * RATE)
TIME = np.arange(N) / RATE
PUSH = np.array([[1.0, 0.7, -0.8, 0.6, 0.9]]).T


def forces(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((F.size, N))


def record(
    force: np.ndarray, f: np.ndarray = F, z: np.ndarray = Z, rate: float = RATE
) -> TimeHistory:
    """Accelerations at seven points, noise 30 dB below."""
    phi = np.linalg.qr(np.random.default_rng(14).standard_normal((7, f.size)))[0]
    y = np.zeros((7, force.shape[1]))
    for shape, s, x in zip(
        phi.T, 2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2)), force, strict=True
    ):
        y += np.outer(
            shape,
            (s * lfilter([1.0], [1.0, -np.exp(s / rate)], x.astype(complex))).imag,
        )
    y += 0.03 * y.std() * np.random.default_rng(1).standard_normal(y.shape)
    return TimeHistory(
        y, rate, tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(7)), "made"
    )


def swept() -> np.ndarray:
    """The turns of a machine between 1 and 5 Hz, three times up and down."""
    turns = np.cumsum(3 - 2 * np.cos(2 * np.pi * TIME / 300)) / RATE
    return 3 * PUSH * np.sin(2 * np.pi * turns) + 2 * PUSH[::-1] * np.sin(
        4 * np.pi * turns
    )


def stamps(intervals: np.ndarray) -> np.ndarray:
    at = np.cumsum(intervals) * RATE
    return 40 * PUSH * np.bincount(at[at < N].astype(int), minlength=N)


def check(r: AmbientResult) -> None:
    assert len(r.modes) == F.size, (r.modes.frequencies, r.notes)
    assert np.abs(r.modes.frequencies / F - 1).max() < 4e-3
    assert (np.abs(r.modes.frequencies - F) < 3 * r.uncertainty.frequency).all()
    assert (np.abs(r.modes.damping - Z) < 3.5 * r.uncertainty.damping).all()


def harmonic_at(r: AmbientResult, frequency: float) -> bool:
    """Whether a candidate within 0.5 % of a frequency, Hz, is a harmonic."""
    near = np.abs(r.others.modes.frequencies / frequency - 1) < 0.005
    return bool((near & (np.array(r.others.classes) == "harmonic")).any())


def test_run_ups_leave_no_modes_where_they_turn() -> None:
    r = identify_ambient(record(forces() + swept()))
    check(r)
    assert any("tones of changing frequency" in n for n in r.notes)


def test_only_what_moves_is_taken_out() -> None:
    quiet, loud = record(forces()), record(forces() + swept())
    clean, found = remove_run_ups(loud)
    assert min(x.low for x in found) == pytest.approx(1.0, abs=0.1)
    assert max(x.high for x in found) == pytest.approx(10.0, abs=0.2)
    assert (clean.data - quiet.data).std() < 0.25 * (loud.data - quiet.data).std()
    bursts = forces() * np.where(TIME % 90 < 9, 30.0, 1.0)
    for still in (
        quiet,
        record(bursts),
        record(forces() + 20 * PUSH * np.sin(2 * np.pi * 5 * TIME)),
    ):
        assert remove_run_ups(still) == (still, ())


def test_a_press_moves_no_mode() -> None:
    rng = np.random.default_rng(2)
    r = identify_ambient(
        record(forces() + stamps(1.7 * (1 + 0.02 * rng.standard_normal(600))))
    )
    check(r)
    assert any("one in 1.7 s" in n for n in r.notes)


def test_regular_blows_are_taken_out_and_others_left() -> None:
    rng = np.random.default_rng(2)
    struck = forces() + stamps(1.7 * (1 + 0.003 * rng.standard_normal(600)))
    clean, found = remove_regular_impacts(record(struck))
    assert found is not None
    assert found.interval == pytest.approx(1.7, abs=0.02)
    assert found.count == pytest.approx(900 / 1.7, rel=0.05)
    quiet = record(forces())
    assert (
        (clean.data - quiet.data).std()
        < 0.5 * quiet.data.std()
        < 0.3 * record(struck).data.std()
    )
    for other in (quiet, record(forces() + stamps(rng.exponential(1.7, 600)))):
        assert remove_regular_impacts(other) == (other, None)


@pytest.mark.parametrize("seed", [2, 5])
def test_blows_that_come_out_faint_are_found_where_they_are_due(seed: int) -> None:
    """Of 525 blows of levels that scatter by 25 % some stand among the random forces; one in 100
    may be lost.
    """
    rng = np.random.default_rng(seed)
    at = np.cumsum(1.7 * (1 + 0.003 * rng.standard_normal(525))) * RATE
    level = 18 * (1 + 0.25 * rng.standard_normal(at.size))
    _, found = remove_regular_impacts(
        record(forces() + PUSH * np.bincount(at.astype(int), level, minlength=N))
    )
    assert found is not None
    assert found.count == pytest.approx(at.size, rel=0.01)


def test_blows_of_which_half_are_missing_have_the_interval_of_the_others() -> None:
    """As many intervals are three times the others as are not: their mean is neither."""
    at = 1.7 * np.cumsum(np.tile([1, 3], 66)[:-1]) * RATE
    _, found = remove_regular_impacts(
        record(forces() + 18 * PUSH * np.bincount(at.astype(int), minlength=N))
    )
    assert found is not None
    assert found.interval == pytest.approx(1.7, abs=0.02)


@pytest.mark.parametrize("place", [0.95, 1.05])
def test_a_mode_farther_from_a_harmonic_than_the_speed_wanders_stays(
    place: float,
) -> None:
    """On either side, and though it is sharper than the wander."""
    wander = lfilter([0.02], [1, -0.9998], np.random.default_rng(4).standard_normal(N))
    speed = place * F[3] / 5 * (1 + 0.012 * wander / wander.std())
    turns = np.cumsum(speed) / RATE
    comb = sum(np.sin(2 * np.pi * k * turns + k * k) for k in range(1, 16))
    r = identify_ambient(record(forces() + 0.5 * PUSH * comb))
    assert r.machines[0].wander > 1.1 * Z[3]
    assert np.abs(r.modes.frequencies / F[3] - 1).min() < 4e-3


def test_three_overlapping_modes_of_much_damping() -> None:
    f, z = np.array([0.5, 0.7, 1.1]), np.array([0.12, 0.1, 0.15])
    r = identify_ambient(
        record(np.random.default_rng(0).standard_normal((3, 36000)), f, z, 10.0)
    )
    assert len(r.modes) == 3, (r.modes.frequencies, r.notes)
    np.testing.assert_allclose(r.modes.frequencies, f, rtol=0.06)
    np.testing.assert_allclose(r.modes.damping, z, rtol=0.35)


def test_a_mode_beside_the_line_of_an_unsteady_machine_stays() -> None:
    """A line of wandering phase, 0.24 Hz, or 3.5 lines of its spectrum, below the lowest mode."""
    turns = (
        1.96 * TIME
        + 0.006 * np.cumsum(np.random.default_rng(8).standard_normal(N)) / 2 / np.pi
    )
    r = identify_ambient(record(forces() + 3 * PUSH * np.sin(2 * np.pi * turns)))
    check(r)
    assert harmonic_at(r, 1.96)


def test_a_machine_whose_speed_wanders_on_a_mode_is_named() -> None:
    """No mode stands there: what is found is a harmonic."""
    wander = lfilter([0.02], [1, -0.9998], np.random.default_rng(4).standard_normal(N))
    speed = F[3] * (1 + 0.003 * wander)
    r = identify_ambient(
        record(forces() + PUSH * np.sin(2 * np.pi * np.cumsum(speed) / RATE))
    )
    np.testing.assert_allclose(r.modes.frequencies, np.delete(F, 3), rtol=4e-3)
    assert harmonic_at(r, F[3])
    assert not len(identify_ambient(record(forces())).others)


def test_a_rotor_slower_than_all_modes_is_one_machine() -> None:
    turns = np.cumsum(0.35 * (1 + 0.002 * np.sin(2 * np.pi * TIME / 300))) / RATE
    comb = sum(np.sin(2 * np.pi * k * turns + k**2) for k in range(1, 26))
    r = identify_ambient(record(forces() + 0.5 * PUSH * comb))
    check(r)
    assert [m.frequency for m in r.machines] == pytest.approx([0.35], rel=1e-3)


def test_what_a_line_leaves_that_was_taken_out_is_no_mode() -> None:
    f, z, line = (
        np.array([10.0, 24.43, 33.0]),
        np.array([0.01, 6e-4, 0.012]),
        np.array([24.437]),
    )
    assert line_remainders(f, z, line, 900.0) == (0.0, 24.437, 0.0)
    # beside it
    assert line_remainders(f, z, np.array([24.5]), 900.0) == (0.0, 0.0, 0.0)
    # as the modes are
    assert line_remainders(f, np.full(3, 6e-4), line, 900.0) == (0.0, 0.0, 0.0)
    assert line_remainders(f, z, np.empty(0), 900.0) == (0.0, 0.0, 0.0)
    assert line_remainders(f[:0], z[:0], line, 900.0) == ()


def test_a_fan_of_wandering_phase_takes_the_place_of_no_mode() -> None:
    """A line 0.7 % below a mode, of 1e-4 of its frequency in wander: its sides were a mode of 0.1 %
    damping.
    """
    rate, f, rng = (
        256.0,
        np.array([12.0, 24.6, 33.0, 49.7, 71.0]),
        np.random.default_rng(1),
    )
    drift = lfilter(
        [np.sqrt(1 - 0.99993**2)], [1, -0.99993], rng.standard_normal(int(900 * rate))
    )
    fan = np.cos(2 * np.pi * np.cumsum(24.435 * (1 + 1e-4 * drift)) / rate)
    r = identify_ambient(
        record(
            rng.standard_normal((5, fan.size)) + PUSH * fan, f, np.full(5, 0.01), rate
        )
    )
    assert (r.modes.damping > 0.005).all(), (r.modes.frequencies, r.modes.damping)
    assert (np.abs(r.modes.frequencies[:, None] / f - 1).min(axis=1) < 4e-3).all()
    assert len(r.modes) >= 4
    assert len(r.modes) == 5 or (np.abs(r.others.modes.frequencies - 24.4) < 0.1).any()
