"""What differs between the records of a test: days, temperatures, levels of vibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.iterate import Progress
from ringtrue.core.notes import Note
from ringtrue.correlation.conditions import (
    CommonSlope,
    ConditionSlopes,
    RepeatedModes,
    condition_slopes,
    day_scatter,
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
    kinds = [x.excitation for x in found.records[: len(records)]]
    scatter, modes = day_scatter(seen, [r.date for r in records], kinds)
    notes = [
        *_drift(slopes.drift, found, session.get("compare")),
        *_amplitude(slopes, found),
        *_days(scatter, modes, sorted({r.date for r in records if r.date})),
    ]
    return ConditionsStage(slopes, scatter, tuple(notes))


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
    drift: CommonSlope | None, found: IdentifyStage, compare: CompareStage | None
) -> list[Note]:
    """Of a drift with the temperature that is proven, and what it explains between the tests."""
    if drift is None or not drift.proven:
        return []
    warm = [r.temperature for r in found.ambient_records]
    what = "parts stiffen or tighten as they warm"
    if drift.value < 0:
        what = "concrete, grout and pads soften as they warm"
    values: dict[str, float | int | str] = {
        "percent": 100 * drift.value,
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
        "percent": 100
        * float(np.median(compare.table.fe_hz / compare.table.test_hz - 1)),
        "modes": len(compare.table),
        "temperature": kelvin,
        "drift": 100 * drift.value * kelvin,
    }
    return [*notes, Note("tests differ", "information", found.source, between)]


def _amplitude(slopes: ConditionSlopes, found: IdentifyStage) -> list[Note]:
    """That frequencies depend on the level, and of which modes that is proven by themselves."""
    common = slopes.dependence
    if common is None or not common.proven:
        return []
    change = np.nan_to_num(slopes.per_decade * slopes.decades)
    bent = slopes.bent & (np.sign(change) == np.sign(common.value))
    names = ", ".join(str(k + 1) for k in np.flatnonzero(bent).tolist())
    most = int(np.argmax(np.abs(change) * (bent if bent.any() else 1.0)))
    values: dict[str, float | int | str] = {
        "mean": 100 * common.value,
        "mean_std": 100 * common.std,
        "modes": common.modes,
        "frequency": float(found.ambient.modes.frequencies[most]),
        "percent": 100 * float(change[most]),
        "std": 100 * float(slopes.per_decade_std[most] * slopes.decades[most]),
        "decades": float(slopes.decades[most]),
    }
    subject = f"ambient modes {names}" if names else "ambient modes"
    return [Note("amplitude dependent", "warning", subject, values)]


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
