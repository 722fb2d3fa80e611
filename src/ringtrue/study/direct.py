"""Updating and localisation without the stages of a study: what ringtrue update and localise do."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.errors import DataError, NumericalError, about
from ringtrue.io.modes import read_modes, read_std
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.model import Model
from ringtrue.model.ports import ModalSolver, ModesRequest
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.dense_models import ReducingAnalysis, condensed
from ringtrue.reduction.expansion import ShapeReadings
from ringtrue.reduction.parametric import (
    KnownModes,
    ReducedModel,
    modes_of,
    reduced_model,
)
from ringtrue.shapes import realise_modes
from ringtrue.solvers.embedded import EmbeddedAnalysis
from ringtrue.solvers.observed import FullModel, reduced
from ringtrue.study.config import StudyConfig
from ringtrue.study.measured_data import (
    Data,
    Measured,
    MeasuredModel,
    Source,
    channels_of,
    check_moving,
    excited,
    flexible,
    read_measured,
    rigid_mass,
)
from ringtrue.study.objective import (
    LOSSES,
    Minimisation,
    constraints,
    course_of_runs,
    further_starts,
    modal_terms,
)
from ringtrue.study.opened import (
    AtChannels,
    Opened,
    ProjectedAtChannels,
    lump_places,
    with_lumps,
)
from ringtrue.study.placing import alignment, placed, seats
from ringtrue.study.reference import highest, locks, measured_part, settings
from ringtrue.study.results import Seat
from ringtrue.study.supplied import pair_frequencies, supplied_frfs, without_channels
from ringtrue.updating.identifiability import least_proven, stood_for
from ringtrue.updating.problem import Configuration, Problem, held_to, single
from ringtrue.updating.residuals.modal import Weighted
from ringtrue.updating.selection.candidates import (
    Candidate,
    CandidateSettings,
    membership,
)
from ringtrue.updating.selection.candidates import parameters as candidate_parameters
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.localisation import EXPANSION_MISFIT, reduced_errors
from ringtrue.updating.selection.missing_members import (
    FittedModel,
    MissingMember,
    missing_members,
)
from ringtrue.updating.selection.proposal import Proposal, propose
from ringtrue.updating.selection.screening import (
    SIZES,
    Dropped,
    ScreenedDeck,
    conflicts,
    drawn,
    effective,
    passed_over,
    screened,
)
from ringtrue.updating.selection.subset_search import SearchSettings
from ringtrue.updating.solver import Solution
from ringtrue.updating.strategy import Verified, displaced, solve_verified, whole_cost
from ringtrue.updating.target import Target, Weights, match
from ringtrue.updating.validation import Misfit, misfits

# relative frequency error of the reduced model that is accepted at the end
AGREE = 1e-4


def read_target(
    config: StudyConfig, opened: Opened, test: Path
) -> tuple[StudyConfig, Target, ModeSet, tuple[str, ...]]:
    """What a file of test modes says, less the channels that the study leaves out, and its modes;
    all are used.

    Returns
    -------
    config : StudyConfig
        The study; where the file has no shapes, comparing frequencies alone.
    target : Target
    modes : ModeSet
    notes : tuple of str
        What is to be said of them.

    Raises
    ------
    DataError
        If no mode was measured at a common set of channels.
    """
    whole, (spread, _), notes = read_modes(test), read_std(test), tuple[str, ...]()
    if len(whole) and not whole.channels:
        found = pair_frequencies(whole, opened, settings(config), locks(config))
        whole = found.modes
        notes = found.notes
        config = config.model_copy(
            update={"test": None, "update": config.update.of_frequencies()}
        )
    if config.test:
        whole = without_channels(whole, config.test.leave_out)
    kept, channels = measured_part(whole)
    modes: ModeSet = realise_modes(whole.take(kept).rows(channels))
    if not len(modes) or not modes.channels:
        raise DataError(f"{test}: no mode was measured at a common set of channels")
    relative = np.nan_to_num(spread[kept] / modes.frequencies, nan=0.0)
    u = config.update
    weights = Weights(u.frequency_error, u.mac_error, u.shape_weight)
    shapes = np.asarray(modes.shapes.real, dtype=np.float64)
    used = np.ones(len(modes), dtype=bool)
    target = Target(
        frequencies=modes.frequencies,
        shapes=shapes,
        std=relative,
        used=used,
        weights=weights,
        pairing=settings(config),
        frequency_only=modes.frequency_only,
    )
    return config, target, modes, notes


def direct_problem(
    opened: Opened,
    config: StudyConfig,
    target: Target,
    modes: ModeSet,
    base: Path,
    engine: ModalSolver | None,
) -> tuple[Problem, tuple[Data, ...], tuple[Seat, ...]]:
    """The objective on a deck, its [[residual]]s, and where the channels on a sheet are read.

    On a reduced model (by the solver of `opened` where it has one), or on the modes that `engine`
    finds anew at each point; `base` is the folder of the study.
    """
    assert config.model is not None
    parameters = config.candidates()
    c = config.correlate
    sheet = _sheet(opened, config, base)
    top = highest(target.frequencies, target.pairing)

    def observed(channels: tuple[str, ...], dofs: DofSet | None = None) -> Observation:
        named = config.test.sheet if config.test else None
        with about(base / named) if named else nullcontext():
            return placed(
                opened,
                channels,
                sheet,
                tolerance=c.tolerance,
                method=c.match,
                dofs=dofs,
            )

    data: tuple[Data, ...] = ()
    model: ProjectedAtChannels | FullModel
    if engine is not None:
        with engine.open(opened.model) as analysis:
            look = observed(modes.channels, analysis.dofs)
        request = ModesRequest(2 * len(modes))
        full = FullModel(opened.model, parameters, look, request, engine)
        model = full.reaching(top)
    elif opened.engine is not None:
        look = observed(modes.channels)
        model = _reduced_there(opened, parameters, look, top)
    else:
        measured = _measured(config, modes, base, sheet)
        look = observed(modes.channels)
        more = [c for c in channels_of(measured) if c not in set(modes.channels)]
        if more:
            with about("[[residual]]"):
                look = look.and_also(observed(tuple(more)))
        model = _reduced_here(
            opened, parameters, look, measured=measured, modes=modes, top=top
        )
        on = MeasuredModel(
            {name: i for i, name in enumerate(look.channels)},
            UNIT_SYSTEMS[config.model.units],
            lambda: rigid_mass(opened.model, parameters),
            tuple(range(len(parameters))),
        )
        data = tuple(m.data(on) for m in measured)
    kilograms = UNIT_SYSTEMS[config.model.units].kilograms
    modal = modal_terms(config.update, modes.norm, kilograms)
    terms = (*modal, *(Weighted(d.term, d.weight) for d in data))
    limit_rows, limits = constraints(config, parameters)
    problem = Problem(
        (Configuration(model, target, terms),),
        loss=LOSSES[config.update.loss],
        rows=limit_rows,
        limits=limits,
    )
    return problem, data, seats(look, sheet.model) if sheet is not None else ()


def _reduced_there(
    opened: Opened, parameters: ParameterSet, look: Observation, top: float
) -> ProjectedAtChannels:
    """The model that the solver of the deck reduces, with its modes up to `top`, Hz."""
    assert opened.engine is not None
    with opened.engine.open(whole_mesh(opened.model)) as analysis:
        assert isinstance(analysis, ReducingAnalysis)
        count = len(opened.modes_by(analysis, top).modes)
        held = analysis.reduced(parameters, look.matrix, count, top)
    return ProjectedAtChannels(held, np.arange(len(look.channels)))


def _reduced_here(
    opened: Opened,
    parameters: ParameterSet,
    look: Observation,
    *,
    measured: Sequence[Measured],
    modes: ModeSet,
    top: float,
) -> AtChannels:
    """The reduced model at the channels of the test modes, which are the first of `look`, with the
    modes up to `top`, Hz, and as far up as other data were measured.
    """
    top = max([top, *(m.highest for m in measured)])
    basis = reduced(opened.model, parameters, look, len(opened.modes(top).modes))
    at = {name: i for i, name in enumerate(look.channels)}
    check_moving(measured, at, basis.basis.observe)
    loaded = excited(measured, at)
    rows = np.arange(len(modes.channels))
    return AtChannels(flexible(basis, measured, loaded), rows, loaded)


def not_told_apart(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Candidates that are held at the deck's values, with those that stand for them
    (`identifiability.stood_for`).

    Those of the largest effect stand for others.
    """
    parameters = problem.parameters
    weighted = problem.evaluate(np.zeros(problem.size)).slope * parameters.std()
    return stood_for(weighted, parameters.names)


