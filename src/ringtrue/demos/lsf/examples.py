"""The worked examples: what one is (its deck, what was built, how it is tested), the first, and the
second, harder one.

In the harder one errors go in both directions that no candidate region follows, joints soften,
three days have other temperatures, and channels are at fault.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ringtrue.core.iterate import Progress, part
from ringtrue.core.testmodel import TestModel
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.campaign import DATE, CampaignPlan, ChannelFaults, Day
from ringtrue.demos.lsf.facility import ZONE
from ringtrue.demos.lsf.spec import Cut, Spec, ZonedSpec
from ringtrue.demos.lsf.study import Region, StudyContents, contents
from ringtrue.demos.lsf.twin import (
    SofteningRegion,
    Twin,
    as_built,
    built_from,
    make_twin,
)
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
    return WorkedExample(
        analyst=Spec(), built={DATE: as_built(seed)}, contents=contents()
    )


def twins_of(
    example: WorkedExample, plan: PlanStage, progress: Progress
) -> dict[str, Twin]:
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


THIRDS = (8.4, 16.6)  # m, where the analyst divides the foundation along the bay
MIDDLE = 5.0  # m, where the analyst divides the frame across it
CONCRETE_PA = 24e9  # of the analyst
ANCHORS = ("anchors front", "anchors middle", "anchors rear")
MOUNTS = ("vessel mounts front", "vessel mounts rear")
MACHINES = ("motor mounts", "gearbox mounts", "bearing mounts")
# stiffness per kelvin: of concrete, and of the grout and pads of anchors and mounts
CONCRETE_PER_K = -0.5e-3
JOINTS_PER_K = -1.5e-3
# stiffness of the anchors that the analyst took, over that of bolts alone
GROUTED = 2.5
SLIP = 3.5e-7  # m, of the anchors that soften
FRAME = ("columns", "girders", "cross beams", "braces", "brackets")
VESSEL = ("vessel shell", "vessel heads", "vessel rings")
DECK = ("drive deck", "deck beams", "pedestals", "shaft")


def hard_analyst() -> ZonedSpec:
    """The facility as it is modelled: joints as stiff as members, concrete of a table."""
    usual = Spec()
    modulus = dict(usual.modulus) | dict.fromkeys(S.CONCRETE, CONCRETE_PA)
    modulus |= dict.fromkeys(S.JOINTED, 2.06e11)
    bush = {
        k: tuple(GROUTED * x for x in v) if k in ANCHORS else v
        for k, v in usual.bush.items()
    }
    cuts = dict.fromkeys(S.CONCRETE, Cut(0, THIRDS))
    cuts |= dict.fromkeys((*FRAME, *ANCHORS), Cut(1, (MIDDLE,)))
    return ZonedSpec(modulus=modulus, bush=bush, cuts=cuts)


def ratios(seed: int) -> dict[str, float]:
    """Ratio of stiffness as built to as modelled for each region, some above 1 and some below;
    drawn by seed.
    """
    rng = np.random.default_rng([seed, 626])

    def draw(regions: tuple[str, ...], low: float, high: float) -> dict[str, float]:
        return {region: float(rng.uniform(low, high)) for region in regions}

    out = draw(tuple(S.STEEL), 0.975, 1.030)
    out |= draw(S.JOINTED, 0.82, 0.92)  # joints give way, which the analyst left out
    out |= draw(tuple(S.BUSHES), 0.95, 1.08)
    out |= draw(("slab", "long walls"), 1.38, 1.55)  # dynamic modulus
    out |= draw(("end walls", "haunches"), 0.95, 1.15)  # cracked
    order = rng.permutation(3).tolist()
    out |= draw((ANCHORS[order[0]],), 0.7, 0.85)  # bolts that are not tight
    out |= draw((ANCHORS[order[1]],), 1.3, 1.6)  # grouted over their length
    worn, shimmed = rng.permutation(2).tolist()
    out |= draw((MOUNTS[worn],), 0.6, 0.8)
    out |= draw((MOUNTS[shimmed],), 1.2, 1.5)
    out |= draw((MACHINES[int(rng.integers(3))],), 1.3, 1.6)
    out |= draw(("air springs",), 1.10, 1.35)
    return out


def cracked(seed: int) -> tuple[float, float]:
    """Where the slab and the long walls are cracked, from an x on, m, and by which factor."""
    rng = np.random.default_rng([seed, 4])
    return float(rng.uniform(12.0, 19.0)), float(rng.uniform(0.78, 0.90))


def days(seed: int) -> tuple[Day, Day, Day]:
    """Of the ambient tests, of the hammer test, and of the repeated ambient test."""
    rng = np.random.default_rng([seed, 5])
    cold = round(float(rng.uniform(6.0, 10.0)), 1)
    warm = round(cold + float(rng.uniform(6.0, 9.0)), 1)
    again = round(cold + float(rng.uniform(3.0, 5.0)), 1)
    return Day("2024-11-04", cold), Day("2024-11-06", warm), Day("2024-11-12", again)


def hard_built(seed: int, temperature: float, reference: float) -> ZonedSpec:
    """The facility as it stands at a temperature, °C; ratios hold at the reference."""
    at, factor = cracked(seed)
    warmer = temperature - reference
    warm = dict.fromkeys(S.CONCRETE, 1 + CONCRETE_PER_K * warmer)
    warm |= dict.fromkeys((*ANCHORS, *MOUNTS, *MACHINES), 1 + JOINTS_PER_K * warmer)
    r = {k: v * warm.get(k, 1.0) for k, v in ratios(seed).items()}
    cuts = dict.fromkeys(("slab", "long walls"), Cut(0, (at,), (1.0, factor)))
    return replace(built_from(hard_analyst(), r, seed), seed=seed + 1000, cuts=cuts)


def softening(seed: int) -> tuple[SofteningRegion, ...]:
    """The two groups of anchors that soften; drawn by seed."""
    rng = np.random.default_rng([seed, 6])
    loose = sorted(rng.choice(3, size=2, replace=False).tolist())
    return tuple(
        SofteningRegion(ANCHORS[i], share=float(rng.uniform(0.15, 0.25)), slip=SLIP)
        for i in loose
    )


def plant(seed: int, plan: CampaignPlan) -> ChannelFaults:
    """Channels at fault; drawn by seed among those of the plan.

    Of the test of the foundation one is reversed, and two of different directions are swapped on
    the sheet; the gain of a driving point is 6 dB wrong in one setup of the hammer test.
    """
    rng = np.random.default_rng([seed, 7])
    rest = [c for c in plan.foundation if c not in plan.references]
    turned, first = (str(c) for c in rng.choice(rest, size=2, replace=False))
    others = [c for c in rest if c != turned and c[-1] != first[-1]]
    return ChannelFaults(
        reversed=turned,
        swapped=(first, str(rng.choice(others))),
        scaled=str(rng.choice(plan.references)),
        setup=int(rng.integers(len(plan.setups))),
        gain=float(rng.choice((0.5, 2.0))),
    )


def named(
    findings: Sequence[Mapping[str, Any]], faults: ChannelFaults
) -> dict[str, bool]:
    """Whether each planted fault is among the `findings` of summary.json, and what else is named.

    Returns
    -------
    dict of str to bool
        What was planted, and whether it is named; last, whether no other channel is accused.
    """

    def found(what: str, subject: str = "") -> list[Mapping[str, Any]]:
        same = [f for f in findings if f["what"] == what]
        return [f for f in same if not subject or f["subject"] == subject]

    partners = {
        f["subject"]: f["values"].get("partner") for f in found("channel swapped")
    }
    a, b = faults.swapped
    gains = found("channel gain", faults.scaled)
    drift = found("temperature drift")
    accused = {f["subject"] for f in findings if f["what"].startswith("channel ")}
    return {
        f"{faults.reversed} reversed": bool(found("channel reversed", faults.reversed)),
        f"{a} and {b} swapped": partners.get(a) == b and partners.get(b) == a,
        f"{faults.scaled} mis-scaled in setup {faults.setup + 1}": any(
            str(g["values"]["setup"]) == str(faults.setup + 1)
            # two calibrations of 1 %, and the difference of days
            and abs(g["values"]["factor"] / faults.gain - 1) < 0.05
            for g in gains
        ),
        "temperature between the days": any(f["values"]["percent"] < 0 for f in drift),
        "amplitude dependence": bool(found("amplitude dependent")),
        "repeated test": bool(found("days differ")),
        "no other channel": accused <= {faults.reversed, a, b, faults.scaled},
    }


def hard_contents() -> StudyContents:
    """What the study file says: candidates by thirds and sides, which cut across what is wrong."""
    number = S.CONCRETE | S.STEEL | S.BUSHES
    cuts = hard_analyst().cuts
    regions = {
        region: [
            pid + ZONE * z
            for z in range(1 + len(cuts[region].at) if region in cuts else 1)
        ]
        for region, pid in number.items()
    }

    def moduli(members: Iterable[str], zone: int) -> list[str]:
        return [f"MAT1 {regions[r][zone]} E" for r in members]

    def springs(members: Iterable[str], zone: int, fields: str) -> list[str]:
        return [f"PBUSH {regions[r][zone]} {fields}" for r in members]

    candidates: list[Region] = []
    for zone, third in enumerate(("west", "middle", "east")):
        here = [r for r in S.CONCRETE if r != "end walls" or third != "middle"]
        candidates.append((f"foundation, {third}", moduli(here, zone)))
    for zone, side in enumerate(("south", "north")):
        candidates.append((f"frame, {side}", moduli(FRAME, zone)))
        candidates.append(
            (f"anchors, {side}", springs(ANCHORS, zone, "K1,K2,K3,K4,K5,K6"))
        )
    candidates += [
        ("vessel", moduli(VESSEL, 0)),
        ("drive deck", moduli(DECK, 0)),
        ("vessel mounts", springs(MOUNTS, 0, "K1,K2,K3")),
        ("drive mounts", springs(MACHINES, 0, "K1,K2,K3")),
    ]
    # there is none in the middle
    regions["end walls"].remove(S.CONCRETE["end walls"] + ZONE)
    # channels at fault stay in the test: three of those that see the rigid-body modes
    return StudyContents(
        tuple(candidates), regions, remodelled=False, mac=80.0, rigid=5
    )


def hard(seed: int) -> WorkedExample:
    """The example of a seed."""
    first, second, third = days(seed)
    built = {
        day.date: hard_built(seed, day.temperature or 0.0, first.temperature or 0.0)
        for day in (first, second, third)
    }
    return WorkedExample(
        analyst=hard_analyst(),
        built=built,
        contents=hard_contents(),
        softening=softening(seed),
        days={
            "foundation": first,
            "frame": first,
            "hammer": second,
            "foundation-again": third,
        },
        repeated=("ambient", "jumping"),
    )
