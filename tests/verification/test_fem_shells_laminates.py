"""Laminates: A, B, D and transverse shear, material axes, a simply supported orthotropic plate;
complex steps.

Jones, Mechanics of Composite Materials (1999); Reddy, Mechanics of Laminated Composite Plates and
Shells (2004).
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from fem_cases import cards, grid, model, modes, pshell, ragged, steel
from shell_cases import SHELLS, displacement, held, nearest, net, rectangle, shell

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.assembly import assemble
from ringtrue.fem.element_cards import mesh, pieces
from ringtrue.fem.elements.shell_material import Laminate, laminates
from ringtrue.fem.mesh import nodes_of
from ringtrue.model.model import Model, Table

E1, E2, NU, G12, G1Z, G2Z, RHO = 1.4e11, 1e10, 0.3, 5e9, 5e9, 3e9, 1600.0
CARBON = cards(
    "MAT8", MID=[2], E1=E1, E2=E2, NU12=NU, G12=G12, G1Z=G1Z, G2Z=G2Z, RHO=RHO
)
FOAM = cards("MAT8", MID=[3], E1=1e3, E2=1e3, G12=1e3, G1Z=4e7, G2Z=2e7, RHO=60.0)
BOTH = cards(
    "MAT8", MID=[2, 3], E1=[E1, 1e3], E2=[E2, 1e3], NU12=[NU, 0.0], G12=[G12, 1e3], G1Z=[G1Z, 4e7], G2Z=[G2Z, 2e7],
    RHO=[RHO, 60.0],
)  # fmt: skip


def pcomp(
    t: list[Any_] | list[float],
    theta: list[float],
    mid: list[int] | None = None,
    **more: object,
) -> Table:
    made = {
        "MID": ragged(mid or [2] * len(t)),
        "T": ragged(t),
        "THETA": ragged(theta),
        "SOUT": ragged(["NO"] * len(t)),
    }
    return cards("PCOMP", PID=[1], **made, **more)


def one(*tables: Table) -> Laminate:
    card = tables[0].card
    return laminates(nodes_of(model(grid([[0, 0, 0]]), *tables)).rows(card))


def reduced() -> Float:
    """Q of the carbon ply."""
    nu21 = NU * E2 / E1
    d = 1 - NU * nu21
    return np.array([[E1 / d, NU * E2 / d, 0], [NU * E2 / d, E2 / d, 0], [0, 0, G12]])


def turned(angle: float) -> Float:
    """Q of the carbon ply at an angle, by the invariants of Tsai and Pagano (Jones 1999, eqs.
    2.92-2.93).
    """
    Q = reduced()
    a, b, c, d = Q[0, 0], Q[1, 1], Q[0, 1], Q[2, 2]
    u1, u2, u3 = (
        (3 * a + 3 * b + 2 * c + 4 * d) / 8,
        (a - b) / 2,
        (a + b - 2 * c - 4 * d) / 8,
    )
    u4, u5 = (a + b + 6 * c - 4 * d) / 8, (a + b - 2 * c + 4 * d) / 8
    t = np.radians(angle)
    c2, c4, s2, s4 = np.cos(2 * t), np.cos(4 * t), np.sin(2 * t), np.sin(4 * t)
    q16, q26 = u2 * s2 / 2 + u3 * s4, u2 * s2 / 2 - u3 * s4
    return np.array(
        [
            [u1 + u2 * c2 + u3 * c4, u4 - u3 * c4, q16],
            [u4 - u3 * c4, u1 - u2 * c2 + u3 * c4, q26],
            [q16, q26, u5 - u3 * c4],
        ]
    )


@pytest.mark.parametrize("z0", [np.nan, 0.0, -0.002])
def test_membrane_coupling_and_bending(z0: float) -> None:
    """A, B, D = Σ Q (z, z²/2, z³/3)."""
    t, theta = np.array([1e-3, 2e-3, 0.5e-3]), [0.0, 30.0, -60.0]
    L = one(pcomp(list(t), theta, Z0=z0), CARBON)
    z = (-t.sum() / 2 if np.isnan(z0) else z0) + np.concatenate([[0], np.cumsum(t)])
    for power, got in ((1, L.membrane), (2, L.coupling), (3, L.bending)):
        want = sum(
            turned(a) * (z[k + 1] ** power - z[k] ** power) / power
            for k, a in enumerate(theta)
        )
        np.testing.assert_allclose(
            got[0], want, rtol=1e-12, atol=1e-12 * np.abs(want).max()
        )
    assert L.density[0] == pytest.approx(RHO * t.sum())


def test_symmetric_and_numbered_plies_are_the_same_laminate() -> None:
    full = one(pcomp([1e-3, 2e-3, 2e-3, 1e-3], [0.0, 40.0, 40.0, 0.0]), CARBON)
    half = one(pcomp([1e-3, 2e-3], [0.0, 40.0], LAM="SYM"), CARBON)
    plies = {
        "MID": ragged([2] * 4),
        "T": ragged([1e-3, 2e-3, 2e-3, 1e-3]),
        "THETA": ragged([0.0, 40.0, 40.0, 0.0]),
    }
    numbered = one(
        cards("PCOMPG", PID=[1], GPLYID=ragged([7, 8, 9, 11]), **plies), CARBON
    )
    for other in (half, numbered):
        for name in ("membrane", "bending", "shear", "density"):
            want = getattr(full, name)
            np.testing.assert_allclose(
                getattr(other, name), want, rtol=1e-12, atol=1e-9 * np.abs(want).max()
            )


def test_transverse_shear_of_a_homogeneous_plate_is_five_sixths() -> None:
    """One ply or ten of the same; and MAT1 the same as PSHELL."""
    for n in (1, 10):
        S = one(pcomp([0.01 / n] * n, [0.0] * n), CARBON).shear[0]
        np.testing.assert_allclose(
            S, 5 / 6 * 0.01 * np.diag([G1Z, G2Z]), rtol=1e-10, atol=1e-3
        )


def test_transverse_shear_of_a_sandwich() -> None:
    """Thin faces: S = G (c + f)²/c (Allen 1969)."""
    f, c = 1e-5, 0.02
    S = one(pcomp([f, c, f], [0.0] * 3, [2, 3, 2]), BOTH).shear[0]
    np.testing.assert_allclose(
        np.diag(S), np.array([4e7, 2e7]) * (c + f) ** 2 / c, rtol=2e-3
    )  # the faces' own shear


def test_simplified_laminates() -> None:
    t, theta = [1e-3, 2e-3], [0.0, 50.0]
    full = one(pcomp(t, theta), CARBON)
    by = {
        lam: one(pcomp(t, theta, LAM=lam), CARBON) for lam in ("MEM", "BEND", "SMEAR")
    }
    for L in by.values():
        assert not L.coupling.any()
        assert L.density[0] == full.density[0]
    assert not by["MEM"].bending.any()
    assert not by["BEND"].membrane.any()
    np.testing.assert_array_equal(by["MEM"].membrane, full.membrane)
    np.testing.assert_array_equal(by["BEND"].bending, full.bending)
    np.testing.assert_allclose(
        by["SMEAR"].bending, full.membrane * 9e-6 / 12, rtol=1e-12
    )
    core = one(
        pcomp([1e-3, 1e-3, 0.01], [0.0, 90.0, 0.0], [2, 2, 3], LAM="SMCORE"), BOTH
    )
    faces = (turned(0) + turned(90)) * 1e-3
    np.testing.assert_allclose(core.membrane[0], faces, rtol=1e-12, atol=1e-3)
    np.testing.assert_allclose(
        core.bending[0], faces / 2e-3 * (0.012**3 - 0.01**3) / 12, rtol=1e-12, atol=1e-9
    )
    np.testing.assert_allclose(np.diag(core.shear[0]), [4e5, 2e5])


@pytest.mark.parametrize(
    ("half", "whole"),
    [("SYM", ""), ("SYMEM", "MEM"), ("SYBEND", "BEND"), ("SYSMEAR", "SMEAR")],
)
def test_half_of_the_plies_stands_for_all(half: str, whole: str) -> None:
    lower = one(pcomp([1e-3, 2e-3], [0.0, 40.0], LAM=half), CARBON)
    full = one(
        pcomp([1e-3, 2e-3, 2e-3, 1e-3], [0.0, 40.0, 40.0, 0.0], LAM=whole), CARBON
    )
    for name in ("membrane", "bending", "shear", "density"):
        np.testing.assert_allclose(
            getattr(lower, name), getattr(full, name), rtol=1e-12, atol=1e-9
        )


def mindlin(m: int, n: int, a: float, b: float, L: Laminate) -> float:
    """Simply supported cross-ply plate, first-order shear, no rotary inertia (Reddy 2004, section
    6.4), Hz.
    """
    p, q, D, S = m * np.pi / a, n * np.pi / b, L.bending[0], L.shear[0]
    k11 = S[0, 0] * p * p + S[1, 1] * q * q
    k12, k13 = S[0, 0] * p, S[1, 1] * q
    k22 = D[0, 0] * p * p + D[2, 2] * q * q + S[0, 0]
    k33 = D[1, 1] * q * q + D[2, 2] * p * p + S[1, 1]
    k23 = (D[0, 1] + D[2, 2]) * p * q
    inner = np.array([[k22, k23], [k23, k33]])
    r = np.array([k12, k13])
    return float(
        np.sqrt((k11 - r @ np.linalg.solve(inner, r)) / L.density[0]) / (2 * np.pi)
    )


@pytest.mark.parametrize(
    ("card", "order"), [("CQUAD4", 2), ("CTRIA3", 2), ("CQUAD8", 3), ("CTRIA6", 1.8)]
)
@pytest.mark.parametrize("thickness", [0.1, 0.005])
def test_simply_supported_cross_ply_plate(
    card: str, order: float, thickness: float
) -> None:
    """Converges to the closed form at the order, thick (shear takes a third of the frequency) and
    thin.
    """
    a, b = 1.0, 0.8
    layup = pcomp([thickness / 4] * 4, [0.0, 90.0, 90.0, 0.0])
    want = np.sort(
        [mindlin(m, n, a, b, one(layup, CARBON)) for m in (1, 2, 3) for n in (1, 2, 3)]
    )[:3]
    error = []
    for n in (4, 8) if order > 2 or card == "CTRIA6" else (8, 16):
        xyz, elements, uv = net(card, n, n, rectangle(a, b))
        hard = held(((uv[:, 0] % 1 == 0), "1234"), ((uv[:, 1] % 1 == 0), "1235"))
        m = model(
            grid(xyz, PS="126"),
            shell(card, elements, MCID=0),
            layup,
            CARBON,
            hard,
            spc=1,
            COUPMASS=1,
        )
        error.append(np.abs(modes(m, 3) / want - 1).max())
    assert error[1] < 0.02
    assert np.log2(error[0] / error[1]) > order - 0.5


@pytest.mark.parametrize("card", SHELLS)
@pytest.mark.parametrize("lam", ["", "SMEAR"])
def test_axes_by_angle_by_frame_and_by_ply_are_the_same(card: str, lam: str) -> None:
    """THETA 35, MCID of a frame at 35 degrees, and plies turned by 35.

    The last only without transverse shear, which is that of bending along the material axes.
    """
    xyz, elements, _ = net(card, 2, 2, rectangle())
    c, s = np.cos(np.radians(35)), np.sin(np.radians(35))
    frame = cards("CORD2R", CID=[4], B3=1.0, C1=c, C2=s, A1=0.0)
    plies, angle = [0.01, 0.02], [10.0, 60.0]
    made = [
        (shell(card, elements, THETA=35.0), pcomp(plies, angle, LAM=lam)),
        (shell(card, elements, MCID=4), pcomp(plies, angle, LAM=lam)),
        (shell(card, elements, MCID=0), pcomp(plies, [35 + x for x in angle], LAM=lam)),
    ]
    if card in ("CTRIA3", "CTRIA6"):
        made[0] = made[1]  # G1-G2 of the upper triangles is a diagonal
    K = [
        assemble(model(grid(xyz), frame, *parts, CARBON)).stiffness.toarray()
        for parts in made
    ]
    for other in K[1:] if lam else K[1:2]:
        np.testing.assert_allclose(other, K[0], atol=1e-9 * np.abs(K[0]).max())


@pytest.mark.parametrize("card", SHELLS)
def test_laminate_of_one_isotropic_ply_is_the_plate(card: str) -> None:
    """Also coupled about another plane: Z0 = 0 equals an offset of half the thickness."""
    xyz, elements, _ = net(card, 2, 2, rectangle())
    ply = pcomp([0.02], [25.0], [1])
    plate = assemble(
        model(grid(xyz), shell(card, elements), pshell(0.02, TST=5 / 6), steel())
    )
    K = assemble(model(grid(xyz), shell(card, elements), ply, steel())).stiffness
    if card != "CTRIA3":  # a laminate has its shear there, a homogeneous plate not
        assert abs(K - plate.stiffness).max() < 1e-9 * abs(K).max()
    up = assemble(
        model(grid(xyz), shell(card, elements, ZOFFS=0.01), ply, steel())
    ).stiffness
    low = assemble(
        model(
            grid(xyz),
            shell(card, elements),
            pcomp([0.02], [25.0], [1], Z0=0.0),
            steel(),
        )
    ).stiffness
    R = np.zeros((len(xyz), 6))
    R[:, 2] = xyz[:, 0] ** 2 + xyz[:, 0] * xyz[:, 1]
    R[:, 3], R[:, 4] = xyz[:, 0], -2 * xyz[:, 0] - xyz[:, 1]
    x = (
        assemble(model(grid(xyz), shell(card, elements), ply, steel())).local
        @ R.ravel()
    )
    # but for the drilling of the arms
    assert x @ low @ x == pytest.approx(x @ up @ x, rel=1e-4)


def test_coupling_bends_under_tension() -> None:
    """A free two-ply strip: κ = (d of the inverse of [A B; B D]) N."""
    xyz, elements, uv = net("CQUAD8", 4, 1, rectangle(1.0, 0.1))
    layup = pcomp([0.01, 0.01], [0.0, 90.0])
    L = one(layup, CARBON)
    abd = np.block([[L.membrane[0], L.coupling[0]], [L.coupling[0], L.bending[0]]])
    kappa = np.linalg.solve(abd, [1, 0, 0, 0, 0, 0])[3]
    root = (uv[:, 0] == 0, "15")
    pin = ((uv[:, 0] == 0) & (np.abs(uv[:, 1] - 0.5) < 1e-9), "2346")
    m = model(
        grid(xyz),
        shell("CQUAD8", elements, MCID=0),
        layup,
        CARBON,
        held(root, pin),
        spc=1,
    )
    tip = [nearest(uv, 1, v) for v in (0, 0.5, 1)]
    loads = [(k, 1, f * 0.1) for k, f in zip(tip, (1 / 6, 4 / 6, 1 / 6), strict=True)]
    w = displacement(m, loads, tip[1], 3)
    assert w == pytest.approx(-kappa / 2, rel=1e-6)  # u = z βx, βx = -∂w/∂x


def element_sums(m: Model) -> tuple[Any_, Any_]:
    """Dense K and M over all DOFs, of the dtype of the elements."""
    made = mesh(m)
    K = np.zeros((made.size, made.size), dtype=complex)
    M = K.copy()
    for _, _, p in pieces(made):
        block = (
            p.mass if p.mass.ndim == 3 else p.mass[..., None] * np.eye(p.mass.shape[1])
        )
        i, j = np.broadcast_arrays(p.dofs[:, :, None], p.dofs[:, None, :])
        np.add.at(K, (i, j), p.stiffness)
        np.add.at(M, (i, j), block)
    return K, M


def bent(card: str) -> tuple[Float, Any_]:
    xyz, elements, _ = net(card, 2, 2, rectangle())
    xyz = xyz + 0.03 * np.random.default_rng(5).uniform(-1, 1, xyz.shape)
    xyz[:, 2] += 0.2 * xyz[:, 0] * xyz[:, 1] + 0.15 * xyz[:, 0] ** 2
    return xyz, elements


def with_value(what: str, x: Float, elements: Any_, card: str, h: complex) -> Model:
    """A curved shell with one number changed by h, relative, of its value."""
    mat1 = {"E": 2e11, "NU": 0.3, "RHO": 8000.0}
    mat8 = {
        "E1": E1,
        "E2": E2,
        "NU12": NU,
        "G12": G12,
        "G1Z": G1Z,
        "G2Z": G2Z,
        "RHO": RHO,
    }
    t, theta, T, offset = [0.02, 0.01], [10.0, 70.0], 0.05, 0.02
    for values in (mat1, mat8):
        if what in values:
            values[what] = values[what] * (1 + h)
    if what == "ply T":
        t = [0.02, 0.01 * (1 + h)]
    if what == "ply angle":
        theta = [10.0, 70.0 * (1 + h)]
    if what in mat8 or what.startswith("ply"):
        section = (
            pcomp(t, theta),
            cards("MAT8", MID=[2], **{k: [v] for k, v in mat8.items()}),
        )
    else:
        thick = [T * (1 + h) if what == "T" else T]
        section = (
            cards("PSHELL", PID=[1], MID1=1, MID2=1, MID3=1, T=thick),
            cards("MAT1", MID=[1], **{k: [v] for k, v in mat1.items()}),
        )
    up = np.full(len(elements), offset * (1 + h) if what == "offset" else offset)
    return model(grid(x), shell(card, elements, ZOFFS=up), *section)


def place(x: Float, e: Any_, card: str, h: complex) -> Model:
    """Node 3 moved by h in all directions, under a laminate."""
    m = model(grid(x), shell(card, e), pcomp([0.02, 0.01], [10.0, 70.0]), CARBON)
    for name in ("X1", "X2", "X3"):
        column = m["GRID"][name].astype(type(h))
        column[2] = column[2] + h
        m = Model(
            {**m.tables, "GRID": m["GRID"].with_column(name, column)}, m.params, m.case
        )
    return m


@pytest.mark.parametrize(
    "what", ["E", "NU", "T", "ply T", "ply angle", "G2Z", "offset", "place"]
)
@pytest.mark.parametrize("card", SHELLS)
def test_complex_step_agrees_with_differences(card: str, what: str) -> None:
    x, e = bent(card)
    change = place if what == "place" else partial(with_value, what)
    step, h = 1e-30, 1e-4
    parts = [
        element_sums(change(x, e, card, s)) for s in (1j * step, h, -h, 2 * h, -2 * h)
    ]
    for which in range(2):
        c, a, b, p, q = (v[which] for v in parts)
        want = (8 * (a - b) - (p - q)).real / (12 * h)
        np.testing.assert_allclose(
            c.imag / step,
            want,
            atol=1e-7 * max(np.abs(want).max(), 1e-6 * np.abs(c).max()),
        )


def test_mixed_properties() -> None:
    """PSHELL and PCOMP elements in one card's batch: the same plate as either alone."""
    xyz, elements, _ = net("CQUAD4", 4, 4, rectangle())
    p = pshell(0.02, TST=5 / 6)
    ply = cards(
        "PCOMP",
        PID=[2],
        MID=ragged([1]),
        T=ragged([0.02]),
        THETA=ragged([0.0]),
        SOUT=ragged(["NO"]),
    )
    g = {f"G{i + 1}": elements[:, i] for i in range(4)}
    both = cards(
        "CQUAD4", EID=np.arange(1, 17), PID=np.where(np.arange(16) % 3, 1, 2), **g
    )
    a, b = (
        assemble(model(grid(xyz), *parts, steel()))
        for parts in ((both, p, ply), (shell("CQUAD4", elements), p))
    )
    assert abs(a.stiffness - b.stiffness).max() < 1e-9 * abs(b.stiffness).max()
