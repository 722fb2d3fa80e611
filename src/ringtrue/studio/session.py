"""What is open in the studio: a study, how its stages stand, the one selection, the run."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nicegui import Event, run
from pydantic import TypeAdapter, ValidationError

import ringtrue as rt
from ringtrue.api.studies import Study, store_of
from ringtrue.api.trial import TrialModel
from ringtrue.errors import ConfigError, RingtrueError
from ringtrue.studio import edits
from ringtrue.studio.documents import Documents, Step, stamp_of
from ringtrue.studio.edits import Change
from ringtrue.studio.work import Work
from ringtrue.study.config import StudyConfig, parse_config
from ringtrue.study.opened import Opened
from ringtrue.study.results import CorrelateStage
from ringtrue.study.run import StageState, stage_states

log = logging.getLogger(__name__)
CHOICE = "choice.toml"  # where a study names none
# of study.toml, on which the reduced model does not rest
OTHER_SECTIONS = {
    "study",
    "plan",
    "report",
    "predict",
    "damping",
    "uncertainty",
    "update",
}
NEVER = (-1, -1)  # time and size of a store that was not looked at


@dataclass(frozen=True, slots=True)
class Selection:
    """What is selected on every screen; None or empty: nothing.

    Attributes
    ----------
    record : str
        Whose diagram is shown: that of an ambient record, or "hammer".
    frequency : float or None
        Hz, on a diagram or a spectrum.
    order : int or None
        Of the pole there.
    mode : int or None
        Test mode, from 0.
    pair : (int, int) or None
        Test mode and FE mode, from 0; they need not be paired.
    channel, region : str
    """

    record: str = ""
    frequency: float | None = None
    order: int | None = None
    mode: int | None = None
    pair: tuple[int, int] | None = None
    channel: str = ""
    region: str = ""


_KEPT = TypeAdapter(tuple[bool, Selection])


class StudioSession:
    """The study that is open; every tab of the browser shows the same one.

    Parameters
    ----------
    study : Path
        Its study.toml, which need not be there yet.
    source : Path, optional
        The deck or record that was opened in place of a study.

    Attributes
    ----------
    documents : Documents
    work : Work
    selection : Selection
    dark : bool
    example : bool
        The worked example: a tour begins by itself.
    config : StudyConfig or None
        None where there is no study.toml, or it is wrong.
    problem : str
        What is wrong with it.
    study : Study or None
        What is stored.
    stages : tuple of StageState
    on_selection, on_documents, on_results, on_work, on_theme : Event
        The selection, a text, what is stored or how it stands, the run, the theme has changed.
    """

    def __init__(self, study: Path, source: Path | None = None) -> None:
        self.path = study
        self.source = source
        self.documents = Documents(study)
        self.selection = Selection()
        self.dark = False
        self.example = False
        self.config: StudyConfig | None = None
        self.problem = ""
        self.study: Study | None = None
        self.stages: tuple[StageState, ...] = ()
        self.on_selection = Event[Selection]()
        self.on_documents = Event[str]()
        self.on_results = Event[[]]()
        self.on_work = Event[[]]()
        self.on_theme = Event[[]]()
        self.work = Work(study, self.on_work.emit)
        self._deck: tuple[tuple[Any, ...], Opened] | None = None
        self._stored = NEVER
        self._read_store = NEVER
        self._trial: tuple[str, TrialModel] | None = None
        self._restored = False
        self._read()

    # --- the selection

    def select(self, **change: Any) -> None:
        """Change the selection; every screen of every tab follows."""
        new = replace(self.selection, **change)
        if new != self.selection:
            self.selection = new
            self.on_selection.emit(new)

    @property
    def kept(self) -> str:
        """Theme and selection, as a browser keeps them."""
        return _KEPT.dump_json((self.dark, self.selection)).decode()

    def restore(self, kept: str) -> None:
        """Take theme and selection as a browser kept them, as long as nothing was selected here."""
        if kept and not self._restored:
            try:
                self.dark, self.selection = _KEPT.validate_json(kept)
            except ValidationError:
                log.info("what the browser kept is not of this version")
        self._restored = True

    def set_dark(self, dark: bool) -> None:
        """Change the theme of all tabs."""
        self.dark = dark
        self.on_theme.emit()

    # --- the texts

    @property
    def choice_name(self) -> str:
        """The choice of modes, as the study names it."""
        given = self.config.identify.choice if self.config is not None else None
        return given or CHOICE

    def edit(
        self, words: str, change: Change, *more: tuple[str, Change]
    ) -> Step | None:
        """Change study.toml, and further documents by name, in one step.

        Raises
        ------
        InputError
            If what it would say is not allowed; nothing was written.
        """
        step = self.documents.edit(words, {self.documents.name: change, **dict(more)})
        self._announce(step, words)
        return step

    def edit_choice(self, words: str, change: Change) -> Step | None:
        """Change the choice of modes; study.toml names it from then on."""
        name = self.choice_name
        changes = {name: edits.in_choice(change)}
        if self.config is not None and self.config.identify.choice is None:
            changes[self.documents.name] = edits.put(("identify", "choice"), name)
        step = self.documents.edit(words, changes)
        self._announce(step, words)
        return step

    def undo(self) -> Step | None:
        """Take the last step back."""
        step = self.documents.undo()
        self._announce(step, f"undone: {step.words}" if step else "")
        return step

    def redo(self) -> Step | None:
        """Make the step that was undone last again."""
        step = self.documents.redo()
        self._announce(step, f"done again: {step.words}" if step else "")
        return step

    def _announce(self, step: Step | None, words: str) -> None:
        if step is not None:
            self._read()
            # what is stored may not follow from the texts any more
            self._stored = NEVER
            self.on_documents.emit(words)

    def _read(self) -> None:
        """The configuration of study.toml as it is now."""
        self.config = None
        self.problem = ""
        text = self.documents.text(self.documents.name)
        if self.config is None and text:
            try:
                self.config = parse_config(text, self.path)
                for name in (self.choice_name, self.sheet_name):
                    if name:
                        self.documents.text(name)
            except RingtrueError as e:
                self.problem = str(e)

    @property
    def sheet_name(self) -> str:
        """The sensor sheet; empty where the study has none."""
        test = self.config.test if self.config is not None else None
        return (test.sheet or "") if test is not None else ""

    # --- results

    @property
    def deck(self) -> Opened | None:
        """The deck of the study; None where it was not read yet, or has changed since."""
        if self._deck is None or self._deck[0] != self._deck_stamp(self._deck[1]):
            return None
        return self._deck[1]

    def stage(self, name: str) -> Any:
        """The stored result of a stage; None where it is not stored."""
        return None if self.study is None else self.study.run.results.get(name)

    def standing(self, name: str) -> str:
        """How a stage stands: done, stale or missing; empty where it does not apply."""
        return next((s.standing for s in self.stages if s.name == name), "")

    async def look(self) -> None:
        """See what has changed outside: texts, and what is stored."""
        if changed := self.documents.changed_outside():
            self._read()
            self.on_documents.emit(
                f"changed outside of the studio: {', '.join(changed)}"
            )
            await self.refresh()
        elif self._store_stamp() != self._stored and not self.work.running:
            await self.refresh()

    async def refresh(self) -> None:
        """Read what is stored, and how it stands."""
        before = self._read_store
        self._stored = stamp = self._store_stamp()
        try:
            found = await run.io_bound(self._results, stamp == before)
        except RingtrueError as e:
            self.stages = ()
            self.problem = self.problem or str(e)
        else:
            if found is None:  # the program ends
                return
            self.study, self.stages = found
            self._read_store = stamp
        self.on_results.emit()

    def _results(self, known: bool) -> tuple[Study | None, tuple[StageState, ...]]:
        """The stored study, which may be known, and how its stages stand."""
        store = store_of(self.path)
        study = self.study
        if not known:
            study = rt.open_study(store) if store.exists() else None
        if self.config is None:
            return study, ()
        states, deck = stage_states(self.path, deck=self.deck)
        if deck is not None:
            self._deck = (self._deck_stamp(deck), deck)
        return study, states

    def _deck_stamp(self, deck: Opened) -> tuple[Any, ...]:
        """What a deck follows from: its settings, and its files as they stand."""
        stamps = [(f, *stamp_of(Path(f))) for f in deck.model.files]
        return (str(self.config.model if self.config else None), *stamps)

    def _store_stamp(self) -> tuple[int, int]:
        return stamp_of(store_of(self.path))

    async def run_stages(self, until: str = "", first: str = "") -> None:
        """Run the study up to a stage; says how it ended by `on_work`.

        Raises
        ------
        ConfigError
            If there is no study that could run.
        """
        if self.config is None:
            raise ConfigError(self.problem or f"{self.path}: there is no study yet")
        await self.work.run(until, first)
        await self.refresh()

    async def trial_model(self) -> TrialModel | None:
        """The reduced model of the study as it is now; made once for each deck, its candidates and
        its correlation. None while the program ends.
        """
        stored: CorrelateStage | None = self.stage("correlate")
        modes = b"" if stored is None else stored.reference.elastic.shapes.tobytes()
        known = (
            self.config.model_dump(exclude=OTHER_SECTIONS)
            if self.config is not None
            else {}
        )
        key = f"{known}{hash(modes)}"
        if self._trial is not None and self._trial[0] == key:
            return self._trial[1]
        model = await run.io_bound(rt.trial_model, self.path)
        if model is not None:
            self._trial = (key, model)
        return model


def opened(target: Path | None) -> StudioSession:
    """The session of a study.toml, its folder, or a deck or record next to which one may begin.

    Raises
    ------
    ConfigError
        If there is no such file.
    """
    path = Path.cwd() if target is None else target
    if path.is_dir():
        return StudioSession(path / "study.toml")
    if path.suffix.lower() == ".toml":
        if not path.exists():
            raise ConfigError(
                f"{path}: no such file; name a study.toml, a deck or a record"
            )
        return StudioSession(path)
    if not path.exists():
        raise ConfigError(
            f"{path}: no such file; name a study.toml, a deck or a record"
        )
    return StudioSession(path.with_name("study.toml"), path)
