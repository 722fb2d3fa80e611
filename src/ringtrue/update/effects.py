"""Candidates held against the modes: what no mode strains or moves cannot be found from modes, and is left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.observation import Observation
from ringtrue.core.progress import Progress, part
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.problem import EigenModes
from ringtrue.fem.assembly import System
from ringtrue.fem.dependence import affine_terms
from ringtrue.fem.derivatives import bilinear
from ringtrue.model.model import Model
from ringtrue.reduce.affine import observed_system
from ringtrue.reduce.expand import expand_reduced
from ringtrue.reduce.parametric import BasisOptions, ReducedModel, reduced_model
from ringtrue.update.candidates import Candidate, parameters
from ringtrue.update.objective import Target

NEAR = 16  # modes of the model along which the force residual of a test mode is taken
EXPANDED = 0.02  # relative error of a measured shape that its expansion may leave as misfit
SHARP = 0.3  # what candidates shall explain is small beside the discrepancy that an updating assumes
AT_ONCE = 40_000_000  # numbers of the vectors that are worked on at a time
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
    strain, kinetic = effects(model, system, candidates, values, vectors)
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


def force_residual(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
    seen: Float,
    aim: Target,
) -> tuple[Float, Float]:
    """What the test's modes leave of the model's equation of motion, and what each candidate adds to it.

    φ_kᵀ(K − ω²M)u of each used test mode, u being its shape expanded in the modes of the model, along the modes φ_k
    nearest to it, and φ_kᵀ(∂K − ω²∂M)u: linear in the parameters, without a pairing and without a solution. Weighted by
    `SHARP` times the errors that shape and frequency are assumed to keep (`Weights`). Fissette, Stavrinidis
    and Ibrahim (1988).

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    seen : (channel, m) float64
        The same at the channels.

    Returns
    -------
    misfit : (n,) float64
    slopes : (n, p) float64
        −∂misfit/∂x in units of the prior.
    """
    f, chosen = aim.frequencies[aim.used], parameters(candidates)
    omega2 = (2 * np.pi * f) ** 2
    energy = np.diag(np.abs(values) + omega2.min())
    own = np.diag(values), np.eye(values.size)
    u = expand_reduced(*own, energy, seen, aim.shapes[:, aim.used], f, noise=EXPANDED).shapes
    u = u / np.maximum(np.linalg.norm(u, axis=0), 1e-300)
    gap = values[:, None] - omega2
    near = np.argsort(np.abs(gap), axis=0, kind="stable")[:NEAR]
    gap, along = np.take_along_axis(gap, near, 0), np.take_along_axis(u, near, 0)
    of_frequency = 2 * np.hypot(SHARP * aim.weights.frequency, aim.std[aim.used]) * omega2
    sigma = np.hypot(SHARP * np.sqrt(aim.weights.mac) * gap, of_frequency)
    slopes = np.empty((*gap.shape, len(chosen)))
    step = max(1, AT_ONCE // (NEAR * vectors.shape[0]))
    for first in range(0, f.size, step):
        at = slice(first, first + step)
        left = np.stack([vectors[:, modes] for modes in near[:, at]])
        dk, dm = bilinear(model, chosen.parameters, system, left, vectors @ u[:, at])
        slopes[:, at] = (omega2[at, None] * dm - dk) / sigma[:, at, None]
    return (gap * along / sigma).ravel(), slopes.reshape(gap.size, len(chosen)) * chosen.std()


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
