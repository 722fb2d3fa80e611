"""The virtual test of a plan."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress
from ringtrue.plan.rehearsal import Conditions, Planned, Rehearsal, rehearse
from ringtrue.study.config_plan import PlanSection
from ringtrue.study.results import PlanStage
from ringtrue.study.workbench import Workbench

SEED = 7919  # added to that of the study
BLOWS = 20  # at a reference, at most


def virtual_test(desk: Workbench, plan: PlanSection, stage: PlanStage, rows: Float, progress: Progress) -> Rehearsal:
    """What virtual tests by a plan find of its target modes; `rows` (s, m) are shapes at its channels, by SI mass."""
    f = desk.get("model").modes.frequencies
    at = [stage.test.channels.index(r) for r in stage.references]
    margin = 0.5 * plan.damping * stage.target_frequencies
    low, high = float((stage.target_frequencies - margin).min()), float((stage.target_frequencies + margin).max())
    planned = Planned(f, rows, rows[at], stage.test.channels, stage.references, low, high)
    rng = np.random.default_rng(desk.config.study.seed + SEED)
    conditions = Conditions(
        trials=plan.trials, damping=plan.damping, background=plan.background, hits=min(stage.averages, BLOWS)
    )
    result = rehearse(planned, conditions, rng, progress=progress)
    return result.take(np.searchsorted(np.flatnonzero(planned.targets), stage.target_modes))
