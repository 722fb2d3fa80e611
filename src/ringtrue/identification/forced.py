"""Peaks of the force among the modes: an operating deflection shape is a sum of the modes that
carry it.

People, waves and machines of unsteady speed have spectra with peaks. A linear structure answers
these with the modes that it has, so the shape there lies in the span of theirs. A mode of its own
does not, where the sensors tell the modes from each other. As dependence has no direction, modes
are accepted one by one, from the surest on: a resonance under noise is as well known as its
bandwidth and the length of the record allow, a peak of the force is wider or wanders, or is far
sharper than the modes (a crowd that jumps to music, now and then).
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.identification.ambient_verdict import Found

EACH_SIDE = 3  # modes, that carry most of the motion at a frequency between them
OUTSIDE = 0.01  # share of a squared shape that may lie outside of the span, times the doubt
# that share of the modes among themselves over that of the peak, where the sensors tell them apart
BLIND = 4.0
SHARP = 5.0  # times less damping than the modes have, beyond which a pole is in doubt, too
# doubt: what is not known of the damping, over that of the modes, times the damping over theirs
LOOSE = 2.0
ODD = 100.0  # times the level of the typical channel
ROOM = 4  # channels a mode of each side


def without_forced(
    found: list[Found], rows: list[tuple[int, int]]
) -> tuple[list[tuple[int, int]], list[str]]:
    """The (band, row) of modes, ascending in frequency, without peaks of the force, and a note on
    each of these.
    """
    if not rows:
        return rows, []
    tables = [found[b].table.take(np.array([i])) for b, i in rows]
    f, z = (np.array([getattr(t, x)[0] for t in tables]) for x in ("frequencies", "damping"))
    shape = np.stack([found[b].shape[:, i] for b, i in rows], axis=1)
    by = carriers(f, z, np.array([t.stds()[1][0] for t in tables]), shape)
    notes = [
        f"pole at {x:.4g} Hz left out: its shape is a sum of those at "
        f"{', '.join(f'{y:.4g}' for y in f[k])} Hz, and it "
        "is no resonance as clear as these: a peak of the force (people, waves, a machine)"
        for x, k in zip(f, by, strict=True)
        if k.size
    ]
    return [row for row, k in zip(rows, by, strict=True) if not k.size], notes


def _of_one_level(shape: Complex) -> Complex:
    """Shapes (ch, m) with channels of an odd level (a unit, a sensitivity) at that of the typical
    channel.
    """
    level = np.linalg.norm(shape, axis=1)
    typical = float(np.median(level))
    return (
        shape * np.where(level > ODD * typical, typical / np.maximum(level, 1e-300), 1.0)[:, None]
    )


def carriers(frequency: Float, damping: Float, deviation: Float, shape: Complex) -> list[Int]:
    """For each pole the modes whose motion it is, none for a mode.

    Parameters
    ----------
    frequency : (m,) float64, Hz, ascending
    damping : (m,) float64
    deviation : (m,) float64
        Standard deviation of the damping.
    shape : (ch, m) complex128
    """
    if not frequency.size:
        return []
    shape = _of_one_level(shape)
    psi = shape / np.linalg.norm(shape, axis=0)
    loose = deviation / np.sqrt(
        damping / frequency
    )  # over the statistical floor, up to the length of the record
    usual = np.median(damping)
    loose = loose * np.maximum(usual / (SHARP * damping), 1.0)
    out = [np.empty(0, dtype=np.int64) for _ in frequency]
    accepted = np.zeros(frequency.size, dtype=np.bool_)
    each = min(EACH_SIDE, len(psi) // ROOM)
    for k in np.argsort(loose * np.maximum(damping / usual, 1.0), kind="stable").tolist():
        at = np.flatnonzero(accepted)
        near = _beside(at[at < k], at[at > k], each)
        if near.size:
            known = min(np.median(loose[near]), np.median(loose[at]))
            doubt = max(damping[k] / np.median(damping[near]), 1.0) * loose[k] / known
            within = min(OUTSIDE * doubt, _least_own(psi[:, near]) / BLIND)
            if doubt > LOOSE and _outside(psi[:, near], psi[:, k]) < within:
                out[k] = near
        accepted[k] = not out[k].size
    return out


def _beside(below: Int, above: Int, each: int) -> Int:
    """The nearest accepted modes, `each` of either side; room that one leaves, as below all modes,
    is the other's.
    """
    low, high = min(below.size, each), min(above.size, each)
    low, high = (
        min(below.size, EACH_SIDE, 2 * each - high),
        min(above.size, EACH_SIDE, 2 * each - low),
    )
    return np.concatenate([below[below.size - low :], above[:high]])


def _outside(basis: Complex, shape: Complex) -> float:
    """Share of a squared unit shape (ch,) outside of the span of others (ch, k)."""
    q = np.linalg.qr(basis)[0]
    return float(1 - np.linalg.norm(q.conj().T @ shape) ** 2)


def _least_own(psi: Complex) -> float:
    """Least share of squared unit shapes (ch, k) that lies outside of the span of all others."""
    inverse = np.linalg.pinv(psi)
    return float((1 / np.maximum((np.abs(inverse) ** 2).sum(axis=1), 1.0)).min())
