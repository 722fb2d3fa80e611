"""Files that are read and files that are written.

All that ringtrue writes goes through `atomic_write`: a file is written whole or not at all, and
never in the place of an input. Within a run (`one_run`) the files that were read are known by
device and inode: no link, hard link, other case or other path leads round it. The readers
announce what they read (`reads`), commands and studies what they will write (`writes`), so that a
run that would replace an input ends before any work.
"""

from __future__ import annotations

import os
import re
import socket
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np

from ringtrue.core.arrays import Any_
from ringtrue.errors import DataError, InputError, did_you_mean

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
    outer = _RUN.get() or _Run()
    mine = _Run(
        dict(outer.inputs), list(outer.targets), set(outer.written), set(outer.kept)
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
        if (
            what is not None
            and what not in run.written
            and path.resolve() not in run.kept
        ):
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
    # a scratch file that is gone leaves its number to others
    if source is None or _identity(source) != what:
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
        with part.open("rb") as file:
            os.fsync(file.fileno())
        umask = os.umask(0)  # there is no way to read it but to set it
        os.umask(umask)
        os.chmod(part, 0o666 & ~umask)
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
    if run is not None and (what := _identity(target)) is not None:
        run.written.add(what)


def _sweep(folder: Path) -> None:
    """Remove the temporary files of processes of this machine that are gone."""
    entries: list[Path] = []
    with suppress(OSError):
        entries = list(folder.glob(".*.part"))
    for part in entries:
        found = _PART.fullmatch(part.name)
        if found and not _alive(int(found[1])):
            with suppress(OSError):
                part.unlink()


def _alive(process: int) -> bool:
    """Whether a process runs; where it cannot be asked, it may."""
    if os.name == "posix":  # elsewhere a signal of 0 would end it
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass
    return True


def absence(path: Path) -> str:
    """Why there is no file to read, in words."""
    return "a folder; name a file in it" if path.is_dir() else "no such file"


def existing(path: str | Path) -> Path:
    """`path` as a Path; it is an input of the run from now on.

    Raises
    ------
    DataError
        If there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: {absence(path)}")
    reads(path)
    return path


def read_text(path: Path, most: int | None = None) -> str:
    """Text in UTF-8, UTF-16 with its mark, or Latin-1, as editors and instruments write it.

    Of a file of more than `most` bytes, the whole lines among the first so many.

    Raises
    ------
    DataError
        If there are zero bytes: a binary file.
    """
    with path.open("rb") as file:
        raw = file.read(most)
    if len(raw) == most and b"\n" in raw:
        raw = raw[: raw.rindex(b"\n")]
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", "replace")
    if b"\x00" in raw:
        raise DataError(f"{path}: has zero bytes; this is not a text file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


FUNCTIONS = {  # of data set 58, by function type
    0: "general functions",
    1: "time records",
    2: "auto spectra",
    3: "cross spectra",
    4: "FRFs",
    5: "transmissibilities",
    6: "coherences",
    9: "spectra",
    12: "spectra",
}
_SETS = {
    15: "nodes",
    18: "coordinate systems",
    55: "mode shapes or other data at nodes",
    58: "functions",
    82: "trace lines",
    151: "a header",
    164: "units",
    1858: "attributes of functions",
    2411: "nodes",
    2412: "elements",
    2414: "mode shapes or other data at nodes",
    2420: "coordinate systems",
    2431: "trace lines",
}
_TAKES = (
    "`ringtrue oma` takes records, `ringtrue ema` FRFs and records with a force, `ringtrue "
    "correlate` modes, and a sensor sheet the points of a test"
)


def functions_held(kinds: Iterable[int]) -> str:
    """How many functions of which types a universal file holds, and which command takes them."""
    count = Counter(FUNCTIONS.get(k, f"functions of type {k}") for k in kinds)
    return f"it holds {', '.join(f'{n} {what}' for what, n in count.items())}; {_TAKES}"


def sets_held(kinds: Iterable[int]) -> str:
    """What the data sets of a universal file hold, and which command takes it."""
    named = [f"{_SETS.get(k, 'data sets')} ({k})" for k in sorted(set(kinds))]
    return f"it holds {', '.join(named)}; {_TAKES}"


def refuse_twice(names: Sequence[str], what: str, path: str | Path) -> None:
    """Refuse names of which one occurs twice.

    Raises
    ------
    DataError
    """
    if twice := sorted({n for n in names if names.count(n) > 1}):
        raise DataError(f"{path}: {what} {' '.join(twice[:8])} occurs twice")


def refuse_ending(path: Path, allowed: Iterable[str]) -> NoReturn:
    """Say that a file has an ending that is none of those allowed.

    Raises
    ------
    DataError
    """
    raise DataError(
        f"{path}: format {path.suffix!r}{did_you_mean(path.suffix, allowed)}"
    )


# of any unit: MAC has products of four, updating of six, which stay below 1.8e308
LARGEST = 1e50


def refuse_large(values: Any_, what: str) -> None:
    """Refuse numbers above `LARGEST` in size; what is not a number passes.

    Parameters
    ----------
    values : (...) float64 or complex128
    what : str
        Names the numbers in the error.

    Raises
    ------
    DataError
    """
    size = np.abs(np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=-np.inf))
    if size.size and size.max() > LARGEST:
        raise DataError(
            f"{what}: {size.max():.3g} is no measured value; allowed are up to {LARGEST:g} in size"
        )
