"""Where to excite: driving-point residues, sets ranked by the mode they excite worst.

What a test must find: target modes with their reasons, frequency step, record length and the
precision to expect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Targets(FrozenArrays):
    """Target modes with their reasons.

    Attributes
    ----------
    modes : (t,) int64
        Positions in the mode set, ascending.
    reasons : tuple of str
        One a target: the criteria that ask for it.
    """

    modes: Int
    reasons: tuple[str, ...]

    def among(self, readable: Bool) -> tuple[Targets, tuple[str, ...]]:
        """The targets among the modes (m,) that can be read, and those that are none in words.

        Raises
        ------
        InputError
            If none is left.
        """
        lost = " ".join(str(k + 1) for k in self.modes[~readable[self.modes]].tolist())
        notes = (
            "no target, as no candidate sensor reads it, which turns nodes or moves across the "
            f"sensors: mode {lost}",
        )
        kept = np.flatnonzero(readable[self.modes])
        if not kept.size:
            raise InputError(notes[0])
        return Targets(
            self.modes[kept], tuple(self.reasons[i] for i in kept.tolist())
        ), notes if lost else ()


def in_band(frequencies: Float, low: float, high: float) -> Bool:
    """Modes (m,) with low < f < high, Hz."""
    f = np.asarray(frequencies, dtype=np.float64)
    return (f > low) & (f < high)


def readable(shapes: Float, mass: float) -> Bool:
    """Modes (m,) that a sensor reads: more than 1e-6 of what a rigid shift of the whole makes;
    below, it is round-off.

    Parameters
    ----------
    shapes : (s, d, m) float64, mass-normalised
        At the candidate sensors.
    mass : float
        Of the structure, in the unit of the shapes.
    """
    return np.asarray(
        np.abs(shapes).max(axis=(0, 1), initial=0.0) * np.sqrt(mass) > 1e-6
    )


def effective_mass(shapes: Float, mass: Any, rigid: Float) -> Float:
    """Share of the whole mass that each mode moves along each rigid-body motion, (m, 6), 0..1.

    (φᵀMr)²/(rᵀMr); over all modes of a held structure a column sums to the share of the mass that
    is free (Clough and Penzien 1993, section 13-2).

    Parameters
    ----------
    shapes : (dof, m) float64, mass-normalised
    mass : (dof, dof) sparse or dense
    rigid : (dof, 6) float64
        Unit motions along and about the axes.
    """
    moved = mass @ rigid
    total = np.einsum("dk,dk->k", rigid, moved)
    taken = (shapes.T @ moved) ** 2
    return np.asarray(
        np.divide(taken, total, out=np.zeros_like(taken), where=total > 0)
    )


def kinetic_share(shapes: Float, mass: Any, regions: Sequence[Int]) -> Float:
    """Share of each mode's kinetic energy in each region, (m, r).

    The energy of a DOF is φ_i·(Mφ)_i; the shares of regions that hold all DOFs sum to one.

    Parameters
    ----------
    shapes : (dof, m) float64
    mass : (dof, dof) sparse or dense
    regions : sequence of (k,) int64
        Rows of each region.
    """
    energy = shapes * np.asarray(mass @ shapes)
    total = energy.sum(axis=0)
    return np.stack([energy[at].sum(axis=0) / total for at in regions], axis=1)


def informative_modes(
    d_lambda: Float, lam: Float, std: Float | float, prior: Float, count: int
) -> Int:
    """Modes whose frequencies distinguish the parameters, greedily by the gain in
    log-determinant of the information.

    The information of a mode about x/σ_x is gᵀg/σ² with g = ∂λ/∂x·σ_x/λ and σ the relative standard
    deviation of λ (D-optimal choice, Fedorov 1972); the prior adds the unit matrix, so that a
    direction that another mode has shown brings little more.

    Parameters
    ----------
    d_lambda : (m, p) float64, (rad/s)²
    lam : (m,) float64, (rad/s)²
    std : (m,) float64 or float
        Relative standard deviation of λ: test and model error together.
    prior : (p,) float64
        Standard deviation of x.
    count : int

    Returns
    -------
    (k,) int64
        In order of choice, k <= count; modes that bring nothing are not chosen.
    """
    lam = np.asarray(lam, dtype=np.float64)
    soft = np.where(lam > 0, lam, np.inf)
    g = d_lambda * prior / (soft * np.broadcast_to(std, lam.shape))[:, None]
    information = np.eye(g.shape[1])
    chosen: list[int] = []
    for _ in range(min(count, lam.size)):
        gain = np.log1p(np.einsum("mp,pm->m", g, np.linalg.solve(information, g.T)))
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] <= 1e-9:
            break
        chosen.append(best)
        information += np.outer(g[best], g[best])
    return np.array(chosen, dtype=np.int64)


def choose_targets(
    frequencies: Float, criteria: Mapping[str, Bool], *, within: Bool | None = None
) -> Targets:
    """Modes that at least one criterion asks for.

    Parameters
    ----------
    frequencies : (m,) float64, Hz
    criteria : mapping of str to (m,) bool
        By reason, such as {"band 5 to 60 Hz": in_band(f, 5, 60)}.
    within : (m,) bool, optional
        Modes that can be targets at all, such as those of the band that can be measured.

    Raises
    ------
    InputError
        If no mode is left.
    """
    names = list(criteria)
    asked = np.array([criteria[n] for n in names], dtype=np.bool_).reshape(
        len(names), np.size(frequencies)
    )
    asked = asked & (True if within is None else np.asarray(within, dtype=np.bool_))
    modes = np.flatnonzero(asked.any(axis=0))
    if not modes.size:
        raise InputError(
            f"none of {np.size(frequencies)} modes meets {' or '.join(names)}: widen the criteria"
        )
    return Targets(
        modes,
        tuple(
            ", ".join(n for n, yes in zip(names, asked[:, k], strict=True) if yes)
            for k in modes
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Resolution:
    """What the records must be like.

    Attributes
    ----------
    step : float, Hz
        Of the FRFs: a quarter of the narrowest half-power bandwidth.
    block : float, s
        Of one hit; 1/step, or until the slowest mode has decayed to 1 % if that is longer.
    record : float, s
        Of an ambient record for the wanted precision of damping.
    averages : int
        Impacts, or blocks of a shaker, at each reference for the wanted random error of the FRFs.
    std_frequency, std_damping : (m,) float64
        Relative standard deviations to expect of an ambient record of that length.
    """

    step: float
    block: float
    record: float
    averages: int
    std_frequency: Float
    std_damping: Float


def ambient_std(
    frequencies: Float, damping: Float | float, duration: float
) -> tuple[Float, Float]:
    """Relative standard deviations (m,) of frequency and damping from `duration` s of white
    excitation.

    σ_f/f = √(ζ/(2π f T)), σ_ζ/ζ = √(1/(2π ζ f T)); Gersch (1974), the statistical floor of any
    method.
    """
    z = np.asarray(damping, dtype=np.float64)
    f = np.asarray(frequencies, dtype=np.float64)
    n = 2 * np.pi * f * duration
    return np.sqrt(z / n), np.sqrt(1 / (z * n))


def frf_averages(error: float, coherence: float) -> int:
    """Averages for a relative random error of |H|: (1 − γ²)/(2γ²·error²); Bendat and Piersol
    (2010), section 9.2.

    Parameters
    ----------
    error : float
        Relative standard deviation of the magnitude of an H1 estimate.
    coherence : float, 0..1
        Of force and response, γ².
    """
    return max(
        1, int(np.ceil((1 - coherence) / (2 * coherence * error**2) * (1 - 1e-9)))
    )


def resolution(
    frequencies: Float,
    damping: float,
    *,
    precision: float = 0.1,
    error: float = 0.05,
    coherence: float = 0.98,
) -> Resolution:
    """Resolution for modes at `frequencies` (m,) Hz with about the damping ratio `damping`.

    Parameters
    ----------
    precision : float
        Wanted relative standard deviation of the damping of the lowest mode in an ambient record.
    error : float
        Wanted relative random error of an FRF.
    coherence : float, 0..1
        Expected of it.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    low = float(f.min())
    step = 0.5 * damping * low
    block = (
        max(1 / step, np.log(100) / (2 * np.pi * damping * low)) if low > 0 else np.inf
    )
    record = max(600.0, 1 / (precision**2 * 2 * np.pi * damping * low))
    record = float(np.ceil(record / 60) * 60)
    std_f, std_z = ambient_std(f, damping, record)
    averages = frf_averages(error, coherence)
    return Resolution(
        step=float(step),
        block=float(block),
        record=record,
        averages=averages,
        std_frequency=std_f,
        std_damping=std_z,
    )


