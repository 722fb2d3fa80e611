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
)
from scipy.special import fdtrc, gammainccinv, ndtri

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.signals import FALSE_ALARM, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.band_correlations import Signals, detrended
from ringtrue.signal.spectra import AT_ONCE, pieces, window

DYNAMIC_RANGE = 1e-14  # of a record, as power: no recorder has more than 140 dB


@dataclass(frozen=True, slots=True)
class RunUpSettings:
    """What is a ridge of the spectrogram that moves.

    Attributes
    ----------
    frames : tuple of int, samples
        Of the transforms: slow tones are sought first.
    ratio : float
        Largest over smallest frequency, at least: five half-power bandwidths of 3 % damping.
    """

    frames: tuple[int, ...] = (8192, 2048, 512, 128)
    ratio: float = 1.15


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

    Zero throughout where fewer frames than a ridge takes have a cell that stands out of the noise.
    """
    group = RUN_UPS.frames[-1] // 4  # half of the bins of the shortest frames
    bins = n // 2 // group * group
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
    groups = total.reshape(len(total), -1, group)
    # levels take longer than all else
    noise = _noise(total.size)
    loud = groups.max(axis=2) > noise
    some = groups[loud]
    loud[loud] = (some > noise * _levels(some)).any(axis=1)
    if loud.any(axis=1).sum() < ndtri(FALSE_ALARM) ** 2:
        return np.zeros_like(total)
    return (groups / _levels(groups)).reshape(total.shape)


def _levels(groups: Any_) -> Any_:
    """The level of a frame is at least that of the record."""
    return np.maximum(_upper_median(groups), 1)


def _noise(cells: int) -> float:
    """What the largest of so many cells of noise exceeds in a false alarm: each is the mean power
    of two mixes over its expectation.
    """
    return float(gammainccinv(2, FALSE_ALARM / cells)) / 2


def _upper_median(a: Any_) -> Any_:
    """Over the last axis, which stays."""
    middle = a.shape[-1] // 2
    ranked: Any_ = np.partition(np.ascontiguousarray(a), middle, axis=-1)
    return ranked[..., middle : middle + 1]


def _moving(white: Any_, step: float) -> tuple[Bool, list[MovingTone]]:
    """Cells (frame, bin) of ridges that move, and these; bins have a distance of `step` Hz."""
    mask = np.zeros(white.shape, dtype=np.bool_)
    sweeps = list[MovingTone]()
    loud = white > _noise(white.size)
    if not loud.any():
        return mask, sweeps
    cell, _ = label(white > _noise(1), np.ones((3, 3)))
    ridges = np.unique(cell[loud]) - 1
    places = find_objects(cell)
    for k in ridges.tolist():  # a few
        own = cell[places[k]] == k + 1
        power = np.where(own & loud[places[k]], white[places[k]], 0.0)
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

    Steps from frame to frame are less than those of noise about one frequency, by the ratio of von
    Neumann (1941).
    """
    seen = power.any(axis=1)
    count = int(seen.sum())
    # noise has the ratio 2, with a variance of 4 / count
    limit = 2 + 2 * float(ndtri(FALSE_ALARM)) / np.sqrt(count)
    if limit < 0:
        return None
    at = first + np.arange(power.shape[1])
    total = power[seen].sum(axis=1)
    centre = power[seen] @ at / total
    ranked = np.sort(centre)
    low = float(ranked[2])
    high = float(ranked[-1 - 2])
    jumps = np.mean(np.diff(centre) ** 2) > limit * np.var(centre)
    # decays of two modes within one main lobe, 3 bins of the sine window, move between its ends
    if jumps or high < RUN_UPS.ratio * low or high - low < 2 * 3:
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
class LineSearch:
    """When a line of the periodogram is one of a machine.

    Attributes
    ----------
    lobe : int
        Lines to each side of a sine that the window holds.
    damping : float
        Least of a structure in operation.
    """

    lobe: int = 5
    damping: float = 2e-3


SEARCH = LineSearch()


