"""Verdict and report: what must hold, a reason for what does not, names of modes, the report."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from ringtrue.studio import edits
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    ask_reason,
    frame,
    heading,
    inspector,
    nothing_yet,
    run_button,
)
from ringtrue.study.acceptance import AcceptanceCheck, verdict
from ringtrue.study.results import CorrelateStage

JUDGED_LATER = (
    "Nothing is judged yet: the limits of [correlate] are judged on the "
    "deck that is delivered."
)
PAGE = "/report.html"  # where `launch` serves the report


def build(session: StudioSession) -> None:
    """Fill the page."""
    if session.study is None:
        nothing_yet(session, "Nothing was run yet.", "")
        return
    _VerdictScreen(session).build()


class _VerdictScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session

    def build(self) -> None:
        session = self.session
        with ui.column().classes("w-full gap-1 p-2"):
            with ui.row().classes("w-full items-center no-wrap gap-2"):
                ui.label("What must hold").classes("text-base")
                ui.space()
                ui.button(
                    "Write the report anew", icon="description", on_click=self.write
                ).props("dense flat no-caps no-wrap").mark("write-report")
                run_button(session, "", "Run the study")
            self.checks()
            self.report()
        self.named()
        frame().follow(self.checks.refresh, session.on_documents, session.on_results)
        frame().follow(self.report.refresh, session.on_results)
        frame().follow(self.named, session.on_documents, session.on_results)

    async def write(self) -> None:
        """The report with the names and reasons as they are now, of the stages that are stored."""
        stored = [s.name for s in self.session.stages if s.standing != "missing"]
        await self.session.run_stages(stored[-1] if stored else "")

    @ui.refreshable_method
    def checks(self) -> None:
        """The checklist."""
        study = self.session.study
        config = self.session.config
        every: tuple[AcceptanceCheck, ...] = ()
        if study is not None and config is not None:
            every = verdict(config, study.run.results)
        if not every:
            ui.label(JUDGED_LATER).classes("text-sm opacity-70")
        for title, required in (("Required", True), ("For information", False)):
            some = [c for c in every if c.required is required]
            if some:
                heading(title)
            for check in some:
                self._check(check)

    def _check(self, check: AcceptanceCheck) -> None:
        icon, color = (
            ("check_circle", "positive") if check.held else ("cancel", "negative")
        )
        with ui.row().classes("w-full items-center no-wrap gap-2"):
            ui.icon(icon, color=color)
            ui.label(check.name).classes("text-sm")
            ui.label(check.got).classes("text-sm rt-value")
            if check.wanted:
                ui.label(f"wanted {check.wanted}").classes("text-sm opacity-70")
            if not check.held or check.reason:
                ui.label(check.reason or "no reason is written").classes(
                    "text-sm italic ellipsis grow"
                )
                ui.button(icon="edit", on_click=partial(self._ask, check.name)).props(
                    "flat dense round size=sm"
                ).tooltip("Why it is borne").mark(f"reason-{check.name}")

    def _ask(self, name: str) -> None:
        ask_reason(f"{name}: why is it borne?", partial(self.bear, name))

    def bear(self, name: str, reason: str) -> None:
        """Write the reason for a check that does not hold."""
        self.session.edit(
            f"reason for {name}", edits.put(("report", "reasons", name), reason)
        )

    @ui.refreshable_method
    def report(self) -> None:
        """The report in a frame."""
        path = self.session.path.with_name("report.html")
        if path.exists():
            stamp = path.stat().st_mtime_ns
            ui.element("iframe").props(f'src="{PAGE}?{stamp}" title="report"').classes(
                "w-full rt-report"
            ).style("height:calc(100vh - 140px)")
        else:
            ui.label("There is no report yet.").classes("text-sm opacity-70")

    def named(self) -> None:
        """Names of the test modes."""
        stage: CorrelateStage | None = self.session.stage("correlate")
        config = self.session.config
        if stage is None or config is None:
            return
        with inspector():
            heading("Names of test modes")
            for k, f in enumerate(stage.reference.elastic.frequencies.tolist()):
                name = config.study.names.get(str(k + 1), "")
                ui.input(f"{k + 1}: {f:.5g} Hz", value=name).props("dense").classes(
                    "w-full"
                ).on("change", lambda e, n=k + 1: self.name(n, str(e.args))).mark(
                    f"name-{k + 1}"
                )

    def name(self, number: int, text: str) -> None:
        """Name a test mode, from 1."""
        words = f"test mode {number}: {text or 'no name'}"
        change = edits.put(("study", "names", str(number)), text.strip() or None)
        self.session.edit(words, change)
