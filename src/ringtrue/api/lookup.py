"""What is looked up on a model: which parameters a region offers to an updating, and where the
sensors of a test are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from ringtrue.api.models import open_model
from ringtrue.core.arrays import Float, Int
from ringtrue.core.display import Displayed
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.sensor_mapping import Alignment
from ringtrue.errors import ConfigError, DataError, InputError
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.model.model import Model
from ringtrue.study.config_sections import target_words
from ringtrue.study.opened import Opened
from ringtrue.study.placing import alignment, alignment_text
from ringtrue.updating.selection.candidates import CandidateSettings, Kind
from ringtrue.updating.selection.generation import generate

# those that a deck can hold
KINDS: tuple[Kind, ...] = ("material", "property", "spring", "mass")


@dataclass(frozen=True, eq=False)
class RegionParameter(Displayed):
    """A factor on fields of a deck that changes elements of a region.

    Attributes
    ----------
    name : str
        Card, number and field.
    what : str
        In words, with the nominal value.
    targets : tuple of str
        As `targets` of a `[[candidate]]`, such as "MAT1 7 E".
    lower, upper, std : float
        Bounds of the factor and prior standard deviation of its logarithm, as usual for it.
    elements : tuple of int
        All elements that it changes.
    inside : int
        How many of them are in the region.
    """

    name: str
    what: str
    targets: tuple[str, ...]
    lower: float
    upper: float
    std: float
    elements: tuple[int, ...]
    inside: int


def region_parameters(
    model: Model, elements: Collection[int]
) -> tuple[RegionParameter, ...]:
    """The factors that change elements of a region: materials, properties, springs, masses.

    Parameters
    ----------
    model : Model
    elements : collection of int
        Numbers of elements.

    Returns
    -------
    tuple of RegionParameter
        Those first that change little besides the region.

    Examples
    --------
    >>> import ringtrue as rt
    >>> rt.region_parameters(rt.read_deck(rt.example_deck()), [11])[0].targets
    ('PELAS 1 K',)
    """
    wanted = {int(e) for e in elements}
    try:
        made = generate(model, CandidateSettings(KINDS, model.units))
    except InputError:  # the deck offers none
        return ()
    found = []
    for c in made:
        inside = len(wanted.intersection(c.elements))
        words = target_words(c.parameter)
        if not inside or not words:
            continue
        p = c.parameter
        entry = RegionParameter(
            name=c.name,
            what=c.what,
            targets=tuple(words),
            lower=float(f"{p.lower:.4g}"),
            upper=float(f"{p.upper:.4g}"),
            std=p.std,
            elements=c.elements,
            inside=inside,
        )
        found.append(entry)
    return tuple(sorted(found, key=lambda r: -r.inside / len(r.elements)))


@dataclass(frozen=True, eq=False)
class PlacedSensors(Displayed):
    """The points of a sensor sheet on a model.

    Attributes
    ----------
    test : TestModel
        In the frame of the model, m.
    points : (p,) int64
    node : (p,) int64
        The nearest node that a sensor may be on.
    distance : (p,) float64, m
        From it.
    tolerance : float, m
        A sensor that is farther off is refused by a correlation.
    alignment : str
        How the sheet was laid onto the model, in words; empty where it was not.
    """

    UNITS: ClassVar[Mapping[str, str]] = {"distance": "m", "tolerance": "m"}

    test: TestModel
    points: Int
    node: Int
    distance: Float
    tolerance: float
    alignment: str = ""
    _fit: Alignment | None = None
    _nodes: tuple[Int, Float] = field(default=(np.zeros(0, np.int64), np.zeros((0, 3))))

    @property
    def far(self) -> Int:
        """Points that are too far from any node, (f,)."""
        return np.asarray(self.points[self.distance > self.tolerance])

    def on_sheet(self, node: int) -> Float:
        """Where a node is in the frame of the sheet, (3,) m.

        Raises
        ------
        DataError
            If the model has no such node, or it is not the one of several at a place that moves.
        """
        ids, xyz = self._nodes
        row = np.flatnonzero(ids == node)
        if not row.size:
            raise DataError(
                f"node {node}: not a node of the model that a sensor may be on"
            )
        at = xyz[row[0]]
        return (
            at
            if self._fit is None
            else np.asarray((at - self._fit.shift) @ self._fit.rotation)
        )


def place_sensors(
    model: Model | Opened,
    sensors: SensorSheet | str | Path,
    *,
    align: Literal["", "points", "nearest"] = "",
    tolerance: float | None = None,
) -> PlacedSensors:
    """The points of a sensor sheet on a model, with their nearest nodes.

    Parameters
    ----------
    model : Model
    sensors : SensorSheet or path
    align : {"", "points", "nearest"}
        Lay the sheet onto the model first: by points that have the number of their node, or by the
        nearest nodes, as `[correlate] align` of a study.
    tolerance : float, m, optional
        Largest distance of a sensor from its node; 3 % of the model or a mesh width if not given.

    Raises
    ------
    ConfigError
        If `align` is not known.
    DataError
        If the points do not decide how the sheet lies.
    """
    if align not in ("", "points", "nearest"):
        raise ConfigError(f"align {align!r}: allowed are points, nearest, or none")
    opened = model if isinstance(model, Opened) else open_model(model)
    sheet = read_sensor_sheet(sensors) if isinstance(sensors, str | Path) else sensors
    test = sheet.model
    fit = alignment(test, opened, align) if align else None
    if fit is not None:
        test = fit.move(test)
    ids, _ = opened.seats
    near, usual = opened.near_seats
    distance, nearest = near.query(test.xyz)
    return PlacedSensors(
        test=test,
        points=test.points,
        node=ids[nearest],
        distance=np.asarray(distance),
        tolerance=usual if tolerance is None else tolerance,
        alignment="" if fit is None else alignment_text(fit),
        _fit=fit,
        _nodes=(ids, near.data),
    )
