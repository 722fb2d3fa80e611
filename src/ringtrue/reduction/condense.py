"""A reduced model reduced once more: to its modes at some points, for searches and sampling that
need thousands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float
from ringtrue.errors import InputError
from ringtrue.reduction.basis import Projection
from ringtrue.reduction.parametric import ReducedModel


def condensed(model: ReducedModel, points: Sequence[Float], size: int) -> ReducedModel:
    """The model on the principal directions of its modes at points x, in the energy K − σM.

    Proper orthogonal decomposition: of all bases of that size the one that leaves the least energy
    of these modes out. Good between the points; away from them it is too stiff.

    Parameters
    ----------
    points : sequence of (p,) float64
        Of the active parameters.
    size : int
        Vectors kept; not fewer than the modes of the model.

    Raises
    ------
    InputError
        If there is no point, or fewer vectors than modes.
    """
    if not len(points) or size < model.count:
        raise InputError(f"{len(points)} points (>= 1), {size} vectors for {model.count} modes")
    b = model.basis
    if size >= b.size:
        return model
    root = linalg.cholesky(b.stiffness - model.shift * b.mass)
    parts = []
    for x in points:
        lam, y = model.coordinates(x)
        parts.append(root @ (y / np.sqrt(lam - model.shift)))
    u, _, _ = linalg.svd(np.hstack(parts), full_matrices=False)
    v = linalg.solve_triangular(root, u[:, :size])
    terms = tuple((f, v.T @ k @ v, v.T @ m @ v) for f, k, m in b.terms)
    basis = Projection(b.vectors @ v, v.T @ b.stiffness @ v, v.T @ b.mass @ v, terms, b.observe @ v)
    return replace(model, basis=basis)
