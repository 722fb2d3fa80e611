"""The target modes of a plan: named, or those of the band that a criterion asks for, each with its
reason.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.modes import rigid_below
from ringtrue.errors import ConfigError
from ringtrue.planning.resolution import (
    Targets,
    choose_targets,
    effective_mass,
    in_band,
    informative_modes,
    kinetic_share,
)
from ringtrue.study.config_plan import PlanSection
from ringtrue.study.workbench import Workbench

MODEL_ERROR = 0.01  # relative, of an eigenvalue: half a percent of a frequency


def planned_targets(desk: Workbench, plan: PlanSection, f: Float, edge: float) -> Targets:
    """The target modes: as named, or those of the band that a criterion asks for."""
    rigid = plan.fmax <= edge  # a band of rigid-body modes alone is one of them
    low = max(rigid_below(f) if rigid else edge, plan.fmin)
    if plan.modes:
        if max(plan.modes) > f.size:
            raise ConfigError(
                f"[plan] modes: {max(plan.modes)} of {f.size} modes below fmax of [model]; raise it"
            )
        return choose_targets(f, {"named": np.isin(np.arange(1, f.size + 1), plan.modes)})
    within = in_band(f, low, plan.fmax)
    criteria = _criteria(desk, plan, within) or {f"{low:.4g} to {plan.fmax:.4g} Hz": within}
    return choose_targets(f, criteria, within=within)


def _criteria(desk: Workbench, plan: PlanSection, within: Bool) -> dict[str, Bool]:
    """What [plan] asks of target modes besides the band."""
    criteria: dict[str, Bool] = {}
    if not (plan.effective_mass or plan.sensitive or plan.telling or plan.kinetic):
        return criteria
    analysis, modes = desk.initial.analysis, desk.initial.modes(desk.first_fmax).modes
    free = np.asarray(analysis.system.local @ modes.shapes)
    if plan.effective_mass:
        share = effective_mass(free, analysis.system.mass, analysis.system.rigid_body())
        criteria[f"effective mass over {100 * plan.effective_mass:g} %"] = (
            share.max(axis=1) > plan.effective_mass
        )
    for name, least in plan.kinetic.items():
        rows = np.flatnonzero(np.isin(analysis.system.free.node, plan.candidates[name]))
        share = kinetic_share(free, analysis.system.mass, [rows])[:, 0]
        criteria[f"kinetic energy of {name} over {100 * least:g} %"] = share > least
    parameters = desk.config.candidates()
    if (plan.sensitive or plan.telling) and not len(parameters):
        raise ConfigError("[plan] sensitive and telling need a [[candidate]]")
    if plan.sensitive or plan.telling:
        lam = (2 * np.pi * modes.frequencies) ** 2
        slopes = analysis.slopes(parameters)
        d = np.stack(
            [
                np.einsum("fm,fm->m", free, s.stiffness @ free - (s.mass @ free) * lam)
                for s in slopes
            ],
            axis=1,
        )
        relative = np.where(within, 1 / np.where(within, lam, 1.0), 0.0)[:, None] * d
        if plan.sensitive:
            criteria[f"sensitivity over {plan.sensitive:g}"] = (
                np.abs(relative).sum(axis=1) > plan.sensitive
            )
        if plan.telling:
            x = relative * parameters.derivative(np.zeros(len(parameters)))
            at = informative_modes(x, np.ones(len(x)), MODEL_ERROR, parameters.std(), plan.telling)
            criteria["tells parameters apart"] = np.isin(np.arange(len(x)), at)
    return criteria
