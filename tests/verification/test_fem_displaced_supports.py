"""Displaced supports, and forces given by nodes, on structures of which the answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_loaded_deck
from ringtrue.errors import DeckError
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.loads import load_vectors, support_motions

E, A = 2e11, 1e-3
HEAD = (
    "CEND\nLOAD = 1\nSPC = 1\nBEGIN BULK\nMAT1,1,2.+11,,0.3,8000.\nPROD,1,1,1.-3,1.-6\n"
)


def solved(path: Path, text: str) -> Float:
    """Displacements (node, 6) of the only load case."""
    path.write_text(text)
    model, cases = read_loaded_deck(path)
    with EmbeddedSolver().open(model) as analysis:
        drawn, carried = support_motions(model, analysis.dofs, cases)
        found = (
            analysis.static(load_vectors(model, analysis.dofs, cases) + drawn) + carried
        )
    return np.asarray(found[: 6 * len(model["GRID"]), 0].reshape(-1, 6))


@pytest.mark.parametrize(
    "cards",
    [
        "SPC,1,3,1,0.002\nFORCE,1,2,,0.,1.",
        "SPC1,1,1,3\nSPCD,1,3,1,0.002",
        "SPC,1,3,1,0.07\nSPCD,1,3,1,0.002",
        "SPC1,1,1,3\nLOAD,1,2.,0.5,7\nSPCD,7,3,1,0.002",
    ],
)
def test_a_support_that_moves_draws_the_rod_with_it(tmp_path: Path, cards: str) -> None:
    nodes = "GRID,1,,0.,,,,123456\nGRID,2,,1.,,,,23456\nGRID,3,,4.,,,,23456\n"
    moved = solved(
        tmp_path / "d.bdf", f"{HEAD}{nodes}CROD,1,1,1,2\nCROD,2,1,2,3\n{cards}\n"
    )
    np.testing.assert_allclose(moved[:, 0], [0, 0.0005, 0.002], rtol=1e-12)


def test_a_turned_support_moves_what_is_tied_to_it_in_its_own_frame(
    tmp_path: Path,
) -> None:
    """X of frame 4 is Y of basic; node 3, on a rigid arm of 2 along X, is displaced and turned with
    node 2.
    """
    frame = "CORD2R,4,,0.,0.,0.,0.,0.,1.\n,0.,1.,0.\n"
    nodes = "GRID,2,,1.,0.,0.,4\nGRID,3,,3.,0.,0.\nGRID,5,,3.,5.,0.,,123456\n"
    tie = "RBE2,8,2,123456,3\nCELAS2,1,100.,3,2,5,2\nSPC1,1,123456,2\nSPCD,1,2,1,0.25,2,6,0.01\n"
    moved = solved(
        tmp_path / "d.bdf",
        HEAD + frame + nodes + tie + "SPOINT,77\nCELAS2,2,1.,77\nFORCE,1,3,,0.,1.\n",
    )
    np.testing.assert_allclose(moved[0], [0, 0.25, 0, 0, 0, 0.01], atol=1e-12)
    np.testing.assert_allclose(moved[1], [0, 0.27, 0, 0, 0, 0.01], atol=1e-12)


def test_scalar_points_that_are_displaced(tmp_path: Path) -> None:
    """Springs in a row, 0.4 at one end, a force of 8 between them: the middle moves by (10·0.4 +
    8)/40.
    """
    path = tmp_path / "d.bdf"
    springs = "SPOINT,7,8\nGRID,1,,,,,,123456\nCELAS4,1,10.,7,8\nCELAS4,2,30.,8,0\n"
    path.write_text(f"{HEAD}{springs}SPC,1,7,1,0.4\nSLOAD,1,8,3.,8,5.\n")
    model, cases = read_loaded_deck(path)
    with EmbeddedSolver().open(model) as analysis:
        drawn, carried = support_motions(model, analysis.dofs, cases)
        found = (
            analysis.static(load_vectors(model, analysis.dofs, cases) + drawn) + carried
        )
    np.testing.assert_allclose(found[-2:, 0], [0.4, 0.3])


def test_forces_and_moments_across_four_nodes(tmp_path: Path) -> None:
    """FORCE2 and MOMENT2 along (G2 - G1) x (G4 - G3): along Z and, with G3 and G4 exchanged, -Z."""
    nodes = "GRID,1,,0.,0.,0.\nGRID,2,,2.,0.,0.\nGRID,3,,0.,3.,0.\nGRID,4,,1.,3.,0.,,123456\n"
    springs = (
        "".join(f"CELAS2,{c},100.,1,{c}\n" for c in range(1, 7)) + "SPC1,1,123456,2,3\n"
    )
    loads = "FORCE2,1,1,5.,1,2,1,3\nMOMENT2,1,1,7.,1,2,3,1\n"
    moved = solved(tmp_path / "d.bdf", HEAD + nodes + springs + loads)
    np.testing.assert_allclose(moved[0], [0, 0, 0.05, 0, 0, -0.07], atol=1e-12)


def test_a_point_that_nothing_holds_cannot_be_displaced(tmp_path: Path) -> None:
    nodes = "".join(f"GRID,{k + 1},,{k}.,,,,23456\n" for k in range(3))
    text = f"{HEAD}{nodes}CROD,1,1,1,2\nCROD,2,1,2,3\nSPC1,1,1,1\nSPCD,1,3,1,0.1\n"
    with pytest.raises(
        DeckError,
        match=r"d\.bdf:\d+: SPCD: node 3 component 1 is held by no SPC, SPC1 or PS",
    ):
        solved(tmp_path / "d.bdf", text)
