"""Writes docs/settings.md, all settings of study.toml, from the configuration classes.

python scripts/settings.py
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ringtrue.study.config import StudyConfig

PAGE = Path(__file__).parents[1] / "docs" / "settings.md"
INTRODUCTION = """# Settings of study.toml

Generated from the configuration classes by `python scripts/settings.py`. Unknown keys are refused.
A table in double brackets, such as `[[candidate]]`, may stand several times.
"""
WORDS = {
    bool: "true or false",
    int: "integer",
    float: "number",
    str: "text",
    type(None): "",
}


def page() -> str:
    """The whole page as Markdown."""
    parts = [INTRODUCTION]
    for name, field in StudyConfig.model_fields.items():
        for section in sections_of(field.annotation):
            several = "list" in str(field.annotation)
            head = f"[[{name}]]" if several else f"[{name}]"
            parts.append(section_text(head, section))
    return "\n".join(parts)


def section_text(head: str, section: type[BaseModel]) -> str:
    """A table of study.toml: its keys with type, default and meaning."""
    kind = section.model_fields.get("kind")
    if kind is not None and get_origin(kind.annotation) is Literal:
        allowed = get_args(kind.annotation)
        if len(allowed) == 1:
            head = f'{head} kind = "{allowed[0]}"'
    lines = [f"## {head}", "", *documentation(section)]
    lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
    nested = []
    for key, field in section.model_fields.items():
        value = type_text(field.annotation)
        cells = (f"`{key}`", value + limits(field), default_text(field), meaning(field))
        lines.append(
            "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
        )
        for inner in sections_of(field.annotation):
            nested.append(section_text(f"[[{head.strip('[]')}.{key}]]", inner))
    return "\n".join([*lines, "", *nested])


def documentation(section: type[BaseModel]) -> list[str]:
    """The docstring of a class, as a paragraph."""
    text = " ".join((section.__doc__ or "").split())
    return [text, ""] if text else []


def sections_of(annotation: Any) -> Iterator[type[BaseModel]]:
    """The configuration classes in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from sections_of(part)


def type_text(annotation: Any) -> str:
    """A type in the words of TOML."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(f'`"{part}"`' for part in parts)
    if origin in (Union, UnionType):
        texts = [text for text in map(type_text, parts) if text]
        return " or ".join(texts)
    if origin in (list, tuple):
        return f"list of {type_text(parts[0])}"
    if origin is dict:
        return f"table of {type_text(parts[1])}"
    if origin is not None:  # Annotated
        return type_text(parts[0])
    if annotation in WORDS:
        return WORDS[annotation]
    return "table"


def limits(field: FieldInfo) -> str:
    """The bounds of a number."""
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    found = []
    for bound in field.metadata:
        for name, sign in signs.items():
            value = getattr(bound, name, None)
            if value is not None:
                found.append(f"{sign} {value:g}")
    return f", {', '.join(found)}" if found else ""


def default_text(field: FieldInfo) -> str:
    """The default as TOML has it; empty where none is stated."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value in ("", [], {}, ()):
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, BaseModel):
        return ""
    return f"`{value}`".replace("'", '"')


def meaning(field: FieldInfo) -> str:
    """The docstring of a key."""
    return " ".join((field.description or "").split())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
