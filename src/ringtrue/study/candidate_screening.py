"""Which candidates a localisation looks at closely, and the models that it searches with.

Where the solver of the study reduces decks in processes of its own, these hold them (`HeldDecks`):
no matrix of a whole deck is in this process.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from ringtrue.checks.materials import unconstrained
from ringtrue.core.arrays import Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.parametrisation.derivatives import congruent
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.model import Model
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.dense_models import (
    DenseModel,
    HeldModel,
    ReducingAnalysis,
    condensed,
)
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.reduction.response import responding, with_responses
from ringtrue.study.evidence import at_channels
from ringtrue.study.measured_data import flexible
from ringtrue.study.objective import data_of, on_parameters, target, terms_of
from ringtrue.study.opened import AtChannels, ProjectedAtChannels
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.residuals.modal import Point, Weighted
from ringtrue.updating.residuals.static import RigidMass
from ringtrue.updating.selection.candidates import Candidate, parameters
from ringtrue.updating.selection.screening import (
    SIZES,
    Dropped,
    HeldDeck,
    ScreenedDeck,
    conflicts,
    drawn,
    effective,
    screened,
)
from ringtrue.updating.selection.subset_search import SearchSettings
from ringtrue.updating.target import Target


@dataclass(frozen=True, slots=True, eq=False)
class HeldDecks:
    """The decks of all configurations, as long as they are open.

    Attributes
    ----------
    solver : str
        Its name.
    analyses : tuple of ReducingAnalysis
        In the order of the configurations.
    """

    solver: str
    analyses: tuple[ReducingAnalysis, ...]

    def reduced(
        self, c: StudyConfiguration, parameters: ParameterSet, progress: Progress
    ) -> HeldModel:
        """The reduced model of a configuration at all its channels, as
        `StudyConfiguration.reduced`.
        """
        progress(0.0, f"reduced model by {self.solver}")
        fmax = c.session.up_to(c.reference.elastic)
        analysis = self.analyses[c.session.configurations.index(c)]
        count = len(c.deck.modes_by(analysis, fmax).modes)
        return analysis.reduced(parameters, c.seen.matrix, count, fmax)

    def model(self, c: StudyConfiguration, progress: Progress) -> ProjectedAtChannels:
        """The reduced model over the candidates that its deck has, as
        `StudyConfiguration.model`.
        """
        every, count = c.parameters()
        model = self.reduced(c, every, progress)
        seen = ProjectedAtChannels(model, c.rows(c.reference.elastic.channels))
        return seen.with_parameters(range(count), np.zeros(len(every)))


@contextmanager
def held_decks(session: Session) -> Iterator[HeldDecks | None]:
    """The decks of a study in its solver; None where that does not reduce them."""
    engine = session.engine
    if engine is None or not session.remodelled.reduces:
        yield None
        return
    with ExitStack() as open_ones:
        analyses = [
            open_ones.enter_context(engine.open(whole_mesh(c.deck.model)))
            for c in session.configurations
        ]
        reducing = tuple(a for a in analyses if isinstance(a, ReducingAnalysis))
        yield HeldDecks(engine.name, reducing)


def updates_candidates(session: Session) -> bool:
    """Whether the candidates are those of the updating: only then do other tests and data know
    them.
    """
    return bool(len(session.config.candidates())) or session.config.propose


def search_settings(session: Session) -> SearchSettings:
    """As [localise] asks for."""
    asked = session.config.localise
    return SearchSettings(asked.most, asked.alike)


# candidates to be looked at closely, those that change a mode, those that do not
_Screened = tuple[tuple[Candidate, ...], tuple[Candidate, ...], tuple[Dropped, ...]]


def screened_here(
    session: Session, every: tuple[Candidate, ...], progress: Progress
) -> _Screened:
    """By the matrices of the deck."""
    model = session.remodelled.model
    system = session.remodelled.analysis.system
    modes = session.remodelled.modes(session.fmax).modes
    lam = (2 * np.pi * modes.frequencies) ** 2
    vectors = np.asarray(system.local @ modes.shapes)
    data = None
    strained = lam, vectors
    if session.own.measured and updates_candidates(session):
        data = DataScreening.of(session.own, every)
        strained = data.strained()
    some, lost = effective(model, system, every, *strained)
    if data is not None:
        data = replace(data, candidates=some)

    def look(few: tuple[Candidate, ...]) -> tuple[ProjectedAtChannels, ReducedModel]:
        reduced = session.own.reduced(parameters(few), quiet)
        reduced = reduced if data is None else data.loaded(reduced)
        return search_model(
            session.own, reduced, search_points(session, reduced, few)
        ), reduced.model

    deck = session.remodelled
    channels = session.own.reference.elastic.channels
    readings = at_channels(deck, session.own.observed(deck), channels)
    near = screened(
        ScreenedDeck(
            model,
            system,
            some,
            observe=readings,
            values=lam,
            vectors=vectors,
            data=data,
        ),
        target(session.own),
        look,
        session.config.localise.pool,
        settings=search_settings(session),
        progress=progress,
    )
    return near, some, lost


def screened_there(
    held: HeldDecks, session: Session, every: tuple[Candidate, ...], progress: Progress
) -> _Screened:
    """By the processes that hold the deck."""
    own = session.own
    start = held.reduced(own, ParameterSet(()), progress)
    rows = own.rows(own.reference.elastic.channels)
    deck, lost = HeldDeck(session.remodelled.model, every, start, rows).effective()

    def look(few: tuple[Candidate, ...]) -> tuple[ProjectedAtChannels, HeldModel]:
        reduced = held.reduced(own, parameters(few), quiet)
        seen = ProjectedAtChannels(reduced, rows)
        return search_model(own, seen, search_points(session, seen, few)), reduced

    near = screened(
        deck,
        target(own),
        look,
        session.config.localise.pool,
        settings=search_settings(session),
        progress=progress,
    )
    return near, deck.candidates, lost


def search_points(
    session: Session, model: ProjectedAtChannels, candidates: Sequence[Candidate]
) -> list[Float]:
    """Where a search will look."""
    together = conflicts(session.remodelled.model, candidates)
    return drawn(
        model.parameters,
        together,
        np.random.default_rng([session.config.study.seed, 5]),
    )


def search_model(
    c: StudyConfiguration, model: ProjectedAtChannels, points: Sequence[Float]
) -> ProjectedAtChannels:
    """The model on its modes around the points, and on the static responses to what was excited or
    pulled.
    """
    size = max(SIZES.vectors, 2 * model.model.count)
    if not isinstance(model, AtChannels):
        return replace(model, model=condensed(model.model, points, size))
    small = condensed(model.model, points, size)
    if c.session.config.residual and updates_candidates(c.session):
        small = flexible(small, c.measured, model.loaded)
    return replace(model, model=small)


@dataclass(frozen=True, eq=False)
class DataScreening:
    """The [[residual]]s of the study's own deck, as a screening of candidates sees them.

    Attributes
    ----------
    configuration : StudyConfiguration
        The study's own.
    candidates : tuple of Candidate
        All that are screened.
    start : ReducedModel
        The deck without a parameter, with the responses to unit loads at the touched channels.
    """

    configuration: StudyConfiguration
    candidates: tuple[Candidate, ...]
    start: ReducedModel

    @classmethod
    def of(
        cls, configuration: StudyConfiguration, candidates: tuple[Candidate, ...]
    ) -> DataScreening:
        """On the deck as it is.

        Raises
        ------
        DataError
            As `objective.data_of`.
        """
        deck = configuration.reduced(ParameterSet(()), quiet)
        data_of(configuration, deck)
        bare = cls(configuration, candidates, deck.model)
        return replace(bare, start=bare.loaded(deck).model)

    @cached_property
    def chosen(self) -> ParameterSet:
        """All candidates."""
        return parameters(self.candidates)

    @cached_property
    def touched(self) -> Int:
        """Channels that were struck or pulled, and those whose deflections were read."""
        c = self.configuration
        read = [name for m in c.measured if m.static for name in m.outputs]
        return np.unique([*c.loaded, *c.rows(read)]).astype(np.int64)

    @cached_property
    def mass(self) -> tuple[Float, Float]:
        """The rigid-body mass (6, 6) of the deck about the origin, and its slopes (p, 6, 6) to the
        factors.
        """
        free = unconstrained(self.configuration.deck.model)
        system = assemble(free)
        r = system.rigid_body()
        return np.asarray(r.T @ (system.mass @ r)), _projected(
            free, self.chosen, system, r
        )[1]

    def strained(self) -> tuple[Float, Float]:
        """λ and vectors of the deck in which a candidate must have a part to be seen: modes and
        responses.
        """
        return responding(self.start, self.touched, np.zeros(0))

    def loaded(self, model: AtChannels) -> AtChannels:
        """With the responses to unit loads at the touched channels in its basis."""
        loads = self.configuration.loaded
        more = flexible(model.model, self.configuration.measured, loads)
        read = np.setdiff1d(self.touched, loads)
        if read.size:
            more, _ = with_responses(more, read, np.zeros(len(more.parameters)))
        return replace(model, model=more, loaded=loads)

    def problem(self, search: AtChannels, aim: Target) -> Problem:
        """Modes and data, over some of the candidates."""
        terms = terms_of(self.configuration, search)
        return Problem((Configuration(search, aim, terms),))

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
        model = at or self.start
        deck = self.configuration.deck
        p = len(self.chosen)
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
        data = on_parameters(
            self.configuration, lambda: self._rigid(everything), tuple(range(p))
        )
        blocks = [Weighted(d.term, d.weight)(here) for d in data]
        slopes = np.concatenate([b.slope for b in blocks]) * self.chosen.std()
        return np.concatenate([b.value for b in blocks]), slopes

    def _rigid(self, x: Float) -> RigidMass:
        """About x (p,), linear in the factors."""
        mass, slopes = self.mass
        none = sparse.csr_array((6, 6))
        here = mass + np.tensordot(self.chosen.factors(x) - 1, slopes, axes=1)
        terms = tuple(
            AffineTerm(power(i), none, sparse.csr_array(s))
            for i, s in enumerate(slopes)
        )
        whole = AffineSystem(none, sparse.csr_array(here), self.chosen, terms, none)
        return RigidMass(whole, np.eye(6))


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
