"""`track`: modes of long records followed from hour to hour."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.comparison import RecordParts, track_records
from ringtrue.cli.identify import Fmax, Fmin, LeaveOut, Rate
from ringtrue.cli.show import Json, file_to, progress, rows, tell, write_json
from ringtrue.core.arrays import Float
from ringtrue.errors import ConfigError
from ringtrue.identification.common.tracking import ModeTrack, Tracked
from ringtrue.io.files import atomic_write
from ringtrue.plots.correlation import tracking_page
from ringtrue.signal.spectra import check_band
from ringtrue.study.summary import finite

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


def track(
    records: Annotated[
        list[Path], typer.Argument(help="Records in order of time: .h5, .npy, .csv, .mat or .uff")
    ],
    hours: Annotated[float, typer.Option("--hours", metavar="H", help="Length of a part.")] = 1.0,
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
        file_to("--csv", "Write a line for each mode and part", ".csv"),
    ] = None,
    plot: Annotated[
        Path | None,
        file_to("--plot", "Write the figures as one page", ".html"),
    ] = None,
    json: Json = None,
) -> int:
    """Modes followed through long records, from part to part.

    Example: ringtrue track day1.h5 day2.h5 --hours 1 --csv modes.csv --plot modes.html
    """
    check_band(fmin, fmax)
    try:
        begins = [float(x) for x in starts.split(",")] if starts is not None else []
    except ValueError as e:
        raise ConfigError(f"--starts {starts!r}: hours, separated by commas") from e
    cut = RecordParts(hours, begins, rate, leave_out or ())
    with progress("modes through time") as show:
        tracked, notes = track_records(records, cut, fmin=fmin, fmax=fmax, progress=show)
    if table:
        _write(table, _csv(tracked))
    if plot:
        title = " ".join(p.name for p in records[:3]) + (" ..." if len(records) > 3 else "")
        _write(plot, tracking_page(title, tracked, notes))
    if json:
        write_json(finite(_json(tracked, notes)), json)
    if json != "-":
        _show(tracked, notes)
    return 0 if tracked.tracks else 1


def _write(path: Path, text: str) -> None:
    with atomic_write(path) as part:
        part.write_text(text, encoding="utf-8")


def _columns(t: ModeTrack) -> dict[str, Float]:
    """The columns of the table, a value for each part that shows the mode."""
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
        for at, row in zip(t.at.tolist(), values.tolist(), strict=True):
            cells = [f"{x:.8g}" if math.isfinite(x) else "" for x in row]
            write.writerow([f"{tracked.times[at]:.6g}", t.name, *cells])
    return text.getvalue()


def _json(tracked: Tracked, notes: Sequence[str]) -> dict[str, Any]:
    modes = []
    for t in tracked.tracks:
        mode = {"name": t.name, "time_h": tracked.times[t.at].tolist()}
        mode |= {name: values.tolist() for name, values in _columns(t).items()}
        mode["shape_re"] = t.shape.real.tolist()
        mode["shape_im"] = t.shape.imag.tolist()
        modes.append(mode)
    return {
        "stretches": [{"time_h": hour} for hour in tracked.times.tolist()],
        "channels": list(tracked.channels),
        "modes": modes,
        "notes": list(notes),
    }


def _show(tracked: Tracked, notes: Sequence[str]) -> None:
    body: list[tuple[object, ...]] = []
    for t in tracked.tracks:
        span = f"{t.frequency.min():.5g} .. {t.frequency.max():.5g}"
        seen = f"{t.at.size} of {tracked.times.size}"
        damping = f"{100 * np.median(t.damping):.3f}"
        first = f"{tracked.times[t.at[0]]:.4g}"
        body.append((t.name, f"{t.frequency.mean():.5g}", span, damping, seen, first))
    heads = ("mode", "f [Hz]", "from .. to", "damping [%]", "parts", "first seen [h]")
    rows(f"{len(tracked.tracks)} modes through {tracked.times.size} parts", heads, body)
    tell(notes)
