"""Groups: what one parameter changes. Regions: elements on which the same groups act, and entries
of their matrices at factors of all parameters.

A call of a kernel costs about as much for a hundred elements as for one: the matrices of a few
elements at many factors come from one call, on a model that has the elements several times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Int
from ringtrue.core.parameters import CardField, Parameter, is_matrix
from ringtrue.errors import DeckError, UnsupportedError
from ringtrue.fem.element_cards import ELEMENTS, batches, with_listed_mass
from ringtrue.fem.mesh import ElementMatrices, Mesh, Rows, common, union
from ringtrue.fem.parametrisation.changed_model import (
    FOLLOWERS,
    changed,
    rows_of,
    rows_of_elements,
    with_entries,
    within,
)
from ringtrue.fem.parametrisation.element_derivatives import is_place
from ringtrue.model.cards import MADE
from ringtrue.model.model import Model, Table, stacked
from ringtrue.model.references import REFERENCES

CARDS = ("P", "MAT")  # how the names of properties and materials begin


@dataclass(frozen=True, slots=True, eq=False)
class Copies:
    """A model that has some of its elements `count` times, with the properties and materials that
    they name.

    Attributes
    ----------
    mesh : Mesh
        The first copy is the original.
    rows : dict
        Of the elements, one copy after the other.
    originals, number : dict
        Of each row of an element card: the row that it is a copy of, and which copy, from 0.
    named : dict
        Ids of the properties and materials that have copies, by card.
    stride : int
        Between the ids of a property and of its copy.
    count : int
    """

    mesh: Mesh
    rows: Rows
    originals: Rows
    number: Rows
    named: Mapping[str, Int]
    stride: int
    count: int

    @classmethod
    def of(cls, m: Mesh, rows: Rows, count: int) -> Copies:
        """Of the rows of element cards; see `copyable`. One copy is the model as it is."""
        model = m.model
        if count == 1:
            whole = {card: np.arange(len(model[card])) for card in rows}
            none = {card: np.zeros_like(at) for card, at in whole.items()}
            return cls(
                m, rows, originals=whole, number=none, named={}, stride=0, count=1
            )
        named = _named(model, rows)
        ids = {card: model[card].ids[at] for card, at in named.items()}
        numbered = (c for c in model.tables if c.startswith(CARDS) and c != "PARAM")
        stride = 1 + max(
            (int(model[c].ids.max(initial=0)) for c in numbered), default=0
        )
        tables = dict(model.tables)
        where, originals, number = Rows(), Rows(), Rows()
        for card, at in (*rows.items(), *named.items()):
            part = model[card].take(at)
            tables[card] = stacked(
                model[card], *(_shifted(part, k * stride, ids) for k in range(1, count))
            )
            if card in rows:
                first = len(model[card])
                where[card] = np.concatenate(
                    [at, first + np.arange((count - 1) * at.size)]
                )
                originals[card] = np.concatenate(
                    [np.arange(first), np.tile(at, count - 1)]
                )
                copy = np.repeat(np.arange(1, count), at.size)
                number[card] = np.concatenate([np.zeros(first, dtype=np.int64), copy])
        return cls(
            mesh=replace(m, model=replace(model, tables=tables)),
            rows=where,
            originals=originals,
            number=number,
            named=ids,
            stride=stride,
            count=count,
        )

    def targets(self, some: Sequence[CardField]) -> list[CardField]:
        """The fields that are of all copies of these; none of those that no element here names.

        `changed` takes them with a factor for each copy, (count,).
        """
        if self.count == 1:
            return list(some)
        out = []
        for t in some:
            if t.card in self.named and t.id in self.named[t.card]:
                out += [
                    replace(t, id=t.id + k * self.stride) for k in range(self.count)
                ]
            elif (
                t.card in self.rows
                and t.id in self.mesh.model[t.card].ids[self.rows[t.card]]
            ):
                out.append(t)  # elements keep their ids
        return out


def copyable(m: Mesh, rows: Rows, targets: Iterable[CardField]) -> bool:
    """Whether copies have the matrices of the originals: no element looks for others by their ids,
    or shares a mass with them; and all fields are those of elements, properties and materials.
    """
    alone = not m.model.case.nsm and not any(card in rows for card in FOLLOWERS)
    return alone and all(
        t.card in ELEMENTS or t.card.startswith(CARDS) for t in targets
    )


def _named(model: Model, rows: Rows) -> Rows:
    """Rows of the properties and materials that elements name, themselves or through others."""
    out = Rows()
    waiting = list(rows.items())
    while waiting:
        card, at = waiting.pop()
        for r in (
            r for r in REFERENCES if r.card == card and r.field in model[card].columns
        ):
            values, owner = model[card].entries(r.field)
            for target in (c for c in r.of if c.startswith(CARDS) and c in model):
                there = np.flatnonzero(
                    np.isin(model[target].ids, values[np.isin(owner, at)])
                )
                old = out.get(target, there[:0])
                if np.setdiff1d(there, old).size:
                    out[target] = np.union1d(old, there)
                    waiting.append((target, there))
    for card, made in MADE.items():
        if made in out and card in model:
            out[card] = np.flatnonzero(
                np.isin(model[card].ids, model[made].ids[out[made]])
            )
    return {card: at for card, at in out.items() if at.size}


def _shifted(part: Table, by: int, named: Mapping[str, Int]) -> Table:
    """A copy of some rows that names the copies of properties and materials, as one of which it has
    an id of its own.
    """
    columns: dict[str, Any] = {}
    if part.card in named:
        columns[next(iter(part.columns))] = part.ids + by
    out = replace(part, columns={**part.columns, **columns})
    for r in (r for r in REFERENCES if r.card == part.card and r.field in part.columns):
        if known := [named[c] for c in r.of if c in named]:
            values, _ = part.entries(r.field)
            here = np.isin(values, np.concatenate(known))
            out = with_entries(out, r.field, np.where(here, values + by, values))
    return out


MOST_COPIES = 16  # of elements in one call of their kernels
_Places = tuple[tuple[int, Int], ...]
# of factors that a section does not allow
INVALID = (DeckError, np.linalg.LinAlgError, ValueError)
Pair = tuple[sparse.csr_array, sparse.csr_array]


@dataclass(frozen=True, slots=True, eq=False)
class ParameterGroup:
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

    def scaled(
        self, part: ElementMatrices, card: str, at: Int, a: Any_
    ) -> ElementMatrices:
        """The matrices of rows `at` (e,) of a card with its factors (e,), if it is one on them."""
        if not self.matrix:
            return part
        on = np.isin(at, self.rows.get(card, at[:0]))
        matrix = part.stiffness if self.matrix == "stiffness" else part.mass
        factor = np.where(on, a, 1.0).reshape(-1, *[1] * (matrix.ndim - 1))
        return replace(part, **{self.matrix: matrix * factor})


def groups_of(model: Model, which: int, parameter: Parameter) -> list[ParameterGroup]:
    """The groups of a parameter.

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
        if is_matrix(t.card, t.field):
            continue
        by_elements.setdefault(t.elements, []).append(t)
    found = []
    for elements, targets in by_elements.items():
        changed(model, parameter.name, targets, 1.0)  # names a target that is not there
        reach = union(rows_of(model, t) for t in targets)
        found.append(
            ParameterGroup(
                which=which,
                parameter=parameter,
                rows=within(model, reach, elements),
                reach=reach,
                targets=tuple(targets),
            )
        )
    for s in parameter.substructures:
        rows = rows_of_elements(model, parameter.name, s.elements)
        found.append(
            ParameterGroup(
                which=which, parameter=parameter, rows=rows, reach=rows, matrix=s.matrix
            )
        )
    fields = [g for g in found if g.targets]
    if any(common(a.rows, b.rows) for i, a in enumerate(fields) for b in fields[:i]):
        raise UnsupportedError(
            f"parameter {parameter.name}: its targets share elements, but not all of them"
        )
    return found


