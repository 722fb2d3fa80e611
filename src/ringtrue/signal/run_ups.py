"""Tones of machines that change their speed: seen as moving ridges of the spectrogram, and taken
out along these.

Where a run-up turns or rests it leaves a peak in the mean spectrum that looks like a mode, and a
mode that it crosses is excited as by one force. A mode under random forces stays where it is: a
ridge that moves by more than the width of any mode is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft
from scipy.ndimage import binary_dilation, find_objects, label

from ringtrue.core.arrays import Any_, Bool, Float
from ringtrue.core.signals import TimeHistory

FRAMES = (8192, 2048, 512, 128)  # samples: slow tones are sought first
LEAST_FRAMES = 64  # of the record, for its medians to mean something
EYES = 4  # channels that are looked at
GROUP = 32  # bins with a common level
LOW, HIGH = (
    4.0,
    12.0,
)  # times the level of bin and frame: what hangs together, and what noise does not reach
LEAST, ODD = 8, 2  # frames of a ridge, and how many at either end of its range may be by chance
LOWEST = 4  # bin
FEW, QUIET = 500, 0.5  # frames at most that tell what is typical; level of a frame at least
MOVES = 1.15  # largest over smallest frequency: five half-power bandwidths of 3 % damping
SPAN, THIN = 6, 2.5  # bins, and widths of the ridge itself, that it moves by
STEADY = 0.25  # of its range: how far it may jump from frame to frame


@dataclass(frozen=True, slots=True)
class MovingTone:
    """A tone of changing frequency: from `low` to `high` Hz, seen in `seconds` of the record."""

    low: float
    high: float
    seconds: float


def remove_run_ups(
    history: TimeHistory, heard: Any_ | None = None
) -> tuple[TimeHistory, tuple[MovingTone, ...]]:
    """The record without tones of changing frequency, and these; the same object where there are
    none.

    All channels lose the same cells of time and frequency; a mode that a tone rests on loses that
    time. `heard` are its `channel_mixes`, if known.
    """
    found, heard = list[MovingTone](), channel_mixes(history.data) if heard is None else heard
    for n in FRAMES:
        if 2 * history.data.shape[1] < LEAST_FRAMES * n:
            continue
        mask, sweeps = _moving(_whitened(heard, n), history.rate / n)
        if sweeps:
            history = replace(history, data=np.stack([_masked(x, mask, n) for x in history.data]))
            found, heard = [*found, *sweeps], channel_mixes(history.data)
    return history, tuple(found)


def channel_mixes(data: Any_) -> Any_:
    """(2, sample) float32 sum and alternating sum of some channels of `data` (ch, sample), of unit
    variance each.
    """
    x = data[np.unique(np.linspace(0, len(data) - 1, EYES).astype(np.int64))].astype(np.float32)
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
    bins, taper = n // 2 // GROUP * GROUP, _window(n)
    total = np.zeros((len(_frames(mixes[0], n)), bins), dtype=np.float32)
    for x in mixes:
        y = rfft(_frames(x, n) * taper, axis=1)[:, :bins]
        power = y.real**2 + y.imag**2
        typical = _upper_median(power[:: -(-len(power) // FEW)].T)[:, 0] * np.float32(
            len(mixes) / np.log(2)
        )
        total += power / np.maximum(typical, np.finfo(np.float32).tiny)
    total[:, :LOWEST] = 0
    groups = total.reshape(len(total), -1, GROUP)
    some = groups[groups.max(axis=2) > HIGH * QUIET]  # levels take longer than all else
    if (some > HIGH * _levels(some)).sum() < LEAST:
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
    """Cells (frame, bin) of ridges that move, and these; bins are `step` Hz apart."""
    mask, sweeps = np.zeros(white.shape, dtype=np.bool_), list[MovingTone]()
    if np.count_nonzero(white > HIGH) < LEAST:
        return mask, sweeps
    cell, count = label(white > LOW, np.ones((3, 3)))
    strong = np.bincount(cell[white > HIGH], minlength=count + 1)[1:]
    ridges = np.flatnonzero(strong >= LEAST).tolist()
    places = find_objects(cell) if ridges else []
    for k in ridges:  # a few
        own = cell[places[k]] == k + 1
        power = np.where(own & (white[places[k]] > HIGH), white[places[k]], 0.0)
        first = places[k][1].start
        if (ends := _ridge(power, first)) is not None:
            mask[places[k]] |= own
            sweeps.append(
                MovingTone(
                    step * ends[0], step * ends[1], 0.5 * int((power > 0).any(axis=1).sum()) / step
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
    if seen.sum() < LEAST:
        return None
    at = first + np.arange(power.shape[1])
    total = power[seen].sum(axis=1)
    centre = power[seen] @ at / total
    width = 1 + 2 * float(
        np.median(np.sqrt((power[seen] * (at - centre[:, None]) ** 2).sum(axis=1) / total))
    )
    ranked = np.sort(centre)
    low, high = float(ranked[ODD]), float(ranked[-1 - ODD])
    jumps = float(np.median(np.abs(np.diff(centre)))) > STEADY * (high - low)
    if jumps or high < MOVES * low or high - low < max(SPAN, THIN * width):
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
