"""Where it is wrong: the stored localisation on the model and as a ranked list, with evidence."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from ringtrue.core.arrays import Float
from ringtrue.core.display import number
from ringtrue.core.notes import sentence
from ringtrue.core.parameters import Parameter
from ringtrue.studio import edits
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import (
    SELECT,
    fact,
    frame,
    heading,
    inspector,
    nothing_yet,
    run_button,
    table,
)
from ringtrue.studio.shown import DrawnDeck, drawn_deck
from ringtrue.studio.viewer_element import Viewer
from ringtrue.studio.views import deck_view, highlighted, no_deck
from ringtrue.study.config_sections import target_words
from ringtrue.study.results import LocaliseStage

FIELDS = {  # of the indicators
    "concentration": "error over strain energy",
    "constitutive": "error in constitutive relation",
    "force": "force residual",
    "energy": "change of strain energy",
    "strain": "strain energy",
}
FAINT = 0.2  # opacity of what is not selected
# of the colours of a concentration: 1 is an error that is spread evenly
LEAST_TOP = 2.0


def build(session: StudioSession) -> None:
    """Fill the page."""
    if session.stage("localise") is None:
        nothing_yet(session, "No localisation is stored.", "localise")
        return
    _WhereScreen(session).build()


class _WhereScreen:
    """The screen of one page."""

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.deck: DrawnDeck | None = None
        self.viewer: Viewer | None = None
        self.field = "concentration"

    @property
    def stage(self) -> LocaliseStage:
        """What is stored."""
        found: LocaliseStage = self.session.stage("localise")
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Of all candidates, those that are proposed first."""
        proposed = [m.name for m in self.stage.proposal.members]
        every = self.stage.candidates.parameters.names
        return (*proposed, *(n for n in every if n not in proposed))

    def build(self) -> None:
        session = self.session
        self.holder = ui.column().classes("w-full gap-1 p-2")
        ui.timer(0.0, self.load, once=True)
        frame().follow(frame().rebuild, session.on_results)
        frame().follow(self._selected, session.on_selection)
        frame().follow(self._changed, session.on_documents)
        keys = frame().keys
        keys["next"] = partial(self.step, 1)
        keys["previous"] = partial(self.step, -1)
        keys["accept"] = self.tick
        keys["reject"] = self.untick

    async def load(self) -> None:
        """Draw the deck with its errors."""
        deck = await drawn_deck(self.session)
        if self.holder.is_deleted:
            return
        with self.holder:
            if deck is None:
                no_deck()
                return
            self.deck = deck
            self._bar()
            self.viewer = deck_view(
                self.session, {"model": deck.arrays}, ["element"], below=388
            )
            self.viewer.show(color="plain").on_event("pick", self.picked)
            with ui.scroll_area().style("height:274px").classes("w-full"):
                self.ranked()
                self.alternatives()
        self.show_field(self.field)
        self._selected()

    def _bar(self) -> None:
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            known = self.stage.indicators.modes.size > 0
            ui.select(
                FIELDS,
                value=self.field,
                on_change=lambda e: self.show_field(str(e.value)),
            ).props(SELECT).classes("min-w-64").mark("field").set_enabled(known)
            if not known:
                by = self.stage.reduced_by
                why = f"{by} has reduced the deck" if by else "No shapes were measured"
                ui.label(f"{why}: no local errors.").classes("text-sm opacity-70")
            ui.space()
            run_button(self.session, "localise", "Localise anew")

    def show_field(self, name: str) -> None:
        """Colour the model by an indicator."""
        self.field = name
        deck = self.deck
        found = self.stage.indicators
        if deck is None or self.viewer is None or not found.modes.size:
            return
        concentration = name == "concentration"
        value: Float = getattr(found, name) * (1.0 if concentration else 100.0)
        at = {region: k for k, region in enumerate(found.regions)}
        group = [at.get(g, -1) for g in deck.arrays["groups"]]
        of_group = np.array([value[k] if k >= 0 else np.nan for k in group])
        top = (
            float(np.nanmax(value, initial=LEAST_TOP if concentration else 0.0)) or 1.0
        )
        self.viewer.field(
            FIELDS[name],
            of_group[deck.numbers("group")],
            of="element",
            unit="times" if concentration else "%",
            range=[0.0, top],
        )
        self.viewer.show(field=FIELDS[name])

    # --- lists

    @ui.refreshable_method
    def ranked(self) -> None:
        """The candidates, those that are proposed first."""
        s = self.stage
        with ui.column().classes("w-full gap-0"):
            heading(
                "Proposal and other candidates" if s.proposal.members else "Candidates"
            )
            if not s.proposal.members:
                ui.label(
                    f"No parameter is proposed: {s.proposal.unexplained()}"
                ).classes("text-sm")
            names = {
                "mark": "",
                "name": "parameter",
                "what": "changes",
                "factor": "factor",
                "std": "σ",
                "worth": "worth, AICc",
                "explains": "explains, %",
                "lost": "not separable from",
            }
            shown = table(names, [self._row(name) for name in self.names])
            shown.props("wrap-cells").on("rowClick", self._clicked).mark("ranked")

    def _row(self, name: str) -> dict[str, object]:
        s = self.stage
        k = s.candidates.parameters.names.index(name)
        member = next((m for m in s.proposal.members if m.name == name), None)
        mark = "✓" if self.entry(name) is not None else ""
        factor, std = ("", "") if member is None else member.digits()
        return {
            "id": name,
            "mark": mark,
            "name": name,
            "what": s.candidates.what[k],
            "factor": factor,
            "std": std,
            "worth": "" if member is None else number(member.worth, 3),
            "explains": f"{100 * s.candidates.explains[k]:.0f}",
            "lost": ", ".join(self.inseparable(name)),
        }

    def inseparable(self, name: str) -> list[str]:
        """Candidates that the data cannot separate from one: of its cluster, or as good."""
        s = self.stage
        every = s.candidates.parameters.names
        clusters = s.proposal.clusters
        k = every.index(name)
        near = [
            n for n, c in zip(every, clusters.tolist(), strict=True) if c == clusters[k]
        ]
        member = next((m for m in s.proposal.members if m.name == name), None)
        rivals = () if member is None else (*member.collinear, *member.rivals)
        return [n for n in dict.fromkeys((*near, *rivals)) if n != name]

    @ui.refreshable_method
    def alternatives(self) -> None:
        """What the deviations follow, and members that the deck may lack."""
        s = self.stage
        form: Any = getattr(s, "form", None)  # not of an older store
        if form is not None and form.notes:
            heading("What the deviations follow")
            for note in form.notes:
                ui.label(sentence(note)).classes("text-sm")
        if s.members:
            heading("Members that the deck may lack")
        for k, member in enumerate(s.members):
            row = (
                ui.label(member.text())
                .classes("text-sm cursor-pointer")
                .mark(f"member-{k}")
            )
            row.on("click", partial(self.fly_to, k))

    def fly_to(self, k: int) -> None:
        """Show the nodes of a member that the deck may lack."""
        nodes = sorted({n for pair in self.stage.members[k].nodes for n in pair if n})
        if self.viewer is not None:
            self.viewer.show(select={"node": nodes}, labels={"node": nodes}).fly(
                {"node": nodes}
            )

    # --- the selection

    def _clicked(self, event: GenericEventArguments) -> None:
        self.session.select(region=str(event.args[1]["id"]))

    def picked(self, found: dict[str, Any] | None) -> None:
        """A click on the model selects the candidate of that element that explains most."""
        deck = self.deck
        if found is None or deck is None:
            self.session.select(region="")
            return
        one = int(found["id"])
        own = [
            n
            for n in self.names
            if one in deck.changed(target_words(self.parameter(n)))
        ]
        if own:
            self.session.select(region=own[0])

    def step(self, by: int) -> None:
        """Select the next or the previous candidate."""
        names = self.names
        if names:
            now = self.session.selection.region
            k = (names.index(now) + by) % len(names) if now in names else 0
            self.session.select(region=names[k])

    def _changed(self) -> None:
        if self.viewer is not None:
            self.ranked.refresh()
            self.inspected()

    def _selected(self) -> None:
        deck = self.deck
        if deck is None or self.viewer is None:
            return
        name = self.session.selection.region
        select = None
        if name in self.names:
            targets = target_words(self.parameter(name))
            select = highlighted(deck, deck.changed(targets))
        # what is not selected is seen through
        alpha = None if select is None else [FAINT] * len(deck.arrays["groups"])
        self.viewer.show(select=select, labels=None, alpha=alpha)
        self.inspected()

    def parameter(self, name: str) -> Parameter:
        """A candidate of the stage."""
        parameters = self.stage.candidates.parameters
        return parameters.parameters[parameters.names.index(name)]

    def entry(self, name: str) -> int | None:
        """Its number in study.toml; None where it is not there."""
        config = self.session.config
        wanted = set(target_words(self.parameter(name)))
        for k, c in enumerate(config.candidate if config is not None else ()):
            if c.name == name or (wanted and set(c.targets) == wanted):
                return k
        return None

    def tick(self) -> None:
        """Write the selected candidate into study.toml."""
        name = self.session.selection.region
        if name not in self.names or self.entry(name) is not None:
            return
        p = self.parameter(name)
        targets = target_words(p)
        if not targets:
            ui.notify(
                f"{name} is no factor on fields of the deck: add its card to the deck."
            )
            return
        entry: dict[str, object] = {"name": name, "targets": targets}
        entry |= {
            "lower": float(f"{p.lower:.4g}"),
            "upper": float(f"{p.upper:.4g}"),
            "std": p.std,
        }
        self.session.edit(f"candidate {name}", edits.add_entry("candidate", entry))

    def untick(self) -> None:
        """Take it out of study.toml."""
        name = self.session.selection.region
        k = self.entry(name) if name in self.names else None
        if k is not None:
            self.session.edit(
                f"candidate {name} taken out", edits.remove_entry("candidate", k)
            )

    def inspected(self) -> None:
        """The evidence for the selected candidate."""
        with inspector():
            name = self.session.selection.region
            if name not in self.names:
                ui.label("Select a candidate.").classes("text-sm opacity-70")
                return
            s = self.stage
            k = s.candidates.parameters.names.index(name)
            p = self.parameter(name)
            heading(name)
            ui.label(s.candidates.what[k]).classes("text-sm")
            there = self.entry(name) is not None
            ui.checkbox(
                "Candidate in study.toml",
                value=there,
                on_change=lambda e: self.tick() if e.value else self.untick(),
            ).props("dense").classes("q-my-xs").mark("tick")
            fact("Bounds", f"{number(p.lower, 3)} to {number(p.upper, 3)}")
            fact(
                "Effect of one prior σ",
                f"{number(float(s.candidates.effect[k]), 3)} σ of data",
            )
            known = 100 * float(s.candidates.others_known[k])
            free = 100 * float(s.candidates.all_free[k])
            fact("σ left, others known", f"{number(known, 2)} %")
            fact("σ left, all free", f"{number(free, 2)} %")
            member = next((m for m in s.proposal.members if m.name == name), None)
            if member is not None:
                heading("Evidence")
                for part in member.because.split("; "):
                    ui.label(part).classes("text-xs")
            if lost := self.inseparable(name):
                heading("The data cannot separate it from")
                for other in lost:
                    ui.label(other).classes("text-sm text-primary cursor-pointer").on(
                        "click", partial(self.session.select, region=other)
                    )
