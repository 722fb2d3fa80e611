"""Candidates that are no modes: lines of machines, overtones of clipping, peaks of the force.

People, waves and machines of unsteady speed have spectra with peaks. A linear structure answers
them with the modes that it has, so the operating deflection shape lies in the span of theirs. The
shape of another mode does not, where the sensors tell the modes from each other. Dependence has no
direction, so modes are accepted one by one, the best known first: a resonance under noise is known
as well as its bandwidth and the length of the record allow. A peak of the force is wider, wanders,
or is far sharper than the modes (a crowd that jumps to music now and then).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.identification.ambient.confidence import DOUBTFUL, SURE, BandModes, confidence
from ringtrue.signal.tonal_lines import Harmonic

PAIRED = 0.3  # share of the orders
STRONG = 10.0  # signal-to-noise ratio in the correlations, that poles of noise do not reach
OVERTONE = 3e-3  # relative distance
LINE = 2e-3  # damping that a line may seem to have
SHARP = 5.0  # and times less of it than the modes have
STEADY = 2.5  # deviations of the logarithm of a fourth moment
ELSEWHERE = 0.1  # of the power of a shape, in channels that are not clipped
EACH_SIDE = 3  # modes, that carry most of the motion at a frequency between them
OUTSIDE = 0.01  # share of a squared shape that may lie outside of the span, times the doubt
# that share of the modes among themselves over that of the peak, where the sensors separate them
BLIND = 4.0
SHARPER = 5.0  # times less damping than the modes have, beyond which a pole is in doubt, too
# doubt: what is not known of the damping, over that of the modes, times the damping over theirs
LOOSE = 2.0
ODD = 100.0  # times the level of the typical channel
ROOM = 4  # channels a mode of each side


def machine(
    f: float, zeta: float, lines: tuple[Harmonic, ...], resolution: float, duration: float
) -> Harmonic | None:
    """The line that a pole stands on, if its width is no more than that of a line.

    The window of the spectra shows a line at half of its `resolution` to each side; a pole farther
    off than that, and than its own half bandwidth, is another one. Within few cycles the amplitude
    of a mode is steady too: the logarithm of its fourth moment, 2, scatters by 1/sqrt(2π ζ f T). A
    pole with a width is a line only where that of the line is far below.
    """
    cycles = 2 * np.pi * zeta * f * duration
    least_moment = np.log(2 * cycles / (cycles + 1)) - STEADY / np.sqrt(cycles)
    near = [h for h in lines if abs(h.frequency - f) < max(0.5 * resolution, zeta * f, 1e-3 * f)]
    near = [
        h
        for h in near
        if zeta < LINE or (zeta < resolution / f and np.log(h.moment) < least_moment)
    ]
    return near[0] if near else None


def line_remainders(
    frequency: Float, damping: Float, sines: Float, duration: float
) -> tuple[float, ...]:
    """For each pole (m,) the line of `sines`, Hz, that was taken out and left this much of itself;
    0 for modes.

    A sine whose phase wanders leaves its sides, in place of the mode they stand on: far sharper
    than the modes are.
    """
    off = np.abs(sines[:, None] - frequency)
    near = off < np.maximum(damping * frequency, 2 / duration)
    far = damping[~near.any(axis=0) | (damping > LINE)]
    usual = float(np.median(far)) if far.size else 0.0
    sharp = damping < min(LINE, usual / SHARP)
    # a few poles
    return tuple(
        float(max(sines[near[:, k] & sharp[k]], default=0.0)) for k in range(frequency.size)
    )


def unresolved(found: list[BandModes], reported: Float) -> tuple[str, ...]:
    """A note where most orders have two poles within half a bandwidth and no mode (`reported`, Hz)
    is reported.

    The shapes of a pair that the record cannot separate turn from order to order, so that neither
    becomes a mode.
    """
    near: list[tuple[float, int, int]] = []
    for x in found:
        order = x.diagram.poles.order
        tried = np.unique(x.diagram.poles.order).size
        for f, z in zip(x.table.frequencies, x.table.damping, strict=True):
            group = np.flatnonzero(np.abs(x.table.frequencies - f) < z * f)
            _, count = np.unique(order[np.isin(x.table.label, group)], return_counts=True)
            unreported = not (np.abs(reported - f) < 2 * z * f).any()
            strong = x.table.strength[group].max(initial=0.0) > STRONG
            if unreported and strong and group.size > 1 and (count > 1).sum() > PAIRED * tried:
                near.append((float(f), int((count > 1).sum()), tried))
    kept = [n for k, n in enumerate(near) if all(abs(n[0] / b[0] - 1) > 0.03 for b in near[:k])]
    return tuple(
        f"two poles near {f:.4g} Hz at {n} of {tried} orders, of shapes that turn from order to "
        "order: a pair of modes "
        "closer than this record can separate; not reported"
        for f, n, tried in kept
    )


def unconfirmed(found: list[BandModes], reported: Float) -> tuple[str, ...]:
    """A note on what would be a mode beyond doubt if both halves of the record showed it, far from
    those `reported`, Hz.
    """
    near: list[tuple[float, int, int]] = []
    for x in found:
        c = x.table
        tried = np.unique(x.diagram.poles.order).size
        unreported = (
            np.abs(reported[:, None] - c.frequencies) > 2 * c.damping * c.frequencies
        ).all(axis=0)
        clear = confidence(replace(c, halves=np.ones(c.pole.size)), tried) > SURE
        for i in np.flatnonzero(unreported & clear & (c.halves < DOUBTFUL)).tolist():
            near.append((float(c.frequencies[i]), *c.orders[i].tolist()))
    kept = [n for k, n in enumerate(near) if all(abs(n[0] / b[0] - 1) > 0.03 for b in near[:k])]
    return tuple(
        f"pole at {f:.4g} Hz at {n} of {tried} orders left out: the halves of the record do not "
        "agree on it: a machine "
        "whose speed wanders, which may hide a mode, or a structure that changed"
        for f, n, tried in kept
    )


def overtones(
    modes: ModeSet, std: Float, reasons: list[str], clipped: Bool
) -> tuple[ModeSet, list[str]]:
    """Modes and reasons of a clipped record: the half of the confidence where a mode is an overtone
    of surer ones.

    Clipping makes responses at a + b, 2a, 3a and 2a ± b of the frequencies a, b of strong modes,
    whose bandwidths add up in them, in the channels that it cuts, (ch,) `clipped`: a mode that
    others move in is none. `std` (m,), Hz, is what is known of the frequencies.
    """
    f = modes.frequencies
    half = modes.frequencies * modes.damping
    halved = modes.confidence.copy()
    texts = list(reasons)
    power = np.abs(modes.shapes) ** 2
    for k in np.flatnonzero(power[~clipped].sum(axis=0) < ELSEWHERE * power.sum(axis=0)).tolist():
        base = np.flatnonzero((f < f[k]) & (modes.confidence > modes.confidence[k]))
        a, b = (x.ravel() for x in np.meshgrid(base, base))
        made = np.concatenate([f[a] + f[b], 2 * f[a] + f[b], 2 * f[a] - f[b]])
        wide = np.concatenate([half[a] + half[b], 2 * half[a] + half[b], 2 * half[a] + half[b]])
        if (np.abs(made - f[k]) < np.maximum(wide, max(OVERTONE * f[k], 2 * std[k]))).any():
            halved[k] *= 0.5
            texts[k] += "; may be made by clipping, as an overtone of other modes"
    return replace(modes, confidence=halved), texts


def unexplained(modes: ModeSet, lines: tuple[float, ...]) -> tuple[float, ...]:
    """Those of the `lines`, Hz, within whose frequency no mode stands."""
    far = np.abs(np.asarray(lines)[:, None] - modes.frequencies)
    return tuple(
        f
        for f, d in zip(lines, far, strict=True)
        if not (d < modes.damping * modes.frequencies).any()
    )


def without_forced(
    found: list[BandModes], rows: list[tuple[int, int]]
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
    # over the statistical floor, up to the length of the record
    loose = deviation / np.sqrt(damping / frequency)
    usual = np.median(damping)
    loose = loose * np.maximum(usual / (SHARPER * damping), 1.0)
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
    low = min(below.size, each)
    high = min(above.size, each)
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
