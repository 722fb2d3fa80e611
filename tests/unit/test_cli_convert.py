"""`ringtrue convert`: a results file in, a mode set out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_io_results_modes import NODES, write_h5, write_op2

from ringtrue.cli.main import run
from ringtrue.io.modes import read_modes, read_std


@pytest.mark.parametrize("ending", ["h5", "json", "uff", "csv"])
def test_convert(tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]) -> None:
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
    np.testing.assert_allclose(read_modes(again).frequencies, modes.frequencies, rtol=1e-6)


def test_standard_deviations_are_kept(tmp_path: Path) -> None:
    table = "frequency [Hz],std frequency [Hz],1+Z\n3,0.01,1\n5,0.02,-1\n"
    (tmp_path / "m.csv").write_text(table)
    for source, target in (("m.csv", "m.json"), ("m.json", "m.h5"), ("m.h5", "again.csv")):
        assert run(["convert", str(tmp_path / source), str(tmp_path / target)]) == 0
        assert read_std(tmp_path / target)[0].tolist() == [0.01, 0.02]


def test_nastran_h5_is_told_from_our_own(tmp_path: Path) -> None:
    write_h5(tmp_path / "m.h5")
    assert run(["convert", str(tmp_path / "m.h5"), str(tmp_path / "out.json")]) == 0
    assert len(read_modes(tmp_path / "out.json")) == 2


def test_bad_input_is_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
