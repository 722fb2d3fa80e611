"""Sines of machines and mains: seen in the periodogram of the whole record, and taken out without
touching a mode.

A mode in random vibration spreads over ζ f T lines of a periodogram of the length T, a sine over
the one of its window. So a sine stands out even on the peak of a mode where both run for long;
fitted by least squares with a slow change of amplitude and phase, it takes with it a few lines of
the mode only. What is left of a machine whose amplitude or speed wanders is the foot of its line.

Tones of machines that change their speed: seen as moving ridges of the spectrogram, and taken
out along these.

Where a run-up turns or rests it leaves a peak in the mean spectrum that looks like a mode, and a
mode that it crosses is excited as by one force. A mode under random forces stays where it is: a
ridge that moves by more than the width of any mode is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial.legendre import legvander
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.ndimage import (
    binary_dilation,
    find_objects,
    label,
    maximum_filter1d,
    median_filter,
)

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.band_correlations import Signals, detrended
from ringtrue.signal.spectra import BLOCK, window

GROUP = 32  # bins with a common level
QUIET = 0.5  # level of a frame, at least
DYNAMIC_RANGE = 1e-14  # of a record, as power: no recorder has more than 140 dB


@dataclass(frozen=True, slots=True)
class RunUpSettings:
    """What is a ridge of the spectrogram that moves.

    Attributes
    ----------
    frames : tuple of int, samples
        Of the transforms: slow tones are sought first.
    low : float
        Times the level of bin and frame: what hangs together.
    high : float
        Times that level: what noise does not reach.
    cells : int
        Loud cells, and frames, of a ridge at least.
    ratio : float
        Largest over smallest frequency, at least: five half-power bandwidths of 3 % damping.
    span : int
        Bins that it moves by, at least.
    jump : float
        Typical step from frame to frame over its range, at most.
    """

    frames: tuple[int, ...] = (8192, 2048, 512, 128)
    low: float = 4.0
    high: float = 12.0
    cells: int = 8
    ratio: float = 1.15
    span: int = 6
    jump: float = 0.25


RUN_UPS = RunUpSettings()


@dataclass(frozen=True, slots=True)
class MovingTone:
    """A tone of changing frequency: from `low` to `high` Hz, seen in `seconds` of the record."""

    low: float
    high: float
    seconds: float


def remove_run_ups(
    history: TimeHistory, mixes: Any_ | None = None
) -> tuple[TimeHistory, tuple[MovingTone, ...]]:
    """The record without tones of changing frequency, and these; the same object where there are
    none.

    All channels lose the same cells of time and frequency; a mode that a tone rests on loses that
    time. `mixes` are its `channel_mixes`, if known.
    """
    found = list[MovingTone]()
    mixes = channel_mixes(history.data) if mixes is None else mixes
    for n in RUN_UPS.frames:
        if 2 * history.data.shape[1] < 64 * n:
            continue
        mask, sweeps = _moving(_whitened(mixes, n), history.rate / n)
        if sweeps:
            history = replace(
                history, data=np.stack([_masked(x, mask, n) for x in history.data])
            )
            found += sweeps
            mixes = channel_mixes(history.data)
    return history, tuple(found)


def channel_mixes(data: Any_) -> Any_:
    """(2, sample) float32 sum and alternating sum of some channels of `data` (ch, sample), of unit
    variance each.
    """
    x = data[np.unique(np.linspace(0, len(data) - 1, 4).astype(np.int64))].astype(
        np.float32
    )
    x -= x.mean(axis=1, keepdims=True)
    x /= np.maximum(x.std(axis=1, keepdims=True), np.finfo(np.float32).tiny)
    return np.stack([x.sum(axis=0), x[::2].sum(axis=0) - x[1::2].sum(axis=0)])


def _window(n: int) -> Any_:
    """(sample,) float32: its squares at half overlap add up to 1."""
    return np.sin(np.pi * (np.arange(n) + 0.5) / n).astype(np.float32)


def _frames(x: Any_, n: int) -> Any_:
    """(frame, n) half-overlapped views of a signal (sample,), the first and last one half beyond
    its ends.
    """
    m = 2 * x.size // n + 2
    padded = np.pad(x, (n // 2, (m + 1) * (n // 2) - n // 2 - x.size))
    return sliding_window_view(padded, n)[:: n // 2]


def _whitened(mixes: Any_, n: int) -> Any_:
    """(frame, bin) power over the typical one of the bin in the record and of neighbouring bins in
    the frame.

    Zero throughout where too few cells stand out for a ridge.
    """
    bins = n // 2 // GROUP * GROUP
    taper = _window(n)
    total = np.zeros((len(_frames(mixes[0], n)), bins), dtype=np.float32)
    for x in mixes:
        y = rfft(_frames(x, n) * taper, axis=1)[:, :bins]
        power = y.real**2 + y.imag**2
        typical = _upper_median(power[:: -(-len(power) // 500)].T)[:, 0] * np.float32(
            len(mixes) / np.log(2)
        )
        total += power / np.maximum(typical, np.finfo(np.float32).tiny)
    total[:, :4] = 0
    groups = total.reshape(len(total), -1, GROUP)
    # levels take longer than all else
    some = groups[groups.max(axis=2) > RUN_UPS.high * QUIET]
    if (some > RUN_UPS.high * _levels(some)).sum() < RUN_UPS.cells:
        return np.zeros_like(total)
    return (groups / _levels(groups)).reshape(total.shape)


def _levels(groups: Any_) -> Any_:
    return np.maximum(_upper_median(groups), np.float32(QUIET))


def _upper_median(a: Any_) -> Any_:
    """Over the last axis, which stays."""
    middle = a.shape[-1] // 2
    ranked: Any_ = np.partition(np.ascontiguousarray(a), middle, axis=-1)
    return ranked[..., middle : middle + 1]


def _moving(white: Any_, step: float) -> tuple[Bool, list[MovingTone]]:
    """Cells (frame, bin) of ridges that move, and these; bins have a distance of `step` Hz."""
    mask = np.zeros(white.shape, dtype=np.bool_)
    sweeps = list[MovingTone]()
    if np.count_nonzero(white > RUN_UPS.high) < RUN_UPS.cells:
        return mask, sweeps
    cell, count = label(white > RUN_UPS.low, np.ones((3, 3)))
    strong = np.bincount(cell[white > RUN_UPS.high], minlength=count + 1)[1:]
    ridges = np.flatnonzero(strong >= RUN_UPS.cells).tolist()
    places = find_objects(cell) if ridges else []
    for k in ridges:  # a few
        own = cell[places[k]] == k + 1
        power = np.where(own & (white[places[k]] > RUN_UPS.high), white[places[k]], 0.0)
        first = places[k][1].start
        if (ends := _ridge(power, first)) is not None:
            mask[places[k]] |= own
            sweeps.append(
                MovingTone(
                    step * ends[0],
                    step * ends[1],
                    0.5 * int((power > 0).any(axis=1).sum()) / step,
                )
            )
    if sweeps:
        mask = np.asarray(binary_dilation(mask, np.ones((1, 3), dtype=np.bool_)))
    return mask, sweeps


def _ridge(power: Float, first: int) -> tuple[float, float] | None:
    """Lowest and highest bin of a ridge `power` (frame, bin from `first` on) that moves smoothly;
    None for others.
    """
    seen = power.any(axis=1)
    if seen.sum() < RUN_UPS.cells:
        return None
    at = first + np.arange(power.shape[1])
    total = power[seen].sum(axis=1)
    centre = power[seen] @ at / total
    ranked = np.sort(centre)
    low = float(ranked[2])
    high = float(ranked[-1 - 2])
    jumps = float(np.median(np.abs(np.diff(centre)))) > RUN_UPS.jump * (high - low)
    if jumps or high < RUN_UPS.ratio * low or high - low < RUN_UPS.span:
        return None
    return low, high


def _masked(x: Any_, mask: Bool, n: int) -> Any_:
    """A signal (sample,) without the cells (frame, bin) of a mask."""
    rows = np.flatnonzero(mask.any(axis=1))
    y = rfft(_frames(x, n)[rows] * _window(n), axis=1)
    y[:, : mask.shape[1]] *= mask[rows]
    y[:, mask.shape[1] :] = 0
    parts = irfft(y, n, axis=1) * _window(n)
    gone = np.zeros((len(mask) + 1, n // 2), dtype=parts.dtype)
    np.add.at(gone, rows, parts[:, : n // 2])
    np.add.at(gone, rows + 1, parts[:, n // 2 :])
    return x - gone.ravel()[n // 2 : n // 2 + x.size]


@dataclass(frozen=True, slots=True)
class LineShares:
    """How the powers of lines are estimated from segments.

    Attributes
    ----------
    channels : int
        Channels that show the lines of machines, at most.
    batch : int
        Segments that are transformed together.
    clear : tuple of float
        Times the power next to a steady line and around it, and its moment.
    """

    channels: int = 32
    batch: int = 8
    clear: tuple[float, ...] = (30.0, 10.0, 1.35)


SHARES = LineShares()


@dataclass(frozen=True, slots=True)
class LineSearch:
    """When a line of the periodogram is one of a machine.

    Attributes
    ----------
    cycles : float
        Cycles of the lowest frequency in which the least damped structure (0.05 %) spreads over
        four lines.
    above : float
        Power over the median around; noise reaches it once in 2^50.
    next_to : float
        Power over the median just outside of the lobe.
    around : int
        Lines to each side of which the median is taken.
    lobe : int
        Lines to each side of a sine that the window holds.
    most : int
        Lines of machines, the strongest.
    """

    cycles: float = 3600.0
    above: float = 50.0
    next_to: float = 25.0
    around: int = 40
    lobe: int = 5
    most: int = 256


SEARCH = LineSearch()


@dataclass(frozen=True, slots=True)
class LineFit:
    """How the lines are fitted and taken out.

    Attributes
    ----------
    slow : int
        Polynomials of amplitude and phase.
    together : int
        Lines that are fitted at a time: a fit of all would cost the square of their number.
    channels : int
        Channels that are searched; four transforms go in step.
    longest : int
        Samples that are searched at most.
    """

    slow: int = 4
    together: int = 32
    channels: int = 4
    longest: int = 1 << 21


FIT = LineFit()


@dataclass(frozen=True, slots=True)
class Harmonic:
    """A spectral line of a machine or the mains: frequency in Hz and why it is taken for one.

    `moment` is the normalised fourth moment of its amplitude: 1 of a steady sine, 2 of a mode in
    random vibration.
    """

    frequency: float
    why: str
    moment: float = 1.0


def line_name(f: float, resolution: float, found: Sequence[float]) -> str:
    """What a line at `f` Hz is: mains hum, a multiple of one `found` already, or a machine."""
    for mains in (50.0, 60.0, 50.0 / 3):
        k = round(f / mains)
        if k >= 1 and abs(f - k * mains) < max(resolution, 2e-3 * f):
            return f"mains hum, {k} x {mains:.4g} Hz"
    for base in found:
        k = round(f / base)
        if k >= 2 and abs(f - k * base) < 2 * resolution:
            return f"{k} x {base:.4g} Hz"
    return "a rotating machine"


def harmonics(history: TimeHistory, *, low: float = 0.0) -> tuple[Harmonic, ...]:
    """Lines with a steady amplitude and no width: machines and mains hum, not modes.

    The normalised fourth moment E|Y|⁴/(E|Y|²)² of the short-time spectra over time is 2 for a mode
    in random vibration and 1 for a sine (Antoni 2006, spectral kurtosis); the line must also be as
    narrow as the window.

    Parameters
    ----------
    low : float, Hz
        Look above this frequency.
    """
    data = history.data
    rate = history.rate
    fewest = 256
    # 120 segments of half overlap, or fewer lines in a short record
    length = int(next_fast_len(max(fewest, 2 * data.shape[1] // 121), real=True))
    if data.shape[1] < 16 * length // 2:
        return ()
    side, floor, limit = SHARES.clear
    if length > fewest:
        # each fourth segment of so many shows a line half as clearly, its moment half as
        # far from that of a mode, if there is any
        some = _moments(data, length, every=4)
        if not _steady(*some, side / 2, floor / 2, limit / 2 + 1).size:
            return ()
    second, kurtosis = _moments(data, length)
    line = _steady(second, kurtosis, side, floor, limit)
    freqs = rfftfreq(length, 1 / rate)
    found = [float(freqs[i]) for i in line if freqs[i] > low]
    names = [line_name(f, freqs[1], found[:i]) for i, f in enumerate(found)]
    return tuple(
        Harmonic(f, f"{name}: steady line (fourth moment {k:.2f}, a mode has 2)", k)
        for f, name, k in zip(
            found,
            names,
            kurtosis[np.rint(found / freqs[1]).astype(np.int64)].tolist(),
            strict=True,
        )
    )


def _steady(
    second: Float, moment: Float, over_side: float, over_floor: float, limit: float
) -> Int:
    """Lines of the spectrum `second` (freq,) as narrow as the window, whose `moment` (freq,) is
    below the limit.
    """
    floor = median_filter(second, size=41, mode="nearest")
    at = np.arange(8, second.size - 8)
    side = np.maximum(second[at - 5], second[at + 5])
    peak = (second[at] >= second[at - 1]) & (second[at] > second[at + 1])
    clear = (second[at] > over_side * side) & (second[at] > over_floor * floor[at])
    return np.asarray(at[peak & clear & (moment[at] < limit)], dtype=np.int64)


def _moments(data: Any_, length: int, *, every: int = 1) -> tuple[Float, Float]:
    """Power (freq,) summed over normalised channels, and its normalised second moment over time.

    Of half-overlapped segments of `length` samples, all or one of `every` so many. The moment is
    the mean of those of the channels by their power: the sum of the powers of two modes in
    different directions would look steadier than either.
    """
    win = window("blackmanharris", length)
    total, moment = np.zeros((2, length // 2 + 1))
    room = np.empty((SHARES.batch, length), dtype=np.float32)
    for i in np.unique(np.linspace(0, len(data) - 1, SHARES.channels).astype(np.int64)):
        some = data[i, :: max(1, data.shape[1] // 20000)]
        level = some.mean(dtype=np.float64)
        scale = max(float(np.std(some, dtype=np.float64)), 1e-30)
        gain = (win / scale).astype(np.float32)
        parts = sliding_window_view(data[i], length)[:: every * (length // 2)]
        first, second = np.zeros((2, length // 2 + 1))
        # in the cache, and in place: most of the time is that of the transforms
        for k in range(0, len(parts), SHARES.batch):
            x = room[: min(SHARES.batch, len(parts) - k)]
            np.subtract(parts[k : k + SHARES.batch], level, out=x, casting="same_kind")
            x *= gain
            y = rfft(x, axis=1).view(np.float32)
            y *= y
            power = y[:, ::2] + y[:, 1::2]
            first += power.sum(0)
            second += np.einsum("sf,sf->f", power, power)
        total += first / len(parts)
        moment += second / np.maximum(first, np.finfo(np.float64).tiny)
    return total, moment / np.maximum(total, np.finfo(np.float64).tiny)


def find_tonal_lines(
    history: TimeHistory, *, low: float = 0.0, high: float = np.inf
) -> tuple[Harmonic, ...]:
    """Sines of constant frequency between `low` and `high` Hz, the strongest where there are more
    than `SEARCH.most`.

    Parameters
    ----------
    history : TimeHistory
        At most 4 channels and 2 million samples of it are looked at.
    """
    power, step = _periodogram(history)
    samples = min(history.data.shape[1], FIT.longest)
    if samples < 16 * SEARCH.around:
        return ()
    k = np.flatnonzero(
        power >= maximum_filter1d(power, 2 * SEARCH.lobe + 1, mode="nearest")
    )
    k = k[
        (k > SEARCH.around)
        & (k < power.size - SEARCH.around)
        & (step * k * samples / history.rate > SEARCH.cycles)
    ]
    k = k[power[k] > DYNAMIC_RANGE * power.max()]
    beyond = np.arange(SEARCH.lobe + 1, SEARCH.lobe + 5)
    side = np.median(power[k + np.concatenate([-beyond, beyond])[:, None]], axis=0)
    k = k[power[k] > SEARCH.next_to * side]
    k = k[
        power[k]
        > SEARCH.above
        * np.median(
            power[k + np.arange(-SEARCH.around, SEARCH.around + 1)[:, None]], axis=0
        )
    ]
    bend = np.log(np.maximum(power[k + np.arange(-1, 2)[:, None]], 1e-300))
    f = step * (k + 0.5 * (bend[0] - bend[2]) / (bend[0] - 2 * bend[1] + bend[2]))
    inside = (f > low) & (f < high)
    k = k[inside]
    f = f[inside]
    f = f[np.sort(np.argsort(-power[k], kind="stable")[: SEARCH.most])]
    why = "steady frequency, taken out before modes are sought"
    names = [line_name(float(x), 2 * step, f[:i].tolist()) for i, x in enumerate(f)]
    return tuple(
        Harmonic(float(x), f"{name}: {why}") for x, name in zip(f, names, strict=True)
    )


def _periodogram(history: TimeHistory) -> tuple[Float, float]:
    """(freq,) of some channels, of unit variance each, and the distance of its lines, Hz."""
    x = searched_part(history)
    scale = np.maximum(
        x[:, :: max(1, x.shape[1] // 20000)].std(
            axis=1, dtype=np.float64, keepdims=True
        ),
        1e-300,
    )
    x *= (1 / scale).astype(np.float32)
    x *= _taper(x.shape[1])
    n = int(next_fast_len(x.shape[1], real=True))
    # single precision is 120 dB below the record, and halves the time
    y = rfft(x, n, axis=1).view(np.float32)
    y *= y
    return np.asarray(
        (y[:, ::2] + y[:, 1::2]).sum(axis=0, dtype=np.float64)
    ), history.rate / n


def _taper(samples: int) -> Any_:
    """Blackman-Harris window (sample,) float32 by powers of one cosine."""
    c: Any_ = np.cos(
        np.arange(samples, dtype=np.float32) * np.float32(2 * np.pi / samples)
    )
    c2 = c * c
    return (
        (0.35875 - 0.14128)
        + c * (3 * 0.01168 - 0.48829)
        + c2 * (2 * 0.14128 - 4 * 0.01168 * c)
    )


def remove_tonal_lines(
    history: TimeHistory, frequencies: Sequence[float]
) -> TimeHistory:
    """The record without sines of constant frequencies, Hz, of slowly changing amplitude and phase.

    Least squares over the whole record by a window that keeps close modes out of the fit.

    Raises
    ------
    DataError
        If nothing but rounding is left.
    """
    if not len(frequencies):
        return history
    data = np.array(history.data)
    parts = [
        frequencies[k : k + FIT.together]
        for k in range(0, len(frequencies), FIT.together)
    ]
    # the second mends what neighbours in two parts took of each other
    sweeps = 1 if len(parts) == 1 else 2
    for part in parts * sweeps:
        _take_out(data, history.rate, part)
    if (
        data.std(axis=1, dtype=np.float64)
        <= np.sqrt(DYNAMIC_RANGE) * history.data.std(axis=1, dtype=np.float64)
    ).all():
        listed = " ".join(f"{f:.5g}" for f in frequencies[:8])
        raise DataError(
            f"{history.source}: nothing but steady lines at {listed} Hz: a machine or a generator, "
            "no mode"
        )
    return replace(history, data=data)


def _take_out(data: Any_, rate: float, frequencies: Sequence[float]) -> None:
    """Fit some lines to the signals (ch, sample) and take them out, in place."""
    samples = data.shape[1]
    taper = window("hann", samples)
    columns = 2 * FIT.slow * len(frequencies)
    gram = np.zeros((columns, columns))
    right = np.zeros((columns, len(data)))
    # a basis of the whole record would not fit in memory
    for start in range(0, samples, BLOCK):
        a = _basis(rate, samples, frequencies, start)
        weighted = a * taper[start : start + BLOCK, None]
        gram += weighted.T @ a
        right += weighted.T @ data[:, start : start + BLOCK].T.astype(np.float64)
    x = np.linalg.lstsq(gram, right)[0]
    for start in range(0, samples, BLOCK):
        data[:, start : start + BLOCK] -= (
            _basis(rate, samples, frequencies, start) @ x
        ).T.astype(data.dtype)


def _basis(
    rate: float, samples: int, frequencies: Sequence[float], start: int
) -> Float:
    """(sample, column) sines and cosines times Legendre polynomials over the record, from a sample
    on.
    """
    t = np.arange(start, min(start + BLOCK, samples))
    slow = legvander(2 * t / samples - 1, FIT.slow - 1)
    turn = 2 * np.pi * t[:, None] * (np.asarray(frequencies) / rate)
    both = np.concatenate([np.cos(turn), np.sin(turn)], axis=1)
    return np.asarray((both[:, :, None] * slow[:, None]).reshape(t.size, -1))


def searched_part(history: TimeHistory) -> Any_:
    """(ch, sample) float32, less about their means: at most `FIT.channels` channels and
    `FIT.longest` samples.
    """
    at = np.unique(
        np.linspace(0, len(history.channels) - 1, FIT.channels).astype(np.int64)
    )
    return Signals.of(history.data).part(0, min(history.data.shape[1], FIT.longest), at)


def excerpt_spectrum(history: TimeHistory) -> tuple[Any_, int]:
    """Transform (ch, line) complex64 of these without their straight lines, and its length."""
    x = searched_part(history)
    n = int(next_fast_len(x.shape[1], real=True))
    return rfft(detrended(x).data, n, axis=1), n
