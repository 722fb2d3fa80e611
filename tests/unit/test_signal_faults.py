"""Spikes are found where they are, and hits, crests and coarse recorders have none."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.signal.channel_checks import find_spikes

RATE = 100.0
N = 6000


def noise(seed: int = 0, count: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    y = rng.standard_normal((count, N + 9))
    return np.stack([np.convolve(x, np.hanning(10), "valid") for x in y])[:, :N]


def history(data: np.ndarray) -> TimeHistory:
    return TimeHistory(
        data,
        RATE,
        tuple(Channel(f"{i + 1}+Z", "acceleration", "m/s^2") for i in range(len(data))),
        "r",
    )


@pytest.mark.parametrize("seed", range(5))
def test_sound_channels_have_no_spikes(seed: int) -> None:
    y = noise(seed)
    assert not find_spikes(history(y))
    coarse = np.round(y / y.std() * 4)  # a recorder of 5 bits
    assert not find_spikes(history(coarse))


def test_hits_are_no_spikes() -> None:
    y = noise()
    t = np.arange(N) / RATE
    for start in (10.0, 31.0):
        y += (
            40
            * y.std()
            * np.where(
                t > start, np.exp(-3 * (t - start)) * np.sin(60 * (t - start)), 0.0
            )
        )
    assert not find_spikes(history(y))


def test_crests_of_a_smooth_signal_are_no_spikes() -> None:
    """A decay sampled finely: the running median leaves it at its crests alone."""
    t = np.arange(N) / RATE
    y = np.exp(-0.2 * t) * (np.sin(2.1 * t) + 0.3 * np.sin(9.7 * t)) + 1e-6 * noise()
    assert not find_spikes(history(y))
    y[0, 3000] += 5.0
    (note,) = find_spikes(history(y))
    assert (note.subject, note.values["count"], note.values["time"]) == ("1+Z", 1, 30.0)
