"""`ema`: modes from FRFs, or from the time records of a hammer or shaker test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ringtrue.api.measurements import estimate_frfs, identify_frfs, read_sensors
from ringtrue.cli.identify import (
    ChoiceFile,
    Diagram,
    Fmax,
    Fmin,
    LeaveOut,
    Rate,
    Sensors,
    Why,
    WriteChoice,
    check_each_once,
    choice_of,
    print_result,
    write_pages,
)
from ringtrue.cli.show import Json, file_to, progress
from ringtrue.core.choice import Choice, Hit
from ringtrue.errors import ConfigError, about
from ringtrue.io.choices import read_choice
from ringtrue.io.frfs import write_frfs
from ringtrue.io.setup_tables import WiredFile, read_setup_table
from ringtrue.signal.impacts import HammerSettings, ImpactReport
from ringtrue.signal.spectra import check_band
from ringtrue.study.hammer_records import ForceRecordFormat


def ema(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="FRFs (.h5 .npz .uff .csv .mat), or time records with a force channel (those, "
            ".wav .tdms .lvm)"
        ),
    ] = None,
    setups: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Time records of several setups, in place of files: a table with the columns "
            "file, channel, point, direction, reference (yes: the force).",
        ),
    ] = None,
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
    why: Why = False,
    json: Json = None,
) -> int:
    """Modes from FRFs, or from records of impacts or shakers: poly-reference LSCF with residues and
    standard deviations.

    Impacts are found in time records; double hits, overloads and impacts on a structure that still
    rings are left out and listed. The damping of the exponential window is taken out. Several files
    are one test: a roving hammer, moved sensors or more impacts. Blocks, windows, the estimator
    and the line spacing of shakers are settings of the Python call, rt.estimate_frfs; modes over
    force levels are followed by ringtrue.identification.common.tracking.level_dependence.

    Example: ringtrue ema impacts-1.csv impacts-2.csv --struck 1+Z --struck 5+Z --fmax 400
    --write-frfs frfs.h5
    """
    check_band(fmin, fmax)
    wiring: tuple[WiredFile, ...] = ()
    if setups is not None:
        given = {"FILES": files, "--force": force, "--struck": struck}
        if twice := [name for name, value in given.items() if value]:
            raise ConfigError(f"{twice[0]} does not go with --setups, whose table says it")
        wiring = read_setup_table(setups)
        files = [file.path for file in wiring]
        force = ["F:*"]
    if not files:
        raise ConfigError("a file is missing; several setups are given by --setups table.csv")
    check_each_once(files)
    by_hand, hits = _by_hand(choice, files)
    sheet = read_sensors(sensors) if sensors else None
    reading = ForceRecordFormat(
        wiring=wiring,
        force=tuple(force or ()),
        struck=tuple(struck or ()),
        leave_out=tuple(leave_out or ()),
        rate=rate,
        sheet=sheet,
    )
    settings = HammerSettings(keep_to=fmax, hits=hits)
    with progress("modes from FRFs") as show, about(files[0]):
        measured = estimate_frfs(files, reading=reading, settings=settings, progress=show)
        if frfs_to:
            write_frfs(frfs_to, measured.frfs)
        found = identify_frfs(measured, fmin=fmin, fmax=fmax, choice=by_hand, progress=show)
    write_pages(files[0], found, choice_to, diagram, sheet, hits)
    none = ("no mode of this band has a confidence above the limit", *found.others.sentences())
    title = " ".join(map(str, files))
    return print_result(title, found, json, more=_hits_json(measured.hits), if_none=none, why=why)


def _by_hand(path: Path | None, files: Sequence[Path]) -> tuple[Choice | None, tuple[Hit, ...]]:
    """The choice of modes for the first of the files, and of hits of all of them."""
    if path is None:
        return None, ()
    whole = read_choice(path)
    names = {f.stem for f in files}
    hits = tuple(h for h in whole.hits if h.record.partition(" #")[0] in names)
    modes = None if hits and whole.of(files[0].stem) is None else choice_of(path, files[0])
    return modes, hits


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
