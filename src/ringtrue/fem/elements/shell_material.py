"""Layers in plane stress: MAT1, MAT2 and MAT8, and how a stiffness turns in the plane.

PCOMP, PCOMPG: classical lamination theory with the transverse shear of the layers in
equilibrium.

Jones (1999) for A, B and D; Rolfes and Rohwer (1997), "Improved transverse shear stresses in
composite finite elements based on first order shear deformation theory", for the shear stiffness:
the complementary energy of the stresses that are in equilibrium with the bending moments of two
cylindrical bendings. A homogeneous plate gets 5/6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.elements.elasticity import plane_stress, solid
from ringtrue.fem.mesh import Isotropic, check_ratio, isotropic
from ringtrue.model.model import Model, Table, card_error, unsupported_card

# no transverse shear modulus given: G12 times this, which bends as if rigid in shear
RIGID_SHEAR = 1000.0
_VOIGT = np.array([[0, 2], [2, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Materials in their own axes, one a row (n,); zeros where none is given.

    `plane` (n, 3, 3) gives (σ1, σ2, τ12) of (ε1, ε2, γ12), `through` (n, 2, 2) gives (τ1z, τ2z) of
    (γ1z, γ2z).
    """

    plane: Any_
    through: Any_
    density: Any_
    loss: Any_


def layers(
    model: Model,
    mid: Int,
    table: Table,
    row: Int,
    *,
    core: bool = False,
    confined: Bool | None = None,
) -> Layer:
    """The materials `mid` (n,) that rows `row` (n,) of `table` refer to; 0 is none.

    Parameters
    ----------
    core : bool
        The material is that of transverse shear alone: G11, G12, G22 of a MAT2 are its moduli
        (PSHELL MID3).
    confined : (n,) bool, optional
        Plane strain in place of plane stress (MAT1 only).

    Raises
    ------
    DeckError, UnsupportedCard
        If a material is absent or not positive; on plane strain of a MAT2 or MAT8.
    """
    used = mid > 0
    where = {card: used & (model[card].find(mid) >= 0) for card in _OTHER if card in model}
    taken = np.logical_or.reduce([np.zeros(mid.size, dtype=bool), *where.values()])
    if confined is not None and (confined & taken).any():
        raise UnsupportedCard("PSHELL", why="plane strain (MID2 -1) is for MAT1")
    parts: list[tuple[Bool, Layer]] = []
    rest = used & ~taken
    if rest.any():
        iso = isotropic(model, mid[rest], table, row[rest])
        if not core:
            check_ratio(model, mid[rest], iso.nu, 1.0)
        parts.append((rest, _mat1(iso, None if confined is None else confined[rest])))
    if "MAT8" in where and not core:
        _check_mat8(model, np.unique(model["MAT8"].find(mid[where["MAT8"]])))
    parts += [
        (w, _OTHER[card](model[card], model[card].find(mid[w]), core))
        for card, w in where.items()
        if w.any()
    ]
    return _merged(mid.size, parts)


def _merged(n: int, parts: list[tuple[Bool, Layer]]) -> Layer:
    kind = np.result_type(
        float, *(a.dtype for _, p in parts for a in (p.plane, p.through, p.density, p.loss))
    )
    out = Layer(
        np.zeros((n, 3, 3), kind), np.zeros((n, 2, 2), kind), np.zeros(n, kind), np.zeros(n, kind)
    )
    for where, p in parts:
        out.plane[where] = p.plane
        out.through[where] = p.through
        out.density[where] = p.density
        out.loss[where] = p.loss
    return out


def _plane(c11: Any_, c12: Any_, c22: Any_, c33: Any_, c13: Any_, c23: Any_) -> Any_:
    rows = ((c11, c12, c13), (c12, c22, c23), (c13, c23, c33))
    return np.stack([np.stack(np.broadcast_arrays(*r), axis=-1) for r in rows], axis=-2)


def _through(g1: Any_, g12: Any_, g2: Any_) -> Any_:
    rows = ((g1, g12), (g12, g2))
    return np.stack([np.stack(np.broadcast_arrays(*r), axis=-1) for r in rows], axis=-2)


