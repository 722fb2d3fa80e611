"""Sensors at a place where two nodes are: on the structure, not on what holds it; else by their number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.testmodel import TestModel
from ringtrue.io.nastran.reader import read_deck
from ringtrue.study.opened import Opened
from ringtrue.study.placing import shared_places

# a bar on two bushes of no length; its middle node 2 and, beside it, node 30 that nothing holds or uses
DECK = """BEGIN BULK
GRID,{ground[0]},,0.,0.,0.,,123456
GRID,{hub[0]},,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,30,,1.,0.,0.
GRID,{hub[1]},,2.,0.,0.
GRID,{ground[1]},,2.,0.,0.
SPC1,1,123456,{ground[1]}
GRID,40,,3.,0.,0.,,123456
CBAR,1,1,{hub[0]},2,0.,0.,1.
CBAR,2,1,2,{hub[1]},0.,0.,1.
PBAR,1,1,1.-3,1.-6,1.-6,1.-6
MAT1,1,2.+11,,.3,7850.
CBUSH,11,2,{ground[0]},{hub[0]},,,,0
CBUSH,12,2,{ground[1]},{hub[1]},,,,0
PBUSH,2,K,1.+6,1.+6,1.+6,1.+6,1.+6,1.+6
ENDDATA
"""


@pytest.mark.parametrize(("hub", "ground"), [((1, 3), (101, 103)), ((101, 103), (1, 3))])
def test_of_two_nodes_at_one_place_the_sensor_sits_on_the_moving_one(
    tmp_path: Path, hub: tuple[int, int], ground: tuple[int, int]
) -> None:
    (tmp_path / "bar.bdf").write_text(DECK.format(hub=hub, ground=ground))
    opened = Opened(read_deck(tmp_path / "bar.bdf"), 1.0)
    xyz = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    test = TestModel(
        np.arange(4), xyz, ("a", "b", "c", "d"), np.arange(4), np.tile([0.0, 0, 1], (4, 1)), np.zeros((0, 2), np.int64)
    )
    seen = opened.observation(test, 0.01)
    read = [opened.analysis.dofs.node[row.indices].tolist() for row in seen.matrix]
    assert read == [[hub[0]], [2], [hub[1]], [40]]  # 40 is held, too, but nothing else is there


@pytest.mark.parametrize("wanted", [2, 30])
def test_of_two_moving_nodes_at_one_place_the_one_with_the_number_of_the_point_is_read(
    tmp_path: Path, wanted: int
) -> None:
    """A hinge: the bar ends at node 2, another one begins at node 30."""
    text = DECK.format(hub=(1, 3), ground=(101, 103)).replace("CBAR,2,1,2,", "CBAR,2,1,30,")
    (tmp_path / "bar.bdf").write_text(text.replace("ENDDATA", "CBUSH,13,2,2,30,,,,0\nENDDATA"))
    opened = Opened(read_deck(tmp_path / "bar.bdf"), 1.0)
    test = TestModel(
        np.array([wanted]),
        np.array([[1.0, 1e-3, 0]]),
        ("a",),
        np.array([wanted]),
        np.eye(3)[[2]],
        np.zeros((0, 2), int),
    )
    seen = opened.observation(test, 0.01)
    assert opened.analysis.dofs.node[seen.matrix.indices].tolist() == [wanted]


@pytest.mark.parametrize(("point", "spring", "told"), [(7, 1e6, True), (2, 1e6, False), (7, 1e12, False)])
def test_a_place_whose_nodes_move_apart_is_said(tmp_path: Path, point: int, spring: float, told: bool) -> None:
    """A soft hinge is; one that is as good as rigid, and a point with the number of a node, are not."""
    text = DECK.format(hub=(1, 3), ground=(101, 103)).replace("CBAR,2,1,2,", "CBAR,2,1,30,")
    hinge = f"CBUSH,13,3,2,30,,,,0\nPBUSH,3,K,{','.join([f'{spring:.1E}'] * 6)}\nENDDATA"
    (tmp_path / "bar.bdf").write_text(text.replace("ENDDATA", hinge))
    opened = Opened(read_deck(tmp_path / "bar.bdf"), 1.0)
    test = TestModel(
        np.array([point]),
        np.array([[1.0, 0, 0]]),
        ("a",),
        np.array([point]),
        np.array([[0.0, 0, 1]]),
        np.zeros((0, 2), np.int64),
    )
    notes = shared_places(opened, test, opened.modes(500.0).modes)
    assert [n.split(", and one")[0] for n in notes] == told * [
        "point 7: nodes that do not move alike are at the place (2 and 30 at point 7)"
    ]
