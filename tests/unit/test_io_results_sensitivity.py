"""The design sensitivity matrix in each of its files: one made matrix, read back."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from op2_writer import Op2Writer

from ringtrue.decks.nastran.results.sensitivity import read_sensitivities
from ringtrue.errors import DataError

COLUMNS = np.array(
    [
        [1, 1, 4, 1, 0, 1, 0, 0, 0],
        [2, 9, 5, 12, 3, 1, 0, 0, 0],
        [3, 9, 5, 40, 3, 1, 0, 0, 0],
    ]
)
VALUES = np.array([[2.5, -1.25e3], [0.125, -4e-3], [7.0, 1.5e-9]])  # response, variable


def write_op2(path: Path, word: int = 4, order: str = "<") -> None:
    writer = Op2Writer(order, word)
    writer.head()
    writer.table("DSCMCOL", [COLUMNS.ravel().tolist()])
    writer.matrix("DSCM2", VALUES.T)
    writer.table(
        "DESTAB",
        [
            [1, 1, b"X1", b"", 0.1, 2.0, -0.5, 0.0],
            [2, 7, b"X7", b"", 0.1, 2.0, -0.5, 0.0],
        ],
    )
    writer.write(path)


def write_f06(path: Path) -> None:
    heads = (
        "DRESP1  ID=        1  RESPONSE TYPE= EIGN        MODE   ID=        1",
        "DRESP1  ID=        9  RESPONSE TYPE= DISP        GRID   ID=       12  COMP NO=    3",
        "DRESP1  ID=        9  RESPONSE TYPE= DISP        GRID   ID=       40  COMP NO=    3",
    )
    text = "      D E S I G N   S E N S I T I V I T Y   M A T R I X   O U T P U T\n"
    for head, row in zip(heads, VALUES, strict=True):
        text += (
            f"0  {'-' * 100}\n     {head}\n     SUBCASE =        1     RESP VALUE =   "
            f"1.2345E+00\n   {'-' * 100}\n"
        )
        text += "        DESIGN VARIABLE       COEFFICIENT        DESIGN VARIABLE       COEFFICIENT\n"
        text += (
            "".join(
                f"{v:12d}  X{v:<8d}{x:16.4E}    "
                for v, x in zip((1, 7), row, strict=True)
            )
            + "\n"
        )
    path.write_text(text)


PAGE = """1    A CHECK PROBLEM   D200                     DECEMBER   5, 2011  MSC.NASTRAN  6/17/05   PAGE   120
      SENSITIVITY RUN                                                                                0
0

0    MATRIX  DSCM2       CONTINUED


"""


def write_matrix(path: Path) -> None:
    """Laid out as MSC Nastran 2005 prints its matrix with PARAM,OPTEXIT,4: a column a response,
    broken by a page.
    """
    rule = f"     {'-' * 100}\n"
    text = (
        f"{' ' * 50}-----   DESIGN VARIABLES   -----\n\n{rule}            INTERNAL       "
        f"DESVAR\n{rule}"
    )
    for internal, v in enumerate((1, 7), 1):
        text += (
            f"{internal:20d}{v:14d}      X{v:<12d}   1.0000E-01        1.0000E+00        "
            "1.0000E+01\n"
        )
    text += "   -----   IDENTIFICATION OF COLUMNS IN THE DESIGN SENSITIVITY  -----\n"
    text += "   -----     MATRIX THAT ARE ASSOCIATED WITH DRESP1  ENTRIES    -----\n\n"
    text += (
        f"            COLUMN         DRESP1         RESPONSE\n{rule}{1:17d}{1:16d}        "
        "EIGN    \n\n"
    )
    text += "             -----  STATICS RESPONSES  -----\n"
    for column, grid in ((2, 12), (3, 40)):
        text += (
            f"{column:17d}{9:16d}        DISP{grid:20d}                               3      "
            "         1\n"
        )
    text += "   -----     MATRIX THAT ARE ASSOCIATED WITH DRESP2  ENTRIES    -----\n"
    text += f"{4:17d}{11:16d}               1\n"
    text += (
        "0      MATRIX DSCM2    (GINO NAME 101 ) IS A REAL               4 COLUMN X          "
        " 2 ROW RECTANG  MATRIX.\n"
    )
    for column, row in enumerate((*VALUES, [5.0, 6.0]), 1):
        text += f"0COLUMN      {column}      ROWS      1 THRU      2     {'-' * 50}\n ROW    \n"
        text += PAGE if column == 3 else ""
        text += "      1)  " + "".join(f"{x:12.4E}" for x in row) + "\n"
    text += "0THE NUMBER OF NON-ZERO TERMS IN THE DENSEST COLUMN =       2\n"
    path.write_text(text)


def write_h5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["NASTRAN/RESULT/OPTIMIZATION/DSCMCOL"] = COLUMNS
        file["NASTRAN/RESULT/OPTIMIZATION/DSCM2"] = VALUES.T


def write_csv(path: Path) -> None:
    lines = ["response,grid,component,1,7"]
    lines += [
        f"{r},{g},{c},{a!r},{b!r}"
        for (r, g, c), (a, b) in zip(LABELS, VALUES.tolist(), strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")


LABELS = [(1, 0, 0), (9, 12, 3), (9, 40, 3)]
WRITERS = {
    "s.op2": write_op2,
    "s.f06": write_f06,
    "m.f06": write_matrix,
    "s.h5": write_h5,
    "s.csv": write_csv,
}


@pytest.mark.parametrize("name", WRITERS)
def test_formats(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name)
    found = read_sensitivities(tmp_path / name)
    assert list(zip(found.response, found.grid, found.component, strict=True)) == LABELS
    assert found.variable.tolist() == (
        [1, 2] if name == "s.h5" else [1, 7]
    )  # only the others name them
    np.testing.assert_allclose(found.values, VALUES, rtol=1e-4)


@pytest.mark.parametrize(("order", "word"), [(">", 4), ("<", 8), (">", 8)])
def test_op2_layouts(tmp_path: Path, order: str, word: int) -> None:
    write_op2(tmp_path / "s.op2", word, order)
    np.testing.assert_array_equal(read_sensitivities(tmp_path / "s.op2").values, VALUES)


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_files(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(40):
        (tmp_path / name).write_bytes(whole[: rng.integers(0, int(0.9 * len(whole)))])
        found, message = None, ""
        try:
            found = read_sensitivities(tmp_path / name)
        except DataError as e:
            message = str(e)
        assert found is not None or str(tmp_path / name) in message
        # only a text cut between two responses, or an OP2 behind its matrix, can be read at all
        assert found is None or found.values.shape[0] < 3 or name == "s.op2"


def test_files_without_sensitivities(tmp_path: Path) -> None:
    for name in ("a.f06", "a.op2", "a.csv", "a.h5"):
        (tmp_path / name).write_bytes(b"nothing of the kind\n" * 20)
        with pytest.raises(DataError, match=name):
            read_sensitivities(tmp_path / name)
    with pytest.raises(DataError, match="no such file"):
        read_sensitivities(tmp_path / "b.op2")
    (tmp_path / "b.pch").write_text("{}")
    with pytest.raises(DataError, match=r"no sensitivities: .* allowed are OP2"):
        read_sensitivities(tmp_path / "b.pch")
