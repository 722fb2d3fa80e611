"""Files that are read."""

from __future__ import annotations

from pathlib import Path

from ringtrue.errors import DataError
from ringtrue.io.atomic import reads


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


def read_text(path: Path) -> str:
    """Text in UTF-8, UTF-16 with its mark, or Latin-1, as editors and instruments write it.

    Raises
    ------
    DataError
        If there are zero bytes: a binary file.
    """
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", "replace")
    if b"\x00" in raw:
        raise DataError(f"{path}: has zero bytes; this is not a text file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
