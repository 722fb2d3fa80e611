"""What speaks for and against a mode, as the inspector shows it."""

from __future__ import annotations

from nicegui import ui

from ringtrue.core.digits import plus_minus
from ringtrue.studio.shell import fact, heading
from ringtrue.study.results import IdentifiedModes


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
