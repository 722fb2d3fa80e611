"""The worked example from beginning to end: deck, plan, campaign, study, checks.

What must hold of the worked example: pairs, deviations and MAC of the delivered model.

The best that six parameters of the deck could reach against the truth; known to nobody in the
study.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

from ringtrue.core.arrays import Float, Int
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.correlation.table import CorrelationTable
from ringtrue.demos.lsf import facility
from ringtrue.demos.lsf.campaign import (
    CampaignSummary,
    ChannelFaults,
    Circumstances,
    run_campaign,
)
from ringtrue.demos.lsf.examples import campaign_plan, first, named, plant, twins_of
from ringtrue.demos.lsf.examples import hard as harder
from ringtrue.demos.lsf.study import write_facility, write_study
from ringtrue.demos.lsf.twin import Twin, twin_hash
from ringtrue.errors import NumericalError
from ringtrue.io.foreign.parsers import read_json
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.dense_models import condensed
from ringtrue.report.build import deliver
from ringtrue.shapes import mac
from ringtrue.study.acceptance import AcceptanceCheck, improvement
from ringtrue.study.conclusion import findings_json
from ringtrue.study.results import (
    CompareStage,
    CorrelateStage,
    FinalStage,
    PlanStage,
    UpdateStage,
)
from ringtrue.study.run import StudyRun, run_study
from ringtrue.updating.problem import single
from ringtrue.updating.selection.screening import SIZES
from ringtrue.updating.selection.selection_rules import Candidates, best_subset
from ringtrue.updating.target import Target, Weights, match

UNPAIRED = 0.4  # relative deviation that a mode without a pair counts as


def true_modes(run: StudyRun, twin: Twin) -> tuple[Int, Int]:
    """Test modes of the final pairs and the as-built mode that each is, by MAC among those within 3
    %.
    """
    final: FinalStage = run.results["final"]
    found: CorrelateStage = run.results["correlate"]
    test = final.table.pairing.a
    measured = found.reference.elastic.take(test)
    truth = twin.real_modes.rows(measured.channels)
    like = mac(measured.shapes, truth.shapes)
    near = np.abs(truth.frequencies[None] / measured.frequencies[:, None] - 1) < 0.03
    return test, np.argmax(np.where(near, like, -1.0), axis=1)


def best_possible(run: StudyRun, twin: Twin) -> float:
    """Smallest mean |Δf|, %, that the best six candidates can reach on the true frequencies of the
    final pairs.

    From the best subset of the least-squares search (on fewer modes) and from each set that the
    study updated, the mean absolute deviation itself is minimised by a sequence of linear
    programmes.
    """
    _, true = true_modes(run, twin)
    found: CorrelateStage = run.results["correlate"]
    updated: UpdateStage = run.results["update"]
    truth = twin.real_modes.rows(found.reference.elastic.channels).take(np.unique(true))
    m = len(truth)
    # they are pairs already: none may count as lost
    gates = PairingSettings(mac_gate=0.3)
    aim = Target(
        frequencies=truth.frequencies,
        shapes=truth.shapes,
        std=np.zeros(m),
        used=np.ones(m, dtype=bool),
        weights=Weights(shape=0.02),
        pairing=gates,
    )
    model = run.session.delivered_models(quiet)[0]
    names = model.parameters.names
    each = np.diag(model.parameters.std())
    small = replace(model, model=condensed(model.model, [*each, *-each], SIZES.vectors))
    choice = best_subset(single(small, aim), min(6, len(names)))
    starts = [(choice.members.tolist(), choice.x[choice.members])]
    for s in updated.sets:
        at = [names.index(n) for n in s.parameters]
        starts.append((at, model.parameters.take(at).vector(s.factor)))
    none = np.zeros(len(names))
    return 100 * min(
        descend(model.with_parameters(at, none), aim, x, 12)[1] for at, x in starts
    )


def _errors(target: Target, now: Linearisation) -> tuple[Float, Float]:
    """Relative frequency deviations (m,) of the used modes and ∂/∂x (m, p); without a pair
    `UNPAIRED` and 0.
    """
    pairs, _, _ = match(target, now)
    pairs = pairs[target.used[pairs[:, 0]]]
    m = target.frequencies.size
    p = now.d_lambda.shape[1]
    error = np.full(m, UNPAIRED)
    slope = np.zeros((m, p))
    f = now.frequencies[pairs[:, 1]]
    error[pairs[:, 0]] = f / target.frequencies[pairs[:, 0]] - 1
    d_f = now.d_lambda[pairs[:, 1]] / (8 * np.pi**2 * f[:, None])
    slope[pairs[:, 0]] = d_f / target.frequencies[pairs[:, 0], None]
    return error[target.used], slope[target.used]


def least_absolute(
    error: Float, slope: Float, lower: Float, upper: Float
) -> tuple[Float, float]:
    """d (p,) in [lower, upper] with the smallest mean |error + slope d|, and that mean: one linear
    programme.
    """
    m, p = slope.shape
    eye = np.eye(m)
    rows = np.block([[slope, -eye], [-slope, -eye]])
    cost = np.concatenate([np.zeros(p), np.full(m, 1 / m)])
    box = [*zip(lower, upper, strict=True), *[(0.0, None)] * m]
    found = linprog(
        cost,
        A_ub=rows,
        b_ub=np.concatenate([-error, error]),
        bounds=box,
        method="highs",
    )
    if found.x is None or found.fun is None:
        raise NumericalError(f"no least-absolute step: {found.message}")
    return np.asarray(found.x[:p]), float(found.fun)


def descend(
    model: Candidates, target: Target, start: Float, limit: int
) -> tuple[Float, float]:
    """x and the mean |Δf| by at most `limit` linear programmes in a trust region from `start`
    (p,).
    """
    low, high = model.parameters.bounds()
    x = np.array(start)
    radius = 0.5
    error, slope = _errors(target, model.linearise(x))
    for _ in range(limit):
        d, _ = least_absolute(
            error, slope, np.maximum(low - x, -radius), np.minimum(high - x, radius)
        )
        trial = _errors(target, model.linearise(np.clip(x + d, low, high)))
        if np.abs(trial[0]).mean() < np.abs(error).mean():
            x, (error, slope) = np.clip(x + d, low, high), trial
        else:
            radius /= 3
        if min(radius, np.abs(d).max(initial=0.0)) < 1e-4:
            break
    return x, float(np.abs(error).mean())


def checks(
    r: Mapping[str, Any], mac: float = 93.0, rigid: int = 6
) -> tuple[AcceptanceCheck, ...]:
    """What must hold of a study of the facility with a test and an updated model.

    Parameters
    ----------
    r : mapping of str to a stage's result
    mac : float, %
        Least mean subspace MAC.
    rigid : int
        Rigid-body modes that are paired: all of them, where no channel is at fault.
    """
    out: list[AcceptanceCheck] = []
    compare: CompareStage | None = r.get("compare")
    if compare is not None:
        t = compare.table
        good = (np.abs(t.deviation_percent) <= 0.6) & (t.subspace_mac_percent >= 80)
        out.append(
            AcceptanceCheck(
                "ambient vs hammer: modes with |Δf| ≤ 0.6 % and subspace MAC ≥ 80 %",
                "≥ 7",
                str(int(good.sum())),
                bool(good.sum() >= 7),
            )
        )
    final: FinalStage | None = r.get("final")
    if final is None:
        return tuple(out)
    t = final.table
    n = len(t)
    spared = int((~t.used).sum())
    subspace_mac = t.mean_subspace_mac()
    out += [
        AcceptanceCheck("final: pairs", "≥ 18", str(n), n >= 18),
        AcceptanceCheck(
            "final: pairs left out of the updating", "≥ 4", str(spared), spared >= 4
        ),
        _at_most("final: mean |Δf|", t.mean_deviation(), 2.0, "%"),
        _at_most("final: largest |Δf|", t.max_deviation(), 6.0, "%"),
        AcceptanceCheck(
            "final: mean subspace MAC",
            f"≥ {mac:g} %",
            f"{subspace_mac:.2f} %",
            bool(subspace_mac >= mac),
        ),
        _unpaired_below(final, r["correlate"].reference.elastic.confidence),
        *improvement(r),
    ]
    soft = final.rigid
    wanted = str(rigid) if rigid == 6 else f"≥ {rigid}"
    found = len(soft)
    out.append(
        AcceptanceCheck(
            "rigid-body modes paired one to one",
            wanted,
            str(found),
            rigid <= found <= 6,
        )
    )
    out.append(
        _at_most(
            "rigid-body modes: largest |Δf| after tuning",
            soft.max_deviation(),
            3.0,
            "%",
        )
    )
    return tuple(out)


def _at_most(name: str, got: float, most: float, unit: str) -> AcceptanceCheck:
    return AcceptanceCheck(
        name, f"≤ {most:g} {unit}", f"{got:.2f} {unit}", bool(got <= most)
    )


def _unpaired_below(final: FinalStage, confidence: Float) -> AcceptanceCheck:
    t = final.table
    top = float(t.test_hz.max(initial=0.0))
    unpaired = t.pairing.unpaired_a
    confident = confidence[unpaired] >= 0.5  # as the study pairs test modes
    count = int(((t.all_test_hz[unpaired] < top) & confident).sum())
    return AcceptanceCheck(
        "final: confident test modes below the last pair without a partner",
        "≤ 4",
        str(count),
        count <= 4,
    )


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """What the command shows."""

    run: StudyRun
    report: Path
    lines: tuple[str, ...]
    checks: tuple[AcceptanceCheck, ...]


def run_demo(
    folder: Path,
    seed: int = 0,
    *,
    hard: bool = False,
    fast: bool = False,
    progress: Progress = quiet,
) -> DemoResult:
    """Write the deck, plan the test, measure the twin, validate the model, and report.

    Parameters
    ----------
    folder : Path
        Gets deck/, data/, study.toml, study.h5, updated/, summary.json and report.html.
    seed : int
    hard : bool
        The second, harder example: `examples.hard`.
    fast : bool
        Short records.
    progress : callable (fraction, text)
    """
    folder.mkdir(parents=True, exist_ok=True)
    example = harder(seed) if hard else first(seed)
    analyst = facility.build(example.analyst)
    write_facility(analyst, folder / "deck", "Large spinning facility, analyst's model")
    study = write_study(analyst, folder, seed, example.contents)
    planned = run_study(study, until="plan", progress=part(progress, 0.0, 0.1))
    plan: PlanStage = planned.results["plan"]
    twins = twins_of(example, plan, part(progress, 0.1, 0.3))
    measured = campaign_plan(plan)
    faults = plant(seed, measured) if hard else ChannelFaults()
    here = Circumstances(twins, example.days, example.repeated, faults)
    shown = part(progress, 0.3, 0.5)
    campaign = run_campaign(
        here, measured, folder / "data", seed, fast=fast, progress=shown
    )
    run = run_study(study, first="identify", progress=part(progress, 0.5, 0.9))
    progress(0.92, "what the best six parameters could reach")
    twin = twins[here.day("hammer").date]
    best = best_possible(run, twin)
    extra: dict[str, Any] = {
        "twin_hash": twin_hash(),
        "dof_as_built": twin.dof,
        "mass_as_built_t": twin.mass / 1e3,
        "best_possible_percent": best,
        "snr_db": campaign.snr_db,
    }
    floor = AcceptanceCheck(
        "best mean |Δf| that six parameters could reach",
        "≥ 0.3 %",
        f"{best:.2f} %",
        best >= 0.3,
    )
    held = (*checks(run.results, example.contents.mac, example.contents.rigid), floor)
    if hard:
        planted = named(findings_json(run.results), faults)
        extra["planted"] = planted
        held += tuple(
            AcceptanceCheck(f"named: {what}", "yes", "yes" if there else "no", there)
            for what, there in planted.items()
        )
    report = deliver(run, extra, checks=held)
    return DemoResult(run, report, _lines(run, twin, campaign, best), held)


def _lines(
    run: StudyRun, twin: Twin, campaign: CampaignSummary, best: float
) -> tuple[str, ...]:
    summary = read_json(run.folder / "summary.json")
    snr = ", ".join(f"{k} {v:.1f} dB" for k, v in campaign.snr_db.items())
    final = run.results["final"].table
    initial = run.results["correlate"].initial
    return (
        f"twin {twin_hash()[:12]}, seed {run.config.study.seed}: {twin.dof} DOF as built, "
        f"{summary['dof']} in the deck",
        f"median signal-to-noise ratio at resonance: {snr}",
        _summary_line("initial", initial),
        _summary_line("final", final),
        f"best mean |Δf| that six parameters could reach: {best:.2f} %",
        "parameters: "
        + "; ".join(f"{p['name']} x {p['factor']:.2f}" for p in summary["parameters"]),
    )


def _summary_line(name: str, table: CorrelationTable) -> str:
    return (
        f"{name}: {len(table)} pairs, mean |Δf| {table.mean_deviation():.2f} %, largest "
        f"{table.max_deviation():.1f} %, "
        f"mean MAC {table.mean_mac():.1f} %, mean subspace MAC {table.mean_subspace_mac():.1f} %"
    )
