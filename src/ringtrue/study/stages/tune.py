"""Rigid-body tuning: the suspension to the rigid-body modes of the ambient test."""

from __future__ import annotations

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

# a rigid-body mode on springs leaves no room for model discrepancy but the mass distribution
WEIGHTS = Weights(frequency=0.005, mac=0.1, shape=0.1)


def run(desk: Workbench, progress: Progress) -> TuneStage:
    """Tune the suspension with the elastic parameters held at their updated values."""
    found: CorrelateStage = desk.get("correlate")
    if not len(found.rigid):
        raise DataError(
            "rigid-body tuning: the ambient test holds no rigid-body mode to tune [[suspension]] to; set "
            "correlate.rigid_below above them, or leave [[suspension]] out"
        )
    reference = reference_modes(desk.get("identify"), desk.config)
    suspension = desk.config.suspensions()
    model = desk.suspended(found.rigid.channels, progress)
    base = np.concatenate([desk.config.candidates().vector(chosen_factors(desk)), np.zeros(len(suspension))])
    first = len(desk.config.candidates())
    active = model.with_parameters(range(first, first + len(suspension)), base)
    n = len(found.rigid)
    gates = rigid_settings(desk.config)
    std = np.maximum(found.rigid_uncertainty.frequency / found.rigid.frequencies, 1e-4)
    aim = Target(found.rigid.frequencies, found.rigid.shapes, std, np.ones(n, dtype=bool), WEIGHTS, gates)
    before = _seen(active, np.zeros(len(suspension)), found.rigid.channels)
    result = update(active, aim, iterations=desk.config.update.iterations)
    slope = suspension.slope(result.x) / result.factors
    return TuneStage(
        rigid_table(reference, before, desk.config),
        rigid_table(reference, _seen(active, result.x, found.rigid.channels), desk.config),
        dict(zip(suspension.names, result.factors.tolist(), strict=True)),
        dict(zip(suspension.names, (result.std * slope).tolist(), strict=True)),
    )


def _seen(active: AtChannels, x: Float, channels: tuple[str, ...]) -> ModeSet:
    point = active.modes(x)
    return ModeSet(point.frequencies, np.zeros(point.frequencies.size), point.shapes, channels, source="reduced")
