"""`ema`: modes from FRFs, or from the time records of a hammer or shaker test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from ringtrue.api.measurements import (
    MeasuredFrfs,
    check_band,
    estimate_frfs,
    identify_frfs,
    read_sensors,
)
from ringtrue.cli.identify import (
    ChoiceFile,
    Diagram,
    Fmax,
    Fmin,
    Group,
    LeaveOut,
    Rate,
    Sensors,
    WriteChoice,
    check_each_once,
    check_method,
    choice_of,
    print_result,
    write_pages,
)
from ringtrue.cli.levels import check_levels, print_comparison
from ringtrue.cli.show import Json, file_to, progress
from ringtrue.core.progress import Progress
from ringtrue.errors import about
from ringtrue.identification.frf.pipeline import HammerResult
from ringtrue.identification.methods import AUTOMATIC_FRF, FRF_METHODS
from ringtrue.io.frfs import write_frfs
from ringtrue.signal.impacts import HammerSettings, ImpactReport
from ringtrue.study.hammer_records import (
    ForceRecordFormat,
)


class Estimator(StrEnum):
    """Of the FRFs."""

    H1 = "H1"
    H2 = "H2"
    HV = "Hv"


class Motion(StrEnum):
    """What responses measure."""

    ACCELERATION = "acceleration"
    VELOCITY = "velocity"
    DISPLACEMENT = "displacement"


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
    method: Annotated[
        str,
        typer.Option(
            metavar="|".join((AUTOMATIC_FRF, *FRF_METHODS)),
            help="Refined pLSCF, or another method for a second opinion.",
        ),
    ] = AUTOMATIC_FRF,
    force: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CHANNEL",
            help="Force channel or a pattern (Hammer*), once or for each file in order; by "
            "default that with a unit of "
            "force, or so named.",
        ),
    ] = None,
    struck: Annotated[
        list[str] | None,
        typer.Option(
            metavar="POINT",
            help="Point and direction struck (3+Z), once or for each file in order.",
        ),
    ] = None,
    channels: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            help="Names of the channels of records without (.wav, .npy), in order "
            "(F:3+Z,1+Z,2+Z), once or for each "
            "file; an empty one is not used.",
        ),
    ] = None,
    quantity: Annotated[
        Motion | None, typer.Option(help="What responses measure, where the file does not tell.")
    ] = None,
    block: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="Length of a block; by default what fits between the blows."
        ),
    ] = None,
    pretrigger: Annotated[
        float, typer.Option(metavar="S", help="Part of a block before the blow.")
    ] = 0.02,
    force_window: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="The force is kept so long; by default while it stands out."
        ),
    ] = None,
    exp_end: Annotated[
        float | None,
        typer.Option(
            metavar="0..1",
            help="End value of the exponential window; 1: none; by default what is needed.",
        ),
    ] = None,
    estimator: Annotated[Estimator, typer.Option(help="FRF estimator.")] = Estimator.H1,
    shaker: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="A force that runs all the time: lines HZ apart; by default what the record "
            "tells.",
        ),
    ] = None,
    level: Annotated[
        list[float] | None,
        typer.Option(
            metavar="N",
            help="Force level of each file, in order: each alone, modes followed, linear or not.",
        ),
    ] = None,
    rate: Rate = None,
    group: Group = "",
    window_decay: Annotated[
        float | None,
        typer.Option(
            metavar="1/S",
            help="Decay rate of an exponential window in given FRFs; taken out of the damping.",
        ),
    ] = None,
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
    """Modes from FRFs or from the blows of a hammer: poly-reference LSCF with residues and standard
    deviations.

    In time records the blows are found; double hits, overloads and blows on a structure that still
    rings are left out and listed; the damping of the exponential window is taken out again. A force
    that runs all the time is that of a shaker. Several files are one test: a roving hammer, moved
    sensors or more blows. Another method (--method): CMIF peaks.

    Where sensors were moved and their mass shifts the modes from file to file beyond doubt, each
    file is fitted alone.

    Example: ringtrue ema blows-1.csv blows-2.csv --struck 1+Z --struck 5+Z --fmax 400 --write-frfs
    frfs.h5
    """
    check_band(fmin, fmax)
    check_each_once(files)
    by_hand = choice_of(choice, files[0])
    names = tuple(tuple(n.strip() for n in text.split(",")) for text in channels or ())
    reading = ForceRecordFormat(
        tuple(force or ()),
        tuple(struck or ()),
        tuple(leave_out or ()),
        quantity.value if quantity else "",
        rate,
        group,
        names,
        read_sensors(sensors) if sensors else None,
    )
    settings = HammerSettings(
        force="", block=block, pretrigger=pretrigger, force_window=force_window, exp_end=exp_end
    )
    settings = replace(settings, estimator=estimator.value, keep_to=fmax)
    only = {"--choice": choice, "--write-choice": choice_to, "--diagram": diagram, "--level": level}
    check_method(method, AUTOMATIC_FRF, FRF_METHODS, only)
    if level:
        check_levels(level, len(files))

    def estimate(paths: Sequence[Path], reading: ForceRecordFormat, show: Progress) -> MeasuredFrfs:
        return estimate_frfs(
            paths,
            reading=reading,
            settings=settings,
            line_spacing=shaker,
            window_decay=window_decay,
            progress=show,
        )

    if level:
        tests = []
        for k, path in enumerate(files):
            with progress(f"level {level[k]:g}") as show, about(path):
                measured = estimate((path,), reading.of(k), show)
                tests.append(identify_frfs(measured, fmin=fmin, fmax=fmax, progress=show))
        return print_comparison(level, files, tests, json)
    with progress("modes from FRFs") as show, about(files[0]):
        measured = estimate(files, reading, show)
        if frfs_to:
            write_frfs(frfs_to, measured.frfs)
        found = identify_frfs(
            measured, fmin=fmin, fmax=fmax, method=method, choice=by_hand, progress=show
        )
    if method == AUTOMATIC_FRF:
        write_pages(files[0], found, choice_to, diagram)
    rejected = found.result.rejected if isinstance(found.result, HammerResult) else ()
    none = ("no mode is believed in this band", *rejected[-5:])
    title = " ".join(map(str, files))
    return print_result(title, found, json, more=_hits_json(measured.hits), if_none=none)


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
