"""Records as a screen looks at them: read where they are looked at, whatever their length.

Hits of a hammer are seen one by one, with the FRFs that those that are kept give.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Any_, Float, FrozenArrays, Int
from ringtrue.core.choice import Hit
from ringtrue.core.notes import Note
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.recognition import Format, format_of
from ringtrue.io.records import read_record, read_runs, record_info, record_parts
from ringtrue.io.sheets import SensorSheet
from ringtrue.signal.channel_checks import check_channels
from ringtrue.signal.frf import estimate_columns
from ringtrue.signal.impacts import (
    HammerSettings,
    ImpactReport,
    force_channel,
    pulse_width,
)
from ringtrue.signal.overview import (
    Extremes,
    Spans,
    Spectrogram,
    envelope,
    extremes,
    spectra,
    spectrogram,
)
from ringtrue.study.hammer_records import renamed
from ringtrue.study.log import Logged
from ringtrue.study.stages.identify import acquisitions, block_settings

IN_MEMORY = 64_000_000  # bytes; a larger table of others is kept in a file of its own
CHECKED = 256_000_000  # bytes of a record that is checked as a whole


@dataclass(frozen=True, eq=False)
class RecordView:
    """A record of any length.

    Attributes
    ----------
    name : str
    channels : tuple of Channel
        As the sensor sheet names them.
    rate : float, Hz
    samples : int
    starts : tuple of int
        First sample of each acquisition, which follow each other.
    """

    name: str
    channels: tuple[Channel, ...]
    rate: float
    samples: int
    starts: tuple[int, ...]
    _rows: Callable[[Sequence[int], Spans], Iterator[Any_]]
    _factor: Float
    _known: dict[str, Extremes] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Length, s."""
        return self.samples / self.rate

    @property
    def bytes(self) -> int:
        """Size of all samples in single precision."""
        return 4 * self.samples * len(self.channels)

    def read(self, ids: Sequence[str], start: int, stop: int) -> Any_:
        """Samples `start` to `stop` of some channels, (channel, sample) float, SI.

        Raises
        ------
        DataError
            If there is no such channel, or the file is damaged.
        """
        (data,) = self.parts(ids, [(start, stop)])
        return data

    def parts(self, ids: Sequence[str], spans: Spans) -> Iterator[Any_]:
        """As `read`, several parts one after the other."""
        here = {c.id: k for k, c in enumerate(self.channels)}
        if lost := [i for i in ids if i not in here]:
            raise DataError(f"{self.name}: no channel {lost[0]}")
        at = [here[i] for i in ids]
        factor = self._factor[at]
        for data in self._rows(at, spans):
            yield (
                data
                if (factor == 1).all()
                else data * factor[:, None].astype(data.dtype)
            )

    def envelope(
        self, ids: Sequence[str], start: int, stop: int, bins: int = 1000
    ) -> Extremes:
        """Samples `start` to `stop` at the size of a screen, as `signal.overview.envelope`."""

        def whole() -> Extremes:
            parts = [self._extremes(i) for i in ids]
            low, high, lost = (
                np.concatenate([getattr(p, name) for p in parts])
                for name in ("low", "high", "lost")
            )
            return Extremes(parts[0].first, low, high, lost)

        return envelope(partial(self.parts, ids), start, stop, bins=bins, whole=whole)

    def _extremes(self, channel: str) -> Extremes:
        """The envelope of a whole channel, read once."""
        if channel not in self._known:
            self._known[channel] = extremes(
                partial(self.parts, [channel]), self.samples
            )
        return self._known[channel]

    def spectra(
        self, ids: Sequence[str], start: int, stop: int, resolution: float
    ) -> tuple[Float, Float, int]:
        """Frequencies (f,), Hz, densities (channel, f), unit²/Hz, and the segments averaged."""
        read = partial(self.parts, ids)
        return spectra(read, start, stop, rate=self.rate, resolution=resolution)

    def spectrogram(self, channel: str, start: int, stop: int) -> Spectrogram:
        """Spectra of one channel along its time."""
        read = partial(self.parts, [channel])
        return spectrogram(read, start, stop, rate=self.rate)

    def checked(self) -> tuple[Note, ...] | None:
        """What `signal.channel_checks.check_channels` finds; None of a record over 256 MB."""
        if self.bytes > CHECKED:
            return None
        data = self.read([c.id for c in self.channels], 0, self.samples)
        return check_channels(TimeHistory(data, self.rate, self.channels, self.name))


