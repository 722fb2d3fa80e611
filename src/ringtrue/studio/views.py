"""The 3D views of a page: `deck_view` shows the deck, `ShapeView` mode shapes, which are the test's
points over the model's skin, in motion.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import ui

from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.plots.scene import Shown, at_nodes, at_test_points, difference_at_points
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import frame
from ringtrue.studio.shown import DrawnDeck, deck_units
from ringtrue.studio.viewer_element import Viewer
from ringtrue.study.results import (
    CorrelateStage,
    FinalStage,
    IdentifyStage,
    ModelStage,
    Scene,
)
from ringtrue.viewer.scene import model_arrays, test_arrays

if TYPE_CHECKING:
    from ringtrue.correlation.paired_shapes import ShapeDifference

BELOW = 272  # pixels of a page that are not the 3D view


def deck_view(
    session: StudioSession,
    drawn: Mapping[str, Any],
    pick: Sequence[str],
    *,
    below: int = BELOW,
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
    return {"SI": "m", "in-lbf-s": "in", "ft-lbf-s": "ft"}.get(
        deck_units(session), "mm"
    )


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


SHAPE = "shown"  # the one shape that a view keeps


class ShapeView:
    """A view of one shape at a time; its geometry is sent once.

    Parameters
    ----------
    session : StudioSession
    parts : {"both", "model", "test"}
        What is drawn.
    linked : str
        Views of a page with the same name move and turn together.
    """

    def __init__(
        self, session: StudioSession, parts: str = "both", linked: str = ""
    ) -> None:
        self.session = session
        model: ModelStage | None = session.stage("model")
        found: IdentifyStage | None = session.stage("identify")
        self.scene: Scene | None = None
        self.test: TestModel | None = None
        drawn: dict[str, Any] = {}
        if model is not None and parts != "test":
            self.scene = model.scene
            drawn["model"] = model_arrays(model.scene)
        if found is not None and parts != "model":
            self.test = found.test
            drawn["test"] = test_arrays(found.test)
        with ui.element("div").classes("w-full h-full"):
            self.viewer = Viewer(drawn, linked=linked, theme=_theme(session))
        self._playing = True
        self.viewer.play()
        frame().follow(
            lambda: self.viewer.show(theme=_theme(session)), session.on_theme
        )

    def toggle(self) -> None:
        """Begin or end the motion."""
        self._playing = not self._playing
        self.viewer.play(self._playing)

    def mode(self, modes: ModeSet, k: int) -> None:
        """Show a mode at the channels of the test, from 0."""
        self._show(Shown("", "", "", test=(modes, k)))

    def pair(self, state: str, pair: tuple[int, int]) -> None:
        """Show a test mode and an FE mode of a correlation, from 0."""
        stage: CorrelateStage | None = self.session.stage("correlate")
        if stage is None:
            return
        seen, skin = fe_modes(self.session, stage, state)
        test = stage.reference.elastic
        t, k = pair
        if t >= len(test) or k >= len(seen):
            return
        fe = (skin, k) if skin is not None and k < len(skin) else None
        self._show(Shown(state, "", "", fe=fe, test=(test, t), seen=(seen, k)))

    def difference(self, state: str, pair: tuple[int, int]) -> ShapeDifference | None:
        """Show the points of the test moved by what a test mode and an FE mode differ in, over the
        model at rest.
        """
        stage: CorrelateStage | None = self.session.stage("correlate")
        if stage is None or self.test is None:
            return None
        seen, _ = fe_modes(self.session, stage, state)
        test = stage.reference.elastic
        t, k = pair
        if t >= len(test) or k >= len(seen):
            return None
        found, points = difference_at_points(self.test, (test, t), (seen, k))
        self.viewer.shapes(SHAPE, points.real, points.imag, on="test")
        self.viewer.show(color="group", mode=None, test=SHAPE)
        return found

    def tried(
        self, skin: ModeSet, seen: tuple[ModeSet, int], test: tuple[ModeSet, int]
    ) -> None:
        """Show a mode that is tried, `skin` on the drawing and `seen` at the channels, in the phase
        of a test mode: it keeps its sign while a factor moves.
        """
        modes, k = seen
        here = {c: i for i, c in enumerate(modes.channels)}
        other, t = test
        both = [(here[c], i) for i, c in enumerate(other.channels) if c in here]
        rows = np.array(both, dtype=np.int64).reshape(-1, 2)
        overlap = np.vdot(other.shapes[rows[:, 1], t].real, modes.shapes[rows[:, 0], k])
        turn = -1.0 if overlap < 0 else 1.0
        fe = replace(skin, shapes=turn * skin.shapes)
        at = replace(modes, shapes=turn * modes.shapes)
        self._show(Shown("", "", "", fe=(fe, 0), test=test, seen=(at, k)))

    def _show(self, shown: Shown) -> None:
        state: dict[str, Any] = {"mode": None}
        if self.scene is not None and shown.fe is not None:
            self.viewer.shapes(SHAPE, at_nodes(self.scene, *shown.fe))
            state["mode"] = SHAPE
        if self.test is not None and shown.test is not None:
            points = at_test_points(self.test, shown)
            self.viewer.shapes(SHAPE, np.real(points), np.imag(points), on="test")
            state["test"] = SHAPE
        self.viewer.show(color="displacement" if state["mode"] else "group", **state)


def fe_modes(
    session: StudioSession, stage: CorrelateStage, state: str
) -> tuple[ModeSet, ModeSet | None]:
    """The FE modes of a correlation at the channels, and on the drawing of the model where they are
    stored.
    """
    final: FinalStage | None = session.stage("final")
    model: ModelStage | None = session.stage("model")
    if state == "final" and final is not None:
        return final.observed, final.modes
    if state == "remodelled":
        return stage.fe_remodelled, None
    return stage.fe_initial, model.modes if model is not None else None
