"""The angle of a shaft from the harmonics of its machine, all of them together.

The angle θ(t) is one smooth function of time, and harmonic k has the phase kθ(t) plus a constant.
Its course is found in two steps. Short frames are searched for spectra that stand up at multiples
of one frequency, and the most likely course of this frequency is taken (Viterbi 1967). The record
is then resampled over the angle, where a harmonic is a constant but for a phase error kε, and ε is
refined from the phases of all harmonics, from short lags to long ones. How smooth it is follows
from the record, by the marginal likelihood of a random walk of the speed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.ndimage import map_coordinates, median_filter, spline_filter1d
from scipy.special import ndtri

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.signals import FALSE_ALARM
from ringtrue.signal.spectra import AT_ONCE
from ringtrue.signal.tonal_lines import DYNAMIC_RANGE


@dataclass(frozen=True, slots=True)
class SpeedSearch:
    """How the frequency of a comb is searched.

    Attributes
    ----------
    orders : int
        Harmonics that are summed, at most.
    cycles : tuple of int
        Revolutions in a frame, at least: short ones for a speed that wanders, long ones for lines
        that stand out little. Over so many bins as the first the mean spectrum is made level.
    revolutions : int
        Of a block over which the angle is refined, at least.
    most : int
        Candidates, and machines.
    """

    orders: int = 24
    cycles: tuple[int, ...] = (16, 64)
    revolutions: int = 4
    most: int = 4

    @property
    def instants(self) -> int:
        """Of a course and of its angle, at most: the levels of the longest frames stay in the
        cache.
        """
        return AT_ONCE // (self.orders * self.cycles[-1])


SEARCH = SpeedSearch()


@dataclass(frozen=True, slots=True, eq=False)
class SearchedSignals:
    """Some channels of a record as their spectrum.

    Attributes
    ----------
    spectrum : (ch, line) complex64
        Of the whole record.
    length : int
        Of the transform, samples.
    samples : int
    rate : float, Hz
    """

    spectrum: Any_
    length: int
    samples: int
    rate: float

    @property
    def duration(self) -> float:
        """Length, s."""
        return self.samples / self.rate

    @property
    def highest(self) -> float:
        """Hz: what the filters of recorders leave."""
        return 0.46 * self.rate

    @classmethod
    def of(cls, data: Any_, rate: float) -> SearchedSignals:
        """Of signals (ch, sample) float32 about their means."""
        n = int(next_fast_len(data.shape[1], real=True))
        return cls(rfft(data, n, axis=1), n, data.shape[1], rate)

    def whitened(self, top: float, width: float, over: float) -> tuple[Any_, float]:
        """Signals (ch, sample) float32 of the band to `top` Hz, and their rate, `over` times as
        high.

        Their spectra are level but for what is narrower than `width` Hz.
        """
        step = self.rate / self.length
        size = int(next_fast_len(int(np.ceil(over * top / step)), real=True))
        lines = min(int(top / step), self.spectrum.shape[1], size // 2)
        white = np.zeros((len(self.spectrum), size // 2 + 1), dtype=np.complex64)
        for own, y in zip(self.spectrum, white, strict=True):
            y[:lines] = own[:lines] / _level(
                own[:lines], max(1, int(width / 16 / step))
            )
        white[:, 0] = 0
        signals = irfft(white, size, axis=1)[
            :, : int(self.samples * size / self.length)
        ]
        return signals, step * size


def _level(spectrum: Any_, group: int) -> Any_:
    """(line,) float32 typical amplitude around each line of a spectrum (line,), by groups of
    lines.
    """
    groups = max(spectrum.size // group, 1)
    used = spectrum[: groups * group]
    power = (used.real**2 + used.imag**2).reshape(groups, -1).mean(axis=1)
    floor = DYNAMIC_RANGE * power.max() + np.finfo(np.float32).tiny
    level = np.sqrt(np.maximum(median_filter(power, size=33, mode="nearest"), floor))
    middles = (np.arange(groups) + 0.5) * group
    return np.asarray(
        np.interp(np.arange(spectrum.size), middles, level), dtype=np.float32
    )


@dataclass(frozen=True, slots=True, eq=False)
class ShaftCourse:
    """The angle of a shaft over time.

    Attributes
    ----------
    knots : (j,) float64, s
    revolutions : (j,) float64
        Angle at the knots over 2π; a cubic spline between them.
    """

    knots: Float
    revolutions: Float

    @property
    def frequency(self) -> float:
        """Mean speed, Hz."""
        turned = self.revolutions[-1] - self.revolutions[0]
        return float(turned / (self.knots[-1] - self.knots[0]))

    @property
    def rises(self) -> bool:
        """Whether the shaft never turns back."""
        return bool((np.diff(self.revolutions) > 0).all())

    def geared(self, ratio: float) -> ShaftCourse:
        """Of a shaft that turns `ratio` times as fast."""
        return ShaftCourse(self.knots, ratio * self.revolutions)

    def smoothed(self) -> ShaftCourse:
        """Without what changes within a dozen knots: if the shaft is slower, its orders between
        those of the course beat with them, and leave a ripple of the angle.
        """
        kernel = np.hanning(15)[1:-1] / np.hanning(15).sum()
        both = [
            np.pad(x, 6, mode="reflect", reflect_type="odd")  # the ends stay in place
            for x in (self.knots, self.revolutions)
        ]
        return ShaftCourse(*(np.convolve(x, kernel, mode="valid") for x in both))

    def angle(self, times: Float) -> Float:
        """Revolutions at `times` (i,), s."""
        return np.asarray(CubicSpline(self.knots, self.revolutions)(times))

    def instants(self, angles: Float) -> Float:
        """Times (i,), s, at which `angles` (i,), revolutions, are reached."""
        fine = np.linspace(self.knots[0], self.knots[-1], 4 * self.knots.size)
        turned = np.maximum.accumulate(self.angle(fine))
        turned += 1e-9 * np.arange(turned.size)  # strictly, for the spline
        return np.asarray(CubicSpline(turned, fine)(angles))


@dataclass(frozen=True, slots=True, eq=False)
class CourseCandidate:
    """A course of the frequency of a comb.

    Attributes
    ----------
    strength : float
        Of its harmonics together, in standard deviations of noise.
    course : ShaftCourse
    """

    strength: float
    course: ShaftCourse


def candidates(signals: SearchedSignals) -> list[CourseCandidate]:
    """Courses that combs might have, the strongest first; multiples and parts of one speed are all
    among them.
    """
    found = list[CourseCandidate]()
    # of the shortest frames there are as many as their cycles
    low = SEARCH.cycles[0] ** 2 / signals.duration
    band = SearchedBand.of(signals, low)
    while low * SEARCH.orders < 4 * signals.highest:
        if band.top < min(signals.highest, _top(low)):
            band = SearchedBand.of(signals, low)
        found += _octave(band, low)
        low *= 2
    # of courses that are one for most of the time, the strongest
    found.sort(key=lambda candidate: -candidate.strength)
    times = np.linspace(0, signals.duration, SEARCH.instants)
    distinct = list[CourseCandidate]()
    speeds = list[Float]()
    for candidate in found:
        course = candidate.course
        speed = np.log(np.gradient(course.angle(times), times[1]).clip(min=1e-3))
        if not any(_one_speed(np.abs(speed - x)) for x in speeds):
            distinct.append(candidate)
            speeds.append(speed)
    return distinct[: SEARCH.most]


def _one_speed(distance: Float) -> Any_:
    """(...,) whether courses of a relative distance (..., instant) are one: for most of the time
    within half a bin of the short frames.
    """
    near = distance < 1 / (2 * SEARCH.cycles[0])
    return np.asarray(near.mean(axis=-1) > 0.5)


def _top(low: float) -> float:
    """Hz: the highest order of the octave above `low` Hz."""
    return 2.1 * low * SEARCH.orders


@dataclass(frozen=True, slots=True, eq=False)
class SearchedBand:
    """The signals of a band, which octaves share.

    Attributes
    ----------
    white : (ch, sample) float32
    rate, top : float, Hz
    duration : float, s
    """

    white: Any_
    rate: float
    top: float
    duration: float

    @classmethod
    def of(cls, signals: SearchedSignals, low: float) -> SearchedBand:
        """For the octave above `low` Hz."""
        top = min(signals.highest, _top(low))
        white, rate = signals.whitened(top, 4 * low, 2.0)
        return cls(white, rate, top, signals.duration)


def _octave(band: SearchedBand, low: float) -> list[CourseCandidate]:
    """Courses between `low` Hz and twice as much."""
    out = list[CourseCandidate]()
    for cycles in SEARCH.cycles:
        length = 2 * round(0.5 * cycles / low * band.rate)
        if 8 * length > band.white.shape[1]:
            continue
        levels, hop = _frame_levels(band.white, length, band.top / band.rate)
        # half a bin at the highest order
        step = 1 / (2 * SEARCH.orders * cycles)
        count = round(np.log(2) / step)
        edge = count // 16
        grid: Float = low * np.exp(step * np.arange(-edge, count + edge))
        times = np.asarray((hop * np.arange(levels.shape[1]) + length / 2) / band.rate)
        for path in _paths(levels, grid * length / band.rate):
            each = _agreement(levels, path)
            # one line more or less, as of a mode, is no comb
            score = np.minimum(each, -ndtri(FALSE_ALARM)).sum() / np.sqrt(each.size)
            # rarer than a false alarm at any of the places that were tried
            if score > -ndtri(FALSE_ALARM / (grid.size * path.size)):
                course = _integrated(times, path * band.rate / length, band.duration)
                strength = float(each.sum() / np.sqrt(each.size))
                out.append(CourseCandidate(strength, course))
    return out


def _paths(levels: Any_, places: Float) -> list[Float]:
    """The most likely courses (step,) over the `places` (grid,), in bins of `levels` (bin, step),
    that are distinct in the mean.
    """
    score, state = _courses(_comb_scores(levels, places))
    step = np.log(places[1] / places[0])
    left = np.ones(places.size, dtype=np.bool_)
    out = list[Float]()
    while left.any() and len(out) < SEARCH.most:
        best = int(np.where(left, score, -np.inf).argmax())
        out.append(places[state[:, best]])
        left &= ~_one_speed(step * np.abs(state - state[:, [best]]).T)
    return out


def _frame_levels(x: Any_, length: int, top: float) -> tuple[Any_, float]:
    """(bin, step) float32 log-levels of frames of `length` samples to `top` of the rate, in
    standard deviations about their mean, and the distance of steps in samples.

    The logarithm of one plus the power bounds what a mode adds to a sum over many harmonics. A step
    of a long record has two frames and more.
    """
    frames = x[:, : x.shape[1] // length * length].reshape(len(x), -1, length)
    win = np.sin(np.pi * (np.arange(length) + 0.5) / length).astype(np.float32)
    bins = int(top * length)
    together = -(-2 * frames.shape[1] // SEARCH.instants)
    steps = frames.shape[1] // together
    total = np.zeros((steps, bins), dtype=np.float32)
    for own in frames:
        y = rfft(own[: steps * together] * win, axis=1)[:, :bins]
        power = y.real**2 + y.imag**2
        power *= np.float32(np.log(2)) / np.median(power[:: max(1, steps // 8), 2:])
        power += 1
        total += np.log(power, out=power).reshape(steps, together, bins).sum(axis=1)
    total -= median_filter(
        total.mean(axis=0), size=SEARCH.cycles[0] + 1, mode="nearest"
    )
    total -= total[:, 2:].mean(axis=1, keepdims=True)
    total /= total[:, 2:].std()
    return np.ascontiguousarray(total.T), together * length


def _comb_scores(levels: Any_, places: Float) -> Any_:
    """(step, grid) float32 sums of `levels` (bin, step) over the multiples of `places` (grid,), in
    bins, of unit standard deviation.
    """
    total = np.zeros((places.size, levels.shape[1]), dtype=np.float32)
    count = np.zeros(places.size)
    for k in range(1, SEARCH.orders + 1):
        at = np.rint(k * places).astype(np.int64)
        inside = int(np.searchsorted(at, len(levels)))
        total[:inside] += levels[at[:inside]]
        count[:inside] += 1
    total /= np.sqrt(np.maximum(count, 4.0)).astype(np.float32)[:, None]
    return np.ascontiguousarray(total.T)


def _agreement(levels: Any_, places: Float) -> Float:
    """(order,) standard deviations by which each harmonic stands up along `places` (step,), in bins
    of `levels` (bin, step).
    """
    orders = np.arange(1, min(SEARCH.orders, int((len(levels) - 1) / places.max())) + 1)
    at = np.rint(orders[:, None] * places).astype(np.int64)
    total = levels[at, np.arange(places.size)].sum(axis=1)
    return np.asarray(total / np.sqrt(places.size), dtype=np.float64)


def _courses(scores: Any_) -> tuple[Float, Any_]:
    """The most likely course to each last place: (grid,) its score, and (step, grid) its places.

    Viterbi (1967); a course moves by at most three places of the grid a step, with a standard
    deviation of sqrt(2).
    """
    steps, size = scores.shape
    moves = np.arange(-3, 4)
    cost = (moves**2 / 4).astype(np.float32)
    totals = np.full((steps, size + 6), -np.inf, dtype=np.float32)  # 3 places beyond
    inner = totals[:, 3:-3]
    inner[0] = scores[0]
    before = sliding_window_view(totals, size, axis=1)  # (step, move, grid)
    options = np.empty((moves.size, size), dtype=np.float32)
    for m in range(1, steps):  # each step needs the one before
        np.subtract(before[m - 1], cost[:, None], out=options)
        options.max(axis=0, out=inner[m])
        inner[m] += scores[m]
    last = inner[-1].astype(np.float64)
    return (last - np.median(last)) / np.sqrt(steps), _traced(totals, moves, cost)


def _traced(totals: Any_, moves: Int, cost: Any_) -> Any_:
    """(step, grid) int16 places of the courses that end at each place, by the `totals` (step, grid
    and three places beyond each end) of the courses up to each step; those that meet go on as one.
    """
    steps = len(totals)
    ends: Int = np.arange(totals.shape[1] - 6)
    course: Int = ends
    state = np.empty((steps, ends.size), dtype=np.int16)
    for m in range(steps - 1, 0, -1):
        state[m] = ends[course]
        options = totals[m - 1].take(ends[:, None] + moves + 3) - cost
        ends = ends + moves[options.argmax(axis=1)]
        new = np.append(True, ends[1:] != ends[:-1])
        if not new.all():
            ends = ends[new]
            course = (new.cumsum() - 1)[course]
    state[0] = ends[course]
    return state


def _integrated(times: Float, frequency: Float, duration: float) -> ShaftCourse:
    """The angle of a `frequency` (i,), Hz, at `times` (i,), s, of which steps of the grid are
    smoothed out.
    """
    kernel = np.hanning(7)[1:-1] / np.hanning(7).sum()
    smooth = np.convolve(np.pad(frequency, 2, mode="edge"), kernel, mode="valid")
    t = np.concatenate([[0.0], times, [duration]])
    f = np.concatenate([smooth[:1], smooth, smooth[-1:]])
    turned = np.cumsum(np.diff(t) * (f[1:] + f[:-1]) / 2)
    return ShaftCourse(t, np.concatenate([[0.0], turned]))


@dataclass(frozen=True, slots=True, eq=False)
class OrderBlocks:
    """Harmonics over blocks of whole revolutions.

    Attributes
    ----------
    values : (block, order, ch) complex64
        Amplitude, up to a constant: what does not change over the blocks is a harmonic.
    orders : (order,) int64
        Multiples of the speed.
    centres : (block,) float64
        Angle of the middle of each block, revolutions.
    """

    values: Any_
    orders: Int
    centres: Float

    def taken(self, use: Bool) -> OrderBlocks:
        """Some of the orders, as `use` (order,) says."""
        return replace(self, values=self.values[:, use], orders=self.orders[use])

    def turned(self, error: Float) -> Any_:
        """(block, order, ch) amplitudes without a phase `error` (block,), revolutions."""
        turn = np.exp(-2j * np.pi * error[:, None] * self.orders).astype(np.complex64)
        return np.asarray(self.values * turn[:, :, None])


def block_size(revolutions: float) -> int:
    """Revolutions of a block of a record of so many."""
    most = SEARCH.revolutions * SEARCH.instants
    return SEARCH.revolutions * max(1, int(np.ceil(2 * revolutions / most)))


def order_blocks(
    signals: SearchedSignals, course: ShaftCourse, orders: int
) -> OrderBlocks | None:
    """The first `orders` harmonics over the record; None if it has too few revolutions.

    The blocks overlap by half under a Hann window, in which one harmonic hides all others.
    """
    f = course.frequency
    turned = int(course.revolutions[-1] - course.revolutions[0])
    size = block_size(turned)
    if turned < 12 * size or not course.rises:
        return None
    # cubic splines leave an image of each line between the orders: 50 dB below it at this rate
    x, rate = signals.whitened(min(signals.highest, 1.05 * f * orders), 4 * f, 5.2)
    per_turn = 2 * int(np.ceil(1.3 * orders))
    angles = course.revolutions[0] + np.arange(turned * per_turn) / per_turn
    places = course.instants(angles)[None] * rate
    length = size * per_turn
    win = (1 - np.cos(2 * np.pi * (np.arange(length) + 0.5) / length)).astype(
        np.float32
    ) / length
    values = list[Any_]()
    for own in x:
        over_angle = np.empty(places.size, dtype=np.float32)
        coefficients = spline_filter1d(own, 3, output=np.float32)
        map_coordinates(coefficients, places, over_angle, order=3, prefilter=False)
        frames = sliding_window_view(over_angle, length)[:: length // 2] * win
        folded = frames.reshape(len(frames), size, per_turn).sum(axis=1)
        values.append(rfft(folded, axis=1)[:, 1 : orders + 1])
    z = np.stack(values, axis=2)
    centres = course.revolutions[0] + (np.arange(len(z)) + 1) * size / 2
    return OrderBlocks(z, np.arange(1, orders + 1), centres)


def phase_errors(blocks: OrderBlocks, shortest: int = 2) -> Float:
    """(block,) revolutions by which the angle is beyond the one that the blocks are taken at.

    Parameters
    ----------
    blocks : OrderBlocks
    shortest : int
        First lag in blocks; each next one is twice as long.
    """
    z = blocks.values
    power = (z.real**2 + z.imag**2).mean(axis=0)
    unit = replace(blocks, values=z / np.sqrt(power + np.finfo(np.float32).tiny))
    k = blocks.orders
    count = len(z)
    error = np.zeros(count)
    lag = shortest
    while lag < count // 3:
        # the mean over a box and the one of a lag later show the speed, all else its ripple
        box = max(1, lag // 2)
        turned = unit.turned(error)
        before = np.concatenate([np.zeros_like(turned[:1]), turned])
        total = np.cumsum(before, axis=0, dtype=np.complex64)
        mean = (total[box:] - total[:-box]) / np.float32(box)
        products = (mean[:-lag].conj() * mean[lag:]).sum(axis=2)
        scaled = _score(products, k, box)
        if scaled is None:
            return np.asarray(error)
        slope = _smoothed(
            lag * scaled[0] / box, lag**2 * scaled[1] / box, _first_differences
        )
        ends = (count - 1 - slope.size) / 2
        each = np.interp(np.arange(count - 1), np.arange(slope.size) + ends, slope)
        error = error + np.concatenate([[0.0], np.cumsum(each)])
        z = unit.turned(error)
        scaled = _score((_around(z, lag).conj() * z).sum(axis=2), k, 1)
        if scaled is None:
            return np.asarray(error)
        error = error + _smoothed(*scaled, _second_differences)
        lag *= 2
    return np.asarray(error)


def _around(z: Any_, reach: int) -> Any_:
    """(block, order, ch) mean of up to `reach` blocks to each side, without the next: these share
    samples with the block.
    """
    total = np.cumsum(np.concatenate([np.zeros_like(z[:1]), z]), axis=0)
    m = np.arange(len(z))
    low = np.maximum(m - reach, 0)
    high = np.minimum(m + reach + 1, len(z))
    inner_low = np.maximum(m - 1, 0)
    inner_high = np.minimum(m + 2, len(z))
    count = (high - low - inner_high + inner_low).astype(np.float32)
    summed = total[high] - total[low] - total[inner_high] + total[inner_low]
    return np.asarray(summed / count[:, None, None])


def _weights(products: Any_, box: int) -> Float:
    """(order,) mean real part of the `products` (block, order) over its variance; 0 where it is
    not clear. `box` neighbours are of one sample.
    """
    real = products.real
    coherent = real.mean(axis=0, dtype=np.float64)
    variance = np.maximum(real.var(axis=0, dtype=np.float64), 1e-12)
    clear = coherent > -ndtri(FALSE_ALARM) * np.sqrt(variance * 2 * box / len(real))
    return np.asarray(np.where(clear, coherent / variance, 0.0))


def _score(products: Any_, orders: Int, box: int) -> tuple[Float, float] | None:
    """(block,) gradient of the log-likelihood of a phase, and its mean information, from
    `products` (block, order) of two amplitudes; None where no harmonic is coherent.
    """
    weight = _weights(products, box)
    if not weight.any():
        return None
    score = 2 * np.pi * (products.imag @ (orders * weight))
    coherent = products.real.mean(axis=0, dtype=np.float64)
    information = (2 * np.pi) ** 2 * float((orders**2 * weight * coherent).sum())
    return np.asarray(score, dtype=np.float64), information


def _first_differences(size: int) -> Float:
    """(2, size) lower bands of DᵀD of first differences."""
    bands = np.zeros((2, size))
    bands[0] = 2
    bands[0, [0, -1]] = 1
    bands[1] = -1
    return bands


def _second_differences(size: int) -> Float:
    """(3, size) lower bands of DᵀD of second differences."""
    bands = np.zeros((3, size))
    bands[0] = 6
    bands[0, [0, -1]] = 1
    bands[0, [1, -2]] = 5
    bands[1] = -4
    bands[1, [0, -2]] = -2
    bands[2] = 1
    return bands


def _smoothed(
    score: Float, information: float, differences: Callable[[int], Float]
) -> Float:
    """(i,) the most likely smooth sequence e: (P + λDᵀD) e = score, with λ of the largest marginal
    likelihood.
    """
    size = score.size
    bands = differences(size)
    rank = size - len(bands) + 1
    measured = float(score @ score) / information
    best = -np.inf
    out = np.zeros(size)
    for stiffness in 10.0 ** np.arange(-2, 10):
        matrix = information * stiffness * bands
        matrix[0] += information
        factor = cholesky_banded(matrix, lower=True)
        e = np.asarray(cho_solve_banded((factor, True), score))
        misfit = measured - float(score @ e)
        determinant = float(np.log(factor[0]).sum()) - 0.5 * size * np.log(information)
        likelihood = -0.5 * misfit - determinant + 0.5 * rank * np.log(stiffness)
        if likelihood > best:
            best = likelihood
            out = e
    return out


def corrected(course: ShaftCourse, blocks: OrderBlocks, error: Float) -> ShaftCourse:
    """The course with a phase `error` (block,), revolutions, of its blocks."""
    at = course.instants(blocks.centres)
    before = blocks.centres[0] - course.revolutions[0]
    after = course.revolutions[-1] - blocks.centres[-1]
    spacing = blocks.centres[1] - blocks.centres[0]
    first = error[0] - (error[1] - error[0]) * before / spacing
    last = error[-1] + (error[-1] - error[-2]) * after / spacing
    revolutions = np.concatenate(
        [
            [course.revolutions[0] + first],
            blocks.centres + error,
            [course.revolutions[-1] + last],
        ]
    )
    return ShaftCourse(
        np.concatenate([course.knots[:1], at, course.knots[-1:]]), revolutions
    )
