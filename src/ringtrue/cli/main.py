"""The command line: parse, call, print. Exit status 0 good, 1 a result that failed its own check, 2 bad input."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Sequence
from errno import EDQUOT, ENOSPC
from importlib import import_module
from importlib.resources import files
from signal import SIGTERM, default_int_handler, signal
from typing import Any, NoReturn

import typer
from typer.exceptions import TyperException
from typer.main import get_command

from ringtrue import __version__
from ringtrue.cli import panels
from ringtrue.cli.show import err
from ringtrue.errors import InputError, RingtrueError, UnsupportedError

COMMANDS = {name: place for panel in panels.COMMANDS.values() for name, place in panel.items()}


def _version(show: bool) -> None:
    if show:
        typer.echo(f"ringtrue {__version__}")
        raise typer.Exit


def _root(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Finite element model validation."""


def application(arguments: Sequence[str]) -> typer.Typer:
    """With the command that is asked for: the others take seconds to import, and show their words in the help only."""
    app = typer.Typer(
        help="Finite element model validation: from a deck and vibration signals to a model that rings true.",
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    asked = [a for a in arguments if a != "--"][:1]  # behind other options stands none: they show something and end
    known = COMMANDS.keys() & asked
    for panel, commands in panels.COMMANDS.items():
        for name, (module, function) in commands.items():
            if name in known or not known:
                body = getattr(import_module(f"ringtrue.cli.{module}"), function) if known else _nothing
                app.command(name, help=_words(module, function), rich_help_panel=panel)(body)
    return app


def _words(module: str, function: str) -> str:
    """The docstring of a function of `ringtrue.cli`, without what its module imports; a line a paragraph."""
    tree = ast.parse(files("ringtrue.cli").joinpath(f"{module}.py").read_text("utf-8"))
    (found,) = (f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name == function)
    return re.sub(r"(?<!\n)\n(?!\n)", " ", ast.get_docstring(found) or "")


def _command(arguments: Sequence[str]) -> Any:
    """The application with its options in their panels."""
    command: Any = get_command(application(arguments))
    for name, groups in panels.OPTIONS.items():
        panel_of = {parameter: panel for panel, names in groups.items() for parameter in names}
        for parameter in command.commands[name].params if name in command.commands else ():
            parameter.rich_help_panel = panel_of.get(parameter.name)
    return command


def _nothing() -> None:
    """In the place of a command that is not asked for."""


def run(arguments: list[str] | None = None) -> int:
    """Run a command line; returns the exit status."""
    try:
        given = sys.argv[1:] if arguments is None else arguments
        status = _command(given).main(args=given, standalone_mode=False, prog_name="ringtrue")
        return int(status or 0)
    except typer.Exit as e:
        return int(e.exit_code)
    except TyperException as e:
        show = getattr(e, "show", None)  # usage errors draw themselves
        show() if show else err.print(f"error: {e}")
        return 2
    except (typer.Abort, KeyboardInterrupt):
        err.print("stopped")
        return 1
    except (InputError, UnsupportedError) as e:
        err.print(f"error: {e}")
        return 2
    except RingtrueError as e:
        err.print(f"error: {e}")
        return 1
    except OSError as e:  # a file that cannot be read or written
        if e.errno in (ENOSPC, EDQUOT):
            err.print(f"error: {e.strerror}: free some; what is stored is whole, the same command resumes")
            return 1
        if e.filename is None:
            raise
        err.print(f"error: {e.filename}: {e.strerror}")
        return 2


def main() -> NoReturn:
    """The console script; a batch system that ends it (SIGTERM) stops it as Ctrl-C does."""
    signal(SIGTERM, default_int_handler)
    sys.exit(run())
