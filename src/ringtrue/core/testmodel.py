"""The test model: measuring points, their frames, lines to draw and channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class TestModel:
    """Points and channels of a test, global frame, SI.

    Attributes
    ----------
    points : (p,) int64
        Point numbers, unique.
    xyz : (p, 3) float64, m
    channels : tuple of str
        Channel ids, unique.
    at : (channel,) int64
        The point number of each channel.
    axes : (channel, 3) float64
        Unit vector of positive reading, global frame, skewed ones too.
    lines : (l, 2) int64
        Pairs of point numbers to draw.
    groups : tuple of str
        Part of the structure for each point (foundation, frame, ...), empty strings where unknown.
    """

    points: Int
    xyz: Float
    channels: tuple[str, ...]
    at: Int
    axes: Float
    lines: Int
    groups: tuple[str, ...] = ()

    __test__ = False  # not a pytest class

    def __post_init__(self) -> None:
        freeze_fields(self, points=np.int64, xyz=np.float64, at=np.int64, axes=np.float64, lines=np.int64)
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "groups", tuple(self.groups) or ("",) * self.points.size)
        if len(set(self.channels)) != len(self.channels):
            raise InputError("a channel occurs twice in the test model")
        if np.unique(self.points).size != self.points.size:
            raise InputError("a point occurs twice in the test model")
        lost = np.setdiff1d(self.at, self.points)
        if lost.size:
            raise InputError(f"channels refer to points that are not there: {lost[:8].tolist()}")
        length = np.linalg.norm(self.axes, axis=1)
        if self.axes.shape != (len(self.channels), 3) or (np.abs(length - 1) > 1e-6).any():
            raise InputError(
                f"axes {self.axes.shape} must be unit vectors, one for each of {len(self.channels)} channels"
            )

    def directions(self) -> Float:
        """(channel, 3) unit vectors, global frame."""
        return self.axes

    def channel_xyz(self) -> Float:
        """(channel, 3) position of each channel, m."""
        order = np.argsort(self.points)
        return np.asarray(self.xyz[order[np.searchsorted(self.points[order], self.at)]])

    def pick(self, channels: Sequence[str]) -> TestModel:
        """The same points with the named channels only, in the given order."""
        here = {c: i for i, c in enumerate(self.channels)}
        lost = [c for c in channels if c not in here]
        if lost:
            raise InputError(f"no channel {' '.join(lost[:8])} in the test model")
        i = [here[c] for c in channels]
        return replace(self, channels=tuple(channels), at=self.at[i], axes=self.axes[i])
