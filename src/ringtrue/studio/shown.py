"""What the screens show of a session: its deck, its open records, and what was identified."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from nicegui import run, ui

import ringtrue as rt
from ringtrue.api.checking import DeckCheck
from ringtrue.api.models import FeModes, open_model
from ringtrue.core.arrays import Int
from ringtrue.core.choice import Choice, Hit
from ringtrue.core.display import plus_minus
from ringtrue.core.modes import ModeSet
from ringtrue.core.notes import Note
from ringtrue.errors import DataError
from ringtrue.io.choices import parse_choice
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.plots.scene import SOFT
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import fact, heading
from ringtrue.study.config_sections import ModelSection
from ringtrue.study.log import Logged, read_log
from ringtrue.study.opened import Opened
from ringtrue.study.record_views import RecordView, open_view
from ringtrue.study.results import (
    IdentifiedModes,
    IdentifiedRecord,
    IdentifyStage,
    ImpactReport,
    ModelStage,
    RecordSummary,
    Scene,
)
from ringtrue.study.scene import make_scene, scene_modes
from ringtrue.viewer.scene import model_arrays


@dataclass(frozen=True, eq=False)
class DrawnDeck:
    """A deck and its drawing.

    Attributes
    ----------
    opened : Opened
    scene : Scene
    arrays : dict
        Of the viewer.
    """

    opened: Opened
    scene: Scene
    arrays: dict[str, Any]

    @cached_property
    def elements(self) -> Int:
        """Numbers of the elements that are drawn, ascending."""
        return np.asarray(self.arrays["element_id"], dtype=np.int64)

    @cached_property
    def _of_cards(self) -> dict[tuple[str, ...], set[int]]:
        """Elements that each card changes, by its name and number."""
        found: dict[tuple[str, ...], set[int]] = {}
        every = frozenset(self.elements.tolist())
        for p in rt.region_parameters(self.opened.model, every):
            for card in set(map(_card, p.targets)):
                found.setdefault(card, set()).update(p.elements)
        return found

    def changed(self, targets: Collection[str]) -> set[int]:
        """Elements that some cards change, which are named as the targets of a candidate."""
        return set().union(*(self._of_cards.get(_card(t), ()) for t in targets))

    def numbers(self, coloring: str) -> Int:
        """The property, material or group of each of `elements`."""
        return np.asarray(self.arrays[coloring], dtype=np.int64)

    def legend(self, coloring: str) -> list[tuple[int, str, str, int]]:
        """Number, name, colour and count of elements of each property, material or group."""
        number, first, count = np.unique(
            self.numbers(coloring), return_index=True, return_counts=True
        )
        region = np.asarray(self.arrays["groups"])[
            self.numbers("group")[first]
        ].tolist()
        out = []
        for k, (n, size) in enumerate(
            zip(number.tolist(), count.tolist(), strict=True)
        ):
            name = f"{coloring} {n}" if n else f"no {coloring}"
            if coloring == "group":
                name = region[k]
            elif coloring == "property" and region[k] != name:
                name = f"{n}: {region[k]}"
            out.append((n, name, SOFT[k % len(SOFT)], size))
        return out


def _card(target: str) -> tuple[str, ...]:
    """Card and number of a target such as `MAT1 7 E`."""
    return tuple(target.split()[:2])


_DRAWN: WeakKeyDictionary[StudioSession, tuple[Any, DrawnDeck]] = WeakKeyDictionary()
_CHECKS: WeakKeyDictionary[StudioSession, tuple[DrawnDeck, DeckCheck]] = (
    WeakKeyDictionary()
)
_MODES: WeakKeyDictionary[StudioSession, tuple[Opened, ModeSet]] = WeakKeyDictionary()
_READING: WeakKeyDictionary[StudioSession, asyncio.Lock] = WeakKeyDictionary()


def deck_units(session: StudioSession) -> str:
    """As study.toml has them."""
    model = session.config.model if session.config is not None else None
    return "SI" if model is None else model.units


async def drawn_deck(session: StudioSession) -> DrawnDeck | None:
    """The deck, read and drawn once as long as it does not change; None where there is none."""
    async with _READING.setdefault(session, asyncio.Lock()):
        return await _drawn_deck(session)


def known_deck(session: StudioSession) -> DrawnDeck | None:
    """The deck where it was drawn already; None where it was not, or has changed since."""
    model = session.config.model if session.config is not None else None
    known = _DRAWN.get(session)
    if model is None or known is None or known[0] != _state(model, known[1].opened):
        return None
    return known[1]


async def _drawn_deck(session: StudioSession) -> DrawnDeck | None:
    model = session.config.model if session.config is not None else None
    known = known_deck(session)
    if model is None or known is not None:
        return known
    if model.refine and session.deck is None:
        await session.refresh()  # it alone refines
    path = session.documents.folder / model.deck
    made: DrawnDeck | None = await run.io_bound(_drawn, path, model, session.deck)
    if made is not None:
        _DRAWN[session] = _state(model, made.opened), made
    return made


def _drawn(path: Path, settings: ModelSection, opened: Opened | None) -> DrawnDeck:
    if opened is None:
        opened = open_model(rt.read_deck(path, units=settings.units))
    scene = make_scene(opened.model, settings.regions, opened.length)
    return DrawnDeck(opened, scene, model_arrays(scene, opened.model))


async def deck_check(session: StudioSession, deck: DrawnDeck) -> DeckCheck | None:
    """What is wrong with the deck, found once; None while the program ends."""
    known = _CHECKS.get(session)
    if known is not None and known[0] is deck:
        return known[1]
    assert session.config is not None
    assert session.config.model is not None
    path = session.documents.folder / session.config.model.deck
    made: DeckCheck | None = await run.io_bound(
        rt.check_deck, path, units=deck_units(session)
    )
    if made is not None:
        _CHECKS[session] = deck, made
    return made


def stored_modes(session: StudioSession, deck: DrawnDeck) -> ModeSet | None:
    """Modes at the nodes of the drawing: those of the study, or those solved on demand."""
    stage: ModelStage | None = session.stage("model")
    if stage is not None and session.standing("model") == "done":
        same = np.array_equal(stage.scene.node, deck.scene.node)
        return stage.modes if same else scene_modes(stage.modes, deck.scene)
    known = _MODES.get(session)
    return known[1] if known is not None and known[0] is deck.opened else None


async def solve_deck(session: StudioSession, deck: DrawnDeck, count: int) -> None:
    """Solve the lowest modes of the deck, for drawing."""
    found: FeModes | None
    found = await run.io_bound(rt.solve_modes, deck.opened.model, count=count)
    if found is not None:
        _MODES[session] = deck.opened, scene_modes(found.modes, deck.scene)


def _state(settings: ModelSection, opened: Opened) -> tuple[Any, ...]:
    """What a drawing follows from: the settings of the deck, and its files as they stand."""
    files = [Path(f) for f in opened.model.files]
    stamps = [
        (f.stat().st_mtime_ns, f.stat().st_size) if f.exists() else None for f in files
    ]
    return str(settings), *stamps


@dataclass(eq=False)
class Records:
    """The records of a session.

    Attributes
    ----------
    session : StudioSession
    """

    session: StudioSession
    _views: dict[str, tuple[float, RecordView]] = field(default_factory=dict)
    _checked: dict[str, tuple[Note, ...]] = field(default_factory=dict)

    @property
    def logged(self) -> dict[str, Logged]:
        """The records of the log, by name.

        Raises
        ------
        DataError
            If the log cannot be read.
        """
        config = self.session.config
        test = config.test if config is not None else None
        if test is None or not test.log:
            return {}
        records, _ = read_log(self.session.path.parent / test.log)
        return {r.name: r for r in records}

    @property
    def names(self) -> list[str]:
        """Of all records."""
        source = self.session.source
        try:
            found = list(self.logged)
        except DataError:
            found = []
        return found or ([source.stem] if source is not None else [])

    @property
    def sheet(self) -> SensorSheet | None:
        """The sensor sheet; None where there is none."""
        name = self.session.sheet_name
        return read_sensor_sheet(self.session.path.parent / name) if name else None

    @property
    def unused(self) -> tuple[str, ...]:
        """Channels that the study leaves out."""
        config = self.session.config
        return (
            tuple(config.test.leave_out) if config is not None and config.test else ()
        )

    async def view(self, name: str) -> RecordView | None:
        """A record, opened once as long as its file stays; None while the program ends."""
        return await run.io_bound(self._open, name)

    def _open(self, name: str) -> RecordView:
        logged = self.logged.get(name)
        path = logged.path if logged is not None else Path(str(self.session.source))
        stamp = path.stat().st_mtime if path.exists() else 0.0
        known = self._views.get(name)
        if known is None or known[0] != stamp:
            sheet = self.sheet if logged is not None else None
            self._views[name] = known = (stamp, open_view(logged or path, sheet))
            self._checked.pop(name, None)
        return known[1]

    def summary(self, name: str) -> RecordSummary | None:
        """What is stored of a record; of files that are one record, of the first."""
        stage: IdentifyStage | None = self.session.stage("identify")
        logged = self.logged.get(name)
        if stage is None or logged is None:
            return None
        return next((r for r in stage.records if r.name == name), None)

    def identified(self, name: str) -> IdentifiedRecord | None:
        """The modes that are stored of an ambient record."""
        stage: IdentifyStage | None = self.session.stage("identify")
        found = () if stage is None else stage.ambient_records
        return next((r for r in found if r.record == name), None)

    async def notes(self, name: str, view: RecordView) -> tuple[Note, ...]:
        """What is wrong with channels: stored, or else found now where the record is not long."""
        stored = self.summary(name)
        if stored is not None and stored.channel_notes:
            return stored.channel_notes
        if name not in self._checked:
            self._checked[name] = await run.io_bound(lambda: view.checked() or ()) or ()
        return self._checked[name]

    def hits(self, name: str) -> list[ImpactReport]:
        """The hits that are stored of a record."""
        stage: IdentifyStage | None = self.session.stage("identify")
        every = () if stage is None else stage.hits
        return [h for h in every if h.source.partition(" #")[0] == name]

    @property
    def decisions(self) -> tuple[Hit, ...]:
        """The hits of the user's own choice, in the order of its text."""
        name = self.session.choice_name
        text = self.session.documents.text(name)
        return (parse_choice(text, name) if text else Choice()).hits


