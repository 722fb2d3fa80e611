"""Checks of joints to solids and of bodies: what the check says, and that the modes bear it out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.checks.deck import check_deck
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.registry import solver

CORNERS = [
    (0, 0, 0),
    (1, 0, 0),
    (1, 1, 0),
    (0, 1, 0),
    (0, 0, 1),
    (1, 0, 1),
    (1, 1, 1),
    (0, 1, 1),
]
REST = "PSOLID,1,1\nMAT1,1,7.+10,,.3,2700.\nSPC1,1,123,1,2,3,4\n"
SPRINGS = "PBUSH,9,K,1.+6,1.+6,1.+6,10.,10.,10.\n"


def _cube(first: int, z: float) -> str:
    nodes = "".join(
        f"GRID,{first + i},,{x}.,{y}.,{z + h:.3f}\n"
        for i, (x, y, h) in enumerate(CORNERS)
    )
    names = [str(first + i) for i in range(8)]
    return f"{nodes}CHEXA,{first},1,{','.join(names[:6])}\n,{','.join(names[6:])}\n"


def _two(folder: Path, gap: float, joint: str) -> Model:
    """A cube that stands, and one on it, joined by what `joint` says."""
    return _deck(folder, _cube(1, 0.0) + _cube(11, 1.0 + gap) + SPRINGS + joint)


def _deck(folder: Path, bulk: str) -> Model:
    path = folder / "a.bdf"
    path.write_text(f"SOL 103\nCEND\nSPC = 1\nBEGIN BULK\n{bulk}{REST}ENDDATA\n")
    return read_deck(path)


def _bushes() -> str:
    return "".join(f"CBUSH,{90 + i},9,{5 + i},{11 + i},1.,0.,0.\n" for i in range(4))


def _told(m: Model) -> list[str]:
    return [
        f"{f.severity} {f.text}"
        for f in check_deck(m).findings
        if "BUSH" in f.text or "CBAR" in f.text
    ]


def _loose(m: Model) -> int:
    """Number of mechanisms: modes far below 1 Hz."""
    return int(
        (
            np.abs(
                solver("embedded")
                .open(m)
                .modes(ModesRequest(count=6))
                .modes.frequencies
            )
            < 0.01
        ).sum()
    )


def test_long_bushes_between_solids_carry_no_shear(tmp_path: Path) -> None:
    """Their ends turn freely: the upper cube slides along x and y and turns about z."""
    m = _two(tmp_path, 0.2, _bushes())
    (told,) = _told(m)
    assert told.startswith("warning CBUSH 90 and 3 more: between nodes of solids")
    assert _loose(m) == 3


def test_bushes_without_length_or_with_held_ends_do(tmp_path: Path) -> None:
    skins = "CQUAD4,70,2,5,6,7,8\nCQUAD4,71,2,11,12,13,14\nPSHELL,2,1,.05,1,,1\n"
    for m in (_two(tmp_path, 0.0, _bushes()), _two(tmp_path, 0.2, _bushes() + skins)):
        assert not _told(m)
        assert _loose(m) == 0


def test_a_beam_on_one_node_of_a_solid_is_hinged(tmp_path: Path) -> None:
    beam = "GRID,30,,3.,0.,2.\nCBAR,60,6,16,30,0.,0.,1.\nPBAR,6,1,.01,1.-5,1.-5,2.-5\n"
    m = _two(tmp_path, 0.0, _bushes() + beam)
    (told,) = _told(m)
    assert told.startswith("info CBAR 60: hinged")
    assert _loose(m) == 2


def test_a_shell_on_an_edge_of_a_solid_is_hinged(tmp_path: Path) -> None:
    """It turns about the edge, unless it goes on over the face, which the other shell is for."""
    shell = "GRID,31,,2.,0.,1.\nGRID,32,,2.,1.,1.\nCQUAD4,60,2,6,31,32,7\nPSHELL,2,1,.05,1,,1\n"
    over = shell + "CQUAD4,61,2,5,6,7,8\n"
    for joint, hinged in ((shell, True), (over, False)):
        m = _deck(tmp_path, _cube(1, 0.0) + joint)
        told = [f.text for f in check_deck(m).findings if "hinged" in f.text]
        assert [
            t.startswith("CQUAD4 60: hinged where an edge of it") for t in told
        ] == [True] * hinged
        assert _loose(m) == hinged


@pytest.mark.parametrize(
    ("card", "wrong"),
    [
        ("CONM2,5,1,,2.\n,.1,.05,.1,0.,0.,.15", False),
        ("CONM2,5,1,,2.\n,.1,.2,.1,0.,0.,.15", True),
        ("CONM2,5,1,,-2.", True),
        ("CONM1,5,1,,2.,0.,2.,0.,0.\n,2.,0.,0.,0.,.1", False),
        ("CONM1,5,1,,2.,3.,2.,0.,0.\n,2.", True),
        ("CONM2,5,1,,0.\n,,,,,,.3", False),
    ],
)
def test_bodies_of_negative_inertia_are_told(
    tmp_path: Path, card: str, wrong: bool
) -> None:
    path = tmp_path / "a.bdf"
    path.write_text(f"BEGIN BULK\nGRID,1\nCELAS2,3,9.,1,1\n{card}\n")
    found = [f for f in check_deck(read_deck(path)).findings if "no body has" in f.text]
    assert len(found) == wrong
    assert all((f.severity, f.line) == ("warning", 4) for f in found)
