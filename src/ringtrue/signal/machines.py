"""Rotating machines: their speed as it wanders, all their harmonics, and the record without them.

Harmonic k of a machine has the phase kθ(t), where θ(t) is the angle of its shaft: over this angle
it is a line of the whole record, however much the speed wanders, and a mode is none. So a machine
differs from structures whose modes are evenly spaced. The evidence is counted on harmonics that
the angle was not taken from: θ is found from one half of the orders, and the lines are counted in
the other half. The chance of as many without a machine is that of a binomial distribution. A line
is one where Hotelling's T² of its amplitudes in some channels against those of its neighbours
(Anderson 2003, section 5.2, for complex numbers) is rarer by chance than a false alarm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import ArrayLike
from scipy.fft import fft
from scipy.special import bdtrc, fdtrc

from ringtrue.core.arrays import Any_, Bool, Float, FrozenArrays, Int
from ringtrue.core.signals import FALSE_ALARM, TimeHistory
from ringtrue.signal.shaft_tracking import (
    SEARCH,
    OrderBlocks,
    SearchedSignals,
    ShaftCourse,
    block_size,
    candidates,
    corrected,
    order_blocks,
    phase_errors,
)
from ringtrue.signal.tonal_lines import FIT
from ringtrue.signal.tonal_lines import SEARCH as LINES

NEIGHBOURS = np.concatenate([np.arange(-9, -1), np.arange(2, 10)])  # lines


@dataclass(frozen=True, slots=True, eq=False)
class Machine(FrozenArrays):
    """A shaft and what it excites.

    Attributes
    ----------
    knots : (j,) float64, s
    revolutions : (j,) float64
        Angle of the shaft at the knots over 2π; a cubic spline between them.
    harmonics : (k,) int64
        Orders that stand out, ascending.
    seen, tried : int
        Orders of one half that stand out over the angle found from the other half, and those
        looked at.
    chance : float
        Of as many without a machine.
    """

    knots: Float
    revolutions: Float
    harmonics: Int
    seen: int
    tried: int
    chance: float

    @property
    def course(self) -> ShaftCourse:
        """The angle over time."""
        return ShaftCourse(self.knots, self.revolutions)

    @property
    def frequency(self) -> float:
        """Mean speed, Hz."""
        return self.course.frequency

    @property
    def wander(self) -> float:
        """Standard deviation of the speed over its mean."""
        speed = np.diff(self.revolutions) / np.diff(self.knots)
        return float(speed[1:-1].std() / self.frequency)

    def angle(self, times: ArrayLike) -> Float:
        """Revolutions of the shaft at `times` (i,), s from the start of the record."""
        return self.course.angle(np.asarray(times, dtype=np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class NearHarmonics(FrozenArrays):
    """The harmonic next to each of some frequencies.

    Attributes
    ----------
    machine, order : (m,) int64
        Position of the machine among those given, and its order; -1 and 0 where there is none.
    distance : (m,) float64
        Between the harmonic and the frequency, over that of the harmonic; infinite where there is
        none.
    wander : (m,) float64
        Standard deviation of the speed of the machine over its mean.
    """

    machine: Int
    order: Int
    distance: Float
    wander: Float


def find_machines(history: TimeHistory) -> tuple[Machine, ...]:
    """Machines whose speed wanders slowly or stays, the clearest first.

    Parameters
    ----------
    history : TimeHistory
        `FIT.channels` of it are looked at, over their whole length.
    """
    at = np.linspace(0, len(history.channels) - 1, FIT.channels).astype(np.int64)
    data = _searched(history.data, np.unique(at))
    found = list[Machine]()
    while len(data) and len(found) < SEARCH.most:
        signals = SearchedSignals.of(data, history.rate)
        machine = _clearest(signals)
        if machine is None:
            break
        found.append(machine)
        _take_out(data, history.rate, machine)
    return tuple(found)


def remove_machines(history: TimeHistory, machines: Sequence[Machine]) -> TimeHistory:
    """The record without the harmonics of some machines; the same object if there are none.

    Least squares on sines and cosines of kθ(t) whose amplitudes change slowly over time and with
    the speed: of a mode near a harmonic they take a few lines out of the ζfT of its peak.
    """
    if not machines:
        return history
    data = np.array(history.data)
    for machine in machines:
        _take_out(data, history.rate, machine)
    return replace(history, data=data)


def near_harmonics(
    machines: Sequence[Machine], frequencies: ArrayLike
) -> NearHarmonics:
    """Which harmonic of which machine lies next to each frequency, and how near.

    Parameters
    ----------
    machines : sequence of Machine
    frequencies : (m,) float64, Hz
    """
    f = np.asarray(frequencies, dtype=np.float64)
    machine = np.full(f.size, -1, dtype=np.int64)
    order = np.zeros(f.size, dtype=np.int64)
    distance = np.full(f.size, np.inf)
    wander = np.zeros(f.size)
    for i, own in enumerate(machines):
        lines = own.harmonics * own.frequency
        at = np.abs(f[:, None] - lines).argmin(axis=1)
        away = np.abs(f / lines[at] - 1)
        nearer = away < distance
        machine[nearer] = i
        order[nearer] = own.harmonics[at][nearer]
        distance[nearer] = away[nearer]
        wander[nearer] = own.wander
    return NearHarmonics(machine, order, distance, wander)


def _searched(data: Any_, at: Int) -> Any_:
    """(ch, sample) float32 channels `at` of `data` (ch, sample) about their means, of unit
    variance; those at rest are left out.
    """
    out = np.empty((at.size, data.shape[1]), dtype=np.float32)
    for own, x in zip(out, data[at], strict=True):
        np.subtract(x, x.mean(dtype=np.float64), out=own, casting="same_kind")
    size = out.std(axis=1, dtype=np.float64)
    moving = np.isfinite(size) & (size > 0)
    return np.asarray(out[moving] / size[moving, None].astype(np.float32))


def _clearest(signals: SearchedSignals) -> Machine | None:
    """The most likely candidate for which there is evidence."""
    most_chance = FALSE_ALARM / SEARCH.most  # of each candidate
    for candidate in candidates(signals):
        course = candidate.course
        most = min(SEARCH.orders, _orders(signals, course))
        blocks = order_blocks(signals, course, most)
        if blocks is None:
            continue
        error = phase_errors(blocks)
        lines = _line_chances(blocks, error) < FALSE_ALARM
        if _chance(lines) > most_chance:
            continue
        evidence = _held_out(blocks, course, signals.duration)
        if evidence.chance < most_chance:
            fundamental = _fundamental(signals, corrected(course, blocks, error))
            return _whole(signals, fundamental, evidence)
    return None


def _orders(signals: SearchedSignals, course: ShaftCourse) -> int:
    """Harmonics that the record holds."""
    return max(1, int(signals.highest / course.frequency))


def _chance(lines: Bool) -> float:
    """That of as many lines (order,) where each is a false alarm."""
    count = int(lines.sum())
    return float(bdtrc(count - 1, lines.size, FALSE_ALARM)) if count else 1.0


def _line_chances(blocks: OrderBlocks, error: Float) -> Float:
    """(order,) chance that noise shows a line as clear, over the angle with a phase `error`
    (block,), revolutions.

    T² of the complex amplitudes in p channels with the covariance of n neighbouring lines: (n - p +
    1)/(n p) T² has an F distribution with 2p and 2(n - p + 1) degrees of freedom.
    """
    lines = fft(blocks.turned(error), axis=0)
    around = lines[NEIGHBOURS]
    count, _, channels = around.shape
    cov = np.einsum("lkc,lkd->kcd", around, around.conj()) / count
    scale = np.einsum("kcc->k", cov).real
    cov += (1e-6 * scale + np.finfo(np.float32).tiny)[:, None, None] * np.eye(channels)
    whitened = np.linalg.solve(cov, lines[0][:, :, None])[:, :, 0]
    t2 = np.einsum("kc,kc->k", lines[0].conj(), whitened).real
    free = count - channels + 1
    return np.asarray(
        fdtrc(2 * channels, 2 * free, np.maximum(t2, 0) * free / (count * channels))
    )


@dataclass(frozen=True, slots=True)
class LineEvidence:
    """Lines among the orders that the angle was not taken from.

    Attributes
    ----------
    seen, tried : int
    chance : float
        Of as many in noise.
    """

    seen: int
    tried: int
    chance: float


def _held_out(
    blocks: OrderBlocks, course: ShaftCourse, duration: float
) -> LineEvidence:
    """LineEvidence of each half of the orders over the angle from the other one.

    The halves are those of Thue and Morse: each holds as many of the multiples of any number.
    """
    orders = blocks.orders
    half = np.array([int(k).bit_count() % 2 for k in orders], dtype=np.bool_)
    reach = int(NEIGHBOURS.max())
    wide = 2 * LINES.damping * orders * course.frequency * duration > reach
    lines = list[Bool]()
    for used in (half, ~half):
        chances = _line_chances(blocks, phase_errors(blocks.taken(used)))
        lines.append(chances[~used & wide] < FALSE_ALARM)
    both = np.concatenate(lines)
    return LineEvidence(int(both.sum()), both.size, _chance(both))


def _fundamental(signals: SearchedSignals, course: ShaftCourse) -> ShaftCourse:
    """The angle of the shaft whose multiples the lines are: orders between those of the course make
    it slower, a common factor of all orders faster.
    """
    for parts in ((2, 3), (5,), (2, 3), (5,)):  # parts of parts, too
        course = _by_parts(signals, course, parts)
    return course


def _by_parts(
    signals: SearchedSignals, course: ShaftCourse, parts: tuple[int, ...]
) -> ShaftCourse:
    """The angle of the shaft if it turns slower than the course by some of the factors `parts`, or
    faster by a common factor of all orders; the course itself if it has too few revolutions.
    """
    slowest = math.prod(parts)
    slow = course.geared(1 / slowest).smoothed()
    most = min(slowest * SEARCH.orders, _orders(signals, slow))
    blocks = order_blocks(signals, slow, most)
    if blocks is None:
        return course
    lines = _line_chances(blocks, np.zeros(len(blocks.values))) < FALSE_ALARM
    spacing = slowest
    for part in parts:
        own = lines[spacing // part - 1 :: spacing // part]
        if _chance(_between(own, part)) < FALSE_ALARM / SEARCH.most:
            spacing //= part
    own = lines[spacing - 1 :: spacing]
    ratio = spacing / slowest
    for factor in (2, 3, 5, 7):
        by_chance = _chance(_between(own, factor)) > FALSE_ALARM
        if by_chance and own[factor - 1 :: factor].any():
            own = own[factor - 1 :: factor]
            ratio *= factor
    return course.geared(ratio)


def _between(lines: Bool, factor: int) -> Bool:
    """The orders of `lines` (order,) that are no multiples of a factor."""
    return lines[np.arange(1, lines.size + 1) % factor > 0]


def _whole(
    signals: SearchedSignals,
    course: ShaftCourse,
    evidence: LineEvidence,
) -> Machine:
    """The machine with all its harmonics, and its angle from all of them."""
    harmonics = np.ones(1, dtype=np.int64)
    blocks = order_blocks(signals, course, _orders(signals, course))
    if blocks is not None:
        # lower orders first: to a high one an angle that is a turn of it off looks as good
        error = np.zeros(len(blocks.values))
        for used in (blocks.orders <= SEARCH.orders, blocks.orders > 0):
            turned = replace(blocks, values=blocks.turned(error))
            error = error + phase_errors(turned.taken(used), shortest=4)
        chances = _line_chances(blocks, error)
        course = corrected(course, blocks, error)
        harmonics = blocks.orders[chances < FALSE_ALARM]
    return Machine(
        course.knots,
        course.revolutions,
        harmonics=harmonics,
        seen=evidence.seen,
        tried=evidence.tried,
        chance=evidence.chance,
    )


def _take_out(data: Any_, rate: float, machine: Machine) -> None:
    """Fit the harmonics of a machine to the signals (ch, sample) and take them out, in place.

    Over whole revolutions they are orthogonal: each is fitted by itself, to its mean over blocks.
    """
    samples = data.shape[1]
    angle = machine.angle(np.arange(samples) / rate)
    bounds = _bounds(angle, block_size(angle[-1] - angle[0]) // 2)
    inner = slice(bounds[0], bounds[-1])
    middles = (bounds[1:] + bounds[:-1]) / 2
    basis = _slow_basis(middles / samples, np.diff(angle[bounds]) / np.diff(bounds))
    offset = data[:, inner].mean(axis=1, dtype=np.float64).astype(np.float32)
    taper = (
        1.0 + 1e-3 - np.cos(2 * np.pi * (np.arange(middles.size) + 0.5) / middles.size)
    )
    weighted = basis * taper[:, None]
    right = np.zeros((basis.shape[1], 2 * machine.harmonics.size, len(data)))
    for own, (part, waves) in zip(
        weighted, _waves(angle, bounds, machine.harmonics), strict=True
    ):
        block = data[:, part].T.astype(np.float32) - offset
        right += np.multiply.outer(own, waves @ block * np.float32(2 / len(block)))
    flat = right.reshape(len(right), -1)
    slow = np.linalg.solve(weighted.T @ basis, flat).reshape(right.shape)
    whole = bounds.copy()
    whole[[0, -1]] = 0, samples
    for own, (part, waves) in zip(
        basis, _waves(angle, whole, machine.harmonics), strict=True
    ):
        amplitudes = np.einsum("b,bkc->ck", own, slow).astype(np.float32)
        data[:, part] -= (amplitudes @ waves).astype(data.dtype)


def _bounds(angle: Float, revolutions: int) -> Int:
    """(block + 1,) samples next to each so many whole revolutions of the angle (sample,)."""
    first = np.ceil(angle[0])
    marks = np.arange(first, angle[-1], revolutions)
    at = np.searchsorted(angle, marks)
    late = np.abs(angle[np.maximum(at - 1, 0)] - marks) < np.abs(angle[at] - marks)
    return np.asarray(np.maximum(at - late, 0), dtype=np.int64)


def _slow_basis(places: Float, speed: Float) -> Float:
    """(block, column) orthonormal functions of the place in the record, 0 to 1, and of the speed of
    each block.
    """
    columns = [legvander(2 * places - 1, FIT.slow - 1)]
    spread = speed.std()
    if spread > 0:
        relative = np.clip((speed - speed.mean()) / (3 * spread), -1, 1)
        columns.append(legvander(relative, FIT.slow - 1)[:, 1:])
    left, size, _ = np.linalg.svd(np.concatenate(columns, axis=1), full_matrices=False)
    return np.asarray(left[:, size > 1e-6 * size[0]])


def _waves(angle: Float, bounds: Int, harmonics: Int) -> Iterator[tuple[slice, Any_]]:
    """Of each block between `bounds` its samples, and (2k, sample) float32 cosines and sines of the
    harmonics.
    """
    highest = int(harmonics.max())
    for low, high in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        one = np.exp(2j * np.pi * (angle[low:high] % 1)).astype(np.complex64)
        powers = np.empty((highest, one.size), dtype=np.complex64)
        powers[0] = one
        known = 1
        while known < highest:  # twice as many each time
            more = min(known, highest - known)
            np.multiply(
                powers[:more], powers[known - 1], out=powers[known : known + more]
            )
            known += more
        used = powers[harmonics - 1]
        yield slice(low, high), np.concatenate([used.real, used.imag])
