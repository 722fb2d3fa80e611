"""GENEL: stiffness or flexibility between listed components, with the rigid motion that others give
them.

With the components u_i of UI and u_d of UD: u_i = Z f_i + S u_d and f_d = −Sᵀ f_i (MSC Nastran
Quick Reference Guide, GENEL), so that K = [I −S]ᵀ Z⁻¹ [I −S]. Where S is not given, six components
of UD hold a rigid body, and S is that body's motion.

DMIG: stiffness, mass and damping given as matrices, chosen by K2GG, M2GG and B2GG in case
control.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import DeckError
from ringtrue.fem.elements.lumped import spread
from ringtrue.fem.mesh import ElementMatrices, Mesh
from ringtrue.fem.rigid_elements import rigid_motion
from ringtrue.model.model import Model, Table, card_error, unsupported_card


def same_sizes(model: Model, at: Int) -> Iterator[Int]:
    """The rows `at` in groups of as many UI and UD."""
    t = model["GENEL"]
    sizes = np.stack([t.ragged(c).sizes[at] for c in ("UI", "UD")], axis=1)
    _, group = np.unique(sizes, axis=0, return_inverse=True)
    for k in range(int(group.max(initial=-1)) + 1):
        yield at[group.reshape(-1) == k]


def _listed(t: Table, name: str, at: Int) -> Any_:
    """A ragged column of rows with lists of one length, (e, n)."""
    column = t.ragged(name)
    first = column.offsets[at]
    size = int(column.sizes[at[0]])
    return np.asarray(column.values[first[:, None] + np.arange(size)])


def _components(m: Mesh, t: Table, kind: str, at: Int) -> tuple[Int, Float]:
    """Full DOFs (e, n, 3) of the components in UI or UD, -1 for none, and their directions in
    them.
    """
    ids = _listed(t, f"U{kind}", at)
    c = _listed(t, f"C{kind}", at)
    dofs, way = spread(m, ids.reshape(-1), c.reshape(-1), t=t, at=np.repeat(at, ids.shape[1]))
    return dofs.reshape(*ids.shape, 3), way.reshape(*ids.shape, 3)


def _symmetric(values: Any_, n: int) -> Any_:
    """Symmetric matrices (e, n, n) from their lower triangles column by column (e, n(n + 1)/2)."""
    j, i = np.triu_indices(n)
    out = np.zeros((len(values), n, n), dtype=values.dtype)
    out[:, i, j] = out[:, j, i] = values
    return out


def _motion(m: Mesh, t: Table, at: Int, n: int, d: int) -> Any_:
    """S (e, n, d): as given, else that of a rigid body."""
    given = t.ragged("S").sizes[at] > 0
    S = np.zeros((at.size, n, d), dtype=t.ragged("S").values.dtype)
    if given.any():
        S[given] = _listed(t, "S", at[given]).reshape(-1, n, d)
    rest = at[~given]
    if not d or not rest.size:
        return S
    if d != 6:
        raise card_error(
            m.model,
            t,
            int(rest[0]),
            f"UD has {d} components and S is missing; give S, or six that hold a body",
        )
    listed = [_listed(t, c, rest) for c in ("UI", "CI", "UD", "CD")]
    ui, ci, ud, cd = listed
    node = m.nodes(np.concatenate([ui, ud], axis=1), t, rest)
    phi = rigid_motion(m, node, np.concatenate([ci, cd], axis=1) - 1)
    values = np.linalg.svd(phi[:, n:], compute_uv=False)
    loose = values[:, -1] < 1e-9 * values[:, 0]
    if loose.any():
        raise card_error(
            m.model,
            t,
            int(rest[loose.argmax()]),
            "UD leaves a rigid motion free; give S, or other components",
        )
    S[~given] = np.linalg.solve(phi[:, n:].swapaxes(1, 2), phi[:, :n].swapaxes(1, 2)).swapaxes(1, 2)
    return S


def build_general(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of GENEL, which have as many UI and UD each (`same_sizes`).

    Raises
    ------
    DeckError
        If Z cannot be inverted, S is missing and cannot be found, or a node is absent.
    """
    t = m.model[card]
    parts = [_components(m, t, kind, at) for kind in ("I", "D")]
    n = parts[0][0].shape[1]
    d = parts[1][0].shape[1]
    K = _symmetric(_listed(t, "KZ", at), n)
    flexible = t["FORM"][at] == "Z"
    values = np.abs(np.linalg.eigvalsh(K.real[flexible])) if flexible.any() else np.ones((0, 1))
    singular = values.min(axis=1) <= 1e-13 * values.max(axis=1)
    if singular.any():
        raise card_error(m.model, t, int(at[flexible][singular.argmax()]), "Z cannot be inverted")
    K[flexible] = np.linalg.inv(K[flexible])
    A = np.concatenate(
        [np.broadcast_to(np.eye(n), (at.size, n, n)), -_motion(m, t, at, n=n, d=d)], axis=2
    )
    K = A.swapaxes(1, 2) @ K @ A
    dofs, way = (np.concatenate(x, axis=1) for x in zip(*parts, strict=True))
    k = 3 * (n + d)
    full = np.einsum("eia,eij,ejb->eiajb", way, K, way, optimize=True).reshape(-1, k, k)
    return ElementMatrices(
        dofs=dofs.reshape(-1, k),
        stiffness=full,
        mass=np.zeros((at.size, k)),
    )