@dataclass(frozen=True, slots=True)
class LineFit:
    """How the lines are fitted and taken out.

    Attributes
    ----------
    slow : int
        Polynomials of amplitude and phase.
    together : int
        Lines that are fitted at a time, and such parts at most: a fit of all would cost the square
        of their number.
    channels : int
        Channels that are searched; four transforms go in step.
    """

    slow: int = 4
    together: int = 16
    channels: int = 4


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
    second, kurtosis = _moments(data, length)
    line = _steady(second, kurtosis, 2 * data.shape[1] // length - 1)
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


def _steady(second: Float, moment: Float, segments: int) -> Int:
    """Peaks of the spectrum `second` (freq,) whose `moment` (freq,) is below that of noise.

    The moment of so many powers of noise has a standard deviation of 2 / sqrt(segments).
    """
    limit = 2 + 2 * float(ndtri(FALSE_ALARM / second.size)) / np.sqrt(segments)
    at = np.arange(8, second.size - 8)
    peak = (second[at] >= second[at - 1]) & (second[at] > second[at + 1])
    return np.asarray(at[peak & (moment[at] < limit)], dtype=np.int64)


def _moments(data: Any_, length: int) -> tuple[Float, Float]:
    """Power (freq,) summed over normalised channels, and its normalised second moment over time.

    Of half-overlapped segments of `length` samples. The moment is the mean of those of the channels
    by their power: the sum of the powers of two modes in different directions would look steadier
    than either.
    """
    win = window("blackmanharris", length)
    total, moment = np.zeros((2, length // 2 + 1))
    batch = max(1, AT_ONCE // (FIT.channels * length))
    room = np.empty((batch, length), dtype=np.float32)
    for i in np.unique(np.linspace(0, len(data) - 1, FIT.channels).astype(np.int64)):
        some = data[i, :: max(1, data.shape[1] // 20000)]
        level = some.mean(dtype=np.float64)
        scale = max(float(np.std(some, dtype=np.float64)), 1e-30)
        gain = (win / scale).astype(np.float32)
        parts = sliding_window_view(data[i], length)[:: length // 2]
        first, second = np.zeros((2, length // 2 + 1))
        # in the cache, and in place: most of the time is that of the transforms
        for k in range(0, len(parts), batch):
            x = room[: min(batch, len(parts) - k)]
            np.subtract(parts[k : k + batch], level, out=x, casting="same_kind")
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
    """Sines of constant frequency between `low` and `high` Hz, the strongest where there are many.

    Parameters
    ----------
    history : TimeHistory
        At most 4 channels and 2 million samples of it are looked at.
    """
    power, step = _periodogram(history)
    samples = min(history.data.shape[1], AT_ONCE)
    k = np.flatnonzero(
        power >= maximum_filter1d(power, 2 * SEARCH.lobe + 1, mode="nearest")
    )
    # the least damped structure spreads over the lobe
    cycles = SEARCH.lobe / (2 * SEARCH.damping)
    beyond = np.arange(SEARCH.lobe + 1, 3 * SEARCH.lobe + 1)
    k = k[
        (k >= beyond[-1])
        & (k < power.size - beyond[-1])
        & (step * k * samples / history.rate > cycles)
    ]
    k = k[power[k] > DYNAMIC_RANGE * power.max()]
    around = power[k + np.concatenate([-beyond, beyond])[:, None]]
    chance = _line_chance(power[k], np.median(around, axis=0) / np.log(2), beyond.size)
    k = k[chance < FALSE_ALARM / power.size]
    bend = np.log(np.maximum(power[k + np.arange(-1, 2)[:, None]], 1e-300))
    f = step * (k + 0.5 * (bend[0] - bend[2]) / (bend[0] - 2 * bend[1] + bend[2]))
    inside = (f > low) & (f < high)
    k = k[inside]
    f = f[inside]
    f = f[np.sort(np.argsort(-power[k], kind="stable")[: FIT.together**2])]
    why = "steady frequency, taken out before modes are sought"
    names = [line_name(float(x), 2 * step, f[:i].tolist()) for i, x in enumerate(f)]
    return tuple(
        Harmonic(float(x), f"{name}: {why}") for x, name in zip(f, names, strict=True)
    )


def _line_chance(power: Float, around: Float, lines: int) -> Float:
    """(k,) chance that noise of one channel has such a power, where that of so many independent
    lines around has a mean `around` (k,): F with 2 and twice as many degrees of freedom.
    """
    return np.asarray(fdtrc(2, 2 * lines, power / np.maximum(around, 1e-300)))


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
    parts = pieces(samples, columns)
    for part in parts:
        a = _basis(rate, samples, frequencies, part)
        weighted = a * taper[part, None]
        gram += weighted.T @ a
        right += weighted.T @ data[:, part].T.astype(np.float64)
    x = np.linalg.lstsq(gram, right)[0]
    for part in parts:
        lines = _basis(rate, samples, frequencies, part) @ x
        data[:, part] -= lines.T.astype(data.dtype)


def _basis(
    rate: float, samples: int, frequencies: Sequence[float], part: slice
) -> Float:
    """(sample, column) sines and cosines times Legendre polynomials over the record, of a part of
    it.
    """
    t = np.arange(part.start, part.stop)
    slow = legvander(2 * t / samples - 1, FIT.slow - 1)
    turn = 2 * np.pi * t[:, None] * (np.asarray(frequencies) / rate)
    both = np.concatenate([np.cos(turn), np.sin(turn)], axis=1)
    return np.asarray((both[:, :, None] * slow[:, None]).reshape(t.size, -1))


def searched_part(history: TimeHistory) -> Any_:
    """(ch, sample) float32, less about their means: at most `FIT.channels` channels and
    `AT_ONCE` samples.
    """
    at = np.unique(
        np.linspace(0, len(history.channels) - 1, FIT.channels).astype(np.int64)
    )
    return Signals.of(history.data).part(0, min(history.data.shape[1], AT_ONCE), at)


def excerpt_spectrum(history: TimeHistory) -> tuple[Any_, int]:
    """Transform (ch, line) complex64 of these without their straight lines, and its length."""
    x = searched_part(history)
    n = int(next_fast_len(x.shape[1], real=True))
    return rfft(detrended(x).data, n, axis=1), n
