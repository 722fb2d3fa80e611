"""Motions that sensors measure: orders of derivative, SI units, the kinds of FRF that they give,
one made another.
"""

from __future__ import annotations

import re
from typing import Literal, get_args

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.signals import Channel, FrfKind, Quantity

Motion = Literal["displacement", "velocity", "acceleration"]
DERIVATIVE: dict[str, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}
SI_UNIT: dict[str, str] = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
FRF_KIND: dict[str, FrfKind] = {
    "displacement": "receptance",
    "velocity": "mobility",
    "acceleration": "accelerance",
}
OF_KIND: dict[str, Motion] = {FRF_KIND[m]: m for m in get_args(Motion)}
POWER: dict[str, int] = {
    FRF_KIND[motion]: n for motion, n in DERIVATIVE.items()
}  # of s, over the receptance
ANGULAR: dict[str, Quantity] = {  # the same about an axis, of the same kind of FRF
    "displacement": "rotation",
    "velocity": "angular velocity",
    "acceleration": "angular acceleration",
    "force": "moment",
}
LINEAR: dict[str, Quantity] = {about: along for along, about in ANGULAR.items()}  # type: ignore[misc]
UNIT: dict[str, str] = {
    **SI_UNIT,
    "force": "N",
    "rotation": "rad",
    "angular velocity": "rad/s",
    "angular acceleration": "rad/s^2",
    "moment": "N*m",
}
FORCES = ("force", "moment")
MOTIONS: dict[str, FrfKind] = {
    **FRF_KIND,
    **{ANGULAR[motion]: kind for motion, kind in FRF_KIND.items()},
}

_ABOUT = re.compile(r"[+-]R[XYZ]$")
BASE = "base "  # how the name of a base begins


def channel(name: str, quantity: Quantity) -> Channel:
    """A motion or force at a point; of a rotation or moment where the name says so, as `3+RX`."""
    kind = ANGULAR.get(quantity, quantity) if _ABOUT.search(name) else quantity
    return Channel(name, kind, UNIT.get(kind, ""))


def base_motion(name: str) -> Channel:
    """The input of transmissibilities, the motion of a base; by its name no response is its driving
    point.
    """
    return Channel(BASE + name, "acceleration", SI_UNIT["acceleration"])


def as_motion(h: Complex, freqs: Float, motion: str, wanted: str, decay: float = 0.0) -> Complex:
    """FRFs of one motion as those of another; the line at 0 Hz becomes 0 without a window.

    Parameters
    ----------
    h : (f, ...) complex128, SI
    freqs : (f,) float64, Hz
    motion, wanted : str
        Quantities; what is no motion stays what it is.
    decay : float, 1/s
        Of an exponential window that is in the FRFs: they stand at iω + decay.
    """
    if motion == wanted or not {motion, wanted} <= set(DERIVATIVE):
        return h
    s = decay + 2j * np.pi * freqs.reshape(-1, *(1,) * (h.ndim - 1))
    factor = np.where(s == 0, 1, s) ** (DERIVATIVE[wanted] - DERIVATIVE[motion])
    return np.asarray(h * np.where(s == 0, 0, factor))
