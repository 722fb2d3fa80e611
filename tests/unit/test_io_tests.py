"""FRF files, modes and sensor sheets."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from ringtrue.core.modes import ModeSet, Norm, Uncertainty
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.frfs import read_frfs, write_frfs
from ringtrue.io.modes import modes_to_json, read_modes, read_std, write_modes
from ringtrue.io.sheets import read_sensor_sheet

DATA = Path(__file__).parents[2].parent / "shared/data"
data_here = pytest.mark.skipif(not DATA.is_dir(), reason=f"no reference data at {DATA}")
RNG = np.random.default_rng(5)
H = RNG.standard_normal((9, 3, 2)) + 1j * RNG.standard_normal((9, 3, 2))


def frfs() -> FrfSet:
    out = tuple(Channel(f"{i}+Z", "acceleration", "m/s^2") for i in (1, 2, 3))
    inputs = (Channel("2+Z", "force", "N"), Channel("3-Z", "force", "N"))
    return FrfSet(
        H,
        np.arange(1, 10) * 0.5,
        out,
        inputs,
        np.full(H.shape, 0.9),
        np.array([4.0, 5.0]),
        "accelerance",
        0.3,
    )


@pytest.mark.parametrize("name", ["f.h5", "f.uff"])
def test_frfs_go_round(tmp_path: Path, name: str) -> None:
    write_frfs(tmp_path / name, frfs())
    got = read_frfs(tmp_path / name)
    np.testing.assert_allclose(got.data, H, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(got.coherence, 0.9, rtol=1e-6)
    assert [c.id for c in got.inputs] == ["2+Z", "3-Z"]
    assert got.driving_points() == [(1, 0)]
    assert got.kind == "accelerance"


def test_npz_turns_axes_and_refuses(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", freq=np.arange(1, 10.0), H1=H.transpose(2, 1, 0))
    np.testing.assert_array_equal(read_frfs(tmp_path / "a.npz").data, H)
    for name, arrays, words in (
        (
            "none",
            {"freq": np.arange(1, 10.0), "H1": np.zeros((0, 3, 9), complex)},
            "no references",
        ),
        ("key", {"freq": np.arange(9.0)}, "H1 missing"),
        ("shape", {"freq": np.arange(8.0), "H1": H.transpose(2, 1, 0)}, "must be"),
        (
            "falling",
            {"freq": np.arange(9.0)[::-1], "H1": H.transpose(2, 1, 0)},
            "must rise",
        ),
    ):
        np.savez(tmp_path / f"{name}.npz", **arrays)
        with pytest.raises(DataError, match=words):
            read_frfs(tmp_path / f"{name}.npz")


@data_here
def test_uff_of_vendors() -> None:
    got = read_frfs(DATA / "uff/beam.uff")
    assert got.data.shape == (64000, 3, 1)
    assert got.inputs[0].id == "21+X"
    with pytest.raises(DataError, match="no FRFs"):
        read_frfs(DATA / "uff/BK_4_channels.uff")
    np.testing.assert_array_equal(
        read_modes(DATA / "uff/uff55_translation.uff").frequencies, [10, 12, 13]
    )


@pytest.mark.parametrize("name", ["m.json", "m.h5", "m.uff"])
@pytest.mark.parametrize("kind", ["real", "complex"])
def test_modes_go_round(tmp_path: Path, name: str, kind: str) -> None:
    shapes = RNG.standard_normal((3, 2)) + (
        1j * RNG.standard_normal((3, 2)) if kind == "complex" else 0
    )
    modes = ModeSet(
        np.array([1.0, 2.5]),
        np.array([0.01, 0.02]),
        shapes,
        ("1+X", "1+Y", "1+Z"),
        Norm.UNSCALED,
    )
    write_modes(tmp_path / name, modes)
    got = read_modes(tmp_path / name)
    np.testing.assert_allclose(got.frequencies, modes.frequencies, rtol=1e-5)
    np.testing.assert_allclose(got.damping, modes.damping, rtol=1e-4)
    np.testing.assert_allclose(got.shapes, shapes, rtol=1e-5, atol=1e-5)
    assert got.channels == modes.channels


def test_json_is_null_where_unknown(tmp_path: Path) -> None:
    modes = ModeSet(np.array([1.0]), np.array([np.nan]), np.ones((1, 1)), ("1+X",))
    table = modes_to_json(modes)
    assert table["modes"][0]["damping"] is None
    assert table["modes"][0]["std_frequency_hz"] is None
    std = Uncertainty.independent(np.array([0.1]), np.array([0.2]), np.zeros((1, 1)))
    assert modes_to_json(modes, std, ["why"])["modes"][0]["std_damping"] == 0.2
    (tmp_path / "m.json").write_text("[]")
    with pytest.raises(DataError, match="not a table of modes"):
        read_modes(tmp_path / "m.json")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("frequency_hz", None, "mode 1 has no frequency_hz"),
        ("damping", "x", "mode 1: damping is 'x'; it must be a number"),
        (
            "std_frequency_hz",
            [0.1],
            r"mode 1: std_frequency_hz is \[0.1\]; it must be a number",
        ),
    ],
)
def test_json_of_modes_with_a_wrong_number(
    tmp_path: Path, key: str, value: object, message: str
) -> None:
    table = modes_to_json(
        ModeSet(np.array([1.0]), np.array([0.01]), np.ones((1, 1)), ("1+X",))
    )
    table["modes"][0][key] = value
    (tmp_path / "m.json").write_text(json.dumps(table))
    with pytest.raises(DataError, match=message):
        read_std(tmp_path / "m.json")


SHEET = [
    ["point", "x", "y", "z", "direction", "unit", "sensitivity", "group", "channel"],
    [101, 0, 0, 0.5, "+X", "g", 0.1, "frame", ""],
    [101, "", "", "", "-Y", "g", 0.1, "", ""],
    [102, 1, 0, 0, "0.6 0 0.8", "m/s^2", 1, "", "skewed"],
    [103, 1, 2, 3, "90, 30", "m/s^2", 1, "", "angles"],
    [104, 0, 0, 1, "", "", "", "", ""],
]


def write_sheet(path: Path, rows: list[list[object]]) -> Path:
    if path.suffix == ".csv":
        path.write_text("\n".join(";".join(map(str, r)) for r in rows))
        return path
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    page = book.create_sheet("lines")
    for row in [["from", "to"], [101, 102]]:
        page.append(row)
    book.save(path)
    return path


@pytest.mark.parametrize("ext", [".csv", ".xlsx"])
def test_sensor_sheet(tmp_path: Path, ext: str) -> None:
    lines = tmp_path / "lines.csv"
    lines.write_text("101,102\n")
    sheet = read_sensor_sheet(
        write_sheet(tmp_path / f"s{ext}", SHEET), lines if ext == ".csv" else None
    )
    model = sheet.model
    assert model.channels == ("101+X", "101-Y", "skewed", "angles")
    c = np.sqrt(3) / 2
    np.testing.assert_allclose(
        model.axes, [[1, 0, 0], [0, -1, 0], [0.6, 0, 0.8], [0, c, 0.5]], atol=1e-12
    )
    np.testing.assert_array_equal(model.lines, [[101, 102]])
    assert model.groups[0] == "frame"
    assert sheet.channels[0].sensitivity == 0.1
    assert not sheet.notes


@pytest.mark.parametrize(
    ("row", "column", "value", "words"),
    [
        (0, 4, "directon", "did you mean 'direction'"),
        (0, 1, "", "columns x are missing"),
        (1, 1, "one", "x is 'one'"),
        (1, 4, "up", "direction 'up'"),
        (1, 6, 0, "sensitivity"),
        (1, 5, "furlong", "unit 'furlong'"),
        (1, 5, "rad/s", "angular velocity: a sheet is of translations"),
        (3, 8, "101+X", "occurs twice"),
    ],
)
def test_sheet_refuses(
    tmp_path: Path, row: int, column: int, value: object, words: str
) -> None:
    rows = [list(r) for r in SHEET]
    rows[row][column] = value
    with pytest.raises(DataError, match=words):
        read_sensor_sheet(write_sheet(tmp_path / "s.csv", rows))


def test_sheet_notes_doubtful_orientations(tmp_path: Path) -> None:
    rows = [["point", "x", "y", "z", "direction", "channel"]]
    rows += [[1, 0, 0, 0, d, f"a{d}"] for d in ("X", "-X")]
    rows += [[2, 0, 0, 1, d, f"b{d}"] for d in ("X", "Y", "-Z")]
    rows += [[3, 0, 1, 1, d, f"c{d}"] for d in ("X", "1 1 0")]
    notes = read_sensor_sheet(write_sheet(tmp_path / "s.csv", rows)).notes
    assert len(notes) == 3
    assert all(
        w in n
        for w, n in zip(("oppose", "left-handed", "right angles"), notes, strict=True)
    )


def test_a_sheet_tells_what_a_record_does_not(tmp_path: Path) -> None:
    """Volts and channels without a unit by the sheet; units of the record and channels elsewhere
    stand.
    """
    rows = [list(r) for r in SHEET] + [
        [104, "", "", "", "+Z", "N", 0.002, "", "F:104+Z"]
    ]
    sheet = read_sensor_sheet(write_sheet(tmp_path / "s.csv", rows))
    assert "F:104+Z" not in sheet.model.channels
    channels = (
        Channel("101+X"),
        Channel("101-Y", unit="V"),
        Channel("skewed", "velocity", "m/s"),
        Channel("F:104+Z"),
        Channel("other"),
    )
    record = TimeHistory(np.ones((5, 4)), 100.0, channels)
    found, notes = sheet.scaled(record)
    np.testing.assert_allclose(found.data[:, 0], [98.0665, 98.0665, 1.0, 500.0, 1.0])
    assert [c.unit for c in found.channels] == ["m/s^2", "m/s^2", "m/s", "N", ""]
    assert notes == (
        "3 channels without a unit taken as the sensor sheet says: 101+X 101-Y F:104+Z",
        "without a unit, and not on the sensor sheet: other",
    )
    assert sheet.scaled(found) == (found, notes[1:])


def test_a_record_without_names_has_those_of_the_sheet(tmp_path: Path) -> None:
    """Its motions; with another number of channels none are given: where the force is, nothing
    tells.
    """
    rows = [list(r) for r in SHEET] + [
        [104, "", "", "", "+Z", "N", 0.002, "", "F:104+Z"]
    ]
    sheet = read_sensor_sheet(write_sheet(tmp_path / "s.csv", rows))
    names = sheet.model.channels
    bare = tuple(Channel(f"ch{i + 1}") for i in range(len(names) + 1))
    record = TimeHistory(np.ones((len(bare), 4)), 100.0, bare)
    found, notes = sheet.scaled(record.pick([c.id for c in bare[:-1]]))
    assert tuple(c.id for c in found.channels) == names
    assert "in its order: 101+X" in notes[0]
    by_name, _ = sheet.scaled(
        replace(found, data=record.data[:-1], channels=tuple(Channel(n) for n in names))
    )
    np.testing.assert_array_equal(found.data, by_name.data)
    same, notes = sheet.scaled(record)
    assert same.channels == record.channels
    assert notes == (
        f"without a unit, and not on the sensor sheet: {' '.join(c.id for c in bare)}",
    )


@pytest.mark.parametrize(
    ("order", "read"),
    [
        (
            [f"ch{i:02d}" for i in range(1, 13)],
            [f"ch{i:02d}" for i in range(1, 13)],
        ),  # 10 to 12 are on the sheet
        (
            [f"ch{i}" for i in range(12, 0, -1)],
            [f"ch{i}" for i in range(1, 13)],
        ),  # all are, in another order
        # one is, at another place
        (["ch2", *"abcdefghijk"], [f"ch{i}" for i in range(1, 13)]),
    ],
)
def test_names_by_number_on_the_sheet(
    tmp_path: Path, order: list[str], read: list[str]
) -> None:
    rows = "".join(f"{k},{k},0,0,Z,{name}\n" for k, name in enumerate(order, start=1))
    (tmp_path / "s.csv").write_text("point,x,y,z,direction,channel\n" + rows)
    record = TimeHistory(
        np.ones((12, 4)), 100.0, tuple(Channel(f"ch{i}") for i in range(1, 13))
    )
    found, _ = read_sensor_sheet(tmp_path / "s.csv").scaled(record)
    assert [c.id for c in found.channels] == read
