"""Leakage: FRFs of noise in blocks under a Hann window, whose impulse responses the window fades
out.

H1 = G_xf/G_ff of blocks of length T, w(t) their window: the cross-spectrum is that of R_xf(τ) r(τ),
with r the autocorrelation of w over its value at 0 (Bendat, Piersol, Random Data, 2010, 11.5); of a
force that is white over a few lines R_xf is the impulse response. So each mode is λ^p e^{λτ} r(τ):
no pole, and a fit by poles takes the fading for damping, by 1.3/n² with n lines in the half-power
bandwidth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ringtrue.core.arrays import Complex
from ringtrue.core.signals import FrfSet

if TYPE_CHECKING:
    from ringtrue.identification.lsfd import Lines
    from ringtrue.identification.refine import Refined

_TURN = 2j * np.pi
_EVEN = 1e-3  # of the step of even lines
_MANY, _EXCESS = (
    12.0,
    1.34,
)  # lines in a bandwidth: one part in a hundred; damping too much, times their square
_BESIDE, _LINES = 8.0, 4  # half bandwidths and lines beside a mode that tell
_LOOKS = 0.3  # of what blocks under a Hann window would leave


def block_of_noise(frfs: FrfSet) -> float:
    """Length, s, of the blocks that FRFs on even lines may be of; 0 where they are known to be of
    impacts, or sharp.
    """
    step = np.diff(frfs.freqs)
    even = float(np.ptp(step)) < _EVEN * float(step.mean())
    known = (
        frfs.sharp or frfs.impacts is not None or np.isfinite(frfs.kept) or frfs.window_decay > 0
    )
    return 0.0 if known or not even else 1 / float(step.mean())


def looks_faded(lines: Lines, fit: Refined, length: float) -> bool:
    """Whether what a fit by poles leaves beside narrow modes is what it would leave of blocks of
    that length, s.

    A regression on that, per mode beside its residue, its pole and a smooth rest; 0 of FRFs without
    leakage, 1 with.
    """
    x, half = lines.s.imag, -fit.poles.real
    count = half * length / np.pi  # lines in the half-power bandwidth
    like, size = 0.0, 0.0
    for k in np.flatnonzero(count < _MANY).tolist():  # few lines each
        at = np.abs(x - fit.poles[k].imag) < _BESIDE * half[k] + _LINES * 2 * np.pi / length
        if np.count_nonzero(at) < 2 * _LINES:
            continue
        pole = complex(-half[k] / (1 + _EXCESS / count[k] ** 2), fit.poles[k].imag)
        weight, far = lines.weight[at], 1 / (lines.s[at] - fit.poles[k])
        there = (
            faded(lines.s[at], np.array([pole]), length)[0][:, 0]
            * pole**lines.order
            / (lines.s[at] - pole)
        )
        basis = np.linalg.qr(
            weight[:, None] * np.stack([far, far**2, np.ones(far.size), x[at] / x[-1]], axis=1)
        )[0]
        part, shape = fit.participation[k] * lines.input, fit.shapes[:, k] * lines.response
        left = np.einsum("i,ifo,o->f", part.conj(), fit.known.rest[:, at], shape.conj())
        missing = -weight * there
        missing = missing - basis @ (basis.conj().T @ missing)
        like += float(np.vdot(missing, left).real)
        size += float(
            (np.abs(missing) ** 2).sum() * (np.abs(part) ** 2).sum() * (np.abs(shape) ** 2).sum()
        )
    return like > _LOOKS * size > 0


def hann_note(before: Complex, after: Complex) -> str:
    """Says what the fading took for damping."""
    more = 100 * (before.real / after.real - 1)
    return (
        "the FRFs are of blocks of noise under a Hann window, which fades the responses out: "
        "taken into account, else "
        f"the damping would be {np.median(more):.2g} % too high at the typical mode, "
        f"{more.max():.2g} % at most"
    )


def faded(s: Complex, poles: Complex, length: float) -> tuple[Complex, Complex]:
    """(freq, m) what the Hann window takes of 1 = (s − λ) ∫ e^{(λ−s)τ} dτ, and its derivatives by
    λ.

    r(x) = (1 − x)(2 + cos 2πx)/3 + sin(2πx)/(2π) on 0 ≤ x = τ/T ≤ 1.

    Parameters
    ----------
    s : (freq,) complex128, rad/s
    poles : (m,) complex128, rad/s
    length : float, s
        T.
    """
    a = (poles - s[:, None]) * length
    growth = np.expm1(a)  # of e^a, the same for a ± 2πi
    ramps, waves = (
        [_ramp(x, growth) for x in (a, a + _TURN, a - _TURN)],
        [_wave(x, growth) for x in (a + _TURN, a - _TURN)],
    )
    value, slope = (
        2 / 3 * ramps[0][k]
        + (ramps[1][k] + ramps[2][k]) / 6
        + (waves[0][k] - waves[1][k]) / (4j * np.pi)
        for k in (0, 1)
    )
    return 1 + a * value, length * (value + a * slope)


def _ramp(a: Complex, growth: Complex) -> tuple[Complex, Complex]:
    """∫ (1 − x) e^{ax} dx over 0..1 and its derivative; `growth` is e^a − 1."""
    value = (growth - a) / a**2
    return value, growth / a**2 - 2 * value / a


def _wave(a: Complex, growth: Complex) -> tuple[Complex, Complex]:
    """∫ e^{ax} dx over 0..1 and its derivative."""
    value = growth / a
    return value, (growth + 1 - value) / a
