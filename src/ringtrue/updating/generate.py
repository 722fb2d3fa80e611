"""Candidate parameters from the cards of a deck, by material, property and group of springs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import CardField
from ringtrue.errors import InputError
from ringtrue.fem.mesh import union
from ringtrue.fem.parametrisation.changed_model import rows_of
from ringtrue.model.dimensions import MADE
from ringtrue.model.model import Model, Table
from ringtrue.model.sections import section
from ringtrue.updating.candidates import (
    Candidate,
    CandidateSettings,
    Kind,
    amount,
    counted,
    given_fields,
    ids_of,
    listed,
    new_candidate,
)
from ringtrue.updating.catalogue import MASSES, MATERIALS, SECTIONS, SPREAD, SPRINGS, Catalogue
from ringtrue.updating.regions import regions

SAME = 1e-9  # relative distance of values that are one
_ENDS = {"A": "AB", "I1": "I1B", "I2": "I2B", "J": "JB", "NSM": "NSMB"}


def generate(model: Model, settings: CandidateSettings | None = None) -> tuple[Candidate, ...]:
    """All candidates of a deck that an element uses, in the order material, property, region,
    spring, mass.

    Of two that are the same fields of the same elements, the first is kept.

    Raises
    ------
    InputError
        If the deck gives none.
    """
    s = (settings or CandidateSettings()).of(model)
    makers: dict[Kind, Callable[[Model, CandidateSettings], Iterator[Candidate]]] = {
        "material": lambda m, s: _fields(m, s, "material", MATERIALS),
        "property": lambda m, s: chain(
            _fields(m, s, "property", SECTIONS), _laminates(m, s), _outlines(m, s)
        ),
        "region": regions,
        "spring": lambda m, s: _grouped(m, s, "spring", SPRINGS),
        "mass": lambda m, s: _grouped(m, s, "mass", MASSES),
    }
    found: dict[object, Candidate] = {}
    for kind, make in makers.items():
        if kind in s.kinds:
            for c in make(model, s):
                found.setdefault(_effect(c), c)
    if not found:
        raise InputError(f"no candidate of the kinds {', '.join(s.kinds)} in the deck")
    return tuple(found.values())


def _effect(c: Candidate) -> object:
    """Equal for candidates that do the same."""
    fields = frozenset((t.card, t.id, t.field) for t in c.parameter.targets)
    return fields, c.parameter.substructures, c.elements


def _fields(
    model: Model, s: CandidateSettings, kind: Kind, catalogue: Catalogue
) -> Iterator[Candidate]:
    """One candidate a card and field."""
    for card, entries in catalogue.items():
        if card not in model:
            continue
        table = model[card]
        made = _made(model, card)
        for row, ident in enumerate(
            table.ids.tolist()
        ):  # over cards, of which a deck has hundreds, not elements
            rows = rows_of(model, CardField(card, ident, ""))
            if not rows or ident in made:
                continue
            for fields, word, quantity in entries:
                given = given_fields(table, row, fields)
                if given:
                    targets = [
                        CardField(card, ident, f) for f in given + _other_end(table, row, given)
                    ]
                    name = f"{card} {ident} {given[0]}"
                    what = (
                        f"{word} {amount(float(table[given[0]][row]), quantity, s)} of "
                        f"{counted(rows)}"
                    )
                    yield new_candidate(s, kind, name, what, quantity, ids_of(model, rows), targets)


def _other_end(table: Table, row: int, given: Sequence[str]) -> list[str]:
    """End B of a PBEAM where it differs from end A; where it does not, it follows by itself."""
    if table.card != "PBEAM":
        return []
    pairs = [(f, _ENDS[f]) for f in given if f in _ENDS]
    return [b for a, b in pairs if table[b][row] != table[a][row] and table[b][row] != 0]


def _laminates(model: Model, s: CandidateSettings) -> Iterator[Candidate]:
    """The thickness of all plies of a laminate, by one factor."""
    for card in ("PCOMP", "PCOMPG"):
        for row, ident in enumerate(model[card].ids.tolist() if card in model else []):
            rows = rows_of(model, CardField(card, ident, ""))
            if rows:
                t = model[card].ragged("T").row(row)
                targets = [CardField(card, ident, f"T{k + 1}") for k in range(t.size)]
                what = f"thickness of all {t.size} plies of {counted(rows)}"
                yield new_candidate(
                    s, "property", f"{card} {ident} T", what, "length", ids_of(model, rows), targets
                )


def _made(model: Model, card: str) -> set[int]:
    """Ids of the PBAR or PBEAM that the deck gives by the dimensions of a section (`_outlines`)."""
    return {
        i
        for source, made in MADE.items()
        if made == card and source in model
        for i in model[source].ids.tolist()
    }


def _outlines(model: Model, s: CandidateSettings) -> Iterator[Candidate]:
    """All dimensions of a section by one factor, each by itself where it stays a section, its
    non-structural mass.
    """
    for card in MADE:
        for row, ident in enumerate(model[card].ids.tolist() if card in model else []):
            table, rows = model[card], rows_of(model, CardField(card, ident, ""))
            if not rows:
                continue
            kind, where = table["TYPE"][row], ids_of(model, rows)
            ends = {
                name: table.ragged(name).row(row)
                for name in ("DIM", "DIMB")
                if name in table.columns
            }
            fields = [
                [f"{n}{k + 1}" for n, values in ends.items() if values.size]
                for k in range(ends["DIM"].size)
            ]
            of = f"of the {kind} section of {counted(rows)}"
            every = [CardField(card, ident, f) for one in fields for f in one]
            yield new_candidate(
                s,
                "property",
                f"{card} {ident} DIM",
                f"all dimensions {of}",
                "section",
                where,
                every,
            )
            for k, one in enumerate(fields if len(fields) > 1 else []):
                if all(_stays(kind, values.tolist(), k) for values in ends.values() if values.size):
                    what = f"dimension {k + 1} ({amount(float(ends['DIM'][k]), 'length', s)}) {of}"
                    alone = [CardField(card, ident, f) for f in one]
                    yield new_candidate(
                        s, "property", f"{card} {ident} DIM{k + 1}", what, "length", where, alone
                    )
            if given := given_fields(table, row, "NSM+NSMB"):
                value = amount(float(table[given[0]][row]), "line", s)
                what = f"non-structural mass {value} of {counted(rows)}"
                masses = [CardField(card, ident, f) for f in given]
                yield new_candidate(
                    s, "property", f"{card} {ident} {given[0]}", what, "line", where, masses
                )


def _stays(kind: str, dimensions: list[float], k: int) -> bool:
    """Whether the k-th dimension makes a section by itself at the bounds of its factor."""
    most = SPREAD["length"][1]
    try:
        for a in (1 / most, most):
            section(kind, [a * d if i == k else d for i, d in enumerate(dimensions)])
    except ValueError:
        return False
    return True


def _grouped(
    model: Model, s: CandidateSettings, kind: Kind, catalogue: Catalogue
) -> Iterator[Candidate]:
    """One candidate for all cards of equal value (one make of spring), and one for each card by
    itself.
    """
    for card, entries in catalogue.items():
        if card not in model:
            continue
        table = model[card]
        used = np.array(
            [bool(rows_of(model, CardField(card, i, ""))) for i in table.ids.tolist()], dtype=bool
        )
        for fields, word, quantity in entries:
            values = table[fields.split("+")[0]]
            live = np.flatnonzero(used & np.isfinite(values) & (values != 0))
            for group in _equal(values, live):
                members = [[at] for at in group.tolist()] if group.size > 1 else []
                for at in [group.tolist(), *members]:
                    yield _group(model, s, kind, table, np.array(at), fields, word, quantity)


def _equal(values: Float, live: Int) -> list[Int]:
    """Rows of `live` whose values are the same, in the order of the rows."""
    order = live[np.argsort(values[live], kind="stable")]
    v = values[order]
    cuts = np.flatnonzero(np.abs(np.diff(v)) > SAME * np.abs(v[1:])) + 1
    groups = [np.sort(g) for g in np.split(order, cuts) if g.size]
    return sorted(groups, key=lambda g: int(g[0]))


def _group(
    model: Model,
    s: CandidateSettings,
    kind: Kind,
    table: Table,
    at: Int,
    fields: str,
    word: str,
    quantity: str,
) -> Candidate:
    ids = table.ids[at]
    targets = [
        CardField(table.card, int(table.ids[r]), f)
        for r in at.tolist()
        for f in given_fields(table, r, fields)
    ]
    rows = union(rows_of(model, CardField(table.card, i, "")) for i in ids.tolist())
    lead = fields.split("+")[0]
    field_name = "K" if fields.startswith("K1+") else lead
    value = amount(float(table[lead][at[0]]), quantity, s)
    each = " each" if ids.size > 1 else ""
    name = f"{table.card} {listed(ids)} {field_name}"
    return new_candidate(
        s,
        kind,
        name,
        f"{word} {value}{each} of {counted(rows)}",
        quantity,
        ids_of(model, rows),
        targets,
    )
