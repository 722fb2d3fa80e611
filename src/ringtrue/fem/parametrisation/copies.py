"""Elements of a model several times in one model, each time with fields of their own.

A call of a kernel costs about as much for a hundred elements as for one: the matrices of a few
elements at many factors come from one call.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.parameters import CardField
from ringtrue.fem.element_cards import ELEMENTS
from ringtrue.fem.mesh import Mesh, Rows
from ringtrue.fem.parametrisation.changed_model import FOLLOWERS, with_entries
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
            return cls(m, rows, originals=whole, number=none, named={}, stride=0, count=1)
        named = _named(model, rows)
        ids = {card: model[card].ids[at] for card, at in named.items()}
        numbered = (c for c in model.tables if c.startswith(CARDS) and c != "PARAM")
        stride = 1 + max((int(model[c].ids.max(initial=0)) for c in numbered), default=0)
        tables = dict(model.tables)
        where, originals, number = Rows(), Rows(), Rows()
        for card, at in (*rows.items(), *named.items()):
            part = model[card].take(at)
            tables[card] = stacked(
                model[card], *(_shifted(part, k * stride, ids) for k in range(1, count))
            )
            if card in rows:
                first = len(model[card])
                where[card] = np.concatenate([at, first + np.arange((count - 1) * at.size)])
                originals[card] = np.concatenate([np.arange(first), np.tile(at, count - 1)])
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
                out += [replace(t, id=t.id + k * self.stride) for k in range(self.count)]
            elif t.card in self.rows and t.id in self.mesh.model[t.card].ids[self.rows[t.card]]:
                out.append(t)  # elements keep their ids
        return out


def copyable(m: Mesh, rows: Rows, targets: Iterable[CardField]) -> bool:
    """Whether copies have the matrices of the originals: no element looks for others by their ids,
    or shares a mass with them; and all fields are those of elements, properties and materials.
    """
    alone = not m.model.case.nsm and not any(card in rows for card in FOLLOWERS)
    return alone and all(t.card in ELEMENTS or t.card.startswith(CARDS) for t in targets)


def _named(model: Model, rows: Rows) -> Rows:
    """Rows of the properties and materials that elements name, themselves or through others."""
    out = Rows()
    waiting = list(rows.items())
    while waiting:
        card, at = waiting.pop()
        for r in (r for r in REFERENCES if r.card == card and r.field in model[card].columns):
            values, owner = model[card].entries(r.field)
            for target in (c for c in r.of if c.startswith(CARDS) and c in model):
                there = np.flatnonzero(np.isin(model[target].ids, values[np.isin(owner, at)]))
                old = out.get(target, there[:0])
                if np.setdiff1d(there, old).size:
                    out[target] = np.union1d(old, there)
                    waiting.append((target, there))
    for card, made in MADE.items():
        if made in out and card in model:
            out[card] = np.flatnonzero(np.isin(model[card].ids, model[made].ids[out[made]]))
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
