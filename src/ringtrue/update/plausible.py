"""Is an updated parameter physically plausible: flags where a bound is reached or a change is beyond its prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import InputError

EDGE = 0.01  # of the range between the bounds
BEYOND = 2.0  # prior standard deviations
SILENT = 0.9  # posterior over prior standard deviation: the data said nothing

Kind = Literal["bound", "prior", "silent"]


@dataclass(frozen=True, slots=True)
class Flag:
    """A parameter that needs an engineer's eye.

    Attributes
    ----------
    parameter : str
    kind : {"bound", "prior", "silent"}
        At a bound; changed by more than two prior standard deviations; moved though the data do not determine it.
    factor : float
    text : str
    """

    parameter: str
    kind: Kind
    factor: float
    text: str


def plausibility(parameters: ParameterSet, x: Float, ratio: Float | None = None) -> tuple[Flag, ...]:
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
            text = f"{p.name}: factor {a[i]:.3g} is at its {side} bound {end:.3g}; the error may lie elsewhere"
            flags.append(Flag(p.name, "bound", float(a[i]), text))
        if abs(away[i]) > BEYOND:
            text = f"{p.name}: factor {a[i]:.3g} is {abs(away[i]):.1f} prior standard deviations from the nominal value"
            flags.append(Flag(p.name, "prior", float(a[i]), text))
        if told[i] > SILENT and abs(away[i]) > 0.25:
            text = f"{p.name}: factor {a[i]:.3g}, but the data do not determine it (posterior/prior {told[i]:.2f})"
            flags.append(Flag(p.name, "silent", float(a[i]), text))
    return tuple(flags)
