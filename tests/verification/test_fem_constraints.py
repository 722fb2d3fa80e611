"""Elimination: rigid elements, averages, equations, supports and what has no stiffness."""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, pshell, ragged, shells, spc, square, steel

from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.model.frames import frames
from ringtrue.model.model import Model

XYZ = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, 0.2, 0.5], [2, 2, 1.0]]
)
CD = np.array([0, 7, 0, 8, 7, 8])
FRAMES = (
    cards("CORD2R", CID=[7], A1=0.3, B1=0.3, B2=0.5, B3=1.0, C1=1.0),
    cards("CORD2C", CID=[8], A1=-1.0, B1=-1.0, B2=0.1, B3=1.0, C1=1.0, C2=0.3),
)
NODES = (grid(XYZ, CD=CD), *FRAMES)


def rbe2(eid: int, gn: int, gm: list[int], cm: str = "123456") -> object:
    return cards("RBE2", EID=[eid], GN=gn, CM=cm, GM=ragged(gm))


def rbe3(ref: int, nodes: list[int], refc: str = "123456", c: str = "123") -> object:
    n = len(nodes)
    rows = {
        "G": ragged(nodes),
        "C": ragged([c] * n),
        "WT": ragged(np.arange(1.0, n + 1)),
    }
    return cards("RBE3", EID=[50], REFGRID=ref, REFC=refc, **rows)


def rigid(m: Model) -> float:
    """How far the constraints bend a rigid motion, which takes u = t + ω × x and θ = ω."""
    s = assemble(m)
    want = np.zeros((len(XYZ), 6, 6))
    want[:] = np.eye(6)
    want[:, :3, 3:] = np.cross(np.eye(3), XYZ[:, None, :]).swapaxes(1, 2)
    return float(np.abs(s.expand(s.rigid_body()) - want.reshape(-1, 6)).max())


@pytest.mark.parametrize(
    "tables",
    [
        (rbe2(1, 2, [1, 3, 4, 5, 6]),),
        (rbe3(5, [1, 2, 3, 4]),),
        (rbe3(5, [1, 2], c="123456"),),
        (rbe3(5, [1, 2, 3, 4]), rbe2(1, 5, [6])),
        (rbe2(1, 6, [1]), rbe3(5, [1, 2, 3, 4])),
    ],
    ids=["rbe2", "rbe3", "rbe3 of two", "rbe2 on rbe3", "rbe3 on rbe2"],
)
def test_constraints_keep_rigid_motions(tables: tuple[object, ...]) -> None:
    assert rigid(model(*NODES, *tables, AUTOSPC="NO")) < 1e-12


def test_rbe3_shares_a_force_by_weight() -> None:
    """On a line of nodes 1 and 2 with weights 1 and 2 the motion is the weighted mean."""
    at = grid(np.zeros((3, 3)))
    s = assemble(model(at, rbe3(3, [1, 2], refc="123"), AUTOSPC="NO"))
    x = np.where(s.free.node == 1, 3.0, 0.0) * (s.free.direction == 1)
    assert s.expand(x)[12] == pytest.approx(1.0)


def test_rotations_of_an_rbe3_are_weighted_by_the_square_of_the_mean_arm() -> None:
    """Nodes 1 and 2 at x = 1 and 3, the reference at 0; v and θ at it, by least squares, for a unit
    turn of node 1.

    2 v + 4 θ = 0 and 4 v + (10 + L²) θ = L², L = (1 + 3) / 2 although node 1 is listed twice.
    """
    at = grid(np.array([[1.0, 0, 0], [3.0, 0, 0], [0.0, 0, 0]]))
    terms = {
        "G": ragged([1, 2, 1]),
        "C": ragged(["2", "2", "6"]),
        "WT": ragged([1.0, 1.0, 1.0]),
    }
    s = assemble(
        model(at, cards("RBE3", EID=[50], REFGRID=3, REFC="26", **terms), AUTOSPC="NO")
    )
    turn = np.array([float(label == "1+RZ") for label in s.free.labels()])
    np.testing.assert_allclose(s.expand(turn)[[13, 17]], [-4 / 3, 2 / 3], rtol=1e-12)


def test_rbe3_that_is_not_determined_is_refused() -> None:
    with pytest.raises(DeckError, match=r"RBE3 50.*do not determine"):
        assemble(model(*NODES, rbe3(5, [1, 2])))


