"""Correlation: the modes of a test against those of a model, or of another test or model.

Modes of long records, followed from one part of the records to the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.constants import hour

from ringtrue.api.measurements import TestModes, modes_at
from ringtrue.api.models import FeModes, open_model
from ringtrue.core.arrays import Float, Int
from ringtrue.core.channels import match_channels, split_label
from ringtrue.core.display import Displayed, plot
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.modes import ModeSet, elastic
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.correlation.assignment import Locks
from ringtrue.correlation.measures import CompleteCorrelation, complete
from ringtrue.correlation.orthogonality import OrthogonalityTest
from ringtrue.correlation.pairing import pair_modes
from ringtrue.correlation.sensor_mapping import at_dofs
from ringtrue.correlation.sensor_mounting import (
    AXES,
    Mending,
    Readings,
    find_mendings,
    readings_by_name,
)
from ringtrue.correlation.table import CorrelationTable, correlation_table
from ringtrue.errors import (
    ConfigError,
    DataError,
    UnsupportedError,
    about,
    did_you_mean,
)
from ringtrue.identification.ambient.pipeline import AmbientSettings, identify_ambient
from ringtrue.identification.common.tracking import (
    Stretch,
    Tracked,
    track_modes,
    unseen,
)
from ringtrue.io.recognition import Format, format_of
from ringtrue.io.records import read_record, record_blocks, record_info
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.study.config_sections import CorrelateSection
from ringtrue.study.evidence import NAMES, ChannelMass, channel_mass, gate
from ringtrue.study.opened import Opened, PairedShapes
from ringtrue.study.placing import (
    alignment,
    alignment_text,
    between_nodes,
    mesh_points,
    near_mesh,
    node_points,
    placed,
    readings,
    seat_words,
    seats,
    shared_places,
)
from ringtrue.study.reference import at_common, highest, positions
from ringtrue.study.results import Seat


@dataclass(frozen=True, slots=True, eq=False)
class RecordParts:
    """How long records are cut into parts.

    Attributes
    ----------
    hours : float, h
        Length of a part.
    starts : sequence of float, h
        Start of each record; one follows the other if not given.
    rate : float, Hz, optional
        Sample rate, where a file has none.
    leave_out : sequence of str
        Channels that are not used.
    """

    hours: float = 1.0
    starts: Sequence[float] = ()
    rate: float | None = None
    leave_out: Sequence[str] = ()

    def check(self, records: int) -> None:
        """Refuse a length or starts that do not fit the number of records."""
        if not 0 < self.hours < math.inf:
            raise ConfigError(f"hours {self.hours}: must be positive")
        if not self.starts:
            return
        if len(self.starts) != records or not all(map(math.isfinite, self.starts)):
            raise ConfigError(
                f"starts: {len(self.starts)} hours for {records} records; one for each"
            )


def track_records(
    records: Sequence[Path],
    cut: RecordParts,
    *,
    fmin: float | None = None,
    fmax: float | None = None,
    progress: Progress = quiet,
) -> tuple[Tracked, list[str]]:
    """The modes of records in order of time, followed from part to part, and notes.

    Raises
    ------
    ConfigError
        If the parts are not positive, or a channel is not there.
    DataError
        If no part could be identified.
    """
    cut.check(len(records))
    settings = AmbientSettings(fmin=fmin, fmax=fmax)
    found: list[Stretch] = []
    notes: list[str] = []
    at = 0.0
    for i, path in enumerate(records):
        at = cut.starts[i] if cut.starts else at
        with about(path):
            for part in _parts(path, cut):
                length = part.duration / hour
                middle = at + 0.5 * length
                progress(i / len(records), f"{path.name}, {at:.4g} h")
                at += length
                if length < 0.5 * cut.hours:
                    notes.append(
                        f"{path.name}: the last {60 * length:.3g} min are too short"
                    )
                    continue
                try:
                    modes, why = _identified(part, cut.leave_out, settings, middle)
                except DataError as e:
                    notes.append(f"{middle:.4g} h: left out: {e}")
                    continue
                found.append(modes)
                notes += [f"{middle:.4g} h: {sentence(note)}" for note in why]
    if not found:
        raise DataError(
            "; ".join(["no part of the records could be identified", *notes[:3]])
        )
    tracked = track_modes(found)
    return tracked, [*notes, *_come_and_gone(tracked)]


def _parts(path: Path, cut: RecordParts) -> Iterator[TimeHistory]:
    """A record in parts; one in ringtrue's layout is never in memory as a whole."""
    seconds = cut.hours * hour
    try:
        info = record_info(path) if format_of(path) is Format.HDF5 else None
    except DataError:
        info = None
    if info is not None:
        yield from record_blocks(path, max(2, round(seconds * info.rate)))
        return
    history = read_record(path, cut.rate, check=False, gaps=True)
    size = max(2, round(seconds * history.rate))
    for a in range(0, history.data.shape[1], size):
        part = history.data[:, a : a + size]
        yield TimeHistory(part, history.rate, history.channels, history.source)


