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
from ringtrue.study.iterates import Iterates
from ringtrue.study.parametric import CLOSE, ROUNDS, AtChannels, not_verified, verified
from ringtrue.study.results import CorrelateStage, SensitivityStage, SetResult, UpdateStage
from ringtrue.study.stages.by_runs import by_runs
from ringtrue.study.stages.localise import element_regions
from ringtrue.study.stages.sensitivity import target
from ringtrue.study.stages.together import percent, spared, together, told_data
from ringtrue.study.workbench import Workbench
from ringtrue.update.alike import errors_of_shapes
from ringtrue.update.candidates import elements_of
from ringtrue.update.choose import criterion
from ringtrue.update.gauss_newton import State, UpdateResult, update
from ringtrue.update.objective import Target, Weights, objective, residual
from ringtrue.update.pool import of_parameter
from ringtrue.update.weights import in_turns, left_over

STARTS = 8  # where one leaves modes without partner

_log = logging.getLogger(__name__)

WHY = (
    "{name}: the lowest AICc ({value:.1f}); it weighs the fit of the used modes, those that lost their partner among "
    "them, against the number of parameters and does not look at the modes left out"
)
OTHER = "; sets that weigh the data otherwise are shown and not chosen from: their J is another"
ALL = "; all figures are over the tests of all configurations"


def run(desk: Workbench, progress: Progress) -> UpdateStage:
    """Update every set, verify each by a full solution, choose by the information criterion."""
    aim = target(desk)
    sets: SensitivityStage = desk.get("sensitivity")
    found: CorrelateStage = desk.get("correlate")
    named = {s.name: s for s in desk.config.set}
    kept, results, runs = Iterates.of(desk, aim), list[SetResult](), 0
    lost = dict[str, int]()  # used modes without partner
    for i, (name, members) in enumerate(sets.sets.items()):
        told = part(progress, i / len(sets.sets), (i + 1) / len(sets.sets))
        told(0.0, f"updating: {name}")
        own = named[name].own() if name in named else {}
        same = next((r for r in results if set(r.parameters) == set(members) and not r.settings), None)
        if same is not None and not own:  # two rules, one choice
            results.append(replace(same, name=name))
            continue
        asked = named[name].settings(desk.config.update) if own else None
        if desk.engine is not None:
            done, more = by_runs(desk, name, members, told, kept, asked)
            results.append(replace(done, settings=named[name].words() if own else ""))
            runs += more
        elif own:
            done = together(desk, name, members, progress, kept, asked)
            results.append(replace(done, settings=named[name].words()))
        elif desk.config.joint:
            results.append(together(desk, name, members, progress, kept))
        else:
            done, lost[name] = _one(desk, aim, name, members, progress, kept)
            results.append(done)
    alike = [r.name not in named or named[r.name].comparable(desk.config.update) for r in results]
    chosen = _least(results, alike)
    if lost.get(results[chosen].name):
        results = _with_further_starts(desk, results, chosen, progress, kept)
        chosen = _least(results, alike)
    kept.done()
    best = results[chosen]
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


def _values(desk: Workbench, best: SetResult, factor: Float) -> list[float]:
    """The first target's value of each parameter at the factors."""
    candidates = {p.name: p for p in desk.parameters.parameters}
    out = []
    for name, a in zip(best.parameters, factor.tolist(), strict=True):
        out.append(float(field_value(desk.remodelled.model, candidates[name].targets[0])) * a)
    return out


def regions(desk: Workbench, name: str) -> tuple[int, ...]:
    """Groups of the scene that a parameter changes: those of the elements that use what it targets."""
    model = desk.remodelled.model
    parameter = desk.parameters.take([desk.parameters.names.index(name)]).parameters[0]
    mine = np.isin(elements_of(model), of_parameter(model, parameter).elements)
    labels = element_regions(model, desk.deck.regions)
    touched = {labels[i] for i in np.flatnonzero(mine).tolist()}
    return tuple(i for i, g in enumerate(desk.get("model").scene.groups) if g in touched or g == name)


def _least(results: Sequence[SetResult], alike: Sequence[bool]) -> int:
    """The set of lowest AICc among those that weigh the data as the study does."""
    return int(np.argmin([r.criterion if good else np.inf for r, good in zip(results, alike, strict=True)]))


def _with_further_starts(
    desk: Workbench, results: list[SetResult], chosen: int, progress: Progress, kept: Iterates
) -> list[SetResult]:
    """The sets, the one to be chosen from further starts as well where these end in a lower J.

    Modes that change places between the deck and the structure make minima in which each is paired with its neighbour,
    and some without partner.
    """
    best, u = results[chosen], desk.config.update
    if u.step == "published":
        return results
    progress(0.9, f"{best.name}: modes without partner, further starts")
    name, more = f"{best.name}, further starts", u.model_copy(update={"starts": STARTS})
    try:
        other = together(desk, name, best.parameters, progress, kept, more)
    except NumericalError as e:  # the end from the deck stands
        _log.info("%s: %s", name, e)
        return results
    if not other.criterion < best.criterion:
        return results
    return [replace(other, name=r.name) if r.parameters == best.parameters and not r.settings else r for r in results]


