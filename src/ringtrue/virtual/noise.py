"""Random and periodic signals as spectra: coloured Gaussian noise, sensor noise, drift, mains
hum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """Self-noise with a 1/f part: S(f) = density²·(1 + corner/f).

    Attributes
    ----------
    density : float, unit/√Hz
        Far above the corner.
    corner : float, Hz
    """

    density: float
    corner: float

    def psd(self, freqs: Float) -> Float:
        """(line,) one-sided spectral density, unit²/Hz; 0 at 0 Hz, where an offset stands
        instead.
        """
        safe = np.where(freqs > 0, freqs, np.inf)
        return np.asarray(np.where(freqs > 0, self.density**2 * (1 + self.corner / safe), 0.0))


def coloured(psd: Float, samples: int, rate: float, rng: np.random.Generator) -> Complex:
    """Spectra of Gaussian noise, periodic over the record.

    Parameters
    ----------
    psd : (row, line) float64
        One-sided spectral densities at the lines of the record, unit²/Hz.
    samples : int
    rate : float, Hz

    Returns
    -------
    (row, line) complex128
    """
    normal = rng.standard_normal((*psd.shape, 2)).view(np.complex128)[..., 0]
    normal *= np.sqrt(0.25 * rate * samples * psd)
    return np.asarray(normal)


def white(
    count: int, density: float, samples: int, rate: float, rng: np.random.Generator
) -> Complex:
    """Spectra (count, line) of independent white noise of a density, unit/√Hz, without an offset:
    as of `coloured`.
    """
    psd = np.full((count, samples // 2 + 1), density**2)
    psd[:, 0] = 0.0
    return coloured(psd, samples, rate, rng)


def power(spectrum: Complex, samples: int, rate: float) -> Float:
    """Periodogram (row, line) of a spectrum, one-sided, unit²/Hz."""
    return np.asarray(2.0 / (rate * samples) * (spectrum.real**2 + spectrum.imag**2))


def tone(freq: float, amplitude: Float, phase: Float, samples: int, rate: float) -> Complex:
    """Spectra (row, line) of amplitude·cos(2πft + phase), f moved to the nearest line."""
    out = np.zeros((amplitude.size, samples // 2 + 1), dtype=np.complex128)
    line = round(freq * samples / rate)
    if 0 < line < out.shape[1]:
        out[:, line] = 0.5 * samples * amplitude * np.exp(1j * phase)
    return out


def hum(
    amplitude: Float, samples: int, rate: float, rng: np.random.Generator, mains: float = 50.0
) -> Complex:
    """Mains hum and its third harmonic (30 %); lines above half the rate are filtered away.

    Returns
    -------
    (row, 2) complex128
        Spectra at the lines `hum_lines`, 0 where there is no such line.
    """
    at = hum_lines(samples, rate, mains)
    phase = rng.uniform(0, 2 * np.pi, (amplitude.size, 2))
    return np.asarray(
        0.5 * samples * amplitude[:, None] * [1.0, 0.3] * np.exp(1j * phase) * (at > 0)
    )


def hum_lines(samples: int, rate: float, mains: float = 50.0) -> Int:
    """(2,) lines nearest to the mains frequency and its third harmonic; 0 where beyond half the
    rate.
    """
    at = np.round(np.array([1, 3]) * mains * samples / rate).astype(np.int64)
    return np.asarray(np.where(at < samples // 2, at, 0))


def anti_alias(freqs: Float, rate: float, start: float = 0.4) -> Float:
    """(line,) gain of the recorder's filter: flat to `start` of the rate, cosine to 0 at half of
    it.
    """
    x = np.clip((freqs / rate - start) / (0.5 - start), 0.0, 1.0)
    return np.asarray(0.5 * (1 + np.cos(np.pi * x)))
