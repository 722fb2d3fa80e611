"""The test plan."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.plots import correlation, identification
from ringtrue.report.parts import Block, Columns, Fact, Facts, Plot, Section, Text, fixed, number, sentence
from ringtrue.report.stages import Stages
from ringtrue.study.results import PlanStage


def section(data: Stages) -> Section | None:
    """Chosen sensors, auto-MAC, resolution and the precision to expect."""
    plan = data.plan
    if plan is None:
        return None
    facts = [
        Fact("Channels chosen", f"{len(plan.test.channels)} of {plan.candidates}"),
        Fact("Worst auto-MAC", fixed(100 * plan.worst_off_diagonal, 1), "%"),
        Fact("Frequency step", number(plan.frequency_step, 3), "Hz"),
        Fact("Block", number(plan.block, 4), "s"),
        Fact("Ambient record", number(plan.record_length / 60, 3), "min"),
    ]
    blocks: list[Block] = [
        Facts(facts),
        Text(f"{sentence(plan.rule)} Hammer references: {', '.join(plan.references)}."),
    ]
    names = [str(i + 1) for i in plan.target_modes.tolist()]
    auto = correlation.matrix(plan.auto_mac, names, names, "FE mode", "FE mode", height=430, diagonal=False)
    left: list[Block] = [Plot(auto, "Auto-MAC of the target modes at the chosen channels.")]
    right: list[Block] = []
    if data.model is not None and np.isfinite(plan.expected_std_frequency).any():
        modes = data.model.modes.take(_ambient_modes(plan, data.model.modes.frequencies))
        fig = identification.precision(modes, plan.expected_std_frequency, plan.expected_std_damping)
        fig.update_layout(height=430)
        right.append(Plot(fig, "Standard deviations to expect from the planned length of the ambient record."))
    blocks.append(Columns([left, right])) if right else blocks.extend(left)
    return Section("plan", "Test plan", blocks)


def _ambient_modes(plan: PlanStage, frequencies: Float) -> Int:
    """Positions of the modes whose precision was planned: the targets, or rigid-body modes and the first targets."""
    if plan.expected_std_frequency.size == plan.target_modes.size:
        return plan.target_modes
    first = int(plan.target_modes[0]) if plan.target_modes.size else frequencies.size
    low = np.flatnonzero(frequencies[:first] > 1e-3 * frequencies.max(initial=0.0))
    return np.concatenate([low, plan.target_modes])[: plan.expected_std_frequency.size]
