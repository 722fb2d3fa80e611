"""Model: the deck in 3D, what is wrong with it, its modes, and regions that may be wrong."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui

import ringtrue as rt
from ringtrue.api.checking import DeckCheck
from ringtrue.api.lookup import RegionParameter
from ringtrue.core.display import number
from ringtrue.core.modes import ModeSet
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.studio import edits
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import SELECT, fact, frame, heading, inspector, run_button
from ringtrue.studio.shown import (
    DrawnDeck,
    deck_check,
    deck_units,
    drawn_deck,
    known_deck,
    solve_deck,
    stored_modes,
)
from ringtrue.studio.viewer_element import Viewer
from ringtrue.studio.views import (
    deck_view,
    highlighted,
    length_unit,
    mass_unit,
    move,
    no_deck,
)
from ringtrue.study.results import CorrelateStage
from ringtrue.study.scene import connected

SEVERITY = {"error": ("error", "negative"), "warning": ("warning", "warning")}
REMARK = ("info", "grey")
MOST_LISTED = 200  # findings
ON_DEMAND = 20  # modes of a deck that no study has solved


def build(session: StudioSession) -> None:
    """Fill the page."""
    _ModelScreen(session).build()


class _ModelScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.deck: DrawnDeck | None = None
        self.check: DeckCheck | None = None
        self.viewer: Viewer | None = None
        self.coloring = "property"
        self.chosen: set[int] = set()
        self.hidden: set[int] = set()
        self.mode: int | None = None

    def build(self) -> None:
        session = self.session
        self.holder = ui.column().classes("w-full gap-1 p-2")
        deck = known_deck(session)
        if deck is not None:
            self._drawn(deck)
        else:
            with self.holder:
                ui.spinner(size="lg").classes("self-center q-ma-xl")
        ui.timer(0.0, self.load, once=True)
        frame().follow(self._selected, session.on_selection)
        frame().follow(self._changed, session.on_documents, session.on_results)
        keys = frame().keys
        keys["next"] = partial(self.step, 1)
        keys["previous"] = partial(self.step, -1)
        keys["play"] = self.play

    async def load(self) -> None:
        """Read the deck and draw it; its check follows."""
        session = self.session
        deck = await drawn_deck(session)
        if self.holder.is_deleted:
            return
        if deck is None:
            self.holder.clear()
            with self.holder:
                no_deck()
            return
        if deck is not self.deck:
            self._drawn(deck)
        self.check = await deck_check(session, deck)
        if not self.holder.is_deleted:
            self.findings.refresh()
            self.facts.refresh()

    def _drawn(self, deck: DrawnDeck) -> None:
        """The deck, with what is known of it."""
        session = self.session
        self.deck = deck
        self.holder.clear()
        with self.holder:
            self.bar()
            self.viewer = deck_view(
                session, {"model": deck.arrays}, ["element"], below=318
            )
            self.viewer.show(color=self.coloring)
            self.viewer.on_event("pick", self.picked).on_event("box", self.boxed)
            with ui.row().classes("w-full no-wrap gap-6 items-start"):
                self.findings()
                self.facts()
        self._selected()

    async def _changed(self) -> None:
        deck = await drawn_deck(self.session)
        if self.holder.is_deleted:  # the page was left meanwhile
            return
        if deck is not self.deck:
            frame().rebuild()
        elif deck is not None:
            known = self.modes
            if self.mode is not None and (known is None or self.mode >= len(known)):
                self.show_mode(None)  # solved anew up to another frequency
            self.bar.refresh()
            self.inspected()

    # --- colours, modes

    @ui.refreshable_method
    def bar(self) -> None:
        """Colouring, modes."""
        deck = self.deck
        assert deck is not None
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.toggle(
                {"property": "Property", "material": "Material", "group": "Region"},
                value=self.coloring,
                on_change=lambda e: self.color(str(e.value)),
            ).props("dense no-caps unelevated padding='3px 10px'").mark("coloring")
            ui.space()
            modes = self.modes
            if modes is None:
                ui.button(
                    "Compute modes", icon="play_arrow", on_click=self.solve
                ).props("dense no-caps no-wrap outline").mark("solve")
            else:
                names = {
                    k: f"{k + 1}: {f:.5g} Hz" for k, f in enumerate(modes.frequencies)
                }
                ui.select(
                    {-1: "at rest", **names},
                    value=-1 if self.mode is None else self.mode,
                    on_change=lambda e: self.show_mode(
                        None if e.value < 0 else int(e.value)
                    ),
                ).props(SELECT).classes("min-w-40").mark("mode")
                ui.button(icon="play_arrow", on_click=self.play).props(
                    "flat dense round"
                ).tooltip("Play or stop, blank").mark("play")
            run_button(self.session, "model", "Solve the deck")

    @property
    def modes(self) -> ModeSet | None:
        """Those that are known of the deck."""
        return None if self.deck is None else stored_modes(self.session, self.deck)

    async def solve(self) -> None:
        """Solve the lowest modes."""
        assert self.deck is not None
        await solve_deck(self.session, self.deck, ON_DEMAND)
        self.bar.refresh()
        self.show_mode(0)

    def color(self, coloring: str) -> None:
        """Colour by property, material or region."""
        self.coloring = coloring
        if self.viewer is not None:
            self.viewer.show(color=coloring)
        self.inspected()

    def show_mode(self, k: int | None) -> None:
        """Show a mode of the deck, from 0; its pair is selected where it has one."""
        self.mode = k
        stage: CorrelateStage | None = self.session.stage("correlate")
        if k is not None and stage is not None:
            pairing = stage.initial.pairing
            at = np.flatnonzero(pairing.b == k)
            if at.size:
                t = int(pairing.a[at[0]])
                self.session.select(pair=(t, k), mode=t)
        self._moved()

    def _moved(self) -> None:
        if self.viewer is not None:
            move(self.viewer, self.modes, self.mode)
            self.bar.refresh()

    def play(self) -> None:
        """Begin or end the motion."""
        if self.viewer is not None and self.mode is not None:
            self.viewer.play(not self.viewer.props["playing"])

    def step(self, by: int) -> None:
        """Show the next or the previous mode."""
        modes = self.modes
        if modes is not None and len(modes):
            self.show_mode(0 if self.mode is None else (self.mode + by) % len(modes))

    # --- what is wrong

    @ui.refreshable_method
    def findings(self) -> None:
        """The findings of the check; a click flies to what one means."""
        with ui.column().classes("grow min-w-0 gap-0"):
            heading("Findings")
            if self.check is None:
                ui.label("checking the deck").classes("text-sm opacity-70")
                return
            listed = self.check.findings[:MOST_LISTED]
            if not self.check.findings:
                ui.label("No findings.").classes("text-sm opacity-70")
            with ui.scroll_area().style("height:150px").classes("w-full"):
                for k, f in enumerate(listed):
                    icon, color = SEVERITY.get(f.severity, REMARK)
                    row = ui.row().classes(
                        "w-full no-wrap items-start gap-2 cursor-pointer"
                    )
                    row.on("click", partial(self.fly_to, k)).mark(f"finding-{k}")
                    with row:
                        ui.icon(icon, color=color).classes("text-base q-mt-xs")
                        ui.label(f.text).classes("text-sm")
                if len(self.check.findings) > len(listed):
                    more = len(self.check.findings) - len(listed)
                    ui.label(f"and {more} more: ringtrue check lists all").classes(
                        "text-sm"
                    )

    def fly_to(self, k: int) -> None:
        """Fly to the nodes or elements of a finding, or to what has its property or material."""
        assert self.check is not None
        finding = self.check.findings[k]
        if self.viewer is None or not finding.ids:
            place = (
                f"{finding.file}:{finding.line}"
                if finding.line
                else "the deck as a whole"
            )
            ui.notify(f"The finding is of {place}.")
            return
        kind = {"G": "node", "P": "property", "M": "material"}.get(
            finding.card[0], "element"
        )
        selection = {kind: list(finding.ids)}
        self.viewer.show(select=selection, labels=selection if kind == "node" else None)
        self.viewer.fly(selection)

    @ui.refreshable_method
    def facts(self) -> None:
        """Mass, centre of gravity, and the unit systems that the deck may be in."""
        with ui.column().classes("w-80 gap-0"):
            heading("Mass")
            check = self.check
            if check is None:
                return
            if check.rigid is None:
                ui.label("The deck cannot be assembled.").classes("text-sm")
            else:
                mass = check.rigid.mass
                at = ", ".join(number(x, 4) for x in mass.cg + 0.0)
                fact("Mass", f"{number(mass.mass, 5)} {mass_unit(self.session)}")
                fact("Centre of gravity", f"({at}) {length_unit(self.session)}")
            fact("Size", f"{number(check.size, 4)} {length_unit(self.session)}")
            heading("Units")
            self._units(check)

    def _units(self, check: DeckCheck) -> None:
        now = deck_units(self.session)
        names = {
            name: name
            + (", not plausible" if check.implausible[name] else ", plausible")
            for name in UNIT_SYSTEMS
        }
        pick = ui.select(
            names, value=now, on_change=lambda e: self.set_units(str(e.value))
        )
        pick.props(SELECT).classes("w-full").mark("units")
        for f in check.implausible[now][:2]:
            ui.label(f.text).classes("text-xs text-accent")

    def set_units(self, name: str) -> None:
        """State the unit system of the deck."""
        self.session.edit(f"units {name}", edits.put(("model", "units"), name))

    # --- the selection

    def picked(self, found: dict[str, Any] | None) -> None:
        """A click selects an element, with Shift one more; next to the model none."""
        if found is None:
            self.select(())
            return
        one = int(found["id"])
        if found.get("shift"):
            self.select(self.chosen ^ {one})
        else:
            self.select({one})

    def boxed(self, found: dict[str, Any]) -> None:
        """A rectangle selects what is seen in it."""
        self.select(int(e) for e in found["element"])

    def select(self, elements: Iterable[int]) -> None:
        """Select elements by their numbers."""
        self.chosen = set(elements)
        self._shown()
        self.selection.refresh()

    def select_number(self, value: int) -> None:
        """Select all elements of a property, material or region."""
        deck = self.deck
        assert deck is not None
        self.select(deck.elements[deck.numbers(self.coloring) == value].tolist())

    def grow(self) -> None:
        """Select what nodes join to the selection, within its properties."""
        deck = self.deck
        if deck is not None and self.chosen:
            self.select(connected(deck.scene, sorted(self.chosen)).tolist())

    def hide(self) -> None:
        """Hide the selection."""
        self.hidden |= self.chosen
        self.select(())

    def isolate(self) -> None:
        """Hide all but the selection."""
        assert self.deck is not None
        self.hidden = set(self.deck.elements.tolist()) - self.chosen
        self._shown()
        self.selection.refresh()

    def show_all(self) -> None:
        """Hide nothing."""
        self.hidden = set()
        self._shown()
        self.selection.refresh()

    def _shown(self) -> None:
        if self.viewer is None or self.deck is None:
            return
        hide = highlighted(self.deck, self.hidden) if self.hidden else None
        select = highlighted(self.deck, self.chosen) if self.chosen else None
        self.viewer.show(hide=hide, select=select, labels=None)

    def _selected(self) -> None:
        """The region or the pair that is selected on any screen."""
        deck = self.deck
        if deck is None or self.viewer is None:
            return
        pair = self.session.selection.pair
        if pair is not None and pair[1] != self.mode:
            self.mode = pair[1]
            self._moved()
        region = self.session.selection.region
        config = self.session.config
        entry = (
            next((c for c in config.candidate if c.name == region), None)
            if config
            else None
        )
        if entry is not None:
            self.chosen = deck.changed(entry.targets)
            self._shown()
        self.inspected()

    # --- the inspector

    def inspected(self) -> None:
        """The selection, the legend, the candidate regions."""
        if self.deck is None:
            return
        with inspector():
            self.selection()
            self._legend()
            self._candidates()

    @ui.refreshable_method
    def selection(self) -> None:
        """The selected elements, and what can be done with them."""
        heading("Selection")
        count = len(self.chosen)
        if not count:
            text = (
                "Click an element, with Shift several; drag with Ctrl for a rectangle."
            )
            ui.label(text).classes("text-sm opacity-70")
        else:
            first = ", ".join(map(str, sorted(self.chosen)[:6]))
            fact("Elements", first + (f" and {count - 6} more" if count > 6 else ""))
            with ui.row().classes("gap-1"):
                _small("Connected", "hub", self.grow)
                _small("Hide", "visibility_off", self.hide)
                _small("Isolate", "filter_center_focus", self.isolate)
                _small("Fly to", "zoom_in", self._fly)
            ui.button(
                "Candidate region", icon="add_location_alt", on_click=self.ask
            ).props("dense no-caps unelevated").classes("q-mt-xs").mark("candidate")
        if self.hidden:
            with ui.row().classes("w-full items-center justify-between"):
                ui.label(f"{len(self.hidden)} elements are hidden").classes("text-sm")
                _small("Show all", "visibility", self.show_all)

    def _fly(self) -> None:
        if self.viewer is not None and self.deck is not None:
            self.viewer.fly(highlighted(self.deck, self.chosen))

    def _legend(self) -> None:
        deck = self.deck
        assert deck is not None
        heading({"group": "Regions"}.get(self.coloring, f"By {self.coloring}"))
        entries = deck.legend(self.coloring)
        with (
            ui.column()
            .classes("w-full gap-0")
            .style("max-height:38vh; overflow-y:auto")
        ):
            for value, name, color, count in entries:
                row = ui.row().classes(
                    "w-full items-center no-wrap gap-2 cursor-pointer"
                )
                row.on("click", partial(self.select_number, value)).mark(
                    f"legend-{value}"
                )
                with row:
                    ui.element("div").style(
                        f"background:{color};width:12px;height:12px;border-radius:2px;flex:none"
                    )
                    ui.label(name).classes("text-sm grow ellipsis")
                    ui.label(f"{count}").classes("text-sm rt-value opacity-70")

    def _candidates(self) -> None:
        config = self.session.config
        if config is None:
            return
        heading("Candidate regions")
        if not config.candidate:
            ui.label("None yet: select elements.").classes("text-sm opacity-70")
        for k, c in enumerate(config.candidate):
            with ui.row().classes("w-full items-center no-wrap gap-2"):
                chosen = c.name == self.session.selection.region
                name = ui.label(c.name).classes("text-sm grow cursor-pointer")
                name.classes("text-primary" if chosen else "")
                name.tooltip(", ".join(c.targets)).mark(f"region-{k}")
                name.on("click", partial(self.session.select, region=c.name))
                ui.button(icon="close", on_click=partial(self.remove, k, c.name)).props(
                    "flat dense round size=sm"
                ).tooltip("Take it out")

    def remove(self, k: int, name: str) -> None:
        """Take a candidate out of study.toml."""
        self.session.edit(
            f"candidate {name} taken out", edits.remove_entry("candidate", k)
        )

    async def ask(self) -> None:
        """Ask for the name of a candidate region and what of it is uncertain."""
        deck = self.deck
        assert deck is not None
        model = deck.opened.model
        found: tuple[RegionParameter, ...] | None
        found = await run.io_bound(rt.region_parameters, model, frozenset(self.chosen))
        if not found:
            ui.notify("No property or material of these elements can be a parameter.")
            return
        options = {
            k: f"{p.name}: {p.what} ({p.inside} of {len(p.elements)} elements selected)"
            for k, p in enumerate(found)
        }
        with self.holder, ui.dialog() as dialog, ui.card().style("width:560px"):
            ui.label("Candidate region").classes("text-base")
            name = (
                ui.input("Name")
                .classes("w-full")
                .props("autofocus")
                .mark("region-name")
            )
            what = ui.select(options, value=[0], multiple=True, label="One factor on")
            what.props("options-dense use-chips").classes("w-full").mark("region-what")

            def write() -> None:
                if (name.value or "").strip() and what.value:
                    dialog.close()
                    self.add(name.value.strip(), [found[k] for k in what.value])

            name.on("keydown.enter", write)
            with ui.row().classes("w-full justify-end"):
                ui.button("Cancel", on_click=dialog.close).props("flat no-caps")
                ui.button("Write", on_click=write).props("no-caps unelevated").mark(
                    "write"
                )
        dialog.open()

    def add(self, name: str, parameters: list[RegionParameter]) -> None:
        """Write a candidate region into study.toml."""
        self.session.edit(f"candidate {name}", candidate(name, parameters))
        self.session.select(region=name)


def candidate(name: str, parameters: list[RegionParameter]) -> edits.Change:
    """A `[[candidate]]` of one factor on all fields of some parameters, in their narrowest
    bounds.
    """
    entry = {
        "name": name,
        "targets": [t for p in parameters for t in p.targets],
        "lower": max(p.lower for p in parameters),
        "upper": min(p.upper for p in parameters),
        "std": min(p.std for p in parameters),
    }
    return edits.add_entry("candidate", entry)


def _small(text: str, icon: str, does: Any) -> None:
    ui.button(text, icon=icon, on_click=does).props("flat dense no-caps size=sm").mark(
        text.lower().replace(" ", "-")
    )
