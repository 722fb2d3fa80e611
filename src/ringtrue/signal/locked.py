"""Lines of one machine: their phases go together, however its speed wanders; those of modes do not.

If two motions come from one shaft, at p and q times its speed, q φ_p − p φ_q stays the same along
the record: the mean of its unit phasor is near 1. Of a random motion it is of the order of one over
the root of the number of independent samples in the band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import ifft, next_fast_len

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.signal.listened import listened_spectrum

NEAR = 0.03  # relative distance from a ratio of whole numbers
WIDEST, LINES = (
    0.06,
    30.0,
)  # half a band over its frequency at most, and in lines of the record at least
ORDERS = (1, 2, 3, 4, 6, 8, 9, 12)  # of one line over that of another
LEAST, SURE = 0.35, 15.0  # mean phasor, and its square times the independent samples


def locked(
    history: TimeHistory, frequencies: Float, damping: Float, machines: Sequence[bool]
) -> tuple[str, ...]:
    """Why a pole belongs to a machine that is known: their phases go together; empty where they do
    not.

    Parameters
    ----------
    history : TimeHistory
        Some of it is looked at (`listened`).
    frequencies : (k,) float64, Hz
    damping : (k,) float64
    machines : sequence of bool
        Which are known to be lines of machines.
    """
    f, known, out = frequencies, np.array(machines, dtype=bool), [""] * frequencies.size
    pairs = [
        (k, j, *r)
        for k in np.flatnonzero(~known)
        for j in np.flatnonzero(known)
        if (r := _ratio(f[k] / f[j]))
    ]
    if not pairs:
        return tuple(out)
    spectrum, n = listened_spectrum(history)
    step = history.rate / n
    for k, j, p, q in pairs:  # a few poles
        if out[k]:
            continue
        half = min(max(3 * max(damping[k], damping[j]), LINES * step / min(f[k], f[j])), WIDEST)
        count = int(next_fast_len(int(4 * half * max(f[k], f[j]) / step) + 8))
        a, b = (_instants(spectrum, step, float(x), half, count) for x in (f[k], f[j]))
        weight = np.abs(a * b)
        turn = np.exp(1j * (q * np.angle(a) - p * np.angle(b)))
        together = float(np.abs((weight * turn).sum()) / weight.sum())
        told = 2 * half * min(f[k], f[j]) / step
        if together > LEAST and together**2 * told > SURE:
            out[k] = f"a machine: its phase goes with that of the line at {f[j]:.4g} Hz, {p}:{q}"
    return tuple(out)


def _ratio(x: float) -> tuple[int, int] | None:
    """Whole numbers p, q with x = p/q but for a few per cent; None where there are none, or x is
    1.
    """
    pairs: Sequence[tuple[int, int]] = (
        [(p, 1) for p in ORDERS[1:]] + [(1, q) for q in ORDERS[1:]] + [(3, 2), (2, 3)]
    )
    p, q = min(pairs, key=lambda r: abs(x * r[1] / r[0] - 1))
    return (p, q) if abs(x * q / p - 1) < NEAR else None


def _instants(spectrum: Any_, step: float, frequency: float, half: float, count: int) -> Complex:
    """(count,) the one-sided band of a relative half width at instants of the record, of the
    channel loudest there.
    """
    first, last = int(frequency * (1 - half) / step), int(np.ceil(frequency * (1 + half) / step))
    own = spectrum[:, first : last + 1]
    loud = own[int((np.abs(own) ** 2).sum(axis=1).argmax())]
    band = np.zeros((last // count + 1) * count, dtype=np.complex64)
    band[first : first + loud.size] = loud * np.hanning(loud.size)
    return np.asarray(ifft(band.reshape(-1, count).sum(axis=0), norm="forward"))
