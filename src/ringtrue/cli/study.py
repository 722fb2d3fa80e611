"""`demo`, `run`, `report` and `studio`: the whole chain; `predict`: what the validated model of a
study is for.
"""

from __future__ import annotations

from csv import writer
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.models import read_deck
from ringtrue.api.studies import ReportFormat, open_study, run_study
from ringtrue.api.studies import predict as run_up
from ringtrue.cli.show import (
    ExitStatus,
    Json,
    SideBySide,
    err,
    one_of,
    out,
    progress,
    rows,
    tell,
    warn_of_units,
    write_json,
)
from ringtrue.errors import ConfigError, SolverMissing
from ringtrue.io.files import atomic_write
from ringtrue.io.foreign.parsers import read_json
from ringtrue.study.acceptance import (
    AcceptanceCheck,
    adequacy,
    limits,
    missed_words,
    settles,
)
from ringtrue.study.config import read_config
from ringtrue.study.config_sections import PredictSection
from ringtrue.study.messages import run_messages, validity_sentence
from ringtrue.study.results import PredictStage
from ringtrue.study.stages import STAGES
from ringtrue.updating.prediction import PLANE, RunUp

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
        typer.Option(
            metavar="N", help="Draws which regions are wrong, by how much, all noise."
        ),
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
        str | None,
        typer.Option("--from", metavar="STAGE", help="Run anew from this stage on."),
    ] = None,
    until: Annotated[
        str | None,
        typer.Option(
            "--until", metavar="STAGE", help=f"The last stage to run. Stages: {ORDER}."
        ),
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
                study,
                out=folder,
                first=first,
                until=until,
                workers=workers,
                progress=show,
            )
    except KeyboardInterrupt:
        err.print(
            "stopped: the stages that were finished are stored, the same command resumes"
        )
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
    store: Annotated[
        Path, typer.Argument(help="study.h5, its study.toml, or their folder.")
    ],
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
        typer.Option(
            "--demo", help="A worked example, in a folder that is named, or in ./frame."
        ),
    ] = False,
    port: Annotated[
        int, typer.Option(metavar="N", help="0: any that is free.", min=0, max=65535)
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page.")
    ] = True,
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
        raise SolverMissing(
            f"{e.name} is missing: pip install 'ringtrue[studio]'"
        ) from e
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


def _stated(
    option: str,
    what: str,
    metavar: str | None = None,
    least: float | None = None,
    most: float | None = None,
) -> Any:
    """An option in place of a key of [predict]; the help names its default."""
    key = {"--to": "fmax"}.get(option, option.removeprefix("--"))
    text = f"{what}; {PredictSection.model_fields[key].default:g} if not stated."
    return typer.Option(option, metavar=metavar, help=text, min=least, max=most)


def predict(
    study: Annotated[
        Path, typer.Argument(help="study.toml of a study that has been run.")
    ],
    folder: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where its results are.")
    ] = None,
    rotor: Annotated[
        int | None,
        typer.Option(metavar="NODE", help="Node that the unbalance acts on."),
    ] = None,
    mass: Annotated[
        float | None, typer.Option(metavar="KG", help="Mass of the rotor.")
    ] = None,
    axis: Annotated[str | None, one_of("--axis", PLANE, "Axis of the rotor")] = None,
    grade: Annotated[
        float | None, _stated("--grade", "Balance grade G (ISO 21940-11)", "MM/S")
    ] = None,
    service: Annotated[
        float | None, _stated("--service", "Service speed", "HZ")
    ] = None,
    fmax: Annotated[float | None, _stated("--to", "Highest speed", "HZ")] = None,
    springs: Annotated[
        list[str] | None,
        typer.Option(
            "--springs",
            metavar="NAME=PID[,PID]",
            help="PBUSH whose forces are wanted; repeat it.",
        ),
    ] = None,
    lines: Annotated[
        int | None, _stated("--lines", "Number of speeds", least=2)
    ] = None,
    draws: Annotated[
        int | None, _stated("--draws", "Draws of the posterior", least=20)
    ] = None,
    level: Annotated[
        float | None,
        _stated("--level", "Probability of the bands", least=0.5, most=0.95),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the draws.", min=0)] = None,
    table: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write every line.")
    ] = None,
    json: Json = None,
) -> int:
    """Unbalance run-up of the rotor on the validated model: response, bearing and support forces,
    with bands.

    Without options it is the stage `predict` of the study, from its \\[predict]; what an option
    states stands in its place, and then the result is shown, not stored.

    Example: ringtrue predict study.toml --rotor 9001 --mass 1200 --grade 2.5 --springs bearings=58
    """
    if table is not None and not table.parent.is_dir():
        raise ConfigError(f"--csv {table}: no folder {table.parent}")
    stated = {
        "rotor": rotor,
        "mass": mass,
        "axis": axis,
        "grade": grade,
        "service": service,
        "fmax": fmax,
        "lines": lines,
        "draws": draws,
        "level": level,
    }
    config = read_config(study)
    chosen = settings(config.predict, stated, springs or [])
    with progress("predict") as show:
        found = run_up(study, out=folder, settings=chosen, seed=seed, progress=show)
    if config.model is not None:
        model = read_deck(study.parent / config.model.deck, units=config.model.units)
        warn_of_units(model, config.model.units)
    if table is not None:
        _write_run_up(found.run_up, table)
    if json:
        write_json(_prediction_json(found), json)
    if json != "-":
        _print_prediction(found)
    return 0


