"""The door to parsers of others: limits of depth, size, time and memory; files that point at other
files.
"""

from __future__ import annotations

import io
import json
import logging
import zipfile
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from readers import FAULTS, SEEDS
from scipy import sparse

from ringtrue.errors import ConfigError, DataError
from ringtrue.io.foreign import door
from ringtrue.io.foreign.door import read_apart
from ringtrue.io.foreign.parsers import (
    DEEPEST,
    OUTSIDE,
    json_value,
    open_hdf5,
    read_json,
    read_npz,
    read_sheet,
    toml_value,
)
from ringtrue.io.matrices import read_matrices
from ringtrue.io.records import read_record


def test_depth_and_width_of_texts() -> None:
    deep = "[" * (DEEPEST - 1) + "]" * (DEEPEST - 1)
    assert json_value(deep, "a") is not None
    for text in (f"[[{deep}]]", "[" * 100_000):
        with pytest.raises(DataError, match=f"more than {DEEPEST} deep"):
            json_value(text, "a")
        with pytest.raises(ConfigError, match=f"more than {DEEPEST} deep"):
            toml_value(f"a = {text}", "a", ConfigError)
    with pytest.raises(DataError, match="integer of 400 digits"):
        json_value("9" * 400, "a")
    with pytest.raises(DataError, match="not a readable JSON"):
        json_value("9" * 5000, "a")
    with pytest.raises(DataError, match=r"a:2: not JSON"):
        json_value("[\n1,,2]", "a")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings_of_editors(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.json").write_bytes(
        json.dumps({"wind": "Böen"}, ensure_ascii=False).encode(encoding)
    )
    assert read_json(tmp_path / "a.json") == {"wind": "Böen"}


def _outside(folder: Path) -> list[Path]:
    """Files whose samples stand in another one: by a link, by external storage, by a virtual data
    set.
    """
    with h5py.File(folder / "secret.h5", "w") as file:
        file["y"] = np.arange(20.0).reshape(10, 2)
    np.arange(20.0).tofile(folder / "secret.bin")
    with h5py.File(folder / "link.h5", "w") as file:
        file["y"] = h5py.ExternalLink("secret.h5", "y")
    with h5py.File(folder / "storage.h5", "w") as file:
        file.create_dataset(
            "y", (10, 2), np.float64, external=[(str(folder / "secret.bin"), 0, 160)]
        )
    layout = h5py.VirtualLayout((10, 2), np.float64)
    layout[:] = h5py.VirtualSource(folder / "secret.h5", "y", (10, 2))
    with h5py.File(folder / "virtual.h5", "w") as file:
        file.create_virtual_dataset("y", layout)
    return [folder / f"{name}.h5" for name in ("link", "storage", "virtual")]


def test_hdf5_files_that_point_outside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in _outside(tmp_path):
        with pytest.raises(DataError, match=rf"{path.name}: .*secret.*{OUTSIDE}=1"):
            read_record(path, 100.0)
    monkeypatch.setenv(OUTSIDE, "1")
    for path in _outside(tmp_path):
        with open_hdf5(path) as file:
            assert file["y"][9, 1] == 19.0


def test_a_parser_that_ends_its_process_ends_not_this_one() -> None:
    """And the next file is read by a new one."""
    for _ in range(3):
        with pytest.raises(DataError, match="ended its process"):
            read_apart(
                "matlab", FAULTS / "matrices" / "ends_the_process.mat", "MATLAB file"
            )
        assert set(
            read_apart("matlab", SEEDS / "matrices" / "k4.mat", "MATLAB file")
        ) == {"K", "M"}


def test_a_parser_without_end_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door, "_SECONDS", 1.0)
    path = FAULTS / "record" / "object_header_without_end.h5"
    with pytest.raises(DataError, match="did not come back in 1 s"), open_hdf5(path):
        pass
    with open_hdf5(SEEDS / "record" / "own.h5") as file:
        assert "record" in file


def test_a_child_that_was_ended_from_outside_is_replaced() -> None:
    path = SEEDS / "matrices" / "sym.mtx"
    read_matrices(path)
    assert door._child is not None
    door._child.process.kill()
    door._child.process.wait()
    assert read_matrices(path)["sym"].shape == (6, 6)


