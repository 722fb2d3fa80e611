"""Peaks of the complex mode indicator function, and single modes fitted to the enhanced FRFs.

Shih, Tsuei, Allemang, Brown (1988), "Complex mode indication function and its applications to
spatial domain parameter estimation", Mech. Syst. Signal Process. 2; Phillips, Allemang, Fladung
(1998), "The complex mode indicator function (CMIF) as a parameter estimation method", IMAC XVI.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modal import ModalModel
from ringtrue.core.motions import POWER
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.identification.frf.residues import lsfd

LEAST = 0.1  # of the response at its frequency: less is the flank of a stronger mode


@dataclass(frozen=True, slots=True)
class CmifPeaks:
    """Settings of `cmif_modes`.

    Attributes
    ----------
    fmin, fmax : float, Hz, optional
    depth : float, dB
        A peak must stand this much above its surroundings.
    level : float, dB
        And not be lower than this below the highest.
    span : float
        Half the width of the enhanced FRF that is fitted, in half-power bandwidths.
    """

    fmin: float | None = None
    fmax: float | None = None
    depth: float = 6.0
    level: float = -60.0
    span: float = 3.0


def cmif(data: Complex) -> Float:
    """Complex mode indicator function: singular values (freq, in), descending, of `data` (freq,
    out, in).
    """
    gram = data.conj().transpose(0, 2, 1) @ data
    values = np.linalg.eigvalsh(gram)[:, ::-1]
    return np.asarray(np.sqrt(np.maximum(values, 0)))


def count_peaks(curve: Float) -> Int:
    """Positions of the peaks of the first two singular values that stand 2 dB above their
    surroundings.
    """
    from scipy.signal import find_peaks  # slow to import, and few commands need it

    level = 20 * np.log10(np.maximum(curve[:, :2], curve.max() * 1e-9))
    kernel = np.ones(3) / 3
    found = [find_peaks(np.convolve(c, kernel, "same"), prominence=2.0)[0] for c in level.T]
    return np.concatenate(found).astype(np.int64)


def cmif_modes(frfs: FrfSet, settings: CmifPeaks | None = None) -> ModalModel:
    """Modes at the peaks of the CMIF: a quick look, for modes whose distance is more than their
    bandwidth.

    The singular vectors at a peak filter the other modes out of the FRFs; the enhanced FRF uᴴ H v
    is that of a single mode and takes a rational function of order one. Two peaks that end in one
    pole count once. The shapes come from one global LSFD.

    Raises
    ------
    DataError
        If there is no peak.
    """
    settings = settings or CmifPeaks()
    f = frfs.freqs
    low = settings.fmin if settings.fmin is not None else 0.0
    high = settings.fmax if settings.fmax is not None else float(f[-1])
    used = _cut(frfs, (f > 0) & (f >= low) & (f <= high))
    found = [_mode(used, at, rank, settings.span) for rank, at in _peaks(cmif(used.data), settings)]
    inside = [(p, v) for p, v in found if p.real < 0 and low <= abs(p) / (2 * np.pi) <= high]
    if not inside:
        raise DataError(
            f"{frfs.source}: no peak of the CMIF between {low:g} and {high:g} Hz; lower depth or "
            "level"
        )
    poles = np.array([p for p, _ in inside], dtype=np.complex128)
    part = np.array([v for _, v in inside], dtype=np.complex128)
    keep = _different(poles, part)
    poles = poles[keep] + used.window_decay
    part = part[keep]
    seen = _size(lsfd(used, poles, part), used) > LEAST
    return lsfd(used, poles[seen], part[seen])


def cmif_peaks(frfs: FrfSet, low: float, high: float) -> ModalModel:
    """Modes at the peaks of a band, Hz."""
    return cmif_modes(frfs, CmifPeaks(low, high))


def _cut(frfs: FrfSet, at: Bool) -> FrfSet:
    return replace(frfs, data=frfs.data[at], freqs=frfs.freqs[at], coherence=frfs.coherence[at])


def _size(model: ModalModel, frfs: FrfSet) -> Float:
    """(m,) residue over half bandwidth of each mode, against the data at its frequency."""
    at = np.abs(2 * np.pi * frfs.freqs[:, None] - model.poles.imag).argmin(axis=0)
    residue = np.linalg.norm(model.shapes, axis=0) * np.linalg.norm(model.participation, axis=1)
    width = np.abs(model.poles.real - frfs.window_decay)
    high = residue / width * np.abs(model.poles) ** POWER[frfs.kind]
    return np.asarray(high / np.linalg.norm(frfs.data[at], axis=(1, 2)))


def _peaks(curve: Float, settings: CmifPeaks) -> list[tuple[int, int]]:
    """(singular value, line) of the peaks, the first singular value first."""
    from scipy.signal import find_peaks  # slow to import, and few commands need it

    level = 20 * np.log10(np.maximum(curve, curve.max() * 1e-12))
    tops = [
        find_peaks(c, prominence=settings.depth, height=level.max() + settings.level)[0]
        for c in level.T
    ]
    return [(rank, int(at)) for rank, top in enumerate(tops) for at in top]


def _mode(frfs: FrfSet, at: int, rank: int, span: float) -> tuple[complex, Complex]:
    """Pole, rad/s, window still in, and participation vector (in,) of the peak."""
    u, _, vh = np.linalg.svd(frfs.data[at], full_matrices=False)
    left = u[:, rank]
    right = vh[rank].conj()
    h = np.einsum("o,foi,i->f", left.conj(), frfs.data, right)
    size = np.abs(h)
    below = np.flatnonzero(size[:at] < size[at] / 2**0.5)
    above = np.flatnonzero(size[at:] < size[at] / 2**0.5)
    half = min(at - below[-1] if below.size else h.size, above[0] if above.size else h.size)
    reach = max(int(np.ceil(span * half)), 3)
    band = slice(max(at - reach, 0), at + reach + 1)
    # the right vector is that of H v, so its conjugate is the participation vector
    return single_mode(h[band], frfs.freqs[band], POWER[frfs.kind]), right.conj()


def single_mode(h: Complex, freqs: Float, power: int) -> complex:
    """Pole, rad/s, of one mode with a constant residual: h = s^p (R/(s − λ) + U), by linear least
    squares.

    Multiplied by s − λ the equation is linear in λ, R and U; weighted with |h|, which is highest at
    the peak.
    """
    s = 2j * np.pi * freqs
    x = (s - s.mean()) / np.abs(s[-1] - s[0])  # scaled, for the condition
    g = h / (s / s.mean()) ** power
    pole = 0j
    for _ in range(
        5
    ):  # the weight 1/|x − λ| undoes the bias of the linearised error (Sanathanan, Koerner 1963)
        w = np.abs(g) if pole == 0 else 1 / np.abs(x - pole)
        a = np.stack([g, np.ones(x.size), x], axis=1) * w[:, None]
        pole = complex(np.linalg.lstsq(a, x * g * w, rcond=None)[0][0])
    return complex(pole * np.abs(s[-1] - s[0]) + s.mean())


def _different(poles: Complex, part: Complex) -> Int:
    """Positions of the modes that are not the same as an earlier one."""
    width = np.maximum(np.abs(poles.real)[:, None], np.abs(poles.real))
    v = part / np.linalg.norm(part, axis=1, keepdims=True)
    same = (np.abs(poles[:, None] - poles) < width) & (np.abs(v.conj() @ v.T) ** 2 > 0.8)
    return np.flatnonzero(~np.tril(same, -1).any(axis=1))
