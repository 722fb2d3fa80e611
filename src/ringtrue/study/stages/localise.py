"""Where the remodelled deck is wrong: error indicators by region, and proposed parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.iterate import Progress, part
from ringtrue.decks.nastran.editor import refuse_unwritable, unwritable
from ringtrue.errors import DataError
from ringtrue.fem.parametrisation.changed_model import affected_cards
from ringtrue.model.edit import has_fields
from ringtrue.model.model import Model
from ringtrue.reduction.expansion import ShapeReadings
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.study.candidate_screening import (
    HeldDecks,
    held_decks,
    screened_here,
    screened_there,
    search_model,
    search_points,
    search_settings,
    updates_candidates,
)
from ringtrue.study.evidence import expanded
from ringtrue.study.form import form_of
from ringtrue.study.objective import problem_of, target
from ringtrue.study.opened import AtChannels, ProjectedAtChannels, lump_places
from ringtrue.study.results import (
    CandidateEffects,
    CandidatePool,
    CorrelateStage,
    ErrorIndicators,
    LocaliseStage,
)
from ringtrue.study.session import Session
from ringtrue.updating.identifiability import identifiability
from ringtrue.updating.problem import Problem, residual_at, single
from ringtrue.updating.selection.candidates import (
    Candidate,
    CandidateSettings,
    membership,
    parameters,
)
from ringtrue.updating.selection.form import FormFindings
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.localisation import (
    EXPANSION_MISFIT,
    ElementErrors,
    expanded_errors,
    reduced_errors,
    variation,
)
from ringtrue.updating.selection.missing_members import (
    FittedModel,
    MissingMember,
    missing_members,
)
from ringtrue.updating.selection.proposal import Proposal, propose
from ringtrue.updating.selection.screening import (
    conflicts,
    of_parameter,
    passed_over,
)
from ringtrue.updating.target import Target, match

NO_CANDIDATE = (
    "no candidate made from the deck changes a mode and can be written into it: give "
    "[[candidate]], or further "
    "`kinds` under [localise] (region, a part of a property, is only looked at)"
)
NO_PAIR = (
    "no mode of the model is paired with one that the updating may see: nothing can be "
    "localised; look at the deck, "
    "the sensor sheet and correlate.mac_gate"
)


NO_INDICATORS = ErrorIndicators(
    regions=(),
    strain=np.zeros(0),
    force=np.zeros(0),
    constitutive=np.zeros(0),
    energy=np.zeros(0),
    modes=np.zeros(0, dtype=np.int64),
    relative=np.zeros(0),
    expansion="",
    misfit=np.zeros(0),
)


def run(session: Session, progress: Progress) -> LocaliseStage | None:
    """Indicators and proposal; None where there is neither a candidate nor a paired mode.

    Raises
    ------
    DataError
        If the updating needs the proposal, and no mode is paired.
    """
    found: CorrelateStage = session.get("correlate")
    paired = bool(found.remodelled.used.any())
    with held_decks(session) as held:
        chosen = (
            _candidates(session, held, part(progress, 0.0, 0.4)) if paired else None
        )
        if chosen is None or not chosen.kept:
            if session.config.propose:
                raise DataError(NO_CANDIDATE if paired else NO_PAIR)
            return None
        return _localised(session, chosen, held, progress)


def _localised(
    session: Session, chosen: _Chosen, held: HeldDecks | None, progress: Progress
) -> LocaliseStage:
    """What the data say of the candidates that are looked at closely."""
    candidates = chosen.kept
    aim = target(session.own)
    model = _candidate_model(session, candidates, held, part(progress, 0.4, 0.6))
    progress(0.6, "error indicators")
    indicators, gathered = _local_errors(session, model, candidates, aim)
    others: tuple[ProjectedAtChannels, ...] = ()
    if updates_candidates(session):
        others = tuple(
            c.model(progress) if held is None else held.model(c, progress)
            for c in session.others
        )
    problem = _problem(session, (model, *others))
    with_others = updates_candidates(session) and (
        session.others or session.config.residual
    )
    points = search_points(session, model, candidates)
    search = [search_model(session.own, model, points)]
    names = model.parameters.names
    for c, other in zip(session.others, others, strict=False):
        at = model.parameters.at(other.parameters.names)
        search.append(search_model(c, other, [x[at] for x in points]))
    proposal = propose(
        _problem(session, search),
        replace(search_settings(session), passed_over=chosen.passed_over),
        conflicts=conflicts(session.remodelled.model, candidates),
        errors=gathered,
        words=[c.what for c in candidates],
        progress=part(progress, 0.7, 1.0),
    )
    start_data = residual_at(problem, np.zeros(len(names)))
    end_data = residual_at(problem, proposal.x)
    basis = ""
    if with_others:
        tests = [f"the test of {c.name}" for c in session.others]
        data = [m.name for c in session.configurations for m in c.measured]
        basis = ", ".join([*tests, *data])
    p = model.parameters
    known = identifiability(end_data.slope * p.std())
    return LocaliseStage(
        indicators=indicators,
        candidates=CandidateEffects(
            parameters=p,
            what=tuple(c.what for c in candidates),
            elements=_regions_of(session, candidates),
            effect=np.linalg.norm(start_data.slope * p.std(), axis=0),
            others_known=known.alone,
            all_free=known.together,
            explains=variation(aim, start_data, p).frequency,
        ),
        pool=chosen.pool,
        proposal=proposal,
        proposal_basis=basis,
        places=session.places,
        members=_members(session, proposal, model, aim),
        form=FormFindings() if held else _form(session, aim),
        reduced_by="" if held is None else held.solver,
    )


def _members(
    session: Session, proposal: Proposal, model: ProjectedAtChannels, aim: Target
) -> tuple[MissingMember, ...]:
    """Members that the deck may lack, where its matrices are here."""
    if not isinstance(model, AtChannels):
        return ()
    deck = session.remodelled
    fitted = FittedModel.after(
        proposal, deck.analysis.system, model.model, model.rows, aim
    )
    return missing_members(deck.model, fitted)


def _form(session: Session, aim: Target) -> FormFindings:
    """What the deviations of the study's own test follow."""
    deck = session.remodelled
    reference = session.own.reference
    test = reference.elastic
    observed = session.own.observed(deck)
    here = {c: i for i, c in enumerate(observed.channels)}
    observe = sparse.csr_array(observed.matrix[[here[c] for c in test.channels]])
    modes = deck.modes(session.fmax).modes
    return form_of(
        deck, modes, test, std=reference.elastic_std, target=aim, observe=observe
    )


