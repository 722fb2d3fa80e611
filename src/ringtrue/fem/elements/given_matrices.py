"""GENEL: stiffness or flexibility between listed components, with the rigid motion that others give
them.

With the components u_i of UI and u_d of UD: u_i = Z f_i + S u_d and f_d = −Sᵀ f_i (MSC Nastran
Quick Reference Guide, GENEL), so that K = [I −S]ᵀ Z⁻¹ [I −S]. Where S is not given, six components
of UD hold a rigid body, and S is that body's motion.

DMIG: stiffness, mass and damping given as matrices, chosen by K2GG, M2GG and B2GG in case
control.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import DeckError
from ringtrue.fem.elements.lumped import spread
from ringtrue.fem.mesh import CardRows, ElementMatrices, Mesh, congruent
from ringtrue.fem.rigid_elements import rigid_motion
from ringtrue.model.model import Model


def sizes(model: Model, at: Int) -> Int:
    """How many UI and UD rows `at` of GENEL have, (e, 2): one call of `build_general` takes those
    with as many.
    """
    t = model["GENEL"]
    return np.stack([t.ragged(c).sizes[at] for c in ("UI", "UD")], axis=1)


def _listed(t: CardRows, name: str) -> Any_:
    """A column of lists of one length, (e, n)."""
    return t.ragged(name).values.reshape(len(t), -1)


def _components(t: CardRows, kind: str) -> tuple[Int, Float]:
    """Full DOFs (e, n, 3) of the components in UI or UD, -1 for none, and their directions in
    them.
    """
    ids = _listed(t, f"U{kind}")
    c = _listed(t, f"C{kind}")
    each = t.take(np.repeat(np.arange(len(t)), ids.shape[1]))
    dofs, way = spread(each, ids.reshape(-1), c.reshape(-1))
    return dofs.reshape(*ids.shape, 3), way.reshape(*ids.shape, 3)


def _symmetric(values: Any_, n: int) -> Any_:
    """Symmetric matrices (e, n, n) from their lower triangles column by column (e, n(n + 1)/2)."""
    j, i = np.triu_indices(n)
    out = np.zeros((len(values), n, n), dtype=values.dtype)
    out[:, i, j] = out[:, j, i] = values
    return out


def _motion(t: CardRows, n: int, d: int) -> Any_:
    """S (e, n, d): as given, else that of a rigid body."""
    column = t.ragged("S")
    given = column.sizes > 0
    S = np.zeros((len(t), n, d), dtype=column.values.dtype)
    if given.any():
        S[given] = _listed(t.take(given), "S").reshape(-1, n, d)
    if not d or given.all():
        return S
    rest = t.take(~given)
    why = f"UD has {d} components and S is missing; give S, or six that hold a body"
    rest.refuse(np.full(len(rest), d != 6), why)
    ids, components = (
        np.concatenate([_listed(rest, f"{c}I"), _listed(rest, f"{c}D")], axis=1) for c in "UC"
    )
    phi = rigid_motion(t.mesh, rest.nodes_of(ids), components - 1)
    values = np.linalg.svd(phi[:, n:], compute_uv=False)
    loose = values[:, -1] < 1e-9 * values[:, 0]
    rest.refuse(loose, "UD leaves a rigid motion free; give S, or other components")
    S[~given] = np.linalg.solve(phi[:, n:].swapaxes(1, 2), phi[:, :n].swapaxes(1, 2)).swapaxes(1, 2)
    return S


def build_general(t: CardRows) -> ElementMatrices:
    """Matrices of rows of GENEL, which have as many UI and UD each (`sizes`).

    Raises
    ------
    DeckError
        If Z cannot be inverted, S is missing and cannot be found, or a node is absent.
    """
    parts = [_components(t, kind) for kind in "ID"]
    n, d = (dofs.shape[1] for dofs, _ in parts)
    K = _symmetric(_listed(t, "KZ"), n)
    flexible = t["FORM"] == "Z"
    values = np.abs(np.linalg.eigvalsh(K.real))
    singular = flexible & (values.min(axis=1) <= 1e-13 * values.max(axis=1))
    t.refuse(singular, "Z cannot be inverted")
    K[flexible] = np.linalg.inv(K[flexible])
    unit = np.broadcast_to(np.eye(n), (len(t), n, n))
    K = congruent(np.concatenate([unit, -_motion(t, n, d)], axis=2), K)
    dofs, way = (np.concatenate(x, axis=1) for x in zip(*parts, strict=True))
    k = 3 * (n + d)
    full = np.einsum("eia,eij,ejb->eiajb", way, K, way, optimize=True).reshape(-1, k, k)
    return ElementMatrices(
        dofs=dofs.reshape(-1, k),
        stiffness=full,
        mass=np.zeros((len(t), k)),
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
    made = []
    for letter, names in zip("KMB", chosen, strict=True):
        if names and m.model.param(f"C{letter}1", 1.0) != 1:
            raise DeckError(
                f"PARAM,C{letter}1 scales all elements: give the factor to their materials and "
                "properties instead"
            )
        total = sparse.csr_array((m.size, m.size))
        for factor, name in names:
            total = total + factor * named_matrix(m, name)
        made.append(sparse.csr_array(total * m.model.param(f"C{letter}2", 1.0)))
    K, M, B = made
    return K, M, B


def named_matrix(m: Mesh, name: str) -> sparse.csr_array:
    """The DMIG matrix of this name over the full DOFs, (n, n) csr in the displacement frames, both
    triangles.
    """
    have = m.model["DMIG"]["NAME"].astype(str) if "DMIG" in m.model else np.empty(0, dtype=str)
    found = np.flatnonzero(np.char.upper(have) == name.upper())
    if not found.size:
        raise DeckError(
            f"case control asks for DMIG {name}, which is not in the deck; it has "
            f"{', '.join(have) or 'none'}"
        )
    t = m.rows("DMIG", found[:1])
    form = int(t["IFO"][0])
    allowed = "; allowed are real matrices of form 1 and 6"
    other = np.array([form not in (SYMMETRIC, SQUARE)])
    t.refuse_unsupported(other, f"{name} is of form {form}{allowed}")
    is_complex = np.array([t.ragged("B").values.any()])
    t.refuse_unsupported(is_complex, f"{name} is complex{allowed}")
    value = t.ragged("A").values
    each = m.rows("DMIG", np.repeat(found[0], value.size))
    row, column = (
        each.dof(t.ragged(f"G{end}").values, t.ragged(f"C{end}").values.astype(np.int64))
        for end in "IJ"
    )
    if form == SYMMETRIC:  # one triangle is given, or both equal: each pair counts once
        row, column = np.maximum(row, column), np.minimum(row, column)
        _, once = np.unique(row * m.size + column, return_index=True)
        row = row[once]
        column = column[once]
        value = value[once]
    A = sparse.coo_array((value, (row, column)), shape=(m.size, m.size)).tocsr()
    if form == SYMMETRIC:
        return sparse.csr_array(A + sparse.tril(A, -1).T)
    t.refuse(np.array([abs(A - A.T).max() > 1e-9 * abs(A).max()]), f"{name} is not symmetric")
    return A
