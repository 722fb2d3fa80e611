"""Solid elements on distorted meshes: rigid motions, patches, mass, anisotropy, missing midside
nodes, complex step.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from fem_cases import cards, grid, model, steel
from solid_meshes import ELEMENTS, SECOND, box, cut, distorted, elements, kind, psolid

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import CardField
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.fem.element_cards import SOLIDS, batches, mesh, pieces
from ringtrue.fem.elements.elasticity import nearest, tensor, turned
from ringtrue.fem.elements.solid import pyramid_quadratic as pyramid13
from ringtrue.fem.parametrisation.changed_model import rows_of
from ringtrue.model.cards import (
    HEXAHEDRON,
    QUADRILATERAL,
    TETRAHEDRON,
    TRIANGLE,
    WEDGE,
    ElementShape,
)
from ringtrue.model.model import Model, Table

ROUNDING = 1e-9  # relative to the largest stiffness, after some thousand operations
E, NU, RHO = 2e11, 0.3, 8000.0
GRADIENT = np.array([[1.0, 0.3, 0.2], [0.7, -0.4, 0.1], [-0.2, 0.5, 0.6]])


def cube(name: str, n: int = 2, size: float = 0.1) -> tuple[Float, Int]:
    """A cube of n³ cells with the nodes inside moved; midside nodes on straight edges."""
    xyz, hexas = box(n, n, n, (1.0, 1.0, 1.0))
    return cut(name, distorted(xyz, size), hexas)


def skewed(name: str) -> tuple[Float, Int]:
    """One cell, all nodes moved: faces warped and, with midside nodes, edges curved."""
    xyz, nodes = cube(name, 1)
    return xyz + 0.05 * np.random.default_rng(1).uniform(-1, 1, xyz.shape), nodes


def body(name: str, xyz: Float, nodes: Int, *more: Table, **params: object) -> Model:
    more = more or (steel(E, NU, RHO), psolid())
    return model(grid(xyz), elements(kind(name)[0], nodes), *more, **params)


def mat9(C: Float, rho: float = RHO) -> Table:
    """MAT9 2 with the matrix (6, 6)."""
    terms = {f"G{i + 1}{j + 1}": C[i, j] for i in range(6) for j in range(i, 6)}
    return cards("MAT9", MID=[2], RHO=rho, **terms)


def isotropic() -> Float:
    c = E / (1 + NU) / (1 - 2 * NU)
    C = np.zeros((6, 6))
    C[:3, :3] = c * NU
    C[np.diag_indices(6)] = [c * (1 - NU)] * 3 + [E / 2 / (1 + NU)] * 3
    return C


def crystal(seed: int = 0) -> Float:
    """A positive definite matrix without any symmetry of a crystal."""
    A = np.random.default_rng(seed).normal(size=(6, 6))
    return 1e11 * (np.eye(6) + 0.1 * A @ A.T)


def patch(m: Model, xyz: Float, u: Float) -> float:
    """The largest error inside when the motion u (n, 3) is imposed on the faces of the unit
    cube.
    """
    s = assemble(m)
    full = np.zeros((len(xyz), 6))
    full[:, :3] = u
    want = s.local @ full.ravel()
    outside = ((xyz < 1e-9) | (xyz > 1 - 1e-9)).any(axis=1)[s.free.node - 1]
    held, free = np.flatnonzero(outside), np.flatnonzero(~outside)
    K = s.stiffness.toarray()
    x = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, held)] @ want[held])
    return float(np.abs(x - want[free]).max() / np.abs(u).max())


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "shape",
    [TRIANGLE, QUADRILATERAL, TETRAHEDRON, WEDGE, HEXAHEDRON],
    ids=lambda s: len(s.corners),
)
def test_shape_functions_are_one_at_their_node(shape: ElementShape, order: int) -> None:
    points = shape.nodes(order)
    values, slopes = shape.functions(order, points)
    np.testing.assert_allclose(values, np.eye(len(points)), atol=1e-14)
    np.testing.assert_allclose(slopes.sum(axis=1), 0.0, atol=1e-14)
    inside = points.mean(axis=0) + 0.1 * np.arange(points.shape[1])
    ahead, back = (
        shape.functions(order, inside + h * np.eye(points.shape[1]))[0]
        for h in (1e-6, -1e-6)
    )
    want = shape.functions(order, inside[None])[1][0]
    np.testing.assert_allclose((ahead - back).T / 2e-6, want, atol=1e-8)


def test_shape_functions_of_the_pyramid() -> None:
    """In (a, b, ζ): the apex is all of ζ = 1, the middles of the rising edges are at a, b = ±1, ζ =
    1/2.
    """
    ab = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    middle = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])
    points = np.vstack(
        [
            np.column_stack([ab, np.zeros(4)]),
            [[0.3, -0.2, 1.0]],
            np.column_stack([middle, np.zeros(4)]),
            np.column_stack([ab, np.full(4, 0.5)]),
        ]
    )
    np.testing.assert_allclose(pyramid13(points)[0], np.eye(13), atol=1e-14)


@pytest.mark.parametrize("coupled", [-1, 1])
@pytest.mark.parametrize("name", ELEMENTS)
def test_rigid_motions_mechanisms_and_mass(name: str, coupled: int) -> None:
    xyz, nodes = skewed(name)
    s = assemble(body(name, xyz, nodes, AUTOSPC="YES", COUPMASS=coupled))
    R = s.rigid_body()
    lam = np.linalg.eigvalsh(s.stiffness.toarray())
    assert np.abs(s.stiffness @ R).max() < ROUNDING * np.abs(s.stiffness).max()
    assert (lam < 1e-9 * lam[-1]).sum() == 6
    massless = name == "CTETRA10" and coupled < 0  # its corners, as in Nastran
    assert (s.mass.diagonal() == 0).any() if massless else s.mass.diagonal().min() > 0
    M = R[:, :3].T @ (s.mass @ R[:, :3])
    np.testing.assert_allclose(M, M[0, 0] * np.eye(3), atol=1e-9 * M[0, 0])


def test_lumped_mass_of_ten_nodes_has_its_centre_where_the_body_has() -> None:
    """Nothing at the corners, first moments right, and the same from whatever corner one counts; a
    missing midside node leaves its share to the corners of its edge.
    """
    corners = np.vstack([np.zeros(3), np.diag([1.0, 2.0, 3.0])])
    ends = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])

    def shares(corners: Float, there: int) -> tuple[Float, Float]:
        xyz = np.vstack([corners, corners[ends].mean(axis=1)])[:there]
        nodes = np.arange(there)[None]
        s = assemble(model(grid(xyz), elements("CTETRA", nodes), psolid(), steel()))
        out = np.zeros(there)
        out[s.free.node[::3] - 1] = s.mass.diagonal()[::3]
        return out / out.sum(), xyz

    whole, xyz = shares(corners, 10)
    assert (whole[:4] == 0).all()
    assert whole[4:].min() > 0.1
    np.testing.assert_allclose(whole @ xyz, corners.mean(axis=0))
    turned, places = shares(corners[[1, 2, 0, 3]], 10)
    same = np.linalg.norm(places[:, None] - xyz, axis=2).argmin(axis=1)
    np.testing.assert_allclose(turned, whole[same])
    folded, _ = shares(corners, 8)
    np.testing.assert_allclose(folded[4:], whole[4:8])
    np.testing.assert_allclose(
        folded[:4], [0, whole[8] / 2, whole[9] / 2, whole[8:].sum() / 2]
    )


@pytest.mark.parametrize("name", ELEMENTS)
def test_mass_of_the_cube(name: str) -> None:
    s = assemble(body(name, *cube(name)))
    assert s.mass.diagonal().sum() == pytest.approx(3 * RHO, rel=1e-12)


@pytest.mark.parametrize("name", ELEMENTS)
def test_patch_of_constant_strain(name: str) -> None:
    """Irons and Razzaque (1972), with MAT1 and with a MAT9 without symmetries in a turned frame."""
    xyz, nodes = cube(name)
    assert patch(body(name, xyz, nodes, RESBEND="NO"), xyz, xyz @ GRADIENT) < ROUNDING
    frame = cards("CORD2R", CID=[7], B1=0.3, B2=0.5, B3=1.0, C1=1.0)
    m = body(name, xyz, nodes, mat9(crystal()), psolid(2, 7), frame, RESBEND="NO")
    assert patch(m, xyz, xyz @ GRADIENT) < ROUNDING


@pytest.mark.parametrize(
    "material", [steel(E, NU), mat9(crystal())], ids=lambda t: t.card
)
def test_constant_strain_goes_through_prisms(material: Table) -> None:
    """Wedges as Nastran's: layers of unequal height over one mesh of unequal triangles."""
    xyz, hexas = box(3, 3, 3, (1.0, 1.0, 1.0))
    inside = (xyz[:, :2] > 0).all(axis=1) & (xyz[:, :2] < 1).all(axis=1)
    x, y, z = xyz.T
    bent = np.column_stack([x + 0.1 * inside * y, y - 0.2 * inside * x * y, z**1.5])
    bent, wedges = cut("CPENTA6", bent, hexas)
    m = body("CPENTA6", bent, wedges, material, psolid(material["MID"][0]))
    assert patch(m, bent, bent @ GRADIENT) < ROUNDING


