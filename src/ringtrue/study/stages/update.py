"""The parameter sets worth comparing; each updated, and one chosen.

One parameter set updated over all configurations, on reduced models or by runs of a solver.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.iterate import IterationText, Progress, part, quiet
from ringtrue.core.side_by_side import Workers, side_by_side
from ringtrue.core.testmodel import Observation
from ringtrue.errors import NumericalError
from ringtrue.model.edit import carried, field_value
from ringtrue.model.ports import Linearisation, ModesRequest
from ringtrue.shapes import unit
from ringtrue.solvers.observed import FullModel
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.measured_data import Data
from ringtrue.study.objective import (
    Minimisation,
    course_of_runs,
    data_count,
    data_of,
    further_starts,
    problem_of,
    target,
    terms_of,
)
from ringtrue.study.opened import (
    CLOSE,
    ROUNDS,
    AtChannels,
    frequency_error,
    not_verified,
    verified,
)
from ringtrue.study.results import (
    DataResult,
    FinishedSet,
    LocaliseStage,
    SensitivityStage,
    SetFit,
    SetResult,
    UpdateHistory,
    UpdateStage,
)
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.study.stages.localise import element_regions
from ringtrue.study.store import FinishedSets
from ringtrue.updating import strategy
from ringtrue.updating.identifiability import least_proven, stood_for
from ringtrue.updating.problem import (
    Configuration,
    Evaluated,
    Problem,
    aicc,
    single,
    weighed,
)
from ringtrue.updating.selection import selection_rules
from ringtrue.updating.selection.candidates import elements_of
from ringtrue.updating.selection.screening import of_parameter
from ringtrue.updating.solver import DescentState, Solution
from ringtrue.updating.strategy import Settled, displaced, whole_cost
from ringtrue.updating.target import Target, Weights, match
from ringtrue.updating.validation import misfits

USUAL_RUNS = 60  # of an updating, for the progress that is shown


@dataclass(frozen=True, slots=True, eq=False)
class SetUpdate:
    """The updating of one parameter set: all that it takes, in this process or another.

    Attributes
    ----------
    name : str
        Of the set.
    problem : Problem
        Over its parameters.
    how : Minimisation
    start : (p,) float64, optional
        Where it starts; [update] says where if not given.
    data : tuple of tuple of Data
        What was measured besides the modes of each configuration.
    """

    name: str
    problem: Problem
    how: Minimisation
    start: Float | None = None
    data: tuple[tuple[Data, ...], ...] = ()


def update_reduced(case: SetUpdate, progress: Progress) -> FinishedSet:
    """Update on the reduced models of all configurations until the full ones agree at the end
    point.

    Raises
    ------
    NotConverged
        If a reduced model does not follow its full one.
    """
    problem = case.problem

    def steps(_fraction: float, text: str) -> None:
        progress(0.0, _with_values(text, text, problem))

    how = replace(case.how, steps=steps)
    end = how.run(problem, progress, start=case.start)
    path = list(end.path)
    error = np.inf
    for _ in range(ROUNDS):
        problem, error = _verified(problem, end.solution)
        end = how.run(problem, progress, start=end.solution.y)
        path += end.path[1:]
        if error < CLOSE or _follows(problem, end.solution):
            break
    else:
        raise not_verified(error)
    whole = replace(end, path=tuple(path))
    result = summary(problem, case.name, whole, case.data)
    return FinishedSet(result, displaced(problem, end.solution.end), 0)


def compare_data(
    session: Session, best: SetResult, progress: Progress
) -> tuple[DataResult, ...]:
    """What was measured besides the modes, by the model before and after the updating."""
    factors = best.factors
    out = []
    models = session.updated(best, progress)
    for c, whole in zip(session.configurations, models, strict=True):
        model = over(whole, best.parameters)
        y = model.parameters.vector(factors)
        for m, d in zip(c.measured, data_of(c, model), strict=True):
            one = Configuration(model, target(c), (d.term,))
            before, after = (
                d.shown(d.term(one.at(v, slopes=False))) for v in (0 * y, y)
            )
            out.append(
                DataResult(
                    name=d.name,
                    kind=d.kind,
                    configuration=c.name,
                    labels=d.labels,
                    units=d.units,
                    measured=d.measured,
                    before=before,
                    after=after,
                    error=d.scale,
                    seats=c.seats_of(m),
                )
            )
    return tuple(out)


def other_configurations(
    session: Session, factor: Mapping[str, float], progress: Progress
) -> tuple[Configuration, ...]:
    """The other configurations over the parameters of `factor`, springs as tuned; the pairs of the
    delivered decks.
    """
    out = []
    models = session.delivered_models(progress)[1:]
    for c, model in zip(session.others, models, strict=True):
        active, x = as_delivered(c, model, factor, progress)
        aim = target(c).settled(active.linearise(x))
        out.append(Configuration(active, aim, terms_of(c, active), c.name))
    return tuple(out)


def as_delivered(
    c: StudyConfiguration,
    model: AtChannels,
    factor: Mapping[str, float],
    progress: Progress,
) -> tuple[AtChannels, Float]:
    """The model over those of the parameters that it has, springs as tuned, and x at their factors.

    Solved anew there if its frequencies are not those of the delivered deck.
    """
    every = model.model.system.parameters
    mine = model.parameters.names
    springs = every.take(range(len(mine), len(every)))
    tuned = c.session.get("tune").factors if len(springs) else {}
    held = springs.vector(tuned)
    base = np.concatenate([np.zeros(len(mine)), held])
    active = model.with_parameters([mine.index(m) for m in factor if m in mine], base)
    x = active.parameters.vector(factor)
    if (
        frequency_error(active.modes(x).frequencies, c.final.observed.frequencies)
        >= CLOSE
    ):
        progress(0.9, "modes at the updated point")
        active, _ = active.enrich(x)
    return active, x


def over(model: AtChannels, members: Sequence[str]) -> AtChannels:
    """The model over those of the parameters that it has, all others as in the deck."""
    every = model.parameters.names
    return model.with_parameters(
        [every.index(m) for m in members if m in every], np.zeros(len(every))
    )


def _verified(problem: Problem, done: Solution) -> tuple[Problem, float]:
    """The problem on models that hold their full solutions at the end, and the largest frequency
    error that they had there.
    """
    better = []
    errors = []
    for c, model, x in _at_end(problem, done):
        fresh, error = verified(model, x)
        better.append(replace(c, model=fresh))
        errors.append(error)
    return replace(problem, configurations=tuple(better)), max(errors)


def _follows(problem: Problem, done: Solution) -> bool:
    """Whether the residuals of all models, that hold full solutions near the end, show no error
    there. Flexibility is not estimated: a model with loaded channels is solved anew.

    The nominal stiffness stands for that at the end, which is at least as large times the cube of
    the lowest factor: bending goes with the cube of a thickness.
    """
    for _, model, x in _at_end(problem, done):
        lowest = float(model.parameters.factors(x).min(initial=1.0)) ** 3
        if model.loaded.size or model.model.error(x) >= CLOSE * lowest:
            return False
    return True


def _at_end(
    problem: Problem, done: Solution
) -> Iterator[tuple[Configuration, AtChannels, Float]]:
    """Configurations, their models, and x of these at the end."""
    for c in problem.configurations:
        assert isinstance(c.model, AtChannels)
        yield c, c.model, done.x[problem.positions(c)]


def _errors(aims: Sequence[Target], at: Evaluated) -> tuple[Float, Float, Bool]:
    """Relative frequency errors and MAC (k,) of all pairs of all configurations, and which of them
    are used.
    """
    error = []
    mac = []
    used = []
    for aim, p in zip(aims, at.points, strict=True):
        test, fe = p.every.T
        error.append(p.now.frequencies[fe] / aim.frequencies[test] - 1)
        mac.append(np.full(p.mac.size, np.nan) if aim.frequency_only else p.mac)
        used.append(aim.used[test])
    return np.concatenate(error), np.concatenate(mac), np.concatenate(used)


def percent(
    of: Callable[[Float], np.floating[Any]], values: Float, which: Bool
) -> float:
    """100 times the mean, or whatever `of` takes, of the sizes of the values that count; NaN of
    none.
    """
    return float(100 * of(np.abs(values[which]))) if which.any() else float("nan")


def left_out_deviation(aims: Sequence[Target], ends: Sequence[Linearisation]) -> float:
    """Mean |Δf|, %, of the modes left out, paired by the gates: the pairs of the updating drop
    those far off.
    """
    errors = []
    for aim, now in zip(aims, ends, strict=True):
        test, fe = match(aim, now)[0].T
        error = now.frequencies[fe] / aim.frequencies[test] - 1
        errors.append(error[~aim.used[test]])
    error = np.concatenate(errors)
    return percent(np.mean, error, np.ones(error.size, dtype=bool))


def summary(
    problem: Problem, name: str, end: Settled, data: Sequence[Sequence[Data]] = ()
) -> SetResult:
    """The updated set as it is compared with others; `data` is what was measured besides the modes
    of each configuration.
    """
    aims = [c.target for c in problem.configurations]
    done = end.solution
    path = end.path
    p = problem.parameters
    errors = [_errors(aims, at) for at in path]
    error, mac, used = errors[-1]
    low, high = p.bounds()
    size = np.maximum(np.linalg.norm(done.end.slope, axis=0), 1e-300)
    scaled = done.end.slope / size
    first = float(np.linalg.norm(problem.gradient(path[0]))) or 1.0
    steps = [
        0.0,
        *(float(np.abs(b.x - a.x).max(initial=0.0)) for a, b in pairwise(path)),
    ]
    cost = whole_cost(problem, done.end)
    found = strategy.kept(end.problem)
    fit = SetFit(
        mean_deviation=percent(np.mean, error, used),
        max_deviation=percent(np.max, error, used),
        mean_subspace_mac=percent(np.mean, mac, used),
        mean_deviation_left_out=left_out_deviation(
            aims, [p.now for p in done.end.points]
        ),
        condition=float(np.linalg.cond(scaled.T @ scaled)) if size.size else 1.0,
        criterion=aicc(cost, data_count(problem, done.end), done.x.size),
        misfits=misfits(weighed(problem, _at_least(problem, found)), done.end, data),
    )
    history = UpdateHistory(
        objective=np.array([at.cost for at in path]),
        step=np.array(steps),
        deviation=np.array([percent(np.mean, e, u) for e, _, u in errors]),
        subspace_mac=np.array([percent(np.mean, m, u) for _, m, u in errors]),
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
        discrepancy=found,
    )


def _at_least(problem: Problem, found: Float) -> Weights:
    """The errors of frequencies and 1 − MAC that the study states, or those found (2,) where these
    are larger: what is known of the form of the model is no misfit. `DISCREPANCY.loose` limits it.
    """
    stated = problem.configurations[0].target.weights
    frequency, mac = np.fmax(found, (stated.frequency, stated.mac)).tolist()
    return replace(stated, frequency=frequency, mac=mac)


def _with_values(words: str, text: str, problem: Problem) -> str:
    """Words of an iteration that carry J and the factors there."""
    state = text.state if isinstance(text, IterationText) else None
    if not isinstance(state, DescentState):
        return words
    said = IterationText(words)
    factors = problem.parameters.factors(state.at.x).tolist()
    said.values = {
        "J": state.at.cost,
        **dict(zip(problem.parameters.names, factors, strict=True)),
    }
    return said


def update_by_runs(case: SetUpdate, progress: Progress) -> FinishedSet:
    """Update on the full decks of all configurations. A run that fails at a trial point is a
    rejected step.

    Raises
    ------
    SolverError
        If the solver is missing, or fails at the start.
    """
    problem = case.problem
    models = [c.model for c in problem.configurations if isinstance(c.model, FullModel)]

    def steps(_fraction: float, text: str) -> None:
        runs = sum(m.ledger.runs for m in models)
        done = runs / (runs + USUAL_RUNS)
        words = f"{case.name}: {text}, {runs} runs of {models[0].solver.name}"
        progress(done, _with_values(words, text, problem))

    how = replace(case.how, course=course_of_runs(case.how.settings), steps=steps)
    end = how.run(problem, progress)
    return FinishedSet(
        summary(problem, case.name, end), 0, sum(m.ledger.runs for m in models)
    )


def _full(c: StudyConfiguration, members: Sequence[str]) -> FullModel:
    """A deck over those of the parameters that it has, at the channels of its test, with all its
    modes up to fmax.
    """
    engine = c.session.engine
    assert engine is not None
    opened = c.deck
    look = c.observed(opened)
    mine = carried(opened.model, c.session.chosen(members))
    channels = c.reference.elastic.channels
    rows = np.array([look.channels.index(n) for n in channels], dtype=np.int64)
    with engine.open(opened.model) as analysis:
        at, sign = look.dofs.align(analysis.dofs)
        matrix = sparse.csr_array(look.matrix[rows][:, at] * sign)
        seen = Observation(
            matrix, channels, analysis.dofs, look.unit, look.distance[rows]
        )
    count = len(opened.modes(c.session.fmax).modes)
    return FullModel(opened.model, mine, seen, ModesRequest(max(count, 1)), engine)


_log = logging.getLogger(__name__)

RULES = selection_rules.RULES | {
    "proposal": "the ranked proposal of the localisation: from all candidates at once the least "
    "useful are left out, "
    "the rest exchanged while J falls; as many as AICc supports"
}

ALL_CONFIGURATIONS = "; of the tests of all configurations"
WHY = (
    "{name}: the lowest AICc ({value:.1f}); it weighs the fit of the used modes, those that lost "
    "their partner among "
    "them, against the number of parameters and does not look at the modes left out"
)
OTHER = "; sets that weigh the data otherwise are shown and not chosen from: their J is another"
ALL_TESTS = "; all figures are over the tests of all configurations"


def _sets(
    session: Session, model: AtChannels, progress: Progress
) -> tuple[dict[str, Int], Float]:
    """Parameter sets by their rule, and the weighted sensitivities (r, p) that the simple ones come
    from.
    """
    names = model.parameters.names
    count = min(session.config.update.choose, len(names))
    if session.config.joint:
        problem = problem_of(session, session.models(progress))
    else:
        problem = single(model, target(session.own))
    weighted = selection_rules.weighted_sensitivities(problem)
    out: dict[str, Int] = {}
    if session.config.propose:
        out["proposal"] = np.array(
            [names.index(n) for n in _proposed(session)], dtype=np.int64
        )
    if not len(session.config.candidates()):
        # those made from the deck may scale the same field: the proposal alone respects that
        return out, weighted
    orthogonal = selection_rules.orthogonal(weighted, count)
    largest = selection_rules.largest(weighted, count)
    progress(0.0, "choosing parameters")
    out["best subset"] = selection_rules.best_subset(problem, count, progress).members
    out |= {"orthogonal sensitivities": orthogonal, "largest sensitivities": largest}
    for s in session.config.set:
        out[s.name] = np.array([names.index(n) for n in s.candidates or names])
    return out, weighted


def _rules(session: Session, sets: Mapping[str, Int]) -> dict[str, str]:
    """How each set was chosen, in words."""
    named = {s.name: s for s in session.config.set}
    out = {}
    for rule in sets:
        if rule in named:
            own = named[rule].words()
            out[rule] = "named in the study" + (f"; {own}" if own else "")
        else:
            out[rule] = RULES[rule] + (ALL_CONFIGURATIONS if session.others else "")
    return out


def mac_slope(psi: Float, point: Linearisation, fe: int) -> Float:
    """∂MAC/∂x of a test shape psi (channel,) with FE mode `fe`, (p,)."""
    phi = point.shapes[:, fe]
    d = point.d_shapes[:, fe]
    a = unit(psi[:, None])[:, 0]
    size = phi @ phi
    cross = float(a @ phi)
    return 2 * cross * (a @ d) / size - 2 * cross**2 * (phi @ d) / size**2


def _proposed(session: Session) -> dict[str, float]:
    """The proposed parameters with their factors; none where no change pays, and the deck stays as
    it is.
    """
    found: LocaliseStage | None = session.get("localise")
    if found is None:
        return {}
    return {m.name: m.factor for m in found.proposal.members}


def choose_sets(session: Session, progress: Progress) -> SensitivityStage:
    """Linearise at the remodelled deck and choose sets by three rules.

    Raises
    ------
    ConfigError
        If [update] stages or a [[constraint]] names what is no candidate that was made from the
        deck.
    """
    names = session.parameters.names
    known = names
    if not len(session.config.candidates()) and session.config.propose:
        # made from the deck, too, but the data do not ask for them: they stay at nominal
        pool = session.get("localise").pool
        known = (*names, *pool.screened, *pool.dropped, *pool.held)
    session.config.check_names(known)
    aim = target(session.own)
    model = session.own.model(part(progress, 0.0, 0.6))
    point = model.linearise(np.zeros(len(names)))
    pairs, _, _ = match(aim, point)
    fe = pairs[:, 1]
    lam = (2 * np.pi * point.frequencies[fe]) ** 2
    seen = [] if aim.frequency_only else pairs.tolist()
    d_mac = np.array([mac_slope(aim.shapes[:, t], point, f) for t, f in seen])
    members, weighted = _sets(session, model, part(progress, 0.6, 1.0))
    first = list(_proposed(session))
    held = {}
    sets = {}
    for rule, at in members.items():
        mine = [names[i] for i in at.tolist()]
        held[rule] = stood_for(weighted[:, at], mine, first)
        sets[rule] = tuple(n for n in mine if n not in held[rule])
    return SensitivityStage(
        names=names,
        d_frequency=0.5 * point.d_lambda[fe] / lam[:, None],
        d_mac=d_mac.reshape(-1, len(names)),
        fe_modes=fe,
        sets=sets,
        rules=_rules(session, members),
        clusters=selection_rules.collinear_pairs(weighted, names),
        held={rule: found for rule, found in held.items() if found},
    )


def _updated(
    session: Session, sets: Mapping[str, Sequence[str]], progress: Progress
) -> Iterator[FinishedSet]:
    """Sets of parameters updated, side by side where there are workers; a single one has these for
    its starts.
    """
    if not sets:
        return
    named = {s.name: s for s in session.config.set}
    workers = session.config.study.workers
    # the runs of a solver are counted where they are started
    one_by_one = len(sets) > 1 or session.engine is not None
    models = session.models(progress) if session.engine is None else ()
    cases = {}
    for name, members in sets.items():
        u = session.config.update
        u = named[name].settings(u) if name in named else u
        of_starts = 1 if one_by_one else workers
        cases[f"updating: {name}"] = _case(session, name, members, u, workers=of_starts)
    if session.engine is not None:
        yield from side_by_side(update_by_runs, cases, workers, progress)
        return
    shared = [
        large
        for m in models
        for large in (m.model.system, m.model.basis, m.model.pencil)
    ]
    yield from side_by_side(update_reduced, cases, workers, progress, shared)


def _case(
    session: Session,
    name: str,
    members: Sequence[str],
    u: UpdateSection,
    factors: Mapping[str, float] | None = None,
    workers: Workers = 1,
) -> SetUpdate:
    """A set of parameters to be updated, on reduced models or by runs of a solver; starts are
    spread over the workers.
    """
    if session.engine is not None:
        problem = problem_of(
            session, [_full(c, members) for c in session.configurations], u
        )
        data: tuple[tuple[Data, ...], ...] = ()
    else:
        models = [over(m, members) for m in session.models(quiet)]
        problem = problem_of(session, models, u)
        data = tuple(
            data_of(c, m) for c, m in zip(session.configurations, models, strict=True)
        )
    y = None if factors is None else session.chosen(members).vector(factors)
    how = Minimisation(u, session.config.study.seed, workers=workers)
    return SetUpdate(name, problem, how, start=y, data=data)


def update_sets(session: Session, progress: Progress) -> UpdateStage:
    """Update every set, verify each by a full solution, choose by the information criterion."""
    members: dict[str, tuple[str, ...]] = session.get("sensitivity").sets
    named = {s.name: s for s in session.config.set}
    kept = FinishedSets.of(session.out, session.keys["update"])
    first = {}  # of the sets with the same parameters, unless they weigh data otherwise
    plain: dict[frozenset[str], str] = {}
    for name, some in members.items():
        otherwise = name in named and named[name].own()
        first[name] = name if otherwise else plain.setdefault(frozenset(some), name)
    found = {n: done for n in first.values() if (done := kept.get(n)) is not None}
    todo = {n: members[n] for n in first.values() if n not in found}
    for name, fresh in zip(todo, _updated(session, todo, progress), strict=True):
        found[name] = kept.put(name, fresh)
    results: dict[str, SetResult] = {}
    runs = 0
    lost: dict[str, int] = {}  # used modes without partner that the model has
    for i, (name, same) in enumerate(first.items()):
        if same != name:  # two rules, one choice
            progress(i / len(first), f"updating: {name}, as {same}")
            results[name] = replace(results[same], name=name)
            continue
        done = found[name]
        words = named[name].words() if name in named else ""
        results[name] = replace(done.result, settings=words)
        runs += done.runs
        lost[name] = done.lost
    own = session.config.update
    sets = list(results.values())
    comparable = [r.name not in named or named[r.name].comparable(own) for r in sets]
    chosen = _lowest_criterion(sets, comparable)
    if sets[chosen].parameters and lost.get(sets[chosen].name):
        sets = _with_further_starts(session, sets, chosen, progress)
        chosen = _lowest_criterion(sets, comparable)
    kept.clear()
    named_set = named.get(sets[chosen].name)
    u = named_set.settings(own) if named_set else own
    sets[chosen] = best = _only_proven(
        session, sets[chosen], part(progress, 0.95, 1.0), u
    )
    why = WHY.format(name=best.name, value=best.fit.criterion)
    why += ALL_TESTS if session.others else ""
    why += "" if all(comparable) else OTHER
    return UpdateStage(
        sets=tuple(sets),
        chosen=chosen,
        why=why,
        initial_values=_field_values(session, best, np.ones(len(best.parameters))),
        updated_values=_field_values(session, best, best.factor),
        regions={n: regions(session, n) for n in best.parameters},
        data=compare_data(session, best, progress) if session.config.residual else (),
        solver=session.deck.solver,
        runs=runs,
    )


def _only_proven(
    session: Session, best: SetResult, progress: Progress, u: UpdateSection
) -> SetResult:
    """The set with a factor of 1 for each parameter whose interval holds it, the others fitted
    anew: the least proven one first, until all that are left are proven.
    """
    while u.write == "proven":
        free = np.flatnonzero(best.factor != 1.0)
        members = [best.parameters[i] for i in free.tolist()]
        chosen = session.chosen(members)
        x = chosen.vector(best.factor[free])
        std = best.std[free] * best.factor[free] / chosen.derivative(x)
        weakest = least_proven(x, std, session.config.uncertainty.level)
        if weakest is None:
            break
        rest = np.delete(free, weakest)
        factor = np.ones(best.factor.size)
        if not rest.size:
            return replace(best, factor=factor)
        members = [best.parameters[i] for i in rest.tolist()]
        if session.engine is None:
            start = dict(zip(members, best.factor[rest].tolist(), strict=True))
            case = _case(session, best.name, members, u, start)
            again = update_reduced(case, progress).result
        else:
            again = update_by_runs(
                _case(session, best.name, members, u), progress
            ).result
        factor[rest] = again.factor
        spread = best.std.copy()
        spread[rest] = again.std
        known = best.identifiability.copy()
        known[rest] = again.identifiability
        path = np.ones((len(again.history.path), factor.size))
        path[:, rest] = again.history.path
        best = replace(
            again,
            parameters=best.parameters,
            factor=factor,
            std=spread,
            bounds=best.bounds,
            identifiability=known,
            history=replace(again.history, path=path),
            settings=best.settings,
        )
    return best


def _field_values(session: Session, best: SetResult, factor: Float) -> dict[str, float]:
    """The first target's value of each parameter at the factors."""
    out = {}
    model = session.remodelled.model
    for p, a in zip(
        session.chosen(best.parameters).parameters, factor.tolist(), strict=True
    ):
        field = p.targets[0]
        out[p.name] = float(field_value(model, field)) * a + field.step * (a - 1)
    return out


