"""A parameter set updated on the whole objective: all configurations and kinds of residuals, each
model verified.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.progress import Progress
from ringtrue.model.ports import Linearisation
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.course import settled
from ringtrue.study.objective import data_count, data_of, names_of, problem_of, terms_of
from ringtrue.study.parametric import (
    CLOSE,
    ROUNDS,
    AtChannels,
    frequency_error,
    not_verified,
    verified,
)
from ringtrue.study.results import ConfiguredStage, DataResult, SetResult
from ringtrue.study.stages.sensitivity import targets
from ringtrue.study.workbench import Workbench
from ringtrue.updating import settle
from ringtrue.updating.objective import Target, aicc, residual
from ringtrue.updating.settle import Settled, displaced, whole_cost
from ringtrue.updating.several import Configuration, Evaluated, Problem
from ringtrue.updating.trust import Solution


def together(
    desk: Workbench,
    name: str,
    members: Sequence[str],
    progress: Progress,
    u: UpdateSection | None = None,
    factors: Mapping[str, float] | None = None,
) -> tuple[SetResult, int]:
    """Update on the reduced models of all configurations until the full ones agree at the end
    point.

    `u` stands in for the [update] of the study; with `factors` of the members it starts there, not
    at the deck. Beside the result the number of used modes without partner whose shape the model
    has.

    Raises
    ------
    NotConverged
        If a reduced model does not follow its full one.
    """
    u = u or desk.config.update
    models, aims = [desk.candidates(progress), *desk.others(progress)], targets(desk, u)
    start: Float | None = None
    if factors is not None:
        mine = desk.parameters.take([desk.parameters.names.index(m) for m in members])
        start = mine.vector(np.array([factors[m] for m in members]))
    path: list[Evaluated] = []
    error = np.inf
    for _ in range(ROUNDS):
        end = settled(
            _problem(desk, u, models, aims, members),
            u,
            desk.config.study.seed,
            progress,
            start=start,
        )
        path += end.path[1:] if path else end.path
        start = end.solution.y
        models, error = _verified(models, members, end.solution)
        if error < CLOSE:
            break
    if error >= CLOSE:
        raise not_verified(error)
    problem = _problem(desk, u, models, aims, members)
    end = settled(problem, u, desk.config.study.seed, progress, start=start)
    return summary(problem, aims, name, replace(end, path=(*path, *end.path[1:]))), displaced(
        problem, end.solution.end
    )


def told_data(desk: Workbench, best: SetResult, progress: Progress) -> tuple[DataResult, ...]:
    """What was measured beside the modes, by the model before and after the updating."""
    models = [_held(m, best.parameters) for m in desk.updated(best, progress)]
    x = desk.parameters.take([desk.parameters.names.index(n) for n in best.parameters]).vector(
        best.factor
    )
    at = dict(zip(best.parameters, x.tolist(), strict=True))
    out = []
    for name, model, aim in zip(names_of(desk), models, targets(desk), strict=True):
        y = np.array([at[n] for n in model.parameters.names])
        for m, d in zip(desk.measured(name), data_of(desk, name, model), strict=True):
            one = Configuration(model, aim, (d.term,))
            before, after = (d.shown(d.term(one.at(v, slopes=False))) for v in (0 * y, y))
            places = desk.seats_beside(name, m)
            out.append(
                DataResult(
                    d.name,
                    d.kind,
                    name,
                    d.labels,
                    d.units,
                    d.measured,
                    before,
                    after,
                    d.scale,
                    places,
                )
            )
    return tuple(out)


def others_at(desk: Workbench, best: SetResult, progress: Progress) -> tuple[Configuration, ...]:
    """The other configurations over the parameters of a set, springs as tuned; the pairs of the
    delivered decks.
    """
    if not desk.config.configuration:
        return ()
    delivered: ConfiguredStage = desk.get("configured")
    factor = dict(zip(best.parameters, best.factor.tolist(), strict=True))
    out = []
    for model, aim, done in zip(
        desk.delivered_models(progress)[1:], targets(desk)[1:], delivered.items, strict=True
    ):
        active, x = as_delivered(desk, model, factor, done.observed.frequencies, progress)
        terms = terms_of(desk, done.name, active, desk.config.update)
        out.append(Configuration(active, aim.settled(active.linearise(x)), terms, done.name))
    return tuple(out)


def as_delivered(
    desk: Workbench,
    model: AtChannels,
    factor: Mapping[str, float],
    truth: Float,
    progress: Progress,
) -> tuple[AtChannels, Float]:
    """The model over those of the parameters that it has, springs as tuned, and x at their factors.

    Solved anew there if its frequencies are not those of the delivered deck, `truth`, Hz.
    """
    every, mine = model.model.system.parameters, model.parameters.names
    springs = every.take(range(len(mine), len(every)))
    tuned = desk.get("tune").factors if len(springs) else {}
    base = np.concatenate(
        [np.zeros(len(mine)), springs.vector(np.array([tuned[n] for n in springs.names]))]
    )
    active = model.with_parameters([mine.index(m) for m in factor if m in mine], base)
    x = active.parameters.vector(np.array([factor[n] for n in active.parameters.names]))
    if frequency_error(active.modes(x).frequencies, truth) >= CLOSE:
        progress(0.9, "modes at the updated point")
        active, _ = active.enrich(x)
    return active, x


def _held(model: AtChannels, members: Sequence[str]) -> AtChannels:
    """The model over those of the parameters that it has."""
    every = model.parameters.names
    return model.with_parameters(
        [every.index(m) for m in members if m in every], np.zeros(len(every))
    )


def _problem(
    desk: Workbench,
    u: UpdateSection,
    models: Sequence[AtChannels],
    aims: Sequence[Target],
    members: Sequence[str],
) -> Problem:
    return problem_of(desk, [_held(m, members) for m in models], aims, u)


def _verified(
    models: Sequence[AtChannels], members: Sequence[str], done: Solution
) -> tuple[list[AtChannels], float]:
    """The models with their full solutions at the end, and the largest frequency error that they
    had there.
    """
    better, errors, at = [], [], dict(zip(members, done.x.tolist(), strict=True))
    for m in models:
        active = _held(m, members)
        fresh, error = verified(active, np.array([at[n] for n in active.parameters.names]))
        every = m.parameters.names
        better.append(fresh.with_parameters(range(len(every)), np.zeros(len(every))))
        errors.append(error)
    return better, max(errors)


def _errors(aims: Sequence[Target], at: Evaluated) -> tuple[Float, Float, Bool]:
    """Relative frequency errors and MAC (k,) of all pairs of all configurations, and which of them
    are used.
    """
    error, mac, used = [], [], []
    for aim, p in zip(aims, at.points, strict=True):
        test, fe = p.every.T
        error.append(p.now.frequencies[fe] / aim.frequencies[test] - 1)
        mac.append(np.full(p.mac.size, np.nan) if aim.lent else p.mac)
        used.append(aim.used[test])
    return np.concatenate(error), np.concatenate(mac), np.concatenate(used)


def percent(of: Callable[[Float], np.floating[Any]], values: Float, which: Bool) -> float:
    """100 times the mean, or whatever `of` takes, of the sizes of the values that count; NaN of
    none.
    """
    return float(100 * of(np.abs(values[which]))) if which.any() else float("nan")


def spared(aims: Sequence[Target], ends: Sequence[Linearisation]) -> float:
    """Mean |Δf|, %, of the modes left out, paired by the gates: the pairs of the updating drop
    those far off.
    """
    blind = [r.frequency_error[~r.used] for r in map(residual, aims, ends)]
    error = np.concatenate(blind)
    return percent(np.mean, error, np.ones(error.size, dtype=bool))


def summary(problem: Problem, aims: Sequence[Target], name: str, end: Settled) -> SetResult:
    """The updated set as it is compared with others."""
    done, path = end.solution, end.path
    p, told = problem.parameters, [_errors(aims, at) for at in path]
    error, mac, used = told[-1]
    low, high = p.bounds()
    size = np.maximum(np.linalg.norm(done.end.slope, axis=0), 1e-300)
    scaled = done.end.slope / size
    first = float(np.linalg.norm(problem.gradient(path[0]))) or 1.0
    steps = [0.0, *(float(np.abs(b.x - a.x).max(initial=0.0)) for a, b in pairwise(path))]
    return SetResult(
        name,
        p.names,
        done.factors,
        done.std * p.derivative(done.x) / done.factors,
        np.stack([p.factors(low), p.factors(high)], axis=1),
        done.identifiability,
        percent(np.mean, error, used),
        percent(np.max, error, used),
        percent(np.mean, mac, used),
        spared(aims, [p.now for p in done.end.points]),
        float(np.linalg.cond(scaled.T @ scaled)) if size.size else 1.0,
        aicc(whole_cost(problem, done.end), data_count(problem, done.end), done.x.size),
        done.outcome.value,
        np.array([at.cost for at in path]),
        np.array(steps),
        np.array([percent(np.mean, e, u) for e, _, u in told]),
        np.array([percent(np.mean, m, u) for _, m, u in told]),
        np.array([p.factors(at.x) for at in path]),
        float(np.linalg.norm(problem.gradient(done.end))) / first,
        discrepancy=settle.kept(end.problem),
    )
