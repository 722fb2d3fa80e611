"""What is wrong with a study.toml or a log, in words: where, what was found, and the nearest
allowed key.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from ringtrue.errors import did_you_mean


def explain(path: Path, error: ValidationError, top: type[BaseModel], whole: str = "study") -> str:
    """One line for each mistake in a file that should be a `top`."""
    lines = []
    for e in error.errors():
        place = ".".join(str(x) for x in e["loc"])
        if e["type"] == "extra_forbidden":
            hint = did_you_mean(str(e["loc"][-1]), _allowed(top, e["loc"][:-1]))
            lines.append(f"{path}: unknown key {place!r}{hint}")
        else:
            lines.append(f"{path}: {place or whole}: {_said(dict(e), place)}")
    return "\n".join(lines)


def _said(e: Mapping[str, Any], place: str) -> str:
    """What is wrong with a value, and what was given."""
    given, about = e["input"], e.get("ctx", {})
    if e["type"] == "model_type" and isinstance(given, list):
        return f"one section, not a list of them (in TOML [{place}], not [[{place}]])"
    if e["type"] == "list_type" and isinstance(given, dict):
        return f"a list of sections, not one (in TOML [[{place}]], not [{place}])"
    if e["type"] == "union_tag_not_found":
        return "Field required: kind"
    if e["type"] == "union_tag_invalid":
        allowed = [x.strip(" '") for x in about["expected_tags"].split(",")]
        return f"unknown kind {about['tag']!r}{did_you_mean(about['tag'], allowed)}"
    got = (
        f" (got {given!r})"
        if isinstance(given, str | int | float | list) and e["type"] != "missing"
        else ""
    )
    return str(e["msg"]).removeprefix("Value error, ") + got


def _allowed(top: type[BaseModel], location: tuple[Any, ...]) -> list[str]:
    """The keys of the section at a location; a step that is no key is the `kind` of one of several
    sections.
    """
    here = [top]
    for step in (s for s in location if not isinstance(s, int)):
        of_kind = [
            m
            for m in here
            if "kind" in m.model_fields and step in get_args(m.model_fields["kind"].annotation)
        ]
        fields = [m.model_fields[step].annotation for m in here if step in m.model_fields]
        here = of_kind or [m for f in fields for m in _sections(f)]
    return [name for m in here for name in m.model_fields]


def _sections(annotation: Any) -> list[type[BaseModel]]:
    """All sections in an annotation such as list[A | B] or A | None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in get_args(annotation) for m in _sections(part)]
