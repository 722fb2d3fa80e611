"""What a study finds of its test (channels at fault, days, temperatures and levels that count), and
what it has shown, as codes and values: the verdict, what speaks for it, and what is open.

The report makes sentences of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.notes import sentence
from ringtrue.correlation.channel_faults import Suspect
from ringtrue.correlation.table import CorrelationTable, repeatability
from ringtrue.study.acceptance import Acceptance, AcceptanceCheck, in_both
from ringtrue.study.results import (
    CompareStage,
    ConditionsStage,
    CorrelateStage,
    DampingStage,
    FinalStage,
    IdentifyStage,
    PredictStage,
    SensitivityStage,
    TuneStage,
    UncertaintyStage,
    UpdateStage,
)
from ringtrue.updating.prediction import validated_band


def repeats(compare: CompareStage | None, conditions: ConditionsStage | None) -> float:
    """How far a test repeats its frequencies, relative: by another kind of test, or on another day.

    The larger of the two; NaN where nothing was repeated.
    """
    again = float("nan") if conditions is None else conditions.scatter
    return float(
        np.fmax(repeatability(compare.table if compare is not None else None), again)
    )


def findings_json(r: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All of them as plain values: what, of which channel, modes or test, and a sentence.

    Parameters
    ----------
    r : mapping of str to a stage's result
        As far as the study was run.
    """
    identify: IdentifyStage | None = r.get("identify")
    conditions: ConditionsStage | None = r.get("conditions")
    notes = [
        n for n in (identify.channel_notes if identify is not None else ()) if n.values
    ]
    notes += conditions.notes if conditions is not None else ()
    out = [
        {
            "what": n.code,
            "subject": n.subject,
            "values": dict(n.values),
            "text": sentence(n),
        }
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
    found = (
        last.evidence.measures.suspects if last is not None and last.evidence else ()
    )
    rigid = correlate.sensors.rigid if correlate is not None else ()
    named = {s.channel for s in found}
    out = [(s, "") for s in found]
    return out + [
        (s, " in the rigid-body modes") for s in rigid if s.channel not in named
    ]


class Validation(StrEnum):
    """Whether a model is validated."""

    VALIDATED = "validated"
    NOT_VALIDATED = "not validated"
    NOT_JUDGED = "not judged"


@dataclass(frozen=True, slots=True)
class Unseen:
    """How well modes are met that no parameter was fitted to.

    Attributes
    ----------
    kind : {"all", "left out", "in turn"}
        Nothing was fitted; the modes left out of the updating; those used, each predicted by an
        updating without it.
    count : int
    mean, largest : float
        |Δf|, %.
    before : float
        Mean |Δf| of the initial model, %; NaN where it is not known.
    inside : int or None
        How many lie in their bands of prediction; None without bands.
    """

    kind: Literal["all", "left out", "in turn"]
    count: int
    mean: float
    largest: float
    before: float = float("nan")
    inside: int | None = None


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter that was changed, and what speaks for or against it.

    Attributes
    ----------
    name : str
    factor, std : float
    interval : tuple of float or None
        Of the factor.
    kept : float
        Least share of the change with any fold of modes left out; NaN where it is not known.
    doubts : tuple of {"bound", "prior", "silent", "form", "interval"}
        As `updating.identifiability.Flag` has them; the last: the interval ends at a bound.
    rigid : bool
        Tuned to the rigid-body modes.
    """

    name: str
    factor: float
    std: float
    interval: tuple[float, float] | None = None
    kept: float = float("nan")
    doubts: tuple[str, ...] = ()
    rigid: bool = False


@dataclass(frozen=True, slots=True)
class Question:
    """What the test leaves open: a code and the values of its sentences."""

    code: str
    values: Mapping[str, float | int | str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Conclusion:
    """What a study has shown.

    Attributes
    ----------
    checks : tuple of AcceptanceCheck
    band : tuple of float
        Where the model is held by the test, Hz; (0, 0): nowhere.
    level : float
        Probability of the intervals and bands.
    unseen : Unseen or None
        None where every mode was fitted.
    remodelled : str or None
        The stated reason of a remodelling; None without one.
    changes : tuple of Change
    questions : tuple of Question
    """

    checks: tuple[AcceptanceCheck, ...]
    band: tuple[float, float]
    level: float
    unseen: Unseen | None
    remodelled: str | None
    changes: tuple[Change, ...]
    questions: tuple[Question, ...]

    @property
    def failed(self) -> tuple[AcceptanceCheck, ...]:
        """The checks that did not hold, required ones first."""
        return tuple(
            sorted((c for c in self.checks if not c.held), key=lambda c: not c.required)
        )

    @property
    def verdict(self) -> Validation:
        """Not validated where anything required failed; not judged where no limit was stated."""
        required = [c for c in self.checks if c.required]
        if not all(c.held for c in required):
            return Validation.NOT_VALIDATED
        limits = any(c.code == "limit" for c in required)
        return Validation.VALIDATED if limits else Validation.NOT_JUDGED


def conclude(
    results: Mapping[str, Any],
    checks: Sequence[AcceptanceCheck],
    acceptance: Acceptance,
) -> Conclusion | None:
    """The conclusion of a study, as far as it was run; None without a correlation."""
    correlate: CorrelateStage | None = results.get("correlate")
    if correlate is None:
        return None
    known: UncertaintyStage | None = results.get("uncertainty")
    band = _band(results, correlate, acceptance)
    unseen = _unseen(results, correlate)
    questions = [
        *([] if unseen else [Question("no mode unseen")]),
        *_open_parameters(results),
        *_open_modes(results, correlate),
        *_open_tests(results, band),
    ]
    remodelling = correlate.remodelling
    return Conclusion(
        checks=tuple(checks),
        band=band,
        level=known.level if known is not None else float("nan"),
        unseen=unseen,
        remodelled=None if remodelling is None else remodelling.reason,
        changes=_changes(results),
        questions=tuple(questions),
    )


def _table(results: Mapping[str, Any], correlate: CorrelateStage) -> CorrelationTable:
    """That of the delivered model."""
    final: FinalStage | None = results.get("final")
    return correlate.remodelled if final is None else final.table


def _band(
    results: Mapping[str, Any], correlate: CorrelateStage, acceptance: Acceptance
) -> tuple[float, float]:
    predicted: PredictStage | None = results.get("predict")
    if predicted is not None:
        return predicted.run_up.validated
    table = _table(results, correlate)
    missed = {r.test - 1 for r in acceptance.missed(table)}
    held = np.isin(np.arange(table.all_test_hz.size), table.pairing.a)
    held[list(missed)] = False
    return validated_band(table.all_test_hz, held)


def _unseen(results: Mapping[str, Any], correlate: CorrelateStage) -> Unseen | None:
    table = _table(results, correlate)
    deviation = np.abs(table.deviation_percent)
    update: UpdateStage | None = results.get("update")
    known: UncertaintyStage | None = results.get("uncertainty")
    if update is None:
        if not deviation.size:
            return None
        return Unseen(
            "all", deviation.size, table.mean_deviation(), table.max_deviation()
        )
    left_out = deviation[~table.used]
    if left_out.size:
        first, _ = in_both(correlate.initial, table, used=False)
        inside = None
        if known is not None:
            bands = known.bands
            inside = int(
                (bands.inside & ~bands.used & np.isfinite(bands.predicted)).sum()
            )
        mean, largest = float(left_out.mean()), float(left_out.max())
        before = correlate.initial.mean_deviation(first)
        return Unseen(
            "left out", left_out.size, mean, largest, before=before, inside=inside
        )
    if known is not None and known.held.in_turn.any():
        at = known.held.in_turn
        error = 100 * np.abs(known.held.error[at])
        inside = int((known.held.inside(known.level) & at).sum())
        mean, largest = float(error.mean()), float(error.max())
        return Unseen("in turn", error.size, mean, largest, inside=inside)
    return None


def _changes(results: Mapping[str, Any]) -> tuple[Change, ...]:
    update: UpdateStage | None = results.get("update")
    tune: TuneStage | None = results.get("tune")
    known: UncertaintyStage | None = results.get("uncertainty")
    out: list[Change] = []
    if known is not None:
        p = known.posterior
        for i, name in enumerate(p.parameters.names):
            doubts: list[str] = [f.kind for f in known.flags if f.parameter == name]
            doubts += ["form"] if known.unproven[i] else []
            low, high = p.interval[i].tolist()
            parameter = p.parameters.parameters[i]
            ends = np.isclose((low, high), (parameter.lower, parameter.upper))
            doubts += ["interval"] if ends.any() else []
            factor = float(p.factor[i])
            std = factor * float(p.relative[i])
            kept = float(known.kept[i])
            kinds = tuple(dict.fromkeys(doubts))
            change = Change(
                name, factor, std, interval=(low, high), kept=kept, doubts=kinds
            )
            out.append(change)
    elif update is not None:
        best = update.best
        spread = zip(
            best.parameters, best.factor.tolist(), best.std.tolist(), strict=True
        )
        out += [Change(name, factor, factor * std) for name, factor, std in spread]
    if tune is not None:
        out += [
            Change(n, a, a * tune.std[n], rigid=True) for n, a in tune.factors.items()
        ]
    return tuple(out)


def _open_parameters(results: Mapping[str, Any]) -> list[Question]:
    """Parameters that the test does not prove, with the test modes that depend on them most."""
    known: UncertaintyStage | None = results.get("uncertainty")
    if known is None:
        return []
    names = known.posterior.parameters.names
    out = []
    for i in np.flatnonzero(known.unproven | ~known.posterior.moved).tolist():
        values: dict[str, float | int | str] = {"name": names[i]}
        trade = np.abs(known.posterior.correlation[i])
        trade[i] = 0.0
        other = int(trade.argmax())
        values["other"] = names[other] if trade[other] > 0 else ""
        values["correlation"] = float(known.posterior.correlation[i, other])
        values["modes"] = _most_sensitive(results.get("sensitivity"), names[i])
        out.append(Question("parameter not proven", values))
    return out


def _most_sensitive(found: SensitivityStage | None, name: str) -> str:
    """Numbers of the three FE modes whose frequencies depend most on a candidate."""
    if found is None or name not in found.names:
        return ""
    slope = np.abs(found.d_frequency[:, found.names.index(name)])
    most = found.fe_modes[np.argsort(-slope, kind="stable")[:3]]
    return ", ".join(str(k + 1) for k in sorted(most.tolist()))


def _open_modes(
    results: Mapping[str, Any], correlate: CorrelateStage
) -> list[Question]:
    """Modes without a partner inside the band of the test."""
    table = _table(results, correlate)
    out = []
    if table.pairing.unpaired_a.size:
        numbered = _numbered(table.pairing.unpaired_a, table.all_test_hz)
        out.append(Question("test modes unpaired", {"modes": numbered}))
    lone = table.pairing.unpaired_b
    hz = table.all_fe_hz[lone]
    low = table.all_test_hz.min(initial=np.inf)
    high = table.all_test_hz.max(initial=0.0)
    within = (hz >= low) & (hz <= high)
    if within.any():
        values = {"modes": _numbered(lone[within], table.all_fe_hz), "points": ""}
        final: FinalStage | None = results.get("final")
        if final is not None and len(final.observed) == table.all_fe_hz.size:
            shapes = np.abs(final.observed.shapes[:, lone[within]])
            points = [
                final.observed.channels[k] for k in shapes.argmax(axis=0).tolist()
            ]
            values["points"] = ", ".join(dict.fromkeys(points))
        out.append(Question("FE modes unpaired", values))
    return out


def _numbered(modes: Int, hz: np.ndarray) -> str:
    """`19 (41.28 Hz), 23 (44.1 Hz)`."""
    return ", ".join(f"{k + 1} ({hz[k]:.4g} Hz)" for k in modes.tolist())


def _open_tests(
    results: Mapping[str, Any], band: tuple[float, float]
) -> list[Question]:
    """What was not measured, or not well."""
    out = []
    compare: CompareStage | None = results.get("compare")
    if compare is None or not len(compare.table):
        out.append(Question("not repeated"))
    if names := dict.fromkeys(s.channel for s, _ in suspected(results)):
        out.append(Question("channels suspected", {"channels": ", ".join(names)}))
    final: FinalStage | None = results.get("final")
    if (
        final is not None
        and final.evidence is not None
        and final.evidence.frfs is not None
    ):
        frfs = final.evidence.frfs
        if worse := frfs.worse:
            points = ", ".join(worse)
            total = len(frfs.final.inputs)
            out.append(
                Question(
                    "FRFs worse",
                    {"points": points, "count": len(worse), "total": total},
                )
            )
    damped: DampingStage | None = results.get("damping")
    if damped is not None and damped.regions is not None and damped.why:
        out.append(Question("damping refused"))
    out.append(Question("beyond the band", {"high": band[1]}))
    predicted: PredictStage | None = results.get("predict")
    if predicted is not None:
        speeds = predicted.run_up.peak_speed.high
        beyond = int((speeds > band[1]).sum())
        if beyond:
            values = {
                "count": beyond,
                "total": speeds.size,
                "high": float(speeds.max()),
            }
            out.append(Question("peaks beyond the band", values))
    return out
