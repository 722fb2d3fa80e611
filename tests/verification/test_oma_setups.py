"""What is stated of shapes put together from several setups, against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.merge import merge_modes
from ringtrue.identification.pick import modes_of
from ringtrue.identification.poles import PoleSet
from ringtrue.identification.setups import preger
from ringtrue.identification.ssi import SsiCov
from ringtrue.identification.variance import frequency_damping
from ringtrue.identification.variance import std as root_sum

F, Z, RATE = np.array([1.1, 1.9, 2.3, 3.4]), np.array([0.012, 0.01, 0.015, 0.02]), 12.5
PHI = np.random.default_rng(5).standard_normal((11, 4))
PLACES = [
    [0, 1, *range(2 + 3 * k, 5 + 3 * k)] for k in range(3)
]  # two references, three channels that move


def pairs(modes: ModeSet) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the truth of the modes that are found, and theirs in what was found."""
    off = np.abs(modes.frequencies[:, None] / F - 1)
    true = np.flatnonzero(off.min(axis=0) < 0.02)
    return true, off[:, true].argmin(axis=0)


def errors(modes: ModeSet, std: Uncertainty) -> np.ndarray:
    """Of the moduli of the shapes over their deviations, but for the largest components."""
    true, at = pairs(modes)
    expected = PHI[np.ix_([int(c) for c in modes.channels], true)]
    shape = np.abs(modes.shapes[:, at])
    top = (shape.argmax(axis=0), np.arange(true.size))
    gap = shape - np.abs(expected / expected[top])
    gap[top] = np.nan
    return np.asarray((gap / std.shape[:, at])[np.isfinite(gap)])


def measured(at: list[int], rng: np.random.Generator) -> tuple[ModeSet, Uncertainty, str]:
    """The shapes at some channels with an error of each component, largest component 1, of any
    scale before.
    """
    noisy = PHI[at] + 0.03 * rng.standard_normal((len(at), F.size))
    top = (np.abs(noisy).argmax(axis=0), np.arange(F.size))
    shape = noisy / noisy[top]
    std = 0.03 / np.abs(noisy[top]) * np.sqrt(1 + shape**2)
    std[top] = 0.0
    modes = ModeSet(F * (1 + 1e-3 * rng.standard_normal(F.size)), Z, shape, tuple(map(str, at)))
    return modes, Uncertainty.independent(1e-3 * F, 0.1 * Z, std), "a"


def recorded(seed: int, samples: int = 7500) -> list[TimeHistory]:
    """Three setups of ten minutes, each with forces of its own."""
    rng, setups = np.random.default_rng(seed), []
    for at in PLACES:
        y = np.zeros((len(at), samples))
        for phi, s in zip(PHI[at].T, 2 * np.pi * F * (-Z + 1j * np.sqrt(1 - Z**2)), strict=True):
            force = rng.uniform(0.5, 2) * rng.standard_normal(samples)
            y += np.outer(
                phi, (s * lfilter([1.0], [1.0, -np.exp(s / RATE)], force.astype(complex))).imag
            )
        y += 0.03 * y.std() * rng.standard_normal(y.shape)
        setups.append(
            TimeHistory(y, RATE, tuple(Channel(str(i), "acceleration") for i in at), "made")
        )
    return setups


def as_one(setups: list[TimeHistory]) -> tuple[ModeSet, Uncertainty]:
    """All setups identified as one."""
    return preger(setups, ("0", "1"), SsiCov(block_rows=30, order_max=16)).modes()


def test_shapes_glued_from_setups_lie_within_their_deviations() -> None:
    rng = np.random.default_rng(0)
    sets = [merge_modes([measured(at, rng) for at in PLACES]) for _ in range(60)]
    gap = np.concatenate([errors(m.modes, m.uncertainty) for m in sets])
    assert 0.90 < (np.abs(gap) < 1.96).mean() < 0.99


def test_a_mean_over_orders_is_better_known_than_each_that_moves_by_itself() -> None:
    k, s = 16, 2 * np.pi * 2.0 * (-0.01 + 1j)
    moved = 1e-3 * np.abs(s) * np.eye(k) * (1 + 0.5j)  # each order by a block of its own
    df, dz = frequency_damping(np.full(k, s), moved)
    poles = PoleSet(
        np.arange(2, 2 * k + 2, 2), np.full(k, s), np.ones((3, k)), root_sum(df), root_sum(dz)
    )
    apart = modes_of(poles, ("a", "b", "c"), deviation=moved)[1]
    alike = modes_of(poles, ("a", "b", "c"), deviation=np.tile(moved.sum(axis=0), (k, 1)) / 4)[1]
    each = modes_of(poles, ("a", "b", "c"))[1]
    used = round(float((each.frequency[0] / apart.frequency[0]) ** 2))
    assert used == k - 1  # the first order has none before it
    assert each.damping[0] / apart.damping[0] == pytest.approx(np.sqrt(used))
    assert alike.frequency == pytest.approx(each.frequency)


def test_deviations_of_one_identification_of_all_setups() -> None:
    found = [as_one(recorded(seed)) for seed in range(3)]
    for m, std in found:
        true, at = pairs(m)
        assert true.size == F.size
        assert (np.abs(m.frequencies[at] - F) < 4 * std.frequency[at]).all()
        assert np.median(std.frequency[at] / F) < 2.5e-3
        assert (np.abs(m.damping[at] - Z) < 4 * std.damping[at]).all()
    gap = np.concatenate([errors(m, std) for m, std in found])
    assert (np.abs(gap) < 1.96).mean() > 0.88
    assert (gap**2).mean() > 0.2