def _identified(
    part: TimeHistory,
    leave_out: Sequence[str],
    settings: AmbientSettings,
    middle: float,
) -> tuple[Stretch, tuple[Note, ...]]:
    """The modes of one part, and notes on its channels."""
    ids = [c.id for c in part.channels]
    for name in leave_out:
        if name not in ids:
            raise ConfigError(f"no channel {name!r}{did_you_mean(name, ids)}")
    motion = part.pick([c for c in ids if c not in leave_out])
    if not np.isfinite(motion.data).any():
        raise DataError("all samples are missing")
    result = identify_ambient(motion, settings)
    return Stretch(middle, result.modes, result.uncertainty), result.channel_notes


def _come_and_gone(tracked: Tracked) -> list[str]:
    """Modes that are not seen all the time, and poles that are seen rarely."""
    notes = []
    for t in tracked.tracks:
        before, after = unseen(tracked, t)
        if before:
            first = tracked.times[t.at[0]]
            notes.append(
                f"mode {t.name}: not seen before {first:.4g} h, in {before} parts"
            )
        if after:
            last = tracked.times[t.at[-1]]
            notes.append(
                f"mode {t.name}: not seen after {last:.4g} h, in {after} parts"
            )
    for t in tracked.rare:
        notes.append(
            f"seen in {t.at.size} of {tracked.times.size} parts only: a pole at "
            f"{t.frequency.mean():.5g} Hz, at {tracked.times[t.at[0]]:.4g} h"
        )
    return notes


BY_FREQUENCY = (
    "no shapes: modes are paired by frequency alone; lock or forbid pairs "
    "to decide otherwise"
)


