"""Shapes of two close modes are told apart by their cross spectrum, unless other motion bends it.

Three modes at 1.0, 1.03 and 1.045 Hz with 1 % damping at six points; the last one is not told to
the method.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.identification.ambient.close_modes import Mixing, unmix
from ringtrue.identification.ambient.maximum_likelihood import EstimatedModes
from ringtrue.identification.ambient.spectral_bins import SpectralBins

FREQS, LINES = np.arange(0.7, 1.4, 4e-4), 8
F, Z = np.array([1.0, 1.03, 1.045]), np.full(3, 0.01)
SHAPES = np.linalg.qr(np.random.default_rng(5).standard_normal((6, 3)))[0]
MIXED: Complex = SHAPES[:, :2] @ np.array([[1.0 + 0j, 0.1], [0.05, 1.0]])


def spectra(shared: float) -> SpectralBins:
    """Spectral matrices of accelerations under forces with the correlation `shared`, averaged over
    8 lines.
    """
    nu = FREQS[:, None] / F
    h = 2 * Z * nu**2 / (1 - nu**2 + 2j * Z * nu)
    modal = h[:, :, None] * (np.eye(3) + shared * (1 - np.eye(3))) * h[:, None].conj()
    root = np.linalg.cholesky(SHAPES @ modal @ SHAPES.T + 1e-3 * np.eye(6))
    noise = np.random.default_rng(0).standard_normal(
        (2, FREQS.size, 6, LINES)
    ) / np.sqrt(2)
    y = root @ (noise[0] + 1j * noise[1])
    return SpectralBins(
        FREQS,
        np.full(FREQS.size, float(LINES)),
        y @ y.conj().swapaxes(1, 2) / LINES,
        1e4,
    )


def left(mix: Mixing) -> Float:
    """Share of the other mode in each shape."""
    own = SHAPES[:, :2].T @ MIXED @ mix.matrix
    return np.asarray(np.abs([own[1, 0] / own[0, 0], own[0, 1] / own[1, 1]]))


def test_a_pair_is_told_apart_beside_a_mode_under_forces_of_its_own() -> None:
    mix = unmix(spectra(0.0), EstimatedModes(F[:2], Z[:2], MIXED), 4.0)
    stated = np.sqrt(mix.variance[[1, 0], [0, 1]])
    assert (left(mix) < 3 * stated).all()
    assert stated.max() < 0.03


def test_a_pair_that_shares_its_forces_with_a_third_mode_is_left_as_it_is() -> None:
    mix = unmix(spectra(0.9), EstimatedModes(F[:2], Z[:2], MIXED), 4.0)
    assert (mix.matrix == np.eye(2)).all()
    assert (mix.variance == 0).all()


def test_a_pair_in_fewer_bins_than_are_averaged_is_left_as_it_is() -> None:
    fine = spectra(0.0)
    band = np.flatnonzero((FREQS > 0.98) & (FREQS < 1.045))  # ends near the modes
    few = band[::30]
    coarse = replace(
        fine, freqs=FREQS[few], count=fine.count[few], cross=fine.cross[few]
    )
    assert few.size == 6
    mix = unmix(coarse, EstimatedModes(F[:2], Z[:2], MIXED), 4.0)
    assert (mix.matrix == np.eye(2)).all()
