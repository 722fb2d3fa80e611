"""The deck of a session as screens show it: its drawing, its checks, its modes."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from nicegui import run

import ringtrue as rt
from ringtrue.api.checking import DeckCheck
from ringtrue.api.models import FeModes, open_model
from ringtrue.core.arrays import Int
from ringtrue.core.modes import ModeSet
from ringtrue.plots.scene import SOFT
from ringtrue.studio.session import StudioSession
from ringtrue.study.config_sections import ModelSection
from ringtrue.study.opened import Opened
from ringtrue.study.results import ModelStage, Scene
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
        region = np.asarray(self.arrays["groups"])[self.numbers("group")[first]].tolist()
        out = []
        for k, (n, size) in enumerate(zip(number.tolist(), count.tolist(), strict=True)):
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
_CHECKS: WeakKeyDictionary[StudioSession, tuple[DrawnDeck, DeckCheck]] = WeakKeyDictionary()
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
    made: DeckCheck | None = await run.io_bound(rt.check_deck, path, units=deck_units(session))
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
    stamps = [(f.stat().st_mtime_ns, f.stat().st_size) if f.exists() else None for f in files]
    return str(settings), *stamps
