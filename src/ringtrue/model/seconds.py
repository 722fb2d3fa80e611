"""A deck whose unit of time is not the second (mm-kg-ms), with its time in seconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.units import UnitSystem
from ringtrue.errors import UnsupportedError
from ringtrue.model.model import Model

DASHPOTS = {  # card -> fields that hold a force over a velocity
    "PDAMP": ("B",),
    "CDAMP2": ("B",),
    "CDAMP4": ("B",),
    "PVISC": ("CE", "CR"),
    "PBUSH": ("B1", "B2", "B3", "B4", "B5", "B6"),
}


def in_seconds(model: Model, unit: UnitSystem) -> Model:
    """The model with frequencies in Hz, whatever its unit of time; the same where that is the
    second.

    Of K φ = λ M φ with λ in 1/T² the mass matrix times T² has λ in 1/s²: PARAM,WTMASS takes the
    factor, and CM2 for masses of DMIG.

    Raises
    ------
    UnsupportedError
        If the deck has dashpots: their values are forces over velocities in its own unit of time.
    """
    if unit.time == 1:
        return model
    if found := _dashpots(model):
        raise UnsupportedError(
            f"{found}: dashpots of a deck whose unit of time is {unit.time:g} s are not read; "
            "leave them out, or write "
            "the deck in a system with seconds"
        )
    square = unit.time**2
    scaled = {name: model.param(name, 1.0) * square for name in ("WTMASS", "CM2")}
    return replace(model, params={**model.params, **scaled}, time=unit.time)


def _dashpots(model: Model) -> str:
    """The first thing of a model that damps by velocity; empty without one."""
    for card, fields in DASHPOTS.items():
        for name in fields:
            if card in model and (np.nan_to_num(model[card][name]) != 0).any():
                return f"{card} {name}"
    if model.case.b2gg or model.case.b2pp:
        return "B2GG or B2PP"
    return next((f"PARAM {name}" for name in ("ALPHA1", "ALPHA2") if model.param(name, 0.0)), "")
