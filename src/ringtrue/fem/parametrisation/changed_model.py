"""A model with the fields of some parameters changed, real or by a complex step."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Any_, Bool, Int
from ringtrue.core.parameters import CardField, Parameter, Shape, is_matrix
from ringtrue.errors import InputError, did_you_mean
from ringtrue.fem.element_cards import ELEMENTS
from ringtrue.fem.elements.curved_shell import with_neighbours
from ringtrue.fem.elements.shell_section import LAMINATES
from ringtrue.fem.mesh import Rows, union
from ringtrue.fem.nonstructural_mass import CARDS, sharers
from ringtrue.model.cards import MADE, resectioned
from ringtrue.model.edit import BOTH_ENDS
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, Ragged, Table, stacked
from ringtrue.model.references import REFERENCES

# they stand on the corners of shells that they do not name
FOLLOWERS = ("CFAST", "CWELD")
_PLY = re.compile(r"([A-Z](?:[A-Z0-9]*[A-Z])?)(\d+)")
Factor = float | complex


def scaled(model: Model, parameter: Parameter, factor: Factor) -> Model:
    """A copy of the model with the parameter at `factor`: fields, those of some
    elements only where the parameter names them, and nodes.

    A PBEAM whose end B or stations equal its end A keeps that. Where a target holds for some
    elements only, they get a copy of the property or material.

    Raises
    ------
    InputError
        If a card, id or field is absent, blank or not a real number, or the parameter is a factor
        on matrices.
    """
    if parameter.substructures:
        raise InputError(
            f"parameter {parameter.name} is a factor on element matrices: no model has them as "
            "fields"
        )
    targets = list(parameter.targets)
    own = dict[tuple[str, int, tuple[int, ...]], int]()
    for i, t in enumerate(targets):
        if t.elements:
            card = (t.card, t.id, t.elements)
            if card not in own:  # several of its fields are changed in one copy
                model, named = _own(model, parameter.name, t)
                own[card] = named.id
            targets[i] = replace(t, id=own[card], elements=())
    model = changed(model, parameter.name, targets, factor)
    for shape in parameter.shapes:
        model = moved(model, shape, float(np.real(factor)) - 1)
    return model


def changed(
    model: Model, name: str, targets: Sequence[CardField], factor: Factor | Any_
) -> Model:
    """A copy with the fields of `targets` at `factor`, whatever elements they are meant for.

    Several factors are those of equal shares of the rows, the first of the first rows.

    Raises
    ------
    InputError
        If a card, id or field is absent, blank or not a real number.
    """
    groups: dict[tuple[str, str, float], list[int]] = {}
    for t in targets:
        groups.setdefault((t.card, t.field, t.step), []).append(t.id)
    tables = dict(model.tables)
    for (card, field, step), ids in groups.items():
        rows = _rows_with(tables, name, card, field, np.array(ids))
        factors = np.ones(len(tables[card]), dtype=np.result_type(factor, np.float64))
        factors[rows] = np.repeat(factor, rows.size // np.size(factor))
        change = _Scaling(f"parameter {name}: {card} {ids[0]} {field}", step, factors)
        tables[card] = _with_fields(tables[card], rows, field, change)
    for card in MADE:
        if dimensioned := [t.id for t in targets if t.card == card]:
            tables[MADE[card]] = resectioned(tables, card, np.array(dimensioned))
    return replace(model, tables=tables)


def _there(tables: dict[str, Table], card: str, wanted: int) -> str:
    """What the model has in place of a card that it lacks: the numbers next to it, or the cards of
    like name.
    """
    if card not in tables or not tables[card].ids.size:
        return did_you_mean(card, (c for c, t in tables.items() if t.ids.size))
    ids = np.unique(tables[card].ids)
    near = np.sort(ids[np.argsort(np.abs(ids - wanted), kind="stable")[:6]])
    return f"; {ids.size} {card}, next to it {', '.join(map(str, near.tolist()))}"


def _rows_with(
    tables: dict[str, Table], name: str, card: str, field: str, ids: Int
) -> Int:
    """Rows of a card with these ids; an error names the first that is absent."""
    there = tables[card].ids if card in tables else ids[:0]
    rows = np.flatnonzero(there == ids[0] if ids.size == 1 else np.isin(there, ids))
    lost = set(ids.tolist()).difference(there[rows].tolist())
    if lost:
        first = next(i for i in ids.tolist() if i in lost)
        raise InputError(
            f"parameter {name}: {card} {first} {field}: no such card in the model"
            f"{_there(tables, card, first)}"
        )
    return rows


@dataclass(frozen=True, slots=True)
class _Scaling:
    """What a parameter does to values of a field.

    Attributes
    ----------
    where : str
        Parameter, card and field, for messages.
    step : float
        If not 0, values become value + step (factor - 1) in place of value times factor.
    factors : (n,) float64 or complex128
        Of each row of the table.
    """

    where: str
    step: float
    factors: Any_

    def of(self, values: NDArray[Any], at: Int, rows: Int) -> NDArray[Any]:
        """A copy of the values, those `at` changed, which belong to `rows`."""
        real = values.dtype.kind in "fc"
        if not real or np.isnan(values[at]).any():
            raise InputError(
                f"{self.where}: must hold a real number, got {'a blank' if real else values[at[0]]}"
            )
        factors = self.factors[rows]
        out = values.astype(np.result_type(values, factors))
        out[at] = (
            out[at] + self.step * (factors - 1) if self.step else out[at] * factors
        )
        return out


def _with_fields(table: Table, rows: Int, field: str, change: _Scaling) -> Table:
    """The table with a field of some rows changed; a uniform PBEAM stays uniform."""
    ply = _PLY.fullmatch(field)
    if (
        field not in table.columns
        and ply
        and isinstance(table.columns.get(ply[1]), Ragged)
    ):
        return _with_ply(table, rows, ply[1], int(ply[2]), change)
    if field not in table.columns:
        raise InputError(
            f"{change.where}: no such field{did_you_mean(field, table.columns)}"
        )
    if is_matrix(table.card, field):
        given = table.ragged(field)
        inside = np.flatnonzero(np.isin(given.owner, rows))
        return with_entries(
            table, field, change.of(given.values, inside, given.owner[inside])
        )
    column = table.columns[field]
    if isinstance(column, Ragged):
        raise InputError(
            f"{change.where} is a list; number its entries: {field}1, {field}2 ..."
        )
    out = table.with_column(field, change.of(column, rows, rows))
    other_end = BOTH_ENDS.get(field) if table.card == "PBEAM" else None
    if other_end is None:
        return out
    both = rows[table[other_end][rows] == column[rows]]
    if both.size:
        out = out.with_column(other_end, change.of(table[other_end], both, both))
    stations = f"{field}X"
    if stations in table.columns:
        entries = table.ragged(stations)
        of = entries.owner
        equal = np.flatnonzero(np.isin(of, rows) & (entries.values == column[of]))
        if equal.size:
            out = with_entries(
                out, stations, change.of(entries.values, equal, of[equal])
            )
    return out


def _with_ply(table: Table, rows: Int, name: str, ply: int, change: _Scaling) -> Table:
    """Entry `ply` (from 1) of a list; a blank one takes the value of the entry before it first."""
    ragged = table.ragged(name)
    values = _filled(ragged, rows) if table.card in LAMINATES else ragged.values
    at = ragged.offsets[rows] + ply - 1
    if (at >= ragged.offsets[rows + 1]).any() or ply < 1:
        raise InputError(f"{change.where}: there is no entry {ply}")
    return with_entries(table, name, change.of(values, at, rows))


def with_entries(table: Table, name: str, values: NDArray[Any]) -> Table:
    """The table with other values of a column, plain or of lists."""
    old = table.columns[name]
    column = Ragged(values, old.offsets) if isinstance(old, Ragged) else values
    return replace(table, columns={**table.columns, name: column})


def _filled(ragged: Ragged, rows: Int) -> NDArray[Any]:
    """The values with blanks of `rows` replaced by the entry before."""
    values = ragged.values.copy()
    if values.dtype.kind not in "fc" or not np.isnan(values).any():
        return values
    of = ragged.owner
    given = np.maximum.accumulate(
        np.where(np.isnan(values), -1, np.arange(values.size))
    )
    use = np.isin(of, rows) & (given >= ragged.offsets[of])
    values[use] = values[given[use]]
    return values


def moved(model: Model, shape: Shape, amount: float) -> Model:
    """A copy with the nodes of `shape` moved by `amount` times their vectors; they stand in basic
    (CP 0) then.

    Raises
    ------
    InputError
        If a node is absent.
    """
    grid = model["GRID"]
    at = grid.find(np.array(shape.nodes, dtype=np.int64))
    if (at < 0).any():
        raise InputError(
            f"shape: GRID {np.array(shape.nodes)[at < 0][0]} is not in the model"
        )
    x = positions(model)[at] + amount * np.array(shape.vectors)
    for i in range(3):
        column = grid[f"X{i + 1}"].copy()
        column[at] = x[:, i]
        grid = grid.with_column(f"X{i + 1}", column)
    frame = grid["CP"].copy()
    frame[at] = 0
    return replace(
        model, tables={**model.tables, "GRID": grid.with_column("CP", frame)}
    )


def rows_of(model: Model, target: CardField) -> Rows:
    """Rows of each element card that the target changes; all users of the card where no elements
    are named.
    """
    ids = np.array([target.id])
    if target.card == "GRID":
        return users_of_nodes(model, ids)
    if target.card in CARDS:
        return sharers(model, {}, ids)
    found = _users(model, target.card, ids)
    # offsets change its length
    if target.card in ("CBAR", "CBEAM") and target.field.startswith("W"):
        return sharers(model, found)
    # a spot weld is as long as its sheets are thick
    welds = {"CWELD", "PWELD"} <= model.tables.keys()
    if target.card == "PSHELL" and welds and "SPOT" in model["PWELD"]["TYPE"]:
        found["CWELD"] = np.arange(len(model["CWELD"]))
    return found


def _users(model: Model, card: str, ids: Int) -> Rows:
    """Rows of each element card that name one of these cards, themselves or through a property, a
    frame or a node.
    """
    elements = set(affected_cards(model))
    found: list[Rows] = []
    followed: dict[str, Int] = {}
    waiting = [(MADE.get(card, card), ids)]
    while waiting:
        card, ids = waiting.pop()
        # a node of a frame may have that frame as its CD
        ids = np.setdiff1d(ids, followed.get(card, []))
        followed[card] = np.union1d(followed.get(card, []), ids)
        if card in elements:
            found.append({card: np.flatnonzero(np.isin(model[card].ids, ids))})
        for r in [
            r for r in REFERENCES if card in r.of and r.card in model and ids.size
        ]:
            rows = _naming(model[r.card], r.field, ids)
            if r.card in elements:
                found.append({r.card: rows})
            elif rows.size:
                waiting.append((r.card, model[r.card].ids[rows]))
    return {c: at for c, at in union(found).items() if at.size}


def _naming(table: Table, field: str, ids: Int) -> Int:
    """Rows of a table whose field, one value or a list, holds one of the ids."""
    if field not in table.columns:
        return np.empty(0, dtype=np.int64)
    values, owner = table.entries(field)
    return np.unique(owner[np.isin(values, ids)])


def within(model: Model, rows: Rows, elements: Sequence[int]) -> Rows:
    """Those of the rows whose element id is listed; all if the list is empty."""
    if not elements:
        return rows
    picked = {
        card: at[np.isin(model[card].ids[at], elements)] for card, at in rows.items()
    }
    return {card: at for card, at in picked.items() if at.size}


def rows_of_elements(model: Model, name: str, elements: Sequence[int]) -> Rows:
    """Rows of each element card with these ids.

    Raises
    ------
    InputError
        If one is not in the model.
    """
    rows = within(
        model, {c: np.arange(len(model[c])) for c in affected_cards(model)}, elements
    )
    if sum(at.size for at in rows.values()) < len(set(elements)):
        raise InputError(
            f"parameter {name}: not all of its {len(set(elements))} elements are in the model"
        )
    return rows


def users_of_nodes(model: Model, nodes: Int) -> Rows:
    """Rows of each element card that stand on any of the nodes; every row if a frame hangs on one.

    With them the shells whose node normals (PARAM,SNORM) those decide, and all that share a whole
    mass (NSML).
    """
    found = {}
    frame = any(
        f"CORD1{k}" in model and _on(model[f"CORD1{k}"], nodes).any() for k in "RCS"
    )
    for card in affected_cards(model):
        at = np.flatnonzero(_on(model[card], nodes) | frame | (card in FOLLOWERS))
        if at.size:
            found[card] = at
    return sharers(model, with_neighbours(model, found))


def affected_cards(model: Model) -> Iterable[str]:
    """Element cards of the model that are assembled."""
    return [card for card in ELEMENTS if card in model]


def _on(table: Table, nodes: Int) -> Bool:
    hit = np.zeros(len(table), dtype=bool)
    for r in REFERENCES:
        if r.card == table.card and "GRID" in r.of:
            hit[_naming(table, r.field, nodes)] = True
    return hit


def _own(model: Model, name: str, target: CardField) -> tuple[Model, CardField]:
    """The model with a copy of the target's card for the elements it is meant for, and the target
    on that copy.
    """
    rows = within(model, rows_of(model, target), target.elements)
    where = f"parameter {name}: {target.card} {target.id}"
    if not rows:
        raise InputError(
            f"{where}: none of its elements {list(target.elements[:5])} uses it"
        )
    if target.card in model and target.card in affected_cards(model):
        return model, replace(target, elements=())
    named = MADE.get(target.card, target.card)
    links = [r for r in REFERENCES if named in r.of and r.card in model]
    direct = [r for r in links if r.card in rows]
    if direct:
        fresh, model = _copied(model, named, target.id, _family(direct[0].of))
        model = (
            model
            if named == target.card
            else _row_added(model, target.card, target.id, fresh)
        )
        for r in direct:
            model = _redirected(
                model, r.card, r.field, rows=rows[r.card], old=target.id, fresh=fresh
            )
        rows = {c: at for c, at in rows.items() if c not in {r.card for r in direct}}
    elif links:
        fresh, model = _copied(model, target.card, target.id, _family(links[0].of))
    # through the properties of the elements that are left
    for r in links if rows else []:
        model = _by_property(
            model, r.card, r.field, rows=rows, old=target.id, fresh=fresh
        )
    return model, replace(target, id=fresh, elements=())


def _family(cards: tuple[str, ...]) -> str:
    return "MAT" if cards[0].startswith("MAT") else "P"


def _copied(model: Model, card: str, row_id: int, family: str) -> tuple[int, Model]:
    """A copy of a row under a new id, which no card of the family has."""
    ids = [
        t.ids.max(initial=0)
        for c, t in model.tables.items()
        if c.startswith(family) and c != "PARAM"
    ]
    fresh = int(max(ids)) + 1
    return fresh, _row_added(model, card, row_id, fresh)


def _row_added(model: Model, card: str, row_id: int, fresh: int) -> Model:
    table = model[card]
    row = table.find(np.array([row_id]))
    columns: dict[str, Any] = {}
    for name, column in table.columns.items():
        if isinstance(column, Ragged):
            columns[name] = Ragged.of([column.row(int(row[0]))])
        else:
            columns[name] = column[row]
    columns[next(iter(columns))] = np.array([fresh])
    made = Table(card, columns, np.array([-1]), np.array([0]))
    return replace(model, tables={**model.tables, card: stacked(table, made)})


def _redirected(
    model: Model, card: str, field: str, rows: Int, old: int, fresh: int
) -> Model:
    """The model in which these rows of a card name `fresh` in place of `old`."""
    values, owner = model[card].entries(field)
    mine = np.isin(owner, rows) & (values == old)
    table = with_entries(model[card], field, np.where(mine, fresh, values))
    return replace(model, tables={**model.tables, card: table})


def _by_property(
    model: Model, card: str, field: str, rows: Rows, old: int, fresh: int
) -> Model:
    """Copies of the properties `card` that name material `old`, naming `fresh`, for the element
    rows.
    """
    naming = model[card].ids[_naming(model[card], field, np.array([old]))]
    for r in [r for r in REFERENCES if card in r.of and r.card in rows]:
        used = model[r.card][r.field][rows[r.card]]
        for pid in np.intersect1d(used, naming).tolist():
            new, model = _copied(model, card, pid, "P")
            copy = model[card].find(np.array([new]))
            model = _redirected(model, card, field, rows=copy, old=old, fresh=fresh)
            model = _redirected(
                model, r.card, r.field, rows=rows[r.card], old=pid, fresh=new
            )
    return model