def regions(session: Session, name: str) -> tuple[int, ...]:
    """Groups of the scene that a parameter changes: those of the elements that use what it
    targets.
    """
    model = session.remodelled.model
    parameter = session.chosen([name]).parameters[0]
    mine = np.isin(elements_of(model), of_parameter(model, parameter).elements)
    labels = element_regions(model, session.deck.regions)
    touched = {name, *(labels[i] for i in np.flatnonzero(mine).tolist())}
    groups = session.get("model").scene.groups
    return tuple(i for i, g in enumerate(groups) if g in touched)


def _lowest_criterion(results: Sequence[SetResult], comparable: Sequence[bool]) -> int:
    """The set of lowest AICc among those that weigh the data as the study does."""
    criteria = [
        r.fit.criterion if good else np.inf
        for r, good in zip(results, comparable, strict=True)
    ]
    return int(np.argmin(criteria))


def _with_further_starts(
    session: Session, results: list[SetResult], chosen: int, progress: Progress
) -> list[SetResult]:
    """The sets, the one to be chosen from further starts as well where these end in a lower J.

    One is where the proposal was found: its search has left minima in which the way from the deck
    may end.
    """
    best = results[chosen]
    own = session.config.update
    more = further_starts(own)
    at = _proposed(session)
    starts: list[tuple[str, UpdateSection, dict[str, float] | None]] = []
    if set(at) == set(best.parameters):
        starts.append(("from the proposal", own, at))
    if more is not None:
        starts.append(("further starts", more, None))
    workers = session.config.study.workers
    for what, u, factors in starts:
        progress(0.9, f"{best.name}: modes without partner, {what}")
        name = f"{best.name}, {what}"
        case = _case(session, name, best.parameters, u, factors, workers=workers)
        try:
            done = update_reduced(case, progress)
        except NumericalError as e:  # the end from the deck stands
            _log.info("%s: %s", name, e)
            continue
        if done.result.fit.criterion < best.fit.criterion:
            best = replace(done.result, name=best.name)
    return [
        replace(best, name=r.name)
        if r.parameters == best.parameters and not r.settings
        else r
        for r in results
    ]
