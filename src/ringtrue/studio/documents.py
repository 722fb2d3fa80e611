"""The texts of a study, its only state: each step is checked, written whole, and can be undone.

A step changes what stands in the files at that moment, so that an edit from outside is never lost.
Undoing it finds its lines again wherever they have moved; where they were edited since, it says so.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from difflib import SequenceMatcher, unified_diff
from pathlib import Path
from typing import Any

from ringtrue.errors import ConfigError, DataError, InputError
from ringtrue.io.choices import parse_choice
from ringtrue.io.files import atomic_write, read_text
from ringtrue.io.foreign.parsers import read_json
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.studio.edits import Change
from ringtrue.study.config import parse_config

HISTORY = ".ringtrue-studio.json"
MOST_STEPS = 500  # that are kept
WRITING_S = 0.2  # that an editor may leave a text empty while it writes it
CONTEXT = 2  # lines around a change by which it is found again


@dataclass(frozen=True, slots=True)
class Hunk:
    """Some lines of a text before and after a change, with those around them."""

    at: int
    before: tuple[str, ...]
    after: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Edit:
    """The change of one file.

    Attributes
    ----------
    name : str
        The file, seen from the folder of the study.
    hunks : tuple of Hunk
    """

    name: str
    hunks: tuple[Hunk, ...]

    def applied(self, text: str, *, back: bool = False) -> str:
        """The text with the change made, or taken back.

        Raises
        ------
        ConfigError
            If its lines are not in the text any more.
        """
        lines = text.splitlines(keepends=True)
        moved = 0
        for hunk in self.hunks:
            old, new = (hunk.after, hunk.before) if back else (hunk.before, hunk.after)
            at = _found(lines, old, hunk.at + moved)
            if at < 0:
                raise ConfigError(
                    f"{self.name}: its lines were edited outside of the studio since; change them "
                    "in an editor"
                )
            lines[at : at + len(old)] = new
            moved += len(new) - len(old)
        return "".join(lines)

    def diff(self) -> str:
        """As a unified diff."""
        parts = [f"--- {self.name}\n+++ {self.name}\n"]
        for hunk in self.hunks:
            rows = list(unified_diff(hunk.before, hunk.after, n=CONTEXT))[2:]
            parts += [row if row.endswith("\n") else f"{row}\n" for row in rows]
        return "".join(parts)


@dataclass(frozen=True, slots=True)
class Step:
    """What one click did.

    Attributes
    ----------
    words : str
    edits : tuple of Edit
    when : float
        Seconds since 1970.
    """

    words: str
    edits: tuple[Edit, ...]
    when: float

    def diff(self) -> str:
        """All its files as a unified diff."""
        return "".join(edit.diff() for edit in self.edits)


class Documents:
    """study.toml, choices of modes and sensor sheets in the folder of a study.

    Parameters
    ----------
    study : Path
        The study.toml; it need not be there yet.

    Attributes
    ----------
    study, folder : Path
    steps : list of Step
        All that were made, those undone last.
    done : int
        How many of them stand.
    """

    def __init__(self, study: Path) -> None:
        self.study = study
        self.folder = study.parent
        self.steps: list[Step] = []
        self.done = 0
        self._seen: dict[str, str] = {}  # digest by name
        self._stamps: dict[str, tuple[int, int]] = {}
        self._read_history()

    @property
    def name(self) -> str:
        """Of the study.toml."""
        return self.study.name

    def path(self, name: str) -> Path:
        """The file of a document.

        Raises
        ------
        ConfigError
            If it is outside of the folder of the study.
        """
        path = (self.folder / name).resolve()
        if not path.is_relative_to(self.folder.resolve()):
            raise ConfigError(
                f"{name}: outside of {self.folder}; the studio writes in the folder of the study "
                "alone: copy the file into it"
            )
        return path

    def text(self, name: str) -> str:
        """The text of a document; empty where there is none."""
        path = self.path(name)
        if not path.is_file():
            return ""
        text = read_text(path)
        waited = 0.0
        # an editor writes it
        while not text and self._seen.get(name) and waited < WRITING_S:
            time.sleep(WRITING_S / 10)
            waited += WRITING_S / 10
            text = read_text(path)
        self._note(name, path, text)
        return text

    def edit(self, words: str, changes: Mapping[str, Change]) -> Step | None:
        """Make one step: every text is changed and checked before any is written.

        Parameters
        ----------
        words : str
            What the step does, for the history.
        changes : mapping of str to Change
            By the name of the document.

        Returns
        -------
        Step or None
            None where nothing changes.

        Raises
        ------
        InputError
            If what a text would say is not allowed; nothing was written.
        """
        before = {name: self.text(name) for name in changes}
        after = {name: change(before[name]) for name, change in changes.items()}
        edits = tuple(
            Edit(name, _hunks(before[name], after[name]))
            for name in changes
            if before[name] != after[name]
        )
        if not edits:
            return None
        self._write({edit.name: after[edit.name] for edit in edits})
        step = Step(words, edits, time.time())
        self.steps = [*self.steps[: self.done], step][-MOST_STEPS:]
        self.done = len(self.steps)
        self._keep_history()
        return step

    def undo(self) -> Step | None:
        """Take the last step back; None where there is none."""
        if not self.done:
            return None
        step = self.steps[self.done - 1]
        self._write(
            {e.name: e.applied(self.text(e.name), back=True) for e in step.edits}
        )
        self.done -= 1
        self._keep_history()
        return step

    def redo(self) -> Step | None:
        """Make the step that was undone last again; None where there is none."""
        if self.done == len(self.steps):
            return None
        step = self.steps[self.done]
        self._write({e.name: e.applied(self.text(e.name)) for e in step.edits})
        self.done += 1
        self._keep_history()
        return step

    def changed_outside(self) -> tuple[str, ...]:
        """Documents that were read or written here and say something else now."""
        changed = []
        for name, digest in list(self._seen.items()):
            path = self.path(name)
            if stamp_of(path) == self._stamps.get(name):
                continue
            self.text(name)
            if not path.is_file():
                self._stamps[name] = stamp_of(path)
                self._seen[name] = ""
            if self._seen[name] != digest:
                changed.append(name)
        return tuple(changed)

    def _write(self, texts: Mapping[str, str]) -> None:
        """Write all of them or none; an empty text is no file."""
        with ExitStack() as stack:
            for name, text in texts.items():
                if not text:
                    continue
                path = self.path(name)
                path.parent.mkdir(parents=True, exist_ok=True)
                part = stack.enter_context(atomic_write(path))
                part.write_bytes(text.encode("utf-8"))
                _check(name, text, part, study=name == self.name)
        for name, text in texts.items():
            path = self.path(name)
            if not text:
                path.unlink(missing_ok=True)
            self._note(name, path, text)

    def _note(self, name: str, path: Path, text: str) -> None:
        self._seen[name] = hashlib.sha256(text.encode()).hexdigest() if text else ""
        self._stamps[name] = stamp_of(path)

    def _read_history(self) -> None:
        """The steps of earlier sessions; without them where their file is damaged."""
        with suppress(DataError, KeyError, TypeError, AttributeError):
            kept = read_json(self.folder / HISTORY)
            self.steps = [_step(s) for s in kept["steps"]]
            self.done = min(int(kept["done"]), len(self.steps))

    def _keep_history(self) -> None:
        kept = {"done": self.done, "steps": [asdict(s) for s in self.steps]}
        with atomic_write(self.folder / HISTORY) as part:
            part.write_text(json.dumps(kept, ensure_ascii=False), encoding="utf-8")


def _check(name: str, text: str, part: Path, *, study: bool) -> None:
    """Refuse a text that could not be read, by the classes that read it."""
    ending = Path(name).suffix.lower()
    try:
        if study:
            parse_config(text, Path(name))
        elif ending == ".toml":
            parse_choice(text, name)
        elif ending == ".csv":
            read_sensor_sheet(part)
        else:
            raise ConfigError(
                f"{name}: the studio edits .toml and .csv; edit it where it was made"
            )
    except InputError as e:
        raise ConfigError(str(e).replace(str(part), name)) from e


def _hunks(before: str, after: str) -> tuple[Hunk, ...]:
    a = before.splitlines(keepends=True)
    b = after.splitlines(keepends=True)
    groups = SequenceMatcher(None, a, b, autojunk=False).get_grouped_opcodes(CONTEXT)
    return tuple(
        Hunk(g[0][1], tuple(a[g[0][1] : g[-1][2]]), tuple(b[g[0][3] : g[-1][4]]))
        for g in groups
    )


def _found(lines: list[str], block: tuple[str, ...], near: int) -> int:
    """Where a block of lines stands, nearest to a line; -1 where it does not."""
    size = len(block)
    at = [
        i for i in range(len(lines) - size + 1) if tuple(lines[i : i + size]) == block
    ]
    return min(at, key=lambda i: abs(i - near), default=-1)


def _step(kept: Mapping[str, Any]) -> Step:
    edits = (
        Edit(
            e["name"],
            tuple(
                Hunk(h["at"], tuple(h["before"]), tuple(h["after"])) for h in e["hunks"]
            ),
        )
        for e in kept["edits"]
    )
    return Step(kept["words"], tuple(edits), float(kept["when"]))


def stamp_of(path: Path) -> tuple[int, int]:
    """Time and size of a file; zeros where there is none."""
    try:
        state = path.stat()
    except OSError:
        return 0, 0
    return state.st_mtime_ns, state.st_size
