"""Spun structures and displaced supports: rods, rings and bodies of which the answer is known.

A rod of length L about its end, free at the other: u(L) = ρω²L³/(3E), held at 0. A ring of radius R
about its axis: u = ρω²R³/E. A mass m at the distance r on a massless rod: F = mω²r, and across an
inclined principal axis the moment -ω × Jω (Goldstein, Classical Mechanics, 5.5).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_loaded_deck
from ringtrue.errors import DeckError
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.loads import load_vectors, support_motions

E, RHO, A, TURNS = 2e11, 8000.0, 1e-3, 5.0
OMEGA2 = (2 * np.pi * TURNS) ** 2
HEAD = "CEND\nLOAD = 1\nSPC = 1\nBEGIN BULK\nMAT1,1,2.+11,,0.3,8000.\nPROD,1,1,1.-3,1.-6\n"


def solved(path: Path, text: str) -> Float:
    """Displacements (node, 6) of the only load case."""
    path.write_text(text)
    model, cases = read_loaded_deck(path)
    with EmbeddedSolver().open(model) as analysis:
        drawn, carried = support_motions(model, analysis.dofs, cases)
        found = analysis.static(load_vectors(model, analysis.dofs, cases) + drawn) + carried
    return np.asarray(found[: 6 * len(model["GRID"]), 0].reshape(-1, 6))


def spun_rod(count: int, more: str = "PARAM,COUPMASS,1") -> str:
    nodes = "".join(f"GRID,{k + 1},,{2 * k / count!r},,,,23456\n" for k in range(count + 1))
    rods = "".join(f"CROD,{k},1,{k},{k + 1}\n" for k in range(1, count + 1))
    return f"{HEAD}{more}\n{nodes}{rods}SPC1,1,1,1\nRFORCE,1,1,,{TURNS},0.,0.,1.\n"


@pytest.mark.parametrize("lumped", [False, True])
def test_a_spun_rod_converges_to_its_closed_form(tmp_path: Path, lumped: bool) -> None:
    want = RHO * OMEGA2 * 2**3 / (3 * E)
    more = "PARAM,COUPMASS,-1" if lumped else "PARAM,COUPMASS,1"
    errors = [abs(solved(tmp_path / "d.bdf", spun_rod(n, more))[-1, 0] / want - 1) for n in (4, 8)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
    assert errors[1] < 0.01


def test_loads_multiply_the_forces_of_a_spin_not_its_speed(tmp_path: Path) -> None:
    one, three = spun_rod(2), spun_rod(2).replace("RFORCE,1,", "LOAD,1,1.5,2.,7\nRFORCE,7,")
    np.testing.assert_allclose(
        solved(tmp_path / "a.bdf", three), 3 * solved(tmp_path / "b.bdf", one), rtol=1e-12
    )


def test_a_spun_ring_widens(tmp_path: Path) -> None:
    """About Y of basic, which is Z of frame 5, on an axis through node 99; nodes move along the
    radius only.
    """
    count, radius = 179, 0.5  # odd, or nodes could move in and out by turns
    turn = 360 / count
    nodes = "".join(f"GRID,{k + 1},6,{radius},{k * turn!r},0.,6,23456\n" for k in range(count))
    rods = "".join(f"CROD,{k + 1},1,{k + 1},{(k + 1) % count + 1}\n" for k in range(count))
    frames = "CORD2R,5,,0.,0.,0.,0.,1.,0.\n,1.,0.,0.\nCORD2C,6,,3.,1.,0.,3.,2.,0.\n,4.,1.,0.\n"
    spin = f"GRID,99{count},,3.,7.,0.,,123456\nRFORCE,1,99{count},5,{TURNS},0.,0.,1.\nSPC1,1,3,1\n"
    moved = solved(tmp_path / "d.bdf", HEAD + frames + nodes + rods + spin)
    out = np.linalg.norm(moved[:-1, :3], axis=1)
    want = RHO * OMEGA2 * radius**3 / E
    np.testing.assert_allclose(out, want, rtol=3e-4)  # chords for arcs: (π/179)²
    np.testing.assert_allclose(moved[:-1, 1], 0, atol=1e-9 * want)


def test_bodies_pull_at_their_own_distance_and_turn_into_the_plane(tmp_path: Path) -> None:
    """3 kg 0.4 m out of node 2 at 1 m, on springs; its axis of the largest inertia is inclined to
    that of the spin.
    """
    body = "CONM2,9,3,,3.,0.4,0.,0.,,\n,0.2,0.,0.3,0.05,0.,0.3\n"
    springs = "".join(f"CELAS2,{c},1.+6,2,{c}\n" for c in range(1, 7))
    deck = f"{HEAD}GRID,2,,1.,0.,0.\nGRID,3,,1.,0.,0.\nRBE2,8,2,123456,3\n{body}{springs}RFORCE,1,0,,{TURNS},0.,0.,1.\n"
    moved = solved(tmp_path / "d.bdf", deck.replace("SPC = 1\n", ""))
    assert moved[0, 0] == pytest.approx(3 * OMEGA2 * 1.4 / 1e6, rel=1e-9)
    # J = [.., I31 = 0.05 on the card is the product ∫xz dm]: -ω × Jω = ω² (J_yz, -J_xz, 0), J_xz =
    # -0.05
    assert moved[0, 4] == pytest.approx(OMEGA2 * 0.05 / 1e6, rel=1e-9)
    np.testing.assert_allclose(moved[0, [1, 2, 3, 5]], 0, atol=1e-12)


def test_far_masses_on_rigid_arms_pull_where_they_are(tmp_path: Path) -> None:
    deck = (
        f"{HEAD}GRID,2,,1.,0.,0.\nGRID,3,,1.,2.,0.\nRBE2,8,2,123456,3\nCONM2,9,3,,3.\n"
        + "".join(f"CELAS2,{c},1.+6,2,{c}\n" for c in range(1, 7))
        + f"RFORCE,1,0,,{TURNS},0.,0.,1.\n"
    )
    moved = solved(tmp_path / "d.bdf", deck.replace("SPC = 1\n", ""))
    force = 3 * OMEGA2 * np.array([1, 2])
    np.testing.assert_allclose(moved[0, :2], force / 1e6, rtol=1e-9)
    assert moved[0, 5] == pytest.approx(
        -2 * force[0] / 1e6, rel=1e-9
    )  # the moment of the arm along Y


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
    moved = solved(tmp_path / "d.bdf", f"{HEAD}{nodes}CROD,1,1,1,2\nCROD,2,1,2,3\n{cards}\n")
    np.testing.assert_allclose(moved[:, 0], [0, 0.0005, 0.002], rtol=1e-12)


def test_a_turned_support_moves_what_is_tied_to_it_in_its_own_frame(tmp_path: Path) -> None:
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
        found = analysis.static(load_vectors(model, analysis.dofs, cases) + drawn) + carried
    np.testing.assert_allclose(found[-2:, 0], [0.4, 0.3])


def test_forces_and_moments_across_four_nodes(tmp_path: Path) -> None:
    """FORCE2 and MOMENT2 along (G2 - G1) x (G4 - G3): along Z and, with G3 and G4 exchanged, -Z."""
    nodes = "GRID,1,,0.,0.,0.\nGRID,2,,2.,0.,0.\nGRID,3,,0.,3.,0.\nGRID,4,,1.,3.,0.,,123456\n"
    springs = "".join(f"CELAS2,{c},100.,1,{c}\n" for c in range(1, 7)) + "SPC1,1,123456,2,3\n"
    loads = "FORCE2,1,1,5.,1,2,1,3\nMOMENT2,1,1,7.,1,2,3,1\n"
    moved = solved(tmp_path / "d.bdf", HEAD + nodes + springs + loads)
    np.testing.assert_allclose(moved[0], [0, 0, 0.05, 0, 0, -0.07], atol=1e-12)


def test_a_point_that_nothing_holds_cannot_be_displaced(tmp_path: Path) -> None:
    text = spun_rod(2) + "SPCD,1,3,1,0.1\n"
    with pytest.raises(
        DeckError, match=r"d\.bdf:\d+: SPCD: node 3 component 1 is held by no SPC, SPC1 or PS"
    ):
        solved(tmp_path / "d.bdf", text)
