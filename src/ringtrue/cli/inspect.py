"""`inspect`: what is in files, and which commands take them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ringtrue.api.inspection import FileContents, FilePart, inspect_file
from ringtrue.cli.show import ExitStatus, Json, out, tell, write_json
from ringtrue.errors import DataError

SHOWN = 8  # names on a line


def inspect(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Files of any format and any name."),
    ],
    json: Json = None,
) -> int:
    """What is in a file, with shapes, units and rates, and which command takes it.

    The content of a file says what it is, not its name: decks, results of solvers, records, FRFs,
    modes, sensor sheets, universal files, studies and choices.

    Example: ringtrue inspect record.mat model.txt
    """
    found = []
    for path in files:
        try:
            contents = inspect_file(path)
        except DataError as exc:
            contents = FileContents(str(path), "unknown", (), str(exc))
        found.append(contents)
        if json != "-":
            _show(contents)
    if json:
        write_json({"files": [_as_json(contents) for contents in found]}, json)
    return ExitStatus.REFUSED if any(contents.problem for contents in found) else 0


def _show(contents: FileContents) -> None:
    out.print(f"{contents.path}: {contents.format}")
    for part in contents.parts:
        tell(f"  {line}" for line in _lines(part))
        tell(f"    {command}" for command in part.commands)
    if contents.problem:
        out.print(f"  {contents.problem.removeprefix(f'{contents.path}: ')}")


def _lines(part: FilePart) -> list[str]:
    """The figures on one line, each list of names on a line of its own."""
    figures = []
    lists = []
    for name, value in part.values.items():
        if isinstance(value, dict):
            value = [f"{count} {key}" for key, count in value.items()]
        if name.endswith("_hz") and isinstance(value, list):
            figures += [f"{value[0]:.5g} to {value[1]:.5g} Hz"] if value else []
        elif isinstance(value, list):
            more = f" and {len(value) - SHOWN} more" if len(value) > SHOWN else ""
            text = ", ".join(map(str, value[:SHOWN]))
            lists += [f"  {name}: {text}{more}"] if value else []
        elif value is None:
            figures += ["no rate in the file"] if name == "rate_hz" else []
        elif isinstance(value, float):
            quantity, _, unit = name.partition("_")
            figures.append(
                f"{quantity} {value:.6g} {unit.replace('hz', 'Hz')}".rstrip()
            )
        else:
            what = name.removesuffix("s") if value == 1 else name
            figures.append(f"{value} {what}" if isinstance(value, int) else str(value))
    return [f"{part.kind}: {', '.join(figures)}" if figures else part.kind, *lists]


def _as_json(contents: FileContents) -> dict[str, Any]:
    return {
        "path": contents.path,
        "format": contents.format,
        "parts": [
            {"kind": p.kind, **p.values, "commands": list(p.commands)}
            for p in contents.parts
        ],
        "problem": contents.problem or None,
    }
