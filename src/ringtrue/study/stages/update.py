"""The parameter sets worth comparing; each updated, and one chosen."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.progress import Progress, part
from ringtrue.errors import NumericalError
from ringtrue.model.edit import field_value
from ringtrue.model.ports import Linearisation
from ringtrue.shapes.mac import unit
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.objective import further_starts, problem_of, target, targets
from ringtrue.study.opened import AtChannels
from ringtrue.study.results import (
    CorrelateStage,
    FinishedSet,
    LocaliseStage,
    SensitivityStage,
    SetResult,
    UpdateStage,
)
from ringtrue.study.session import Session
from ringtrue.study.stages.localise import element_regions
from ringtrue.study.stages.update_set import compare_data, update_by_runs, update_reduced
from ringtrue.study.store import FinishedSets
from ringtrue.updating.identifiability import stood_for, unmoved
from ringtrue.updating.selection import selection_rules
from ringtrue.updating.selection.candidates import elements_of
from ringtrue.updating.selection.screening import of_parameter
from ringtrue.updating.target import match

RULES = selection_rules.RULES | {
    "proposal": "the ranked proposal of the localisation: from all candidates at once the least "
    "useful are left out, "
    "the rest exchanged while J falls; as many as AICc supports"
}

ALL_CONFIGURATIONS = "; of the tests of all configurations"


def _sets(session: Session, model: AtChannels, progress: Progress) -> tuple[dict[str, Int], Float]:
    """Parameter sets by their rule, and the weighted sensitivities (r, p) that the simple ones come
    from.
    """
    names, count = model.parameters.names, min(session.config.update.choose, len(model.parameters))
    several = None
    if session.config.joint:
        several = problem_of(
            session, (model, *session.others(progress)), targets(session), session.config.update
        )
    if several is None:
        weighted = selection_rules.weighted_sensitivities(model, target(session))
    else:
        weighted = several.evaluate(np.zeros(len(names))).slope * several.parameters.std()
    out: dict[str, Int] = {}
    if session.config.propose:
        out["proposal"] = np.array([names.index(n) for n in proposed(session)], dtype=np.int64)
    if not len(
        session.config.candidates()
    ):  # those made from the deck may scale the same field: the proposal knows
        return out, weighted
    orthogonal, largest = (
        selection_rules.orthogonal(weighted, count),
        selection_rules.largest(weighted, count),
    )
    progress(0.0, "choosing parameters")
    if several is None:
        out["best subset"] = selection_rules.best_subset(
            model, target(session), count, progress
        ).members
    else:
        out["best subset"] = selection_rules.joint_subset(
            several, count, (orthogonal, largest), progress
        ).members
    out |= {"orthogonal sensitivities": orthogonal, "largest sensitivities": largest}
    named = {
        s.name: np.array([names.index(n) for n in s.candidates or names])
        for s in session.config.set
    }
    return out | named, weighted


def _not_told_apart(
    session: Session, weighted: Float, names: Sequence[str], members: Int
) -> dict[str, tuple[str, ...]]:
    """Members of a set that are held at the deck's values, with those that stand for them.

    Those of the proposal stand for others, then those of the largest effect.
    """
    found: LocaliseStage | None = session.get("localise")
    first = [m.name for m in found.proposal.members] if found is not None else []
    return stood_for(weighted[:, members], [names[i] for i in members.tolist()], first)


def _rules(session: Session, sets: Mapping[str, Int]) -> dict[str, str]:
    """How each set was chosen, in words."""
    several = session.config.configuration
    out = {
        s.name: "named in the study" + (f"; {s.words()}" if s.own() else "")
        for s in session.config.set
    }
    made = {
        rule: RULES[rule] + (ALL_CONFIGURATIONS if several else "")
        for rule in sets
        if rule not in out
    }
    return made | out


def mac_slope(psi: Float, point: Linearisation, fe: int) -> Float:
    """∂MAC/∂x of a test shape psi (channel,) with FE mode `fe`, (p,)."""
    phi, d = point.shapes[:, fe], point.d_shapes[:, fe]
    a = unit(psi[:, None])[:, 0]
    size = phi @ phi
    cross = float(a @ phi)
    return np.asarray(2 * cross * (a @ d) / size - 2 * cross**2 * (phi @ d) / size**2)


def proposed(session: Session) -> tuple[str, ...]:
    """Names of the proposed parameters; none where no change pays, and the deck stays as it is."""
    found: LocaliseStage = session.get("localise")
    return tuple(m.name for m in found.proposal.members)


def _known(session: Session) -> tuple[str, ...]:
    """All candidates; also those made from the deck that the data do not ask for, which stay at
    nominal.
    """
    names = session.parameters.names
    if len(session.config.candidates()) or not session.config.propose:
        return names
    found: LocaliseStage = session.get("localise")
    return (*names, *found.pool.screened, *found.pool.dropped, *found.pool.held)


def choose_sets(session: Session, progress: Progress) -> SensitivityStage:
    """Linearise at the remodelled deck and choose sets by three rules.

    Raises
    ------
    ConfigError
        If [update] stages or a [[constraint]] names what is no candidate that was made from the
        deck.
    """
    session.config.check_names(_known(session))
    aim = target(session)
    model = session.candidates(part(progress, 0.0, 0.6))
    names = model.parameters.names
    point = model.linearise(np.zeros(len(names)))
    pairs, _, _ = match(aim, point)
    fe = pairs[:, 1]
    lam = (2 * np.pi * point.frequencies[fe]) ** 2
    d_mac = np.array(
        [mac_slope(aim.shapes[:, t], point, f) for t, f in pairs.tolist() if not aim.lent]
    )
    members, weighted = _sets(session, model, part(progress, 0.6, 1.0))
    held = {rule: _not_told_apart(session, weighted, names, at) for rule, at in members.items()}
    members = {
        rule: at[[names[i] not in held[rule] for i in at.tolist()]] for rule, at in members.items()
    }
    return SensitivityStage(
        names=names,
        d_frequency=0.5 * point.d_lambda[fe] / lam[:, None],
        d_mac=d_mac.reshape(-1, len(names)),
        fe_modes=fe,
        sets={rule: tuple(names[i] for i in at.tolist()) for rule, at in members.items()},
        rules=_rules(session, members),
        clusters=selection_rules.alike(weighted, names),
        held={rule: found for rule, found in held.items() if found},
    )


_log = logging.getLogger(__name__)

WHY = (
    "{name}: the lowest AICc ({value:.1f}); it weighs the fit of the used modes, those that lost "
    "their partner among "
    "them, against the number of parameters and does not look at the modes left out"
)
OTHER = "; sets that weigh the data otherwise are shown and not chosen from: their J is another"
ALL_TESTS = "; all figures are over the tests of all configurations"


def update_sets(session: Session, progress: Progress) -> UpdateStage:
    """Update every set, verify each by a full solution, choose by the information criterion."""
    sets: SensitivityStage = session.get("sensitivity")
    found: CorrelateStage = session.get("correlate")
    named = {s.name: s for s in session.config.set}
    kept, results, runs = FinishedSets.of(session.out, session.keys["update"]), list[SetResult](), 0
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
            asked = named[name].settings(session.config.update) if own else None
            done = kept.put(name, _updated_set(session, name, members, told, asked))
        results.append(replace(done.result, settings=named[name].words() if own else ""))
        runs += done.runs
        lost[name] = done.lost
    alike = [
        r.name not in named or named[r.name].comparable(session.config.update) for r in results
    ]
    chosen = _lowest_criterion(results, alike)
    if results[chosen].parameters and lost.get(results[chosen].name):
        results = _with_further_starts(session, results, chosen, progress)
        chosen = _lowest_criterion(results, alike)
    kept.clear()
    results[chosen] = best = _without_unmoved(session, results[chosen])
    parameters = session.parameters.take([sets.names.index(n) for n in best.parameters])
    before = dict(
        zip(best.parameters, _field_values(session, best, np.ones(len(parameters))), strict=True)
    )
    after = dict(zip(best.parameters, _field_values(session, best, best.factor), strict=True))
    return UpdateStage(
        sets=tuple(results),
        chosen=chosen,
        why=WHY.format(name=best.name, value=best.fit.criterion)
        + (ALL_TESTS if session.config.configuration else "")
        + ("" if all(alike) else OTHER),
        left_out=found.left_out,
        initial_values=before,
        updated_values=after,
        regions={n: regions(session, n) for n in best.parameters},
        data=compare_data(session, best, progress) if session.config.residual else (),
        solver=session.deck.solver,
        runs=runs,
    )


def _updated_set(
    session: Session,
    name: str,
    members: Sequence[str],
    progress: Progress,
    asked: UpdateSection | None,
) -> FinishedSet:
    """A set updated on the reduced models, or by runs of another solver."""
    if session.engine is not None:
        result, runs = update_by_runs(session, name, members, progress, asked)
        return FinishedSet(result, 0, runs)
    result, lost = update_reduced(session, name, members, progress, asked)
    return FinishedSet(result, lost, 0)


def _without_unmoved(session: Session, best: SetResult) -> SetResult:
    """The set with a factor of 1 for what has not changed beyond its own error and moves no mode:
    it is not written.
    """
    names, sets = session.parameters.names, session.get("sensitivity")
    at = [names.index(n) for n in best.parameters]
    x = session.parameters.take(at).vector(best.factor)
    slopes = sets.d_frequency[:, [sets.names.index(n) for n in best.parameters]]
    factor = np.where(unmoved(x, best.std, slopes), 1.0, best.factor)
    return replace(best, factor=factor)


def _field_values(session: Session, best: SetResult, factor: Float) -> list[float]:
    """The first target's value of each parameter at the factors."""
    candidates = {p.name: p for p in session.parameters.parameters}
    out = []
    for name, a in zip(best.parameters, factor.tolist(), strict=True):
        target = candidates[name].targets[0]
        out.append(float(field_value(session.remodelled.model, target)) * a + target.step * (a - 1))
    return out


