"""The parts of a test plan: target modes, sensor arrangements, excitation points, virtual tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.iterate import Progress, part
from ringtrue.core.modes import rigid_below
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError
from ringtrue.planning.exciters import (
    LEAST_REACH,
    ExciterSet,
    Targets,
    choose_targets,
    effective_mass,
    in_band,
    informative_modes,
    kinetic_share,
    rank_sets,
    readable,
    select_references,
    shares,
)
from ringtrue.planning.geometry import (
    along,
    relative_neighbours,
    spacing_of_points,
    surface_normals,
)
from ringtrue.planning.virtual_test import (
    AmbientConditions,
    Conditions,
    Planned,
    longest,
    simulate_ambient_test,
    simulate_impact_test,
)
from ringtrue.study.config_sections import PlanSection
from ringtrue.study.results import ModelStage, PlanStage, Scene
from ringtrue.study.session import Session
from ringtrue.virtual.sensors import ACCELEROMETER

LARGEST_LEAST_DISTANCE_M = 0.8  # of measuring points, where nothing is asked


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
    spread : (s, 3 or 4) float64, m
        Where the least distance is measured: sensors in different single axes do not keep each
        other away.
    region : tuple (s) of str
    """

    nodes: Int
    at: Int
    axes: Float
    names: tuple[tuple[str, ...], ...]
    xyz: Float
    spread: Float
    region: tuple[str, ...]

    @property
    def node(self) -> Int:
        """Node of each sensor, (s,)."""
        return self.nodes[self.at]

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
        at = self.points(chosen)[1]
        axes = self.axes[chosen]
        out = np.zeros((at.max(initial=-1) + 1, 3, 3))
        np.add.at(out, at, np.einsum("cdi,cdj->cij", axes, axes))
        return out

    def test_model(self, chosen: Int) -> TestModel:
        """The sensors with lines between their points and the neighbours of the same region, for
        drawing.
        """
        points, back = self.points(chosen)
        _, first = np.unique(back, return_index=True)
        xyz = self.xyz[chosen][first]
        groups = [self.region[i] for i in chosen[first].tolist()]
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
    n = nodes.size
    names: tuple[tuple[str, ...], ...]
    if directions == "triaxial":
        at = np.arange(n)
        axes = np.broadcast_to(np.eye(3), (n, 3, 3))
        names = (AXES,) * n
    elif directions == "uniaxial":
        at = np.repeat(np.arange(n), 3)
        axes = np.tile(np.eye(3), (n, 1))[:, None, :]
        names = tuple((a,) for a in AXES) * n
    else:
        at, axes = _surface_sensors(nodes, scene)
        names = (NORMAL,) * at.size
    place = xyz[at]
    spread = place
    if directions == "uniaxial":
        # a fourth coordinate sets the axes farther from each other than any two nodes are
        far = 10 * (1.0 + float(np.ptp(xyz, axis=0).max(initial=0.0)))
        spread = np.column_stack([place, far * np.tile(np.arange(3), n)])
    regions = tuple(region[i] for i in at.tolist())
    return Arrangement(nodes, at, axes, names, xyz=place, spread=spread, region=regions)


def _surface_sensors(nodes: Int, scene: Scene) -> tuple[Int, Float]:
    """Candidates that lie on surfaces, (s,), and their normals, (s, 1, 3)."""
    normal = surface_normals(scene.xyz, scene.triangles)
    seat = np.searchsorted(scene.node, nodes).clip(max=scene.node.size - 1)
    here: Bool = (scene.node[seat] == nodes) & (
        np.linalg.norm(normal[seat], axis=1) > 0
    )
    if not here.any():
        raise ConfigError(
            '[plan] directions = "normal": no candidate lies on a shell or on the skin of solids'
        )
    at = np.flatnonzero(here)
    return at, normal[seat[at]][:, None, :]


