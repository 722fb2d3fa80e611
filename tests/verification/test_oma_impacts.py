"""Records of repeated impacts: decays between them hold the modes, however regular the impacts are.

Five modes, six accelerometers, one impact at a point every `interval` s, sensor noise 60 dB below
the first peak:

    f (Hz)  2.1   4.7   4.9   9.3   14.2
    ζ (%)   1.0   0.8   1.0   0.6   1.2

Impacts at exactly equal intervals T have lines at all multiples of 1/T, which are no machine's.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import AmbientResult, identify_ambient
from ringtrue.signal.tonal_lines import (
    LineFit,
    find_tonal_lines,
    remove_tonal_lines,
)
from ringtrue.signal.transients import find_events

F, Z = np.array([2.1, 4.7, 4.9, 9.3, 14.2]), np.array([1.0, 0.8, 1.0, 0.6, 1.2]) / 100
PHI = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 5)))[0]
# relative: the lowest mode falls by 3.3 nepers between impacts, and some of it is left at the next
DAMPING = 0.06


def response(force: np.ndarray, rate: float, slower: float = 1.0) -> np.ndarray:
    """Accelerations (6, sample) for modal forces (5, sample)."""
    q = []
    for pole, x in zip(
        2 * np.pi * F / slower * (-Z + 1j * np.sqrt(1 - Z**2)), force, strict=True
    ):
        a = np.exp(pole / rate)
        q.append(
            2
            * np.real(
                pole**2 / (2j * pole.imag) * lfilter([0, (a - 1) / pole], [1, -a], x)
            )
        )
    return PHI @ np.array(q)


def history(data: np.ndarray, rate: float) -> TimeHistory:
    return TimeHistory(
        data,
        rate,
        tuple(Channel(f"{i + 1}+Z", "acceleration", "m/s^2") for i in range(6)),
        "made",
    )


def dropped(
    times: np.ndarray,
    seconds: float,
    rate: float = 64.0,
    *,
    ambient: float = 0.0,
    levels: float = 0.0,
    slower: float = 1,
) -> TimeHistory:
    """Impacts at `times` (s); `ambient` is the RMS of random vibration over the first peak."""
    rng, samples = np.random.default_rng(0), int(seconds * rate)
    force = np.zeros(samples)
    force[np.round(times * rate).astype(int)] = 1 + levels * rng.standard_normal(
        times.size
    )
    y = response(np.outer(PHI[0], force), rate, slower)
    peak = np.abs(y).max()
    random = response(rng.standard_normal((5, samples)), rate, slower)
    y += ambient * peak * random / random.std()
    return history(y + 1e-3 * peak * rng.standard_normal(y.shape), rate)


def dropped_elsewhere(
    interval: float, count: int, seed: int, rate: float = 64.0
) -> TimeHistory:
    """A weight dropped at equal intervals, each time at another of six points, beside random forces
    of a tenth of its motion.
    """
    rng = np.random.default_rng(seed)
    at = (interval * rate * np.arange(0.5, count)).astype(int)
    force = np.zeros((6, int(interval * count * rate)))
    force[rng.integers(0, 6, count), at] = rng.uniform(0.7, 1.3, count)
    y = response(PHI.T @ force, rate)
    random = response(rng.standard_normal((5, force.shape[1])), rate)
    y += 0.1 * y.std() / random.std() * random
    return history(y + 0.01 * y.std() * rng.standard_normal(y.shape), rate)


def every(interval: float, seconds: float) -> np.ndarray:
    return np.arange(3.0, seconds, interval)


def check(r: AmbientResult, damping: float = DAMPING, slower: float = 1.0) -> None:
    np.testing.assert_allclose(
        r.modes.frequencies, F / slower, rtol=2e-3, err_msg=str(r.notes)
    )
    np.testing.assert_allclose(r.modes.damping, Z, rtol=damping)
    assert (
        np.abs(r.modes.frequencies - F / slower)
        < 4 * r.uncertainty.frequency + 1e-4 * F
    ).all()
    assert not r.harmonics


@pytest.mark.parametrize("interval", [20.0, 25.0, 40.0, 80.0])
def test_impacts_at_equal_intervals_are_no_machine(interval: float) -> None:
    r = identify_ambient(dropped(every(interval, 400.0), 400.0))
    check(r)
    assert any("the decays after them are used" in n for n in r.notes)


def test_an_hour_third_of_equal_impacts_is_no_press() -> None:
    """60 impacts: the mean response to them is what the modes are found in."""
    r = identify_ambient(dropped(every(20.0, 1200.0), 1200.0))
    check(r)
    assert not any("taken out" in n for n in r.notes)


@pytest.mark.parametrize(
    ("levels", "scatter", "rate"),
    [(0.2, 0.0, 64.0), (0.0, 0.5, 64.0), (0.0, 0.0, 256.0)],
    ids=["level", "time", "rate"],
)
def test_impacts_of_a_hand(levels: float, scatter: float, rate: float) -> None:
    times = every(25.0, 400.0)
    times = times + scatter * np.random.default_rng(1).standard_normal(times.size)
    check(identify_ambient(dropped(times, 400.0, rate, levels=levels)))


@pytest.mark.parametrize(("ambient", "damping"), [(0.003, DAMPING), (0.1, 0.5)])
def test_impacts_beside_random_forces(ambient: float, damping: float) -> None:
    check(
        identify_ambient(dropped(every(25.0, 400.0), 400.0, ambient=ambient)), damping
    )


# 8 to 12 periods of the first mode
@pytest.mark.parametrize("interval", [3.8, 4.7, 5.6])
def test_impacts_that_follow_soon_leave_no_bias(interval: float) -> None:
    """Correlations that reach across impacts at equal intervals have lines at all multiples of
    1/T, which move the lowest mode by many of its stated deviations.
    """
    off = []
    for seed in range(4):
        r = identify_ambient(dropped_elsewhere(interval, 90, seed))
        assert len(r.modes) == 5, r.notes
        frequency = (r.modes.frequencies - F) / r.uncertainty.frequency
        damping = (r.modes.damping - Z) / r.uncertainty.damping
        off.append([frequency, damping])
    assert np.abs(off).max() < 4.0
    assert np.sqrt(np.square(off).mean()) < 1.4


def test_modes_with_few_periods_between_impacts_are_named() -> None:
    few = identify_ambient(dropped_elsewhere(1.9, 90, 0, rate=128.0))
    many = identify_ambient(dropped_elsewhere(4.7, 90, 0, rate=128.0))
    assert any("fewer than 5 periods" in note for note in few.notes)
    assert not any("fewer than 5 periods" in note for note in many.notes)


def test_modes_of_a_slow_structure() -> None:
    """The lowest mode falls by 0.8 nepers only from one impact to the next."""
    check(identify_ambient(dropped(every(25.0, 400.0), 400.0, slower=4.0)), 0.1, 4.0)


@pytest.mark.parametrize(
    ("f", "taken_out"), [(12.0, False), (11.3456, True)], ids=["in step", "beside"]
)
def test_a_machine_beside_the_impacts_is_no_mode(f: float, taken_out: bool) -> None:
    """At a multiple of 1/T it is left in the record, and is a pole without damping."""
    clean = dropped(every(25.0, 400.0), 400.0)
    line = (
        3e-3
        * np.abs(clean.data).max()
        * np.sin(2 * np.pi * f * np.arange(clean.data.shape[1]) / 64.0)
    )
    r = identify_ambient(history(clean.data + line, 64.0))
    np.testing.assert_allclose(r.modes.frequencies, F, rtol=2e-3, err_msg=str(r.notes))
    assert bool(r.harmonics) == taken_out
    assert taken_out or [note.code for note in r.others.notes] == ["candidate impacts"]


@pytest.mark.parametrize("rate", [64.0, 256.0, 1024.0])
def test_the_times_of_impacts_are_known_to_a_sample_of_their_motion(
    rate: float,
) -> None:
    times = every(25.0, 400.0)
    found = find_events(dropped(times, 400.0, rate).data, rate)
    np.testing.assert_allclose(found.times, times, atol=1 / 16)
    assert found.driven
    assert found.in_step(np.array([1.0, 1.02])).tolist() == [True, False]


def test_many_lines_are_bounded_and_parts_of_them_leave_as_little_as_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng, rate, seconds = np.random.default_rng(0), 64.0, 600.0
    t = np.arange(int(rate * seconds)) / rate
    quiet = rng.standard_normal((6, t.size))
    fifty = np.sin(2 * np.pi * np.linspace(7.01, 25.3, 50)[:, None] * t).sum(axis=0)
    found = find_tonal_lines(history(quiet + fifty, rate))
    assert len(found) == 50
    left = remove_tonal_lines(
        history(quiet + fifty, rate), [h.frequency for h in found]
    )
    monkeypatch.setattr("ringtrue.signal.tonal_lines.FIT", LineFit(together=50))
    best = remove_tonal_lines(
        history(quiet + fifty, rate), [h.frequency for h in found]
    )
    assert (
        best.data - quiet
    ).std() < 0.2 * fifty.std()  # 400 unknowns take some of the noise of 38,400 samples
    assert (left.data - best.data).std() < 1e-3 * fifty.std()
    comb = sum(np.sin(2 * np.pi * f * t + f**2) for f in np.arange(6.5, 30.0, 0.06))
    monkeypatch.undo()
    most = LineFit().together ** 2
    assert len(find_tonal_lines(history(0.1 * quiet + comb, rate))) == most
