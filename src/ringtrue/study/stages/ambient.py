"""Modes of ambient records, each of one file or of several that go on with each other, and what is
shown of records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.choice import Choice
from ringtrue.core.progress import Progress
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import about
from ringtrue.identification.ambient.pipeline import AmbientSettings, identify_stretches
from ringtrue.identification.ambient.record_bands import SHORTEST
from ringtrue.io.records import read_record, refuse_bad_samples
from ringtrue.io.sheets import SensorSheet
from ringtrue.signal.gaps import Gaps, bridge_gaps
from ringtrue.signal.sensor_response import Geophone, deconvolve, lowest_frequency
from ringtrue.signal.spectra import Welch, csd
from ringtrue.study.config_sections import IdentifySection
from ringtrue.study.hammer_records import renamed
from ringtrue.study.log import Logged, SensorType
from ringtrue.study.results import IdentifiedRecord, RecordSummary
from ringtrue.study.supplied import check_channels

SHOWN, POINTS = 4, 1500  # channels and samples of a preview


def check_sheet(path: Path, channels: Sequence[Channel], sheet: TestModel) -> None:
    """Every response in a record must have its place on the sheet; a force channel names its point
    itself.
    """
    check_channels([c.id for c in channels if c.quantity != "force"], sheet, path)


def _history(
    record: Logged, sheet: SensorSheet, lost: Sequence[str]
) -> tuple[TimeHistory, tuple[str, ...]]:
    """A record without the channels `lost`, and what the sheet told; the others are checked and
    must be on the sheet.

    Samples may be missing.
    """
    history = read_record(record.path, record.rate_hz, check=False, gaps=True)
    history, told = sheet.scaled(renamed(history, record.channels, record.path))
    history = history.pick([c.id for c in history.channels if c.id not in set(lost)])
    refuse_bad_samples(history, record.path, gaps=True)
    check_sheet(record.path, history.channels, sheet.model)
    return history, told


def corrected(
    history: TimeHistory, sensors: Mapping[str, SensorType], low: float | None = None
) -> tuple[TimeHistory, float, str]:
    """The history with the corners of its geophones taken out where the signals allow, from which
    frequency, and why.

    Channels of other sensors stay as they are. With `low`, Hz, they are taken out from there on.
    """
    types = sorted(
        {c.sensor for c in history.channels}
        & {t for t, sheet in sensors.items() if sheet.corrected}
    )
    if not types:
        return history, 0.0, ""
    parts = {t: history.pick([c.id for c in history.channels if c.sensor == t]) for t in types}
    low = low or max(_lowest(parts[t], sensors[t]) for t in types)
    fixed: dict[str, tuple[Channel, Float]] = {}
    for t, part_ in parts.items():
        whole = deconvolve(
            part_, Geophone(sensors[t].corner_hz, sensors[t].damping or 0.0), low=low
        )
        fixed |= {
            c.id: (w, d) for c, w, d in zip(part_.channels, whole.channels, whole.data, strict=True)
        }
    every = [fixed.get(c.id, (c, d)) for c, d in zip(history.channels, history.data, strict=True)]
    corners = " and ".join(f"{sensors[t].corner_hz:g}" for t in types)
    note = f"{corners} Hz corner corrected from {low:.2f} Hz on"
    return (
        replace(history, channels=tuple(c for c, _ in every), data=np.stack([d for _, d in every])),
        low,
        note,
    )


def _lowest(history: TimeHistory, sheet: SensorType) -> float:
    """From where on the signals of geophones stand above their noise, Hz."""
    psd = csd(history, Welch(0.1))
    level = np.median(np.real(np.einsum("fii->fi", psd.data)), axis=1)
    return max(
        lowest_frequency(psd.freqs, level, np.full(psd.freqs.shape, sheet.noise**2)),
        sheet.corner_hz * 0.6,
    )


def summary(
    record: Logged, history: TimeHistory, notes: Sequence[str], *, draw: bool = True
) -> RecordSummary:
    """What the report shows of a record: channels of one unit, thinned so that no peak is lost;
    none unless `draw`.
    """
    unit = history.channels[0].unit
    at = [i for i, c in enumerate(history.channels) if c.unit == unit][: SHOWN if draw else 0]
    if not at:
        return _listed(record, history, notes)
    shown = tuple(history.channels[i] for i in at)
    show = np.asarray(history.data[at], dtype=np.float64)
    psd = csd(TimeHistory(show, history.rate, shown), Welch(max(0.05, 4 / history.duration)))
    power = np.real(np.einsum("fii->if", psd.data))
    thin = max(1, psd.freqs.size // 2000)
    step = max(1, show.shape[1] // POINTS)
    return RecordSummary(
        name=record.name,
        test=record.test,
        excitation=record.excitation,
        file=record.path.name,
        channels=len(history.channels),
        rate=history.rate,
        duration=history.duration,
        preview_time=np.arange(show.shape[1] // step) * step / history.rate,
        preview=_peaks(show, step),
        preview_channels=tuple(c.id for c in shown),
        psd_freqs=psd.freqs[::thin],
        psd=power[:, ::thin],
        notes=tuple(notes),
        unit=unit,
        setup=str(record.setup),
    )


def _listed(record: Logged, history: TimeHistory, notes: Sequence[str]) -> RecordSummary:
    """A record that the report lists and does not draw."""
    line, curves = np.zeros(0), np.zeros((0, 0))
    what = (record.name, record.test, record.excitation, record.path.name)
    size = (len(history.channels), history.rate, history.duration)
    return RecordSummary(
        *what, *size, line, curves, (), line, curves, tuple(notes), setup=str(record.setup)
    )


def _peaks(data: Float, step: int) -> Float:
    """The value of largest modulus in each run of `step` samples, (channel, runs)."""
    runs = data[:, : data.shape[1] // step * step].reshape(len(data), -1, step)
    best = np.abs(runs).argmax(axis=2)
    return np.asarray(np.take_along_axis(runs, best[:, :, None], axis=2)[:, :, 0])


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    """A file of an ambient record: its record, bridged, with the corners of its sensors taken out
    from `low` Hz on.
    """

    history: TimeHistory
    gaps: Gaps
    low: float
    notes: tuple[str, ...]

    def goes_on_in(self, later: _File) -> bool:
        """Whether another has the same channels and rate, and is long enough for a stretch."""
        a, b = self.history, later.history
        return (a.channels, a.rate) == (b.channels, b.rate) and b.duration >= SHORTEST * a.duration


def _files_of_one(
    todo: list[Logged],
    read: Callable[[Logged, float | None], _File],
    choice: Choice,
    shown: list[RecordSummary],
) -> Iterator[_File]:
    """The first of the records `todo` and those that go on with it, each taken out when it is read;
    what to show of it.

    A record with a choice by hand of its own is not joined.
    """
    record = todo.pop(0)
    first = file = read(record, None)
    while True:
        shown.append(summary(record, file.history, file.notes, draw=file is first))
        yield file
        if not (todo and record.goes_on_in(todo[0]) and todo[0].name not in choice.records):
            return
        file = read(todo[0], first.low)
        if not first.goes_on_in(file):
            return
        record = todo.pop(0)


def _as_one(files: Sequence[RecordSummary], notes: Sequence[str]) -> RecordSummary:
    """What is shown of a record of some files, with the `notes` of its identification."""
    first, *more = files
    names = f"{len(files)} files, {first.file} to {files[-1].file}"
    said = (
        (f"{names}, are one record with pauses (a `setup` for each in the log keeps them apart)",)
        if more
        else ()
    )
    told = tuple(f"{x.file}: {n}" for x in more for n in x.notes if n not in first.notes)
    return replace(
        first, duration=sum(x.duration for x in files), notes=(*said, *first.notes, *told, *notes)
    )


def ambient(
    records: Sequence[Logged],
    sensors: Mapping[str, SensorType],
    sheet: SensorSheet,
    settings: IdentifySection,
    lost: Sequence[str],
    choice: Choice,
    progress: Progress,
) -> tuple[list[IdentifiedRecord], list[RecordSummary]]:
    """Modes of each ambient record without the channels `lost`; files that go on with each other
    are one record.
    """

    def read(record: Logged, low: float | None) -> _File:
        history, told = _history(record, sheet, lost)
        raw, gaps = bridge_gaps(history)
        fixed, low, note = corrected(raw, sensors, low)
        return _File(fixed, gaps, low, tuple(n for n in (*told, note, *gaps.channels) if n))

    found, shown, todo = list[IdentifiedRecord](), list[RecordSummary](), list(records)
    while todo:
        record, mine = todo[0], list[RecordSummary]()
        progress(1 - len(todo) / len(records), f"ambient modes: {record.name}")
        files = _files_of_one(todo, read, choice, mine)
        first = next(files)
        stretches = (x.gaps.marked(x.history) for x in chain((first,), files))
        band = AmbientSettings(
            fmin=max(first.low, settings.ambient_fmin or 0.0) or None, fmax=settings.ambient_fmax
        )
        with about(record.path):
            result = identify_stretches(stretches, band, choice=choice.of(record.name))
        found.append(
            IdentifiedRecord(
                record.name, result.modes, result.uncertainty, result.reasons, result.diagrams
            )
        )
        shown.append(_as_one(mine, result.notes))
    return found, shown
