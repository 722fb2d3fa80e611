"""Motions that sensors measure: orders of derivative, SI units, and the kinds of FRF that they give."""

from __future__ import annotations

from typing import Literal

from ringtrue.core.signals import Channel, FrfKind

Motion = Literal["displacement", "velocity", "acceleration"]
DERIVATIVE: dict[str, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}
SI_UNIT: dict[str, str] = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
FRF_KIND: dict[str, FrfKind] = {"displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance"}
POWER: dict[str, int] = {FRF_KIND[motion]: n for motion, n in DERIVATIVE.items()}  # of s, over the receptance

BASE = "base "  # how the name of a base begins


def base_motion(name: str) -> Channel:
    """The input of transmissibilities, the motion of a base; by its name no response is its driving point."""
    return Channel(BASE + name, "acceleration", SI_UNIT["acceleration"])