def built(
    m: Mesh,
    groups: Sequence[ParameterGroup],
    rows: Rows,
    factors: Sequence[float | complex],
) -> list[ElementMatrices]:
    """Element matrices of the rows with the groups at their factors; none feels the fields of one
    it is not in.
    """
    targets = [g.targets for g in groups]
    return _built(Copies.of(m, rows, 1), groups, targets, np.array(factors)[:, None])


def _built(
    copies: Copies,
    groups: Sequence[ParameterGroup],
    targets: Sequence[Sequence[CardField]],
    factors: Any_,
) -> list[ElementMatrices]:
    """The same of copies, with the targets of each group there and its factors (groups, count)."""
    model = copies.mesh.model
    for g, wide, a in zip(groups, targets, factors, strict=True):
        if wide and (a != 1).any():
            model = changed(model, g.parameter.name, wide, a)
    there = with_listed_mass(replace(copies.mesh, model=model))
    out = list[ElementMatrices]()
    for card, at in batches(model, copies.rows):
        part = ELEMENTS[card](there.rows(card, at))
        originals = copies.originals[card][at]
        for g, a in zip(groups, factors, strict=True):
            part = g.scaled(part, card, originals, a[copies.number[card][at]])
        out.append(part)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Elements on which the same groups act."""

    groups: tuple[ParameterGroup, ...]
    rows: Rows

    @property
    def which(self) -> tuple[int, ...]:
        """Positions of the parameters."""
        return tuple(sorted({g.which for g in self.groups}))


def regions(groups: Sequence[ParameterGroup], rows: Rows) -> list[Region]:
    """The rows, by the groups that act on them."""
    found: dict[tuple[int, ...], Rows] = {}
    for card, at in rows.items():
        acts = np.array([np.isin(at, g.rows.get(card, ())) for g in groups]).T
        bits = np.packbits(acts, axis=1)
        _, first, of = np.unique(bits, axis=0, return_index=True, return_inverse=True)
        for k, row in enumerate(first.tolist()):
            kind = tuple(np.flatnonzero(acts[row]).tolist())
            found.setdefault(kind, {})[card] = at[of.ravel() == k]
    return [
        Region(tuple(groups[i] for i in some), there)
        for some, there in sorted(found.items())
    ]


def independent_batches(every: Sequence[Region]) -> list[list[Region]]:
    """Regions whose kernels can be called at once: none feels the fields of a group that acts on
    another only.
    """
    out: list[list[Region]] = []
    for r in every:
        for batch in out:
            if not any(_feels(r, s) or _feels(s, r) for s in batch):
                batch.append(r)
                break
        else:
            out.append([r])
    return out


def _feels(r: Region, other: Region) -> bool:
    return any(bool(common(g.reach, r.rows)) for g in other.groups if g not in r.groups)


def picked(m: Mesh, rows: Rows, wanted: Int) -> Rows:
    """Elements by their numbers, ascending, as `owners` counts them."""
    first = 0
    out = Rows()
    for card, at in batches(m.model, rows):
        here = at[wanted[(wanted >= first) & (wanted < first + at.size)] - first]
        out[card] = np.union1d(out.get(card, here), here)
        first += at.size
    return {card: at for card, at in out.items() if at.size}


def few(rows: Rows, count: int) -> Rows:
    """A sample of the rows of each card."""
    return {
        card: at[np.unique(np.linspace(0, at.size - 1, count).astype(int))]
        for card, at in rows.items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """Regions whose kernels are called at once: `independent_batches`.

    Attributes
    ----------
    mesh : Mesh
    groups : tuple of ParameterGroup
    rows : dict
        Of all the regions.
    regions : tuple of dict
        The rows of each.
    """

    mesh: Mesh
    groups: tuple[ParameterGroup, ...]
    rows: Rows
    regions: tuple[Rows, ...]
    _copies: dict[int, tuple[Copies, list[list[CardField]], list[_Places]]] = field(
        default_factory=dict
    )

    @classmethod
    def of(cls, m: Mesh, some: Sequence[Region]) -> Together:
        """The regions, in their order."""
        groups = tuple(dict.fromkeys(g for r in some for g in r.groups))
        return cls(m, groups, union(r.rows for r in some), tuple(r.rows for r in some))

    def entries(
        self, points: Sequence[Any_], of: Callable[[Any_], Any_] | None = None
    ) -> list[Any_]:
        """Lower triangles of K, then of M, of each region's elements end to end: (k, entries) at k
        points.

        Parameters
        ----------
        points : sequence of (P,) float64 or complex128
            The factors of all parameters.
        of : callable (matrices (e, d, d)) -> (e, d, d), optional
            What of the matrices is wanted in place of themselves.
        """
        targets = (t for g in self.groups for t in g.targets)
        most = MOST_COPIES if copyable(self.mesh, self.rows, targets) else 1
        parts = [
            self._some(np.array(points[k : k + most]), of)
            for k in range(0, len(points), most)
        ]
        return [np.concatenate(each) for each in zip(*parts, strict=True)]

    def _some(self, points: Any_, of: Callable[[Any_], Any_] | None) -> list[Any_]:
        count = len(points)
        if count not in self._copies:
            self._copies[count] = self._copied(count)
        copies, targets, places = self._copies[count]
        made = _built(
            copies, self.groups, targets, points[:, [g.which for g in self.groups]].T
        )
        return [
            ends([(made[i].stiffness[k], made[i].mass[k]) for i, k in on], of, count)
            for on in places
        ]

    def _copied(
        self, count: int
    ) -> tuple[Copies, list[list[CardField]], list[_Places]]:
        """Copies of the elements, the targets of each group there, and in which batches the
        elements of each region are, and where.
        """
        copies = Copies.of(self.mesh, self.rows, count)
        every = batches(copies.mesh.model, copies.rows)
        there = [(card, copies.originals[card][at]) for card, at in every]
        places = []
        for rows in self.regions:
            on = [np.flatnonzero(np.isin(at, rows.get(card, ()))) for card, at in there]
            places.append(tuple((i, k) for i, k in enumerate(on) if k.size))
        return copies, [copies.targets(g.targets) for g in self.groups], places


def entries(
    m: Mesh, some: Sequence[Region], a: Any_, of: Callable[[Any_], Any_] | None = None
) -> list[Any_]:
    """`Together.entries` of the regions, once, at the factors a (P,)."""
    return [found[0] for found in Together.of(m, some).entries([a], of)]


def ends(
    parts: Sequence[tuple[Any_, Any_]],
    of: Callable[[Any_], Any_] | None = None,
    count: int = 1,
) -> Any_:
    """Lower triangles of stiffnesses (e, d, d), then of masses, (e, d) or (e, d, d), end to end:
    (count, entries) of as many copies, one after the other.
    """
    lower = [np.empty((count, 0))]
    for x in (*(k for k, _ in parts), *(m for _, m in parts)):
        full = x if x.ndim == 3 else x[:, :, None] * np.eye(x.shape[1])
        i, j = np.tril_indices(full.shape[1])
        lower.append((of(full) if of else full)[:, i, j].reshape(count, -1))
    return np.concatenate(lower, axis=1)


def owners(m: Mesh, region: Region) -> Int:
    """Which of its elements, counted over `batches`, each of a region's `entries` is of."""
    count = 0

    def numbers(x: Any_) -> Any_:
        nonlocal count
        count += len(x)
        return np.broadcast_to(np.arange(count - len(x), count)[:, None, None], x.shape)

    wide = 1 + max(region.which)
    (found,) = entries(m, [region], np.ones(wide), numbers)
    return found.astype(np.int64) % (count // 2)


def roots(x: Any_) -> Any_:
    """1 / √(x_ii x_jj) of matrices (e, d, d); 0 where one of the two is none."""
    d = np.abs(np.einsum("eii->ei", x))
    there = d > 1e-12 * d.max(axis=1, keepdims=True, initial=0.0)
    s = np.where(there, 1 / np.sqrt(np.where(there, d, 1.0)), 0.0)
    return s[:, :, None] * s[:, None, :]
