"""`oma`: modes from ambient records; `ema`: modes from FRFs, or from records of a hammer or shaker
test. They share the options, the table and the files of modes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.measurements import (
    TestModes,
    ambient_parts,
    estimate_frfs,
    identify_ambient,
    identify_frfs,
    merge_method,
    modes_of_setups,
    read_sensors,
    record_with_notes,
    references_of,
)
from ringtrue.cli.show import Json, file_to, progress, tell, write_json
from ringtrue.core.choice import Choice, Hit
from ringtrue.core.display import with_error
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.notes import summary
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, about, did_you_mean
from ringtrue.identification.ambient.pipeline import AmbientResult, AmbientSettings
from ringtrue.identification.ambient.setups import SetupsResult
from ringtrue.identification.common.diagram import shape_collinearity
from ringtrue.identification.common.manual_selection import as_choice
from ringtrue.identification.methods import (
    AMBIENT_METHODS,
    AUTOMATIC_AMBIENT,
    PeakMethod,
)
from ringtrue.io.campaign_tables import WiredFile, read_setup_table
from ringtrue.io.choices import read_choice, write_choice
from ringtrue.io.files import atomic_write
from ringtrue.io.frfs import write_frfs
from ringtrue.io.modes import modes_to_json
from ringtrue.io.sheets import SensorSheet
from ringtrue.plots.diagram import picker_page
from ringtrue.signal.impacts import HammerSettings, ImpactReport
from ringtrue.signal.spectra import check_band
from ringtrue.study.hammer_records import ForceRecordFormat

Fmin = Annotated[
    float | None,
    typer.Option("--fmin", metavar="HZ", help="Lowest frequency of interest."),
]
Fmax = Annotated[
    float | None,
    typer.Option("--fmax", metavar="HZ", help="Highest frequency of interest."),
]
Rate = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", help="Sampling rate, if the file has none."),
]
Group = Annotated[
    str,
    typer.Option(
        "--group",
        metavar="NAME",
        help="Group of a .tdms or HDF5 file, where its rates differ.",
    ),
]
LeaveOut = Annotated[
    list[str] | None,
    typer.Option(
        "--leave-out",
        metavar="CHANNEL",
        help="Do not use this channel; may be repeated.",
    ),
]
Sensors = Annotated[
    Path | None,
    typer.Option(
        "--sensors",
        metavar="FILE",
        help="Sensor sheet: units and sensitivities where a record has none; or a universal file "
        "with the geometry.",
    ),
]
ChoiceFile = Annotated[
    Path | None,
    typer.Option(
        "--choice", metavar="FILE", help="Apply a choice by hand (.toml, .json)."
    ),
]
WriteChoice = Annotated[
    Path | None,
    file_to(
        "--write-choice", "Write the modes as a choice to be edited", ".toml", ".json"
    ),
]
Diagram = Annotated[
    Path | None,
    file_to(
        "--diagram",
        "Write the diagram as a page: a click takes a mode or pole up",
        ".html",
    ),
]


Why = Annotated[
    bool, typer.Option("--why", help="All evidence for and against each mode.")
]
HEADS = "  #    f [Hz]       ±   damping [%]   ±    MPC  conf.  class     remark"


def mode_lines(found: TestModes) -> list[str]:
    """One line a mode and a candidate, at most 100 columns, ascending in frequency."""
    natural = _lines(found.modes, found.uncertainty)
    names = [f"{k + 1:3}" for k in range(len(found))]
    others = _lines(found.others.modes, found.others.uncertainty)
    both = [
        *zip(natural, names, ["natural"] * len(found), found.remarks, strict=True),
        *zip(
            others,
            ["  -"] * len(found.others),
            found.others.classes,
            map(summary, found.others.notes),
            strict=True,
        ),
    ]
    frequency = np.concatenate([found.frequencies, found.others.modes.frequencies])
    ordered = [both[k] for k in np.argsort(frequency, kind="stable").tolist()]
    return [
        f"{name} {line}  {kind:8}  {text}".rstrip()
        for line, name, kind, text in ordered
    ]


def _lines(modes: ModeSet, std: Uncertainty) -> list[str]:
    """The numbers of each mode: frequency and damping with deviations, MPC, confidence."""
    collinear = shape_collinearity(modes)
    out = []
    for i, (f, z) in enumerate(zip(modes.frequencies, modes.damping, strict=True)):
        hertz, spread = with_error(float(f), float(std.frequency[i]), 5)
        damping, its_spread = with_error(100 * float(z), 100 * float(std.damping[i]), 3)
        out.append(
            f"{hertz:>9} {spread:>10} {damping:>8} {its_spread:>7}   "
            f"{_known(collinear[i], '.2f'):>4}  {modes.confidence[i]:5.2f}"
        )
    return out


def _known(x: float, form: str) -> str:
    return format(x, form) if np.isfinite(x) else "-"


def write_pages(
    record: Path,
    found: TestModes,
    choice_to: Path | None,
    diagram_to: Path | None,
    sheet: SensorSheet | None = None,
    hits: tuple[Hit, ...] = (),
) -> None:
    """Write the choice and the diagram that were asked for; shapes move on the sheet, `hits` were
    decided by hand.
    """
    if choice_to:
        modes = as_choice(found.modes, found.reasons, record=record.stem)
        write_choice(choice_to, replace(modes, hits=hits))
    if diagram_to:
        with atomic_write(diagram_to) as part:
            page = picker_page(
                str(record), found.diagram, sheet.model if sheet else None
            )
            part.write_text(page, encoding="utf-8")


def choice_of(path: Path | None, record: Path) -> Choice | None:
    """The choice by hand for a record."""
    if path is None:
        return None
    choice = read_choice(path)
    if (part := choice.of(record.stem)) is None:
        listed = (
            f"; it has {', '.join(choice.records)}"
            if choice.records
            else ": it is empty"
        )
        raise ConfigError(f"{path}: no entry for the record {record.stem!r}{listed}")
    return part


def oma(
    records: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="RECORD",
            help=".h5, .npy (sample, channel), .csv, .mat, .uff, .tdms, .lvm or .wav; several of "
            "one length, of "
            "sensors that stay in place (hourly files), are one record with pauses.",
        ),
    ] = None,
    rate: Rate = None,
    group: Group = "",
    fmin: Fmin = None,
    fmax: Fmax = None,
    setups: Annotated[
        Path | None,
        typer.Option(
            "--setups",
            metavar="FILE",
            help="Several setups, in place of records: a table (.csv, .xlsx) with the columns "
            "file, channel, point, direction, reference; one row a channel of each file.",
        ),
    ] = None,
    merge: Annotated[
        str,
        typer.Option(
            "--merge",
            metavar="poser|preger",
            help="Poles of setups: of each by itself, merged; or of their references as one "
            "record.",
        ),
    ] = "poser",
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="|".join((AUTOMATIC_AMBIENT, *AMBIENT_METHODS)),
            help="SSI-cov, or another method for a second opinion.",
        ),
    ] = AUTOMATIC_AMBIENT,
    near: Annotated[
        list[float] | None,
        typer.Option(
            "--near", metavar="HZ", help="Peak of the FDD methods; may be repeated."
        ),
    ] = None,
    decay: Annotated[
        bool | None,
        typer.Option(
            "--decay/--no-decay",
            help="Free decays: step relaxation, ring-down, impacts without measured force; "
            "the record decides if not given.",
        ),
    ] = None,
    leave_out: LeaveOut = None,
    sensors: Sensors = None,
    choice: ChoiceFile = None,
    choice_to: WriteChoice = None,
    diagram: Diagram = None,
    why: Why = False,
    json: Json = None,
) -> int:
    """Modes from an ambient record: automatic covariance-driven SSI with standard deviations.

    Other methods (--method): poly-reference LSCF on half spectra, ERA/NExT, SSI-data, FDD with
    the damping of FSDD. Free decays (--decay) are fitted as such.

    Setups of moved sensors (--setups): poles of all together, shapes from every record.

    Example: ringtrue oma tower.npy --rate 100 --fmax 10 --write-choice tower.toml
    ringtrue oma --setups setups.csv --rate 100 --sensors sensors.csv --json modes.json
    """
    check_band(fmin, fmax)
    by_setup = {
        "--near": near,
        "--decay": decay,
        "--method": method if method != AUTOMATIC_AMBIENT else None,
        "RECORD": records,
    }
    if setups is not None:
        if given := [name for name, value in by_setup.items() if value]:
            raise ConfigError(
                f"{given[0]} is of one record and does not go with --setups"
            )
        sheet = read_sensors(sensors) if sensors else None
        reading = _SetupReading(rate, group, sheet, tuple(leave_out or ()))
        settings = AmbientSettings(fmin=fmin, fmax=fmax)
        by_hand = choice_of(choice, setups)
        found = _modes_of_setups(setups, merge, reading, settings, by_hand)
        write_pages(setups, found, choice_to, diagram, sheet)
        return print_result(str(setups), found, json, more=_setups_json(found), why=why)
    if not records:
        raise ConfigError(
            "a record is missing; several setups are given by --setups table.csv"
        )
    check_each_once(records)
    record = records[0]
    more = f" .. {records[-1].name} ({len(records)} files)" if len(records) > 1 else ""
    by_hand = choice_of(choice, record)
    by_diagram = {"--choice": choice, "--write-choice": choice_to, "--diagram": diagram}
    check_method(method, AUTOMATIC_AMBIENT, AMBIENT_METHODS, by_diagram)
    if near and not isinstance(AMBIENT_METHODS.get(method), PeakMethod):
        raise ConfigError(
            f"--near: {method} finds its modes in the whole band; give --fmin and --fmax"
        )
    if method != AUTOMATIC_AMBIENT and len(records) > 1:
        raise ConfigError(f"--method {method}: one record, got {len(records)}")
    sheet = read_sensors(sensors) if sensors else None
    notes: list[str] = []

    def read(path: Path) -> TimeHistory:
        history, of_sheet = record_with_notes(path, rate, group, sheet, leave_out or ())
        notes.extend(note for note in of_sheet if note not in notes)
        return history

    parts = ambient_parts(records, map(read, records), notes)
    with (
        progress("ambient modes") as show,
        about(record) if len(records) == 1 else nullcontext(),
    ):
        found = identify_ambient(
            parts,
            fmin=fmin,
            fmax=fmax,
            method=method,
            near=tuple(near or ()),
            decay=decay,
            choice=by_hand,
            progress=show,
        )
    if method == AUTOMATIC_AMBIENT:
        write_pages(record, found, choice_to, diagram, sheet)
    found = replace(found, notes=(*notes, *_machines(found), *found.notes))
    return print_result(f"{record}{more}", found, json, why=why)


@dataclass(frozen=True, slots=True)
class _SetupReading:
    """How the files of setups are read."""

    rate: float | None
    group: str
    sheet: SensorSheet | None
    leave_out: tuple[str, ...]

    def read(self, file: WiredFile, notes: dict[str, None]) -> TimeHistory:
        """The channels of a setup; what is to be said of them is added to `notes`."""
        history, _ = record_with_notes(file.path, self.rate, self.group, None, ())
        named = file.wired(history)
        if self.sheet:
            named, of_sheet = self.sheet.scaled(named)
            notes.update(dict.fromkeys(of_sheet))
        kept = [c.id for c in named.channels if c.id not in self.leave_out]
        return named if len(kept) == len(named.channels) else named.pick(kept)


def _modes_of_setups(
    table: Path,
    merge: str,
    reading: _SetupReading,
    settings: AmbientSettings,
    choice: Choice | None,
) -> TestModes:
    """Modes of the setups of a wiring table."""
    files = read_setup_table(table)
    known = {c.name for file in files for c in file.channels}
    if lost := [c for c in reading.leave_out if c not in known]:
        raise ConfigError(f"--leave-out {lost[0]}{did_you_mean(lost[0], known)}")
    notes: dict[str, None] = {}
    histories = (reading.read(file, notes) for file in files)
    kept = tuple(c for c in references_of(files) if c not in reading.leave_out)
    with progress("ambient modes of setups") as show, about(table):
        found = modes_of_setups(
            histories, settings, kept, merge_method(merge), choice=choice, progress=show
        )
    return replace(found, notes=(*notes, *found.notes))


def _setups_json(found: TestModes) -> dict[str, Any]:
    """Frequencies and damping of each setup; null where it did not find the mode."""
    if not isinstance(found.result, SetupsResult):
        return {}
    result = found.result
    rows = zip(
        result.setups, result.frequency.tolist(), result.damping.tolist(), strict=True
    )
    return {
        "setups": [
            {
                "name": name,
                "frequency_hz": [x if np.isfinite(x) else None for x in frequency],
                "damping": [x if np.isfinite(x) else None for x in damping],
            }
            for name, frequency, damping in rows
        ]
    }


def check_each_once(files: Sequence[Path]) -> None:
    """Refuse a file that is given twice: it would count as a measurement of its own."""
    if twice := [
        str(f) for f, n in Counter(p.resolve() for p in files).items() if n > 1
    ]:
        raise ConfigError(f"{twice[0]} is given twice")


def check_method(
    method: str, automatic: str, others: Iterable[str], options: Mapping[str, object]
) -> None:
    """Refuse a method that is unknown, and options that only the automatic one has."""
    known = (automatic, *others)
    if method not in known:
        raise ConfigError(f"--method {method!r}{did_you_mean(method, known)}")
    given = [name for name, value in options.items() if value is not None]
    if method != automatic and given:
        raise ConfigError(
            f"{given[0]} goes with --method {automatic}; the others have no stabilisation diagram"
        )


def print_result(
    title: str,
    found: TestModes,
    json: str | None,
    *,
    more: dict[str, Any] | None = None,
    if_none: Sequence[str] = (),
    why: bool = False,
) -> int:
    """Print the identified modes with their notes, write them with `more`; the exit status."""
    if json:
        value = modes_to_json(
            found.modes, found.uncertainty, found.reasons, found.others
        )
        write_json(value | (more or {}), json)
    if json != "-":
        count = f"{len(found)} mode{'s' if len(found) != 1 else ''}"
        kinds = Counter(found.others.classes)
        besides = "".join(f", {n} {kind}" for kind, n in sorted(kinds.items()))
        tell((f"{title}: {count}{besides}", HEADS, *mode_lines(found)))
        if why:
            numbered = enumerate(found.reasons, start=1)
            tell((*(f"{k}: {text}" for k, text in numbered), *found.others.sentences()))
        tell((*found.notes, *(() if len(found) else if_none)))
    return 0 if len(found) else 1


def _machines(found: TestModes) -> list[str]:
    """The lines of machines on which no pole is; the others are candidates."""
    if not isinstance(found.result, AmbientResult):
        return []
    listed = {note.values.get("line") for note in found.others.notes}
    return [
        f"line at {h.frequency:.4g} Hz: {h.why}"
        for h in found.result.harmonics
        if h.frequency not in listed
    ]


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
        file_to(
            "--write-frfs", "Write the FRFs with their coherence", ".h5", ".uff", ".csv"
        ),
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
            raise ConfigError(
                f"{twice[0]} does not go with --setups, whose table says it"
            )
        wiring = read_setup_table(setups)
        files = [file.path for file in wiring]
        force = ["F:*"]
    if not files:
        raise ConfigError(
            "a file is missing; several setups are given by --setups table.csv"
        )
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
        measured = estimate_frfs(
            files, reading=reading, settings=settings, progress=show
        )
        if frfs_to:
            write_frfs(frfs_to, measured.frfs)
        found = identify_frfs(
            measured, fmin=fmin, fmax=fmax, choice=by_hand, progress=show
        )
    write_pages(files[0], found, choice_to, diagram, sheet, hits)
    none = (
        "no mode of this band has a confidence above the limit",
        *found.others.sentences(),
    )
    title = " ".join(map(str, files))
    return print_result(
        title, found, json, more=_hits_json(measured.hits), if_none=none, why=why
    )


def _by_hand(
    path: Path | None, files: Sequence[Path]
) -> tuple[Choice | None, tuple[Hit, ...]]:
    """The choice of modes for the first of the files, and of hits of all of them."""
    if path is None:
        return None, ()
    whole = read_choice(path)
    names = {f.stem for f in files}
    hits = tuple(h for h in whole.hits if h.record.partition(" #")[0] in names)
    modes = (
        None if hits and whole.of(files[0].stem) is None else choice_of(path, files[0])
    )
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