@dataclass(frozen=True, eq=False)
class Correlation(Displayed):
    """Mode pairs of two mode sets, and the evidence for them.

    Attributes
    ----------
    table : CorrelationTable
        With the pairing, the reasons of unpaired modes and the MAC of all combinations.
    complete : CompleteCorrelation, optional
        Orthogonality, CoMAC, complexity, significance.
    notes : tuple of str
    seats : tuple of Seat
        Where each sensor reads the model.
    mendings : tuple of Mending
        Mountings of sensors that would explain the shapes better.
    drawn : PairedShapes, optional
        The shapes and the places of the channels, where a model was given.
    """

    UNITS: ClassVar[Mapping[str, str]] = {
        "test_hz": "Hz",
        "fe_hz": "Hz",
        "deviation_percent": "%",
        "mac_percent": "%",
    }

    table: CorrelationTable
    complete: CompleteCorrelation | None = None
    notes: tuple[str, ...] = ()
    seats: tuple[Seat, ...] = ()
    mendings: tuple[Mending, ...] = ()
    drawn: PairedShapes | None = None

    @property
    def test_mode(self) -> Int:
        """Test modes (pair,), numbers from 1."""
        return self.table.pairing.a + 1

    @property
    def fe_mode(self) -> Int:
        """FE modes (pair,), numbers from 1."""
        return self.table.pairing.b + 1

    @property
    def test_hz(self) -> Float:
        """Natural frequencies (pair,) of the test, Hz."""
        return self.table.test_hz

    @property
    def fe_hz(self) -> Float:
        """Natural frequencies (pair,) of the model, Hz."""
        return self.table.fe_hz

    @property
    def deviation_percent(self) -> Float:
        """100 (f_FE / f_test - 1), (pair,)."""
        return self.table.deviation_percent

    @property
    def mac_percent(self) -> Float:
        """MAC of each pair (pair,), %; NaN where frequencies alone were measured."""
        return self.table.mac_percent

    def displayed(self) -> Mapping[str, Any]:
        """What is shown, by name: the fields, and a row a pair."""
        columns = ("test_mode", "fe_mode", *self.UNITS)
        return {
            **super().displayed(),
            **{name: getattr(self, name) for name in columns},
        }

    def __len__(self) -> int:
        return len(self.table)

    def plot(self, *, shapes: bool = False) -> Any:
        """The MAC matrix, a plotly figure; with `shapes` the pairs in motion, a 3D view: the test
        over the model.

        Raises
        ------
        UnsupportedError
            If `shapes` are asked for and no model, or no shapes, were correlated.
        """
        if not shapes:
            return plot(self.table)
        if self.drawn is None or self.table.frequency_only:
            raise UnsupportedError(
                "plot(shapes=True): the places of the channels are not known; correlate test "
                "shapes with a model, or with modes of rt.solve_modes"
            )
        # plotly loads when something is drawn
        from ringtrue.plots.scene import pair_modes_view

        return pair_modes_view(self.table, self.drawn)


@dataclass(frozen=True, slots=True, eq=False)
class _AtChannels:
    """The modes of a model at the channels of a test, and what the evidence needs of it."""

    modes: ModeSet
    notes: tuple[str, ...] = ()
    mass: Callable[[], ChannelMass] = ChannelMass
    seats: tuple[Seat, ...] = ()
    readings: Readings | None = None
    drawn: Callable[[ModeSet, ModeSet], PairedShapes] | None = None


