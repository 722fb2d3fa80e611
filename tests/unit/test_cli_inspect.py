"""`ringtrue inspect`: what is in any file, and which command takes it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from readers import SEEDS
from test_cli import Capture, call, refused

import ringtrue as rt
from ringtrue.errors import DataError

KINDS = {
    "choice/c.json": ("choice", "--choice"),
    "choice/c.toml": ("choice", "--choice"),
    "deck/fixed.bdf": ("deck", "ringtrue check"),
    "frf/a.mat": ("FRFs", "ringtrue ema"),
    "frf/a.npz": ("FRFs", "ringtrue ema"),
    "frf/binary.uff": ("FRFs", "ringtrue ema"),
    "frf/groups.txt": ("FRFs", "ringtrue ema"),
    "frf/keys.csv": ("FRFs", "ringtrue ema"),
    "frf/other.h5": ("FRFs", "ringtrue ema"),
    "frf/own.h5": ("FRFs", "ringtrue ema"),
    "frf/spectrum.lvm": ("FRFs", "ringtrue ema"),
    "log/campaign.json": ("log", "test.log ="),
    "matrices/a00.op4": ("matrices", ""),
    "matrices/csr.npz": ("matrices", ""),
    "matrices/k.h5": ("matrices", ""),
    "matrices/k.mat": ("matrices", ""),
    "matrices/s.hb": ("matrices", ""),
    "modes/real.csv": ("modes", "ringtrue correlate"),
    "modes/real.h5": ("modes", "ringtrue correlate"),
    "modes/real.json": ("modes", "ringtrue correlate"),
    "modes/real.uff": ("modes", "ringtrue correlate"),
    "modes/t.xlsx": ("modes", "ringtrue correlate"),
    "record/a.tdms": ("record", "ringtrue oma"),
    "record/a.wav": ("record", "ringtrue oma"),
    "record/german.csv": ("record", "ringtrue ema"),
    "record/one.lvm": ("record", "ringtrue ema"),
    "record/own.h5": ("record", "ringtrue ema"),
    "record/own.uff": ("record", "ringtrue ema"),
    "record/v73.mat": ("record", "ringtrue"),
    "results/m.f06": ("results", "ringtrue convert"),
    "results/m.h5": ("results", "ringtrue convert"),
    "results/m.op2": ("results", "ringtrue convert"),
    "results/m.pch": ("results", "ringtrue convert"),
    "sensitivity/s.f06": ("sensitivities", ""),
    "sensitivity/s.op2": ("sensitivities", ""),
    "sensors/geometry.uff": ("sensors", "--sensors"),
    "sensors/s.csv": ("sensors", "--sensors"),
    "sensors/s.xlsx": ("sensors", "--sensors"),
    "statics/s.csv": ("statics", "residual ="),
    "study/small.toml": ("study", "ringtrue run"),
}


@pytest.mark.parametrize("name", KINDS)
def test_each_kind_under_a_name_that_says_nothing(name: str, tmp_path: Path) -> None:
    kind, command = KINDS[name]
    path = tmp_path / "some file"
    shutil.copy(SEEDS / name, path)
    found = rt.inspect_file(path)
    assert found.problem == ""
    assert [part.kind for part in found.parts] == [kind]
    assert command in "".join(found.commands)
    assert all(f"'{path}'" in line or f'"{path}"' in line for line in found.commands)


def test_one_block_a_file(tmp_path: Path, capsys: Capture) -> None:
    t = np.arange(400) / 200
    np.savetxt(
        tmp_path / "r.dat",
        np.column_stack([t, np.sin(t), np.cos(t)]),
        delimiter=",",
        header="time [s],1+Z [g],2+Z [g]",
        comments="",
    )
    np.save(tmp_path / "tower", np.random.default_rng(0).standard_normal((500, 3)))
    status, out, _ = call(capsys, "inspect", tmp_path / "r.dat", tmp_path / "tower.npy")
    assert status == 0
    assert out.splitlines() == [
        f"{tmp_path}/r.dat: text",
        "  record: 2 channels, 400 samples, rate 200 Hz, duration 2 s",
        "    names: 1+Z [g], 2+Z [g]",
        f"    ringtrue oma {tmp_path}/r.dat",
        f"{tmp_path}/tower.npy: a NumPy array",
        "  record: 3 channels, 500 samples, no rate in the file",
        "    names: ch1, ch2, ch3",
        f"    ringtrue oma {tmp_path}/tower.npy --rate HZ",
    ]


def test_json_and_a_file_that_cannot_be_read(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "bad.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + b"\x00" * 50)
    (tmp_path / "odd").write_bytes(b"\x01\x02\x00\x03")
    good = SEEDS / "modes/real.json"
    files = (tmp_path / "bad.h5", tmp_path / "odd", good, tmp_path / "none")
    status, out, _ = call(capsys, "inspect", *files, "--json", "-")
    bad, odd, modes, none = json.loads(out)["files"]
    assert status == 2
    assert "not a readable HDF5" in bad["problem"]
    assert "looked for" in odd["problem"]
    assert "no such file" in none["problem"]
    assert modes["problem"] is None
    assert modes["parts"][0]["modes"] == 2
    assert modes["parts"][0]["commands"] == [f"ringtrue correlate {good} MODEL.bdf"]


def test_a_universal_file_of_several_things(tmp_path: Path) -> None:
    both = (SEEDS / "sensors/geometry.uff").read_bytes() + (
        SEEDS / "frf/own.uff"
    ).read_bytes()
    (tmp_path / "all.dat").write_bytes(both)
    found = rt.inspect_file(tmp_path / "all.dat")
    assert [part.kind for part in found.parts] == ["FRFs", "sensors"]


def test_a_short_table_is_no_record(tmp_path: Path) -> None:
    (tmp_path / "xyz.txt").write_text("x,y,z\n1,2,3\n4,5,6\n9,8,9\n")
    (part,) = rt.inspect_file(tmp_path / "xyz.txt").parts
    assert (part.kind, part.commands) == ("table", ())
    assert part.values["names"] == ["x", "y", "z"]
    (tmp_path / "job.inp").write_text("*Heading\n*Node\n1, 0., 0., 0.\n")
    assert "Abaqus" in rt.inspect_file(tmp_path / "job.inp").problem


def test_a_deck_of_any_name_is_correlated_and_checked(
    tmp_path: Path, capsys: Capture
) -> None:
    shutil.copy(rt.example_deck(), tmp_path / "model.txt")
    modes = rt.solve_modes(rt.read_deck(tmp_path / "model.txt"), count=3)
    rt.write_modes(tmp_path / "m.json", modes)
    status, out, _ = call(
        capsys, "correlate", tmp_path / "m.json", tmp_path / "model.txt"
    )
    assert status == 0
    assert "100.0" in out


def test_a_missing_file_is_an_error_in_python(tmp_path: Path, capsys: Capture) -> None:
    with pytest.raises(DataError, match="no such file"):
        rt.inspect_file(tmp_path / "none")
    assert "no such file" in refused(capsys, "oma", tmp_path / "none")
