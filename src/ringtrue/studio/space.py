"""What the screens in space have in common: the deck in 3D, its modes in motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from nicegui import ui

from ringtrue.core.modes import ModeSet
from ringtrue.studio.decks import DrawnDeck, deck_units
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import frame
from ringtrue.studio.viewer_element import Viewer

BELOW = 272  # pixels of a page that are not the 3D view


def deck_view(
    session: StudioSession, drawn: Mapping[str, Any], pick: Sequence[str], *, below: int = BELOW
) -> Viewer:
    """The deck in 3D, as high as the page less what stands below, in the theme of the page.

    Parameters
    ----------
    session : StudioSession
    drawn : mapping
        The scene of the viewer.
    pick : sequence of str
        Kinds that are found under the pointer; sensors can then be dragged, too.
    below : int
        Pixels.
    """
    with ui.element("div").classes("w-full").style(f"height:calc(100vh - {below}px)"):
        viewer = Viewer(drawn, pick=list(pick), drag="sensor" in pick)
    viewer.show(theme=_theme(session)).mark("view")
    frame().follow(lambda: viewer.show(theme=_theme(session)), session.on_theme)
    return viewer


def _theme(session: StudioSession) -> str:
    return "dark" if session.dark else "light"


def move(viewer: Viewer, modes: ModeSet | None, k: int | None) -> None:
    """Show a mode, from 0, in motion; the deck at rest without one."""
    if modes is None or k is None or not 0 <= k < len(modes):
        viewer.show(mode=None).play(False)
        return
    name = f"FE {k + 1}"
    viewer.shapes(name, modes.shapes[:, k].real.reshape(-1, 3))
    viewer.show(mode=name).play(True)


def no_deck() -> None:
    """What a screen shows where the study has no deck."""
    with ui.column().classes("w-full items-center q-pa-xl gap-2"):
        ui.icon("view_in_ar").classes("text-4xl opacity-40")
        ui.label("The study has no deck: name one under [model] of study.toml.")


def length_unit(session: StudioSession) -> str:
    """In which the deck is."""
    return {"SI": "m", "in-lbf-s": "in", "ft-lbf-s": "ft"}.get(deck_units(session), "mm")


def mass_unit(session: StudioSession) -> str:
    """Of its mass matrix."""
    units = {"SI": "kg", "mm-t-s": "t", "in-lbf-s": "lbf s²/in", "ft-lbf-s": "slug"}
    return units.get(deck_units(session), "kg")


def highlighted(deck: DrawnDeck, elements: Collection[int]) -> dict[str, list[int]]:
    """A selection of the viewer; whole properties by their numbers, which is short."""
    chosen = np.isin(deck.elements, np.array(sorted(elements), dtype=np.int64))
    prop = deck.numbers("property")
    number, at, count = np.unique(prop, return_inverse=True, return_counts=True)
    inside = np.bincount(at, weights=chosen, minlength=number.size)
    whole = number[(inside == count) & (number > 0)]
    rest = deck.elements[chosen & ~np.isin(prop, whole)]
    return {"property": whole.tolist(), "element": rest.tolist()}
