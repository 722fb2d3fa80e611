"""Candidates of a study fitted to a file of test modes, without its stages: what `ringtrue update`
does.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.errors import DataError, NumericalError, about
from ringtrue.io.modes_json import read_modes, read_std
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.ports import ModalSolver, ModesRequest
from ringtrue.shapes.complexity import realise_modes
from ringtrue.solvers.observed import PRINTED, UNTOLD, FullModel, reduced
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.course import course_of, further, settled
from ringtrue.study.lent import lent
from ringtrue.study.measured import (
    NO_FRFS,
    Data,
    Measured,
    channels_of,
    check_moving,
    excited,
    flexible,
    measured,
    residual_data,
    rigid_mass,
)
from ringtrue.study.naming import supplied_frfs, without_channels
from ringtrue.study.objective import LOSSES, constraints, mass_at, modal_terms
from ringtrue.study.opened import Opened
from ringtrue.study.parametric import AtChannels
from ringtrue.study.placing import placed
from ringtrue.study.reference import highest, locks, measured_part, settings
from ringtrue.study.results import Seat
from ringtrue.study.seats import seats
from ringtrue.updating.identifiable import stood_for
from ringtrue.updating.objective import Target, Weights
from ringtrue.updating.residuals import Weighted
from ringtrue.updating.settle import displaced, whole_cost
from ringtrue.updating.several import Configuration, Problem
from ringtrue.updating.trust import Solution
from ringtrue.updating.unmoved import unmoved
from ringtrue.updating.verified import Verified, solve_verified

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
        found = lent(whole, opened, settings(config), locks(config))
        whole, notes = found.modes, found.notes
        config = config.model_copy(update={"test": None, "update": config.update.alone()})
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
        modes.frequencies, shapes, relative, used, weights, settings(config), lent=modes.lent
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
        problem, seen = _by_runs(opened, config, target, modes, engine, base)
        data = ()
    sheet = _sheet(config, base)
    places = seats(seen, sheet) if sheet is not None else ()
    return replace(problem, loss=LOSSES[config.update.loss]), data, places


def not_told_apart(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Candidates that are held at the deck's values, with those that stand for them
    (`identifiable.stood_for`).

    Those of the largest effect stand for others.
    """
    parameters = problem.parameters
    weighted = problem.evaluate(np.zeros(problem.size)).slope * parameters.std()
    return stood_for(weighted, parameters.names)


def unmoved_by(solution: Solution) -> Bool:
    """Parameters (p,) whose change is not worth a new value in the deck (`update.unmoved`)."""
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
    return [measured(s, base, modes, frfs, why) for s in config.residual]


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
    done, more = _on_basis(problem, u, seed, checkpoint, show), further(u)
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
    end = settled(problem, u, seed, show, course=course, told=show, checkpoint=checkpoint)
    return Verified(end.solution, end.problem, 0.0, model.ledger.runs)


def _on_basis(
    problem: Problem, u: UpdateSection, seed: int, checkpoint: Path | None, show: Progress
) -> Verified:
    def at(p: Problem, y: Float | None) -> tuple[Solution, Problem]:
        end = settled(p, u, seed, show, start=y, checkpoint=checkpoint)
        return end.solution, end.problem

    return solve_verified(problem, solved=at, tolerance=AGREE, progress=show)
