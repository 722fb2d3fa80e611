"""The sentences that a run shows: modes, pairs, factors, and what to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.display import plus_minus, with_error
from ringtrue.core.notes import sentence
from ringtrue.correlation.channel_faults import Suspect
from ringtrue.correlation.table import CorrelationTable
from ringtrue.study.acceptance import in_both
from ringtrue.study.conclusion import suspected
from ringtrue.study.placing import seat_words
from ringtrue.study.results import (
    CompareStage,
    ConditionsStage,
    ConfigurationsStage,
    CorrelateStage,
    FinalStage,
    IdentifyStage,
    LocaliseStage,
    PlanStage,
    TuneStage,
    UncertaintyStage,
    UpdateStage,
)
from ringtrue.updating.validation import Misfit

MEND = (
    "see such a channel's row in the sensor sheet (direction, place, unit); [test] leave_out "
    "= [...] leaves it out"
)


NO_CHANGE = (
    "no change of the candidates pays for its parameters (AICc): nothing is proposed, and the "
    "deck is delivered as it "
    "is; first look for what is wrong with the pairs, the sensors, the mesh or the form of the "
    "model"
)


def run_messages(r: Mapping[str, Any]) -> tuple[str, ...]:
    """Modes found, pairs and deviations before and after, what was changed, and channels that look
    wrong.

    Parameters
    ----------
    r : mapping of str to a stage's result
        As far as the study was run.
    """
    identify: IdentifyStage | None = r.get("identify")
    correlate: CorrelateStage | None = r.get("correlate")
    final: FinalStage | None = r.get("final")
    update: UpdateStage | None = r.get("update")
    localise: LocaliseStage | None = r.get("localise")
    known: UncertaintyStage | None = r.get("uncertainty")
    out: list[str] = []
    if identify is not None:
        modes = (
            [f"{len(identify.ambient)} ambient modes"]
            if identify.ambient_records
            else []
        )
        if identify.hammer is not None:
            modes.append(f"{len(identify.hammer)} modes of the {identify.source}")
        out += [
            "; ".join(modes) or "no mode",
            *identify.merge_notes,
            *_at_fault(identify),
        ]
    conditions: ConditionsStage | None = r.get("conditions")
    if conditions is not None:
        out += [sentence(note) for note in conditions.notes]
    if correlate is not None:
        out += [m.text for m in correlate.sensors.mendings]
        others: ConfigurationsStage | None = r.get("configurations")
        for c in others.items if others is not None else ():
            out += [f"configuration {c.name}: {m.text}" for m in c.sensors.mendings]
        out += [
            *seat_words(correlate.sensors.seats),
            *correlate.notes,
            *_pairs(correlate, final),
        ]
    best = update.best if update is not None else None
    if best is not None:
        still = np.flatnonzero(best.factor == 1.0).tolist()
        out += not_written_sentences([best.parameters[i] for i in still])
    if r.get("sensitivity") is not None and best is not None:
        out += held_sentences(r["sensitivity"].held.get(best.name, {}))
    # that the deck did not have and a factor of 2 adds
    masses = {}
    if localise is not None:
        candidates = localise.candidates.parameters.parameters
        masses = {p.name: p.lump for p in candidates if p.lump}
    for name, a, std in _factors(r):
        within = _interval(known, name)
        if name in masses:
            out.append(_added_mass(name, masses[name], a, std, within))
        else:
            out.append(_factor_sentence(name, a, std, within))
    if known is not None:
        out += _doubts(known)
    if correlate is not None and final is not None:
        deviations = _in_both_deviations(correlate.remodelled, final.table, used=True)
        out.append(worse_frequencies(*deviations))
    if update is not None and best is not None:
        out += [
            f"{d.name}: {line}" for d in update.data for line in seat_words(d.seats)
        ]
        out.append(discrepancy_sentence(best.discrepancy.tolist()))
        out += [misfit_sentence(m) for m in best.fit.misfits]
        proposed = localise.proposal.members if localise is not None else ()
        if best.name == "proposal" and localise is not None and not proposed:
            out.append(NO_CHANGE)
    out += _suspects(suspected(r), r.get("compare"))
    return tuple(filter(None, out))


def held_sentences(held: Mapping[str, Sequence[str]]) -> list[str]:
    """Candidates that are held at the deck's values, with those that stand for them."""
    return [
        f"{name} is held at the deck's value: the data cannot tell it from {', '.join(by)}, which "
        f"{'stand' if len(by) > 1 else 'stands'} for it; one candidate with the targets of both "
        "changes them together"
        for name, by in held.items()
    ]


def misfit_sentence(m: Misfit) -> str:
    """A kind of residuals beyond its stated error."""
    where = f" of {m.configuration}" if m.configuration else ""
    return (
        f"not fitted: {m.kind}{where} deviate by {m.ratio:.2g} times their stated error "
        f"(χ² {m.chi_square:.3g}, by chance up to {m.limit:.3g}); most of all {', '.join(m.worst)}"
    )


