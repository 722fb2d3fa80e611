"""The posterior of the parameters around the best point (Laplace), and what the data moved.

The estimate is x̂ = argmin ‖√W Δz‖² + xᵀW_p x. With A = GᵀWG + W_p and S the true covariance of the
weighted residuals its error has the covariance A⁻¹(GᵀSG + W_p)A⁻¹, which is A⁻¹ only where W⁻¹ is
the covariance of the residuals (White 1982, eq. 3.3; Kleijn and van der Vaart 2012). So an
objective that counts a shape as one datum keeps honest intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.special import ndtri, stdtrit

from ringtrue.core.arrays import Bool, Float, freeze_fields
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import InputError
from ringtrue.updating.quadratic import covariance_root
from ringtrue.updating.residuals import Eigenvalues, Shapes, Weighted
from ringtrue.updating.several import Configuration, Evaluated, Problem

MOVED = 0.7  # posterior over prior standard deviation below which the data have told something


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """A normal (or Student) posterior of the unknowns y, x = link y.

    Attributes
    ----------
    parameters : ParameterSet
    y : (q,) float64
    covariance : (q, q) float64
        Of y.
    link : (p, q) float64
    prior_std : (p,) float64
        Of x.
    freedom : float
        Degrees of freedom that the size of the residuals was estimated from; inf where it was
        known.
    """

    parameters: ParameterSet
    y: Float
    covariance: Float
    link: Float
    prior_std: Float
    freedom: float = np.inf

    def __post_init__(self) -> None:
        freeze_fields(
            self, y=np.float64, covariance=np.float64, link=np.float64, prior_std=np.float64
        )
        p, q = len(self.parameters), self.y.size
        shapes = self.covariance.shape, self.link.shape, self.prior_std.shape
        if shapes != ((q, q), (p, q), (p,)) or not self.freedom > 0:
            raise InputError(
                f"posterior of {p} parameters, {q} unknowns: got {shapes}, freedom "
                f"{self.freedom} (> 0)"
            )

    @property
    def x(self) -> Float:
        """(p,) float64."""
        return np.asarray(self.link @ self.y)

    @property
    def std(self) -> Float:
        """Standard deviation of x, (p,)."""
        return np.asarray(np.sqrt(np.einsum("pq,qr,pr->p", self.link, self.covariance, self.link)))

    @property
    def ratio(self) -> Float:
        """Posterior over prior standard deviation, (p,): near 1 the data said nothing, near 0 they
        said all.
        """
        return np.asarray(self.std / self.prior_std)

    @property
    def moved(self) -> Bool:
        """Which parameters the data moved or pinned down, (p,)."""
        return np.asarray((self.ratio < MOVED) | (np.abs(self.x) > 2 * self.prior_std))

    def interval(self, level: float = 0.9) -> Float:
        """Central intervals of the factors, (p, 2), cut at the bounds.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise InputError(f"level {level}: allowed are values between 0 and 1")
        p = 0.5 + level / 2
        reach = float(ndtri(p) if np.isinf(self.freedom) else stdtrit(self.freedom, p)) * self.std
        low, high = self.parameters.bounds()
        ends = (np.clip(self.x - reach, low, high), np.clip(self.x + reach, low, high))
        return np.stack([self.parameters.factors(e) for e in ends], axis=1)

    def take(self, at: Sequence[int]) -> Posterior:
        """Of some parameters by position, the others left open."""
        part = self.link[list(at)]
        every = self.parameters.take(at)
        return Posterior(
            every,
            part @ self.y,
            part @ self.covariance @ part.T,
            np.eye(len(every)),
            self.prior_std[list(at)],
            self.freedom,
        )

    def sample(self, count: int, rng: np.random.Generator) -> Float:
        """Draws of x, (count, p), pulled back to the bounds."""
        z = rng.standard_normal((count, self.y.size)) @ covariance_root(self.covariance).T
        if np.isfinite(self.freedom):
            z *= np.sqrt(self.freedom / rng.chisquare(self.freedom, count))[:, None]
        low, high = self.parameters.bounds()
        return np.clip((self.y + z) @ self.link.T, low, high)

    def correlation(self) -> Float:
        """Of x, (p, p); near ±1 two parameters trade for each other."""
        c = self.link @ self.covariance @ self.link.T
        size = np.sqrt(np.diag(c))
        return np.asarray(c / np.outer(size, size))


