"""`oma`: modes from ambient records; with `ema` it shares the options, the table and a choice by
hand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.cli.show import Json, file_to, progress, rows, tell, write_json
from ringtrue.core.choice import Choice
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import ConfigError, DataError, about, did_you_mean
from ringtrue.identification.ambient.other_methods import SecondOpinion, identify_ambient_by
from ringtrue.identification.ambient.pipeline import (
    AmbientResult,
    AmbientSettings,
    identify_stretches,
)
from ringtrue.identification.ambient.record_bands import SHORTEST
from ringtrue.identification.common.manual_selection import as_choice
from ringtrue.identification.common.poles import StableDiagram
from ringtrue.identification.frf.pipeline import HammerResult
from ringtrue.io.atomic import atomic_write
from ringtrue.io.choices import read_choice, write_choice
from ringtrue.io.modes_json import modes_to_json
from ringtrue.io.records import read_record, refuse_bad_samples
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.plots.picker import picker_page
from ringtrue.signal.channel_checks import find_faults
from ringtrue.signal.gaps import bridge_gaps, remove_overlap
from ringtrue.signal.order_tracking import remove_harmonics
from ringtrue.signal.tonal_lines import harmonics


class AmbientMethod(StrEnum):
    """How modes are found in an ambient record."""

    SSI = "ssi"
    PLSCF = "plscf"
    ERA = "era"
    SSI_DATA = "ssi-data"
    FDD = "fdd"
    EFDD = "efdd"
    FSDD = "fsdd"
    RANDOM_DECREMENT = "random-decrement"


class Removal(StrEnum):
    """How lines of machines are taken out."""

    LINES = "lines"
    CEPSTRUM = "cepstrum"


Fmin = Annotated[
    float | None, typer.Option("--fmin", metavar="HZ", help="Lowest frequency of interest.")
]
Fmax = Annotated[
    float | None, typer.Option("--fmax", metavar="HZ", help="Highest frequency of interest.")
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Sampling rate, if the file has none.")
]
Group = Annotated[
    str,
    typer.Option(
        "--group", metavar="NAME", help="Group of a .tdms or HDF5 file, where its rates differ."
    ),
]
LeaveOut = Annotated[
    list[str] | None,
    typer.Option(
        "--leave-out", metavar="CHANNEL", help="Do not use this channel; may be repeated."
    ),
]
Sensors = Annotated[
    Path | None,
    typer.Option(
        "--sensors",
        metavar="FILE",
        help="Sensor sheet: units and sensitivities where a record tells none.",
    ),
]
ChoiceFile = Annotated[
    Path | None,
    typer.Option("--choice", metavar="FILE", help="Apply a choice by hand (.toml, .json)."),
]
WriteChoice = Annotated[
    Path | None,
    file_to("--write-choice", "Write the modes as a choice to be edited", ".toml", ".json"),
]
Diagram = Annotated[
    Path | None,
    file_to("--diagram", "Write the stabilisation diagrams as a page to pick poles on", ".html"),
]


def print_modes(
    title: str, modes: ModeSet, std: Uncertainty | None, reasons: Sequence[str]
) -> None:
    """A table of modes with standard deviations, confidence and reasons."""
    body: list[tuple[object, ...]] = []
    for i in range(len(modes)):
        sf, sz = (
            (std.frequency[i], std.damping[i]) if std is not None else (float("nan"), float("nan"))
        )
        f, z = modes.frequencies[i], modes.damping[i]
        note = reasons[i] if i < len(reasons) else ""
        values = (f"{f:.5g}", _known(sf, ".1e"), f"{100 * z:.3f}", _known(100 * sz, ".2g"))
        body.append((i + 1, *values, f"{modes.confidence[i]:.2f}", note))
    rows(title, ("#", "f [Hz]", "± [Hz]", "damping [%]", "± [%]", "confidence", "why"), body)


def _known(x: float, form: str) -> str:
    return format(x, form) if np.isfinite(x) else "-"


def check_band(fmin: float | None, fmax: float | None) -> None:
    """Refuse a band that is empty."""
    low, high = 0.0 if fmin is None else fmin, float("inf") if fmax is None else fmax
    if not 0 <= low < high:
        raise ConfigError(f"--fmin {fmin} --fmax {fmax}: must be 0 <= fmin < fmax")


def record_without(
    path: Path,
    rate: float | None,
    lost: Sequence[str],
    group: str = "",
    sheet: SensorSheet | None = None,
) -> tuple[TimeHistory, tuple[str, ...]]:
    """A record scaled by its sheet, and what that said; without some channels, checked. Samples may
    be missing.
    """
    history = read_record(path, rate, check=not lost, group=group, gaps=True)
    history, notes = sheet.scaled(history) if sheet else (history, ())
    if lost:
        history = history.pick(kept_channels(path, history.channels, lost))
        refuse_bad_samples(history, path, gaps=True)
    return history, notes


def kept_channels(path: Path, channels: Sequence[Channel], lost: Sequence[str]) -> list[str]:
    """Ids of the channels but for those left out, each of which must be there."""
    ids = [c.id for c in channels]
    for name in lost:
        if name not in ids:
            raise ConfigError(
                f"--leave-out {name}: {path} has no such channel{did_you_mean(name, ids)}"
            )
    if not (keep := [c for c in ids if c not in set(lost)]):
        raise DataError(f"{path}: --leave-out leaves no channel")
    return keep


def fault_notes(history: TimeHistory) -> tuple[str, ...]:
    """Spikes, a line for each channel."""
    found = [f for f in find_faults(history) if f.kind == "spike"]
    count = Counter(f.id for f in found)
    first = {f.id: f for f in reversed(found)}
    return tuple(
        f"channel {c}: {n} spike{'s' if n > 1 else ''}, the first at {first[c].time:.4g} s: "
        f"{first[c].why}"
        for c, n in count.items()
    )


def write_pages(
    record: Path,
    found: tuple[ModeSet, Sequence[str], Sequence[StableDiagram]],
    choice_to: Path | None,
    diagram_to: Path | None,
) -> None:
    """Write the choice and the diagrams that were asked for."""
    modes, reasons, diagrams = found
    if choice_to:
        write_choice(choice_to, as_choice(modes, reasons, record=record.stem))
    if diagram_to:
        with atomic_write(diagram_to) as part:
            part.write_text(picker_page(str(record), diagrams, modes), encoding="utf-8")


def choice_of(path: Path | None, record: Path) -> Choice | None:
    """The choice by hand for a record."""
    if path is None:
        return None
    choice = read_choice(path)
    if (part := choice.of(record.stem)) is None:
        told = f"; it has {', '.join(choice.records)}" if choice.records else ": it is empty"
        raise ConfigError(f"{path}: no entry for the record {record.stem!r}{told}")
    return part


def oma(
    records: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORD...",
            help=".h5, .npy (sample, channel), .csv, .mat, .uff, .tdms, .lvm or .wav; several of "
            "one length, of "
            "sensors that stay in place (hourly files), are one record with pauses.",
        ),
    ],
    rate: Rate = None,
    group: Group = "",
    fmin: Fmin = None,
    fmax: Fmax = None,
    method: Annotated[
        AmbientMethod,
        typer.Option("--method", help="SSI-cov, or another method for a second opinion."),
    ] = AmbientMethod.SSI,
    near: Annotated[
        list[float] | None,
        typer.Option("--near", metavar="HZ", help="Peak of the FDD methods; may be repeated."),
    ] = None,
    leave_out: LeaveOut = None,
    sensors: Sensors = None,
    remove_harmonics: Annotated[
        Removal | None,
        typer.Option(
            "--remove-harmonics",
            help="Take the lines of machines out first: each by itself, or families.",
        ),
    ] = None,
    choice: ChoiceFile = None,
    choice_to: WriteChoice = None,
    diagram: Diagram = None,
    json: Json = None,
) -> int:
    """Modes from an ambient record: automatic covariance-driven SSI with standard deviations.

    Other methods (--method): poly-reference LSCF on half spectra, ERA/NExT, SSI-data, FDD with the
    damping of FSDD, of EFDD or of random decrement.

    Example: ringtrue oma tower.npy --rate 100 --fmax 10 --write-choice tower.toml
    """
    check_band(fmin, fmax)
    check_each_once(records)
    record = records[0]
    title = (
        str(record)
        if len(records) == 1
        else f"{record} .. {records[-1].name} ({len(records)} files)"
    )
    by_hand = choice_of(choice, record)
    settings = AmbientSettings(fmin=fmin, fmax=fmax)
    check_method(
        method,
        AmbientMethod.SSI,
        {"--choice": choice, "--write-choice": choice_to, "--diagram": diagram},
    )
    if near and method in (
        AmbientMethod.SSI,
        AmbientMethod.PLSCF,
        AmbientMethod.ERA,
        AmbientMethod.SSI_DATA,
    ):
        raise ConfigError(
            f"--near: {method.value} finds its modes in the whole band; give --fmin and --fmax"
        )
    if method is not AmbientMethod.SSI and len(records) > 1:
        raise ConfigError(f"--method {method.value}: one record, got {len(records)}")
    said: list[str] = []
    sheet = read_sensor_sheet(sensors) if sensors else None

    def read(path: Path) -> TimeHistory:
        history, notes = record_without(path, rate, leave_out or [], group, sheet)
        said.extend(n for n in notes if n not in said)
        return history

    parts = _parts(records, read, remove_harmonics, said)
    with progress("ambient modes") as show, about(record) if len(records) == 1 else nullcontext():
        if method is not AmbientMethod.SSI:
            other = identify_ambient_by(
                method.value, next(parts), settings, near=near or (), progress=show
            )
            return told(title, other, said, json)
        found = identify_stretches(parts, settings, choice=by_hand, progress=show)
    write_pages(record, (found.modes, found.reasons, found.diagrams), choice_to, diagram)
    return told(title, found, (*said, *_machines(found)), json)


def _parts(
    records: Sequence[Path],
    read: Callable[[Path], TimeHistory],
    how: Removal | None,
    said: list[str],
) -> Iterator[TimeHistory]:
    """Each record as it is read, without the lines of machines where that is asked for; what there
    is to say of it.
    """
    first, before = 0.0, None
    for path in records:
        whole = read(path)
        kept, twice = remove_overlap(before, whole)
        before = whole
        if twice:
            said.append(f"{path.name}: {twice}")
        if not kept.data.size:
            continue
        history, removed = _removed(kept, how)
        first = first or history.duration
        short = (
            ("shorter than half of the first record: left out",)
            if history.duration < SHORTEST * first
            else ()
        )
        where = "" if len(records) == 1 else f"{path.name}: "
        said += [where + note for note in (*fault_notes(history), *removed, *short)]
        yield history


def check_each_once(files: Sequence[Path]) -> None:
    """Refuse a file that is given twice: it would count as a measurement of its own."""
    if twice := [str(f) for f, n in Counter(p.resolve() for p in files).items() if n > 1]:
        raise ConfigError(f"{twice[0]} is given twice")


def check_method(method: StrEnum, first: StrEnum, options: Mapping[str, object]) -> None:
    """Refuse options that only the first method has."""
    if method is not first and (wrong := [k for k, v in options.items() if v is not None]):
        raise ConfigError(
            f"{wrong[0]} goes with --method {first.value}; the others have no diagram of judged "
            "poles"
        )


def told(
    title: str,
    found: AmbientResult | HammerResult | SecondOpinion,
    notes: Sequence[str],
    json: str | None,
    *,
    more: dict[str, Any] | None = None,
    if_none: Sequence[str] = (),
) -> int:
    """Print the modes that were found and what is to be said of them, write them with `more`; the
    exit status.
    """
    if json:
        write_json(
            modes_to_json(found.modes, found.uncertainty, reasons=found.reasons) | (more or {}),
            json,
        )
    if json != "-":
        count = f"{len(found.modes)} mode{'s' if len(found.modes) != 1 else ''}"
        print_modes(f"{title}: {count}", found.modes, found.uncertainty, found.reasons)
        tell((*notes, *found.notes, *(() if len(found.modes) else if_none)))
    return 0 if len(found.modes) else 1


def _removed(history: TimeHistory, how: Removal | None) -> tuple[TimeHistory, tuple[str, ...]]:
    if not how:
        return history, ()
    whole, gaps = bridge_gaps(history)
    if not (lines := harmonics(whole)):
        return history, ()
    clean, said = remove_harmonics(whole, [h.frequency for h in lines], how.value)
    return gaps.marked(clean), (*gaps.channels, *said)


def _machines(found: AmbientResult) -> list[str]:
    """The lines of machines that no pole stood on; the others are among the notes."""
    told = " ".join(found.notes)
    return [f"line at {h.frequency:.4g} Hz: {h.why}" for h in found.harmonics if h.why not in told]