def _problem(session: Session, models: Sequence[ProjectedAtChannels]) -> Problem:
    """All tests and what was measured besides modes."""
    if not (
        updates_candidates(session) and (session.others or session.config.residual)
    ):
        return single(models[0], target(session.own))
    return problem_of(session, models)


@dataclass(frozen=True, slots=True)
class _Chosen:
    """The candidates that are looked at closely, and what became of the others.

    `passed_over` of the screened ones count in the choice.
    """

    kept: tuple[Candidate, ...]
    pool: CandidatePool = field(default_factory=lambda: CandidatePool(0, (), ()))
    passed_over: int = 0


def _candidates(
    session: Session, held: HeldDecks | None, progress: Progress
) -> _Chosen:
    """The candidates of the study, or those made from the deck that explain most of the misfit."""
    given = session.config.candidates()
    asked = session.config.localise
    model = session.remodelled.model
    if len(given):
        refuse_unwritable(model, given)
        return _Chosen(tuple(of_parameter(model, p) for p in given.parameters))
    if not asked.pool:
        return _Chosen(())
    every = generate(model, CandidateSettings(tuple(asked.kinds), session.deck.units))
    masses: tuple[Candidate, ...] = ()
    # not where other decks or another solver would have to have them, too
    if "lump" in asked.kinds and not session.others and session.engine is None:
        deck = session.steps[-1]
        masses = session.with_lumps(lump_places(deck, session.own.observed(deck)))
        model = session.remodelled.model
    if session.config.propose:  # what is proposed is delivered
        every = tuple(c for c in every if has_fields(c.parameter))
    springs = tuple(
        of_parameter(model, p) for p in session.config.suspensions().parameters
    )
    taken = conflicts(model, (*every, *springs))[: len(every), len(every) :]
    never = unwritable(model, [t for c in every for t in c.parameter.targets])
    held_fields = [every[i].name for i in np.flatnonzero(taken.any(axis=1)).tolist()]
    every = tuple(
        c
        for c in every
        if c.name not in held_fields and not never.keys() & c.parameter.targets
    )
    every += masses
    screen = screened_here if held is None else partial(screened_there, held)
    near, some, lost = screen(session, every, progress)
    far = tuple(c.name for c in some if c not in near)
    pool = CandidatePool(
        len(every), tuple(d.name for d in lost), far, tuple(held_fields)
    )
    return _Chosen(near, pool, passed_over(some, near))


