"""Where the points of a sheet are on a model, with the sheet turned, shifted, and off its nodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ringtrue as rt
from ringtrue.demos import frame
from ringtrue.virtual.measurements import write_sheet


def test_a_turned_sheet_is_laid_onto_its_nodes_and_back(tmp_path: Path) -> None:
    (tmp_path / "frame.bdf").write_text(frame.deck())
    model = rt.read_deck(tmp_path / "frame.bdf")
    test = frame.test_model()
    turn = Rotation.from_rotvec([0.1, -0.3, 0.7]).as_matrix()
    shift = np.array([5.0, -2.0, 1.0])
    xyz = test.xyz @ turn.T + shift
    turned = replace(test, xyz=xyz, axes=test.axes @ turn.T)
    write_sheet(tmp_path / "sensors.csv", turned, turned.channels)
    lost = rt.place_sensors(model, tmp_path / "sensors.csv")
    assert lost.far.size
    placed = rt.place_sensors(model, tmp_path / "sensors.csv", align="points")
    assert placed.node.tolist() == placed.points.tolist() == test.points.tolist()
    # the digits of the sheet
    assert placed.distance == pytest.approx(np.zeros(test.points.size), abs=1e-4)
    assert not placed.far.size
    node = int(test.points[4])
    assert placed.on_sheet(node) == pytest.approx(xyz[4], abs=1e-4)
    with pytest.raises(rt.InputError, match="node 2: not a node of the model"):
        placed.on_sheet(2)
    with pytest.raises(rt.InputError, match="allowed are points, nearest"):
        rt.place_sensors(model, tmp_path / "sensors.csv", align="point")  # type: ignore[arg-type]


def test_a_check_names_the_rows_that_it_means(tmp_path: Path) -> None:
    deck = rt.example_deck().read_text().replace("ENDDATA", "GRID,9,,5.,0.,0.\nENDDATA")
    (tmp_path / "floors.bdf").write_text(deck)
    found = rt.check_deck(tmp_path / "floors.bdf", units="SI")
    (one,) = (f for f in found.findings if f.card == "GRID")
    assert one.ids == (9,)
    assert found.rigid is not None
    assert found.rigid.mass.mass == pytest.approx(3.0)
    (tmp_path / "frame.bdf").write_text(frame.deck())
    judged = rt.check_deck(tmp_path / "frame.bdf").implausible
    assert [name for name, findings in judged.items() if not findings] == ["SI"]
