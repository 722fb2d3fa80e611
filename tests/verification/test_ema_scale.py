"""How well modal masses are known: blows that are skewed, errors that all responses share, drifting
sensors.

Four modes of unit modal mass at twelve points, two of them struck; 1 % of noise in each FRF, five
averages.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.modes import Norm
from ringtrue.core.signals import Channel, FrfSet, Impacts
from ringtrue.identification.frf.data_checks import sound_pairs
from ringtrue.identification.frf.pipeline import (
    HammerModes,
    HammerResult,
    identify_hammer,
)

FN = np.array([11.0, 17.0, 26.0, 38.0])
ZETA = np.array([0.01, 0.012, 0.008, 0.01])
PHI = np.random.default_rng(3).standard_normal((12, 4))
PHI[4] = [1.2, -1.0, 1.1, 0.9]  # a point that sees all modes
STRUCK = [0, 7]


def frfs(seed: int, struck: np.ndarray, shared: float = 0.0) -> FrfSet:
    """Accelerances; `struck` (in, mode) takes the place of the shapes there, `shared` is an error
    of each column.
    """
    rng = np.random.default_rng(seed)
    f = np.arange(1, 800) * 0.0625
    s, w = 2j * np.pi * f, 2 * np.pi * FN
    h = np.einsum(
        "fm,om,im->foi",
        s[:, None] ** 2 / (s[:, None] ** 2 + 2 * ZETA * w * s[:, None] + w**2),
        PHI,
        struck,
    )
    h = h * (1 + shared * rng.standard_normal(2))
    noise = 0.01 * np.sqrt((np.abs(h) ** 2).mean(axis=0)) * np.ones(h.shape)
    h = h + noise * (
        rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape)
    ) / np.sqrt(2)
    coherence = 1 / (1 + 4 * ((noise / np.abs(h)) ** 2 + 2 * shared**2))
    out = tuple(Channel(f"{k + 1}+Z", "acceleration", "m/s^2") for k in range(12))
    given = tuple(Channel(f"{k + 1}+Z", "force", "N") for k in STRUCK)
    return FrfSet(h, f, out, given, coherence, np.full(2, 5.0))


def scores(result: HammerResult) -> np.ndarray:
    """Errors of the shapes' moduli in stated deviations."""
    assert (len(result.modes), result.modes.norm) == (4, Norm.MASS)
    return np.asarray(
        (np.abs(result.modes.shapes) - np.abs(PHI)) / result.uncertainty.shape
    )


def test_a_skewed_blow_makes_the_modal_mass_doubtful_and_is_told() -> None:
    """A fifth of another direction in one of two blows; the errors of all shapes are some 10 %."""
    skewed = PHI[STRUCK] + np.array([[0.3], [0.0]]) * np.random.default_rng(
        4
    ).standard_normal(4)
    result = identify_hammer(frfs(0, skewed), HammerModes(fmax=45.0))
    assert any("1+Z 8+Z disagree" in n for n in result.notes)
    assert np.abs(np.abs(result.modes.shapes / PHI) - 1).max() > 0.05
    assert np.mean(np.abs(scores(result)) < 2.5) > 0.9
    straight = identify_hammer(frfs(0, PHI[STRUCK]), HammerModes(fmax=45.0))
    assert not any("disagree" in n for n in straight.notes)
    assert 0.8 < np.sqrt(np.mean(scores(straight) ** 2)) < 1.2


def test_an_error_that_all_responses_share_is_in_the_deviations() -> None:
    """3 % on the force of each reference, which the coherence shows and no fit can: rms of the
    scores near 1.
    """
    all_scores = [
        scores(identify_hammer(frfs(k, PHI[STRUCK], 0.03), HammerModes(fmax=45.0)))
        for k in range(12)
    ]
    assert 0.6 < np.sqrt(np.mean(np.square(all_scores))) < 1.6


def test_noise_on_the_force_is_in_the_deviations() -> None:
    """Of every blow 3 % of the pulse at the lines of the modes, known from the record; one blow, so
    no coherence.
    """
    blows = Impacts(
        np.zeros((2, 0)),
        np.zeros((2, 0)),
        np.eye(2)[:, None],
        np.array([0.0, 50.0]),
        np.full((2, 2), 9e-4),
    )
    all_scores = []
    for seed in range(12):
        bare = frfs(seed, PHI[STRUCK])
        noisy = bare.data * (
            1 + 0.03 / np.sqrt(2) * np.random.default_rng(100 + seed).standard_normal(2)
        )
        told = replace(
            bare,
            data=noisy,
            impacts=replace(blows, weight=np.repeat(blows.weight, 12, axis=1)),
        )
        all_scores.append(scores(identify_hammer(told, HammerModes(fmax=45.0))))
    assert 0.6 < np.sqrt(np.mean(np.square(all_scores))) < 1.6


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_drift_does_not_turn_a_driving_point(sign: float) -> None:
    """The lowest lines hold a drift whose mobility is far above that of the modes."""
    x = frfs(1, sign * PHI[STRUCK])
    h = x.data.copy()
    h[:6] -= sign * 400j
    assert len(sound_pairs(replace(x, data=h))) == (2 if sign > 0 else 0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("phase", [-2.0, -0.7, 0.0, 0.7])
@pytest.mark.parametrize("flexibility", [0.0, 0.01])
def test_a_delay_of_a_sample_does_not_turn_a_driving_point(
    sign: float, phase: float, flexibility: float
) -> None:
    """Most lines lie between resonances, on a mass or a stiffness line; the phase is that at the
    highest of them.
    """
    f = np.arange(1, 1001) * 0.5
    s, w = 2j * np.pi * f[:, None], 2 * np.pi * np.array([20.0, 35.0, 90.0])
    h = (s**2 / (s**2 + 0.02 * w * s + w**2)).sum(axis=1) + flexibility * s[
        :, 0
    ] ** 2 / w[0] ** 2
    h = sign * h * np.exp(1j * phase * f / f[-1])
    x = replace(
        frfs(1, PHI[STRUCK]),
        freqs=f,
        data=h[:, None, None],
        outputs=(Channel("1+Z", "acceleration"),),
        inputs=(Channel("1+Z", "force"),),
        coherence=np.full((f.size, 1, 1), np.nan),
        averages=np.array([np.nan]),
    )
    assert len(sound_pairs(x)) == (sign > 0)


@pytest.mark.parametrize("delay", [6e-3, -8e-3])
def test_a_response_that_comes_late_is_told(delay: float) -> None:
    x = frfs(2, PHI[STRUCK])
    h = x.data.copy()
    h[:, 4] *= np.exp(-2j * np.pi * x.freqs * delay)[:, None]
    told = [
        n
        for n in identify_hammer(replace(x, data=h), HammerModes(fmax=45.0)).notes
        if "response" in n
    ]
    assert len(told) == 1
    assert told[0].startswith(
        f"response 5+Z looks {1e3 * abs(delay):.0f} ms {'late' if delay > 0 else 'early'}"
    )
    assert not any(
        "response" in n for n in identify_hammer(x, HammerModes(fmax=45.0)).notes
    )