def regions(session: Session, name: str) -> tuple[int, ...]:
    """Groups of the scene that a parameter changes: those of the elements that use what it
    targets.
    """
    model = session.remodelled.model
    parameter = session.parameters.take([session.parameters.names.index(name)]).parameters[0]
    mine = np.isin(elements_of(model), of_parameter(model, parameter).elements)
    labels = element_regions(model, session.deck.regions)
    touched = {labels[i] for i in np.flatnonzero(mine).tolist()}
    return tuple(
        i for i, g in enumerate(session.get("model").scene.groups) if g in touched or g == name
    )


def _lowest_criterion(results: Sequence[SetResult], alike: Sequence[bool]) -> int:
    """The set of lowest AICc among those that weigh the data as the study does."""
    return int(
        np.argmin(
            [r.fit.criterion if good else np.inf for r, good in zip(results, alike, strict=True)]
        )
    )


def _with_further_starts(
    session: Session, results: list[SetResult], chosen: int, progress: Progress
) -> list[SetResult]:
    """The sets, the one to be chosen from further starts as well where these end in a lower J.

    One is where the proposal was found: its search has left minima in which the way from the deck
    may end.
    """
    best, more = results[chosen], further_starts(session.config.update)
    found: LocaliseStage | None = session.get("localise")
    at = {m.name: m.factor for m in found.proposal.members} if found is not None else {}
    others = list[tuple[str, UpdateSection | None, dict[str, float] | None]]()
    others += [("from the proposal", None, at)] if set(at) == set(best.parameters) else []
    others += [("further starts", more, None)] if more is not None else []
    for what, u, factors in others:
        progress(0.9, f"{best.name}: modes without partner, {what}")
        name = f"{best.name}, {what}"
        try:
            other, _ = update_reduced(
                session, name, members=best.parameters, progress=progress, u=u, factors=factors
            )
        except NumericalError as e:  # the end from the deck stands
            _log.info("%s: %s", name, e)
            continue
        if other.fit.criterion < best.fit.criterion:
            best = replace(other, name=best.name)
    return [
        replace(best, name=r.name) if r.parameters == best.parameters and not r.settings else r
        for r in results
    ]


def chosen_factors(session: Session) -> Float:
    """Factors of all candidates after the updating, (P,); 1 for those not chosen."""
    names = session.parameters.names
    out = np.ones(len(names))
    if not names:
        return out
    done: UpdateStage = session.get("update")
    best = done.sets[done.chosen]
    for n, a in zip(best.parameters, best.factor.tolist(), strict=True):
        out[names.index(n)] = a
    return out
