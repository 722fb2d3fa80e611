"""Modes as tables: either way round, of any hand, written and read back, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import DataError
from ringtrue.io.modes import read_modes, read_std, write_modes


def table(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "modes.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    shapes = rng.standard_normal((4, 3)) + 1j * rng.standard_normal((4, 3))
    shapes[2, 1] = np.nan
    modes = ModeSet(
        np.array([3.0, 5.5, 9.25]),
        np.array([0.01, np.nan, 0.02]),
        shapes,
        ("1+X", "1+Y", "2+X", "2-Y"),
    )
    spread = Uncertainty.independent(
        np.array([0.01, 0.02, np.nan]), np.full(3, 1e-3), np.zeros((4, 3))
    )
    write_modes(tmp_path / "m.csv", modes, spread)
    found = read_modes(tmp_path / "m.csv")
    assert found.channels == modes.channels
    np.testing.assert_allclose(found.shapes, modes.shapes, rtol=1e-8)
    np.testing.assert_allclose(found.frequencies, modes.frequencies)
    np.testing.assert_allclose(found.damping, modes.damping)
    np.testing.assert_allclose(read_std(tmp_path / "m.csv")[0], spread.frequency)
    np.testing.assert_allclose(read_std(tmp_path / "m.csv")[1], spread.damping)


def test_a_mode_a_row_with_decimal_commas(tmp_path: Path) -> None:
    path = table(
        tmp_path,
        "Mode;Frequenz [Hz];Dämpfung [%];101+Z;102+Z\n2;16,1;0,7;-0,3+0,1i;1\n1;6,37;0,8;1;0,5\n",
    )
    found = read_modes(path)
    assert found.frequencies.tolist() == [6.37, 16.1]
    assert found.damping == pytest.approx([0.008, 0.007])
    np.testing.assert_allclose(
        found.rows(["101+Z", "102+Z"]).shapes, [[1, -0.3 + 0.1j], [0.5, 1]]
    )


def test_frequencies_alone_and_angular_ones(tmp_path: Path) -> None:
    found = read_modes(
        table(tmp_path, "frequency [rad/s]\n62.8318530718\n31.4159265359\n")
    )
    assert found.frequencies == pytest.approx([5.0, 10.0])
    assert found.channels == ()
    assert np.isnan(read_std(tmp_path / "modes.csv")[0]).all()


@pytest.mark.parametrize(
    ("head", "hertz"),
    [
        ("Natural frequency [Hz]", 1.0),
        ("frequency_hz", 1.0),
        ("f [kHz]", 1e3),
        ("Frequency (rpm)", 1 / 60),
    ],
)
def test_titles_and_units_of_frequencies(
    tmp_path: Path, head: str, hertz: float
) -> None:
    path = table(
        tmp_path, f"No.,{head},± [Hz],Modal damping [%]\n1,6,0.5,0.8\n2,30,,0.7\n"
    )
    found = read_modes(path)
    assert found.frequencies == pytest.approx([6 * hertz, 30 * hertz])
    assert found.damping == pytest.approx([0.008, 0.007])
    assert found.channels == ()
    np.testing.assert_allclose(read_std(path)[0], [0.5, np.nan])


def test_a_table_as_a_spreadsheet_saves_it_abroad(tmp_path: Path) -> None:
    path = tmp_path / "modes.csv"
    path.write_bytes("f [Hz];6,37;16,1\nDämpfung [%];0,8;0,7\n".encode("latin-1"))
    found = read_modes(path)
    assert found.frequencies.tolist() == [6.37, 16.1]
    assert found.damping == pytest.approx([0.008, 0.007])


def test_the_first_sheet_of_a_workbook(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for row in (
        ["mode", 1, 2],
        ["f [Hz]", 4.5, 7],
        ["zeta", 0.01, 0.02],
        ["3+Z", 1, -0.25],
    ):
        book.active.append(row)
    book.save(tmp_path / "modes.xlsx")
    found = read_modes(tmp_path / "modes.xlsx")
    assert (found.frequencies.tolist(), found.damping.tolist()) == (
        [4.5, 7.0],
        [0.01, 0.02],
    )
    assert found.shapes.tolist() == [[1.0, -0.25]]
    assert not np.iscomplexobj(found.shapes)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a,b\n1,2\n", "no row or column `frequency [Hz]`; there are a, b"),
        ("", "empty, no modes in it"),
        ("frequency [Hz],1+Z\n", "no mode below `frequency [Hz]`"),
        ("frequency,1+Z\n3.0,much\n", "1+Z is 'much'; it must be a number"),
        ("frequency,1+Z\n3.0,inf\n", "1+Z is 'inf'; it must be a number"),
        (
            "frequency,damping\n3.0,1.5\n4.0,0.8\n",
            "`damping`: 1.5 of critical? What is in percent has [%]",
        ),
        ("frequency,3,4\n1+Z,1,2\n1+Z,3,4\n", "`1+Z` occurs twice"),
        (
            "mode,f FEM [Hz],f test [Hz]\n1,3,4\n",
            "`f FEM [Hz]` and `f test [Hz]` are both frequency",
        ),
    ],
)
def test_what_is_no_table_of_modes(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(DataError) as e:
        read_modes(table(tmp_path, text))
    assert "modes.csv: " in str(e.value)
    assert told in str(e.value)
