"""Sensors that are replaced, or whose amplifiers are set anew, while a structure is monitored.

From then on one channel has another factor in the shapes of all modes, and the other channels keep
their ratios. A structure that changes moves some modes more than others, and several channels of
each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.identification.environment import inflation, memory_of
from ringtrue.identification.tracking import ModeTrack, Stretch, Tracked, TrackSettings, track_modes

LEAST = 3  # stretches on either side of a change, that a mode must be seen in
CHANGE, SURE = 0.1, 6.0  # of the logarithm of the factor: the least, and in standard deviations
SUDDEN = (
    0.6,
    1.6,
)  # of the change, from the last stretches before it to the first ones after: sensors also drift
ALONE = 4.0  # times the change of the typical channel
FEWEST = 3  # channels: of two, either may have changed
SEEN = 0.1  # of the component of the typical channel: what is below is mostly noise
QUIETEST = 1e-3  # relative scatter of a component
MOST, TRIED = 20, 50  # changes, and places where each is looked for


@dataclass(frozen=True, slots=True)
class GainChange:
    """A channel that has another factor from a stretch on.

    Attributes
    ----------
    channel : str
    at : int
        The first stretch with it.
    factor : float
        Of its components, over that before.
    std : float
        Standard deviation of the factor.
    """

    channel: str
    at: int
    factor: float
    std: float


def with_equal_gains(
    stretches: Sequence[Stretch], settings: TrackSettings | None = None
) -> tuple[list[Stretch], list[GainChange]]:
    """The stretches with shapes as the sensors of the first ones measure them, and the changes, by
    time.

    Parameters
    ----------
    stretches : sequence of Stretch
        Ascending in time.
    settings : TrackSettings, optional

    Raises
    ------
    DataError
        Without stretches, or if they do not ascend.
    """
    # a shape of which one component changed much may be like no other
    by_frequency = replace(settings or TrackSettings(), mac=0.0)
    out, found = list(stretches), list[GainChange]()
    for _ in range(MOST):
        if (change := _largest(track_modes(out, by_frequency), out)) is None:
            break
        found.append(change)
        out = [*out[: change.at], *(_divided(x, change) for x in out[change.at :])]
    return out, sorted(found, key=lambda c: c.at)


def _divided(stretch: Stretch, change: GainChange) -> Stretch:
    """The stretch with the components of the channel over the factor."""
    factor = np.array(
        [change.factor if c == change.channel else 1.0 for c in stretch.modes.channels]
    )[:, None]
    modes, uncertainty = stretch.modes, stretch.uncertainty
    return replace(
        stretch,
        modes=replace(modes, shapes=modes.shapes / factor),
        uncertainty=replace(uncertainty, shape=uncertainty.shape / factor),
    )


def _largest(tracked: Tracked, stretches: Sequence[Stretch]) -> GainChange | None:
    """The surest change of one channel."""
    sizes = [_sizes(tracked, t, stretches) for t in tracked.tracks if t.at.size >= 2 * LEAST]
    if len(tracked.channels) < FEWEST or not sizes:
        return None
    steps, variances = zip(*(_steps(_levels(x)) for x in sizes), strict=True)
    size, std = _pooled(np.array(steps), np.array(variances))
    usual = np.median(np.abs(size), axis=0)
    ratio = np.where(
        (np.abs(size) > CHANGE) & (np.abs(size) > ALONE * usual), np.abs(size) / std, 0.0
    )
    places = np.argsort(-ratio, axis=None, kind="stable")[:TRIED]
    for c, at in zip(
        *np.unravel_index(places[ratio.flat[places] > SURE], ratio.shape), strict=True
    ):  # few
        if (sure := _confirmed([_levels(x, int(c))[c] for x in sizes], int(at))) is not None:
            factor = float(np.exp(sure[0]))
            return GainChange(tracked.channels[c], int(at), factor, factor * sure[1])
    return None


def _sizes(tracked: Tracked, track: ModeTrack, stretches: Sequence[Stretch]) -> Float:
    """(channel, stretch) moduli of the components of a mode, NaN where unknown."""
    place = {c: i for i, c in enumerate(tracked.channels)}
    size = np.full((len(place), len(stretches)), np.nan)
    for k, j in zip(
        track.at.tolist(), track.mode.tolist(), strict=True
    ):  # stretches may have different channels
        modes = stretches[k].modes
        size[[place[c] for c in modes.channels], k] = np.abs(modes.shapes[:, j])
    size[size <= 0] = np.nan
    return size


def _levels(size: Float, but: int | None = None) -> Float:
    """Logarithms of the components (channel, stretch) over the usual ones, in units of the typical
    channel `but` one.

    NaN where they are small.
    """
    others = np.delete(np.arange(len(size)), [] if but is None else but)
    size = size / _median(size[others], 0)
    typical = _median(size, 1)
    level = np.log(np.where(typical > SEEN, size, np.nan) / typical)
    return np.asarray(level - _median(level[others], 0))


def _median(x: Float, axis: int) -> Float:
    """Over an axis, which stays; NaN where nothing is known."""
    known = np.isfinite(x).any(axis=axis, keepdims=True)
    return np.asarray(
        np.where(known, np.nanmedian(np.where(known, x, 0.0), axis=axis, keepdims=True), np.nan)
    )


def _steps(level: Float) -> tuple[Float, Float]:
    """Change of the levels (..., stretch) from each stretch on, and its variance; infinite where
    too few are known.
    """
    seen = np.isfinite(level)
    x = np.where(seen, level, 0.0)
    before, after = np.cumsum(seen, axis=-1) - seen, np.cumsum(seen[..., ::-1], axis=-1)[..., ::-1]
    one, two = np.maximum(before, 1), np.maximum(after, 1)
    early, late = (
        (np.cumsum(x, axis=-1) - x) / one,
        np.cumsum(x[..., ::-1], axis=-1)[..., ::-1] / two,
    )
    left = (x**2).sum(axis=-1, keepdims=True) - before * early**2 - after * late**2
    scatter = np.maximum(left / np.maximum(before + after - 2, 1), QUIETEST**2)
    enough = (before >= LEAST) & (after >= LEAST)
    return np.where(enough, late - early, 0.0), np.where(
        enough, scatter * (1 / one + 1 / two), np.inf
    )


def _pooled(size: Float, variance: Float) -> tuple[Float, Float]:
    """Mean of the changes (mode, ...) by their variances, and its deviation, wider where modes
    differ.
    """
    weight = 1 / variance
    total = np.maximum(weight.sum(axis=0), np.finfo(np.float64).tiny)
    mean = (weight * size).sum(axis=0) / total
    apart = (weight * (size - mean) ** 2).sum(axis=0) / np.maximum((weight > 0).sum(axis=0) - 1, 1)
    return mean, np.sqrt(np.maximum(apart, 1.0) / total)


def _confirmed(levels: Sequence[Float], at: int) -> tuple[float, float] | None:
    """The change of the levels of a channel (stretch,) in all modes and its deviation; None where
    it is no sure one.

    Residuals that hang together from stretch to stretch make it less certain.
    """
    sizes, variances, sudden = list[float](), list[float](), list[float]()
    for level in levels:
        known = np.flatnonzero(np.isfinite(level))
        before, after = known[known < at], known[known >= at]
        if min(before.size, after.size) < LEAST:
            continue
        size, variance = (float(x[at]) for x in _steps(level))
        left = level[known] - np.where(known < at, level[before].mean(), level[after].mean())
        sizes.append(size)
        variances.append(variance * inflation(memory_of(left, known, 2), 1.0))
        sudden.append(float(np.median(level[after[:LEAST]]) - np.median(level[before[-LEAST:]])))
    if not sizes:
        return None
    mean, std = (float(x) for x in _pooled(np.array(sizes), np.array(variances)))
    weight = 1 / np.array(variances)
    at_once = float(weight @ np.array(sudden) / weight.sum()) / mean
    return (
        (mean, std)
        if abs(mean) > max(CHANGE, SURE * std) and SUDDEN[0] < at_once < SUDDEN[1]
        else None
    )
