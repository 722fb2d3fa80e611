"""What the data can tell of each parameter, and which they cannot tell apart.

Sensitivities are weighted and in units of the prior standard deviation (`choose.weighted_sensitivities`), so that
GᵀG is the information of the data and the unit matrix that of the prior. Collinearity by hierarchical clustering of
the columns; Cramér-Rao bounds; the directions of the parameter space that the data do not see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import InputError

ALIKE = 0.95  # |cosine| of two weighted sensitivity columns from which on the data cannot tell them apart
BLIND = 1.0  # singular value, in units of the prior, below which the prior says more of a direction than the data


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability:
    """Standard deviations of x in units of the prior's.

    Attributes
    ----------
    alone : (p,) float64
        Posterior, all others known: the best that the data can do.
    together : (p,) float64
        Posterior, all candidates free.
    bound : (p,) float64
        Cramér-Rao without a prior, all candidates free; infinite where the data leave a direction open.
    inflation : (p,) float64
        bound² over that with all others known: what the others cost (variance inflation factor).
    """

    alone: Float
    together: Float
    bound: Float
    inflation: Float

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, alone=f, together=f, bound=f, inflation=f)


def identifiability(sensitivities: Float) -> Identifiability:
    """Cramér-Rao bounds with and without the prior.

    Parameters
    ----------
    sensitivities : (r, p) float64
    """
    g = _columns(sensitivities)
    information = np.sum(g**2, axis=0)
    s, vt = _right(g)
    together = np.sqrt(np.sum(vt**2 / (1 + s[:, None] ** 2), axis=0))
    seen = s > max(g.shape) * np.finfo(float).eps * s.max(initial=0.0)
    open_ = np.sum(vt[~seen] ** 2, axis=0) > 1e-12
    bound = np.sqrt(np.sum((vt[seen] / s[seen][:, None]) ** 2, axis=0))
    bound = np.where(open_, np.inf, bound)
    return Identifiability(1 / np.sqrt(1 + information), together, bound, bound**2 * information)


def _right(g: Float) -> tuple[Float, Float]:
    """Singular values (p,) of g (r, p) and its right vectors (p, p); the left ones would be (r, r)."""
    _, s, vt = linalg.svd(g, full_matrices=g.shape[0] < g.shape[1])
    return np.concatenate([s, np.zeros(vt.shape[0] - s.size)]), np.asarray(vt)


def cosines(sensitivities: Float) -> Float:
    """|cosine| of all pairs of columns, (p, p); 0 with a column of zeros."""
    g = _columns(sensitivities)
    size = np.linalg.norm(g, axis=0)
    unit = g / np.where(size > 0, size, 1.0)
    return np.minimum(np.abs(unit.T @ unit), 1.0)


def blind_cosines(sensitivities: Float, level: float = BLIND) -> tuple[Float, Float]:
    """How parameters trade against each other where the data do not see.

    The directions v with ‖G v‖ < `level` ‖v‖ span what is left open. A parameter alike to a *combination* of others has
    a large share there though no single cosine shows it.

    Returns
    -------
    share : (p,) float64
        Of each parameter's own direction, in the open space: 1 means the data say nothing of it.
    cosine : (p, p) float64
        |cosine| between the projections of two parameters on the open space; near 1 they only trade with each other.
    """
    g = _columns(sensitivities)
    s, vt = _right(g)
    open_ = vt[s < level]
    share = np.sqrt(np.sum(open_**2, axis=0))
    unit = open_ / np.where(share > 1e-9, share, np.inf)
    return np.minimum(share, 1.0), np.minimum(np.abs(unit.T @ unit), 1.0)


def clusters(sensitivities: Float, alike: float = ALIKE) -> Int:
    """The cluster of each parameter, (p,) int64, numbered from 0 in the order of their first members.

    By complete linkage: no two with a |cosine| below `alike` are in one cluster. A column of zeros stands alone.

    Raises
    ------
    InputError
        Unless 0 < alike <= 1.
    """
    if not 0 < alike <= 1:
        raise InputError(f"clusters: alike {alike} must be above 0 and at most 1")
    cosine = cosines(sensitivities)
    if len(cosine) < 2:
        return np.zeros(len(cosine), dtype=np.int64)
    distance = squareform(np.maximum(1 - (cosine + cosine.T) / 2, 0.0), checks=False)
    raw = fcluster(linkage(distance, "complete"), 1 - alike + 1e-12, criterion="distance")
    _, first, number = np.unique(raw, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number].astype(np.int64)


def _columns(sensitivities: Float) -> Float:
    g = np.asarray(sensitivities, dtype=np.float64)
    if g.ndim != 2 or not np.isfinite(g).all():
        raise InputError(f"sensitivities {g.shape}: must be a finite (residual, parameter) array")
    return g
