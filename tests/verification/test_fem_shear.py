"""CSHEAR: Garvey's panel against closed forms (NASTRAN Theoretical Manual, section 5.3), its rods
and its mass.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, modes, ragged, steel
from fem_slopes import check_slopes, turned
from test_fem_derivatives import parameter

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import Parameter, Shape
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.elements import shear
from ringtrue.model.model import Model

E, NU, RHO, T = 2e11, 0.3, 8000.0, 1e-3
G = E / (2 * (1 + NU))
RECTANGLE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]])
WARPED = np.array([[0, 0, 0], [2, 0, 0.2], [1.7, 1.1, 0], [0.2, 0.9, 0.3]])


def panel(xyz: Float, **more: object) -> Model:
    p = cards("PSHEAR", PID=[8], MID=1, **{"T": T, **more})
    e = cards("CSHEAR", EID=[22], PID=8, G1=1, G2=2, G3=3, G4=4)
    return model(grid(xyz), e, p, steel(E, NU, RHO, GE=0.02), AUTOSPC="NO")


def general(x: Float) -> tuple[float, float]:
    """Garvey's energy q²/(2 G t) (A1 + A2 / (1 + ν)) of a panel without parallel edges, by
    logarithms.
    """
    xy, area = shear.flat(x[None])
    (_, x2, x3, x4), (_, _, y3, y4) = xy[0].T
    xq = x4 - (x3 - x4) / (y3 - y4) * y4
    below = y3 * x4 - y4 * (x3 - x2)
    xp, yp = x2 * y3 * x4 / below, x2 * y3 * y4 / below
    length, d = float(np.hypot(xq - xp, yp)), (xq - xp) / yp
    p = yp / length * (xq - xy[0, :, 0] - d * xy[0, :, 1])
    c = length / p[0] - d
    b, a = length / p[3] - c, length / p[1] - d

    def log(u: float, v: float) -> float:
        return sum(w + 2 / 3 * w**3 + w**5 / 5 for w in (u, v)) * np.log(abs(u + v))

    f = log(a, b) + log(c, d) - log(b, c) - log(d, a)
    f += 0.1 * ((a**2 - c**2) * (b**3 - d**3) + (b**2 - d**2) * (a**3 - c**3))
    f -= 0.2 * ((a - c) * (b**4 - d**4) + (b - d) * (a**4 - c**4))
    f *= 0.5 * np.prod(p) / length**2
    ratio = p[0] * p[1] / (p[2] * p[3])
    return float(ratio * area[0]), float(ratio * 4 * (f - 2 / 3 * area[0]))


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0, 0], [2, 0, 0], [1.7, 1, 0], [0.1, 0.8, 0]],
        [[0, 0, 0], [2, 0, 0.1], [1.3, 1.5, 0], [0.4, 1.2, 0.3]],
        [[0, 0, 0], [1, 0, 0], [1.2, 0.7, 0], [0.1, 1.9, 0]],
    ],
)
def test_energy_of_any_quadrilateral(corners: list[list[float]]) -> None:
    x = np.array(corners)
    np.testing.assert_allclose(
        [float(a[0]) for a in shear.flexibility(x[None])], general(x), rtol=1e-7
    )


@pytest.mark.parametrize("skew", [0.0, 0.4, -1.0])
def test_parallelogram(skew: float) -> None:
    """A (1 + 2 D² / (1 + ν)), D the cotangent of the angle; parallel edges need no case of their
    own.
    """
    x = RECTANGLE + skew * RECTANGLE[:, 1:2] * np.array([1.0, 0, 0])
    plain, more = shear.flexibility(x[None])
    assert (plain[0], more[0]) == pytest.approx((2.0, 4 * skew**2))


def test_trapezoid() -> None:
    """1-2 parallel to 3-4: A p1²/p3² (1 + 2/3 (S² + S C + C²)/(1 + ν)), S and C the slopes of the
    sides.
    """
    x = np.array([[0, 0, 0], [3, 0, 0], [2, 1, 0], [0.5, 1, 0.0]])
    plain, more = shear.flexibility(x[None])
    ratio, S, C = 2.0, -1.0, 0.5  # 3 : 1.5 wide
    assert plain[0] == pytest.approx(2.25 * ratio**2)
    assert more[0] == pytest.approx(2.25 * ratio**2 * 2 / 3 * (S**2 + S * C + C**2))


def test_plain_shear_of_a_rectangle() -> None:
    """u = γ y has the energy G t a b γ²/2, whatever the way to look at it; extension has none."""
    s = assemble(panel(RECTANGLE))
    K = dense(s)
    u, v = np.zeros((4, 6)), np.zeros((4, 6))
    u[:, 0], v[:, 0] = RECTANGLE[:, 1], RECTANGLE[:, 0]
    assert u.ravel() @ K @ u.ravel() == pytest.approx(G * T * 2)
    assert abs(K @ v.ravel()).max() < 1e-9 * abs(K).max()


def dense(s: System) -> Float:
    return np.asarray((s.transform @ s.stiffness @ s.transform.T).todense())


@pytest.mark.parametrize("xyz", [RECTANGLE, WARPED], ids=["flat", "warped"])
def test_rigid_motions_rank_and_turns(xyz: Float) -> None:
    s = assemble(panel(xyz))
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-10 * abs(s.stiffness).max()
    assert np.linalg.matrix_rank(dense(s), tol=1e-9 * abs(s.stiffness).max()) == 1
    assert np.linalg.matrix_rank(dense(assemble(panel(xyz, F1=1.0, F2=2.0)))) == 5
    there, Q = turned(xyz)
    R = np.kron(np.eye(8), Q)
    np.testing.assert_allclose(
        dense(assemble(panel(there))),
        R @ dense(s) @ R.T,
        atol=1e-9 * abs(s.stiffness).max(),
    )


def test_numbering_does_not_matter() -> None:
    """The panel is the same from which corner and in which sense its nodes are listed."""
    K = shear.kernel(WARPED[None], np.array([G]), np.array([NU]), np.array([T]))[
        0
    ].reshape(4, 3, 4, 3)
    for order in ([1, 2, 3, 0], [3, 2, 1, 0]):
        other = shear.kernel(
            WARPED[None, order], np.array([G]), np.array([NU]), np.array([T])
        )[0].reshape(4, 3, 4, 3)
        np.testing.assert_allclose(
            other, K[order][:, :, order], atol=1e-7 * abs(K).max()
        )


def test_rods_on_the_edges() -> None:
    """F1 = 1 carries E t b ε along 1-2 over the whole width; F = 30 a rod of 15 T² on each edge."""
    u = np.zeros((4, 6))
    u[:, 0] = 1e-3 * RECTANGLE[:, 0]
    force = (dense(assemble(panel(RECTANGLE, F1=1.0))) @ u.ravel()).reshape(4, 6)
    assert force[1:3, 0].sum() == pytest.approx(E * T * 1.0 * 1e-3)
    u[:] = 0
    u[:, 1] = 1e-3 * RECTANGLE[:, 1]
    force = (dense(assemble(panel(RECTANGLE, F2=30.0))) @ u.ravel()).reshape(4, 6)
    np.testing.assert_allclose(force[2:, 1], 15 * T**2 * E * 1e-3)


def test_mass_at_the_corners() -> None:
    s = assemble(panel(RECTANGLE, NSM=2.0))
    np.testing.assert_allclose(
        s.mass.diagonal().reshape(4, 6)[:, :3], (RHO * T + 2.0) * 2 / 4
    )
    assert abs(s.mass.diagonal().reshape(4, 6)[:, 3:]).max() == 0


def test_box_of_panels_and_stringers() -> None:
    """A cantilever of one bay: the tip mass on the web moves with k = G t h / L (stringers too
    stiff to count).
    """
    rods = cards("CONROD", EID=[1, 2, 3], G1=[1, 2, 3], G2=[2, 3, 4], MID=1, A=1.0)
    m = panel(RECTANGLE)
    tip = cards("CONM2", EID=[9], G=2, M=1000.0)
    both = cards("SPC1", SID=[1, 1], C=["123456", "3456"], G=ragged([1, 4], [2, 3]))
    whole = Model(
        {**m.tables, "CONROD": rods, "CONM2": tip, "SPC1": both}, {}, model(spc=1).case
    )
    weight = 1000.0 + RHO * (T * 2 / 2 + 1.0 * (2 / 2 + 1.0 + 2 / 2))
    assert modes(whole, 1)[0] == pytest.approx(
        np.sqrt(G * T * 1.0 / 2 / weight) / (2 * np.pi), rel=1e-3
    )


@pytest.mark.parametrize(
    "p",
    [
        *(parameter(("PSHEAR", 8, f)) for f in ("T", "NSM", "F1", "F2")),
        *(parameter(("MAT1", 1, f)) for f in ("E", "NU", "RHO")),
        Parameter("shape", shapes=(Shape((2,), ((0.3, 0.1, 0.2),)),)),
    ],
    ids=lambda p: f"{p.targets[0].card} {p.targets[0].field}" if p.targets else "nodes",
)
def test_derivatives(p: Parameter) -> None:
    check_slopes(panel(WARPED, NSM=3.0, F1=0.7, F2=20.0), p)


def test_bad_panels_are_named() -> None:
    with pytest.raises(DeckError, match=r"CSHEAR 22.*180 degrees"):
        assemble(panel(RECTANGLE[[0, 2, 1, 3]]))
    with pytest.raises(DeckError, match=r"PSHEAR 8.*thickness"):
        assemble(panel(RECTANGLE, T=0.0))