def open_view(record: Logged | Path, sheet: SensorSheet | None = None) -> RecordView:
    """A record of a log, or a file by itself, with the names and units of its sensor sheet.

    Of ringtrue's own layout no sample is read; files of others are read whole, and kept outside of
    memory where they are large.

    Raises
    ------
    DataError
        As `io.records.read_record` does.
    """
    logged = record if isinstance(record, Logged) else None
    path = logged.path if logged else Path(str(record))
    rate = logged.rate_hz if logged else None
    try:
        own = record_info(path) if format_of(path) is Format.HDF5 else None
    except DataError:  # HDF5 of others
        own = None
    if own is not None:
        ids = [c.id for c in own.channels]
        channels = tuple(c.channel() for c in own.channels)
        starts, samples, found = (0,), own.samples, own.rate
        rows = partial(_stored_rows, path, ids)
    else:
        # as the study reads them
        forced = logged is not None and logged.kind != "ambient"
        runs = (
            read_runs(path, rate)
            if forced
            else (read_record(path, rate, check=False, gaps=True),)
        )
        channels, found = runs[0].channels, runs[0].rate
        ends = np.cumsum([r.data.shape[1] for r in runs]).tolist()
        starts, samples = (0, *ends[:-1]), ends[-1]
        rows = partial(_kept_rows, _kept(runs))
    names = logged.channels if logged else ()
    at, channels, factor = _named(channels, found, names, sheet, path)
    return RecordView(
        name=logged.name if logged else path.stem,
        channels=channels,
        rate=found,
        samples=samples,
        starts=starts,
        _rows=lambda wanted, spans: rows(at[wanted].tolist(), spans),
        _factor=factor,
    )


def _named(
    channels: Sequence[Channel],
    rate: float,
    names: Sequence[str],
    sheet: SensorSheet | None,
    path: Path,
) -> tuple[Int, tuple[Channel, ...], Float]:
    """Rows of the file that are channels, the channels as log and sheet name them, and the factors
    that make their samples SI.
    """
    rows = np.repeat(np.arange(len(channels), dtype=np.float64)[:, None], 2, axis=1)
    given = renamed(TimeHistory(rows, rate, tuple(channels), str(path)), names, path)
    ones = replace(given, data=np.ones_like(given.data))
    scaled = sheet.scaled(ones)[0] if sheet is not None else ones
    at = given.data[:, 0].astype(np.int64)
    return at, scaled.channels, np.asarray(scaled.data[:, 0], dtype=np.float64)


def _stored_rows(
    path: Path, ids: Sequence[str], at: Sequence[int], spans: Spans
) -> Iterator[Any_]:
    """Rows of a record in ringtrue's layout."""
    for part in record_parts(path, [ids[k] for k in at], spans):
        yield part.data


def _kept(runs: Sequence[TimeHistory]) -> Any_:
    """Samples of all acquisitions in a row; in a file without a name where they are many."""
    size = sum(r.data.nbytes for r in runs)
    if size <= IN_MEMORY:
        return np.hstack([r.data for r in runs])
    shape = len(runs[0].channels), sum(r.data.shape[1] for r in runs)
    with tempfile.TemporaryFile() as file:
        kept = np.memmap(file, dtype=runs[0].data.dtype, mode="w+", shape=shape)
    at = 0
    for r in runs:
        kept[:, at : at + r.data.shape[1]] = r.data
        at += r.data.shape[1]
    return kept