@pytest.mark.parametrize("name", SECOND)
def test_patch_of_pure_bending(name: str) -> None:
    """Pure bending, a quadratic motion, is exact on a regular mesh of second order, whatever
    Poisson's ratio.
    """
    xyz, nodes = cube(name, size=0.0)
    x, y, z = xyz.T
    for nu in (0.0, 0.3, 0.499):
        u = np.column_stack([-x * z, nu * y * z, x**2 / 2 + nu * (z**2 - y**2) / 2])
        assert (
            patch(body(name, xyz, nodes, steel(E, nu), psolid()), xyz, u) < 1e-7
        )  # conditioning of ν = 0.499


@pytest.mark.parametrize("size", [0.0, 0.1])
def test_elements_fit_together(size: float) -> None:
    """A cell of pyramids between hexahedra, a row of wedges: a constant strain goes through all of
    them.
    """
    xyz, hexas = box(3, 2, 2, (1.0, 1.0, 1.0))
    xyz, pyramids = cut("CPYRAM5", distorted(xyz, size), hexas[[4, 5]])
    wedges = cut("CPENTA6", xyz, hexas[[8, 10]])[1]
    m = model(
        grid(xyz),
        elements("CHEXA", hexas[[0, 1, 2, 3, 6, 7, 9, 11]]),
        elements("CPYRAM", pyramids, 101),
        elements("CPENTA", wedges, 201),
        steel(),
        psolid(),
        RESBEND="NO",
    )
    assert patch(m, xyz, xyz @ GRADIENT) < ROUNDING


