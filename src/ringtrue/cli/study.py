"""`demo`, `run` and `report`: the whole chain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ringtrue.cli.show import out, progress, rows
from ringtrue.report.deliver import deliver, report_from_store
from ringtrue.study.run import run_study
from ringtrue.study.summary import Check


def _verdict(checks: tuple[Check, ...]) -> int:
    if checks:
        body = [("yes" if c.held else "NO", c.name, c.got, c.wanted) for c in checks]
        rows("What must hold", ("held", "what", "got", "wanted"), body)
    return 0 if all(c.held for c in checks) else 1


def demo(
    folder: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where everything goes.")] = Path("lsf"),
    seed: Annotated[int, typer.Option(metavar="N", help="Draws which regions are wrong, by how much, all noise.")] = 0,
    fast: Annotated[bool, typer.Option("--fast", help="Shorter records.")] = False,
    full: Annotated[bool, typer.Option("--full", help="With the 11.4-hour ambient record.")] = False,
) -> int:
    """The worked example: a 1,600 t spin test facility, from deck and raw signals to the validated model.

    Example: ringtrue demo --out lsf
    """
    from ringtrue.demos.lsf.demo import run_demo  # here, so that no other command needs the worked example

    with progress("large spinning facility") as show:
        result = run_demo(folder, seed, fast=fast, full=full, progress=show)
    for line in result.lines:
        out.print(line, markup=False, highlight=False)
    out.print(f"report: {result.report}", markup=False, soft_wrap=True)
    return _verdict(result.checks)


def run(
    study: Annotated[Path, typer.Argument(help="study.toml")],
    folder: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where results go.")] = None,
    first: Annotated[str | None, typer.Option("--from", metavar="STAGE", help="Run anew from this stage on.")] = None,
    until: Annotated[str | None, typer.Option("--until", metavar="STAGE", help="The last stage to run.")] = None,
) -> int:
    """Run a study: what is up to date is taken from study.h5, the rest is computed.

    Example: ringtrue run study.toml --until correlate
    """
    with progress("study") as show:
        result = run_study(study, out=folder, first=first, until=until, progress=show)
        report = deliver(result)
    for name, seconds in result.timings.items():
        out.print(f"{name}: {seconds:.1f} s", markup=False, highlight=False)
    for name in result.loaded:
        out.print(f"{name}: up to date", markup=False, highlight=False)
    out.print(f"report: {report}", markup=False, soft_wrap=True)
    return 0


def report(
    store: Annotated[Path, typer.Argument(help="study.h5")],
    target: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="The HTML file.")] = None,
) -> int:
    """Write the report of a stored study anew.

    Example: ringtrue report lsf/study.h5
    """
    path = report_from_store(store, target)
    out.print(f"report: {path}", markup=False, soft_wrap=True)
    return 0


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (demo, run, report):
        app.command()(command)