def laplace(
    problem: Problem, at: Evaluated, scale: Float | None = None, *, independent: float | None = None
) -> Posterior:
    """The posterior around the best point of a problem.

    Parameters
    ----------
    problem : Problem
    at : Evaluated
        The end of an updating, `Solution.end`.
    scale : (kind,) float64, optional
        Factors on the standard deviations of the kinds of residuals, from `discrepancy_by_evidence`
        say. If not given, one factor is taken from the size of the residuals, and the posterior is
        Student's.
    independent : float, optional
        Number of independent errors in a datum of many rows (a shape); all its rows if not given.
        Model discrepancy is smooth over the channels: a handful is the safe choice where it
        outweighs noise. 1 with `as_likelihood`, whose rows have the variance 1 each.

    Raises
    ------
    InputError
        If there is not one scale for each kind.
    """
    value, g = problem.weighted(at)
    rows = np.bincount(at.datum)
    errors = np.minimum(rows, rows if independent is None else independent)
    share = (
        1.0 / errors[at.datum]
    )  # variance of a row of a datum whose square sum has the expectation 1
    precision = problem.linked_precision
    a = g.T @ g + precision
    freedom = np.inf
    if scale is None:
        freedom, s2 = _size(
            value, linalg.solve(a, g.T, assume_a="pos"), g, share, float(errors.sum())
        )
        square = np.full(value.size, s2)
    else:
        kinds = int(at.kind.max(initial=-1)) + 1
        if np.shape(scale) != (kinds,):
            raise InputError(f"scale {np.shape(scale)} for {kinds} kinds of residuals")
        square = np.asarray(scale, dtype=np.float64)[at.kind] ** 2
    middle = g.T @ ((square * share)[:, None] * g) + precision
    half = linalg.solve(a, middle, assume_a="pos")
    covariance = linalg.solve(a, half.T, assume_a="pos")
    prior = np.sqrt(np.diag(linalg.inv(problem.precision)))
    return Posterior(
        problem.parameters, at.y, (covariance + covariance.T) / 2, problem.link, prior, freedom
    )


def around(
    problem: Problem, at: Evaluated, free: Bool | None = None, *, freedom: float = np.inf
) -> Posterior:
    """The posterior about a point that is not its mean, where W is the inverse covariance of the
    residuals.

    With more parameters free than were updated, the others may be off by their priors too: what the
    data leave open between the two widens both. The covariance is the mean square error about the
    point, A⁻¹ + d dᵀ with d the Gauss-Newton step from it to the mean.

    Parameters
    ----------
    problem : Problem
        Its terms as `as_likelihood` makes them.
    at : Evaluated
    free : (q,) bool, optional
        Unknowns that may be off; the others are held to 0.
    freedom : float
        Degrees of freedom that the size of the errors is known with.
    """
    keep = np.ones(problem.size, dtype=np.bool_) if free is None else free
    if at.y[~keep].any():
        raise InputError("unknowns that are held must be at 0")
    r, g = problem.weighted(at)
    precision, g = problem.linked_precision[np.ix_(keep, keep)], g[:, keep]
    inverse = linalg.inv(g.T @ g + precision)
    d = inverse @ (g.T @ r - precision @ at.y[keep])
    prior = np.sqrt(np.diag(linalg.inv(problem.precision)))
    return Posterior(
        problem.parameters,
        at.y[keep],
        inverse + np.outer(d, d),
        problem.link[:, keep],
        prior,
        freedom,
    )


def _size(
    value: Float, inverse: Float, g: Float, share: Float, errors: float
) -> tuple[float, float]:
    """Degrees of freedom and mean square of the residuals; `inverse` = A⁻¹Gᵀ (q, r), expectation
    over (I − H)e.
    """
    hat = np.einsum("rq,qr->r", g, inverse)
    kept = (
        share.sum() - 2 * share @ hat + share @ np.einsum("qr,qs,sr->r", inverse, g.T @ g, inverse)
    )
    return max(errors - float(hat.sum()), 1.0), float(value @ value) / max(float(kept), 1e-12)


def as_likelihood(
    configuration: Configuration,
    frequency: float,
    shape: float,
    *,
    independent: float | None = None,
) -> Configuration:
    """The configuration with weights that are the inverse covariance of its residuals, as sampling
    needs them.

    Parameters
    ----------
    configuration : Configuration
    frequency : float
        Model discrepancy of a frequency, relative; the test's own uncertainty is added.
    shape : float
        Expected 1 − MAC, all causes.
    independent : float, optional
        Number of independent errors in a shape; the channels if not given.

    Notes
    ----- Replaces the kinds of residuals of the modes by eigenvalues and shapes; what else was
    measured stays.
    """
    if not (frequency >= 0 and shape > 0):
        raise InputError(f"discrepancy of frequencies {frequency} (>= 0), of shapes {shape} (> 0)")
    count = configuration.target.shapes.shape[0] if independent is None else independent
    rest = tuple(t for t in configuration.terms if isinstance(t, Weighted))
    return replace(configuration, terms=(Eigenvalues(frequency), Shapes(shape, count), *rest))
