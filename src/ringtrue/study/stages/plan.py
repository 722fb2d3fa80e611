"""The test plan: target modes, measuring points, hammer points, resolution, and a virtual test of
it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.modes import elastic
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.correlation.sensor_mapping import at_dofs
from ringtrue.errors import ConfigError
from ringtrue.model.frames import positions
from ringtrue.planning.exciters import reached, shares
from ringtrue.planning.geometry import (
    drawn_mac,
    mesh_edges,
    select_candidates,
    spacing_of_points,
    wireframe,
)
from ringtrue.planning.information import Aim, greedy_logdet, mode_aim, parameter_aim, prior_shapes
from ringtrue.planning.resolution import readable, resolution
from ringtrue.planning.sensors import (
    add_redundancy,
    auto_mac_points,
    kinetic_weighted,
    lower_auto_mac,
    qr_points,
    select_points,
    worst_sensor_loss,
)
from ringtrue.planning.setups import (
    Setups,
    loaded_frequencies,
    roving_setups,
    roving_shift,
    suspension_points,
)
from ringtrue.shapes.mac import auto_mac, worst_off_diagonal
from ringtrue.study.config_sections import PlanSection
from ringtrue.study.opened import build
from ringtrue.study.planned_test import (
    AXES,
    RULES,
    Arrangement,
    arranged,
    exciters,
    node_rows,
    planned_targets,
    ranked,
    virtual_ambient_test,
    virtual_test,
)
from ringtrue.study.reference import elastic_edge
from ringtrue.study.results import ModelStage, PlanStage
from ringtrue.study.session import Session

# of the auto-MAC: points that lower it by less, and not to what was asked for, are left out
WORTH = 0.02
STILL = 1e-9  # of the largest motion: a node that is held is no candidate
APART = 0.8  # m, most that measuring points must be apart where nothing is said
SENSORS = {
    "triaxial": "triaxial points",
    "uniaxial": "sensors along single axes",
    "normal": "sensors along normals",
}
METHODS = {
    "independence": "by effective independence (backward elimination)",
    "qr": "by QR with pivoting of the modal matrix",
    "auto-mac": "by least auto-MAC (pivoted QR, additions, exchanges)",
    "information": "by greedy log-determinant of the information about modes and parameters",
}


def _candidates(plan: PlanSection, model: ModelStage) -> tuple[Int, tuple[str, ...]]:
    """Candidate nodes and the region of each: the first that names it."""
    if not plan.candidates:
        return model.scene.node, ("",) * model.scene.node.size
    first: dict[int, str] = {}
    for name, group in plan.candidates.items():
        first |= dict.fromkeys((n for n in group if n not in first), name)
    return np.array(list(first)), tuple(first.values())


def _within(
    session: Session, plan: PlanSection, nodes: Int, region: tuple[str, ...]
) -> tuple[Int, tuple[str, ...]]:
    """The candidates less those that boxes and exclusions take away; fixed nodes always stay."""
    if not (plan.boxes or plan.keep_out or plan.exclude or plan.fixed):
        return nodes, region
    lost = sorted(set(plan.fixed) - set(nodes.tolist()))
    nodes, region = np.append(nodes, np.array(lost, dtype=np.int64)), (*region, *("",) * len(lost))
    rows = session.initial.model["GRID"].find(nodes)
    if (rows < 0).any():
        raise ConfigError(f"[plan] fixed: node {int(nodes[rows < 0][0])} is not in the deck")
    xyz = positions(session.initial.model)[rows] * session.length
    here = np.intersect1d(plan.exclude, nodes).tolist()
    keep = select_candidates(nodes, xyz, boxes=plan.boxes, exclude=here, keep_out=plan.keep_out)
    keep |= np.isin(nodes, plan.fixed)
    return nodes[keep], tuple(r for r, yes in zip(region, keep.tolist(), strict=True) if yes)


def _shapes(session: Session, nodes: Int, modes: Int) -> Float:
    """Mass-normalised translations at the candidates, (n, 3, m)."""
    found = session.initial.modes(session.first_fmax).modes
    return np.asarray(found.shapes[node_rows(session, nodes)][:, :, modes])


def _able(session: Session, plan: PlanSection, model: ModelStage) -> tuple[Arrangement, Float]:
    """The candidates that move, and the motion (node, 3, mode) of their nodes."""
    nodes, region = _within(session, plan, *_candidates(plan, model))
    motion = _shapes(session, nodes, np.arange(model.modes.frequencies.size))
    moves = np.abs(motion).max(axis=(1, 2)) > STILL * np.abs(motion).max(initial=0.0)
    rows = session.initial.model["GRID"].find(nodes)
    read = session.initial.model["GRID"].file[rows] >= 0  # not made by refining the mesh
    keep = np.flatnonzero(read & (moves | np.isin(nodes, plan.fixed)))
    nodes, region, motion = nodes[keep], tuple(region[i] for i in keep.tolist()), motion[keep]
    xyz = positions(session.initial.model)[rows[keep]] * session.length
    return arranged(nodes, region, xyz, plan.directions, model.scene), motion


def run(session: Session, progress: Progress) -> PlanStage:
    """Choose where to measure and where to hit.

    The ambient tests use the sensors that tell the rigid-body and first elastic modes apart; they
    stay in the hammer test, so that the two can be compared.
    """
    plan = session.config.plan
    if plan is None:
        raise ConfigError("this stage needs a [plan]")
    model: ModelStage = session.get("model")
    f = model.modes.frequencies
    edge = elastic_edge(f, session.config)
    able, motion = _able(session, plan, model)
    shapes = able.seen(motion)
    seen = readable(shapes, model.mass)
    wanted, unseen = planned_targets(session, plan, f, edge).among(seen)
    targets = wanted.modes
    flexible = elastic(f)
    timed = (
        targets[flexible[targets]] if flexible[targets].any() else targets
    )  # what decays; rigid bodies do not
    first = np.union1d(np.flatnonzero(flexible & seen & (f <= edge)), timed[: plan.ambient_sensors])
    apart = _apart(plan, able.apart, plan.sensors)
    ambient_at = (
        _ambient(plan, able, shapes[:, :, first], apart)
        if plan.ambient
        else np.zeros(0, dtype=np.int64)
    )
    fixed = np.isin(np.arange(able.at.size), ambient_at) | np.isin(able.node, plan.fixed)
    progress(0.3, "measuring points")
    spots = np.flatnonzero(
        np.isin(able.node, plan.strike_at)
    )  # where alone may be struck: chosen before the points
    if plan.strike_at and not spots.size:
        raise ConfigError(f"[plan] strike_at: none of {plan.strike_at[:8]} is a candidate")
    if spots.size:
        hits, values, forces = exciters(
            session, plan, able=able, shapes=shapes, chosen=spots, targets=targets
        )
        struck, axis = spots[hits // able.each], hits % able.each
        fixed |= np.isin(np.arange(able.at.size), struck)
    chosen = _points(
        session, plan, able=able, shapes=shapes, targets=targets, fixed=fixed, apart=apart
    )
    rows = shapes[chosen][:, :, targets].reshape(-1, targets.size)
    labels = able.labels(chosen)
    progress(0.5, "where to excite")
    if spots.size:
        hits = np.searchsorted(chosen, struck) * able.each + axis
    else:
        hits, values, forces = exciters(
            session, plan, able=able, shapes=shapes, chosen=chosen, targets=targets
        )
    where = spots if spots.size else chosen
    able_rows, largest = (
        shapes[where][:, :, targets].reshape(-1, targets.size),
        (rows**2).max(axis=0),
    )
    sets, set_reach = ranked(able_rows, able.labels(where), hits.size, largest)
    mac = auto_mac(rows)
    lost = min(max(1, plan.redundancy), chosen.size)
    need = resolution(f[timed], plan.damping, error=plan.error, coherence=plan.coherence)
    every = resolution(f[first], plan.damping, precision=plan.precision)
    stage = PlanStage(
        candidates=able.at.size,
        target_modes=targets,
        test=able.test_model(chosen),
        ambient=able.labels(ambient_at),
        references=tuple(labels[i] for i in hits.tolist()),
        auto_mac=mac,
        worst_off_diagonal=worst_off_diagonal(mac),
        frequency_step=need.step,
        block=need.block,
        record_length=every.record,
        damping=plan.damping,
        expected_modes=first,
        expected_std_frequency=every.std_frequency,
        expected_std_damping=every.std_damping,
        rule=f"{SENSORS[plan.directions]} {METHODS[plan.method]} of {targets.size} target modes, "
        f"at least {apart:g} m apart, then points that lower the worst auto-MAC; "
        f"{RULES[plan.strike]} "
        f"(least share reached {100 * float(reached(rows, hits).min()):.0f} %)",
        target_frequencies=f[targets],
        reach=reached(rows, hits),
        reachable=shares(able_rows, largest).max(axis=0),
        reasons=wanted.reasons,
        left_by_loss=worst_sensor_loss(shapes[chosen][:, :, targets], lost).left
        if lost < chosen.size
        else 0.0,
        lost=lost,
        averages=need.averages,
        segments=int(every.record // need.block),
        notes=(*unseen, *_in_vain(session, plan, able), *_alike(mac, targets, plan.max_auto_mac)),
        indicator=values,
        forces=forces,
        sets=sets,
        set_reach=set_reach,
    )
    progress(0.6, "what the plan shows and misses")
    return _judged(
        session,
        plan,
        stage=stage,
        able=able,
        motion=motion,
        chosen=chosen,
        apart=apart,
        progress=progress,
    )


def _in_vain(session: Session, plan: PlanSection, able: Arrangement) -> tuple[str, ...]:
    """Nodes that the plan names in vain, in words."""
    lost = {
        "strike_at names nodes that are no candidates": np.setdiff1d(plan.strike_at, able.node),
        "exclude names nodes that are not in the deck": np.setdiff1d(
            plan.exclude, session.initial.model["GRID"].ids
        ),
    }
    return tuple(
        f"{t}: {' '.join(str(int(n)) for n in x[:8])}{' ...' * (x.size > 8)}"
        for t, x in lost.items()
        if x.size
    )


def _alike(mac: Float, targets: Int, wanted: float) -> tuple[str, ...]:
    """Target modes that the points do not tell apart as well as wanted, in words; the worst pair
    and how many.
    """
    above = np.triu(mac, 1)
    a, b = np.unravel_index(int(np.argmax(above)), above.shape)
    if above[a, b] <= wanted:
        return ()
    pairs, of = np.count_nonzero(above > wanted), targets.size * (targets.size - 1) // 2
    return (
        f"modes {targets[a] + 1} and {targets[b] + 1} look alike at the points, auto-MAC "
        f"{100 * above[a, b]:.0f} %; "
        f"{pairs} of {of} pairs above {100 * wanted:g} %: more points, or closer ones, may tell "
        "them apart",
    )


def _apart(plan: PlanSection, places: Float, count: int) -> float:
    """Least distance of measuring points, m."""
    if isinstance(plan.min_distance, float):
        return plan.min_distance
    even = spacing_of_points(places, count)
    return even if plan.min_distance == "even" else min(even, APART)


def _points(
    session: Session,
    plan: PlanSection,
    able: Arrangement,
    shapes: Float,
    targets: Int,
    fixed: Bool,
    apart: float,
) -> Int:
    """Sensors by the method asked for, with the auto-MAC lowered and the redundancy asked for."""
    phi, xyz = shapes[:, :, targets], able.apart
    seen = kinetic_weighted(phi, _mass(session, able)) if plan.weigh else phi
    cost = np.array([plan.cost.get(r, 1.0) for r in able.region]) if plan.cost else None
    count = plan.sensors
    if plan.method == "independence":
        chosen = select_points(seen, xyz, count, fixed=fixed, min_distance=apart)
    elif plan.method == "qr":
        chosen = qr_points(seen, count, xyz=xyz, min_distance=apart, fixed=fixed, cost=cost)
    elif plan.method == "auto-mac":
        chosen = auto_mac_points(seen, count, xyz=xyz, min_distance=apart, fixed=fixed)
    else:
        aims = _aims(session, plan, able=able, seen=seen, phi=phi, targets=targets)
        chosen = greedy_logdet(aims, count, xyz=xyz, min_distance=apart, fixed=fixed, cost=cost)
    kept = (
        0.0 if plan.min_distance is None else apart
    )  # what was asked for holds for additions, too
    most = plan.at_hand if plan.at_hand >= plan.sensors else plan.sensors + 15
    chosen = lower_auto_mac(
        phi, np.sort(chosen), plan.max_auto_mac, most, xyz=xyz, min_distance=kept, worth=WORTH
    )
    if plan.redundancy:
        most = 2 * plan.sensors + 15
        chosen = np.sort(
            add_redundancy(phi, chosen, plan.redundancy, most=most, xyz=xyz, min_distance=kept)
        )
    return chosen


def _mass(session: Session, able: Arrangement) -> Float:
    """Mean translational mass on the diagonal of the mass matrix at the sensors, (s,); 0 where a
    node is held.
    """
    system, nodes = session.initial.analysis.system, able.nodes
    at = np.flatnonzero((system.free.direction != 0) & (np.abs(system.free.direction) <= 3))
    order = np.argsort(nodes)
    seat = order[
        np.searchsorted(nodes, system.free.node[at], sorter=order).clip(max=nodes.size - 1)
    ]
    here = nodes[seat] == system.free.node[at]
    return np.asarray(
        np.bincount(seat[here], system.mass.diagonal()[at][here], nodes.size)[able.at] / 3
    )


def _aims(
    session: Session, plan: PlanSection, able: Arrangement, seen: Float, phi: Float, targets: Int
) -> list[Aim]:
    """The modes, as they are and at draws of the prior, and the candidates for the updating where
    there are some.
    """
    parameters = session.config.candidates()
    aims = [mode_aim(seen)]
    if plan.draws:
        aims = [
            mode_aim(s, weight=1 / (plan.draws + 1)) for s in _drawn(session, plan, able, targets)
        ]
    if len(parameters) and session.engine is not None:
        raise ConfigError(
            f'[plan] method "information" needs derivatives of the modes of {session.deck.solver}: '
            "use another"
        )
    if len(parameters):
        found = session.initial.modes(session.first_fmax).modes.take(targets)
        d_lambda, d_phi = session.initial.analysis.derivatives(found, parameters)
        slope = parameters.derivative(np.zeros(len(parameters)))
        relative = d_lambda * slope / (2 * np.pi * found.frequencies[:, None]) ** 2
        d_nodes = d_phi[node_rows(session, able.nodes)] * slope
        d_seen = able.seen(d_nodes.reshape(*d_nodes.shape[:2], -1))
        aims.append(
            parameter_aim(
                phi,
                d_seen.reshape(*d_seen.shape[:2], *d_nodes.shape[2:]),
                parameters.std(),
                relative=relative,
            )
        )
    return aims


def _drawn(session: Session, plan: PlanSection, able: Arrangement, targets: Int) -> Float:
    """Target shapes at the sensors at draws of the prior, the nominal ones first, (draw, s, d,
    m).
    """
    parameters = session.config.candidates()
    if not len(parameters):
        raise ConfigError("[plan] draws needs a [[candidate]]: the prior is theirs")
    labels = tuple(f"{n}+{a}" for n in able.nodes.tolist() for a in AXES)
    model = build(
        session.initial,
        parameters,
        at_dofs(labels, session.initial.analysis.dofs),
        session.first_fmax,
        quiet,
    )
    found = prior_shapes(model, plan.draws, np.random.default_rng([session.config.study.seed, 10]))[
        :, :, targets
    ]
    mass = _mass(session, able) if plan.weigh else np.ones(able.at.size)
    return np.stack(
        [kinetic_weighted(able.seen(s.reshape(able.nodes.size, 3, -1)), mass) for s in found]
    )


def _judged(
    session: Session,
    plan: PlanSection,
    stage: PlanStage,
    able: Arrangement,
    motion: Float,
    chosen: Int,
    apart: float,
    progress: Progress,
) -> PlanStage:
    """The stage with what was asked for besides: drawing, loading, suspension, virtual test."""
    model: ModelStage = session.get("model")
    f, targets = model.modes.frequencies, stage.target_modes
    points, back = able.points(chosen)
    seat = np.searchsorted(model.scene.node, points).clip(max=model.scene.node.size - 1)
    if (model.scene.node[seat] == points).all():  # all points lie on what is drawn
        edges = mesh_edges(model.scene.triangles, model.scene.lines)
        drawn = model.modes.shapes.reshape(model.scene.node.size, 3, -1)[:, :, targets]
        stage = replace(
            stage, shown=drawn_mac(model.scene.xyz, edges, seat, drawn, able.measured(chosen))
        )
        if plan.lines == "mesh":
            lines = points[wireframe(model.scene.xyz, edges, seat)]
            stage = replace(stage, test=replace(stage.test, lines=lines))
    si = 1 / np.sqrt(session.unit.kilograms)  # mass-normalised in t: 1/√t = 1/√(1000 kg)
    if plan.sensor_mass:
        added = np.asarray(plan.sensor_mass * np.bincount(back), dtype=np.float64)
        flexible, shift = elastic(f), np.full(f.size, np.nan)
        order = np.argsort(able.nodes)
        here = motion[order[np.searchsorted(able.nodes, points, sorter=order)]][:, :, flexible]
        shift[flexible] = loaded_frequencies(f[flexible], si * here, added) / f[flexible] - 1
        stage = replace(stage, loaded=shift[targets])
    if 0 < plan.at_hand < chosen.size:
        stage = replace(
            stage, setups=_setups(plan, stage, able=able, chosen=chosen, f=f, motion=si * motion)
        )
    if plan.suspension:
        xyz = (
            positions(session.initial.model)[session.initial.model["GRID"].find(able.nodes)]
            * session.length
        )
        hung = suspension_points(
            motion[:, 2:, targets],
            xyz,
            plan.suspension,
            model.cg * session.length,
            min_distance=apart,
        )
        places = tuple(able.nodes[hung.points].tolist())
        stage = replace(stage, suspension=places, suspension_motion=hung.motion, steady=hung.steady)
    if plan.trials:
        progress(0.7, "virtual test")
        rows = si * able.seen(motion)[chosen].reshape(-1, f.size)
        stage = replace(
            stage, rehearsal=virtual_test(session, plan, stage, rows, part(progress, 0.7, 0.85))
        )
        if plan.ambient_force:
            found, notes = virtual_ambient_test(
                session, plan, stage, rows, part(progress, 0.85, 1.0)
            )
            stage = replace(stage, ambient_rehearsal=found, notes=(*stage.notes, *notes))
    return stage


def _setups(
    plan: PlanSection, stage: PlanStage, able: Arrangement, chosen: Int, f: Float, motion: Float
) -> Setups:
    """Which sensors stay and which rove, and what their mass does to the target modes; motion in
    SI.
    """
    targets = stage.target_modes
    struck = np.array(
        [stage.test.channels.index(r) // able.each for r in stage.references], dtype=np.int64
    )
    found = roving_setups(
        able.seen(motion)[chosen][:, :, targets], able.xyz[chosen], plan.at_hand, struck
    )
    if not plan.sensor_mass:
        return found
    flexible, shift = elastic(f), np.full(f.size, np.nan)
    here = motion[able.at[chosen]][:, :, flexible]
    shift[flexible] = roving_shift(f[flexible], here, plan.sensor_mass, found.setup)
    return replace(found, shift=shift[targets])


def _ambient(plan: PlanSection, able: Arrangement, shapes: Float, apart: float) -> Int:
    """Sensors of the ambient tests: in the first two regions, half of them in each."""
    names = list(dict.fromkeys(able.region))[:2]
    out = []
    for name in names:
        at = np.flatnonzero(np.array([r == name for r in able.region]))
        count = max(plan.ambient_sensors // len(names), -(-shapes.shape[2] // able.each))
        count = min(count, at.size)
        wide = (
            2 * apart
            if isinstance(plan.min_distance, float)
            else min(2 * apart, spacing_of_points(able.apart[at], count))
        )
        out.append(at[select_points(shapes[at], able.apart[at], count, min_distance=wide)])
    return np.sort(np.concatenate(out))
