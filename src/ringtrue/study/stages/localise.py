"""Where the remodelled deck is wrong: error indicators by region, and a ranked proposal of
parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.decks.nastran.edit import refuse_unwritable, unwritable
from ringtrue.errors import DataError
from ringtrue.fem.parametrisation.changed_model import affected_cards
from ringtrue.model.edit import has_fields
from ringtrue.model.model import Model
from ringtrue.reduction.condense import condensed
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.study.beside import Beside
from ringtrue.study.evidence import at_channels
from ringtrue.study.expansion import expanded
from ringtrue.study.measured import flexible
from ringtrue.study.objective import names_of, problem_of
from ringtrue.study.parametric import AtChannels
from ringtrue.study.proposing import lump_places
from ringtrue.study.results import CorrelateStage, LocaliseStage
from ringtrue.study.stages.sensitivity import target, targets
from ringtrue.study.workbench import OWN, Workbench
from ringtrue.updating.candidates import Candidate, CandidateSettings, membership, parameters
from ringtrue.updating.effects import effective
from ringtrue.updating.generate import generate
from ringtrue.updating.identifiable import identifiability
from ringtrue.updating.joint import joint_residual
from ringtrue.updating.localise import ElementErrors, expanded_errors, reduced_errors, variation
from ringtrue.updating.objective import Target, match, residual
from ringtrue.updating.pool import SMALL, conflicts, drawn, of_parameter, passed_over
from ringtrue.updating.proposal import Proposal, propose
from ringtrue.updating.screening import screened
from ringtrue.updating.several import Problem

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


@dataclass(frozen=True, slots=True)
class _Pool:
    """The candidates that are looked at closely, and what became of the others."""

    candidates: tuple[Candidate, ...]
    made: int = 0
    dropped: tuple[str, ...] = ()
    screened: tuple[str, ...] = ()
    passed_over: int = 0  # of these, those whose number counts
    held: tuple[str, ...] = ()


def run(desk: Workbench, progress: Progress) -> LocaliseStage | None:
    """Indicators and proposal; None where there is neither a candidate nor a paired mode.

    Raises
    ------
    DataError
        If the updating needs the proposal, and no mode is paired.
    """
    found: CorrelateStage = desk.get("correlate")
    paired = bool(found.remodelled.used.any())
    pool = _pool(desk, found, part(progress, 0.0, 0.4)) if paired else _Pool(())
    if not pool.candidates:
        if desk.config.propose:
            raise DataError(NO_CANDIDATE if paired else NO_PAIR)
        return None
    aim, model = target(desk), _model(desk, pool, part(progress, 0.4, 0.6))
    start = model.linearise(np.zeros(len(model.parameters)))
    pairs, _, _ = match(aim, start)
    pairs = pairs[aim.used[pairs[:, 0]] & (not aim.lent)]  # lent shapes have no local errors
    progress(0.6, "error indicators")
    errors, misfit = _errors(desk, model, aim, pairs)
    member = membership(desk.steps[-1].model, pool.candidates)
    others = desk.others(progress) if desk.config.configuration and _shared(desk) else ()
    proposal = _proposal(
        desk, model, others, aim, pool, errors.concentration(member), part(progress, 0.7, 1.0)
    )
    return _result(
        desk, model, _problem(desk, model, others), aim, pool, pairs, errors, misfit, proposal
    )


def _shared(desk: Workbench) -> bool:
    """Whether the candidates are those of the updating: only then do other tests and data know
    them.
    """
    return bool(len(desk.config.candidates())) or desk.config.propose


def _problem(desk: Workbench, model: AtChannels, others: Sequence[AtChannels]) -> Problem | None:
    """All tests and what was measured beside modes; None where there are the study's own modes
    alone.
    """
    if not (others or (desk.config.residual and _shared(desk))):
        return None
    return problem_of(desk, (model, *others), targets(desk), desk.config.update)


def _pool(desk: Workbench, found: CorrelateStage, progress: Progress) -> _Pool:
    """The candidates of the study, or those made from the deck that explain most of the misfit."""
    model, given, asked = desk.remodelled.model, desk.config.candidates(), desk.config.localise
    if len(given):
        refuse_unwritable(model, given)
        return _Pool(tuple(of_parameter(model, p) for p in given.parameters))
    if not asked.pool:
        return _Pool(())
    every = generate(model, CandidateSettings(tuple(asked.kinds), desk.deck.units))
    more = _lumps(desk)
    model = desk.remodelled.model
    if desk.config.propose:  # what is proposed is delivered
        every = tuple(c for c in every if has_fields(c.parameter))
    springs = tuple(of_parameter(model, p) for p in desk.config.suspensions().parameters)
    taken = conflicts(model, (*every, *springs))[: len(every), len(every) :]
    never = unwritable(model, [t for c in every for t in c.parameter.targets])
    held = [every[i].name for i in np.flatnonzero(taken.any(axis=1)).tolist()]
    every = tuple(c for c in every if c.name not in held and not never.keys() & c.parameter.targets)
    every += more
    system, modes = desk.remodelled.analysis.system, desk.remodelled.modes(desk.fmax).modes
    lam, vectors = (2 * np.pi * modes.frequencies) ** 2, np.asarray(system.local @ modes.shapes)
    beside = Beside.of(desk, every) if desk.measured(OWN) and _shared(desk) else None
    strained = (lam, vectors) if beside is None else beside.strained()
    some, lost = effective(model, system, every, *strained)
    beside = beside and replace(beside, candidates=some)

    def look(few: tuple[Candidate, ...]) -> tuple[AtChannels, ReducedModel]:
        reduced = desk.apart(parameters(few), quiet)
        reduced = reduced if beside is None else beside.loaded(reduced)
        return _small(desk, OWN, reduced, _points(desk, reduced, few)), reduced.model

    near = screened(
        model,
        system,
        some,
        target(desk),
        at_channels(desk.remodelled, desk.bridge(desk.remodelled), found.reference.channels),
        (lam, vectors),
        look,
        pool=asked.pool,
        most=asked.most,
        alike=asked.alike,
        progress=progress,
        beside=beside,
    )
    far = tuple(c.name for c in some if c not in near)
    return _Pool(
        near, len(every), tuple(d.name for d in lost), far, passed_over(some, near), tuple(held)
    )


def _lumps(desk: Workbench) -> tuple[Candidate, ...]:
    """Masses that the deck may lack; not where other decks or another solver would have to have
    them, too.
    """
    if (
        "lump" not in desk.config.localise.kinds
        or desk.config.configuration
        or desk.engine is not None
    ):
        return ()
    deck = desk.steps[-1]
    return desk.with_lumps(lump_places(deck, desk.bridge(deck)))


def _condensed(model: AtChannels, points: Sequence[Float]) -> AtChannels:
    """The model on its modes around the points."""
    return replace(model, model=condensed(model.model, points, max(SMALL, 2 * model.model.count)))


def _points(desk: Workbench, model: AtChannels, candidates: Sequence[Candidate]) -> list[Float]:
    """Where a search will look."""
    apart = conflicts(desk.remodelled.model, candidates)
    return drawn(model.parameters, apart, np.random.default_rng([desk.config.study.seed, 5]))


def _model(desk: Workbench, pool: _Pool, progress: Progress) -> AtChannels:
    """The reduced model over the candidates: that of the updating where it has the same."""
    if len(desk.config.candidates()):
        return desk.candidates(progress)
    if desk.config.propose:
        desk.generated = parameters(pool.candidates)
        return desk.candidates(progress)
    return desk.apart(parameters(pool.candidates), progress)


def _errors(
    desk: Workbench, model: AtChannels, aim: Target, pairs: Int
) -> tuple[ElementErrors, Float]:
    """Indicators by element, and the misfit (m,) of the expanded test shapes: in the reduced basis,
    or as asked for.
    """
    test, fe = pairs.T
    reduced: ReducedModel = model.model
    method, opened = desk.config.correlate.expand, desk.steps[-1]
    f, shapes, system = aim.frequencies[test], aim.shapes[:, test], opened.analysis.system
    if method in ("", "hybrid"):
        return reduced_errors(opened.model, system, reduced, model.rows, f, shapes, fe)
    _, own = reduced.coordinates(np.zeros(len(reduced.active)))
    found = expanded(
        method, opened, desk.bridge(opened), desk.reference(OWN).take(test), desk.fmax, quiet
    )
    mine, solve = reduced.basis.vectors @ own[:, fe], reduced.pencil.at(reduced.shift).solve
    return expanded_errors(opened.model, system, f, found.shapes, mine, solve), found.misfit


def _proposal(
    desk: Workbench,
    model: AtChannels,
    others: Sequence[AtChannels],
    aim: Target,
    pool: _Pool,
    errors: Mapping[str, Float],
    progress: Progress,
) -> Proposal:
    asked, apart = desk.config.localise, conflicts(desk.remodelled.model, pool.candidates)
    points = _points(desk, model, pool.candidates)
    search = _small(desk, OWN, model, points)
    names = model.parameters.names
    also = [
        _small(desk, c.name, o, [x[[names.index(n) for n in o.parameters.names]] for x in points])
        for c, o in zip(desk.config.configuration, others, strict=False)
    ]
    return propose(
        search,
        aim,
        most=asked.most,
        alike=asked.alike,
        apart=apart,
        errors=errors,
        words=[c.what for c in pool.candidates],
        problem=_problem(desk, search, also),
        passed_over=pool.passed_over,
        progress=progress,
    )


def _small(desk: Workbench, name: str, model: AtChannels, points: Sequence[Float]) -> AtChannels:
    """The model on its modes around the points, and on the static responses to what was struck or
    pulled.
    """
    small = _condensed(model, points)
    if desk.config.residual and _shared(desk):
        small = replace(small, model=flexible(small.model, desk.measured(name), model.loaded))
    return small


def _result(
    desk: Workbench,
    model: AtChannels,
    problem: Problem | None,
    aim: Target,
    pool: _Pool,
    pairs: Int,
    errors: ElementErrors,
    misfit: Float,
    proposal: Proposal,
) -> LocaliseStage:
    p = model.parameters
    low, high = p.bounds()
    start, end = (
        residual(aim, model.linearise(x)) if problem is None else joint_residual(problem, x)
        for x in (np.zeros(len(p)), proposal.x)
    )
    known = identifiability(end.slope * p.std())
    labels = element_regions(desk.steps[-1].model, desk.deck.regions)
    names = tuple(dict.fromkeys(labels))
    at = np.array([names.index(x) for x in labels])

    def by_region(share: Float) -> Float:
        return np.asarray(np.bincount(at, share, len(names)), dtype=np.float64)

    member = membership(desk.steps[-1].model, pool.candidates)
    return LocaliseStage(
        names,
        by_region(errors.strain),
        by_region(errors.force),
        by_region(errors.constitutive),
        by_region(errors.energy),
        pairs[:, 0],
        errors.relative,
        p,
        tuple(c.what for c in pool.candidates),
        tuple(
            ", ".join(dict.fromkeys(labels[e] for e in member[[i]].indices)) for i in range(len(p))
        ),
        np.linalg.norm(start.slope * p.std(), axis=0),
        known.alone,
        known.together,
        variation(aim, start, p.std(), low, high).frequency,
        pool.made,
        pool.dropped,
        pool.screened,
        proposal,
        desk.config.correlate.expand or "hybrid",
        misfit,
        _beside(desk) if problem is not None else "",
        desk.places,
        pool.held,
    )


def _beside(desk: Workbench) -> str:
    """What the proposal rests on beside the modes of the study's own test."""
    tests = [f"the test of {c.name}" for c in desk.config.configuration]
    data = [m.name for n in names_of(desk) for m in desk.measured(n)]
    return ", ".join([*tests, *data])


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
