"""The test plan."""

from __future__ import annotations

from ringtrue.plots import correlation, identification
from ringtrue.report.parts import Block, Columns, Fact, Facts, Plot, Section, Table, Text, fixed, number, sentence
from ringtrue.report.stages import Stages
from ringtrue.study.results import IdentifyStage, PlanStage
from ringtrue.study.summary import precision


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
    if data.model is not None and plan.expected_modes.size:
        modes = data.model.modes.take(plan.expected_modes)
        fig = identification.precision(modes, plan.expected_std_frequency, plan.expected_std_damping)
        fig.update_layout(height=430)
        right.append(Plot(fig, "Standard deviations to expect from the planned length of the ambient record."))
    blocks.append(Columns([left, right])) if right else blocks.extend(left)
    if data.identify is not None and len(data.identify.ambient):
        blocks.append(_verified(plan, data.identify))
    return Section("plan", "Test plan", blocks)


def _verified(plan: PlanStage, found: IdentifyStage) -> Table:
    """Planned precision against that of the modes found."""
    rows = [(fixed(r.pop("frequency_hz"), 3), *(number(v, 2) for v in r.values())) for r in precision(plan, found)]
    heads = ("f, Hz", "planned σ of f, %", "found, %", "planned σ of ζ, %", "found, %")
    caption = (
        f"The plan verified: standard deviations of one ambient record with {100 * plan.damping:g} % damping as "
        "planned, and those of the merged ambient modes."
    )
    return Table(heads, rows, caption)
