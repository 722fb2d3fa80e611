"""The worked example from beginning to end: deck, plan, campaign, study, verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.table import CorrelationTable
from ringtrue.demos.lsf import deck, facility
from ringtrue.demos.lsf.best import best_possible
from ringtrue.demos.lsf.campaign import CampaignPlan, CampaignSummary, run_campaign
from ringtrue.demos.lsf.checks import checks
from ringtrue.demos.lsf.spec import Spec
from ringtrue.demos.lsf.study import write_study
from ringtrue.demos.lsf.truth import twin_hash
from ringtrue.demos.lsf.twin import Twin, make_twin
from ringtrue.io.foreign.parsers import read_json
from ringtrue.report.build import deliver
from ringtrue.study.acceptance import Check
from ringtrue.study.results import PlanStage
from ringtrue.study.run import StudyRun, run_study
from ringtrue.virtual.measurements import HammerPlan

SEED = 0
SETUPS = 4  # roving setups of the hammer test
HAMMER = HammerPlan(hits=8, block=8.0, peak=(10e3, 22e3))
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """What the command shows."""

    run: StudyRun
    report: Path
    lines: tuple[str, ...]
    checks: tuple[Check, ...]


def run_demo(
    folder: Path,
    seed: int = SEED,
    *,
    fast: bool = False,
    full: bool = False,
    progress: Progress | None = None,
) -> DemoResult:
    """Write the deck, plan the test, measure the twin, validate the model, and report.

    Parameters
    ----------
    folder : Path
        Gets deck/, data/, study.toml, study.h5, updated/, summary.json and report.html.
    seed : int
    fast, full : bool
        Short records; the 11.4-hour record.
    progress : callable, optional
    """
    tell = progress or (lambda fraction, text: None)
    folder.mkdir(parents=True, exist_ok=True)
    analyst = facility.build(Spec())
    deck.write(analyst, folder / "deck", "Large spinning facility, analyst's model")
    study = write_study(analyst, folder, seed)
    planned = run_study(study, until="plan", progress=lambda f, t: tell(0.1 * f, t))
    plan: PlanStage = planned.results["plan"]
    twin = make_twin(seed, plan.test, plan.references, lambda f, t: tell(0.1 + 0.2 * f, t))
    campaign = run_campaign(
        twin,
        campaign_plan(plan),
        folder / "data",
        seed,
        fast=fast,
        full=full,
        progress=lambda f, t: tell(0.3 + 0.2 * f, t),
    )
    run = run_study(study, first="identify", progress=lambda f, t: tell(0.5 + 0.4 * f, t))
    tell(0.92, "what the best six parameters could reach")
    best = best_possible(run, twin, run.session)
    extra: dict[str, Any] = {
        "twin_hash": twin_hash(),
        "dof_as_built": twin.dof,
        "mass_as_built_t": twin.mass / 1e3,
        "best_possible_percent": best,
        "snr_db": campaign.snr_db,
    }
    held = (*checks(run.results), _floor(best))
    report = deliver(run, extra, checks=held)
    return DemoResult(run, report, _lines(run, twin, campaign, best), held)


def _floor(best: float) -> Check:
    name = "best mean |Δf| that six parameters could reach"
    return Check(name, "≥ 0.3 %", f"{best:.2f} %", best >= 0.3)


def campaign_plan(plan: PlanStage) -> CampaignPlan:
    """The campaign at the planned points: roving setups, each with all the driving points."""
    test = plan.test
    group = dict(zip(test.points.tolist(), test.groups, strict=True))
    on = {c: group[int(p)] for c, p in zip(test.channels, test.at, strict=True)}
    foundation = tuple(c for c in plan.ambient if on[c] == "foundation")
    frame = (
        *foundation[: len(foundation) // 2 // 3 * 3],
        *(c for c in plan.ambient if on[c] != "foundation"),
    )
    return CampaignPlan(
        foundation, frame, setups(test, plan.references), plan.references, hammer=HAMMER
    )


def setups(test: TestModel, references: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """Channels in `SETUPS` batches along the regions; the driving points are measured in every
    one.
    """
    rest = [c for c in test.channels if c not in references]
    parts = np.array_split(np.arange(len(rest)), SETUPS)
    return tuple((*references, *(rest[i] for i in p.tolist())) for p in parts)


def _lines(run: StudyRun, twin: Twin, campaign: CampaignSummary, best: float) -> tuple[str, ...]:
    summary = read_json(run.folder / "summary.json")
    snr = ", ".join(f"{k} {v:.1f} dB" for k, v in campaign.snr_db.items())
    final = run.results["final"].table
    initial = run.results["correlate"].initial
    return (
        f"twin {twin_hash()[:12]}, seed {run.config.study.seed}: {twin.dof} DOF as built, "
        f"{summary['dof']} in the deck",
        f"median signal-to-noise ratio at resonance: {snr}",
        _said("initial", initial),
        _said("final", final),
        f"best mean |Δf| that six parameters could reach: {best:.2f} %",
        "parameters: "
        + "; ".join(f"{p['name']} x {p['factor']:.2f}" for p in summary["parameters"]),
    )


def _said(name: str, table: CorrelationTable) -> str:
    return (
        f"{name}: {len(table)} pairs, mean |Δf| {table.mean_deviation():.2f} %, largest "
        f"{table.max_deviation():.1f} %, "
        f"mean MAC {table.mean_mac():.1f} %, mean subspace MAC {table.mean_subspace_mac():.1f} %"
    )
