"""DMIG: stiffness, mass and damping given as matrices, chosen by K2GG, M2GG and B2GG in case
control.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Int
from ringtrue.errors import DeckError
from ringtrue.fem.mesh import Mesh, error, unsupported

SYMMETRIC, SQUARE = 6, 1
Given = tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]


def given(m: Mesh) -> Given | None:
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
    K, M, B = (sparse.csr_array(_sum(m, names) * c) for names, c in zip(chosen, scale, strict=True))
    return K, M, B


def _sum(m: Mesh, names: Sequence[tuple[float, str]]) -> sparse.csr_array:
    total = sparse.csr_array((m.size, m.size))
    for factor, name in names:
        total = sparse.csr_array(total + factor * named(m, name))
    return total


def named(m: Mesh, name: str) -> sparse.csr_array:
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
        raise unsupported(
            m.model, t, i, f"{name} is {kind}; allowed are real matrices of form 1 and 6"
        )
    row, column = (_dofs(m, i, t.ragged(f"G{e}").row(i), t.ragged(f"C{e}").row(i)) for e in "IJ")
    value = t.ragged("A").row(i)
    if form == SYMMETRIC:  # one triangle is given, or both alike: each pair counts once
        row, column = np.maximum(row, column), np.minimum(row, column)
        _, once = np.unique(row * m.size + column, return_index=True)
        row, column, value = row[once], column[once], value[once]
    A = sparse.coo_array((value, (row, column)), shape=(m.size, m.size)).tocsr()
    if form == SYMMETRIC:
        return sparse.csr_array(A + sparse.tril(A, -1).T)
    if abs(A - A.T).max() > 1e-9 * abs(A).max():
        raise error(m.model, t, i, f"{name} is not symmetric")
    return A


def _dofs(m: Mesh, row: int, ids: Int, component: Int) -> Int:
    return m.dof(ids, component.astype(np.int64), m.model["DMIG"], np.full(ids.shape, row))
