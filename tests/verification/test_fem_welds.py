"""CWELD: patches that follow linear fields, the beam between them, and the equations of GA and
GB.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, steel
from fem_slopes import check_slopes, turned
from test_fem_derivatives import parameter

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import Parameter, Shape
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.elements.fasteners import SHEAR, build_weld, on_patch, weld_ends
from ringtrue.model.model import Model

E, NU, D, H = 2e11, 0.3, 0.02, 0.03
G = E / (2 * (1 + NU))
AREA, SECOND = np.pi / 4 * D**2, np.pi / 64 * D**4
LOW = np.array([[0, 0, 0], [0.1, 0, 0], [0.12, 0.1, 0], [0, 0.09, 0.0]])
HIGH = np.array([[-0.02, -0.01, H], [0.11, 0, H], [0.05, 0.12, H]])
XYZ = np.vstack([LOW, HIGH, [[0.05, 0.04, 0.012]], [[0.05, 0.04, 0], [0.05, 0.04, H]]])
CORNERS = {f"GA{i}": i for i in range(1, 5)} | {f"GB{i}": i + 4 for i in range(1, 4)}


def weld(xyz: Float = XYZ, p: dict[str, object] | None = None, **more: object) -> Model:
    line = cards(
        "CWELD", EID=[3], PID=5, **({"GS": 8, "TYPE": "GRIDID", **CORNERS} | more)
    )
    return model(
        grid(xyz),
        line,
        cards("PWELD", PID=[5], MID=1, D=D, **(p or {})),
        steel(E, NU, GE=0.02),
        AUTOSPC="NO",
    )


def align(xyz: Float = XYZ, **p: float) -> Model:
    return weld(xyz, p, TYPE="ALIGN", GS=0, GA=9, GB=10, **dict.fromkeys(CORNERS, 0))


def tip(s: System) -> Float:
    """Flexibility (6, 6) of the last node with the others held."""
    return np.linalg.inv(s.stiffness.toarray()[-6:, -6:])


def test_it_is_a_shear_flexible_beam() -> None:
    F = tip(assemble(align()))
    assert F[2, 2] == pytest.approx(H / (E * AREA))
    assert F[0, 0] == pytest.approx(H**3 / (3 * E * SECOND) + H / (SHEAR * G * AREA))
    assert F[4, 4] == pytest.approx(H / (E * SECOND))
    assert F[5, 5] == pytest.approx(H / (2 * G * SECOND))


def test_lengths_that_count() -> None:
    """Shorter than LDMIN or longer than LDMAX diameters it is as stiff as one of that length; 0 is
    allowed.
    """
    soft = tip(assemble(align(LDMIN=3.0)))
    assert soft[2, 2] == pytest.approx(3 * D / (E * AREA))
    stiff = tip(assemble(align(LDMAX=1.0)))
    assert stiff[4, 4] == pytest.approx(D / (E * SECOND))
    none = tip(assemble(align(np.vstack([XYZ[:8], XYZ[8], XYZ[8]]))))
    assert none[2, 2] == pytest.approx(0.2 * D / (E * AREA))
    assert none[0, 0] == pytest.approx(0.2 * D / (SHEAR * G * AREA))


@pytest.mark.parametrize("warp", [0.0, 0.01])
def test_rigid_motions_rank_mass_and_turns(warp: float) -> None:
    xyz = XYZ.copy()
    xyz[2, 2] += warp
    s = assemble(weld(xyz))
    K = s.stiffness.toarray()
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-9 * abs(K).max()
    assert np.linalg.matrix_rank(K, tol=1e-9 * abs(K).max()) == 6
    R = s.rigid_body()[:, :3]
    np.testing.assert_allclose(
        R.T @ (s.mass @ R), 8000 * AREA * _length(xyz) * np.eye(3), atol=1e-12
    )
    there, Q = turned(xyz)
    big = np.kron(np.eye(20), Q)
    np.testing.assert_allclose(
        assemble(weld(there)).stiffness.toarray(),
        big @ K @ big.T,
        atol=1e-8 * abs(K).max(),
    )


def _length(xyz: Float) -> float:
    a, b = weld_ends(mesh(weld(xyz)).rows("CWELD"))
    return float(np.linalg.norm(b.place - a.place))


def test_the_patch_follows_a_plate() -> None:
    """On u = A x the end moves with A x and turns with the surface: θ = (∂w/∂y, −∂w/∂x, (∂v/∂x −
    ∂u/∂y)/2).
    """
    m = mesh(weld())
    end = on_patch(m.rows("CWELD"), np.array([[0, 1, 2, 3]]), XYZ[7:8])
    np.testing.assert_allclose(end.place, [[0.05, 0.04, 0]], atol=1e-15)
    A = np.random.default_rng(0).normal(size=(3, 3))
    u = np.zeros((4, 6))
    u[:, :3] = LOW @ A.T
    want = [*(A @ end.place[0]), A[2, 1], -A[2, 0], (A[1, 0] - A[0, 1]) / 2]
    np.testing.assert_allclose(end.follow[0] @ u.ravel(), want, atol=1e-12)


def test_shells_by_number_and_a_patch_on_a_point() -> None:
    quad = cards("CQUAD4", EID=[50], PID=9, G1=1, G2=2, G3=3, G4=4)
    tria = cards("CTRIA3", EID=[51], PID=9, G1=5, G2=6, G3=7)
    m = weld(TYPE="ELEMID", SHIDA=50, SHIDB=51, **dict.fromkeys(CORNERS, 0))
    both = Model({**m.tables, "CQUAD4": quad, "CTRIA3": tria}, m.params)
    K = build_weld(mesh(both).rows("CWELD")).stiffness
    np.testing.assert_allclose(K, build_weld(mesh(weld()).rows("CWELD")).stiffness)
    s = assemble(weld(GB1=0, GB2=0, GB3=0))
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-9 * abs(s.stiffness).max()
    assert abs(s.stiffness.toarray()[42:48]).max() > 0  # node 8 itself is end B


def test_given_ends_follow_their_patches() -> None:
    s = assemble(weld(GS=0, GA=9, GB=10))
    assert len(s.free) == 48
    np.testing.assert_allclose(
        s.expand(s.rigid_body()).reshape(10, 6, 6)[:, 3:, 3:],
        np.tile(np.eye(3), (10, 1, 1)),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        s.stiffness.toarray(),
        assemble(weld()).stiffness.toarray()[:48, :48],
        rtol=1e-9,
        atol=1e-3,
    )


@pytest.mark.parametrize(
    "p",
    [
        *(
            parameter(x)
            for x in (
                ("PWELD", 5, "D"),
                ("MAT1", 1, "E"),
                ("MAT1", 1, "NU"),
                ("MAT1", 1, "RHO"),
            )
        ),
        Parameter(
            "nodes", shapes=(Shape((2, 6), ((0.01, 0.02, 0.01), (0.0, 0.01, 0.02))),)
        ),
    ],
    ids=["D", "E", "NU", "RHO", "nodes"],
)
def test_derivatives(p: Parameter) -> None:
    check_slopes(weld(), p)


def test_wrong_welds_are_named() -> None:
    far = XYZ.copy()
    far[7] = [1.0, 0, 0]
    with pytest.raises(DeckError, match=r"CWELD 3.*outside of a patch"):
        assemble(weld(far))
    with pytest.raises(DeckError, match=r"CWELD 3.*no GS or GA"):
        assemble(weld(GS=0))
    with pytest.raises(DeckError, match=r"CWELD 3.*neither a patch nor a node"):
        assemble(weld(TYPE="ALIGN", GS=0, **dict.fromkeys(CORNERS, 0)))


def spot(high: float = H, **p: object) -> Model:
    """A spot weld between a quadrilateral of thickness 0.004 and a triangle of 0.002, `high` above
    it.
    """
    xyz = XYZ.copy()
    xyz[4:7, 2] = xyz[9, 2] = high
    quad = cards("CQUAD4", EID=[50], PID=9, G1=1, G2=2, G3=3, G4=4)
    tria = cards("CTRIA3", EID=[51], PID=8, G1=5, G2=6, G3=7)
    skin = cards("PSHELL", PID=[8, 9], MID1=7, T=[2e-3, 4e-3])
    m = weld(
        xyz,
        {"TYPE": "SPOT"} | p,
        TYPE="ELEMID",
        SHIDA=50,
        SHIDB=51,
        **dict.fromkeys(CORNERS, 0),
    )
    soft = cards(
        "MAT1", MID=[1, 7], E=[E, 1e-3], NU=NU, RHO=[8000.0, 0.0], GE=[0.02, 0.0]
    )
    return Model(
        {**m.tables, "CQUAD4": quad, "CTRIA3": tria, "PSHELL": skin, "MAT1": soft},
        m.params,
    )


@pytest.mark.parametrize("high", [H, 0.003])
def test_a_spot_weld_is_as_long_as_its_sheets_are_thick(high: float) -> None:
    s = assemble(spot(high))
    lift = np.zeros((len(s.xyz), 6))
    lift[4:7, 2] = 1.0
    assert lift.ravel() @ s.stiffness @ lift.ravel() == pytest.approx(E * AREA / 3e-3)
    check_slopes(spot(high), parameter(("PSHELL", 9, "T")))


def test_a_spot_weld_on_other_sheets_is_named() -> None:
    m = spot()
    other = m["CQUAD4"].with_column("PID", np.array([77]))
    with pytest.raises(DeckError, match=r"CWELD 3.*sheet A is no PSHELL"):
        build_weld(mesh(Model({**m.tables, "CQUAD4": other}, m.params)).rows("CWELD"))
