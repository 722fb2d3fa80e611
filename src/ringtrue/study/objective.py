"""What a study minimises, and how an updating proceeds: residuals, limits, starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import elastic
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import Observation
from ringtrue.errors import ConfigError, DataError
from ringtrue.solvers.observed import FullModel
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.evidence import channel_mass
from ringtrue.study.measured_data import Data, check_moving, residual_data, rigid_mass
from ringtrue.study.opened import AtChannels, Opened
from ringtrue.study.reference import followed, settings, used_mask
from ringtrue.study.results import ConfiguredTest, CorrelateStage
from ringtrue.study.session import OWN, Session
from ringtrue.updating.multistart import global_search, latin_hypercube, multi_start
from ringtrue.updating.problem import Configuration, Evaluated, Huber, Loss, Problem, Squares, Tukey
from ringtrue.updating.residuals.modal import (
    CrossOrthogonality,
    Eigenvalues,
    Frequencies,
    Mac,
    Shapes,
    Term,
    Weighted,
)
from ringtrue.updating.residuals.static import RigidMass
from ringtrue.updating.solver import Method, Solution, solve, staged
from ringtrue.updating.strategy import Course, Settled
from ringtrue.updating.strategy import settled as settled_from
from ringtrue.updating.target import Target, Weights

LOSSES: dict[str, Loss] = {"squares": Squares(), "huber": Huber(), "tukey": Tukey()}
KINDS = ("eigenvalues", "frequencies", "shapes", "mac", "orthogonality")


def names_of(session: Session) -> tuple[str, ...]:
    """The deck of the study and the other configurations."""
    return (OWN, *(c.name for c in session.config.configuration))


def target(session: Session, u: UpdateSection | None = None) -> Target:
    """The elastic modes of the test as the updating sees them: those left out are marked."""
    found: CorrelateStage = session.get("correlate")
    return _target(session, found, u or session.config.update)


def targets(session: Session, u: UpdateSection | None = None) -> tuple[Target, ...]:
    """The same of all configurations, the study's own first."""
    u = u or session.config.update
    others: tuple[ConfiguredTest, ...] = (
        session.get("configurations").items if session.config.configuration else ()
    )
    return (target(session, u), *(_target(session, c, u) for c in others))


def _target(session: Session, found: CorrelateStage | ConfiguredTest, u: UpdateSection) -> Target:
    sure = found.reference.confidence >= session.config.identify.confidence
    used = used_mask(len(found.reference), found.left_out) & sure
    std = np.nan_to_num(
        found.reference_uncertainty.frequency / found.reference.frequencies, nan=0.0
    )
    weights = Weights(u.frequency_error, u.mac_error, u.shape_weight)
    known = (
        followed(found.reference, found.fe_initial, session.config)
        if isinstance(found, CorrelateStage)
        else None
    )
    return Target(
        frequencies=found.reference.frequencies,
        shapes=found.reference.shapes,
        std=std,
        used=used,
        weights=weights,
        pairing=settings(session.config),
        followed=known,
        lent=found.reference.lent,
    )


def problem_of(
    session: Session,
    models: Sequence[AtChannels | FullModel],
    aims: Sequence[Target],
    u: UpdateSection,
) -> Problem:
    """The objective over all configurations, the parameters of the models free."""
    parts = [
        Configuration(m, aim, terms_of(session, n, m, u), name=n or "the deck of the study")
        for n, m, aim in zip(names_of(session), models, aims, strict=True)
    ]
    problem = Problem(tuple(parts), loss=LOSSES[u.loss])
    rows, limits = constraints(session.config, problem.parameters)
    return Problem(
        problem.configurations, problem.parameters, loss=problem.loss, rows=rows, limits=limits
    )


def constraints(config: StudyConfig, parameters: ParameterSet) -> tuple[Float, Float]:
    """Rows (c, p) and limits (c,) of the [[constraint]]s that name a parameter; those not there
    stay at x = 0.
    """
    rows = [[c.terms.get(n, 0.0) for n in parameters.names] for c in config.constraint]
    kept = [i for i, r in enumerate(rows) if any(r)]
    limits = np.array([config.constraint[i].most for i in kept])
    return np.array([rows[i] for i in kept]).reshape(len(kept), len(parameters)), limits


def terms_of(
    session: Session, name: str, model: AtChannels | FullModel, u: UpdateSection
) -> tuple[Term, ...]:
    """All kinds of residuals of a configuration: those of its modes, then what else was measured on
    it.
    """
    modal = modal_terms(u, lambda: _mass(session, name))
    if isinstance(model, FullModel):  # modes alone
        return modal
    return (*modal, *(Weighted(d.term, d.weight) for d in data_of(session, name, model)))


def modal_terms(u: UpdateSection, mass: Callable[[], Float]) -> tuple[Term, ...]:
    """The kinds of residuals of the paired modes; `mass` (channel, channel) of the deck at the
    channels.
    """
    made: dict[str, Term] = {
        "eigenvalues": Eigenvalues(u.frequency_error),
        "frequencies": Frequencies(u.frequency_error, "log"),
        "mac": Mac(u.mac_error),
    }
    if u.shape_weight > 0:
        made["shapes"] = Shapes(u.mac_error, u.shape_weight)
    if "orthogonality" in u.residuals:
        made["orthogonality"] = CrossOrthogonality(mass(), u.orthogonality_error)
    return tuple(made[k] for k in KINDS if k in u.residuals and k in made)


def _mass(session: Session, name: str) -> Float:
    """The mass of the nominal deck at the channels of the test modes."""
    if name not in session.masses:
        opened, seen = session.deck_of(name)
        session.masses[name] = mass_at(
            opened, seen, session.reference(name).channels, session.config, session.fmax
        )
    return session.masses[name]


