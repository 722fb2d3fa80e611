"""Regions: elements on which the same parameters act, and entries of their matrices at factors of
all parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.fem.kinds import batches
from ringtrue.fem.mesh import Mesh
from ringtrue.fem.powers import Group, built
from ringtrue.fem.rows import Rows, common, union

TINY = 1e-12  # share of an element's largest diagonal entry below which one scales nothing


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Elements on which the same groups act."""

    groups: tuple[Group, ...]
    rows: Rows

    @property
    def which(self) -> tuple[int, ...]:
        """Positions of the parameters."""
        return tuple(sorted({g.which for g in self.groups}))


def regions(groups: Sequence[Group], rows: Rows) -> list[Region]:
    """The rows, by the groups that act on them."""
    found: dict[tuple[int, ...], Rows] = {}
    for card, at in rows.items():
        acts = np.array([np.isin(at, g.rows.get(card, ())) for g in groups]).T
        kinds, of = np.unique(acts, axis=0, return_inverse=True)
        for k, kind in enumerate(kinds):
            found.setdefault(tuple(np.flatnonzero(kind).tolist()), {})[card] = at[of.ravel() == k]
    return [Region(tuple(groups[i] for i in some), there) for some, there in sorted(found.items())]


def apart(every: Sequence[Region]) -> list[list[Region]]:
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
    first, out = 0, Rows()
    for card, _, at in batches(m.model, rows):
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
    """Regions whose kernels are called at once: `apart`.

    Attributes
    ----------
    mesh : Mesh
    groups : tuple of Group
    rows : dict
        Of all the regions.
    places : tuple of tuple of (int, rows)
        Of each region: in which batches its elements are, and where in these.
    """

    mesh: Mesh
    groups: tuple[Group, ...]
    rows: Rows
    places: tuple[tuple[tuple[int, Int], ...], ...]

    @classmethod
    def of(cls, m: Mesh, some: Sequence[Region]) -> Together:
        """The regions, in their order."""
        rows = union(r.rows for r in some)
        there = [(card, at) for card, _, at in batches(m.model, rows)]
        places = []
        for r in some:
            on = [np.flatnonzero(np.isin(at, r.rows.get(card, ()))) for card, at in there]
            places.append(tuple((i, k) for i, k in enumerate(on) if k.size))
        return cls(m, tuple(dict.fromkeys(g for r in some for g in r.groups)), rows, tuple(places))

    def entries(self, a: Any_, of: Callable[[Any_], Any_] | None = None) -> list[Any_]:
        """Lower triangles of K, then of M, of each region's elements end to end, at the factors a
        (P,) of all.

        Parameters
        ----------
        of : callable (matrices (e, d, d)) -> (e, d, d), optional
            What of the matrices is wanted in place of themselves.
        """
        made = built(self.mesh, self.groups, self.rows, [a[g.which] for g in self.groups])
        return [
            ends([(made[i].stiffness[k], made[i].mass[k]) for i, k in on], of) for on in self.places
        ]


def entries(
    m: Mesh, some: Sequence[Region], a: Any_, of: Callable[[Any_], Any_] | None = None
) -> list[Any_]:
    """`Together.entries` of the regions, once."""
    return Together.of(m, some).entries(a, of)


def ends(parts: Sequence[tuple[Any_, Any_]], of: Callable[[Any_], Any_] | None = None) -> Any_:
    """Lower triangles of stiffnesses (e, d, d), then of masses, (e, d) or (e, d, d), end to end."""
    every = [k for k, _ in parts] + [
        x if x.ndim == 3 else x[:, :, None] * np.eye(x.shape[1]) for _, x in parts
    ]
    return np.concatenate([np.empty(0), *(_lower(of(x) if of else x) for x in every)])


def owners(m: Mesh, region: Region) -> Int:
    """Which of its elements, counted over `batches`, each of a region's `entries` is of."""
    count = 0

    def numbers(x: Any_) -> Any_:
        nonlocal count
        count += len(x)
        return np.broadcast_to(np.arange(count - len(x), count)[:, None, None], x.shape)

    wide = 1 + max(region.which)
    (found,) = entries(m, [region], np.ones(wide), numbers)
    return np.asarray(found.astype(np.int64) % (count // 2))


def roots(x: Any_) -> Any_:
    """1 / √(x_ii x_jj) of matrices (e, d, d); 0 where one of the two is none."""
    d = np.abs(np.einsum("eii->ei", x))
    there = d > TINY * d.max(axis=1, keepdims=True, initial=0.0)
    s = np.where(there, 1 / np.sqrt(np.where(there, d, 1.0)), 0.0)
    return s[:, :, None] * s[:, None, :]


def _lower(x: Any_) -> Any_:
    i, j = np.tril_indices(x.shape[1])
    return x[:, i, j].ravel()
