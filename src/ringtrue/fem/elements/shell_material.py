"""Layers in plane stress: MAT1, MAT2 and MAT8, and how a stiffness turns in the plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.isotropy import plane_stress, solid
from ringtrue.fem.mesh import Isotropic, check_ratio, error, isotropic
from ringtrue.model.model import Model, Table

RIGID_SHEAR = (
    1000.0  # no transverse shear modulus given: G12 times this, which bends as if rigid in shear
)
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
        out.plane[where], out.through[where] = p.plane, p.through
        out.density[where], out.loss[where] = p.density, p.loss
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
        _plane(c11, c12, c11, iso.shear, zero, zero),
        _through(iso.G, zero, iso.G),
        iso.rho,
        iso.loss,
    )


def _mat2(t: Table, row: Int, core: bool) -> Layer:
    g11, g12, g13, g22, g23, g33 = (t[c][row] for c in ("G11", "G12", "G13", "G22", "G23", "G33"))
    rigid = RIGID_SHEAR * g33
    through = _through(g11, g12, g22) if core else _through(rigid, 0 * g33, rigid)
    return Layer(_plane(g11, g12, g22, g33, g13, g23), through, t["RHO"][row], t["GE"][row])


def _check_mat8(model: Model, row: Int) -> None:
    """Rows of MAT8 that make no elasticity; moduli may be complex, or negative, where functions are
    sampled.
    """
    E1, E2, nu = (model["MAT8"][c][row] for c in ("E1", "E2", "NU12"))
    none = (E1 == 0) | (E2 == 0)
    if (bad := none | ((nu * nu * E2 / np.where(none, 1.0, E1)).real >= 1)).any():
        why = "E1 and E2 must not be 0, and NU12 below the root of E1/E2"
        raise error(model, model["MAT8"], int(row[bad][0]), why)


def _mat8(t: Table, row: Int, core: bool) -> Layer:
    E1, E2, nu, G, g1, g2 = (t[c][row] for c in ("E1", "E2", "NU12", "G12", "G1Z", "G2Z"))
    c11 = E1 / (1 - nu * nu * E2 / E1)
    c22 = c11 * E2 / E1
    zero = 0 * G
    g1, g2 = (np.where(g == 0, RIGID_SHEAR * G, g) for g in (g1, g2))
    return Layer(
        _plane(c11, nu * c22, c22, G, zero, zero),
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
    c, s = np.asarray(c), np.asarray(s)
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
