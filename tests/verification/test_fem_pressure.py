"""Pressures as forces at nodes: what divergence and equilibrium say of closed surfaces, and decks
under pressure.

Over the faces of a solid, ∫ n dA = 0, ∫ r x n dA = 0 and ∫ z n dA = V e_z, n outward; with straight
sides the shape functions give these exactly. A pressure of PLOAD4 acts into a solid and along the
normal of a shell.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ringtrue.cli.main import run
from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_loaded_deck
from ringtrue.errors import InputError
from ringtrue.fem.element_cards import SOLIDS, mesh
from ringtrue.fem.loads import FACES, face, face_forces
from ringtrue.model.model import Model
from ringtrue.study.loads import load_vectors

Capture = pytest.CaptureFixture[str]
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
CORNERS = {  # and the volume
    "CHEXA": ([*SQUARE, (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], 1.0),
    "CPENTA": (
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)],
        1 / 2,
    ),
    "CPYRAM": ([*SQUARE, (0.5, 0.5, 1)], 1 / 3),
    "CTETRA": ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], 1 / 6),
}
TURN = np.array([[1.0, 0.3, -0.2], [0.1, 1.4, 0.5], [0.4, -0.3, 0.9]])


def named_by(card: str, f: tuple[int, ...]) -> int:
    """The second node by which PLOAD4 names a face whose first is f[0], from 1 on; 0 for none."""
    if card == "CTETRA":
        return 1 + ({0, 1, 2, 3} - set(f)).pop()
    return 1 + f[2] if len(f) == 4 else 1 + f[1] if card == "CPYRAM" else 0


@pytest.mark.parametrize("quadratic", [False, True])
@pytest.mark.parametrize("card", CORNERS)
def test_over_all_faces_of_a_solid(card: str, quadratic: bool) -> None:
    corners, volume = CORNERS[card]
    x: Float = np.array(corners) @ TURN.T
    places = np.vstack(
        [x, [x[list(e)].mean(axis=0) for e in SOLIDS[card].edges]] if quadratic else [x]
    )
    force, moment, first = np.zeros(3), np.zeros(3), np.zeros(3)
    for f in FACES[card]:
        nodes = np.array(
            face(card, range(1, len(places) + 1), f[0] + 1, named_by(card, f))
        )
        at = np.where(nodes[:, None] > 0, places[nodes - 1], np.nan)[None]
        even, rising = (
            face_forces(at, p)[0] for p in (np.ones((1, len(f))), at[:, : len(f), 2])
        )
        force, first = force + even.sum(axis=0), first + rising.sum(axis=0)
        moment = moment + np.cross(np.nan_to_num(at[0]), even).sum(axis=0)
    np.testing.assert_allclose(np.hstack([force, moment]), 0, atol=1e-14)
    np.testing.assert_allclose(first, [0, 0, volume * np.linalg.det(TURN)], atol=1e-14)


def test_nodes_that_name_no_face() -> None:
    for first, other in ((1, 2), (1, 0), (9, 3), (1, 7)):
        with pytest.raises(InputError, match="mean no face of the CHEXA"):
            face("CHEXA", range(1, 9), first, other)


CUBE = """CEND
SPC = 1
SUBCASE 1
LOAD = 1
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,2.,0.,0.
GRID,3,,2.,3.,0.
GRID,4,,0.,3.,0.
GRID,5,,0.,0.,4.
GRID,6,,2.,0.,4.
GRID,7,,2.,3.,4.
GRID,8,,0.,3.,4.
GRID,9,,1.,0.,4.
CORD2C,5,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
CHEXA,1,1,1,2,3,4,5,6
,7,8
CQUAD4,2,2,5,6,7,8
CTRIA3,3,2,5,6,7
CTRIA6,4,2,5,6,7,9
PSOLID,1,1
PSHELL,2,1,.01,1,,1
MAT1,1,2.+11,,.3,7800.
SPC1,1,123456,1,2,3,4
"""


def loaded(tmp_path: Path, *cards: str) -> tuple[Model, Float]:
    """The model and the forces (node, 3) of its case."""
    (tmp_path / "d.bdf").write_text(CUBE + "\n".join(cards) + "\n")
    model, cases = read_loaded_deck(tmp_path / "d.bdf")
    return model, load_vectors(model, mesh(model).dofs, cases)[:, 0].reshape(-1, 6)[
        :, :3
    ]


@pytest.mark.parametrize(
    ("cards", "total"),
    [
        (("PLOAD4,1,1,10.,,,,5,7",), (0, 0, -60)),  # top of the solid: down
        (("PLOAD4,1,1,10.,,,,6,3",), (-120, 0, 0)),
        (("PLOAD4,1,1,1.,2.,3.,4.,6,3",), (-30, 0, 0)),
        # along a vector, whatever its length
        (("PLOAD4,1,1,10.,,,,5,7", ",,0.,-7."), (0, -60, 0)),
        (("PLOAD4,1,2,10.",), (0, 0, 60)),  # along the normal of the shell
        (("PLOAD4,1,2,10.,,,,THRU,4",), (0, 0, 120)),
        (("PLOAD2,1,10.,2,3",), (0, 0, 90)),
        (("PLOAD2,1,10.,2,THRU,4",), (0, 0, 120)),
        (("PLOAD,1,10.,5,6,7,8",), (0, 0, 60)),
        (("PLOAD,1,10.,7,6,5",), (0, 0, -30)),
        (("LOAD,1,2.,.5,7,1.,8", "PLOAD2,7,10.,2", "FORCE1,8,6,5.,5,6"), (10, 0, 60)),
        (("PLOAD4,1,4,10.", ",5,0.,0.,1."), (0, 0, 30)),
    ],
)
def test_cards(
    tmp_path: Path, cards: tuple[str, ...], total: tuple[float, ...]
) -> None:
    _, force = loaded(tmp_path, *cards)
    np.testing.assert_allclose(force.sum(axis=0), total, atol=1e-9)


def test_sizes_go_round_from_g1_as_seen_from_outside(tmp_path: Path) -> None:
    """The face x = 2 is 6, 2, 3, 7 by the right-hand rule about its outward normal."""
    _, force = loaded(tmp_path, "PLOAD4,1,1,1.,2.,3.,4.,6,3")
    a = (
        np.array([[4, 2, 1, 2], [2, 4, 2, 1], [1, 2, 4, 2], [2, 1, 2, 4]]) / 36 * 12
    )  # of a rectangle of 12
    np.testing.assert_allclose(-force[[5, 1, 2, 6], 0], a @ [1, 2, 3, 4], atol=1e-12)


def test_a_direction_of_a_cylindrical_frame_turns_with_the_place(
    tmp_path: Path,
) -> None:
    """∫ e_r dA over 0 < x < 2, 0 < y < 3."""
    _, force = loaded(tmp_path, "PLOAD4,1,2,1.", ",5,1.,0.,0.")
    p, w = np.polynomial.legendre.leggauss(60)
    x, y = np.meshgrid(1 + p, 1.5 * (1 + p), indexing="ij")
    want = [(1.5 * np.outer(w, w) * c / np.hypot(x, y)).sum() for c in (x, y)]
    np.testing.assert_allclose(
        force.sum(axis=0), [*want, 0], rtol=0.02
    )  # three points a side at the axis


@pytest.mark.parametrize(
    ("cards", "told"),
    [
        (("PLOAD4,1,99,1.",), "PLOAD4: names element 99, which is no shell or solid"),
        (
            ("PLOAD4,1,1,1.",),
            "element 1: G1 = 0 and G3/G4 = blank mean no face of the CHEXA",
        ),
        (("PLOAD,1,1.,5,6,77",), "a node of the face is not in the deck"),
        (("PLOAD4,1,2,1.", ",,,,,LINE"), "loads along edges"),
        (
            ("ACCEL1,1,,3.,0.,0.,1.", ",1"),
            "ACCEL1 is not supported: of a static load, FORCE",
        ),
        (
            ("RFORCE,1,1,,3.,0.,0.,1.",),
            "RFORCE is not supported: of a static load, FORCE",
        ),
        (("FORCE1,1,6,5.,5,55",), "FORCE names node 55"),
        (("PLOAD,1,1.,5,6",), "PLOAD field G1: three or four nodes span a face"),
        (("FORCE,1,6,,1.+200,0.,0.,1.+200",), "SUBCASE 1: the loads are too large"),
        (("FORCE1,1,0,5.,5,6",), "FORCE1 field G: 0 is no node"),
        (("FORCE,1,0,,5.,0.,0.,1.",), "FORCE field G: 0 is no node"),
        (("FORCE1,1,6,5.,5,5",), "which are at one place"),
        (("FORCE2,1,6,5.,5,6,6,5",), "which span no plane"),
        (("SLOAD,1,6,5.",), "SLOAD names 6, which is no scalar point of the deck"),
    ],
)
def test_what_cannot_be_taken(
    tmp_path: Path, cards: tuple[str, ...], told: str, capsys: Capture
) -> None:
    (tmp_path / "d.bdf").write_text(CUBE + "\n".join(cards) + "\n")
    assert run(["static", str(tmp_path / "d.bdf"), "--at", "7+Z"]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("TEMP(LOAD) = 4", "TEMP(LOAD) = 4: of static loads those of LOAD are read"),
        ("TEMPERATURE = 4", "TEMP(LOAD) = 4: of static loads those of LOAD are read"),
        ("DEFORM = 3", "DEFORM = 3: of static loads those of LOAD are read"),
    ],
)
def test_other_loads_of_case_control(
    tmp_path: Path, line: str, told: str, capsys: Capture
) -> None:
    (tmp_path / "d.bdf").write_text(
        CUBE.replace("LOAD = 1", f"LOAD = 1\n{line}") + "PLOAD2,1,10.,2\n"
    )
    assert run(["static", str(tmp_path / "d.bdf"), "--at", "7+Z"]) == 2
    assert told in capsys.readouterr().err


def test_a_pressed_bar_shortens(tmp_path: Path, capsys: Capture) -> None:
    """A bar of solids, 10 long, with nu = 0, under p at its end: u = p L/E."""
    n, lines = 5, ["CEND", "SPC = 1", "LOAD = 1", "TEMP(INIT) = 3", "BEGIN BULK"]
    for k in range(n + 1):
        corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
        lines += [
            f"GRID,{4 * k + i + 1},,{x}.,{y}.,{10 * k / n}"
            for i, (x, y) in enumerate(corners)
        ]
    for k in range(n):
        g = [str(4 * k + i) for i in range(1, 9)]
        lines += [f"CHEXA,{k + 1},1,{','.join(g[:6])}", f",{','.join(g[6:])}"]
    lines += [
        "PSOLID,1,1",
        "MAT1,1,2.+9,,0.,1.",
        "SPC1,1,123,1,2,3,4",
        f"PLOAD4,1,{n},4.+5,,,,21,23",
    ]
    (tmp_path / "d.bdf").write_text("\n".join(lines) + "\n")
    assert run(["static", str(tmp_path / "d.bdf"), "--at", "22+Z", "--json", "-"]) == 0
    (case,) = json.loads(capsys.readouterr().out)["cases"]
    assert case["metre"]["22+Z"] == pytest.approx(-4e5 * 10 / 2e9, rel=1e-9)
