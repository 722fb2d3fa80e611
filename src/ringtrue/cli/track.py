"""`track`: modes of long records followed from hour to hour."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.measurements import check_band
from ringtrue.cli.identify import Fmax, Fmin, LeaveOut, Rate
from ringtrue.cli.show import Json, file_to, progress, rows, tell, write_json
from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError, about, did_you_mean
from ringtrue.identification.ambient.pipeline import AmbientSettings, identify_ambient
from ringtrue.identification.common.tracking import ModeTrack, Stretch, Tracked, track_modes, unseen
from ringtrue.io.files import atomic_write
from ringtrue.io.records import read_record, record_blocks, record_info
from ringtrue.plots.tracking import tracking_page

HOUR = 3600.0
HEADS = (
    "time_h",
    "mode",
    "frequency_hz",
    "std_frequency_hz",
    "damping",
    "std_damping",
    "confidence",
    "mac",
)


def _parts(path: Path, rate: float | None, seconds: float) -> Iterator[TimeHistory]:
    """A record in stretches; one in ringtrue's layout is never in memory as a whole."""
    try:
        info = record_info(path) if path.suffix.lower() in (".h5", ".hdf5") else None
    except DataError:
        info = None
    if info is not None:
        size = max(2, round(seconds * info.rate))
        yield from record_blocks(path, size)
        return
    history = read_record(path, rate, check=False, gaps=True)
    size = max(2, round(seconds * history.rate))
    for a in range(0, history.data.shape[1], size):
        part = history.data[:, a : a + size]
        yield TimeHistory(part, history.rate, history.channels, history.source)


def _starts(text: str | None, records: Sequence[Path]) -> list[float | None]:
    if text is None:
        return [None] * len(records)
    try:
        values = [float(x) for x in text.split(",")]
    except ValueError as e:
        raise ConfigError(f"--starts {text!r}: hours, separated by commas") from e
    if len(values) != len(records) or not all(map(math.isfinite, values)):
        raise ConfigError(
            f"--starts {text!r}: {len(values)} hours for {len(records)} records; one for each"
        )
    return list(values)


def track(
    records: Annotated[
        list[Path], typer.Argument(help="Records in order of time: .h5, .npy, .csv, .mat or .uff")
    ],
    hours: Annotated[
        float, typer.Option("--hours", metavar="H", help="Length of a stretch.")
    ] = 1.0,
    starts: Annotated[
        str | None,
        typer.Option(
            "--starts",
            metavar="H,H,...",
            help="Start of each record; without it one follows the other.",
        ),
    ] = None,
    rate: Rate = None,
    fmin: Fmin = None,
    fmax: Fmax = None,
    leave_out: LeaveOut = None,
    table: Annotated[
        Path | None,
        file_to("--csv", "Write a line for each mode and stretch", ".csv"),
    ] = None,
    plot: Annotated[
        Path | None,
        file_to("--plot", "Write the figures as one page", ".html"),
    ] = None,
    json: Json = None,
) -> int:
    """Modes followed through long records, from stretch to stretch.

    Example: ringtrue track day1.h5 day2.h5 --hours 1 --csv modes.csv --plot modes.html
    """
    check_band(fmin, fmax)
    if not 0 < hours < math.inf:
        raise ConfigError(f"--hours {hours}: must be positive")
    settings = AmbientSettings(fmin=fmin, fmax=fmax)
    begin = _starts(starts, records)
    lost = tuple(leave_out or ())
    with progress("modes through time") as show:
        found, notes = _collect(records, begin, (rate, hours), settings, lost, show)
    tracked = track_modes(found)
    notes += [*_come_and_gone(tracked), *_rare(tracked)]
    if table:
        _write(table, _csv(tracked))
    if plot:
        title = " ".join(p.name for p in records[:3]) + (" ..." if len(records) > 3 else "")
        _write(plot, tracking_page(title, tracked, notes))
    if json:
        write_json(_json(tracked, notes), json)
    if json != "-":
        _show(tracked, notes)
    return 0 if tracked.tracks else 1


def _collect(
    records: Sequence[Path],
    begin: Sequence[float | None],
    cut: tuple[float | None, float],
    settings: AmbientSettings,
    lost: Sequence[str],
    show: Progress,
) -> tuple[list[Stretch], list[str]]:
    """The modes of all stretches, and notes on them; `cut` is the rate and hours."""
    rate, hours = cut
    found: list[Stretch] = []
    notes: list[str] = []
    at = 0.0
    for i, path in enumerate(records):
        at = at if (start := begin[i]) is None else start
        with about(path):
            for part in _parts(path, rate, hours * HOUR):
                length = part.duration / HOUR
                middle = at + 0.5 * length
                show(i / len(records), f"{path.name}, {at:.4g} h")
                at += length
                if length < 0.5 * hours:
                    notes.append(
                        f"{path.name}: the last {60 * length:.3g} min are too short for a stretch"
                    )
                    continue
                _check_names(part, lost, path)
                stretch, why = _identified(part, lost, settings, middle)
                notes += [f"{middle:.4g} h: {w}" for w in why]
                if stretch is not None:
                    found.append(stretch)
    if not found:
        raise DataError("; ".join(["no stretch could be identified", *notes[:3]]))
    return found, notes