def correlate(
    test: ModeSet | TestModes | FeModes | Model,
    fe: ModeSet | TestModes | FeModes | Model,
    *,
    sensors: SensorSheet | str | Path | None = None,
    lock: Sequence[str] = (),
    forbid: Sequence[str] = (),
    evidence: bool = False,
    mass: Float | None = None,
    settings: CorrelateSection | None = None,
    names: tuple[str, str] = ("test", "FE"),
    mountings: bool = True,
    progress: Progress = quiet,
) -> Correlation:
    """Pair the modes of a test with those of a model on their common channels.

    Parameters
    ----------
    test : ModeSet, TestModes or Model
        The reference; of a model its lowest elastic modes at its nodes.
    fe : FeModes, Model, ModeSet or TestModes
        What is judged. A `Model` is solved as far up as a partner may be.
    sensors : SensorSheet or path, optional
        Where the channels of the test are; without it they are degrees of freedom such as `101+Z`.
    lock, forbid : sequence of str
        Pairs such as `3:4` that belong together, or do not.
    evidence : bool
        Orthogonality, CoMAC, suspect channels, complexity and significance too.
    mass : (channel, channel) float64, kg, optional
        Mass at the common channels, for the orthogonality.
    settings : CorrelateSettings, optional
        Gates of MAC and frequency, tolerance, matching of sensors and nodes.
    names : (str, str)
        What the two sets are called in reasons.
    mountings : bool
        Try whether sensors that are mounted otherwise explain the test better.

    Raises
    ------
    DataError
        If the sets have no channel in common, or a sensor is too far from the model.

    References
    ----------
    Allemang (2003), The Modal Assurance Criterion; ISO 18431.

    Examples
    --------
    >>> import ringtrue as rt
    >>> model = rt.read_deck(rt.example_deck())
    >>> fe = rt.solve_modes(model, band=(0, 100))
    >>> names = ["2+X", "3+X"]
    >>> test = rt.modes_of_test([2.2, 6.4], fe.at(names).shapes[:, :2], names)
    >>> rt.correlate(test, fe).deviation_percent.round(1)
    array([ 1.8, -1.9])
    """
    asked = settings or CorrelateSection()
    gates = asked.gates()
    sheet = read_sensor_sheet(sensors) if isinstance(sensors, str | Path) else sensors
    first = ""
    points: TestModel | SensorSheet | None = sheet
    both = isinstance(test, Model)
    if isinstance(test, Model):
        reference, points, first = _as_test(test, progress)
    else:
        reference = modes_at(test)
    reference, gaps = at_common(reference)
    if isinstance(fe, FeModes | Model):
        held = _of_model(fe, reference, points, asked, progress)
    else:
        there, missing = at_common(modes_at(fe))
        held = _AtChannels(there, tuple(f"{names[1]}: {g}" for g in missing))
    one, two = _common(reference, held.modes)
    tried = (
        held.readings
        if isinstance(fe, FeModes | Model)
        else readings_by_name(one, held.modes)
    )
    worth_trying = mountings and tried is not None and one.channels and not both
    mendings = find_mendings(tried, gates) if tried is not None and worth_trying else ()
    notes = (*(f"{names[0]}: {g}" for g in gaps), *held.notes)
    if not one.channels:
        if evidence or mass is not None:
            raise ConfigError(
                f"orthogonality and CoMAC compare shapes; {reference.source or names[0]} has none"
            )
        notes = (*notes, BY_FREQUENCY)
    locks = Locks(positions(lock), positions(forbid))
    pairing = pair_modes(one, two, gates, names=names, locks=locks)
    table = correlation_table(one, two, pairing, names=names)
    notes = (
        *filter(None, [first]),
        *notes,
        *pairing.doubts(names),
        *pairing.far(names),
    )
    full: CompleteCorrelation | None = None
    if evidence or mass is not None:
        if mass is not None and mass.shape != (len(one.channels),) * 2:
            raise DataError(
                f"mass {mass.shape}; there are {len(one.channels)} common channels, in the order "
                "of A"
            )
        weight = held.mass() if mass is None else ChannelMass(mass)
        name = NAMES.get(asked.tam, asked.tam) if mass is None else "given"
        full = complete(
            one,
            two,
            table.pairing,
            orthogonality=OrthogonalityTest(
                gate(asked), weight.matrix, name, weight.lift
            ),
            std=(_std(test), _std(fe)),
            settings=gates,
        )
        notes = (*notes, *filter(None, [weight.why]))
    drawn = held.drawn(one, two) if held.drawn is not None and one.channels else None
    return Correlation(
        table, full, notes, seats=held.seats, mendings=tuple(mendings), drawn=drawn
    )


def _std(modes: object) -> Float | float:
    """Standard deviations of frequencies, Hz."""
    return modes.uncertainty.frequency if isinstance(modes, TestModes) else 0.0


def _as_test(model: Model, progress: Progress) -> tuple[ModeSet, TestModel, str]:
    """The lowest elastic modes of a model at its nodes, as of a test, and how they are numbered."""
    name = model.files[0] if model.files else "the model"
    progress(0.0, name)
    opened = open_model(model)
    # modes of a model in the place of a test
    found = opened.analysis.modes(ModesRequest(26)).modes
    at = np.flatnonzero(elastic(found.frequencies))
    if not at.size:
        raise DataError(f"{name}: none of its {len(found)} lowest modes is elastic")
    modes = found.take(at)
    points = mesh_points(opened)
    shapes = at_dofs(points.channels, opened.analysis.dofs, opened.length)(modes.shapes)
    there = replace(modes, shapes=shapes, labels=points.channels, source=name)
    return there, points, f"mode 1 of A is mode {at[0] + 1} of {name}" if at[0] else ""


