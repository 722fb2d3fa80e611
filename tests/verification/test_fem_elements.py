"""Every element: six rigid motions without energy, exact mass, and constant strain on distorted
meshes.

The patches are a unit square (cube) with inner nodes moved; a linear displacement (or, in bending,
a constant curvature) is imposed on the outside and must come out inside (Irons and Razzaque 1972).
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
    square,
    steel,
    triangles,
)

from ringtrue.core.arrays import Float
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.mesh import isotropic, nodes_of
from ringtrue.model.model import Model, Table

ROUNDING = 1e-9  # relative to the largest stiffness, after some thousand operations
CUBE = np.array(
    [
        [0, 0, 0],
        [1, 0, 0],
        [1, 1, 0],
        [0, 1, 0],
        [0, 0, 1],
        [1, 0, 1],
        [1, 1, 1],
        [0, 1, 1],
    ],
    dtype=float,
)


def skewed(x: Float, seed: int = 0, size: float = 0.12) -> Float:
    return x + size * np.random.default_rng(seed).uniform(-1, 1, x.shape)


def solid(card: str, xyz: Float, *nodes: list[int]) -> tuple[Table, ...]:
    g = {f"G{i + 1}": list(c) for i, c in enumerate(zip(*nodes, strict=True))}
    return (
        grid(xyz),
        cards(card, EID=list(range(1, len(nodes) + 1)), PID=1, **g),
        cards("PSOLID", PID=[1], MID=1),
    )


def tetra10() -> tuple[Table, ...]:
    corner = skewed(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]))
    mid = [
        (corner[i] + corner[j]) / 2
        for i, j in ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
    ]
    return solid("CTETRA", np.vstack([corner, mid]), list(range(1, 11)))


def beam(card: str, **more: object) -> tuple[Table, ...]:
    section = {"A": 0.01, "I1": 2e-5, "I2": 1e-5, "I12": 3e-6, "J": 3e-5}
    p = cards("PBAR", PID=[1], MID=1, **section)
    if card == "CBEAM":
        ends = {
            "AB": 0.02,
            "I1B": 4e-5,
            "I2B": 1e-5,
            "JB": 4e-5,
            "N1A": 0.05,
            "N1B": 0.05,
            "N2A": -0.02,
            "N2B": -0.02,
        }
        p = cards("PBEAM", PID=[1], MID=1, **section, **ends)
    offset = {"W1A": 0.1, "W2A": 0.2, "W3B": -0.3}
    line = cards(
        card, EID=[1], PID=1, GA=1, GB=2, X1=0.1, X2=1.0, X3=0.2, **offset, **more
    )
    return grid(np.array([[0, 0, 0], [1, 0.5, 0.3]])), line, p


def bush(**more: object) -> tuple[Table, ...]:
    k = {f"K{i}": 1e6 * i for i in range(1, 7)}
    at = grid(np.array([[0, 0, 0], [1, 0.5, 0.3]]), CD=np.array([0, 7]))
    frame = cards("CORD2R", CID=[7], A1=0.3, B1=0.3, B2=0.5, B3=1.0, C1=1.0)
    return (
        at,
        frame,
        cards("CBUSH", EID=[1], PID=1, GA=1, GB=2, **more),
        cards("PBUSH", PID=[1], **k),
    )


def warped() -> tuple[Table, ...]:
    xyz, quads = square(3, 1.0, 1.0)
    xyz[:, 2] = 0.3 * xyz[:, 0] * xyz[:, 1]
    return grid(skewed(xyz, 1, 0.05)), shells(quads, ZOFFS=0.07), pshell(0.02, NSM=3.0)


FREE = {
    "rod": (
        *beam("CBAR")[:1],
        cards("CROD", EID=[1], PID=1, G1=1, G2=2),
        cards("PROD", PID=[1], MID=1, A=1.0, J=1.0),
    ),
    "bar": beam("CBAR"),
    "bar pinned": beam("CBAR", PA="5", PB="456"),
    "beam": beam("CBEAM"),
    "shell4": warped(),
    "shell3": (warped()[0], triangles(square(3, 1.0, 1.0)[1]), pshell(0.02)),
    "hexa": solid("CHEXA", skewed(CUBE), list(range(1, 9))),
    "penta": solid("CPENTA", skewed(CUBE[[0, 1, 2, 4, 5, 6]]), list(range(1, 7))),
    "tetra4": solid("CTETRA", skewed(CUBE[[0, 1, 2, 5]]), [1, 2, 3, 4]),
    "tetra10": tetra10(),
    "bush": bush(X1=0.3, X2=1.0),
    "bush in a frame": bush(CID=7, S=0.2),
    "bush elsewhere": bush(CID=0, OCID=7, S1=0.4, S2=0.1, S3=-2.0),
}


@pytest.mark.parametrize("coupled", [-1, 1])
@pytest.mark.parametrize("name", FREE)
def test_rigid_motions_have_no_energy_and_the_whole_mass(
    name: str, coupled: int
) -> None:
    s = assemble(model(*FREE[name], steel(), AUTOSPC="NO", COUPMASS=coupled))
    R = s.rigid_body()
    assert np.abs(s.stiffness @ R).max() < ROUNDING * np.abs(s.stiffness).max()
    M = R[:, :3].T @ (s.mass @ R[:, :3])
    np.testing.assert_allclose(M, M[0, 0] * np.eye(3), atol=1e-9 * max(M[0, 0], 1.0))
    np.testing.assert_allclose(s.expand(R), _rigid(s), atol=1e-12)


def _rigid(s: System) -> Float:
    x, y, z = s.xyz.T
    o, i = np.zeros_like(x), np.ones_like(x)
    columns = [[i, o, o, o, o, o], [o, i, o, o, o, o], [o, o, i, o, o, o]]
    columns += [[o, -z, y, i, o, o], [z, o, -x, o, i, o], [-y, x, o, o, o, i]]
    return np.stack([np.stack(c, axis=1).ravel() for c in columns], axis=1)


@pytest.mark.parametrize(
    ("name", "zero"),
    [("shell4", 6), ("hexa", 6), ("penta", 6), ("tetra10", 6), ("beam", 6)],
)
def test_no_mechanisms_but_rigid_motions(name: str, zero: int) -> None:
    s = assemble(model(*FREE[name], steel()))
    lam = np.linalg.eigvalsh(s.stiffness.toarray())
    assert (np.abs(lam) < 1e-10 * lam[-1]).sum() == zero
    assert lam[zero] > 1e-10 * lam[-1]


def imposed(m: Model, outside: Float, u: Float) -> Float:
    """The largest error inside when the motion u (n, 6) is imposed on the nodes `outside`."""
    s = assemble(m)
    full = s.local @ u.ravel()
    node = s.free.node - 1
    held, free = np.flatnonzero(outside[node]), np.flatnonzero(~outside[node])
    K = s.stiffness.toarray()
    x = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, held)] @ full[held])
    return float(np.abs(x - full[free]).max() / np.abs(u).max())


def plate_patch() -> tuple[Float, Float, Float]:
    xyz, quads = square(3, 1.0, 1.0)
    inner = (np.abs(xyz[:, :2] - 0.5) < 0.4).all(axis=1)
    xyz[inner, :2] += np.array(
        [[0.09, -0.05], [-0.1, 0.04], [0.03, 0.11], [0.05, -0.08]]
    )
    return xyz, quads, ~inner


@pytest.mark.parametrize("make", [shells, triangles])
def test_patch_membrane(make: object) -> None:
    xyz, quads, outside = plate_patch()
    u = np.zeros((len(xyz), 6))
    u[:, :2] = xyz[:, :2] @ np.array([[1.0, 0.3], [0.7, -0.4]])
    u[:, 5] = (0.3 - 0.7) / 2
    assert (
        imposed(model(grid(xyz), make(quads), pshell(0.1), steel()), outside, u)
        < ROUNDING
    )


@pytest.mark.parametrize("make", [shells, triangles])
def test_patch_bending(make: object) -> None:
    xyz, quads, outside = plate_patch()
    x, y = xyz[:, 0], xyz[:, 1]
    u = np.zeros((len(xyz), 6))
    u[:, 2] = x**2 + 0.7 * x * y - 0.4 * y**2
    u[:, 3], u[:, 4] = 0.7 * x - 0.8 * y, -(2 * x + 0.7 * y)
    assert (
        imposed(model(grid(xyz), make(quads), pshell(0.01), steel()), outside, u) < 1e-7
    )  # t² of conditioning


def linear(xyz: Float) -> Float:
    u = np.zeros((len(xyz), 6))
    u[:, :3] = xyz @ np.array([[1.0, 0.3, 0.2], [0.7, -0.4, 0.1], [-0.2, 0.5, 0.6]])
    return u


def test_patch_hexa() -> None:
    """Seven distorted hexahedra (MacNeal and Harder 1985)."""
    xyz = np.vstack([CUBE, skewed(0.33 + 0.34 * CUBE, 3, 0.06)])
    faces = [
        [0, 1, 2, 3],
        [4, 7, 6, 5],
        [0, 4, 5, 1],
        [1, 5, 6, 2],
        [2, 6, 7, 3],
        [3, 7, 4, 0],
    ]
    hexas = [[*(i + 1 for i in f), *(i + 9 for i in f)] for f in faces] + [
        [*range(9, 17)]
    ]
    assert (
        imposed(
            model(*solid("CHEXA", xyz, *hexas), steel()), np.arange(16) < 8, linear(xyz)
        )
        < ROUNDING
    )


def test_patch_penta() -> None:
    """Two layers of refined wedges over the plate's patch, the layer between them buckled."""
    flat, quads, outside = plate_patch()
    n = len(flat)
    xyz = np.vstack([flat + np.array([0, 0, z]) for z in (0.0, 0.3, 0.7)])
    inside = np.concatenate([outside, outside, outside]) == 0
    inside[:n] = inside[2 * n :] = False
    xyz[inside] = skewed(xyz[inside], 4, 0.05)
    base = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    wedges = [[*(t + k * n), *(t + (k + 1) * n)] for k in (0, 1) for t in base]
    m = model(*solid("CPENTA", xyz, *wedges), steel(), RESBEND="NO")
    assert imposed(m, ~inside, linear(xyz)) < ROUNDING


