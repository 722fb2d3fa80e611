"""Where the remodelled deck is wrong: error indicators by region, and proposed parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from ringtrue.checks.mass import unconstrained
from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.decks.nastran.editor import refuse_unwritable, unwritable
from ringtrue.errors import DataError
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.parametrisation.changed_model import affected_cards
from ringtrue.fem.parametrisation.derivatives import congruent
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.model.edit import has_fields
from ringtrue.model.model import Model
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.matrix_model import DenseModel
from ringtrue.reduction.parametric import ReducedModel, condensed
from ringtrue.reduction.response import responding, with_responses
from ringtrue.study.evidence import at_channels, expanded
from ringtrue.study.measured_data import flexible
from ringtrue.study.objective import (
    data_of,
    names_of,
    on_parameters,
    problem_of,
    target,
    targets,
    terms_of,
)
from ringtrue.study.opened import AtChannels, lump_places
from ringtrue.study.results import (
    CandidateEffects,
    CandidatePool,
    CorrelateStage,
    ErrorIndicators,
    LocaliseStage,
)
from ringtrue.study.session import OWN, Session
from ringtrue.updating.gauss_newton import joint_residual, residual
from ringtrue.updating.identifiability import identifiability
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.residuals.modal import Point, Weighted
from ringtrue.updating.residuals.static import RigidMass
from ringtrue.updating.selection.candidates import (
    Candidate,
    CandidateSettings,
    membership,
    parameters,
)
from ringtrue.updating.selection.effects import effective
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.localisation import (
    ElementErrors,
    expanded_errors,
    reduced_errors,
    variation,
)
from ringtrue.updating.selection.proposal import Proposal, propose
from ringtrue.updating.selection.screening import (
    SMALL,
    conflicts,
    drawn,
    of_parameter,
    passed_over,
    screened,
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


@dataclass(frozen=True, slots=True)
class _Pool:
    """The candidates that are looked at closely, and what became of the others."""

    candidates: tuple[Candidate, ...]
    made: int = 0
    dropped: tuple[str, ...] = ()
    screened: tuple[str, ...] = ()
    passed_over: int = 0  # of these, those whose number counts
    held: tuple[str, ...] = ()


def run(session: Session, progress: Progress) -> LocaliseStage | None:
    """Indicators and proposal; None where there is neither a candidate nor a paired mode.

    Raises
    ------
    DataError
        If the updating needs the proposal, and no mode is paired.
    """
    found: CorrelateStage = session.get("correlate")
    paired = bool(found.remodelled.used.any())
    pool = _pool(session, found, part(progress, 0.0, 0.4)) if paired else _Pool(())
    if not pool.candidates:
        if session.config.propose:
            raise DataError(NO_CANDIDATE if paired else NO_PAIR)
        return None
    aim, model = target(session), _candidate_model(session, pool, part(progress, 0.4, 0.6))
    start = model.linearise(np.zeros(len(model.parameters)))
    pairs, _, _ = match(aim, start)
    pairs = pairs[aim.used[pairs[:, 0]] & (not aim.lent)]  # lent shapes have no local errors
    progress(0.6, "error indicators")
    errors, misfit = _error_indicators(session, model, aim, pairs)
    member = membership(session.steps[-1].model, pool.candidates)
    others = session.others(progress) if session.config.configuration and _shared(session) else ()
    proposal = _proposal(
        session,
        model,
        others=others,
        aim=aim,
        pool=pool,
        errors=errors.concentration(member),
        progress=part(progress, 0.7, 1.0),
    )
    problem = _problem(session, model, others)
    return LocaliseStage(
        indicators=_region_indicators(session, errors, misfit, pairs[:, 0]),
        candidates=_candidate_effects(
            session,
            model,
            problem=problem,
            aim=aim,
            candidates=pool.candidates,
            proposed=proposal.x,
        ),
        pool=CandidatePool(pool.made, pool.dropped, pool.screened, pool.held),
        proposal=proposal,
        proposal_basis=_beside(session) if problem is not None else "",
        places=session.places,
    )


def _shared(session: Session) -> bool:
    """Whether the candidates are those of the updating: only then do other tests and data know
    them.
    """
    return bool(len(session.config.candidates())) or session.config.propose


def _problem(session: Session, model: AtChannels, others: Sequence[AtChannels]) -> Problem | None:
    """All tests and what was measured beside modes; None where there are the study's own modes
    alone.
    """
    if not (others or (session.config.residual and _shared(session))):
        return None
    return problem_of(session, (model, *others), targets(session), session.config.update)


def _pool(session: Session, found: CorrelateStage, progress: Progress) -> _Pool:
    """The candidates of the study, or those made from the deck that explain most of the misfit."""
    model, given, asked = (
        session.remodelled.model,
        session.config.candidates(),
        session.config.localise,
    )
    if len(given):
        refuse_unwritable(model, given)
        return _Pool(tuple(of_parameter(model, p) for p in given.parameters))
    if not asked.pool:
        return _Pool(())
    every = generate(model, CandidateSettings(tuple(asked.kinds), session.deck.units))
    more = _lumps(session)
    model = session.remodelled.model
    if session.config.propose:  # what is proposed is delivered
        every = tuple(c for c in every if has_fields(c.parameter))
    springs = tuple(of_parameter(model, p) for p in session.config.suspensions().parameters)
    taken = conflicts(model, (*every, *springs))[: len(every), len(every) :]
    never = unwritable(model, [t for c in every for t in c.parameter.targets])
    held = [every[i].name for i in np.flatnonzero(taken.any(axis=1)).tolist()]
    every = tuple(c for c in every if c.name not in held and not never.keys() & c.parameter.targets)
    every += more
    system, modes = session.remodelled.analysis.system, session.remodelled.modes(session.fmax).modes
    lam, vectors = (2 * np.pi * modes.frequencies) ** 2, np.asarray(system.local @ modes.shapes)
    beside = (
        DataScreening.of(session, every) if session.measured(OWN) and _shared(session) else None
    )
    strained = (lam, vectors) if beside is None else beside.strained()
    some, lost = effective(model, system, every, *strained)
    beside = beside and replace(beside, candidates=some)

    def look(few: tuple[Candidate, ...]) -> tuple[AtChannels, ReducedModel]:
        reduced = session.apart(parameters(few), quiet)
        reduced = reduced if beside is None else beside.loaded(reduced)
        return _small(session, OWN, reduced, _points(session, reduced, few)), reduced.model

    near = screened(
        model,
        system,
        candidates=some,
        aim=target(session),
        observe=at_channels(
            session.remodelled, session.bridge(session.remodelled), found.reference.channels
        ),
        modes=(lam, vectors),
        look=look,
        pool=asked.pool,
        most=asked.most,
        alike=asked.alike,
        progress=progress,
        beside=beside,
    )
    far = tuple(c.name for c in some if c not in near)
    return _Pool(
        candidates=near,
        made=len(every),
        dropped=tuple(d.name for d in lost),
        screened=far,
        passed_over=passed_over(some, near),
        held=tuple(held),
    )


def _lumps(session: Session) -> tuple[Candidate, ...]:
    """Masses that the deck may lack; not where other decks or another solver would have to have
    them, too.
    """
    if (
        "lump" not in session.config.localise.kinds
        or session.config.configuration
        or session.engine is not None
    ):
        return ()
    deck = session.steps[-1]
    return session.with_lumps(lump_places(deck, session.bridge(deck)))


def _condensed(model: AtChannels, points: Sequence[Float]) -> AtChannels:
    """The model on its modes around the points."""
    return replace(model, model=condensed(model.model, points, max(SMALL, 2 * model.model.count)))


def _points(session: Session, model: AtChannels, candidates: Sequence[Candidate]) -> list[Float]:
    """Where a search will look."""
    apart = conflicts(session.remodelled.model, candidates)
    return drawn(model.parameters, apart, np.random.default_rng([session.config.study.seed, 5]))


def _candidate_model(session: Session, pool: _Pool, progress: Progress) -> AtChannels:
    """The reduced model over the candidates: that of the updating where it has the same."""
    if len(session.config.candidates()):
        return session.candidates(progress)
    if session.config.propose:
        session.generated = parameters(pool.candidates)
        return session.candidates(progress)
    return session.apart(parameters(pool.candidates), progress)


def _error_indicators(
    session: Session, model: AtChannels, aim: Target, pairs: Int
) -> tuple[ElementErrors, Float]:
    """Indicators by element, and the misfit (m,) of the expanded test shapes: in the reduced basis,
    or as asked for.
    """
    test, fe = pairs.T
    reduced: ReducedModel = model.model
    method, opened = session.config.correlate.expand, session.steps[-1]
    f, shapes, system = aim.frequencies[test], aim.shapes[:, test], opened.analysis.system
    if method in ("", "hybrid"):
        return reduced_errors(
            opened.model,
            system,
            reduced=reduced,
            rows=model.rows,
            frequencies=f,
            shapes=shapes,
            partners=fe,
        )
    _, own = reduced.coordinates(np.zeros(len(reduced.active)))
    found = expanded(
        method,
        opened,
        look=session.bridge(opened),
        test=session.reference(OWN).take(test),
        fmax=session.fmax,
        progress=quiet,
    )
    mine, solve = reduced.basis.vectors @ own[:, fe], reduced.pencil.at(reduced.shift).solve
    return expanded_errors(
        opened.model, system, frequencies=f, shapes=found.shapes, own=mine, solve=solve
    ), found.misfit


def _proposal(
    session: Session,
    model: AtChannels,
    others: Sequence[AtChannels],
    aim: Target,
    pool: _Pool,
    errors: Mapping[str, Float],
    progress: Progress,
) -> Proposal:
    asked, apart = session.config.localise, conflicts(session.remodelled.model, pool.candidates)
    points = _points(session, model, pool.candidates)
    search = _small(session, OWN, model, points)
    names = model.parameters.names
    also = [
        _small(
            session, c.name, o, [x[[names.index(n) for n in o.parameters.names]] for x in points]
        )
        for c, o in zip(session.config.configuration, others, strict=False)
    ]
    return propose(
        search,
        aim,
        most=asked.most,
        alike=asked.alike,
        apart=apart,
        errors=errors,
        words=[c.what for c in pool.candidates],
        problem=_problem(session, search, also),
        passed_over=pool.passed_over,
        progress=progress,
    )


def _small(session: Session, name: str, model: AtChannels, points: Sequence[Float]) -> AtChannels:
    """The model on its modes around the points, and on the static responses to what was struck or
    pulled.
    """
    small = _condensed(model, points)
    if session.config.residual and _shared(session):
        small = replace(small, model=flexible(small.model, session.measured(name), model.loaded))
    return small


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


def _candidate_effects(
    session: Session,
    model: AtChannels,
    problem: Problem | None,
    aim: Target,
    candidates: Sequence[Candidate],
    proposed: Float,
) -> CandidateEffects:
    """What the data say of each candidate, at the deck and at the proposed point (p,)."""
    p = model.parameters
    low, high = p.bounds()
    start, end = (
        residual(aim, model.linearise(x)) if problem is None else joint_residual(problem, x)
        for x in (np.zeros(len(p)), proposed)
    )
    known = identifiability(end.slope * p.std())
    deck = session.steps[-1].model
    labels = element_regions(deck, session.deck.regions)
    member = membership(deck, candidates)
    regions = [dict.fromkeys(labels[e] for e in member[[i]].indices) for i in range(len(p))]
    return CandidateEffects(
        parameters=p,
        what=tuple(c.what for c in candidates),
        elements=tuple(", ".join(names) for names in regions),
        effect=np.linalg.norm(start.slope * p.std(), axis=0),
        others_known=known.alone,
        all_free=known.together,
        explains=variation(aim, start, p.std(), low, high).frequency,
    )


def _beside(session: Session) -> str:
    """What the proposal rests on beside the modes of the study's own test."""
    tests = [f"the test of {c.name}" for c in session.config.configuration]
    data = [m.name for n in names_of(session) for m in session.measured(n)]
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


