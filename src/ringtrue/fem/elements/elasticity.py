"""Elasticity of elements: the stiffness of isotropic material from the gradients of the shape
functions, and the materials of solids, MAT1 or MAT9 in the frame that PSOLID CORDM names.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.mesh import CardRows, Isotropic, check_ratio, frame, isotropic
from ringtrue.fem.negative_stiffness import asks_for_negative_stiffness, elasticity
from ringtrue.model.model import Model


def gram(gradients: Float, weights: Float) -> Float:
    """A[i,a,j,b] = ∫ ∂aNi ∂bNj; gradients (e, gp, n, d), weights (e, gp) -> (e, n, d, n, d)."""
    e, g, n, d = gradients.shape
    flat = gradients.reshape(e, g, n * d)
    return ((flat * weights[:, :, None]).swapaxes(1, 2) @ flat).reshape(e, n, d, n, d)


def elastic(A: Float, c11: Any_, c12: Any_, G: Any_) -> Any_:
    """Stiffness (e, n d, n d) with σaa = c11 εaa + c12 εbb, τab = G γab from the Gram matrix A; c,
    G (e,).
    """
    e, n, d = A.shape[:3]
    c11, c12, G = (c.reshape(-1, 1, 1, 1, 1) for c in (c11, c12, G))
    K = c12 * A + G * A.transpose(0, 1, 4, 3, 2)
    trace = np.einsum("eiaja->eij", A)
    for a in range(d):
        K[:, :, a, :, a] += (
            G[..., 0, 0] * trace + (c11 - c12 - 2 * G)[..., 0, 0] * A[:, :, a, :, a]
        )
    return K.reshape(e, n * d, n * d)


def plane_stress(E: Any_, nu: Any_) -> tuple[Any_, Any_]:
    """c11, c12 of plane stress."""
    c = E / (1 - nu * nu)
    return c, nu * c


def solid(E: Any_, nu: Any_) -> tuple[Any_, Any_]:
    """c11, c12 of a three-dimensional body."""
    c = E / ((1 + nu) * (1 - 2 * nu))
    return (1 - nu) * c, nu * c


def determinants(derivatives: Float, x: Float) -> Float:
    """(e, gp), of the map from natural derivatives (gp, n, d) at nodes x (e, n, d); 0 where it is
    singular.
    """
    return np.asarray(np.linalg.det(np.einsum("gnr,ena->egra", derivatives, x)))


def jacobian(derivatives: Float, x: Float) -> tuple[Float, Float, Float]:
    """Of the map from natural derivatives (gp, n, d) at nodes x (e, n, d).

    Returns
    -------
    J : (e, gp, d, d), J[r, a] = ∂x_a/∂ξ_r
    det : (e, gp)
    gradients : (e, gp, n, d)
    """
    J = np.einsum("gnr,ena->egra", derivatives, x)
    det = np.linalg.det(J)
    gradients = np.linalg.solve(
        J,
        np.broadcast_to(
            derivatives.swapaxes(1, 2), (*J.shape[:2], *derivatives.shape[:0:-1])
        ),
    )
    return J, det, gradients.swapaxes(2, 3)


def incompatible(
    derivatives: Float, J0: Float, det0: Float, det: Float, weights: Float
) -> Float:
    """Gradients of bubble modes with zero mean: the patch test holds on any distortion.

    Taken at the centre's Jacobian and scaled by det0/det (Taylor, Beresford and Wilson 1976); what
    mean is left is removed (Ibrahimbegovic and Wilson 1991). `derivatives` (gp, m, d), J0 (e, d,
    d), weights (e, gp) with det in them -> (e, gp, m, d).
    """
    g = np.einsum("era,gmr->egma", np.linalg.inv(J0).swapaxes(1, 2), derivatives)
    g = g * (det0[:, None] / det)[:, :, None, None]
    mean = np.einsum("eg,egma->ema", weights, g) / weights.sum(1)[:, None, None]
    return np.asarray(g - mean[:, None])


# x y z xy yz zx, the order of MAT9
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Anisotropic:
    """MAT9 rows, one an element: `tensor` (e, 3, 3, 3, 3) in basic, `rho, loss` (e,), real or
    complex.
    """

    tensor: Any_
    rho: Any_
    loss: Any_


def elasticity_matrix(material: Isotropic | Anisotropic) -> Any_:
    """Matrices (e, 6, 6) in basic, engineering shear, in the order of PAIRS."""
    if isinstance(material, Anisotropic):
        i, j = np.array(PAIRS).T
        return material.tensor[:, i[:, None], j[:, None], i, j]
    c11, c12 = solid(material.E, material.nu)
    out = np.zeros((c11.size, 6, 6), dtype=np.result_type(c11, material.shear))
    out[:, :3, :3] = c12[:, None, None]
    for k in range(3):
        out[:, k, k] = c11
        out[:, k + 3, k + 3] = material.shear
    return out


def in_cartesian(gradients: Any_) -> Any_:
    """What makes strains along natural coordinates ones of basic: (..., 6, 6), engineering shear,
    in the order of PAIRS; from the gradients (..., 3, 3) of the coordinates, as rows.
    """
    i, j = np.array(PAIRS).T
    first = gradients[..., i, :]
    second = gradients[..., j, :]
    rows = [
        first[..., a] * second[..., b] + first[..., b] * second[..., a]
        for a, b in PAIRS
    ]
    rows[:3] = [0.5 * row for row in rows[:3]]
    return np.stack(rows, axis=-2)


def is_anisotropic(model: Model, pid: Int) -> Bool:
    """Whether each PSOLID id (e,) has a MAT9."""
    if "MAT9" not in model or "PSOLID" not in model:
        return np.zeros(pid.shape, dtype=bool)
    p = model["PSOLID"]
    return np.isin(pid, p.ids[np.isin(p["MID"], model["MAT9"].ids)])


def tensor(C: Any_) -> Any_:
    """Matrix of elasticity (e, 6, 6), engineering shear, to the tensor (e, 3, 3, 3, 3)."""
    out = np.empty((len(C), 3, 3, 3, 3), dtype=C.dtype)
    for i, (a, b) in enumerate(PAIRS):
        for j, (c, d) in enumerate(PAIRS):
            for p, q in ((a, b), (b, a)):
                out[:, p, q, c, d] = out[:, p, q, d, c] = C[:, i, j]
    return out


def turned(C: Any_, R: Any_) -> Any_:
    """A tensor (e, 3, 3, 3, 3) given in axes R (e, 3, 3), unit vectors as rows, in basic."""
    return np.asarray(
        np.einsum("epqrs,epa,eqb,erc,esd->eabcd", C, R, R, R, R, optimize=True)
    )


def anisotropic(p: CardRows, x: Any_, element_axes: Any_) -> Anisotropic:
    """MAT9 of each row of PSOLID, turned into basic.

    Its CORDM is 0 (basic), -1 (`element_axes`, (e, 3, 3)) or a frame, taken at the mean of the
    nodes x (e, n, 3).
    """
    m = p.mesh
    t = p.named("MAT9", "MID")
    rows, inverse = np.unique(t.at, return_inverse=True)
    C = elasticity(t.table, 6)[rows]
    if not asks_for_negative_stiffness(m.model):
        lam = np.linalg.eigvalsh(C.real)
        bad = lam[:, 0] < -1e-9 * np.abs(lam).max(axis=1)
        why = "its matrix G is not positive; check the signs and places of its terms"
        m.rows("MAT9", rows).refuse(bad, why)
    cid = p["CORDM"]
    C4 = tensor(C)[inverse]
    if (cid != 0).any():
        own = (cid == -1)[:, None, None]
        C4 = turned(C4, np.where(own, element_axes, frame(m, cid, x.mean(axis=1))))
    return Anisotropic(C4, t["RHO"], t["GE"])


def moduli(p: CardRows) -> Isotropic:
    """MAT1 of each row of PSOLID (e,)."""
    mat = p.named("MAT1", "MID")
    iso = isotropic(mat)
    check_ratio(mat, iso.nu, 0.5)
    return iso


def bulk(iso: Isotropic) -> tuple[Any_, Any_, Any_]:
    """Bulk modulus, and c11, c12 of what is left when it is taken off; (e,) each."""
    c11, c12 = solid(iso.E, iso.nu)
    kappa = (c11 + 2 * c12) / 3
    return kappa, c11 - kappa, c12 - kappa


def nearest(R: Any_) -> Any_:
    """The rotation nearest to vectors R (e, 3, 3), given as rows: R Qᵀ is symmetric (polar
    decomposition).

    By Newton's iteration (Higham 1986), through which a complex step passes.
    """
    Q = R / np.cbrt(np.abs(np.linalg.det(R.real)))[:, None, None]
    for _ in range(_POLAR):
        Q = (Q + np.linalg.inv(Q).swapaxes(1, 2)) / 2
    return np.asarray(Q)


_POLAR = 30  # quadratic once near; 30 serve any element that is not flat to 1e-6


def by_normal(along: Any_, other: Any_) -> Any_:
    """Axes (e, 3, 3) as rows: x along `along` (e, 3), z normal to it and `other`."""
    z = np.cross(along, other)
    rows = np.stack([along, np.cross(z, along), z], axis=1)
    return np.asarray(rows / np.sqrt((rows * rows).sum(axis=2, keepdims=True)))


def between(x: Any_, first: list[int], second: list[int]) -> Float:
    """Vector (e, 3) from the mean of one set of nodes of x (e, n, 3) to the mean of another."""
    return np.asarray(x[:, second].mean(axis=1) - x[:, first].mean(axis=1))