@pytest.mark.parametrize("name", SECOND)
def test_missing_midside_nodes(name: str) -> None:
    """An absent midside node is the mean of its ends: the same as an MPC would make of the full
    element.
    """
    xyz, nodes = skewed(name)
    shape = SOLIDS[kind(name)[0]]
    k, edge = shape.corners + 1, shape.edges[1]
    nodes = nodes[:1]
    xyz[nodes[0, k]] = xyz[nodes[0, list(edge)]].mean(axis=0)
    use = np.unique(nodes)
    xyz, nodes = xyz[use], np.searchsorted(use, nodes)
    full = assemble(body(name, xyz, nodes, COUPMASS=1))
    bare = nodes.copy()
    bare[0, k] = -1
    part = assemble(body(name, xyz, bare, COUPMASS=1))
    T = np.zeros((len(xyz), len(xyz)))
    np.fill_diagonal(T, 1.0)
    T[nodes[0, k]] = 0.0
    T[nodes[0, k], nodes[0, list(edge)]] = 0.5
    T = np.kron(np.delete(T, nodes[0, k], axis=1), np.eye(3))
    assert len(part.free) == T.shape[1]
    np.testing.assert_allclose(
        part.mass.toarray(), T.T @ full.mass.toarray() @ T, atol=1e-12 * RHO
    )
    # its four points see the dilatation of the whole element in either case
    if name != "CTETRA10":
        np.testing.assert_allclose(
            part.stiffness.toarray(), T.T @ full.stiffness.toarray() @ T, atol=1e-9 * E
        )