def not_written_sentences(names: Sequence[str]) -> list[str]:
    """Parameters whose change is not proven."""
    return [
        f"{name} stays as in the deck: the interval of its factor holds 1 ([update] write = "
        '"all" writes it)'
        for name in names
    ]


def _doubts(known: UncertaintyStage) -> list[str]:
    """Parameters that the test does not prove, and what is not plausible of the others."""
    names = [
        n
        for n, open_ in zip(
            known.posterior.parameters.names, known.unproven, strict=True
        )
        if open_
    ]
    why = "may take up an error of the model's form, or are known only together with others"
    out = [f"not proven by the test, {why}: {', '.join(names)}"] if names else []
    return [*out, *(f.text for f in known.flags if f.parameter not in names)]


def discrepancy_sentence(discrepancy: Sequence[float]) -> str:
    """What an updating took for the deviations, of a frequency (relative) and of 1 − MAC, that its
    best model keeps.
    """
    parts = [
        f"{100 * x:.2g} % of {what}"
        for x, what in zip(discrepancy, ("frequency", "MAC"), strict=True)
        if x > 0
    ]
    return (
        f"deviations that the model is taken to keep: {' and '.join(parts)}"
        if parts
        else ""
    )


def lost_points_sentence(plan: PlanStage) -> str:
    """What a plan still says of the modes when the worst of its points fail."""
    sensors = plan.sensors
    what = (
        "the most important point"
        if sensors.lost == 1
        else f"any {sensors.lost} points"
    )
    left = f"{100 * sensors.left_by_loss:.0f} %"
    return f"without {what} {left} of the information about any mode is left"


def missed_modes(plan: PlanStage) -> list[str]:
    """Target modes that the references miss: those that more of them could reach, and those that
    none could.
    """
    found = plan.excitation
    kinds = {
        "the references miss mode {}: strike at more points": found.missed
        & ~found.unreachable,
        "no point that can be struck moves enough in mode {}: name others": found.missed
        & found.unreachable,
    }
    out = []
    for text, which in kinds.items():
        modes = (plan.target_modes[which] + 1).tolist()
        if modes:
            out.append(text.format(", ".join(map(str, modes))))
    return out


def setup_sentences(plan: PlanStage) -> list[str]:
    """How the sensors at hand are moved, the modes that cannot be joined well, and those that their
    mass shifts.
    """
    if (found := plan.sensors.setups) is None:
        return []
    at_once = found.references.size + max(
        found.roving(k).size for k in range(found.count)
    )
    lines = [
        f"{found.count} setups of up to {at_once} sensors; those at "
        f"{' '.join(map(str, plan.sensors.roving(-1)))} stay"
    ]
    names = np.array([str(k + 1) for k in plan.target_modes.tolist()])
    if (dim := found.seen < 0.5).any():  # of what the typical point sees of a mode
        lines.append(
            f"the sensors that stay see little of mode {', '.join(names[dim])}: "
            "strike elsewhere or take more sensors"
        )
    if (moved := found.shift > plan.acquisition.damping).any():
        worst = int(np.nanargmax(found.shift))
        lines.append(
            f"moving the sensors shifts mode {', '.join(names[moved])} by more than half its "
            "resonance is wide (mode "
            f"{names[worst]} by {100 * found.shift[worst]:.2g} %): rove with the hammer, or "
            "leave dummy masses"
        )
    return lines


def validity_sentence(band: tuple[float, float]) -> str:
    """How far a prediction may be believed, Hz."""
    low, high = band
    if high <= 0:
        return (
            "the model is validated nowhere: it does not hold the lowest mode of the test; "
            "mend it, or leave that out"
        )
    return f"the model is validated from {low:.4g} to {high:.4g} Hz; beyond, no test has checked it"


def worse_frequencies(before: Float, after: Float) -> str:
    """That an updating has made frequencies worse; nothing where it has not by a hundredth of a
    percent.

    Parameters
    ----------
    before, after : (n,) float64
        Deviations in percent of the used modes that have a partner in both.
    """
    a, b = (
        round(float(np.abs(x).mean()), 2) if x.size else 0.0 for x in (before, after)
    )
    if b <= a:
        return ""
    return (
        f"the updating made frequencies worse: mean |Δf| of the {before.size} used modes paired "
        "before and after "
        f"{a:.2f} -> {b:.2f} %. Shapes or other data were fitted at their cost; look at the "
        "pairs first, then weigh "
        "the shapes less ([update] shape_weight)"
    )


def _suspects(
    found: Sequence[tuple[Suspect, str]], tests: CompareStage | None
) -> list[str]:
    """Channels that contradict the model or the others, and those that ambient and hammer test do
    not agree on.
    """
    out = [
        f"channel {s.channel} looks {s.fault}{where}: {s.message}" for s, where in found
    ]
    more = (
        tests.evidence.measures.suspects
        if tests is not None and tests.evidence is not None
        else ()
    )
    named = {s.channel for s, _ in found}
    out += [
        f"channel {s.channel} looks {s.fault} in the ambient against the hammer test: {s.message}"
        for s in more
        if s.channel not in named
    ]
    return [*out, MEND] if out else []


