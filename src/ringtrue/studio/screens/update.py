"""Update: factors that are tried move frequencies and MAC at once; the run; the delivered deck."""

from __future__ import annotations

from functools import partial

import numpy as np
import plotly.graph_objects as go
from nicegui import ui

from ringtrue.api.trial import TrialModel
from ringtrue.core.parameters import Parameter
from ringtrue.errors import RingtrueError
from ringtrue.plots.style import axis, figure, log_axis
from ringtrue.plots.updating import convergence, path
from ringtrue.studio import edits, theme
from ringtrue.studio.screens.tried import Tried
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    diff_view,
    fact,
    frame,
    heading,
    inspector,
    nothing_yet,
    run_button,
    table,
)
from ringtrue.studio.work import Job
from ringtrue.study.results import SetResult, UncertaintyStage, UpdateStage

THROTTLE_S = 0.05  # between two positions of a slider that is dragged
TAIL = 14  # lines of progress


def build(session: StudioSession) -> None:
    """Fill the page."""
    if session.stage("correlate") is None:
        nothing_yet(session, "The updating follows from a correlation.", "correlate")
        return
    _UpdateScreen(session).build()


def _within(parameter: Parameter, factor: float) -> float:
    return min(max(factor, parameter.lower), parameter.upper)


class _UpdateScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.model: TrialModel | None = None
        self.factors: dict[str, float] = {}
        self.follows = Tried(session)
        self.sliders: dict[str, tuple[ui.slider, ui.label]] = {}
        self.live: tuple[ui.linear_progress, ui.column, ui.column] | None = None
        self.growing: ui.plotly | None = None
        self.drawn: list[dict[str, float]] = []

    def build(self) -> None:
        session = self.session
        with ui.column().classes("w-full gap-1 p-2"):
            with ui.row().classes("w-full items-center no-wrap gap-2"):
                self.sets()
                ui.space()
                run_button(session, "final", "Update")
            # all that follows a factor is seen at once: what is long scrolls in its own place
            with (
                ui.row()
                .classes("w-full no-wrap gap-3")
                .style("height:calc(100vh - 112px)")
            ):
                with ui.column().classes("w-2/5 h-full no-wrap gap-1"):
                    self.tried = ui.column().classes("w-full no-wrap gap-1 rt-long")
                    self.follows.objective()
                    self.follows.shape()
                with ui.column().classes("grow h-full min-w-0 no-wrap gap-0"):
                    self.follows.table()
                    self.follows.figures()
            self.results()
        self.inspected()
        frame().follow(self._results_changed, session.on_results, session.on_theme)
        frame().follow(
            self.inspected, session.on_selection, session.on_work, session.on_documents
        )
        ui.timer(0.05, self._open, once=True)

    async def _results_changed(self) -> None:
        self.sets.refresh()
        self.results.refresh()
        self.inspected()
        await self._open()

    async def _open(self) -> None:
        """Make the reduced model where it is not known, then its sliders."""
        self.tried.clear()
        with self.tried, ui.row().classes("items-center gap-2"):
            ui.spinner(size="sm")
            ui.label("Reduced model over the candidates").classes("text-sm")
        try:
            self.model = await self.session.trial_model()
        except RingtrueError as e:
            if not self.tried.is_deleted:
                self.tried.clear()
                with self.tried:
                    ui.label(str(e)).classes("text-sm")
            return
        # the page was left meanwhile
        if self.model is not None and not self.tried.is_deleted:
            self._rows()
            self.put(self.factors)

    # --- what is tried

    def _rows(self) -> None:
        assert self.model is not None
        self.tried.clear()
        self.sliders.clear()
        with self.tried:
            heading("Factors, updated over initial")
            for parameter in self.model.parameters.parameters:
                self._slider(parameter)
            with ui.row().classes("gap-1"):
                deck = ui.button("Deck", on_click=partial(self.put, {})).props(
                    "dense flat no-caps"
                )
                deck.tooltip("All factors 1").mark("reset")
                if self.update is not None:
                    best = self.update.best.factors
                    ui.button("Updated", on_click=partial(self.put, best)).props(
                        "dense flat no-caps"
                    ).tooltip("As the chosen set of the updating ends").mark("updated")

    def _slider(self, parameter: Parameter) -> None:
        """A factor between its bounds, by its logarithm."""
        name = parameter.name
        low, high = np.log(parameter.lower), np.log(parameter.upper)
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.label(name).classes(
                "text-sm w-28 shrink-0 ellipsis cursor-pointer"
            ).tooltip(name).on("click", partial(self.session.select, region=name))
            slider = ui.slider(
                min=low, max=high, step=(high - low) / 400, value=0.0
            ).props("dense")
            slider.on(
                "update:model-value",
                lambda e, n=name: self.try_factor(n, float(np.exp(e.args))),
                throttle=THROTTLE_S,
                leading_events=True,
            ).mark(f"factor-{name}")
            value = ui.label("1.000").classes("text-sm rt-value w-12 text-right")
        words = f"{parameter.lower:g} to {parameter.upper:g}"
        if name in (known := self._intervals()):
            low_end, high_end = known[name]
            words += f"; interval {low_end:.4f} to {high_end:.4f}"
        ui.label(words).classes("text-xs opacity-60 rt-value w-full text-right -mt-2")
        self.sliders[name] = (slider, value)

    def try_factor(self, name: str, factor: float) -> None:
        """Put one factor, within its bounds, and draw what follows."""
        assert self.model is not None
        at = self.model.parameters.names.index(name)
        self.factors[name] = _within(self.model.parameters.parameters[at], factor)
        self.sliders[name][1].text = f"{self.factors[name]:.3f}"
        self._draw()

    def put(self, factors: dict[str, float]) -> None:
        """Put all factors, within their bounds; those that are not named have 1."""
        assert self.model is not None
        every = self.model.parameters.parameters
        self.factors = {p.name: _within(p, factors.get(p.name, 1.0)) for p in every}
        for name, (slider, value) in self.sliders.items():
            slider.value = float(np.log(self.factors[name]))
            value.text = f"{self.factors[name]:.3f}"
        self._draw()

    def _draw(self) -> None:
        if self.model is not None:
            self.follows.show(self.model, self.factors)

    # --- what was run

    @property
    def update(self) -> UpdateStage | None:
        """The stored updating."""
        found: UpdateStage | None = self.session.stage("update")
        return found

    @ui.refreshable_method
    def sets(self) -> None:
        """The chosen set in a line."""
        if self.update is None:
            ui.label("Not updated yet: try factors, then run.").classes(
                "text-sm opacity-70"
            )
            return
        best = self.update.best
        ui.label(f"{best.name}: {best.outcome.verdict}").classes("text-sm")
        ui.label(f"mean |Δf| {best.fit.mean_deviation:.2f} %").classes(
            "text-sm rt-value"
        )

    @ui.refreshable_method
    def results(self) -> None:
        """Parameters, sets and the objective, and the delivered deck."""
        found = self.update
        if found is None:
            return
        dark = self.session.dark
        with ui.tabs().props("dense no-caps align=left") as tabs:
            names = ("Parameters", "Objective", "Sets", "Delivered deck")
            each = [ui.tab(name) for name in names]
        with ui.tab_panels(tabs, value=each[0]).classes("w-full"):
            with ui.tab_panel(each[0]).classes("q-pa-none"):
                table(PARAMETERS, self._parameter_rows(found.best)).mark("parameters")
            with ui.tab_panel(each[1]).classes("q-pa-none"):
                ui.plotly(
                    theme.drawn(convergence(found.sets, found.chosen), dark=dark)
                ).classes("w-full").style("height:300px")
                ui.plotly(theme.drawn(path(found.best), dark=dark)).classes(
                    "w-full"
                ).style("height:320px")
            with ui.tab_panel(each[2]).classes("q-pa-none"):
                table(SETS, _set_rows(found)).mark("sets")
                ui.label(found.why).classes("text-sm q-mt-sm")
            with ui.tab_panel(each[3]).classes("q-pa-none"):
                if (
                    self.session.stage("final") is not None
                    and self.session.study is not None
                ):
                    diff_view(self.session.study.deck_diff)
                else:
                    ui.label("No deck is delivered yet.").classes("text-sm opacity-70")

    def _intervals(self) -> dict[str, tuple[float, float]]:
        """Of the factors that were updated, where they are stored."""
        known: UncertaintyStage | None = self.session.stage("uncertainty")
        if known is None:
            return {}
        p = known.posterior
        each = zip(p.parameters.names, p.interval.tolist(), strict=True)
        return {name: (low, high) for name, (low, high) in each}

    def _parameter_rows(self, best: SetResult) -> list[dict[str, object]]:
        intervals = self._intervals()
        rows: list[dict[str, object]] = []
        for k, name in enumerate(best.parameters):
            low, high = intervals.get(name, (np.nan, np.nan))
            rows.append(
                {
                    "id": name,
                    "name": name,
                    "factor": f"{best.factor[k]:.4f}",
                    "std": f"{100 * best.std[k]:.2f}",
                    "interval": f"{low:.4f} to {high:.4f}" if np.isfinite(low) else "",
                    "bounds": f"{best.bounds[k, 0]:g} to {best.bounds[k, 1]:g}",
                    "ratio": f"{best.identifiability[k]:.3f}",
                }
            )
        return rows

    # --- the inspector

    def inspected(self) -> None:
        """The run while there is one, else the selected candidate with its bounds."""
        job = self.session.work.job
        if job is not None and job.running:
            self._running(job)
            return
        self.live = self.growing = None
        with inspector():
            self._candidate()

    def _running(self, job: Job) -> None:
        """How far the run is, J and the factors so far; the figure stays while it grows."""
        if self.live is None:
            with inspector():
                heading("Run")
                bar = ui.linear_progress(show_value=False).props("instant-feedback")
                place = ui.column().classes("w-full")
                self.live = bar, place, ui.column().classes("w-full gap-0 rt-mono")
        bar, place, lines = self.live
        bar.value = job.fraction
        if job.steps and job.steps is not self.drawn:
            self.drawn = job.steps
            spec = theme.drawn(_live(job.steps), dark=self.session.dark, tools=False)
            if self.growing is not None:
                self.growing.update_figure(spec)
            else:
                with place:
                    self.growing = (
                        ui.plotly(spec).classes("w-full").style("height:300px")
                    )
        lines.clear()
        with lines:
            for line in job.lines[-TAIL:]:
                ui.label(line)

    def _candidate(self) -> None:
        config = self.session.config
        candidates = config.candidate if config is not None else []
        names = [c.name for c in candidates]
        heading("Candidate")
        if self.session.selection.region not in names:
            ui.label("Select the name of a factor.").classes("text-sm opacity-70")
            return
        at = names.index(self.session.selection.region)
        candidate = candidates[at]
        fact("Name", candidate.name)
        for target in candidate.targets:
            ui.label(target).classes("rt-mono")
        fact("Prior standard deviation", f"{candidate.std:g}")
        for key in ("lower", "upper"):
            ui.number(
                f"{key.capitalize()} bound", value=getattr(candidate, key), step=0.05
            ).props("dense outlined").classes("w-full").on(
                "change",
                lambda e, k=key: self._set_bound(at, candidate.name, k, e.args),
            ).mark(f"bound-{key}")

    def _set_bound(self, at: int, name: str, key: str, value: object) -> None:
        if value in ("", None):  # an emptied field: the bound stays
            self.inspected()
            return
        words = f"{key} bound of {name}"
        self.session.edit(
            words, edits.put(("candidate", str(at), key), float(str(value)))
        )


