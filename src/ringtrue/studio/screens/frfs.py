"""FRFs: any output and input of the test, of both models and of the fit; FRAC over the channels."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui
from nicegui.events import GenericEventArguments

from ringtrue.api.studies import Stage
from ringtrue.core.signals import FrfSet
from ringtrue.errors import RingtrueError
from ringtrue.plots import signals as figures
from ringtrue.plots.signals import frf_unit
from ringtrue.studio import theme
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    SELECT,
    fact,
    frame,
    heading,
    inspector,
    nothing_yet,
    on_click,
    output_select,
)
from ringtrue.study.evidence import frf_band
from ringtrue.study.results import IdentifyStage
from ringtrue.study.synthesis import FrfFit, compared

STATES: dict[Stage, str] = {"initial": "initial model", "final": "final model"}
PHASE, PARTS = "magnitude and phase", "real and imaginary"
TEST, FIT = "test", "fit of the test"


def build(session: StudioSession) -> None:
    """Fill the page."""
    stage: IdentifyStage | None = session.stage("identify")
    if stage is None or stage.frfs is None:
        nothing_yet(
            session,
            "No FRFs are stored: the study has none, or was not run.",
            "identify",
        )
        return
    _FrfsScreen(session, stage, stage.frfs).build()


class _FrfsScreen:
    """The screen of one page."""

    def __init__(
        self, session: StudioSession, stage: IdentifyStage, test: FrfSet
    ) -> None:
        self.session = session
        self.stage = stage
        self.sets: dict[str, FrfSet] = {TEST: test}
        self.compared: dict[str, Any] = {}
        self.problem = ""
        self.input = test.inputs[0].id
        self.parts = False
        there = [name for name in STATES if self._run_as_far(name)]
        self.state: Stage | None = there[-1] if there else None

    def _run_as_far(self, name: Stage) -> bool:
        return (
            self.session.stage("final" if name == "final" else "correlate") is not None
        )

    @property
    def test(self) -> FrfSet:
        """The measured FRFs."""
        return self.sets[TEST]

    @property
    def output(self) -> str:
        """The selected channel, or at first the driving point."""
        there = [c.id for c in self.test.outputs]
        chosen = self.session.selection.channel
        if chosen in there:
            return chosen
        return self.input if self.input in there else there[0]

    def build(self) -> None:
        session = self.session
        with ui.column().classes("w-full gap-1 p-2"):
            self._bar()
            self.plot = ui.plotly(self._figure()).classes("w-full").style("height:60vh")
            on_click(self.plot, self._clicked).mark("frf")
            self.map()
        self.inspected()
        keys = frame().keys
        keys["next"] = partial(self._step, 1)
        keys["previous"] = partial(self._step, -1)
        frame().follow(self._update, session.on_selection, session.on_theme)
        frame().follow(frame().rebuild, session.on_results)
        ui.timer(0, self._computed, once=True)

    async def _computed(self) -> None:
        """The fit and the FRFs of the models, each shown when it is there."""
        session = self.session
        hammer, study = self.stage.hammer, session.study
        config = session.config
        if hammer is not None and hammer.diagrams:
            fitted = await run.io_bound(_fit, hammer, self.test)
            if self.plot.is_deleted:
                return
            if fitted is not None:
                self.sets[FIT] = fitted
                self._update()
        for name in STATES:
            if study is None or config is None or not self._run_as_far(name):
                continue
            try:
                found = await run.io_bound(study.model_frfs, name)
            except (RingtrueError, OSError) as e:
                self.problem = str(e)
                self._update()
                return
            if found is None or self.plot.is_deleted:
                return
            self.sets[STATES[name]] = found
            self.compared[name] = compared(self.stage, config, found)
            self._update()

    def _update(self) -> None:
        self.plot.update_figure(self._figure())
        self.map.refresh()
        self.inspected()
        self.outputs.value = self.output

    def _show(self, **change: Any) -> None:
        for name, value in change.items():
            setattr(self, name, value)
        self._update()

    def _bar(self) -> None:
        with ui.row().classes("w-full items-center no-wrap gap-2"):
            outputs = [c.id for c in self.test.outputs]
            self.outputs = output_select(self.session, outputs, self.output).mark(
                "output"
            )
            ui.select(
                [c.id for c in self.test.inputs],
                value=self.input,
                label="input",
                on_change=lambda e: self._show(input=e.value),
            ).props(SELECT).classes("w-36").mark("input")
            ui.toggle(
                [PHASE, PARTS],
                value=PHASE,
                on_change=lambda e: self._show(parts=e.value == PARTS),
            ).props("dense no-caps unelevated").mark("kind")

    def _figure(self) -> dict[str, Any]:
        curves = []
        for name, frfs in self.sets.items():
            value = one_frf(frfs, self.output, self.input)
            if value is not None:
                curves.append(figures.Curve(name, frfs.freqs, value))
        config = self.session.config
        hammer = self.stage.hammer
        marks = figures.Marks(
            hammer.modes.frequencies if hammer is not None else np.empty(0),
            frf_band(self.stage, config) if config is not None else None,
            self.session.selection.frequency,
        )
        figure = figures.frf(curves, frf_unit(self.test), marks, parts=self.parts)
        spec = theme.drawn(figure, dark=self.session.dark)
        spec["layout"]["uirevision"] = f"{self.output} {self.input} {self.parts}"
        return spec

    @ui.refreshable_method
    def map(self) -> None:
        """FRAC over the channels; a click shows that FRF."""
        found = self.compared.get(self.state or "")
        with ui.row().classes("w-full items-center gap-3"):
            heading("FRAC with the")
            ui.toggle(
                {k: v for k, v in STATES.items() if self._run_as_far(k)},
                value=self.state,
                on_change=lambda e: self._show(state=e.value),
            ).props("dense no-caps unelevated").mark("state")
            if self.problem:
                ui.label(self.problem).classes("text-xs text-negative")
            elif self.state and self.state not in self.compared:
                ui.spinner()
        if not self.state:
            ui.label("No model was correlated yet.").classes("text-sm opacity-70")
        if found is None:
            return
        figure = figures.frac_map(found[0], (self.output, self.input))
        spec = theme.drawn(figure, dark=self.session.dark, tools=False)
        height = 110 + 24 * len(self.test.inputs)
        plot = ui.plotly(spec).classes("w-full").style(f"height:{height}px")
        on_click(plot, self._map_clicked).mark("frac")

    def _map_clicked(self, event: GenericEventArguments) -> None:
        self.choose(str(event.args["x"]), str(event.args["y"]))

    def choose(self, output: str, input_: str) -> None:
        """Show one FRF."""
        self.input = input_
        if output == self.output:
            self._update()
        self.session.select(channel=output)

    def _clicked(self, event: GenericEventArguments) -> None:
        """Select the frequency, and the mode where one is near."""
        hammer = self.stage.hammer
        f = float(event.args["x"])
        mode = None
        if hammer is not None and len(hammer):
            there = hammer.modes.frequencies
            near = int(np.argmin(np.abs(there - f)))
            if abs(there[near] / f - 1) < 0.02:
                mode, f = near, float(there[near])
        self.session.select(frequency=f, mode=mode, order=None)

    def _step(self, by: int) -> None:
        there = [c.id for c in self.test.outputs]
        self.session.select(channel=there[(there.index(self.output) + by) % len(there)])

    def inspected(self) -> None:
        """What the measures say of the FRF that is shown."""
        with inspector():
            heading(f"{self.output} / {self.input}")
            value = one_frf(self.test, self.output, self.input)
            if value is None:
                return
            i = [c.id for c in self.test.outputs].index(self.output)
            j = [c.id for c in self.test.inputs].index(self.input)
            coherence = self.test.coherence[:, i, j]
            averages = self.test.averages[j]
            fact("Kind", self.test.kind)
            if np.isfinite(averages):
                fact("Averages", f"{averages:.0f}")
            if np.isfinite(coherence).any():
                fact("Coherence, median", f"{np.nanmedian(coherence):.3f}")
            errors = self.stage.synthesis_error
            if errors.size:
                fact("Error of the fit", f"{100 * errors[i, j]:.2g} %")
            for name, title in STATES.items():
                found = self.compared.get(name)
                if found is None:
                    continue
                comparison, band = found
                if (
                    self.output not in comparison.outputs
                    or self.input not in comparison.inputs
                ):
                    continue
                a, b = (
                    comparison.outputs.index(self.output),
                    comparison.inputs.index(self.input),
                )
                heading(title)
                fact("FRAC", f"{comparison.frac[a, b]:.3f}")
                fact("Level difference", f"{comparison.deviation[a, b]:.2f} dB")
                fact("Band", f"{band[0]:.4g} to {band[1]:.4g} Hz")


def one_frf(frfs: FrfSet, output: str, input_: str) -> Any:
    """One FRF, (f,); None where there is none."""
    outputs, inputs = ([c.id for c in side] for side in (frfs.outputs, frfs.inputs))
    if output not in outputs or input_ not in inputs:
        return None
    return frfs.data[:, outputs.index(output), inputs.index(input_)]


def _fit(hammer: Any, test: FrfSet) -> FrfSet:
    """The FRFs of the modes of the last run."""
    return FrfFit.of(hammer, test).at(hammer, None)