def _one(
    desk: Workbench, aim: Target, name: str, members: tuple[str, ...], progress: Progress, kept: Iterates
) -> tuple[SetResult, int]:
    """Update on the reduced model until the full one agrees at the end point.

    By Gauss-Newton on one deck's modes alone. `together` ends at the same minimum, factors within 1e-6, by other steps.
    Beside it the number of used modes without partner.
    """
    model = desk.candidates(progress)
    every = model.parameters.names
    at = [every.index(m) for m in members]
    start = kept.start(name, members)
    states: list[State] = []
    error = np.inf
    for _ in range(ROUNDS):
        active = model.with_parameters(at, np.zeros(len(every)))
        result, path, _ = _settled(desk, active, aim, start)
        states += path[1:] if states else path
        start = result.x
        kept.keep(name, start)
        better, error = verified(active, result.x)
        model = better.with_parameters(range(len(every)), np.zeros(len(every)))
        if error < CLOSE:
            break
    desk.keep(model)
    if error >= CLOSE:
        raise not_verified(error)
    active = model.with_parameters(at, np.zeros(len(every)))
    final, path, weights = _settled(desk, active, aim, start)
    blind = spared((aim,), (active.linearise(final.x),))
    done = _summary(desk, aim, name, members, final, [*states, *path[1:]], blind)
    done = replace(done, discrepancy=np.array([weights.frequency, weights.mac]))
    return done, int(aim.used.sum()) - int(final.residual.used.sum())


def _settled(
    desk: Workbench, active: AtChannels, aim: Target, start: Float | None
) -> tuple[UpdateResult, list[State], Weights]:
    """One updating in up to three parts: the result, the way there, and what the end was weighed by.

    From the deck with the gates of the pairing, which far deviations need; then no pair costs more than a lost mode,
    so that one paired wrongly on the way lets go; then with the pairs made there for good.
    """
    limit, published = desk.config.update.iterations, desk.config.update.step == "published"
    states: list[State] = []
    if start is None:
        rough = update(active, aim, iterations=limit, published=published)
        states += rough.history
        start = rough.x
    near = update(active, aim.doubting(), iterations=limit, start=start, published=published)
    states += near.history[1:] if states else near.history
    last = aim.settled(active.linearise(near.x))
    if desk.config.update.sharpened:
        result, weights = _sharpened(active, last, near.x, limit)
    else:
        result, weights = update(active, last, iterations=limit, start=near.x, published=published), aim.weights
    return result, [*states, *result.history[1:]], weights


def _sharpened(active: AtChannels, aim: Target, x: Float, limit: int) -> tuple[UpdateResult, Weights]:
    """Updated with the discrepancy that is left over, until that stands; J at the end is as all sets have it."""

    def updated(w: Weights, x: Float) -> tuple[UpdateResult, Float]:
        done = update(active, replace(aim, weights=w), iterations=limit, start=x)
        return done, done.x

    done, found = in_turns(x, updated, lambda x: weights_at(aim, active, x))
    r = residual(aim, active.linearise(done.x))
    end = replace(done.history[-1], residual=r, value=objective(aim, r, done.x, active.parameters.std()))
    return replace(done, history=(*done.history[:1], end)), found


def weights_at(aim: Target, model: AtChannels, x: Float) -> Weights:
    """The weights with the discrepancy that an updating of all parameters of a model has left at x."""
    now = model.linearise(x)
    r = residual(aim, now)
    return left_over(aim.weights, r, r.slope * model.parameters.std(), aim.weights.data, errors_of_shapes(aim, now))


def _summary(
    desk: Workbench,
    aim: Target,
    name: str,
    members: tuple[str, ...],
    final: UpdateResult,
    states: list[State],
    blind: float,
) -> SetResult:
    candidates = desk.parameters
    parameters = candidates.take([candidates.names.index(m) for m in members])
    r = final.residual
    low, high = parameters.bounds()
    slope = parameters.slope(final.x) / final.factors
    return SetResult(
        name,
        members,
        final.factors,
        final.std * slope,
        np.stack([parameters.factors(low), parameters.factors(high)], axis=1),
        final.identifiability,
        percent(np.mean, r.frequency_error, r.used),
        percent(np.max, r.frequency_error, r.used),
        percent(np.mean, r.mac, r.used),
        blind,
        final.condition,
        criterion(r, final.x, parameters.std(), aim.doubting()),
        final.outcome.value,
        np.array([s.value for s in states]),
        np.array([0.0 if not np.isfinite(s.step) else s.step for s in states]),
        np.array([percent(np.mean, s.residual.frequency_error, s.residual.used) for s in states]),
        np.array([percent(np.mean, s.residual.mac, s.residual.used) for s in states]),
        np.array([parameters.factors(s.x) for s in states]),
        final.gradient,
    )


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
