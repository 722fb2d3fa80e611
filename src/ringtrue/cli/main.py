"""The command line: parse, call, print; `cli.show` lists the exit statuses."""

from __future__ import annotations

import ast
import platform
import re
import sys
from collections.abc import Callable, Sequence
from errno import EDQUOT, ENOSPC
from functools import wraps
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from signal import SIGTERM, default_int_handler, signal
from tempfile import NamedTemporaryFile
from traceback import format_exception
from typing import Any, NoReturn

import typer
from typer.exceptions import TyperException
from typer.main import get_command

from ringtrue import __version__
from ringtrue.cli.show import ExitStatus, err, in_words
from ringtrue.errors import InputError, RingtrueError, UnsupportedError
from ringtrue.io.files import one_run, reads, writes

PANELS = {  # panel -> command -> module of `ringtrue.cli` and function
    "Whole studies": {
        "demo": ("study", "demo"),
        "run": ("study", "run"),
        "report": ("study", "report"),
        "inspect": ("inspect", "inspect"),
        "studio": ("study", "studio"),
    },
    "Models": {
        "check": ("model", "check"),
        "modes": ("model", "modes"),
        "frf": ("respond", "frf"),
        "static": ("respond", "static"),
        "reduce": ("model", "reduce"),
        "convert": ("convert", "convert"),
    },
    "Tests": {
        "plan": ("plan", "plan"),
        "oma": ("identify", "oma"),
        "ema": ("identify", "ema"),
        "track": ("correlate", "track"),
    },
    "Models and tests": {
        "correlate": ("correlate", "correlate"),
        "localise": ("update", "localise"),
        "update": ("update", "update"),
        "predict": ("study", "predict"),
    },
}

# What names a file or folder that a command writes (of `convert` the argument `target`); other
# paths are its inputs.
OUTPUTS = {
    "--json",
    "--out",
    "--csv",
    "--plot",
    "--diagram",
    "--write-choice",
    "--write-frfs",
    "--checkpoint",
    "--members",
    "target",
}

COMMANDS = {name: place for panel in PANELS.values() for name, place in panel.items()}

STOPPED = "stopped: no file was left half written"


def _version(show: bool) -> None:
    if show:
        typer.echo(f"ringtrue {__version__}")
        raise typer.Exit


def _root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Finite element model validation."""


def application(arguments: Sequence[str]) -> typer.Typer:
    """With the command that is asked for: the others take seconds to import, and show their words
    in the help only.
    """
    app = typer.Typer(
        help="Finite element model validation: from a deck and vibration signals to a model that "
        "rings true.",
        epilog=in_words(),
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    asked = [a for a in arguments if a != "--"][
        :1
    ]  # behind other options stands none: they show something and end
    known = COMMANDS.keys() & asked
    for panel, commands in PANELS.items():
        for name, (module, function) in commands.items():
            if name in known or not known:
                body = (
                    getattr(import_module(f"ringtrue.cli.{module}"), function)
                    if known
                    else _nothing
                )
                app.command(name, help=_words(module, function), rich_help_panel=panel)(
                    _interruptible(body)
                )
    return app


def _interruptible(body: Callable[..., int | None]) -> Callable[..., int | None]:
    """The command, which says that it was stopped: typer turns a KeyboardInterrupt into a status
    without a word.
    """

    @wraps(body)
    def command(*given: Any, **named: Any) -> int | None:
        try:
            return body(*given, **named)
        except KeyboardInterrupt:
            err.print(STOPPED)
            return ExitStatus.STOPPED

    return command


def _words(module: str, function: str) -> str:
    """The docstring of a function of `ringtrue.cli`, without what its module imports; a line a
    paragraph.
    """
    tree = ast.parse(files("ringtrue.cli").joinpath(f"{module}.py").read_text("utf-8"))
    (found,) = (
        f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name == function
    )
    return re.sub(r"(?<!\n)\n(?!\n)", " ", ast.get_docstring(found) or "")


def _careful(body: Callable[..., Any], parameters: Sequence[Any]) -> Callable[..., Any]:
    """A command that first names its files: none that it reads is replaced by what it writes."""
    outputs = {p.name for p in parameters if OUTPUTS & set(p.opts)}

    @wraps(body)
    def called(**given: Any) -> Any:
        for name, value in given.items():
            several = value if isinstance(value, list | tuple) else (value,)
            if name in outputs:
                writes(
                    *(
                        Path(v)
                        for v in several
                        if v is not None and not Path(v).is_dir()
                    )
                )
            else:
                reads(*(v for v in several if isinstance(v, Path) and v.is_file()))
        return body(**given)

    return called


def _nothing() -> None:
    """In the place of a command that is not asked for."""


def run(arguments: list[str] | None = None) -> int:
    """Run a command line; returns the exit status. A fault of ringtrue is raised: `main` reports
    it.
    """
    try:
        given = sys.argv[1:] if arguments is None else arguments
        command: Any = get_command(application(given))
        for asked in command.commands.values():
            asked.callback = _careful(asked.callback, asked.params)
        with one_run():
            status = command.main(
                args=given, standalone_mode=False, prog_name="ringtrue"
            )
        return int(status or 0)
    except typer.Exit as e:
        return int(e.exit_code)
    except TyperException as e:
        show = getattr(e, "show", None)  # usage errors draw themselves
        show() if show else err.print(f"error: {e}")
        return ExitStatus.REFUSED
    except (typer.Abort, KeyboardInterrupt):
        err.print(STOPPED)
        return ExitStatus.STOPPED
    except (InputError, UnsupportedError) as e:
        err.print(f"error: {e}")
        return ExitStatus.REFUSED
    except RingtrueError as e:
        err.print(f"error: {e}")
        return ExitStatus.FAILED
    except OSError as e:  # a file that cannot be read or written
        if e.errno in (ENOSPC, EDQUOT):
            err.print(
                f"error: {e.strerror}: free some; what is stored is whole, the same command resumes"
            )
            return ExitStatus.FAILED
        if e.filename is None:
            raise
        err.print(f"error: {e.filename}: {e.strerror}")
        return ExitStatus.REFUSED


def report_fault(fault: Exception, arguments: Sequence[str]) -> int:
    """Write the traceback of a fault of ringtrue to a file of its own, and say where."""
    details = [
        f"ringtrue {__version__}, Python {platform.python_version()}, {platform.platform()}",
        f"ringtrue {' '.join(arguments)}",
        "".join(format_exception(fault)),
    ]
    what = f"error: this is a fault of ringtrue, not of your input: {type(fault).__name__}: {fault}"
    try:
        with NamedTemporaryFile(
            "w", prefix="ringtrue-fault-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write("\n".join(details))
    except OSError:  # no room for the file: the details go to the screen
        err.print("\n".join([what, *details]))
        return ExitStatus.FAULT
    err.print(
        f"{what}\nthe details were written to {file.name}: please report them, with the input if "
        "you can"
    )
    return ExitStatus.FAULT


def main() -> NoReturn:
    """The console script; a batch system that ends it (SIGTERM) stops it as Ctrl-C does."""
    signal(SIGTERM, default_int_handler)
    try:
        status = run()
    # the outermost border: whatever arrives here no one has foreseen
    except Exception as fault:
        status = report_fault(fault, sys.argv[1:])
    sys.exit(status)
