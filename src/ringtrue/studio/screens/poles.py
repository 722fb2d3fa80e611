"""Poles: the stabilisation diagram, the modes that were found and the user's own choice."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from ringtrue.core.choice import SAME_MODE, Choice
from ringtrue.core.display import plus_minus
from ringtrue.io.choices import parse_choice
from ringtrue.plots.diagram import OTHERS, POLES, identification_figure
from ringtrue.studio import edits, theme
from ringtrue.studio.screens.synthesis import Synthesis
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
from ringtrue.studio.shown import evidence, nearest_pole, pole_shape, sources
from ringtrue.studio.views import ShapeView
from ringtrue.study.results import IdentifiedModes, IdentifyStage

PICK = {
    "symbol": "star",
    "size": 13,
    "color": "#e69f00",
    "line": {"width": 1, "color": "#7a5200"},
}
PICKED = "your pick"  # the name of its marks
# A mark of a pick or a mode that is drawn onto another one: plotly would take that for a zoom.
DRAWN = """(e) => {
  const own = (p) => p.data.name === '@PICKED@' || p.customdata !== undefined;
  const under = () => plot._hoverdata?.find(own);
  const plot = e.currentTarget, from = under(), { clientX, clientY } = e;
  if (!from || e.button) return;
  const ended = (up) => {
    const to = under();
    if (Math.hypot(up.clientX - clientX, up.clientY - clientY) <= 4) plot.emit('plotly_click', {});
    else if (to) emit([from.x, to.x]);
  };
  e.stopPropagation();
  addEventListener('mouseup', ended, { once: true, capture: true });
}"""
REJECT = {"symbol": "x-thin", "size": 13, "line": {"width": 2.5, "color": "#c0392b"}}


def build(session: StudioSession) -> None:
    """Fill the page."""
    stage: IdentifyStage | None = session.stage("identify")
    if not sources(stage):
        text = "No diagram is stored: the study has no records or FRFs, or was not run."
        nothing_yet(session, text, "identify")
        return
    _PolesScreen(session).build()


class _PolesScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.plot: ui.plotly | None = None
        self.view: ShapeView | None = None

    @property
    def record(self) -> str:
        """Whose diagram is shown."""
        there = sources(self.session.stage("identify"))
        wanted = self.session.selection.record
        return wanted if wanted in there else next(iter(there))

    @property
    def found(self) -> IdentifiedModes:
        """The poles and modes that are shown."""
        return sources(self.session.stage("identify"))[self.record]

    @property
    def choice(self) -> Choice:
        """The user's own choice, as far as it concerns the record."""
        name = self.session.choice_name
        text = self.session.documents.text(name)
        whole = parse_choice(text, name) if text else Choice()
        return whole.of(self.record) or Choice()

    def build(self) -> None:
        session = self.session
        with ui.column().classes("w-full gap-1 p-2"):
            self._bar()
            self.plot = ui.plotly(self._figure()).classes("w-full").style("height:50vh")
            on_click(self.plot, self._clicked).mark("diagram")
            self.plot.on("plotly_hover", self._hovered, ["points"], throttle=0.1)
            self.plot.on(
                "mousedown.capture",
                lambda e: self.ask_merge(e.args),
                js_handler=DRAWN.replace("@PICKED@", PICKED),
            )
            self.synthesis = Synthesis(
                session, lambda: (self.record, self.found, self.choice)
            )
            self.synthesis.build()
            with ui.row().classes("w-full no-wrap gap-4 items-start"):
                self.automatic()
                self.own()
        with inspector():
            with ui.element("div").classes("w-full").style("height:220px"):
                self.view = ShapeView(session, "test")
            self.about = ui.column().classes("w-full gap-1")
        self.inspected()
        keys = frame().keys
        keys["next"] = partial(self._step, 1)
        keys["previous"] = partial(self._step, -1)
        keys["accept"] = self._confirm
        keys["reject"] = self._ask_reject
        keys["play"] = self.view.toggle
        events = (
            session.on_documents,
            session.on_results,
            session.on_theme,
            session.on_selection,
        )
        frame().follow(self._update, *events)

    def _update(self) -> None:
        # a run has begun
        if self.record not in sources(self.session.stage("identify")):
            frame().rebuild()
            return
        assert self.plot is not None
        self.plot.update_figure(self._figure())
        self.automatic.refresh()
        self.own.refresh()
        self.inspected()

    def _bar(self) -> None:
        session = self.session
        names = list(sources(session.stage("identify")))
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.toggle(
                names,
                value=self.record,
                on_change=lambda e: session.select(
                    record=e.value, frequency=None, order=None
                ),
            ).props("dense no-caps unelevated toggle-color=primary").mark("record")
            ui.label("Click a pole or a mode; draw one onto another to merge.").classes(
                "text-sm opacity-70 ellipsis"
            )
            ui.space()
            run_button(session, "identify", "Identify anew")

    def _figure(self) -> dict[str, Any]:
        shown = self.found.diagram
        figure = identification_figure(shown)
        top = max(
            (int(d.poles.order.max(initial=1)) for d in shown.diagrams), default=1
        )
        choice = self.choice
        picked = choice.picks
        hover = "%{x:.5g} Hz<extra>%{fullData.name}</extra>"
        figure.add_scatter(
            x=[p.frequency for p in picked],
            y=[p.order or 1.06 * top for p in picked],
            mode="markers",
            marker=PICK,
            name=PICKED,
            hovertemplate=hover,
        )
        figure.add_scatter(
            x=[r.frequency for r in choice.rejects],
            y=[1.06 * top for _ in choice.rejects],
            mode="markers",
            marker=REJECT,
            name="your reject",
            hovertemplate=hover,
        )
        selected = self.session.selection.frequency
        if selected is not None:
            line = {"color": "#d55e00", "width": 1, "dash": "dot"}
            figure.add_vline(selected, line=line)
        spec = theme.drawn(figure, dark=self.session.dark)
        kinds = {name for name, *_ in POLES[len(OTHERS) :]}
        for trace in spec["data"]:
            if trace.get("name") in kinds and trace.get("yaxis", "y") == "y":
                # without a label nothing can be clicked
                del trace["hoverinfo"]
                trace["hovertemplate"] = "%{x:.5g} Hz, order %{y}<extra></extra>"
        return spec

    def _hovered(self, event: GenericEventArguments) -> None:
        """The shape of the mode, or of the pole, under the pointer moves."""
        points = event.args.get("points") or []
        if not points or self.view is None:
            return
        if (mode := points[0].get("customdata")) is not None:
            self.view.mode(self.found.diagram.modes, int(np.ravel(mode)[0]))
        elif (
            pole := nearest_pole(self.found, points[0]["x"], points[0]["y"])
        ) is not None:
            shape = pole_shape(self.found, pole)
            if shape is not None:
                self.view.mode(shape, 0)

    def _clicked(self, event: GenericEventArguments) -> None:
        """A mark of a mode selects it, a pole is picked, one that is picked is let go."""
        point = event.args
        f = float(point["x"])
        if (mode := point.get("customdata")) is not None:
            self._select_mode(int(np.ravel(mode)[0]))
        elif float(point["y"]).is_integer():
            self.pick_pole(f, int(point["y"]))

    def pick_pole(self, frequency: float, order: int) -> None:
        """Pick the pole of an order nearest to a frequency, or let it go."""
        pole = nearest_pole(self.found, frequency, order)
        if pole is None:
            return
        self.session.select(
            record=self.record, frequency=pole.frequency, order=order, mode=None
        )
        number = self._entry("pick", pole.frequency, order)
        if number is not None:
            self._remove("pick", number, pole.frequency)
            return
        entry = {"frequency": pole.frequency, "order": order, "record": self.record}
        self.session.edit_choice(
            f"picked {pole.frequency:.5g} Hz, order {order}",
            edits.add_entry("pick", entry),
        )

    def _entry(self, kind: str, frequency: float, order: int = 0) -> int | None:
        """Number of the entry of the choice that means a mode or pole."""
        name = self.session.choice_name
        text = self.session.documents.text(name)
        whole = parse_choice(text, name) if text else Choice()
        if kind == "merge":
            return merge_of(whole, self.record, frequency)
        rows: tuple[Any, ...] = whole.picks if kind == "pick" else whole.rejects
        for k, row in enumerate(rows):
            near = abs(row.frequency / frequency - 1) < (1e-9 if order else SAME_MODE)
            if (
                row.record in (self.record, "")
                and near
                and getattr(row, "order", 0) == order
            ):
                return k
        return None

    def _remove(self, kind: str, number: int, frequency: float) -> None:
        self.session.edit_choice(
            f"{kind} at {frequency:.5g} Hz taken back", edits.remove_entry(kind, number)
        )

    def _select_mode(self, k: int) -> None:
        f = float(self.found.diagram.modes.frequencies[k])
        self.session.select(
            record=self.record, frequency=f, order=0, mode=self._number(k)
        )

    def _number(self, k: int) -> int | None:
        """Position among the natural modes, which all screens count."""
        classes = self.found.diagram.classes
        return classes[:k].count("natural") if classes[k] == "natural" else None

    def _mode(self) -> int | None:
        """Position of the selected mode in the diagram."""
        f = self.session.selection.frequency
        if f is None or self.session.selection.order:
            return None
        there = self.found.diagram.modes.frequencies
        near = int(np.argmin(np.abs(there - f))) if there.size else -1
        return near if near >= 0 and abs(there[near] / f - 1) < SAME_MODE else None

    def _step(self, by: int) -> None:
        there = self.found.diagram.modes.frequencies
        if not there.size:
            return
        f = self.session.selection.frequency or 0.0
        now = self._mode()
        at = int(np.searchsorted(there, f)) - (by > 0) if now is None else now
        self._select_mode((at + by) % there.size)

    def _confirm(self) -> None:
        k = self._mode()
        if k is None:
            return
        f = float(self.found.diagram.modes.frequencies[k])
        if (number := self._entry("pick", f)) is not None:
            self._remove("pick", number, f)
            return
        entry = {"frequency": f, "record": self.record}
        self.session.edit_choice(
            f"confirmed {f:.5g} Hz", edits.add_entry("pick", entry)
        )

    def _ask_reject(self) -> None:
        k = self._mode()
        if k is None:
            return
        f = float(self.found.diagram.modes.frequencies[k])
        if (number := self._entry("reject", f)) is not None:
            self._remove("reject", number, f)
            return
        ask_reason(f"Reject the mode at {f:.5g} Hz", partial(self.reject, f))

    def reject(self, frequency: float, reason: str) -> None:
        """Reject an automatic mode."""
        entry = {"frequency": frequency, "reason": reason, "record": self.record}
        self.session.edit_choice(
            f"rejected {frequency:.5g} Hz", edits.add_entry("reject", entry)
        )

    def merge(self, low: float, high: float, reason: str) -> None:
        """Say that two modes are one."""
        entry = {"frequencies": [low, high], "reason": reason, "record": self.record}
        self.session.edit_choice(
            f"merged {low:.5g} and {high:.5g} Hz", edits.add_entry("merge", entry)
        )

    def _merging(self, k: int) -> None:
        """The mode that another one is merged with, nearest first; or the merge taken back."""
        there = self.found.diagram.modes.frequencies
        f = float(there[k])
        if (number := self._entry("merge", f)) is not None:
            ui.button(
                "Take the merge back",
                icon="call_split",
                on_click=lambda: self._unmerge(number, f),
            ).props("dense no-caps outline").mark("unmerge")
            return
        near = [int(j) for j in np.argsort(np.abs(there - f), kind="stable") if j != k]
        if not near:
            return

        ui.select(
            {float(there[j]): f"{there[j]:.5g} Hz" for j in near},
            label="Merge with",
            on_change=lambda e: self.ask_merge([f, float(e.value)]),
        ).props(SELECT).classes("w-full").mark("merge")

    def ask_merge(self, frequencies: Sequence[float]) -> None:
        """Ask why two modes are one: both were chosen, or one was drawn onto the other."""
        low, high = sorted(map(float, frequencies))
        if low < high:
            title = f"Merge {low:.5g} and {high:.5g} Hz into one mode"
            ask_reason(title, partial(self.merge, low, high))

    def _unmerge(self, number: int, frequency: float) -> None:
        self._remove("merge", number, frequency)

    @ui.refreshable_method
    def automatic(self) -> None:
        """What was found, with the classes."""
        shown = self.found.diagram
        modes = shown.modes
        rows: list[dict[str, object]] = [
            {
                "id": k,
                "class": kind,
                "f": f"{modes.frequencies[k]:.6g}",
                "zeta": f"{100 * modes.damping[k]:.3g}",
                "mpc": f"{shown.mpc[k]:.2f}",
                "confidence": f"{modes.confidence[k]:.2f}",
                "own": self._decision(float(modes.frequencies[k])),
            }
            for k, kind in enumerate(shown.classes)
        ]
        names = {
            "class": "class",
            "f": "f, Hz",
            "zeta": "ζ, %",
            "mpc": "MPC",
            "confidence": "confidence",
            "own": "you",
        }
        with ui.column().classes("grow gap-0"):
            heading("Found")
            listed = table(names, rows).mark("found")
            listed.on("rowClick", lambda e: self._select_mode(int(e.args[1]["id"])))

    def _decision(self, frequency: float) -> str:
        if self._entry("reject", frequency) is not None:
            return "rejected"
        if self._entry("merge", frequency) is not None:
            return "merged"
        return "confirmed" if self._entry("pick", frequency) is not None else ""

    @ui.refreshable_method
    def own(self) -> None:
        """What the choice says of this record."""
        choice = self.choice
        rows: list[dict[str, object]] = [
            {
                "id": f"p{k}",
                "what": "pick",
                "f": f"{p.frequency:.6g}",
                "why": f"order {p.order}" if p.order else "the automatic mode",
            }
            for k, p in enumerate(choice.picks)
        ]
        rows += [
            {
                "id": f"r{k}",
                "what": "reject",
                "f": f"{r.frequency:.6g}",
                "why": r.reason,
            }
            for k, r in enumerate(choice.rejects)
        ]
        rows += [
            {
                "id": f"m{k}",
                "what": "merge",
                "f": ", ".join(f"{f:.6g}" for f in m.frequencies),
                "why": m.reason,
            }
            for k, m in enumerate(choice.merges)
        ]
        with ui.column().classes("w-80 gap-0"):
            heading(f"Your choice: {self.session.choice_name}")
            if rows:
                table(
                    {"what": "what", "f": "f, Hz", "why": "order or reason"}, rows
                ).mark("own")
            else:
                ui.label("Nothing yet: the automatic modes stand.").classes(
                    "text-sm opacity-70"
                )

    def inspected(self) -> None:
        """The evidence of what is selected, and its shape in motion."""
        assert self.view is not None
        self.about.clear()
        with self.about:
            selection = self.session.selection
            k = self._mode()
            if k is not None:
                self.view.mode(self.found.diagram.modes, k)
                evidence(self.found, k)
                f = float(self.found.diagram.modes.frequencies[k])
                rejected = self._entry("reject", f) is not None
                confirmed = self._entry("pick", f) is not None
                with ui.row().classes("gap-2 q-mt-sm"):
                    ui.button(
                        "Take back" if confirmed else "Confirm",
                        icon="check",
                        on_click=self._confirm,
                    ).props("dense no-caps unelevated").mark("confirm")
                    ui.button(
                        "Take back" if rejected else "Reject",
                        icon="close",
                        on_click=self._ask_reject,
                    ).props("dense no-caps outline").mark("reject")
                self._merging(k)
            elif selection.order and selection.frequency is not None:
                pole = nearest_pole(self.found, selection.frequency, selection.order)
                if pole is not None:
                    heading("Pole")
                    fact(
                        "Frequency",
                        f"{plus_minus(pole.frequency, pole.std_frequency, 6)} Hz",
                    )
                    damping = plus_minus(100 * pole.damping, 100 * pole.std_damping, 3)
                    fact("Damping ratio", f"{damping} %")
                    fact("Model order", str(pole.order))
            else:
                ui.label("Select a mode or a pole.").classes("text-sm opacity-70")


def merge_of(choice: Choice, record: str, frequency: float) -> int | None:
    """Number of the merge of a choice that a mode of a record is in."""
    for k, merge in enumerate(choice.merges):
        near = min(abs(f / frequency - 1) for f in merge.frequencies)
        if merge.record in (record, "") and near < SAME_MODE:
            return k
    return None
