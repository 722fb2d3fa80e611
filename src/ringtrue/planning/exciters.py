"""Where to excite: driving-point residues, QR of M·Φ, sets ranked by the mode they excite worst,
MIF.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int, freeze_fields
from ringtrue.errors import InputError
from ringtrue.planning.sensors import qr_points

_MOST_SETS = 200_000
_CHUNK = 20_000
_ENTRIES = 4_000_000  # of the FRFs of all trial sets that are looked at at once


@dataclass(frozen=True, slots=True, eq=False)
class ExciterSet:
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

    def __post_init__(self) -> None:
        freeze_fields(self, rows=np.int64, reach=np.float64, missed=np.int64)

    @property
    def worst(self) -> float:
        """Reach of the mode that is excited worst."""
        return float(self.reach.min(initial=1.0))


def qr_exciters(forces: Float, count: int) -> Int:
    """Rows to excite by pivoted QR of (MΦ)ᵀ (Schedlinski and Link 1996): force patterns that part
    the modes best.

    A force f excites the modes with Φᵀf, and f = MΦ excites each alone; the rows of MΦ that are
    largest and least alike come closest to it with few forces. When the modes are spanned, it
    starts again with the rows that are left.

    Parameters
    ----------
    forces : (r, m) float64
        MΦ at the rows that can be excited, shapes mass-normalised.
    count : int

    Returns
    -------
    (count,) int64
        Positions among the rows, in order of choice.

    Raises
    ------
    InputError
        If there are fewer rows, or those that are left carry no mass.
    """
    if not 1 <= count <= len(forces):
        raise InputError(f"{count} exciters at {len(forces)} rows: must be 1 to {len(forces)}")
    return qr_points(np.asarray(forces, dtype=np.float64)[:, None, :], count)


def rank_sets(
    shapes: Float, count: int, *, largest: Float | None = None, limit: float = 0.1, most: int = 10
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
    limit : float
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
    best = _ranked(share, sets, limit, most)
    if pool.size == r:
        return best
    better = [_exchanged(share, b.rows) for b in best]
    return _ranked(
        share, np.unique(np.stack([*better, *(b.rows for b in best)]), axis=0), limit, most
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
        [greedy, np.stack([level[:size], np.resize(by_mode, min(size, level.size))], 1).ravel()]
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


def _ranked(share: Float, sets: Int, limit: float, most: int) -> tuple[ExciterSet, ...]:
    """Best sets by the least reach, ties by the mean of the logarithms."""
    worst, mean = np.empty(len(sets)), np.empty(len(sets))
    for at in range(0, len(sets), _CHUNK):  # bounds the memory
        reach = share[sets[at : at + _CHUNK]].max(axis=1)
        worst[at : at + _CHUNK] = reach.min(axis=1)
        mean[at : at + _CHUNK] = np.log(reach + 1e-12).mean(axis=1)
    best = np.lexsort((-mean, -np.round(worst, 12)))[:most]
    return tuple(_exciter_set(share, np.sort(sets[i]), limit) for i in best)


def _exciter_set(share: Float, rows: Int, limit: float) -> ExciterSet:
    reach = share[rows].max(axis=0)
    return ExciterSet(rows, reach, np.flatnonzero(reach < limit))


def mode_indicator(data: Complex) -> tuple[Float, Float]:
    """Multivariate mode indicator function and the forces that reach it.

    The least of fᵀAf/fᵀ(A + B)f with A = HᵣᵀHᵣ and B = HᵢᵀHᵢ of the parts in phase and in
    quadrature (Williams, Crowley and Vold 1985): it dips to 0 where real forces f drive all
    responses in quadrature, at a phase resonance.

    Parameters
    ----------
    data : (freq, out, in) complex128
        Receptance or accelerance.

    Returns
    -------
    values : (freq, in) float64, 0..1, ascending
    forces : (freq, in, in) float64
        [freq, :, k] is the unit force pattern of the k-th value: force appropriation.
    """
    a = data.real.transpose(0, 2, 1) @ data.real
    b = a + data.imag.transpose(0, 2, 1) @ data.imag
    low = np.linalg.cholesky(
        b + 1e-14 * np.trace(b, axis1=1, axis2=2)[:, None, None] * np.eye(b.shape[1])
    )
    half = np.linalg.solve(low, np.linalg.solve(low, a).transpose(0, 2, 1))
    values, vectors = np.linalg.eigh(0.5 * (half + half.transpose(0, 2, 1)))
    forces = np.linalg.solve(low.transpose(0, 2, 1), vectors)
    return np.clip(values, 0, 1), np.asarray(forces / np.linalg.norm(forces, axis=1, keepdims=True))


def appropriate_exciters(
    data: Complex, count: int, *, noise: float = 0.01
) -> tuple[Int, Float, Float]:
    """Rows where real forces, all at once and tuned to each mode, come closest to a phase resonance
    of every mode.

    Grown one at a time by the mean logarithm of the least mode indicator, which lifts the mode that
    is isolated worst. The indicator is that of responses with an error, so that a row that hardly
    moves the structure does not serve.

    Parameters
    ----------
    data : (m, out, in) complex128
        Accelerance at the frequency of each mode; `in` are the rows that can be excited. Only the
        Gram matrix of the outputs counts: H = Φ_out G Φ_inᵀ may have the triangle R of Φ_out = QR
        in place of Φ_out.
    count : int
    noise : float
        Error of a response, over the response to the input that moves the mode most.

    Returns
    -------
    rows : (count,) int64
        Positions among the inputs, in order of choice.
    values : (m,) float64, 0..1
        Mode indicator of each mode with all of them; 0: it responds alone.
    forces : (m, count) float64
        Unit force pattern that reaches it, the largest force positive.

    Raises
    ------
    InputError
        If there are fewer inputs.
    """
    m, out, n = data.shape
    if not 1 <= count <= n:
        raise InputError(f"{count} exciters at {n} rows: must be 1 to {n}")
    level = noise * np.linalg.norm(data, axis=1).max(axis=1)
    chosen: list[int] = []
    for _ in range(count):
        rest = np.setdiff1d(np.arange(n), chosen)
        cost = np.empty(rest.size)
        step = max(1, _ENTRIES // (m * out * (len(chosen) + 1)))
        for at in range(0, rest.size, step):  # bounds the memory
            some = rest[at : at + step]
            sets = np.column_stack(
                [np.tile(np.array(chosen, dtype=np.int64), (some.size, 1)), some]
            )
            trial = data[:, :, sets].transpose(2, 0, 1, 3).reshape(-1, out, sets.shape[1])
            least = mode_indicator(_noisy(trial, np.tile(level, some.size)))[0][:, 0].reshape(
                some.size, m
            )
            cost[at : at + step] = np.log(least + 1e-3).mean(axis=1)
        chosen.append(int(rest[np.argmin(cost)]))
    values, forces = mode_indicator(_noisy(data[:, :, chosen], level))
    best = forces[:, :, 0]
    sign = np.sign(np.take_along_axis(best, np.abs(best).argmax(axis=1)[:, None], axis=1))
    return np.array(chosen, dtype=np.int64), values[:, 0], np.asarray(best * sign)


def _noisy(data: Complex, level: Float) -> Complex:
    """FRFs (l, out, k) and k more outputs, each in phase with one input and as large as `level`
    (l,).
    """
    extra = level[:, None, None] * np.eye(data.shape[2])
    return np.concatenate([data, extra.astype(np.complex128)], axis=1)


def appropriated_force(shapes: Float, mode: int) -> tuple[Float, Float]:
    """Forces (r,) at the rows that excite one mode and least of the others, and what they do to
    each, (m,).

    Least squares of Φᵀf = e_mode; with as many rows as modes the others stay still.

    Parameters
    ----------
    shapes : (r, m) float64, mass-normalised, at the exciters
    mode : int
    """
    wanted = np.zeros(shapes.shape[1])
    wanted[mode] = 1.0
    force = np.linalg.lstsq(shapes.T, wanted, rcond=None)[0]
    return np.asarray(force), np.asarray(shapes.T @ force)


def reciprocity_pairs(
    references: Sequence[str], channels: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """Pairs of references that are measured as responses too: H(a, b) must equal H(b, a) in the
    test.
    """
    here = set(channels)
    return tuple((a, b) for a, b in combinations([r for r in references if r in here], 2))


def shares(shapes: Float, largest: Float | None = None) -> Float:
    """Driving-point residues φ_im² of rows (r, m) over the largest of each mode, (m,), 0..1: of
    these if not given.
    """
    square = np.asarray(shapes, dtype=np.float64) ** 2
    over = square.max(axis=0) if largest is None else largest
    return np.asarray(np.minimum(square / np.maximum(over, 1e-300), 1.0))


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
