"""Candidate parameters from the cards of a deck, by material, property and group of springs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.parameters import CardField, Parameter, Substructure
from ringtrue.errors import InputError
from ringtrue.fem.element_cards import ELEMENTS, MATERIAL, PROPERTY
from ringtrue.fem.mesh import union
from ringtrue.fem.parametrisation.changed_model import affected_cards, rows_of
from ringtrue.model.cards import MADE
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, Table, stacked, table
from ringtrue.model.references import REFERENCES, SHELL_PROPERTIES
from ringtrue.model.sections import section
from ringtrue.updating.selection.candidates import (
    MASSES,
    MATERIALS,
    PLACES,
    SECTIONS,
    SPREAD,
    SPRINGS,
    Candidate,
    CandidateSettings,
    Catalogue,
    Draft,
    Entry,
    Kind,
    amount,
    counted,
    given_fields,
    ids_of,
    listed,
)

_ENDS = {"A": "AB", "I1": "I1B", "I2": "I2B", "J": "JB", "NSM": "NSMB"}
_AIDS = ("G0", "SA", "SB")  # name a node, but do not stand on it
_NODE_FIELDS = {
    card: tuple(
        r.field
        for r in REFERENCES
        if r.card == card and "GRID" in r.of and r.field not in _AIDS
    )
    for card in ELEMENTS
}
NONE = 1e-7  # likewise: a bound must not be the nominal value
_FIELDS = ("M", "X1", "X2", "X3", "I11", "I21", "I22", "I31", "I32", "I33")


def generate(model: Model, settings: CandidateSettings) -> tuple[Candidate, ...]:
    """All candidates of a deck that an element uses, in the order material, property, region,
    spring, mass.

    Of two that are the same fields of the same elements, the first is kept.

    Raises
    ------
    InputError
        If the deck gives none.
    """
    s = settings.of(model)
    makers: dict[Kind, Callable[[Model, CandidateSettings], Iterator[Draft]]] = {
        "material": lambda m, s: _fields(m, s, "material", MATERIALS),
        "property": lambda m, s: chain(
            _fields(m, s, "property", SECTIONS), _laminates(m), _outlines(m, s)
        ),
        "region": regions,
        "spring": lambda m, s: _grouped(m, s, "spring", SPRINGS),
        "mass": lambda m, s: _grouped(m, s, "mass", MASSES),
    }
    found: dict[object, Candidate] = {}
    for kind, make in makers.items():
        if kind in s.kinds:
            for draft in make(model, s):
                c = draft.candidate()
                # equal for candidates that do the same
                fields = frozenset((t.card, t.id, t.field) for t in c.parameter.targets)
                effect = (fields, c.parameter.substructures, c.elements)
                found.setdefault(effect, c)
    if not found:
        raise InputError(f"no candidate of the kinds {', '.join(s.kinds)} in the deck")
    return tuple(found.values())


def _fields(
    model: Model, s: CandidateSettings, kind: Kind, catalogue: Catalogue
) -> Iterator[Draft]:
    """One candidate a card and field."""
    for card, entries in catalogue.items():
        if card not in model:
            continue
        table = model[card]
        made = _made(model, card)
        # over cards, of which a deck has hundreds, not elements
        for row, ident in enumerate(table.ids.tolist()):
            rows = rows_of(model, CardField(card, ident, ""))
            if not rows or ident in made:
                continue
            for fields, word, quantity in entries:
                given = given_fields(table, row, fields)
                if not given:
                    continue
                every = given + _other_end(table, row, given)
                targets = [CardField(card, ident, f) for f in every]
                name = f"{card} {ident} {given[0]}"
                value = amount(float(table[given[0]][row]), quantity, s)
                what = f"{word} {value} of {counted(rows)}"
                yield Draft(
                    kind,
                    name,
                    what,
                    quantity,
                    elements=ids_of(model, rows),
                    targets=targets,
                )


def _other_end(table: Table, row: int, given: Sequence[str]) -> list[str]:
    """End B of a PBEAM where it differs from end A; where it does not, it follows by itself."""
    if table.card != "PBEAM":
        return []
    pairs = [(f, _ENDS[f]) for f in given if f in _ENDS]
    return [
        b for a, b in pairs if table[b][row] != table[a][row] and table[b][row] != 0
    ]


def _laminates(model: Model) -> Iterator[Draft]:
    """The thickness of all plies of a laminate, by one factor."""
    for card in ("PCOMP", "PCOMPG"):
        for row, ident in enumerate(model[card].ids.tolist() if card in model else []):
            rows = rows_of(model, CardField(card, ident, ""))
            if rows:
                t = model[card].ragged("T").row(row)
                targets = [CardField(card, ident, f"T{k + 1}") for k in range(t.size)]
                what = f"thickness of all {t.size} plies of {counted(rows)}"
                name = f"{card} {ident} T"
                yield Draft(
                    "property",
                    name,
                    what,
                    "length",
                    elements=ids_of(model, rows),
                    targets=targets,
                )


def _made(model: Model, card: str) -> set[int]:
    """Ids of the PBAR or PBEAM that the deck gives by the dimensions of a section (`_outlines`)."""
    return {
        i
        for source, made in MADE.items()
        if made == card and source in model
        for i in model[source].ids.tolist()
    }


def _outlines(model: Model, s: CandidateSettings) -> Iterator[Draft]:
    """All dimensions of a section by one factor, each by itself where it stays a section, its
    non-structural mass.
    """
    for card in MADE:
        for row, ident in enumerate(model[card].ids.tolist() if card in model else []):
            table = model[card]
            rows = rows_of(model, CardField(card, ident, ""))
            if not rows:
                continue
            kind = table["TYPE"][row]
            where = ids_of(model, rows)
            given_ends = [n for n in ("DIM", "DIMB") if n in table.columns]
            ends = {n: table.ragged(n).row(row) for n in given_ends}
            ends = {n: values for n, values in ends.items() if values.size}
            fields = [[f"{n}{k + 1}" for n in ends] for k in range(ends["DIM"].size)]
            of = f"of the {kind} section of {counted(rows)}"
            every = [CardField(card, ident, f) for one in fields for f in one]
            name = f"{card} {ident}"
            yield Draft(
                "property",
                f"{name} DIM",
                f"all dimensions {of}",
                "section",
                elements=where,
                targets=every,
            )
            for k, one in enumerate(fields if len(fields) > 1 else []):
                if all(_stays(kind, values.tolist(), k) for values in ends.values()):
                    what = f"dimension {k + 1} ({amount(float(ends['DIM'][k]), 'length', s)}) {of}"
                    alone = [CardField(card, ident, f) for f in one]
                    yield Draft(
                        "property",
                        f"{name} DIM{k + 1}",
                        what,
                        "length",
                        elements=where,
                        targets=alone,
                    )
            if given := given_fields(table, row, "NSM+NSMB"):
                value = amount(float(table[given[0]][row]), "line", s)
                what = f"non-structural mass {value} of {counted(rows)}"
                masses = [CardField(card, ident, f) for f in given]
                yield Draft(
                    "property",
                    f"{name} {given[0]}",
                    what,
                    "line",
                    elements=where,
                    targets=masses,
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
) -> Iterator[Draft]:
    """One candidate for all cards of equal value (one make of spring), and one for each card by
    itself.
    """
    for card, entries in catalogue.items():
        if card not in model:
            continue
        table = model[card]
        used = np.array(
            [bool(rows_of(model, CardField(card, i, ""))) for i in table.ids.tolist()],
            dtype=bool,
        )
        for entry in entries:
            values = table[entry[0].split("+")[0]]
            live = np.flatnonzero(used & np.isfinite(values) & (values != 0))
            for group in _equal(values, live):
                members = [[at] for at in group.tolist()] if group.size > 1 else []
                for at in [group.tolist(), *members]:
                    yield _group(
                        model,
                        s,
                        kind=kind,
                        table=table,
                        at=np.array(at),
                        entry=entry,
                    )


def _equal(values: Float, live: Int) -> list[Int]:
    """Rows of `live` whose values are the same, in the order of the rows."""
    order = live[np.argsort(values[live], kind="stable")]
    v = values[order]
    # 1e-9: relative distance of values that are one
    cuts = np.flatnonzero(np.abs(np.diff(v)) > 1e-9 * np.abs(v[1:])) + 1
    groups = [np.sort(g) for g in np.split(order, cuts) if g.size]
    return sorted(groups, key=lambda g: int(g[0]))


def _group(
    model: Model, s: CandidateSettings, kind: Kind, table: Table, at: Int, entry: Entry
) -> Draft:
    fields, word, quantity = entry
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
    what = f"{word} {value}{each} of {counted(rows)}"
    return Draft(
        kind, name, what, quantity, elements=ids_of(model, rows), targets=targets
    )


def regions(model: Model, s: CandidateSettings) -> Iterator[Draft]:
    """The stiffness of each connected part of a property, and of pieces of it."""
    plates = [
        c for c in affected_cards(model) if PROPERTY.get(c) in ("PSHELL", "PSOLID")
    ]
    structural = ("CROD", "CTUBE", "CBAR", "CBEAM", *plates)
    cards = [c for c in dict.fromkeys(structural) if c in model]
    if not cards:
        return
    pid = np.concatenate([model[c]["PID"] for c in cards])
    eid = np.concatenate([model[c].ids for c in cards])
    family = np.concatenate([np.full(len(model[c]), PROPERTY[c]) for c in cards])
    nodes = connectivity(model, cards)
    centre = np.asarray(
        (nodes @ positions(model)) / np.maximum(nodes.sum(axis=1), 1)[:, None]
    )
    for key in sorted({(str(f), int(p)) for f, p in zip(family, pid, strict=True)}):
        of = np.flatnonzero((family == key[0]) & (pid == key[1]))
        parts = _islands(nodes[of])
        for k, part in enumerate(parts):
            whole = of[part]
            place = f" part {k + 1}" if len(parts) > 1 else ""
            # at most four pieces of about equal size, of two elements or more
            pieces = _cut(centre[whole], min(4, whole.size // 2))
            sets = [(place, whole)] if place else []
            if len(pieces) > 1:
                sets += [
                    (f"{place} piece {j + 1}", whole[p]) for j, p in enumerate(pieces)
                ]
            for label, at in sets:
                name = f"{_property(model, key)} {key[1]}{label}"
                yield _region(model, s, name, eid[at], centre[at].mean(axis=0))


def _property(model: Model, key: tuple[str, int]) -> str:
    """The card that holds a property id."""
    cards = SHELL_PROPERTIES if key[0] == "PSHELL" else (key[0],)
    return next(
        (c for c in cards if c in model and (model[c].ids == key[1]).any()), key[0]
    )


def connectivity(model: Model, cards: Sequence[str]) -> sparse.csr_array:
    """1 where an element (e) of the cards stands on a node (n), csr (e, n)."""
    grid = model["GRID"]
    parts = []
    for c in cards:
        ids = model[c].stack(*_NODE_FIELDS[c])
        node = grid.find(ids.ravel()).reshape(ids.shape)
        e, k = np.nonzero((ids > 0) & (node >= 0))
        entries = (np.ones(e.size), (e, node[e, k]))
        parts.append(sparse.coo_array(entries, shape=(len(ids), len(grid))))
    return sparse.csr_array(sparse.vstack(parts))


def _islands(nodes: sparse.csr_array) -> list[Int]:
    """Elements that hang together, in the order of their first."""
    _, label = sparse.csgraph.connected_components(
        sparse.csr_array(nodes @ nodes.T), directed=False
    )
    return [np.flatnonzero(label == k) for k in range(int(label.max(initial=-1)) + 1)]


def _cut(centre: Float, pieces: int) -> list[Int]:
    """Cut points (e, 3) again and again across their longest axis into parts of about equal
    number.
    """
    parts = [np.arange(len(centre))]
    while len(parts) < pieces:
        i = int(np.argmax([p.size for p in parts]))
        x = centre[parts[i]] - centre[parts[i]].mean(axis=0)
        _, _, axes = np.linalg.svd(x, full_matrices=False)
        axis = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
        order = parts[i][np.argsort(np.round(x @ axis, 9), kind="stable")]
        half = order.size // 2
        parts[i : i + 1] = [np.sort(order[:half]), np.sort(order[half:])]
    return parts


def _region(
    model: Model, s: CandidateSettings, label: str, elements: Int, centre: Float
) -> Draft:
    """Young's modulus as these elements see it; a factor on their stiffness where they are not
    isotropic.
    """
    place = ", ".join(f"{x:.3g}" for x in centre)
    what = f"stiffness of {elements.size} elements around ({place}) {s.unit('length')}".strip()
    ids = tuple(np.unique(elements).tolist())
    targets = []
    for mid in _isotropic(model, elements):
        row = int(model["MAT1"].find(np.array([mid]))[0])
        targets += [
            CardField("MAT1", mid, f, ids)
            for f in given_fields(model["MAT1"], row, "E+G")
        ]
    if targets:
        return Draft(
            "region", f"{label} E", what, "modulus", elements=elements, targets=targets
        )
    part = (Substructure("stiffness", ids),)
    return Draft(
        "region", f"{label} K", what, "modulus", elements=elements, substructures=part
    )


def _isotropic(model: Model, elements: Int) -> list[int]:
    """The MAT1 of the elements; none if one of them has another material."""
    found: set[int] = set()
    for card in affected_cards(model):
        if "PID" not in model[card].columns:
            continue
        pid = model[card]["PID"][np.isin(model[card].ids, elements)]
        prop = PROPERTY.get(card, "")
        if not pid.size:
            continue
        row = model[prop].find(pid) if prop in model else np.full(pid.size, -1)
        if (row < 0).any() or prop not in MATERIAL:
            return []
        mids = model[prop].stack(*MATERIAL[prop])[row]
        found |= set(mids[mids > 0].tolist())
    if "MAT1" not in model or not np.isin(list(found), model["MAT1"].ids).all():
        return []
    return sorted(found)


def places(model: Model, free: Bool, seen: Sequence[int] | Int) -> Int:
    """Nodes that cover the structure, ascending ids (k,): those that are seen, then the one
    farthest from all before.

    Parameters
    ----------
    free : (n,) bool
        Nodes that may move, in the order of GRID.
    seen : (k,) int64
        Ids of the nodes of sensors.
    """
    grid = model["GRID"]
    if (read := grid.file >= 0).any():
        free = free & read  # nodes that a refinement has made are in no file
    ids = grid.ids[free]
    xyz = positions(model)[free]
    first = np.flatnonzero(np.isin(ids, seen))[:PLACES]
    more = spread_out(xyz, PLACES - first.size, xyz[first])
    return np.sort(ids[np.concatenate([first, more])])


def spread_out(xyz: Float, most: int, taken: Float | None = None) -> Int:
    """Up to `most` points that cover all: each is the farthest from those before, rows (k,).

    Parameters
    ----------
    xyz : (n, 3) float64
    taken : (k, 3) float64, optional
        Points that come before the first; without any the first row is the first.
    """
    out: list[int] = []
    far = np.full(len(xyz), np.inf)
    for x in xyz[:0] if taken is None else taken:
        far = np.minimum(far, np.linalg.norm(xyz - x, axis=1))
    while len(out) < most and far.max(initial=0.0) > 0:
        out.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(xyz - xyz[out[-1]], axis=1))
    return np.array(out, dtype=np.int64)


def lumped(
    model: Model, nodes: Int, total: float, settings: CandidateSettings
) -> tuple[Model, tuple[Candidate, ...]]:
    """A copy with a CONM2 of no mass at each node, and what is missing there as candidates.

    Parameters
    ----------
    nodes : (k,) int64
        Ids.
    total : float
        Mass of the structure as a CONM2 states it: PARAM,WTMASS is not applied.
    """
    first = 1 + max(
        (
            int(t.ids.max(initial=0))
            for t in model.tables.values()
            if "EID" in t.columns
        ),
        default=0,
    )
    ids = np.arange(first, first + nodes.size)
    frames = np.zeros(nodes.size, dtype=np.int64)
    made = table(
        "CONM2",
        EID=ids,
        G=nodes,
        CID=frames,
        **dict.fromkeys(_FIELDS, np.zeros(nodes.size)),
    )
    whole = stacked(model["CONM2"], made) if "CONM2" in model else made
    at = positions(model)[model["GRID"].find(nodes)].tolist()
    every = zip(ids.tolist(), nodes.tolist(), at, strict=True)
    found = tuple(_lump(eid, node, x, total, settings) for eid, node, x in every)
    return replace(model, tables={**model.tables, "CONM2": whole}), found


def _lump(
    eid: int, node: int, x: Sequence[float], total: float, s: CandidateSettings
) -> Candidate:
    target = CardField("CONM2", eid, "M", (), total)
    p = Parameter(
        name=f"mass missing at {node}",
        targets=(target,),
        lower=1 - NONE,
        upper=1 + 0.4,
        scale="linear",
        std=0.05,  # of the mass of the structure: prior standard deviation, bound
    )
    unit = f" [{s.unit('mass')}]" if s.unit("mass") else ""
    place = f"({', '.join(f'{v:.3g}' for v in x)}) {s.unit('length')}".strip()
    return Candidate(
        p, "lump", f"a mass{unit} around {place} that the deck does not have", (eid,)
    )
