"""The posterior of the parameters around the best point (Laplace), and what the data moved.

The estimate is x̂ = argmin ‖√W Δz‖² + xᵀW_p x. With A = GᵀWG + W_p and S the true covariance of the
weighted residuals its error has the covariance A⁻¹(GᵀSG + W_p)A⁻¹, which is A⁻¹ only where W⁻¹ is
the covariance of the residuals (White 1982, eq. 3.3; Kleijn and van der Vaart 2012). So an
objective that counts a shape as one datum keeps honest intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.special import ndtri, stdtrit

from ringtrue.core.arrays import Bool, Float, FrozenArrays
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import InputError, NumericalError, SolverError
from ringtrue.fem.assembly import System
from ringtrue.fem.element_cards import mesh
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation
from ringtrue.shapes import basis
from ringtrue.updating.problem import Configuration, Evaluated, Problem
from ringtrue.updating.residuals.modal import Eigenvalues, Quantity, Shapes
from ringtrue.updating.selection.localisation import strain_energies
from ringtrue.updating.target import Target, match, span_residuals


@dataclass(frozen=True, slots=True)
class ChainSettings:
    """The sampling of the posterior.

    Attributes
    ----------
    stretch : float
        a of the stretch move: z in [1/a, a] with density ∝ 1/√z.
    window : float
        Autocorrelation times that the sum runs over.
    enough : float
        Autocorrelation times that a chain must have.
    """

    stretch: float = 2.0
    window: float = 5.0
    enough: float = 50.0


CHAIN = ChainSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Posterior(FrozenArrays):
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

    @property
    def x(self) -> Float:
        """(p,) float64."""
        return self.link @ self.y

    @property
    def std(self) -> Float:
        """Standard deviation of x, (p,)."""
        return np.asarray(
            np.sqrt(np.einsum("pq,qr,pr->p", self.link, self.covariance, self.link))
        )

    @property
    def ratio(self) -> Float:
        """Posterior over prior standard deviation, (p,): near 1 the data said nothing, near 0 they
        said all.
        """
        return self.std / self.prior_std

    @property
    def moved(self) -> Bool:
        """Which parameters the data moved or pinned down, (p,)."""
        # 0.7: posterior over prior standard deviation below which the data have shown something
        return (self.ratio < 0.7) | (np.abs(self.x) > 2 * self.prior_std)

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
        reach = (
            float(ndtri(p) if np.isinf(self.freedom) else stdtrit(self.freedom, p))
            * self.std
        )
        low, high = self.parameters.bounds()
        ends = (np.clip(self.x - reach, low, high), np.clip(self.x + reach, low, high))
        return np.stack([self.parameters.factors(e) for e in ends], axis=1)

    def take(self, at: Sequence[int]) -> Posterior:
        """Of some parameters by position, the others left open."""
        part = self.link[list(at)]
        every = self.parameters.take(at)
        return Posterior(
            parameters=every,
            y=part @ self.y,
            covariance=part @ self.covariance @ part.T,
            link=np.eye(len(every)),
            prior_std=self.prior_std[list(at)],
            freedom=self.freedom,
        )

    def sample(self, count: int, rng: np.random.Generator) -> Float:
        """Draws of x, (count, p), pulled back to the bounds."""
        z = (
            rng.standard_normal((count, self.y.size))
            @ covariance_root(self.covariance).T
        )
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
    problem: Problem,
    at: Evaluated,
    scale: Float | None = None,
    *,
    independent: float | None = None,
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
    # variance of a row of a datum whose square sum has the expectation 1
    share = 1.0 / errors[at.datum]
    precision = problem.linked_precision
    a = g.T @ g + precision
    freedom = np.inf
    if scale is None:
        inverse = linalg.solve(a, g.T, assume_a="pos")
        freedom, s2 = _size(value, inverse, g, share, float(errors.sum()))
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
        parameters=problem.parameters,
        y=at.y,
        covariance=(covariance + covariance.T) / 2,
        link=problem.link,
        prior_std=prior,
        freedom=freedom,
    )


def around(
    problem: Problem,
    at: Evaluated,
    free: Bool | None = None,
    *,
    freedom: float = np.inf,
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
    precision = problem.linked_precision[np.ix_(keep, keep)]
    g = g[:, keep]
    inverse = linalg.inv(g.T @ g + precision)
    d = inverse @ (g.T @ r - precision @ at.y[keep])
    prior = np.sqrt(np.diag(linalg.inv(problem.precision)))
    return Posterior(
        parameters=problem.parameters,
        y=at.y[keep],
        covariance=inverse + np.outer(d, d),
        link=problem.link[:, keep],
        prior_std=prior,
        freedom=freedom,
    )


def _size(
    value: Float, inverse: Float, g: Float, share: Float, errors: float
) -> tuple[float, float]:
    """Degrees of freedom and mean square of the residuals; `inverse` = A⁻¹Gᵀ (q, r), expectation
    over (I − H)e.
    """
    hat = np.einsum("rq,qr->r", g, inverse)
    kept = (
        share.sum()
        - 2 * share @ hat
        + share @ np.einsum("qr,qs,sr->r", inverse, g.T @ g, inverse)
    )
    return max(errors - float(hat.sum()), 1.0), float(value @ value) / max(
        float(kept), 1e-12
    )


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
        raise InputError(
            f"discrepancy of frequencies {frequency} (>= 0), of shapes {shape} (> 0)"
        )
    count = configuration.target.shapes.shape[0] if independent is None else independent
    rest = tuple(t for t in configuration.terms if t.quantity is Quantity.OTHER)
    return replace(
        configuration, terms=(Eigenvalues(frequency), Shapes(shape, count), *rest)
    )


def covariance_root(covariance: Float) -> Float:
    """L (q, q) with L Lᵀ = covariance (q, q), which may be singular: the symmetric root of the
    correlation, scaled.

    Draws L z of standard normal z are then the same whatever signs and rotations the eigenvectors
    come out with, which differ from processor to processor.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(size > 0, size, 1.0)
    value, turn = linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(
        scale[:, None] * ((turn * np.sqrt(np.maximum(value, 0.0))) @ turn.T)
    )


