"""What a study minimises, and how an updating proceeds: residuals, limits, starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import Norm, elastic
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.side_by_side import Workers
from ringtrue.errors import ConfigError, DataError
from ringtrue.solvers.observed import PRINTED, UNTOLD, FullModel
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.measured_data import Data, MeasuredModel, check_moving
from ringtrue.study.opened import AtChannels, ProjectedAtChannels
from ringtrue.study.reference import followed, settings, used_mask
from ringtrue.study.results import CorrelateStage
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.updating.problem import (
    Configuration,
    Evaluated,
    Huber,
    Problem,
    RobustLoss,
    Squares,
)
from ringtrue.updating.residuals.modal import (
    Eigenvalues,
    Frequencies,
    Mac,
    ModalMasses,
    Quantity,
    Shapes,
    Term,
    Weighted,
)
from ringtrue.updating.residuals.static import RigidMass
from ringtrue.updating.solver import (
    Method,
    Solution,
    StartSettings,
    latin_hypercube,
    multi_start,
    solve,
    staged,
)
from ringtrue.updating.strategy import Course, Settled, by_modes, joined_by_all
from ringtrue.updating.strategy import settled as settled_from
from ringtrue.updating.target import Target, Weights

LOSSES: dict[str, RobustLoss] = {"squares": Squares(), "huber": Huber()}
MASSES = "modal masses"
KINDS = ("eigenvalues", "frequencies", "shapes", "mac", MASSES)


def target(c: StudyConfiguration, u: UpdateSection | None = None) -> Target:
    """The elastic modes of a test as the updating sees them: those left out are marked.

    `u` stands in for the [update] of the study.
    """
    config = c.session.config
    u = u or config.update
    reference = c.reference
    test = reference.elastic
    confident = test.confidence >= config.identify.confidence
    known = None
    if isinstance(c.tested, CorrelateStage):
        known = followed(test, c.tested.fe_initial, config)
    return Target(
        frequencies=test.frequencies,
        shapes=test.shapes,
        std=np.nan_to_num(reference.elastic_std.frequency / test.frequencies, nan=0.0),
        used=used_mask(len(test), reference.left_out) & confident,
        weights=Weights(u.frequency_error, u.mac_error, u.shape_weight),
        pairing=settings(config),
        followed=known,
        frequency_only=test.frequency_only,
    )


def problem_of(
    session: Session,
    models: Sequence[ProjectedAtChannels | FullModel],
    u: UpdateSection | None = None,
) -> Problem:
    """The objective over all configurations, the parameters of the models free."""
    u = u or session.config.update
    parts = []
    for c, model in zip(session.configurations, models, strict=True):
        name = c.name or "the deck of the study"
        parts.append(
            Configuration(model, target(c, u), terms_of(c, model, u), name=name)
        )
    problem = Problem(tuple(parts), loss=LOSSES[u.loss])
    rows, limits = constraints(session.config, problem.parameters)
    return replace(problem, rows=rows, limits=limits)


def constraints(config: StudyConfig, parameters: ParameterSet) -> tuple[Float, Float]:
    """Rows (c, p) and limits (c,) of the [[constraint]]s that name a parameter; those not there
    stay at x = 0.
    """
    rows = [[c.terms.get(n, 0.0) for n in parameters.names] for c in config.constraint]
    kept = [i for i, r in enumerate(rows) if any(r)]
    limits = np.array([config.constraint[i].most for i in kept])
    return np.array([rows[i] for i in kept]).reshape(len(kept), len(parameters)), limits


def terms_of(
    c: StudyConfiguration,
    model: ProjectedAtChannels | FullModel,
    u: UpdateSection | None = None,
) -> tuple[Term, ...]:
    """All kinds of residuals of a configuration: those of its modes, then its [[residual]]s."""
    unit = c.session.unit.kilograms
    modal = modal_terms(u or c.session.config.update, c.reference.elastic.norm, unit)
    if not isinstance(model, AtChannels):  # by another solver: modes alone
        return modal
    return (*modal, *(Weighted(d.term, d.weight) for d in data_of(c, model)))


def modal_terms(u: UpdateSection, norm: Norm, kilograms: float) -> tuple[Term, ...]:
    """The kinds of residuals of the paired modes; `kilograms` of the deck's unit of mass.

    Raises
    ------
    ConfigError
        If modal masses are asked for of test modes that have none.
    """
    if MASSES in u.residuals and norm is not Norm.MASS:
        raise ConfigError(
            f'[update] residuals: "{MASSES}" need test modes of unit modal mass; got {norm.value} '
            "shapes. They come from a driving point (`ringtrue ema`); or compare its FRF by a "
            "[[residual]]"
        )
    made: dict[str, Term] = {
        "eigenvalues": Eigenvalues(u.frequency_error),
        "frequencies": Frequencies(u.frequency_error, "log"),
        "mac": Mac(u.mac_error),
        MASSES: ModalMasses(u.mass_error, kilograms),
    }
    if u.shape_weight > 0:
        made["shapes"] = Shapes(u.mac_error, u.shape_weight)
    return tuple(made[k] for k in KINDS if k in u.residuals and k in made)


def data_of(c: StudyConfiguration, model: AtChannels) -> tuple[Data, ...]:
    """The residuals of what was measured besides the modes, on the parameters that are free in a
    model.

    Raises
    ------
    DataError
        If static deflections were measured on a structure that is free to move.
    """
    reduced = model.model
    if any(m.static for m in c.measured):
        f = reduced.modes(np.zeros(len(model.parameters))).frequencies
        if not elastic(f)[0]:
            raise DataError(
                "a static test needs a structure that is held; mode 1 of the deck is at "
                f"{f[0]:.3g} Hz"
            )
    check_moving(c.measured, c.at, reduced.basis.observe)
    every = reduced.system.parameters
    return on_parameters(c, lambda: c.rigid_mass(every), tuple(reduced.active))


def on_parameters(
    c: StudyConfiguration, rigid: Callable[[], RigidMass], active: tuple[int, ...]
) -> tuple[Data, ...]:
    """The residuals of what was measured besides the modes, on the active ones of the parameters
    that `rigid` is over.
    """
    on = MeasuredModel(c.at, c.session.unit, rigid, active)
    return tuple(m.data(on) for m in c.measured)


def data_count(problem: Problem, at: Evaluated) -> float:
    """Number of data: a frequency and a shape each used test mode, lost ones too, and what else was
    measured.

    A kind besides the modes counts as many as its weight says.
    """
    count = 0.0
    kind = 0
    for c in problem.configurations:
        for t in c.terms:
            rows = float((at.kind == kind).sum())
            modes = float(c.target.used.sum())
            count += t.weight * rows if t.quantity is Quantity.OTHER else modes
            kind += 1
    return max(count, 1.0)


FINISHED_STARTS = 3  # of several starts, that go on to the end
FURTHER_STARTS = 8  # where one start leaves modes without partner


def course_of(u: UpdateSection) -> Course:
    """As [update] asks for."""
    weighed = u.discrepancy if u.discrepancy != "found" or u.sharpened else "assumed"
    return Course(
        Method(), u.iterations, "given" if u.prior == "study" else u.prior, weighed
    )


def course_of_runs(u: UpdateSection) -> Course:
    """The same for modes that an external solver has printed."""
    course = course_of(u)
    return replace(course, method=replace(course.method, step=PRINTED, gradient=UNTOLD))


def further_starts(u: UpdateSection) -> UpdateSection | None:
    """[update] from several starts, for an end that leaves used modes without partner; None where
    none are asked for.

    Modes that change places between the deck and the structure make minima in which each is paired
    with its neighbour, and some without partner.
    """
    return (
        u.otherwise({"starts": FURTHER_STARTS}) if u.starts < FURTHER_STARTS else None
    )


@dataclass(frozen=True, slots=True)
class Minimisation:
    """How an objective is minimised.

    Attributes
    ----------
    settings : UpdateSection
    seed : int
        Of the starts.
    course : Course, optional
        In place of that of the settings.
    steps : callable, optional
        Progress of the steps.
    checkpoint : Path, optional
        Where the last iterate is kept.
    workers : int or str
        That several starts are spread over.
    """

    settings: UpdateSection
    seed: int
    course: Course | None = None
    steps: Progress = quiet
    checkpoint: Path | None = None
    workers: Workers = 1

    def run(
        self, problem: Problem, progress: Progress, start: Float | None = None
    ) -> Settled:
        """The end of an updating from a start that the gates have led to, or from where they
        lead: by the modes first, then by FRFs too.
        """
        course = self.course or course_of(self.settings)
        if start is not None:
            return settled_from(problem, course, start=start, progress=self.steps)
        modal = by_modes(problem)
        rough = self.starting_point(modal, progress)
        end = settled_from(modal, course, start=rough.y, progress=self.steps)
        end = replace(end, path=(*rough.history, *end.path[1:]))
        if not any(t.whole for c in problem.configurations for t in c.terms):
            return end
        return joined_by_all(problem, end, course, self.steps)

    def starting_point(self, problem: Problem, progress: Progress) -> Solution:
        """Where the gates lead: the best end of several starts, sets that grow, or the deck."""
        u = self.settings
        course = self.course or course_of(u)
        method = course.method
        limit = course.iterations
        rng = np.random.default_rng([self.seed, 9])
        if u.starts > 1:
            more = latin_hypercube(problem.parameters, u.starts - 1, rng)
            starts = np.vstack([np.zeros(problem.size), more])
            settings = StartSettings(limit, FINISHED_STARTS, self.workers)
            return multi_start(
                problem, starts, method, settings, progress=progress
            ).best
        members = problem.parameters.names
        grown = [[n for n in stage if n in members] for stage in u.stages]
        grown = [g for g in grown if g and len(g) < len(members)]
        start = np.zeros(problem.size)
        if grown:
            parts = staged(
                problem, grown, method, iterations=u.iterations, progress=progress
            )
            start = np.array(parts[-1].x)
        return solve(
            problem,
            method,
            start=start,
            iterations=limit,
            checkpoint=self.checkpoint,
            progress=self.steps,
        )