def _check_names(part: TimeHistory, names: Sequence[str], path: Path) -> None:
    ids = [c.id for c in part.channels]
    for name in names:
        if name not in ids:
            raise ConfigError(f"{path}: no channel {name!r}{did_you_mean(name, ids)}")


def _identified(
    part: TimeHistory, lost: Sequence[str], settings: AmbientSettings, middle: float
) -> tuple[Stretch | None, list[str]]:
    """The modes of one stretch, and notes on it; None if it cannot be identified: a
    gap.
    """
    motion = part.pick([c.id for c in part.channels if c.id not in lost])
    if not np.isfinite(motion.data).any():
        return None, ["left out: all samples are missing"]
    try:
        result = identify_ambient(motion, settings)
    except DataError as e:
        return None, [f"left out: {e}"]
    stretch = Stretch(middle, result.modes, result.uncertainty)
    return stretch, list(result.channel_notes)


def _come_and_gone(tracked: Tracked) -> list[str]:
    notes = []
    for t in tracked.tracks:
        before, after = unseen(tracked, t)
        if before:
            notes.append(
                f"mode {t.name}: not seen before {tracked.times[t.at[0]]:.4g} h, in {before} "
                "stretches"
            )
        if after:
            notes.append(
                f"mode {t.name}: not seen after {tracked.times[t.at[-1]]:.4g} h, in {after} "
                "stretches"
            )
    return notes


def _rare(tracked: Tracked) -> list[str]:
    return [
        f"seen in {t.at.size} of {tracked.times.size} stretches only: a pole at "
        f"{t.frequency.mean():.5g} Hz, "
        f"at {tracked.times[t.at[0]]:.4g} h"
        for t in tracked.rare
    ]


def _write(path: Path, text: str) -> None:
    with atomic_write(path) as part:
        part.write_text(text, encoding="utf-8")


def _columns(t: ModeTrack) -> dict[str, Float]:
    """What is written of each stretch that shows a mode."""
    return {
        "frequency_hz": t.frequency,
        "std_frequency_hz": t.std_frequency,
        "damping": t.damping,
        "std_damping": t.std_damping,
        "confidence": t.confidence,
        "mac": t.mac,
    }


def _csv(tracked: Tracked) -> str:
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n")
    write.writerow(HEADS)
    for t in tracked.tracks:
        values = np.array(list(_columns(t).values())).T
        for at, row in zip(t.at.tolist(), values, strict=True):
            write.writerow([f"{tracked.times[at]:.6g}", t.name, *(_short(x) for x in row)])
    return text.getvalue()


def _short(x: float) -> str:
    return f"{x:.8g}" if math.isfinite(x) else ""


def _number(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def _json(tracked: Tracked, notes: Sequence[str]) -> dict[str, Any]:
    return {
        "stretches": [{"time_h": hour} for hour in tracked.times.tolist()],
        "channels": list(tracked.channels),
        "modes": [_mode_json(t, tracked) for t in tracked.tracks],
        "notes": list(notes),
    }


def _mode_json(t: ModeTrack, tracked: Tracked) -> dict[str, Any]:
    return {
        "name": t.name,
        "time_h": tracked.times[t.at].tolist(),
        **{k: [_number(x) for x in v] for k, v in _columns(t).items()},
        "shape_re": [_number(x) for x in t.shape.real],
        "shape_im": [_number(x) for x in t.shape.imag],
    }


def _show(tracked: Tracked, notes: Sequence[str]) -> None:
    body: list[tuple[object, ...]] = []
    for t in tracked.tracks:
        span = f"{t.frequency.min():.5g} .. {t.frequency.max():.5g}"
        seen = f"{t.at.size} of {tracked.times.size}"
        damping = f"{100 * np.median(t.damping):.3f}"
        first = f"{tracked.times[t.at[0]]:.4g}"
        body.append((t.name, f"{t.frequency.mean():.5g}", span, damping, seen, first))
    heads = ("mode", "f [Hz]", "from .. to", "damping [%]", "stretches", "first seen [h]")
    rows(f"{len(tracked.tracks)} modes through {tracked.times.size} stretches", heads, body)
    tell(notes)
