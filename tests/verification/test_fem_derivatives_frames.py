"""Derivatives where nodes carry frames, rigid arms and given matrices: second-order remainders of
whole assemblies.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_slopes import check_slopes

from ringtrue.core.parameters import CardField, Parameter, Shape
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.model.model import Model

BEAM = """SOL 103
CEND
SPC = 1
K2GG = KX
M2GG = MX
B2GG = BX
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,.1,0.,8
GRID,3,,2.,.3,.1,8
GRID,4,,2.2,.1,.4
CORD1R,7,1,2,4
CORD2R,8,7,.1,.1,0.,.1,.1,1.
,1.,.3,0.
CBAR,1,1,1,2,0.,0.,1.
CBAR,2,1,2,3,0.,0.,1.
PBAR,1,1,1.-3,2.-7,3.-7,4.-7
MAT1,1,7.+10,,.3,2700.
RBE2,9,3,123456,4
CONM2,10,4,8,3.,.1,.2,.3
SPC1,1,123456,1
"""
DIRECT = "".join(
    f"DMIG,{name},0,6,1,0\nDMIG,{name},4,1,,4,1,{value}\n,3,2,-.3\nDMIG,{name},3,5,,3,5,{value}\n"
    for name, value in (("KX", "4.+4"), ("MX", "2."), ("BX", "30."))
)


def _read(folder: Path, text: str) -> Model:
    path = folder / "model.bdf"
    path.write_text(text)
    return read_deck(path)


@pytest.mark.parametrize("nodes", [(4,), (3,), (2,), (1, 3)], ids=str)
def test_given_matrices_turn_with_frames_and_rigid_arms(
    tmp_path: Path, nodes: tuple[int, ...]
) -> None:
    """DMIG stands in the displacement frames, on a dependent node too: its share changes with the
    arm alone.
    """
    m = _read(tmp_path, BEAM + DIRECT)
    vectors = tuple((0.3 - 0.1 * i, 0.2, -0.25) for i in range(len(nodes)))
    check_slopes(m, Parameter("p", shapes=(Shape(nodes, vectors),)))


@pytest.mark.parametrize("field", ["A1", "C2"])
def test_frame_on_a_node_that_moves_in_it(tmp_path: Path, field: str) -> None:
    """Node 2 is of the frame 7 on which its own displacement frame 8 rests."""
    m = _read(tmp_path, BEAM + DIRECT)
    check_slopes(m, Parameter("p", (CardField("CORD2R", 8, field),)))


@pytest.mark.parametrize("field", ["T1", "T3"])
def test_corner_thickness_of_a_curved_shell(tmp_path: Path, field: str) -> None:
    """Node normals (PARAM,SNORM) differ from those of the elements: the bubbles, too, feel the
    thickness.
    """
    at = [(np.cos(a), np.sin(a), z) for a in (0.0, 0.2, 0.4) for z in (0.0, 0.3)]
    grids = "".join(
        f"GRID,{i},,{x:.6f},{y:.6f},{z:.6f}\n" for i, (x, y, z) in enumerate(at, 1)
    )
    quads = "CQUAD4,1,1,1,3,4,2\n,,,.004,.005,.006,.007\nCQUAD4,2,1,3,5,6,4\n"
    rest = "PSHELL,1,1,.005,1,,1\nMAT1,1,7.+10,,.3,2700.\nSPC1,1,123456,1,2\nPARAM,SNORM,30.\n"
    m = _read(tmp_path, "SOL 103\nCEND\nSPC = 1\nBEGIN BULK\n" + grids + quads + rest)
    check_slopes(m, Parameter("p", (CardField("CQUAD4", 1, field),)))


def test_a_node_that_turns_the_normals_of_triangles_beyond_it(tmp_path: Path) -> None:
    """The triangle 3-4-2 does not have node 6, but its normal at 4 depends on where 6 is."""
    at = [(np.cos(a), np.sin(a), z) for a in (0.0, 0.2, 0.4) for z in (0.0, 0.3)]
    grids = "".join(
        f"GRID,{i},,{x:.6f},{y:.6f},{z:.6f}\n" for i, (x, y, z) in enumerate(at, 1)
    )
    corners = ((1, 3, 2), (3, 4, 2), (3, 5, 4), (5, 6, 4))
    shells = "".join(
        f"CTRIA3,{e},1,{a},{b},{c}\n" for e, (a, b, c) in enumerate(corners, 1)
    )
    rest = "PSHELL,1,1,.005,1,,1\nMAT1,1,7.+10,,.3,2700.\nSPC1,1,123456,1,2\n"
    m = _read(tmp_path, "SOL 103\nCEND\nSPC = 1\nBEGIN BULK\n" + grids + shells + rest)
    vectors = np.array([[0.02, -0.01, 0.03]])
    check_slopes(m, Parameter("p", shapes=(Shape(np.array([6]), vectors),)))


def test_thickness_of_the_beam_that_a_spline_is(tmp_path: Path) -> None:
    """D/L of an RSPLINE sets how it turns between its ends: only the constraint changes."""
    spline = "RSPLINE,9,.1,1,5,123,3\nGRID,5,,1.2,.4,.3\nCONM2,10,5,,3.\n"
    beams = (
        BEAM[: BEAM.index("RBE2")]
        + spline
        + "SPC1,1,123456,1\nCONM2,11,4,,1.\nCBAR,3,1,3,4,0.,0.,1.\n"
    )
    m = _read(tmp_path, beams.replace("K2GG = KX\nM2GG = MX\nB2GG = BX\n", ""))
    check_slopes(m, Parameter("p", (CardField("RSPLINE", 9, "DL"),)))
