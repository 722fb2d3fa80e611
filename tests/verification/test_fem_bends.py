"""CBEND: closed forms of arcs (Timoshenko, Strength of Materials), chains of bars, the four ways to
give the arc.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, modes, steel
from fem_slopes import check_slopes, turned
from test_fem_derivatives import parameter

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import Parameter, Shape
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.elements.bend import pipe
from ringtrue.model.model import Model

E, NU, R = 2e11, 0.3, 1.5
G = E / (2 * (1 + NU))
SECTION = {"A": 0.01, "I1": 2e-5, "I2": 1e-5, "J": 3e-5}
QUARTER = np.array([[R, 0, 0], [0, R, 0.0]])
OUT = {"X1": 0.0, "X2": 1.0, "X3": 0.0}  # tangent at A


def bend(
    xyz: Float = QUARTER,
    p: dict[str, float] = SECTION,
    COUPMASS: int = -1,
    **more: object,
) -> Model:
    line = cards("CBEND", EID=[3], PID=5, GA=1, GB=2, **({"GEOM": 2, **OUT} | more))
    table = cards("PBEND", PID=[5], MID=1, **p)
    return model(
        grid(xyz), line, table, steel(E, NU, GE=0.02), AUTOSPC="NO", COUPMASS=COUPMASS
    )


def tip(s: System) -> Float:
    """Flexibility (6, 6) of end B with A held."""
    return np.linalg.inv(s.stiffness.toarray()[6:, 6:])


def test_quarter_ring_in_its_plane() -> None:
    """A load P along x at B: N = −P sin φ, M = −P R (1 − sin φ), and the work of N in the turn that
    M makes.
    """
    F = tip(assemble(bend()))
    EA, EI = E * SECTION["A"], E * SECTION["I1"]
    bending, axial, both = 3 * np.pi / 4 - 2, np.pi / 4, 2 * (1 - np.pi / 4)
    assert F[0, 0] == pytest.approx(
        R**3 / EI * bending + R / EA * (axial + both), rel=1e-12
    )
    assert F[5, 5] == pytest.approx(R * np.pi / 2 / EI, rel=1e-12)


def test_quarter_ring_out_of_its_plane() -> None:
    """δ = P R³ [π/4 /EI2 + (3π/4 − 2)/GJ]."""
    F = tip(assemble(bend()))
    want = R**3 * (
        np.pi / 4 / (E * SECTION["I2"]) + (3 * np.pi / 4 - 2) / (G * SECTION["J"])
    )
    assert F[2, 2] == pytest.approx(want, rel=1e-12)


def chain(n: int) -> Float:
    """The tip of n straight bars on the quarter, without the coupling of curvature."""
    phi = np.linspace(0, np.pi / 2, n + 1)
    xyz = R * np.stack([np.cos(phi), np.sin(phi), 0 * phi], axis=1)
    i = np.arange(1, n + 1)
    bars = cards(
        "CBAR",
        EID=i,
        PID=1,
        GA=i,
        GB=i + 1,
        X1=np.cos(phi[:-1]),
        X2=np.sin(phi[:-1]),
        X3=0.0,
    )
    K = assemble(
        model(
            grid(xyz),
            bars,
            cards("PBAR", PID=[1], MID=1, **SECTION),
            steel(E, NU),
            AUTOSPC="NO",
        )
    )
    return np.linalg.inv(K.stiffness.toarray()[6:, 6:])[-6:, -6:]


def test_it_is_the_limit_of_a_chain_of_bars() -> None:
    F = tip(assemble(bend(p={**SECTION, "DELTAN": 0.0})))
    scale = np.sqrt(np.outer(F.diagonal(), F.diagonal()))
    errors = [abs((chain(n) - F) / scale).max() for n in (8, 16)]
    assert errors[1] < 5e-3
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize(
    ("way", "p"),
    [
        ({"GEOM": 1, "X1": -1.0, "X2": 0.0}, {}),
        ({"GEOM": 1, "X1": 1.0, "X2": 0.0}, {}),
        ({"GEOM": 3, "X1": 1.0, "X2": 1.0}, {"RB": R}),
        ({"GEOM": 4, "X1": 1.0, "X2": 1.0}, {"THETAB": 90.0}),
    ],
    ids=["centre ahead", "centre behind", "radius", "angle"],
)
def test_four_ways_to_give_the_arc(way: dict[str, float], p: dict[str, float]) -> None:
    whole = {**SECTION, "I2": 2e-5, **p}
    K = assemble(bend(p={**SECTION, "I2": 2e-5})).stiffness.toarray()
    np.testing.assert_allclose(
        assemble(bend(p=whole, **way)).stiffness.toarray(), K, atol=1e-9 * abs(K).max()
    )


def test_more_than_half_a_ring() -> None:
    """The tangent that leads away from B: three quarters of a ring, which weighs as much."""
    m = bend(p={**SECTION, "NSM": 4.0}, X2=-1.0)
    s = assemble(m)
    assert s.mass.diagonal()[0] * 2 == pytest.approx(
        (8000 * 0.01 + 4) * 1.5 * np.pi * R
    )
    assert tip(s)[5, 5] == pytest.approx(1.5 * np.pi * R / (E * SECTION["I1"]))


def test_offsets_move_the_line_of_centroids() -> None:
    """RC and ZC: the element stands where nodes on the centroids would be joined by rigid arms."""
    there = {**SECTION, "RC": 0.2, "ZC": 0.1, "NSM": 4.0}
    s = assemble(bend(p=there))
    far = assemble(
        bend(np.array([[R + 0.2, 0, 0.1], [0, R + 0.2, 0.1]]), {**SECTION, "NSM": 4.0})
    )
    arms = np.eye(12)
    for k, r in enumerate(([0.2, 0, 0.1], [0, 0.2, 0.1])):
        arms[6 * k : 6 * k + 3, 6 * k + 3 : 6 * k + 6] = np.cross(np.eye(3), r).T
    for a, b in ((s.stiffness, far.stiffness), (s.mass, far.mass)):
        np.testing.assert_allclose(
            a.toarray(), arms.T @ b.toarray() @ arms, atol=1e-9 * abs(b).max()
        )
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-9 * abs(s.stiffness).max()


def test_turning_the_whole() -> None:
    there, Q = turned(QUARTER)
    v = Q @ np.array([0.0, 1, 0])
    big = np.kron(np.eye(4), Q)
    K = assemble(
        bend(p={**SECTION, "ZC": 0.1, "K1": 0.5, "K2": 0.6})
    ).stiffness.toarray()
    other = bend(
        there, {**SECTION, "ZC": 0.1, "K1": 0.5, "K2": 0.6}, X1=v[0], X2=v[1], X3=v[2]
    )
    np.testing.assert_allclose(
        assemble(other).stiffness.toarray(), big @ K @ big.T, atol=1e-9 * abs(K).max()
    )


def test_pipe() -> None:
    """A thin pipe has A = 2π r t; a solid one e = R − (R + √(R² − c²))/2."""
    area, second, e = pipe(
        np.array([0.1, 0.1]), np.array([0.002, 0.0]), np.array([1.0, 1.0])
    )
    np.testing.assert_allclose(area, [2 * np.pi * 0.1 * 0.002, np.pi * 0.01])
    np.testing.assert_allclose(second[1], np.pi / 4 * 1e-4)
    assert e[1] == pytest.approx(1 - (1 + np.sqrt(1 - 0.01)) / 2)
    assert e[0] == pytest.approx(second[0] / area[0], rel=5e-3)
    K = assemble(bend(p={"FSI": 1, "RM": 0.1, "T": 0.002})).stiffness.toarray()
    same = {"A": area[0], "I1": second[0], "I2": second[0], "J": 2 * second[0]}
    _, _, e = pipe(np.array([0.1]), np.array([0.002]), np.array([R]))
    alike = assemble(bend(p={**same, "DELTAN": float(e[0])})).stiffness.toarray()
    np.testing.assert_allclose(K, alike, rtol=1e-9, atol=1e-9 * abs(K).max())


def test_a_flat_arc_is_a_straight_beam() -> None:
    xyz = np.array([[0, 0, 0], [1, 0, 0.0]])
    F = tip(assemble(bend(xyz, {**SECTION, "THETAB": 1e-3}, GEOM=4)))
    assert F[1, 1] == pytest.approx(1 / (3 * E * SECTION["I1"]), rel=1e-6)
    assert F[2, 2] == pytest.approx(1 / (3 * E * SECTION["I2"]), rel=1e-6)
    assert F[0, 0] == pytest.approx(1 / (E * SECTION["A"]), rel=1e-5)


def ring(n: int) -> Float:
    """Frequencies over those of a free thin ring in its plane, k = 2 and 3 (Timoshenko, Vibration
    Problems, 1937).
    """
    phi = 2 * np.pi * np.arange(n) / n
    xyz = R * np.stack([np.cos(phi), np.sin(phi), 0 * phi], axis=1)
    i = np.arange(n)
    line = cards(
        "CBEND",
        EID=i + 1,
        PID=5,
        GA=i + 1,
        GB=(i + 1) % n + 1,
        GEOM=1,
        X1=-xyz[:, 0],
        X2=-xyz[:, 1],
        X3=0.0,
    )
    thin = {"A": 1e-4, "I1": 1e-9, "I2": 1e-9, "J": 2e-9, "DELTAN": 0.0}
    m = model(
        grid(xyz, PS="345"),
        line,
        cards("PBEND", PID=[5], MID=1, **thin),
        steel(E, NU),
        COUPMASS=1,
    )
    k = np.array([2, 2, 3, 3])
    exact = np.sqrt(
        E * 1e-9 / (8000 * 1e-4 * R**4) * (k * (k * k - 1)) ** 2 / (k * k + 1)
    ) / (2 * np.pi)
    return modes(m, 7)[3:] / exact


def test_coupled_mass() -> None:
    """The mass of a rigid motion is that of the line; a ring of eight elements is near its
    frequencies.
    """
    s = assemble(bend(p={**SECTION, "NSM": 4.0}, COUPMASS=1))
    r = s.rigid_body()
    mass, centre = (8000 * 0.01 + 4) * np.pi / 2 * R, 2 * R / np.pi
    M = r.T @ (s.mass @ r)
    np.testing.assert_allclose(M[:3, :3], mass * np.eye(3), rtol=1e-9, atol=1e-9 * mass)
    assert abs(M[0, 5]) == pytest.approx(mass * centre, rel=1e-9)
    assert M[5, 5] == pytest.approx(mass * R * R, rel=1e-9)
    errors = [abs(ring(n) - 1).max() for n in (8, 12)]
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] > 1.5**3  # h⁴, less what the thin ring leaves out


FULL = {**SECTION, "K1": 0.5, "K2": 0.6, "NSM": 3.0, "RC": 0.1, "ZC": -0.05}


@pytest.mark.parametrize("field", ["A", "I1", "I2", "J", "K1", "K2", "NSM", "RC", "ZC"])
def test_derivatives(field: str) -> None:
    check_slopes(bend(p=FULL), parameter(("PBEND", 5, field)))
    check_slopes(bend(p=FULL, COUPMASS=1), parameter(("PBEND", 5, field)))


def test_derivatives_of_arc_pipe_material_and_nodes() -> None:
    check_slopes(bend(p={**FULL, "RB": 2.5}, GEOM=3), parameter(("PBEND", 5, "RB")))
    check_slopes(
        bend(p={**FULL, "THETAB": 70.0}, GEOM=4), parameter(("PBEND", 5, "THETAB"))
    )
    for field in ("RM", "T"):
        check_slopes(
            bend(p={"FSI": 1, "RM": 0.1, "T": 0.02}), parameter(("PBEND", 5, field))
        )
    for field in ("E", "NU", "RHO"):
        check_slopes(bend(p=FULL), parameter(("MAT1", 1, field)))
    check_slopes(
        bend(p=FULL), Parameter("nodes", shapes=(Shape((2,), ((0.1, 0.2, 0.1),)),))
    )


@pytest.mark.parametrize(
    ("p", "more", "message"),
    [
        (SECTION, {"GEOM": 0}, r"CBEND 3.*GEOM must be 1 to 4"),
        (SECTION, {"GEOM": 3}, r"CBEND 3.*RB is less"),
        (SECTION, {"GEOM": 4}, r"CBEND 3.*angle"),
        (SECTION, {"X1": -1.0}, r"CBEND 3.*along the chord"),
        ({**SECTION, "J": 0.0}, {}, r"PBEND 5.*J must"),
        ({"FSI": 1, "RM": 2.0, "T": 0.1}, {}, r"PBEND 5.*RM \+ T/2"),
    ],
)
def test_what_is_missing_is_named(
    p: dict[str, float], more: dict[str, float], message: str
) -> None:
    with pytest.raises(DeckError, match=message):
        assemble(bend(p=p, **more))
