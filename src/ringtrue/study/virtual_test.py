"""The virtual tests of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress
from ringtrue.planning.virtual_test import (
    AmbientConditions,
    Conditions,
    Planned,
    VirtualTest,
    longest,
    simulate_ambient_test,
    simulate_impact_test,
)
from ringtrue.study.config_plan import PlanSection
from ringtrue.study.results import PlanStage
from ringtrue.study.workbench import Workbench
from ringtrue.virtual.sensors import ACCELEROMETER

SEED = 7919  # added to that of the study
AMBIENT_SEED = 7927
BLOWS = 20  # at a reference, at most


def virtual_test(
    desk: Workbench, plan: PlanSection, stage: PlanStage, rows: Float, progress: Progress
) -> VirtualTest:
    """What virtual tests by a plan find of its target modes; `rows` (s, m) are shapes at its
    channels, by SI mass.
    """
    f = desk.get("model").modes.frequencies
    at = [stage.test.channels.index(r) for r in stage.references]
    band = _band(stage.target_frequencies, plan.damping)
    planned = Planned(f, rows, rows[at], stage.test.channels, stage.references, *band)
    rng = np.random.default_rng(desk.config.study.seed + SEED)
    conditions = Conditions(
        trials=plan.trials, damping=plan.damping, hits=min(stage.averages, BLOWS)
    )
    if plan.background is None:
        conditions = replace(conditions, coherence=plan.coherence)
    else:
        conditions = replace(conditions, background=plan.background)
    result = simulate_impact_test(planned, conditions, rng, progress=progress)
    return result.take(np.searchsorted(np.flatnonzero(planned.targets), stage.target_modes))


def virtual_ambient_test(
    desk: Workbench, plan: PlanSection, stage: PlanStage, rows: Float, progress: Progress
) -> tuple[VirtualTest, tuple[str, ...]]:
    """What virtual ambient tests find of its modes, and notes; `rows` (s, m) are shapes at all
    channels, by SI mass.

    Forces act along all channels; the sensors are those of the ambient tests, or all where these
    are not planned.
    """
    f = desk.get("model").modes.frequencies
    channels = stage.ambient or stage.test.channels
    seen = rows[[stage.test.channels.index(c) for c in channels]]
    band = _band(f[stage.expected_modes], plan.damping)
    planned = Planned(f, seen, rows, channels, stage.test.channels, *band)
    rng = np.random.default_rng(desk.config.study.seed + AMBIENT_SEED)
    conditions = Conditions(trials=plan.trials, damping=plan.damping, sensor=ACCELEROMETER)
    duration = min(stage.record_length, longest(len(channels), band[1]))
    cut = (
        f"the virtual ambient tests last {duration:.4g} s of the {stage.record_length:.4g} s, "
        "as memory allows"
    )
    result = simulate_ambient_test(
        planned, AmbientConditions(duration, plan.ambient_force), conditions, rng, progress=progress
    )
    found = result.take(np.searchsorted(np.flatnonzero(planned.targets), stage.expected_modes))
    return found, (cut,) if duration < stage.record_length else ()


def _band(frequencies: Float, damping: float) -> tuple[float, float]:
    """From half a half-power band below the lowest to as much above the highest, Hz."""
    margin = 0.5 * damping * frequencies
    return float((frequencies - margin).min()), float((frequencies + margin).max())
