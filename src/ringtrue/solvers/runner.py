"""Running an external program: no terminal, a time limit, its whole log kept, its failures told.

It ends with this process, even one that is killed: where there are process groups, `guard` stands
between the two.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ringtrue.errors import SolverFailed, SolverMissing
from ringtrue.solvers import guard

TAIL = 12  # lines of the log in an error
_LAST = 65_536  # bytes of the end of a log that are kept
_PIECE = 1 << 20  # bytes of a log that are looked through at once
_FULL = ("no space left", "disk full", "disk quota exceeded", "disk i/o error", "file system full")


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
        return tuple(f for e in endings for f in here if f.suffix.lower() == e and f.stat().st_size)


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
    words = [str(c) for c in command]
    log = folder / "ringtrue.log"
    groups = hasattr(os, "killpg")
    whole = [sys.executable, "-I", "-S", guard.__file__, *words] if groups else words
    with log.open("wb") as sink:
        try:
            process = subprocess.Popen(
                whole,
                cwd=folder,
                stdin=subprocess.PIPE if groups else subprocess.DEVNULL,
                stdout=sink,
                stderr=sink,
                start_new_session=True,
            )
        except OSError as e:
            raise SolverMissing(f"{name}: {words[0]} cannot be started: {e.strerror}") from e
        try:
            status = process.wait(timeout)
        except subprocess.TimeoutExpired:
            longer = "give it longer by --time-limit SECONDS, or timeout= in Python"
            raise SolverFailed(
                f"{name} did not end within {timeout:g} s and was stopped: {longer}{tail(log)}"
            ) from None
        finally:
            _end(process)
    if groups and status == guard.NOT_STARTED and (why := _last(log)).startswith(guard.WHY):
        raise SolverMissing(
            f"{name}: {words[0]} cannot be started: {why.removeprefix(guard.WHY).strip()}"
        )
    if _tells_of_a_full_disk(log):
        free = shutil.disk_usage(folder).free / 1e9
        raise SolverFailed(f"{name}: the disk of {folder} is full ({free:.2f} GB free){tail(log)}")
    return Finished(folder, status, _last(log))


def _tells_of_a_full_disk(log: Path) -> bool:
    """Whether a log says so; it may be larger than the memory."""
    longest = max(map(len, _FULL))
    before = b""
    with log.open("rb") as source:
        while piece := source.read(_PIECE):
            text = (before + piece).lower()
            if any(words.encode() in text for words in _FULL):
                return True
            before = text[-longest:]
    return False


def _last(log: Path) -> str:
    """The last bytes of a log as text."""
    with log.open("rb") as source:
        source.seek(max(log.stat().st_size - _LAST, 0))
        return source.read().decode("latin-1")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End what is left of the program and of the processes it started."""
    if process.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()
    if process.stdin is not None:
        process.stdin.close()


def tail(log: str | Path) -> str:
    """The last lines of a log (a path or its text), as the end of a message."""
    text = _last(log) if isinstance(log, Path) else log
    lines = [line.rstrip() for line in text.splitlines() if line.strip()][-TAIL:]
    return "; it said nothing" if not lines else "; the end of its log:\n  " + "\n  ".join(lines)
