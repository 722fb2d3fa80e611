"""The parameter sets updated and compared; the chosen one."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress, part
from ringtrue.errors import NumericalError
from ringtrue.model.edit import field_value
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.course import further
from ringtrue.study.finished import FinishedSets
from ringtrue.study.results import (
    CorrelateStage,
    FinishedSet,
    LocaliseStage,
    SensitivityStage,
    SetResult,
    UpdateStage,
)
from ringtrue.study.stages.by_runs import by_runs
from ringtrue.study.stages.localise import element_regions
from ringtrue.study.stages.together import together, told_data
from ringtrue.study.workbench import Workbench
from ringtrue.updating.identifiability import unmoved
from ringtrue.updating.selection.candidates import elements_of
from ringtrue.updating.selection.screening import of_parameter

_log = logging.getLogger(__name__)

WHY = (
    "{name}: the lowest AICc ({value:.1f}); it weighs the fit of the used modes, those that lost "
    "their partner among "
    "them, against the number of parameters and does not look at the modes left out"
)
OTHER = "; sets that weigh the data otherwise are shown and not chosen from: their J is another"
ALL = "; all figures are over the tests of all configurations"


def run(desk: Workbench, progress: Progress) -> UpdateStage:
    """Update every set, verify each by a full solution, choose by the information criterion."""
    sets: SensitivityStage = desk.get("sensitivity")
    found: CorrelateStage = desk.get("correlate")
    named = {s.name: s for s in desk.config.set}
    kept, results, runs = FinishedSets.of(desk), list[SetResult](), 0
    lost = dict[str, int]()  # used modes without partner that the model has
    for i, (name, members) in enumerate(sets.sets.items()):
        told = part(progress, i / len(sets.sets), (i + 1) / len(sets.sets))
        told(0.0, f"updating: {name}")
        own = named[name].own() if name in named else {}
        same = next(
            (r for r in results if set(r.parameters) == set(members) and not r.settings), None
        )
        if same is not None and not own:  # two rules, one choice
            results.append(replace(same, name=name))
            continue
        done = kept.get(name)
        if done is None:
            asked = named[name].settings(desk.config.update) if own else None
            done = kept.put(name, _finished(desk, name, members, told, asked))
        results.append(replace(done.result, settings=named[name].words() if own else ""))
        runs += done.runs
        lost[name] = done.lost
    alike = [r.name not in named or named[r.name].comparable(desk.config.update) for r in results]
    chosen = _least(results, alike)
    if results[chosen].parameters and lost.get(results[chosen].name):
        results = _with_further_starts(desk, results, chosen, progress)
        chosen = _least(results, alike)
    kept.clear()
    results[chosen] = best = _without_unmoved(desk, results[chosen])
    parameters = desk.parameters.take([sets.names.index(n) for n in best.parameters])
    before = dict(zip(best.parameters, _values(desk, best, np.ones(len(parameters))), strict=True))
    after = dict(zip(best.parameters, _values(desk, best, best.factor), strict=True))
    return UpdateStage(
        tuple(results),
        chosen,
        WHY.format(name=best.name, value=best.criterion)
        + (ALL if desk.config.configuration else "")
        + ("" if all(alike) else OTHER),
        found.left_out,
        before,
        after,
        {n: regions(desk, n) for n in best.parameters},
        told_data(desk, best, progress) if desk.config.residual else (),
        desk.deck.solver,
        runs,
    )


def _finished(
    desk: Workbench,
    name: str,
    members: Sequence[str],
    progress: Progress,
    asked: UpdateSection | None,
) -> FinishedSet:
    """A set updated on the reduced models, or by runs of another solver."""
    if desk.engine is not None:
        result, runs = by_runs(desk, name, members, progress, asked)
        return FinishedSet(result, 0, runs)
    result, lost = together(desk, name, members, progress, asked)
    return FinishedSet(result, lost, 0)


def _without_unmoved(desk: Workbench, best: SetResult) -> SetResult:
    """The set with a factor of 1 for what has not changed beyond its own error and moves no mode:
    it is not written.
    """
    names, sets = desk.parameters.names, desk.get("sensitivity")
    at = [names.index(n) for n in best.parameters]
    x = desk.parameters.take(at).vector(best.factor)
    slopes = sets.d_frequency[:, [sets.names.index(n) for n in best.parameters]]
    factor = np.where(unmoved(x, best.std, slopes), 1.0, best.factor)
    return replace(best, factor=factor)


def _values(desk: Workbench, best: SetResult, factor: Float) -> list[float]:
    """The first target's value of each parameter at the factors."""
    candidates = {p.name: p for p in desk.parameters.parameters}
    out = []
    for name, a in zip(best.parameters, factor.tolist(), strict=True):
        target = candidates[name].targets[0]
        out.append(float(field_value(desk.remodelled.model, target)) * a + target.step * (a - 1))
    return out


def regions(desk: Workbench, name: str) -> tuple[int, ...]:
    """Groups of the scene that a parameter changes: those of the elements that use what it
    targets.
    """
    model = desk.remodelled.model
    parameter = desk.parameters.take([desk.parameters.names.index(name)]).parameters[0]
    mine = np.isin(elements_of(model), of_parameter(model, parameter).elements)
    labels = element_regions(model, desk.deck.regions)
    touched = {labels[i] for i in np.flatnonzero(mine).tolist()}
    return tuple(
        i for i, g in enumerate(desk.get("model").scene.groups) if g in touched or g == name
    )


def _least(results: Sequence[SetResult], alike: Sequence[bool]) -> int:
    """The set of lowest AICc among those that weigh the data as the study does."""
    return int(
        np.argmin([r.criterion if good else np.inf for r, good in zip(results, alike, strict=True)])
    )


def _with_further_starts(
    desk: Workbench, results: list[SetResult], chosen: int, progress: Progress
) -> list[SetResult]:
    """The sets, the one to be chosen from further starts as well where these end in a lower J.

    One is where the proposal was found: its search has left minima in which the way from the deck
    may end.
    """
    best, more = results[chosen], further(desk.config.update)
    found: LocaliseStage | None = desk.get("localise")
    at = {m.name: m.factor for m in found.proposal.members} if found is not None else {}
    others = list[tuple[str, UpdateSection | None, dict[str, float] | None]]()
    others += [("from the proposal", None, at)] if set(at) == set(best.parameters) else []
    others += [("further starts", more, None)] if more is not None else []
    for what, settings, factors in others:
        progress(0.9, f"{best.name}: modes without partner, {what}")
        name = f"{best.name}, {what}"
        try:
            other, _ = together(desk, name, best.parameters, progress, settings, factors)
        except NumericalError as e:  # the end from the deck stands
            _log.info("%s: %s", name, e)
            continue
        if other.criterion < best.criterion:
            best = replace(other, name=best.name)
    return [
        replace(best, name=r.name) if r.parameters == best.parameters and not r.settings else r
        for r in results
    ]


def chosen_factors(desk: Workbench) -> Float:
    """Factors of all candidates after the updating, (P,); 1 for those not chosen."""
    names = desk.parameters.names
    out = np.ones(len(names))
    if not names:
        return out
    done: UpdateStage = desk.get("update")
    best = done.sets[done.chosen]
    for n, a in zip(best.parameters, best.factor.tolist(), strict=True):
        out[names.index(n)] = a
    return out
