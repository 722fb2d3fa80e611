"""A deck in the unit system that the user states."""

from __future__ import annotations

from ringtrue.checks.materials import check_units
from ringtrue.cli.show import err
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.model.edit import in_seconds
from ringtrue.model.model import Model


def stated(model: Model, units: str) -> Model:
    """The model with its time in seconds; what is not plausible of it in the stated units is
    told.
    """
    warn_of_units(model, units)
    return in_seconds(model, UNIT_SYSTEMS[units])


def warn_of_units(model: Model, units: str) -> None:
    """Print what is not plausible of a deck in a unit system."""
    for finding in check_units(model, units):
        err.print(str(finding))
