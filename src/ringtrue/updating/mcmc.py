"""Sampling a posterior with an ensemble of walkers, blind to any linear stretching of the
parameters.

Goodman and Weare (2010), Comm. App. Math. Comp. Sci. 5, 65: the stretch move; the two halves of the
ensemble move in turns (Foreman-Mackey et al. 2013, sec. 3). Convergence by the integrated
autocorrelation time (Sokal 1997) and the split potential scale reduction (Gelman et al. 2013, eq.
11.4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, freeze_fields
from ringtrue.core.progress import Progress
from ringtrue.errors import InputError, NumericalError, SolverError
from ringtrue.updating.several import Problem

STRETCH = 2.0  # a of the stretch move: z in [1/a, a] with density ∝ 1/√z
WINDOW = 5.0  # autocorrelation times that the sum runs over
ENOUGH = 50.0  # autocorrelation times that a chain must have


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """A sampled posterior.

    Attributes
    ----------
    samples : (step, walker, q) float64
    log_density : (step, walker) float64
    acceptance : float
        Share of accepted moves; 0.2 to 0.5 is healthy.
    time : (q,) float64
        Integrated autocorrelation time, steps.
    reduction : (q,) float64
        Split R̂; 1 when the walkers agree.
    """

    samples: Float
    log_density: Float
    acceptance: float
    time: Float
    reduction: Float

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, samples=f, log_density=f, time=f, reduction=f)

    @property
    def converged(self) -> bool:
        """Long enough for its autocorrelation, and one distribution throughout."""
        long = self.samples.shape[0] >= ENOUGH * float(self.time.max(initial=0.0))
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
        return np.asarray(np.quantile(self.flat(), [tail, 1 - tail], axis=0).T)


def log_posterior(problem: Problem) -> Callable[[Float], Float]:
    """ln p of points (n, q): −J/2 within the limits, −inf beyond them and where the model cannot be
    solved.

    W of the problem must be the inverse covariance of its residuals (`posterior.as_likelihood`).
    """
    rows, limits = problem.inequalities()

    def one(y: Float) -> float:
        if (rows @ y > limits).any():
            return -np.inf
        try:
            return -0.5 * problem.cost(y)
        except (NumericalError, SolverError):
            return -np.inf

    # a loop over walkers: each is an eigensolution, beside which the loop costs nothing
    return lambda points: np.array([one(y) for y in points])


def ensemble(
    log_density: Callable[[Float], Float],
    start: Float,
    steps: int,
    rng: np.random.Generator,
    *,
    burn: int = 0,
    progress: Progress | None = None,
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
    if walkers % 2 or walkers < 2 * q + 2 or np.linalg.matrix_rank(x - x.mean(axis=0)) < q:
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
    samples, logs, taken = np.empty((steps, walkers, q)), np.empty((steps, walkers)), 0
    for i in range(burn + steps):
        for move, rest in _halves(walkers, rng):
            taken += _stretch(log_density, x, here, move, rest, rng)
        if i >= burn:
            samples[i - burn], logs[i - burn] = x, here
        if progress is not None:
            progress((i + 1) / (burn + steps), "sampling the posterior")
    share = taken / (walkers * (burn + steps))
    return Chains(samples, logs, share, autocorrelation_time(samples), _reduction(samples))


def _halves(walkers: int, rng: np.random.Generator) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    a, b = np.split(rng.permutation(walkers), 2)
    return (a, b), (b, a)


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
    z = ((STRETCH - 1) * rng.random(move.size) + 1) ** 2 / STRETCH
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
    stop = np.arange(n)[:, None] >= WINDOW * tau
    at = np.where(stop.any(axis=0), stop.argmax(axis=0), n - 1)
    return np.asarray(np.maximum(tau[at, np.arange(tau.shape[1])], 1.0))


def _reduction(samples: Float) -> Float:
    """Split R̂ (q,) of (step, walker, q)."""
    half = samples.shape[0] // 2
    parts = np.concatenate([samples[:half], samples[half : 2 * half]], axis=1)
    within = parts.var(axis=0, ddof=1).mean(axis=0)
    between = parts.mean(axis=0).var(axis=0, ddof=1)
    return np.asarray(np.sqrt((half - 1) / half + between / np.where(within > 0, within, 1.0)))
