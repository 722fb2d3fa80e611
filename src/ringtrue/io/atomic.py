"""Writes that either happen completely or not at all, and never in the place of an input.

All that ringtrue writes goes through `atomic_write`. Within a run (`one_run`) it knows the files
that were read, by what they are and not by their names: no link, hard link, other case or other way
to a folder leads round it. The readers announce what they read (`reads`), commands and studies what
they will write (`writes`), so that a run that would replace an input ends before any work.
"""

from __future__ import annotations

import os
import re
import socket
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from ringtrue.errors import InputError

Identity = tuple[int, int]  # device and inode
_HOST = re.sub(r"\W", "", socket.gethostname())[:32] or "host"
_PART = re.compile(rf"\..+\.{_HOST}-(\d+)-\w+\.part")


@dataclass(slots=True)
class _Run:
    """The files of a run: what it has read, what it will write, what it has written, and what it
    keeps up.
    """

    inputs: dict[Identity, Path] = field(default_factory=dict)
    targets: list[Path] = field(default_factory=list)
    written: set[Identity] = field(default_factory=set)
    kept: set[Path] = field(default_factory=set)


_RUN: ContextVar[_Run | None] = ContextVar("run", default=None)


@contextmanager
def one_run() -> Iterator[None]:
    """Within it no file that is read is replaced; a run within a run knows the files of both."""
    outer = _RUN.get()
    mine = (
        _Run(dict(outer.inputs), list(outer.targets), set(outer.written), set(outer.kept))
        if outer
        else _Run()
    )
    token = _RUN.set(mine)
    try:
        yield
    finally:
        _RUN.reset(token)


def reads(*paths: str | Path) -> None:
    """These files are inputs of the run. What it has written itself is none.

    Raises
    ------
    InputError
        If one of them is to be written.
    """
    if (run := _RUN.get()) is None:
        return
    for path in map(Path, paths):
        what = _identity(path)
        if what is not None and what not in run.written and path.resolve() not in run.kept:
            run.inputs[what] = path
    for target in run.targets:
        _refuse_input(run, target)


def keeps_up(path: Path) -> None:
    """A file that the run both reads and writes anew, as a store of results: it is no input."""
    if (run := _RUN.get()) is not None:
        run.kept.add(path.resolve())


def writes(*paths: str | Path) -> None:
    """These files will be written by the run.

    Raises
    ------
    InputError
        If one of them is an input.
    """
    if (run := _RUN.get()) is None:
        return
    for path in map(Path, paths):
        _refuse_input(run, path)
        run.targets.append(path)


def _refuse_input(run: _Run, target: Path) -> None:
    what = _identity(target)
    source = run.inputs.get(what) if what is not None else None
    if (
        source is None or _identity(source) != what
    ):  # a scratch file that is gone leaves its number to others
        return
    same = "" if source == target else f" (it is {source})"
    raise InputError(
        f"{target}: an input of this run{same} would be replaced; name another file or folder to "
        "write"
    )


def _identity(path: Path) -> Identity | None:
    """What a path leads to; None where there is nothing."""
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_dev, state.st_ino


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """A temporary path in the folder of `path` that replaces it when the block ends without an
    error.

    What killed processes have left in the folder is removed.

    Parameters
    ----------
    path : path
        The file to write; its folder must exist.

    Yields
    ------
    Path
        Write here. After an error the temporary file is removed and the old `path` stays as it was.

    Raises
    ------
    InputError
        If `path` is an input of this run.
    """
    target = Path(path)
    run = _RUN.get()
    if run is not None:
        _refuse_input(run, target)
    _sweep(target.parent)
    owner = f".{target.name}.{_HOST}-{os.getpid()}-"
    handle, name = tempfile.mkstemp(prefix=owner, suffix=".part", dir=target.parent)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        _sync(part)
        os.chmod(part, 0o666 & ~_umask())
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
    if run is not None and (what := _identity(target)) is not None:
        run.written.add(what)


def _sweep(folder: Path) -> None:
    """Remove the temporary files of processes of this machine that are gone."""
    for name in _parts(folder):
        found = _PART.fullmatch(name)
        if found and not _alive(int(found.group(1))):
            with suppress(OSError):
                (folder / name).unlink()


def _parts(folder: Path) -> Iterable[str]:
    with suppress(OSError), os.scandir(folder) as entries:
        return [e.name for e in entries if e.name.endswith(".part")]
    return []


def _alive(process: int) -> bool:
    """Whether a process runs; where it cannot be asked, it may."""
    if os.name != "posix":  # there a signal of 0 would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _umask() -> int:
    """The umask; there is no way to read it but to set it."""
    now = os.umask(0)
    os.umask(now)
    return now
