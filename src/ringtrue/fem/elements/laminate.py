"""PCOMP, PCOMPG: classical lamination theory with the transverse shear of the layers in
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
from ringtrue.fem.elements.shell_material import RIGID_SHEAR, layers, turned
from ringtrue.fem.mesh import error, unsupported
from ringtrue.model.model import Model, Table

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
        raise error(
            model, t, int(rows[np.flatnonzero(total.real <= 0)[0]]), "its plies have no thickness"
        )
    A, B, D = stiffness(plies)
    _refuse_singular(model, t, rows, plies, A)
    S = transverse_shear(plies, A, B, D)
    A, B, D, S = _smeared(option, plies, A, B, D, S)
    return Laminate(A, B, D, S, _turning(plies), (plies.height * plies.density).sum(axis=1))


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
        raise error(model, t, int(rows[laminate[0]]), why)
    if (flat := np.flatnonzero(_singular(A))).size:
        why = (
            "its plies have no stiffness in a direction of their plane; check E2 and G12, or "
            "G11 to G33"
        )
        raise error(model, t, int(rows[flat[0]]), why)


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
        raise unsupported(
            model,
            t,
            int(rows[i]),
            f"has LAM {text[i]}; allowed are blank, {', '.join(OPTIONS[1:])}",
        )
    return text


def _plies(model: Model, t: Table, rows: Int, option: Any_) -> Plies:
    """The plies from the bottom up; those of a LAM such as SYM are mirrored."""
    mid, T, theta = t.ragged("MID"), t.ragged("T"), t.ragged("THETA")
    first, count = mid.offsets[rows], mid.sizes[rows]
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
    return Plies(height, z, plane, through, used.density.reshape(at.shape))


def _turning(p: Plies) -> Any_:
    """In-plane shear modulus times the thickness (p,), the mean over all directions."""
    Q = p.plane
    G = (Q[..., 0, 0] + Q[..., 1, 1] - 2 * Q[..., 0, 1]) / 8 + Q[..., 2, 2] / 2
    return np.asarray((p.height * G).sum(axis=1))


def stiffness(p: Plies) -> tuple[Any_, Any_, Any_]:
    """A, B, D (p, 3, 3) about the reference plane."""
    h, zc = p.height, p.z + p.height / 2
    weights = (h, h * zc, h * zc * zc + h**3 / 12)
    A, B, D = (np.einsum("pl,plij->pij", w, p.plane) for w in weights)
    return A, B, D


def transverse_shear(p: Plies, A: Any_, B: Any_, D: Any_) -> Any_:
    """Transverse shear stiffness (p, 2, 2): Rolfes and Rohwer (1997), eqs. 14-20."""
    low = B.swapaxes(1, 2)
    neutral = np.linalg.solve(
        A, B
    )  # strain of the reference plane per curvature without a normal force, negative
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
