"""The test plan: target modes, measuring points, excitation points, resolution, and a virtual test
of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.iterate import Progress, part
from ringtrue.core.modes import elastic
from ringtrue.errors import ConfigError
from ringtrue.model.frames import positions
from ringtrue.planning.exciters import reached, readable, resolution, shares
from ringtrue.planning.geometry import (
    drawn_mac,
    mesh_edges,
    select_candidates,
    spacing_of_points,
    wireframe,
)
from ringtrue.planning.plan_files import (
    loaded_frequencies,
    roving_setups,
    roving_shift,
    suspension_points,
)
from ringtrue.planning.sensors import (
    Spacing,
    add_redundancy,
    lower_auto_mac,
    select_points,
    worst_sensor_loss,
)
from ringtrue.shapes import auto_mac
from ringtrue.study.config_sections import PlanSection
from ringtrue.study.planned_test import (
    PlanProblem,
    arranged,
    node_rows,
    ranked,
    virtual_tests,
)
from ringtrue.study.reference import elastic_edge
from ringtrue.study.results import (
    AcquisitionPlan,
    ExcitationPlan,
    ModelStage,
    PlanStage,
    SensorPlan,
    SuspensionPlan,
)
from ringtrue.study.session import Session

# of the auto-MAC: points that lower it by less, and not to what was asked for, are left out
WORTH = 0.02
EXTRA_POINTS = 15  # over those asked for, to lower the auto-MAC or for redundancy

SENSORS = {
    "triaxial": "triaxial points",
    "uniaxial": "sensors along single axes",
    "normal": "sensors along normals",
}
EXCITATION = {
    "greedy": "hammer points greedily by the driving-point residue of the mode that is excited "
    "worst",
    "worst": "the best set of hammer points by the driving-point residue of the mode that is "
    "excited worst",
}


def run(session: Session, progress: Progress) -> PlanStage:
    """Choose where to measure and where to hit.

    The ambient tests use the sensors that best tell the rigid-body and first elastic modes from
    each other; they stay in the hammer test, so that the two can be compared.
    """
    plan = session.config.plan
    if plan is None:
        raise ConfigError("this stage needs a [plan]")
    problem = plan_problem(session, plan)
    able = problem.able
    shapes = problem.shapes
    f = problem.frequencies
    edge = elastic_edge(f, session.config)
    wanted, unseen = problem.targets(edge)
    targets = wanted.modes
    flexible = elastic(f)
    # what decays; rigid bodies do not
    timed = targets[flexible[targets]] if flexible[targets].any() else targets
    seen = readable(shapes, problem.model.mass.mass)
    low = np.flatnonzero(flexible & seen & (f <= edge))
    first = np.union1d(low, timed[: plan.ambient_sensors])
    ambient = _ambient(problem, first) if plan.ambient else np.zeros(0, dtype=np.int64)
    fixed = np.isin(np.arange(able.at.size), ambient) | np.isin(able.node, plan.fixed)
    progress(0.3, "measuring points")
    chosen, where, found = _points_and_exciters(problem, targets, fixed, progress)
    seen_rows = shapes[chosen][:, :, targets]
    mac = auto_mac(seen_rows.reshape(-1, targets.size))
    lost = min(max(1, plan.redundancy), chosen.size)
    left = worst_sensor_loss(seen_rows, lost).left if lost < chosen.size else 0.0
    excitation = _excitation(problem, targets, chosen=chosen, where=where, found=found)
    stage = PlanStage(
        target_modes=targets,
        target_frequencies=f[targets],
        reasons=wanted.reasons,
        sensors=SensorPlan(
            candidates=able.at.size,
            test=able.test_model(chosen),
            ambient=able.labels(ambient),
            auto_mac=mac,
            lost=lost,
            left_by_loss=left,
        ),
        excitation=excitation,
        acquisition=_acquisition(problem, timed, first),
        rule=_rule(problem, targets, excitation),
        notes=(*unseen, *_in_vain(problem), *_similar(mac, targets, plan.max_auto_mac)),
    )
    progress(0.6, "what the plan shows and misses")
    stage = replace(stage, sensors=_with_drawing(problem, stage, chosen))
    if plan.suspension:
        stage = replace(stage, suspension=_suspension(problem, targets))
    if plan.trials:
        progress(0.7, "virtual test")
        rows_si = problem.si * shapes[chosen].reshape(-1, f.size)
        stage = virtual_tests(problem, stage, rows_si, part(progress, 0.7, 1.0))
    return stage


def _points_and_exciters(
    problem: PlanProblem, targets: Int, fixed: Bool, progress: Progress
) -> tuple[Int, Int, Int]:
    """The measuring points, the points that may be excited, and the directions of the measuring
    points that are.

    Where `strike_at` says where alone may be excited, that is chosen before the measuring points.
    """
    able = problem.able
    strike_at = problem.section.strike_at
    spots = np.flatnonzero(np.isin(able.node, strike_at))
    if strike_at and not spots.size:
        raise ConfigError(f"[plan] strike_at: none of {strike_at[:8]} is a candidate")
    if not spots.size:
        chosen = _points(problem, targets, fixed)
        progress(0.5, "where to excite")
        return chosen, chosen, problem.excitation(chosen, targets)
    found = problem.excitation(spots, targets)
    excited = spots[found // able.each]
    chosen = _points(
        problem, targets, fixed | np.isin(np.arange(able.at.size), excited)
    )
    return (
        chosen,
        spots,
        np.searchsorted(chosen, excited) * able.each + found % able.each,
    )


def _acquisition(problem: PlanProblem, timed: Int, first: Int) -> AcquisitionPlan:
    """Blocks that resolve the modes `timed`, and ambient records that are long enough for the modes
    `first`.
    """
    plan = problem.section
    f = problem.frequencies
    need = resolution(
        f[timed], plan.damping, error=plan.error, coherence=plan.coherence
    )
    every = resolution(f[first], plan.damping, precision=plan.precision)
    return AcquisitionPlan(
        damping=plan.damping,
        frequency_step=need.step,
        block=need.block,
        averages=need.averages,
        record_length=every.record,
        segments=int(every.record // need.block),
        modes=first,
        std_frequency=every.std_frequency,
        std_damping=every.std_damping,
    )


def _rule(problem: PlanProblem, targets: Int, excitation: ExcitationPlan) -> str:
    """How the points were chosen, in words."""
    plan = problem.section
    return (
        f"{SENSORS[plan.directions]} by effective independence (backward elimination) of "
        f"{targets.size} target modes, at least {problem.least_distance:g} m from each other, "
        f"then points that lower the worst auto-MAC; {EXCITATION[plan.strike]} "
        f"(least share reached {100 * float(excitation.reach.min()):.0f} %)"
    )


def plan_problem(
    session: Session, plan: PlanSection, *, stored: bool = False
) -> PlanProblem:
    """The candidates that move, and the motion (node, 3, mode) of their nodes.

    A candidate is of the first region that names it; boxes and exclusions take candidates away,
    fixed nodes always stay. With `stored` the motion is that of the stored modes where all
    candidates are drawn, and nothing is solved.

    Raises
    ------
    ConfigError
        If a fixed node is not in the deck, or the deck has no mode up to `fmax`.
    """
    model: ModelStage = session.get("model")
    grid = session.initial.model["GRID"]
    first: dict[int, str] = {}
    for name, group in plan.candidates.items():
        first |= dict.fromkeys((n for n in group if n not in first), name)
    if not plan.candidates:
        first = dict.fromkeys(model.scene.node.tolist(), "")
    first |= dict.fromkeys((n for n in sorted(set(plan.fixed)) if n not in first), "")
    nodes = np.array(list(first))
    rows = grid.find(nodes)
    lost = (rows < 0) & np.isin(nodes, plan.fixed)
    if lost.any():
        raise ConfigError(
            f"[plan] fixed: node {int(nodes[lost][0])} is not in the deck"
        )
    seat = np.searchsorted(model.scene.node, nodes).clip(max=model.scene.node.size - 1)
    if stored and (model.scene.node[seat] == nodes).all():
        motion = model.modes.shapes.reshape(model.scene.node.size, 3, -1)[seat]
    else:
        motion = session.initial.modes(session.first_fmax).modes.shapes[
            node_rows(session, nodes)
        ]
    if not motion.shape[2]:
        raise ConfigError(
            f"[plan]: the deck has no mode below {session.first_fmax:g} Hz: raise [model] fmax"
        )
    xyz = positions(session.initial.model)[rows] * session.length
    here = np.intersect1d(plan.exclude, nodes).tolist()
    keep = select_candidates(
        nodes, xyz, boxes=plan.boxes, exclude=here, keep_out=plan.keep_out
    )
    fixed = np.isin(nodes, plan.fixed)
    keep |= fixed
    # 1e-9: of the largest motion: a node that moves less is no candidate
    moves = np.abs(motion).max(axis=(1, 2)) > 1e-9 * np.abs(motion[keep]).max(
        initial=0.0
    )
    read = grid.file[rows] >= 0  # not made by refining the mesh
    at = np.flatnonzero(keep & read & (moves | fixed))
    region = list(first.values())
    regions = tuple(region[i] for i in at.tolist())
    able = arranged(nodes[at], regions, xyz[at], plan.directions, model.scene)
    return PlanProblem(session, plan, able, np.asarray(motion[at]))


def _excitation(
    problem: PlanProblem, targets: Int, *, chosen: Int, where: Int, found: Int
) -> ExcitationPlan:
    """What the excitation points reach at the chosen sensors; `where` may be excited."""
    able = problem.able
    shapes = problem.shapes
    rows = shapes[chosen][:, :, targets].reshape(-1, targets.size)
    able_rows = shapes[where][:, :, targets].reshape(-1, targets.size)
    largest = (rows**2).max(axis=0)
    sets, set_reach = ranked(able_rows, able.labels(where), found.size, largest)
    labels = able.labels(chosen)
    return ExcitationPlan(
        references=tuple(labels[i] for i in found.tolist()),
        reach=reached(rows, found),
        reachable=shares(able_rows, largest).max(axis=0),
        sets=sets,
        set_reach=set_reach,
    )


def _in_vain(problem: PlanProblem) -> tuple[str, ...]:
    """Nodes that the plan names in vain, in words."""
    plan = problem.section
    deck = problem.session.initial.model["GRID"].ids
    lost = {
        "strike_at names nodes that are no candidates": np.setdiff1d(
            plan.strike_at, problem.able.node
        ),
        "exclude names nodes that are not in the deck": np.setdiff1d(
            plan.exclude, deck
        ),
    }
    return tuple(
        f"{t}: {' '.join(str(int(n)) for n in x[:8])}{' ...' * (x.size > 8)}"
        for t, x in lost.items()
        if x.size
    )


def _similar(mac: Float, targets: Int, wanted: float) -> tuple[str, ...]:
    """Target modes that the points do not tell from each other as well as wanted, in words; the
    worst pair and how many.
    """
    above = np.triu(mac, 1)
    a, b = np.unravel_index(int(np.argmax(above)), above.shape)
    if above[a, b] <= wanted:
        return ()
    pairs = np.count_nonzero(above > wanted)
    every = targets.size * (targets.size - 1) // 2
    return (
        f"modes {targets[a] + 1} and {targets[b] + 1} look the same at the points, auto-MAC "
        f"{100 * above[a, b]:.0f} %; "
        f"{pairs} of {every} pairs above {100 * wanted:g} %: more points, or closer ones, may "
        "distinguish them",
    )


def _points(problem: PlanProblem, targets: Int, fixed: Bool) -> Int:
    """Sensors by effective independence, with the auto-MAC lowered and the redundancy asked for."""
    plan = problem.section
    able = problem.able
    phi = problem.shapes[:, :, targets]
    xyz = able.spread
    count = plan.sensors
    least = problem.least_distance
    chosen = select_points(phi, xyz, count, fixed=fixed, min_distance=least)
    if plan.min_distance is None:  # what was asked for holds for additions, too
        least = 0.0
    most = plan.at_hand if plan.at_hand >= count else count + EXTRA_POINTS
    spacing = Spacing(xyz, least)
    chosen = lower_auto_mac(
        phi, np.sort(chosen), plan.max_auto_mac, most, spacing=spacing, worth=WORTH
    )
    if plan.redundancy:
        most = 2 * count + EXTRA_POINTS
        chosen = add_redundancy(
            phi, chosen, plan.redundancy, most=most, spacing=spacing
        )
        chosen = np.sort(chosen)
    return chosen


def _with_drawing(problem: PlanProblem, stage: PlanStage, chosen: Int) -> SensorPlan:
    """The sensors with their drawing, the shift of the modes by their mass, and the setups."""
    plan = problem.section
    able = problem.able
    sensors = stage.sensors
    targets = stage.target_modes
    f = problem.frequencies
    scene = problem.model.scene
    points, back = able.points(chosen)
    seat = np.searchsorted(scene.node, points).clip(max=scene.node.size - 1)
    if (scene.node[seat] == points).all():  # all points lie on what is drawn
        edges = mesh_edges(scene.triangles, scene.lines)
        drawn = problem.model.modes.shapes.reshape(scene.node.size, 3, -1)[
            :, :, targets
        ]
        shown = drawn_mac(scene.xyz, edges, seat, drawn, able.measured(chosen))
        sensors = replace(sensors, shown=shown)
        if plan.lines == "mesh":
            lines = points[wireframe(scene.xyz, edges, seat)]
            sensors = replace(sensors, test=replace(sensors.test, lines=lines))
    flexible = elastic(f)
    motion = problem.si * problem.motion[:, :, flexible]
    shift = np.full(f.size, np.nan)
    if plan.sensor_mass:
        added = np.asarray(plan.sensor_mass * np.bincount(back), dtype=np.float64)
        order = np.argsort(able.nodes)
        here = motion[order[np.searchsorted(able.nodes, points, sorter=order)]]
        shift[flexible] = loaded_frequencies(f[flexible], here, added) / f[flexible] - 1
        sensors = replace(sensors, loaded=shift[targets])
    if 0 < plan.at_hand < chosen.size:
        channels = sensors.test.channels
        excited = [channels.index(r) // able.each for r in stage.excitation.references]
        shapes = problem.si * problem.shapes[chosen][:, :, targets]
        at_points = np.array(excited, dtype=np.int64)
        setups = roving_setups(shapes, able.xyz[chosen], plan.at_hand, at_points)
        if plan.sensor_mass:
            moved = motion[able.at[chosen]]
            shift = np.full(f.size, np.nan)
            shift[flexible] = roving_shift(
                f[flexible], moved, plan.sensor_mass, setups.setup
            )
            setups = replace(setups, shift=shift[targets])
        sensors = replace(sensors, setups=setups)
    return sensors


def _suspension(problem: PlanProblem, targets: Int) -> SuspensionPlan:
    """Points to hang from that move least in the target modes."""
    session = problem.session
    nodes = problem.able.nodes
    grid = session.initial.model["GRID"]
    xyz = positions(session.initial.model)[grid.find(nodes)] * session.length
    found = suspension_points(
        problem.motion[:, 2:, targets],
        xyz,
        problem.section.suspension,
        problem.model.mass.cg * session.length,
        min_distance=problem.least_distance,
    )
    return SuspensionPlan(
        tuple(nodes[found.points].tolist()), found.motion, found.steady
    )


def _ambient(problem: PlanProblem, modes: Int) -> Int:
    """Sensors of the ambient tests: in the first two regions, half of them in each."""
    plan = problem.section
    able = problem.able
    shapes = problem.shapes[:, :, modes]
    names = list(dict.fromkeys(able.region))[:2]
    out = []
    for name in names:
        at = np.flatnonzero(np.array([r == name for r in able.region]))
        count = max(plan.ambient_sensors // len(names), -(-modes.size // able.each))
        count = min(count, at.size)
        least = 2 * problem.least_distance
        if not isinstance(plan.min_distance, float):
            least = min(least, spacing_of_points(able.spread[at], count))
        out.append(
            at[select_points(shapes[at], able.spread[at], count, min_distance=least)]
        )
    return np.sort(np.concatenate(out))
