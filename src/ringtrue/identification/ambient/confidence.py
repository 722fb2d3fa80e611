"""Confidence of the candidate modes of all bands, and the selection of those to report.

Candidates that are no modes: lines of machines and peaks of the force.

People, waves and machines of unsteady speed have spectra with peaks. A linear structure answers
them with the modes that it has, so the operating deflection shape lies in the span of theirs. The
shape of another mode does not, where the sensors separate the modes. Dependence has no direction,
so modes are accepted one by one, the best known first: a resonance under noise is known as well as
its bandwidth and the length of the record allow. A peak of the force is wider, wanders, or is far
sharper than the modes (a crowd that jumps to music now and then).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modes import Uncertainty
from ringtrue.identification.ambient.spectral_bins import CandidateModes
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.shapes import mac
from ringtrue.signal.tonal_lines import Harmonic

Row = tuple[int, int]  # a band, and a row of its table


@dataclass(frozen=True, slots=True)
class ConfidenceLimits:
    """What the confidence of candidates means, and when a band needs more orders or lags.

    Attributes
    ----------
    doubtful, certain : float
        Confidence below which a candidate is left out, and above which it is a mode beyond doubt.
    crowd : float
        Number of possible modes over the largest order, above which more orders are tried.
    dense, spacing : int, float
        A set of more than `dense` possible modes is dense if their mean distance is below `spacing`
        times the resolution of the lags.
    gain : float
        Sum of confidence by which more lags must be better: less is chance.
    """

    doubtful: float = 0.2
    certain: float = 0.6
    crowd: float = 0.2
    dense: int = 10
    spacing: float = 3.0
    gain: float = 0.1


LIMITS = ConfidenceLimits()


@dataclass(frozen=True, slots=True, eq=False)
class BandModes:
    """Candidates of one band with shapes in the channels' units.

    Attributes
    ----------
    table : CandidateModes
    shape : (ch, m) complex128
    shape_std : (ch, m) float64
    confidence : (m,) float64
    diagram : StableDiagram
    picked : (m,) int64
        The pick by hand behind each candidate, -1 for none.
    inseparable : tuple of int
        Rows of pairs that the record does not separate.
    wander : (m,) float64
        Relative standard deviation of the frequency along the record, 0 where it does not wander.
    """

    table: CandidateModes
    shape: Complex
    shape_std: Float
    confidence: Float
    diagram: StableDiagram
    picked: Int
    inseparable: tuple[int, ...]
    wander: Float

    def automatic(self, least: float) -> Int:
        """Rows of `least` confidence that no pick stands behind."""
        return np.flatnonzero((self.confidence >= least) & (self.picked < 0))


def confidence(c: CandidateModes, orders: int = 0) -> Float:
    """(m,) 0..1: agreement of the halves, share of the orders, certainty of the damping,
    collinearity.

    `orders` is the number of orders there are to try. Those not tried count as those do that were,
    from the first appearance of the mode on.
    """
    _, sz = c.stds()
    shown = c.orders[:, 0] + 0.0
    tried = np.maximum(c.orders[:, 1], 1)
    rest = np.maximum(orders - tried, 0)
    seen = np.sqrt((shown + c.share * rest) / (tried + rest))
    known = 1 / (1 + (2 * sz / np.maximum(c.damping, 1e-3)) ** 2)
    return np.asarray(np.clip(c.halves * seen * known * np.sqrt(c.mpc), 0, 1))


def all_clear(c: CandidateModes, orders: int) -> bool:
    """Whether each possible mode is beyond doubt and shown by most orders."""
    conf = confidence(c, orders)
    rare = c.orders[:, 0] < 0.6 * c.orders[:, 1]
    open_ = (conf > LIMITS.doubtful) & ((conf < LIMITS.certain) | rare)
    return not open_.any()


def crowded(c: CandidateModes, orders: int, largest: int) -> bool:
    """Whether possible modes take two fifths of the largest order: some appear late."""
    possible = confidence(c, orders) > 0.5 * LIMITS.doubtful
    return bool(possible.sum() > LIMITS.crowd * largest)


def is_dense(c: CandidateModes, orders: int, seconds: float) -> bool:
    """Whether possible modes, some of them in doubt, are closer than lags of `seconds` resolve."""
    if all_clear(c, orders):
        return False
    f = c.frequencies[confidence(c) > 0.5 * LIMITS.doubtful]
    return bool(f.size > LIMITS.dense and np.ptp(f) * seconds < LIMITS.spacing * f.size)


def better_groups(one: BandModes, two: BandModes, least: float) -> tuple[BandModes, BandModes]:
    """Two estimates of one band: of each group of overlapping modes the surer estimate keeps its
    confidence.

    Modes are of one group where their half-power bandwidths touch.
    """
    rows = [one.automatic(least), two.automatic(least)]
    estimates = (one, two)
    f = np.concatenate([x.table.frequencies[at] for x, at in zip(estimates, rows, strict=True)])
    half = np.concatenate([x.table.damping[at] for x, at in zip(estimates, rows, strict=True)]) * f
    conf = np.concatenate([x.confidence[at] for x, at in zip(estimates, rows, strict=True)])
    source = np.repeat([0, 1], [at.size for at in rows])
    rank = np.argsort(f - half, kind="stable")
    reach = np.maximum.accumulate((f + half)[rank])
    begins = np.ones(f.size, dtype=np.bool_)
    begins[1:] = (f - half)[rank][1:] > reach[:-1]
    group = np.empty(f.size, dtype=np.int64)
    group[rank] = np.cumsum(begins) - 1
    size = group.max(initial=0) + 1
    sums = [np.bincount(group[source == k], conf[source == k], size) for k in (0, 1)]
    worse = np.where(sums[1] > sums[0] + LIMITS.gain, 0, 1)[group]
    out = []
    for k, (x, at) in enumerate(zip(estimates, rows, strict=True)):
        kept = x.confidence.copy()
        kept[at[worse[source == k] == k]] = 0.0
        out.append(replace(x, confidence=kept))
    return out[0], out[1]


@dataclass(frozen=True, slots=True, eq=False)
class ListedCandidates:
    """Candidates of several bands in one list.

    Attributes
    ----------
    frequency, damping : (m,) float64, Hz and fraction of critical
    std_frequency, std_damping : (m,) float64
    confidence : (m,) float64
    shape : (ch, m) complex128
    """

    frequency: Float
    damping: Float
    std_frequency: Float
    std_damping: Float
    confidence: Float
    shape: Complex


def listed(found: list[BandModes], rows: list[Row]) -> ListedCandidates:
    """The candidates of some rows, in their order."""
    first = np.cumsum([0] + [x.table.pole.size for x in found])
    at = np.array([first[b] + i for b, i in rows], dtype=np.int64)
    stds = [x.table.stds() for x in found]
    return ListedCandidates(
        frequency=np.concatenate([x.table.frequencies for x in found])[at],
        damping=np.concatenate([x.table.damping for x in found])[at],
        std_frequency=np.concatenate([s for s, _ in stds])[at],
        std_damping=np.concatenate([s for _, s in stds])[at],
        confidence=np.concatenate([x.confidence for x in found])[at],
        shape=np.take(np.concatenate([x.shape for x in found], axis=1), at, axis=1),
    )


def select(found: list[BandModes], least: float) -> list[Row]:
    """The modes to report: confident ones, each once, ascending in frequency."""
    rows = [(b, i) for b, x in enumerate(found) for i in x.automatic(least).tolist()]
    if not rows:
        return []
    c = listed(found, rows)
    f = c.frequency
    sf = c.std_frequency
    conf = c.confidence
    band = np.array([b for b, _ in rows])
    half = c.damping * f
    widths = half[:, None] + half
    near = np.abs(f[:, None] - f) < np.maximum(4 * np.hypot(sf[:, None], sf), widths)
    # two clusters of one band beyond doubt must be more similar to be one mode
    both_certain = np.minimum(conf[:, None], conf) > LIMITS.certain
    like = np.where(both_certain & (band[:, None] == band), 0.95, 0.8)
    same = near & (mac(c.shape, c.shape) > like)
    keep: list[int] = []
    for k in np.lexsort((sf / f, -conf.round(1))).tolist():  # greedy: the best first
        if not same[k, keep].any():
            keep.append(k)
    return [rows[k] for k in sorted(keep, key=lambda k: float(f[k]))]


def reason(found: BandModes, i: int) -> str:
    """The evidence for one candidate."""
    c = found.table
    sf, sz = c.stds()
    n, tried = c.orders[i].tolist()
    parts = [
        f"found at {n} of {tried} orders, std {100 * sf[i] / c.frequencies[i]:.2g} % of frequency "
        f"and {100 * sz[i] / c.damping[i]:.2g} % of damping, MPC {c.mpc[i]:.2f}, halves of the "
        f"record agree to {c.halves[i]:.2f}"
    ]
    if c.refined[i]:
        parts.append("refined by maximum likelihood")
    if found.wander[i]:
        parts.append(
            f"its frequency wanders by {100 * found.wander[i]:.2g} % along the record, which adds "
            "to the damping"
        )
    if c.damping[i] < 2.5e-3:
        parts.append("so little damping may be a machine of unsteady speed")
    if i in found.inseparable:
        parts.append(
            "one of a pair closer than this record can separate: any turn of the two shapes in "
            "their plane fits as well"
        )
    return "; ".join(parts)


def uncertainty(found: list[BandModes], at: list[Row], channels: int) -> Uncertainty:
    """Standard deviations and covariance factor; modes of different bands are independent."""
    m = len(at)
    if not m:
        return Uncertainty.independent(np.empty(0), np.empty(0), np.empty((channels, 0)))
    shape = np.stack([found[b].shape_std[:, i] for b, i in at], axis=1)
    blocks = np.cumsum([0] + [x.table.deviation.shape[1] for x in found])
    factor = np.zeros((int(blocks[-1]), 2 * m))
    for k, (b, i) in enumerate(at):
        df, dz = var.frequency_damping(found[b].table.pole[[i]], found[b].table.deviation[[i]])
        own = slice(blocks[b], blocks[b + 1])
        factor[own, k] = df[0]
        factor[own, m + k] = dz[0]
    size = np.sqrt((factor**2).sum(0))
    return Uncertainty(size[:m], size[m:], shape, factor)


@dataclass(frozen=True, slots=True)
class LineLimits:
    """When a pole is a line of a machine.

    Attributes
    ----------
    damping : float
        Damping that a line may seem to have.
    sharper : float
        And times less of it than the modes have, where a line was taken out.
    deviations : float
        By which the fourth moment of the amplitude must be below that of a mode (ln, standard
        deviations).
    """

    damping: float = 2e-3
    sharper: float = 5.0
    deviations: float = 2.5


@dataclass(frozen=True, slots=True)
class ForceLimits:
    """When a pole is a peak of the force.

    Attributes
    ----------
    each_side : int
        Modes of each side that carry most of the motion at a frequency between them.
    channels : int
        Channels for each of these modes.
    outside : float
        Share of the squared shape that may lie outside their span, times the doubt.
    blind : float
        That share of the modes among themselves, over that of the peak, where sensors separate
        them.
    sharper : float
        Times less damping than the modes have, beyond which a pole is in doubt.
    doubt : float
        Least uncertainty of the damping over that of the modes, times the damping over theirs.
    odd_level : float
        Level of a channel over the typical one, above which its unit is not believed.
    """

    each_side: int = 3
    channels: int = 4
    outside: float = 0.01
    blind: float = 4.0
    sharper: float = 5.0
    doubt: float = 2.0
    odd_level: float = 100.0


def machine(
    f: float, zeta: float, lines: tuple[Harmonic, ...], resolution: float, duration: float
) -> Harmonic | None:
    """The line that a pole stands on, if its width is no more than that of a line.

    The window of the spectra shows a line at half of its `resolution` to each side. A pole farther
    away than that, and than its own half bandwidth, is another one. Within few cycles the amplitude
    of a mode is steady too: the logarithm of its fourth moment, 2, scatters by 1/sqrt(2π ζ f T). A
    pole with a width is a line only where that of the line is far below.
    """
    limits = LineLimits()
    cycles = 2 * np.pi * zeta * f * duration
    scatter = limits.deviations / np.sqrt(cycles)
    least_moment = np.log(2 * cycles / (cycles + 1)) - scatter
    reach = max(0.5 * resolution, zeta * f, 1e-3 * f)
    for line in lines:
        narrow = zeta < limits.damping
        steady = zeta < resolution / f and np.log(line.moment) < least_moment
        if abs(line.frequency - f) < reach and (narrow or steady):
            return line
    return None


def line_remainders(
    frequency: Float, damping: Float, sines: Float, duration: float
) -> tuple[float, ...]:
    """For each pole (m,) the line of `sines`, Hz, that was taken out and left this much of itself;
    0 for modes.

    A sine whose phase wanders leaves its sides, in place of the mode they stand on: far sharper
    than the modes are.
    """
    limits = LineLimits()
    off = np.abs(sines[:, None] - frequency)
    near = off < np.maximum(damping * frequency, 2 / duration)
    modes = damping[~near.any(axis=0) | (damping > limits.damping)]
    usual = float(np.median(modes)) if modes.size else 0.0
    sharp = damping < min(limits.damping, usual / limits.sharper)
    left = near & sharp
    return tuple(float(max(sines[left[:, k]], default=0.0)) for k in range(frequency.size))


def unconfirmed(found: list[BandModes], reported: Float) -> tuple[str, ...]:
    """A note on what would be a mode beyond doubt if both halves of the record showed it, far from
    those `reported`, Hz.
    """
    known: list[float] = []
    notes = []
    for x in found:
        c = x.table
        f = c.frequencies
        tried = np.unique(x.diagram.poles.order).size
        far = (np.abs(reported[:, None] - f) > 2 * c.damping * f).all(axis=0)
        clear = confidence(replace(c, halves=np.ones(f.size)), tried) > LIMITS.certain
        for i in np.flatnonzero(far & clear & (c.halves < LIMITS.doubtful)).tolist():
            own = float(f[i])
            if all(abs(own / other - 1) > 0.03 for other in known):
                notes.append(
                    f"pole at {own:.4g} Hz at {c.orders[i, 0]} of {c.orders[i, 1]} orders left "
                    "out: the halves of the record do not agree on it: a machine whose speed "
                    "wanders, which may hide a mode, or a structure that changed"
                )
            known.append(own)
    return tuple(notes)


def without_forced(found: list[BandModes], rows: list[Row]) -> tuple[list[Row], list[str]]:
    """The modes, ascending in frequency, without peaks of the force, and a note on each
    of these.
    """
    if not rows:
        return rows, []
    c = listed(found, rows)
    f = c.frequency
    modes = []
    notes = []
    whose = carriers(f, c.damping, c.std_damping, c.shape)
    for row, x, by in zip(rows, f, whose, strict=True):
        if not by.size:
            modes.append(row)
            continue
        notes.append(
            f"pole at {x:.4g} Hz left out: its shape is a sum of those at "
            f"{', '.join(f'{y:.4g}' for y in f[by])} Hz, and it is no resonance as clear as "
            "these: a peak of the force (people, waves, a machine)"
        )
    return modes, notes


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
    limits = ForceLimits()
    level = np.linalg.norm(shape, axis=1)
    typical = float(np.median(level))
    # a channel of another unit
    odd = level > limits.odd_level * typical
    psi = shape * np.where(odd, typical / np.maximum(level, 1e-300), 1.0)[:, None]
    psi = psi / np.linalg.norm(psi, axis=0)
    # over the statistical floor, up to the length of the record
    loose = deviation / np.sqrt(damping / frequency)
    usual = np.median(damping)
    loose = loose * np.maximum(usual / (limits.sharper * damping), 1.0)
    out = [np.empty(0, dtype=np.int64) for _ in frequency]
    accepted = np.zeros(frequency.size, dtype=np.bool_)
    for k in np.argsort(loose * np.maximum(damping / usual, 1.0), kind="stable").tolist():
        at = np.flatnonzero(accepted)
        near = _neighbours(at[at < k], at[at > k], len(psi), limits)
        if near.size:
            known = min(np.median(loose[near]), np.median(loose[at]))
            doubt = max(damping[k] / np.median(damping[near]), 1.0) * loose[k] / known
            basis = np.linalg.qr(psi[:, near])[0]
            outside = float(1 - np.linalg.norm(basis.conj().T @ psi[:, k]) ** 2)
            inverse = np.linalg.pinv(psi[:, near])
            # least share of these shapes that lies outside the span of the others
            own = (1 / np.maximum((np.abs(inverse) ** 2).sum(axis=1), 1.0)).min()
            within = min(limits.outside * doubt, float(own) / limits.blind)
            if doubt > limits.doubt and outside < within:
                out[k] = near
        accepted[k] = not out[k].size
    return out


def _neighbours(below: Int, above: Int, channels: int, limits: ForceLimits) -> Int:
    """The nearest accepted modes of either side; room that one side leaves, as below all modes, is
    the other's.
    """
    most = limits.each_side
    each = min(most, channels // limits.channels)
    low = min(below.size, each)
    high = min(above.size, each)
    more_low = min(below.size, most, 2 * each - high)
    more_high = min(above.size, most, 2 * each - low)
    return np.concatenate([below[below.size - more_low :], above[:more_high]])