_OF: WeakKeyDictionary[StudioSession, Records] = WeakKeyDictionary()


def records_of(session: StudioSession) -> Records:
    """The records of a session, one for all its tabs."""
    if session not in _OF:
        _OF[session] = Records(session)
    return _OF[session]


HAMMER = "hammer"  # as a choice names the modes of FRFs


@dataclass(frozen=True, slots=True)
class Pole:
    """A pole of a diagram.

    Attributes
    ----------
    frequency : float, Hz
    order : int
    damping, std_frequency, std_damping : float
    """

    frequency: float
    order: int
    damping: float
    std_frequency: float
    std_damping: float


def sources(stage: IdentifyStage | None) -> dict[str, IdentifiedModes]:
    """Whose diagrams there are, by the names that a choice has for them."""
    if stage is None:
        return {}
    found: dict[str, IdentifiedModes] = {}
    if stage.hammer is not None and stage.hammer.diagrams:
        found[HAMMER] = stage.hammer
    found |= {r.record: r for r in stage.ambient_records if r.diagrams}
    return found


def nearest_pole(found: IdentifiedModes, frequency: float, order: int) -> Pole | None:
    """The pole of an order that is nearest to a frequency, Hz, to all its digits."""
    best: Pole | None = None
    for diagram in found.diagrams:
        poles = diagram.poles
        for k in np.flatnonzero(poles.order == order).tolist():
            f = float(poles.frequencies[k])
            if best is None or abs(f - frequency) < abs(best.frequency - frequency):
                best = Pole(
                    f,
                    order,
                    float(poles.damping[k]),
                    float(poles.std_frequency[k]),
                    float(poles.std_damping[k]),
                )
    return best