def _measured(
    config: StudyConfig, modes: ModeSet, base: Path, sheet: SensorSheet | None
) -> list[Measured]:
    """What the [[residual]]s name; FRFs without a file are those of [test] frfs."""
    source = Source(base, modes)
    frfs = None
    test = config.test
    if test is not None and any(
        s.kind == "frf" and s.file is None for s in config.residual
    ):
        files = [base / f for f in test.frfs]
        if sheet is not None:
            frfs, _ = supplied_frfs(files, sheet.model, test.leave_out)
        if test.log and not files:
            why = (
                f"`ringtrue run` makes FRFs of the hammer records of {test.log}, an "
                "updating by itself does not"
            )
            source = replace(source, why=why)
    return [read_measured(s, replace(source, frfs=frfs)) for s in config.residual]


def _sheet(opened: Opened, config: StudyConfig, base: Path) -> SensorSheet | None:
    """The sensor sheet of the study, laid onto the deck; None without one."""
    if config.test is None or config.test.sheet is None:
        return None
    sheet = read_sensor_sheet(base / config.test.sheet)
    if not config.correlate.align:
        return sheet
    found = alignment(sheet.model, opened, config.correlate.align)
    return replace(sheet, model=found.move(sheet.model))


def solved(problem: Problem, how: Minimisation, show: Progress) -> Verified:
    """As a study updates a set of parameters, on a basis verified by full solutions.

    From further starts, too, where used modes that the model has are left without partner or a
    kind of residuals is not fitted; the end of lower J.
    """
    done = _minimised(problem, how, show)
    more = further_starts(how.settings)
    by_runs = isinstance(problem.configurations[0].model, FullModel)
    if more is None or how.checkpoint or by_runs:
        return done
    if not displaced(problem, done.solution.end) and not not_fitted(problem, done):
        return done
    show(0.5, "modes without partner or data that are not fitted: further starts")
    try:
        other = _minimised(problem, replace(how, settings=more), show)
    except NumericalError:  # the end from the deck stands
        return done
    return min(done, other, key=lambda d: whole_cost(problem, d.solution.end))


