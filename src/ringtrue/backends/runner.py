"""Running an external program: no terminal, a time limit, its whole log kept, its failures told."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ringtrue.errors import SolverFailed, SolverMissing

TAIL = 12  # lines of the log in an error
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
        What it printed, both streams.
    """

    folder: Path
    status: int
    log: str

    def files(self, *endings: str) -> tuple[Path, ...]:
        """Files with these endings, whatever their case, in the order of the endings."""
        here = sorted(self.folder.iterdir())
        return tuple(f for e in endings for f in here if f.suffix.lower() == e and f.stat().st_size)


def run_program(command: Sequence[str | Path], folder: Path, *, name: str, timeout: float) -> Finished:
    """Run a command in a folder to its end; its processes are ended if it takes too long.

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
    with log.open("wb") as sink:
        try:
            process = subprocess.Popen(
                words, cwd=folder, stdin=subprocess.DEVNULL, stdout=sink, stderr=sink, start_new_session=True
            )
        except OSError as e:
            raise SolverMissing(f"{name}: {words[0]} cannot be started: {e.strerror}") from e
        try:
            status = process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise SolverFailed(f"{name} did not end within {timeout:g} s and was stopped{tail(log)}") from None
        finally:
            _end(process)
    text = log.read_text(encoding="latin-1")
    if any(w in text.lower() for w in _FULL):
        free = shutil.disk_usage(folder).free / 1e9
        raise SolverFailed(f"{name}: the disk of {folder} is full ({free:.2f} GB free){tail(log)}")
    return Finished(folder, status, text)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End what is left of the program and of the processes it started."""
    if process.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()


def tail(log: str | Path) -> str:
    """The last lines of a log (a path or its text), as the end of a message."""
    text = log.read_text(encoding="latin-1") if isinstance(log, Path) else log
    lines = [line.rstrip() for line in text.splitlines() if line.strip()][-TAIL:]
    return "; it said nothing" if not lines else "; the end of its log:\n  " + "\n  ".join(lines)