def _mat1(iso: Isotropic, confined: Bool | None) -> Layer:
    c11, c12 = plane_stress(iso.E, iso.nu)
    if confined is not None and confined.any():
        c11, c12 = (
            np.where(confined, s, p) for s, p in zip(solid(iso.E, iso.nu), (c11, c12), strict=True)
        )
    zero = 0 * iso.G
    return Layer(
        _plane(c11, c12, c11, c33=iso.shear, c13=zero, c23=zero),
        _through(iso.G, zero, iso.G),
        iso.rho,
        iso.loss,
    )


def _mat2(t: Table, row: Int, core: bool) -> Layer:
    g11, g12, g13, g22, g23, g33 = (t[c][row] for c in ("G11", "G12", "G13", "G22", "G23", "G33"))
    rigid = RIGID_SHEAR * g33
    through = _through(g11, g12, g22) if core else _through(rigid, 0 * g33, rigid)
    return Layer(
        _plane(g11, g12, g22, c33=g33, c13=g13, c23=g23), through, t["RHO"][row], t["GE"][row]
    )


def _check_mat8(model: Model, row: Int) -> None:
    """Rows of MAT8 that make no elasticity; moduli may be complex, or negative, where functions are
    sampled.
    """
    E1, E2, nu = (model["MAT8"][c][row] for c in ("E1", "E2", "NU12"))
    none = (E1 == 0) | (E2 == 0)
    if (bad := none | ((nu * nu * E2 / np.where(none, 1.0, E1)).real >= 1)).any():
        why = "E1 and E2 must not be 0, and NU12 below the root of E1/E2"
        raise card_error(model, model["MAT8"], int(row[bad][0]), why)


def _mat8(t: Table, row: Int, core: bool) -> Layer:
    E1, E2, nu, G, g1, g2 = (t[c][row] for c in ("E1", "E2", "NU12", "G12", "G1Z", "G2Z"))
    c11 = E1 / (1 - nu * nu * E2 / E1)
    c22 = c11 * E2 / E1
    zero = 0 * G
    g1, g2 = (np.where(g == 0, RIGID_SHEAR * G, g) for g in (g1, g2))
    return Layer(
        _plane(c11, nu * c22, c22, c33=G, c13=zero, c23=zero),
        _through(g1, zero, g2),
        t["RHO"][row],
        t["GE"][row],
    )


_OTHER: dict[str, Callable[[Table, Int, bool], Layer]] = {"MAT2": _mat2, "MAT8": _mat8}


def turned(plane: Any_, through: Any_, c: Any_, s: Any_) -> tuple[Any_, Any_]:
    """Stiffnesses (..., 3, 3) and (..., 2, 2) of a material whose axis 1 is at the angle of cosine
    c, sine s (...).

    Reuter's form: Q = Rᵀ Q' R with the engineering strains of the material R times those of the new
    axes (Jones 1999, eq. 2.84).
    """
    c = np.asarray(c)
    s = np.asarray(s)
    rows = ((c * c, s * s, c * s), (s * s, c * c, -c * s), (-2 * c * s, 2 * c * s, c * c - s * s))
    R = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    r = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
    return R.swapaxes(-1, -2) @ plane @ R, r.swapaxes(-1, -2) @ through @ r


def contract(A: Any_, C: Any_) -> Any_:
    """Stiffness (e, n 2, m 2) of the plane law C (e, 3, 3) from a Gram matrix of gradients A (e, n,
    2, m, 2).
    """
    e, n, _, m, _ = A.shape
    law = C[:, _VOIGT[:, :, None, None], _VOIGT].transpose(0, 1, 3, 2, 4).reshape(e, 4, 4)
    K = law @ A.transpose(0, 2, 4, 1, 3).reshape(e, 4, n * m)
    return K.reshape(e, 2, 2, n, m).transpose(0, 3, 1, 4, 2).reshape(e, 2 * n, 2 * m)


_GAUSS = np.polynomial.legendre.leggauss(3)
MIRRORED = {
    "SYM": "",
    "SYMEM": "MEM",
    "SYBEND": "BEND",
    "SYSMEAR": "SMEAR",
}  # LAM of half the plies and of all
SIMPLER = ("MEM", "BEND", "SMEAR", "SMCORE")
OPTIONS = ("", *MIRRORED, *SIMPLER)
_SHORT = {"SME": "SMEAR", "SMC": "SMCORE"}  # Autodesk Nastran


@dataclass(frozen=True, slots=True, eq=False)
class Plies:
    """Plies of laminates in material axes, padded with plies without thickness to (p, l).

    `z` is the height of a ply's lower face over the reference plane.
    """

    height: Any_
    z: Any_
    plane: Any_
    through: Any_
    density: Any_