def test_in_plane_bending_of_one_row_of_quads() -> None:
    """Pure bending of a 10 x 1 strip in its plane: the end turns by M L/EI, without shear
    locking.
    """
    xyz, quads = square(5, 10.0, 1.0, 1)
    left = np.flatnonzero(xyz[:, 0] == 0) + 1
    held = cards("SPC1", SID=[1, 1], C=["1", "2"], G=ragged(left, left[:1]))
    s = assemble(
        model(
            grid(xyz, PS="345"), shells(quads), pshell(0.1), steel(nu=0.0), held, spc=1
        )
    )
    end = s.free.find(np.flatnonzero(xyz[:, 0] == 10) + 1, np.array([1, 1]))
    f = np.zeros(len(s.free))
    f[end] = [1.0, -1.0]
    u = np.linalg.solve(s.stiffness.toarray(), f)[end]
    assert u[0] - u[1] == pytest.approx(
        10 / (2e11 * 0.1 / 12), rel=1e-3
    )  # the drilling springs are 4e-4 of G


def test_a_rod_without_length_is_refused() -> None:
    rod = cards("CONROD", EID=[3], MID=1, G1=1, G2=2, A=1.0)
    with pytest.raises(DeckError, match=r"CONROD 3.*one place"):
        assemble(model(grid(np.zeros((2, 3))), steel(), rod))


