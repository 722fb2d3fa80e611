"""Thermal expansion: free bodies without stress, rods between walls, two metals side by side.

A free isotropic body at T = T0 + g·x moves without stress, u = α [(T0 − TREF) x + (g·x) x − g
|x|²/2] (Boley and Weiner 1960). A rod between walls, half of it warmer by ΔT: its middle moves α ΔT
L/4. Two rods tied at both ends: u/L = ΔT (E1 A1 α1 + E2 A2 α2)/(E1 A1 + E2 A2).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.cli.main import run
from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_loaded_deck
from ringtrue.fem.algebra import arm
from ringtrue.model.frames import positions
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.loads import load_vectors

ALPHA, TREF = 1.2e-5, 20.0
HEAD = (
    "CEND\nTEMPERATURE(LOAD) = 4\nSPC = 1\nBEGIN BULK\nMAT1,1,2.+11,,0.3,8000.,1.2-5,20.\n"
    "MAT1,2,1.+11,,0.3,8000.,2.-5\n"
    "PROD,1,1,1.-3,1.-6\nPROD,2,2,3.-3,1.-6\nPSHELL,1,1,.01,1,,1\nPSOLID,1,1\nPBAR,1,1,1.-3,1.-6,2.-6,2.-6\n"
)
AFFINE = np.array([50.0, 30.0, -20.0, 10.0])  # T = 50 + 30 x - 20 y + 10 z
CORNERS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
EDGES = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
]


def solved(path: Path, text: str) -> tuple[Float, Float]:
    """Coordinates (node, 3) and displacements (node, 6)."""
    path.write_text(text)
    model, cases = read_loaded_deck(path)
    with EmbeddedSolver().open(model) as analysis:
        found = analysis.static(load_vectors(model, analysis.dofs, cases))
    return positions(model), found.reshape(-1, 6)


def strained(x: Float, u: Float, slopes: Float) -> float:
    """The largest part of the displacements (n, 3) at x (n, 3) that is neither expansion without
    stress nor rigid.
    """
    g = slopes[1:]
    free = ALPHA * (
        (slopes[0] - TREF + (x @ g)[:, None]) * x - g * (x**2).sum(axis=1, keepdims=True) / 2
    )
    rigid = arm(x)[:, :3].reshape(-1, 6)
    rest = (u - free).ravel()
    rest = rest - rigid @ np.linalg.lstsq(rigid, rest, rcond=None)[0]
    return float(np.abs(rest).max() / np.abs(free).max())


def body(x: Float, elements: str, held: str) -> str:
    T = AFFINE[0] + x @ AFFINE[1:]
    nodes = "".join(
        f"GRID*,{k + 1},,{a!r},{b!r}\n*,{c!r}\n" for k, (a, b, c) in enumerate(x.tolist())
    )
    warm = "".join(f"TEMP*,4,{k + 1},{t!r}\n" for k, t in enumerate(T.tolist()))
    return HEAD + nodes + warm + elements + held


def solid(card: str) -> tuple[Float, str]:
    """A distorted cube of some elements around it."""
    rng = np.random.default_rng(3)
    x = np.array(CORNERS, dtype=float) + 0.15 * rng.uniform(-1, 1, (8, 3))
    if card in ("CHEXA20", "CTETRA10"):
        pairs = EDGES if card == "CHEXA20" else [(0, 1), (1, 3), (0, 3), (0, 4), (1, 4), (3, 4)]
        x = np.concatenate([x, [(x[a] + x[b]) / 2 for a, b in pairs]])
    if card == "CTETRA10":
        return x[[0, 1, 3, 4, *range(8, 14)]], "CTETRA,1,1,1,2,3,4,5,6\n,7,8,9,10\n"
    if card == "CHEXA20":
        order = [*range(1, 9), *range(9, 21)]
        return x, "CHEXA,1,1," + ",".join(map(str, order[:6])) + "\n," + ",".join(
            map(str, order[6:14])
        ) + "\n," + (",".join(map(str, order[14:])) + "\n")
    return x, {
        "CHEXA": "CHEXA,1,1,1,2,3,4,5,6\n,7,8\n",
        "CPENTA": "CPENTA,1,1,1,2,4,5,6,8\nCPENTA,2,1,2,3,4,6,7,8\n",
        "CPYRAM": "CPYRAM,1,1,1,2,3,4,7\nCPYRAM,2,1,1,5,6,2,7\nCPYRAM,3,1,1,4,8,5,7\n",
        "CTETRA": "".join(
            f"CTETRA,{k},1,{a},{b},{c},{d}\n"
            for k, (a, b, c, d) in enumerate(
                [(1, 2, 4, 5), (2, 3, 4, 7), (2, 5, 6, 7), (4, 5, 7, 8), (2, 4, 5, 7)], 1
            )
        ),
    }[card]


@pytest.mark.parametrize("card", ["CHEXA", "CHEXA20", "CPENTA", "CPYRAM", "CTETRA", "CTETRA10"])
def test_free_solids_expand_without_stress(tmp_path: Path, card: str) -> None:
    x, elements = solid(card)
    xyz, u = solved(
        tmp_path / "d.bdf", body(x, elements, "SPC1,1,123,1\nSPC1,1,23,2\nSPC1,1,3,3\n")
    )
    assert strained(xyz, u[:, :3], AFFINE) < 1e-9


@pytest.mark.parametrize(
    "elements",
    [
        "CQUAD4,1,1,1,2,5,4\nCQUAD4,2,1,2,3,6,5\n",
        "CQUADR,1,1,1,2,5,4\nCQUADR,2,1,2,3,6,5\n",
        "CTRIA3,1,1,1,2,5\nCTRIA3,2,1,1,5,4\nCTRIAR,3,1,2,3,6\nCTRIAR,4,1,2,6,5\n",
        "CQUAD4,1,1,1,2,5,4,,0.3\nCQUAD4,2,1,2,3,6,5,,0.3\n",
        "CQUAD8,1,1,1,2,5,4,7,8\n,9,10\nCQUAD4,2,1,2,3,6,5\n",
        "CTRIA6,1,1,1,2,5,7,8,11\nCTRIA3,2,1,1,5,4\nCQUAD4,3,1,2,3,6,5\n",
        "CBAR,1,1,1,2,0.3,0.4,1.\n,,,0.1,0.2,0.3,0.1,0.2,0.3\nCBAR,2,1,2,5,0.3,0.4,1.\n,,,0.1,0.2,0.3,0.1,0.2,0.3\n",
    ],
)
def test_free_shells_and_beams_expand_without_stress(tmp_path: Path, elements: str) -> None:
    """On an inclined plane, along which the temperature varies; beams on offset ends at one
    temperature.
    """
    flat = np.array([(0, 0), (1.1, 0.1), (2, 0), (0.1, 1), (0.9, 1.2), (2.1, 0.9)], dtype=float)
    edges = [(0, 1), (1, 4), (4, 3), (3, 0), (0, 4)]
    flat = np.concatenate([flat, [(flat[a] + flat[b]) / 2 for a, b in edges]])
    used = sorted({int(w) - 1 for line in elements.splitlines() for w in line.split(",")[3 if line[0] == "C" else 1 :]
                   if w.isdigit()})  # fmt: skip
    plane = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    x = flat @ plane[:, :2].T + 0.3
    x[[k for k in range(len(x)) if k not in used]] = 9.0
    text = body(x, elements, "SPC1,1,123456,1\n")
    slopes = np.array([AFFINE[0], *(plane[:, :2] @ (plane[:, :2].T @ AFFINE[1:]))])
    slopes[0] += 0.3 * (AFFINE[1:] - slopes[1:]).sum()
    if "CBAR" in elements:
        text = (
            "\n".join(line for line in text.splitlines() if not line.startswith("TEMP*"))
            + "\nTEMPD,9,5.,4,70.\n"
        )
        slopes = np.array([70.0, 0, 0, 0])
    xyz, u = solved(tmp_path / "d.bdf", text)
    assert strained(xyz[used], u[used, :3], slopes) < 1e-8


def test_a_rod_between_walls_moves_from_its_warm_half(tmp_path: Path) -> None:
    nodes = "GRID,1,,0.,,,,123456\nGRID,2,,1.,,,,23456\nGRID,3,,2.,,,,123456\n"
    rods = "CROD,1,1,1,2\nCROD,2,1,2,3\nTEMPD,4,20.\nTEMP,4,1,70.,2,70.\n"
    _, u = solved(tmp_path / "d.bdf", HEAD + nodes + rods)
    assert u[1, 0] == pytest.approx(
        ALPHA * (50 - 25) * 2 / 4, rel=1e-9
    )  # the cold rod ends at 70: 25 in the mean


def test_two_metals_side_by_side(tmp_path: Path) -> None:
    nodes = "GRID,1,,0.,,,,123456\nGRID,2,,2.,,,,23456\n"
    _, u = solved(tmp_path / "d.bdf", HEAD + nodes + "CROD,1,1,1,2\nCROD,2,2,1,2\nTEMPD,4,100.\n")
    one, two = 2e11 * 1e-3, 1e11 * 3e-3
    assert u[1, 0] == pytest.approx(
        2 * (one * ALPHA * 80 + two * 2e-5 * 100) / (one + two), rel=1e-9
    )


@pytest.mark.parametrize(
    ("case", "cards", "told"),
    [
        ("TEMP = 4", "TEMP,4,1,30.", "node 2 has no temperature (TEMP or TEMPD)"),
        ("TEMP = 7", "TEMPD,4,30.", "temperature set 7 is not in the deck"),
        (
            "TEMP = 4",
            "TEMPD,4,30.\nTEMPRB,4,1,30.",
            "TEMPRB is not supported: of temperatures, TEMP and TEMPD are read",
        ),
        ("TEMP = 4", "TEMPD,4,30.\nTEMP,4,9,1.", "TEMP names node 9, which is not in the deck"),
        (
            "TEMP(INIT) = 3\nTEMP(LOAD) = 4",
            "TEMPD,4,30.",
            "TEMP(INIT) = 3: of static loads those of LOAD and TEMP(LOAD)",
        ),
        ("TEMP = x", "TEMPD,4,30.", "it must be the number of a set"),
    ],
)
def test_temperatures_that_cannot_be_taken(
    tmp_path: Path, case: str, cards: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    nodes = "GRID,1,,0.,,,,123456\nGRID,2,,2.,,,,23456\nCROD,1,1,1,2\n"
    text = HEAD.replace("TEMPERATURE(LOAD) = 4", case) + nodes + cards + "\n"
    (tmp_path / "d.bdf").write_text(text)
    assert run(["static", str(tmp_path / "d.bdf"), "--at", "2+X"]) == 2
    assert told in capsys.readouterr().err


def test_laminates_that_would_expand_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nodes = "GRID,1,,0.,,,,123456\nGRID,2,,2.\nGRID,3,,0.,1.\nCTRIA3,1,7,1,2,3\nPCOMP,7\n,1,.01,0.,,1,.01,90.\nTEMPD,4,1.\n"
    (tmp_path / "d.bdf").write_text(HEAD + nodes)
    assert run(["static", str(tmp_path / "d.bdf"), "--at", "2+X"]) == 2
    assert "CTRIA3 is not supported: 1 would expand" in capsys.readouterr().err
