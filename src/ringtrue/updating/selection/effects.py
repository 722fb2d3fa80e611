"""Candidates held against the modes: what no mode strains or moves cannot be found from modes, and
is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress, part
from ringtrue.core.testmodel import Observation
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.pencil import Pencil
from ringtrue.fem.assembly import System
from ringtrue.fem.parametrisation.affine import affine_terms
from ringtrue.fem.parametrisation.derivatives import bilinear, congruent
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.expansion import expand_reduced
from ringtrue.reduction.parametric import BasisOptions, ReducedModel, reduced_model
from ringtrue.updating.gauss_newton import residual
from ringtrue.updating.selection.candidates import Candidate, parameters
from ringtrue.updating.target import Target
from ringtrue.updating.uncertainty import errors_of_shapes

NEAR = 16  # modes of the model along which the force residual of a test mode is taken
EXPANDED = 0.02  # relative error of a measured shape that its expansion may leave as misfit
SHARP = (
    0.3  # what candidates shall explain is small beside the discrepancy that an updating assumes
)
CLOSE = 1e-6  # relative distance of eigenvalues below which modes only rotate into each other
LEAST = (
    1e-5  # share of a mode's strain and kinetic energy below which a candidate does not change it
)


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

    Of a candidate that no mode strains or moves, ∂K φ = ∂M φ = 0: neither frequency nor shape
    depends on it.

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
    """φᵀ(∂K/∂x)φ/λ and φᵀ(∂M/∂x)φ of each mode and candidate, (m, p) each; ∂ ln f/∂x is half their
    difference.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    """
    lam = np.maximum(np.abs(values), 1e-6 * np.abs(values).max(initial=1e-300))
    dk, dm = bilinear(model, [c.parameter for c in candidates], system, vectors[None], vectors)
    return dk[0] / lam[:, None], dm[0]


def misfits(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
    seen: Float,
    aim: Target,
) -> tuple[tuple[Float, Float], ...]:
    """`paired_residual` and `force_residual`: what the test finds wrong near the model, and far
    from it.
    """
    chosen = parameters(candidates)
    kinds = _paired(chosen, values, seen, aim), _force(chosen, values, seen, aim)
    return _evaluated(model, system, chosen, vectors, kinds)


@dataclass(frozen=True, slots=True, eq=False)
class _Kind:
    """A kind of residual before the candidates are asked.

    Attributes
    ----------
    near : (k, n) int64
        Modes φ_k of the model that each vector v is taken along.
    u : (m, n) float64
        The vectors v in the modes.
    made : callable (φ_kᵀ∂Kv, φ_kᵀ∂Mv), (k, n, p) each -> misfit (r,) and slopes (r, p)
    """

    near: Int
    u: Float
    made: Callable[[Float, Float], tuple[Float, Float]]


def _evaluated(
    model: Model, system: System, chosen: ParameterSet, vectors: Float, kinds: Sequence[_Kind]
) -> tuple[tuple[Float, Float], ...]:
    """The residuals of all kinds, from one pass over the elements."""
    found = [np.zeros((2, *kind.near.shape, len(chosen))) for kind in kinds]
    for i, *both in congruent(model, chosen.parameters, system, vectors):
        for kind, out in zip(kinds, found, strict=True):
            for total, change in zip(out, both, strict=True):
                if change.size:
                    total[:, :, i] += np.take_along_axis(change @ kind.u, kind.near, 0)
    return tuple(kind.made(*out) for kind, out in zip(kinds, found, strict=True))


def force_residual(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
    seen: Float,
    aim: Target,
) -> tuple[Float, Float]:
    """What the test's modes leave of the model's equation of motion, and what each candidate adds
    to it.

    φ_kᵀ(K − ω²M)u of each used test mode, u being its shape expanded in the modes of the model,
    along the modes φ_k nearest to it, and φ_kᵀ(∂K − ω²∂M)u: linear in the parameters, without a
    pairing and without a solution. Weighted by `SHARP` times the errors that shape and frequency
    are assumed to keep (`Weights`). Fissette, Stavrinidis and Ibrahim (1988).

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
    chosen = parameters(candidates)
    return _evaluated(model, system, chosen, vectors, [_force(chosen, values, seen, aim)])[0]


def _force(chosen: ParameterSet, values: Float, seen: Float, aim: Target) -> _Kind:
    f = aim.frequencies[aim.used]
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

    def made(dk: Float, dm: Float) -> tuple[Float, Float]:
        slopes = (omega2[:, None] * dm - dk) / sigma[:, :, None]
        return (gap * along / sigma).ravel(), slopes.reshape(gap.size, len(chosen)) * chosen.std()

    return _Kind(near, u, made)


def paired_residual(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
    seen: Float,
    aim: Target,
) -> tuple[Float, Float]:
    """Deviations of the modes that are paired, and what each candidate does to them: `residual` of
    the deck.

    Nothing is expanded, and noise of the shapes is told from errors that candidates could make, but
    modes far off have no part in it. Derivatives of shapes along the modes nearest to each (Fox and
    Kapoor 1968). Arguments and results as of `force_residual`.
    """
    chosen = parameters(candidates)
    return _evaluated(model, system, chosen, vectors, [_paired(chosen, values, seen, aim)])[0]


def _paired(chosen: ParameterSet, values: Float, seen: Float, aim: Target) -> _Kind:
    far = np.abs(values - values[:, None])
    np.fill_diagonal(far, -1.0)  # the first is the mode itself
    near = np.argsort(far, axis=0, kind="stable")[:NEAR]
    gap = values - values[near]
    apart = np.abs(gap) > CLOSE * np.abs(values)
    w = aim.weights

    def made(dk: Float, dm: Float) -> tuple[Float, Float]:
        slope = dk - values[:, None] * dm
        share = np.where(apart[:, :, None], slope / np.where(apart, gap, 1.0)[:, :, None], 0.0)
        share[0] = -dm[0] / 2
        now = Linearisation(
            np.zeros(len(chosen)),
            np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi),
            seen,
            slope[0],
            np.moveaxis(seen[:, near].transpose(2, 0, 1) @ share.transpose(1, 0, 2), 0, 1),
        )
        many = errors_of_shapes(aim, now)
        weights = replace(w, frequency=SHARP * w.frequency, mac=SHARP**2 * w.mac, independent=many)
        r = residual(replace(aim, weights=weights), now)
        return r.value, r.slope * chosen.std()

    return _Kind(near, np.eye(values.size), made)


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
    """A reduced model over all candidates, as the choice needs it; `pencil` and `modes` as in
    `reduced_model`.

    Raises
    ------
    UnsupportedError
        If K and M are no smooth functions of one of them (`affine.matrices_kept`).
    """
    chosen = parameters(candidates)
    parts = affine_terms(model, chosen, system, progress=part(progress, 0.0, 0.5))
    affine = observed_system(
        system.stiffness, system.mass, system.transform, chosen, parts, observation
    )
    return reduced_model(
        affine,
        count,
        options=options,
        pencil=pencil,
        modes=modes,
        progress=part(progress, 0.5, 1.0),
    )
