"""Frequencies against closed forms (with their rates of convergence) and the NAFEMS benchmarks.

NAFEMS: "The Standard NAFEMS Benchmarks", rev. 3 (1990), tests FV2, FV12, FV16, FV32, FV52; the
targets are there.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import (
    cards,
    grid,
    model,
    modes,
    pshell,
    ragged,
    shells,
    spc,
    square,
    steel,
    triangles,
)

from ringtrue.core.arrays import Float
from ringtrue.model.model import Model

E, RHO, NU = 2e11, 8000.0, 0.3


def line(n: int, length: float) -> Float:
    return np.column_stack([np.linspace(0, length, n + 1), np.zeros((n + 1, 2))])


def chain(card: str, n: int, prop: object, **more: object) -> tuple[object, ...]:
    i = np.arange(1, n + 1)
    g = {"G1": i, "G2": i + 1} if card == "CROD" else {"GA": i, "GB": i + 1, "X2": 1.0}
    return cards(card, EID=i, PID=1, **g, **more), prop, steel()


def rates(errors: list[float]) -> Float:
    """Orders of convergence as the element size halves."""
    return np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))


@pytest.mark.parametrize(("coupled", "order"), [(-1, 2), (1, 4)])
def test_fixed_free_rod(coupled: int, order: int) -> None:
    """f = sqrt(E/ρ)/(4L); the coupled mass, mean of lumped and consistent, is of fourth order."""
    L, exact = 3.0, np.sqrt(E / RHO) / 12
    rod = cards("PROD", PID=[1], MID=1, A=0.01)
    f = [
        modes(
            model(
                grid(line(n, L), PS="23456"),
                *chain("CROD", n, rod),
                spc([1], "1"),
                spc=1,
                COUPMASS=coupled,
            ),
            1,
        )[0]
        for n in (4, 8, 16)
    ]
    np.testing.assert_allclose(rates([x / exact - 1 for x in f]), order, atol=0.1)


def cantilever(n: int, coupled: int, **pbar: float) -> Model:
    bar = cards("PBAR", PID=[1], MID=1, A=0.01, I1=1e-5, I2=2e-5, J=1e-5, **pbar)
    nodes = grid(line(n, 2.0), PS="1345")
    return model(nodes, *chain("CBAR", n, bar), spc([1], "26"), spc=1, COUPMASS=coupled)


@pytest.mark.parametrize(("coupled", "order"), [(-1, 2), (1, 4)])
def test_cantilever(coupled: int, order: int) -> None:
    """f = 1.8751041²/(2π L²) sqrt(EI/ρA)."""
    exact = 1.875104068711961**2 / (2 * np.pi * 4) * np.sqrt(E * 1e-5 / (RHO * 0.01))
    f = [modes(cantilever(n, coupled), 1)[0] for n in (2, 4, 8)]
    np.testing.assert_allclose(rates([x / exact - 1 for x in f]), order, atol=0.15)


def test_shear_flexibility_of_a_beam_is_exact_at_its_end() -> None:
    """Massless cantilever with a tip mass: δ = L³/3EI + L/kGA, one element."""
    k, G = 0.5, E / 2.6
    bar = cards("PBAR", PID=[1], MID=1, A=0.01, I1=1e-5, I2=2e-5, J=1e-5, K1=k)
    tip = cards("CONM2", EID=[99], G=2, M=1000.0)
    m = model(
        grid(line(1, 0.5), PS="1345"),
        *chain("CBAR", 1, bar)[:2],
        cards("MAT1", MID=[1], E=E, NU=NU),
        spc([1], "26"),
        tip,
        spc=1,
    )
    flexibility = 0.5**3 / (3 * E * 1e-5) + 0.5 / (k * G * 0.01)
    assert modes(m, 1)[0] == pytest.approx(
        1 / np.sqrt(1000 * flexibility) / (2 * np.pi), rel=1e-10
    )


def double_cross(n: int) -> Model:
    angle = np.arange(8) * np.pi / 4
    r = np.linspace(0, 5, n + 1)[1:]
    arms = np.stack(
        [np.outer(np.cos(angle), r), np.outer(np.sin(angle), r), np.zeros((8, n))],
        axis=-1,
    )
    number = np.arange(8 * n).reshape(8, n) + 2
    ga = np.concatenate([np.ones((8, 1), dtype=int), number[:, :-1]], axis=1)
    elements = cards(
        "CBAR",
        EID=np.arange(1, 8 * n + 1),
        PID=1,
        GA=ga.ravel(),
        GB=number.ravel(),
        X3=1.0,
    )
    side = 0.125
    area, second = side**2, side**4 / 12
    bar = cards("PBAR", PID=[1], MID=1, A=area, I1=second, I2=second, J=2 * second)
    nodes = grid(np.vstack([np.zeros((1, 3)), arms.reshape(-1, 3)]), PS="345")
    return model(
        nodes, elements, bar, steel(), spc(number[:, -1], "12"), spc=1, COUPMASS=1
    )


def test_fv2_pin_ended_double_cross() -> None:
    f = modes(double_cross(4), 16)
    np.testing.assert_allclose(
        f[[0, 8]], [11.336, 45.345], rtol=5e-3
    )  # NAFEMS' own finite element answers differ so
    np.testing.assert_allclose(f[1:8], 17.709, rtol=5e-3)
    np.testing.assert_allclose(f[9:16], 57.390, rtol=1e-2)


FV12 = np.array([1.622, 2.360, 2.922])
FREE_PLATE = np.array(
    [13.468, 19.596, 24.270, 34.801, 34.801, 61.093, 61.093]
)  # ω a² sqrt(ρh/D), ν = 0.3; Gorman 1978
FV16 = np.array([0.421, 1.029, 2.582, 3.306, 3.753, 6.555])


@pytest.mark.parametrize("make", [shells, triangles])
def test_fv12_free_thin_square_plate(make: object) -> None:
    """Extrapolated from 12 x 12 and 24 x 24. NAFEMS targets 4.233 and 7.416 are those of a mesh, not
    of a plate.
    """
    f = []
    for n in (12, 24):
        xyz, quads = square(n, 10.0, 10.0)
        f.append(
            modes(model(grid(xyz, PS="126"), make(quads), pshell(0.05), steel()), 10)
        )
    assert (np.abs(f[1][:3]) < 1e-3).all()
    limit = (f[1] + (f[1] - f[0]) / 3)[3:]
    bending = E * 0.05**3 / 12 / (1 - NU**2)
    exact = FREE_PLATE / (2 * np.pi * 100) * np.sqrt(bending / (RHO * 0.05))
    np.testing.assert_allclose(limit[:5], exact[:5], rtol=3e-3)
    np.testing.assert_allclose(
        limit[5:], exact[5:], rtol=2e-2 if make is triangles else 3e-3
    )
    np.testing.assert_allclose(limit[:3], FV12, rtol=3e-3)


@pytest.mark.parametrize("make", [shells, triangles])
def test_fv16_cantilevered_thin_square_plate(make: object) -> None:
    """0.421 Hz is the target of a thin plate series; a converged plate has 0.418."""
    xyz, quads = square(14, 10.0, 10.0)
    root = spc(np.flatnonzero(xyz[:, 0] == 0) + 1, "12345")
    m = model(grid(xyz, PS="126"), make(quads), pshell(0.05), steel(), root, spc=1)
    np.testing.assert_allclose(modes(m, 6), FV16, rtol=4e-2)


def test_fv32_tapered_membrane() -> None:
    xyz, quads = square(16, 1.0, 1.0, 8)
    x, y = xyz[:, 0], xyz[:, 1]
    plane = np.column_stack([10 * x, (y - 0.5) * (5 - 4 * x), 0 * x])
    root = spc(np.flatnonzero(x == 0) + 1, "12")
    by_mass = [
        modes(
            model(
                grid(plane, PS="345"),
                shells(quads),
                pshell(0.05),
                steel(),
                root,
                spc=1,
                COUPMASS=c,
            ),
            6,
        )
        for c in (-1, 1)
    ]
    want = [44.623, 130.03, 162.70, 246.05, 379.90, 391.44]
    np.testing.assert_allclose(
        np.mean(by_mass, axis=0), want, rtol=1e-2
    )  # lumped is low, coupled high


def test_fv52_simply_supported_solid_plate() -> None:
    """10 x 10 x 1, w = 0 along the lower edges; 8 x 8 x 3 hexahedra. Three rigid motions in the
    plane first.

    The target is that of a thick plate held at its mid-plane; a solid held at its lower edges is
    softer.
    """
    n, layers = 8, 3
    grid_of = np.meshgrid(
        np.linspace(0, 10, n + 1),
        np.linspace(0, 10, n + 1),
        np.linspace(0, 1, layers + 1),
        indexing="ij",
    )
    xyz = np.stack([g.ravel() for g in grid_of], axis=1)
    i = np.arange(len(xyz)).reshape(n + 1, n + 1, layers + 1)
    base = [(0, 0), (1, 0), (1, 1), (0, 1)]
    corner = [
        i[a : n + a, b : n + b, c : layers + c].ravel() + 1
        for c in (0, 1)
        for a, b in base
    ]
    edge = (xyz[:, 2] == 0) & ((xyz[:, :2] == 0) | (xyz[:, :2] == 10)).any(axis=1)
    m = model(
        grid(xyz),
        cards(
            "CHEXA",
            EID=np.arange(corner[0].size) + 1,
            PID=1,
            **{f"G{k + 1}": c for k, c in enumerate(corner)},
        ),
        cards("PSOLID", PID=[1], MID=1),
        steel(),
        spc(np.flatnonzero(edge) + 1, "3"),
        spc=1,
        COUPMASS=1,
    )
    f = modes(m, 7)
    assert (np.abs(f[:3]) < 1e-2).all()
    np.testing.assert_allclose(f[3:], [45.897, 109.44, 109.44, 167.89], rtol=5e-2)


def test_offset_mass_on_a_rigid_arm() -> None:
    """CONM2 at 0.5 from a torsion spring: f = sqrt(k/(I + m r²))/2π, through an RBE2 or its own
    offset alike.
    """
    spring = cards("CELAS2", EID=[1], K=100.0, G1=1, C1=6)
    want = np.sqrt(100 / (0.3 + 2 * 0.25)) / (2 * np.pi)
    own = cards("CONM2", EID=[2], G=1, M=2.0, X1=0.5, I33=0.3)
    at_end = cards("CONM2", EID=[2], G=2, M=2.0, I33=0.3)
    arm = cards("RBE2", EID=[3], GN=1, CM="123456", GM=ragged([2]))
    held = grid([[0, 0, 0]], PS="12345")
    both = grid([[0, 0, 0], [0.5, 0, 0]], PS=np.array(["12345", ""]))
    for m in (model(held, spring, own), model(both, spring, at_end, arm)):
        assert modes(m, 1)[0] == pytest.approx(want, rel=1e-12)
