"""Machines whose speed wanders: their harmonics over the angle of the shaft, in random vibration.

Each record is a structure of seven modes of 0.8 to 2 % under independent white forces, seen by six
channels, and a comb a_k cos(kθ(t) + φ_k): θ' wanders about the mean by a filtered random walk. The
level of a harmonic is its power over that of the vibration in 0.19 Hz (a Hann window of 8 s).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter, welch

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.signal.machines import (
    Machine,
    find_machines,
    near_harmonics,
    remove_machines,
)
from ringtrue.signal.shaft_tracking import ShaftCourse

RATE, SECONDS = 300.0, 300.0
SAMPLES = int(RATE * SECONDS)
LONGEST = 0.44 * RATE


@dataclass(frozen=True)
class Comb:
    """Speed in Hz, its relative wander, seconds it is correlated over, and level in dB."""

    speed: float
    wander: float
    seconds: float
    level: float
    missing: tuple[int, ...] = ()

    @property
    def orders(self) -> Int:
        every = np.arange(1, int(LONGEST / self.speed))
        return every[~np.isin(every, self.missing)]

    def angle(self, rng: np.random.Generator) -> Float:
        """(sample,) revolutions; the mean speed is exact."""
        rest = np.exp(-1 / (RATE * self.seconds / 2))
        slow = lfilter([1.0], np.poly([rest, rest]), rng.standard_normal(SAMPLES))
        slow -= slow.mean()
        turned = np.cumsum(self.speed * (1 + self.wander * slow / slow.std())) / RATE
        return np.asarray(turned)


def structure(rng: np.random.Generator, frequencies: Any_, channels: int = 6) -> Any_:
    """(ch, sample) float32."""
    y = np.zeros((channels, SAMPLES), dtype=np.float32)
    for f, z in zip(
        frequencies, rng.uniform(0.008, 0.02, len(frequencies)), strict=True
    ):
        pole = np.exp(2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2)) / RATE)
        a = [1.0, -2 * pole.real, abs(pole) ** 2]
        q = lfilter([1.0, -1.0], a, rng.standard_normal(SAMPLES)) * np.sqrt(z * f)
        y += np.outer(rng.standard_normal(channels), q).astype(np.float32)
    noise = 0.03 * y.std() * rng.standard_normal(y.shape)
    return y + noise.astype(np.float32)


def with_combs(rng: np.random.Generator, quiet: Any_, *combs: Comb) -> Any_:
    freqs, power = welch(quiet, RATE, nperseg=int(8 * RATE))
    y = quiet.copy()
    for comb in combs:
        angle = comb.angle(rng)
        for k in comb.orders:
            level = 10 ** (rng.normal(comb.level, 3) / 10) * 1.5 / 8
            around = np.array([np.interp(k * comb.speed, freqs, p) for p in power])
            wave = np.cos(2 * np.pi * (k * angle + rng.uniform()))
            sizes = np.sqrt(2 * level * around) * rng.choice([-1, 1], len(y))
            y += np.outer(sizes, wave).astype(np.float32)
    return y


def record(data: Any_) -> TimeHistory:
    return TimeHistory(
        data, RATE, tuple(Channel(str(k)) for k in range(len(data))), "made"
    )


@pytest.mark.parametrize(
    "comb",
    [
        Comb(3.3, 0.003, 20, 10, missing=(1, 4, 5, 9, 16, 17)),
        Comb(7.1, 0.0, 20, 5),
        Comb(6.4, 0.02, 60, 20),
    ],
)
def test_the_speed_its_wander_and_all_harmonics_are_found(comb: Comb) -> None:
    rng = np.random.default_rng(int(100 * comb.speed))
    quiet = structure(rng, np.exp(rng.uniform(np.log(4), np.log(120), 7)))
    (machine,) = find_machines(record(with_combs(rng, quiet, comb)))
    assert machine.frequency == pytest.approx(comb.speed, rel=1e-3)  # as the issue asks
    assert machine.wander == pytest.approx(comb.wander, rel=0.15, abs=2e-4)
    found = machine.harmonics
    assert np.isin(comb.orders, found).mean() > 0.95
    # one in a hundred orders by chance
    assert np.isin(found, comb.orders).sum() >= found.size - 3
    assert machine.chance < 1e-6


@pytest.mark.parametrize("seed", [19, 28, 35, 51, 73])
def test_a_part_or_a_multiple_of_the_speed_is_not_taken_for_it(seed: int) -> None:
    """Combs of 60 to 140 lines, 20 to 29 dB high: their orders beat with those of a multiple, and
    their images by an interpolation look like lines of a part.
    """
    rng = np.random.default_rng(7000 + seed)
    comb = Comb(
        rng.uniform(0.9, 2.2),
        float(rng.choice([0, 0.001, 0.003])),
        rng.uniform(10, 60),
        rng.uniform(15, 30),
    )
    quiet = structure(rng, np.exp(rng.uniform(np.log(4), np.log(120), 7)))
    (machine,) = find_machines(record(with_combs(rng, quiet, comb)))
    assert machine.frequency == pytest.approx(comb.speed, rel=1e-5)


def test_smoothing_an_angle_takes_nothing_off_its_ends() -> None:
    """A short record of many revolutions, as its parts are looked at, loses none of them."""
    knots = np.linspace(0.0, 40.0, 90)
    even = ShaftCourse(knots, 3.0 * knots)
    assert even.smoothed().knots == pytest.approx(knots, abs=1e-12)
    assert even.smoothed().revolutions == pytest.approx(3.0 * knots, abs=1e-12)
    ripple = 0.01 * np.cos(np.pi * np.arange(90))
    left = ShaftCourse(knots, 3.0 * knots + ripple).smoothed().revolutions - 3.0 * knots
    assert np.abs(left[6:-6]).max() < 1e-4


def test_two_machines_are_told_apart() -> None:
    rng = np.random.default_rng(8)
    combs = (Comb(5.2, 0.002, 20, 12), Comb(8.3, 0.001, 40, 16))
    quiet = structure(rng, np.array([6, 11, 17, 31, 62, 97, 120]))
    found = find_machines(record(with_combs(rng, quiet, *combs)))
    speeds = sorted(machine.frequency for machine in found)
    assert speeds == pytest.approx([5.2, 8.3], rel=1e-3)


def test_what_is_taken_out_is_the_comb() -> None:
    """Modes 1 % beside harmonics, and one on the sixth, keep their power to 0.3 dB: the half-power
    band of the one that is most narrow has 20 lines, of which the fit takes seven in part.
    """
    rng = np.random.default_rng(21)
    comb = Comb(5.0, 0.002, 30, 20)
    frequencies = (
        5.0
        * np.array([3, 6, 9, 14, 21, 30])
        * np.array([1.01, 1, 0.99, 1.01, 0.99, 1.01])
    )
    quiet = structure(rng, frequencies)
    whole = record(with_combs(rng, quiet, comb))
    machines = find_machines(whole)
    clean = remove_machines(whole, machines)
    left = clean.data - quiet
    assert left.std() < 0.12 * quiet.std()
    freqs, before = welch(quiet, RATE, nperseg=int(30 * RATE))
    _, after = welch(clean.data, RATE, nperseg=int(30 * RATE))
    for f in frequencies:
        band = np.abs(freqs - f) < 0.01 * f
        change = 10 * np.log10(after[:, band].sum() / before[:, band].sum())
        assert abs(change) < 0.3
    assert find_machines(clean) == ()  # no line of it stands out
    assert remove_machines(whole, ()) is whole


@pytest.mark.parametrize("seed", range(4))
def test_structures_are_no_machines(seed: int) -> None:
    """Strings, with modes at multiples of one frequency to 0.1 %, and others."""
    rng = np.random.default_rng(300 + seed)
    frequencies = np.exp(rng.uniform(np.log(4), np.log(120), 9))
    if seed % 2 == 0:
        frequencies = (
            rng.uniform(4, 15) * np.arange(1, 11) * (1 + 1e-3 * rng.standard_normal(10))
        )
    assert find_machines(record(structure(rng, frequencies))) == ()


def test_noise_short_and_dead_records_have_none() -> None:
    rng = np.random.default_rng(5)
    assert find_machines(record(rng.standard_normal((3, 40_000)))) == ()
    assert find_machines(record(rng.standard_normal((3, 50)))) == ()
    assert find_machines(record(np.zeros((2, 5000)))) == ()


def test_the_harmonic_next_to_a_frequency_is_named() -> None:
    t = np.linspace(0, 100, 50)
    slow = Machine(t, 4.0 * t, np.array([1, 2, 5]), 9, 9, 0.0)
    fast = replace(slow, revolutions=7.0 * t, harmonics=np.array([1, 3]))
    near = near_harmonics((slow, fast), [4.04, 12.0, 20.9])
    assert near.machine.tolist() == [0, 0, 1]
    assert near.order.tolist() == [1, 2, 3]
    assert near.distance == pytest.approx([0.01, 0.5, 1 - 20.9 / 21])
    assert near_harmonics((), [4.0]).machine.tolist() == [-1]
