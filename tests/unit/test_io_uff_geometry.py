"""Geometry of universal files as sensor sheet and wireframe."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.modes import ModeSet
from ringtrue.errors import DataError
from ringtrue.io.uff.functions import write_test_model
from ringtrue.plots.scene import test_modes as drawn_modes

DATA = Path(__file__).parents[2].parent / "shared/data/uff"
data_here = pytest.mark.skipif(not DATA.is_dir(), reason=f"needs {DATA}")


def uff(path: Path, **sets: str) -> Path:
    """A universal file of these data sets, `set15="..."`."""
    marked = (
        f"    -1\n{k.removeprefix('set'):>6}\n{v}    -1\n" for k, v in sets.items()
    )
    path.write_text("".join(marked))
    return path


MILLIMETRES = (
    "         5mm (newton)        2         1\n"
    + "".join(f"{x:25.17E}" for x in (1000.0, 1.0, 1.0)).replace("E", "D")
    + "\n   0.0\n"
)
# x of the frame points along -Y, z along Z
TURNED = (
    "         7         0         0         8         1\nturned\n"
    "  0.00000E+00  0.00000E+00  5.00000E+02  0.00000E+00 -1.00000E+00  5.00000E+02\n"
    "  0.00000E+00  0.00000E+00  6.00000E+02\n"
)


def test_frames_units_and_lines(tmp_path: Path) -> None:
    nodes = (
        "         1         0         7         8  1.00000E+03  0.00000E+00  0.00000E+00\n"
        "         2         7         0         8  1.00000E+03  0.00000E+00  0.00000E+00\n"
        "         3         0         0         8  0.00000E+00  0.00000E+00  2.50000E+02\n"
    )
    trace = "         1         5         8\nframe\n         1         2         0         2         3\n"
    path = uff(
        tmp_path / "g.txt", set164=MILLIMETRES, set18=TURNED, set15=nodes, set82=trace
    )
    sheet = rt.read_sensors(path)
    model = sheet.model
    np.testing.assert_array_equal(model.points, [1, 2, 3])
    np.testing.assert_allclose(
        model.xyz, [[1, 0, 0], [0, -1, 0.5], [0, 0, 0.25]], atol=1e-12
    )
    np.testing.assert_array_equal(model.lines, [[1, 2], [2, 3]])
    assert model.channels[:4] == ("1+X", "1+Y", "1+Z", "2+X")
    np.testing.assert_allclose(
        model.axes[:3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12
    )
    assert [c.id for c in sheet.channels] == list(model.channels)


def test_elements_become_lines(tmp_path: Path) -> None:
    nodes = "".join(
        f"{n:10d}         0         0        11\n"
        + "".join(f"{x:25.16E}" for x in (n, 0, 0))
        + "\n"
        for n in range(1, 10)
    )
    rod = "         1        21         2         1         7         2\n         0         1         1\n         1         9\n"
    quad = "         2        94         1         1         7         4\n         1         2         3         4\n"
    brick = "         3       115         1         1         7         8\n" + "".join(
        f"{n:10d}" for n in range(1, 9)
    )
    path = uff(tmp_path / "g.uff", set2411=nodes, set2412=f"{rod}{quad}{brick}\n")
    lines = rt.read_sensors(path).model.lines.tolist()
    assert lines[0] == [1, 9]
    assert lines[1:5] == [[1, 2], [2, 3], [3, 4], [1, 4]]
    assert len(lines) == 1 + 12  # the face of the brick is the quadrilateral


def test_what_cannot_be_placed_is_refused(tmp_path: Path) -> None:
    node = "         1         0         7         8  1.00000E+00  0.00000E+00  0.00000E+00\n"
    round_frame = TURNED.replace("         7         0 ", "         7         1 ", 1)
    path = uff(tmp_path / "g.uff", set18=round_frame, set15=node)
    with pytest.raises(
        DataError, match="motion of point 1 is in frame 7, which is cylindrical"
    ):
        rt.read_sensors(path)
    trace = "         1         2         8\nframe\n         1         4\n"
    path = uff(tmp_path / "h.uff", set15=node, set82=trace)
    with pytest.raises(DataError, match=r"name nodes that are not there: \[4\]"):
        rt.read_sensors(path)


def test_a_written_test_model_is_read_again(tmp_path: Path) -> None:
    model = rt.read_sensors(sheet_of(tmp_path)).model
    write_test_model(tmp_path / "again.uff", model)
    again = rt.read_sensors(tmp_path / "again.uff").model
    np.testing.assert_array_equal(again.points, model.points)
    np.testing.assert_allclose(again.xyz, model.xyz, atol=1e-6)


def sheet_of(folder: Path) -> Path:
    path = folder / "sensors.csv"
    path.write_text("point,x,y,z,direction\n1,0,0,0,Z\n2,1.5,0,2,-X\n")
    return path


@data_here
def test_geometry_of_vendors() -> None:
    stator = rt.read_sensors(DATA / "TestLab 161 164 18 15 82.uff").model
    assert (stator.points.size, len(stator.lines)) == (36, 30)
    np.testing.assert_allclose(stator.xyz[0], [-2.4, -0.95, 0])
    np.testing.assert_allclose(stator.axes[0], [-1, 0, 0], atol=1e-6)  # of SYS1
    plate = rt.read_sensors(DATA / "2411 and 2414.uff").model
    assert (plate.points.size, len(plate.lines)) == (441, 840)  # 20 x 20 quadrilaterals
    mixed = rt.read_sensors(DATA / "mesh_test_uff2412_mixed.uff").model
    assert (mixed.points.size, len(mixed.lines)) == (5, 8)  # a pyramid
    beam = rt.read_sensors(DATA / "beam.uff").model
    frfs = rt.read_frfs(DATA / "beam.uff")
    assert beam.channels == tuple(c.id for c in frfs.outputs)
    np.testing.assert_allclose(np.linalg.norm(beam.axes, axis=1), 1)


@data_here
def test_shapes_are_drawn_on_the_geometry() -> None:
    model = rt.read_sensors(DATA / "2411 and 2414.uff").model
    z = tuple(c for c in model.channels if c.endswith("+Z"))
    modes = ModeSet(np.array([5.0]), np.array([0.01]), np.ones((len(z), 1)), z)
    test = drawn_modes(model, modes).payload["scene"]["test"]
    assert len(test["names"]) == 441
    assert test["lines"].shape == (840, 2)


@data_here
@pytest.mark.parametrize(
    "name", ["1858.uff", "BK_4_channels.uff", "uff55_translation.uff"]
)
def test_files_without_nodes_say_so(name: str) -> None:
    with pytest.raises(DataError, match="no nodes"):
        rt.read_sensors(DATA / name)