@dataclass(frozen=True, slots=True, eq=False)
class Laminate:
    """Sections of laminates (p,): N = A ε + B κ, M = B ε + D κ, Q = S γ; mass per area; G t for the
    drilling spring.
    """

    membrane: Any_
    coupling: Any_
    bending: Any_
    shear: Any_
    turning: Any_
    density: Any_


def laminates(model: Model, card: str, rows: Int) -> Laminate:
    """The sections of rows (p,) of PCOMP or PCOMPG in their material axes.

    Raises
    ------
    DeckError, UnsupportedCard
        On a laminate without thickness or with a ply that is singular, an absent material, or an
        unknown LAM.
    """
    t = model[card]
    option = _options(model, t, rows)
    plies = _plies(model, t, rows, option)
    total = plies.height.sum(axis=1)
    if (total.real <= 0).any():
        raise card_error(
            model, t, int(rows[np.flatnonzero(total.real <= 0)[0]]), "its plies have no thickness"
        )
    A, B, D = stiffness(plies)
    _refuse_singular(model, t, rows, p=plies, A=A)
    S = transverse_shear(plies, A, B, D)
    A, B, D, S = _smeared(option, plies, A, B=B, D=D, S=S)
    return Laminate(
        membrane=A,
        coupling=B,
        bending=D,
        shear=S,
        turning=_turning(plies),
        density=(plies.height * plies.density).sum(axis=1),
    )


def _refuse_singular(model: Model, t: Table, rows: Int, p: Plies, A: Any_) -> None:
    """Refuse laminates whose plies have no stiffness in transverse shear, or together none in a
    direction of the plane.

    The stresses of a laminate follow from those of its plies, so that each must resist shear.
    """
    laminate, ply = np.nonzero((p.height.real > 0) & _singular(p.through))
    if laminate.size:
        why = (
            f"ply {ply[0] + 1} has no stiffness in transverse shear; give its material G12, or "
            "G1Z and G2Z (MAT8), "
            "G33 (MAT2), or E and NU (MAT1)"
        )
        raise card_error(model, t, int(rows[laminate[0]]), why)
    if (flat := np.flatnonzero(_singular(A))).size:
        why = (
            "its plies have no stiffness in a direction of their plane; check E2 and G12, or "
            "G11 to G33"
        )
        raise card_error(model, t, int(rows[flat[0]]), why)


def _singular(matrices: Any_) -> Bool:
    """Which matrices (..., k, k) are singular to rounding, (...); complex steps have complex
    ones.
    """
    size = np.linalg.svd(matrices, compute_uv=False)
    return np.asarray(size.min(axis=-1) <= np.finfo(np.float64).eps * size.max(axis=-1))


def _options(model: Model, t: Table, rows: Int) -> Any_:
    text = np.char.upper(np.char.strip(t["LAM"][rows].astype(str)))
    for short, name in _SHORT.items():
        text = np.where(text == short, name, text)
    strange = ~np.isin(text, OPTIONS)
    if strange.any():
        i = int(np.flatnonzero(strange)[0])
        raise unsupported_card(
            model,
            t,
            int(rows[i]),
            f"has LAM {text[i]}; allowed are blank, {', '.join(OPTIONS[1:])}",
        )
    return text


def _plies(model: Model, t: Table, rows: Int, option: Any_) -> Plies:
    """The plies from the bottom up; those of a LAM such as SYM are mirrored."""
    mid = t.ragged("MID")
    T = t.ragged("T")
    theta = t.ragged("THETA")
    first = mid.offsets[rows]
    count = mid.sizes[rows]
    k = np.arange(max(int(count.max(initial=1)), 1))
    there = k < count[:, None]
    at = np.where(there, first[:, None] + k, first[:, None])
    height = np.where(there, T.values[at], 0.0)
    if (half := np.isin(option, tuple(MIRRORED))).any():
        at = np.concatenate([at, at[:, ::-1]], axis=1)
        height = np.concatenate([height, np.where(half[:, None], height[:, ::-1], 0.0)], axis=1)
    used = layers(model, mid.values[at].ravel(), t, np.repeat(rows, at.shape[1]))
    angle = np.radians(1.0) * theta.values[at]
    through = used.through.reshape(*at.shape, 2, 2)
    plane, through = turned(
        used.plane.reshape(*at.shape, 3, 3), through, np.cos(angle), np.sin(angle)
    )
    z0 = t["Z0"][rows]
    z0 = np.where(np.isnan(z0), -height.sum(axis=1) / 2, z0)
    z = z0[:, None] + np.cumsum(height, axis=1) - height
    return Plies(
        height=height, z=z, plane=plane, through=through, density=used.density.reshape(at.shape)
    )


