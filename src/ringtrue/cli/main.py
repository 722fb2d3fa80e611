"""The command line: parse, call, print. Exit status 0 good, 1 a result that failed its own check, 2 bad input."""

from __future__ import annotations

import sys
from typing import NoReturn

import typer
from typer.exceptions import TyperException
from typer.main import get_command

from ringtrue import __version__
from ringtrue.cli import convert, identify, localise, measure, model, plan, predict, study, track, update
from ringtrue.cli.show import err
from ringtrue.errors import InputError, RingtrueError, UnsupportedError

app = typer.Typer(
    help="Finite element model validation: from a deck and vibration signals to a model that rings true.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(show: bool) -> None:
    if show:
        typer.echo(f"ringtrue {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Finite element model validation."""


for module in (study, model, plan, identify, track, measure, predict, convert, update, localise):
    module.register(app)


def run(arguments: list[str] | None = None) -> int:
    """Run a command line; returns the exit status."""
    try:
        status = get_command(app).main(args=arguments, standalone_mode=False, prog_name="ringtrue")
        return int(status or 0)
    except typer.Exit as e:
        return int(e.exit_code)
    except TyperException as e:
        show = getattr(e, "show", None)  # usage errors draw themselves
        show() if show else err.print(f"error: {e}", markup=False)
        return 2
    except (typer.Abort, KeyboardInterrupt):
        err.print("stopped", markup=False)
        return 1
    except (InputError, UnsupportedError) as e:
        err.print(f"error: {e}", markup=False, highlight=False, soft_wrap=True)
        return 2
    except RingtrueError as e:
        err.print(f"error: {e}", markup=False, highlight=False, soft_wrap=True)
        return 1
    except OSError as e:  # a file that cannot be read or written
        if e.filename is None:
            raise
        err.print(f"error: {e.filename}: {e.strerror}", markup=False, highlight=False, soft_wrap=True)
        return 2


def main() -> NoReturn:
    """The console script."""
    sys.exit(run())
