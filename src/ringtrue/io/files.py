"""Files that are read."""

from __future__ import annotations

from pathlib import Path

from ringtrue.errors import DataError


def absence(path: Path) -> str:
    """Why there is no file to read, in words."""
    return "a folder; name a file in it" if path.is_dir() else "no such file"


def existing(path: str | Path) -> Path:
    """`path` as a Path.

    Raises
    ------
    DataError
        If there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: {absence(path)}")
    return path