@dataclass(frozen=True, eq=False)
class PlanProblem:
    """What a plan chooses from.

    Attributes
    ----------
    session : Session
    section : PlanSection
    able : Arrangement
        The candidates that move.
    motion : (n, 3, m) float64
        Mass-normalised translations of their nodes in all modes of the deck.
    """

    session: Session
    section: PlanSection
    able: Arrangement
    motion: Float

    @cached_property
    def shapes(self) -> Float:
        """What the candidates read, (s, d, m)."""
        return self.able.seen(self.motion)

    @property
    def model(self) -> ModelStage:
        """The deck and its modes."""
        found: ModelStage = self.session.get("model")
        return found

    @property
    def frequencies(self) -> Float:
        """Of the deck, (m,) Hz."""
        return self.model.modes.frequencies

    @property
    def si(self) -> float:
        """Of shapes: mass-normalised in t they are 1/√t = 1/√(1000 kg)."""
        return float(1 / np.sqrt(self.session.unit.kilograms))

    @cached_property
    def least_distance(self) -> float:
        """Of measuring points, m."""
        asked = self.section.min_distance
        if isinstance(asked, float):
            return asked
        even = spacing_of_points(self.able.spread, self.section.sensors)
        return even if asked == "even" else min(even, LARGEST_LEAST_DISTANCE_M)

    def targets(self, edge: float) -> tuple[Targets, tuple[str, ...]]:
        """The target modes: as named, or those of the band that a criterion asks for; and those
        that no candidate reads, in words. `edge` is between rigid-body and elastic modes, Hz.
        """
        f = self.frequencies
        plan = self.section
        readable_modes = readable(self.shapes, self.model.mass.mass)
        if plan.modes:
            if max(plan.modes) > f.size:
                raise ConfigError(
                    f"[plan] modes: {max(plan.modes)} of {f.size} modes below fmax of [model]; "
                    "raise it"
                )
            named = np.isin(np.arange(1, f.size + 1), plan.modes)
            return choose_targets(f, {"named": named}).among(readable_modes)
        rigid = plan.fmax <= edge  # a band of rigid-body modes alone is one of them
        low = max(rigid_below(f) if rigid else edge, plan.fmin)
        within = in_band(f, low, plan.fmax)
        criteria = self._criteria(within) or {
            f"{low:.4g} to {plan.fmax:.4g} Hz": within
        }
        return choose_targets(f, criteria, within=within).among(readable_modes)

    def _criteria(self, within: Bool) -> dict[str, Bool]:
        """What [plan] asks of target modes besides the band."""
        plan = self.section
        criteria: dict[str, Bool] = {}
        if not (plan.effective_mass or plan.sensitive or plan.telling or plan.kinetic):
            return criteria
        analysis = self.session.initial.analysis
        modes = self.session.initial.modes(self.session.first_fmax).modes
        system = analysis.system
        free = np.asarray(system.local @ modes.shapes)
        if plan.effective_mass:
            share = effective_mass(free, system.mass, system.rigid_body()).max(axis=1)
            name = f"effective mass over {100 * plan.effective_mass:g} %"
            criteria[name] = share > plan.effective_mass
        for name, least in plan.kinetic.items():
            rows = np.flatnonzero(np.isin(system.free.node, plan.candidates[name]))
            share = kinetic_share(free, system.mass, [rows])[:, 0]
            criteria[f"kinetic energy of {name} over {100 * least:g} %"] = share > least
        if not (plan.sensitive or plan.telling):
            return criteria
        parameters = self.session.config.candidates()
        if not len(parameters):
            raise ConfigError("[plan] sensitive and telling need a [[candidate]]")
        lam = (2 * np.pi * modes.frequencies) ** 2
        columns = []
        for s in analysis.slopes(parameters):
            change = s.stiffness @ free - (s.mass @ free) * lam
            columns.append(np.einsum("fm,fm->m", free, change))
        scale = np.where(within, 1 / np.where(within, lam, 1.0), 0.0)
        relative = scale[:, None] * np.stack(columns, axis=1)
        if plan.sensitive:
            total = np.abs(relative).sum(axis=1)
            criteria[f"sensitivity over {plan.sensitive:g}"] = total > plan.sensitive
        if plan.telling:
            x = relative * parameters.derivative(np.zeros(len(parameters)))
            # 0.01: relative, of an eigenvalue: half a percent of a frequency
            at = informative_modes(
                x, np.ones(len(x)), 0.01, parameters.std(), plan.telling
            )
            criteria["distinguishes parameters"] = np.isin(np.arange(len(x)), at)
        return criteria

    def excitation(self, chosen: Int, targets: Int) -> Int:
        """Rows of the channels to excite, among those of the chosen sensors."""
        plan = self.section
        able = self.able
        rows = self.shapes[chosen].reshape(chosen.size * able.each, -1)
        count = min(plan.references, len(rows))
        rows = rows[:, targets]
        measured = self.shapes[:, :, targets] if plan.strike_at else rows[:, None, :]
        largest = (measured**2).max(axis=(0, 1))
        some = within_reach(rows, largest)
        few = rows[:, some]
        top = largest[some]
        if plan.strike == "greedy":
            return select_references(few, count, top)
        return rank_sets(few, count, largest=top, most=1)[0].rows


