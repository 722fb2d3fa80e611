"""JSON and TOML: any text of an editor, and no deeper or larger than such files are."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from ringtrue.errors import DataError, InputError
from ringtrue.io.files import existing, read_text
from ringtrue.io.foreign.door import MEGABYTE, check_size, door

LARGEST = 256 * MEGABYTE  # shapes of 100,000 channels and 100 modes
DEEPEST = 50  # tables within tables; ringtrue's own have 6
_WIDEST = 1 << 63  # of integers: 64 bits


def read_json(path: str | Path, error: type[InputError] = DataError) -> Any:
    """The value in a JSON file of UTF-8, UTF-16 with its mark, or Latin-1.

    Raises
    ------
    InputError
        Of the class `error`: the file is missing or not JSON, its lists are nested more than
        `DEEPEST` deep, or an integer has more than 64 bits.
    """
    path = existing(path)
    check_size(path, LARGEST, "JSON file", error)
    return json_value(read_text(path), path, error)


def json_value(text: str, path: str | Path, error: type[InputError] = DataError) -> Any:
    """The value of a JSON text; `path` names it in errors, as `read_json` has them."""
    with door(path, "JSON text", error, "open it in an editor"):
        try:
            return _bounded(json.loads(text), path, error)
        except json.JSONDecodeError as exc:
            raise error(f"{path}:{exc.lineno}: not JSON: {exc.msg}") from exc
        except RecursionError as exc:
            raise _too_deep(path, error) from exc


def read_toml(path: str | Path, error: type[InputError] = DataError) -> dict[str, Any]:
    """The tables of a TOML file; limits and errors as `read_json` has them."""
    path = existing(path)
    check_size(path, LARGEST, "TOML file", error)
    return toml_value(read_text(path), path, error)


def toml_value(text: str, path: str | Path, error: type[InputError] = DataError) -> dict[str, Any]:
    """The tables of a TOML text; `path` names it in errors, as `read_json` has them."""
    with door(path, "TOML text", error, "open it in an editor"):
        try:
            table: dict[str, Any] = _bounded(tomllib.loads(text), path, error)
            return table
        except tomllib.TOMLDecodeError as exc:
            raise error(f"{path}: not TOML: {exc}") from exc
        except RecursionError as exc:
            raise _too_deep(path, error) from exc


def _bounded(value: Any, path: str | Path, error: type[InputError]) -> Any:
    """The value, if it is not too deep and its integers are not too wide."""
    level = [value]
    for _ in range(DEEPEST):
        inside: list[Any] = []
        for part in level:
            if isinstance(part, dict):
                inside += part.values()
            elif isinstance(part, list):
                inside += part
            elif isinstance(part, int) and not -_WIDEST <= part < _WIDEST:
                raise error(
                    f"{path}: an integer of {len(str(abs(part)))} digits; it must have 64 bits "
                    "or less"
                )
        if not inside:
            return value
        level = inside
    raise _too_deep(path, error)


def _too_deep(path: str | Path, error: type[InputError]) -> InputError:
    return error(
        f"{path}: lists or tables nested more than {DEEPEST} deep: this is no file of settings "
        "or modes"
    )