SYMMETRIC = 6
SQUARE = 1
GivenMatrices = tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]


def given_matrices(m: Mesh) -> GivenMatrices | None:
    """The chosen stiffness, mass and damping, (n, n) csr each, in the displacement frames; None if
    none is chosen.

    PARAM CK2, CM2 and CB2 scale them; PARAM,WTMASS does not (the mass is entered as mass).

    Raises
    ------
    DeckError
        If a matrix that is chosen is not in the deck, or is not symmetric, or PARAM CK1, CM1 or CB1
        scale the elements.
    UnsupportedCard
        If one is rectangular or complex.
    """
    case = m.model.case
    chosen = case.k2gg, case.m2gg, case.b2gg
    if not any(chosen):
        return None
    for name, names in zip(("CK1", "CM1", "CB1"), chosen, strict=True):
        if names and m.model.param(name, 1.0) != 1:
            raise DeckError(
                f"PARAM,{name} scales all elements: give the factor to their materials and "
                "properties instead"
            )
    scale = (m.model.param(name, 1.0) for name in ("CK2", "CM2", "CB2"))
    K, M, B = (
        sparse.csr_array(_summed(m, names) * c) for names, c in zip(chosen, scale, strict=True)
    )
    return K, M, B


def _summed(m: Mesh, names: Sequence[tuple[float, str]]) -> sparse.csr_array:
    total = sparse.csr_array((m.size, m.size))
    for factor, name in names:
        total = sparse.csr_array(total + factor * named_matrix(m, name))
    return total


def named_matrix(m: Mesh, name: str) -> sparse.csr_array:
    """The DMIG matrix of this name over the full DOFs, (n, n) csr in the displacement frames, both
    triangles.
    """
    have = (
        np.char.upper(m.model["DMIG"]["NAME"].astype(str))
        if "DMIG" in m.model
        else np.empty(0, dtype=str)
    )
    found = np.flatnonzero(have == name.upper())
    if not found.size:
        raise DeckError(
            f"case control asks for DMIG {name}, which is not in the deck; it has "
            f"{', '.join(have) or 'none'}"
        )
    i = int(found[0])
    t = m.model["DMIG"]
    form = int(t["IFO"][i])
    if form not in (SYMMETRIC, SQUARE) or t.ragged("B").row(i).any():
        kind = "complex" if form in (SYMMETRIC, SQUARE) else f"of form {form}"
        raise unsupported_card(
            m.model, t, i, f"{name} is {kind}; allowed are real matrices of form 1 and 6"
        )
    row, column = (
        _named_dofs(m, i, t.ragged(f"G{e}").row(i), t.ragged(f"C{e}").row(i)) for e in "IJ"
    )
    value = t.ragged("A").row(i)
    if form == SYMMETRIC:  # one triangle is given, or both equal: each pair counts once
        row, column = np.maximum(row, column), np.minimum(row, column)
        _, once = np.unique(row * m.size + column, return_index=True)
        row = row[once]
        column = column[once]
        value = value[once]
    A = sparse.coo_array((value, (row, column)), shape=(m.size, m.size)).tocsr()
    if form == SYMMETRIC:
        return sparse.csr_array(A + sparse.tril(A, -1).T)
    if abs(A - A.T).max() > 1e-9 * abs(A).max():
        raise card_error(m.model, t, i, f"{name} is not symmetric")
    return A


def _named_dofs(m: Mesh, row: int, ids: Int, component: Int) -> Int:
    return m.dof(ids, component.astype(np.int64), m.model["DMIG"], np.full(ids.shape, row))
