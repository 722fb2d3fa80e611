"""How good the solid elements are: rates of convergence, slender and skewed beams, near
incompressibility, NAFEMS.

Sliding cube: a unit cube whose faces move in their plane only. A shear wave with the wave vector π
(1, 1, 0) fits it: ω² = 2 π² G / ρ, three times. The faces hold the tests to the field, not to a
beam or plate theory.

Thick cylinder (MacNeal and Harder 1985): radii 3 and 9, plane strain, pressure p inside;
u(3) = (1 + ν) p 9 / (72 E) (81 / 3 + 3 (1 - 2ν)).
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, modes, ragged, spc, steel
from scipy.sparse.linalg import eigsh, spsolve
from solid_meshes import ELEMENTS, box, cut, distorted, elements, kind, psolid

from ringtrue.core.arrays import Float
from ringtrue.fem.assembly import System, assemble


def sliding_cube(name: str, n: int, size: float, nu: float = 0.3) -> float:
    """Relative error of ω², mean of the three, on n³ cells with nodes moved by up to `size` of a
    cell.
    """
    xyz, hexas = box(n, n, n, (1.0, 1.0, 1.0))
    xyz, nodes = cut(name, distorted(xyz, size / n), hexas)
    held = np.full(len(xyz), "", dtype="U3")
    for a in range(3):
        on = (xyz[:, a] < 1e-9) | (xyz[:, a] > 1 - 1e-9)
        held = np.where(on, np.char.add(held, str(a + 1)), held)
    m = model(
        grid(xyz, PS=held),
        elements(kind(name)[0], nodes),
        psolid(),
        steel(1.0, nu, 1.0),
        COUPMASS=1,
    )
    s = assemble(m)
    start = np.random.default_rng(0).normal(size=len(s.free))
    lam = eigsh(
        s.stiffness.tocsc(),
        3,
        s.mass.tocsc(),
        sigma=0.0,
        v0=start,
        return_eigenvectors=False,
    )
    return float(lam.mean() / (2 * np.pi**2 / (2 * (1 + nu))) - 1)


@pytest.mark.parametrize("size", [0.0, 0.2])
@pytest.mark.parametrize(
    ("name", "rate"),
    [
        *(("CHEXA8", 2), ("CPENTA6", 2), ("CTETRA4", 2), ("CPYRAM5", 2)),
        *(("CHEXA20", 4), ("CPENTA15", 4), ("CTETRA10", 4), ("CPYRAM13", 4)),
    ],
)
def test_rate_of_convergence(name: str, rate: int, size: float) -> None:
    """h² for linear elements, h⁴ for those of second order; from coarse meshes, hence within
    0.75.
    """
    coarse, fine = (sliding_cube(name, n, size) for n in (2, 4))
    assert 0 < fine < coarse
    assert np.log2(coarse / fine) == pytest.approx(rate, abs=0.75)
    assert fine < (0.35 if rate == 2 else 0.007)


@pytest.mark.parametrize(
    ("name", "worse"),
    [("CHEXA8", 2.2), ("CHEXA20", 1.25), ("CPYRAM5", 2.2), ("CPYRAM13", 1.25)],
)
def test_nearly_incompressible_cube(name: str, worse: float) -> None:
    """ν = 0.499 makes the error of the shear wave, which does not dilate, at most so many times
    that of ν = 0.3.
    """
    assert sliding_cube(name, 4, 0.2, 0.499) < worse * sliding_cube(name, 4, 0.2)


def cantilever(
    name: str,
    cells: tuple[int, int, int],
    size: tuple[float, float, float],
    skew: float = 0.0,
) -> float:
    """Tip deflection under a load across, over that of a Timoshenko beam; `skew` leans the cells
    alternately.
    """
    L, W, H = size
    xyz, hexas = box(*cells, size)
    i = np.round(xyz[:, 0] * cells[0] / L).astype(int)
    lean = np.where((i > 0) & (i < cells[0]), np.where(i % 2, -skew, skew), 0.0)
    xyz[:, 0] += lean * (2 * xyz[:, 2] / H - 1)
    xyz, nodes = cut(name, xyz, hexas)
    root = np.flatnonzero(xyz[:, 0] < 1e-9) + 1
    m = model(
        grid(xyz),
        elements(kind(name)[0], nodes),
        psolid(),
        steel(1.0),
        spc(root, "123"),
        spc=1,
    )
    s = assemble(m)
    f, tip = _end_load(s, xyz, L)
    u = spsolve(s.stiffness.tocsc(), f)[tip].mean()
    inertia, G = W * H**3 / 12, 1 / 2.6
    return float(u / (L**3 / 3 / inertia + L / (5 / 6 * G * W * H)))


def _end_load(s: System, xyz: Float, length: float) -> tuple[Float, Float]:
    nodes = np.flatnonzero(xyz[:, 0] > length - 1e-9) + 1
    tip = s.free.find(nodes, np.full(nodes.size, 3))
    f = np.zeros(len(s.free))
    f[tip] = 1 / tip.size
    return f, tip


@pytest.mark.parametrize(
    "name", ["CHEXA8", "CHEXA20", "CPENTA15", "CTETRA10", "CPYRAM13"]
)
def test_slender_cantilever(name: str) -> None:
    """One layer of cells ten times as long as high; the clamped root makes it a little stiffer than
    the beam.
    """
    assert cantilever(name, (10, 1, 1), (100.0, 1.0, 1.0)) == pytest.approx(
        1.0, abs=0.03
    )


@pytest.mark.parametrize(
    ("name", "least"),
    [("CHEXA20", 0.97), ("CPENTA15", 0.97), ("CTETRA10", 0.95), ("CPYRAM13", 0.95)],
)
def test_slender_beam_of_trapezia(name: str, least: float) -> None:
    """MacNeal and Harder's slender beam, 6 x 0.2 x 0.1, six cells whose sides lean by 14 degrees to
    and fro.
    """
    assert least < cantilever(name, (6, 1, 1), (6.0, 0.1, 0.2), 0.025) < 1.01


def cylinder(name: str, nu: float) -> float:
    """Radial motion of the inside over the closed form; a sector of 10 degrees, five cells."""
    xyz, hexas = box(5, 1, 1, (5.0, 1.0, 1.0))
    xyz, nodes = cut(name, xyz, hexas)
    r = np.interp(xyz[:, 0], np.arange(6), [3, 3.5, 4.2, 5.2, 6.75, 9])
    t = np.radians(10) * xyz[:, 1]
    x = np.column_stack([r * np.cos(t), r * np.sin(t), xyz[:, 2]])
    frame = cards("CORD2C", CID=[5], B3=1.0, C1=1.0)
    s = assemble(
        model(
            grid(x, CD=5, PS="23"),
            frame,
            elements(kind(name)[0], nodes),
            psolid(),
            steel(1000.0, nu),
        )
    )
    inside = np.flatnonzero(xyz[:, 0] < 1e-9)
    middle = (np.abs(xyz[inside, 1:] - 0.5) < 1e-9).any(axis=1)
    share = (
        np.where(middle, 1 / 3, -1 / 12) if middle.any() else np.full(inside.size, 0.25)
    )
    f, at = (
        np.zeros(len(s.free)),
        s.free.find(inside + 1, np.ones(inside.size, dtype=int)),
    )
    f[at] = share * 6 * np.sin(np.radians(5))
    u = share @ spsolve(s.stiffness.tocsc(), f)[at]
    return float(u / ((1 + nu) / 1000 / 8 * (27 + 3 * (1 - 2 * nu))))


@pytest.mark.parametrize("nu", [0.3, 0.49, 0.499, 0.4999])
@pytest.mark.parametrize("name", ["CHEXA8", "CHEXA20", "CPYRAM13"])
def test_thick_cylinder(name: str, nu: float) -> None:
    assert cylinder(name, nu) == pytest.approx(
        1.0, abs=0.012 if name == "CHEXA8" else 0.003
    )


NAFEMS_HEX20 = [
    44.762,
    110.52,
    110.52,
    169.08,
    193.93,
    206.64,
    206.64,
]  # its own 4 x 4 x 1 elements of 20 nodes
THICK_PLATE = [
    45.897,
    109.44,
    109.44,
    167.89,
    193.59,
    206.19,
    206.19,
]  # closed form, held at mid-plane


@pytest.mark.parametrize(
    ("name", "cells", "want", "tolerance"),
    [
        ("CHEXA8", (8, 8, 3), THICK_PLATE, 0.05),
        ("CHEXA20", (4, 4, 1), NAFEMS_HEX20, 0.01),
        ("CPENTA15", (4, 4, 1), THICK_PLATE, 0.05),
    ],
)
def test_fv52_thick_plate(
    name: str, cells: tuple[int, int, int], want: list[float], tolerance: float
) -> None:
    """NAFEMS FV52: 10 x 10 x 1, simply supported at the lower edges of its sides; three rigid modes
    first.

    A solid held along a line yields there without end as the mesh is refined, and a plate held at
    its lower edges is softer than one held at mid-plane: the same mesh is compared where the
    target's authors gave its result.
    """
    xyz, hexas = box(*cells, (10.0, 10.0, 1.0))
    xyz, nodes = cut(name, xyz, hexas)
    rim = ((xyz[:, :2] < 1e-9) | (xyz[:, :2] > 10 - 1e-9)).any(axis=1) & (
        xyz[:, 2] < 1e-9
    )
    held = spc(np.flatnonzero(rim) + 1, "3")
    m = model(
        grid(xyz),
        elements(kind(name)[0], nodes),
        psolid(),
        steel(),
        held,
        spc=1,
        COUPMASS=1,
    )
    f = modes(m, 10)
    assert (np.abs(f[:3]) < 1e-2).all()
    np.testing.assert_allclose(f[3:], want, rtol=tolerance)


@pytest.mark.parametrize("name", ELEMENTS)
def test_lumped_mass_against_coupled(name: str) -> None:
    """First bending of a free bar, eight cells long: lumping lowers it by a term of h², less with
    midside nodes.
    """

    def first(coupled: int) -> float:
        xyz, hexas = box(8, 1, 1, (8.0, 1.0, 1.0))
        xyz, nodes = cut(name, xyz, hexas)
        m = model(
            grid(xyz),
            elements(kind(name)[0], nodes),
            psolid(),
            steel(),
            COUPMASS=coupled,
        )
        return float(modes(m, 7)[6])

    assert first(-1) == pytest.approx(first(1), rel=0.06 if kind(name)[1] else 0.12)


def test_held_nodes_and_constraints_do_not_change_the_sum() -> None:
    """The matrices of a body in parts, with other frames (CD) and SPCs, are those of the whole,
    transformed.
    """
    xyz, hexas = box(3, 2, 2, (1.0, 1.0, 1.0))
    frame = cards("CORD2R", CID=[7], B1=0.3, B2=0.5, B3=1.0, C1=1.0)
    table, psol = elements("CHEXA", hexas), psolid()
    whole = assemble(model(grid(xyz), table, psol, steel()))
    turned = assemble(model(grid(xyz, CD=7), frame, table, psol, steel()))
    a, b = (np.linalg.eigvalsh(s.stiffness.toarray()) for s in (whole, turned))
    np.testing.assert_allclose(b, a, atol=1e-12 * a[-1])
    root = np.arange(1, 10)
    held = assemble(
        model(
            grid(xyz),
            table,
            psol,
            steel(),
            cards("SPC1", SID=[1], C=["13"], G=ragged(root)),
            spc=1,
        )
    )
    at = whole.free.find(held.free.node, held.free.direction)
    gap = held.stiffness - whole.stiffness[at][:, at]
    assert abs(gap).max() == 0.0
    assert abs(whole.stiffness - whole.stiffness.T).max() == 0.0