def _candidate_model(
    session: Session,
    candidates: tuple[Candidate, ...],
    held: HeldDecks | None,
    progress: Progress,
) -> ProjectedAtChannels:
    """The reduced model over the candidates: that of the updating where it has the same."""
    own = session.own
    if not updates_candidates(session):
        only = parameters(candidates)
        if held is None:
            return own.reduced(only, progress)
        rows = own.rows(own.reference.elastic.channels)
        return ProjectedAtChannels(held.reduced(own, only, progress), rows)
    if not len(session.config.candidates()):
        session.generated = parameters(candidates)
    return own.model(progress) if held is None else held.model(own, progress)


def _local_errors(
    session: Session,
    model: ProjectedAtChannels,
    candidates: Sequence[Candidate],
    aim: Target,
) -> tuple[ErrorIndicators, Mapping[str, Float]]:
    """Error indicators of the regions, and their concentration on each candidate; none where the
    matrices of the deck are not here.
    """
    if not isinstance(model, AtChannels):
        return NO_INDICATORS, {}
    pairs, _, _ = match(aim, model.linearise(np.zeros(len(model.parameters))))
    pairs = pairs[
        aim.used[pairs[:, 0]] & (not aim.frequency_only)
    ]  # without measured shapes no local errors
    errors, misfit = _error_indicators(session, model, aim, pairs)
    gathered = errors.concentration(membership(session.steps[-1].model, candidates))
    return _region_indicators(session, errors, misfit, pairs[:, 0]), gathered


def _error_indicators(
    session: Session, model: AtChannels, aim: Target, pairs: Int
) -> tuple[ElementErrors, Float]:
    """Indicators by element, and the misfit (m,) of the expanded test shapes: in the reduced basis,
    or as asked for.
    """
    test, fe = pairs.T
    reduced: ReducedModel = model.model
    method = session.config.correlate.expand
    opened = session.steps[-1]
    system = opened.analysis.system
    f = aim.frequencies[test]
    if method in ("", "hybrid"):
        observe = reduced.basis.observe[model.rows]
        readings = ShapeReadings(observe, aim.shapes[:, test], f, EXPANSION_MISFIT)
        return reduced_errors(opened.model, system, reduced, readings, fe)
    _, own = reduced.coordinates(np.zeros(len(reduced.active)))
    found = expanded(
        method,
        opened,
        look=session.own.observed(opened),
        test=session.own.reference.elastic.take(test),
        fmax=session.fmax,
    )
    errors = expanded_errors(
        opened.model,
        system,
        frequencies=f,
        shapes=found.shapes,
        own=reduced.basis.vectors @ own[:, fe],
        solve=reduced.pencil.at(reduced.shift).solve,
    )
    return errors, found.misfit


def _region_indicators(
    session: Session, errors: ElementErrors, misfit: Float, modes: Int
) -> ErrorIndicators:
    """The indicators of the elements summed over regions."""
    labels = element_regions(session.steps[-1].model, session.deck.regions)
    names = tuple(dict.fromkeys(labels))
    at = np.array([names.index(x) for x in labels])

    def by_region(share: Float) -> Float:
        return np.asarray(np.bincount(at, share, len(names)), dtype=np.float64)

    return ErrorIndicators(
        regions=names,
        strain=by_region(errors.strain),
        force=by_region(errors.force),
        constitutive=by_region(errors.constitutive),
        energy=by_region(errors.energy),
        modes=modes,
        relative=errors.relative,
        expansion=session.config.correlate.expand or "hybrid",
        misfit=misfit,
    )


def _regions_of(session: Session, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """The regions that each candidate changes."""
    deck = session.steps[-1].model
    labels = element_regions(deck, session.deck.regions)
    member = membership(deck, candidates)
    rows = (member[[i]].indices for i in range(len(candidates)))
    return tuple(", ".join(dict.fromkeys(labels[e] for e in row)) for row in rows)


def element_regions(model: Model, regions: Mapping[str, Sequence[int]]) -> list[str]:
    """The region of each element, in the order of `candidates.elements_of`: that of its property,
    or its card.
    """
    named = {pid: name for name, members in regions.items() for pid in members}
    out: list[str] = []
    for card in affected_cards(model):
        table = model[card]
        if "PID" not in table.columns:
            out += [card] * len(table)
            continue
        out += [named.get(p, f"property {p}") for p in table["PID"].tolist()]
    return out
