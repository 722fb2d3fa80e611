"""Where to strike or shake, by the method asked for, and how many points it takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import ConfigError
from ringtrue.fem.response import frf
from ringtrue.planning.exciters import (
    appropriate_exciters,
    qr_exciters,
    rank_sets,
    select_references,
    shares,
)
from ringtrue.planning.geometry import along
from ringtrue.study.arrangement import Arrangement
from ringtrue.study.config_plan import PlanSection
from ringtrue.study.results.model import MISSED
from ringtrue.study.workbench import Workbench

RESIDUE: dict[str, Callable[[Float, int, Float], Int]] = {
    "greedy": select_references,
    "worst": lambda rows, count, largest: rank_sets(rows, count, largest=largest, most=1)[0].rows,
}
BESIDE = 2  # points fewer and more than asked for
ALIKE = 3  # sets of as many points as asked for
WORST = "by the driving-point residue of the mode that is excited worst"
SAID = {
    "greedy": f"hammer points greedily {WORST}",
    "worst": f"the best set of hammer points {WORST}",
    "qr": "exciters by QR with pivoting of M·Φ, the forces that part the modes",
    "mif": "exciters that come closest together to a phase resonance of every mode (mode "
    "indicator)",
}


def node_rows(desk: Workbench, nodes: Int) -> Int:
    """Rows of the translations of the nodes among the DOFs of the deck, (n, 3)."""
    labels = desk.initial.analysis.dofs
    at = np.stack([labels.find(nodes, np.full(nodes.shape, i + 1)) for i in range(3)], axis=1)
    if (at < 0).any():
        raise ConfigError(
            f"[plan.candidates]: node {int(nodes[(at < 0).any(axis=1)][0])} is not in the deck"
        )
    return at


def exciters(
    desk: Workbench, plan: PlanSection, able: Arrangement, shapes: Float, chosen: Int, targets: Int
) -> tuple[Int, Float, Float]:
    """Channels to excite by the method asked for; mode indicators (m,) and forces (m, k) where
    these were sought.
    """
    rows = shapes[chosen].reshape(chosen.size * able.each, -1)
    count = min(plan.references, len(rows))
    none = np.zeros(0), np.zeros((0, 0))
    if plan.strike == "qr":
        analysis = desk.initial.analysis
        pull = analysis.system.mass @ (
            analysis.system.local @ desk.initial.modes(desk.first_fmax).modes.shapes
        )
        at = node_rows(desk, able.node[chosen])
        forces = (analysis.system.transform[at.ravel()] @ pull[:, targets]).reshape(
            chosen.size, 3, -1
        )
        return (qr_exciters(along(forces, able.axes[chosen]).reshape(len(rows), -1), count), *none)
    if plan.strike == "mif":
        f = desk.get("model").modes.frequencies
        zeta = np.full(f.size, plan.damping)
        # as good as all channels: the indicator reads sums over them alone
        outputs = np.asarray(np.linalg.qr(rows, mode="r"))
        return appropriate_exciters(frf(f[targets], f, zeta, outputs, rows), count)
    rows = rows[:, targets]
    largest = (shapes[:, :, targets] if plan.strike_at else rows[:, None, :]) ** 2
    largest = largest.max(axis=(0, 1))
    some = within_reach(rows, largest)
    return (RESIDUE[plan.strike](rows[:, some], count, largest[some]), *none)


def within_reach(rows: Float, largest: Float) -> Bool:
    """Which modes of rows (r, m) one of them excites well, (m,); all if none: what no point reaches
    ranks nothing.
    """
    some = (rows**2).max(axis=0) >= MISSED * largest
    return np.asarray(some | ~some.any())


def ranked(
    rows: Float, labels: Sequence[str], count: int, largest: Float
) -> tuple[tuple[tuple[str, ...], ...], Float]:
    """The best sets of up to two points fewer and two more than `count`, and the next best of as
    many.

    Ranked by the modes that a point can reach.

    Parameters
    ----------
    rows : (r, m) float64, mass-normalised
        Target modes where a blow can go.
    labels : sequence (r) of str
    count : int
    largest : (m,) float64
        Of the squared motion in each mode at any channel.

    Returns
    -------
    sets : tuple of tuples of str
    reach : (set, m) float64
        Driving-point residue of the best point of each set over the largest of any channel.
    """
    sizes = range(max(1, count - BESIDE), min(count + BESIDE, len(rows)) + 1)
    some = within_reach(rows, largest)
    few, top = rows[:, some], largest[some]
    sets = [
        s.rows
        for k in sizes
        for s in rank_sets(few, k, largest=top, most=ALIKE if k == count else 1)
    ]
    reach = np.stack([shares(rows, largest)[s].max(axis=0) for s in sets])
    return tuple(tuple(labels[i] for i in s.tolist()) for s in sets), reach
