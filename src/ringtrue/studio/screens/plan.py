"""Plan: measuring points on the deck, and what they see of the target modes, at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from nicegui import run, ui
from nicegui.events import GenericEventArguments

import ringtrue as rt
from ringtrue.api.studies import ALONE
from ringtrue.api.trial import PlanTrial, TrialPlan
from ringtrue.core.display import number
from ringtrue.errors import ConfigError
from ringtrue.plots.scene import SENSORS
from ringtrue.studio import edits
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    SELECT,
    fact,
    frame,
    heading,
    inspector,
    nothing_yet,
    run_button,
    table,
)
from ringtrue.studio.shown import DrawnDeck, drawn_deck, stored_modes
from ringtrue.studio.viewer_element import Viewer
from ringtrue.studio.views import deck_view, move, no_deck
from ringtrue.study.config_sections import PlanSection
from ringtrue.study.results import ModelStage, PlanStage
from ringtrue.viewer.scene import sensor_arrays

STRUCK, MEASURED = "excitation point", "measuring point"
TRIALS = 20  # virtual tests on demand
MARGIN = 1e-3  # m: of a box around the nodes that it is to hold


@dataclass(frozen=True, slots=True)
class PlannedPoints:
    """Points as they stand: those of the stored plan, with what was added and taken out since.

    Attributes
    ----------
    points : tuple of int or str
        As `TrialPlan.at` takes them.
    nodes : tuple of int
    trial : PlanTrial, optional
        None where there is no point.
    """

    points: tuple[int | str, ...]
    nodes: tuple[int, ...]
    trial: PlanTrial | None


_TRIALS: WeakKeyDictionary[StudioSession, tuple[ModelStage, TrialPlan]] = (
    WeakKeyDictionary()
)


def trial_of(session: StudioSession) -> TrialPlan:
    """The candidates under [plan] as it is now; what is known of the deck is read once.

    Raises
    ------
    ConfigError
        If no candidate is left.
    """
    assert session.config is not None
    assert session.config.plan is not None
    stage: ModelStage = session.stage("model")
    known = _TRIALS.get(session)
    if known is None or known[0] is not stage:
        known = _TRIALS[session] = stage, rt.trial_plan(session.path)
    return known[1].under(session.config.plan)


def planned(
    plan: PlanSection, stored: PlanStage | None, candidates: TrialPlan
) -> PlannedPoints:
    """The points as they stand."""
    allowed = set(candidates.nodes.tolist())
    points: list[int | str] = []
    nodes: list[int] = []
    single = plan.directions == "uniaxial"
    if stored is not None:
        test = stored.sensors.test
        for channel, node in zip(test.channels, test.at.tolist(), strict=True):
            if node in allowed and (single or node not in nodes):
                points.append(channel if single else node)
                nodes.append(node)
    points += [n for n in plan.fixed if n in allowed and n not in nodes]
    nodes += [n for n in plan.fixed if n in allowed and n not in nodes]
    try:
        trial = candidates.at(points) if points else None
    except ConfigError:  # the stored plan is of other directions
        points = list(dict.fromkeys(nodes))
        trial = candidates.at(points)
    return PlannedPoints(tuple(points), tuple(dict.fromkeys(nodes)), trial)


def build(session: StudioSession) -> None:
    """Fill the page."""
    config = session.config
    if config is None or config.model is None:
        frame().follow(frame().rebuild, session.on_documents)
        no_deck()
        return
    if session.stage("model") is None:
        nothing_yet(session, "No modes of the deck are stored.", "model")
        return
    if config.plan is None:
        frame().follow(frame().rebuild, session.on_documents)
        _begin(session)
        return
    _PlanScreen(session).build()


def _begin(session: StudioSession) -> None:
    """Ask for the band and the number of points of a new plan."""
    stage: ModelStage = session.stage("model")
    f = stage.modes.frequencies
    elastic = f[f > 0]
    low = 0.5 * float(elastic[0]) if elastic.size else 0.0
    high = 1.001 * float(elastic[min(9, elastic.size - 1)]) if elastic.size else 100.0
    with ui.column().classes("w-full items-center q-pa-xl gap-3"):
        ui.icon("edit_location_alt").classes("text-4xl opacity-40")
        ui.label("The study has no plan of a test yet.")
        with ui.row().classes("items-center gap-3"):
            fmin = ui.number("from, Hz", value=float(f"{low:.4g}"), min=0).props(
                "dense outlined"
            )
            fmax = ui.number("to, Hz", value=float(f"{high:.4g}"), min=0).props(
                "dense outlined"
            )
            points = ui.number("points", value=ALONE["sensors"], min=1, precision=0)
            points.props("dense outlined").mark("points")

        def write() -> None:
            section = ALONE | {"sensors": int(points.value or 1)}
            section |= {
                "fmin": float(fmin.value or 0.0),
                "fmax": float(fmax.value or 0.0),
            }
            session.edit("a plan begun", edits.put(("plan",), section))

        ui.button("Begin a plan", icon="add", on_click=write).props(
            "no-caps unelevated"
        ).mark("begin-plan")


class _PlanScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.deck: DrawnDeck | None = None
        self.viewer: Viewer | None = None
        self.candidates: TrialPlan | None = None
        self.now: PlannedPoints | None = None
        self.problem = ""
        self.node: int | None = None
        self.boxed_nodes: list[int] = []
        self.mode: int | None = None

    @property
    def plan(self) -> PlanSection:
        """The settings."""
        assert self.session.config is not None
        assert self.session.config.plan is not None
        return self.session.config.plan

    @property
    def stored(self) -> PlanStage | None:
        """The plan that was made."""
        found: PlanStage | None = self.session.stage("plan")
        return found

    def build(self) -> None:
        session = self.session
        self.holder = ui.column().classes("w-full gap-1 p-2")
        ui.timer(0.0, self.load, once=True)
        frame().follow(self._changed, session.on_documents, session.on_results)
        keys = frame().keys
        keys["next"] = partial(self.step, 1)
        keys["previous"] = partial(self.step, -1)
        keys["accept"] = self.add
        keys["reject"] = self.remove
        keys["play"] = self.play

    async def load(self) -> None:
        """Read what points are chosen from, and draw the deck."""
        self.deck = await drawn_deck(self.session)
        await run.io_bound(self._try)
        if self.holder.is_deleted or self.deck is None:
            return
        with self.holder:
            self.bar()
            drawn = {"model": self.deck.arrays}
            self.viewer = deck_view(self.session, drawn, ["node", "sensor"], below=378)
            self.viewer.show(color="plain").on_event("pick", self.picked)
            self.viewer.on_event("box", self.boxed)
            with ui.scroll_area().style("height:264px").classes("w-full"):
                self.modes()
        self._drawn()
        self.inspected()

    def _try(self) -> None:
        """What the points as they stand see."""
        self.problem = ""
        try:
            self.candidates = trial_of(self.session)
            self.now = planned(self.plan, self.stored, self.candidates)
        except ConfigError as e:
            self.problem = str(e)

    async def _changed(self) -> None:
        if self.session.config is None or self.session.config.plan is None:
            frame().rebuild()
            return
        await run.io_bound(self._try)
        if self.holder.is_deleted or self.viewer is None:
            return
        self.bar.refresh()
        self.modes.refresh()
        self._drawn()
        self.inspected()

    def _drawn(self) -> None:
        """The points, the node and the mode that are shown."""
        if self.viewer is None:
            return
        trial = self.now.trial if self.now is not None else None
        if trial is not None:
            struck = dict.fromkeys(trial.references, STRUCK)
            self.viewer.sensors(sensor_arrays(trial.test, struck, SENSORS, MEASURED))
        self.viewer.show(sensor=trial is not None)
        nodes = [self.node] if self.node is not None else []
        labels = {"node": nodes} if nodes else None
        nodes += self.boxed_nodes
        self.viewer.show(select={"node": nodes} if nodes else None, labels=labels)

    # --- bar and table

    @ui.refreshable_method
    def bar(self) -> None:
        """The figures of the points as they stand."""
        trial = self.now.trial if self.now is not None else None
        with ui.row().classes("w-full items-center no-wrap gap-4"):
            if trial is not None and self.now is not None:
                _figure("points", str(len(self.now.nodes)))
                a, b = trial.worst_pair
                worst = f"{100 * trial.worst_auto_mac:.0f} %, modes {a} and {b}"
                good = trial.worst_auto_mac <= self.plan.max_auto_mac
                _figure("worst auto-MAC", worst, good)
                k = int(np.argmin(trial.reach))
                reach = f"mode {trial.worst_excited}, {100 * trial.reach[k]:.0f} %"
                _figure("excited worst", reach, not trial.missed.any())
                _figure("left if one fails", f"{100 * trial.left_by_loss:.2g} %")
            ui.space()
            run_button(self.session, "plan", "Choose points")
        if self.problem:
            ui.label(self.problem).classes("text-sm text-negative").mark("plan-problem")
        for note in self.stored.notes if self.stored is not None else ():
            ui.label(note).classes("text-xs opacity-70 ellipsis w-full").tooltip(note)

    @ui.refreshable_method
    def modes(self) -> None:
        """The target modes, as the points see them; a click moves the deck."""
        trial = self.now.trial if self.now is not None else None
        if trial is None:
            ui.label("No points yet: choose some, or click nodes.").classes(
                "text-sm opacity-70"
            )
            return
        others = np.array(trial.auto_mac)
        np.fill_diagonal(others, -1.0)
        virtual = self.stored.virtual_test if self.stored is not None else None
        found = {}
        if virtual is not None and self.stored is not None:
            targets = self.stored.target_modes + 1
            found = dict(zip(targets.tolist(), virtual.found.tolist(), strict=True))
        rows: list[dict[str, object]] = []
        for k, mode in enumerate(trial.modes.tolist()):
            row: dict[str, object] = {"id": mode, "mode": mode}
            row["f"] = f"{trial.frequencies[k]:.5g}"
            if len(trial.modes) > 1:
                near = int(np.argmax(others[k]))
                row["mac"] = (
                    f"{100 * others[k, near]:.0f} %, mode {int(trial.modes[near])}"
                )
            row["reach"] = f"{100 * trial.reach[k]:.0f}"
            row["found"] = f"{100 * found[mode]:.0f}" if mode in found else ""
            rows.append(row)
        names = {"mode": "mode", "f": "f, Hz", "mac": "largest auto-MAC"}
        names["reach"] = "best driving point, %"
        if virtual is not None:
            names["found"] = f"found in {virtual.trials} virtual tests, %"
        table(names, rows).on("rowClick", self._row).mark("modes")

    def _row(self, event: GenericEventArguments) -> None:
        self.show_mode(int(event.args[1]["id"]) - 1)

    def show_mode(self, k: int) -> None:
        """Show a mode of the deck, from 0, in motion."""
        self.mode = k
        if self.viewer is not None and self.deck is not None:
            move(self.viewer, stored_modes(self.session, self.deck), k)

    def step(self, by: int) -> None:
        """Show the next or the previous target mode."""
        trial = self.now.trial if self.now is not None else None
        if trial is not None:
            modes = (trial.modes - 1).tolist()
            k = (modes.index(self.mode) + by) % len(modes) if self.mode in modes else 0
            self.show_mode(modes[k])

    def play(self) -> None:
        """Begin or end the motion."""
        if self.viewer is not None and self.mode is not None:
            self.viewer.play(not self.viewer.props["playing"])

    # --- the selection

    def picked(self, found: dict[str, Any] | None) -> None:
        """A click selects a node, or the node of an arrow."""
        self.boxed_nodes = []
        self.node = None
        if found is not None and found["kind"] == "node":
            self.node = int(found["id"])
        elif found is not None and self.now is not None and self.now.trial is not None:
            test = self.now.trial.test
            if found["id"] in test.channels:
                self.node = int(test.at[test.channels.index(found["id"])])
        self._drawn()
        self.inspected()

    def boxed(self, found: dict[str, Any]) -> None:
        """A rectangle selects the nodes that are seen in it."""
        self.node = None
        self.boxed_nodes = [int(n) for n in found["node"]]
        self._drawn()
        self.inspected()

    # --- edits of [plan]

    def set(self, words: str, **keys: object) -> None:
        """Change keys of [plan] in one step; None takes one out."""
        self.session.edit(words, edits.put_all(("plan",), keys))

    def add(self) -> None:
        """Measure at the selected node in any case."""
        node = self.node
        if node is not None and (self.now is None or node not in self.now.nodes):
            self.set(
                f"point {node} added",
                fixed=[*self.plan.fixed, node],
                exclude=[n for n in self.plan.exclude if n != node] or None,
            )

    def remove(self) -> None:
        """Do not measure at the selected node."""
        node = self.node
        if node is not None and node not in self.plan.exclude:
            self.set(
                f"point {node} taken out",
                fixed=[n for n in self.plan.fixed if n != node] or None,
                exclude=[*self.plan.exclude, node],
            )

    def allow(self) -> None:
        """Let the selected node be a candidate again."""
        self.set(
            f"node {self.node} allowed",
            exclude=[n for n in self.plan.exclude if n != self.node] or None,
        )

    def strike(self, on: bool) -> None:
        """Name the selected node as one that can be excited, or not any more."""
        node = self.node
        assert node is not None
        here = [n for n in self.plan.strike_at if n != node] + ([node] if on else [])
        self.set(
            f"excitation at {node} {'named' if on else 'not named'}",
            strike_at=here or None,
        )

    def forbid(self, key: str) -> None:
        """Forbid the box around the selected nodes, or measure in it alone."""
        deck = self.deck
        assert deck is not None
        here = deck.scene.xyz[np.isin(deck.scene.node, self.boxed_nodes)]
        if not len(here):
            return
        corners = [
            *(here.min(axis=0) - MARGIN).tolist(),
            *(here.max(axis=0) + MARGIN).tolist(),
        ]
        box = [float(f"{x:.4f}") + 0.0 for x in corners]
        count = len(self.boxed_nodes)
        self.boxed_nodes = []
        words = "forbidden" if key == "keep_out" else "measured alone"
        self.set(
            f"box of {count} nodes {words}", **{key: [*getattr(self.plan, key), box]}
        )

    def unbox(self, key: str, k: int) -> None:
        """Take a box out of [plan]."""
        rest: list[list[float]] = list(getattr(self.plan, key))
        del rest[k]
        self.set(f"box {k + 1} taken out", **{key: rest or None})

    async def virtual_test(self) -> None:
        """Make the plan with virtual tests of it."""
        if not self.plan.trials:
            self.set(f"{TRIALS} virtual tests", trials=TRIALS)
        await self.session.run_stages("plan")

    # --- the inspector

    def inspected(self) -> None:
        """The selected node or box, the settings, the virtual test."""
        with inspector():
            self._node()
            self._boxes()
            self._settings()
            self._excitation()
            self._virtual()

    def _node(self) -> None:
        node = self.node
        if node is None and not self.boxed_nodes:
            heading("Node")
            ui.label("Click a node; drag with Ctrl for a rectangle.").classes(
                "text-sm opacity-70"
            )
            return
        if node is None:
            heading("Rectangle")
            fact("Nodes", str(len(self.boxed_nodes)))
            with ui.row().classes("gap-1"):
                _button("Forbid", "block", partial(self.forbid, "keep_out"))
                _button("Only here", "crop_free", partial(self.forbid, "boxes"))
            return
        heading(f"Node {node}")
        here = self.now is not None and node in self.now.nodes
        able = self.candidates is not None and node in self.candidates.nodes
        with ui.row().classes("gap-1"):
            if here:
                _button("Remove", "remove_location_alt", self.remove)
            elif node in self.plan.exclude:
                _button("Allow", "undo", self.allow)
            elif able:
                _button("Add", "add_location_alt", self.add)
                _button("Exclude", "block", self.remove)
            else:
                ui.label("No candidate: held, or in a forbidden box.").classes(
                    "text-sm"
                )
            if able:
                named = node in self.plan.strike_at
                _button(
                    "Excite elsewhere" if named else "Excite here",
                    "gavel",
                    partial(self.strike, not named),
                )

    def _boxes(self) -> None:
        kinds = (("keep_out", "Forbidden boxes"), ("boxes", "Measured boxes alone"))
        for key, title in kinds:
            boxes: Sequence[Sequence[float]] = getattr(self.plan, key)
            if boxes:
                heading(title)
            for k, box in enumerate(boxes):
                with ui.row().classes("w-full items-center no-wrap gap-2"):
                    low, high = (
                        " ".join(f"{x:.3g}" for x in b) for b in (box[:3], box[3:])
                    )
                    ui.label(f"{low} to {high} m").classes("text-xs rt-value grow")
                    ui.button(icon="close", on_click=partial(self.unbox, key, k)).props(
                        "flat dense round size=sm"
                    ).tooltip("Take it out")

    def _settings(self) -> None:
        heading("What is asked")
        with ui.row().classes("w-full no-wrap gap-2"):
            for key, label in (
                ("sensors", "points"),
                ("references", "excitation points"),
            ):
                self._number(key, label, whole=True)
        with ui.row().classes("w-full no-wrap gap-2"):
            for key, label in (("fmin", "from, Hz"), ("fmax", "to, Hz")):
                self._number(key, label, whole=False)
        ui.select(
            {
                "triaxial": "triaxial",
                "uniaxial": "single axes",
                "normal": "along normals",
            },
            value=self.plan.directions,
            label="sensors",
            on_change=lambda e: self.set(f"sensors {e.value}", directions=str(e.value)),
        ).props(SELECT).classes("w-full")

    def _number(self, key: str, label: str, *, whole: bool) -> None:
        value = getattr(self.plan, key)
        given = (
            ui.number(label, value=value, min=0)
            .props("dense outlined")
            .classes("w-1/2")
        )

        def write() -> None:
            new = given.value
            if new is not None and new != value:
                made: int | float = int(new) if whole else float(new)
                self.set(f"{label} {made:g}", **{key: made})

        given.on("blur", write).on("keydown.enter", write).mark(f"plan-{key}")

    def _excitation(self) -> None:
        trial = self.now.trial if self.now is not None else None
        heading("Excitation points")
        for name in trial.references if trial is not None else ():
            ui.label(name).classes("text-sm")
        if self.plan.strike_at:
            named = ", ".join(map(str, self.plan.strike_at))
            ui.label(f"chosen among nodes {named}").classes("text-xs opacity-70")

    def _virtual(self) -> None:
        heading("Virtual test")
        stored = self.stored
        found = stored.virtual_test if stored is not None else None
        if stored is None:
            ui.label("No plan is stored yet.").classes("text-sm opacity-70")
        elif self.session.standing("plan") == "stale":
            ui.label("The stored plan is of other settings.").classes(
                "text-xs opacity-70"
            )
        if found is not None:
            fact("Trials", str(found.trials))
            fact(
                "Modes found in most",
                f"{int((found.found > 0.5).sum())} of {found.found.size}",
            )
            fact("Invented modes a trial", number(found.invented, 2))
            fact("Largest force", f"{number(found.force, 2)} N")
        _button("Virtual test", "science", self.virtual_test)


def _figure(name: str, value: str, good: bool = True) -> None:
    with ui.column().classes("gap-0 whitespace-nowrap"):
        ui.label(name).classes("rt-head")
        ui.label(value).classes("text-sm rt-value" + ("" if good else " text-accent"))


def _button(text: str, icon: str, does: Any) -> None:
    ui.button(text, icon=icon, on_click=does).props(
        "dense no-caps outline size=sm"
    ).mark(text.lower().replace(" ", "-"))
