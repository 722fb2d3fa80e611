"""A deck before anything is computed: what it holds and what is wrong with it, which parameters its
regions offer to an updating, and where the sensors of a test are on it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from ringtrue.api.models import in_units, open_model
from ringtrue.checks import Finding
from ringtrue.checks.deck import check_deck as checked
from ringtrue.checks.deck import readable
from ringtrue.checks.elements import free_edges_in_words, shell_edges
from ringtrue.checks.materials import (
    GroundCheck,
    MassProperties,
    autospc_findings,
    check_units,
    ground_check,
    ground_findings,
    mass_properties,
    unconstrained,
)
from ringtrue.core.arrays import Float, Int
from ringtrue.core.display import Displayed
from ringtrue.core.testmodel import TestModel
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.correlation.sensor_mapping import Alignment
from ringtrue.decks.nastran.reader import Survey, survey
from ringtrue.errors import ConfigError, DataError, InputError, RingtrueError, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.model.cards import effects
from ringtrue.model.frames import extent
from ringtrue.model.model import Model
from ringtrue.study.config_sections import target_words
from ringtrue.study.opened import Opened
from ringtrue.study.placing import alignment, alignment_text
from ringtrue.updating.selection.candidates import CandidateSettings, Kind
from ringtrue.updating.selection.generation import generate


@dataclass(frozen=True, eq=False)
class RigidCheck:
    """How a deck moves as a rigid body.

    Attributes
    ----------
    mass : MassProperties
        Of the whole structure, held or not, in units of the deck.
    ground : GroundCheck
    free_edges : str
        Of shells, in words.
    autospc : mapping of str to list of int
        Components that AUTOSPC holds, and the nodes.
    """

    mass: MassProperties
    ground: GroundCheck
    free_edges: str
    autospc: Mapping[str, list[int]]


@dataclass(frozen=True, eq=False)
class DeckCheck(Displayed):
    """What a deck holds and what is wrong with it.

    Attributes
    ----------
    model : Model
        What is read of it.
    cards, kept : mapping of str to int
        All cards, and those that are kept but not used.
    unsupported : mapping of str to str
        Cards that are not read, with the first place of each.
    missing : mapping of str to tuple of str
        What the model lacks without them.
    findings : tuple of Finding
        Errors first. Those of a card have its name and the numbers of what is meant.
    rigid : RigidCheck, optional
        None where the deck cannot be assembled; a finding says why.
    size : float
        Diagonal of the nodes, units of the deck; 0 without nodes.
    implausible : mapping of str to tuple of Finding
        For each unit system what would not be plausible in it: none where the deck may be in it.
    """

    UNITS: ClassVar[Mapping[str, str]] = {}

    model: Model
    cards: Mapping[str, int]
    kept: Mapping[str, int]
    unsupported: Mapping[str, str]
    missing: Mapping[str, tuple[str, ...]]
    findings: tuple[Finding, ...]
    rigid: RigidCheck | None
    size: float
    implausible: Mapping[str, tuple[Finding, ...]]

    @property
    def sound(self) -> bool:
        """Whether all is read and there is no error."""
        return not self.unsupported and all(f.severity != "error" for f in self.findings)


def check_deck(deck: str | Path, *, units: str = "") -> DeckCheck:
    """What a deck holds: cards, mass, ground check, free edges, and findings with their places.

    Parameters
    ----------
    deck : str or Path
    units : str
        The unit system that it is said to be in, as in `read_deck`; empty: moduli, densities and
        size are not judged by one.

    Raises
    ------
    DeckError
        On anything malformed.
    InputError
        If the unit system is not known.

    Examples
    --------
    >>> import ringtrue as rt
    >>> found = rt.check_deck(rt.example_deck(), units="SI")
    >>> found.sound, found.rigid.mass.mass
    (True, 3.0)
    """
    found = survey(deck)
    findings = _findings(found, units)
    unsupported = dict(found.unsupported)
    model = readable(found.model) if unsupported else found.model
    there = "GRID" in model and len(model["GRID"]) > 0
    rigid = _rigid_of_readable(model, findings, unsupported) if there else None
    return DeckCheck(
        model=in_units(model, units) if units else model,
        cards=dict(found.cards),
        kept=dict(found.model.kept),
        unsupported=unsupported,
        missing={card: tuple(effects(card)) for card in unsupported},
        findings=tuple(findings),
        rigid=rigid,
        size=float(extent(model)) if there else 0.0,
        implausible={name: tuple(check_units(model, name)) for name in UNIT_SYSTEMS},
    )


def _findings(found: Survey, units: str) -> list[Finding]:
    """What is wrong with the deck, as far as it is read."""
    partial = bool(found.unsupported)
    findings = list(checked(found.model, units, partial=partial).findings)
    extra = {(f.file, f.line) for f in findings}
    lost = []
    for fault in (f for f in found.faults if (str(f.path), f.line) not in extra):
        place = f"{fault.path}:{fault.line}: " if fault.line else f"{fault.path}: "
        text = str(fault).removeprefix(place)
        lost.append(Finding("error", text, str(fault.path), fault.line or 0))
    return lost + findings


def _rigid_of_readable(
    model: Model, findings: list[Finding], unsupported: dict[str, str]
) -> RigidCheck | None:
    """`_rigid` without the cards that assembly refuses, which are added to the unsupported; None
    where it is not possible, with a finding of the reason unless others say what is wrong.
    """
    try:
        return _rigid(model, findings, partial=bool(unsupported))
    except UnsupportedCard as e:
        if e.card not in model:
            findings.append(Finding("error", str(e)))
            return None
        place = f"{e.path}:{e.line}" if e.line else ""
        unsupported[e.card] = ": ".join(t for t in (place, e.why) if t)
        rest = {card: t for card, t in model.tables.items() if card != e.card}
        return _rigid_of_readable(readable(replace(model, tables=rest)), findings, unsupported)
    except RingtrueError as e:  # the rest of the check is worth more than the mass
        if not any(f.severity == "error" for f in findings):
            findings.append(Finding("error", str(e)))
        return None


def _rigid(model: Model, findings: list[Finding], *, partial: bool) -> RigidCheck:
    """Mass properties, ground check, free edges and what AUTOSPC holds; findings of these are added
    to the findings, but of what cards that are not read may hold.
    """
    held = assemble(model)
    system = assemble(unconstrained(model))
    ground = ground_check(system)
    mass = mass_properties(system)
    findings += [] if partial else autospc_findings(held)
    findings += ground_findings(model, ground)
    free = "" if partial else free_edges_in_words(shell_edges(model))
    return RigidCheck(mass, ground, free, held.autospc.by_components())


KINDS: tuple[Kind, ...] = ("material", "property", "spring", "mass")  # those that a deck can hold


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


def region_parameters(model: Model, elements: Collection[int]) -> tuple[RegionParameter, ...]:
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
            raise DataError(f"node {node}: not a node of the model that a sensor may be on")
        at = xyz[row[0]]
        return at if self._fit is None else np.asarray((at - self._fit.shift) @ self._fit.rotation)


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
