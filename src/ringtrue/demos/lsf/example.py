"""What a worked example is: its deck, what was built, how it is tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ringtrue.core.iterate import Progress, part
from ringtrue.core.testmodel import TestModel
from ringtrue.demos.lsf.campaign import DATE, CampaignPlan, Day
from ringtrue.demos.lsf.spec import Spec
from ringtrue.demos.lsf.study import StudyContents, contents
from ringtrue.demos.lsf.twin import SofteningRegion, Twin, as_built, make_twin
from ringtrue.study.results import PlanStage
from ringtrue.virtual.measurements import HammerPlan

HAMMER = HammerPlan(hits=8, block=8.0, peak=(10e3, 22e3))


@dataclass(frozen=True, slots=True)
class WorkedExample:
    """A worked example.

    Attributes
    ----------
    analyst : Spec
        The facility as it is modelled.
    built : mapping of str to Spec
        The facility as it stands, by date.
    contents : StudyContents
        What the study file says of the deck.
    softening : tuple of SofteningRegion
        Joints that are not linear.
    days : mapping of str to Day
        When tests are made, by name; without an entry on the first date.
    repeated : tuple of str
        Kinds of excitation that the test of the foundation is repeated with.
    """

    analyst: Spec
    built: Mapping[str, Spec]
    contents: StudyContents
    softening: tuple[SofteningRegion, ...] = ()
    days: Mapping[str, Day] = field(default_factory=dict)
    repeated: tuple[str, ...] = ()


def first(seed: int) -> WorkedExample:
    """The first example of a seed: one day, linear, all channels as the sheet says."""
    return WorkedExample(analyst=Spec(), built={DATE: as_built(seed)}, contents=contents())


def twins_of(example: WorkedExample, plan: PlanStage, progress: Progress) -> dict[str, Twin]:
    """The twin on each date."""
    out = {}
    count = len(example.built)
    for i, (date, built) in enumerate(example.built.items()):
        out[date] = make_twin(
            built,
            plan.sensors.test,
            plan.excitation.references,
            softening=example.softening,
            progress=part(progress, i / count, (i + 1) / count),
        )
    return out


def campaign_plan(plan: PlanStage) -> CampaignPlan:
    """The campaign at the planned points: roving setups, each with all the driving points."""
    test = plan.sensors.test
    group = dict(zip(test.points.tolist(), test.groups, strict=True))
    on = {c: group[int(p)] for c, p in zip(test.channels, test.at, strict=True)}
    foundation = tuple(c for c in plan.sensors.ambient if on[c] == "foundation")
    frame = (
        *foundation[: len(foundation) // 2 // 3 * 3],
        *(c for c in plan.sensors.ambient if on[c] != "foundation"),
    )
    return CampaignPlan(
        foundation,
        frame,
        setups(test, plan.excitation.references),
        plan.excitation.references,
        hammer=HAMMER,
    )


def setups(test: TestModel, references: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """Channels in four batches along the regions; the driving points are measured in every
    one.
    """
    rest = [c for c in test.channels if c not in references]
    parts = np.array_split(np.arange(len(rest)), 4)
    return tuple((*references, *(rest[i] for i in p.tolist())) for p in parts)
