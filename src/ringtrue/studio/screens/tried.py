"""What follows from factors that are tried: modes and MAC, J, one shape and one FRF."""

from __future__ import annotations

from typing import Any

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from ringtrue.api.trial import Trial, TrialModel
from ringtrue.core.signals import FrfSet
from ringtrue.plots import signals as figures
from ringtrue.plots.correlation import table_matrix
from ringtrue.plots.signals import frf_unit
from ringtrue.studio import theme
from ringtrue.studio.screens.frfs import one_frf
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import SELECT, fact, frame, heading, output_select, table
from ringtrue.studio.views import ShapeView
from ringtrue.study.results import CorrelateStage, IdentifyStage

MODES = {
    "test": "test, Hz",
    "fe": "FE, Hz",
    "df": "Δf, %",
    "mac": "MAC, %",
    "subspace": "subspace MAC, %",
}


class Tried:
    """The panels of one page.

    Parameters
    ----------
    session : StudioSession
    """

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.model: TrialModel | None = None
        self.factors: dict[str, float] = {}
        self.trial: Trial | None = None
        self.input = ""

    # --- the panels

    def table(self) -> None:
        """The pairs; a row selects its mode."""
        self.modes = table(MODES, []).on("rowClick", self._row).mark("modes")
        self.modes.classes("rt-long")

    def shape(self) -> None:
        """The shape of the selected mode."""
        self.name = ui.label().classes("rt-head mt-2").mark("shape-name")
        with ui.element("div").classes("w-full rt-rest"):
            self.view = ShapeView(self.session)
        frame().keys["play"] = self.view.toggle
        frame().follow(self._selected, self.session.on_selection)

    def figures(self) -> None:
        """The matrix and the FRF."""
        heading("MAC")
        self.matrix = ui.plotly({}).classes("w-full rt-rest")
        self._frf_panel()

    def objective(self) -> None:
        """J of the trial and of the deck, where the sliders are."""
        heading("Objective of the updating")
        with ui.column().classes("w-full gap-0").mark("objective"):
            self.cost = fact("J of the trial")
            self.cost_of_deck = fact("J of the deck")
            self.deviation = fact("Mean |Δf|")

    @property
    def measured(self) -> FrfSet | None:
        """The FRFs of the test."""
        stage: IdentifyStage | None = self.session.stage("identify")
        return stage.frfs if stage is not None else None

    @property
    def output(self) -> str:
        """The selected channel, or at first the driving point."""
        there = self._ids()[0]
        chosen = self.session.selection.channel
        if chosen in there:
            return chosen
        return self.input if self.input in there else next(iter(there), "")

    def _ids(self) -> tuple[list[str], list[str]]:
        """Outputs and inputs on the sheet."""
        frfs = self.measured
        stage: IdentifyStage | None = self.session.stage("identify")
        if frfs is None or stage is None:
            return [], []
        known = set(stage.test.channels)
        sides = (frfs.outputs, frfs.inputs)
        outputs, inputs = ([c.id for c in side if c.id in known] for side in sides)
        return outputs, inputs

    def _frf_panel(self) -> None:
        outputs, inputs = self._ids()
        self.plot: ui.plotly | None = None
        if not (outputs and inputs):
            return
        self.input = self.input if self.input in inputs else inputs[0]
        with ui.row().classes("w-full items-center no-wrap gap-2"):
            heading("FRF")
            ui.space()
            self.outputs = output_select(self.session, outputs, self.output).mark(
                "trial-output"
            )
            ui.select(
                inputs,
                value=self.input,
                label="input",
                on_change=lambda e: self._load(e.value),
            ).props(SELECT).classes("w-36").mark("trial-input")
        self.plot = (
            ui.plotly({})
            .classes("w-full rt-rest")
            .style("flex-grow:1.4")
            .mark("trial-frf")
        )

    def _load(self, input_: str) -> None:
        self.input = input_
        self._draw_frf()

    # --- what is drawn

    def show(self, model: TrialModel, factors: dict[str, float]) -> None:
        """Draw what follows from some factors."""
        if self.model is not model:
            self.cost_of_deck.text = f"{model.objective({}):.4g}"
        self.trial = model.at(factors)
        self.model, self.factors = model, factors
        self.modes.rows = _mode_rows(self.trial)
        spec = theme.drawn(
            table_matrix(self.trial.pairs), dark=self.session.dark, tools=False
        )
        self.matrix.update_figure(spec)
        self._draw_objective()
        self._draw_shape()
        self._draw_frf()

    def _draw_objective(self) -> None:
        assert self.model is not None
        assert self.trial is not None
        deviation = np.abs(self.trial.pairs.deviation_percent)
        self.cost.text = f"{self.model.objective(self.factors):.4g}"
        self.deviation.text = (
            f"{float(deviation.mean()):.2f} %" if deviation.size else "no pair"
        )

    def _selected(self) -> None:
        if self.trial is None:
            return
        self._draw_shape()
        self._draw_frf()

    def _pair(self) -> tuple[int, int] | None:
        """The selected test mode and its FE mode in the trial, from 0; the first without one."""
        assert self.trial is not None
        pairing = self.trial.pairs.pairing
        chosen = self.session.selection.pair
        wanted = chosen[0] if chosen is not None else self.session.selection.mode
        there = (
            np.flatnonzero(pairing.a == wanted) if wanted is not None else pairing.a[:0]
        )
        if there.size:
            return int(pairing.a[there[0]]), int(pairing.b[there[0]])
        shape = self.trial.pairs.mac.shape
        if chosen is not None and chosen[0] < shape[0] and chosen[1] < shape[1]:
            return chosen
        return (int(pairing.a[0]), int(pairing.b[0])) if pairing.a.size else None

    def _draw_shape(self) -> None:
        assert self.model is not None
        assert self.trial is not None
        pair = self._pair()
        stage: CorrelateStage | None = self.session.stage("correlate")
        if pair is None or stage is None:
            return
        test, fe = pair
        self.name.text = (
            f"Test mode {test + 1}: {stage.reference.elastic.frequencies[test]:.4g} Hz; "
            f"FE mode {fe + 1}: {self.trial.modes.frequencies[fe]:.4g} Hz"
        )
        shape = self.model.shape(self.factors, fe)
        self.view.tried(shape, (self.trial.modes, fe), (stage.reference.elastic, test))

    def _draw_frf(self) -> None:
        measured = self.measured
        if self.plot is None or self.model is None or measured is None:
            return
        output = self.output
        self.outputs.value = output
        trial = self.model.frf(self.factors, output, self.input)
        own = one_frf(measured, output, self.input)
        curves = (
            figures.Curve("test", measured.freqs, own),
            figures.Curve("trial", trial.freqs, trial.data[:, 0, 0]),
        )
        stage: IdentifyStage | None = self.session.stage("identify")
        modes = (
            stage.hammer.modes.frequencies if stage and stage.hammer else np.empty(0)
        )
        ends = (float(trial.freqs[0]), float(trial.freqs[-1]))
        marks = figures.Marks(modes, ends, self.session.selection.frequency)
        figure = figures.frf(curves, frf_unit(measured), marks)
        spec: dict[str, Any] = theme.drawn(figure, dark=self.session.dark, tools=False)
        spec["layout"]["uirevision"] = f"{output} {self.input}"
        self.plot.update_figure(spec)

    def _row(self, event: GenericEventArguments) -> None:
        """A row of the table: its mode is selected on all screens."""
        assert self.trial is not None
        test = int(event.args[1]["id"]) - 1
        pairing = self.trial.pairs.pairing
        fe = int(pairing.b[np.flatnonzero(pairing.a == test)[0]])
        hz = float(self.trial.pairs.all_test_hz[test])
        self.session.select(pair=(test, fe), mode=test, frequency=hz, order=0)


def _mode_rows(trial: Trial) -> list[dict[str, object]]:
    return [
        {
            "id": r.test,
            "test": f"{r.test}: {r.test_hz:.4f}",
            "fe": f"{r.fe}: {r.fe_hz:.4f}",
            "df": f"{r.deviation_percent:+.2f}",
            "mac": f"{r.mac_percent:.1f}",
            "subspace": f"{r.subspace_mac_percent:.1f}",
        }
        for r in trial.pairs.rows()
    ]
