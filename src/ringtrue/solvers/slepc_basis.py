"""Reduced models by the ranks of the `slepc` solver: each makes the terms of its own elements and
holds its rows of the basis, in a file of all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.iterate import Progress
from ringtrue.core.parameters import ParameterSet
from ringtrue.eigen.shift import shift_below
from ringtrue.fem.mesh import applied
from ringtrue.fem.parametrisation.derivatives import by_owner, share_terms
from ringtrue.fem.parametrisation.element_derivatives import element_derivatives
from ringtrue.io.foreign.arrays import read_npy
from ringtrue.reduction.basis import AffineSystem, ProjectedSystem, StaticSensitivities, project
from ringtrue.reduction.parametric import basis_vectors, modes_of
from ringtrue.solvers.slepc_share import ShareOfModel, put_object

BASIS = "basis.npy"  # (r, free)
PROJECTED = "projected.pickle"
CHANGES = "changes.npy"  # (2, p, m, m)


@dataclass(frozen=True, slots=True, eq=False)
class AskedBasis:
    """A reduced model.

    Attributes
    ----------
    parameters : ParameterSet
    readings : (channel, full) csr float64
    count : int
        Modes that it returns, the lowest.
    fmax : float, Hz
        Up to which these are.
    """

    parameters: ParameterSet
    readings: sparse.csr_array
    count: int
    fmax: float

    def answer(self, own: ShareOfModel, at: Callable[[str], Path]) -> dict[str, Any]:
        """Write the basis and what is projected on it; the shift, and how many modes there are."""
        own.find_lowest(modes_of(self.count), shift_below(own.first_shift, self.fmax))
        count = min(self.count, own.values.size)
        none = sparse.csr_array((own.cols.size,) * 2)
        terms = share_terms(own.model, self.parameters, own.transform[:, own.cols], share=own.share)
        part = AffineSystem(none, none, self.parameters, terms, none[:0])
        vectors = _vectors(own, part, modes_of(self.count), count)
        own.write_rows(at(BASIS), vectors)
        projected = self._projected(own, part, vectors, read_npy(at(BASIS)))
        if own.share.number == 0:
            put_object(at(PROJECTED), projected)
        return {"shift": own.shift, "count": count}

    def _projected(
        self, own: ShareOfModel, part: AffineSystem, rows: Float, every: Any_
    ) -> ProjectedSystem:
        """Sums over all shares: K and M by the rows of the vectors, terms by their elements.

        Parameters
        ----------
        part : AffineSystem
            The terms of the share.
        rows : (own, r) float64
            Of the vectors.
        every : (r, free) float64
            The vectors.
        """
        terms = project(part, every[:, own.cols].T).terms
        seen = sparse.csr_array(self.readings @ own.transform)
        at = np.unique(seen.indices)
        return ProjectedSystem(
            parameters=self.parameters,
            vectors=np.eye(rows.shape[1]),
            stiffness=_symmetric(own.inner(rows, rows, 1.0, 0.0)),
            mass=_symmetric(own.inner(rows, rows, 0.0, 1.0)),
            terms=tuple((f, own.share.summed(k), own.share.summed(m)) for f, k, m in terms),
            observe=np.asarray(seen[:, at] @ every[:, at].T),
        )


def _symmetric(a: Float) -> Float:
    return (a + a.T) / 2


def _vectors(own: ShareOfModel, part: AffineSystem, most: int, count: int) -> Float:
    """The rows (own, r) of the basis: at most so many modes, and the static sensitivities of the
    lowest `count`.
    """
    values = own.values[:most]
    modes = own.modes_found[: values.size]

    def respond(load: Float, _progress: Progress) -> Float:
        at = np.flatnonzero(load.any(axis=1))
        loads = own.cols[at], load[at]
        return np.asarray(own.rank("responses", *loads, modes=values.size)[1][0])

    sensitivities = StaticSensitivities(
        values=values[:count],
        shapes=modes[:count, own.cols].T,
        shift=own.shift,
        respond=respond,
        inner=lambda a, b: own.inner(a, b, 1.0, -own.shift),
    )
    terms = [t for i in range(len(part.parameters)) for t in part.terms_of(i)]
    first, last = own.share.span(own.size)
    rows = modes[:, first:last].T / np.sqrt(values - own.shift)
    return basis_vectors(rows, sensitivities, terms)


@dataclass(frozen=True, slots=True, eq=False)
class AskedChanges:
    """∂K/∂a and ∂M/∂a along vectors.

    Attributes
    ----------
    parameters : ParameterSet
    basis : Path
        The file of the vectors.
    along : (r, m) float64
        Combinations of these.
    """

    parameters: ParameterSet
    basis: Path
    along: Float

    def answer(self, own: ShareOfModel, at: Callable[[str], Path]) -> dict[str, Any]:
        """Write the sums over the elements of all shares."""
        x = own.full(self.basis, self.along)
        m = x.shape[1]
        total = np.zeros((2, len(self.parameters), m, m))
        for piece in element_derivatives(own.model, self.parameters.parameters, own.share):
            for i, rows in by_owner(piece):
                there = x[own.where[piece.dofs[rows]]]
                flat = there.reshape(-1, m)
                for k, a in enumerate((piece.stiffness[rows], piece.mass[rows])):
                    total[k, i] += flat.T @ applied(a, there).reshape(-1, m)
        total = own.share.summed(total)
        if own.share.number == 0:
            np.save(at(CHANGES), total)
        return {}
