"""Files that are read."""

from __future__ import annotations

from pathlib import Path

from ringtrue.errors import DataError


def existing(path: str | Path) -> Path:
    """`path` as a Path.

    Raises
    ------
    DataError
        If there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    return path
