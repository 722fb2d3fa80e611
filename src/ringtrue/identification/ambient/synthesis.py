"""A spectrum of given poles with the residues that fit a measured one best, for a look at a
choice.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Complex, Float


def fit_spectrum(freqs: Float, power: Float, poles: Complex) -> Float:
    """The sum of spectra as poles explain it, (f,).

    The spectrum of responses to white forces is that of decays with the poles of the structure:
    S(ω) = Σ_k 2 Re(r_k/(iω − λ_k)) (Peeters and Van der Auweraer, 2005, PolyMAX of half
    spectra), with r_k by least squares of relative errors, and a level and a slope of noise.

    Parameters
    ----------
    freqs : (f,) float64, Hz
    power : (f,) float64
        Sum of the spectra of all channels.
    poles : (m,) complex128, rad/s
    """
    s = 2j * np.pi * freqs
    decay = 1 / (s[:, None] - poles)
    mirror = 1 / (s[:, None] - poles.conj())
    # r_k and its conjugate at the conjugate pole, real and imaginary part
    real, imaginary = (decay + mirror).real, (1j * (decay - mirror)).real
    ramp = (freqs / max(float(freqs[-1]), 1e-300)) ** 2
    columns = np.concatenate([real, imaginary, np.ones((freqs.size, 1)), ramp[:, None]], axis=1)
    weighted = columns / power[:, None]
    size = np.maximum(np.linalg.norm(weighted, axis=0), np.finfo(float).tiny)
    found, *_ = np.linalg.lstsq(weighted / size, np.ones(freqs.size), rcond=1e-10)
    return np.asarray(columns @ (found / size), dtype=np.float64)
