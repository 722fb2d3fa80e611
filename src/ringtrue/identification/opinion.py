"""What another method finds: a second opinion on a record or on FRFs."""

from __future__ import annotations

from dataclasses import dataclass

from ringtrue.core.modes import ModeSet, Uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class SecondOpinion:
    """Modes by one method.

    Attributes
    ----------
    modes : ModeSet
    uncertainty : Uncertainty
        NaN where the method states none.
    reasons, notes : tuple of str
    """

    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
