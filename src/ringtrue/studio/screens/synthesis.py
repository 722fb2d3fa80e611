"""What the modes as they are chosen explain of the measured FRFs or spectra, below the diagram."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import run, ui

from ringtrue.core.choice import Choice
from ringtrue.errors import RingtrueError
from ringtrue.plots import signals as figures
from ringtrue.studio import theme
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import frame
from ringtrue.study.results import IdentifiedModes, IdentifyStage
from ringtrue.study.synthesis import FittedData, FrfFit, fitted_spectra, single, summed

ALL = "all FRFs"
HAMMER = "hammer"

# record, what was found, the user's choice for it
Shown = tuple[str, IdentifiedModes, Choice]


class Synthesis:
    """The panel of one page.

    Parameters
    ----------
    session : StudioSession
    shown : callable
        Gives what the diagram shows.
    """

    def __init__(self, session: StudioSession, shown: Callable[[], Shown]) -> None:
        self.session = session
        self.shown = shown
        self.what = ALL
        self._fit: tuple[int, FrfFit] | None = None  # of the stage with this identity
        self._turn = 0

    def build(self) -> None:
        """The figure and what it is of."""
        session = self.session
        with ui.row().classes("w-full items-center no-wrap gap-2"):
            self.title = ui.label().classes("rt-head")
            ui.space()
            self.note = ui.label().classes("text-xs text-negative ellipsis")
            self.options = (
                ui.select([ALL], value=ALL, with_input=True, on_change=self._other)
                .props("dense options-dense borderless")
                .classes("w-40")
                .mark("fit-of")
            )
        self.plot = ui.plotly({}).classes("w-full").style("height:26vh").mark("fit")
        events = (session.on_documents, session.on_results, session.on_theme)
        frame().follow(self.drawn, *events)
        frame().follow(self._followed, session.on_selection)
        ui.timer(0, self.drawn, once=True)

    async def _other(self, event: object) -> None:
        chosen = str(self.options.value or ALL)
        if chosen != self.what:
            self.what = chosen
            await self.drawn()

    async def _followed(self) -> None:
        """Another record, or a channel, was selected."""
        chosen = self.session.selection.channel
        there = (
            [o for o in self._pairs() if o.startswith(f"{chosen} / ")] if chosen else []
        )
        if there and not self.what.startswith(f"{chosen} / "):
            self.what = there[0]
        await self.drawn()

    def _pairs(self) -> list[str]:
        stage: IdentifyStage | None = self.session.stage("identify")
        if stage is None or stage.frfs is None:
            return []
        return [
            f"{o.id} / {i.id}" for i in stage.frfs.inputs for o in stage.frfs.outputs
        ]

    async def drawn(self) -> None:
        """Fit the modes anew and show what they explain."""
        self._turn += 1
        turn = self._turn
        record, found, choice = self.shown()
        hammer = record == HAMMER
        pairs = self._pairs() if hammer else []
        if self.what not in pairs:
            self.what = ALL
        self.options.set_visibility(hammer)
        self.options.set_options([ALL, *pairs], value=self.what)
        try:
            parts = await run.io_bound(self._fitted, found, choice, hammer)
        except RingtrueError as e:
            self.note.text = str(e)
            return
        if parts is None or turn != self._turn or self.plot.is_deleted:
            return
        self.note.text = ""
        of = "the measured FRFs" if hammer else "the sum of the spectra"
        self.title.text = f"What the chosen modes explain of {of}"
        figure = figures.fitted(
            [p.freqs for p in parts],
            [p.measured for p in parts],
            [p.fitted for p in parts],
            span=found.diagram.span,
        )
        spec = theme.drawn(figure, dark=self.session.dark)
        spec["layout"]["uirevision"] = f"{record} {self.what}"
        self.plot.update_figure(spec)

    def _fitted(
        self, found: IdentifiedModes, choice: Choice, hammer: bool
    ) -> tuple[FittedData, ...]:
        stage: IdentifyStage | None = self.session.stage("identify")
        if not hammer or stage is None or stage.frfs is None:
            return fitted_spectra(found, choice)
        if self._fit is None or self._fit[0] != id(stage):
            self._fit = (id(stage), FrfFit.of(found, stage.frfs))
        fit = self._fit[1]
        fitted = fit.at(found, choice)
        if self.what == ALL:
            return (summed(fit.frfs, fitted),)
        output, _, input_ = self.what.partition(" / ")
        return (single(fit.frfs, fitted, output, input_),)
