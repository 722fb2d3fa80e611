"""What is drawn and counted of a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ringtrue.plots.scene import regions
from ringtrue.study.results import Scene
from ringtrue.study.run import run_study


def test_a_region_has_the_colour_of_what_changes_it_and_little_else() -> None:
    """A density of all parts does not cover the thickness of one, in whatever order they stand."""
    part = np.arange(3)
    scene = Scene(part, np.eye(3), part[None, :], part[:1], np.zeros((0, 2), int), part[:0], ("a", "b", "c"))
    changed = {"thickness of b": [1], "density": [0, 1, 2], "far away": []}
    for order in (list(changed), list(reversed(changed))):
        view = regions(scene, {k: changed[k] for k in order}, {"density": "× 1.1"})
        colour = {x["name"]: x["color"] for x in view.payload["legend"]}
        drawn = view.payload["skin"]["colors"]
        assert drawn == [colour["density"], colour["thickness of b"], colour["density"]]
        assert list(colour) == [k + ", not drawn" * (k == "far away") for k in order]


def test_cards_are_those_of_the_deck(tmp_path: Path) -> None:
    """A PBARL makes a PBAR that the deck does not have."""
    nodes = [f"GRID,{i},,{i}.,0.,0." for i in range(1, 5)]
    bars = [f"CBAR,{i},{p},{i},{i + 1},0.,0.,1." for i, p in ((1, 1), (2, 1), (3, 2))]
    cards = ["PBARL,1,1,,ROD", ",.1", "PBAR,2,1,.01,1.-5,1.-5,2.-5", "MAT1,1,2.1+11,,.3,7850.", "SPC1,1,123456,1"]
    deck = ["SOL 103", "CEND", "SPC = 1", "BEGIN BULK", *nodes, *bars, *cards, "ENDDATA"]
    (tmp_path / "bar.bdf").write_text("\n".join(deck))
    (tmp_path / "study.toml").write_text('[model]\ndeck = "bar.bdf"\n')
    found = run_study(tmp_path / "study.toml", until="model").results["model"].cards
    assert found == {"CBAR": 3, "GRID": 4, "MAT1": 1, "PBAR": 1, "PBARL": 1, "SPC1": 1}
