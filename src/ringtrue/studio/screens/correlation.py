"""Correlation: the matrix of shapes, pairs locked or forbidden with a reason, the gates."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go
from nicegui import ui
from nicegui.events import GenericEventArguments

from ringtrue.core.display import number
from ringtrue.plots.correlation import labels, orthogonality, table_matrix
from ringtrue.studio import edits, theme
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    SELECT,
    ask_reason,
    fact,
    frame,
    heading,
    inspector,
    nothing_yet,
    on_click,
    run_button,
    table,
)
from ringtrue.studio.views import ShapeView
from ringtrue.study.results import CompareStage, CorrelateStage, Evidence, FinalStage

if TYPE_CHECKING:
    from ringtrue.correlation.measures import CompleteCorrelation
    from ringtrue.correlation.table import CorrelationTable

BOTH_TESTS = "ambient and hammer"
DIFFERENCE = "difference"
MATRICES = ("MAC", "subspace MAC")  # whose cells can be selected
DECISIONS = ("lock", "forbid")


def states(
    session: StudioSession,
) -> dict[str, tuple[CorrelationTable, Evidence | None]]:
    """The correlations that are stored, by what is compared."""
    found: dict[str, tuple[CorrelationTable, Evidence | None]] = {}
    stage: CorrelateStage | None = session.stage("correlate")
    if stage is not None:
        found["initial"] = (stage.initial, stage.evidence_initial)
        if stage.remodelling is not None:
            found["remodelled"] = (stage.remodelled, stage.evidence)
    final: FinalStage | None = session.stage("final")
    if final is not None:
        found["final"] = (final.table, final.evidence)
    compared: CompareStage | None = session.stage("compare")
    if compared is not None:
        found[BOTH_TESTS] = (compared.table, compared.evidence)
    return found


def build(session: StudioSession) -> None:
    """Fill the page."""
    if not states(session):
        nothing_yet(session, "No correlation is stored.", "correlate")
        return
    _CorrelationScreen(session).build()


class _CorrelationScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.there = list(states(session))
        self.state = "final" if "final" in self.there else self.there[0]
        self.kind = "MAC"
        self.arrangement = "overlaid"
        self.shown: list[ShapeView] = []

    @property
    def table(self) -> CorrelationTable:
        """The correlation that is shown."""
        return states(self.session)[self.state][0]

    @property
    def measures(self) -> CompleteCorrelation | None:
        """What it rests on."""
        evidence = states(self.session)[self.state][1]
        return None if evidence is None else evidence.measures

    @property
    def kinds(self) -> list[str]:
        """The matrices that there are."""
        checks = self.measures.checks if self.measures is not None else ()
        return [*MATRICES, *(check.name for check in checks)]

    def build(self) -> None:
        session = self.session
        with ui.column().classes("w-full gap-1 p-2"):
            self._bar()
            with ui.row().classes("w-full no-wrap gap-3 items-start"):
                with ui.column().classes("grow min-w-0 gap-0"):
                    self.plot = (
                        ui.plotly(self._figure()).classes("w-full").style("height:58vh")
                    )
                    on_click(self.plot, self._clicked).mark("matrix")
                self._shapes()
            self.pairs()
        self.inspected()
        keys = frame().keys
        keys["next"] = partial(self._step, 1)
        keys["previous"] = partial(self._step, -1)
        keys["accept"] = partial(self._ask, "lock")
        keys["reject"] = partial(self._ask, "forbid")
        keys["play"] = self._toggle
        frame().follow(
            self._update, session.on_documents, session.on_results, session.on_theme
        )
        frame().follow(self._selected, session.on_selection)

    def _update(self) -> None:
        if list(states(self.session)) != self.there:  # a run has begun or ended
            frame().rebuild()
            return
        self.plot.update_figure(self._figure())
        self.pairs.refresh()
        self._show_pair()
        self.inspected()

    def _selected(self) -> None:
        """Another cell: its shapes first."""
        self._show_pair()
        outlined = self._outlined()
        self.plot.figure["layout"]["shapes"] = outlined
        self.plot.run_plot_method("relayout", {"shapes": outlined})
        self.cell.refresh()

    def _show(self, **change: str) -> None:
        for name, value in change.items():
            setattr(self, name, value)
        self._update()

    def _bar(self) -> None:
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.toggle(
                self.there,
                value=self.state,
                on_change=lambda e: self._show(state=e.value),
            ).props("dense no-caps unelevated").mark("state")
            ui.select(
                self.kinds,
                value=self.kind,
                on_change=lambda e: self._show(kind=e.value),
            ).props(SELECT).classes("min-w-40").mark("kind")
            ui.space()
            run_button(self.session, "correlate", "Correlate anew")

    def _figure(self) -> dict[str, Any]:
        found = self.table
        figure: go.Figure
        checks = self.measures.checks if self.measures is not None else ()
        check = next((c for c in checks if c.name == self.kind), None)
        if check is not None:
            figure = orthogonality(check, found)
        else:
            figure = table_matrix(found, subspace=self.kind == "subspace MAC")
        self.axes = list(figure.data[0].x), list(figure.data[0].y)
        drawn = theme.drawn(figure, dark=self.session.dark, tools=False)
        self.outlines = list(drawn["layout"].get("shapes", ()))
        drawn["layout"]["shapes"] = self._outlined()
        return drawn

    def _outlined(self) -> list[dict[str, Any]]:
        """What is outlined in the matrix, and the selected cell."""
        pair = self.session.selection.pair
        if pair is None or self.kind not in MATRICES:
            return self.outlines
        column, row = self._label(1, pair[1]), self._label(0, pair[0])
        if column not in self.axes[0] or row not in self.axes[1]:
            return self.outlines
        x, y = self.axes[0].index(column), self.axes[1].index(row)
        edges = {"x0": x - 0.5, "x1": x + 0.5, "y0": y - 0.5, "y1": y + 0.5}
        line = {"width": 3, "color": "#2f9e44"}
        return [*self.outlines, {"type": "rect", **edges, "line": line}]

    def _label(self, side: int, k: int) -> str:
        hz = (self.table.all_test_hz, self.table.all_fe_hz)[side]
        return labels(hz)[k] if k < hz.size else ""

    def _clicked(self, event: GenericEventArguments) -> None:
        if self.kind not in MATRICES:
            return
        test = labels(self.table.all_test_hz).index(str(event.args["y"]))
        fe = labels(self.table.all_fe_hz).index(str(event.args["x"]))
        self.select(test, fe)

    def select(self, test: int, fe: int) -> None:
        """Select a cell of the matrix: a test mode and an FE mode, from 0."""
        hz = float(self.table.all_test_hz[test])
        self.session.select(pair=(test, fe), mode=test, frequency=hz, order=0)

    def _step(self, by: int) -> None:
        a, b = self.table.pairing.a, self.table.pairing.b
        if not a.size:
            return
        pair = self.session.selection.pair
        now = (
            np.flatnonzero(a == pair[0])
            if pair is not None
            else np.zeros(0, dtype=np.int64)
        )
        k = (int(now[0]) + by) % a.size if now.size else 0
        self.select(int(a[k]), int(b[k]))

    def _shapes(self) -> None:
        """Both shapes of the selected cell, over each other or next to each other."""
        with ui.column().classes("w-2/5 gap-1").style("height:58vh"):
            ui.toggle(
                ["overlaid", "side by side", DIFFERENCE],
                value=self.arrangement,
                on_change=lambda e: self._arrange(e.value),
            ).props("dense no-caps unelevated size=sm").mark("arrangement")
            self.words = ui.label().classes("text-xs rt-value").mark("difference")
            self.views()

    def _toggle(self) -> None:
        for view in self.shown:
            view.toggle()

    def _arrange(self, arrangement: str) -> None:
        self.arrangement = arrangement
        self.views.refresh()

    @ui.refreshable_method
    def views(self) -> None:
        """The views, which stay while the selection changes."""
        parts = ("test", "model") if self.arrangement == "side by side" else ("both",)
        with ui.column().classes("w-full grow gap-1"):
            for part in parts:
                with ui.element("div").classes("w-full grow min-h-0"):
                    view = ShapeView(self.session, part, linked="pair")
                self.shown = [view] if part == parts[0] else [*self.shown, view]
        self._show_pair()

    def _show_pair(self) -> None:
        pair = self.session.selection.pair
        self.words.text = ""
        if pair is None or self.state == BOTH_TESTS:
            return
        for view in self.shown:
            if self.arrangement != DIFFERENCE:
                view.pair(self.state, pair)
            elif (found := view.difference(self.state, pair)) is not None:
                self.words.text = (
                    f"Test less FE: worst channel {found.worst}, {100 * found.largest:.1f} %; rms "
                    f"{100 * found.rms:.1f} % of the largest FE component. Drawn enlarged."
                )

    @ui.refreshable_method
    def pairs(self) -> None:
        """The pairs, and modes without one."""
        found = self.table
        rows: list[dict[str, object]] = [
            {
                "id": f"{r.test}:{r.fe}",
                "pair": f"{r.test}:{r.fe}",
                "test": f"{r.test_hz:.5g}",
                "fe": f"{r.fe_hz:.5g}",
                "df": f"{r.deviation_percent:+.2f}",
                "mac": f"{r.mac_percent:.1f}",
                "subspace": f"{r.subspace_mac_percent:.1f}",
                "used": "yes" if r.used else "left out",
            }
            for r in found.rows()
        ]
        one, two = found.names
        names = {
            "pair": "pair",
            "test": f"{one}, Hz",
            "fe": f"{two}, Hz",
            "df": "Δf, %",
            "mac": "MAC, %",
            "subspace": "subspace MAC, %",
            "used": "updating",
        }
        heading("Pairs")
        table(names, rows).on("rowClick", self._row).mark("pairs")
        without = [
            *zip(
                found.pairing.unpaired_a.tolist(), found.pairing.reasons_a, strict=True
            ),
        ]
        if without:
            heading(f"{one.capitalize()} modes without a pair")
            for k, why in without:
                hz = found.all_test_hz[k]
                ui.label(f"{k + 1}: {hz:.5g} Hz, {why}").classes("text-sm")

    def _row(self, event: GenericEventArguments) -> None:
        test, fe = str(event.args[1]["id"]).split(":")
        self.select(int(test) - 1, int(fe) - 1)

    # --- decisions

    def inspected(self) -> None:
        """The selected cell, the decisions of the user, the gates."""
        with inspector():
            self.cell()
            self._decisions()
            self._gates()

    @ui.refreshable_method
    def cell(self) -> None:
        """The selected cell and what can be decided of it."""
        pair = self.session.selection.pair
        found = self.table
        heading("Cell")
        if (
            pair is None
            or pair[0] >= found.mac.shape[0]
            or pair[1] >= found.mac.shape[1]
        ):
            ui.label("Select a cell of the matrix.").classes("text-sm opacity-70")
            return
        test, fe = pair
        one, two = found.names
        fact(f"{one} mode {test + 1}", f"{found.all_test_hz[test]:.5g} Hz")
        fact(f"{two} mode {fe + 1}", f"{found.all_fe_hz[fe]:.5g} Hz")
        fact("MAC", f"{100 * found.mac[test, fe]:.1f} %")
        at = np.flatnonzero((found.pairing.a == test) & (found.pairing.b == fe))
        if at.size:
            k = int(at[0])
            fact("Δf", f"{found.deviation_percent[k]:+.2f} %")
            fact("Subspace MAC", f"{found.subspace_mac_percent[k]:.1f} %")
            fact("Paired", "yes")
        else:
            fact("Paired", "no")
        if self.state == BOTH_TESTS:
            return
        with ui.row().classes("gap-2 q-mt-sm"):
            ui.button("Lock", icon="lock", on_click=partial(self._ask, "lock")).props(
                "dense no-caps unelevated"
            ).mark("lock")
            ui.button(
                "Forbid", icon="block", on_click=partial(self._ask, "forbid")
            ).props("dense no-caps outline").mark("forbid")
        ui.label("FE modes are counted on the initial deck.").classes(
            "text-xs opacity-70"
        )

    def _ask(self, decision: str) -> None:
        pair = self.session.selection.pair
        if pair is None or self.state != "initial":
            ui.notify(
                "Select a cell of the initial deck: its modes are what study.toml names."
            )
            return
        words = f"{pair[0] + 1}:{pair[1] + 1}"
        title = f"{decision.capitalize()} the pair {words}"
        ask_reason(title, partial(self.decide, decision, words))

    def decide(self, decision: str, pair: str, reason: str) -> None:
        """Lock or forbid a pair."""
        self.session.edit(
            f"{decision} {pair}", edits.decide_pair(decision, pair, reason)
        )

    def _decisions(self) -> None:
        text = self.session.documents.text(self.session.documents.name)
        for decision in DECISIONS:
            decided = edits.reasons(text, decision)
            if decided:
                heading("Locked" if decision == "lock" else "Forbidden")
            for pair, reason in decided.items():
                with ui.row().classes("w-full items-center no-wrap gap-2"):
                    ui.label(pair).classes("rt-value text-sm")
                    ui.label(reason or "no reason").classes("text-xs opacity-70 grow")
                    ui.button(
                        icon="close", on_click=partial(self._release, decision, pair)
                    ).props("flat dense round size=sm").tooltip("Take it out")

    def _release(self, decision: str, pair: str) -> None:
        self.session.edit(
            f"{decision} {pair} taken out", edits.undecide_pair(decision, pair)
        )

    def _gates(self) -> None:
        config = self.session.config
        if config is None:
            return
        heading("Gates")
        gate = config.correlate.mac_gate
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.label("MAC").classes("text-sm w-20")
            slider = ui.slider(min=0.05, max=0.95, step=0.05, value=gate).props("label")
            slider.on(
                "change", lambda e: self._set_gate("mac_gate", float(e.args))
            ).mark("mac-gate")
            ui.label(f"{gate:.2f}").classes("text-sm rt-value w-12 text-right")
        wide = config.correlate.frequency_gate
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.label("frequency").classes("text-sm w-20")
            slider = ui.slider(min=0.05, max=1.0, step=0.05, value=wide or 0.4).props(
                "label"
            )
            slider.on(
                "change", lambda e: self._set_gate("frequency_gate", float(e.args))
            )
            ui.label("open" if wide is None else number(wide, 2)).classes(
                "text-sm rt-value w-12 text-right"
            )

    def _set_gate(self, name: str, value: float) -> None:
        self.session.edit(
            f"{name} {value:g}", edits.put(("correlate", name), round(value, 2))
        )