def as_stated(problem: Problem, done: Verified) -> Problem:
    """The problem with its errors as stated, on the model that was verified at the end."""
    verified = done.problem.configurations[0].model
    return replace(
        problem, configurations=(replace(problem.configurations[0], model=verified),)
    )


def not_fitted(
    problem: Problem, done: Verified, data: Sequence[Data] = ()
) -> tuple[Misfit, ...]:
    """The kinds of residuals that the end does not fit within the errors that are stated."""
    stated = as_stated(problem, done)
    return misfits(stated, stated.evaluate(done.solution.y), [data])


def only_proven(
    problem: Problem,
    done: Verified,
    how: Minimisation,
    level: float,
    show: Progress = quiet,
) -> tuple[Problem, Verified, tuple[str, ...]]:
    """Without the parameters whose interval holds 1: the least proven one is held at the deck's
    value and the others are fitted anew, until all that are left are proven.

    Returns
    -------
    problem : Problem
        With the parameters that are left free; a last one that is not proven stays.
    done : Verified
    dropped : tuple of str
        Those that are not written.
    """
    dropped = list[str]()
    while how.settings.write == "proven":
        solution = done.solution
        weakest = least_proven(solution.y, solution.std, level)
        if weakest is None:
            break
        name = problem.parameters.names[int(problem.link[:, weakest].argmax())]
        dropped.append(name)
        rest = np.delete(np.arange(problem.size), weakest)
        if not rest.size:
            break
        free = np.flatnonzero(problem.link.any(axis=1)).tolist()
        names = [problem.parameters.names[i] for i in free]
        problem = held_to(as_stated(problem, done), [n for n in names if n != name])
        again = replace(how, checkpoint=None)
        done = _minimised(problem, again, show, start=solution.y[rest])
    return problem, done, tuple(dropped)


