"""Impacts one by one: force, its spectrum, response and coherence; kept or left out by key."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui
from nicegui.events import GenericEventArguments

from ringtrue.core.channels import FORCES, MOTIONS
from ringtrue.core.choice import SAME_HIT_S, Hit
from ringtrue.core.signals import Channel
from ringtrue.errors import RingtrueError
from ringtrue.plots import records as figures
from ringtrue.studio import edits, theme
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    ask_reason,
    channels_select,
    fact,
    frame,
    heading,
    inspector,
    nothing_yet,
    run_button,
    table,
)
from ringtrue.studio.shown import Records
from ringtrue.study.record_views import RecordView, hit_signals, kept_frfs
from ringtrue.study.results import IdentifyStage, ImpactReport

MOST = 4  # responses that are shown


class ImpactPanel:
    """The hits of one record on one page."""

    def __init__(
        self, session: StudioSession, records: Records, record: str, view: RecordView
    ) -> None:
        self.session = session
        self.records = records
        self.record = record
        self.view = view
        self.hits = records.hits(record)
        self.at = 0
        self.problem = ""
        motions = [c.id for c in view.channels if c.quantity not in FORCES]
        chosen = session.selection.channel
        self.responses = [chosen] if chosen in motions else motions[:1]

    def build(self) -> None:
        """The table, the figure, the keys."""
        session = self.session
        if not self.hits:
            text = "No hit is stored of this record."
            nothing_yet(session, text, "identify")
            return
        with ui.row().classes("w-full no-wrap gap-3 items-start"):
            with ui.column().classes("w-64 shrink-0 gap-1"):
                self.listed()
                run_button(session, "identify", "Identify anew")
            with ui.column().classes("grow min-w-0 gap-0"):
                ids = [
                    c.id
                    for c in self.view.channels
                    if c.quantity in (*MOTIONS, "unknown")
                ]
                channels_select(
                    "responses", ids, self.responses, self._other_responses, MOST
                ).classes("w-full").mark("responses")
                self.note = ui.label().classes("text-xs text-negative")
                self.plot = ui.plotly({}).classes("w-full").style("height:68vh")
                self.plot.mark("hit")
        keys = frame().keys
        keys["next"] = partial(self._step, 1)
        keys["previous"] = partial(self._step, -1)
        keys["accept"] = self.keep
        keys["reject"] = self.leave_out
        ui.timer(0, self.drawn, once=True)

    @property
    def hit(self) -> ImpactReport:
        """The one that is shown."""
        return self.hits[self.at]

    async def drawn(self) -> None:
        """Show the hit and what was decided."""
        if not self.hits:
            return
        self.listed.refresh()
        self.inspected()
        logged = self.records.logged[self.record]
        shown = [c for c in self.view.channels if c.id in self.responses]
        ids = [c.id for c in shown]
        seen = await run.io_bound(
            hit_signals, self.view, logged, self.hits, self.at, ids
        )
        if seen is None:
            return
        freqs, coherence = await self._coherence(ids)
        if self.plot.is_deleted:
            return
        figure = figures.hit(
            seen, shown, freqs=freqs, coherence=coherence, stored=self._stored(shown)
        )
        self.note.text = self.problem
        spec = theme.drawn(figure, dark=self.session.dark)
        spec["layout"]["uirevision"] = f"{self.record} {self.at}"
        self.plot.update_figure(spec)

    async def _coherence(self, ids: list[str]) -> tuple[Any, Any]:
        """Of the hits that are kept with what is decided now: lines, and (channel, line)."""
        sheet = self.records.sheet
        self.problem = ""
        nothing = np.empty(0), np.full((len(ids), 0), np.nan)
        if sheet is None:
            return nothing
        config = self.session.config
        keep_to = config.identify.hammer_fmax if config is not None else None
        mine = [h for h in self.records.decisions if self._is_of(h)]
        logged = self.records.logged[self.record]
        try:
            frfs = await run.io_bound(
                kept_frfs, logged, sheet, self.records.unused, mine, keep_to
            )
        except RingtrueError as e:
            self.problem = str(e)
            return nothing
        if frfs is None:
            return nothing
        here = {c.id: k for k, c in enumerate(frfs.outputs)}
        rows = [
            frfs.coherence[:, here[i], 0]
            if i in here
            else np.full(frfs.freqs.size, np.nan)
            for i in ids
        ]
        top = keep_to or float(frfs.freqs[-1])
        shown = frfs.freqs <= 1.25 * top
        return frfs.freqs[shown], np.array(rows)[:, shown]

    def _stored(self, shown: list[Channel]) -> tuple[Any, Any] | None:
        """The coherence of the last run at this input."""
        stage: IdentifyStage | None = self.session.stage("identify")
        frfs = stage.frfs if stage is not None else None
        if frfs is None:
            return None
        inputs = [c.id for c in frfs.inputs]
        outputs = {c.id: k for k, c in enumerate(frfs.outputs)}
        if self.hit.input not in inputs or any(c.id not in outputs for c in shown):
            return None
        at = [outputs[c.id] for c in shown]
        return frfs.freqs, frfs.coherence[:, at, inputs.index(self.hit.input)].T

    # --- decisions

    def _is_of(self, decision: Hit) -> bool:
        return decision.record.partition(" #")[0] == self.record

    def _entry(self, hit: ImpactReport) -> int | None:
        """Number of the entry of the choice that means a hit."""
        for k, decision in enumerate(self.records.decisions):
            near = abs(decision.time - hit.time) <= SAME_HIT_S
            if near and decision.record == hit.source:
                return k
        return None

    def _decided(self, hit: ImpactReport) -> str:
        k = self._entry(hit)
        if k is None:
            return ""
        return "kept" if self.records.decisions[k].keep else "left out"

    def keep(self) -> None:
        """Keep the hit: an entry against it is taken back, one left out asks why."""
        hit = self.hit
        k = self._entry(hit)
        if k is not None:
            if not self.records.decisions[k].keep:
                self._take_back(k)
        elif not hit.accepted:
            ask_reason(
                f"Keep the hit at {hit.time:.2f} s", partial(self.decide, hit, True)
            )
            return
        self._step(1)

    def leave_out(self) -> None:
        """Leave the hit out, with a reason; an entry for it is taken back."""
        hit = self.hit
        k = self._entry(hit)
        if k is not None:
            if self.records.decisions[k].keep:
                self._take_back(k)
        elif hit.accepted:
            ask_reason(
                f"Leave out the hit at {hit.time:.2f} s",
                partial(self.decide, hit, False),
            )
            return
        self._step(1)

    def decide(self, hit: ImpactReport, keep: bool, reason: str) -> None:
        """Write an entry of the choice, and show the next hit."""
        words = f"{'kept' if keep else 'left out'} the hit of {hit.source} at {hit.time:.2f} s"
        entry = {
            "record": hit.source,
            "time": round(hit.time, 4),
            "keep": keep,
            "reason": reason,
        }
        self.session.edit_choice(words, edits.add_entry("hit", entry))
        self._step(1)

    def _take_back(self, k: int) -> None:
        decision = self.records.decisions[k]
        words = f"the hit at {decision.time:.2f} s is as the checks say"
        self.session.edit_choice(words, edits.remove_entry("hit", k))

    async def _go(self, k: int) -> None:
        self.at = k
        await self.drawn()

    def _step(self, by: int) -> None:
        k = (self.at + by) % len(self.hits)
        with self.plot:
            ui.timer(0, partial(self._go, k), once=True)

    async def _other_responses(self, event: Any) -> None:
        self.responses = event.value[:MOST]
        if len(self.responses) == 1:
            self.session.select(channel=self.responses[0])
        await self.drawn()

    # --- what is said of them

    @ui.refreshable_method
    def listed(self) -> None:
        """All hits of the record."""
        rows: list[dict[str, object]] = [
            {
                "id": k,
                "n": f"{'▸' if k == self.at else ''}{k + 1}",
                "t": f"{h.time:.2f}",
                "f": f"{h.peak:.4g}",
                "used": "kept" if h.accepted else "left out",
                "own": self._decided(h),
            }
            for k, h in enumerate(self.hits)
        ]
        names = {"n": "hit", "t": "s", "f": "N", "used": "last run", "own": "you"}
        table(names, rows).on("rowClick", self._row_clicked).mark("hits")

    async def _row_clicked(self, event: GenericEventArguments) -> None:
        await self._go(int(event.args[1]["id"]))

    def inspected(self) -> None:
        """The hit that is shown."""
        hit = self.hit
        k = self._entry(hit)
        with inspector():
            heading(f"Hit {self.at + 1} of {len(self.hits)}")
            fact("Record", hit.source)
            fact("At", hit.input)
            fact("Time", f"{hit.time:.3f} s")
            fact("Peak", f"{hit.peak:.4g} N")
            fact("Width at half the peak", f"{1000 * hit.width:.3g} ms")
            fact("Last run", "kept" if hit.accepted else "left out")
            for reason in hit.reasons:
                ui.label(reason).classes("text-xs")
            if k is not None:
                decision = self.records.decisions[k]
                heading("Your choice")
                ui.label(f"{self._decided(hit)}: {decision.reason}").classes("text-sm")
            with ui.row().classes("gap-2 q-mt-sm"):
                ui.button("Keep", icon="check", on_click=self.keep).props(
                    "dense no-caps unelevated"
                ).tooltip("a or Enter").mark("keep")
                ui.button("Leave out", icon="close", on_click=self.leave_out).props(
                    "dense no-caps outline"
                ).tooltip("r or Delete").mark("leave-out")
