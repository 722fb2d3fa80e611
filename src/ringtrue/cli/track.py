"""`track`: modes of long records followed from hour to hour, against temperature and amplitude."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.cli.identify import Fmax, Fmin, LeaveOut, Rate, check_band
from ringtrue.cli.show import Json, file_to, progress, rows, tell, write_json
from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError, about, did_you_mean
from ringtrue.identification.ambient import AmbientSettings, identify_ambient
from ringtrue.identification.environment import EnvironmentFit, fit_environment
from ringtrue.identification.gains import with_equal_gains
from ringtrue.identification.inertia import Followed, behind, thermal_lag
from ringtrue.identification.tracking import ModeTrack, Stretch, Tracked, ticks, track_modes, unseen
from ringtrue.io.files import atomic_write, existing, read_text
from ringtrue.io.foreign.door import door
from ringtrue.io.records import read_record, record_blocks, record_info
from ringtrue.plots.tracking import tracking_page

HOUR = 3600.0
LEAST_FITTED = 6  # stretches with a mode before its environment is looked at


@dataclass(frozen=True, slots=True)
class _Environment:
    """Channels that are no responses, and those whose amplitude counts."""

    mean: tuple[str, ...]
    rms: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.mean, *(f"rms {c}" for c in self.rms))

    def values(self, part: TimeHistory) -> list[float]:
        """Means and root mean squares over one stretch; NaN where nothing is known."""
        means = [_quiet(np.mean, part.pick([c]).data[0]) for c in self.mean]
        return means + [_quiet(np.std, part.pick([c]).data[0]) for c in self.rms]


def _quiet(function: Any, x: Any) -> float:
    known = x[np.isfinite(x)]
    return float(function(known, dtype=np.float64)) if known.size else float("nan")


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
    temperature: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Regress on this temperature, which modes may follow hours behind: the mean of "
            "a channel, "
            "which is no response, or a column of --environment.",
        ),
    ] = None,
    amplitude: Annotated[
        list[str] | None,
        typer.Option(
            "--amplitude",
            metavar="CHANNEL",
            help="Regress on the root mean square of this channel.",
        ),
    ] = None,
    environment: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Regress on the columns of a .csv; the first is the time, h."
        ),
    ] = None,
    drift: Annotated[bool, typer.Option("--drift", help="Regress on time too, h.")] = False,
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
    """Modes followed through long records: frequency against temperature and amplitude, outliers,
    changes.

    Example: ringtrue track day1.h5 day2.h5 --hours 1 --temperature T1 --csv modes.csv --plot
    modes.html
    """
    check_band(fmin, fmax)
    if not 0 < hours < math.inf:
        raise ConfigError(f"--hours {hours}: must be positive")
    settings = AmbientSettings(fmin=fmin, fmax=fmax)
    begin = _starts(starts, records)
    given = _given(environment) if environment else None
    heat = tuple(temperature or ())
    env = _Environment(
        tuple(t for t in heat if not (given and t in given.names)), tuple(amplitude or ())
    )
    with progress("modes through time") as show:
        found, values, notes = _collect(
            records, begin, (rate, hours), (settings, env, given, leave_out or ()), show
        )
    found, gains = with_equal_gains(found)
    tracked = track_modes(found)
    notes += [
        f"channel {g.channel}: {g.factor:.4g} ± {g.std:.1g} times as much as before from "
        f"{found[g.at].time:.4g} h on, "
        "in all modes (another sensor or range?); its part of the shapes is divided by that"
        for g in gains
    ]
    if given and not any(given.time[0] <= t <= given.time[-1] for t in tracked.times):
        raise DataError(
            f"{environment}: its times, {given.time[0]:.4g} to {given.time[-1]:.4g} h, are not "
            "those of the stretches, "
            f"{tracked.times[0]:.4g} to {tracked.times[-1]:.4g} h; the first column is in hours"
        )
    columns = (*env.names, *(given.names if given else ()))
    regressors = {name: np.array([v[j] for v in values]) for j, name in enumerate(columns)}
    regressors, late = _late(tracked, regressors, heat)
    notes += late
    if drift:
        regressors["time"] = tracked.times
    fits = {
        t.name: _fit(t, tracked, regressors) for t in tracked.tracks if t.at.size >= LEAST_FITTED
    }
    notes += [*_come_and_gone(tracked), *_rare(tracked)]
    if table:
        _write(table, _csv(tracked, fits, regressors))
    if plot:
        title = " ".join(p.name for p in records[:3]) + (" ..." if len(records) > 3 else "")
        _write(plot, tracking_page(title, tracked, fits, regressors, notes))
    if json:
        write_json(_json(tracked, fits, regressors, notes), json)
    if json != "-":
        _show(tracked, fits, notes)
    return 0 if tracked.tracks else 1


def _collect(
    records: Sequence[Path],
    begin: Sequence[float | None],
    cut: tuple[float | None, float],
    how: tuple[AmbientSettings, _Environment, _Given | None, Sequence[str]],
    show: Progress,
) -> tuple[list[Stretch], list[list[float]], list[str]]:
    """The modes of all stretches, their environment, and what is to be said; `cut` is the rate and
    hours.
    """
    (rate, hours), (settings, env, given, lost) = cut, how
    found: list[Stretch] = []
    values: list[list[float]] = []
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
                _check_names(part, (*env.mean, *env.rms, *lost), path)
                stretch, why = _identified(part, env, lost, settings, middle)
                notes += [f"{middle:.4g} h: {w}" for w in why]
                if stretch is not None:
                    found.append(stretch)
                    values.append([*env.values(part), *(given.at(middle) if given else ())])
    if not found:
        raise DataError("; ".join(["no stretch could be identified", *notes[:3]]))
    return found, values, notes


def _check_names(part: TimeHistory, names: Sequence[str], path: Path) -> None:
    ids = [c.id for c in part.channels]
    for name in names:
        if name not in ids:
            raise ConfigError(f"{path}: no channel {name!r}{did_you_mean(name, ids)}")


def _identified(
    part: TimeHistory,
    env: _Environment,
    lost: Sequence[str],
    settings: AmbientSettings,
    middle: float,
) -> tuple[Stretch | None, list[str]]:
    """The modes of one stretch, and what is to be said of it; None if it cannot be identified: a
    gap.
    """
    motion = part.pick([c.id for c in part.channels if c.id not in {*env.mean, *lost}])
    if not np.isfinite(motion.data).any():
        return None, ["left out: all samples are missing"]
    try:
        result = identify_ambient(motion, settings)
    except DataError as e:
        return None, [f"left out: {e}"]
    said = [n for n in result.notes if n.startswith("channel")]
    return Stretch(middle, result.modes, result.uncertainty), said


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """Columns over time, h."""

    time: Float
    names: tuple[str, ...]
    columns: Float

    def at(self, hour: float) -> list[float]:
        """The columns at a time; NaN outside."""
        return [
            float(np.interp(hour, self.time, c, left=np.nan, right=np.nan)) for c in self.columns
        ]


def _given(path: Path) -> _Given:
    try:
        with door(path, "CSV table"):
            lines = [r for r in csv.reader(io.StringIO(read_text(existing(path)), newline="")) if r]
        names = tuple(x.strip() for x in lines[0])
        values = np.array([[float(x) if x.strip() else math.nan for x in r] for r in lines[1:]])
    except DataError:
        raise
    except (ValueError, IndexError) as e:
        raise DataError(f"{path}: not a table of numbers under a line of names ({e})") from e
    if (
        values.ndim != 2
        or values.shape[1] != len(names)
        or len(names) < 2
        or not (np.diff(values[:, 0]) > 0).all()
    ):
        raise DataError(
            f"{path}: needs a first column of rising hours and one more for each thing to "
            "regress on"
        )
    return _Given(values[:, 0], names[1:], values[:, 1:].T)


def _fit(t: ModeTrack, tracked: Tracked, regressors: Mapping[str, Float]) -> EnvironmentFit:
    clock = np.round(ticks(tracked.times)).astype(np.int64)[t.at]
    return fit_environment(
        t.frequency, t.std_frequency, {k: v[t.at] for k, v in regressors.items()}, clock
    )


def _late(
    tracked: Tracked, regressors: Mapping[str, Float], temperatures: Sequence[str]
) -> tuple[dict[str, Float], list[str]]:
    """The regressors with each temperature as late as all modes follow it, and what is to be said
    of that.
    """
    modes = [Followed(t.frequency, t.std_frequency, t.at) for t in tracked.tracks]
    out: dict[str, Float] = {}
    notes = []
    for name, values in regressors.items():
        lag = thermal_lag(modes, tracked.times, values) if name in temperatures else 0.0
        out[f"{name} {lag:g} h behind" if lag else name] = (
            behind(tracked.times, values, lag) if lag else values
        )
        if lag:
            notes.append(
                f"{name}: the modes follow it with an inertia of {lag:g} h, as which they are "
                "regressed on it"
            )
    return out, notes


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


def _csv(
    tracked: Tracked, fits: Mapping[str, EnvironmentFit], regressors: Mapping[str, Float]
) -> str:
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n")
    heads = (
        "time_h",
        "mode",
        "frequency_hz",
        "std_frequency_hz",
        "damping",
        "std_damping",
        "confidence",
        "mac",
    )
    write.writerow([*heads, "corrected_hz", "residual", "outlier", *regressors])
    for t in tracked.tracks:
        fit = fits.get(t.name)
        for k, at in enumerate(t.at.tolist()):
            own = (t.frequency, t.std_frequency, t.damping, t.std_damping, t.confidence, t.mac)
            more = (fit.corrected[k], fit.residual[k], int(fit.outlier[k])) if fit else ("", "", "")
            write.writerow(
                [
                    f"{tracked.times[at]:.6g}",
                    t.name,
                    *(_short(x[k]) for x in own),
                    *map(_short, more),
                ]
                + [_short(v[at]) for v in regressors.values()]
            )
    return text.getvalue()


def _short(x: Any) -> str:
    return x if isinstance(x, str) else "" if not math.isfinite(x) else f"{x:.8g}"


def _number(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def _json(
    tracked: Tracked,
    fits: Mapping[str, EnvironmentFit],
    regressors: Mapping[str, Float],
    notes: Sequence[str],
) -> dict[str, Any]:
    stretches = [
        {"time_h": float(h), **{k: _number(v[i]) for k, v in regressors.items()}}
        for i, h in enumerate(tracked.times.tolist())
    ]
    modes = [_mode_json(t, tracked, fits.get(t.name)) for t in tracked.tracks]
    return {
        "stretches": stretches,
        "channels": list(tracked.channels),
        "modes": modes,
        "notes": list(notes),
    }


def _mode_json(t: ModeTrack, tracked: Tracked, fit: EnvironmentFit | None) -> dict[str, Any]:
    columns = {
        "frequency_hz": t.frequency,
        "std_frequency_hz": t.std_frequency,
        "damping": t.damping,
        "std_damping": t.std_damping,
        "confidence": t.confidence,
        "mac": t.mac,
    }
    if fit is not None:
        columns |= {"corrected_hz": fit.corrected, "residual": fit.residual}
    value: dict[str, Any] = {
        "name": t.name,
        "time_h": tracked.times[t.at].tolist(),
        **{k: [_number(x) for x in v] for k, v in columns.items()},
        "shape_re": [_number(x) for x in t.shape.real],
        "shape_im": [_number(x) for x in t.shape.imag],
    }
    if fit is None:
        return value
    times = tracked.times[t.at]
    return value | {
        "outliers_h": times[fit.outlier].tolist(),
        "environment": {
            "reference_hz": fit.reference,
            "std_reference_hz": fit.std_reference,
            "explained": fit.explained,
            "scatter_hz": fit.scatter,
            "memory": fit.memory,
            "slopes": [
                {
                    "name": n,
                    "centre": _number(c),
                    "hz_per_unit": _number(b),
                    "std": _number(s),
                    "p_value": _number(p),
                }
                for n, c, b, s, p in zip(
                    fit.names, fit.centre, fit.slope, fit.std_slope, fit.p_value, strict=True
                )
            ],
        },
        "changes": [
            {
                "time_h": float(times[c.at]),
                "shift_hz": c.shift,
                "std_hz": c.std,
                "p_value": c.p_value,
            }
            for c in fit.changes
        ],
    }


def _show(tracked: Tracked, fits: Mapping[str, EnvironmentFit], notes: Sequence[str]) -> None:
    body: list[tuple[object, ...]] = []
    for t in tracked.tracks:
        fit = fits.get(t.name)
        f = fit.reference if fit else float(t.frequency.mean())
        span = f"{t.frequency.min():.5g} .. {t.frequency.max():.5g}"
        seen = f"{t.at.size} of {tracked.times.size}"
        body.append(
            (
                t.name,
                f"{f:.5g}",
                span,
                f"{100 * np.median(t.damping):.3f}",
                seen,
                _words(t, tracked, fit),
            )
        )
    heads = ("mode", "f [Hz]", "from .. to", "damping [%]", "stretches", "environment")
    rows(f"{len(tracked.tracks)} modes through {tracked.times.size} stretches", heads, body)
    tell(notes)


def _words(t: ModeTrack, tracked: Tracked, fit: EnvironmentFit | None) -> str:
    if fit is None:
        return ""
    known = np.isfinite(fit.slope)
    told = [
        f"{n}: {b:+.3g} ± {s:.1g} Hz per unit (p {p:.1g})"
        for n, b, s, p, k in zip(
            fit.names, fit.slope, fit.std_slope, fit.p_value, known, strict=True
        )
        if k
    ]
    told += [f"{int(fit.outlier.sum())} outliers"] if fit.outlier.any() else []
    times = tracked.times[t.at]
    told += [
        f"change at {times[c.at]:.4g} h: {c.shift:+.3g} ± {c.std:.1g} Hz (p {c.p_value:.1g})"
        for c in fit.changes
    ]
    told += [f"first seen at {times[0]:.4g} h"] if t.at[0] > 0 else []
    return "; ".join(told)