def _minimised(
    problem: Problem, how: Minimisation, show: Progress, start: Float | None = None
) -> Verified:
    """The end on a basis verified by full solutions, or on modes that a solver finds anew at each
    point.
    """
    model = problem.configurations[0].model
    if isinstance(model, FullModel):
        # its runs are counted where they are started
        how = replace(how, course=course_of_runs(how.settings), steps=show, workers=1)
        end = how.run(problem, show, start)
        return Verified(end.solution, end.problem, 0.0, model.ledger.runs)

    def at(p: Problem, y: Float | None) -> tuple[Solution, Problem]:
        end = how.run(p, show, start=y)
        return end.solution, end.problem

    return solve_verified(
        problem, solved=at, start=start, tolerance=AGREE, progress=show
    )


EXTRA = 1.5  # modes of the model, as a multiple of those of the test


@dataclass(frozen=True, slots=True, eq=False)
class DirectProposal:
    """A proposal, and what it was chosen from.

    Attributes
    ----------
    proposal : Proposal
    model : Model
        The deck, with places for masses that it may lack.
    candidates : tuple of Candidate
        That were looked at closely.
    dropped : tuple of Dropped
        That change no mode.
    screened : tuple of str
        That were not looked at closely.
    made : int
        All that were made from the deck.
    members : tuple of MissingMember
        That the deck may lack, the first first.
    """

    proposal: Proposal
    model: Model
    candidates: tuple[Candidate, ...]
    dropped: tuple[Dropped, ...]
    screened: tuple[str, ...]
    made: int
    members: tuple[MissingMember, ...] = ()