@pytest.mark.parametrize("corner", [(0.5, 0.5, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_a_quad_that_is_a_triangle_is_refused(
    corner: tuple[float, float, float],
) -> None:
    xyz = np.array([[0, 0, 0], [1, 0, 0], corner, [0, 1, 0]])
    with pytest.raises(DeckError, match=r"CQUAD4 1.*180 degrees"):
        assemble(
            model(
                grid(xyz),
                cards("CQUAD4", EID=[1], PID=1, G1=1, G2=2, G3=3, G4=4),
                pshell(0.1),
                steel(),
            )
        )


def test_inside_out_hexa_is_refused() -> None:
    with pytest.raises(DeckError, match=r"CHEXA 1.*node order"):
        assemble(model(*solid("CHEXA", CUBE, [4, 3, 2, 1, 8, 7, 6, 5]), steel()))


def test_coincident_bush_and_celas_frequency() -> None:
    """A mass of 2 on a spring of 8: sqrt(8/2)/2π, by CBUSH, CELAS1 and CELAS2 alike."""
    xyz = grid(np.zeros((2, 3)), PS=np.array(["123456", "23456"]))
    tip = cards("CONM2", EID=[9], G=2, M=2.0)
    by = [
        (
            cards("CBUSH", EID=[1], PID=1, GA=1, GB=2, CID=0),
            cards("PBUSH", PID=[1], K1=8.0),
        ),
        (cards("CBUSH", EID=[1], PID=1, GA=2, CID=0), cards("PBUSH", PID=[1], K1=8.0)),
        (
            cards("CELAS1", EID=[1], PID=1, G1=1, C1=1, G2=2, C2=1),
            cards("PELAS", PID=[1], K=8.0),
        ),
        (cards("CELAS2", EID=[1], K=8.0, G1=2, C1=1),),
    ]
    for tables in by:
        assert modes(model(xyz, tip, *tables), 1)[0] == pytest.approx(
            1 / np.pi, rel=1e-12
        )


def test_scalar_points() -> None:
    """Two masses of 1 on a chain of springs ground-1-2: λ = (3 ± √5)/2."""
    m = model(
        grid(np.zeros((1, 3))),
        cards("SPOINT", ID=ragged([10, 11])),
        cards("CELAS2", EID=[1, 2], K=1.0, G1=[10, 10], C1=0, G2=[0, 11]),
        cards("CMASS2", EID=[3, 4], M=1.0, G1=[10, 11]),
    )
    want = np.sqrt((3 + np.sqrt(5) * np.array([-1, 1])) / 2) / (2 * np.pi)
    np.testing.assert_allclose(modes(m, 2), want, rtol=1e-12)


@pytest.mark.parametrize(
    ("given", "full"),
    [
        ({"E": 2.0, "NU": 0.25}, (2.0, 0.8, 0.25)),
        ({"E": 2.0, "NU": 0.0}, (2.0, 1.0, 0.0)),
        ({"E": 2.0, "G": 0.8}, (2.0, 0.8, 0.25)),
        ({"G": 0.8, "NU": 0.25}, (2.0, 0.8, 0.25)),
        # as given, though they do not agree
        ({"E": 2.0, "G": 0.9, "NU": 0.0}, (2.0, 0.9, 0.0)),
        ({"E": 2.0}, (2.0, 0.0, 0.0)),
        ({"G": 2.0}, (0.0, 2.0, 0.0)),
    ],
)
def test_blanks_of_mat1(
    given: dict[str, float], full: tuple[float, float, float]
) -> None:
    """Quick Reference Guide, MAT1: NU and one of E and G that are both blank are both 0."""
    mat = cards("MAT1", MID=[1], **given)
    found = isotropic(nodes_of(model(grid([[0, 0, 0]]), mat)).rows("MAT1"))
    assert (found.E[0], found.G[0], found.nu[0]) == pytest.approx(full)
