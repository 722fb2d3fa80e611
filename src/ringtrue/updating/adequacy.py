"""Whether an updated model is as near to its data as their errors state, kind by kind.

The weighted squares of a kind whose errors are as stated have a χ² distribution; its degrees of
freedom are the data less those that the parameters have used up (trace of the hat matrix). A kind
beyond the quantile of it has not been fitted: the updating has ended in a minimum that is not the
global one, the form of the model is wrong, or an error was stated too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import linalg
from scipy.special import chdtri

from ringtrue.core.arrays import Float
from ringtrue.updating.problem import MODE_STRIDE, Evaluated, Problem
from ringtrue.updating.residuals.modal import NO_MODE, Weighted


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
            used_up = float(np.trace(linalg.solve(normal, g[rows].T @ g[rows], assume_a="pos")))
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
