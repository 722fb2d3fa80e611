"""What a finished study says of running the rotor: run-up with unbalance on the updated model, with bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.fem.assembly import System
from ringtrue.fem.change import changed
from ringtrue.fem.elements.bush import build as bush
from ringtrue.fem.mesh import mesh
from ringtrue.model.model import Model
from ringtrue.reduce.parametric import ReducedModel
from ringtrue.study.opened import Opened, Progress
from ringtrue.study.parametric import AtChannels, build
from ringtrue.study.results import CorrelateStage, FinalStage, UpdateStage
from ringtrue.study.stages.sensitivity import target
from ringtrue.study.stages.tune import suspended
from ringtrue.study.stages.tune import target as rigid_target
from ringtrue.study.stages.update import chosen_factors
from ringtrue.study.workbench import Workbench
from ringtrue.update.kfold import discrepancy
from ringtrue.update.plausible import plausibility
from ringtrue.update.posterior import Posterior, laplace
from ringtrue.update.predict import Damping, Output, Rows, RunUp, Unbalance, plane, run_up, validated_band
from ringtrue.update.several import Configuration, Problem

UNIT = {"SI": "m", "mm-t-s": "mm"}
ABOVE = 1.3  # modes up to here over the highest speed
SPREAD = 0.3  # of ln ζ: what is known of damping beyond the tested modes


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """A run-up and what it rests on.

    Attributes
    ----------
    run_up : RunUp
    posterior : Posterior
        Of the elastic and suspension parameters.
    discrepancy : float
        Relative, of a frequency, from the modes left out of the updating (all pairs where none was).
    flags : tuple of str
        Parameters that are not plausible.
    """

    run_up: RunUp
    posterior: Posterior
    discrepancy: float
    flags: tuple[str, ...]


def predict(
    desk: Workbench,
    rotor: int,
    axis: str,
    unbalance: Unbalance,
    springs: Mapping[str, Sequence[int]],
    rng: np.random.Generator,
    *,
    freqs: Float,
    draws: int = 100,
    level: float = 0.9,
    progress: Progress,
) -> Prediction:
    """The run-up of a rotor of a study whose final stage is done.

    Parameters
    ----------
    desk : Workbench
    rotor : int
        Node that the unbalance acts on.
    axis : {"X", "Y", "Z"}
        Of the rotor, basic frame.
    unbalance : Unbalance
    springs : mapping of name to PBUSH numbers
        Groups whose forces are wanted: bearings, supports, springs to the building.
    rng : Generator
    freqs : (l,) float64, Hz
        Speeds, above 0.
    draws : int
        Of the posterior.

    Raises
    ------
    ConfigError
        If the study was not run to its end, or node or springs are not in the deck.
    """
    if "final" not in desk.store.stages():
        raise ConfigError("the study has no updated model yet: `ringtrue run` it to its final stage first")
    posterior, error = _posterior(desk, lambda f, t: progress(0.3 * f, t))
    model = _model(desk, posterior.parameters, float(ABOVE * freqs[-1]), lambda f, t: progress(0.3 + 0.4 * f, t))
    opened = desk.remodelled
    across = plane(axis)
    motion = _translations(opened.analysis.system, rotor)
    model = model.augmented(opened.analysis.pencil.at(model.shift).solve(motion[list(across)].toarray().T))
    v = model.basis.vectors
    outputs = [Output(f"rotor, node {rotor}", UNIT[desk.deck.units], Rows(np.asarray(motion @ v)), 3)]
    for name, ids in springs.items():
        outputs += _forces(opened, posterior.parameters, name, ids, v)
    final: FinalStage = desk.get("final")
    result = run_up(
        model,
        posterior.sample(draws, rng),
        posterior.x,
        freqs,
        np.asarray(motion[list(across)] @ v).T,
        unbalance,
        outputs,
        _damping(final),
        rng,
        discrepancy=error,
        level=level,
        validated=_validated(desk, final),
        progress=lambda f, t: progress(0.7 + 0.3 * f, t),
    )
    flags = plausibility(posterior.parameters, posterior.x, posterior.ratio)
    return Prediction(result, posterior, error, tuple(f.text for f in flags))


def _damping(final: FinalStage) -> Damping:
    f, at = np.unique(final.observed.frequencies, return_index=True)
    keep = f > 0
    return Damping(f[keep], np.maximum(final.damping[at][keep], 0.0), SPREAD)


def _validated(desk: Workbench, final: FinalStage) -> tuple[float, float]:
    """The band of the test modes that the delivered model holds, wider by the deviation that is accepted."""
    found: CorrelateStage = desk.get("correlate")
    sure = found.reference.confidence >= desk.config.identify.confidence
    held = np.zeros(len(found.reference), dtype=bool)
    held[final.table.pairing.a[np.abs(final.table.deviation_percent) <= desk.config.correlate.accept_percent]] = True
    low, high = validated_band(found.reference.frequencies[sure], held[sure])
    if len(found.rigid) and high > 0:
        low = min(low, float(found.rigid.frequencies.min()))
    margin = desk.config.correlate.accept_percent / 100
    return low * (1 - margin), high * (1 + margin)


def _posterior(desk: Workbench, progress: Progress) -> tuple[Posterior, float]:
    """Of the chosen parameters and the suspension, and the discrepancy of the left-out frequencies."""
    done: UpdateStage = desk.get("update")
    final: FinalStage = desk.get("final")
    best = done.sets[done.chosen]
    model, aim = desk.candidates(progress), target(desk)
    every = model.parameters.names
    at = [every.index(n) for n in best.parameters]
    out = final.table.deviation_percent[~final.table.used] / 100
    shown = out if out.size else final.table.deviation_percent / 100
    error = discrepancy(shown, np.zeros(shown.size)) if shown.size else aim.weights.frequency
    active = model.with_parameters(at, np.zeros(len(every)))
    weights = replace(aim.weights, frequency=max(error, aim.weights.frequency))
    parts = [_laplace(active, Configuration(active, replace(aim, weights=weights)), best.factor)]
    if desk.config.suspension:
        springs = suspended(desk, progress)
        tuned = desk.get("tune").factors
        factors = np.array([tuned[n] for n in springs.parameters.names])
        parts.append(_laplace(springs, Configuration(springs, rigid_target(desk)), factors))
    return _together(parts), error


def _laplace(active: AtChannels, configuration: Configuration, factors: Float) -> Posterior:
    problem = Problem((configuration,))
    at = problem.evaluate(active.parameters.vector(factors))
    return laplace(problem, at, np.ones(int(at.kind.max(initial=-1)) + 1), independent=1.0)


def _together(parts: Sequence[Posterior]) -> Posterior:
    """Independent posteriors side by side."""
    names = ParameterSet(tuple(p for part in parts for p in part.parameters.parameters))
    y = np.concatenate([p.y for p in parts])
    covariance = np.zeros((y.size, y.size))
    first = 0
    for p in parts:
        covariance[first : first + p.y.size, first : first + p.y.size] = p.covariance
        first += p.y.size
    return Posterior(names, y, covariance, np.eye(y.size), np.concatenate([p.prior_std for p in parts]))


def _model(desk: Workbench, parameters: ParameterSet, fmax: float, progress: Progress) -> ReducedModel:
    """The remodelled deck reduced to its modes up to `fmax`, enriched at the updated point; all modes of the basis."""
    found = desk.get("identify")
    model = build(desk.remodelled, parameters, found.test, desk.config.correlate.tolerance, fmax, progress)
    known = dict(zip(desk.config.candidates().names, chosen_factors(desk).tolist(), strict=True))
    known |= desk.get("tune").factors if desk.config.suspension else {}
    better, _ = model.enrich(parameters.vector(np.array([known[n] for n in parameters.names])))
    return better


def _translations(system: System, node: int) -> sparse.csr_array:
    """Rows (3, f) that pick the translations of a node from the free DOFs."""
    at = system.dofs.find(np.full(3, node), np.arange(1, 4))
    if (at < 0).any():
        raise ConfigError(f"rotor node {node}: there is no such node in the deck")
    return sparse.csr_array(system.transform[at])


def _forces(opened: Opened, parameters: ParameterSet, name: str, ids: Sequence[int], v: Float) -> list[Output]:
    """The largest force in one spring of a group, and the sum over the group along each axis."""
    model, system = opened.model, opened.analysis.system
    at = _bushes(model, name, ids)
    t = system.transform
    rows = _spring_rows(model, at, system.dofs)
    slopes = []
    for i, p in enumerate(parameters.parameters):
        mine = [x for x in p.targets if x.card == "PBUSH" and x.id in ids and x.field.startswith("K")]
        if mine:  # linear in the factor: one more build gives the slope
            twice = _spring_rows(changed(model, p.name, mine, 2.0), at, system.dofs)
            slopes.append((i, np.asarray((twice - rows) @ t @ v)))
    each = Rows(np.asarray(rows @ t @ v), tuple(slopes))
    total = np.tile(np.eye(3), at.size)
    summed = Rows(total @ each.nominal, tuple((i, total @ s) for i, s in slopes))
    axes = [
        Output(f"{name}, sum along {a}", "N", Rows(summed.nominal[[k]], tuple((i, s[[k]]) for i, s in summed.slopes)))
        for k, a in enumerate("XYZ")
    ]
    return [Output(f"{name}, largest in one of {at.size}", "N", each, 3), *axes]


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
    """Rows (3 · spring, full) that give the force through each spring, basic frame, from the motion of the nodes.

    The force that passes from GA to GB or to the ground; dashpots of the springs are not part of it.
    """
    part = bush(mesh(model), "CBUSH", at)
    k = np.asarray(part.stiffness, dtype=np.float64)[:, :3]
    cols = np.broadcast_to(part.dofs[:, None, :], k.shape)
    rows = np.broadcast_to(np.arange(3 * at.size).reshape(-1, 3)[..., None], k.shape)
    keep = cols >= 0
    return sparse.csr_array((k[keep], (rows[keep], cols[keep])), shape=(3 * at.size, len(dofs)))
