"""Signal-to-noise ratio at the resonances, from the parts of a simulation or ahead of it from the
spectra.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modal import ModalModel
from ringtrue.core.motions import DERIVATIVE, POWER, Motion
from ringtrue.virtual.noise import power


def resonance_power(spectrum: Complex, poles: Complex, samples: int, rate: float) -> Float:
    """Mean spectral density within the half-power band of each mode.

    Parameters
    ----------
    spectrum : (channel, line) complex128
    poles : (m,) complex128, rad/s

    Returns
    -------
    (channel, m) float64, unit²/Hz
    """
    total = np.concatenate(
        [np.zeros((spectrum.shape[0], 1)), np.cumsum(power(spectrum, samples, rate), axis=1)],
        axis=1,
    )
    f, half = np.abs(poles) / (2 * np.pi), np.abs(poles.real) / (2 * np.pi)
    low = np.floor((f - half) * samples / rate).astype(np.int64).clip(1, spectrum.shape[1] - 1)
    high = (np.ceil((f + half) * samples / rate).astype(np.int64) + 1).clip(
        low + 1, spectrum.shape[1]
    )
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def in_band(poles: Complex, low: float, high: float) -> Complex:
    """The poles between two frequencies, Hz."""
    f = np.abs(poles) / (2 * np.pi)
    return np.asarray(poles[(f >= low) & (f <= high)])


def ratio_db(signal: Float, noise: Float) -> Float:
    """10·lg(signal/noise), dB."""
    tiny = np.finfo(np.float64).tiny
    return np.asarray(10 * np.log10(np.maximum(signal, tiny) / np.maximum(noise, tiny)))


def expected_power(model: ModalModel, poles: Complex, input_psd: Float, quantity: Motion) -> Float:
    """(out, m) spectral density at the resonances, inputs uncorrelated with `input_psd` (in, m)
    there.
    """
    f = np.abs(poles) / (2 * np.pi)
    power_of_s = DERIVATIVE[quantity] - POWER[model.kind]
    h = np.moveaxis(model.synthesise(f), 0, -1)  # (out, in, m)
    return np.asarray(
        np.einsum("oim,im->om", np.abs(h) ** 2, input_psd) * (2 * np.pi * f) ** (2 * power_of_s)
    )
