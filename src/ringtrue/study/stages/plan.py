"""The test plan: target modes, measuring points, hammer points, resolution."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError
from ringtrue.model.frames import positions
from ringtrue.plan.layout import lower_auto_mac, reached, select_points, select_references
from ringtrue.plan.resolution import resolution
from ringtrue.shapes.mac import auto_mac, worst_off_diagonal
from ringtrue.study.config import PlanSection
from ringtrue.study.opened import Progress
from ringtrue.study.reference import elastic_edge
from ringtrue.study.results import ModelStage, PlanStage
from ringtrue.study.workbench import Workbench

AXES = ("X", "Y", "Z")


def _candidates(plan: PlanSection, model: ModelStage) -> tuple[Int, tuple[str, ...]]:
    """Candidate nodes and the region of each."""
    if not plan.candidates:
        return model.scene.node, ("",) * model.scene.node.size
    nodes = [n for group in plan.candidates.values() for n in group]
    return np.array(nodes), tuple(name for name, group in plan.candidates.items() for _ in group)


def _shapes(desk: Workbench, nodes: Int, modes: Int) -> Float:
    """Mass-normalised translations at the candidates, (n, 3, m)."""
    found = desk.initial.modes(desk.deck.fmax).modes
    labels = desk.initial.analysis.dofs
    at = np.stack([labels.find(nodes, np.full(nodes.shape, i + 1)) for i in range(3)], axis=1)
    if (at < 0).any():
        raise ConfigError(f"[plan.candidates]: node {int(nodes[(at < 0).any(axis=1)][0])} is not in the deck")
    return np.asarray(found.shapes[at][:, :, modes])


def run(desk: Workbench, progress: Progress) -> PlanStage:
    """Choose where to measure and where to hit.

    Points are triaxial. The ambient tests use the points that tell the rigid-body and first elastic modes apart; they
    stay in the hammer test, so that the two can be compared.
    """
    plan = desk.config.plan
    if plan is None:
        raise ConfigError("this stage needs a [plan]")
    model: ModelStage = desk.get("model")
    f = model.modes.frequencies
    edge = elastic_edge(f, desk.config)
    targets = np.flatnonzero((f > max(edge, plan.fmin)) & (f < plan.fmax))
    nodes, region = _candidates(plan, model)
    shapes = _shapes(desk, nodes, np.arange(f.size))
    xyz = positions(desk.initial.model)[desk.initial.model["GRID"].find(nodes)] * desk.length
    first = np.concatenate([np.flatnonzero((f > 1e-3 * f.max()) & (f <= edge)), targets[: plan.ambient_sensors]])
    ambient_at = _ambient(plan, shapes[:, :, first], xyz, region)
    fixed = np.isin(np.arange(nodes.size), ambient_at)
    progress(0.3, "measuring points")
    chosen = select_points(shapes[:, :, targets], xyz, plan.sensors, fixed=fixed, min_distance=plan.min_distance)
    chosen = lower_auto_mac(shapes[:, :, targets], chosen, plan.max_auto_mac, plan.sensors + 15)
    rows = shapes[chosen][:, :, targets].reshape(-1, targets.size)
    labels = tuple(f"{n}+{a}" for n in nodes[chosen].tolist() for a in AXES)
    hits = select_references(rows, plan.references)
    mac = auto_mac(rows)
    need = resolution(f[targets], plan.damping)
    every = resolution(f[first], plan.damping)
    return PlanStage(
        nodes.size,
        targets,
        _test_model(nodes[chosen], xyz[chosen], labels, [region[i] for i in chosen.tolist()]),
        tuple(f"{n}+{a}" for n in nodes[ambient_at].tolist() for a in AXES),
        tuple(labels[i] for i in hits.tolist()),
        mac,
        worst_off_diagonal(mac),
        need.step,
        need.block,
        every.record,
        plan.damping,
        first,
        every.std_frequency,
        every.std_damping,
        f"triaxial points by effective independence (backward elimination) of {targets.size} target modes, at least "
        f"{plan.min_distance:g} m apart, then points that lower the worst auto-MAC; hammer points greedily by the "
        f"driving-point residue of the mode that is excited worst (least share reached "
        f"{100 * float(reached(rows, hits).min()):.0f} %)",
    )


def _ambient(plan: PlanSection, shapes: Float, xyz: Float, region: tuple[str, ...]) -> Int:
    """Points of the ambient tests: in the first two regions, half of them in each."""
    names = list(dict.fromkeys(region))[:2]
    out = []
    for name in names:
        at = np.flatnonzero(np.array([r == name for r in region]))
        count = max(plan.ambient_sensors // len(names), -(-shapes.shape[2] // 3))
        out.append(at[select_points(shapes[at], xyz[at], min(count, at.size), min_distance=2 * plan.min_distance)])
    return np.sort(np.concatenate(out))


def _test_model(nodes: Int, xyz: Float, labels: tuple[str, ...], groups: list[str]) -> TestModel:
    """Points with lines to their two nearest neighbours of the same region, for drawing."""
    gap = np.linalg.norm(xyz[:, None] - xyz[None], axis=-1)
    gap[np.array(groups)[:, None] != np.array(groups)[None]] = np.inf
    np.fill_diagonal(gap, np.inf)
    near = np.argsort(gap, axis=1, kind="stable")[:, :2]
    pairs = [sorted((i, j)) for i, row in enumerate(near.tolist()) for j in row if np.isfinite(gap[i, j])]
    lines = nodes[np.unique(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=0)]
    axes = np.tile(np.eye(3), (nodes.size, 1))
    return TestModel(nodes, xyz, labels, np.repeat(nodes, 3), axes, lines, tuple(groups))
