"""External programs: the deck that they get, their run without a terminal, and their results.

A program has a time limit, and its whole log is kept. It ends with this process, even one that is
killed: where there are process groups, `guard` is between the two.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.decks.nastran.results.modes import read_nastran_modes
from ringtrue.decks.nastran.results.printed import fatal_messages
from ringtrue.decks.nastran.writer import NOT_MODEL, format_card, large_card, write_bulk
from ringtrue.errors import DataError, SolverFailed, SolverMissing, UnsupportedError
from ringtrue.fem.element_cards import mesh
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.solvers import guard

POLL = 0.02  # s
# what programs print where their disk is full
_DISK_FULL = (
    b"no space left",
    b"disk full",
    b"disk quota exceeded",
    b"disk i/o error",
    b"file system full",
)


@dataclass(frozen=True, slots=True)
class Finished:
    """A program that ran to its end.

    Attributes
    ----------
    folder : Path
        Where it ran; its files are there.
    status : int
        Its exit status; some programs exit 0 on a fatal error.
    log : str
        The end of what it printed, both streams.
    """

    folder: Path
    status: int
    log: str

    def files(self, *endings: str) -> tuple[Path, ...]:
        """Files with these endings, whatever their case, in the order of the endings."""
        here = sorted(self.folder.iterdir())
        return tuple(
            f
            for e in endings
            for f in here
            if f.suffix.lower() == e and f.stat().st_size
        )


def run_program(
    command: Sequence[str | Path], folder: Path, *, name: str, timeout: float
) -> Finished:
    """Run a command in a folder to its end; its processes are ended if it takes too long, or with
    this one.

    Parameters
    ----------
    command : sequence of str or Path
    folder : Path
        Must exist; the log is written there as `ringtrue.log`.
    name : str
        Of the solver, for messages.
    timeout : float, s

    Raises
    ------
    SolverMissing
        If the program cannot be started.
    SolverFailed
        If it did not end in time or its disk is full.
    """
    running = Running(command, folder, name=name)
    try:
        status = running.process.wait(timeout)
    except subprocess.TimeoutExpired:
        raise running.late(timeout) from None
    finally:
        running.end()
    running.check()
    return Finished(folder, status, _last(running.log))


class Running:
    """A program that runs next to this process, and ends with it.

    Parameters
    ----------
    command : sequence of str or Path
    folder : Path
        Must exist; the log is written there as `ringtrue.log`.
    name : str
        Of the solver, for messages.

    Raises
    ------
    SolverMissing
        If the program cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str | Path],
        folder: Path,
        *,
        name: str,
    ) -> None:
        words = [str(c) for c in command]
        self.log = folder / "ringtrue.log"
        self._folder = folder
        self._name = name
        self._program = words[0]
        self._not_started = folder / guard.NOT_STARTED
        self._not_started.unlink(missing_ok=True)
        groups = hasattr(os, "killpg")
        whole = (
            [sys.executable, "-I", "-S", guard.__file__, *words] if groups else words
        )
        with self.log.open("wb") as sink:
            try:
                self.process = subprocess.Popen(
                    whole,
                    cwd=folder,
                    stdin=subprocess.PIPE if groups else subprocess.DEVNULL,
                    stdout=sink,
                    stderr=sink,
                    start_new_session=True,
                )
            except OSError as e:
                raise SolverMissing(
                    f"{name}: {words[0]} cannot be started: {e.strerror}"
                ) from e

    def wait(self, path: Path, timeout: float, *, but: str) -> Path | None:
        """Until the program has written a file, or in its place one of the pattern `but`, which is
        given back.

        Raises
        ------
        SolverMissing, SolverFailed
            If it cannot be started, ends before, takes too long or its disk is full.
        """
        end = time.monotonic() + timeout
        while not path.exists():
            gone = self.process.poll() is not None
            if others := sorted(self._folder.glob(but)):
                return others[0]
            if gone and not path.exists():
                self.check()
                status = self.process.returncode
                raise SolverFailed(
                    f"{self._name} ended with exit status {status}{tail(_last(self.log))}"
                )
            if time.monotonic() > end:
                self.end()
                raise self.late(timeout)
            time.sleep(POLL)
        return None

    def late(self, timeout: float) -> SolverFailed:
        """That it did not end in time."""
        longer = "give it longer by --time-limit SECONDS, or timeout= in Python"
        return SolverFailed(
            f"{self._name} did not end within {timeout:g} s and was stopped: {longer}"
            f"{tail(self.log)}"
        )

    def check(self) -> None:
        """Raise what kept it from its work."""
        if self._not_started.exists():
            why = os.strerror(int(self._not_started.read_text()))
            raise SolverMissing(
                f"{self._name}: {self._program} cannot be started: {why}"
            )
        if _disk_was_full(self.log):
            free = shutil.disk_usage(self._folder).free / 1e9
            raise SolverFailed(
                f"{self._name}: the disk of {self._folder} is full ({free:.2f} GB free)"
                f"{tail(self.log)}"
            )

    def end(self, patience: float = 0.0) -> None:
        """End what is left of it and of the processes it started, if it does not end by itself
        within so many seconds.
        """
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(patience)
        if self.process.poll() is None:
            if hasattr(os, "killpg"):
                os.killpg(self.process.pid, signal.SIGKILL)
            else:
                self.process.kill()
            self.process.wait()
        if self.process.stdin is not None:
            self.process.stdin.close()


