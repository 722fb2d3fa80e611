"""`predict`: what the validated model is for."""

from __future__ import annotations

from csv import writer
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.models import read_deck
from ringtrue.api.studies import predict
from ringtrue.cli.show import Json, err, one_of, out, progress, rows, warn_of_units, write_json
from ringtrue.errors import ConfigError
from ringtrue.io.files import atomic_write
from ringtrue.study.config import read_config
from ringtrue.study.config_sections import PredictSection
from ringtrue.study.messages import validity_sentence
from ringtrue.study.results import PredictStage
from ringtrue.updating.prediction import PLANE, RunUp


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


def run(
    study: Annotated[Path, typer.Argument(help="study.toml of a study that has been run.")],
    folder: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where its results are.")
    ] = None,
    rotor: Annotated[
        int | None, typer.Option(metavar="NODE", help="Node that the unbalance acts on.")
    ] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="Mass of the rotor.")] = None,
    axis: Annotated[str | None, one_of("--axis", PLANE, "Axis of the rotor")] = None,
    grade: Annotated[
        float | None, _stated("--grade", "Balance grade G (ISO 21940-11)", "MM/S")
    ] = None,
    service: Annotated[float | None, _stated("--service", "Service speed", "HZ")] = None,
    fmax: Annotated[float | None, _stated("--to", "Highest speed", "HZ")] = None,
    springs: Annotated[
        list[str] | None,
        typer.Option(
            "--springs", metavar="NAME=PID[,PID]", help="PBUSH whose forces are wanted; repeat it."
        ),
    ] = None,
    lines: Annotated[int | None, _stated("--lines", "Number of speeds", least=2)] = None,
    draws: Annotated[int | None, _stated("--draws", "Draws of the posterior", least=20)] = None,
    level: Annotated[
        float | None, _stated("--level", "Probability of the bands", least=0.5, most=0.95)
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
        found = predict(study, out=folder, settings=chosen, seed=seed, progress=show)
    if config.model is not None:
        model = read_deck(study.parent / config.model.deck, units=config.model.units)
        warn_of_units(model, config.model.units)
    if table is not None:
        _write(found.run_up, table)
    if json:
        write_json(_json(found), json)
    if json != "-":
        _print(found)
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
        raise ConfigError(f"--{lost[0]}: give it here, or as {lost[0]} in [predict] of the study")
    if springs:
        held["springs"] = {}
    for text in springs:
        name, _, ids = text.partition("=")
        numbers = [i.strip() for i in ids.split(",")]
        if not name or not all(i.isdigit() for i in numbers):
            raise ConfigError(f"--springs {text!r}: the form is NAME=PID[,PID], as in bearings=58")
        held["springs"][name] = [int(i) for i in numbers]
    try:
        return PredictSection.model_validate(held)
    except ValueError as e:
        raise ConfigError(f"predict: {e}") from e


def _json(found: PredictStage) -> dict[str, Any]:
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
                    float(b[i]) for b in (r.peak_speed.low, r.peak_speed.median, r.peak_speed.high)
                ],
                "low": r.amplitude.low[i].tolist(),
                "median": r.amplitude.median[i].tolist(),
                "high": r.amplitude.high[i].tolist(),
            }
            for i, (name, unit) in enumerate(zip(r.names, r.units, strict=True))
        ],
    }


def _print(found: PredictStage) -> None:
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
    rows(f"Run-up to {r.freqs[-1]:g} Hz, unbalance {found.unbalance.moment:.4g} kg m", heads, body)
    out.print(validity_sentence(r.validated))
    for flag in found.flags:
        err.print(f"warning: {flag}")


def _write(r: RunUp, path: Path) -> None:
    """Speed, whether it is validated, and low, median, high of each output."""
    with atomic_write(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        sheet = writer(file)
        names = [
            f"{n} [{u}] {q}"
            for n, u in zip(r.names, r.units, strict=True)
            for q in ("low", "median", "high")
        ]
        sheet.writerow(["speed [Hz]", "validated", *names])
        parts = np.stack([r.amplitude.low, r.amplitude.median, r.amplitude.high], axis=1)
        values = parts.reshape(-1, r.freqs.size).T
        for f, ok, line in zip(r.freqs.tolist(), r.checked.tolist(), values.tolist(), strict=True):
            sheet.writerow([f"{f:.6g}", int(ok), *(f"{v:.6g}" for v in line)])
