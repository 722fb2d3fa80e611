"""What a study minimises: the kinds of residuals of each configuration, limits and links of the
parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import elastic
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.errors import ConfigError, DataError
from ringtrue.solvers.observed import FullModel
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.evidence import channel_mass
from ringtrue.study.measured import Data, check_moving, residual_data, rigid_mass
from ringtrue.study.opened import Opened
from ringtrue.study.parametric import AtChannels
from ringtrue.study.workbench import OWN, Workbench
from ringtrue.updating.objective import Target
from ringtrue.updating.residuals import (
    CrossOrthogonality,
    Eigenvalues,
    Frequencies,
    Mac,
    Shapes,
    Term,
    Weighted,
)
from ringtrue.updating.residuals_static import RigidMass
from ringtrue.updating.robust import Huber, Loss, Squares, Tukey
from ringtrue.updating.several import Configuration, Evaluated, Problem

LOSSES: dict[str, Loss] = {"squares": Squares(), "huber": Huber(), "tukey": Tukey()}
KINDS = ("eigenvalues", "frequencies", "shapes", "mac", "orthogonality")


def names_of(desk: Workbench) -> tuple[str, ...]:
    """The deck of the study and the other configurations."""
    return (OWN, *(c.name for c in desk.config.configuration))


def problem_of(
    desk: Workbench,
    models: Sequence[AtChannels | FullModel],
    aims: Sequence[Target],
    u: UpdateSection,
) -> Problem:
    """The objective over all configurations, the parameters of the models free."""
    parts = [
        Configuration(m, aim, terms_of(desk, n, m, u), name=n or "the deck of the study")
        for n, m, aim in zip(names_of(desk), models, aims, strict=True)
    ]
    problem = Problem(tuple(parts), loss=LOSSES[u.loss])
    rows, limits = constraints(desk.config, problem.parameters)
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
    desk: Workbench, name: str, model: AtChannels | FullModel, u: UpdateSection
) -> tuple[Term, ...]:
    """All kinds of residuals of a configuration: those of its modes, then what else was measured on
    it.
    """
    modal = modal_terms(u, lambda: _mass(desk, name))
    if isinstance(model, FullModel):  # modes alone
        return modal
    return (*modal, *(Weighted(d.term, d.weight) for d in data_of(desk, name, model)))


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


def _mass(desk: Workbench, name: str) -> Float:
    """The mass of the nominal deck at the channels of the test modes."""
    if name not in desk.masses:
        opened, seen = desk.deck_of(name)
        desk.masses[name] = mass_at(
            opened, seen, desk.reference(name).channels, desk.config, desk.fmax
        )
    return desk.masses[name]


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


def data_of(desk: Workbench, name: str, model: AtChannels) -> tuple[Data, ...]:
    """What was measured beside the modes, on the parameters that are free in a model.

    Raises
    ------
    DataError
        If static deflections were measured on a structure that is free to move.
    """
    found = desk.measured(name)
    if any(m.statics is not None for m in found):
        f = model.model.modes(np.zeros(len(model.parameters))).frequencies
        if not elastic(f)[0]:
            raise DataError(
                "a static test needs a structure that is held; mode 1 of the deck is at "
                f"{f[0]:.3g} Hz"
            )
    check_moving(
        found, {c: i for i, c in enumerate(desk.channels(name))}, model.model.basis.observe
    )
    every = model.model.system.parameters
    return on_parameters(desk, name, lambda: _rigid(desk, name, every), tuple(model.model.active))


def on_parameters(
    desk: Workbench, name: str, rigid: Callable[[], RigidMass], active: tuple[int, ...]
) -> tuple[Data, ...]:
    """What was measured beside the modes of a configuration, on the active of the parameters that
    `rigid` is over.
    """
    at = {c: i for i, c in enumerate(desk.channels(name))}
    return tuple(residual_data(m, at, desk.deck.units, rigid, active) for m in desk.measured(name))


def _rigid(desk: Workbench, name: str, every: ParameterSet) -> RigidMass:
    """Over all parameters of a reduced model."""
    key = (name, every.names)
    if key not in desk.weighed:
        desk.weighed[key] = rigid_mass(desk.deck_of(name)[0].model, every)
    return desk.weighed[key]


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
