"""What a study finds of its test: channels at fault, days, temperatures and levels that count."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringtrue.core.notes import sentence
from ringtrue.correlation.channel_faults import Suspect
from ringtrue.correlation.table import repeatability
from ringtrue.study.results import (
    CompareStage,
    ConditionsStage,
    CorrelateStage,
    FinalStage,
    IdentifyStage,
)


def repeats(compare: CompareStage | None, conditions: ConditionsStage | None) -> float:
    """How far a test repeats its frequencies, relative: by another kind of test, or on another day.

    The larger of the two; NaN where nothing was repeated.
    """
    again = float("nan") if conditions is None else conditions.scatter
    return float(np.fmax(repeatability(compare.table if compare is not None else None), again))


def findings_json(r: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All of them as plain values: what, of which channel, modes or test, and a sentence.

    Parameters
    ----------
    r : mapping of str to a stage's result
        As far as the study was run.
    """
    identify: IdentifyStage | None = r.get("identify")
    conditions: ConditionsStage | None = r.get("conditions")
    notes = [n for n in (identify.channel_notes if identify is not None else ()) if n.values]
    notes += conditions.notes if conditions is not None else ()
    out = [
        {"what": n.code, "subject": n.subject, "values": dict(n.values), "text": sentence(n)}
        for n in notes
    ]
    for s, where in suspected(r):
        values: dict[str, float | str] = {"factor": s.factor}
        values |= {"partner": s.partner} if s.partner else {}
        out.append(
            {
                "what": f"channel {s.fault}",
                "subject": s.channel,
                "values": values,
                "text": f"channel {s.channel} looks {s.fault}{where}: {s.message}",
            }
        )
    return out


def suspected(r: Mapping[str, Any]) -> list[tuple[Suspect, str]]:
    """Channels that contradict the model or the rigid-body motion of the others, each once, and
    where they do in words.
    """
    correlate: CorrelateStage | None = r.get("correlate")
    last: FinalStage | CorrelateStage | None = r.get("final") or correlate
    found = last.evidence.measures.suspects if last is not None and last.evidence else ()
    rigid = correlate.sensors.rigid if correlate is not None else ()
    named = {s.channel for s in found}
    out = [(s, "") for s in found]
    return out + [(s, " in the rigid-body modes") for s in rigid if s.channel not in named]