def propose_parameters(
    opened: Opened,
    test: ModeSet,
    bridge: Observation,
    settings: CandidateSettings,
    limits: tuple[int, int],
    progress: Progress = quiet,
) -> DirectProposal:
    """Which of the candidates made from a deck the modes of a test ask for.

    Parameters
    ----------
    opened : Opened
    test : ModeSet
        Real shapes at the channels of `bridge`; those at 0 Hz or below are left out. Where
        the shapes are those of the deck (`study.supplied`), frequencies alone are compared.
    bridge : Observation
    settings : CandidateSettings
    limits : (int, int)
        Candidates that are looked at closely, and parameters that are proposed, at most.
    """
    model = opened.model
    analysis = opened.analysis
    every = generate(model, settings)
    pool, most = limits
    if "lump" in settings.kinds:
        model, more = with_lumps(opened, lump_places(opened, bridge), settings)
        every += more
    test = test.take(np.flatnonzero(test.frequencies > 0))
    aim = Target(
        frequencies=test.frequencies,
        shapes=test.shapes,
        std=np.zeros(len(test)),
        used=np.ones(len(test), dtype=bool),
        weights=Weights(shape=0.0) if test.frequency_only else Weights(),
        frequency_only=test.frequency_only,
    )
    count = mode_count(len(test))
    modes = analysis.eigen(ModesRequest(modes_of(count)), part(progress, 0.0, 0.1))
    progress(0.1, f"energies of {len(every)} candidates")
    moved, lost = effective(model, analysis.system, every, modes.values, modes.vectors)
    over = _OverCandidates(model, analysis, bridge, modes, count)
    progress(0.15, f"what {len(moved)} candidates explain")
    deck = ScreenedDeck(
        model=model,
        system=analysis.system,
        candidates=moved,
        observe=sparse.csr_array(bridge.matrix @ analysis.system.transform),
        values=modes.values,
        vectors=modes.vectors,
    )
    search = SearchSettings(most)
    screening = part(progress, 0.15, 0.4)
    keep = screened(
        deck, aim, over.screening, pool, settings=search, progress=screening
    )
    reduced = over.reduced(keep, part(progress, 0.4, 0.55))
    progress(0.55, "error indicators")
    found = propose(
        single(over.condensed(reduced, keep), aim),
        replace(search, passed_over=passed_over(moved, keep)),
        conflicts=conflicts(model, keep),
        errors=_local_errors(opened, reduced, aim, keep),
        words=[c.what for c in keep],
        progress=part(progress, 0.55, 1.0),
    )
    names = {c.name for c in keep}
    rows = np.arange(len(test.channels))
    fitted = FittedModel.after(found, analysis.system, reduced, rows, aim)
    return DirectProposal(
        proposal=found,
        model=model,
        candidates=keep,
        dropped=lost,
        screened=tuple(c.name for c in moved if c.name not in names),
        made=len(every),
        members=missing_members(model, fitted),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _OverCandidates:
    """A deck with its modes, to be reduced over some of its candidates; `count` modes are compared
    with a test.
    """

    model: Model
    analysis: EmbeddedAnalysis
    bridge: Observation
    modes: EigenModes
    count: int

    def reduced(
        self, some: tuple[Candidate, ...], progress: Progress = quiet
    ) -> ReducedModel:
        """The reduced model over candidates."""
        affine = observed_system(
            self.model,
            self.analysis.system,
            candidate_parameters(some),
            self.bridge,
            progress=part(progress, 0.0, 0.5),
        )
        known = KnownModes(self.analysis.pencil, self.modes)
        late = part(progress, 0.5, 1.0)
        return reduced_model(affine, self.count, known=known, progress=late)

    def condensed(
        self, whole: ReducedModel, some: tuple[Candidate, ...]
    ) -> ReducedModel:
        """A smaller one, for the search, that holds the modes at points drawn at random."""
        points = drawn(
            whole.parameters, conflicts(self.model, some), np.random.default_rng(0)
        )
        return condensed(whole, points, max(SIZES.vectors, 2 * whole.count))

    def screening(
        self, some: tuple[Candidate, ...]
    ) -> tuple[ReducedModel, ReducedModel]:
        """Both, the smaller one with as few modes as candidates are screened by."""
        whole = self.reduced(some)
        few = replace(whole, count=min(whole.count, mode_count(SIZES.modes)))
        return self.condensed(few, some), whole


def mode_count(modes: int) -> int:
    """Modes of the model to compare so many of a test with."""
    return int(EXTRA * modes) + 4


def _local_errors(
    opened: Opened, reduced: ReducedModel, aim: Target, keep: tuple[Candidate, ...]
) -> dict[str, Float]:
    """Concentration of the local errors on each candidate."""
    pairs, _, _ = match(aim, reduced.modes(np.zeros(len(keep))))
    if not len(pairs) or aim.frequency_only:
        return {}
    test = pairs[:, 0]
    observe = reduced.basis.observe
    readings = ShapeReadings(
        observe, aim.shapes[:, test], aim.frequencies[test], EXPANSION_MISFIT
    )
    system = opened.analysis.system
    found, _ = reduced_errors(opened.model, system, reduced, readings, pairs[:, 1])
    return dict(found.concentration(membership(opened.model, keep)))
