"""The static flexibility at loaded channels in a reduced basis: residual vectors, for FRFs, their
zeros and statics.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.modes import elastic
from ringtrue.eigen.eigenpairs import frequencies
from ringtrue.eigen.pencil import Factor, Pencil
from ringtrue.errors import SingularModel
from ringtrue.reduction.basis import CHUNK, orthonormal_part, project
from ringtrue.reduction.parametric import ReducedModel

DEPENDENT, MASSLESS = (
    1e-10,
    1e-11,
)  # shares of the energy below which a vector is one of others, or has no mode


def with_responses(
    model: ReducedModel, channels: Int, x: Float, *, sensitivities: bool = False
) -> tuple[ReducedModel, float]:
    """The model with the static responses of the full one to unit loads at channels added to its
    basis.

    A structure that is free has none; the responses are then those of K − σM, which serve FRFs as
    well.

    Parameters
    ----------
    channels : (l,) int64
        Positions among the channels of the model.
    x : (p,) float64
        Of the active parameters: where the full model is solved.
    sensitivities : bool
        Add the derivatives of the responses along the active parameters, too.

    Returns
    -------
    model : ReducedModel
        Its static deflections at x are those of the full model.
    error : float
        Largest error of the old one's flexibility between these channels, relative to the largest
        flexibility.

    Sources: residual vectors, Craig and Kurdila (2006), Fundamentals of Structural Dynamics, sec.
    17.
    """
    a = model.system.parameters.factors(model.full_vector(x))
    pencil = Pencil(*model.system.at(a), method=model.pencil.method, labels=model.pencil.labels)
    shift, factor = _definite(pencil, model.shift)
    load = model.system.observe[channels].T.toarray()
    u = _solved(factor, load)
    fresh = [u]
    if sensitivities:
        for i in model.active:
            fresh += [_solved(factor, k @ u - shift * (m @ u)) for k, m in model.system.alone(i)]
    pencil.close()
    true, found = load.T @ u, _flexibility(model, a, channels, shift)
    error = float(
        np.abs(found - true).max(initial=0.0) / max(float(np.abs(true).max(initial=0.0)), 1e-300)
    )
    new = np.hstack(fresh)
    new = new[:, np.abs(new).max(axis=0) > 0]
    energy = sparse.csr_array(model.system.stiffness - model.shift * model.system.mass)
    vectors = np.hstack([model.basis.vectors, orthonormal_part(energy, model.basis.vectors, new)])
    return model.with_basis(project(model.system, vectors, model.basis)), error


def responding(model: ReducedModel, channels: Int, x: Float) -> tuple[Float, Float]:
    """λ (r,) and vectors (f, r) of unit modal mass: the modes at x (p,) and, as modes of the space
    that they span together, the static responses to unit loads at channels that are in the basis.
    Held channels have none.

    Of a structure that is free the responses are those of K − σM.
    """
    k, m = model.projected(model.system.parameters.factors(model.full_vector(x)))
    lam, y = model.coordinates(x)
    energy = k if lam[0] > 0 and elastic(frequencies(lam))[0] else k - model.shift * m
    loads = model.basis.observe[channels]
    some = np.hstack([y, linalg.solve(energy, loads[loads.any(axis=1)].T, assume_a="sym")])
    some = some / np.sqrt(np.einsum("ij,ij->j", some, energy @ some))
    size, turn = linalg.eigh(some.T @ energy @ some)
    some = some @ (turn / np.sqrt(size))[:, size > DEPENDENT]
    inverse, turn = linalg.eigh(some.T @ m @ some)
    some = some @ turn[:, inverse > MASSLESS * inverse.max()]
    values, turn = linalg.eigh(some.T @ k @ some, some.T @ m @ some)
    return values, model.basis.vectors @ (some @ turn)


def _definite(pencil: Pencil, shift: float) -> tuple[float, Factor]:
    """K itself, or K − σM where something is free to move."""
    try:
        factor = pencil.at(0.0)
        if factor.negatives <= 0:
            return 0.0, factor
    except SingularModel:
        pass
    return shift, pencil.at(shift)


def _solved(factor: Factor, load: Float) -> Float:
    n = load.shape[1]
    return np.concatenate(
        [factor.solve(load[:, i : i + CHUNK]) for i in range(0, n, CHUNK)], axis=1
    )


def _flexibility(model: ReducedModel, a: Float, channels: Int, shift: float) -> Float:
    """Of the reduced model between the channels, (l, l)."""
    k, m = model.projected(a)
    load = model.basis.observe[channels]
    return np.asarray(load @ linalg.solve(k - shift * m, load.T, assume_a="sym"))
