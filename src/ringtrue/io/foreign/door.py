"""What a foreign parser raises on a damaged file becomes an error that names the file and says what
to try.
"""

from __future__ import annotations

import csv
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError

from ringtrue.errors import DataError, InputError, RingtrueError

MEGABYTE = 1 << 20
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
    path: str | Path, kind: str, error: type[InputError] = DataError, advice: str = EXPORT_AGAIN
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
        told = f"{type(exc).__name__}: {said}" if said else type(exc).__name__
        raise error(f"{path}: not a readable {kind}, or damaged ({told}): {advice}") from exc


def check_size(path: Path, most: int, kind: str, error: type[InputError] = DataError) -> None:
    """Refuse a file of more than `most` bytes.

    Raises
    ------
    InputError
    """
    if (size := path.stat().st_size) > most:
        raise error(f"{path}: {size / MEGABYTE:.0f} MB; a {kind} may have {most / MEGABYTE:.0f} MB")
