"""Exact derivatives of the matrices to parameters.

K and M as functions of all parameters together: fixed matrices times functions of the factors.

On the elements of a region the same parameters act. Where the matrices of these are polynomials of
the factors, the functions are products of powers, exactly (`polynomials`); elsewhere they are what
interpolates the matrices between chosen factors (`interpolation`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.eigen.derivatives import MatrixDerivatives
from ringtrue.errors import UnsupportedError
from ringtrue.fem.assembly import (
    WHOLE,
    Share,
    Sum,
    System,
    full_matrices,
    reduced,
    turn,
)
from ringtrue.fem.constraints import eliminate
from ringtrue.fem.element_cards import mesh, pieces
from ringtrue.fem.elements import lumped
from ringtrue.fem.mesh import Mesh, applied, union
from ringtrue.fem.parametrisation.element_derivatives import (
    ElementDerivatives,
    central_differences,
    element_derivatives,
    given_matrix_derivatives,
    moves,
)
from ringtrue.fem.parametrisation.interpolation import SEARCH, interpolated, learn
from ringtrue.fem.parametrisation.parameter_groups import Pair, few, groups_of, regions
from ringtrue.fem.parametrisation.polynomials import (
    SAMPLE,
    AffineTerm,
    PolynomialTerms,
    own_powers,
    power,
)
from ringtrue.model.frames import diagonal
from ringtrue.model.model import Model


def affine_terms(
    model: Model,
    parameters: ParameterSet,
    system: System,
    *,
    progress: Progress = quiet,
) -> tuple[AffineTerm, ...]:
    """The parts of K(a) = K(1) + Σ g_t(a) K_t, M likewise, in the free degrees of freedom.

    What is a polynomial of degree three or less in each factor is exact; the rest (laminates, the
    sections of beams with shear, Poisson's ratio) is interpolated between the bounds, to 1e-8 of
    the roots of the diagonal entries. Only the affected elements are computed.

    Raises
    ------
    UnsupportedError
        If a parameter moves nodes, or the matrices are no smooth function of it between its bounds.
    InputError
        If a target or element is not in the model.
    """
    return share_terms(model, parameters, system.transform, progress=progress)


def share_terms(
    model: Model,
    parameters: ParameterSet,
    transform: sparse.csr_array,
    *,
    share: Share = WHOLE,
    progress: Progress = quiet,
) -> tuple[AffineTerm, ...]:
    """The part of the elements of a share in the terms of `affine_terms`, which are the same in all
    shares.

    Parameters
    ----------
    transform : (full, c) csr float64
        Motion of every node by that of the free degrees of freedom, or of those that the elements
        of the share move: the matrices are over these.
    """
    m = mesh(model)
    groups = [
        g for i, p in enumerate(parameters.parameters) for g in groups_of(model, i, p)
    ]
    say = part(progress, 0.0, 0.5)
    powers = {}
    for k, g in enumerate(groups):
        say(0.5 * k / len(groups), f"derivatives: {g.parameter.name}")
        own = own_powers(m, g)
        if own is not None:
            powers[g] = own or (1,)  # elements outside of the sample may change
    every = regions(groups, union(g.rows for g in groups))
    polynomials = PolynomialTerms(m, powers, share)
    others = []
    for k, region in enumerate(every):
        say(0.5 + 0.5 * k / len(every), "derivatives: parameters on the same elements")
        smooth = all(g in powers for g in region.groups)
        others.append(polynomials.add(region) if smooth else region.rows)
    rest = interpolated(
        m,
        groups,
        union(others),
        transform=transform,
        share=share,
        progress=part(progress, 0.5, 1.0),
    )
    given = _matrix_terms(m, parameters, transform, share)
    return (*polynomials.terms(transform), *rest, *given)


def _matrix_terms(
    m: Mesh, parameters: ParameterSet, transform: sparse.csr_array, share: Share
) -> Iterator[AffineTerm]:
    """Matrices of DMIG, which are proportional to their factors; the first share has them."""
    for i, p in enumerate(parameters.parameters):
        for found in given_matrix_derivatives(m, i, p):
            sums = []
            for matrix in (found.stiffness, found.mass):
                total = Sum(m.size)
                if share.number == 0:
                    total.add(found.dofs, matrix)
                sums.append(reduced(transform, total.total()))
            yield AffineTerm(power(i), *sums)


def matrices_kept(
    model: Model, *parameters: Parameter, most: int = SEARCH.most
) -> int | None:
    """How many matrices the interpolation of parameters together keeps of an element, seen on a
    sample of elements.

    0 where powers of each do; None where K and M are no smooth function of them (`affine_terms` has
    no parts), or take more than `most`.

    Raises
    ------
    InputError
        If a target or element is not in the model.
    """
    m = mesh(model)
    groups = [g for i, p in enumerate(parameters) for g in groups_of(model, i, p)]
    powers = [own_powers(m, g) for g in groups]
    curved = [
        few(g.rows, SAMPLE)
        for g, own in zip(groups, powers, strict=True)
        if own is None
    ]
    try:
        found = [n for rows in curved for n in learn(m, regions(groups, rows), most)]
    except UnsupportedError:
        return None
    if not curved and not any(powers):
        return None
    return max((len(n.factors) for n in found), default=0)


def system_derivatives(
    model: Model, parameters: Sequence[Parameter], system: System
) -> list[MatrixDerivatives]:
    """∂K/∂a, ∂M/∂a and ∂T/∂a at a = 1 of each parameter, csr.

    Only the affected elements are computed, for as many parameters at once as do not share one.
    Where nodes move, rigid elements and displacement frames move along.

    Raises
    ------
    InputError
        If a target, node or element is not in the model.
    """
    T = system.transform
    size = T.shape[0]
    sums = [(Sum(size), Sum(size)) for _ in parameters]
    for piece in element_derivatives(model, parameters):
        for i, at in by_owner(piece):
            sums[i][0].add(piece.dofs[at], piece.stiffness[at])
            sums[i][1].add(piece.dofs[at], piece.mass[at])
    out = []
    for p, (K, M) in zip(parameters, sums, strict=True):
        stiffness = reduced(T, K.total())
        mass = reduced(T, M.total())
        dT = _transform_derivative(model, p, system)
        if dT is not None:
            more = _with_transform(model, p, system, dT)
            stiffness = sparse.csr_array(stiffness + more[0])
            mass = sparse.csr_array(mass + more[1])
        out.append(MatrixDerivatives(stiffness, mass, transform=dT))
    return out


def by_owner(part: ElementDerivatives) -> Iterator[tuple[int, Int]]:
    """Each parameter among the derivatives, and the positions of its elements."""
    order = np.argsort(part.owner, kind="stable")
    present, first = np.unique(part.owner[order], return_index=True)
    yield from zip(present.tolist(), np.split(order, first[1:]), strict=True)


def _transform_derivative(
    model: Model, p: Parameter, system: System
) -> sparse.csr_array | None:
    """∂T/∂a of `system.transform` at a = 1, (full, f) csr; None if it is zero.

    It is not zero where the arm of a rigid element changes, or a node goes round a cylindrical
    displacement frame.
    """
    dT = _differences(model, p, system, _transform)
    if dT is None or np.abs(dT.data).max(initial=0.0) < 1e-9:
        return None
    return dT


def _differences(
    model: Model,
    p: Parameter,
    system: System,
    transform: Callable[[Model, System], sparse.csr_array],
) -> sparse.csr_array | None:
    """The derivative of a transform at a = 1; None if no node moves."""
    moving = [move for move in moves(p) if move.of_nodes]
    if not moving:
        return None
    total = sparse.csr_array(system.transform.shape)
    reach = diagonal(system.xyz) or 1.0
    for move in moving:
        for step, weight in central_differences(move.size(model), reach):
            T = transform(move.applied(model, step), system)
            total = sparse.csr_array(total + T * weight)
    return total


def _transform(model: Model, system: System) -> sparse.csr_array:
    """`system.transform` of a model whose nodes have moved."""
    return sparse.csr_array(turn(mesh(model)) @ _in_frames(model, system))


def _in_frames(model: Model, system: System) -> sparse.csr_array:
    """The same in the displacement frames, (full, f)."""
    local, free = eliminate(mesh(model))
    at = np.searchsorted(
        free, system.dofs.find(system.free.node, system.free.direction)
    )
    return sparse.csr_array(local[:, at])


def _with_transform(
    model: Model, p: Parameter, system: System, dT: sparse.csr_array
) -> Pair:
    """dTᵀ A T + Tᵀ A dT of the full K and M; DMIG turn with the displacement frames."""
    m = mesh(model)
    K, M = full_matrices(m, (part for _, _, part in pieces(m)))
    stiffness, mass = (_both(dT, A, system.transform) for A in (K, M))
    given = lumped.given_matrices(m)
    dL = None if given is None else _differences(model, p, system, _in_frames)
    if given is not None and dL is not None:
        L = _in_frames(model, system)
        stiffness = sparse.csr_array(stiffness + _both(dL, given[0], L))
        mass = sparse.csr_array(mass + _both(dL, given[1], L))
    return stiffness, mass


def _both(
    dT: sparse.csr_array, A: sparse.csr_array, T: sparse.csr_array
) -> sparse.csr_array:
    half = sparse.csr_array(dT.T.tocsr() @ A @ T)
    return sparse.csr_array(half + half.T)


def congruent(
    model: Model, parameters: Sequence[Parameter], system: System, vectors: Float
) -> Iterator[tuple[int, Float, Float]]:
    """Vᵀ(∂K/∂a)V and Vᵀ(∂M/∂a)V of many vectors and parameters, a piece of the mesh at a time.

    All vectors with all others cost one product of matrices a piece; of each with itself
    `quadratic_forms` takes less.

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
    count = vectors.shape[1]
    full = _padded(system, vectors)
    for piece in element_derivatives(model, parameters):
        for i, at in by_owner(piece):
            x = full[piece.dofs[at]]
            made = [np.zeros((0, 0)), np.zeros((0, 0))]
            for k, A in enumerate((piece.stiffness[at], piece.mass[at])):
                if np.any(A):
                    made[k] = x.reshape(-1, count).T @ applied(A, x).reshape(-1, count)
            yield i, made[0], made[1]
    for i, p in enumerate(parameters):
        dT = _transform_derivative(model, p, system)
        if dT is not None:
            dK, dM = _with_transform(model, p, system, dT)
            yield i, vectors.T @ (dK @ vectors), vectors.T @ (dM @ vectors)


def _padded(system: System, x: Float) -> Float:
    """Motions (full + 1, m) of all nodes; the last row, that of DOF -1, is zero."""
    return np.concatenate(
        [system.transform @ np.ascontiguousarray(x), np.zeros((1, x.shape[1]))]
    )


def quadratic_forms(
    model: Model, parameters: Sequence[Parameter], system: System, vectors: Float
) -> tuple[Float, Float]:
    """vᵀ(∂K/∂a)v and vᵀ(∂M/∂a)v of many vectors and parameters, from the elements, with no sparse
    matrix made.

    Parameters
    ----------
    vectors : (f, m) float64

    Returns
    -------
    stiffness, mass : (m, p) float64
    """
    full = _padded(system, vectors)
    K, M = (np.zeros((len(parameters), vectors.shape[1])) for _ in range(2))
    dofs = np.empty(0, dtype=np.int64)
    x = np.empty(0)
    for piece in element_derivatives(model, parameters):
        if not np.array_equal(piece.dofs, dofs):
            # one piece of the mesh may come once for each kind of parameter
            dofs = piece.dofs
            x = full[dofs]
        for total, A in ((K, piece.stiffness), (M, piece.mass)):
            if np.any(A):
                np.add.at(
                    total, piece.owner, np.einsum("edm,edm->em", x, applied(A, x))
                )
    for i, p in enumerate(parameters):
        dT = _transform_derivative(model, p, system)
        if dT is not None:
            dK, dM = _with_transform(model, p, system, dT)
            K[i] += np.einsum("fm,fm->m", vectors, dK @ vectors)
            M[i] += np.einsum("fm,fm->m", vectors, dM @ vectors)
    return K.T, M.T
