"""Modes from raw signals: each ambient record, their merger, and the test with hammer or
shakers.

Modes of ambient records, each of one file or of several that go on with each other, and what is
shown of records.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.choice import Choice, Hit
from ringtrue.core.iterate import Progress, part
from ringtrue.core.modes import Uncertainty
from ringtrue.core.notes import Note
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, about, did_you_mean
from ringtrue.identification.ambient.pipeline import (
    AmbientResult,
    AmbientSettings,
)
from ringtrue.identification.ambient.record_bands import too_short
from ringtrue.identification.ambient.setups import identified_setup
from ringtrue.identification.ambient.shape_reading import (
    RecordCorrelations,
    mode_levels,
    with_joined_shapes,
)
from ringtrue.identification.common.diagram import SpectrumAccount
from ringtrue.identification.common.merging import (
    Contribution,
    join_candidates,
    merge_modes,
)
from ringtrue.identification.frf.local_fits import with_local_fits
from ringtrue.identification.frf.pipeline import HammerModes, identify_hammer
from ringtrue.io.choices import read_choice
from ringtrue.io.records import read_record, refuse_bad_samples
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.planning.exciters import ambient_std
from ringtrue.planning.geometry import relative_neighbours
from ringtrue.signal.channel_checks import Gaps, bridge_gaps
from ringtrue.signal.frf_sets import (
    exchange_by_reciprocity,
    join_frfs,
    with_equal_gains,
)
from ringtrue.signal.impacts import HammerSettings, ImpactReport
from ringtrue.signal.spectra import (
    Geophone,
    Welch,
    deconvolve,
    detrend,
    lowest_frequency,
    psd,
)
from ringtrue.study.config_sections import IdentifySection, TestSection
from ringtrue.study.hammer_records import (
    ForceRecordFormat,
    forced_frfs,
    full_scale,
    read_file,
    renamed,
)
from ringtrue.study.log import Logged, SensorType, read_log
from ringtrue.study.results import (
    IdentifiedModes,
    IdentifiedRecord,
    IdentifyStage,
    RecordPreview,
    RecordSummary,
)
from ringtrue.study.session import Session
from ringtrue.study.supplied import (
    NO_MODES,
    NOT_KNOWN,
    check_channels,
    frfs_by_sheet,
    supplied_frequencies,
    supplied_frfs,
    supplied_modes,
)

SHOWN = 4  # channels of a preview


def check_sheet(path: Path, channels: Sequence[Channel], sheet: TestModel) -> None:
    """Every response in a record must have its place on the sheet; a force channel names its point
    itself.
    """
    check_channels([c.id for c in channels if c.quantity != "force"], sheet, path)


def corrected(
    history: TimeHistory, sensors: Mapping[str, SensorType], low: float | None = None
) -> tuple[TimeHistory, float, str]:
    """The history with the corners of its geophones taken out where the signals allow, from which
    frequency, and why.

    Channels of other sensors stay as they are. With `low`, Hz, they are taken out from there on.
    """
    known = {name for name, sheet in sensors.items() if sheet.corrected}
    types = sorted({c.sensor for c in history.channels} & known)
    if not types:
        return history, 0.0, ""
    parts = {
        t: history.pick([c.id for c in history.channels if c.sensor == t])
        for t in types
    }
    low = low or max(_lowest(parts[t], sensors[t]) for t in types)
    fixed: dict[str, tuple[Channel, Float]] = {}
    for t, chosen in parts.items():
        geophone = Geophone(sensors[t].corner_hz, sensors[t].damping or 0.0)
        whole = deconvolve(chosen, geophone, low=low)
        for c, w, d in zip(chosen.channels, whole.channels, whole.data, strict=True):
            fixed[c.id] = w, d
    every = [
        fixed.get(c.id, (c, d))
        for c, d in zip(history.channels, history.data, strict=True)
    ]
    made = replace(
        history,
        channels=tuple(c for c, _ in every),
        data=np.stack([d for _, d in every]),
    )
    corners = " and ".join(f"{sensors[t].corner_hz:g}" for t in types)
    return made, low, f"{corners} Hz corner corrected from {low:.2f} Hz on"


def _lowest(history: TimeHistory, sheet: SensorType) -> float:
    """From where on the signals of geophones stand above their noise, Hz."""
    freqs, density = psd(history, Welch(0.1))
    noise = np.full(freqs.shape, sheet.noise**2)
    return max(
        lowest_frequency(freqs, np.median(density, axis=0), noise),
        sheet.corner_hz * 0.6,
    )


def summary(
    record: Logged,
    history: TimeHistory,
    notes: Sequence[str],
    channel_notes: tuple[Note, ...] = (),
    *,
    draw: bool,
) -> RecordSummary:
    """What the report shows of a record; with a preview if `draw`."""
    return RecordSummary(
        name=record.name,
        test=record.test,
        excitation=record.excitation,
        file=record.path.name,
        channels=len(history.channels),
        rate=history.rate,
        duration=history.duration,
        notes=tuple(notes),
        channel_notes=channel_notes,
        setup=str(record.setup),
        preview=preview(history) if draw else None,
    )


def preview(history: TimeHistory) -> RecordPreview:
    """Channels of one unit without their linear trend, thinned so that no peak is lost."""
    unit = history.channels[0].unit
    at = [i for i, c in enumerate(history.channels) if c.unit == unit][:SHOWN]
    channels = tuple(history.channels[i] for i in at)
    data = detrend(history.data[at])
    resolution = Welch(max(0.05, 4 / history.duration))
    freqs, density = psd(TimeHistory(data, history.rate, channels), resolution)
    every = max(1, freqs.size // 2000)
    step = max(1, data.shape[1] // 1500)  # samples of a preview
    # the value of largest modulus in each run of samples
    runs = data[:, : data.shape[1] // step * step].reshape(len(data), -1, step)
    largest = np.abs(runs).argmax(axis=2)
    signal = np.take_along_axis(runs, largest[:, :, None], axis=2)[:, :, 0]
    return RecordPreview(
        channels=tuple(c.id for c in channels),
        unit=unit,
        time=np.arange(signal.shape[1]) * step / history.rate,
        signal=np.asarray(signal),
        freqs=freqs[::every],
        psd=density[:, ::every],
    )


@dataclass(frozen=True, slots=True)
class Campaign:
    """What holds for all records of a test.

    Attributes
    ----------
    sheet : SensorSheet
    sensors : mapping of str to SensorType
    unused : tuple of str
        Channels.
    choice : Choice
        Of modes by hand.
    """

    sheet: SensorSheet
    sensors: Mapping[str, SensorType]
    unused: tuple[str, ...]
    choice: Choice


@dataclass(frozen=True, slots=True, eq=False)
class RecordFile:
    """A file of an ambient record: its record, bridged, with the corners of its sensors taken out
    from `low` Hz on.
    """

    history: TimeHistory
    gaps: Gaps
    low: float
    notes: tuple[str, ...]

    @classmethod
    def read(cls, record: Logged, campaign: Campaign, low: float | None) -> RecordFile:
        """All channels must be on the sheet, but for the unused ones; samples may be missing."""
        sheet = campaign.sheet
        history = read_record(record.path, record.rate_hz, check=False, gaps=True)
        history, notes = sheet.scaled(renamed(history, record.channels, record.path))
        used = [c.id for c in history.channels if c.id not in set(campaign.unused)]
        history = history.pick(used)
        refuse_bad_samples(history, record.path, gaps=True)
        check_sheet(record.path, history.channels, sheet.model)
        raw, gaps = bridge_gaps(history)
        fixed, low, note = corrected(raw, campaign.sensors, low)
        return cls(fixed, gaps, low, tuple(n for n in (*notes, note) if n))

    def goes_on_in(self, later: RecordFile) -> bool:
        """Whether another has the same channels and rate, and is long enough for a part of the
        record.
        """
        a = self.history
        b = later.history
        same = (a.channels, a.rate) == (b.channels, b.rate)
        return same and not too_short(b.duration, a.duration)


def _files_of_one(
    todo: list[Logged], campaign: Campaign, shown: list[RecordSummary]
) -> Iterator[RecordFile]:
    """The first of the records `todo` and those that go on with it, each taken out when it is read;
    what to show of it is added to `shown`.

    A record with a choice by hand of its own is not joined.
    """
    record = todo.pop(0)
    first = file = RecordFile.read(record, campaign, None)
    while True:
        shown.append(
            summary(
                record, file.history, file.notes, file.gaps.channels, draw=file is first
            )
        )
        yield file
        chosen = campaign.choice.records
        if not (todo and record.goes_on_in(todo[0]) and todo[0].name not in chosen):
            return
        file = RecordFile.read(todo[0], campaign, first.low)
        if not first.goes_on_in(file):
            return
        record = todo.pop(0)


def _as_one(files: Sequence[RecordSummary], result: AmbientResult) -> RecordSummary:
    """What is shown of a record of some files, with the notes of its identification."""
    first, *more = files
    joined = []
    if more:
        joined = [
            f"{len(files)} files, {first.file} to {files[-1].file}, are one record with pauses "
            "(a `setup` for each in the log separates them)"
        ]
    others = [f"{x.file}: {n}" for x in more for n in x.notes if n not in first.notes]
    duration = sum(x.duration for x in files)
    of_files = (note for x in files for note in x.channel_notes)
    return replace(
        first,
        duration=duration,
        notes=(*joined, *first.notes, *others, *result.record_notes),
        channel_notes=(*of_files, *result.channel_notes),
    )


def ambient(
    records: Sequence[Logged],
    campaign: Campaign,
    settings: IdentifySection,
    progress: Progress,
) -> tuple[list[IdentifiedRecord], list[RecordSummary], list[RecordCorrelations]]:
    """Modes of each ambient record, what is shown of it, and what shapes are read from; files that
    go on with each other are one record.
    """
    found: list[IdentifiedRecord] = []
    shown: list[RecordSummary] = []
    correlations: list[RecordCorrelations] = []
    todo = list(records)
    while todo:
        record = todo[0]
        mine: list[RecordSummary] = []
        progress(1 - len(todo) / len(records), f"ambient modes: {record.name}")
        files = _files_of_one(todo, campaign, mine)
        first = next(files)
        parts = (x.gaps.marked(x.history) for x in chain((first,), files))
        low = max(first.low, settings.ambient_fmin or 0.0)
        band = AmbientSettings(fmin=low or None, fmax=settings.ambient_fmax)
        with about(record.path):
            setup = identified_setup(
                parts, band, record.name, campaign.choice.of(record.name)
            )
        result = setup.result
        found.append(
            IdentifiedRecord(
                modes=result.modes,
                uncertainty=result.uncertainty,
                reasons=result.reasons,
                diagrams=result.diagrams,
                remarks=result.remarks,
                others=result.others,
                account=result.account,
                record=record.name,
                date=record.date,
                temperature=record.temperature,
                level=mode_levels(
                    first.history, result.modes.frequencies, result.modes.damping
                ),
            )
        )
        correlations.append(setup.correlations)
        shown.append(_as_one(mine, result))
    return found, shown, correlations


HAMMER = "hammer"  # what a choice by hand calls the hammer test


def section(session: Session) -> TestSection:
    """The [test] section."""
    test = session.config.test
    if test is None or not (test.log or test.frfs or test.modes):
        raise ConfigError(
            "this stage needs a [test] with a sheet, and a log, frfs or modes"
        )
    return test


def files(session: Session) -> list[Path]:
    """All inputs of the stage."""
    test = section(session)
    records, _ = read_log(session.base / test.log) if test.log else ([], {})
    names = (
        test.sheet,
        test.log,
        test.lines,
        test.modes,
        session.config.identify.choice,
        *test.frfs,
    )
    lending = session.initial.model.files if session.config.frequency_only else ()
    return [
        *(session.base / f for f in names if f),
        *(r.path for r in records),
        *map(Path, lending),
    ]


def _by_hand(session: Session, records: Sequence[Logged]) -> Choice:
    """The choice of the study; one that changes nothing if there is none."""
    if (name := session.config.identify.choice) is None:
        return Choice()
    choice = read_choice(session.base / name)
    known = [HAMMER, *(r.name for r in records if r.kind == "ambient")]
    for record in choice.records:
        if record not in known:
            raise ConfigError(
                f"{choice.source}: no record {record!r}{did_you_mean(record, known)}"
            )
    hammered = [r.name for r in records if r.kind != "ambient"]
    for hit in choice.hits:
        if hit.record.partition(" #")[0] not in hammered:
            raise ConfigError(
                f"{choice.source}: hit of {hit.record!r}: no such record with a hammer"
                f"{did_you_mean(hit.record, hammered)}"
            )
    return choice


def _reason(parts: Sequence[Contribution], found: Sequence[IdentifiedRecord]) -> str:
    """The evidence for a merged mode, and where it was chosen by hand."""
    reasons = {r.record: r.reasons for r in found}
    mine = [(c.record, reasons[c.record][c.mode].split(";")[0]) for c in parts]
    return "; ".join(
        [
            *(c.why for c in parts),
            *(f"{r}: {why}" for r, why in mine if "by hand" in why),
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class FrfsOfRecords:
    """FRFs of the records with forces.

    Attributes
    ----------
    frfs : FrfSet
        Of all setups.
    setups : tuple of FrfSet
    records : tuple of RecordSummary
    hits : tuple of ImpactReport
    channel_notes : tuple of Note
        On channels that read otherwise in one setup.
    """

    frfs: FrfSet
    setups: tuple[FrfSet, ...]
    records: tuple[RecordSummary, ...] = ()
    hits: tuple[ImpactReport, ...] = ()
    channel_notes: tuple[Note, ...] = ()


def frfs_of_records(
    records: Sequence[Logged],
    sheet: SensorSheet,
    unused: Sequence[str],
    fmax: float | None,
    progress: Progress,
    by_hand: tuple[Hit, ...] = (),
) -> FrfsOfRecords:
    """The FRFs of all records of a hammer or shaker test; `by_hand` are hits of a choice."""
    read = [acquisitions(r, sheet, unused) for r in records]
    ranges: dict[str, float] = {}
    for r in records:
        ranges |= full_scale(r.path)
    runs = [run for mine, _ in read for run in mine]
    wanted = replace(
        block_settings(records[0], runs[0].rate), keep_to=fmax, hits=by_hand
    )
    found = forced_frfs(runs, wanted, full_scale=ranges, progress=progress)
    shown = []
    for record, (mine, notes) in zip(records, read, strict=True):
        names = {run.source for run in mine}
        hits = [h for h in found.hits if h.source in names]
        whole = mine[0]
        if len(mine) > 1:  # one after the other, to be looked at
            whole = replace(whole, data=np.hstack([run.data for run in mine]))
        first = record.setup == records[0].setup  # other setups look the same
        shown.append(
            replace(
                summary(record, whole, [*notes, *found.notes], draw=first),
                hits=(sum(h.accepted for h in hits), len(hits)),
            )
        )
    columns = [frfs_by_sheet(c, sheet.model)[0] for c in found.columns]
    columns, setups, gains = with_equal_gains(columns)
    frfs, _ = exchange_by_reciprocity(join_frfs(columns))
    label = {
        tuple(c.id for c in s.outputs): str(record.setup) or record.name
        for s in setups
        for record, (runs, _) in zip(reversed(records), reversed(read), strict=True)
        if {c.id for c in s.outputs} <= {c.id for c in runs[0].channels}
    }
    gained = [
        g.note(label[tuple(c.id for c in setups[g.setup].outputs)]) for g in gains
    ]
    return FrfsOfRecords(frfs, setups, tuple(shown), found.hits, tuple(gained))


def acquisitions(
    record: Logged, sheet: SensorSheet, unused: Sequence[str]
) -> tuple[tuple[TimeHistory, ...], tuple[str, ...]]:
    """The acquisitions of a hammer record, and notes."""
    how = ForceRecordFormat(
        force=(record.force_channel,) if record.force_channel else (),
        struck=(record.reference,) if record.reference else (),
        leave_out=tuple(unused),
        rate=record.rate_hz,
        channels=(tuple(record.channels),) if record.channels else (),
        sheet=sheet,
    )
    found = read_file(record.path, how)
    runs = []
    for k, run in enumerate(found.records, start=1):
        check_sheet(record.path, run.channels, sheet.model)
        name = record.name if len(found.records) == 1 else f"{record.name} #{k}"
        runs.append(replace(run, source=name))
    return tuple(runs), found.notes


def block_settings(record: Logged, rate: float) -> HammerSettings:
    """The block of an impact that the log states; else as long as the time between impacts or the
    acquisition lasts.
    """
    if record.block_samples is None or record.pretrigger_samples is None:
        return HammerSettings()
    block = record.block_samples / rate
    pre = record.pretrigger_samples / rate
    # the peak comes a little after the trigger
    return HammerSettings(block=block - pre, pretrigger=pre)


def _floored(found: IdentifiedRecord, duration: float) -> Uncertainty:
    """Standard deviations not below what `duration` s of any record can give: a record with smaller
    ones would outweigh the others.
    """
    u = found.uncertainty
    modes = found.modes
    frequency, damping = ambient_std(
        modes.frequencies, np.maximum(modes.damping, 1e-4), duration
    )
    return replace(
        u,
        frequency=np.maximum(u.frequency, frequency * modes.frequencies),
        damping=np.maximum(u.damping, damping * modes.damping),
    )


def run(session: Session, progress: Progress) -> IdentifyStage:
    """Identify everything that the log lists, or take the FRFs or modes that were given."""
    test = section(session)
    if test.sheet is None:
        return supplied_frequencies(
            session.base / str(test.modes), session.initial, session.config
        )
    lines = session.base / test.lines if test.lines else None
    sheet = read_sensor_sheet(session.base / test.sheet, lines)
    model = sheet.model
    if not model.lines.size:  # the crew gave none to draw
        model = replace(
            model, lines=model.points[relative_neighbours(model.xyz, model.groups)]
        )
    unused, _ = model.named(test.leave_out)
    if unknown := [c for c in unused if c not in set(model.channels)]:
        raise ConfigError(
            f"[test] leave_out {unknown[0]!r}{did_you_mean(unknown[0], model.channels)}"
        )
    found = _identified(
        session, replace(sheet, model=model), (*unused, *sheet.strain), progress
    )
    strain = tuple(Note("channel strain", "warning", c) for c in sheet.strain)
    return replace(found, channel_notes=(*strain, *found.channel_notes))


def _identified(
    session: Session, sheet: SensorSheet, unused: Sequence[str], progress: Progress
) -> IdentifyStage:
    """Of all channels of the sheet but the unused ones."""
    test = section(session)
    settings = session.config.identify
    if test.modes:
        return supplied_modes(session.base / test.modes, sheet.model, unused)
    records, sensors = read_log(session.base / test.log) if test.log else ([], {})
    unforced = [r for r in records if r.kind == "ambient"]
    forced = [r for r in records if r.kind != "ambient"]
    if forced and test.frfs:
        raise ConfigError(
            f"[test] frfs and the hammer records of {test.log}: give one of the two"
        )
    choice = _by_hand(session, records)
    campaign = Campaign(sheet, sensors, tuple(unused), choice)
    found, shown, read = ambient(unforced, campaign, settings, part(progress, 0.0, 0.5))
    nothing = IdentifyStage(sheet.model, IdentifiedModes(NO_MODES, NOT_KNOWN), None)
    stage = _with_ambient(nothing, found, shown, read)
    given, notes = supplied_frfs(
        [session.base / f for f in test.frfs], sheet.model, unused
    )
    if forced:
        early = part(progress, 0.5, 0.7)
        made = frfs_of_records(
            forced, sheet, unused, settings.hammer_fmax, early, choice.hits
        )
    elif given is not None:
        made = FrfsOfRecords(given, ())
    else:
        return replace(stage, source="FRFs")
    frfs = made.frfs
    band = HammerModes(fmin=settings.hammer_fmin, fmax=settings.hammer_fmax)
    by_hand = choice.of(HAMMER)
    result = identify_hammer(
        frfs, band, choice=by_hand, progress=part(progress, 0.7, 1.0)
    )
    if by_hand is None:
        setups = made.setups if len(made.setups) > 1 else (frfs,)
        result = with_local_fits(result, setups, band)
    records_of_frfs = list(made.records)
    if forced:
        first = records_of_frfs[0]
        notes_of_both = (*first.notes, *result.notes)
        records_of_frfs[0] = replace(
            first, notes=notes_of_both, channel_notes=result.channel_notes
        )
    return replace(
        stage,
        hammer=IdentifiedRecord(
            modes=result.modes,
            uncertainty=result.uncertainty,
            reasons=result.reasons,
            diagrams=result.diagrams,
            others=result.others,
            record=HAMMER,
            date=forced[0].date if forced else "",
            temperature=forced[0].temperature if forced else float("nan"),
        ),
        source=f"{forced[0].kind} test" if forced else "FRFs",
        records=(*stage.records, *records_of_frfs),
        frfs=frfs,
        frf_notes=(*notes, *result.notes) if test.frfs else (),
        channel_notes=result.channel_notes if test.frfs else made.channel_notes,
        synthesis_error=result.synthesis_error,
        hits=made.hits,
    )


def _with_ambient(
    stage: IdentifyStage,
    found: Sequence[IdentifiedRecord],
    shown: Sequence[RecordSummary],
    correlations: Sequence[RecordCorrelations],
) -> IdentifyStage:
    """With the modes of ambient records, merged; the shape of one that two records or more found is
    read from all.
    """
    stage = replace(stage, records=tuple(shown), ambient_records=tuple(found))
    parts = [
        (r.modes, _floored(r, s.duration), r.record)
        for r, s in zip(found, shown, strict=True)
        if len(r)
    ]
    if not found:
        return stage
    only = found[0] if len(found) == 1 else None
    account = only.account if only else SpectrumAccount()
    if not parts:
        others = join_candidates([r.others for r in found], NO_MODES)
        return replace(
            stage, ambient=replace(stage.ambient, others=others, account=account)
        )
    merged = merge_modes(parts)
    readers = [c for c, r in zip(correlations, found, strict=True) if len(r)]
    several = np.flatnonzero([len(given) > 1 for given in merged.provenance])
    merged = with_joined_shapes(merged, parts, readers, several)
    ambient_modes = IdentifiedModes(
        modes=merged.modes,
        uncertainty=merged.uncertainty,
        reasons=tuple(_reason(p, found) for p in merged.provenance),
        remarks=only.remarks if only else (),
        others=join_candidates([r.others for r in found], merged.modes),
        account=account,
    )
    went = [np.full(len(modes), -1, dtype=np.int64) for modes, _, _ in parts]
    for column, given in enumerate(merged.provenance):
        for c in given:
            went[c.position][c.mode] = column
    rows = iter(went)
    records = tuple(replace(r, merged=next(rows)) if len(r) else r for r in found)
    return replace(
        stage, ambient=ambient_modes, ambient_records=records, merge_notes=merged.notes
    )
