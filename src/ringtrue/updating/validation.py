"""Predictions on modes left out of the updating, fold by fold, with bands that hold what was
measured.

The band of a left-out frequency has three parts: the parameters, the test, and the model
discrepancy, which no parameter can remove. The parameters of a fold are known as well as errors of
that size in the modes left to it allow: one that only the left-out mode shows may be far off and
says nothing of the model. The discrepancy is taken from all modes that are predicted unseen: those
of the folds, and those that the updating does not use at all, which have had no say in the choice
of the parameters either. That of a mode comes from all *others*, so that none helps to judge
itself; `with_discrepancy` puts the number of all into W, so that the posterior does not collapse.

`misfits` asks whether an updated model is as near to its data as their errors state, kind by kind.
The weighted squares of a kind whose errors are as stated have a χ² distribution; its degrees of
freedom are the data less those that the parameters have used up (trace of the hat matrix). A kind
beyond the quantile of it has not been fitted: the updating has ended in a minimum that is not the
global one, the form of the model is wrong, or an error was stated too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy import linalg
from scipy.special import chdtri, stdtrit

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.iterate import Outcome, Progress, quiet
from ringtrue.errors import InputError
from ringtrue.updating.problem import MODE_STRIDE, Configuration, Evaluated, Problem
from ringtrue.updating.residuals.modal import NO_MODE, Quantity, Weighted
from ringtrue.updating.solver import solve
from ringtrue.updating.uncertainty import laplace

LEAST = 1e-4  # model discrepancy, relative


@dataclass(frozen=True, slots=True, eq=False)
class Held(FrozenArrays):
    """Left-out modes against their predictions; the test modes in order.

    Attributes
    ----------
    test, predicted : (m,) float64, Hz
        NaN where the mode found no partner, or was used and in no fold.
    mac : (m,) float64
    parameter_std, test_std, model_std : (m,) float64, relative
        The three parts of the band; `model_std` from all other modes that are predicted. Parameters
        are known as well as errors of the size found let them be.
    fold : (m,) int64
        -1: in none; a mode that is not used is predicted by all that are.
    converged : bool
    ends : (fold, p) float64
        x of each fold.
    discrepancy : float
        Of a frequency, relative, from all modes that are predicted.
    """

    test: Float
    predicted: Float
    mac: Float
    parameter_std: Float
    test_std: Float
    model_std: Float
    fold: Int
    converged: bool
    ends: Float = field(default_factory=lambda: np.zeros((0, 0)))
    discrepancy: float = float("nan")

    @property
    def in_turn(self) -> Bool:
        """Modes that a fold has left out and predicted, (m,)."""
        return (self.fold >= 0) & np.isfinite(self.predicted)

    @property
    def freedom(self) -> int:
        """Degrees of freedom that the discrepancy is known with: as many errors as modes are
        predicted, less one.
        """
        return max(int(np.isfinite(self.predicted).sum()) - 1, 1)

    @property
    def error(self) -> Float:
        """(f_predicted − f_test)/f_test, (m,)."""
        return self.predicted / self.test - 1

    @property
    def std(self) -> Float:
        """Of the predicted minus the measured frequency, relative, (m,)."""
        return np.sqrt(self.parameter_std**2 + self.test_std**2 + self.model_std**2)

    def band(self, level: float) -> Float:
        """Central interval of the measured frequency, (m, 2), Hz.

        The discrepancy is known from so many errors: Student's quantile.
        """
        reach = (
            float(stdtrit(self.freedom, 0.5 + level / 2)) * self.std * self.predicted
        )
        return np.stack([self.predicted - reach, self.predicted + reach], axis=1)

    def inside(self, level: float) -> Bool:
        """Whether the band holds the measured frequency, (m,); False without a prediction."""
        band = self.band(level)
        return (band[:, 0] <= self.test) & (self.test <= band[:, 1])

    def coverage(self, level: float) -> float:
        """Share of the modes left out in turn that are inside their bands."""
        seen = self.in_turn
        return float(self.inside(level)[seen].mean()) if seen.any() else float("nan")


def folds_of(used: Bool, count: int) -> tuple[tuple[int, ...], ...]:
    """`count` folds of the used modes, interleaved over the band.

    Raises
    ------
    InputError
        If there are fewer than two folds or fewer modes than folds.
    """
    at = np.flatnonzero(used)
    if not 2 <= count <= at.size:
        raise InputError(
            f"{count} folds of {at.size} modes: from 2 to the number of modes"
        )
    return tuple(tuple(at[i::count].tolist()) for i in range(count))


def discrepancy(error: Float, known: Float, gain: Float | None = None) -> float:
    """Relative standard deviation s of largest likelihood of errors ~ N(0, gain s² + known²), (m,)
    each; NaNs left out.

    `gain` is 1 if not given, larger where s has made the parameters uncertain, too.
    """
    seen = np.isfinite(error)
    e2 = error[seen] ** 2
    k2 = known[seen] ** 2
    g = 1.0 if gain is None else gain[seen]
    if not e2.size:
        raise InputError(
            "no left-out mode has found a partner: widen the gates, or leave other modes out"
        )
    grid = np.geomspace(LEAST, max(10 * float(np.sqrt(e2.max())), 2 * LEAST), 200)
    total = grid[:, None] ** 2 * g + k2
    return float(grid[np.argmin((e2 / total + np.log(total)).sum(axis=1))])


def k_fold(
    configuration: Configuration,
    folds: Sequence[Sequence[int]],
    *,
    start: Float | None = None,
    others: Sequence[Configuration] = (),
    progress: Progress = quiet,
) -> Held:
    """Update without each fold in turn and predict it; at last with all used modes, for those that
    are not used.

    Parameters
    ----------
    configuration : Configuration
        Its target says which modes are used at all.
    folds : sequences of test modes
    start : (q,) float64, optional
        Unknowns at the start of every fold; else each starts where the one before has ended, the
        first at 0.
    others : sequence of Configuration
        Further configurations that every fold sees whole; their parameters are among those of the
        first.

    Raises
    ------
    InputError
        If no left-out mode finds a partner, or a mode is in two folds.
    """
    target = configuration.target
    m = target.frequencies.size
    if len({i for f in folds for i in f}) != sum(len(f) for f in folds):
        raise InputError("a mode is in two folds")
    predicted = np.full(m, np.nan)
    mac = np.full(m, np.nan)
    spread = np.full((m, 3), np.nan)
    of = np.full(m, -1)
    begin = start
    good = True
    ends = []
    unused = np.flatnonzero(~target.used).tolist()
    for i, fold in enumerate([*folds, unused] if unused else folds):
        used = target.used & ~np.isin(np.arange(m), fold)
        problem = Problem(
            (replace(configuration, target=replace(target, used=used)), *others)
        )
        done = solve(problem, start=begin)
        good = good and done.outcome is Outcome.CONVERGED
        begin = done.y if start is None else start
        here = done.end.points[0]
        which = np.isin(here.every[:, 0], fold)
        t, f = here.every[which].T
        hertz = here.now.frequencies[f]
        slope = here.now.d_lambda[f] / (8 * np.pi**2 * hertz**2)[:, None] @ problem.link
        parts = variance_parts(problem, done.end)
        predicted[t] = hertz
        mac[t] = here.mac[which]
        spread[t] = np.einsum("mp,kpq,mq->mk", slope, parts, slope)
        if i == len(folds):
            break
        of[list(fold)] = i
        ends.append(done.x)
        progress((i + 1) / len(folds), f"left out: fold {i + 1} of {len(folds)}")
    error = predicted / target.frequencies - 1
    by_f = spread[:, 0]
    fixed = (
        by_f * float(np.mean(target.std**2))
        + spread[:, 1] * mean_miss(mac)
        + spread[:, 2]
    )
    known = np.sqrt(fixed + target.std**2)
    found = discrepancy(error, known, 1 + by_f)
    return Held(
        test=target.frequencies,
        predicted=predicted,
        mac=mac,
        parameter_std=np.sqrt(fixed + by_f * found**2),
        test_std=target.std,
        model_std=_from_others(error, known, 1 + by_f),
        fold=of,
        converged=good,
        ends=np.array(ends),
        discrepancy=found,
    )


def mean_miss(mac: Float) -> float:
    """Mean 1 − MAC of the modes that have a partner; `LEAST` at least."""
    seen = mac[np.isfinite(mac)]
    return max(float(np.mean(1 - seen)), LEAST) if seen.size else LEAST


def _from_others(error: Float, known: Float, gain: Float) -> Float:
    """The discrepancy of each mode from the errors of all others, (m,); NaN without an error."""
    seen = np.flatnonzero(np.isfinite(error))
    out = np.full(error.size, np.nan)
    for i in seen:  # over modes: a search each
        rest = seen[seen != i] if seen.size > 1 else seen
        out[i] = discrepancy(error[rest], known[rest], gain[rest])
    return out


def variance_parts(problem: Problem, at: Evaluated) -> Float:
    """Covariance of the unknowns (3, q, q): a unit of the mean square error of frequencies, one of
    1 − MAC, the rest.

    A shape has as many independent errors as the weights say: one, as the parameters imitate it
    best, if not given.
    """
    kinds = int(at.kind.max(initial=-1)) + 1
    terms = [(t, c.target.std) for c in problem.configurations for t in c.terms]
    scales = np.zeros((4, kinds))  # none, of frequencies, of shapes, the rest
    for i, (term, std) in enumerate(terms[:kinds]):
        unit = term.unit(std)
        if unit is None:
            scales[3, i] = 1.0
        else:
            scales[1 if term.quantity is Quantity.FREQUENCY else 2, i] = unit
    many = problem.configurations[0].target.weights.independent
    none, *each = (laplace(problem, at, k, independent=many).covariance for k in scales)
    return np.stack([each[0] - none, each[1] - none, each[2]])


def with_discrepancy(
    configuration: Configuration,
    folds: Sequence[Sequence[int]],
    *,
    start: Float | None = None,
    others: Sequence[Configuration] = (),
    progress: Progress = quiet,
) -> tuple[Configuration, Held]:
    """The configuration with the weights that its left-out modes ask for, and the predictions of
    these.

    The folds are updated by the weights that are given, as the whole was: their errors are those of
    this way to update. The discrepancy of a frequency is that of all frequencies that were
    predicted unseen, that of a shape the mean of 1 − MAC of such shapes.

    Notes
    ----- Terms of frequencies, shapes and MAC get these weights, in the other configurations too;
    other kinds stay.
    """
    held = k_fold(
        configuration,
        folds,
        start=start,
        others=others,
        progress=progress,
    )
    return configuration.weighed(held.discrepancy, mean_miss(held.mac)), held


@dataclass(frozen=True, slots=True)
class AdequacyLimits:
    """When a kind of residuals is not fitted.

    Attributes
    ----------
    risk : float
        Probability that one whose errors are as stated is called so.
    """

    risk: float = 1e-3


ADEQUACY = AdequacyLimits()


class LabelledData(Protocol):
    """What was measured besides the modes: its name, and a label for each of its data."""

    @property
    def name(self) -> str:
        """Of the kind."""
        ...

    @property
    def labels(self) -> tuple[str, ...]:
        """One a datum."""
        ...


@dataclass(frozen=True, slots=True)
class Misfit:
    """A kind of residuals beyond its stated error.

    Attributes
    ----------
    kind : str
        `frequencies`, `shapes`, or the name of what was measured besides the modes.
    configuration : str
        Empty where there is one.
    ratio : float
        Root mean square deviation over the stated error.
    chi_square, freedom, limit : float
        Of the kind, its degrees of freedom, and the quantile that it exceeds.
    worst : tuple of str
        The data that stand out; the largest where none does by itself.
    """

    kind: str
    configuration: str
    ratio: float
    chi_square: float
    freedom: float
    limit: float
    worst: tuple[str, ...]


def misfits(
    problem: Problem,
    at: Evaluated,
    data: Sequence[Sequence[LabelledData]] = (),
    limits: AdequacyLimits = ADEQUACY,
) -> tuple[Misfit, ...]:
    """The kinds of residuals that a point does not fit.

    Parameters
    ----------
    problem : Problem
        Its errors as stated.
    at : Evaluated
        Of this problem.
    data : sequence (configuration) of sequences, optional
        What the kinds besides those of the modes are called, in their order.
    """
    _, g = problem.weighted(at)
    normal = g.T @ g + problem.linked_precision
    out = []
    kind = 0
    for i, (c, point) in enumerate(zip(problem.configurations, at.points, strict=True)):
        others = iter(data[i] if data else ())
        for term in c.terms:
            rows = at.kind == kind
            kind = kind + 1
            named = next(others, None) if isinstance(term, Weighted) else None
            squares = term.fit(point)
            used_up = float(
                np.trace(linalg.solve(normal, g[rows].T @ g[rows], assume_a="pos"))
            )
            freedom = max(squares.size - used_up, 1.0)
            limit = float(chdtri(freedom, limits.risk))
            if float(squares.sum()) <= limit:
                continue
            modes = at.mode[rows]
            each = dict.fromkeys(modes[modes != NO_MODE].tolist())
            labels: Sequence[str] = [f"test mode {t % MODE_STRIDE + 1}" for t in each]
            if named is not None:
                labels = named.labels
            elif not each:
                labels = [f"datum {k + 1}" for k in range(modes.size)]
            found = Misfit(
                kind=term.called if named is None else named.name,
                configuration=c.name if len(problem.configurations) > 1 else "",
                ratio=float(np.sqrt(squares.sum() / freedom)),
                chi_square=float(squares.sum()),
                freedom=freedom,
                limit=limit,
                worst=tuple(labels[k] for k in _standing_out(squares, limits.risk)),
            )
            out.append(found)
    return tuple(out)


def _standing_out(squares: Float, risk: float) -> list[int]:
    """Data of which the largest of so many would be as large by chance with the probability
    `risk`; the largest if there is none.
    """
    order = np.argsort(-squares, kind="stable")
    limit = float(chdtri(1, 1 - (1 - risk) ** (1 / squares.size)))
    count = max(int((squares > limit).sum()), 1)
    return [int(k) for k in order[:count]]
