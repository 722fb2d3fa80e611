"""Sensors by information: greedy log-determinant of the information about modes and parameters.

Each aim is a set of unknowns with a prior; a point adds BᵀB to the information about them. The
log-determinant is submodular, so that the greedy choice reaches at least 1 - 1/e of the best gain
there is (Nemhauser, Wolsey and Fisher 1978; Krause, Singh and Guestrin 2008 for sensors).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.core.progress import Progress
from ringtrue.errors import InputError
from ringtrue.model.ports import ObservedModel
from ringtrue.shapes.mac import mac


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """Unknowns, and what each point tells of them.

    Attributes
    ----------
    rows : (n, r, k) float64
        Point, measurement, unknown: sensitivity over the standard deviation of the measurement.
    prior : (k, k) float64
        Information before the test.
    weight : float
        Of its log-determinant in the sum over aims.
    """

    rows: Float
    prior: Float
    weight: float = 1.0

    def __post_init__(self) -> None:
        freeze_fields(self, rows=np.float64, prior=np.float64)
        k = self.rows.shape[-1]
        if self.rows.ndim != 3 or self.prior.shape != (k, k):
            raise InputError(
                f"aim: rows {self.rows.shape} must be (point, measurement, unknown), prior {k} x "
                f"{k}"
            )


def mode_aim(shapes: Float, noise: float = 0.02, weight: float = 1.0) -> Aim:
    """Aim at the modal coordinates.

    Parameters
    ----------
    shapes : (n, d, m) float64
    noise : float
        Standard deviation of a measured component over the RMS of the mode; the prior is one
        coordinate of 1.
    """
    size = np.sqrt((shapes**2).mean(axis=(0, 1)))
    return Aim(shapes / (noise * np.where(size > 0, size, 1.0)), np.eye(shapes.shape[2]), weight)


def parameter_aim(
    shapes: Float,
    d_shapes: Float,
    prior_std: Float,
    *,
    noise: float = 0.02,
    relative: Float | None = None,
    frequency_std: float = 0.005,
    weight: float = 1.0,
) -> Aim:
    """Aim at the parameters x/σ_x, through shapes at the points and frequencies, which every layout
    finds.

    The scale of a measured shape is unknown: the part of ∂φ/∂x along φ over all candidates tells
    nothing and is taken out.

    Parameters
    ----------
    shapes : (n, d, m) float64
    d_shapes : (n, d, m, p) float64, ∂φ/∂x
    prior_std : (p,) float64
    noise : float
        Standard deviation of a measured component over the RMS of the mode.
    relative : (m, p) float64, optional
        ∂λ/∂x/λ.
    frequency_std : float
        Relative standard deviation of a frequency, test and model error together.
    """
    n, d, m, p = d_shapes.shape
    norm = (shapes**2).sum(axis=(0, 1))
    norm = np.where(norm > 0, norm, 1.0)
    share = np.einsum("ndm,ndmp->mp", shapes, d_shapes) / norm[:, None]
    pure = d_shapes - shapes[..., None] * share
    rows = pure * prior_std / (noise * np.sqrt(norm / (n * d)))[:, None]
    prior = np.eye(p)
    if relative is not None:
        g = np.asarray(relative) * prior_std / (2 * frequency_std)
        prior = prior + g.T @ g
    return Aim(rows.reshape(n, d * m, p), prior, weight)


def gains(aim: Aim, information: Float) -> Float:
    """Gain in log-determinant by each point alone, (n,), at `information` (k, k)."""
    n, r, k = aim.rows.shape
    low = np.linalg.cholesky(information)
    b = np.linalg.solve(low, aim.rows.reshape(n * r, k).T).T.reshape(n, r, k)
    grown = b @ b.transpose(0, 2, 1) + np.eye(r) if r <= k else b.transpose(0, 2, 1) @ b + np.eye(k)
    return np.asarray(np.linalg.slogdet(grown)[1])


def informed(aim: Aim, chosen: Int) -> Float:
    """Information (k, k) with the chosen points in."""
    b = aim.rows[chosen].reshape(-1, aim.rows.shape[2])
    return np.asarray(aim.prior + b.T @ b)


def greedy_logdet(
    aims: Sequence[Aim],
    count: int,
    *,
    xyz: Float | None = None,
    min_distance: float = 0.0,
    fixed: Bool | None = None,
    cost: Float | None = None,
    budget: float = np.inf,
    progress: Progress | None = None,
) -> Int:
    """Points that add most to the weighted sum of log-determinants, one at a time, per unit of
    cost.

    Several aims at once serve modes and parameters together; one aim a sample of the prior makes
    the layout robust.

    Parameters
    ----------
    aims : sequence of Aim
    count : int
        Most points, the fixed ones included.
    xyz : (n, 3) float64, m, optional
        Needed for `min_distance`.
    min_distance : float, m
    fixed : (n,) bool, optional
        Points that are in from the start.
    cost : (n,) float64, optional
        Of a point, > 0; 1 where not given.
    budget : float
        Largest sum of the costs of the points that are added.

    Returns
    -------
    (k,) int64
        Fixed ones first, then in order of choice.

    Raises
    ------
    InputError
        If the points run out before `count` is reached within the budget.
    """
    n = aims[0].rows.shape[0]
    price = np.ones(n) if cost is None else np.asarray(cost, dtype=np.float64)
    if (price <= 0).any() or price.shape != (n,) or any(a.rows.shape[0] != n for a in aims):
        raise InputError(
            f"cost {price.shape}: one number > 0 for each of {n} candidates, in every aim"
        )
    chosen = [] if fixed is None else np.flatnonzero(fixed).tolist()
    left = float(budget)
    while len(chosen) < count:
        free = _free(n, np.array(chosen, dtype=np.int64), xyz, min_distance)
        if not free.any():
            raise InputError(
                f"{len(chosen)} points are {min_distance:g} m apart, {count} were asked for: "
                "lower min_distance or "
                "name more candidates"
            )
        if not (free & (price <= left)).any():
            break
        at = np.array(chosen, dtype=np.int64)
        gain = sum(a.weight * gains(a, informed(a, at)) for a in aims)
        best = int(np.argmax(np.where(free & (price <= left), gain / price, -np.inf)))
        chosen.append(best)
        left -= float(price[best])
        if progress:
            progress(len(chosen) / count, "measuring points by information")
    return np.array(chosen, dtype=np.int64)


def _free(n: int, chosen: Int, xyz: Float | None, distance: float) -> Bool:
    free = np.ones(n, dtype=np.bool_)
    free[chosen] = False
    if distance > 0 and chosen.size:
        if xyz is None:
            raise InputError("min_distance needs the places xyz of the candidates")
        gap = np.linalg.norm(xyz[:, None] - xyz[None, chosen], axis=2).min(axis=1)
        free &= gap > distance
    return free


def prior_shapes(model: ObservedModel, count: int, rng: np.random.Generator) -> Float:
    """Shapes (s, channel, m) at draws from the prior, s = 1 + count, the nominal ones first, in
    their order and sign.

    Modes that cross keep the place of the nominal mode they look like; the prior is normal, cut at
    the bounds.
    """
    nominal = model.modes(np.zeros(len(model.parameters))).shapes
    low, high = model.parameters.bounds()
    draws = np.clip(
        rng.standard_normal((count, len(model.parameters))) * model.parameters.std(), low, high
    )
    return np.stack([nominal, *(_like(nominal, model.modes(x).shapes) for x in draws)])


def _like(nominal: Float, shapes: Float) -> Float:
    _, at = linear_sum_assignment(-mac(nominal, shapes))
    sign = np.sign(np.einsum("cm,cm->m", nominal, shapes[:, at]))
    return np.asarray(shapes[:, at] * np.where(sign == 0, 1.0, sign))