def energy_shares(model: Model, system: System, vectors: Float) -> Float:
    """Shares of strain energy of the elements, then of kinetic energy of the nodes, (e + n, m).

    Parameters
    ----------
    vectors : (f, m) float64
        Modes in the free degrees of freedom, any scale.
    """
    strain = np.maximum(strain_energies(mesh(model), system, vectors), 0.0)
    _, node = np.unique(system.free.node, return_inverse=True)
    kinetic = np.zeros((int(node.max(initial=-1)) + 1, vectors.shape[1]))
    np.add.at(kinetic, node, vectors * (system.mass @ vectors))
    energies = (strain, np.maximum(kinetic, 0.0))
    return np.concatenate([e / np.maximum(e.sum(axis=0), 1e-300) for e in energies])


def likeness(shares: Float) -> Float:
    """Correlation of the frequency errors of modes, (m, m), from their energy shares (e, m)."""
    covariance = shares.T @ shares
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance / np.outer(size, size))


def effective_freedom(correlation: Float) -> float:
    """Degrees of freedom of the mean square of errors with this correlation, (m, m).

    m²/ΣR² is that of the χ² with the same mean and variance (Satterthwaite 1946): m where the
    errors are independent, 1 where they are one and the same.
    """
    m = len(correlation)
    return float(m**2 / (correlation**2).sum()) if m else 1.0


def errors_of_shapes(target: Target, now: Linearisation) -> float:
    """`independent_errors` of the used shapes of a test against a model at a point; 1 without a
    pair.
    """
    pairs, _, of = match(target, now)
    used = target.used[pairs[:, 0]]
    if not used.any():
        return 1.0
    rest, _ = span_residuals(target.shapes, now, pairs, of)
    return independent_errors(
        rest[:, used], np.array([s.size for s in of])[used], now.shapes
    )