def _at_fault(identify: IdentifyStage) -> list[str]:
    """What records and FRFs say of their channels, once for each of these."""
    every = [
        (f"{r.name}: ", note) for r in identify.records for note in r.channel_notes
    ]
    every += [("", note) for note in identify.channel_notes]
    notes: dict[str, list[str]] = {}
    for name, note in every:
        notes.setdefault(note.subject, []).append(name + sentence(note))
    out = []
    for first, *rest in notes.values():
        more = f" (further notes on it: {len(rest)})" if rest else ""
        out.append(first + more)
    return out


def _pairs(correlate: CorrelateStage, final: FinalStage | None) -> list[str]:
    tables = [
        t
        for t in (correlate.initial, final.table if final is not None else None)
        if t is not None
    ]
    total = len(correlate.reference.elastic)
    mac = ""
    if not tables[0].frequency_only:
        single = _arrow([f"{t.mean_mac():.1f}" for t in tables])
        subspace = _arrow([f"{t.mean_subspace_mac():.1f}" for t in tables])
        mac = f", mean MAC {single} %, mean subspace MAC {subspace} %"
    out = [
        f"pairs: {_arrow([str(len(t)) for t in tables])} of {total} test modes; mean |Δf| "
        f"{_arrow([f'{t.mean_deviation():.2f}' for t in tables])} %{mac}"
    ]
    if final is not None and any((~t.used).any() for t in tables):
        out.append(left_out_sentence(correlate.initial, final.table))
    return out


def _in_both_deviations(
    before: CorrelationTable, after: CorrelationTable, *, used: bool
) -> list[Float]:
    """Deviations, %, of the modes that are `in_both`."""
    return [
        t.deviation_percent[w]
        for t, w in zip((before, after), in_both(before, after, used=used), strict=True)
    ]


def left_out_sentence(before: CorrelationTable, after: CorrelationTable) -> str:
    """How well the modes are met that the updating did not see, and which of them have a partner in
    one table only.
    """
    both = _in_both_deviations(before, after, used=False)
    out = "modes that the updating did not see: "
    if both[0].size:
        alone = both[0].size < max(int((~t.used).sum()) for t in (before, after))
        means = _arrow([f"{np.abs(x).mean():.2f}" for x in both])
        out += (
            f"mean |Δf|{f' of the {both[0].size} paired before and after' if alone else ''} "
            f"{means} %"
        )
    else:
        out += "none paired before and after"
    for when, t, other in (("before", before, after), ("after", after, before)):
        only = ~t.used & ~np.isin(t.pairing.a, other.pairing.a)
        each = [
            f"{k + 1} ({x:+.1f} %)"
            for k, x in zip(t.pairing.a[only], t.deviation_percent[only], strict=True)
        ]
        out += f"; paired {when} only: {', '.join(each)}" if each else ""
    return out


def _arrow(values: list[str]) -> str:
    return " -> ".join(values)


def _factors(r: Mapping[str, Any]) -> list[tuple[str, float, float]]:
    """Name, factor and standard deviation of what was changed."""
    update: UpdateStage | None = r.get("update")
    tune: TuneStage | None = r.get("tune")
    out: list[tuple[str, float, float]] = []
    if update is not None:
        best = update.best
        known: UncertaintyStage | None = r.get("uncertainty")
        std = best.std if known is None else known.posterior.relative
        out += zip(
            best.parameters,
            best.factor.tolist(),
            (best.factor * std).tolist(),
            strict=True,
        )
    if tune is not None:
        out += [(n, a, tune.std[n] * a) for n, a in tune.factors.items()]
    return out


def _interval(
    known: UncertaintyStage | None, name: str
) -> tuple[float, float, float] | None:
    """Level and ends of the interval of a factor: far wider than normal where few modes tell the
    size of the errors.
    """
    if known is None or name not in known.posterior.parameters.names:
        return None
    low, high = known.posterior.interval[
        known.posterior.parameters.names.index(name)
    ].tolist()
    return known.level, low, high


def _factor_sentence(
    name: str, factor: float, std: float, within: tuple[float, float, float] | None
) -> str:
    ends = ""
    if within:
        low, high = (with_error(end, std)[0] for end in within[1:])
        ends = f" ({100 * within[0]:g} %: {low} to {high})"
    return f"{name}: times {plus_minus(factor, std)}{ends}"


def _added_mass(
    name: str,
    total: float,
    factor: float,
    std: float,
    within: tuple[float, float, float] | None,
) -> str:
    mass = plus_minus(total * (factor - 1), total * std)
    if within:
        low, high = (
            with_error(total * max(a - 1, 0.0), total * std)[0] for a in within[1:]
        )
        mass += f" ({100 * within[0]:g} %: {low} to {high})"
    return (
        f"{name}: {mass} (units of the deck); is a part left out there? The updated deck has "
        "it as a CONM2"
    )
