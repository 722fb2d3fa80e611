"""Updating and localisation without the stages of a study: what ringtrue update and localise do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.errors import DataError, NumericalError, about
from ringtrue.io.modes import read_modes, read_std
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.model import Model
from ringtrue.model.ports import ModalSolver, ModesRequest
from ringtrue.reduction.parametric import ReducedModel, condensed, modes_of
from ringtrue.shapes.complexity import realise_modes
from ringtrue.solvers.observed import PRINTED, UNTOLD, FullModel, reduced
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.measured_data import (
    NO_FRFS,
    Data,
    Measured,
    channels_of,
    check_moving,
    excited,
    flexible,
    read_measured,
    residual_data,
    rigid_mass,
)
from ringtrue.study.objective import (
    LOSSES,
    constraints,
    course_of,
    further_starts,
    mass_at,
    minimise,
    modal_terms,
)
from ringtrue.study.opened import AtChannels, Opened, lump_places, with_lumps
from ringtrue.study.placing import placed, seats
from ringtrue.study.reference import highest, locks, measured_part, settings
from ringtrue.study.results import Seat
from ringtrue.study.supplied import pair_frequencies, supplied_frfs, without_channels
from ringtrue.updating.identifiability import ALIKE, stood_for, unmoved
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.residuals.modal import Weighted
from ringtrue.updating.selection.candidates import Candidate, CandidateSettings, membership
from ringtrue.updating.selection.effects import Dropped, effective, reduced_candidates
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.localisation import reduced_errors
from ringtrue.updating.selection.proposal import Proposal, propose
from ringtrue.updating.selection.screening import (
    LEADING,
    SMALL,
    conflicts,
    drawn,
    passed_over,
    screened,
)
from ringtrue.updating.solver import Solution
from ringtrue.updating.strategy import Verified, displaced, solve_verified, whole_cost
from ringtrue.updating.target import Target, Weights, match

AGREE = 1e-4  # relative frequency error of the reduced model that is accepted at the end


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
        whole, notes = found.modes, found.notes
        config = config.model_copy(update={"test": None, "update": config.update.of_frequencies()})
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
        lent=modes.lent,
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
    """The objective on a deck, what was measured beside the modes, and where the channels on a
    sheet are read.

    On a reduced model, or on the modes that `engine` finds anew at each point; `base` is the folder
    of the study.
    """
    if engine is None:
        problem, data, seen = _reduced(opened, config, target, modes, base)
    else:
        problem, seen = _by_runs(
            opened, config, target=target, modes=modes, engine=engine, base=base
        )
        data = ()
    sheet = _sheet(config, base)
    places = seats(seen, sheet) if sheet is not None else ()
    return replace(problem, loss=LOSSES[config.update.loss]), data, places


def not_told_apart(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Candidates that are held at the deck's values, with those that stand for them
    (`identifiability.stood_for`).

    Those of the largest effect stand for others.
    """
    parameters = problem.parameters
    weighted = problem.evaluate(np.zeros(problem.size)).slope * parameters.std()
    return stood_for(weighted, parameters.names)


def unmoved_by(solution: Solution) -> Bool:
    """Parameters (p,) whose change is not worth a new value in the deck."""
    at = solution.end.points[0]
    fe = at.every[:, 1]
    slopes = 0.5 * at.now.d_lambda[fe] / (2 * np.pi * at.now.frequencies[fe, None]) ** 2
    return unmoved(solution.x, solution.std, slopes)


def _reduced(
    opened: Opened, config: StudyConfig, target: Target, modes: ModeSet, base: Path
) -> tuple[Problem, tuple[Data, ...], Observation]:
    """The objective on the reduced model of the deck, what was measured beside the modes, and the
    channels of both.
    """
    assert config.model is not None
    model, parameters, units = opened.model, config.candidates(), config.model.units
    found = _measured(config, modes, base)
    named = tuple(dict.fromkeys((*modes.channels, *channels_of(found))))
    at = {c: i for i, c in enumerate(named)}
    loaded = excited(found, at)
    observation = _observation(opened, config, modes.channels, base)
    if more := named[len(modes.channels) :]:
        with about("[[residual]]"):
            observation = observation.and_also(_observation(opened, config, more, base))
    top = highest(target.frequencies, target.pairing)
    count = len(opened.modes(top).modes)
    basis = reduced(model, parameters, observation, count)
    check_moving(found, at, basis.basis.observe)
    seen = AtChannels(flexible(basis, found, loaded), np.arange(len(modes.channels)), loaded)
    every = tuple(range(len(parameters)))
    data = tuple(
        residual_data(m, at, units, lambda: rigid_mass(model, parameters), every) for m in found
    )
    modal = modal_terms(
        config.update, lambda: mass_at(opened, observation, modes.channels, config, top)
    )
    terms = (*modal, *(Weighted(d.term, d.weight) for d in data))
    rows, limits = constraints(config, parameters)
    return (
        Problem((Configuration(seen, target, terms),), rows=rows, limits=limits),
        data,
        observation,
    )