@dataclass(frozen=True, eq=False)
class DataScreening:
    """The [[residual]]s of the study's own deck, as a screening of candidates sees them.

    Attributes
    ----------
    session : Session
    candidates : tuple of Candidate
        All that are screened.
    start : ReducedModel
        The deck without a parameter, with the responses to unit loads at the touched channels.
    """

    session: Session
    candidates: tuple[Candidate, ...]
    start: ReducedModel

    @classmethod
    def of(cls, session: Session, candidates: tuple[Candidate, ...]) -> DataScreening:
        """On the deck as it is.

        Raises
        ------
        DataError
            As `objective.data_of`.
        """
        deck = session.apart(ParameterSet(()), quiet)
        data_of(session, OWN, deck)
        bare = cls(session, candidates, deck.model)
        return replace(bare, start=bare.loaded(deck).model)

    @cached_property
    def chosen(self) -> ParameterSet:
        """All candidates."""
        return parameters(self.candidates)

    @cached_property
    def touched(self) -> Int:
        """Channels that were struck or pulled, and those whose deflections were read."""
        at = {c: i for i, c in enumerate(self.session.channels(OWN))}
        read = [
            at[c] for m in self.session.measured(OWN) if m.statics is not None for c in m.outputs
        ]
        return np.unique([*self.session.loaded(OWN), *read]).astype(np.int64)

    @cached_property
    def mass(self) -> tuple[Float, Float]:
        """The rigid-body mass (6, 6) of the deck about the origin, and its slopes (p, 6, 6) to the
        factors.
        """
        free = unconstrained(self.session.remodelled.model)
        system = assemble(free)
        r = system.rigid_body()
        return np.asarray(r.T @ (system.mass @ r)), _projected(free, self.chosen, system, r)[1]

    def strained(self) -> tuple[Float, Float]:
        """λ and vectors of the deck in which a candidate must have a part to be seen: modes and
        responses.
        """
        return responding(self.start, self.touched, np.zeros(0))

    def loaded(self, model: AtChannels) -> AtChannels:
        """With the responses to unit loads at the touched channels in its basis."""
        loads = self.session.loaded(OWN)
        more, read = (
            flexible(model.model, self.session.measured(OWN), loads),
            np.setdiff1d(self.touched, loads),
        )
        if read.size:
            more, _ = with_responses(more, read, np.zeros(len(more.parameters)))
        return replace(model, model=more, loaded=loads)

    def problem(self, search: AtChannels, aim: Target) -> Problem:
        """Modes and data, over some of the candidates."""
        return Problem(
            (
                Configuration(
                    search, aim, terms_of(self.session, OWN, search, self.session.config.update)
                ),
            )
        )

    def misfit(
        self, at: ReducedModel | None, x: Float, which: Sequence[int], aim: Target
    ) -> tuple[Float, Float]:
        """Weighted deviations (n,) at a point, and what each candidate does to them in units of its
        prior, (n, p).

        Along the modes there and the responses to unit loads at the touched channels (Fox and
        Kapoor 1968).

        Parameters
        ----------
        at : ReducedModel, optional
            Over some of the candidates; the deck as it is if not given.
        x : (k,) float64
            Of those.
        which : sequence of int
            Their positions among all.
        """
        model, deck, p = at or self.start, self.session.remodelled, len(self.chosen)
        lam, vectors = responding(model, self.touched, x)
        dk, dm = _projected(deck.model, self.chosen, deck.analysis.system, vectors)
        dense = DenseModel(
            stiffness=np.diag(lam),
            mass=np.eye(lam.size),
            d_stiffness=dk,
            d_mass=dm,
            observation=model.system.observe @ vectors,
            parameters=self.chosen,
            count=lam.size,
        )
        now = dense.linearise(np.zeros(p))
        none = np.zeros((0, 2), dtype=np.int64)
        here = Point(
            model=dense,
            now=now,
            target=aim,
            pairs=none,
            spans=(),
            every=none,
            mac=np.zeros(0),
            whole=now,
        )
        everything = np.zeros(p)
        everything[list(which)] = x
        data = on_parameters(self.session, OWN, lambda: self._rigid(everything), tuple(range(p)))
        blocks = [Weighted(d.term, d.weight)(here) for d in data]
        slopes = np.concatenate([b.slope for b in blocks]) * self.chosen.std()
        return np.concatenate([b.value for b in blocks]), slopes

    def _rigid(self, x: Float) -> RigidMass:
        """About x (p,), linear in the factors."""
        mass, slopes = self.mass
        none, here = (
            sparse.csr_array((6, 6)),
            mass + np.tensordot(self.chosen.factors(x) - 1, slopes, axes=1),
        )
        terms = tuple(AffineTerm(power(i), none, sparse.csr_array(s)) for i, s in enumerate(slopes))
        return RigidMass(
            AffineSystem(none, sparse.csr_array(here), self.chosen, terms, none), np.eye(6)
        )


def _projected(
    model: Model, chosen: ParameterSet, system: System, vectors: Float
) -> tuple[Float, Float]:
    """∂K/∂a and ∂M/∂a of each parameter along vectors (f, r), (p, r, r) each."""
    r = vectors.shape[1]
    out = np.zeros((2, len(chosen), r, r))
    for i, *both in congruent(model, chosen.parameters, system, vectors):
        for total, change in zip(out, both, strict=True):
            if change.size:
                total[i] += change
    return out[0], out[1]
