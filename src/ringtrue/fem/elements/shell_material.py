"""Layers in plane stress: MAT1, MAT2 and MAT8, and how a stiffness turns in the plane.

PCOMP, PCOMPG: classical lamination theory with the transverse shear of the layers in
equilibrium.

Jones (1999) for A, B and D; Rolfes and Rohwer (1997), "Improved transverse shear stresses in
composite finite elements based on first order shear deformation theory", for the shear stiffness:
the complementary energy of the stresses that are in equilibrium with the bending moments of two
cylindrical bendings. A homogeneous plate gets 5/6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.elements.elasticity import plane_stress, solid
from ringtrue.fem.mesh import (
    CardRows,
    check_ratio,
    congruent,
    isotropic,
    matrix,
    merged,
    scaled,
)
from ringtrue.fem.negative_stiffness import elasticity

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
    t: CardRows, mid: Int, *, core: bool = False, confined: Bool | None = None
) -> Layer:
    """The materials `mid` (n,) that the rows (n,) refer to; 0 is none.

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
    model = t.mesh.model
    n = mid.size
    if confined is None:
        confined = np.zeros(n, dtype=bool)
    none = Layer(np.zeros((n, 3, 3)), np.zeros((n, 2, 2)), np.zeros(n), np.zeros(n))
    parts: list[tuple[Bool | slice, Layer]] = [(slice(None), none)]
    rest = mid > 0
    for card, make in (("MAT2", _mat2), ("MAT8", _mat8)):
        where = rest & np.isin(mid, model[card].ids) if card in model else ~rest & rest
        if where.any():
            parts.append((where, make(t.take(where).find(card, mid[where]), core)))
            rest &= ~where
    if (confined & (mid > 0) & ~rest).any():
        raise UnsupportedCard("PSHELL", why="plane strain (MID2 -1) is for MAT1")
    if rest.any():
        parts.append(
            (rest, _mat1(t.take(rest).find("MAT1", mid[rest]), core, confined[rest]))
        )
    return merged(n, parts)


def _mat1(mat: CardRows, core: bool, confined: Bool) -> Layer:
    iso = isotropic(mat)
    if not core:
        check_ratio(mat, iso.nu, 1.0)
    c11, c12 = plane_stress(iso.E, iso.nu)
    if confined.any():
        body = solid(iso.E, iso.nu)
        c11, c12 = (
            np.where(confined, s, p) for s, p in zip(body, (c11, c12), strict=True)
        )
    o = 0 * iso.G
    return Layer(
        plane=matrix((c11, c12, o), (c12, c11, o), (o, o, iso.shear)),
        through=matrix((iso.G, o), (o, iso.G)),
        density=iso.rho,
        loss=iso.loss,
    )


def _mat2(mat: CardRows, core: bool) -> Layer:
    plane = elasticity(mat.table, 3)[mat.at]
    rigid = scaled(RIGID_SHEAR * plane[:, 2, 2], np.eye(2))
    through = plane[:, :2, :2] if core else rigid
    return Layer(plane, through, mat["RHO"], mat["GE"])


def _mat8(mat: CardRows, core: bool) -> Layer:
    E1, E2, nu, G, g1, g2 = (mat[c] for c in ("E1", "E2", "NU12", "G12", "G1Z", "G2Z"))
    if not core:  # moduli may be complex, or negative, where functions are sampled
        none = (E1 == 0) | (E2 == 0)
        bad = none | ((nu * nu * E2 / np.where(none, 1.0, E1)).real >= 1)
        mat.refuse(bad, "E1 and E2 must not be 0, and NU12 below the root of E1/E2")
    c11 = E1 / (1 - nu * nu * E2 / E1)
    c22 = c11 * E2 / E1
    o = 0 * G
    g1, g2 = (np.where(g == 0, RIGID_SHEAR * G, g) for g in (g1, g2))
    return Layer(
        plane=matrix((c11, nu * c22, o), (nu * c22, c22, o), (o, o, G)),
        through=matrix((g1, o), (o, g2)),
        density=mat["RHO"],
        loss=mat["GE"],
    )


def turned(plane: Any_, through: Any_, c: Any_, s: Any_) -> tuple[Any_, Any_]:
    """Stiffnesses (..., 3, 3) and (..., 2, 2) of a material whose axis 1 is at the angle of cosine
    c, sine s (...).

    Reuter's form: Q = Rᵀ Q' R with the engineering strains of the material R times those of the new
    axes (Jones 1999, eq. 2.84).
    """
    R = matrix(
        (c * c, s * s, c * s),
        (s * s, c * c, -c * s),
        (-2 * c * s, 2 * c * s, c * c - s * s),
    )
    return congruent(R, plane), congruent(matrix((c, s), (-s, c)), through)