def pole_shape(found: IdentifiedModes, pole: Pole) -> ModeSet | None:
    """The shape of a pole; None where the poles hold something else, as those of FRFs do."""
    channels = found.diagram.modes.channels
    for diagram in found.diagrams:
        poles = diagram.poles
        at = np.flatnonzero(
            (poles.order == pole.order) & (poles.frequencies == pole.frequency)
        )
        if at.size and poles.shape.shape[0] == len(channels):
            shape = poles.shape[:, at[:1]]
            return ModeSet(
                poles.frequencies[at[:1]], poles.damping[at[:1]], shape, channels
            )
    return None


def evidence(found: IdentifiedModes, k: int) -> None:
    """The evidence of mode `k` of a diagram, from 0."""
    shown = found.diagram
    std = shown.uncertainty
    heading(f"{shown.classes[k]} mode")
    fact(
        "Frequency",
        f"{plus_minus(float(shown.modes.frequencies[k]), float(std.frequency[k]), 6)} Hz",
    )
    damping = plus_minus(
        100 * float(shown.modes.damping[k]), 100 * float(std.damping[k]), 3
    )
    fact("Damping ratio", f"{damping} %")
    fact("MPC", f"{shown.mpc[k]:.3f}")
    fact("Confidence", f"{shown.modes.confidence[k]:.2f}")
    if shown.remarks[k]:
        ui.label(shown.remarks[k]).classes("text-sm")
    number = shown.classes[:k].count("natural")
    if shown.classes[k] == "natural" and number < len(found.reasons):
        words = found.reasons[number]
    else:
        others = [j for j, kind in enumerate(shown.classes) if kind != "natural"]
        words = found.others.sentences()[others.index(k)] if k in others else ""
    if words:
        heading("Evidence")
        ui.label(words).classes("text-xs")
