"""What the data can tell of each parameter, and which they cannot tell apart.

Sensitivities are weighted and in units of the prior standard deviation
(`choose.weighted_sensitivities`), so that GᵀG is the information of the data and the unit matrix
that of the prior. Collinearity by hierarchical clustering of the columns; Cramér-Rao bounds; the
directions of the parameter space that the data do not see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import InputError

# |cosine| of two weighted sensitivity columns from which on the data cannot tell them apart
ALIKE = 0.95
EQUAL = 9  # decimals, of the largest, to which effects are compared: rounding must not choose
# in standard deviations of the data: what a change by the prior's standard deviation does beyond
# the other parameters, from which on the data share a change out between them, however weakly;
# below it the prior alone does
SAME = 0.01
# singular value, in units of the prior, below which the prior says more of a direction than the
# data
BLIND = 1.0


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
        Cramér-Rao without a prior, all candidates free; infinite where the data leave a direction
        open.
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
    """Singular values (p,) of g (r, p) and its right vectors (p, p); the left ones would be (r,
    r).
    """
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

    The directions v with ‖G v‖ < `level` ‖v‖ span what is left open. A parameter alike to a
    *combination* of others has a large share there though no single cosine shows it.

    Returns
    -------
    share : (p,) float64
        Of each parameter's own direction, in the open space: 1 means the data say nothing of it.
    cosine : (p, p) float64
        |cosine| between the projections of two parameters on the open space; near 1 they only trade
        with each other.
    """
    g = _columns(sensitivities)
    s, vt = _right(g)
    open_ = vt[s < level]
    share = np.sqrt(np.sum(open_**2, axis=0))
    unit = open_ / np.where(share > 1e-9, share, np.inf)
    return np.minimum(share, 1.0), np.minimum(np.abs(unit.T @ unit), 1.0)


def clusters(sensitivities: Float, alike: float = ALIKE) -> Int:
    """The cluster of each parameter, (p,) int64, numbered from 0 in the order of their first
    members.

    By complete linkage: no two with a |cosine| below `alike` are in one cluster. A column of zeros
    stands alone.

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


def told_apart(sensitivities: Float, order: Sequence[int]) -> tuple[Int, dict[int, Int]]:
    """Which parameters of a set the data can tell apart, and which are to be held at nominal as
    they cannot.

    One after the other a parameter is kept unless those kept before it do the same: what they leave
    of its column is below `SAME`, so that the prior alone would share a change out between them.
    One of which the data tell less than its prior by itself is kept: that holds it.

    Parameters
    ----------
    sensitivities : (r, p) float64
        Weighted, in units of the prior.
    order : sequence of int
        All parameters, those first that are to stand for others.

    Returns
    -------
    kept : (k,) int64
        Ascending.
    held : dict of int to (j,) int64
        Of each parameter that is not kept those that stand for it, the one most like it first.
    """
    g = _columns(sensitivities)
    size, cosine = np.linalg.norm(g, axis=0), cosines(g)
    kept, held, span = list[int](), dict[int, Int](), np.zeros((len(g), 0))
    for i in order:
        own = g[:, i] - span @ (span.T @ g[:, i])
        own = own - span @ (span.T @ own)  # twice is enough (Kahan and Parlett)
        rest = float(np.linalg.norm(own))
        if size[i] >= BLIND and rest < SAME:
            near = sorted(kept, key=lambda j: -cosine[i, j])
            same = [j for j in near if cosine[i, j] > ALIKE]
            held[i] = np.array(same or near, dtype=np.int64)
            continue
        kept.append(i)
        if rest > np.finfo(float).eps * size[i]:
            span = np.column_stack([span, own / rest])
    return np.sort(np.array(kept, dtype=np.int64)), held


def stood_for(
    sensitivities: Float, names: Sequence[str], first: Sequence[str] = ()
) -> dict[str, tuple[str, ...]]:
    """Parameters that are held at nominal by `told_apart`, with those that stand for them.

    Parameters
    ----------
    sensitivities : (r, p) float64
        Weighted, in units of the prior.
    names : sequence of str
        Of the parameters.
    first : sequence of str
        These stand for others; of the rest those of the largest effect, and of equal ones the
        first.
    """
    rank = {name: i for i, name in enumerate(first)}
    norm = np.linalg.norm(sensitivities, axis=0)
    size = np.round(norm / max(float(norm.max(initial=0.0)), 1e-300), EQUAL).tolist()

    def turn(i: int) -> tuple[int, float]:
        return rank.get(names[i], len(rank)), -size[i]

    _, held = told_apart(sensitivities, sorted(range(len(names)), key=turn))
    return {names[i]: tuple(names[j] for j in by.tolist()) for i, by in held.items()}


def _columns(sensitivities: Float) -> Float:
    g = np.asarray(sensitivities, dtype=np.float64)
    if g.ndim != 2 or not np.isfinite(g).all():
        raise InputError(f"sensitivities {g.shape}: must be a finite (residual, parameter) array")
    return g
