"""The test model: measuring points, their frames, lines to draw and channels.

Observation: the only bridge between the DOFs of a model and the channels of a test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int, freeze_arrays, freeze_fields
from ringtrue.core.channels import SHOWN, match_channels, split_label
from ringtrue.core.dofs import DofSet
from ringtrue.errors import DataError, InputError


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
    forces : tuple of str
        Excitation points that the sheet lists, by the ids that inputs of FRFs have (`9-Z`).
    force_at : (force,) int64
        The point number of each.
    force_axes : (force, 3) float64
        Unit vector of each positive force, global frame.
    """

    points: Int
    xyz: Float
    channels: tuple[str, ...]
    at: Int
    axes: Float
    lines: Int
    groups: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()
    force_at: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    force_axes: Float = field(default_factory=lambda: np.zeros((0, 3)))

    __test__ = False  # not a pytest class

    def __post_init__(self) -> None:
        freeze_fields(
            self,
            points=np.int64,
            xyz=np.float64,
            at=np.int64,
            axes=np.float64,
            lines=np.int64,
        )
        freeze_fields(self, force_at=np.int64, force_axes=np.float64)
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "forces", tuple(self.forces))
        object.__setattr__(
            self, "groups", tuple(self.groups) or ("",) * self.points.size
        )
        if len(set(self.channels)) != len(self.channels):
            raise InputError("a channel occurs twice in the test model")
        if np.unique(self.points).size != self.points.size:
            raise InputError("a point occurs twice in the test model")
        lost = np.setdiff1d(self.at, self.points)
        if lost.size:
            raise InputError(
                f"channels refer to points that are not there: {lost[:8].tolist()}"
            )
        length = np.linalg.norm(self.axes, axis=1)
        if (
            self.axes.shape != (len(self.channels), 3)
            or (np.abs(length - 1) > 1e-6).any()
        ):
            raise InputError(
                f"axes {self.axes.shape} must be unit vectors, one for each of "
                f"{len(self.channels)} channels"
            )

    def channel_xyz(self) -> Float:
        """(channel, 3) position of each channel, m."""
        order = np.argsort(self.points)
        return self.xyz[order[np.searchsorted(self.points[order], self.at)]]

    def threefold(self) -> TestModel:
        """A channel along X, Y and Z of the sheet at the place of each: first all along X, (3 ·
        channel).
        """
        n = len(self.channels)
        names = tuple(f"{c} {axis}" for axis in "XYZ" for c in self.channels)
        axes = np.repeat(np.eye(3), n, axis=0)
        return replace(self, channels=names, at=np.tile(self.at, 3), axes=axes)

    def group_of_channels(self) -> tuple[str, ...]:
        """The part of the structure that each channel is on, as the sheet names it."""
        group = dict(zip(self.points.tolist(), self.groups, strict=True))
        return tuple(group[p] for p in self.at.tolist())

    def find(
        self, channels: Sequence[str], *, forces: bool = True
    ) -> tuple[Int, Float]:
        """Where named channels stand in `channels`, then `forces` unless left out, and with which
        sign.

        `4-X` is the sensor `4+X` read the other way, unless the sheet gives that sensor a direction
        against its name: then what another sign of it means is unknown, and it is not found.

        Returns
        -------
        index : (k,) int64
            -1 where the sheet has no such channel.
        sign : (k,) float64, ±1
        """
        known = self.channels
        axes = self.axes
        if forces:
            known = (*known, *self.forces)
            axes = np.concatenate([axes, self.force_axes])
        index, sign = match_channels(channels, known)
        for k in np.flatnonzero(sign < 0).tolist():  # few
            label = split_label(known[index[k]])
            assert label is not None
            _, way, axis = label
            if way * axes[index[k], "XYZ".index(axis.strip("RS"))] <= 0:
                index[k] = -1
        return index, sign

    def named(self, channels: Sequence[str]) -> tuple[tuple[str, ...], Float]:
        """The names (k,) that the sheet has for the motions of a test, and their signs (k,); its
        own where it has none.

        A reading by the given name is the sign times one by the name of the sheet.

        Raises
        ------
        DataError
            If two are the same sensor.
        """
        index, sign = self.find(channels, forces=False)
        names = tuple(
            self.channels[i] if i >= 0 else c
            for c, i in zip(channels, index.tolist(), strict=True)
        )
        first: dict[str, str] = {}
        for one, name in zip(channels, names, strict=True):
            if first.setdefault(name, one) != one:
                raise DataError(
                    f"channels {first[name]} and {one} are the same sensor of the sheet, {name}"
                )
        return names, np.where(index >= 0, sign, 1.0)

    def pick(self, channels: Sequence[str], *, forces: bool = True) -> TestModel:
        """The same points with the named channels only, by these names and in this order.

        Excitation points are among those that can be named, unless `forces` is false.

        Raises
        ------
        DataError
            If one is not on the sheet (`find`); it is named.
        """
        index, sign = self.find(channels, forces=forces)
        if (index < 0).any():
            raise DataError(
                self._not_there(
                    [c for c, i in zip(channels, index.tolist(), strict=True) if i < 0]
                )
            )
        at = np.concatenate([self.at, self.force_at])[index]
        axes = np.concatenate([self.axes, self.force_axes])[index] * sign[:, None]
        return replace(self, channels=tuple(channels), at=at, axes=axes)

    def _not_there(self, lost: Sequence[str]) -> str:
        more = f" and {len(lost) - SHOWN} more" if len(lost) > SHOWN else ""
        there = " ".join((*self.channels, *self.forces)[:SHOWN])
        there += " ..." if len(self.channels) + len(self.forces) > SHOWN else ""
        against = match_channels(lost, (*self.channels, *self.forces))[0]
        if against.max() >= 0:
            name = (*self.channels, *self.forces)[against.max()]
            there += (
                f". The direction of {name} is against its name, so that no other sign of "
                "it has a meaning"
            )
        return (
            f"channel {' '.join(lost[:SHOWN])}{more} is not on the sensor sheet. It has {there}; "
            "its column `channel` "
            "names rows as the test does, and an excitation point needs a row, too"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A sparse matrix from FE degrees of freedom to test channels.

    Attributes
    ----------
    matrix : (channel, dof) scipy.sparse.csr_array float64
        Interpolation, direction cosines and signs; dimensionless.
    channels : tuple of str
    dofs : DofSet
        The FE degrees of freedom (basic frame) that the columns stand for.
    unit : float
        Factor from the model's length unit to metres (mm-t-s: 1e-3).
    distance : (channel,) float64, model unit
        From the sensor to the node or nodes it was matched to.
    """

    matrix: sparse.csr_array
    channels: tuple[str, ...]
    dofs: DofSet
    unit: float
    distance: Float

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if self.matrix.shape != (len(self.channels), len(self.dofs)):
            raise InputError(
                f"observation {self.matrix.shape} for {len(self.channels)} channels and "
                f"{len(self.dofs)} DOFs"
            )

    def __call__(self, shapes: Any_) -> Any_:
        """Shapes (dof, m) of the model, seen at the channels (channel, m).

        Mass-normalised shapes of a model in its own units stay so in SI through `unit` (length)
        elsewhere; here only direction and place change.
        """
        return self.matrix @ shapes

    def and_also(self, more: Observation) -> Observation:
        """The same model seen at further channels, too."""
        matrix = sparse.csr_array(sparse.vstack([self.matrix, more.matrix]))
        distance = np.concatenate([self.distance, more.distance])
        return Observation(
            matrix=matrix,
            channels=(*self.channels, *more.channels),
            dofs=self.dofs,
            unit=self.unit,
            distance=distance,
        )
