"""`ringtrue convert`: a results file in, a mode set out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from op2_writer import Op2Writer
from test_io_results_modes import NODES, recorded, write_h5, write_op2

import ringtrue as rt
from ringtrue.cli.main import run
from ringtrue.io.modes import read_modes, read_std


@pytest.mark.parametrize("ending", ["h5", "json", "uff", "csv"])
def test_convert(
    tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    motion = write_op2(tmp_path / "m.op2")
    target = tmp_path / f"out.{ending}"
    assert run(["convert", str(tmp_path / "m.op2"), str(target)]) == 0
    assert "2 modes, 0.31831 to 4.7746 Hz" in capsys.readouterr().out
    modes = read_modes(target)
    rows = [f"{NODES[1]}+{d}" for d in "XYZ"]
    np.testing.assert_allclose(modes.rows(rows).shapes, motion[1, :3], rtol=1e-4)
    again = (
        tmp_path / "again.json"
    )  # what was written is read, too, be it called .h5 like Nastran's
    assert run(["convert", str(target), str(again)]) == 0
    np.testing.assert_allclose(
        read_modes(again).frequencies, modes.frequencies, rtol=1e-6
    )


def test_deflections_and_weight_of_a_static_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two subcases, and OGPWG; in mm-t-s the deflections read as millimetres."""
    moved = np.random.default_rng(0).normal(size=(3, 6, 2))
    writer = Op2Writer()
    records: list[list[object]] = []
    for case in range(2):
        records.append([11, 1, 0, case + 1, 0, 0, 0, 0, 1, 8] + [0] * 136)
        body: list[object] = []
        for node, values in zip(
            NODES.tolist(), moved[:, :, case].tolist(), strict=True
        ):
            body += [10 * node + 1, 1, *values]
        records.append(body)
    writer.table("OUGV1", records)
    weight = np.zeros(78)
    weight[36:45] = np.eye(3).ravel()
    weight[45:57] = [2.5, 0, 0.2, 0.3, 2.5, 0.1, 0, 0.3, 2.5, 0.1, 0.2, 0]
    writer.table("OGPWG", [[1, 13, *[0] * 144], weight.tolist()])
    writer.write(tmp_path / "statics.op2")
    table = tmp_path / "deflections.csv"
    assert run(["convert", str(tmp_path / "statics.op2"), str(table)]) == 0
    assert run(["inspect", str(tmp_path / "statics.op2")]) == 0
    said = capsys.readouterr().out
    assert "2 cases, 18 deflections each" in said
    assert "weight: mass 2.5, x 0.1, y 0.2, z 0.3" in said
    rows = [line.split(",") for line in table.read_text().splitlines()[1:]]
    assert rows[18][:2] == ["subcase 2", f"{NODES[0]}+X"]
    found = np.array([float(r[2]) for r in rows]).reshape(2, 3, 6)
    np.testing.assert_allclose(found, moved.transpose(2, 0, 1), rtol=1e-6)
    metres = rt.read_deflections(tmp_path / "statics.op2", units="mm-t-s").values
    about = np.tile([1e-3] * 3 + [1.0] * 3, 3)
    np.testing.assert_allclose(metres, found.reshape(2, 18) * about, rtol=1e-6)
    assert (
        run(["convert", str(tmp_path / "statics.op2"), str(tmp_path / "modes.h5")]) == 2
    )


@pytest.mark.data
def test_deflections_of_the_h5_of_msc() -> None:
    path = recorded(
        "msc2019/superelements/three_element_types/no_super/noreduction-static.h5"
    )
    found = rt.read_deflections(path)
    assert found.cases == ("subcase 1", "subcase 2", "subcase 3")
    assert found.values[0, found.points.index("1+X")] == pytest.approx(
        5.86206897e-8, rel=1e-8
    )


def test_standard_deviations_are_kept(tmp_path: Path) -> None:
    table = "frequency [Hz],std frequency [Hz],1+Z\n3,0.01,1\n5,0.02,-1\n"
    (tmp_path / "m.csv").write_text(table)
    for source, target in (
        ("m.csv", "m.json"),
        ("m.json", "m.h5"),
        ("m.h5", "again.csv"),
    ):
        assert run(["convert", str(tmp_path / source), str(tmp_path / target)]) == 0
        assert read_std(tmp_path / target)[0].tolist() == [0.01, 0.02]


def test_nastran_h5_is_told_from_our_own(tmp_path: Path) -> None:
    write_h5(tmp_path / "m.h5")
    assert run(["convert", str(tmp_path / "m.h5"), str(tmp_path / "out.json")]) == 0
    assert len(read_modes(tmp_path / "out.json")) == 2


def test_bad_input_is_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_op2(tmp_path / "m.op2")
    (tmp_path / "cut.op2").write_bytes((tmp_path / "m.op2").read_bytes()[:900])
    for source, target, word in (
        ("cut.op2", "o.h5", "cut off"),
        ("no.op2", "o.h5", "no such"),
        ("m.op2", "o.x", "'.x'"),
    ):
        assert run(["convert", str(tmp_path / source), str(tmp_path / target)]) == 2
        assert word in capsys.readouterr().err
    assert not (tmp_path / "o.h5").exists()
