"""The records of a study that are open: what the log lists, or the one record that was opened."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from weakref import WeakKeyDictionary

from nicegui import run

from ringtrue.core.choice import Choice, Hit
from ringtrue.core.notes import Note
from ringtrue.errors import DataError
from ringtrue.io.choices import parse_choice
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.studio.session import StudioSession
from ringtrue.study.log import Logged, read_log
from ringtrue.study.record_views import RecordView, open_view
from ringtrue.study.results import IdentifiedRecord, IdentifyStage, ImpactReport, RecordSummary


@dataclass(eq=False)
class Records:
    """The records of a session.

    Attributes
    ----------
    session : StudioSession
    """

    session: StudioSession
    _views: dict[str, tuple[float, RecordView]] = field(default_factory=dict)
    _checked: dict[str, tuple[Note, ...]] = field(default_factory=dict)

    @property
    def logged(self) -> dict[str, Logged]:
        """The records of the log, by name.

        Raises
        ------
        DataError
            If the log cannot be read.
        """
        config = self.session.config
        test = config.test if config is not None else None
        if test is None or not test.log:
            return {}
        records, _ = read_log(self.session.path.parent / test.log)
        return {r.name: r for r in records}

    @property
    def names(self) -> list[str]:
        """Of all records."""
        source = self.session.source
        try:
            found = list(self.logged)
        except DataError:
            found = []
        return found or ([source.stem] if source is not None else [])

    @property
    def sheet(self) -> SensorSheet | None:
        """The sensor sheet; None where there is none."""
        name = self.session.sheet_name
        return read_sensor_sheet(self.session.path.parent / name) if name else None

    @property
    def unused(self) -> tuple[str, ...]:
        """Channels that the study leaves out."""
        config = self.session.config
        return tuple(config.test.leave_out) if config is not None and config.test else ()

    async def view(self, name: str) -> RecordView | None:
        """A record, opened once as long as its file stays; None while the program ends."""
        return await run.io_bound(self._open, name)

    def _open(self, name: str) -> RecordView:
        logged = self.logged.get(name)
        path = logged.path if logged is not None else Path(str(self.session.source))
        stamp = path.stat().st_mtime if path.exists() else 0.0
        known = self._views.get(name)
        if known is None or known[0] != stamp:
            sheet = self.sheet if logged is not None else None
            self._views[name] = known = (stamp, open_view(logged or path, sheet))
            self._checked.pop(name, None)
        return known[1]

    def summary(self, name: str) -> RecordSummary | None:
        """What is stored of a record; of files that are one record, of the first."""
        stage: IdentifyStage | None = self.session.stage("identify")
        logged = self.logged.get(name)
        if stage is None or logged is None:
            return None
        return next((r for r in stage.records if r.name == name), None)

    def identified(self, name: str) -> IdentifiedRecord | None:
        """The modes that are stored of an ambient record."""
        stage: IdentifyStage | None = self.session.stage("identify")
        found = () if stage is None else stage.ambient_records
        return next((r for r in found if r.record == name), None)

    async def notes(self, name: str, view: RecordView) -> tuple[Note, ...]:
        """What is wrong with channels: stored, or else found now where the record is not long."""
        stored = self.summary(name)
        if stored is not None and stored.channel_notes:
            return stored.channel_notes
        if name not in self._checked:
            self._checked[name] = await run.io_bound(lambda: view.checked() or ()) or ()
        return self._checked[name]

    def hits(self, name: str) -> list[ImpactReport]:
        """The hits that are stored of a record."""
        stage: IdentifyStage | None = self.session.stage("identify")
        every = () if stage is None else stage.hits
        return [h for h in every if h.source.partition(" #")[0] == name]

    @property
    def decisions(self) -> tuple[Hit, ...]:
        """The hits of the user's own choice, in the order of its text."""
        name = self.session.choice_name
        text = self.session.documents.text(name)
        return (parse_choice(text, name) if text else Choice()).hits


_OF: WeakKeyDictionary[StudioSession, Records] = WeakKeyDictionary()


def records_of(session: StudioSession) -> Records:
    """The records of a session, one for all its tabs."""
    if session not in _OF:
        _OF[session] = Records(session)
    return _OF[session]
