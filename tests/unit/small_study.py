"""The frame of three storeys (`ringtrue.demos.frame`) as a small study, and what tests alone need."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ringtrue.core.modes import ModeSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.demos.frame import (
    BLOCK,
    CORNERS,
    DAMPING,
    FMAX,
    FULL,
    HITS,
    MODEL,
    RATE,
    REFERENCES,
    SETTINGS,
    TEST,
    TRUTH,
    candidates,
    deck,
    modal,
    node,
    signals,
    test_model,
    write_data,
    write_study,
)
from ringtrue.study.opened import Opened

__all__ = (
    "BLOCK",
    "CORNERS",
    "DAMPING",
    "FMAX",
    "FULL",
    "HITS",
    "MODEL",
    "RATE",
    "REFERENCES",
    "SETTINGS",
    "TEST",
    "TRUTH",
    "candidates",
    "deck",
    "modal",
    "node",
    "signals",
    "test_model",
    "write_data",
    "write_study",
)
test_model.__test__ = False  # type: ignore[attr-defined]

WHOLE = """
[[candidate]]
name = "stiffness"
targets = ["MAT1 1 E", "MAT1 2 E", "MAT1 3 E", "MAT1 10 E"]

[[candidate]]
name = "density"
targets = ["MAT1 1 RHO", "MAT1 2 RHO", "MAT1 3 RHO", "MAT1 10 RHO"]
"""  # candidates over the whole frame


def measured_modes(deck: Path, fmax: float) -> ModeSet:
    """The modes of a deck at the channels of the test."""
    opened = Opened(read_deck(deck), 1.0)
    test = test_model()
    modes = opened.modes(fmax).modes
    shapes = opened.observation(test, 0.01)(modes.shapes)
    return replace(modes, shapes=shapes, labels=test.channels)
