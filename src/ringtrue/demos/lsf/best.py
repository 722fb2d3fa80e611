"""The best that six parameters of the deck could reach against the truth; known to nobody in the
study.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from ringtrue.core.arrays import Float, Int
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.demos.lsf.twin import Twin
from ringtrue.errors import NumericalError
from ringtrue.model.ports import Linearisation
from ringtrue.shapes.mac import mac
from ringtrue.study.results import CorrelateStage, FinalStage, UpdateStage
from ringtrue.study.run import StudyRun
from ringtrue.study.session import Session
from ringtrue.updating.selection.selection_rules import Candidates, best_subset
from ringtrue.updating.target import Target, Weights, match

TURNS = 12  # linear programmes from each start
RADIUS = 0.5  # first trust region of x
SMALLEST = 1e-4  # of the trust region
LOST = 0.4  # relative deviation that a mode without a partner counts as


def _silent(fraction: float, text: str) -> None:
    """No progress shown."""


def true_modes(run: StudyRun, twin: Twin) -> tuple[Int, Int]:
    """Test modes of the final pairs and the as-built mode that each is, by MAC among those within 3
    %.
    """
    final: FinalStage = run.results["final"]
    found: CorrelateStage = run.results["correlate"]
    test = final.table.pairing.a
    channels = found.reference.channels
    truth = twin.real_modes.rows(channels)
    like = mac(found.reference.shapes[:, test], truth.shapes)
    near = np.abs(truth.frequencies[None] / found.reference.frequencies[test][:, None] - 1) < 0.03
    return test, np.argmax(np.where(near, like, -1.0), axis=1)


def best_possible(run: StudyRun, twin: Twin, session: Session) -> float:
    """Smallest mean |Δf|, %, that the best six candidates can reach on the true frequencies of the
    final pairs.

    From the best subset of the least-squares search and from each set that the study updated, the
    mean absolute deviation itself is minimised by a sequence of linear programmes.
    """
    _, true = true_modes(run, twin)
    found: CorrelateStage = run.results["correlate"]
    updated: UpdateStage = run.results["update"]
    truth = twin.real_modes.rows(found.reference.channels).take(np.unique(true))
    m = len(truth)
    gates = PairingSettings(mac_gate=0.3)  # they are pairs already: none may count as lost
    aim = Target(
        truth.frequencies,
        truth.shapes,
        np.zeros(m),
        np.ones(m, dtype=bool),
        Weights(shape=0.02),
        gates,
    )
    model = session.delivered_models(_silent)[0]
    names = model.parameters.names
    choice = best_subset(model, aim, min(6, len(names)))
    starts = [(choice.members.tolist(), choice.x[choice.members])]
    for s in updated.sets:
        at = [names.index(n) for n in s.parameters]
        starts.append((at, model.parameters.take(at).vector(s.factor)))
    none = np.zeros(len(names))
    return 100 * min(descend(model.with_parameters(at, none), aim, x, TURNS)[1] for at, x in starts)


def _errors(target: Target, now: Linearisation) -> tuple[Float, Float]:
    """Relative frequency deviations (m,) of the used modes and ∂/∂x (m, p); `LOST` and 0 without a
    partner.
    """
    pairs, _, _ = match(target, now)
    pairs = pairs[target.used[pairs[:, 0]]]
    m, p = target.frequencies.size, now.d_lambda.shape[1]
    error, slope = np.full(m, LOST), np.zeros((m, p))
    f = now.frequencies[pairs[:, 1]]
    error[pairs[:, 0]] = f / target.frequencies[pairs[:, 0]] - 1
    d_f = now.d_lambda[pairs[:, 1]] / (8 * np.pi**2 * f[:, None])
    slope[pairs[:, 0]] = d_f / target.frequencies[pairs[:, 0], None]
    return error[target.used], slope[target.used]


def least_absolute(error: Float, slope: Float, lower: Float, upper: Float) -> tuple[Float, float]:
    """d (p,) in [lower, upper] with the smallest mean |error + slope d|, and that mean: one linear
    programme.
    """
    m, p = slope.shape
    eye = np.eye(m)
    rows = np.block([[slope, -eye], [-slope, -eye]])
    cost = np.concatenate([np.zeros(p), np.full(m, 1 / m)])
    box = [*zip(lower, upper, strict=True), *[(0.0, None)] * m]
    found = linprog(
        cost, A_ub=rows, b_ub=np.concatenate([-error, error]), bounds=box, method="highs"
    )
    if found.x is None or found.fun is None:
        raise NumericalError(f"no least-absolute step: {found.message}")
    return np.asarray(found.x[:p]), float(found.fun)


def descend(model: Candidates, target: Target, start: Float, limit: int) -> tuple[Float, float]:
    """Successive linear programming in a trust region from `start` (p,): x and the mean |Δf|."""
    low, high = model.parameters.bounds()
    x, radius = np.array(start), RADIUS
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
        if radius < SMALLEST or np.abs(d).max(initial=0.0) < SMALLEST:
            break
    return x, float(np.abs(error).mean())
