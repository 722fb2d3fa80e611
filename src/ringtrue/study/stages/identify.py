"""Modes from raw signals: each ambient record, their merger, and the test with hammer or
shakers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.choice import Choice
from ringtrue.core.modes import Uncertainty
from ringtrue.core.progress import Progress, part
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.identification.common.merging import Contribution, merge_modes
from ringtrue.identification.frf.cmif import cmif
from ringtrue.identification.frf.local_fits import with_local_fits
from ringtrue.identification.frf.pipeline import HammerModes, HammerResult, identify_hammer
from ringtrue.io.choices import read_choice
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.planning.geometry import relative_neighbours
from ringtrue.planning.resolution import ambient_std
from ringtrue.signal.frf_sets import exchange_by_reciprocity, join_by_setup, join_frfs
from ringtrue.signal.impacts import HammerSettings
from ringtrue.study.config_sections import IdentifySection, TestSection
from ringtrue.study.hammer_records import (
    ForceRecordFormat,
    accepted_hits,
    forced_frfs,
    full_scale,
    read_file,
    rejected_hits,
)
from ringtrue.study.log import Logged, read_log
from ringtrue.study.results import IdentifiedRecord, IdentifyStage, RecordSummary
from ringtrue.study.session import Session
from ringtrue.study.stages.ambient import ambient, check_sheet, summary
from ringtrue.study.supplied import (
    NO_MODES,
    NOT_KNOWN,
    frfs_by_sheet,
    supplied_frequencies,
    supplied_frfs,
    supplied_modes,
)

HAMMER = "hammer"  # what a choice by hand calls the hammer test


def section(session: Session) -> TestSection:
    """The [test] section."""
    test = session.config.test
    if test is None or not (test.log or test.frfs or test.modes):
        raise ConfigError("this stage needs a [test] with a sheet, and a log, frfs or modes")
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
            raise ConfigError(f"{choice.source}: no record {record!r}{did_you_mean(record, known)}")
    return choice


def _reason(parts: Sequence[Contribution], found: Sequence[IdentifiedRecord]) -> str:
    """Why a merged mode is believed, and where it was chosen by hand."""
    reasons = {r.record: r.reasons for r in found}
    mine = [(c.record, reasons[c.record][c.mode].split(";")[0]) for c in parts]
    return "; ".join(
        [*(c.why for c in parts), *(f"{r}: {why}" for r, why in mine if "by hand" in why)]
    )


def struck(
    records: Sequence[Logged],
    sheet: SensorSheet,
    lost: Sequence[str],
    fmax: float | None,
    progress: Progress,
) -> tuple[FrfSet, list[RecordSummary], tuple[str, ...], tuple[FrfSet, ...]]:
    """FRFs of all setups, what is shown of the records, the hits that do not count, and the FRFs of
    each setup.
    """
    read = [_blows(r, sheet, lost) for r in records]
    ranges: dict[str, float] = {}
    for r in records:
        ranges |= full_scale(r.path)
    histories = [h for blows, _ in read for h in blows]
    want = replace(_block(records[0], histories[0].rate), keep_to=fmax)
    found = forced_frfs(histories, want, full_scale=ranges, progress=progress)
    shown = []
    for record, (blows, notes) in zip(records, read, strict=True):
        names = {b.source for b in blows}
        mine = [h for h in found.hits if h.source in names]
        kept = [accepted_hits(mine)] if found.hits else []
        first = record.setup == records[0].setup  # the others look alike
        shown.append(summary(record, _in_a_row(blows), [*notes, *kept, *found.notes], draw=first))
    columns = [frfs_by_sheet(c, sheet.model)[0] for c in found.columns]
    return join_frfs(columns), shown, rejected_hits(found.hits), join_by_setup(columns)


def _blows(
    record: Logged, sheet: SensorSheet, lost: Sequence[str]
) -> tuple[tuple[TimeHistory, ...], tuple[str, ...]]:
    """The acquisitions of a hammer record, and what is to be said of them."""
    how = ForceRecordFormat(
        force=(record.force_channel,) if record.force_channel else (),
        struck=(record.reference,) if record.reference else (),
        leave_out=tuple(lost),
        rate=record.rate_hz,
        channels=(tuple(record.channels),) if record.channels else (),
        sheet=sheet,
    )
    runs, notes = read_file(record.path, how)
    for run in runs:
        check_sheet(record.path, run.channels, sheet.model)
    names = (
        [record.name] if len(runs) == 1 else [f"{record.name} #{k + 1}" for k in range(len(runs))]
    )
    return tuple(replace(r, source=name) for r, name in zip(runs, names, strict=True)), notes


def _block(record: Logged, rate: float) -> HammerSettings:
    """The block of a blow that the log tells; without, as long as the blows are apart or the
    acquisition lasts.
    """
    if record.block_samples is None or record.pretrigger_samples is None:
        return HammerSettings()
    block, pre = record.block_samples / rate, record.pretrigger_samples / rate
    return HammerSettings(
        block=block - pre, pretrigger=pre
    )  # the peak comes a little after the trigger


def _in_a_row(blows: Sequence[TimeHistory]) -> TimeHistory:
    """Acquisitions of the same channels, one after the other, to be looked at."""
    first = blows[0]
    return first if len(blows) == 1 else replace(first, data=np.hstack([b.data for b in blows]))


def _lines(test: TestModel) -> Int:
    """Lines to draw where the crew gave none."""
    return test.points[relative_neighbours(test.xyz, test.groups)]


def _floored(found: IdentifiedRecord, duration: float) -> Uncertainty:
    """Standard deviations not below what `duration` s of any record can tell: a record that claims
    more would rule.
    """
    u, modes = found.uncertainty, found.modes
    frequency, damping = ambient_std(modes.frequencies, np.maximum(modes.damping, 1e-4), duration)
    return replace(
        u,
        frequency=np.maximum(u.frequency, frequency * modes.frequencies),
        damping=np.maximum(u.damping, damping * modes.damping),
    )


def run(session: Session, progress: Progress) -> IdentifyStage:
    """Identify everything that the log lists, or take the FRFs or modes that were given."""
    test = section(session)
    if test.sheet is None:
        return supplied_frequencies(session.base / str(test.modes), session.initial, session.config)
    sheet = read_sensor_sheet(
        session.base / test.sheet, session.base / test.lines if test.lines else None
    )
    model = (
        sheet.model if sheet.model.lines.size else replace(sheet.model, lines=_lines(sheet.model))
    )
    lost, _ = model.named(test.leave_out)
    if unknown := [c for c in lost if c not in set(model.channels)]:
        raise ConfigError(
            f"[test] leave_out {unknown[0]!r}{did_you_mean(unknown[0], model.channels)}"
        )
    found = _identified(session, replace(sheet, model=model), (*lost, *sheet.strain), progress)
    strain = tuple(f"channel {c}: measures strain, not used" for c in sheet.strain)
    return replace(found, frf_notes=(*strain, *found.frf_notes))


def _identified(
    session: Session, sheet: SensorSheet, lost: Sequence[str], progress: Progress
) -> IdentifyStage:
    """Of all channels of the sheet but those in `lost`."""
    test, model = section(session), sheet.model
    if test.modes:
        return supplied_modes(session.base / test.modes, model, lost)
    records, sensors = read_log(session.base / test.log) if test.log else ([], {})
    quiet = [r for r in records if r.kind == "ambient"]
    hits = [r for r in records if r.kind != "ambient"]
    if hits and test.frfs:
        raise ConfigError(f"[test] frfs and the hammer records of {test.log}: give one of the two")
    choice = _by_hand(session, records)
    found, shown = ambient(
        quiet,
        sensors,
        sheet=sheet,
        settings=session.config.identify,
        lost=lost,
        choice=choice,
        progress=part(progress, 0.0, 0.5),
    )
    parts = [
        (r.modes, _floored(r, s.duration), r.record)
        for r, s in zip(found, shown, strict=True)
        if len(r.modes)
    ]
    merged = merge_modes(parts) if parts else None
    frfs, renamed = supplied_frfs([session.base / f for f in test.frfs], model, lost)
    rejected = tuple[str, ...]()
    batches: tuple[FrfSet, ...] = ()
    fmax = session.config.identify.hammer_fmax
    if hits:
        frfs, more, rejected, batches = struck(hits, sheet, lost, fmax, part(progress, 0.5, 0.7))
        frfs = exchange_by_reciprocity(frfs)[0]
        shown += more
    result = (
        _of_frfs(frfs, session.config.identify, choice, part(progress, 0.7, 1.0)) if frfs else None
    )
    if frfs and result is not None and choice.of(HAMMER) is None:
        batches = batches if len(batches) > 1 else (frfs,)
        result = with_local_fits(result, batches, _band(session.config.identify))
    if hits and result is not None:
        at = len(shown) - len(hits)
        shown[at] = replace(shown[at], notes=(*shown[at].notes, *result.notes))
    return IdentifyStage(
        test=model,
        records=tuple(shown),
        ambient_records=tuple(found),
        ambient=merged.modes if merged else NO_MODES,
        ambient_uncertainty=merged.uncertainty if merged else NOT_KNOWN,
        ambient_reasons=tuple(_reason(p, found) for p in merged.provenance) if merged else (),
        frfs=frfs,
        cmif=cmif(frfs.data) if frfs else np.zeros((0, 0)),
        rejected_hits=rejected,
        hammer=result.modes if result else None,
        hammer_uncertainty=result.uncertainty if result else None,
        hammer_reasons=result.reasons if result else (),
        hammer_diagrams=result.diagrams if result else (),
        synthesis_error=result.synthesis_error if result else np.zeros((0, 0)),
        frf_notes=(*renamed, *result.notes) if result and test.frfs else (),
        merge_notes=merged.notes if merged else (),
        source=f"{hits[0].kind} test" if hits else "FRFs",
    )


def _of_frfs(
    frfs: FrfSet, settings: IdentifySection, choice: Choice, progress: Progress
) -> HammerResult:
    return identify_hammer(frfs, _band(settings), choice=choice.of(HAMMER), progress=progress)


def _band(settings: IdentifySection) -> HammerModes:
    return HammerModes(fmin=settings.hammer_fmin, fmax=settings.hammer_fmax)