def test_the_answer_to_an_interrupted_question_is_not_taken_for_the_next_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(_: object) -> object:
        raise KeyboardInterrupt

    read_matrices(SEEDS / "matrices" / "sym.mtx")
    with monkeypatch.context() as patch:
        patch.setattr(door.pickle, "load", interrupted)
        with pytest.raises(KeyboardInterrupt):
            read_matrices(SEEDS / "matrices" / "sym.mtx")
    assert read_matrices(SEEDS / "matrices" / "dense.mtx")["dense"].nnz == 16
    assert set(read_matrices(SEEDS / "matrices" / "k4.mat").matrices) == {"K", "M"}


def test_memory_of_a_parser_has_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("y", data=np.zeros(1 << 22), compression="gzip")
    with open_hdf5(tmp_path / "a.h5"):
        pass
    monkeypatch.setattr(door, "_MEMORY", 1 << 24)
    door._tried.clear()
    door._close()  # one that has read it before has the memory already
    with pytest.raises(DataError, match="MemoryError"), open_hdf5(tmp_path / "a.h5"):
        pass


def test_large_workbooks(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.append(["point", "x"])
    book.save(tmp_path / "a.xlsx")
    with zipfile.ZipFile(tmp_path / "a.xlsx") as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    row = b'<row r="1"><c r="XFD1"><v>1</v></c></row>'
    wide = b"".join(
        row.replace(b'r="1"', b'r="%d"' % k).replace(b"XFD1", b"XFD%d" % k)
        for k in range(1, 400)
    )
    for rows, told in (
        (b" " * 70_000_000, "unfolds to 67 MB"),
        (wide, "more than 1000000 cells"),
    ):
        sheet = b"<worksheet xmlns='http://schemas.openxmlformats.org/spreadsheetml/2006/main'><sheetData>"
        parts["xl/worksheets/sheet1.xml"] = sheet + rows + b"</sheetData></worksheet>"
        with zipfile.ZipFile(tmp_path / "b.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
            for name, part in parts.items():
                archive.writestr(name, part)
        with pytest.raises(DataError, match=told):
            read_sheet(tmp_path / "b.xlsx")
    with pytest.raises(DataError, match="no sheet 'lines'; Allowed: Sheet"):
        read_sheet(tmp_path / "a.xlsx", "lines")


def test_an_archive_that_unfolds_to_far_more_than_it_is(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(1 << 24))
    with pytest.raises(DataError, match="unfold to"):
        read_npz(tmp_path / "a.npz")


def test_sparse_matrices_of_each_form(tmp_path: Path) -> None:
    a = sparse.random_array((7, 5), density=0.4, rng=np.random.default_rng(0))
    for kind in ("csr", "csc", "coo"):
        sparse.save_npz(tmp_path / "a.npz", a.asformat(kind))
        np.testing.assert_array_equal(
            read_matrices(tmp_path / "a.npz")["a"].toarray(), a.toarray()
        )


def test_sound_that_was_cut_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    raw = (SEEDS / "record" / "a.wav").read_bytes()
    whole = read_record(SEEDS / "record" / "a.wav").data
    (tmp_path / "cut.wav").write_bytes(raw[:-40])
    with caplog.at_level(logging.WARNING):
        got = read_record(tmp_path / "cut.wav").data
    np.testing.assert_array_equal(got, whole[:, :-10])
    assert "the file is cut" in caplog.text
    open_end = bytearray(raw)
    open_end[4:8] = b"\xff\xff\xff\xff"  # the recorder was not stopped
    (tmp_path / "open.wav").write_bytes(open_end)
    np.testing.assert_array_equal(read_record(tmp_path / "open.wav").data, whole)


def test_complex_and_large_endian_numbers_of_matlab(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(
        tmp_path / "a.mat",
        {
            "z": np.array([[1 + 2j, 3]]),
            "none": np.zeros((0, 0)),
            "l": np.array([[True]]),
        },
    )
    found = read_apart("matlab", tmp_path / "a.mat", "MATLAB file")
    np.testing.assert_array_equal(found["z"], [[1 + 2j, 3]])
    assert found["l"].dtype == np.uint8
    text = io.StringIO()
    print(sorted(found), file=text)
    assert text.getvalue().strip() == "['l', 'none', 'z']"
