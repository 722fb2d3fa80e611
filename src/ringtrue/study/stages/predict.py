"""What a finished study says of running the rotor: run-up with unbalance on the updated model, with
bands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, part
from ringtrue.core.parameters import ParameterSet
from ringtrue.eigen.damped import project
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.elements.lumped import build_bush as bush
from ringtrue.fem.parametrisation.changed_model import changed
from ringtrue.model.model import Model
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.reduction.response import ResponseSearch, response_basis
from ringtrue.study.config_sections import PredictSection
from ringtrue.study.objective import target, terms_of
from ringtrue.study.opened import Opened
from ringtrue.study.results import (
    CorrelateStage,
    DampedModes,
    DampedRegions,
    DampingStage,
    FinalStage,
    PredictStage,
)
from ringtrue.study.session import Session
from ringtrue.study.stages.damping import regions
from ringtrue.study.stages.final import delivered
from ringtrue.study.stages.tune import suspended
from ringtrue.study.stages.tune import target as rigid_target
from ringtrue.study.stages.update import other_configurations, over
from ringtrue.updating.damping_regions import matrices_of
from ringtrue.updating.identifiability import plausibility
from ringtrue.updating.prediction import (
    Damping,
    KnownModel,
    Output,
    RegionDamping,
    Rows,
    Unbalance,
    plane,
    run_up,
    unbalance_load,
    validated_band,
)
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.uncertainty import Posterior, laplace
from ringtrue.updating.validation import discrepancy

SPREAD = 0.3  # of ln ζ: what is known of damping beyond the tested modes


def run(session: Session, progress: Progress) -> PredictStage:
    """The run-up that [predict] of the study asks for.

    Raises
    ------
    ConfigError
        If the study has no [predict] or was not run to its end, its node or springs are not in the
        deck, or the test modes have no damping.
    """
    asked = session.config.predict
    if asked is None:
        raise ConfigError("a run-up needs [predict] with the rotor's node and mass")
    if "final" not in session.store.stages():
        raise ConfigError(
            "the study has no updated model yet: `ringtrue run` it to its final stage first"
        )
    rng = np.random.default_rng([session.config.study.seed, 9])
    # 0.005: of the highest speed: the first line
    freqs = np.linspace(0.005 * asked.fmax, asked.fmax, asked.lines)
    unbalance = Unbalance(asked.mass, asked.grade, asked.service)
    posterior, error = _posterior(session, part(progress, 0.0, 0.3))
    opened = session.remodelled
    final: FinalStage = session.get("final")
    if not np.median(final.damping) > 0:
        raise ConfigError(
            "a run-up needs damping; that of the test modes is 0. Where it is not known leave it "
            "out: 1 % is assumed"
        )
    system = opened.analysis.system
    at = system.dofs.find(np.full(3, asked.rotor), np.arange(1, 4))
    if (at < 0).any():
        raise ConfigError(
            f"rotor node {asked.rotor}: there is no such node in the deck"
        )
    motion = sparse.csr_array(system.transform[at])
    loads = motion[list(plane(asked.axis))].toarray().T
    model, residual = _model(
        session, posterior.parameters, loads, freqs, part(progress, 0.3, 0.6)
    )
    v = model.basis.vectors
    rows = Rows(np.asarray(motion @ v) * session.unit.length)
    outputs = [Output(f"rotor, node {asked.rotor}", "m", rows, 3)]
    for name, ids in asked.springs.items():
        outputs += _forces(
            opened, model.system.parameters, name, ids, v * session.unit.force
        )
    progress(0.6, "damping")
    damping, words = _damping(session, v)
    draws = posterior.sample(asked.draws, rng)
    forces = np.asarray(v.T @ loads) / session.unit.force  # the unbalance is in N
    result = run_up(
        KnownModel(model, posterior.x, draws, damping, discrepancy=error),
        unbalance_load(freqs, forces, unbalance),
        outputs,
        rng,
        level=asked.level,
        progress=part(progress, 0.65, 1.0),
    )
    result = replace(result, validated=_validated(session, final))
    flags = plausibility(posterior.parameters, posterior.x, posterior.ratio)
    return PredictStage(
        rotor=asked.rotor,
        axis=asked.axis,
        unbalance=unbalance,
        run_up=result,
        posterior=posterior,
        discrepancy=error,
        damping=words,
        residual=residual,
        flags=tuple(f.text for f in flags),
    )


def _damping(session: Session, v: Float) -> tuple[Damping | RegionDamping, str]:
    """Of the regions, where the study has found them; else the ratios of the test over frequency.
    And in words.
    """
    found: DampingStage | None = None
    if "damping" in (*session.results, *session.store.stages()):
        found = session.get("damping")
    if found is not None and found.regions is not None and not found.why:
        own = scatter(found.modes) if found.modes is not None else 0.0
        words = "loss factors and dashpots by region"
        each = f"{100 * own:.0f}"
        words += f", ± {each} % from mode to mode" if each != "0" else ""
        return replace(_by_region(session, found.regions, v), scatter=own), words
    final: FinalStage = session.get("final")
    f, at = np.unique(final.observed.frequencies, return_index=True)
    keep = f > 0
    words = (
        "damping ratios of the test, interpolated between its modes and constant beyond"
    )
    return Damping(f[keep], np.maximum(final.damping[at][keep], 0.0), SPREAD), words


def scatter(modes: DampedModes) -> float:
    """Standard deviation of ln ζ that the tested modes have besides the damping of the regions and
    its errors.
    """
    damped = (modes.measured > 0) & (modes.after > 0)
    if not damped.any():
        return 0.0
    measured = modes.measured[damped]
    found = modes.after[damped]
    known = np.hypot(
        modes.measured_std[damped] / measured, modes.after_std[damped] / found
    )
    return discrepancy(np.log(measured / found), known)


def _by_region(session: Session, found: DampedRegions, v: Float) -> RegionDamping:
    opened = delivered(session.own).opened
    mine = {r.name: r for r in regions(session, opened)}
    if lost := [n for n in found.names if n not in mine]:
        raise ConfigError(
            f"damping region {lost[0]!r} is not in the study any more: `ringtrue run` it again"
        )
    kept = [mine[n] for n in found.names]
    system = opened.analysis.system
    total = project(v, system.viscous, system.structural)
    matrices, base = matrices_of(
        opened.model, kept, np.asarray(system.transform @ v), total
    )
    viscous = np.array([r.kind == "viscous" for r in kept])
    return RegionDamping(
        found.coefficients, found.covariance, np.array(matrices), viscous, base
    )


def _validated(session: Session, final: FinalStage) -> tuple[float, float]:
    """The band of the test modes that the delivered model holds, wider by the deviation that is
    accepted.
    """
    found: CorrelateStage = session.get("correlate")
    test = found.reference.elastic
    rigid = found.reference.rigid
    accepted = session.config.correlate.accept_percent
    confident = test.confidence >= session.config.identify.confidence
    held = np.zeros(len(test), dtype=bool)
    held[final.table.pairing.a[np.abs(final.table.deviation_percent) <= accepted]] = (
        True
    )
    low, high = validated_band(test.frequencies[confident], held[confident])
    if len(rigid) and high > 0:
        low = min(low, float(rigid.frequencies.min()))
    margin = accepted / 100
    return low * (1 - margin), high * (1 + margin)


def _posterior(session: Session, progress: Progress) -> tuple[Posterior, float]:
    """Of the chosen parameters and the suspension, and the discrepancy of the left-out
    frequencies.
    """
    final: FinalStage = session.get("final")
    best = session.best
    aim = target(session.own)
    out = final.table.deviation_percent[~final.table.used] / 100
    shown = out if out.size else final.table.deviation_percent / 100
    error = (
        discrepancy(shown, np.zeros(shown.size))
        if shown.size
        else aim.weights.frequency
    )
    active = over(session.delivered_models(progress)[0], best.parameters)
    own = Configuration(active, aim, terms_of(session.own, active))
    every = (own, *other_configurations(session, best.factors, progress))
    wide = max(error, aim.weights.frequency)
    parts = [
        _laplace(tuple(c.weighed(wide, aim.weights.mac) for c in every), best.factors)
    ]
    if session.config.suspension:
        channels = session.own.reference.rigid.channels
        springs = suspended(session.own, channels, progress)
        tuned = session.get("tune").factors
        parts.append(
            _laplace((Configuration(springs, rigid_target(session.own)),), tuned)
        )
    # independent posteriors
    names = ParameterSet(tuple(p for one in parts for p in one.parameters.parameters))
    y = np.concatenate([one.y for one in parts])
    covariance = linalg.block_diag(*(one.covariance for one in parts))
    prior = np.concatenate([one.prior_std for one in parts])
    return Posterior(names, y, covariance, np.eye(y.size), prior), error


def _laplace(
    configurations: tuple[Configuration, ...], factors: Mapping[str, float]
) -> Posterior:
    problem = Problem(configurations)
    at = problem.evaluate(problem.parameters.vector(factors))
    return laplace(
        problem, at, np.ones(int(at.kind.max(initial=-1)) + 1), independent=1.0
    )


def _model(
    session: Session,
    parameters: ParameterSet,
    loads: Float,
    freqs: Float,
    progress: Progress,
) -> tuple[ReducedModel, float]:
    """The remodelled deck over some of its parameters, on a basis for the response to the loads at
    the updated point.

    And the largest residual of that response, relative to the load. The basis is that of one point:
    for the changes that the posterior leaves it is exact to second order.
    """
    model = session.delivered_models(part(progress, 0.0, 0.3))[0].model
    every = model.system.parameters
    known = session.factors()
    factors = np.array([known[n] for n in every.names])
    none = np.zeros(len(every))
    whole = model.with_parameters(range(len(every)), none)
    _, start = whole.vectors(every.vector(factors))
    final: FinalStage = session.get("final")
    # 40: speeds at which the residual is watched
    found = response_basis(
        Pencil(*model.system.at(factors)),
        loads,
        np.linspace(freqs[0], freqs[-1], min(freqs.size, 40)),
        start,
        ResponseSearch(loss=2 * float(np.median(final.damping))),
        progress=part(progress, 0.3, 1.0),
    )
    at = every.at(parameters.names)
    return model.on(found.vectors).with_parameters(at, none), float(
        found.residual.max()
    )


def _forces(
    opened: Opened, parameters: ParameterSet, name: str, ids: Sequence[int], v: Float
) -> list[Output]:
    """The largest force in one spring of a group, and the sum over the group along each axis.

    `parameters` are those of the reduced system, all of them in its order: `Rows` counts them so.
    """
    model = opened.model
    system = opened.analysis.system
    at = _bushes(model, name, ids)
    t = system.transform
    rows = _spring_rows(model, at, system.dofs)
    slopes = []
    for i, p in enumerate(parameters.parameters):
        mine = [
            x
            for x in p.targets
            if x.card == "PBUSH" and x.id in ids and x.field.startswith("K")
        ]
        if mine:  # linear in the factor: one more build gives the slope
            twice = _spring_rows(changed(model, p.name, mine, 2.0), at, system.dofs)
            slopes.append((i, np.asarray((twice - rows) @ t @ v)))
    each = Rows(np.asarray(rows @ t @ v), tuple(slopes))
    total = np.tile(np.eye(3), at.size)
    summed = Rows(total @ each.nominal, tuple((i, total @ s) for i, s in slopes))
    axes = [
        Output(
            f"{name}, sum along {a}",
            "N",
            Rows(summed.nominal[[k]], tuple((i, s[[k]]) for i, s in summed.slopes)),
        )
        for k, a in enumerate("XYZ")
    ]
    return [Output(f"{name}, largest in one of {at.size}", "N", each, 3), *axes]


def check(model: Model, asked: PredictSection) -> None:
    """Whether the rotor and the springs of a study are in its deck.

    Raises
    ------
    ConfigError
        If one is not.
    """
    plane(asked.axis)
    if model["GRID"].find(np.array([asked.rotor]))[0] < 0:
        raise ConfigError(
            f"rotor node {asked.rotor}: there is no such node in the deck"
        )
    for name, ids in asked.springs.items():
        _bushes(model, name, ids)


def _bushes(model: Model, name: str, ids: Sequence[int]) -> Int:
    if "CBUSH" not in model:
        raise ConfigError(f"springs {name!r}: the deck has no CBUSH")
    there = np.unique(model["CBUSH"]["PID"])
    lost = [i for i in ids if i not in there]
    if lost or not ids:
        hint = did_you_mean(str(lost[0]) if lost else "", map(str, there.tolist()))
        raise ConfigError(f"springs {name!r}: no CBUSH with PBUSH {lost[:1]}{hint}")
    return np.flatnonzero(np.isin(model["CBUSH"]["PID"], list(ids)))


def _spring_rows(model: Model, at: Int, dofs: DofSet) -> sparse.csr_array:
    """Rows (3 · spring, full) that give the force through each spring, basic frame, from the motion
    of the nodes.

    The force that passes from GA to GB or to the ground; dashpots of the springs are not part of
    it.
    """
    part = bush(mesh(model).rows("CBUSH", at))
    k = np.asarray(part.stiffness, dtype=np.float64)[:, :3]
    cols = np.broadcast_to(part.dofs[:, None, :], k.shape)
    rows = np.broadcast_to(np.arange(3 * at.size).reshape(-1, 3)[..., None], k.shape)
    keep = cols >= 0
    return sparse.csr_array(
        (k[keep], (rows[keep], cols[keep])), shape=(3 * at.size, len(dofs))
    )
