"""`ema`: modes from FRFs, or from the time records of a hammer or shaker test.

One test at several force levels: is the structure linear, and how do frequency and damping
change?
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.measurements import (
    TestModes,
    check_band,
    check_levels,
    compare_levels,
    estimate_frfs,
    identify_frfs,
    read_sensors,
)
from ringtrue.cli.identify import (
    ChoiceFile,
    Diagram,
    Fmax,
    Fmin,
    LeaveOut,
    Rate,
    Sensors,
    WriteChoice,
    check_each_once,
    choice_of,
    print_result,
    write_pages,
)
from ringtrue.cli.show import Json, file_to, progress, rows, tell, write_json
from ringtrue.errors import about
from ringtrue.identification.common.tracking import LevelDependence
from ringtrue.identification.frf.pipeline import HammerResult
from ringtrue.io.frfs import write_frfs
from ringtrue.io.modes import modes_to_json
from ringtrue.signal.impacts import HammerSettings, ImpactReport
from ringtrue.study.hammer_records import ForceRecordFormat
from ringtrue.study.summary import finite


def print_comparison(
    levels: Sequence[float], files: Sequence[Path], tests: Sequence[TestModes], json: str | None
) -> int:
    """Print or write the modes of the lowest level followed over all levels; the exit status."""
    table = compare_levels(levels, tests)
    lowest = tests[int(np.argmin(levels))]
    if json:
        write_json(modes_to_json(lowest.modes, lowest.uncertainty) | _levels_json(table), json)
    if json != "-":
        _print_levels(table)
        tell(f"{p}: {note}" for p, test in zip(files, tests, strict=True) for note in test.notes)
    return 0 if len(lowest) else 1


def _print_levels(table: LevelDependence) -> None:
    """Frequency and damping at each level, their change with the level, and whether the structure
    is linear.
    """
    heads = ("#", "f [Hz]", "% a doubling", "damping [%]", "% a doubling")
    body: list[tuple[object, ...]] = []
    verdicts: list[str] = []
    for k in range(table.linear.size):
        frequency = table.frequency[:, k]
        damping = 100 * table.damping[:, k]
        body.append(
            (
                k + 1,
                " ".join(f"{x:.5g}" for x in frequency),
                _slope(table.slope_frequency[k], table.std_slope_frequency[k]),
                " ".join(f"{x:.3f}" for x in damping),
                _slope(table.slope_damping[k], table.std_slope_damping[k]),
            )
        )
        chance = min(table.chance_frequency[k], table.chance_damping[k])
        if np.isfinite(frequency).sum() < 2:
            verdict = "found at one level only"
        elif table.linear[k]:
            verdict = "linear"
        else:
            verdict = f"not linear: probability {chance:.1g} of a linear structure"
        verdicts.append(f"{k + 1}: {verdict}")
    rows(f"at force levels {' '.join(f'{x:g}' for x in table.levels)}", heads, body)
    tell(verdicts)


def _slope(slope: float, std: float) -> str:
    """Per cent for twice the force, from d ln x / d ln F."""
    return f"{100 * (2**slope - 1):+.3g} ± {100 * np.log(2) * std:.2g}"


def _levels_json(table: LevelDependence) -> dict[str, Any]:
    """The same for JSON; null where a mode was not found."""
    columns = {
        "frequency_hz": table.frequency.T,
        "damping": table.damping.T,
        "slope_frequency": table.slope_frequency,
        "std_slope_frequency": table.std_slope_frequency,
        "slope_damping": table.slope_damping,
        "std_slope_damping": table.std_slope_damping,
    }
    modes = []
    for k, linear in enumerate(table.linear.tolist()):
        mode = {name: finite(values[k].tolist()) for name, values in columns.items()}
        modes.append(mode | {"linear": linear})
    return {"levels": table.levels.tolist(), "level_dependence": modes}


def ema(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="FRFs (.h5 .npz .uff .csv .mat), or time records with a force channel (those, "
            ".wav .tdms .lvm)"
        ),
    ],
    fmin: Fmin = None,
    fmax: Fmax = None,
    force: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CHANNEL",
            help="Force channel or a pattern (Hammer*), once or for each file in order; by "
            "default that with a unit of force, or so named.",
        ),
    ] = None,
    struck: Annotated[
        list[str] | None,
        typer.Option(
            metavar="POINT",
            help="Excitation point and direction (3+Z), once or for each file in order.",
        ),
    ] = None,
    shaker: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Line spacing of a shaker test; chosen from the record if not given.",
        ),
    ] = None,
    level: Annotated[
        list[float] | None,
        typer.Option(
            metavar="N",
            help="Force level of each file, in order: is the structure linear?",
        ),
    ] = None,
    rate: Rate = None,
    leave_out: LeaveOut = None,
    sensors: Sensors = None,
    choice: ChoiceFile = None,
    choice_to: WriteChoice = None,
    diagram: Diagram = None,
    frfs_to: Annotated[
        Path | None,
        file_to("--write-frfs", "Write the FRFs with their coherence", ".h5", ".uff", ".csv"),
    ] = None,
    json: Json = None,
) -> int:
    """Modes from FRFs, or from records of impacts or shakers: poly-reference LSCF with residues and
    standard deviations.

    Impacts are found in time records; double hits, overloads and impacts on a structure that still
    rings are left out and listed. The damping of the exponential window is taken out. Several files
    are one test: a roving hammer, moved sensors or more impacts. Blocks, windows and the estimator
    are settings of the Python call, rt.estimate_frfs.

    Example: ringtrue ema impacts-1.csv impacts-2.csv --struck 1+Z --struck 5+Z --fmax 400
    --write-frfs frfs.h5
    """
    check_band(fmin, fmax)
    check_each_once(files)
    by_hand = choice_of(choice, files[0])
    reading = ForceRecordFormat(
        force=tuple(force or ()),
        struck=tuple(struck or ()),
        leave_out=tuple(leave_out or ()),
        rate=rate,
        sheet=read_sensors(sensors) if sensors else None,
    )
    settings = HammerSettings(keep_to=fmax)
    if level:
        return _at_levels(
            level, files, reading=reading, settings=settings, band=(fmin, fmax), json=json
        )
    with progress("modes from FRFs") as show, about(files[0]):
        measured = estimate_frfs(
            files, reading=reading, settings=settings, line_spacing=shaker, progress=show
        )
        if frfs_to:
            write_frfs(frfs_to, measured.frfs)
        found = identify_frfs(measured, fmin=fmin, fmax=fmax, choice=by_hand, progress=show)
    write_pages(files[0], found, choice_to, diagram)
    rejected = found.result.rejected if isinstance(found.result, HammerResult) else ()
    none = ("no mode of this band has a confidence above the limit", *rejected[-5:])
    title = " ".join(map(str, files))
    return print_result(title, found, json, more=_hits_json(measured.hits), if_none=none)


def _at_levels(
    levels: Sequence[float],
    files: Sequence[Path],
    reading: ForceRecordFormat,
    settings: HammerSettings,
    band: tuple[float | None, float | None],
    json: str | None,
) -> int:
    """The modes of each file, a force level each, followed over the levels; the exit status."""
    check_levels(levels, len(files))
    tests = []
    for k, path in enumerate(files):
        with progress(f"level {levels[k]:g}") as show, about(path):
            measured = estimate_frfs(path, reading=reading.of(k), settings=settings, progress=show)
            tests.append(identify_frfs(measured, fmin=band[0], fmax=band[1], progress=show))
    return print_comparison(levels, files, tests, json)


def _hits_json(hits: Sequence[ImpactReport]) -> dict[str, Any]:
    rows = [
        {
            "source": h.source,
            "struck": h.input,
            "time_s": h.time,
            "peak_n": h.peak,
            "used": h.accepted,
            "reasons": list(h.reasons),
        }
        for h in hits
    ]
    return {"blows": rows} if rows else {}
