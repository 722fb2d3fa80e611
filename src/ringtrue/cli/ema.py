"""`ema`: modes from FRFs, or from the time records of a hammer or shaker test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

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
    check_band,
    check_each_once,
    check_method,
    choice_of,
    kept_channels,
    told,
    write_pages,
)
from ringtrue.cli.levels import check_levels, levels_json, print_levels
from ringtrue.cli.show import Json, file_to, progress, tell, write_json
from ringtrue.core.progress import Progress, part
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.errors import ConfigError, about
from ringtrue.identification.frf.linearity import level_dependence
from ringtrue.identification.frf.local_fits import with_local_fits
from ringtrue.identification.frf.other_methods import identify_frfs_by
from ringtrue.identification.frf.pipeline import HammerModes, identify_hammer
from ringtrue.identification.frf.residues import driving_pairs
from ringtrue.io.frfs import frf_ids, holds_frfs, read_frfs, write_frfs
from ringtrue.io.modes_json import modes_to_json
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.signal.channel_checks import explain_clipping
from ringtrue.signal.frf_sets import alike, join_by_setup, join_frfs
from ringtrue.signal.impacts import HammerSettings, ImpactReport
from ringtrue.study.blows import BlowFiles, kept_blows, read_blows, refused_blows
from ringtrue.study.forced import Forced, forced_frfs


class Estimator(StrEnum):
    """Of the FRFs."""

    H1 = "H1"
    H2 = "H2"
    HV = "Hv"


class FrfMethod(StrEnum):
    """How modes are found in FRFs."""

    PLSCF = "plscf"
    CMIF = "cmif"


class Motion(StrEnum):
    """What responses measure."""

    ACCELERATION = "acceleration"
    VELOCITY = "velocity"
    DISPLACEMENT = "displacement"


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """FRFs of some files, the blows behind them and what is to be said of both."""

    frfs: FrfSet
    hits: tuple[ImpactReport, ...] = ()
    notes: tuple[str, ...] = ()
    batches: tuple[FrfSet, ...] = ()
    clipped: tuple[str, ...] = ()


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
        FrfMethod, typer.Option(help="Refined pLSCF, or another method for a second opinion.")
    ] = FrfMethod.PLSCF,
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
    named, points, lost = (tuple(x or ()) for x in (force, struck, leave_out))
    sheet = read_sensor_sheet(sensors) if sensors else None
    names = tuple(tuple(n.strip() for n in text.split(",")) for text in channels or ())
    how = BlowFiles(
        named, points, lost, quantity.value if quantity else "", rate, group, names, sheet
    )
    want = HammerSettings(
        force="", block=block, pretrigger=pretrigger, force_window=force_window, exp_end=exp_end
    )
    want = replace(want, estimator=estimator.value, keep_to=fmax)
    band = HammerModes(fmin=fmin, fmax=fmax)
    only = {"--choice": choice, "--write-choice": choice_to, "--diagram": diagram, "--level": level}
    check_method(method, FrfMethod.PLSCF, only)
    if level:
        check_levels(level, len(files))
        return _at_levels(level, files, (how, want, shaker, window_decay), band, json)
    title = " ".join(map(str, files))
    with progress("modes from FRFs") as show, about(files[0]):
        measured = _measured(files, how, want, shaker, show)
        frfs = _windowed(measured.frfs, window_decay)
        if frfs_to:
            write_frfs(frfs_to, frfs)
        if method is not FrfMethod.PLSCF:
            with explain_clipping(measured.clipped):
                other = identify_frfs_by(method.value, frfs, band, progress=show)
            return told(title, other, measured.notes, json)
        with explain_clipping(measured.clipped):
            found = identify_hammer(frfs, band, choice=by_hand, progress=show)
        if by_hand is None:
            batches = [_windowed(b, window_decay) for b in measured.batches or (frfs,)]
            found = with_local_fits(found, batches, band, progress=show)
    write_pages(files[0], (found.modes, found.reasons, found.diagrams), choice_to, diagram)
    none = ("no mode is believed in this band", *found.rejected[-5:])
    return told(title, found, measured.notes, json, more=_blows_json(measured.hits), if_none=none)


def _at_levels(
    levels: Sequence[float],
    files: Sequence[Path],
    how: tuple[BlowFiles, HammerSettings, float | None, float | None],
    band: HammerModes,
    json: str | None,
) -> int:
    """Each file by itself, then the modes of the lowest level followed over all levels."""
    read, want, shaker, decay = how
    found, notes = [], list[str]()
    for k, path in enumerate(files):
        with progress(f"level {levels[k]:g}") as show, about(path):
            measured = _measured((path,), read.of(k), want, shaker, show)
            with explain_clipping(measured.clipped):
                result = identify_hammer(_windowed(measured.frfs, decay), band, progress=show)
        notes += [f"{path}: {n}" for n in (*measured.notes, *result.notes)]
        found.append((result.modes, result.uncertainty))
    lowest = found[int(np.argmin(levels))]
    table = level_dependence(levels, found)
    if json:
        write_json(modes_to_json(*lowest) | levels_json(table), json)
    if json != "-":
        print_levels(table)
        tell(notes)
    return 0 if len(lowest[0]) else 1


def _blows_json(hits: Sequence[ImpactReport]) -> dict[str, Any]:
    rows = [
        {
            "source": h.source,
            "struck": h.input,
            "time_s": h.time,
            "peak_n": h.peak,
            "used": h.accepted,
        }
        | {"reasons": list(h.reasons)}
        for h in hits
    ]
    return {"blows": rows} if rows else {}


def _windowed(frfs: FrfSet, decay: float | None) -> FrfSet:
    if decay is None:
        return frfs
    if not 0 <= decay < float("inf"):
        raise ConfigError(f"--window-decay {decay}: must be 0 or more, 1/s")
    return replace(frfs, window_decay=decay)


def _measured(
    files: Sequence[Path],
    how: BlowFiles,
    want: HammerSettings,
    shaker: float | None,
    show: Progress,
) -> _Measured:
    """The FRFs of the files, estimated where these are time records."""
    given = [holds_frfs(f) for f in files]
    if any(given) and not all(given):
        raise ConfigError(
            f"{files[given.index(False)]} is a time record, {files[given.index(True)]} holds "
            "FRFs: one of the two"
        )
    if all(given):
        if how.channels:
            raise ConfigError(
                f"--channels names the channels of time records; {files[0]} holds FRFs, which "
                "have names"
            )
        if how.leave_out:
            known = dict.fromkeys(c for f in files for c in frf_ids(f))
            kept_channels(files[0], [Channel(c, "unknown", "") for c in known], how.leave_out)
        found = alike([read_frfs(f, how.leave_out) for f in files])
        return _Measured(join_frfs(found), batches=found) if len(found) > 1 else _Measured(found[0])
    records, ranges, notes = read_blows(files, how)
    forced = forced_frfs(records, want, shaker, full_scale=ranges, progress=part(show, 0.0, 0.05))
    frfs = join_frfs(forced.columns)
    said = _said(frfs, forced) if forced.hits else (*forced.notes, *forced.clipped)
    return _Measured(
        frfs, forced.hits, (*notes, *said), join_by_setup(forced.columns), forced.clipped
    )


def _said(frfs: FrfSet, forced: Forced) -> tuple[str, ...]:
    """Blows kept and left out, windows, coherence, driving points."""
    known = frfs.coherence[np.isfinite(frfs.coherence)]
    out = [kept_blows(forced.hits), *refused_blows(forced.hits), *forced.notes]
    if frfs.window_decay > 0:
        out.append(f"exponential window of {frfs.window_decay:.3g} 1/s, taken out of the damping")
    out.append(
        f"coherence {np.median(known):.3f} at the typical line"
        if known.size
        else "one blow a point: no coherence"
    )
    if not driving_pairs(frfs):
        ids = " ".join(dict.fromkeys(c.id for c in frfs.inputs))
        out.append(
            f"struck at {ids}, where no response is: shapes are not scaled to unit modal mass "
            "(--struck)"
        )
    return tuple(out)
