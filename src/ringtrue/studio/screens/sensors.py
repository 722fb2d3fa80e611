"""Sensors: arrows on the deck, distances to its nodes, and channels that may be wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import run, ui
from nicegui.events import GenericEventArguments

import ringtrue as rt
from ringtrue.api.lookup import PlacedSensors
from ringtrue.core.display import number
from ringtrue.errors import RingtrueError
from ringtrue.io.sheets import SensorSheet
from ringtrue.plots.style import QUALITATIVE
from ringtrue.studio import edits
from ringtrue.studio.edits import Change
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    SELECT,
    fact,
    frame,
    heading,
    inspector,
    run_button,
    table,
)
from ringtrue.studio.shown import DrawnDeck, drawn_deck
from ringtrue.studio.viewer_element import Viewer
from ringtrue.studio.views import deck_view
from ringtrue.study.results import CorrelateStage
from ringtrue.viewer.scene import sensor_arrays, test_arrays

FAR, SUSPECT, REST = "far from the deck", "suspect", "sensor"
COLORS = {REST: QUALITATIVE[2], SUSPECT: QUALITATIVE[1], FAR: QUALITATIVE[3]}
FITS = {
    "": "As the sheet says",
    "points": "By numbers of points",
    "nearest": "By nearest nodes",
}


@dataclass(frozen=True, slots=True)
class Gain:
    """What a change of channels does to the pairs.

    Attributes
    ----------
    pairs : (int, int)
        Before and after.
    mac : (float, float), %
        Mean MAC of the test modes with their partners, 0 without one.
    """

    pairs: tuple[int, int]
    mac: tuple[float, float]

    def __str__(self) -> str:
        """In words."""
        (few, more), (now, then) = self.pairs, self.mac
        return f"mean MAC {now:.1f} → {then:.1f} %, {few} → {more} pairs"


def gain(session: StudioSession, reads: Mapping[str, tuple[str, float]]) -> Gain | None:
    """What the pairs of the initial deck gain if channels read others; None where no correlation
    is stored, or it does not have these channels.

    Parameters
    ----------
    session : StudioSession
    reads : mapping of str to (str, float)
        Channel -> the channel whose motion it reads, and with which sign.
    """
    stage: CorrelateStage | None = session.stage("correlate")
    if stage is None or session.config is None:
        return None
    test = stage.reference.elastic
    row = {c: k for k, c in enumerate(test.channels)}
    if not row.keys() >= {*reads, *(at for at, _ in reads.values())}:
        return None
    shapes = np.array(test.shapes)
    for name, (at, sign) in reads.items():
        shapes[row[at]] = sign * test.shapes[row[name]]
    found = rt.correlate(
        replace(test, shapes=shapes),
        stage.fe_initial,
        settings=session.config.correlate,
        mountings=False,
    )
    before = [r.mac_percent for r in stage.initial.rows()]
    count = max(len(test), 1)
    now, then = sum(before) / count, float(np.sum(found.mac_percent)) / count
    return Gain((len(before), len(found)), (now, then))


def build(session: StudioSession) -> None:
    """Fill the page."""
    if not session.sheet_name:
        frame().follow(frame().rebuild, session.on_documents)
        with ui.column().classes("w-full items-center q-pa-xl gap-2"):
            ui.icon("sensors").classes("text-4xl opacity-40")
            ui.label(
                "The study has no sensor sheet: name one under [test] of study.toml."
            )
        return
    _SensorsScreen(session).build()


class _SensorsScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.deck: DrawnDeck | None = None
        self.viewer: Viewer | None = None
        self.sheet: SensorSheet | None = None
        self.placed: PlacedSensors | None = None
        self.problem = ""
        self.partner = ""

    @property
    def path(self) -> Path:
        """The sensor sheet."""
        return self.session.documents.folder / self.session.sheet_name

    def build(self) -> None:
        session = self.session
        self.holder = ui.column().classes("w-full gap-1 p-2")
        self._inspector()
        ui.timer(0.0, self.load, once=True)
        frame().follow(self._changed, session.on_documents, session.on_results)
        frame().follow(self._selected, session.on_selection)
        keys = frame().keys
        keys["next"] = partial(self.step, 1)
        keys["previous"] = partial(self.step, -1)

    async def load(self) -> None:
        """Read deck and sheet, and draw them."""
        self.deck = await drawn_deck(self.session)
        if self.holder.is_deleted:
            return
        drawn: dict[str, Any] = {}
        if self.deck is not None:
            drawn["model"] = self.deck.arrays
        else:
            await self._place()
            drawn["test"] = (
                test_arrays(self.sheet.model) if self.sheet is not None else {}
            )
        with self.holder:
            self.bar()
            self.viewer = deck_view(self.session, drawn, ["sensor"], below=358)
            self.viewer.show(color="plain", test=False)
            self.viewer.on_event("pick", self.picked).on_event("drag", self.dragged)
            with ui.scroll_area().style("height:246px").classes("w-full"):
                self.points()
        await self._changed()

    async def _changed(self) -> None:
        deck = await drawn_deck(self.session)
        if self.holder.is_deleted:
            return
        if deck is not self.deck:
            frame().rebuild()
            return
        await self._place()
        if self.holder.is_deleted or self.viewer is None:
            return
        self.bar.refresh()
        self._drawn()
        self.points.refresh()
        self._selected()

    async def _place(self) -> None:
        """The sheet as it is now, on the deck."""
        self.problem = ""
        try:
            found = await run.io_bound(self._read)
        except RingtrueError as e:
            self.problem = str(e)
        else:
            if found is not None:
                self.sheet, self.placed = found

    def _read(self) -> tuple[SensorSheet, PlacedSensors | None]:
        sheet = rt.read_sensors(self.path)
        config = self.session.config
        if self.deck is None or config is None:
            return sheet, None
        asked = config.correlate
        placed = rt.place_sensors(
            self.deck.opened, sheet, align=asked.align, tolerance=asked.tolerance
        )
        return sheet, placed

    def _kinds(self) -> dict[str, str]:
        """What is said of each channel besides that it is one."""
        kinds: dict[str, str] = {}
        stage: CorrelateStage | None = self.session.stage("correlate")
        if stage is not None:
            kinds |= dict.fromkeys(
                (c for m in stage.sensors.mendings for c in m.channels), SUSPECT
            )
        if self.placed is not None:
            far = set(self.placed.far.tolist())
            at = self.placed.test.at.tolist()
            channels = self.placed.test.channels
            kinds |= {c: FAR for c, p in zip(channels, at, strict=True) if p in far}
        return kinds

    def _drawn(self) -> None:
        """The arrows as they are now."""
        if self.viewer is None or self.sheet is None:
            return
        test = self.sheet.model if self.placed is None else self.placed.test
        kinds = self._kinds()
        there = sorted({kinds.get(c, REST) for c in test.channels})
        self.viewer.sensors(
            sensor_arrays(test, kinds, [COLORS[k] for k in there], REST)
        )

    # --- bar and table

    @ui.refreshable_method
    def bar(self) -> None:
        """How the sheet is laid onto the deck, and what the colours mean."""
        session = self.session
        config = session.config
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            if config is not None and self.deck is not None:
                ui.select(
                    FITS,
                    value=config.correlate.align,
                    on_change=lambda e: self.fit(str(e.value)),
                ).props(SELECT).classes("min-w-48").mark("fit").tooltip(
                    "How the sheet is laid onto the deck"
                )
            kinds = set(self._kinds().values())
            for name in (REST, SUSPECT, FAR):
                if name in kinds or name == REST:
                    with ui.row().classes("items-center no-wrap gap-1"):
                        ui.icon("north_east").style(f"color:{COLORS[name]}")
                        ui.label(name).classes("text-xs no-wrap")
            ui.space()
            run_button(session, "correlate", "Correlate")
        if self.problem:
            ui.label(self.problem).classes("text-sm text-negative").mark(
                "sheet-problem"
            )
        elif self.placed is not None and self.placed.alignment:
            ui.label(self.placed.alignment).classes(
                "text-xs opacity-70 ellipsis w-full"
            ).tooltip(self.placed.alignment)

    def fit(self, how: str) -> None:
        """Lay the sheet onto the deck, or leave it where it is."""
        change = edits.put(("correlate", "align"), how or None)
        self.session.edit(f"sheet laid onto the deck: {FITS[how].lower()}", change)

    @ui.refreshable_method
    def points(self) -> None:
        """Where each point is, and how far from a node."""
        sheet = self.sheet
        if sheet is None:
            return
        here: dict[int, list[str]] = {}
        for c in sheet.channels:
            here.setdefault(c.point, []).append(c.id)
        placed = self.placed
        model = sheet.model
        rows: list[dict[str, object]] = []
        for k, point in enumerate(model.points.tolist()):
            place = ", ".join(f"{x:g}" for x in model.xyz[k].tolist())
            row: dict[str, object] = {"id": point, "point": point, "place": place}
            row["channels"] = " ".join(here.get(point, ()))
            if placed is not None:
                row["node"] = int(placed.node[k])
                row["distance"] = f"{1e3 * placed.distance[k]:.4g}"
                row["far"] = "too far" if placed.distance[k] > placed.tolerance else ""
            rows.append(row)
        names = {"point": "point", "channels": "channels", "place": "x, y, z in m"}
        if placed is not None:
            names |= {"node": "nearest node", "distance": "distance, mm", "far": ""}
        table(names, rows).on("rowClick", self._row).mark("points")

    def _row(self, event: GenericEventArguments) -> None:
        point = int(event.args[1]["id"])
        sheet = self.sheet
        first = (
            next((c.id for c in sheet.channels if c.point == point), "")
            if sheet
            else ""
        )
        if first:
            self.session.select(channel=first)

    # --- the selection

    @property
    def names(self) -> tuple[str, ...]:
        """Channels of the sheet."""
        return () if self.sheet is None else self.sheet.model.channels

    def picked(self, found: dict[str, Any] | None) -> None:
        """A click selects a channel."""
        self.session.select(channel="" if found is None else str(found["id"]))

    def step(self, by: int) -> None:
        """Select the next or the previous channel."""
        names = self.names
        if names:
            now = self.session.selection.channel
            k = (names.index(now) + by) % len(names) if now in names else 0
            self.session.select(channel=names[k])

    def _selected(self) -> None:
        self.partner = ""
        self._marked()
        self.inspected()

    def _marked(self) -> None:
        if self.viewer is not None:
            wanted = [
                c
                for c in (self.session.selection.channel, self.partner)
                if c in self.names
            ]
            select = {"sensor": wanted} if wanted else None
            self.viewer.show(select=select, labels=select)

    def point_of(self, channel: str) -> int:
        """The point that a channel is at."""
        assert self.sheet is not None
        return next(c.point for c in self.sheet.channels if c.id == channel)

    # --- edits

    def edit(self, words: str, change: Change) -> None:
        """Change the sensor sheet."""
        self.session.edit(words, lambda text: text, (self.session.sheet_name, change))

    def dragged(self, found: dict[str, Any]) -> None:
        """A sensor let go at a node: its point is moved there."""
        if self.placed is None or self.sheet is None or found.get("node") is None:
            return
        node = int(found["node"])
        point = self.point_of(str(found["id"]))
        xyz = self.placed.on_sheet(node)
        self.session.select(channel=str(found["id"]))
        self.edit(
            f"point {point} at node {node}", edits.relocate(self.sheet, point, xyz)
        )

    def flip(self) -> None:
        """Reverse the selected channel."""
        assert self.sheet is not None
        name = self.session.selection.channel
        self.edit(f"{name} reversed", edits.flip(self.sheet, [name]))

    def turn(self, about: str) -> None:
        """Turn all channels of the point by 90°."""
        assert self.sheet is not None
        point = self.point_of(self.session.selection.channel)
        self.edit(
            f"point {point} turned by 90° about {about}",
            edits.turn(self.sheet, point, about),
        )

    def swap(self) -> None:
        """Exchange the selected channel with another."""
        assert self.sheet is not None
        name, other = self.session.selection.channel, self.partner
        if other:
            self.edit(
                f"{name} and {other} exchanged", edits.swap(self.sheet, name, other)
            )

    def mend(self, k: int) -> None:
        """Write what the correlation found of the sensors into the sheet."""
        stage: CorrelateStage = self.session.stage("correlate")
        found = stage.sensors.mendings[k]
        sheet = self.sheet
        assert sheet is not None
        if found.kind == "axes":
            groups = dict(
                zip(sheet.model.channels, sheet.model.group_of_channels(), strict=True)
            )
            mine = [
                c for c in self.names if not found.group or groups[c] == found.group
            ]
            change = edits.remap(sheet, mine, dict(found.axes))
        else:
            reads = {s.channel: s.partner for s in found.suspects if s.partner}
            turned = [s.partner or s.channel for s in found.suspects if s.factor < 0]
            change = mended(sheet, turned, reads)
        self.edit(found.change, change)

    # --- the inspector

    def _inspector(self) -> None:
        """What `inspected` fills, and the list of channels, which is too long to be made at each
        click.
        """
        with inspector():
            self.about = ui.column().classes("w-full gap-1")
            self.exchange = (
                ui.select(
                    [],
                    label="Exchange with",
                    with_input=True,
                    on_change=lambda e: self.try_swap(str(e.value or "")),
                )
                .props("dense options-dense outlined clearable")
                .classes("w-full")
                .mark("partner")
            )
            self.exchange.set_visibility(False)
            self.after = ui.column().classes("w-full gap-1")

    def inspected(self) -> None:
        """The selected channel, and what would explain the test better."""
        for column in (self.about, self.after):
            column.clear()
        if self.exchange.options != list(self.names):
            self.exchange.set_options(list(self.names))
        name = self.session.selection.channel
        self.exchange.set_visibility(name in self.names)
        self.exchange.value = self.partner or None
        with self.about:
            self._channel()
        with self.after:
            if self.partner:
                swapped = {name: (self.partner, 1.0), self.partner: (name, 1.0)}
                self._gain("Exchanged", swapped).mark("swap-gain")
                _button("Exchange", "swap_horiz", self.swap)
            self._doctor()

    def _channel(self) -> None:
        name = self.session.selection.channel
        heading("Channel")
        if name not in self.names or self.sheet is None:
            ui.label("Click an arrow; drag it to a node to move its point.").classes(
                "text-sm opacity-70"
            )
            return
        model = self.sheet.model
        k = model.channels.index(name)
        point = int(model.at[k])
        fact("Channel", name)
        fact("Point", str(point))
        fact("Direction", "  ".join(number(x, 3) for x in model.axes[k] + 0.0))
        if self.placed is not None:
            at = self.placed.points.tolist().index(point)
            fact("Nearest node", str(int(self.placed.node[at])))
            fact("Distance", f"{1e3 * self.placed.distance[at]:.4g} mm")
        self._gain("Reversed", {name: (name, -1.0)}).mark("flip-gain")
        with ui.row().classes("gap-1 items-center"):
            _button("Flip", "swap_vert", self.flip)
            ui.label("turn about").classes("text-xs opacity-70")
            for axis in edits.AXES:
                _button(axis, "", partial(self.turn, axis)).tooltip(
                    f"All channels of point {point} by 90° about {axis}"
                )

    def _gain(self, what: str, reads: Mapping[str, tuple[str, float]]) -> ui.label:
        """What reading some channels otherwise does to the pairs, filled in when it is computed."""
        label = ui.label().classes("text-xs q-mt-xs")

        async def fill() -> None:
            found = await run.io_bound(gain, self.session, reads)
            if found is not None and not label.is_deleted:
                label.text = f"{what}: {found}"

        ui.timer(0, fill, once=True)
        return label

    def try_swap(self, partner: str) -> None:
        """See what an exchange would do."""
        if partner != self.partner:
            self.partner = partner if partner != self.session.selection.channel else ""
            self._marked()
            self.inspected()

    def _doctor(self) -> None:
        stage: CorrelateStage | None = self.session.stage("correlate")
        heading("Channel doctor")
        if stage is None:
            ui.label("No correlation is stored.").classes("text-sm opacity-70")
            return
        if self.session.standing("correlate") == "stale":
            ui.label("Deck or sheet have changed since: correlate anew.").classes(
                "text-xs"
            )
        if not stage.sensors.mendings:
            ui.label("No other mounting explains the test better.").classes(
                "text-sm opacity-70"
            )
        for k, found in enumerate(stage.sensors.mendings):
            with ui.card().classes("w-full q-pa-sm gap-1").props("flat bordered"):
                ui.label(found.change).classes("text-sm")
                seen = Gain(found.pairs, (100 * found.mac[0], 100 * found.mac[1]))
                ui.label(str(seen)).classes("text-xs opacity-70")
                if found.rivals:
                    ui.label(f"or {'; or '.join(found.rivals)}").classes(
                        "text-xs opacity-70"
                    )
                _button("Write into the sheet", "edit", partial(self.mend, k)).mark(
                    f"mend-{k}"
                )


def mended(sheet: SensorSheet, turned: list[str], reads: Mapping[str, str]) -> Change:
    """Rows reversed, then named after the channel that reads each."""
    first = edits.flip(sheet, turned)
    second = edits.reread(sheet, reads)
    return lambda text: second(first(text))


def _button(text: str, icon: str, does: Any) -> ui.button:
    button = ui.button(text, icon=icon or None, on_click=does)
    return button.props("dense no-caps outline size=sm").mark(
        text.lower().replace(" ", "-")
    )