# of the best driving-point residue: below, the references miss a mode
LEAST_REACH = 0.1
_MOST_SETS = 200_000
_CHUNK = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class ExciterSet(FrozenArrays):
    """Points struck or shaken, and what they reach.

    Attributes
    ----------
    rows : (k,) int64
        Positions in the candidate rows, ascending.
    reach : (m,) float64, 0..1
        Best driving-point residue of the set over the largest, mode by mode.
    missed : (x,) int64
        Modes below the limit.
    """

    rows: Int
    reach: Float
    missed: Int

    @property
    def worst(self) -> float:
        """Reach of the mode that is excited worst."""
        return float(self.reach.min(initial=1.0))


def rank_sets(
    shapes: Float, count: int, *, largest: Float | None = None, most: int = 10
) -> tuple[ExciterSet, ...]:
    """The best sets of `count` rows by the worst driving-point residue over all target modes.

    All sets are looked at where there are few enough; otherwise those of a pool (for each mode the
    rows that reach it best, the greedy choice, and the single rows that miss least), the best of
    them improved by exchanging single rows.

    Parameters
    ----------
    shapes : (r, m) float64, mass-normalised
    count : int
    largest : (m,) float64, optional
        Of φ² of each mode, which residues are relative to; that of these rows if not given.
    most : int
        Sets to return.

    Raises
    ------
    InputError
        If there are fewer rows than `count`.
    """
    r = len(shapes)
    if not 1 <= count <= r:
        raise InputError(f"sets of {count} of {r} rows: must be 1 to {r}")
    share = shares(shapes, largest)
    pool = np.arange(r) if comb(r, count) <= _MOST_SETS else _pool(share, count)
    sets = np.array(list(combinations(pool.tolist(), count)), dtype=np.int64)
    best = _ranked(share, sets, most)
    if pool.size == r:
        return best
    better = [_exchanged(share, b.rows) for b in best]
    return _ranked(
        share, np.unique(np.stack([*better, *(b.rows for b in best)]), axis=0), most
    )


