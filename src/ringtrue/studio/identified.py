"""What was identified: the diagrams, their poles, what speaks for and against a mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from nicegui import ui

from ringtrue.core.digits import plus_minus
from ringtrue.core.modes import ModeSet
from ringtrue.studio.shell import fact, heading
from ringtrue.study.results import IdentifiedModes, IdentifyStage

HAMMER = "hammer"  # as a choice names the modes of FRFs


@dataclass(frozen=True, slots=True)
class Pole:
    """A pole of a diagram.

    Attributes
    ----------
    frequency : float, Hz
    order : int
    damping, std_frequency, std_damping : float
    """

    frequency: float
    order: int
    damping: float
    std_frequency: float
    std_damping: float


def sources(stage: IdentifyStage | None) -> dict[str, IdentifiedModes]:
    """Whose diagrams there are, by the names that a choice has for them."""
    if stage is None:
        return {}
    found: dict[str, IdentifiedModes] = {}
    if stage.hammer is not None and stage.hammer.diagrams:
        found[HAMMER] = stage.hammer
    found |= {r.record: r for r in stage.ambient_records if r.diagrams}
    return found


def nearest_pole(found: IdentifiedModes, frequency: float, order: int) -> Pole | None:
    """The pole of an order that is nearest to a frequency, Hz, to all its digits."""
    best: Pole | None = None
    for diagram in found.diagrams:
        poles = diagram.poles
        for k in np.flatnonzero(poles.order == order).tolist():
            f = float(poles.frequencies[k])
            if best is None or abs(f - frequency) < abs(best.frequency - frequency):
                best = Pole(
                    f,
                    order,
                    float(poles.damping[k]),
                    float(poles.std_frequency[k]),
                    float(poles.std_damping[k]),
                )
    return best


def pole_shape(found: IdentifiedModes, pole: Pole) -> ModeSet | None:
    """The shape of a pole; None where the poles hold something else, as those of FRFs do."""
    channels = found.diagram.modes.channels
    for diagram in found.diagrams:
        poles = diagram.poles
        at = np.flatnonzero((poles.order == pole.order) & (poles.frequencies == pole.frequency))
        if at.size and poles.shape.shape[0] == len(channels):
            shape = poles.shape[:, at[:1]]
            return ModeSet(poles.frequencies[at[:1]], poles.damping[at[:1]], shape, channels)
    return None


def evidence(found: IdentifiedModes, k: int) -> None:
    """The evidence of mode `k` of a diagram, from 0."""
    shown = found.diagram
    std = shown.uncertainty
    heading(f"{shown.classes[k]} mode")
    fact(
        "Frequency",
        f"{plus_minus(float(shown.modes.frequencies[k]), float(std.frequency[k]), 6)} Hz",
    )
    damping = plus_minus(100 * float(shown.modes.damping[k]), 100 * float(std.damping[k]), 3)
    fact("Damping ratio", f"{damping} %")
    fact("MPC", f"{shown.mpc[k]:.3f}")
    fact("Confidence", f"{shown.modes.confidence[k]:.2f}")
    if shown.remarks[k]:
        ui.label(shown.remarks[k]).classes("text-sm")
    number = shown.classes[:k].count("natural")
    if shown.classes[k] == "natural" and number < len(found.reasons):
        words = found.reasons[number]
    else:
        others = [j for j, kind in enumerate(shown.classes) if kind != "natural"]
        words = found.others.sentences()[others.index(k)] if k in others else ""
    if words:
        heading("Evidence")
        ui.label(words).classes("text-xs")
