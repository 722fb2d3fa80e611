"""What the commands print: tables and progress by rich, JSON to a file or standard output."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars
from rich.table import Table

from ringtrue.checks.materials import check_units
from ringtrue.core.iterate import Progress
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.io.files import atomic_write
from ringtrue.model.model import Model


class ExitStatus(IntEnum):
    """How a command ended; `ringtrue --help` lists the same words."""

    DONE = 0
    FAILED = 1
    REFUSED = 2
    FAULT = 70  # EX_SOFTWARE of sysexits.h
    STOPPED = 130  # 128 + SIGINT, as shells have it


WORDS = {
    ExitStatus.DONE: "done",
    ExitStatus.FAILED: "a result missed its own check or a stated limit, or a computation or "
    "solver failed",
    ExitStatus.REFUSED: "the input or an option is wrong or not supported: nothing was computed",
    ExitStatus.FAULT: "a fault of ringtrue: the message names the file with its details",
    ExitStatus.STOPPED: "stopped by Ctrl-C or by a batch system (SIGTERM)",
}


def in_words() -> str:
    """All of them in one paragraph."""
    return (
        "Exit status: "
        + "; ".join(f"{status.value} {what}" for status, what in WORDS.items())
        + "."
    )


# names in brackets and lines like `wing.bdf:100:` stay as they are, lines are the terminal's to
# wrap
out = Console(markup=False, emoji=False, highlight=False, soft_wrap=True)
err = Console(
    stderr=True,
    markup=False,
    emoji=False,
    highlight=False,
    soft_wrap=True,
)


@contextmanager
def progress(label: str) -> Iterator[Progress]:
    """A bar on a terminal, plain lines in a log."""
    if not err.is_terminal:
        last = ""

        def line(fraction: float, text: str) -> None:
            nonlocal last
            if text != last:
                last = text
                err.print(f"[{100 * fraction:3.0f} %] {text}")

        yield line
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Bars(*columns, console=err, transient=True) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda fraction, text: bar.update(
            task, completed=fraction, description=text[:60].ljust(60)
        )


def rows(title: str, heads: Sequence[str], body: Sequence[Sequence[object]]) -> None:
    """A table; numbers to the right."""
    out.print(title, style="italic")
    table = Table(header_style="bold", box=None, pad_edge=False)
    for i, head in enumerate(heads):
        number = any(isinstance(r[i], (int, float)) for r in body)
        table.add_column(head, justify="right" if number else "left")
    for r in body:
        table.add_row(*(str(x) for x in r))
    out.print(table, soft_wrap=False)


def tell(lines: Iterable[str]) -> None:
    """Print lines."""
    for line in lines:
        out.print(line)


def listed(numbers: Sequence[int]) -> str:
    """Ascending numbers as `1-6, 9`."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and n == runs[-1][-1] + 1:
            runs[-1] = [runs[-1][0], n]
        else:
            runs.append([n])
    return ", ".join("-".join(map(str, r)) for r in runs)


def json_target(value: str | None) -> str | None:
    """The target as given, refused before any work is done if its folder is not there."""
    if value not in (None, "-") and not Path(str(value)).parent.is_dir():
        raise ConfigError(f"--json {value}: no folder {Path(str(value)).parent}")
    return value


Json = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write JSON; - is standard output.",
        callback=json_target,
    ),
]


def file_to(option: str, what: str, *endings: str) -> Any:
    """An option with a file to write, its folder there and its ending allowed, before any work;
    `what` is its help.
    """

    def check(value: Path | None) -> Path | None:
        if value is not None and not value.parent.is_dir():
            raise ConfigError(f"{option} {value}: no folder {value.parent}")
        if value is not None and value.is_dir():
            raise ConfigError(f"{option} {value}: a folder; name a file in it")
        if value is not None and value.suffix.lower() not in endings:
            raise ConfigError(
                f"{option} {value}: format {value.suffix!r}{did_you_mean(value.suffix, endings)}"
            )
        return value

    return typer.Option(
        option, metavar="FILE", help=f"{what}: {', '.join(endings)}.", callback=check
    )


def one_of(option: str, allowed: Iterable[str], what: str, otherwise: str = "") -> Any:
    """An option that takes one of some names, refused before any work is done; `what` is its help.

    `otherwise` is what is taken where an option without a default is not given.
    """
    names = tuple(allowed)

    def check(value: str | None) -> str | None:
        if value and value not in names:
            raise ConfigError(f"{option} {value!r}{did_you_mean(value, names)}")
        return value

    return typer.Option(
        option,
        metavar="NAME",
        help=f"{what}: {', '.join(names)}.",
        callback=check,
        show_default=otherwise or True,
    )


SideBySide = Annotated[
    str | None,
    typer.Option(
        "--workers",
        metavar="N",
        help="Processes side by side, or a dask scheduler: tcp://host:8786.",
        show_default="that of the study, or 1",
    ),
]
Units = Annotated[str, one_of("--units", UNIT_SYSTEMS, "Unit system of the deck")]
Tolerance = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="Largest distance of a sensor from a node.",
        min=1e-9,
        show_default="3 % of the deck, or a mesh width",
    ),
]


@contextmanager
def json_file(target: str) -> Iterator[TextIO]:
    """What `--json` names, written whole or not at all; `-` is standard output."""
    if target == "-":
        yield sys.stdout
        return
    with atomic_write(Path(target)) as part, part.open("w", encoding="utf-8") as file:
        yield file


def write_json(value: Any, target: str) -> None:
    """JSON to a file, whole or not at all; `-` is standard output."""
    text = json.dumps(value, indent=1, allow_nan=False) + "\n"
    with json_file(target) as file:
        file.write(text)


def warn_of_units(model: Model, units: str) -> None:
    """Print what is not plausible of a deck in a unit system."""
    for finding in check_units(model, units):
        err.print(str(finding))
