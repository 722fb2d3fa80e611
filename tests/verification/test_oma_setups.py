"""What is stated of shapes put together from several setups, against the truth."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.common.merging import merge_modes

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


def measured(
    at: list[int], rng: np.random.Generator
) -> tuple[ModeSet, Uncertainty, str]:
    """The shapes at some channels with an error of each component, largest component 1, of any
    scale before.
    """
    noisy = PHI[at] + 0.03 * rng.standard_normal((len(at), F.size))
    top = (np.abs(noisy).argmax(axis=0), np.arange(F.size))
    shape = noisy / noisy[top]
    std = 0.03 / np.abs(noisy[top]) * np.sqrt(1 + shape**2)
    std[top] = 0.0
    modes = ModeSet(
        F * (1 + 1e-3 * rng.standard_normal(F.size)), Z, shape, tuple(map(str, at))
    )
    return modes, Uncertainty.independent(1e-3 * F, 0.1 * Z, std), "a"


def recorded(seed: int, samples: int = 7500) -> list[TimeHistory]:
    """Three setups of ten minutes, each with forces of its own."""
    rng, setups = np.random.default_rng(seed), []
    for at in PLACES:
        y = np.zeros((len(at), samples))
        for phi, s in zip(
            PHI[at].T, 2 * np.pi * F * (-Z + 1j * np.sqrt(1 - Z**2)), strict=True
        ):
            force = rng.uniform(0.5, 2) * rng.standard_normal(samples)
            y += np.outer(
                phi,
                (
                    s * lfilter([1.0], [1.0, -np.exp(s / RATE)], force.astype(complex))
                ).imag,
            )
        y += 0.03 * y.std() * rng.standard_normal(y.shape)
        setups.append(
            TimeHistory(
                y, RATE, tuple(Channel(str(i), "acceleration") for i in at), "made"
            )
        )
    return setups


def test_shapes_glued_from_setups_lie_within_their_deviations() -> None:
    rng = np.random.default_rng(0)
    sets = [merge_modes([measured(at, rng) for at in PLACES]) for _ in range(60)]
    gap = np.concatenate([errors(m.modes, m.uncertainty) for m in sets])
    assert 0.90 < (np.abs(gap) < 1.96).mean() < 0.99
