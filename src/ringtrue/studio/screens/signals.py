"""Signals and impacts: records from hours down to the sample, their spectra, hits one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
from nicegui import run, ui
from nicegui.events import GenericEventArguments

from ringtrue.core.arrays import Float
from ringtrue.core.channels import FORCES
from ringtrue.core.notes import sentence
from ringtrue.core.signals import Channel
from ringtrue.errors import RingtrueError
from ringtrue.plots import records as figures
from ringtrue.studio import theme
from ringtrue.studio.screens.impacts import ImpactPanel
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    SELECT,
    channels_select,
    fact,
    frame,
    heading,
    inspector,
    on_click,
)
from ringtrue.studio.shown import records_of
from ringtrue.study.record_views import RecordView, place_of
from ringtrue.study.results import IdentifyStage

AT_FIRST = 3  # channels that are shown
MOST = 8
LINES = 2048  # of a spectrum, where no resolution is asked for
RESOLUTIONS = tuple(float(f"{m}e{e}") for e in range(-3, 1) for m in (1, 2, 5))  # Hz
SIGNALS, IMPACTS = "signals", "impacts"


def build(session: StudioSession) -> None:
    """Fill the page."""
    if not records_of(session).names:
        frame().follow(frame().rebuild, session.on_documents)
        with ui.column().classes("w-full items-center q-pa-xl gap-2"):
            ui.icon("graphic_eq").classes("text-4xl opacity-40")
            ui.label(
                session.problem or "The study has no records: [test] log names them."
            )
        return
    _SignalsScreen(session).build()


class _SignalsScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.records = records_of(session)
        self.view: RecordView | None = None
        self.problem = ""
        self.channels: list[str] = []
        self.span = (0, 0)  # samples that are shown
        self.resolution = 0.0  # Hz; 0: as the length asks for
        self.what = SIGNALS
        self.seen: tuple[Float, Float, int] | None = None  # the spectra that are shown
        self._wanted = 0
        self._impacts: ImpactPanel | None = None

    @property
    def record(self) -> str:
        """The record that is shown."""
        names = self.records.names
        wanted = self.session.selection.record
        if wanted == "hammer":  # the FRFs of all of them
            hammered = [
                n for n, r in self.records.logged.items() if r.kind != "ambient"
            ]
            wanted = hammered[0] if hammered else ""
        return wanted if wanted in names else names[0]

    @property
    def with_hits(self) -> bool:
        """Whether the record has hits of a hammer."""
        logged = self.records.logged.get(self.record)
        return logged is not None and logged.kind == "hammer"

    def build(self) -> None:
        self.root = ui.column().classes("w-full gap-0")
        with self.root:
            self.body()
        session = self.session
        frame().follow(self._restyled, session.on_theme)
        frame().follow(
            self._marked, session.on_documents, session.on_results, session.on_selection
        )
        ui.timer(0, self._open, once=True)

    async def _open(self) -> None:
        """Open the record and show all of it."""
        self.problem = ""
        try:
            view = await self.records.view(self.record)
        except (RingtrueError, OSError) as e:
            if self.root.is_deleted:
                return
            self.view = None
            self.problem = str(e)
            self.body.refresh()
            return
        if view is None or self.root.is_deleted:  # the program or the page has ended
            return
        fresh = self.view is None or view.name != self.view.name
        self.view = view
        there = [c.id for c in view.channels]
        if fresh:
            self.span = (0, view.samples)
            chosen = self.session.selection.channel
            at = there.index(chosen) if chosen in there[AT_FIRST:] else 0
            self.channels = there[at : at + AT_FIRST]
        if self.what == IMPACTS and not self.with_hits:
            self.what = SIGNALS
        await self._rebuilt()

    async def _rebuilt(self) -> None:
        """Build the page anew and fill it."""
        with self.root:  # what was clicked is no longer there
            self.body.refresh()
            await self._inspected()
            await self._drawn()

    @ui.refreshable_method
    def body(self) -> None:
        """The bar, and what is shown of the record."""
        with ui.column().classes("w-full gap-1 p-2"):
            self._bar()
            frame().keys.clear()
            self._impacts = None
            if self.problem:
                ui.label(self.problem).classes("text-negative").mark("problem")
            elif self.view is None:
                ui.spinner(size="lg").classes("self-center q-ma-xl")
            elif self.what == IMPACTS:
                self._impacts = ImpactPanel(
                    self.session, self.records, self.record, self.view
                )
                self._impacts.build()
            else:
                self._plots()

    def _bar(self) -> None:
        view = self.view
        with ui.row().classes("w-full items-center no-wrap gap-2"):
            ui.select(
                self.records.names, value=self.record, on_change=self._other_record
            ).props(SELECT).classes("min-w-44").mark("record")
            if self.with_hits:
                ui.toggle(
                    [SIGNALS, IMPACTS], value=self.what, on_change=self._other_view
                ).props("dense no-caps unelevated").mark("what")
            if view is None or self.what == IMPACTS:
                return
            ids = [c.id for c in view.channels]
            channels_select(
                "channels", ids, self.channels, self._other_channels, MOST
            ).classes("grow min-w-0").mark("channels")
            ui.button(icon="zoom_out_map", on_click=self._whole).props(
                "flat dense round"
            ).tooltip("The whole record").mark("whole")

    def _plots(self) -> None:
        height = f"max(38vh, {70 * len(self.channels)}px)"
        self.plot = ui.plotly({}).classes("w-full").style(f"height:{height}")
        self.plot.on("plotly_relayout", self._zoomed).mark("signals")
        view = self.view
        assert view is not None
        with ui.row().classes("w-full items-center no-wrap gap-2"):
            heading("Spectra and spectrogram of what is shown")
            ui.space()
            fine = [r for r in RESOLUTIONS if 4 / view.duration < r < view.rate / 16]
            ui.select(
                {0.0: "lines: auto"} | {r: f"lines: {r:g} Hz" for r in fine},
                value=self.resolution if self.resolution in fine else 0.0,
                on_change=self._other_resolution,
            ).props("dense options-dense borderless").mark("resolution")
        with ui.row().classes("w-full no-wrap gap-2"):
            self.spectra = ui.plotly({}).classes("w-1/2 min-w-0").style("height:38vh")
            on_click(self.spectra, self._clicked).mark("spectra")
            self.waterfall = ui.plotly({}).classes("w-1/2 min-w-0").style("height:38vh")

    # --- what is asked for

    async def _other_record(self, event: Any) -> None:
        self.session.select(record=event.value)
        await self._open()

    async def _other_view(self, event: Any) -> None:
        self.what = event.value
        await self._rebuilt()

    async def _other_channels(self, event: Any) -> None:
        there = [c.id for c in self.view.channels] if self.view else []
        self.channels = sorted(event.value[:MOST], key=there.index)
        if len(self.channels) == 1:
            self.session.select(channel=self.channels[0])
        await self._drawn()

    async def _other_resolution(self, event: Any) -> None:
        self.resolution = float(event.value)
        await self._drawn()

    async def _whole(self) -> None:
        if self.view is not None:
            self.span = (0, self.view.samples)
            await self._drawn()

    async def _zoomed(self, event: GenericEventArguments) -> None:
        """Read what a zoom or a move has brought into view."""
        view = self.view
        if view is None:
            return
        args = event.args
        ends = args.get("xaxis.range") or [
            args.get("xaxis.range[0]"),
            args.get("xaxis.range[1]"),
        ]
        if args.get("xaxis.autorange"):
            ends = [0.0, view.duration]
        if None in ends:
            return
        first, last = (round(float(x) * view.rate) for x in ends)
        start = min(max(first, 0), view.samples - 16)
        span = (start, max(min(last + 1, view.samples), start + 16))
        if span != self.span:
            self.span = span
            await self._drawn()

    def _clicked(self, event: GenericEventArguments) -> None:
        self.session.select(frequency=float(event.args["x"]), order=None, mode=None)

    # --- what is shown

    @property
    def _shown(self) -> list[Channel]:
        assert self.view is not None
        return [c for c in self.view.channels if c.id in self.channels]

    async def _drawn(self) -> None:
        """Draw the part that is shown; what was asked for meanwhile is drawn in place of it."""
        self._wanted += 1
        turn = self._wanted
        view = self.view
        ids = [c.id for c in self._shown] if view is not None else []
        if view is None or self.what != SIGNALS or not ids:
            return
        start, stop = self.span
        seen = await run.io_bound(view.envelope, ids, start, stop)
        notes = await self.records.notes(self.record, view)
        if turn != self._wanted or seen is None or self.root.is_deleted:
            return
        levels = {
            n.subject: float(n.values["value"])
            for n in notes
            if n.code == "channel clipped"
        }
        figure = figures.signals(
            self._shown,
            seen,
            rate=view.rate,
            shown=(start / view.rate, stop / view.rate),
            levels=levels,
            hits=self._hits(view),
        )
        spec = theme.drawn(figure, dark=self.session.dark)
        spec["layout"]["uirevision"] = f"{self.record} {self.span}"
        self.plot.update_figure(spec)
        resolution = self.resolution or max(
            view.rate / 2 / LINES, 4 * view.rate / (stop - start)
        )
        self.seen = await run.io_bound(view.spectra, ids, start, stop, resolution)
        one = next((c for c in self._shown if c.quantity not in FORCES), self._shown[0])
        level = await run.io_bound(view.spectrogram, one.id, start, stop)
        if turn != self._wanted or level is None or self.root.is_deleted:
            return
        self._marked_spectra()
        figure = figures.spectrogram(one, level, rate=view.rate)
        spec = theme.drawn(figure, dark=self.session.dark)
        spec["layout"]["uirevision"] = f"{self.record} {self.span}"
        self.waterfall.update_figure(spec)

    def _hits(self, view: RecordView) -> list[figures.MarkedHit]:
        hits = self.records.hits(self.record)
        return [
            figures.MarkedHit(place_of(view, h) / view.rate, h.accepted) for h in hits
        ]

    def _marked_spectra(self) -> None:
        """The spectra with modes, machines and the selected frequency."""
        if self.seen is None or self.what != SIGNALS:
            return
        freqs, density, _ = self.seen
        if len(density) != len(self._shown):
            return
        found = self.records.identified(self.record)
        stage: IdentifyStage | None = self.session.stage("identify")
        hammer = stage.hammer if stage is not None and self.with_hits else None
        modes = found or hammer
        figure = figures.spectra(
            self._shown,
            freqs,
            density,
            modes=modes.modes.frequencies if modes is not None else np.empty(0),
            machines=found.account.lines if found is not None else np.empty(0),
            selected=self.session.selection.frequency,
        )
        spec = theme.drawn(figure, dark=self.session.dark)
        spec["layout"]["uirevision"] = f"{self.record} {freqs[-1]:g}"
        self.spectra.update_figure(spec)

    async def _restyled(self) -> None:
        if self._impacts is not None:
            await self._impacts.drawn()
        await self._drawn()

    async def _marked(self) -> None:
        """Follow the selection, the choice and what is stored."""
        if self.view is not None and self.view.name != self.record:
            await self._open()
        elif self._impacts is not None:
            await self._impacts.drawn()
        elif self.view is not None:
            self._marked_spectra()

    async def _inspected(self) -> None:
        """What is known of the record."""
        view = self.view
        if view is None or self.what == IMPACTS:
            return
        notes = await self.records.notes(self.record, view)
        stored = self.records.summary(self.record)
        found = self.records.identified(self.record)
        if self.root.is_deleted:
            return
        with inspector():
            heading(self.record)
            fact("Length", _length(view.duration))
            fact("Rate", f"{view.rate:g} Hz")
            fact("Samples", f"{view.samples:,} × {len(view.channels)} channels")
            if stored is not None:
                fact("Excitation", stored.excitation)
                if stored.hits[1]:
                    fact("Hits kept", f"{stored.hits[0]} of {stored.hits[1]}")
            heading("Channels")
            for note in notes:
                colour = {"warning": "text-warning", "error": "text-negative"}.get(
                    note.severity, ""
                )
                ui.label(sentence(note)).classes(f"text-xs {colour}")
            if not notes:
                whole = stored is not None or view.name in self.records.names
                ui.label("Nothing is wrong with them." if whole else "").classes(
                    "text-xs"
                )
            if stored is not None and stored.notes:
                heading("Identification")
                for text in stored.notes:
                    ui.label(text).classes("text-xs")
            if found is not None and found.account.machines:
                heading("Machines")
                for machine in found.account.machines:
                    ui.label(
                        f"{machine.frequency:.4g} Hz, {len(machine.harmonics)} harmonics"
                    )


def _length(seconds: float) -> str:
    """A time in the unit that suits it."""
    if seconds < 600:
        return f"{seconds:.4g} s"
    return f"{seconds / 60:.4g} min" if seconds < 7200 else f"{seconds / 3600:.4g} h"