def _disk_was_full(log: Path) -> bool:
    """Whether a log, which may be larger than the memory, has a message of a full disk."""
    longest = max(map(len, _DISK_FULL))
    before = b""
    with log.open("rb") as source:
        while piece := source.read(1 << 20):
            text = (before + piece).lower()
            if any(message in text for message in _DISK_FULL):
                return True
            before = text[-longest:]
    return False


def _last(log: Path) -> str:
    """The last 64 kB of a log as text."""
    with log.open("rb") as source:
        source.seek(max(log.stat().st_size - 65_536, 0))
        return source.read().decode("latin-1")


def tail(log: str | Path) -> str:
    """The last 12 lines of a log (a path or its text), as the end of a message."""
    text = _last(log) if isinstance(log, Path) else log
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    if not lines:
        return "; its log is empty"
    return "; the end of its log:\n  " + "\n  ".join(lines[-12:])


DECK = "model.bdf"
METHOD = 1
_OWN_PARAMS = frozenset(("POST", "OUGCORD", "OPTEXIT", "GRDPNT", "POSTEXT", "PRTMAXIM"))


class DeckProgram(Protocol):
    """What differs from program to program.

    Attributes
    ----------
    name : str
    timeout : float, s
    endings : tuple of str
        Of its results files, the most precise first.
    band_by_count : bool
        Whether its Lanczos method takes a number of modes only, not a band.
    more_bulk : str
        Further bulk data.
    """

    name: str
    timeout: float
    endings: tuple[str, ...]
    band_by_count: bool
    more_bulk: str

    def command(self, deck: Path) -> Sequence[str | Path]:
        """The command line; it runs in the folder of the deck."""
        ...

    def adapted(self, model: Model) -> Model:
        """The model with what this program wants to have written out."""
        ...

    def proof(
        self, run: Finished, modes: ModeSet, request: ModesRequest
    ) -> tuple[bool, str]:
        """Whether and how it proves that no mode is missing."""
        ...


def modes_deck(model: Model, request: ModesRequest, program: DeckProgram) -> str:
    """A SOL 103 deck: unit modal mass, all displacements printed and plotted."""
    low, high = request.band or (None, None)
    # a rigid-body mode may be a little below 0
    low = None if low is None or low <= 0 else low
    count = None if request.band else request.count
    eigrl = large_card("EIGRL", (METHOD, low, high, count, None, None, None, "MASS"))
    case = [
        "SOL 103",
        "CEND",
        *case_control(model),
        "DISPLACEMENT(PRINT,PLOT) = ALL",
        "BEGIN BULK",
    ]
    return "\n".join(case) + "\n" + eigrl + bulk(model, program) + "ENDDATA\n"


def case_control(model: Model) -> list[str]:
    """The choices of constraint sets and method."""
    chosen = [
        ("SPC", model.case.spc),
        ("MPC", model.case.mpc),
        ("NSM", model.case.nsm),
        ("METHOD", METHOD),
    ]
    matrices = [
        ("K2GG", model.case.k2gg),
        ("M2GG", model.case.m2gg),
        ("B2GG", model.case.b2gg),
    ]
    added = [
        f"{name} = " + ", ".join(f"{a:.9G}*{m}" for a, m in terms)
        for name, terms in matrices
        if terms
    ]
    return [
        "TITLE = RINGTRUE",
        "ECHO = NONE",
        *(f"{name} = {sid}" for name, sid in chosen if sid),
        *added,
    ]


def bulk(model: Model, program: DeckProgram) -> str:
    """The model, what makes the program write OP2, and what it wants besides."""
    own = format_card("PARAM", ("POST", -1)) + program.more_bulk
    return own + write_bulk(program.adapted(model), without={*NOT_MODEL, *_OWN_PARAMS})