def test_linear_and_quadratic_elements_share_an_edge() -> None:
    """Hexahedra of 20 nodes beside ones of 8: the nodes of the common face are left out, and the
    patch holds.
    """
    corner, hexas = box(2, 2, 2, (1.0, 1.0, 1.0))
    corner = distorted(corner, 0.1)
    xyz, fine = cut("CHEXA20", corner, hexas[:4])
    on_face = np.isin(fine[:, 8:], np.flatnonzero(np.abs(xyz[:, 0] - 0.5) < 0.3))
    common = np.isin(np.array(SOLIDS["CHEXA"].edges), [1, 2, 5, 6]).all(axis=1)
    fine[:, 8:] = np.where(on_face & common, -1, fine[:, 8:])
    coarse = np.column_stack([hexas[4:], np.full((4, 12), -1)])
    m = body("CHEXA20", xyz, np.vstack([fine, coarse]))
    assert patch(m, xyz, xyz @ GRADIENT) < ROUNDING
    assert len({len(p) for _, p in batches(m)}) == 1  # four of each kind


@pytest.mark.parametrize("name", ELEMENTS)
def test_mat9_of_an_isotropic_body_is_mat1(name: str) -> None:
    """Equal to rounding where the dilatation is not projected; equal in a patch, and nearly so,
    where it is.
    """
    xyz, nodes = skewed(name)
    one = assemble(body(name, xyz, nodes)).stiffness.toarray()
    nine = assemble(
        body(name, xyz, nodes, mat9(isotropic()), psolid(2, -1))
    ).stiffness.toarray()
    if name in ("CHEXA8", "CPENTA6", "CTETRA4", "CTETRA10"):
        np.testing.assert_allclose(nine, one, atol=1e-12 * np.abs(one).max())
    else:
        low = np.linalg.eigvalsh(nine - one)[0]
        # a projection can only take energy away
        assert low > -1e-12 * np.abs(one).max()
        assert np.abs(nine - one).max() < 0.5 * np.abs(one).max()


def rotation(seed: int = 0) -> Float:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("cordm", [-1, 7])
@pytest.mark.parametrize("name", ELEMENTS)
def test_material_frame_goes_with_the_body(name: str, cordm: int) -> None:
    """A body turned together with its material frame (of the element, or of a CORD2R) has the same
    eigenvalues.
    """
    xyz, nodes = skewed(name)
    R = rotation()
    frame = (
        {"A1": np.zeros(1)}
        | {f"B{i + 1}": [R[i, 2]] for i in range(3)}
        | {f"C{i + 1}": [R[i, 0]] for i in range(3)}
    )
    still = body(
        name,
        xyz,
        nodes,
        mat9(crystal()),
        psolid(2, cordm),
        cards("CORD2R", CID=[7], B3=1.0, C1=1.0),
    )
    moved = body(
        name,
        xyz @ R.T,
        nodes,
        mat9(crystal()),
        psolid(2, cordm),
        cards("CORD2R", CID=[7], **frame),
    )
    a, b = (np.linalg.eigvalsh(assemble(m).stiffness.toarray()) for m in (still, moved))
    np.testing.assert_allclose(b, a, atol=1e-10 * a[-1])


@pytest.mark.parametrize("name", ["CHEXA8", "CPENTA6", "CPYRAM5"])
def test_element_frame_of_a_regular_body_is_basic(name: str) -> None:
    """Bricks, and wedges and pyramids upright on them, have the axes of basic: CORDM -1 and 0 are
    the same.
    """
    xyz, nodes = cube(name, 1, 0.0)
    # the first wedge has G1-G2 along x, the first pyramid stands upright
    keep = nodes[:1]
    K = [
        assemble(
            body(name, xyz, keep, mat9(crystal()), psolid(2, c), AUTOSPC="NO")
        ).stiffness
        for c in (0, -1)
    ]
    assert abs(K[0] - K[1]).max() < 1e-12 * abs(K[0]).max()