def _measured(config: StudyConfig, modes: ModeSet, base: Path) -> list[Measured]:
    """What was measured beside the modes; FRFs without a file are those of [test] frfs."""
    frfs, why = None, NO_FRFS
    if config.test is not None and any(s.kind == "frf" and s.file is None for s in config.residual):
        files = [base / f for f in config.test.frfs]
        if (sheet := _sheet(config, base)) is not None:
            frfs, _ = supplied_frfs(files, sheet, config.test.leave_out)
        if config.test.log and not files:
            why = (
                f"`ringtrue run` makes FRFs of the hammer records of {config.test.log}, an "
                "updating by itself does not"
            )
    return [read_measured(s, base, modes, frfs, why) for s in config.residual]


def _sheet(config: StudyConfig, base: Path) -> TestModel | None:
    """The sensor sheet of the study, if it has one."""
    return (
        read_sensor_sheet(base / config.test.sheet).model
        if config.test and config.test.sheet
        else None
    )


def _observation(
    opened: Opened,
    config: StudyConfig,
    channels: tuple[str, ...],
    base: Path,
    dofs: DofSet | None = None,
) -> Observation:
    """The channels of the test modes: on the sheet of the study, if it has one."""
    sheet, c = (
        base / config.test.sheet if config.test and config.test.sheet else None,
        config.correlate,
    )
    return placed(
        opened, channels, sheet, tolerance=c.tolerance, method=c.match, align=c.align, dofs=dofs
    )


def _by_runs(
    opened: Opened,
    config: StudyConfig,
    target: Target,
    modes: ModeSet,
    engine: ModalSolver,
    base: Path,
) -> tuple[Problem, Observation]:
    """The objective on the modes that a solver finds anew at each point, and the channels."""
    model, parameters = opened.model, config.candidates()
    with engine.open(model) as analysis:
        observation = _observation(opened, config, modes.channels, base, analysis.dofs)
    full = FullModel(model, parameters, observation, ModesRequest(2 * len(modes)), engine)
    top = highest(target.frequencies, target.pairing)
    full = full.reaching(top)
    terms = modal_terms(
        config.update, lambda: mass_at(opened, observation, modes.channels, config, top)
    )
    rows, limits = constraints(config, parameters)
    return Problem((Configuration(full, target, terms),), rows=rows, limits=limits), observation


def solved(
    problem: Problem, u: UpdateSection, seed: int, checkpoint: Path | None, show: Progress
) -> Verified:
    """As a study updates a set of parameters, on a basis verified by full solutions.

    From further starts, too, where used modes that the model has are left without partner; the end
    of lower J.
    """
    if isinstance(problem.configurations[0].model, FullModel):
        return _on_full(problem, u, seed, checkpoint, show)
    done, more = _on_basis(problem, u, seed, checkpoint, show), further_starts(u)
    if more is None or checkpoint is not None or not displaced(problem, done.solution.end):
        return done
    show(0.5, "modes without partner: further starts")
    try:
        other = _on_basis(problem, more, seed, checkpoint, show)
    except NumericalError:  # the end from the deck stands
        return done
    return min(done, other, key=lambda d: whole_cost(problem, d.solution.end))


def _on_full(
    problem: Problem, u: UpdateSection, seed: int, checkpoint: Path | None, show: Progress
) -> Verified:
    """On modes that a solver finds anew at each point."""
    model, course = problem.configurations[0].model, course_of(u)
    assert isinstance(model, FullModel)
    course = replace(course, method=replace(course.method, step=PRINTED, gradient=UNTOLD))
    end = minimise(problem, u, seed, show, course=course, told=show, checkpoint=checkpoint)
    return Verified(end.solution, end.problem, 0.0, model.ledger.runs)


