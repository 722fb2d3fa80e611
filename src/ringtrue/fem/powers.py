"""What one parameter changes, and the exact parts of a polynomial dependence, from the kernels at
complex factors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Int
from ringtrue.core.parameters import CardField, Parameter
from ringtrue.errors import DeckError, UnsupportedError
from ringtrue.fem.assembly import full_matrices
from ringtrue.fem.change import changed, rows_of, rows_of_elements, within
from ringtrue.fem.kinds import batches
from ringtrue.fem.mesh import Matrices, Mesh
from ringtrue.fem.rows import Rows, common, union
from ringtrue.fem.slopes import is_place
from ringtrue.model.model import Model

CHECK = 1.37  # a factor at which the polynomial must hold
EXACT, NOISE = 1e-10, 1e-13  # relative: not polynomial above, no such power below
INVALID = (DeckError, np.linalg.LinAlgError, ValueError)  # of factors that a section does not allow
Pair = tuple[sparse.csr_array, sparse.csr_array]


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Targets of the same elements, or a factor on one of their matrices.

    Attributes
    ----------
    which : int
        Position of the parameter.
    parameter : Parameter
    rows : dict
        Rows of each element card that it changes.
    reach : dict
        Rows that feel its fields: with a target for some elements only, more than those.
    targets : tuple of CardField
    matrix : str
        "stiffness" or "mass" where it is a factor on that.
    """

    which: int
    parameter: Parameter
    rows: Rows
    reach: Rows
    targets: tuple[CardField, ...] = ()
    matrix: str = ""

    @property
    def fields(self) -> str:
        """What it scales, in words."""
        return (
            ", ".join(sorted({f"{t.card} {t.field}" for t in self.targets}))
            or f"{self.matrix} of elements"
        )

    def scaled(self, part: Matrices, card: str, at: Int, a: float | complex) -> Matrices:
        """The matrices of rows `at` of a card with its factor, if it is one on them."""
        if not self.matrix:
            return part
        on = np.isin(at, self.rows.get(card, at[:0]))
        matrix = part.stiffness if self.matrix == "stiffness" else part.mass
        return replace(
            part,
            **{self.matrix: matrix * np.where(on, a, 1.0).reshape(-1, *[1] * (matrix.ndim - 1))},
        )


def groups_of(model: Model, which: int, parameter: Parameter) -> list[Group]:
    """The groups of a parameter; factors on damping are none, as K and M do not depend on them.

    Raises
    ------
    UnsupportedError
        If it moves nodes, or if groups share an element: their products are not sums.
    InputError
        If a target or element is not in the model.
    """
    moved = [f"{t.card} {t.field}" for t in parameter.targets if is_place(t)]
    moved += [f"shape of {len(s.nodes)} nodes" for s in parameter.shapes]
    if moved:
        raise UnsupportedError(
            f"parameter {parameter.name}: {moved[0]} moves nodes; a reduced model has sections, "
            "materials, springs and "
            "masses only (try a solver that is run anew at each point)"
        )
    by_elements: dict[tuple[int, ...], list[CardField]] = {}
    for t in parameter.targets:
        by_elements.setdefault(t.elements, []).append(t)
    found = []
    for elements, targets in by_elements.items():
        changed(model, parameter.name, targets, 1.0)  # names a target that is not there
        reach = union(rows_of(model, t) for t in targets)
        found.append(Group(which, parameter, within(model, reach, elements), reach, tuple(targets)))
    for s in parameter.substructures:
        rows = rows_of_elements(model, parameter.name, s.elements)
        if s.matrix != "damping":
            found.append(Group(which, parameter, rows, rows, (), s.matrix))
    fields = [g for g in found if g.targets]
    if any(common(a.rows, b.rows) for i, a in enumerate(fields) for b in fields[:i]):
        raise UnsupportedError(
            f"parameter {parameter.name}: its targets share elements, but not all of them"
        )
    return found


def built(
    m: Mesh, groups: Sequence[Group], rows: Rows, factors: Sequence[float | complex]
) -> list[Matrices]:
    """Element matrices of the rows with the groups at their factors; none feels the fields of one
    it is not in.
    """
    model = m.model
    for g, a in zip(groups, factors, strict=True):
        model = changed(model, g.parameter.name, g.targets, a) if g.targets and a != 1 else model
    there, out = Mesh(model, m.xyz, m.cd, m.scalar), list[Matrices]()
    for card, build, at in batches(model, rows):
        part = build(there, card, at)
        for g, a in zip(groups, factors, strict=True):
            part = g.scaled(part, card, at, a)
        out.append(part)
    return out


def size(a: sparse.csr_array | Any_) -> float:
    """Largest absolute entry."""
    data = a.data if sparse.issparse(a) else a
    return float(np.abs(data).max(initial=0.0))


def cubic(m: Mesh, g: Group, *, linear: bool = False) -> dict[int, Pair]:
    """The parts of K(a) = K0 + Σ a^power K_power, M likewise, by power; those that are there.

    The kernels are evaluated at a = 1, -1, i, which gives the coefficients of a cubic without loss
    of digits, and at one further point, which proves that it is one. Where it is thought to be
    `linear`, i is left out: a complex kernel takes the time of several. Only the affected elements
    are computed.

    Raises
    ------
    UnsupportedError
        If the dependence is not a polynomial of degree three or less, or not linear where it was
        thought to be.
    """
    if g.matrix:
        K, M = full_matrices(m, built(m, (), g.rows, ()))
        return {1: (K, M * 0) if g.matrix == "stiffness" else (K * 0, M)}
    points = (1, -1, CHECK) if linear else (1, -1, 1j, CHECK)
    with np.errstate(
        all="ignore"
    ):  # a rational dependence may have its pole at one of the points; it is refused
        try:
            samples = {a: full_matrices(m, built(m, (g,), g.rows, (a,))) for a in points}
        except DeckError as e:  # a section that has a limit, such as the thickness of a laminate
            raise UnsupportedError(_not_polynomial(g)) from e
    parts = []
    for which in range(2):
        at = {a: s[which] for a, s in samples.items()}
        c = _powers(at)
        miss = size(c[0] + CHECK * c[1] + CHECK**2 * c[2] + CHECK**3 * c[3] - at[CHECK])
        if not miss <= EXACT * size(at[CHECK]):
            raise UnsupportedError(_not_polynomial(g))
        noise = NOISE * size(samples[1][which])
        parts.append([a if size(a) > noise else a * 0 for a in c])
    return {
        power: (parts[0][power], parts[1][power])
        for power in (1, 2, 3)
        if any(size(p[power]) for p in parts)
    }


def _powers(at: dict[complex, sparse.csr_array]) -> list[sparse.csr_array]:
    """c0..c3 of a cubic from its values at 1, -1, i: perfectly conditioned; of a straight line
    without i.
    """
    even, odd = (at[1] + at[-1]) / 2, (at[1] - at[-1]) / 2
    P, Q = (at[1j].real, at[1j].imag) if 1j in at else (even, odd)
    return [(even + P) / 2, (odd + Q) / 2, (even - P) / 2, (odd - Q) / 2]


def _not_polynomial(g: Group) -> str:
    return (
        f"parameter {g.parameter.name} ({g.fields}): the matrices are not a cubic polynomial of it"
    )