def settings(
    section: PredictSection | None, stated: dict[str, Any], springs: list[str]
) -> PredictSection:
    """[predict] of the study with what the options state in its place.

    Raises
    ------
    ConfigError
        If the rotor's node or mass is not given, or an option is not of its form.
    """
    held: dict[str, Any] = section.model_dump() if section else {}
    held |= {k: v for k, v in stated.items() if v is not None}
    lost = [n for n in ("rotor", "mass") if n not in held]
    if lost:
        raise ConfigError(
            f"--{lost[0]}: give it here, or as {lost[0]} in [predict] of the study"
        )
    if springs:
        held["springs"] = {}
    for text in springs:
        name, _, ids = text.partition("=")
        numbers = [i.strip() for i in ids.split(",")]
        if not name or not all(i.isdigit() for i in numbers):
            raise ConfigError(
                f"--springs {text!r}: the form is NAME=PID[,PID], as in bearings=58"
            )
        held["springs"][name] = [int(i) for i in numbers]
    try:
        return PredictSection.model_validate(held)
    except ValueError as e:
        raise ConfigError(f"predict: {e}") from e


def _prediction_json(found: PredictStage) -> dict[str, Any]:
    """What JSON holds."""
    r = found.run_up
    return {
        "unbalance_kg_m": found.unbalance.moment,
        "validated_hz": list(r.validated),
        "level": r.amplitude.level,
        "discrepancy_percent": 100 * found.discrepancy,
        "flags": list(found.flags),
        "speeds_hz": r.freqs.tolist(),
        "outputs": [
            {
                "name": name,
                "unit": unit,
                "peak": [float(b[i]) for b in (r.peak.low, r.peak.median, r.peak.high)],
                "peak_speed_hz": [
                    float(b[i])
                    for b in (r.peak_speed.low, r.peak_speed.median, r.peak_speed.high)
                ],
                "low": r.amplitude.low[i].tolist(),
                "median": r.amplitude.median[i].tolist(),
                "high": r.amplitude.high[i].tolist(),
            }
            for i, (name, unit) in enumerate(zip(r.names, r.units, strict=True))
        ],
    }


def _print_prediction(found: PredictStage) -> None:
    r = found.run_up
    level = f"{100 * found.run_up.amplitude.level:.0f} %"
    body = [
        (
            name,
            unit,
            f"{r.peak.median[i]:.3g}",
            f"{r.peak.low[i]:.3g} to {r.peak.high[i]:.3g}",
            f"{r.peak_speed.median[i]:.4g}",
            "yes" if r.checked_peaks[i] else "NO",
        )
        for i, (name, unit) in enumerate(zip(r.names, r.units, strict=True))
    ]
    heads = ("what", "unit", "peak", f"{level} band", "at Hz", "validated")
    rows(
        f"Run-up to {r.freqs[-1]:g} Hz, unbalance {found.unbalance.moment:.4g} kg m",
        heads,
        body,
    )
    out.print(validity_sentence(r.validated))
    for flag in found.flags:
        err.print(f"warning: {flag}")


def _write_run_up(r: RunUp, path: Path) -> None:
    """Speed, whether it is validated, and low, median, high of each output."""
    with (
        atomic_write(path) as part,
        part.open("w", newline="", encoding="utf-8") as file,
    ):
        sheet = writer(file)
        names = [
            f"{n} [{u}] {q}"
            for n, u in zip(r.names, r.units, strict=True)
            for q in ("low", "median", "high")
        ]
        sheet.writerow(["speed [Hz]", "validated", *names])
        parts = np.stack(
            [r.amplitude.low, r.amplitude.median, r.amplitude.high], axis=1
        )
        values = parts.reshape(-1, r.freqs.size).T
        for f, ok, line in zip(
            r.freqs.tolist(), r.checked.tolist(), values.tolist(), strict=True
        ):
            sheet.writerow([f"{f:.6g}", int(ok), *(f"{v:.6g}" for v in line)])