def mass_at(
    opened: Opened, seen: Observation, channels: tuple[str, ...], config: StudyConfig, fmax: float
) -> Float:
    """The mass of a deck at channels, (channel, channel), by the test-analysis model of the study;
    `fmax` in Hz.

    Raises
    ------
    ConfigError
        If there is none.
    """
    if config.correlate.tam in ("serep", "craig-bampton") or config.model is None:
        raise ConfigError(
            'update.residuals "orthogonality" needs a deck, and correlate.tam irs, guyan or hybrid'
        )
    found = channel_mass(opened, seen, channels, config.correlate, fmax)
    if found.matrix is None:
        raise ConfigError(f'update.residuals "orthogonality": {found.why}')
    return found.matrix


def data_of(session: Session, name: str, model: AtChannels) -> tuple[Data, ...]:
    """What was measured beside the modes, on the parameters that are free in a model.

    Raises
    ------
    DataError
        If static deflections were measured on a structure that is free to move.
    """
    found = session.measured(name)
    if any(m.statics is not None for m in found):
        f = model.model.modes(np.zeros(len(model.parameters))).frequencies
        if not elastic(f)[0]:
            raise DataError(
                "a static test needs a structure that is held; mode 1 of the deck is at "
                f"{f[0]:.3g} Hz"
            )
    check_moving(
        found, {c: i for i, c in enumerate(session.channels(name))}, model.model.basis.observe
    )
    every = model.model.system.parameters
    return on_parameters(
        session, name, lambda: _rigid(session, name, every), tuple(model.model.active)
    )


def on_parameters(
    session: Session, name: str, rigid: Callable[[], RigidMass], active: tuple[int, ...]
) -> tuple[Data, ...]:
    """What was measured beside the modes of a configuration, on the active of the parameters that
    `rigid` is over.
    """
    at = {c: i for i, c in enumerate(session.channels(name))}
    return tuple(
        residual_data(m, at, session.deck.units, rigid, active) for m in session.measured(name)
    )


def _rigid(session: Session, name: str, every: ParameterSet) -> RigidMass:
    """Over all parameters of a reduced model."""
    key = (name, every.names)
    if key not in session.weighed:
        session.weighed[key] = rigid_mass(session.deck_of(name)[0].model, every)
    return session.weighed[key]


def data_count(problem: Problem, at: Evaluated) -> float:
    """Number of data: a frequency and a shape each used test mode, lost ones too, and what else was
    measured.

    A kind beside the modes counts as many as its weight says.
    """
    count, kind = 0.0, 0
    for c in problem.configurations:
        for t in c.terms:
            rows = float((at.kind == kind).sum())
            count += t.factor * rows if isinstance(t, Weighted) else float(c.target.used.sum())
            kind += 1
    return max(count, 1.0)


BEST = 3  # of several starts, that go on to the end
STARTS = 8  # where one leaves modes without partner


def course_of(u: UpdateSection) -> Course:
    """As [update] asks for."""
    weighed = u.discrepancy if u.discrepancy != "found" or u.sharpened else "assumed"
    return Course(Method(u.step), u.iterations, "given" if u.prior == "study" else u.prior, weighed)


def further_starts(u: UpdateSection) -> UpdateSection | None:
    """[update] from several starts, for an end that leaves used modes without partner; None where
    none are asked for.

    Modes that change places between the deck and the structure make minima in which each is paired
    with its neighbour, and some without partner.
    """
    enough = u.starts >= STARTS or u.search == "global"
    return None if u.step == "published" or enough else u.otherwise({"starts": STARTS})


def minimise(
    problem: Problem,
    u: UpdateSection,
    seed: int,
    progress: Progress,
    *,
    start: Float | None = None,
    course: Course | None = None,
    told: Progress | None = None,
    checkpoint: Path | None = None,
) -> Settled:
    """The end of an updating from a start that the gates have led to, or from where they lead."""
    course = course or course_of(u)
    if start is not None:
        return settled_from(problem, course, start=start, progress=told)
    rough = starting_point(
        problem, u, course=course, seed=seed, progress=progress, told=told, checkpoint=checkpoint
    )
    end = settled_from(problem, course, start=rough.y, progress=told)
    return replace(end, path=(*rough.history, *end.path[1:]))


def starting_point(
    problem: Problem,
    u: UpdateSection,
    course: Course,
    seed: int,
    progress: Progress,
    told: Progress | None = None,
    checkpoint: Path | None = None,
) -> Solution:
    """Where the gates lead: from a global search, the best end of several starts, sets that grow,
    or the deck.
    """
    method, limit = course.method, course.iterations
    if u.search == "global":
        return global_search(problem, np.random.default_rng([seed, 9]), method, progress=progress)
    if u.starts > 1:
        more = latin_hypercube(problem.parameters, u.starts - 1, np.random.default_rng([seed, 9]))
        starts = np.vstack([np.zeros(problem.size), more])
        return multi_start(
            problem, starts, method, iterations=limit, finish=BEST, progress=progress
        ).best
    start = _after_growing_sets(problem, u, method, progress)
    return solve(
        problem, method, start=start, iterations=limit, checkpoint=checkpoint, progress=told
    )


def _after_growing_sets(
    problem: Problem, u: UpdateSection, method: Method, progress: Progress
) -> Float:
    """Where the sets of [update] stages end, (q,); the deck where none is smaller than the
    whole.
    """
    members = problem.parameters.names
    grown = [[n for n in stage if n in members] for stage in u.stages]
    grown = [g for g in grown if g and len(g) < len(members)]
    if not grown:
        return np.zeros(problem.size)
    return np.array(
        staged(problem, grown, method, iterations=u.iterations, progress=progress)[-1].x
    )
