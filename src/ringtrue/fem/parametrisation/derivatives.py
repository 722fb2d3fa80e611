"""Exact derivatives of the matrices to parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import CardField, Parameter
from ringtrue.eigen.derivatives import MatrixDerivatives
from ringtrue.fem.algebra import applied
from ringtrue.fem.assembly import System, full_matrices, rayleigh, sum_up, turn
from ringtrue.fem.constraints import eliminate
from ringtrue.fem.element_cards import batches
from ringtrue.fem.elements import given_matrices
from ringtrue.fem.mesh import Mesh, mesh
from ringtrue.fem.parametrisation.element_derivatives import (
    CENTRAL,
    SMALL,
    ElementDerivatives,
    displaced,
    element_derivatives,
    moves_nodes,
)
from ringtrue.model.frames import diagonal
from ringtrue.model.model import Model


def matrix_derivatives(
    model: Model, parameter: Parameter, system: System
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """∂K/∂a and ∂M/∂a at a = 1, (f, f) csr; see `system_derivatives`."""
    (slope,) = system_derivatives(model, [parameter], system)
    return slope.stiffness, slope.mass


def system_derivatives(
    model: Model, parameters: Sequence[Parameter], system: System
) -> list[MatrixDerivatives]:
    """∂K/∂a, ∂M/∂a, ∂D/∂a, ∂H/∂a (structural damping) and ∂T/∂a at a = 1 of each parameter, csr.

    Only the affected elements are computed, for as many parameters at once as do not share one.
    Where nodes move, rigid elements and displacement frames move along.

    Raises
    ------
    InputError
        If a target, node or element is not in the model.
    """
    m = mesh(model)
    T = system.transform
    slopes = list(element_derivatives(model, parameters))
    Tt, G, (alpha, beta) = sparse.csr_array(T.T), m.model.param("G", 0.0), rayleigh(model)
    moved = _transforms(model, parameters, system)
    out = []
    for p, dT, full in zip(parameters, moved, _summed(m, slopes, len(parameters)), strict=True):
        K, M, D, H = (_congruent(T, Tt, A) for A in full)
        if dT is not None:
            K, M, D, H = (
                A + B for A, B in zip((K, M, D, H), _carried(model, p, system, dT), strict=True)
            )
        out.append(
            MatrixDerivatives(
                stiffness=K,
                mass=M,
                viscous=sparse.csr_array(D + alpha * M + beta * K),
                structural=sparse.csr_array(H + G * K),
                transform=dT,
            )
        )
    return out


def _congruent(T: sparse.csr_array, Tt: sparse.csr_array, A: sparse.csr_array) -> sparse.csr_array:
    B = sparse.csr_array(Tt @ A @ T) if A.nnz else sparse.csr_array((T.shape[1], T.shape[1]))
    return sparse.csr_array((B + B.T) * 0.5)


def _summed(
    m: Mesh, slopes: Sequence[ElementDerivatives], count: int
) -> list[list[sparse.csr_array]]:
    """Full K', M', D', H' of each parameter."""
    mine: list[list[tuple[ElementDerivatives, Int]]] = [[] for _ in range(count)]
    for s in slopes:
        order = np.argsort(s.owner, kind="stable")
        present, first = np.unique(s.owner[order], return_index=True)
        for i, at in zip(present.tolist(), np.split(order, first[1:]), strict=True):
            mine[i].append((s, at))
    names = ("stiffness", "mass", "viscous", "structural")
    return [
        [
            sum_up(
                m.size, ((s.dofs[at], getattr(s, n)[at]) for s, at in parts if getattr(s, n).size)
            )
            for n in names
        ]
        for parts in mine
    ]


def _transforms(
    model: Model, parameters: Sequence[Parameter], system: System
) -> list[sparse.csr_array | None]:
    """∂T/∂a of `system.transform` at a = 1 of each parameter, (full, f) csr, where its nodes move;
    None if it is zero.

    It is not zero where the arm of a rigid element changes, or a node goes round a cylindrical
    displacement frame.
    """
    every = (_moved(model, p, system, _transform) for p in parameters)
    return [None if dT is None or np.abs(dT.data).max(initial=0.0) < 1e-9 else dT for dT in every]


def _moved(
    model: Model,
    p: Parameter,
    system: System,
    transform: Callable[[Model, System], sparse.csr_array],
) -> sparse.csr_array | None:
    """The derivative of a transform at a = 1; None if no node moves."""
    moves: list[tuple[CardField | None, int, float]] = [
        (t, 0, abs(t.step) or 1.0) for t in p.targets if moves_nodes(t)
    ]
    moves += [(None, k, float(np.abs(s.vectors).max(initial=0.0))) for k, s in enumerate(p.shapes)]
    if not moves:
        return None
    total = sparse.csr_array(system.transform.shape)
    reach = _reach(mesh(model))
    for target, shape, size in moves:
        h = SMALL * min(1.0, reach / (size or 1.0))
        for k, c in CENTRAL:
            for sign in (1, -1):
                T = transform(displaced(model, p, sign * k * h, target=target, shape=shape), system)
                total = sparse.csr_array(total + T * (sign * c / h))
    return total


def _reach(m: Mesh) -> float:
    return diagonal(m.xyz) or 1.0


def _transform(model: Model, system: System) -> sparse.csr_array:
    """`system.transform` of a model whose nodes have moved."""
    return sparse.csr_array(turn(mesh(model)) @ _in_frames(model, system))


def _in_frames(model: Model, system: System) -> sparse.csr_array:
    """The same in the displacement frames, (full, f)."""
    local, free = eliminate(mesh(model))
    at = np.searchsorted(free, system.dofs.find(system.free.node, system.free.direction))
    return sparse.csr_array(local[:, at])


def _carried(
    model: Model, p: Parameter, system: System, dT: sparse.csr_array
) -> list[sparse.csr_array]:
    """dTᵀ A T + Tᵀ A dT of the full K, M, D and Σ g K; DMIG, given in the displacement frames, turn
    with them.
    """
    m = mesh(model)
    parts = [build(m, card, at) for card, build, at in batches(model)]
    K, M = full_matrices(m, parts)
    D = sum_up(m.size, ((p.dofs, p.viscous) for p in parts if len(p.viscous)))
    H = sum_up(m.size, ((p.dofs, s) for p in parts if len(s := p.structural)))
    out = [_both(dT, A, system.transform) for A in (K, M, D, H)]
    if (direct := given_matrices.given_matrices(m)) is not None and (
        dL := _moved(model, p, system, _in_frames)
    ) is not None:
        L = _in_frames(model, system)
        out[:3] = [sparse.csr_array(a + _both(dL, A, L)) for a, A in zip(out, direct, strict=False)]
    return out


def _both(dT: sparse.csr_array, A: sparse.csr_array, T: sparse.csr_array) -> sparse.csr_array:
    half = sparse.csr_array(dT.T.tocsr() @ A @ T)
    return sparse.csr_array(half + half.T)


def congruent(
    model: Model, parameters: Sequence[Parameter], system: System, vectors: Float
) -> Iterator[tuple[int, Float, Float]]:
    """Vᵀ(∂K/∂a)V and Vᵀ(∂M/∂a)V of many vectors and parameters, a piece of the mesh at a time.

    All vectors with all others cost one product of matrices a piece; of few with each other
    `bilinear` takes less.

    Parameters
    ----------
    vectors : (f, m) float64

    Yields
    ------
    parameter : int
        Its position; one that changes several pieces comes several times, and what it is to get is
        the sum.
    stiffness, mass : (m, m) float64
        Without entries where there is none.
    """
    v = _padded(system, vectors)
    none = np.zeros((0, 0))
    for s in element_derivatives(model, parameters):
        order = np.argsort(s.owner, kind="stable")
        present, first = np.unique(s.owner[order], return_index=True)
        for i, at in zip(present.tolist(), np.split(order, first[1:]), strict=True):
            x = v[s.dofs[at]]
            yield i, *(_through(A[at], x) if np.any(A[at]) else none for A in (s.stiffness, s.mass))
    for i, (p, dT) in enumerate(
        zip(parameters, _transforms(model, parameters, system), strict=True)
    ):
        if dT is not None:
            dK, dM, _, _ = _carried(model, p, system, dT)
            yield i, vectors.T @ (dK @ vectors), vectors.T @ (dM @ vectors)


def _through(A: Float, x: Float) -> Float:
    """Σ xᵀAx over elements, (m, m), of matrices (e, d, d) or diagonals (e, d) and motions (e, d,
    m).
    """
    m = x.shape[2]
    return np.asarray(x.reshape(-1, m).T @ applied(A, x).reshape(-1, m))


def _padded(system: System, x: Float) -> Float:
    """Motions (full + 1, m) of all nodes; the last row, that of DOF -1, is zero."""
    return np.concatenate([system.transform @ np.ascontiguousarray(x), np.zeros((1, x.shape[1]))])


def _gathered(motions: list[Float], dofs: Int) -> list[Float]:
    """Of each element (e, d, m); the same array for the same motions."""
    made: dict[int, Float] = {}
    for x in motions:
        if id(x) not in made:
            made[id(x)] = x[dofs]
    return [made[id(x)] for x in motions]


def bilinear(
    model: Model, parameters: Sequence[Parameter], system: System, left: Float, right: Float
) -> tuple[Float, Float]:
    """uᵀ(∂K/∂a)v and uᵀ(∂M/∂a)v of many vectors and parameters, from the elements, with no sparse
    matrix made.

    Parameters
    ----------
    left : (s, f, m) float64
        s vectors u for each v: eigenvalues need the modes themselves, other quantities their
        adjoint vectors.
    right : (f, m) float64

    Returns
    -------
    stiffness, mass : (s, m, p) float64
    """
    v = _padded(system, right)
    u = [v if np.array_equal(x, right) else _padded(system, x) for x in left]
    K, M = (np.zeros((len(parameters), *left.shape[::2])) for _ in range(2))
    dofs = np.empty(0, dtype=np.int64)
    at = list[Float]()
    for s in element_derivatives(model, parameters):
        if not np.array_equal(
            s.dofs, dofs
        ):  # one piece of the mesh may come once for each kind of parameter
            dofs = s.dofs
            at = _gathered([v, *u], s.dofs)
        for total, A in ((K, s.stiffness), (M, s.mass)):
            if np.any(A):
                Av = applied(A, at[0])
                np.add.at(
                    total,
                    s.owner,
                    np.stack([np.einsum("edm,edm->em", x, Av) for x in at[1:]], axis=1),
                )
    for i, (p, dT) in enumerate(
        zip(parameters, _transforms(model, parameters, system), strict=True)
    ):
        if dT is not None:
            dK, dM, _, _ = _carried(model, p, system, dT)
            for total, carried in ((K, dK), (M, dM)):
                total[i] += np.einsum("sfm,fm->sm", left, carried @ right)
    return K.transpose(1, 2, 0), M.transpose(1, 2, 0)
