"""The best that six parameters of the deck could reach against the truth; known to nobody in the study."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from ringtrue.core.arrays import Float, Int
from ringtrue.demos.lsf.twin import Twin
from ringtrue.model.ports import ObservedModel
from ringtrue.shapes.mac import mac
from ringtrue.study.results import CorrelateStage, FinalStage
from ringtrue.study.run import StudyRun
from ringtrue.study.workbench import Workbench
from ringtrue.update.choose import best_subset
from ringtrue.update.objective import Target, Weights, match

TURNS, TRUST = 8, 0.2  # linear programmes after the subset search; largest change of any x in one


def _silent(fraction: float, text: str) -> None:
    """No progress shown."""


def true_modes(run: StudyRun, twin: Twin) -> tuple[Int, Int]:
    """Test modes of the final pairs and the as-built mode that each is, by MAC among those within 3 %."""
    final: FinalStage = run.results["final"]
    found: CorrelateStage = run.results["correlate"]
    test = final.table.pairing.a
    channels = found.reference.channels
    truth = twin.real_modes.rows(channels)
    like = mac(found.reference.shapes[:, test], truth.shapes)
    near = np.abs(truth.frequencies[None] / found.reference.frequencies[test][:, None] - 1) < 0.03
    return test, np.argmax(np.where(near, like, -1.0), axis=1)


def best_possible(run: StudyRun, twin: Twin, desk: Workbench) -> float:
    """Smallest mean |Δf|, %, that the best six candidates can reach on the true frequencies of the final pairs.

    Subset selection and exchange on the frequencies, then the mean absolute deviation itself is minimised by a
    sequence of linear programmes in a trust region.
    """
    _, true = true_modes(run, twin)
    found: CorrelateStage = run.results["correlate"]
    truth = twin.real_modes.rows(found.reference.channels).take(np.unique(true))
    m = len(truth)
    aim = Target(truth.frequencies, truth.shapes, np.zeros(m), np.ones(m, dtype=bool), Weights(shape=0.02))
    model = desk.candidates(_silent)
    choice = best_subset(model, aim, min(6, len(model.parameters)))
    active = model.with_parameters(choice.members.tolist(), np.zeros(choice.x.size))
    return 100 * _least_mean(active, aim, choice.x[choice.members])


def _least_mean(model: ObservedModel, aim: Target, x: Float) -> float:
    best = np.inf
    trust = TRUST
    low, high = model.parameters.bounds()
    for _ in range(TURNS):
        point = model.linearise(x)
        pairs, _, _ = match(aim, point)
        f = point.frequencies[pairs[:, 1]]
        error = f / aim.frequencies[pairs[:, 0]] - 1
        slope = 0.5 * point.d_lambda[pairs[:, 1]] / ((2 * np.pi * f) ** 2)[:, None] * (1 + error)[:, None]
        value = float(np.mean(np.abs(error)))
        trust = trust if value < best else trust / 3
        best = min(best, value)
        n, p = slope.shape
        cost = np.concatenate([np.zeros(p), np.ones(n)])
        above = np.block([[slope, -np.eye(n)], [-slope, -np.eye(n)]])
        limits = [(max(-trust, a - b), min(trust, c - b)) for a, b, c in zip(low, x, high, strict=True)]
        step = linprog(cost, above, np.concatenate([-error, error]), bounds=[*limits, *[(0, None)] * n])
        if step.x is None:
            break
        x = np.clip(x + step.x[:p], low, high)
    return best
