"""One click as one small edit of a text: study.toml, a choice of modes, a sensor sheet.

Each function gives a `Change`, from the text as it is to the text as it will be. Comments and the
order of what stands there stay.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import tomlkit
from tomlkit.items import AoT, Array, Comment, String, Table

from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.io.choices import NEW_CHOICE

Change = Callable[[str], str]


def put(where: Sequence[str], value: Any) -> Change:
    """Set a key, such as ("correlate", "mac_gate"); its tables are made if need be.

    Parameters
    ----------
    where : sequence of str
        Tables and the key. A table that stands several times is meant by its number, from 0, as
        in ("candidate", "0", "upper").
    value : bool, int, float, str, list or dict
        None takes the key out.
    """

    *tables, key = where
    return put_all(tables, {key: value})


def put_all(where: Sequence[str], values: Mapping[str, Any]) -> Change:
    """Set several keys of a table in one step, as `put` sets one."""

    def change(text: str) -> str:
        document = _parsed(text)
        here: Any = document
        for name in where:
            if isinstance(here, AoT):
                here = here[int(name)]
                continue
            if name not in here:
                here[name] = tomlkit.table()
            here = here[name]
        for key, value in values.items():
            if value is None:
                here.pop(key, None)
            else:
                here[key] = value
        return tomlkit.dumps(document)

    return change


def add_entry(name: str, entry: Mapping[str, Any]) -> Change:
    """Add one table to those of a name, such as `[[pick]]`: behind the last of them, or at the
    end.
    """

    def change(text: str) -> str:
        wanted = _parsed(text).unwrap()
        if not wanted.get(name):
            text = text if name not in wanted else put((name,), None)(text)
            wanted[name] = []
        wanted[name].append(dict(entry))
        lines = text.splitlines(keepends=True)
        body = tomlkit.dumps({name: [dict(entry)]}).splitlines(keepends=True)
        for _, end in reversed(_tables(lines, name)):
            made = "".join([*lines[:end], "\n", *body, *lines[end:]])
            if _parsed(made).unwrap() == wanted:
                return made
        lead = "" if not text or text.endswith("\n") else "\n"
        return text + lead + ("\n" if text else "") + "".join(body)

    return change


def remove_entry(name: str, number: int) -> Change:
    """Take out one of the tables of a name, by its number from 0."""

    def change(text: str) -> str:
        wanted = _parsed(text).unwrap()
        count = len(wanted.get(name, []))
        if not 0 <= number < count:
            raise ConfigError(f"[[{name}]] {number + 1}: there are {count}")
        lines = text.splitlines(keepends=True)
        tables = _tables(lines, name)
        if len(tables) != count:
            raise ConfigError(f"[[{name}]]: written as a list; take it out in an editor")
        start, end = tables[number]
        if start and end < len(lines) and not lines[start - 1].strip() and lines[end].strip():
            end -= 1  # an empty line stays
        while start and not lines[start - 1].strip():
            start -= 1
        return "".join([*lines[:start], *lines[end:]])

    return change


def _parsed(text: str) -> tomlkit.TOMLDocument:
    """The text as it will be written again, every byte.

    Raises
    ------
    ConfigError
        If tables of one name stand between others, where they could not be left.
    """
    document = tomlkit.parse(text)
    if tomlkit.dumps(document) != text:
        raise ConfigError(
            "tables of one name, such as [[candidate]], stand between others: bring them together "
            "in an editor, or edit there"
        )
    return document


def _tables(lines: Sequence[str], name: str) -> list[tuple[int, int]]:
    """First line and end of each `[[name]]`, without the comments above what follows."""
    heads = [i for i, line in enumerate(lines) if re.match(r"\s*\[", line)]
    found = []
    for i, after in pairwise([*heads, len(lines)]):
        if not re.match(rf"\s*\[\[\s*\"?{re.escape(name)}\"?\s*\]\]", lines[i]):
            continue
        end = after
        while end > i + 1 and (not lines[end - 1].strip() or lines[end - 1].lstrip()[0] == "#"):
            end -= 1
        found.append((i, end))
    return found


def in_choice(change: Change) -> Change:
    """The same in a choice of modes, which is begun where there is none: the automatic modes
    stay.
    """
    return lambda text: change(text or NEW_CHOICE)


def decide_pair(decision: str, pair: str, reason: str) -> Change:
    """Lock or forbid a pair such as `3:7` under [correlate]; the reason is its comment.

    Raises
    ------
    ConfigError
        If there is no reason, or the pair is there already.
    """
    words = " ".join(reason.split())
    if not words:
        raise ConfigError(f"{decision} {pair}: needs a reason, which goes into study.toml with it")

    def change(text: str) -> str:
        document = _parsed(text)
        if "correlate" not in document:
            document["correlate"] = tomlkit.table()
        section = document["correlate"]
        assert isinstance(section, Table)
        rows = _with_reasons(section.get(decision))
        if pair in rows:
            raise ConfigError(f"correlate.{decision}: holds {pair} already")
        section[decision] = _array(rows | {pair: words})
        return tomlkit.dumps(document)

    return change


def undecide_pair(decision: str, pair: str) -> Change:
    """Take a pair out of `lock` or `forbid`, with its reason."""

    def change(text: str) -> str:
        document = _parsed(text)
        section: Any = document.get("correlate", {})
        rows = _with_reasons(section.get(decision))
        if pair not in rows:
            raise ConfigError(f"correlate.{decision}: no pair {pair}{did_you_mean(pair, rows)}")
        del rows[pair]
        if rows:
            section[decision] = _array(rows)
        else:
            section.pop(decision)
        return tomlkit.dumps(document)

    return change


def reasons(text: str, decision: str) -> dict[str, str]:
    """The pairs of `lock` or `forbid` with their reasons."""
    if decision not in text:  # reading all of a text with its comments takes long
        return {}
    section: Any = tomlkit.parse(text).get("correlate", {})
    return _with_reasons(section.get(decision))


def _with_reasons(array: Any) -> dict[str, str]:
    """Texts of an array and the comment that follows each."""
    found: dict[str, str] = {}
    if not isinstance(array, Array):
        return found
    last = ""
    for item in array._iter_items():
        if isinstance(item, Comment):
            found |= {last: item.as_string().strip(" #\t\n")} if last else {}
        elif isinstance(item, String):
            last = str(item)
            found[last] = ""
    return found


def _array(rows: Mapping[str, str]) -> Array:
    """A line for each text, with its comment."""
    array = tomlkit.array()
    for text, words in rows.items():
        array.add_line(text, indent="    ", comment=words or None)
    array.add_line(indent="")
    return array
