"""The test plan."""

from __future__ import annotations

import numpy as np

from ringtrue.plots import correlation, identification
from ringtrue.report.parts import Block, Columns, Fact, Facts, Plot, Section, Text, fixed, plain
from ringtrue.report.stages import Stages


def section(data: Stages) -> Section | None:
    """Chosen sensors, auto-MAC, resolution and the precision to expect."""
    plan = data.plan
    if plan is None:
        return None
    facts = [
        Fact("Channels chosen", f"{len(plan.test.channels)} of {plan.candidates}"),
        Fact("Worst auto-MAC", fixed(100 * plan.worst_off_diagonal, 1), "%"),
        Fact("Frequency step", plain(plan.frequency_step), "Hz"),
        Fact("Block", plain(plan.block), "s"),
        Fact("Ambient record", plain(plan.record_length / 60), "min"),
    ]
    blocks: list[Block] = [Facts(facts), Text(f"{plan.rule} Hammer references: {', '.join(plan.references)}.")]
    names = [str(i + 1) for i in plan.target_modes.tolist()]
    auto = correlation.matrix(plan.auto_mac, names, names, "FE mode", "FE mode", height=430)
    left: list[Block] = [Plot(auto, "Auto-MAC of the target modes at the chosen channels.")]
    right: list[Block] = []
    if data.model is not None and np.isfinite(plan.expected_std_frequency).any():
        modes = data.model.modes.take(plan.target_modes)
        fig = identification.precision(modes, plan.expected_std_frequency, plan.expected_std_damping)
        fig.update_layout(height=430)
        right.append(Plot(fig, "Standard deviations to expect from the planned length of the ambient record."))
    blocks.append(Columns([left, right])) if right else blocks.extend(left)
    return Section("plan", "Test plan", blocks)
