"""GENEL: stiffness or flexibility between listed components, with the rigid motion that others give
them.

With the components u_i of UI and u_d of UD: u_i = Z f_i + S u_d and f_d = −Sᵀ f_i (MSC Nastran
Quick Reference Guide, GENEL), so that K = [I −S]ᵀ Z⁻¹ [I −S]. Where S is not given, six components
of UD hold a rigid body, and S is that body's motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.elements.spring import spread
from ringtrue.fem.equations import rigid_motion
from ringtrue.fem.mesh import Matrices, Mesh, error
from ringtrue.model.model import Model, Table


def alike(model: Model, at: Int) -> Iterator[Int]:
    """The rows `at` in groups of as many UI and UD."""
    t = model["GENEL"]
    sizes = np.stack([t.ragged(c).sizes[at] for c in ("UI", "UD")], axis=1)
    _, group = np.unique(sizes, axis=0, return_inverse=True)
    for k in range(int(group.max(initial=-1)) + 1):
        yield at[group.reshape(-1) == k]


def _listed(t: Table, name: str, at: Int) -> Any_:
    """A ragged column of rows with lists of one length, (e, n)."""
    column = t.ragged(name)
    first, size = column.offsets[at], int(column.sizes[at[0]])
    return np.asarray(column.values[first[:, None] + np.arange(size)])


def _components(m: Mesh, t: Table, kind: str, at: Int) -> tuple[Int, Float]:
    """Full DOFs (e, n, 3) of the components in UI or UD, -1 for none, and their directions in
    them.
    """
    ids, c = _listed(t, f"U{kind}", at), _listed(t, f"C{kind}", at)
    dofs, way = spread(m, ids.reshape(-1), c.reshape(-1), t, np.repeat(at, ids.shape[1]))
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
        raise error(
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
        raise error(
            m.model,
            t,
            int(rest[loose.argmax()]),
            "UD leaves a rigid motion free; give S, or other components",
        )
    S[~given] = np.linalg.solve(phi[:, n:].swapaxes(1, 2), phi[:, :n].swapaxes(1, 2)).swapaxes(1, 2)
    return S


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of GENEL, which have as many UI and UD each (`alike`).

    Raises
    ------
    DeckError
        If Z cannot be inverted, S is missing and cannot be found, or a node is absent.
    """
    t = m.model[card]
    parts = [_components(m, t, kind, at) for kind in ("I", "D")]
    n, d = parts[0][0].shape[1], parts[1][0].shape[1]
    K = _symmetric(_listed(t, "KZ", at), n)
    flexible = t["FORM"][at] == "Z"
    values = np.abs(np.linalg.eigvalsh(K.real[flexible])) if flexible.any() else np.ones((0, 1))
    singular = values.min(axis=1) <= 1e-13 * values.max(axis=1)
    if singular.any():
        raise error(m.model, t, int(at[flexible][singular.argmax()]), "Z cannot be inverted")
    K[flexible] = np.linalg.inv(K[flexible])
    A = np.concatenate(
        [np.broadcast_to(np.eye(n), (at.size, n, n)), -_motion(m, t, at, n, d)], axis=2
    )
    K = A.swapaxes(1, 2) @ K @ A
    dofs, way = (np.concatenate(x, axis=1) for x in zip(*parts, strict=True))
    k = 3 * (n + d)
    full = np.einsum("eia,eij,ejb->eiajb", way, K, way, optimize=True).reshape(-1, k, k)
    return Matrices(
        dofs.reshape(-1, k), full, np.zeros((at.size, k)), np.zeros(at.size), np.empty((0, k, k))
    )
