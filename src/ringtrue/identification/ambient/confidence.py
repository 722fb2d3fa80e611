"""Confidence of the candidate modes of all bands, and the selection of those to report."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import Uncertainty
from ringtrue.identification.ambient.candidates import CandidateModes
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.poles import StableDiagram
from ringtrue.identification.common.stabilisation import least_deviations
from ringtrue.shapes.mac import mac

FEW = 4  # channels: with three any shape is like any other
ECHO = 1.25  # ratio of frequencies
LIKE = 0.9  # MAC
ROUGH = 0.2  # and deviation of the damping over it
WORSE = 15.0  # times the least deviation of the damping of a mode
# confidence
DOUBTFUL = 0.2
SURE = 0.6
CROWD = 0.2  # of the order; each mode takes two
CHANCE = 0.1  # of it
MANY = 10  # modes
APART = 3.0  # and their mean distance, over the resolution of the lags


@dataclass(frozen=True, slots=True, eq=False)
class BandModes:
    """Candidates of one band with shapes in the channels' units, their confidence, and the pick
    behind each (-1).

    `turning` are the rows of pairs that the record does not separate, `wandering` rows with the
    relative standard deviation of their frequency along the record.
    """

    table: CandidateModes
    shape: Complex
    shape_std: Float
    confidence: Float
    diagram: StableDiagram
    picked: Int
    turning: tuple[int, ...] = ()
    wandering: tuple[tuple[int, float], ...] = ()


def confidence(c: CandidateModes, orders: int = 0) -> Float:
    """(m,) 0..1: agreement of the halves, share of the orders, certainty of the damping,
    collinearity.

    `orders` there are to try; those that were not would show a mode as those since its first
    appearance do.
    """
    _, sz = c.stds()
    found = c.orders[:, 0] + 0.0
    tried = np.maximum(c.orders[:, 1], 1)
    rest = np.maximum(orders - tried, 0)
    seen = np.sqrt((found + c.share * rest) / (tried + rest))
    known = 1 / (1 + (2 * sz / np.maximum(c.damping, 1e-3)) ** 2)
    return np.asarray(np.clip(c.halves * seen * known * np.sqrt(c.mpc), 0, 1))


def all_clear(c: CandidateModes, orders: int) -> bool:
    """Whether all that may be a mode was there at most of the orders tried, beyond doubt: the
    higher ones may rest.
    """
    conf = confidence(c, orders)
    return not ((conf > DOUBTFUL) & ((conf < SURE) | (c.orders[:, 0] < 0.6 * c.orders[:, 1]))).any()


def crowded(c: CandidateModes, orders: int, largest: int) -> bool:
    """Whether what may be modes takes two fifths of the largest order: some appear too late to be
    at most orders.
    """
    return bool((confidence(c, orders) > 0.5 * DOUBTFUL).sum() > CROWD * largest)


def dense_set(c: CandidateModes, orders: int, seconds: float) -> bool:
    """Whether what may be modes stands closer, on average over the range it takes, than lags of
    `seconds` tell well.

    And some of it is in doubt.
    """
    if all_clear(c, orders):
        return False
    f = c.frequencies[confidence(c) > 0.5 * DOUBTFUL]
    return bool(f.size > MANY and (f.max() - f.min()) * seconds < APART * f.size)


def fastest_decay(c: CandidateModes, orders: int) -> float:
    """Largest ζω, 1/s, of what may be a mode; 0 where all of the candidates are clear, and for
    few channels.
    """
    if len(c.shape) < FEW or all_clear(c, orders):
        return 0.0
    return float((-c.pole.real[confidence(c, orders) > 0.5 * DOUBTFUL]).max(initial=0.0))


def surer_groups(one: BandModes, two: BandModes, least: float) -> tuple[BandModes, BandModes]:
    """Two looks at one band, with the confidence of overlapping modes left to that which is surer
    of all of them.

    The second must be so by more than chance. Modes hang together where their half-power bandwidths
    touch.
    """
    both = [(x, np.flatnonzero(_automatic(x, least))) for x in (one, two)]
    f, z = (
        np.concatenate([getattr(x.table, name)[at] for x, at in both])
        for name in ("frequencies", "damping")
    )
    conf = np.concatenate([x.confidence[at] for x, at in both])
    look = np.repeat([0, 1], [at.size for _, at in both])
    rank = np.argsort(f - z * f, kind="stable")
    reach = np.maximum.accumulate((f + z * f)[rank])
    group = np.empty(f.size, dtype=np.int64)
    group[rank] = np.concatenate([[0], np.cumsum((f - z * f)[rank][1:] > reach[:-1])])[: f.size]
    first, second = (
        np.bincount(group[look == k], conf[look == k], group.max(initial=0) + 1) for k in (0, 1)
    )
    lost = np.where(second > first + CHANCE, 0, 1)[group] == look
    out = []
    for k, (x, at) in enumerate(both):
        kept = x.confidence.copy()
        kept[at[lost[look == k]]] = 0.0
        out.append(replace(x, confidence=kept))
    return out[0], out[1]


def frequencies_and_damping(
    found: list[BandModes], rows: list[tuple[int, int]]
) -> tuple[Float, Float]:
    """Frequencies, Hz, and damping ratios (m,) of the (band, row) of candidates."""
    f = np.array([found[b].table.frequencies[i] for b, i in rows])
    damping = np.array([found[b].table.damping[i] for b, i in rows])
    return f, damping


def select(found: list[BandModes], least: float) -> list[tuple[int, int]]:
    """(band, row) of the modes to report: confident ones, each once, ascending in frequency."""
    rows = [
        (b, i) for b, x in enumerate(found) for i in np.flatnonzero(_automatic(x, least)).tolist()
    ]
    if not rows:
        return []
    f = np.array([found[b].table.frequencies[i] for b, i in rows])
    z = np.array([found[b].table.damping[i] for b, i in rows])
    sf = np.array([found[b].table.stds()[0][i] for b, i in rows])
    conf = np.array([found[b].confidence[i] for b, i in rows])
    band = np.array([b for b, _ in rows])
    psi = np.stack([found[b].shape[:, i] for b, i in rows], axis=1)
    near = np.abs(f[:, None] - f) < np.maximum(
        4 * np.hypot(sf[:, None], sf), (z * f)[:, None] + z * f
    )
    same = near & _alike(mac(psi, psi), band, conf)
    keep: list[int] = []
    for k in np.lexsort((sf / f, -conf.round(1))).tolist():  # greedy: the best first
        if not same[k, keep].any():
            keep.append(k)
    return [rows[k] for k in sorted(keep, key=lambda k: float(f[k]))]


def _automatic(x: BandModes, least: float) -> Bool:
    return np.asarray((x.confidence >= least) & (x.picked < 0))


def _alike(like: Float, band: Int, conf: Float) -> Bool:
    """Shapes (MAC `like`) of one mode; two clusters of one band beyond doubt must be more similar
    to be one.
    """
    conf = (np.minimum(conf[:, None], conf) > SURE) & (band[:, None] == band)
    return np.asarray(like > np.where(conf, 0.95, 0.8))


def without_echoes(c: CandidateModes, conf: Float) -> Float:
    """(m,) confidence, halved for candidates that are the scatter of a mode of the same shape,
    stronger and surer.

    The correlations of a mode of few cycles, and those of its motion with noise, have poles near it
    that both halves of a record may show, all of its shape; their damping is poorly known, and
    their spectrum has no peak to fit. Four channels or more.
    """
    if len(c.shape) < FEW:
        return conf
    f = c.frequencies
    less = (c.strength[:, None] < 1.2 * c.strength) & (conf[:, None] < conf)
    near = np.abs(np.log(f[:, None] / f)) < np.log(ECHO)
    rough = ~c.refined & (c.stds()[1] > ROUGH * c.damping)
    echo = less & near & (mac(c.shape, c.shape) > LIKE) & rough[:, None] & c.refined
    return np.where(echo.any(axis=1), 0.5 * conf, conf)


def without_noise(c: CandidateModes, conf: Float, duration: float) -> Float:
    """(m,) confidence, halved where there is no peak to fit and the damping is known far worse than
    a mode's may be.

    Of many bands of noise both halves of a record of `duration` s may show one pole by chance.
    """
    _, least = least_deviations(c.frequencies, c.damping, duration)
    _, sz = c.stds()
    return np.where(~c.refined & (sz > ROUGH * c.damping) & (sz > WORSE * least), 0.5 * conf, conf)


def reason(found: BandModes, i: int) -> str:
    c = found.table
    sf, sz = c.stds()
    pair = (
        "; one of a pair closer than this record can separate: any turn of the two shapes in "
        "their plane fits as well"
    )
    n, tried = c.orders[i].tolist()
    sharp = "; refined by maximum likelihood" if c.refined[i] else ""
    moved = dict(found.wandering).get(i, 0.0)
    wide = (
        f"; its frequency wanders by {100 * moved:.2g} % along the record, which adds to the "
        "damping"
        if moved
        else ""
    )
    thin = "; so little damping may be a machine of unsteady speed" if c.damping[i] < 2.5e-3 else ""
    return (
        f"found at {n} of {tried} orders, std {100 * sf[i] / c.frequencies[i]:.2g} % of "
        "frequency and "
        f"{100 * sz[i] / c.damping[i]:.2g} % of damping, MPC {c.mpc[i]:.2f}, halves of the "
        "record agree to "
        f"{c.halves[i]:.2f}{sharp}{wide}{thin}{pair if i in found.turning else ''}"
    )


def uncertainty(found: list[BandModes], at: list[tuple[int, int]], channels: int) -> Uncertainty:
    """Standard deviations and covariance factor; modes of different bands are taken as
    independent.
    """
    m = len(at)
    if not m:
        return Uncertainty.independent(np.empty(0), np.empty(0), np.empty((channels, 0)))
    shape = np.stack([found[b].shape_std[:, i] for b, i in at], axis=1)
    blocks = np.cumsum([0] + [x.table.deviation.shape[1] for x in found])
    factor = np.zeros((int(blocks[-1]), 2 * m))
    for k, (b, i) in enumerate(at):
        df, dz = var.frequency_damping(found[b].table.pole[[i]], found[b].table.deviation[[i]])
        factor[blocks[b] : blocks[b + 1], k], factor[blocks[b] : blocks[b + 1], m + k] = (
            df[0],
            dz[0],
        )
    size = np.sqrt((factor**2).sum(0))
    return Uncertainty(size[:m], size[m:], shape, factor)
