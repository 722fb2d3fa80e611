"""Equations between displacements: dependent ones by others, and those of rigid bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.fem.algebra import arm
from ringtrue.fem.mesh import Mesh
from ringtrue.model.model import Table, card_error

Owner = tuple[Table, int]
ROUNDING = 1e-14  # of the largest coefficient of a card: what is smaller is a zero


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """x[dependent] = coefficients x, k rows in triplet form.

    Attributes
    ----------
    dependent : (k,) int64
    row, column : (t,) int64
        Positions in `dependent`; full DOFs.
    value : (t,) float64
    owner : tuple of (Table, int)
        The card behind each row: its table and row there.
    """

    dependent: Int
    row: Int
    column: Int
    value: Float
    owner: tuple[Owner, ...]


def owners(t: Table, at: Int) -> tuple[Owner, ...]:
    """The cards of rows `at`, for messages."""
    return tuple((t, i) for i in at.tolist())


Ends = tuple[Int, Int, Bool]  # owner (k,), node id (k,), components (k, 6)


def rigid(m: Mesh, t: Table, independent: Ends, dependent: Ends) -> Equations:
    """u_m = Φ_m Φ_n⁻¹ u_n with Φ the rigid motions at the independent (n, six an element) and
    dependent DOFs.
    """
    of, g, c = listed(m, t, independent)
    count = np.bincount(of, minlength=len(t))
    if (count != 6).any():
        i = int(np.flatnonzero(count != 6)[0])
        raise card_error(
            m.model,
            t,
            i,
            f"it has {count[i]} independent components; allowed are 6 that hold a rigid body",
        )
    order = np.argsort(of, kind="stable")
    g = g[order].reshape(-1, 6)
    c = c[order].reshape(-1, 6)
    origin, size = _extent(m, g)
    own = np.arange(len(t))[:, None]
    phi_n = _motion(m, g, c, origin=origin[own], size=size[own])
    values = np.linalg.svd(phi_n, compute_uv=False)
    loose = values[:, -1] < 1e-9 * values[:, 0]
    if loose.any():
        i = int(np.flatnonzero(loose)[0])
        raise card_error(
            m.model,
            t,
            i,
            "its independent components leave a rigid motion free; choose six that hold it",
        )
    at, h, d = listed(m, t, dependent)
    phi_m = _motion(m, h, d, origin=origin[at], size=size[at])
    X = np.linalg.solve(phi_n.swapaxes(1, 2)[at], phi_m[:, :, None])[:, :, 0]
    column = (6 * g + c)[at]
    if (column == (6 * h + d)[:, None]).any():
        i = int(at[np.flatnonzero((column == (6 * h + d)[:, None]).any(axis=1))[0]])
        raise card_error(m.model, t, i, "a component is both independent and dependent")
    row = np.repeat(np.arange(at.size), 6)
    keep = np.abs(X.reshape(-1)) > ROUNDING * np.abs(X).max(initial=0.0)
    return Equations(
        dependent=6 * h + d,
        row=row[keep],
        column=column.reshape(-1)[keep],
        value=X.reshape(-1)[keep],
        owner=owners(t, at),
    )


def listed(m: Mesh, t: Table, ends: Ends) -> tuple[Int, Int, Int]:
    """Owner, row of the node and component (0..5) of each component, in order."""
    of, ids, flags = ends
    entry, c = np.nonzero(flags)
    used = np.unique(entry)
    node = np.full(ids.shape, -1)
    node[used] = m.nodes(ids[used], t, of[used])
    return of[entry], node[entry], c


def _motion(m: Mesh, node: Int, component: Int, origin: Float, size: Float) -> Float:
    """Motion of components (...) by that of a rigid body about `origin`, turns in units of 1/size:
    (..., 6).
    """
    A = arm(m.xyz[node] - origin)
    A[..., 3:] /= size[..., None, None]
    axis = np.take_along_axis(m.cd[node], (component % 3)[..., None, None], axis=-2)[..., 0, :]
    kind = np.where((component < 3)[..., None, None], A[..., :3, :], A[..., 3:, :])
    return np.asarray(np.einsum("...i,...ij->...j", axis, kind))


def rigid_motion(m: Mesh, node: Int, component: Int) -> Float:
    """Motion of components (e, k) of nodes (rows, e, k) by that of a rigid body about their centre,
    (e, k, 6).
    """
    origin, size = _extent(m, node)
    return _motion(m, node, component, origin=origin[:, None], size=size[:, None])


def _extent(m: Mesh, node: Int) -> tuple[Float, Float]:
    """Centre (e, 3) of nodes (rows, e, k), and their largest distance from it along an axis (e,), 1
    for one place.
    """
    origin = m.xyz[node].mean(axis=1)
    size = np.abs(m.xyz[node] - origin[:, None]).max(axis=(1, 2))
    return origin, np.where(size > 1e-9 * np.abs(m.xyz).max(), size, 1.0)