def test_modulus_of_a_turned_lamina() -> None:
    """1/E(θ) = c⁴/E1 + s⁴/E2 + (1/G12 - 2ν12/E1) s²c² (Lekhnitskii 1963): a bar of one hexahedron,
    pulled.
    """
    E1, E2, nu, G = 140e9, 10e9, 0.3, 5e9
    S = np.diag([1 / E1, 1 / E2, 1 / E2, 1 / G, 1 / G, 1 / G])
    for i, j, v in ((0, 1, -nu / E1), (0, 2, -nu / E1), (1, 2, -0.4 / E2)):
        S[i, j] = S[j, i] = v
    t = np.radians(25)
    frame = cards("CORD2R", CID=[7], B3=1.0, C1=np.cos(t), C2=np.sin(t))
    xyz, nodes = cube("CHEXA8", 1, 0.0)
    m = body("CHEXA8", xyz, nodes, mat9(np.linalg.inv(S)), psolid(2, 7), frame)
    s = assemble(m)
    u = np.linalg.pinv(s.stiffness.toarray(), rcond=1e-12, hermitian=True) @ _pull(
        s.free.node, s.free.direction, xyz
    )
    x = s.free.direction == 1
    end = xyz[s.free.node - 1, 0] > 0.5
    stretch = u[x & end].mean() - u[x & ~end].mean()
    c, d = np.cos(t), np.sin(t)
    want = c**4 / E1 + d**4 / E2 + (1 / G - 2 * nu / E1) * (c * d) ** 2
    assert stretch == pytest.approx(want, rel=1e-9)


def _pull(node: Int, direction: Int, xyz: Float) -> Float:
    return np.where(direction == 1, np.where(xyz[node - 1, 0] > 0.5, 0.25, -0.25), 0.0)


def test_tensor_turned_by_halves() -> None:
    """Two turns are one, and the energy of a strain does not depend on who looks at it."""
    C, A, B = tensor(crystal()[None]), rotation(1)[None], rotation(2)[None]
    np.testing.assert_allclose(
        turned(turned(C, B), A), turned(C, B @ A), rtol=1e-10, atol=1e-2
    )
    strain = GRADIENT + GRADIENT.T
    before = np.einsum(
        "pqrs,pq,rs->", C[0], A[0] @ strain @ A[0].T, A[0] @ strain @ A[0].T
    )
    after = np.einsum("pqrs,pq,rs->", turned(C, A)[0], strain, strain)
    assert after == pytest.approx(before, rel=1e-12)


def test_nearest_rotation() -> None:
    """R Qᵀ is symmetric and positive, Q a rotation."""
    R = np.random.default_rng(3).normal(size=(20, 3, 3))
    R = R[np.linalg.det(R) > 0]
    Q = nearest(R)
    U = R @ Q.swapaxes(1, 2)
    np.testing.assert_allclose(U, U.swapaxes(1, 2), atol=1e-12)
    np.testing.assert_allclose(
        Q @ Q.swapaxes(1, 2), np.broadcast_to(np.eye(3), Q.shape), atol=1e-12
    )
    assert (np.linalg.eigvalsh(U) > 0).all()


def element_matrices(m: Model, move: object = 0.0) -> tuple[Float, Float]:
    """Element K and M of the first batch, the nodes moved by `move` (n, 3), which may be
    complex.
    """
    there = mesh(m)
    there = replace(there, xyz=there.xyz + move)
    _, _, part = next(iter(pieces(there)))
    return part.stiffness, part.mass


@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("name", ELEMENTS)
def test_complex_step_in_node_coordinates(name: str, anisotropic: bool) -> None:
    """Against central differences, whose error is about 1e-9 here, with the frame of the element
    moving along.
    """
    xyz, nodes = skewed(name)
    more = (mat9(crystal()), psolid(2, -1)) if anisotropic else (steel(), psolid())
    d = np.random.default_rng(5).normal(size=xyz.shape)
    for coupled in (-1, 1):
        m = body(name, xyz, nodes, *more, COUPMASS=coupled)
        exact = [A.imag / 1e-40 for A in element_matrices(m, 1e-40j * d)]
        pairs = zip(
            element_matrices(m, 1e-5 * d), element_matrices(m, -1e-5 * d), strict=True
        )
        for a, (p, q) in zip(exact, pairs, strict=True):
            assert np.abs(a - (p - q) / 2e-5).max() < 1e-7 * np.abs(a).max()


