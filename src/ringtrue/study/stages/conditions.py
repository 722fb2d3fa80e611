"""What differs between the records of a test: days, temperatures, levels of vibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.iterate import Progress
from ringtrue.core.notes import Note
from ringtrue.correlation.conditions import (
    ConditionSlopes,
    RepeatedModes,
    TemperatureDrift,
    condition_slopes,
    day_scatter,
    temperature_drift,
)
from ringtrue.study.results import (
    CompareStage,
    ConditionsStage,
    IdentifiedRecord,
    IdentifyStage,
)
from ringtrue.study.session import Session


def run(session: Session, progress: Progress) -> ConditionsStage | None:
    """Compare the ambient records with each other, and with the other test; None where there are
    not two records.
    """
    found: IdentifyStage = session.get("identify")
    records = found.ambient_records
    if len(records) < 2 or not len(found.ambient):
        return None
    seen = repeated_modes(records, len(found.ambient))
    slopes = condition_slopes(seen)
    drift = temperature_drift(slopes)
    kinds = [x.excitation for x in found.records[: len(records)]]
    scatter, modes = day_scatter(seen, [r.date for r in records], kinds)
    notes = [
        *_drift(drift, found, session.get("compare")),
        *_amplitude(slopes, found),
        *_days(scatter, modes, sorted({r.date for r in records if r.date})),
    ]
    return ConditionsStage(slopes, drift, scatter, tuple(notes))


def repeated_modes(records: Sequence[IdentifiedRecord], count: int) -> RepeatedModes:
    """The merged ambient modes, `count` of them, as each record shows them."""
    frequency, std, level = np.full((3, len(records), count), np.nan)
    for k, r in enumerate(records):
        known = r.merged >= 0
        at = r.merged[known]
        frequency[k, at] = r.modes.frequencies[known]
        std[k, at] = r.uncertainty.frequency[known]
        level[k, at] = r.level[known]
    channels = [tuple(sorted(r.modes.channels)) for r in records]
    return RepeatedModes(
        frequency=frequency,
        std=std,
        level=level,
        temperature=np.array([r.temperature for r in records]),
        place=np.array([channels.index(c) for c in channels]),
    )


def _drift(
    drift: TemperatureDrift | None, found: IdentifyStage, compare: CompareStage | None
) -> list[Note]:
    """Of a drift with the temperature that is proven, and what it explains between the tests."""
    if drift is None or not drift.proven:
        return []
    warm = [r.temperature for r in found.ambient_records]
    what = "parts stiffen or tighten as they warm"
    if drift.per_kelvin < 0:
        what = "concrete, grout and pads soften as they warm"
    values: dict[str, float | int | str] = {
        "percent": 100 * drift.per_kelvin,
        "std": 100 * drift.std,
        "modes": drift.modes,
        "cold": float(np.nanmin(warm)),
        "warm": float(np.nanmax(warm)),
        "what": what,
    }
    notes = [Note("temperature drift", "information", "ambient records", values)]
    other = found.hammer
    if not isinstance(other, IdentifiedRecord) or not np.isfinite(other.temperature):
        return notes
    if compare is None or not len(compare.table):
        return notes
    kelvin = float(other.temperature - np.nanmean(warm))
    between: dict[str, float | int | str] = {
        "percent": 100 * float(np.median(compare.table.fe_hz / compare.table.test_hz - 1)),
        "modes": len(compare.table),
        "temperature": kelvin,
        "drift": 100 * drift.per_kelvin * kelvin,
    }
    return [*notes, Note("tests differ", "information", found.source, between)]


def _amplitude(slopes: ConditionSlopes, found: IdentifyStage) -> list[Note]:
    """Of modes whose frequency depends on the level."""
    bent = np.flatnonzero(slopes.bent)
    if not bent.size:
        return []
    change = slopes.per_decade * slopes.decades
    most = bent[np.argmax(np.abs(change[bent]))]
    names = ", ".join(str(k + 1) for k in bent.tolist())
    values: dict[str, float | int | str] = {
        "frequency": float(found.ambient.modes.frequencies[most]),
        "percent": 100 * float(change[most]),
        "std": 100 * float(slopes.per_decade_std[most] * slopes.decades[most]),
        "decades": float(slopes.decades[most]),
    }
    plural = "s" if bent.size > 1 else ""
    return [Note("amplitude dependent", "warning", f"ambient mode{plural} {names}", values)]


def _days(scatter: float, modes: int, dates: Sequence[str]) -> list[Note]:
    """Of a test that was repeated on another day."""
    if not modes:
        return []
    values: dict[str, float | int | str] = {
        "percent": 100 * scatter,
        "modes": modes,
        "first": dates[0],
        "last": dates[-1],
    }
    return [Note("days differ", "information", "repeated test", values)]
