"""Rigid-body tuning: the suspension to the rigid-body modes of the ambient test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.errors import DataError
from ringtrue.study.opened import Progress
from ringtrue.study.parametric import AtChannels
from ringtrue.study.reference import reference_modes, rigid_settings, rigid_table
from ringtrue.study.results import CorrelateStage, TuneStage
from ringtrue.study.stages.update import chosen_factors
from ringtrue.study.workbench import Workbench
from ringtrue.update.gauss_newton import update
from ringtrue.update.objective import Target, Weights
from ringtrue.update.plausible import plausibility
from ringtrue.update.suspension import Suspended, tune

# a rigid-body mode on springs leaves no room for model discrepancy but the mass distribution
WEIGHTS = Weights(frequency=0.005, mac=0.1, shape=0.1)


def target(desk: Workbench) -> Target:
    """The rigid-body modes of the test.

    Raises
    ------
    DataError
        If there is none.
    """
    found: CorrelateStage = desk.get("correlate")
    n = len(found.rigid)
    if not n:
        raise DataError(
            "rigid-body tuning: the ambient test holds no rigid-body mode to tune [[suspension]] to; set "
            "correlate.rigid_below above them, or leave [[suspension]] out"
        )
    std = np.maximum(found.rigid_uncertainty.frequency / found.rigid.frequencies, 1e-4)
    gates = rigid_settings(desk.config)
    return Target(found.rigid.frequencies, found.rigid.shapes, std, np.ones(n, dtype=bool), WEIGHTS, gates)


def suspended(desk: Workbench, progress: Progress) -> AtChannels:
    """The model over the suspension alone, the elastic parameters held at their updated values."""
    found: CorrelateStage = desk.get("correlate")
    count = len(desk.config.suspensions())
    base = np.concatenate([desk.parameters.vector(chosen_factors(desk)), np.zeros(count)])
    first = len(desk.parameters)
    model = desk.suspended(found.rigid.channels, progress)
    return model.with_parameters(range(first, first + count), base)


def tuned(active: AtChannels, aim: Target, iterations: int, progress: Progress) -> Suspended:
    """Every pairing weighed, from the point that the nearest pairing leads to.

    Test modes that find no partner inside the gates there take no part.
    """
    near = update(active, aim, iterations=iterations)
    used = np.isin(np.arange(aim.used.size), near.residual.pairs[near.residual.used, 0])
    if not used.any():
        raise DataError(
            "rigid-body tuning: no rigid-body mode of the test has a partner in the model; look at the bounds of "
            "[[suspension]], at the directions of the channels, or at correlate.mac_gate"
        )
    return tune(active, replace(aim, used=used), start=near.x, progress=progress)


def run(desk: Workbench, progress: Progress) -> TuneStage:
    """Tune the suspension with the elastic parameters held at their updated values."""
    aim = target(desk)
    active = suspended(desk, lambda f, t: progress(0.7 * f, t))
    before = _seen(active, np.zeros(len(active.parameters)), desk)
    found = tuned(active, aim, desk.config.update.iterations, lambda f, t: progress(0.7 + 0.3 * f, t))
    parameters, x = active.parameters, found.best.x
    factors = parameters.factors(x)
    slope = parameters.slope(x) / factors
    reference = reference_modes(desk.get("identify"), desk.config)
    return TuneStage(
        rigid_table(reference, before, desk.config),
        rigid_table(reference, _seen(active, x, desk), desk.config),
        dict(zip(parameters.names, factors.tolist(), strict=True)),
        dict(zip(parameters.names, (found.std * slope).tolist(), strict=True)),
        found.ambiguity(),
        tuple(f.text for f in plausibility(parameters, x, found.std / parameters.std())),
    )


def _seen(active: AtChannels, x: Float, desk: Workbench) -> ModeSet:
    found: CorrelateStage = desk.get("correlate")
    point = active.modes(x)
    zeros = np.zeros(point.frequencies.size)
    return ModeSet(point.frequencies, zeros, point.shapes, found.rigid.channels, source="reduced")