def test_mpc_and_sets() -> None:
    """2 u2 - 3 u1 = 0 in an MPCADD; SPCADD unites; an SPC that is not chosen does nothing."""
    mpc = cards(
        "MPC", SID=[5], G=ragged([2, 1]), C=ragged([1, 1]), A=ragged([2.0, -3.0])
    )
    add = (
        cards("MPCADD", SID=[1], S=ragged([5])),
        cards("SPCADD", SID=[1], S=ragged([6, 7])),
    )
    held = cards("SPC1", SID=[6, 7, 8], C=["3", "2", "1"], G=ragged([1], [1], [1]))
    s = assemble(model(grid(XYZ[:2]), mpc, *add, held, spc=1, mpc=1, AUTOSPC="NO"))
    labels = s.free.labels()
    assert set(labels) == {f"1{d}" for d in ("+X", "+RX", "+RY", "+RZ")} | {
        f"2{d}" for d in ("+Y", "+Z", "+RX", "+RY", "+RZ")
    }
    assert s.expand(np.eye(9)[labels.index("1+X")])[6] == 1.5


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ((rbe2(1, 1, [2]), rbe3(2, [3, 4, 5])), "more than once.*RBE2 1, RBE3 50"),
        (
            (cards("RBE2", EID=[1, 2], GN=[1, 2], CM="123456", GM=ragged([2], [1])),),
            "circle.*RBE2 1, RBE2 2",
        ),
        ((rbe2(1, 1, [2]), spc([2], "1")), "held by an SPC.*RBE2 1"),
        ((rbe2(1, 1, [77]),), "GRID 77 is not in the deck"),
        ((rbe2(7, 1, [2], ""),), "RBE2 7.*CM names no component"),
    ],
)
def test_contradictions_are_named(tables: tuple[object, ...], message: str) -> None:
    with pytest.raises(DeckError, match=message):
        assemble(model(*NODES, *tables, spc=1))


def test_an_equation_that_names_its_dependent_dof_twice_is_named() -> None:
    twice = cards(
        "MPC",
        SID=[5],
        G=ragged([3, 3, 4]),
        C=ragged([1, 1, 1]),
        A=ragged([1.0, 1.0, -1.0]),
    )
    with pytest.raises(DeckError, match="circle: MPC 5;"):
        assemble(model(*NODES, rbe2(1, 1, [2]), twice, mpc=5))


def test_autospc_holds_what_has_no_stiffness() -> None:
    """A rod along x leaves y, z and the bending rotations; drilling is held in a plate without
    K6ROT.
    """
    rod = (
        cards("CROD", EID=[1], PID=1, G1=1, G2=2),
        cards("PROD", PID=[1], MID=1, A=1.0, J=1.0),
    )
    s = assemble(model(grid(XYZ[:2]), *rod, steel()))
    assert s.free.labels() == ("1+X", "1+RX", "2+X", "2+RX")
    xyz, quads = square(1, 1.0, 1.0)
    plate = (grid(xyz), shells(quads), pshell(0.1), steel())
    assert len(assemble(model(*plate)).autospc) == 0
    assert assemble(model(*plate, K6ROT=0.0)).autospc.labels() == (
        "1+RZ",
        "2+RZ",
        "3+RZ",
        "4+RZ",
    )


def test_a_support_in_a_displacement_frame() -> None:
    """Node 2 held along the x axis of its frame moves only across it."""
    s = assemble(model(*NODES, spc([2], "1"), spc=1, AUTOSPC="NO"))
    every = frames(model(*NODES))
    x_axis = every.axes[every.find(np.array([7]))[0], 0]
    motion = s.expand(np.random.default_rng(0).normal(size=len(s.free)))[6:9]
    assert abs(motion @ x_axis) < 1e-12


def test_structural_damping_is_the_imaginary_part() -> None:
    m = model(
        grid(XYZ[:2]),
        cards("CROD", EID=[1], PID=1, G1=1, G2=2),
        cards("PROD", PID=[1], MID=1, A=1.0, J=1.0),
        steel(GE=0.02),
        G=0.01,
    )
    s = assemble(m)
    np.testing.assert_allclose(
        s.structural.toarray(), 0.03 * s.stiffness.toarray(), rtol=1e-12
    )


def test_a_card_that_is_not_assembled_is_refused() -> None:
    m = Model({"GRID": grid(XYZ)}, kept={"CSEAM": 3})
    with pytest.raises(UnsupportedCard, match="CSEAM"):
        assemble(m)