class DeckAnalysis:
    """A model handed to a program as a deck; see `ringtrue.model.ports.Analysis`.

    Each request is a run in a folder of its own, removed at the end unless `keep` names a folder.
    """

    capabilities = frozenset({"modes"})

    def __init__(
        self,
        model: Model,
        program: DeckProgram,
        *,
        keep: Path | None = None,
    ) -> None:
        self.model = whole_mesh(model)
        self.program = program
        self.dofs: DofSet = mesh(model).dofs
        self._temporary = (
            None if keep else tempfile.mkdtemp(prefix=f"ringtrue-{program.name}-")
        )
        self._folder = Path(self._temporary or str(keep))
        self._done: dict[ModesRequest, ModesResult] = {}

    def modes(self, request: ModesRequest) -> ModesResult:
        """Natural modes; one run of the program a request.

        Raises
        ------
        SolverMissing, SolverFailed
            If the program is not there, ends with a fatal error or writes no modes.
        """
        if request not in self._done:
            by_count = request.band is not None and self.program.band_by_count
            self._done[request] = (
                self._band(request) if by_count else self._modes(request)
            )
        return self._done[request]

    def derivatives(
        self, modes: ModeSet, parameters: ParameterSet
    ) -> tuple[Float, Any_]:
        """Not offered by this program.

        Raises
        ------
        UnsupportedError
            Always; `capabilities` says so beforehand.
        """
        raise UnsupportedError(
            f"{self.program.name} gives no derivatives; use the embedded solver"
        )

    def run(self, deck: str) -> Finished:
        """Run a deck; fatal messages of the printed file become an error."""
        number = len(list(self._folder.glob("run*"))) if self._folder.is_dir() else 0
        folder = self._folder / f"run{number + 1}"
        folder.mkdir(parents=True)
        path = folder / DECK
        path.write_text(deck, encoding="ascii")
        name = self.program.name
        done = run_program(
            self.program.command(path), folder, name=name, timeout=self.program.timeout
        )
        fatal = [m for f in done.files(".f06", ".err") for m in fatal_messages(f)]
        if fatal:
            raise SolverFailed(
                f"{name} stopped with a fatal error:\n  "
                + "\n  ".join(fatal[0].splitlines())
            )
        if done.status:
            raise SolverFailed(
                f"{name} ended with exit status {done.status}{tail(done.log)}"
            )
        return done

    def _modes(self, request: ModesRequest) -> ModesResult:
        done = self.run(modes_deck(self.model, request, self.program))
        modes = self._read(done)
        if request.band is None:
            modes = modes.take(slice(0, request.count))
        complete, proof = self.program.proof(done, modes, request)
        return ModesResult(modes, np.full(len(modes), np.nan), complete, proof)

    def _band(self, request: ModesRequest) -> ModesResult:
        """All modes of a band from a program that takes a number: asked for twice as many until
        they pass the band.
        """
        low, high = request.band or (0.0, 0.0)
        count = request.count
        most = len(self.dofs) // 2
        while True:
            found = self.modes(ModesRequest(count))
            above = found.modes.frequencies[-1:] > high
            if above.all() or len(found.modes) < count or count >= most:
                break
            count = min(2 * count, most)
        inside = found.modes.band(-np.inf if low <= 0 else low, high)
        return ModesResult(
            inside, np.full(len(inside), np.nan), found.complete, found.proof
        )

    def _read(self, done: Finished) -> ModeSet:
        """Modes from the most precise file that holds them, on this analysis' DOFs."""
        files = done.files(*self.program.endings)
        written = self.program.adapted(self.model)
        problems = []
        for path in files:
            try:
                found = read_nastran_modes(path, written, mass_normalised=True)
            except DataError as e:
                problems.append(str(e))
                continue
            return self._aligned(found)
        nothing = (
            f"no file {' or '.join(self.program.endings)}; its command must wait for the "
            "job (MSC: bat=no)"
        )
        what = "; ".join(problems) or nothing
        raise SolverFailed(
            f"{self.program.name} wrote no modes: {what}{tail(done.log)}"
        )

    def _aligned(self, found: ModeSet) -> ModeSet:
        labels = found.labels
        assert isinstance(labels, DofSet)
        at = labels.find(self.dofs.node, self.dofs.direction)
        if (at < 0).any():
            lost = self.dofs.labels()[int(np.flatnonzero(at < 0)[0])]
            raise SolverFailed(
                f"{self.program.name} wrote modes without {lost} and {int((at < 0).sum()) - 1} "
                "more DOFs"
            )
        return replace(
            found,
            shapes=found.shapes[at],
            labels=self.dofs,
            norm=Norm.MASS,
            source=self.program.name,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._temporary:
            shutil.rmtree(self._temporary, ignore_errors=True)
