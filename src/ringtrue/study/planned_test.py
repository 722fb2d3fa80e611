"""The parts of a test plan: target modes, sensor arrangements, excitation points, virtual tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.modes import rigid_below
from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError
from ringtrue.fem.response import frf
from ringtrue.planning.exciters import (
    appropriate_exciters,
    qr_exciters,
    rank_sets,
    select_references,
    shares,
)
from ringtrue.planning.geometry import along, relative_neighbours, surface_normals
from ringtrue.planning.resolution import (
    Targets,
    choose_targets,
    effective_mass,
    in_band,
    informative_modes,
    kinetic_share,
)
from ringtrue.planning.virtual_test import (
    AmbientConditions,
    Conditions,
    Planned,
    VirtualTest,
    longest,
    simulate_ambient_test,
    simulate_impact_test,
)
from ringtrue.study.config_sections import PlanSection
from ringtrue.study.results import PlanStage, Scene
from ringtrue.study.results.model import MISSED
from ringtrue.study.session import Session
from ringtrue.virtual.sensors import ACCELEROMETER

MODEL_ERROR = 0.01  # relative, of an eigenvalue: half a percent of a frequency


def planned_targets(session: Session, plan: PlanSection, f: Float, edge: float) -> Targets:
    """The target modes: as named, or those of the band that a criterion asks for."""
    rigid = plan.fmax <= edge  # a band of rigid-body modes alone is one of them
    low = max(rigid_below(f) if rigid else edge, plan.fmin)
    if plan.modes:
        if max(plan.modes) > f.size:
            raise ConfigError(
                f"[plan] modes: {max(plan.modes)} of {f.size} modes below fmax of [model]; raise it"
            )
        return choose_targets(f, {"named": np.isin(np.arange(1, f.size + 1), plan.modes)})
    within = in_band(f, low, plan.fmax)
    criteria = _criteria(session, plan, within) or {f"{low:.4g} to {plan.fmax:.4g} Hz": within}
    return choose_targets(f, criteria, within=within)


def _criteria(session: Session, plan: PlanSection, within: Bool) -> dict[str, Bool]:
    """What [plan] asks of target modes besides the band."""
    criteria: dict[str, Bool] = {}
    if not (plan.effective_mass or plan.sensitive or plan.telling or plan.kinetic):
        return criteria
    analysis, modes = session.initial.analysis, session.initial.modes(session.first_fmax).modes
    free = np.asarray(analysis.system.local @ modes.shapes)
    if plan.effective_mass:
        share = effective_mass(free, analysis.system.mass, analysis.system.rigid_body())
        criteria[f"effective mass over {100 * plan.effective_mass:g} %"] = (
            share.max(axis=1) > plan.effective_mass
        )
    for name, least in plan.kinetic.items():
        rows = np.flatnonzero(np.isin(analysis.system.free.node, plan.candidates[name]))
        share = kinetic_share(free, analysis.system.mass, [rows])[:, 0]
        criteria[f"kinetic energy of {name} over {100 * least:g} %"] = share > least
    parameters = session.config.candidates()
    if (plan.sensitive or plan.telling) and not len(parameters):
        raise ConfigError("[plan] sensitive and telling need a [[candidate]]")
    if plan.sensitive or plan.telling:
        lam = (2 * np.pi * modes.frequencies) ** 2
        slopes = analysis.slopes(parameters)
        d = np.stack(
            [
                np.einsum("fm,fm->m", free, s.stiffness @ free - (s.mass @ free) * lam)
                for s in slopes
            ],
            axis=1,
        )
        relative = np.where(within, 1 / np.where(within, lam, 1.0), 0.0)[:, None] * d
        if plan.sensitive:
            criteria[f"sensitivity over {plan.sensitive:g}"] = (
                np.abs(relative).sum(axis=1) > plan.sensitive
            )
        if plan.telling:
            x = relative * parameters.derivative(np.zeros(len(parameters)))
            at = informative_modes(x, np.ones(len(x)), MODEL_ERROR, parameters.std(), plan.telling)
            criteria["tells parameters apart"] = np.isin(np.arange(len(x)), at)
    return criteria


AXES = ("X", "Y", "Z")
NORMAL = ("N",)  # along the outward normal of the skin


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """Candidate sensors (s) with d directions each.

    Attributes
    ----------
    nodes : (n,) int64
        Candidate nodes.
    at : (s,) int64
        Position of each sensor's node among them.
    axes : (s, d, 3) float64
        Unit vectors.
    names : tuple (s) of tuple (d) of str
        Direction in the name of a channel.
    xyz : (s, 3) float64, m
    apart : (s, 3 or 4) float64, m
        Where the least distance is measured: sensors in different single axes do not keep each
        other away.
    region : tuple (s) of str
    """

    nodes: Int
    at: Int
    axes: Float
    names: tuple[tuple[str, ...], ...]
    xyz: Float
    apart: Float
    region: tuple[str, ...]

    @property
    def node(self) -> Int:
        """Node of each sensor, (s,)."""
        return np.asarray(self.nodes[self.at])

    @property
    def each(self) -> int:
        """Directions a sensor, d."""
        return int(self.axes.shape[1])

    def seen(self, shapes: Float) -> Float:
        """What the sensors read of translations (n, 3, m) at the candidate nodes, (s, d, m)."""
        return shapes if self.each == len(AXES) else along(shapes[self.at], self.axes)

    def labels(self, chosen: Int) -> tuple[str, ...]:
        """Channels of sensors (c,), sensor by sensor."""
        node = self.node
        return tuple(f"{node[i]}+{a}" for i in chosen.tolist() for a in self.names[i])

    def points(self, chosen: Int) -> tuple[Int, Int]:
        """Nodes (p,) that hold a sensor, in order, and which of them each sensor (c,) sits on."""
        node = self.node[chosen]
        kept, first, back = np.unique(node, return_index=True, return_inverse=True)
        order = np.argsort(first, kind="stable")
        rank = np.empty(kept.size, dtype=np.int64)
        rank[order] = np.arange(kept.size)
        return np.asarray(kept[order]), rank[back]

    def measured(self, chosen: Int) -> Float:
        """Projector on the directions that are measured at each point of `points`, (p, 3, 3)."""
        at, axes = self.points(chosen)[1], self.axes[chosen]
        out = np.zeros((at.max(initial=-1) + 1, 3, 3))
        np.add.at(out, at, np.einsum("cdi,cdj->cij", axes, axes))
        return out

    def test_model(self, chosen: Int) -> TestModel:
        """The sensors with lines between their points and the neighbours of the same region, for
        drawing.
        """
        points, back = self.points(chosen)
        first = np.array(
            [int(np.argmax(back == k)) for k in range(points.size)], dtype=np.int64
        )  # tens of points
        xyz, groups = self.xyz[chosen][first], [self.region[i] for i in chosen[first].tolist()]
        lines = points[relative_neighbours(xyz, groups)]
        axes = self.axes[chosen].reshape(-1, 3)
        return TestModel(
            points=points,
            xyz=xyz,
            channels=self.labels(chosen),
            at=np.repeat(points[back], self.each),
            axes=axes,
            lines=lines,
            groups=tuple(groups),
        )


def arranged(
    nodes: Int, region: Sequence[str], xyz: Float, directions: str, scene: Scene
) -> Arrangement:
    """All sensors that candidate nodes can hold.

    Parameters
    ----------
    nodes : (n,) int64
    region : sequence (n) of str
    xyz : (n, 3) float64, m
    directions : {"triaxial", "uniaxial", "normal"}
        One sensor a node along the global axes together, one for each of the axes, or one along the
        normal of the skin.

    Raises
    ------
    ConfigError
        If no candidate lies on a surface and normals are asked for.
    """
    n, eye = nodes.size, np.eye(3)
    names: tuple[tuple[str, ...], ...]
    if directions == "triaxial":
        at, axes, names = np.arange(n), np.broadcast_to(eye, (n, 3, 3)), (AXES,) * n
    elif directions == "uniaxial":
        at, axes = np.repeat(np.arange(n), 3), np.tile(eye, (n, 1))[:, None, :]
        names = tuple((a,) for a in AXES) * n
    else:
        at, axes = _surface_sensors(nodes, scene)
        names = (NORMAL,) * at.size
    place = xyz[at]
    apart = place
    if (
        directions == "uniaxial"
    ):  # a fourth coordinate keeps the axes farther apart than any two nodes are
        far = 10 * (1.0 + float(np.ptp(xyz, axis=0).max(initial=0.0)))
        apart = np.column_stack([place, far * np.tile(np.arange(3), n)])
    return Arrangement(
        nodes=nodes,
        at=at,
        axes=axes,
        names=names,
        xyz=place,
        apart=apart,
        region=tuple(region[i] for i in at.tolist()),
    )


def _surface_sensors(nodes: Int, scene: Scene) -> tuple[Int, Float]:
    """Candidates that lie on surfaces, (s,), and their normals, (s, 1, 3)."""
    normal = surface_normals(scene.xyz, scene.triangles)
    seat = np.searchsorted(scene.node, nodes).clip(max=scene.node.size - 1)
    here: Bool = (scene.node[seat] == nodes) & (np.linalg.norm(normal[seat], axis=1) > 0)
    if not here.any():
        raise ConfigError(
            '[plan] directions = "normal": no candidate lies on a shell or on the skin of solids'
        )
    at = np.flatnonzero(here)
    return at, normal[seat[at]][:, None, :]


RESIDUE: dict[str, Callable[[Float, int, Float], Int]] = {
    "greedy": select_references,
    "worst": lambda rows, count, largest: rank_sets(rows, count, largest=largest, most=1)[0].rows,
}
MORE_OR_FEWER = 2  # points fewer and more than asked for
EQUAL_SETS = 3  # sets of as many points as asked for
WORST = "by the driving-point residue of the mode that is excited worst"
RULES = {
    "greedy": f"hammer points greedily {WORST}",
    "worst": f"the best set of hammer points {WORST}",
    "qr": "exciters by QR with pivoting of M·Φ, the forces that part the modes",
    "mif": "exciters that come closest together to a phase resonance of every mode (mode "
    "indicator)",
}


def node_rows(session: Session, nodes: Int) -> Int:
    """Rows of the translations of the nodes among the DOFs of the deck, (n, 3)."""
    labels = session.initial.analysis.dofs
    at = np.stack([labels.find(nodes, np.full(nodes.shape, i + 1)) for i in range(3)], axis=1)
    if (at < 0).any():
        raise ConfigError(
            f"[plan.candidates]: node {int(nodes[(at < 0).any(axis=1)][0])} is not in the deck"
        )
    return at


def exciters(
    session: Session, plan: PlanSection, able: Arrangement, shapes: Float, chosen: Int, targets: Int
) -> tuple[Int, Float, Float]:
    """Channels to excite by the method asked for; mode indicators (m,) and forces (m, k) where
    these were sought.
    """
    rows = shapes[chosen].reshape(chosen.size * able.each, -1)
    count = min(plan.references, len(rows))
    none = np.zeros(0), np.zeros((0, 0))
    if plan.strike == "qr":
        analysis = session.initial.analysis
        pull = analysis.system.mass @ (
            analysis.system.local @ session.initial.modes(session.first_fmax).modes.shapes
        )
        at = node_rows(session, able.node[chosen])
        forces = (analysis.system.transform[at.ravel()] @ pull[:, targets]).reshape(
            chosen.size, 3, -1
        )
        return (qr_exciters(along(forces, able.axes[chosen]).reshape(len(rows), -1), count), *none)
    if plan.strike == "mif":
        f = session.get("model").modes.frequencies
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
    sizes = range(max(1, count - MORE_OR_FEWER), min(count + MORE_OR_FEWER, len(rows)) + 1)
    some = within_reach(rows, largest)
    few, top = rows[:, some], largest[some]
    sets = [
        s.rows
        for k in sizes
        for s in rank_sets(few, k, largest=top, most=EQUAL_SETS if k == count else 1)
    ]
    reach = np.stack([shares(rows, largest)[s].max(axis=0) for s in sets])
    return tuple(tuple(labels[i] for i in s.tolist()) for s in sets), reach


SEED = 7919  # added to that of the study
AMBIENT_SEED = 7927
BLOWS = 20  # at a reference, at most


def virtual_test(
    session: Session, plan: PlanSection, stage: PlanStage, rows: Float, progress: Progress
) -> VirtualTest:
    """What virtual tests by a plan find of its target modes; `rows` (s, m) are shapes at its
    channels, by SI mass.
    """
    f = session.get("model").modes.frequencies
    at = [stage.test.channels.index(r) for r in stage.references]
    band = _test_band(stage.target_frequencies, plan.damping)
    planned = Planned(f, rows, rows[at], stage.test.channels, stage.references, *band)
    rng = np.random.default_rng(session.config.study.seed + SEED)
    conditions = Conditions(
        trials=plan.trials, damping=plan.damping, hits=min(stage.averages, BLOWS)
    )
    if plan.background is None:
        conditions = replace(conditions, coherence=plan.coherence)
    else:
        conditions = replace(conditions, background=plan.background)
    result = simulate_impact_test(planned, conditions, rng, progress=progress)
    return result.take(np.searchsorted(np.flatnonzero(planned.targets), stage.target_modes))


def virtual_ambient_test(
    session: Session, plan: PlanSection, stage: PlanStage, rows: Float, progress: Progress
) -> tuple[VirtualTest, tuple[str, ...]]:
    """What virtual ambient tests find of its modes, and notes; `rows` (s, m) are shapes at all
    channels, by SI mass.

    Forces act along all channels; the sensors are those of the ambient tests, or all where these
    are not planned.
    """
    f = session.get("model").modes.frequencies
    channels = stage.ambient or stage.test.channels
    seen = rows[[stage.test.channels.index(c) for c in channels]]
    band = _test_band(f[stage.expected_modes], plan.damping)
    planned = Planned(f, seen, rows, channels, stage.test.channels, *band)
    rng = np.random.default_rng(session.config.study.seed + AMBIENT_SEED)
    conditions = Conditions(trials=plan.trials, damping=plan.damping, sensor=ACCELEROMETER)
    duration = min(stage.record_length, longest(len(channels), band[1]))
    cut = (
        f"the virtual ambient tests last {duration:.4g} s of the {stage.record_length:.4g} s, "
        "as memory allows"
    )
    result = simulate_ambient_test(
        planned, AmbientConditions(duration, plan.ambient_force), conditions, rng, progress=progress
    )
    found = result.take(np.searchsorted(np.flatnonzero(planned.targets), stage.expected_modes))
    return found, (cut,) if duration < stage.record_length else ()


def _test_band(frequencies: Float, damping: float) -> tuple[float, float]:
    """From half a half-power band below the lowest to as much above the highest, Hz."""
    margin = 0.5 * damping * frequencies
    return float((frequencies - margin).min()), float((frequencies + margin).max())