def _common(one: ModeSet, two: ModeSet) -> tuple[ModeSet, ModeSet]:
    """Both sets on the channels that they share; on none where one has frequencies alone."""
    index, sign = match_channels(one.channels, two.channels)
    at = np.flatnonzero(index >= 0)
    if not at.size and one.channels and two.channels:
        raise DataError(
            f"{one.source or 'the test'} and {two.source or 'the model'} have no channel in "
            f"common: {one.channels[:5]} against {two.channels[:5]}"
        )
    common = tuple(one.channels[k] for k in at.tolist())
    shapes = two.shapes[index[at]] * sign[at, None]
    return one.rows(common), replace(two, shapes=shapes, labels=common)


def _of_model(
    fe: FeModes | Model,
    test: ModeSet,
    sensors: SensorSheet | TestModel | None,
    asked: CorrelateSection,
    progress: Progress,
) -> _AtChannels:
    """The modes of a model at the channels of a test, as far up as a partner may be."""
    opened = fe.opened if isinstance(fe, FeModes) else open_model(fe)
    name = opened.model.files[0] if opened.model.files else "the model"
    reach = highest(test.frequencies, asked.gates())
    notes: list[str] = []
    here = sensors if isinstance(sensors, TestModel) else None
    channels = test.channels
    if isinstance(sensors, SensorSheet):
        here = sensors.model
        of_sheet = dict(zip(channels, here.named(channels)[0], strict=True))
        lost = [c for c in channels if of_sheet[c] in sensors.strain]
        if lost:
            channels = tuple(c for c in channels if c not in lost)
            notes.append(
                f"not compared, of strain: {' '.join(lost[:8])}{' ...' * (len(lost) > 8)}"
            )
    if isinstance(sensors, TestModel):
        here, near = near_mesh(sensors, opened, asked.tolerance)
        channels = here.channels
        count = np.unique(here.at).size
        notes.append(
            f"{count} of {sensors.points.size} nodes of A are within {near:.3g} m of one of B"
        )
    match = "rigid" if isinstance(sensors, TestModel) else asked.match
    given = here
    found = (
        alignment(here, opened, asked.align)
        if here is not None and asked.align
        else None
    )
    if here is not None and found is not None:
        here = found.move(here)
        notes.append(alignment_text(found))

    def bridge(there: TestModel) -> Observation:
        on_model = found.move(there) if found is not None else there
        return placed(
            opened, there.channels, on_model, tolerance=asked.tolerance, method=match
        )

    look = placed(opened, channels, here, tolerance=asked.tolerance, method=match)
    if isinstance(fe, FeModes):
        modes = fe.modes
    else:
        modes = opened.modes(reach, part(progress, 0.3, 1.0)).modes
    there = replace(modes, shapes=look(modes.shapes), labels=look.channels, source=name)
    places: tuple[Seat, ...] = ()
    if isinstance(sensors, SensorSheet) and here is not None:
        if match == "nearest":
            notes += shared_places(opened, here.pick(channels), modes)
        notes += between_nodes(opened, look, match)
        places = seats(look, here)
        notes += seat_words(places)
    at_sensors = test.rows(channels)
    at = here if here is not None else node_points(opened, channels)
    if given is None:
        tried = readings_by_name(at_sensors, _along_all_axes(opened, modes, channels))
    else:
        tried = readings(at_sensors, modes, given, bridge)
    return _AtChannels(
        there,
        tuple(notes),
        lambda: channel_mass(opened, look, channels, asked, reach),
        seats=places,
        readings=tried,
        drawn=lambda one, two: PairedShapes(one, two, at, opened, modes),
    )


def _along_all_axes(opened: Opened, modes: ModeSet, channels: Sequence[str]) -> ModeSet:
    """The modes at channels that are degrees of freedom, and along the other axes of their
    nodes.
    """
    labels = [split_label(c) for c in channels]
    more = [f"{label[0]}+{axis}" for label in labels if label for axis in AXES]
    names = tuple(dict.fromkeys((*channels, *more)))
    shapes = at_dofs(names, opened.analysis.dofs, opened.length)(modes.shapes)
    return replace(modes, shapes=shapes, labels=names)