def contract(A: Any_, C: Any_) -> Any_:
    """Stiffness (e, n 2, m 2) of the plane law C (e, 3, 3) from a Gram matrix of gradients A (e, n,
    2, m, 2).
    """
    e, n, _, m, _ = A.shape
    law = (
        C[:, _VOIGT[:, :, None, None], _VOIGT].transpose(0, 1, 3, 2, 4).reshape(e, 4, 4)
    )
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


def laminates(t: CardRows) -> Laminate:
    """The sections of rows (p,) of PCOMP or PCOMPG in their material axes.

    Raises
    ------
    DeckError, UnsupportedCard
        On a laminate without thickness or with a ply that is singular, an absent material, or an
        unknown LAM.
    """
    option = _options(t)
    plies = _plies(t, option)
    t.refuse(plies.height.sum(axis=1).real <= 0, "its plies have no thickness")
    A, B, D = stiffness(plies)
    # the stresses of a laminate follow from those of its plies, so that each must resist shear
    soft = (plies.height.real > 0) & _singular(plies.through)
    why = (
        "ply {} has no stiffness in transverse shear; give its material G12, or G1Z and G2Z "
        "(MAT8), G33 (MAT2), or E and NU (MAT1)"
    )
    t.refuse(soft, why, np.broadcast_to(1 + np.arange(soft.shape[1]), soft.shape))
    why = (
        "its plies have no stiffness in a direction of their plane; check E2 "
        "and G12, or G11 to G33"
    )
    t.refuse(_singular(A), why)
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


def _singular(matrices: Any_) -> Bool:
    """Which matrices (..., k, k) are singular to rounding, (...); complex steps have complex
    ones.
    """
    size = np.linalg.svd(matrices, compute_uv=False)
    return np.asarray(size.min(axis=-1) <= np.finfo(np.float64).eps * size.max(axis=-1))


def _options(t: CardRows) -> Any_:
    text = np.char.upper(np.char.strip(t["LAM"].astype(str)))
    for short, name in _SHORT.items():
        text = np.where(text == short, name, text)
    strange = ~np.isin(text, OPTIONS)
    t.refuse_unsupported(
        strange, f"has LAM {{}}; allowed are blank, {', '.join(OPTIONS[1:])}", text
    )
    return text


def _plies(t: CardRows, option: Any_) -> Plies:
    """The plies from the bottom up; those of a LAM such as SYM are mirrored."""
    mid, T, theta = (t.ragged(c) for c in ("MID", "T", "THETA"))
    k = np.arange(max(int(mid.sizes.max()), 1))
    there = k < mid.sizes[:, None]
    at = mid.offsets[:-1, None] + np.where(there, k, 0)
    height = np.where(there, T.values[at], 0.0)
    half = np.isin(option, tuple(MIRRORED))
    if half.any():
        at = np.concatenate([at, at[:, ::-1]], axis=1)
        height = np.concatenate(
            [height, np.where(half[:, None], height[:, ::-1], 0.0)], axis=1
        )
    each = t.take(np.repeat(np.arange(len(t)), at.shape[1]))
    used = layers(each, mid.values[at].ravel())
    angle = np.radians(1.0) * theta.values[at].ravel()
    plane, through = turned(used.plane, used.through, np.cos(angle), np.sin(angle))
    z0 = np.where(np.isnan(t["Z0"]), -height.sum(axis=1) / 2, t["Z0"])
    return Plies(
        height=height,
        z=z0[:, None] + np.cumsum(height, axis=1) - height,
        plane=plane.reshape(*at.shape, 3, 3),
        through=through.reshape(*at.shape, 2, 2),
        density=used.density.reshape(at.shape),
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
        f = matrix((F[..., 0, 0], F[..., 2, 1]), (F[..., 2, 0], F[..., 1, 1]))
        compliance = compliance + np.einsum(
            "pl,plji,pljk,plkm->pim", p.height * w / 2, f, flexible, f, optimize=True
        )
    return np.linalg.inv(compliance)


def _smeared(
    option: Any_, p: Plies, A: Any_, B: Any_, D: Any_, S: Any_
) -> tuple[Any_, Any_, Any_, Any_]:
    """The sections where LAM simplifies them: MEM, BEND, SMEAR, SMCORE (the last ply is the
    core).
    """
    for half, whole in MIRRORED.items():
        option = np.where(option == half, whole, option)
    membrane, flat, smear, core = (option[:, None, None] == name for name in SIMPLER)
    total = p.height.sum(axis=1)[:, None, None]
    B = np.where(membrane | flat | smear | core, 0.0, B)
    rigid = scaled(RIGID_SHEAR * _turning(p), np.eye(2))
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
    return (
        np.where(flat, 0.0, A),
        B,
        np.where(membrane, 0.0, D),
        np.where(membrane, 0.0, S),
    )