def _live(steps: list[dict[str, float]]) -> go.Figure:
    """J and, below it, the factors over the iterations of a run."""
    fig = figure(
        300,
        xaxis=axis("Iteration", anchor="y2", rangemode="tozero"),
        yaxis=log_axis("J", domain=[0.56, 1]),
        yaxis2=axis("Factor", domain=[0, 0.46]),
        margin={"l": 44, "r": 6, "t": 8, "b": 40},
        showlegend=False,
    )
    for name in steps[-1]:
        on = "y" if name == "J" else "y2"
        fig.add_scatter(
            y=[s[name] for s in steps], name=name, yaxis=on, mode="lines+markers"
        )
    return fig


PARAMETERS = {
    "name": "parameter",
    "factor": "factor",
    "std": "σ, %",
    "interval": "interval",
    "bounds": "bounds",
    "ratio": "posterior over prior",
}
SETS = {
    "name": "set",
    "count": "parameters",
    "outcome": "outcome",
    "mean": "mean |Δf|, %",
    "max": "largest |Δf|, %",
    "left": "left out, %",
    "criterion": "AICc",
}


def _set_rows(found: UpdateStage) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for k, s in enumerate(found.sets):
        chosen = " (chosen)" if k == found.chosen else ""
        rows.append(
            {
                "id": s.name,
                "name": s.name + chosen,
                "count": len(s.parameters),
                "outcome": s.outcome.verdict,
                "mean": f"{s.fit.mean_deviation:.3f}",
                "max": f"{s.fit.max_deviation:.2f}",
                "left": f"{s.fit.mean_deviation_left_out:.3f}",
                "criterion": f"{s.fit.criterion:.1f}",
            }
        )
    return rows
