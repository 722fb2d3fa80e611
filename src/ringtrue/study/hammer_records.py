"""Records with measured forces, of hammers or shakers: how they are read, and their FRFs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from ringtrue.core.channels import FORCES, MOTIONS, SI_UNIT, UNIT, Motion
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.io.campaign_tables import WiredFile
from ringtrue.io.recognition import Format, format_of
from ringtrue.io.records import read_runs, record_info, refuse_bad_samples
from ringtrue.io.sheets import SensorSheet
from ringtrue.signal.channel_checks import clipping, explain_clipping
from ringtrue.signal.frf import estimate_columns, shaker_frfs
from ringtrue.signal.impacts import (
    Estimator,
    HammerSettings,
    ImpactReport,
    force_channel,
    record_names,
)
from ringtrue.signal.local_rational import (
    is_continuous,
    local_frfs,
    period,
    periodic_frfs,
    spacing,
)
from ringtrue.signal.spectra import Welch


@dataclass(frozen=True, slots=True)
class ForceRecordFormat:
    """How the records of a hammer test are to be read.

    Attributes
    ----------
    force : tuple of str
        Id of the force channel or a pattern of it (`Hammer*`), one for all files or one a file; by
        default found by its quantity, or else by its name.
    struck : tuple of str
        Point and direction struck, such as `3+Z`, one for all files or one a file; by default the
        id of the force.
    leave_out : tuple of str
        Channels that are not used.
    quantity : str
        What responses measure, acceleration, velocity or displacement, where no file states it; by
        default acceleration, and a note says so.
    rate : float, Hz, optional
        Where the files have none.
    group : str
        The group of a `.tdms` or HDF5 file that is meant.
    channels : tuple of tuple of str
        Names in place of those of the file (`renamed`), one set for all files or one a file.
    wiring : tuple of WiredFile
        The files of a wiring table, which names their channels; empty without one.
    sheet : SensorSheet, optional
        Tells units and sensitivities where the files do not.
    """

    force: tuple[str, ...] = ()
    struck: tuple[str, ...] = ()
    leave_out: tuple[str, ...] = ()
    quantity: str = ""
    rate: float | None = None
    group: str = ""
    channels: tuple[tuple[str, ...], ...] = ()
    wiring: tuple[WiredFile, ...] = ()
    sheet: SensorSheet | None = None

    def of(self, k: int) -> ForceRecordFormat:
        """How file k is to be read."""
        force, struck = (x[k : k + 1] or x[:1] for x in (self.force, self.struck))
        channels = self.channels[k : k + 1] or self.channels[:1]
        wiring = self.wiring[k : k + 1]
        return replace(
            self, force=force, struck=struck, channels=channels, wiring=wiring
        )


def renamed(history: TimeHistory, names: Sequence[str], path: Path) -> TimeHistory:
    """The channels by other names, in their order in the file; those with an empty name are left
    out.

    Raises
    ------
    DataError
        If there are not as many names as channels, or one comes twice.
    """
    if not names:
        return history
    old = [c.id for c in history.channels]
    if (
        isinstance(names, str)
        or len(names) != len(old)
        or not all(isinstance(n, str) for n in names)
    ):
        raise DataError(
            f"{path}: `channels` must name all {len(old)} in their order: {' '.join(old[:40])}"
        )
    given = [n for n in names if n]
    if twice := sorted({n for n in given if given.count(n) > 1}):
        raise DataError(f"{path}: `channels` names {' '.join(twice)} twice")
    kept = history.pick([i for i, name in zip(old, names, strict=True) if name])
    return replace(
        kept,
        channels=tuple(
            replace(c, id=n) for c, n in zip(kept.channels, given, strict=True)
        ),
    )


def full_scale(path: Path) -> dict[str, float]:
    """Ranges of the channels by id, SI, where the record states them."""
    try:
        return record_info(path).full_scale() if format_of(path) is Format.HDF5 else {}
    except DataError:  # HDF5 of another layout
        return {}


def rejected_hits(hits: Sequence[ImpactReport]) -> tuple[str, ...]:
    """A line for each blow that does not count, or of which something is to be said."""
    return tuple(
        f"{h.source}, {h.time:.2f} s, {h.peak:.0f} N: "
        f"{'used, but ' if h.accepted else ''}{', '.join(h.reasons)}"
        for h in hits
        if h.reasons
    )


def accepted_hits(hits: Sequence[ImpactReport]) -> str:
    """How many blows count."""
    return f"{sum(h.accepted for h in hits)} of {len(hits)} hits kept"


def read_force_records(
    paths: Sequence[Path], how: ForceRecordFormat | None = None
) -> tuple[tuple[TimeHistory, ...], dict[str, float], tuple[str, ...]]:
    """The records of all files, forces and motions each, ready for `forced_frfs`.

    Parameters
    ----------
    paths : sequence of Path
    how : ForceRecordFormat, optional

    Returns
    -------
    tuple of TimeHistory
        `source` names file and acquisition.
    dict
        Full scale by channel, where known.
    tuple of str
        Channels that are not used, and what was taken for granted.

    Raises
    ------
    DataError
        If a file has no force channel, no motion, or samples that are constant or not finite.
    ConfigError
        If there are neither one nor as many points struck, names of the force, or of the channels,
        as files, or no file has a channel to be left out.
    """
    how = how or ForceRecordFormat()
    options = {"--struck": how.struck, "--force": how.force, "--channels": how.channels}
    for option, given in options.items():
        if len(given) not in (0, 1, len(paths)):
            raise ConfigError(
                f"{option}: given {len(given)} times for {len(paths)} files; once for all, or "
                "once each"
            )
    found = [read_file(path, how.of(i)) for i, path in enumerate(paths)]
    known = {name for file in found for name in file.channels}
    if lost := [c for c in how.leave_out if c not in known]:
        raise ConfigError(
            f"--leave-out {lost[0]}: no file has such a channel; there are "
            f"{' '.join(sorted(known)[:40])}"
        )
    ranges: dict[str, float] = {}
    for path in paths:
        ranges |= full_scale(path)
    records = tuple(record for file in found for record in file.records)
    return (
        records,
        ranges,
        tuple(dict.fromkeys(note for file in found for note in file.notes)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ForceRecords:
    """The acquisitions of one file, notes, and all channels that it has."""

    records: tuple[TimeHistory, ...]
    notes: tuple[str, ...]
    channels: frozenset[str]


def read_file(path: Path, how: ForceRecordFormat) -> ForceRecords:
    """The acquisitions of one file as `read_force_records` gives them.

    Channels of `leave_out` that the file does not have are no error: another file of the test may
    have them.

    Raises
    ------
    DataError
        As `read_force_records` does.
    """
    runs = read_runs(path, how.rate, group=how.group)
    names = how.channels[0] if how.channels else ()
    if how.wiring:
        names = how.wiring[0].force_names([c.id for c in runs[0].channels])
    records = []
    notes: list[str] = []
    channels: set[str] = set()
    for k, run in enumerate(runs, start=1):
        source = str(path) if len(runs) == 1 else f"{path} #{k}"
        named = renamed(replace(run, source=source), names, path)
        if how.sheet:
            named, of_sheet = how.sheet.scaled(named)
            notes += of_sheet
        here = [c.id for c in named.channels]
        channels.update(here)
        record, more = _prepared(
            named.pick([c for c in here if c not in how.leave_out]), how
        )
        refuse_bad_samples(record, path)
        records.append(record)
        notes += more
    return ForceRecords(
        tuple(records), tuple(dict.fromkeys(notes)), frozenset(channels)
    )


def _prepared(
    record: TimeHistory, how: ForceRecordFormat
) -> tuple[TimeHistory, list[str]]:
    """The force, named after the point struck, and the motions; several forces where shakers run
    together.
    """
    force, point = ("".join(x[:1]) for x in (how.force, how.struck))
    at = (
        [i for i, c in enumerate(record.channels) if c.quantity in FORCES]
        if not force
        else []
    )
    at = at if len(at) > 1 else [force_channel(record, HammerSettings(force=force))]
    notes = list[str]()
    if point and len(at) > 1:
        raise ConfigError(
            f"--struck {point}: {record.source} has {len(at)} forces; their names give their points"
        )
    rest = [i for i in range(len(record.channels)) if i not in at]
    motions = [i for i in rest if record.channels[i].quantity in MOTIONS]
    unknown = [i for i in rest if record.channels[i].quantity == "unknown"]
    quantity = cast(Motion, how.quantity or "acceleration")
    if not motions and unknown:
        motions = unknown
        if not how.quantity:
            notes.append(
                "no unit says what the responses measure: taken as accelerations, m/s^2 "
                "(--quantity)"
            )
    if bare := [
        record.channels[i].id for i in at if record.channels[i].quantity == "unknown"
    ]:
        notes.append(
            f"{' '.join(bare)}: a force without a unit, taken as N (--sensors)"
        )
    if lost := [record.channels[i].id for i in rest if i not in motions]:
        notes.append(f"channel {' '.join(lost)}: no motion, not used")
    if not motions:
        raise DataError(
            f"{record.source}: no channel but the force {record.channels[at[0]].id} is a motion"
        )
    channels = [
        c
        if c.quantity in MOTIONS
        else Channel(c.id, quantity, SI_UNIT[quantity], c.sensor)
        for c in record.channels
    ]
    forces = []
    for c in (record.channels[i] for i in at):
        acting = c.quantity if c.quantity in FORCES else "force"
        name = f"F:{point}" if point else c.id
        forces.append(Channel(name, acting, UNIT[acting], c.sensor))
    data = np.asarray(record.data[[*at, *motions]])
    return TimeHistory(
        data, record.rate, (*forces, *(channels[i] for i in motions)), record.source
    ), notes


@dataclass(frozen=True, slots=True, eq=False)
class Forced:
    """FRFs of records, before they are joined.

    Attributes
    ----------
    columns : tuple of FrfSet
        On the same lines.
    hits : tuple of ImpactReport
        The blows; none of shakers.
    notes : tuple of str
        Responses that overload, points at which the force has the other sign, where the FRFs of
        blows end because the force does; how those of shakers were estimated.
    clipped : tuple of str
        Channels that are clipped, a line each.
    """

    columns: tuple[FrfSet, ...]
    hits: tuple[ImpactReport, ...] = ()
    notes: tuple[str, ...] = ()
    clipped: tuple[str, ...] = ()


def forced_frfs(
    records: Sequence[TimeHistory],
    settings: HammerSettings,
    resolution: float | None = None,
    *,
    full_scale: Mapping[str, float] | None = None,
    progress: Progress = quiet,
) -> Forced:
    """FRFs of records as `read_force_records` reads them: of shakers where all forces run all
    the time, else of blows.

    Parameters
    ----------
    records : sequence of TimeHistory, SI, equal rates
    settings : HammerSettings
        Of blows; its estimator holds for shakers, too.
    resolution : float, Hz, optional
        Distance of the lines of shakers; they are shakers if it is given.
    full_scale : mapping of str to float, optional
        Range of each channel by id, in its unit; for the detection of overloads.
    progress : callable (fraction, text)

    Raises
    ------
    DataError
        As `signal.frf.estimate_columns`, `signal.local_rational.local_frfs` and
        `signal.frf.shaker_frfs` do.
    """
    clipped = tuple(f"{r.source}: {line}" for r in records for line in clipping(r))
    with explain_clipping(clipped):
        return replace(
            _estimated(records, settings, resolution, full_scale, progress),
            clipped=clipped,
        )


def _estimated(
    records: Sequence[TimeHistory],
    settings: HammerSettings,
    resolution: float | None,
    full_scale: Mapping[str, float] | None,
    progress: Progress,
) -> Forced:
    if resolution is None and not all(is_continuous(r) for r in records):
        columns, hits = estimate_columns(
            records, settings, full_scale=full_scale, progress=progress
        )
        lost = dict.fromkeys(c for h in hits for c in h.lost)
        notes = (
            *_turned(hits),
            *_force_end(columns, records[0].rate, settings.keep_to),
        )
        if lost:
            left_out = f"response {' '.join(lost)}: overload in most blows, left out"
            notes = (left_out, *notes)
        return Forced(columns, hits, notes)
    mine = {name for r in records for name in record_names(r.source)}
    if wrong := [h for h in settings.hits if h.record in mine]:
        raise ConfigError(
            f"hit of {wrong[0].record} at {wrong[0].time:g} s: its force runs all the time, there "
            "are no hits to choose"
        )
    parts = tuple(_shaken(records, resolution, settings.estimator))
    step = float(np.median(np.diff(parts[0].freqs)))
    averages = parts[0].averages[0]
    said = (
        f"the force runs all the time: lines every {step:.3g} Hz, "
        f"{averages:.3g} averages at each"
    )
    return Forced(parts, notes=(said,))


def _turned(hits: Sequence[ImpactReport]) -> tuple[str, ...]:
    """A line where a hammer, which can only push, has forces of one sign at some points and of the
    other elsewhere.
    """
    peaks: dict[str, list[float]] = {}
    for h in hits:
        if h.accepted:
            peaks.setdefault(h.input, []).append(h.peak)
    below = [point for point, peak in peaks.items() if np.median(peak) < 0]
    if not 0 < len(below) < len(peaks):
        return ()
    above = [point for point in peaks if point not in below]
    sign, few = ("negative", below) if len(below) <= len(above) else ("positive", above)
    return (
        f"the force is {sign} at "
        f"{' '.join(few[:8])}{f' and {len(few) - 8} more' if len(few) > 8 else ''}, and of the "
        "other sign elsewhere: unless that is the direction of the blow, the shapes are turned "
        "there",
    )


def _force_end(
    columns: Sequence[FrfSet], rate: float, keep_to: float | None
) -> tuple[str, ...]:
    """A line where the force of blows sampled at `rate`, Hz, ends before the lines that could be or
    are asked for.
    """
    last = columns[0].freqs[-1]
    heard = min(
        (c.impacts.highest_clear_line() for c in columns if c.impacts), default=np.inf
    )
    if keep_to and min(last, keep_to) > heard * 1.05:  # times the end of the force
        return (
            f"the force ends at about {heard:.3g} Hz: beyond it is noise, and so may be the "
            "modes that are asked for",
        )
    # 0.45: of the rate: an anti-aliasing filter ends there too
    if last > 0.45 * rate or (keep_to and last > keep_to):
        return ()
    return (
        f"the force ends at {last:.4g} Hz: beyond it is noise, and the lines are left out "
        "(--fmax for more)",
    )


def _shaken(
    records: Sequence[TimeHistory], resolution: float | None, estimator: Estimator
) -> Sequence[FrfSet]:
    """FRFs without leakage, on lines of all records, or, where the noise on the force counts, by
    Welch's spectra.

    A force that repeats itself has the lines of its period.
    """
    if (
        resolution is None
        and estimator == "H1"
        and (one := period(records[0]))
        and period(records[-1]) == one
    ):
        return periodic_frfs(records, one)
    if resolution is None:
        resolution = max(spacing(r) for r in records)
    if estimator == "H1":
        return local_frfs(records, resolution)
    return [
        shaker_frfs(r, Welch(resolution), estimator=estimator).frfs for r in records
    ]