def _pool(share: Float, count: int) -> Int:
    """As many promising rows as can be combined fully."""
    size = count
    while size < len(share) and comb(size + 1, count) <= _MOST_SETS:
        size += 1
    by_mode = np.argsort(-share, axis=0, kind="stable")[
        :size
    ].ravel()  # best of every mode, then the second best, ...
    level = np.argsort(-np.log(share + 1e-3).sum(axis=1), kind="stable")
    greedy = select_references(np.sqrt(share), count, np.ones(share.shape[1]))
    mixed = np.concatenate(
        [
            greedy,
            np.stack(
                [level[:size], np.resize(by_mode, min(size, level.size))], 1
            ).ravel(),
        ]
    )
    _, first = np.unique(mixed, return_index=True)
    return np.sort(mixed[np.sort(first)][:size])


def _exchanged(share: Float, rows: Int) -> Int:
    """The set with single rows replaced by any other as long as that helps the modes that are
    excited worst.
    """
    rows = np.array(rows)
    while True:
        before = _worth(share[rows].max(axis=0))
        for i in range(rows.size):
            others = share[np.delete(rows, i)].max(axis=0, initial=0.0)
            rows[i] = int(np.argmax(_worth(np.maximum(share, others))))
        if _worth(share[rows].max(axis=0)) <= before * (1 + 1e-9):
            return np.sort(rows)


def _worth(reach: Float) -> Float:
    """The least reach, and a little of the mean, which parts sets with the same least one."""
    return np.asarray(reach.min(axis=-1) + 1e-6 * reach.mean(axis=-1))


def _ranked(share: Float, sets: Int, most: int) -> tuple[ExciterSet, ...]:
    """Best sets by the least reach, ties by the mean of the logarithms."""
    worst = np.empty(len(sets))
    mean = np.empty(len(sets))
    for at in range(0, len(sets), _CHUNK):  # bounds the memory
        reach = share[sets[at : at + _CHUNK]].max(axis=1)
        worst[at : at + _CHUNK] = reach.min(axis=1)
        mean[at : at + _CHUNK] = np.log(reach + 1e-12).mean(axis=1)
    best = np.lexsort((-mean, -np.round(worst, 12)))[:most]
    return tuple(_exciter_set(share, np.sort(sets[i])) for i in best)


def _exciter_set(share: Float, rows: Int) -> ExciterSet:
    reach = share[rows].max(axis=0)
    return ExciterSet(rows, reach, np.flatnonzero(reach < LEAST_REACH))


def reciprocity_pairs(
    references: Sequence[str], channels: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """Pairs of references that are measured as responses too: H(a, b) must equal H(b, a) in the
    test.
    """
    here = set(channels)
    return tuple(
        (a, b) for a, b in combinations([r for r in references if r in here], 2)
    )


def shares(shapes: Float, largest: Float | None = None) -> Float:
    """Driving-point residues φ_im² of rows (r, m) over the largest of each mode, (m,), 0..1: of
    these if not given.
    """
    square = np.asarray(shapes, dtype=np.float64) ** 2
    over = square.max(axis=0) if largest is None else largest
    return np.minimum(square / np.maximum(over, 1e-300), 1.0)


def select_references(shapes: Float, count: int, largest: Float | None = None) -> Int:
    """Rows to hit, greedily by the worst driving-point residue over all modes.

    The residue of mode m at row i is φ_im², taken relative to the mode's largest.

    Parameters
    ----------
    shapes : (r, m) float64
        Mass-normalised shapes at the rows that can be hit.
    count : int
    largest : (m,) float64, optional
        Of φ² of each mode; that of these rows if not given.

    Returns
    -------
    (count,) int64
        In order of choice.
    """
    share = shares(shapes, largest)
    reached = np.zeros(shapes.shape[1])
    out: list[int] = []
    for _ in range(min(count, len(shapes))):
        # the smooth minimum over modes: lift the modes that are reached worst
        value = np.log(np.maximum(share, reached) + 1e-3).sum(axis=1)
        value[out] = -np.inf
        best = int(np.argmax(value))
        out.append(best)
        reached = np.maximum(reached, share[best])
    return np.array(out, dtype=np.int64)


def reached(shapes: Float, references: Int) -> Float:
    """The largest share of each mode's best driving-point residue that the references reach,
    (m,).
    """
    return np.asarray(shares(shapes)[references].max(axis=0))
