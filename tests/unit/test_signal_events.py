"""Events in a record that nobody measured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.arrays import Float
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.signal.transients import find_events

RATE, SECONDS = 64.0, 1200
FREQUENCIES, DAMPING = np.array([2.0, 2.3, 6.1]), np.array([0.02, 0.025, 0.012])
SHAPES = np.array(
    [[1.0, 0.8, -0.6], [0.9, -1.0, 0.2], [0.3, 0.7, 1.0], [-0.5, 0.4, 0.8]]
)


def responses(force: Float) -> Float:
    """Accelerations (ch, sample) of three modes under one force (sample,), each sampled exactly."""
    w, z = 2 * np.pi * FREQUENCIES, DAMPING
    poles = np.exp((-z * w + 1j * w * np.sqrt(1 - z**2)) / RATE)
    out = [
        lfilter([1.0, 0.0, -1.0], [1.0, -2 * p.real, abs(p) ** 2], force) for p in poles
    ]
    return SHAPES @ np.array(out)


def jumps(starts: Float, rng: np.random.Generator) -> Float:
    """Three people: six landings each, almost in step."""
    force = np.zeros(int(RATE * SECONDS))
    for t in starts:
        at = t + 0.45 * np.arange(6)[:, None] + 0.03 * rng.normal(size=(6, 3))
        np.add.at(force, (at * RATE).astype(int).ravel(), rng.uniform(50, 150, 18))
    return force


@pytest.fixture(scope="module")
def starts() -> Float:
    return np.arange(10.0, SECONDS - 40, 31.0)


@pytest.fixture(scope="module")
def jumped(starts: Float) -> Float:
    rng = np.random.default_rng(3)
    force = jumps(starts, rng) + rng.normal(size=int(RATE * SECONDS))
    y = responses(force)
    return y + 0.02 * rng.normal(size=y.shape)


def test_events_are_found_where_they_are(jumped: Float, starts: Float) -> None:
    found = find_events(jumped, RATE)
    at = np.flatnonzero(found.struck) * found.window
    assert found.count == starts.size
    assert found.driven
    assert found.level > 20
    for t in starts:
        assert np.abs(at - t).min() < 0.5
    gap = at[:, None] - starts
    assert np.all(
        ((gap > -0.8) & (gap < 6)).any(axis=1)
    )  # two windows of a quarter of a second more


def test_noise_and_the_spike_of_one_sensor_are_no_events() -> None:
    rng = np.random.default_rng(1)
    y = responses(rng.normal(size=int(RATE * SECONDS)))
    assert not find_events(y, RATE).count
    y[1, 1000] += 1e4
    assert not find_events(y, RATE).count
    assert not find_events(np.zeros((3, 1000)), RATE).count
    assert not find_events(y[:, :10], RATE).count


def test_no_pair_of_samples_has_an_event_between_them(jumped: Float) -> None:
    found, lags, rate = find_events(jumped, RATE), 30, RATE / 4
    n = jumped.shape[1] // 4
    keep = found.free(n, rate, lags)
    assert keep is not None
    struck = np.floor(np.flatnonzero(found.struck) * found.window * rate).astype(int)
    for t in np.flatnonzero(keep):
        assert not np.any((struck > t) & (struck <= t + lags))
    assert found.free(n, rate, 10 * n) is None


def test_decays_after_events_give_the_damping_that_the_whole_record_gets_wrong(
    jumped: Float, monkeypatch: pytest.MonkeyPatch
) -> None:
    history = TimeHistory(
        jumped, RATE, tuple(Channel(f"c{k}") for k in range(len(jumped)))
    )

    def error() -> Float:
        found = identify_ambient(history).modes
        at = np.abs(found.frequencies[:, None] / FREQUENCIES - 1).argmin(0)
        return np.abs(found.damping[at] / DAMPING - 1)

    with_events = error()
    assert with_events.max() < 0.1
    monkeypatch.setattr(
        "ringtrue.identification.ambient.record_bands.find_events",
        lambda data, rate, gone: find_events(data[:, :1], rate),
    )
    assert error().max() > 2 * with_events.max()


@pytest.mark.parametrize("at", [[20.0], [20.0, 60.0, 100.0], [20.0, 200.0, 260.0]])
def test_few_blows_in_silence_give_all_modes(at: list[float]) -> None:
    """All blows may lie in one half of the record, the rest of which is the noise of the
    sensors.
    """
    rng = np.random.default_rng(0)
    force = np.zeros(int(RATE * 300))
    force[(np.array(at) * RATE).astype(int)] = 100 * rng.uniform(0.5, 1.5, len(at))
    y = responses(force) + 0.02 * rng.normal(size=(4, force.size))
    result = identify_ambient(
        TimeHistory(y, RATE, tuple(Channel(f"{i}+Z") for i in range(1, 5)))
    )
    np.testing.assert_allclose(result.modes.frequencies, FREQUENCIES, rtol=3e-3)
    np.testing.assert_allclose(result.modes.damping, DAMPING, rtol=0.1)


def test_blows_without_decays_are_no_modes() -> None:
    rng = np.random.default_rng(1)
    y = 0.02 * rng.normal(size=(4, int(RATE * 300)))
    for k in (2000, 9000, 15000):
        y[:, k] += 5 * rng.normal(size=4)
    result = identify_ambient(
        TimeHistory(y, RATE, tuple(Channel(f"{i}+Z") for i in range(1, 5)))
    )
    assert not len(result.modes)
    assert any("3 events" in n for n in result.notes)
