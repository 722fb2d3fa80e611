"""One run of a study at a time: a lock that the operating system releases when its process ends,
however it ends.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ringtrue.errors import DataError

_log = logging.getLogger(__name__)

FILE = "study.h5.lock"  # beside the store while a study runs
_FAR = 1 << 30  # where Windows locks a byte: what stands before it can be read


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Alone in the folder of a study, which is made if need be, and goes again where nothing was
    written.

    The file that a killed process has left is taken over: its lock is gone with it.

    Raises
    ------
    DataError
        If another run has it.
    """
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    handle = _taken(path)
    try:
        os.truncate(handle, 0)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
        yield
    finally:
        with suppress(OSError):  # Windows keeps a file that is open
            path.unlink()
        os.close(handle)
        if new:
            with suppress(OSError):  # it holds results
                folder.rmdir()


def _taken(path: Path) -> int:
    """The lock file, opened and locked; tried again if its last owner has removed it in between."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(handle)
            if path.exists() and os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        except FileNotFoundError:
            pass
        except BlockingIOError as e:
            owner = os.read(handle, 200).decode(errors="replace") or "another process"
            os.close(handle)
            raise DataError(
                f"{path.parent}: {owner} runs this study; wait for its end, or write elsewhere "
                "with --out"
            ) from e
        except OSError as e:
            _log.warning(
                "%s: its file system has no locks (%s); start no second run on this study",
                path.parent,
                e,
            )
            return handle
        os.close(handle)


def _lock(handle: int) -> None:
    """Take the lock, or raise BlockingIOError."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError as e:
            raise BlockingIOError(str(e)) from e
        finally:
            os.lseek(handle, 0, os.SEEK_SET)
        return
    import fcntl

    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
