"""Files are known by their content: each intact file of the corpus under a name that says nothing
or something else.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from readers import READERS, SEEDS

from ringtrue.errors import DataError
from ringtrue.io.recognition import Format, format_of
from ringtrue.io.records import read_record

FORMATS = {
    ".bdf": Format.DECK,
    ".op2": Format.OP2,
    ".op4": Format.OP4,
    ".f06": Format.F06,
    ".pch": Format.PUNCH,
    ".uff": Format.UFF,
    ".h5": Format.HDF5,
    ".mat": Format.MATLAB,
    ".npy": Format.NPY,
    ".npz": Format.NPZ,
    ".xlsx": Format.XLSX,
    ".wav": Format.WAVE,
    ".tdms": Format.TDMS,
    ".lvm": Format.LVM,
    ".json": Format.JSON,
    ".toml": Format.TOML,
    ".hb": Format.HARWELL_BOEING,
    ".rua": Format.HARWELL_BOEING,
    ".csv": Format.TEXT,
    ".txt": Format.TEXT,
}
EVERY = sorted(SEEDS.glob("*/*"))
# kinds that name other files, or whose reader needs a rate that it does not get here
READ = [p for p in EVERY if p.parent.name not in ("study", "log", "record")]


@pytest.mark.parametrize(
    "name", ["data", "data.dat", "data.csv", "data.h5", "data.mat"]
)
def test_the_content_tells_the_format(name: str, tmp_path: Path) -> None:
    for path in EVERY:
        if path.suffix != ".mtx":
            shutil.copy(path, tmp_path / name)
            assert format_of(tmp_path / name) is FORMATS[path.suffix], path.name


@pytest.mark.parametrize("path", READ, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_readers_take_files_of_any_name(path: Path, tmp_path: Path) -> None:
    shutil.copy(path, tmp_path / "data.dat")
    for read in READERS[path.parent.name]:
        read(tmp_path / "data.dat")


@pytest.mark.parametrize("path", sorted(SEEDS.glob("record/*")), ids=lambda p: p.name)
def test_a_record_of_any_name_is_the_same(path: Path, tmp_path: Path) -> None:
    shutil.copy(path, tmp_path / "data.dat")
    rate = 200.0 if path.suffix == ".npy" else None
    by_name, by_content = (
        read_record(p, rate, gaps=True) for p in (path, tmp_path / "data.dat")
    )
    np.testing.assert_array_equal(by_name.data, by_content.data)
    assert by_name.channels == by_content.channels


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("fs = 100\n0.1 0.2\n0.3 0.1\n", Format.TEXT),
        ("[Header]\nRate: 100\n[Data]\n0.1;0.2\n0.3;0.1\n", Format.TEXT),
        ("[[pick]]\nfrequency = 2.5\n", Format.TOML),
        ('[{"a": 1}]', Format.JSON),
        ('{"a": [\n1, 2,\n3, 4\n]}', Format.JSON),
        ("[plan]\nband = [\n  0, 100,\n  200, 300\n]\n", Format.TOML),
        ("     7\n    -1\n     3\n    12\n     5\n", Format.TEXT),
        (f"{'1,' * 5000}x\n", Format.TEXT),
        ("$ C A S E    C O N T R O L   of old\nGRID,1,,0.,0.,0.\n", Format.DECK),
        ("sName\tx\ty\nch5\t1\t2\nch6\t2\t2\n", Format.TEXT),
        ("", Format.EMPTY),
    ],
)
def test_texts(text: str, kind: Format, tmp_path: Path) -> None:
    (tmp_path / "x").write_text(text)
    assert format_of(tmp_path / "x") is kind


def test_what_is_not_known_is_said_with_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "x.wav").write_bytes(bytes(range(200, 256)) + b"\x00" * 9)
    with pytest.raises(DataError, match="looked for: a Nastran deck, OP2 of Nastran"):
        format_of(tmp_path / "x.wav")
    with pytest.raises(DataError, match="no such file"):
        format_of(tmp_path / "none")