def independent_errors(rest: Float, own: Float, shapes: Float) -> float:
    """Number of independent errors in a shape: 1 where they are errors of form, the channels where
    they are noise.

    Of noise the other shapes hold as large a share as the directions they span of all that are
    free; what they hold beyond that is taken for one error, which any parameter may imitate.

    Parameters
    ----------
    rest : (n, k) float64
        Unit test shapes less their part in the span of the modes that stand for them.
    own : (k,) float64
        Number of these modes.
    shapes : (n, m) float64
        Of the model, the lowest first; n/2 of them are looked at.
    """
    n = len(rest)
    total = float((rest**2).sum())
    space = basis(shapes[:, : n // 2])
    if not total > 0 or not space.size:
        return 1.0
    held = float(((space.T @ rest) ** 2).sum()) / total
    size = (rest**2).sum(axis=0)
    by_chance = (
        float(size @ np.clip((space.shape[1] - own) / np.maximum(n - own, 1), 0, 1))
        / total
    )
    of_form = float(np.clip((held - by_chance) / (1 - by_chance), 0.0, 1.0))
    return 1 / (of_form + (1 - of_form) / n)


@dataclass(frozen=True, slots=True, eq=False)
class Chains(FrozenArrays):
    """A sampled posterior.

    Attributes
    ----------
    samples : (step, walker, q) float64
    acceptance : float
        Share of accepted moves; 0.2 to 0.5 is healthy.
    time : (q,) float64
        Integrated autocorrelation time, steps.
    reduction : (q,) float64
        Split R̂; 1 when the walkers agree.
    """

    samples: Float
    acceptance: float
    time: Float
    reduction: Float

    @property
    def converged(self) -> bool:
        """Long enough for its autocorrelation, and one distribution throughout."""
        long = self.samples.shape[0] >= CHAIN.enough * float(self.time.max(initial=0.0))
        return bool(long and float(self.reduction.max(initial=1.0)) < 1.05)

    @property
    def size(self) -> float:
        """Effective number of independent samples of the worst parameter."""
        steps, walkers, _ = self.samples.shape
        return float(steps * walkers / self.time.max(initial=1.0))

    def flat(self) -> Float:
        """All samples, (step · walker, q)."""
        return self.samples.reshape(-1, self.samples.shape[-1])

    def interval(self, level: float = 0.9) -> Float:
        """Central intervals, (q, 2)."""
        tail = (1 - level) / 2
        return np.quantile(self.flat(), [tail, 1 - tail], axis=0).T


def log_posterior(problem: Problem) -> Callable[[Float], Float]:
    """ln p of points (n, q): −J/2 within the limits, −inf beyond them and where the model cannot be
    solved.

    W of the problem must be the inverse covariance of its residuals (`uncertainty.as_likelihood`).
    """
    rows, limits = problem.inequalities()

    def one(y: Float) -> float:
        if (rows @ y > limits).any():
            return -np.inf
        try:
            return -0.5 * problem.cost(y)
        except (NumericalError, SolverError):
            return -np.inf

    # a loop over walkers: each is an eigensolution, against which the loop costs nothing
    return lambda points: np.array([one(y) for y in points])


def ensemble(
    log_density: Callable[[Float], Float],
    start: Float,
    steps: int,
    rng: np.random.Generator,
    *,
    burn: int = 0,
    progress: Progress = quiet,
) -> Chains:
    """Sample a density.

    Parameters
    ----------
    log_density : callable (n, q) -> (n,)
        Up to a constant; -inf where the density is zero.
    start : (walker, q) float64
        An even number of walkers, at least 2 q + 2, where the density is not zero; draws of the
        Laplace posterior.
    steps, burn : int
        Kept, and thrown away before.
    rng : Generator

    Raises
    ------
    InputError
        If there are too few walkers, they lie in a subspace, or one of them has no density.
    """
    x = np.array(start, dtype=np.float64)
    walkers, q = x.shape
    if (
        walkers % 2
        or walkers < 2 * q + 2
        or np.linalg.matrix_rank(x - x.mean(axis=0)) < q
    ):
        raise InputError(
            f"{walkers} walkers for {q} unknowns: an even number >= {2 * q + 2}, spread in all "
            "directions"
        )
    if steps < 4 or burn < 0:
        raise InputError(f"{steps} steps (>= 4), {burn} thrown away (>= 0)")
    here = log_density(x)
    if not np.isfinite(here).all():
        raise InputError(
            "a walker starts where the density is zero: draw the start closer to the best point"
        )
    samples = np.empty((steps, walkers, q))
    taken = 0
    for i in range(burn + steps):
        a, b = np.split(rng.permutation(walkers), 2)
        for move, rest in ((a, b), (b, a)):
            taken += _stretch(
                log_density,
                x,
                here=here,
                move=move,
                rest=rest,
                rng=rng,
            )
        if i >= burn:
            samples[i - burn] = x
        progress((i + 1) / (burn + steps), "sampling the posterior")
    share = taken / (walkers * (burn + steps))
    return Chains(samples, share, autocorrelation_time(samples), _reduction(samples))


def _stretch(
    log_density: Callable[[Float], Float],
    x: Float,
    here: Float,
    move: np.ndarray,
    rest: np.ndarray,
    rng: np.random.Generator,
) -> int:
    """Move one half along lines to walkers of the other, in place; the number accepted. Goodman and
    Weare, eq. 7.
    """
    z = ((CHAIN.stretch - 1) * rng.random(move.size) + 1) ** 2 / CHAIN.stretch
    other = x[rng.choice(rest, move.size)]
    trial = other + z[:, None] * (x[move] - other)
    there = log_density(trial)
    ratio = (x.shape[1] - 1) * np.log(z) + there - here[move]
    go = np.log(rng.random(move.size)) < ratio
    x[move[go]], here[move[go]] = trial[go], there[go]
    return int(go.sum())


def autocorrelation_time(samples: Float) -> Float:
    """Integrated autocorrelation time (q,), steps, of samples (step, walker, q), the walkers'
    functions averaged.
    """
    n = samples.shape[0]
    d = samples - samples.mean(axis=(0, 1))
    power = np.abs(np.fft.rfft(d, 2 * n, axis=0)) ** 2
    rho = np.fft.irfft(power, axis=0)[:n].mean(axis=1)
    tau = 2 * np.cumsum(rho / np.where(rho[0] > 0, rho[0], 1.0), axis=0) - 1
    stop = np.arange(n)[:, None] >= CHAIN.window * tau
    at = np.where(stop.any(axis=0), stop.argmax(axis=0), n - 1)
    return np.asarray(np.maximum(tau[at, np.arange(tau.shape[1])], 1.0))


def _reduction(samples: Float) -> Float:
    """Split R̂ (q,) of (step, walker, q)."""
    half = samples.shape[0] // 2
    parts = np.concatenate([samples[:half], samples[half : 2 * half]], axis=1)
    within = parts.var(axis=0, ddof=1).mean(axis=0)
    between = parts.mean(axis=0).var(axis=0, ddof=1)
    return np.asarray(
        np.sqrt((half - 1) / half + between / np.where(within > 0, within, 1.0))
    )