@pytest.mark.parametrize(
    ("card", "field"), [("MAT1", "E"), ("MAT1", "NU"), ("MAT1", "RHO"), ("MAT9", "G14")]
)
@pytest.mark.parametrize("name", ELEMENTS)
def test_complex_step_in_the_material(name: str, card: str, field: str) -> None:
    xyz, nodes = skewed(name)
    more = (mat9(crystal()), psolid(2)) if card == "MAT9" else (steel(), psolid())
    m = body(name, xyz, nodes, *more)
    value = m[card][field]

    def at(factor: complex) -> tuple[Float, Float]:
        return element_matrices(
            replace(
                m, tables={**m.tables, card: m[card].with_column(field, value * factor)}
            )
        )

    for exact, p, q in zip(at(1 + 1e-40j), at(1 + 1e-5), at(1 - 1e-5), strict=True):
        d = exact.imag / 1e-40 if np.iscomplexobj(exact) else np.zeros_like(exact)
        assert np.abs(d - (p - q) / 2e-5).max() < 1e-7 * max(
            np.abs(d).max(), 1e-3 * np.abs(p).max()
        )


def test_elements_that_a_material_affects() -> None:
    """Through the property, MAT9 as MAT1."""
    xyz, nodes = cube("CPYRAM5", 1, 0.0)
    m = body("CPYRAM5", xyz, nodes, steel(), mat9(crystal()), psolid(2))
    assert rows_of(m, CardField("MAT9", 2, ""))["CPYRAM"].size == 6
    assert rows_of(m, CardField("MAT1", 1, "")) == {}


@pytest.mark.parametrize(("a", "b"), list(combinations(SECOND, 2)))
def test_second_order_cubes_agree(a: str, b: str) -> None:
    """The energy of a smooth motion that no element holds exactly: two ways to cut a cube differ by
    a few percent.
    """
    energy = []
    for name in (a, b):
        xyz, nodes = cube(name, size=0.0)
        s = assemble(body(name, xyz, nodes))
        u = np.zeros((len(xyz), 6))
        u[:, :3] = np.sin(xyz @ GRADIENT)
        x = s.local @ u.ravel()
        energy.append(x @ (s.stiffness @ x))
    assert energy[0] == pytest.approx(energy[1], rel=0.05)


@pytest.mark.parametrize("name", ["CHEXA", "CPENTA", "CPYRAM5"])
def test_a_body_without_stiffness_has_its_mass(name: str) -> None:
    """E = 0 is how decks carry weight alone."""
    s = assemble(
        body(name, *cube(name, 1, 0.0), steel(0.0, NU, RHO), psolid(), AUTOSPC="NO")
    )
    assert not s.stiffness.nnz
    assert s.mass.diagonal().sum() == pytest.approx(3 * RHO)


def test_inside_out_indefinite_and_fluid_are_refused() -> None:
    xyz, nodes = cube("CPYRAM5", 1, 0.0)
    with pytest.raises(DeckError, match=r"CPYRAM 1.*node order"):
        assemble(body("CPYRAM5", xyz, nodes[:1, [3, 2, 1, 0, 4]]))
    bad = crystal()
    bad[0, 0] = -1e9
    with pytest.raises(DeckError, match=r"MAT9 2.*negative eigenvalue"):
        assemble(body("CPYRAM5", xyz, nodes, mat9(bad), psolid(2)))
    with pytest.raises(DeckError, match=r"CPYRAM 1.*no volume"):
        assemble(body("CPYRAM5", xyz * (1.0, 1.0, 0.0), nodes[:1]))
    with pytest.raises(DeckError, match=r"MAT1 1.*ratio 0\.5 must"):
        assemble(body("CPYRAM5", xyz, nodes, steel(E, 0.5, RHO), psolid()))
    with pytest.raises(UnsupportedCard, match="PFLUID"):
        assemble(
            body(
                "CPYRAM5",
                xyz,
                nodes,
                steel(),
                cards("PSOLID", PID=[1], MID=1, FCTN="PFLUID"),
            )
        )
