"""`studio`: the study in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ringtrue.cli.show import err, out, progress
from ringtrue.errors import SolverMissing


def studio(
    what: Annotated[
        Path | None,
        typer.Argument(
            metavar="[STUDY | DECK | RECORD]",
            help="study.toml or its folder; a deck or a record, next to which a study may begin.",
        ),
    ] = None,
    demo: Annotated[
        bool,
        typer.Option("--demo", help="A worked example, in a folder that is named, or in ./frame."),
    ] = False,
    port: Annotated[
        int, typer.Option(metavar="N", help="0: any that is free.", min=0, max=65535)
    ] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page.")] = True,
) -> int:
    """A study in the browser, on this machine alone: poles, pairs, updating and report.

    What is clicked is written into study.toml, choice.toml and the sensor sheet; the same runs
    without the studio. Needs ringtrue\\[studio].

    Example: ringtrue studio --demo
    """
    try:
        from ringtrue.studio.launch import serve
        from ringtrue.studio.session import opened
    except ModuleNotFoundError as e:
        raise SolverMissing(f"{e.name} is missing: pip install 'ringtrue[studio]'") from e
    if demo:
        # here, so that no other study needs the worked example
        from ringtrue.api.studies import run_study, store_of
        from ringtrue.demos.frame import write_demo

        folder = what or Path("frame")
        folder.mkdir(parents=True, exist_ok=True)
        what = write_demo(folder)
        if not store_of(what).exists():
            with progress("worked example") as show:
                run_study(what, until="correlate", progress=show)

    def say(address: str) -> None:
        out.print(f"ringtrue studio: {address}")
        err.print("Ctrl-C ends it; what was changed is in the files of the study.")

    session = opened(what)
    session.example = demo
    serve(session, port=port, browser=browser, say=say)
    return 0