def node_rows(session: Session, nodes: Int) -> Int:
    """Rows of the translations of the nodes among the DOFs of the deck, (n, 3)."""
    labels = session.initial.analysis.dofs
    at = np.stack(
        [labels.find(nodes, np.full(nodes.shape, i + 1)) for i in range(3)], axis=1
    )
    if (at < 0).any():
        raise ConfigError(
            f"[plan.candidates]: node {int(nodes[(at < 0).any(axis=1)][0])} is not in the deck"
        )
    return at


def within_reach(rows: Float, largest: Float) -> Bool:
    """Which modes of rows (r, m) one of them excites well, (m,); all if none: what no point reaches
    ranks nothing.
    """
    some = (rows**2).max(axis=0) >= LEAST_REACH * largest
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
        Target modes where a force can act.
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
    some = within_reach(rows, largest)
    sets: list[ExciterSet] = []
    for size in range(max(1, count - 2), min(count + 2, len(rows)) + 1):
        most = 3 if size == count else 1
        sets += rank_sets(rows[:, some], size, largest=largest[some], most=most)
    share = shares(rows, largest)
    reach = np.stack([share[s.rows].max(axis=0) for s in sets])
    return tuple(tuple(labels[i] for i in s.rows.tolist()) for s in sets), reach


def virtual_tests(
    problem: PlanProblem, stage: PlanStage, rows: Float, progress: Progress
) -> PlanStage:
    """The stage with what virtual tests by a plan find of its target modes, and virtual ambient
    tests of theirs; `rows` (s, m) are shapes at its channels, by SI mass.

    Ambient forces act along all channels; the sensors are those of the ambient tests, or all where
    these are not planned.
    """
    plan = problem.section
    seed = problem.session.config.study.seed
    f = problem.frequencies
    channels = stage.sensors.test.channels
    references = stage.excitation.references
    at = [channels.index(r) for r in references]
    band = _test_band(stage.target_frequencies, plan.damping)
    planned = Planned(
        f, rows, rows[at], channels, references, fmin=band[0], fmax=band[1]
    )
    hits = min(stage.acquisition.averages, 20)  # at a reference, of a virtual test
    conditions = Conditions(trials=plan.trials, damping=plan.damping, hits=hits)
    if plan.background is None:
        conditions = replace(conditions, coherence=plan.coherence)
    else:
        conditions = replace(conditions, background=plan.background)
    rng = np.random.default_rng(seed + 7919)
    found = simulate_impact_test(
        planned, conditions, rng, progress=part(progress, 0.0, 0.5)
    )
    in_band_modes = np.flatnonzero(planned.targets)
    found = found.take(np.searchsorted(in_band_modes, stage.target_modes))
    stage = replace(stage, virtual_test=found)
    if not plan.ambient_force:
        return stage

    sensors = stage.sensors.ambient or channels
    seen = rows[[channels.index(c) for c in sensors]]
    expected = stage.acquisition.modes
    band = _test_band(f[expected], plan.damping)
    planned = Planned(f, seen, rows, sensors, channels, fmin=band[0], fmax=band[1])
    conditions = Conditions(
        trials=plan.trials, damping=plan.damping, sensor=ACCELEROMETER
    )
    whole = stage.acquisition.record_length
    duration = min(whole, longest(len(sensors), band[1]))
    ambient = AmbientConditions(duration, plan.ambient_force)
    rng = np.random.default_rng(seed + 7927)
    found = simulate_ambient_test(
        planned, ambient, conditions, rng, progress=part(progress, 0.5, 1.0)
    )
    found = found.take(np.searchsorted(np.flatnonzero(planned.targets), expected))
    notes = stage.notes
    if duration < whole:
        notes = (
            *notes,
            f"the virtual ambient tests last {duration:.4g} s of the {whole:.4g} s, as memory "
            "allows",
        )
    return replace(stage, virtual_ambient_test=found, notes=notes)


def _test_band(frequencies: Float, damping: float) -> tuple[float, float]:
    """From half a half-power band below the lowest to as much above the highest, Hz."""
    margin = 0.5 * damping * frequencies
    return float((frequencies - margin).min()), float((frequencies + margin).max())
