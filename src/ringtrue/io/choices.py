"""Choices of modes and hits by hand as .toml or .json, to be edited and replayed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

from ringtrue.core.choice import Choice, Hit, Merge, Pick, Reject
from ringtrue.errors import ConfigError, about, did_you_mean
from ringtrue.io.files import atomic_write, existing
from ringtrue.io.foreign.parsers import read_json, read_toml, toml_value
from ringtrue.io.recognition import Format, format_of

_KINDS = {"pick": Pick, "reject": Reject, "merge": Merge, "hit": Hit}
_HEAD = """\
# A choice of modes. automatic = false: only what is picked here is reported; delete a [[pick]] to leave its mode out.
# automatic = true: the automatic modes stay, and the entries change them.
# [[pick]]   frequency (Hz), order (model order of the pole, if it is no automatic mode), record, note
# [[reject]] frequency (Hz), reason, record
# [[merge]]  frequencies (Hz) that are one mode, reason, record
# [[hit]]    record, time (s) of a hit of a hammer, keep (true or false), reason
"""
NEW_CHOICE = _HEAD + "automatic = true\n"  # the text of a choice that changes nothing


def read_choice(path: str | Path) -> Choice:
    """Read a choice.

    Raises
    ------
    DataError
        If there is no such file.
    ConfigError
        If it is no TOML or JSON, or an entry has a key or value that is not allowed.
    """
    path = existing(path)
    if format_of(path) is not Format.JSON:
        return _choice(read_toml(path, ConfigError), str(path))
    table = read_json(path, ConfigError)
    if not isinstance(table, dict):
        raise ConfigError(
            f"{path}: not a choice; it must have `pick`, `reject`, `merge` or `hit`"
        )
    return _choice(table, str(path))


def parse_choice(text: str, path: str | Path) -> Choice:
    """A choice from a TOML text; `path` names it in errors, as `read_choice` has them."""
    return _choice(toml_value(text, path, ConfigError), str(path))


def _choice(table: Mapping[str, Any], source: str) -> Choice:
    allowed = ("automatic", *_KINDS)
    for key in table:
        if key not in allowed:
            raise ConfigError(
                f"{source}: unknown key {key!r}{did_you_mean(key, allowed)}"
            )
    automatic = table.get("automatic", True)
    if not isinstance(automatic, bool):
        raise ConfigError(
            f"{source}: automatic is {automatic!r}; it must be true or false"
        )
    parts: dict[str, tuple[Any, ...]] = {}
    for name in _KINDS:
        rows = table.get(name, [])
        if not isinstance(rows, list) or not all(isinstance(r, dict) for r in rows):
            raise ConfigError(f"{source}: {name} must be a list of tables")
        entries = (
            _entry(name, row, f"{source}: {name} {i}") for i, row in enumerate(rows, 1)
        )
        parts[name] = tuple(entries)
    return Choice(
        parts["pick"],
        parts["reject"],
        parts["merge"],
        automatic,
        source,
        hits=parts["hit"],
    )


# of the values of an entry; others are texts
_WANTED = {
    "frequency": ((int, float), "a number, Hz"),
    "frequencies": ((int, float), "a list of numbers, Hz"),
    "order": ((int,), "a whole number"),
    "time": ((int, float), "a number, s"),
    "keep": ((bool,), "true or false"),
}


def _entry(name: str, row: Mapping[str, Any], where: str) -> Any:
    kind = _KINDS[name]
    known = {f.name: f for f in fields(kind)}
    for key, value in row.items():
        if key not in known:
            raise ConfigError(f"{where}: unknown key {key!r}{did_you_mean(key, known)}")
        types, wanted = _WANTED.get(key, ((str,), "a text"))
        several = isinstance(value, list)
        numbers = value if several else [value]
        if several != (key == "frequencies") or not {type(x) for x in numbers} <= set(
            types
        ):
            raise ConfigError(f"{where}: {key} is {value!r}; it must be {wanted}")
    if lost := [k for k, f in known.items() if f.default is MISSING and k not in row]:
        raise ConfigError(f"{where}: {' and '.join(lost)} missing")
    with about(where):
        return kind(**row)


def write_choice(path: str | Path, choice: Choice) -> None:
    """Write a choice as `.toml` or `.json`, by the ending of the path.

    Raises
    ------
    ConfigError
        If the ending is another one.
    """
    path = Path(path)
    table = {
        "automatic": choice.automatic,
        "pick": [_row(p) for p in choice.picks],
        "reject": [_row(r) for r in choice.rejects],
        "merge": [_row(m) for m in choice.merges],
        "hit": [asdict(h) for h in choice.hits],
    }
    ending = path.suffix.lower()
    if ending == ".json":
        text = json.dumps(table, indent=1, ensure_ascii=False) + "\n"
    elif ending == ".toml":
        text = _HEAD + f"automatic = {str(choice.automatic).lower()}\n" + _tables(table)
    else:
        raise ConfigError(
            f"{path}: format {ending!r}{did_you_mean(ending, ['.toml', '.json'])}"
        )
    with atomic_write(path) as part:
        part.write_text(text, encoding="utf-8")


def _row(entry: Pick | Reject | Merge) -> dict[str, Any]:
    """The entry without what is empty."""
    return {
        k: list(v) if isinstance(v, tuple) else v for k, v in asdict(entry).items() if v
    }


def _tables(table: Mapping[str, Any]) -> str:
    out = ""
    for name in _KINDS:
        for row in table[name]:
            # JSON texts, numbers and lists of numbers are TOML too
            body = "".join(
                f"{k} = {json.dumps(v, ensure_ascii=False)}\n" for k, v in row.items()
            )
            out += f"\n[[{name}]]\n{body}"
    return out
