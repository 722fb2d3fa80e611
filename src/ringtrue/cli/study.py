"""`demo`, `run`, `report` and `studio`: the whole chain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ringtrue.api.studies import ReportFormat, open_study, run_study
from ringtrue.cli.show import (
    ExitStatus,
    Json,
    SideBySide,
    err,
    out,
    progress,
    rows,
    tell,
    warn_of_units,
    write_json,
)
from ringtrue.errors import ConfigError, SolverMissing
from ringtrue.io.foreign.parsers import read_json
from ringtrue.study.acceptance import AcceptanceCheck, adequacy, limits, missed_words, settles
from ringtrue.study.messages import run_messages
from ringtrue.study.stages import STAGES

ORDER = ", ".join(s.name for s in STAGES)


def _verdict(checks: tuple[AcceptanceCheck, ...]) -> int:
    for title, required in (("What must hold", True), ("For information", False)):
        body = [
            ("yes" if c.held else "NO", c.name, c.got, c.wanted)
            for c in checks
            if c.required is required
        ]
        if body:
            rows(title, ("held", "what", "got", "wanted"), body)
    return _status(checks)


def _status(checks: tuple[AcceptanceCheck, ...]) -> int:
    return 0 if all(c.held for c in checks if c.required) else 1


def _summary(folder: Path) -> Any:
    return read_json(folder / "summary.json")


def demo(
    folder: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where everything goes.")
    ] = Path("lsf"),
    seed: Annotated[
        int,
        typer.Option(metavar="N", help="Draws which regions are wrong, by how much, all noise."),
    ] = 0,
    hard: Annotated[
        bool,
        typer.Option(
            "--hard",
            help="The harder one: days of other temperatures, joints that slip, channels at "
            "fault, regions that cut across what is wrong.",
        ),
    ] = False,
    fast: Annotated[bool, typer.Option("--fast", help="Shorter records.")] = False,
    json: Json = None,
) -> int:
    """The worked example: a 1,600 t spin test facility, from deck and raw signals to the validated
    model.

    Example: ringtrue demo --out lsf
    """
    # here, so that no other command needs the worked example
    from ringtrue.demos.lsf.demo import run_demo

    with progress("large spinning facility") as show:
        result = run_demo(folder, seed, hard=hard, fast=fast, progress=show)
    if json:
        write_json(_summary(folder), json)
    if json == "-":
        return _status(result.checks)
    tell(result.lines)
    out.print(f"report: {result.report}")
    return _verdict(result.checks)


def run(
    study: Annotated[Path, typer.Argument(help="study.toml")],
    folder: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where results go.")
    ] = None,
    first: Annotated[
        str | None, typer.Option("--from", metavar="STAGE", help="Run anew from this stage on.")
    ] = None,
    until: Annotated[
        str | None,
        typer.Option("--until", metavar="STAGE", help=f"The last stage to run. Stages: {ORDER}."),
    ] = None,
    workers: SideBySide = None,
    json: Json = None,
) -> int:
    """Run a study: what is up to date is taken from study.h5, the rest is computed.

    Exit status 1: the updating did not converge or fits a kind of data worse than its stated error
    (where the study states limits, these judge an updating that stalled or does not fit), or the
    final model misses a limit of \\[correlate] (accept_percent, accept_hz, accept_mac,
    accept_pairs, accept_mean_percent, accept_mean_mac, accept_orthogonality, accept_off_diagonal)
    that study.toml sets.

    Example: ringtrue run study.toml --until correlate
    """
    try:
        with progress("study") as show:
            done = run_study(
                study, out=folder, first=first, until=until, workers=workers, progress=show
            )
    except KeyboardInterrupt:
        err.print("stopped: the stages that were finished are stored, the same command resumes")
        return ExitStatus.STOPPED
    result = done.run
    if result.config.model is not None:
        warn_of_units(result.session.initial.model, result.config.model.units)
    outcome = None
    if updated := result.results.get("update"):
        outcome = updated.best.outcome
    stated = limits(result.config, result.results)
    unfit = adequacy(result.results, required=not stated)
    if json:
        write_json(_summary(result.folder), json)
    if json != "-":
        for name, seconds in result.timings.items():
            took = "up to date" if name in result.loaded else f"{seconds:.1f} s"
            out.print(f"{name}: {took}")
        tell(run_messages(result.results))
        out.print(f"report: {done.folder / 'report.html'}")
        _verdict((*unfit, *stated))
    for line in missed_words(result.config, result.results):
        err.print(f"not accepted: {line}")
    if outcome is not None and not outcome.ok:
        err.print(f"the updating did not converge: {outcome}")
    return _status((*unfit, *stated)) if settles(outcome, stated) else ExitStatus.FAILED


def report(
    store: Annotated[Path, typer.Argument(help="study.h5, its study.toml, or their folder.")],
    target: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="The file to write.")
    ] = None,
    form: Annotated[
        ReportFormat,
        typer.Option(
            "--format",
            help="html; pdf, printed by an installed Chromium; docx, with the figures as pictures "
            "where there is a Chromium.",
        ),
    ] = "html",
    json: Json = None,
) -> int:
    """Write the report of a stored study anew.

    RINGTRUE_CHROMIUM names the Chromium, where it is not on the PATH.

    Example: ringtrue report lsf/study.h5 --format pdf
    """
    if target is not None and not target.parent.is_dir():
        raise ConfigError(f"--out {target}: no folder {target.parent}")
    stored = open_study(store)
    path = stored.report(target, form)
    if json:
        write_json({"report": str(path)} | stored.summary, json)
    if json != "-":
        out.print(f"report: {path}")
    return 0


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
