"""Is an updated parameter plausible: flags at a bound, beyond the prior, and where it may stand for
something else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.errors import InputError

EDGE = 0.01  # of the range between the bounds
BEYOND = 2.0  # prior standard deviations
SILENT = 0.9  # posterior over prior standard deviation: the data said nothing
SLIGHT = 0.05  # change of a factor that needs no proof
TIED = 0.9  # |correlation| from which on two parameters are known together, not each by itself
KEPT = 0.5  # share of a change that should be there whatever modes are left out

Kind = Literal["bound", "prior", "silent", "form"]


@dataclass(frozen=True, slots=True)
class Flag:
    """A parameter that needs an engineer's eye.

    Attributes
    ----------
    parameter : str
    kind : {"bound", "prior", "silent", "form"}
        At a bound; changed by more than two prior standard deviations; moved though the data do not
        determine it; not proven, so that it may take up an error of the model's form.
    factor : float
    text : str
    """

    parameter: str
    kind: Kind
    factor: float
    text: str


def plausibility(
    parameters: ParameterSet, x: Float, ratio: Float | None = None
) -> tuple[Flag, ...]:
    """Flags of updated parameters, in their order; none if all is plausible.

    Parameters
    ----------
    parameters : ParameterSet
    x : (p,) float64
    ratio : (p,) float64, optional
        Posterior over prior standard deviation.
    """
    x = np.asarray(x, dtype=np.float64)
    told = np.zeros(x.size) if ratio is None else np.asarray(ratio, dtype=np.float64)
    if x.shape != (len(parameters),) or told.shape != x.shape:
        raise InputError(f"x {x.shape} and ratio {told.shape} for {len(parameters)} parameters")
    low, high = parameters.bounds()
    margin = EDGE * (high - low)
    away = x / parameters.std()
    a = parameters.factors(x)
    flags: list[Flag] = []
    for i, p in enumerate(parameters.parameters):  # over parameters: text for people
        if x[i] <= low[i] + margin[i] or x[i] >= high[i] - margin[i]:
            side, end = ("lower", p.lower) if x[i] <= low[i] + margin[i] else ("upper", p.upper)
            text = (
                f"{_said(p, a[i])} is at its {side} bound {_found(p, end)}; the error may lie "
                "elsewhere"
            )
            flags.append(Flag(p.name, "bound", float(a[i]), text))
        if abs(away[i]) > BEYOND:
            text = (
                f"{_said(p, a[i])} is {abs(away[i]):.1f} prior standard deviations from the "
                "nominal value"
            )
            flags.append(Flag(p.name, "prior", float(a[i]), text))
        if told[i] > SILENT and abs(away[i]) > 0.25:
            text = (
                f"{_said(p, a[i])}, but the data do not determine it (posterior/prior "
                f"{told[i]:.2f})"
            )
            flags.append(Flag(p.name, "silent", float(a[i]), text))
    return tuple(flags)


def kept(x: Float, ends: Float) -> Float:
    """Least share of each change that is there with any fold of modes left out, (p,); below 0 it
    turns round.

    Parameters
    ----------
    x : (p,) float64
    ends : (fold, p) float64
        The same without each fold.
    """
    if not len(ends):
        return np.full(x.size, np.nan)
    return np.asarray((ends / np.where(x == 0.0, 1.0, x)).min(axis=0))


def unproven(parameters: ParameterSet, factor: Float, interval: Float, share: Float) -> Bool:
    """Changes (p,) that the test does not prove: the interval of the factor holds 1, or few modes
    carry the change.

    Slight changes of what the deck has need no proof; masses that it lacks do, however light.

    Such a parameter may take up an error of form, or of a region that is no candidate.

    Parameters
    ----------
    factor : (p,) float64
    interval : (p, 2) float64
        Where the candidates that were not updated may be off, too (`posterior.around`).
    share : (p,) float64
        Of `kept`.
    """
    open_ = (interval[:, 0] <= 1) & (interval[:, 1] >= 1)
    slight = np.array([0.0 if p.lump else SLIGHT for p in parameters.parameters])
    return np.asarray((np.abs(factor - 1) > slight) & (open_ | (share < KEPT)))


def _found(p: Parameter, *factors: float) -> str:
    """Factors in words, `0.8 to 1.2`; of a mass that the deck lacks what is added."""
    return " to ".join(f"{p.lump * max(a - 1, 0.0) if p.lump else a:.3g}" for a in factors)


def _said(p: Parameter, factor: float) -> str:
    return f"{p.name}: {'mass' if p.lump else 'factor'} {_found(p, factor)}"


def form_flags(
    parameters: ParameterSet, factor: Float, interval: Float, share: Float, correlation: Float
) -> tuple[Flag, ...]:
    """A flag for each change that is `unproven`; with others that the test tells only together with
    it, these instead.

    Parameters
    ----------
    factor, interval, share
        As in `unproven`.
    correlation : (p, p) float64
        Of x, posterior.
    """
    flags: list[Flag] = []
    for i in np.flatnonzero(
        unproven(parameters, factor, interval, share)
    ).tolist():  # over parameters: text for people
        low, high = interval[i].tolist()
        open_ = low <= 1 <= high
        p = parameters.parameters[i]
        why = (
            [f"its interval, {_found(p, low, high)}, holds {'none' if p.lump else 1}"]
            if open_
            else []
        )
        if share[i] < KEPT:
            turned = "turns round" if share[i] < 0 else f"shrinks to {100 * share[i]:.0f} %"
            why.append(f"its change {turned} when some of the modes are left out")
        tied = [
            n for j, n in enumerate(parameters.names) if j != i and abs(correlation[i, j]) > TIED
        ]
        whence = "it may take up an error of the model's form"
        if open_ and tied:
            whence = f"the test tells it and {', '.join(tied)} together, not each by itself"
        text = f"{_said(p, factor[i])}, but {' and '.join(why)}; {whence}"
        flags.append(Flag(p.name, "form", float(factor[i]), text))
    return tuple(flags)
