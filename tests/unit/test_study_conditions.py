"""Records of several days as a study compares them: what is said, and where it is found again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from test_correlate_conditions import DAYS, KINDS, MODES, RepeatedModes, records

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.notes import Note, sentence
from ringtrue.core.testmodel import TestModel
from ringtrue.study.conclusion import findings_json, repeats
from ringtrue.study.results import (
    ConditionsStage,
    IdentifiedModes,
    IdentifiedRecord,
    IdentifyStage,
    RecordSummary,
)
from ringtrue.study.session import Session
from ringtrue.study.stages import conditions

CHANNELS = ("1+Z", "2+Z")
TEST = TestModel(
    np.array([1, 2]),
    np.eye(2, 3),
    CHANNELS,
    np.array([1, 2]),
    np.eye(3)[[2, 2]],
    np.zeros((0, 2)),
)


def identified(seen: RepeatedModes) -> IdentifyStage:
    """The same modes as a study has them; a mode that a record did not find is not among its own."""
    own = []
    for r, f in enumerate(seen.frequency):
        there = np.flatnonzero(np.isfinite(f))
        std = Uncertainty.independent(
            seen.std[r, there], np.full(there.size, 1e-4), np.zeros((2, there.size))
        )
        record = IdentifiedRecord(
            modes(f[there]),
            std,
            record=f"r{r}",
            date=DAYS[r],
            temperature=float(seen.temperature[r]),
            level=seen.level[r, there],
            merged=there,
        )
        own.append(record)
    shown = [
        RecordSummary(f"r{r}", "a", kind, f"r{r}.h5", 2, 128.0, 600.0, ())
        for r, kind in enumerate(KINDS)
    ]
    merged = IdentifiedModes(
        modes(seen.frequency[0]),
        Uncertainty.independent(
            seen.std[0], np.full(MODES, 1e-4), np.zeros((2, MODES))
        ),
    )
    gain = Note(
        "channel gain", "warning", "1+Z", {"setup": "2", "factor": 0.5, "others": 3}
    )
    return IdentifyStage(
        TEST,
        merged,
        None,
        records=tuple(shown),
        ambient_records=tuple(own),
        channel_notes=(gain,),
    )


def modes(frequency: np.ndarray) -> ModeSet:
    return ModeSet(
        frequency, np.full(frequency.size, 0.01), np.ones((2, frequency.size)), CHANNELS
    )


def compared(seen: RepeatedModes) -> tuple[IdentifyStage, ConditionsStage]:
    found = identified(seen)
    session = SimpleNamespace(get={"identify": found, "compare": None}.get)
    stage = conditions.run(cast(Session, session), lambda fraction, text: None)
    assert stage is not None
    return found, stage


def test_drift_level_and_days_are_findings_with_their_values() -> None:
    found, stage = compared(records(-3e-4, -5e-4, 1))
    by_code: dict[str, dict[str, Any]] = {
        f["what"]: f for f in findings_json({"identify": found, "conditions": stage})
    }
    assert list(by_code) == [
        "channel gain",
        "temperature drift",
        "amplitude dependent",
        "days differ",
    ]
    assert by_code["channel gain"]["subject"] == "1+Z"
    assert by_code["amplitude dependent"]["subject"].startswith(
        "ambient modes 1, 2, 3, 5"
    )
    assert by_code["amplitude dependent"]["values"]["mean"] < -0.02
    assert -0.05 < by_code["temperature drift"]["values"]["percent"] < -0.015
    assert by_code["temperature drift"]["values"]["warm"] == 15.0
    assert all(
        sentence(n) in (f["text"] for f in by_code.values()) for n in stage.notes
    )
    assert repeats(None, stage) == stage.scatter > 0


def test_records_that_agree_are_only_said_to_repeat() -> None:
    _, stage = compared(records(0.0, 0.0, 3))
    assert [n.code for n in stage.notes] == ["days differ"]