def _on_basis(
    problem: Problem, u: UpdateSection, seed: int, checkpoint: Path | None, show: Progress
) -> Verified:
    def at(p: Problem, y: Float | None) -> tuple[Solution, Problem]:
        end = minimise(p, u, seed, show, start=y, checkpoint=checkpoint)
        return end.solution, end.problem

    return solve_verified(problem, solved=at, tolerance=AGREE, progress=show)


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
    """

    proposal: Proposal
    model: Model
    candidates: tuple[Candidate, ...]
    dropped: tuple[Dropped, ...]
    screened: tuple[str, ...]
    made: int


def propose_parameters(
    opened: Opened,
    test: ModeSet,
    bridge: Observation,
    settings: CandidateSettings,
    pool: int,
    most: int,
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
    pool, most : int
        Candidates that are looked at closely, and parameters that are proposed, at most.
    """
    model, analysis, every = opened.model, opened.analysis, generate(opened.model, settings)
    if "lump" in settings.kinds:
        model, more = with_lumps(opened, lump_places(opened, bridge), settings)
        every += more
    test = test.take(np.flatnonzero(test.frequencies > 0))
    weights, used = Weights(shape=0.0) if test.lent else Weights(), np.ones(len(test), dtype=bool)
    aim = Target(test.frequencies, test.shapes, np.zeros(len(test)), used, weights, lent=test.lent)
    count = _mode_count(len(test))
    modes = analysis.eigen(ModesRequest(modes_of(count)), part(progress, 0.0, 0.1))
    progress(0.1, f"energies of {len(every)} candidates")
    moved, lost = effective(model, analysis.system, every, modes.values, modes.vectors)

    def reduced_to(some: tuple[Candidate, ...], progress: Progress = quiet) -> ReducedModel:
        return reduced_candidates(
            model,
            analysis.system,
            some,
            bridge,
            count,
            pencil=analysis.pencil,
            modes=modes,
            progress=progress,
        )

    def small(whole: ReducedModel, some: tuple[Candidate, ...]) -> ReducedModel:
        points = drawn(whole.parameters, conflicts(model, some), np.random.default_rng(0))
        return condensed(whole, points, max(SMALL, 2 * whole.count))

    def look(some: tuple[Candidate, ...]) -> tuple[ReducedModel, ReducedModel]:
        whole = reduced_to(some)
        return small(replace(whole, count=min(whole.count, _mode_count(LEADING))), some), whole

    progress(0.15, f"what {len(moved)} candidates explain")
    keep = screened(
        model,
        analysis.system,
        candidates=moved,
        aim=aim,
        observe=sparse.csr_array(bridge.matrix @ analysis.system.transform),
        modes=(modes.values, modes.vectors),
        look=look,
        pool=pool,
        most=most,
        alike=ALIKE,
        progress=part(progress, 0.15, 0.4),
    )
    reduced = reduced_to(keep, part(progress, 0.4, 0.55))
    progress(0.55, "error indicators")
    found = propose(
        small(reduced, keep),
        aim,
        most=most,
        apart=conflicts(model, keep),
        errors=_local_errors(opened, reduced, aim, keep),
        words=[c.what for c in keep],
        passed_over=passed_over(moved, keep),
        progress=part(progress, 0.55, 1.0),
    )
    names = {c.name for c in keep}
    return DirectProposal(
        proposal=found,
        model=model,
        candidates=keep,
        dropped=lost,
        screened=tuple(c.name for c in moved if c.name not in names),
        made=len(every),
    )


def _mode_count(modes: int) -> int:
    """Modes of the model to compare so many of a test with."""
    return int(EXTRA * modes) + 4


def _local_errors(
    opened: Opened, reduced: ReducedModel, aim: Target, keep: tuple[Candidate, ...]
) -> dict[str, Float]:
    """Concentration of the local errors on each candidate."""
    pairs, _, _ = match(aim, reduced.modes(np.zeros(len(keep))))
    if not len(pairs) or aim.lent:
        return {}
    f, shapes = aim.frequencies[pairs[:, 0]], aim.shapes[:, pairs[:, 0]]
    rows = np.arange(len(reduced.basis.observe))
    found, _ = reduced_errors(
        opened.model,
        opened.analysis.system,
        reduced=reduced,
        rows=rows,
        frequencies=f,
        shapes=shapes,
        partners=pairs[:, 1],
    )
    return dict(found.concentration(membership(opened.model, keep)))
