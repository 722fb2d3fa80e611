"""Candidates held against the modes: what no mode strains or moves cannot be found from modes, and is left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.observation import Observation
from ringtrue.core.progress import Progress, part
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.problem import EigenModes, frequencies
from ringtrue.fem.assembly import System
from ringtrue.fem.dependence import affine_terms
from ringtrue.fem.derivatives import bilinear
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation
from ringtrue.reduce.affine import observed_system
from ringtrue.reduce.parametric import BasisOptions, ReducedModel, reduced_model
from ringtrue.update.candidates import Candidate, parameters

NEAR = 16  # modes whose sum is the change of a mode: those nearest to it
REPEATED = 1e-9  # relative distance of eigenvalues whose shapes mix freely
AT_ONCE = 10_000_000  # numbers of the vectors that are worked on at a time
LEAST = 1e-5  # share of a mode's strain and kinetic energy below which a candidate does not change it


@dataclass(frozen=True, slots=True)
class Dropped:
    """A candidate that is left out, and why."""

    name: str
    reason: str


def effective(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
    least: float = LEAST,
) -> tuple[tuple[Candidate, ...], tuple[Dropped, ...]]:
    """Those candidates that change one of the modes, and those that do not.

    Of a candidate that no mode strains or moves, ∂K φ = ∂M φ = 0: neither frequency nor shape depends on it.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    """
    return moving(candidates, *effects(model, system, candidates, values, vectors), least)


def moving(
    candidates: Sequence[Candidate], strain: Float, kinetic: Float, least: float = LEAST
) -> tuple[tuple[Candidate, ...], tuple[Dropped, ...]]:
    """The same where the effects (m, p) are known."""
    most = (np.abs(strain) + np.abs(kinetic)).max(axis=0, initial=0.0)
    keep = tuple(c for c, size in zip(candidates, most.tolist(), strict=True) if size > least)
    lost = tuple(
        Dropped(c.name, f"no mode has more than {size:.1e} of its energy in {c.what}")
        for c, size in zip(candidates, most.tolist(), strict=True)
        if size <= least
    )
    return keep, lost


def effects(
    model: Model, system: System, candidates: Sequence[Candidate], values: Float, vectors: Float
) -> tuple[Float, Float]:
    """φᵀ(∂K/∂x)φ/λ and φᵀ(∂M/∂x)φ of each mode and candidate, (m, p) each; ∂ ln f/∂x is half their difference.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    """
    lam = np.maximum(np.abs(values), 1e-6 * np.abs(values).max(initial=1e-300))
    dk, dm = bilinear(model, [c.parameter for c in candidates], system, vectors[None], vectors)
    return dk[0] / lam[:, None], dm[0]


def superposed(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
    seen: Float,
    count: int,
) -> Linearisation:
    """The lowest modes and their slopes to all candidates without a solution: a shape changes by the modes near to it.

    Fox and Kapoor (1968), the sum cut off at `NEAR` modes: good for a choice among hundreds, not for an updating.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    seen : (channel, m) float64
        The same at the channels.
    count : int
        Modes returned, the lowest.
    """
    m, p, chosen = min(count, values.size), len(candidates), [c.parameter for c in candidates]
    gap = values[:m] - values[:, None]
    repeated = np.abs(gap) <= REPEATED * np.abs(values).max(initial=0.0)
    distance = np.abs(gap)
    distance[np.arange(m), np.arange(m)] = -1.0  # of all modes its own is the first
    near = np.argsort(distance, axis=0, kind="stable")[: NEAR + 1]
    d_lambda, d_shapes = np.empty((m, p)), np.empty((len(seen), m, p))
    step = max(1, AT_ONCE // (near.shape[0] * vectors.shape[0]))
    for first in range(0, m, step):
        mine = np.arange(first, min(first + step, m))
        some = near[:, mine]
        left = np.ascontiguousarray(vectors[:, some].transpose(1, 0, 2))
        dk, dm = bilinear(model, chosen, system, left, vectors[:, mine])
        force, free = dk - values[mine, None] * dm, repeated[some, mine]
        mix = np.where(free[:, :, None], 0.0, force / np.where(free, np.inf, gap[some, mine])[:, :, None])
        mix[0] = -0.5 * dm[0]
        d_lambda[mine] = force[0]
        d_shapes[:, mine] = np.einsum("csk,skp->ckp", seen[:, some], mix)
    return Linearisation(np.zeros(p), frequencies(values[:m]), seen[:, :m], d_lambda, d_shapes)


def reduced_candidates(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    observation: Observation,
    count: int,
    *,
    options: BasisOptions | None = None,
    pencil: Pencil | None = None,
    modes: EigenModes | None = None,
    progress: Progress | None = None,
) -> ReducedModel:
    """A reduced model over all candidates, as the choice needs it; `pencil` and `modes` as in `reduced_model`.

    Raises
    ------
    UnsupportedError
        If the `fem.dependence.form` of one of them is rough.
    """
    chosen = parameters(candidates)
    parts = affine_terms(model, chosen, system, progress=part(progress, 0.0, 0.5))
    affine = observed_system(system.stiffness, system.mass, system.transform, chosen, parts, observation)
    return reduced_model(affine, count, options=options, pencil=pencil, modes=modes, progress=part(progress, 0.5, 1.0))