def _kept_rows(kept: Any_, at: Sequence[int], spans: Spans) -> Iterator[Any_]:
    """Rows of samples that were read before."""
    for start, stop in spans:
        data = np.asarray(kept[list(at), start:stop])
        yield data if data.dtype.kind == "f" else data.astype(np.float64)


PULSES = 8  # pulse widths of the force that are shown on both sides
LONGEST_S = 60.0  # of a response without a block


@dataclass(frozen=True, slots=True, eq=False)
class HitSignals(FrozenArrays):
    """One hit.

    Attributes
    ----------
    force_time : (k,) float64, s
        From the peak of the force on.
    force : (k,) float64, N
        Without its offset.
    freqs : (f,) float64, Hz
    force_level : (f,) float64, dB
        Of the spectrum of the pulse over its largest line.
    time : (n,) float64, s
        From the peak of the force on.
    response : (channel, n) float64
    rate : float, Hz
    """

    force_time: Float
    force: Float
    freqs: Float
    force_level: Float
    time: Float
    response: Float
    rate: float


def force_of(view: RecordView, record: Logged) -> str:
    """The force channel of a record with a hammer.

    Raises
    ------
    DataError
        As `signal.impacts.force_channel` does.
    """
    empty = TimeHistory(
        np.zeros((len(view.channels), 2)), view.rate, view.channels, view.name
    )
    at = force_channel(empty, HammerSettings(force=record.force_channel))
    return view.channels[at].id


def place_of(view: RecordView, hit: ImpactReport) -> int:
    """Sample of the peak of a hit in the record."""
    number = hit.source.rpartition(" #")[2]
    run = int(number) - 1 if number.isdigit() and len(view.starts) > 1 else 0
    return view.starts[min(run, len(view.starts) - 1)] + round(hit.time * view.rate)


def hit_signals(
    view: RecordView,
    record: Logged,
    hits: Sequence[ImpactReport],
    k: int,
    responses: Sequence[str],
) -> HitSignals:
    """The signals of hit `k` of a record: of its block, or up to the next hit."""
    settings = block_settings(record, view.rate)
    peak = place_of(view, hits[k])
    later = sorted(place_of(view, h) for h in hits)
    ends = [s for s in (*view.starts[1:], view.samples) if s > peak]
    following = [s for s in later if s > peak]
    length = round((settings.block or LONGEST_S) * view.rate)
    start = max(peak - round(settings.pretrigger * view.rate), 0)
    stop = min([start + length, ends[0], *following[:1]])
    (block,) = view.read([force_of(view, record)], start, stop)
    force = np.asarray(block, dtype=np.float64)
    force = force - np.median(force)
    at = peak - start
    wide = PULSES * max(pulse_width(force, at), 1)
    around = slice(max(at - wide, 0), at + wide + 1)
    pulse = np.zeros_like(force)
    pulse[around] = force[around]
    power = np.abs(np.fft.rfft(pulse)) ** 2
    level = 10 * np.log10(np.maximum(power / max(float(power.max()), 1e-300), 1e-12))
    time = (np.arange(force.size) - at) / view.rate
    response = np.asarray(view.read(responses, start, stop), dtype=np.float64)
    return HitSignals(
        force_time=time[around],
        force=force[around],
        freqs=np.asarray(np.fft.rfftfreq(force.size, 1 / view.rate), dtype=np.float64),
        force_level=level,
        time=time,
        response=response,
        rate=view.rate,
    )


def kept_frfs(
    record: Logged,
    sheet: SensorSheet,
    unused: Sequence[str],
    hits: Sequence[Hit],
    keep_to: float | None = None,
) -> FrfSet:
    """FRFs and coherence of one record, of the hits that count after a choice by hand.

    Raises
    ------
    DataError
        As `signal.frf.estimate_columns` does, as where no hit is left.
    """
    runs, _ = acquisitions(record, sheet, unused)
    settings = replace(
        block_settings(record, runs[0].rate), keep_to=keep_to, hits=tuple(hits)
    )
    columns, _ = estimate_columns(runs, settings)
    return columns[0]