def _turning(p: Plies) -> Any_:
    """In-plane shear modulus times the thickness (p,), the mean over all directions."""
    Q = p.plane
    G = (Q[..., 0, 0] + Q[..., 1, 1] - 2 * Q[..., 0, 1]) / 8 + Q[..., 2, 2] / 2
    return np.asarray((p.height * G).sum(axis=1))


def stiffness(p: Plies) -> tuple[Any_, Any_, Any_]:
    """A, B, D (p, 3, 3) about the reference plane."""
    h = p.height
    zc = p.z + p.height / 2
    weights = (h, h * zc, h * zc * zc + h**3 / 12)
    A, B, D = (np.einsum("pl,plij->pij", w, p.plane) for w in weights)
    return A, B, D


def transverse_shear(p: Plies, A: Any_, B: Any_, D: Any_) -> Any_:
    """Transverse shear stiffness (p, 2, 2): Rolfes and Rohwer (1997), eqs. 14-20."""
    low = B.swapaxes(1, 2)
    # strain of the reference plane per curvature without a normal force, negative
    neutral = np.linalg.solve(A, B)
    bending = D - low @ neutral
    a = np.cumsum(p.height[..., None, None] * p.plane, axis=1)
    b = np.cumsum((p.height * (p.z + p.height / 2))[..., None, None] * p.plane, axis=1)
    a, b = (
        np.concatenate([0 * x[:, :1], x[:, :-1]], axis=1) for x in (a, b)
    )  # up to the lower face of each ply
    flexible = np.linalg.inv(p.through)
    compliance: Any_ = np.zeros_like(p.through[:, 0])
    for at, w in zip(*_GAUSS, strict=True):  # τ² is of degree four in a ply: exact
        up = (1 + at) / 2 * p.height
        here_a = a + up[..., None, None] * p.plane
        here_b = b + (up * (p.z + up / 2))[..., None, None] * p.plane
        F: Any_ = (here_a @ neutral[:, None] - here_b).swapaxes(-1, -2)
        F = np.linalg.solve(bending[:, None].swapaxes(-1, -2), F).swapaxes(-1, -2)
        f = np.stack(
            [
                np.stack([F[..., 0, 0], F[..., 2, 1]], -1),
                np.stack([F[..., 2, 0], F[..., 1, 1]], -1),
            ],
            -2,
        )
        compliance = compliance + np.einsum(
            "pl,plji,pljk,plkm->pim", p.height * w / 2, f, flexible, f, optimize=True
        )
    return np.asarray(np.linalg.inv(compliance))


def _smeared(
    option: Any_, p: Plies, A: Any_, B: Any_, D: Any_, S: Any_
) -> tuple[Any_, Any_, Any_, Any_]:
    """The sections where LAM simplifies them: MEM, BEND, SMEAR, SMCORE (the last ply is the
    core).
    """
    membrane, flat, smear, core = (_flag(option, o) for o in SIMPLER)
    total = p.height.sum(axis=1)[:, None, None]
    B = np.where(membrane | flat | smear | core, 0.0, B)
    rigid = RIGID_SHEAR * _turning(p)[:, None, None] * np.eye(2)
    D = np.where(smear, A * total**2 / 12, D)
    S = np.where(smear, rigid, S)
    last = (p.height.real > 0).cumsum(axis=1).argmax(axis=1)
    i = np.arange(len(last))
    tc = p.height[i, last][:, None, None]
    tf = total - tc
    faces = A - tc * p.plane[i, last]
    safe = np.where(tf == 0, 1.0, tf)
    D = np.where(core, faces * ((tf + tc) ** 3 - tc**3) / (12 * safe), D)
    S = np.where(core, tc * p.through[i, last], S)
    A = np.where(core, faces, A)
    return np.where(flat, 0.0, A), B, np.where(membrane, 0.0, D), np.where(membrane, 0.0, S)


def _flag(option: Any_, name: str) -> Bool:
    names = [name, *(half for half, whole in MIRRORED.items() if whole == name)]
    return np.isin(option, names)[:, None, None]
