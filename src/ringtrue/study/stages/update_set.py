"""One parameter set updated over all configurations, on reduced models or by runs of a solver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import Observation
from ringtrue.model.edit import carried
from ringtrue.model.ports import Linearisation, ModesRequest
from ringtrue.solvers.observed import PRINTED, UNTOLD, FullModel
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.objective import (
    course_of,
    data_count,
    data_of,
    minimise,
    names_of,
    problem_of,
    targets,
    terms_of,
)
from ringtrue.study.opened import CLOSE, ROUNDS, AtChannels, frequency_error, not_verified, verified
from ringtrue.study.results import ConfiguredStage, DataResult, SetFit, SetResult, UpdateHistory
from ringtrue.study.session import Session
from ringtrue.updating import strategy
from ringtrue.updating.gauss_newton import aicc, residual
from ringtrue.updating.problem import Configuration, Evaluated, Problem
from ringtrue.updating.solver import Solution
from ringtrue.updating.strategy import Settled, displaced, whole_cost
from ringtrue.updating.target import Target


def update_reduced(
    session: Session,
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
    u = u or session.config.update
    models, aims = [session.candidates(progress), *session.others(progress)], targets(session, u)
    start: Float | None = None
    if factors is not None:
        mine = session.parameters.take([session.parameters.names.index(m) for m in members])
        start = mine.vector(np.array([factors[m] for m in members]))
    path: list[Evaluated] = []
    error = np.inf
    for _ in range(ROUNDS):
        end = minimise(
            _problem(session, u, models, aims, members),
            u,
            session.config.study.seed,
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
    problem = _problem(session, u, models, aims, members)
    end = minimise(problem, u, session.config.study.seed, progress, start=start)
    return summary(problem, aims, name, replace(end, path=(*path, *end.path[1:]))), displaced(
        problem, end.solution.end
    )


def compare_data(session: Session, best: SetResult, progress: Progress) -> tuple[DataResult, ...]:
    """What was measured beside the modes, by the model before and after the updating."""
    models = [_over(m, best.parameters) for m in session.updated(best, progress)]
    x = session.parameters.take(
        [session.parameters.names.index(n) for n in best.parameters]
    ).vector(best.factor)
    at = dict(zip(best.parameters, x.tolist(), strict=True))
    out = []
    for name, model, aim in zip(names_of(session), models, targets(session), strict=True):
        y = np.array([at[n] for n in model.parameters.names])
        for m, d in zip(session.measured(name), data_of(session, name, model), strict=True):
            one = Configuration(model, aim, (d.term,))
            before, after = (d.shown(d.term(one.at(v, slopes=False))) for v in (0 * y, y))
            places = session.seats_beside(name, m)
            out.append(
                DataResult(
                    name=d.name,
                    kind=d.kind,
                    configuration=name,
                    labels=d.labels,
                    units=d.units,
                    measured=d.measured,
                    before=before,
                    after=after,
                    error=d.scale,
                    seats=places,
                )
            )
    return tuple(out)


def other_configurations(
    session: Session, best: SetResult, progress: Progress
) -> tuple[Configuration, ...]:
    """The other configurations over the parameters of a set, springs as tuned; the pairs of the
    delivered decks.
    """
    if not session.config.configuration:
        return ()
    delivered: ConfiguredStage = session.get("configured")
    factor = dict(zip(best.parameters, best.factor.tolist(), strict=True))
    out = []
    for model, aim, done in zip(
        session.delivered_models(progress)[1:], targets(session)[1:], delivered.items, strict=True
    ):
        active, x = as_delivered(session, model, factor, done.observed.frequencies, progress)
        terms = terms_of(session, done.name, active, session.config.update)
        out.append(Configuration(active, aim.settled(active.linearise(x)), terms, done.name))
    return tuple(out)


def as_delivered(
    session: Session,
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
    tuned = session.get("tune").factors if len(springs) else {}
    base = np.concatenate(
        [np.zeros(len(mine)), springs.vector(np.array([tuned[n] for n in springs.names]))]
    )
    active = model.with_parameters([mine.index(m) for m in factor if m in mine], base)
    x = active.parameters.vector(np.array([factor[n] for n in active.parameters.names]))
    if frequency_error(active.modes(x).frequencies, truth) >= CLOSE:
        progress(0.9, "modes at the updated point")
        active, _ = active.enrich(x)
    return active, x


def _over(model: AtChannels, members: Sequence[str]) -> AtChannels:
    """The model over those of the parameters that it has."""
    every = model.parameters.names
    return model.with_parameters(
        [every.index(m) for m in members if m in every], np.zeros(len(every))
    )


def _problem(
    session: Session,
    u: UpdateSection,
    models: Sequence[AtChannels],
    aims: Sequence[Target],
    members: Sequence[str],
) -> Problem:
    return problem_of(session, [_over(m, members) for m in models], aims, u)


def _verified(
    models: Sequence[AtChannels], members: Sequence[str], done: Solution
) -> tuple[list[AtChannels], float]:
    """The models with their full solutions at the end, and the largest frequency error that they
    had there.
    """
    better, errors, at = [], [], dict(zip(members, done.x.tolist(), strict=True))
    for m in models:
        active = _over(m, members)
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


def left_out_deviation(aims: Sequence[Target], ends: Sequence[Linearisation]) -> float:
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
    fit = SetFit(
        mean_deviation=percent(np.mean, error, used),
        max_deviation=percent(np.max, error, used),
        mean_subspace_mac=percent(np.mean, mac, used),
        mean_deviation_left_out=left_out_deviation(aims, [p.now for p in done.end.points]),
        condition=float(np.linalg.cond(scaled.T @ scaled)) if size.size else 1.0,
        criterion=aicc(whole_cost(problem, done.end), data_count(problem, done.end), done.x.size),
    )
    history = UpdateHistory(
        objective=np.array([at.cost for at in path]),
        step=np.array(steps),
        deviation=np.array([percent(np.mean, e, u) for e, _, u in told]),
        subspace_mac=np.array([percent(np.mean, m, u) for _, m, u in told]),
        path=np.array([p.factors(at.x) for at in path]),
        gradient=float(np.linalg.norm(problem.gradient(done.end))) / first,
    )
    return SetResult(
        name=name,
        parameters=p.names,
        factor=done.factors,
        std=done.std * p.derivative(done.x) / done.factors,
        bounds=np.stack([p.factors(low), p.factors(high)], axis=1),
        identifiability=done.identifiability,
        fit=fit,
        outcome=done.outcome,
        history=history,
        discrepancy=strategy.kept(end.problem),
    )


USUAL = 60  # runs of an updating, for the progress that is shown


def update_by_runs(
    session: Session,
    name: str,
    members: Sequence[str],
    progress: Progress,
    u: UpdateSection | None = None,
) -> tuple[SetResult, int]:
    """Update on the full decks of all configurations; the result, and how many runs it took.

    `u` stands in for the [update] of the study. A run that fails at a trial point is a rejected
    step.

    Raises
    ------
    SolverError
        If the solver is missing, or fails at the start.
    """
    u = u or session.config.update
    aims = targets(session, u)
    models = [_full(session, n, members) for n in names_of(session)]
    problem = problem_of(session, models, aims, u)

    def told(_fraction: float, text: str) -> None:
        runs = sum(m.ledger.runs for m in models)
        progress(runs / (runs + USUAL), f"{name}: {text}, {runs} runs of {session.deck.solver}")

    course = course_of(u)
    course = replace(course, method=replace(course.method, step=PRINTED, gradient=UNTOLD))
    end = minimise(problem, u, session.config.study.seed, progress, course=course, told=told)
    return summary(problem, aims, name, end), sum(m.ledger.runs for m in models)


def _full(session: Session, name: str, members: Sequence[str]) -> FullModel:
    """A deck over those of the parameters that it has, at the channels of its test, with all its
    modes up to fmax.
    """
    assert session.engine is not None
    opened, look = session.deck_of(name)
    names = session.parameters.names
    mine = carried(opened.model, session.parameters.take([names.index(m) for m in members]))
    channels = session.reference(name).channels
    rows = np.array([look.channels.index(c) for c in channels], dtype=np.int64)
    with session.engine.open(opened.model) as analysis:
        at, sign = look.dofs.align(analysis.dofs)
        matrix = sparse.csr_array(look.matrix[rows][:, at] * sign)
        seen = Observation(matrix, channels, analysis.dofs, look.unit, look.distance[rows])
    count = len(opened.modes(session.fmax).modes)
    return FullModel(opened.model, mine, seen, ModesRequest(max(count, 1)), session.engine)
