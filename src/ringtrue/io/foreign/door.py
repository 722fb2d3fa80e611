"""The door to parsers of others: their limits, their errors, and a process for some of them.

What a parser raises on a damaged file becomes an error that names the file and says what to try
(`door`). Parsers in C that can end the process or never come back run in a process of their own
(`read_apart`). scipy 1.17: `mmread` ends the process on 0.1 % of the damaged MatrixMarket files,
`loadmat` on 4 % of the MATLAB files. HDF5 2.0: of 10,000 damaged files one hangs, one ends the
process and one takes gigabytes; `tried_apart` opens it first. One child serves all reads of a
process, so that a file costs its start once; it has limits of time and memory.
"""

from __future__ import annotations

import atexit
import csv
import os
import pickle
import struct
import subprocess
import sys
import threading
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tokenize import TokenError
from typing import Any

from ringtrue.errors import DataError, InputError, RingtrueError
from ringtrue.io.files import existing

MEGABYTE = 1 << 20
# times that a data set may be larger than its file: records of constants are packed 200 times
PACKED = 1000
DAMAGE = (  # all that the parsers were seen to raise in 10^6 damaged files
    ArithmeticError,
    AssertionError,
    AttributeError,
    BufferError,
    csv.Error,
    EOFError,
    LookupError,
    MemoryError,
    NameError,  # scipy, of a sound file without samples
    OSError,
    RuntimeError,  # RecursionError and NotImplementedError, too
    SystemError,  # h5py
    SyntaxError,  # of XML, and of the Python text in a .npy file
    TokenError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    zlib.error,
)
EXPORT_AGAIN = "write or export the file again"
_SHOWN = 200  # characters of what the parser says


@contextmanager
def door(
    path: str | Path,
    kind: str,
    error: type[InputError] = DataError,
    advice: str = EXPORT_AGAIN,
) -> Iterator[None]:
    """What is raised within, as `error`: "`path`: not a readable `kind`, or damaged (what the
    parser said): `advice`".

    Raises
    ------
    InputError
        Of the class `error`. Errors of ringtrue's own pass as they are, and so does a file that may
        not be opened.
    """
    try:
        yield
    except (RingtrueError, PermissionError, FileNotFoundError, IsADirectoryError):
        raise
    except DAMAGE as exc:
        said = " ".join(str(exc).split())
        said = said if len(said) <= _SHOWN else f"{said[:_SHOWN]} ..."
        cause = f"{type(exc).__name__}: {said}" if said else type(exc).__name__
        raise error(
            f"{path}: not a readable {kind}, or damaged ({cause}): {advice}"
        ) from exc


_SECONDS = 5.0  # for any file
_RATE = 5 * MEGABYTE  # bytes a second that a parser reads at least
_MEMORY = 512 * MEGABYTE  # for any file
_TIMES = 16  # and that many times its size
_START = (
    "import sys; sys.path[:] = sys.argv[1:]; from "
    "ringtrue.io.foreign.child import serve; serve()"
)


class _Child:
    """The process, and the lock of its two pipes."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.lock = threading.Lock()
        self.late = False
        self.process = subprocess.Popen(
            [sys.executable, "-c", _START, *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        assert self.process.stdout is not None
        self.process.stdout.read(1)  # it is there: its start is no time of a parser

    def ask(
        self, parser: str, path: Path, seconds: float, memory: int
    ) -> tuple[str, Any]:
        """`done` with the value, else `failed` with why not, in words."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        watch = threading.Timer(seconds, self._stop)
        try:
            pickle.dump(
                (parser, str(path.absolute()), seconds, memory), self.process.stdin
            )
            self.process.stdin.flush()
            self.process.stdout.read(1)  # the parser is imported
            watch.start()
            answer: tuple[str, Any] = pickle.load(self.process.stdout)
            return answer
        except BaseException as exc:
            # of Ctrl-C, too: what is left of this answer must not be taken for the next one
            self.process.kill()
            self.process.wait()
            if not isinstance(exc, (EOFError, BrokenPipeError, pickle.UnpicklingError)):
                raise
            if self.late:
                return "failed", f"its parser did not come back in {seconds:.0f} s"
            return "failed", "its parser ended its process"
        finally:
            watch.cancel()

    def _stop(self) -> None:
        self.late = True
        self.process.kill()

    def close(self) -> None:
        """End the process, if it is this one's."""
        if self.owner != os.getpid():
            return
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                # what was not sent is lost with the process
                with suppress(BrokenPipeError):
                    pipe.close()


_child: _Child | None = None
_choose = threading.Lock()
_tried: dict[tuple[str, tuple[int, int, int, int]], Any] = {}


def read_apart(
    parser: str, path: str | Path, kind: str, advice: str = EXPORT_AGAIN
) -> Any:
    """What `child.PARSERS[parser]` makes of a file.

    Raises
    ------
    DataError
        If the parser fails, ends its process, or needs more time or memory than such a file may.
    """
    path = existing(path)
    size = path.stat().st_size
    seconds = _SECONDS + size / _RATE
    child = _running()
    with child.lock:
        how, value = child.ask(parser, path, seconds, _MEMORY + _TIMES * size)
    if how == "done":
        return value
    raise DataError(f"{path}: not a readable {kind}, or damaged ({value}): {advice}")


def tried_apart(parser: str, path: Path, kind: str, advice: str) -> Any:
    """What `read_apart` gives, asked once for each state of the file, before this process opens it.

    Raises
    ------
    DataError
        As `read_apart` does.
    """
    state = _state(path)
    if (parser, state) not in _tried:
        _tried[parser, state] = read_apart(parser, path, kind, advice)
    return _tried[parser, state]


def need_not_try(parser: str, path: Path, answer: Any) -> None:
    """Note the answer for a file that this process has just written itself."""
    _tried[parser, _state(path)] = answer


def _state(path: Path) -> tuple[int, int, int, int]:
    found = path.stat()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _running() -> _Child:
    """The child of this process; a new one where there is none, it has ended, or it is that of the
    parent.
    """
    global _child
    with _choose:
        if (
            _child is None
            or _child.owner != os.getpid()
            or _child.process.poll() is not None
        ):
            _close()
            _child = _Child()
        return _child


@atexit.register
def _close() -> None:
    global _child
    if _child is not None:
        _child.close()
    _child = None
