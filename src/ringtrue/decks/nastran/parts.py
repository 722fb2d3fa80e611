"""A deck whose superelements have bulk data of their own (BEGIN SUPER) as one model: parts joined
at their boundary points, numbers that several parts have made different.

A point keeps its number where no other part has it; else all numbers of its kind in that part get
those of the superelement before them: with a step of 1000, 2006 is 6 of superelement 2 (MSC Nastran
Superelements User's Guide, part superelements).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.decks.nastran.external import matrices_of_op4
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.cards import NONSTRUCTURAL
from ringtrue.model.case_control import (
    CONSTRAINTS,
    KEPT,
    METHODS,
    MODAL,
    OMITTED,
    component_modes,
    taken_sets,
)
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import (
    Model,
    Ragged,
    Superelement,
    Table,
    card_error,
    refuse_rows,
    stacked,
)
from ringtrue.model.references import FRAMES, NODES, REFERENCES

log = logging.getLogger(__name__)
# PARAM that make matrices, and what they are where they are not given: all sections must agree
_OF_MATRICES = {
    "WTMASS": 1.0,
    "COUPMASS": -1.0,
    "K6ROT": 100.0,
    "G": 0.0,
    "ALPHA1": 0.0,
    "ALPHA2": 0.0,
    "RESBEND": 1.0,
    "SNORM": 20.0,
}
# commands that add matrices, and the matrices that EXTSEOUT writes
_EXTERNAL = (("k2gg", "KAAX"), ("m2gg", "MAAX"), ("b2gg", "BAAX"))
# types of superelements that are read, and what to do with others
_READ = ("PRIMARY", "EXTERNAL", "EXTOP4")
_OUTPUT2 = (
    "its matrices are in an OUTPUT2 file, which is not read: run EXTSEOUT with MATOP4=n and write "
    "EXTOP4, or with DMIGPCH and write EXTERNAL"
)
_COPY = (
    "copies are not made: write it out with BEGIN SUPER=n, its points where they are and numbers "
    "of its own"
)
_OTHERS = {
    "EXTOP2": _OUTPUT2,
    "FRFOP2": _OUTPUT2,
    "REPEAT": _COPY,
    "MIRROR": _COPY,
    "COLLCTR": "it has no elements: leave it out, its parts are joined without it",
}
_BY_NUMBER = ("CWELD", "CFAST")  # they name properties or elements by other fields

Numbers = Mapping[int, int]  # new ones by old ones, of those that change


@dataclass(frozen=True, slots=True, eq=False)
class BulkSection:
    """The residual structure (number 0) or a part, as its own bulk data and case control make it.

    Attributes
    ----------
    number : int
    model : Model
    """

    number: int
    model: Model

    @property
    def points(self) -> Int:
        """Ids of GRID, then of SPOINT."""
        made = [np.empty(0, dtype=np.int64)]
        made += [self.model[c].entries("ID")[0] for c in NODES if c in self.model]
        return np.concatenate(made)

    @property
    def elements(self) -> Int:
        """EID of all elements."""
        tables = [t for t in self.model.tables.values() if kind_of(t.card) == "element"]
        return np.concatenate([np.empty(0, dtype=np.int64), *(t.ids for t in tables)])


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """The parts as one model.

    Attributes
    ----------
    model : Model
    numbers : mapping of int to mapping of str to Numbers
        New numbers by superelement and kind (point, frame, element, property, material).
    """

    model: Model
    numbers: Mapping[int, Mapping[str, Numbers]]


def kind_of(card: str) -> str:
    """What the numbers of a card count: point, frame, element, property, material or nothing."""
    if card in NODES:
        return "point"
    if card in FRAMES:
        return "frame"
    if card.startswith("MAT"):
        return "material"
    if card.startswith("P"):
        return "property"
    rigid = card.startswith("R") or card == "GENEL"
    return "element" if card.startswith("C") or rigid else ""


def joined(sections: Sequence[BulkSection], op4: Mapping[int, Path]) -> Joined:
    """The residual structure, which comes first, and its parts as one model.

    Parameters
    ----------
    sections : sequence of BulkSection
    op4 : mapping of int to Path
        OUTPUT4 files of external superelements by their units.

    Raises
    ------
    DeckError
        If joined points lie at different places or move in different frames, or a PARAM differs.
    UnsupportedCard
        On a kind of superelement that is not read.
    """
    residual = sections[0].model
    kinds = _kinds(sections)
    sections = [_with_matrices(s, kinds.get(s.number), op4) for s in sections]
    at = _joints(sections, kinds)
    numbers = _numbers(sections, at)
    made = [_renumbered(s, numbers[s.number]) for s in sections]
    _refuse_distant(sections, made, kinds)
    common = {}
    for kind in CONSTRAINTS:
        most = max(int(taken_sets(s.model, kind).max(initial=0)) for s in made)
        common[kind] = int(getattr(residual.case, kind.lower())) or most
    tables: dict[str, Table] = {}
    for section in made:
        for name, table in _own_tables(section, common).items():
            tables[name] = stacked(tables[name], table) if name in tables else table
    tables |= _points(made, kinds)
    if "DMIG" in tables:
        tables["DMIG"] = tables["DMIG"].with_column(
            "ID", np.arange(1, len(tables["DMIG"]) + 1)
        )
    stiffness, mass, damping = (_matrices(sections, kinds, *of) for of in _EXTERNAL)
    case = replace(
        residual.case,
        spc=common["SPC"],
        mpc=common["MPC"],
        k2gg=stiffness,
        m2gg=mass,
        b2gg=damping,
    )
    kept: dict[str, int] = {}
    for section in sections:
        for name, n in section.model.kept.items():
            kept[name] = kept.get(name, 0) + n
    model = Model(
        tables,
        _params(sections),
        case,
        residual.files,
        kept,
        superelements=tuple(_superelement(s, made) for s in made[1:]),
    )
    return Joined(model, numbers)


@dataclass(frozen=True, slots=True)
class _PartKind:
    """How a part is joined (SEBULK)."""

    kind: str = "PRIMARY"
    automatic: bool = True
    tolerance: float = 1e-5
    unit: int = 0

    @property
    def external(self) -> bool:
        """Whether it is its matrices."""
        return self.kind != "PRIMARY"


def _kinds(sections: Sequence[BulkSection]) -> dict[int, _PartKind]:
    """Of each part; without a SEBULK a part is PRIMARY and joined where points coincide."""
    residual = sections[0].model
    out = {s.number: _PartKind() for s in sections[1:]}
    if "SEBULK" not in residual:
        return out
    table = residual["SEBULK"]
    for row, number in enumerate(table.ids.tolist()):
        path, line = residual.place(table, row)
        kind = str(table["TYPE"][row])
        method = str(table["METHOD"][row])
        if kind not in ("", *_READ):
            what = _OTHERS.get(kind, f"{', '.join(_READ)} are read")
            why = f"TYPE {kind} of superelement {number}: {what}"
            raise UnsupportedCard("SEBULK", path=path, line=line, why=why)
        if number not in out:
            why = f"superelement {number} has no BEGIN SUPER={number}: its matrices stand elsewhere"
            raise UnsupportedCard("SEBULK", path=path, line=line, why=why)
        tolerance = float(table["TOL"][row])
        unit = int(table["UNITNO"][row])
        out[number] = _PartKind(kind or "PRIMARY", method == "AUTO", tolerance, unit)
    return out


def _with_matrices(
    section: BulkSection, kind: _PartKind | None, op4: Mapping[int, Path]
) -> BulkSection:
    """An external superelement with its matrices as DMIG.

    Raises
    ------
    DeckError
        If they are neither in its bulk data nor in a file.
    """
    model = section.model
    if kind is None or not kind.external or "DMIG" in model:
        return section
    where = model.files[0]
    if kind.kind == "EXTERNAL":
        raise DeckError(
            f"superelement {section.number} is EXTERNAL, and its bulk data hold no DMIG: INCLUDE "
            "the punch file of EXTSEOUT(EXTBULK, DMIGPCH) behind BEGIN SUPER",
            path=where,
        )
    if kind.unit not in op4:
        raise DeckError(
            f"superelement {section.number} is in OUTPUT4 unit {kind.unit}: name its file above "
            f"SOL, as in ASSIGN INPUTT4='part.op4', UNIT={kind.unit}",
            path=where,
        )
    matrices = matrices_of_op4(model, op4[kind.unit])
    return BulkSection(
        section.number, replace(model, tables={**model.tables, "DMIG": matrices})
    )


def _joints(
    sections: Sequence[BulkSection], kinds: Mapping[int, _PartKind]
) -> list[Int]:
    """Which joint each point of each section belongs to: points of one number are one point."""
    first = np.cumsum([0, *(s.points.size for s in sections)])
    place = {s.number: i for i, s in enumerate(sections)}
    pairs = [np.empty((0, 2), dtype=np.int64)]
    table = sections[0].model.tables.get("SECONCT")
    for row in range(len(table) if table else 0):
        assert table is not None
        ends = []
        for side in "AB":
            number = int(table[f"SEID{side}"][row])
            if number not in place:
                raise card_error(
                    sections[0].model, table, row, f"there is no superelement {number}"
                )
            points = sections[place[number]].points
            ids = table.ragged(f"GID{side}").row(row)
            order = np.argsort(points)
            found = order[
                np.searchsorted(points, ids, sorter=order).clip(max=points.size - 1)
            ]
            if (lost := points[found] != ids).any():
                why = f"superelement {number} has no point {ids[lost][0]}"
                raise card_error(sections[0].model, table, row, why)
            ends.append(first[place[number]] + found)
        pairs.append(np.stack(ends, axis=1))
    for number, kind in kinds.items():
        if kind.automatic and "GRID" in sections[place[number]].model:
            pairs += _coincident(sections, place[number], first, kinds)
    edges = np.concatenate(pairs)
    graph = sparse.coo_array(
        (np.ones(len(edges)), edges.T), shape=(first[-1], first[-1])
    )
    label = connected_components(graph, directed=False)[1].astype(np.int64)
    return np.split(label, first[1:-1])


def _coincident(
    sections: Sequence[BulkSection],
    part: int,
    first: Int,
    kinds: Mapping[int, _PartKind],
) -> list[Int]:
    """Pairs of points of a part and those of other sections at the same place."""
    mine = KDTree(positions(sections[part].model))
    tolerance = kinds[sections[part].number].tolerance
    out = []
    for other, section in enumerate(sections):
        manual = section.number and not kinds[section.number].automatic
        if other == part or manual or "GRID" not in section.model:
            continue
        theirs = KDTree(positions(section.model))
        near = mine.sparse_distance_matrix(theirs, tolerance, output_type="ndarray")
        out.append(
            np.stack([first[part] + near["i"], first[other] + near["j"]], axis=1)
        )
    return out


def _numbers(
    sections: Sequence[BulkSection], joints: Sequence[Int]
) -> dict[int, dict[str, Numbers]]:
    """New numbers of what is joined, and of all of a kind where another section has one of them."""
    _refuse_twice(sections, joints)
    every = [t.ids.max(initial=0) for s in sections for t in _numbered(s.model)]
    top = max([*every, *(int(s.points.max(initial=0)) for s in sections)])
    step = 1000
    while step <= top:
        step *= 10
    out: dict[int, dict[str, Numbers]] = {}
    used: dict[str, set[int]] = {}
    place: dict[int, int] = {}  # the number of each joint
    for section, joint in zip(sections, joints, strict=True):
        shift = step * section.number
        ids = {"point": section.points.tolist()}
        for table in _numbered(section.model):
            ids.setdefault(kind_of(table.card), []).extend(table.ids.tolist())
        new = [
            p
            for p, j in zip(ids["point"], joint.tolist(), strict=True)
            if j not in place
        ]
        maps: dict[str, Numbers] = {}
        moved = []
        for kind, numbers in ids.items():
            known = used.setdefault(kind, set())
            clash = not known.isdisjoint(new if kind == "point" else numbers)
            move = shift if clash else 0
            moved += [kind] * clash
            if kind == "point":
                pairs = zip(numbers, joint.tolist(), strict=True)
                found = {p: place.setdefault(j, p + move) for p, j in pairs}
            else:
                found = {i: i + move for i in numbers}
            known |= set(found.values())
            maps[kind] = {a: b for a, b in found.items() if a != b}
        out[section.number] = maps
        if section.number and moved:
            log.info(
                "superelement %d: %d is added to the numbers of each %s, as others have them, too",
                section.number,
                shift,
                ", ".join(moved),
            )
    return out


def _refuse_twice(sections: Sequence[BulkSection], joints: Sequence[Int]) -> None:
    """Refuse a joint of two points of one section."""
    for section, joint in zip(sections, joints, strict=True):
        label, count = np.unique(joint, return_counts=True)
        if (count > 1).any():
            twice = np.flatnonzero(joint == label[count > 1][0])[:2]
            a, b = section.points[twice].tolist()
            raise DeckError(
                f"points {a} and {b} of superelement {section.number} are joined to the same "
                "point: name the boundary by SECONCT, with MANUAL on the SEBULK",
                path=sections[0].model.files[0],
                card="SECONCT",
            )


def _numbered(model: Model) -> list[Table]:
    """Tables whose rows have a number of a kind, points aside."""
    return [t for t in model.tables.values() if kind_of(t.card) not in ("", "point")]


def changed_numbers(ids: Any_, numbers: Numbers) -> Any_:
    """Ids (...) with those that change replaced."""
    if not numbers:
        return ids
    old = np.array(sorted(numbers), dtype=np.int64)
    new = np.array([numbers[i] for i in old.tolist()], dtype=np.int64)
    at = np.searchsorted(old, ids).clip(max=old.size - 1)
    return np.where(old[at] == ids, new[at], ids)


def _renumbered(section: BulkSection, numbers: Mapping[str, Numbers]) -> BulkSection:
    """The section with its new numbers."""
    if not any(numbers.values()):
        return section
    model = section.model
    tables = dict(model.tables)
    others = {
        kind: new
        for kind, new in numbers.items()
        if kind in ("element", "property") and new
    }
    if others and (named := [card for card in _BY_NUMBER if card in model]):
        why = (
            f"superelement {section.number} numbers elements or properties as another part does, "
            "and this card names them: give them numbers of their own"
        )
        path, line = model.place(model[named[0]], 0)
        raise UnsupportedCard(named[0], path=path, line=line, why=why)
    for name, table in model.tables.items():
        if new := numbers.get(kind_of(name)):
            tables[name] = _changed(table, next(iter(table.columns)), new)
    for ref in REFERENCES:
        new = numbers.get(kind_of(ref.of[0]))
        if ref.card in tables and new:
            tables[ref.card] = _changed(tables[ref.card], ref.field, new)
    return BulkSection(section.number, replace(model, tables=tables))


def _changed(table: Table, name: str, numbers: Numbers) -> Table:
    column = table.columns[name]
    made: Any_ | Ragged
    if isinstance(column, Ragged):
        made = Ragged(changed_numbers(column.values, numbers), column.offsets)
    else:
        made = changed_numbers(column, numbers)
    return replace(table, columns={**table.columns, name: made})


def _refuse_distant(
    given: Sequence[BulkSection],
    made: Sequence[BulkSection],
    kinds: Mapping[int, _PartKind],
) -> None:
    """Refuse joined points that do not lie at one place, or whose displacement frames differ."""
    first: dict[int, tuple[int, Float, Float]] = {}
    tolerance = {0: 0.0, **{n: k.tolerance for n, k in kinds.items()}}
    table = given[0].model.tables.get("SECONCT")
    if table is not None:
        for number, tol in zip(
            table["SEIDA"].tolist(), table["TOL"].tolist(), strict=True
        ):
            tolerance[number] = max(tolerance[number], tol)
    grids = [s.model["GRID"].ids for s in made if "GRID" in s.model]
    ids, count = np.unique(
        np.concatenate([np.empty(0, dtype=np.int64), *grids]), return_counts=True
    )
    for before, section in zip(given, made, strict=True):
        if "GRID" not in before.model:
            continue
        grid = before.model["GRID"]
        new = section.model["GRID"].ids
        rows = np.flatnonzero(np.isin(new, ids[count > 1]))
        xyz = positions(before.model)[rows]
        cd = axes(before.model, grid["CD"][rows], xyz)
        # of the boundary
        for row, x, frame in zip(rows.tolist(), xyz, cd, strict=True):
            mine = (section.number, x, frame)
            other, x0, frame0 = first.setdefault(int(new[row]), mine)
            where = f"it is joined to a point of superelement {other}"
            distance = float(np.linalg.norm(x - x0))
            if distance > tolerance[section.number]:
                why = (
                    f"{where} that lies {distance:.3g} away: give the part in the coordinates of "
                    "the whole (SELOC is not read), or raise TOL of SEBULK or SECONCT"
                )
                raise card_error(before.model, grid, row, why)
            if np.abs(frame - frame0).max() > 1e-6:  # of unit vectors
                why = f"{where} that moves in another frame: give both the same CD"
                raise card_error(before.model, grid, row, why)


def _own_tables(section: BulkSection, common: Mapping[str, int]) -> dict[str, Table]:
    """Tables of a section but for points: constraints of the sets that count, matrices by names of
    their own.
    """
    model = section.model
    mass = [card for card in NONSTRUCTURAL if card in model]
    if section.number and mass:
        path, line = model.place(model[mass[0]], 0)
        why = (
            f"lists of non-structural mass in superelement {section.number}: give "
            "NSM of properties"
        )
        raise UnsupportedCard(mass[0], path=path, line=line, why=why)
    gone = {*NODES, "SEBULK", "SECONCT", "EXTRN"}
    if section.number:
        gone |= {*KEPT, *OMITTED, *MODAL, *METHODS}
    tables = {n: t for n, t in model.tables.items() if n not in gone}
    for kind, (add, cards) in CONSTRAINTS.items():
        tables.pop(add, None)
        taken = taken_sets(model, kind)
        for card in (c for c in cards if c in tables):
            rows = np.flatnonzero(np.isin(tables[card]["SID"], taken))
            kept = tables[card].take(rows)
            tables[card] = kept.with_column("SID", np.full(rows.size, common[kind]))
    if section.number and "DMIG" in tables:
        names = [
            _named(name, section.number) for name in tables["DMIG"]["NAME"].tolist()
        ]
        tables["DMIG"] = tables["DMIG"].with_column("NAME", np.array(names))
    return {name: table for name, table in tables.items() if len(table)}


def _named(matrix: str, number: int) -> str:
    """A matrix of a part, by a name that no other part has."""
    return f"{matrix.upper()}@{number}"


def _points(
    made: Sequence[BulkSection], kinds: Mapping[int, _PartKind]
) -> dict[str, Table]:
    """GRID and SPOINT, joined ones once: of the section that comes first, held as in any of them.

    SEID is the part that a point is in the interior of.
    """
    grids = []
    for section in (s for s in made if "GRID" in s.model):
        grid = section.model["GRID"]
        if section.number:
            inside = 0 if kinds[section.number].external else section.number
            grid = grid.with_column("SEID", np.full(len(grid), inside))
        grids.append(grid)
    if not grids:
        raise DeckError("the deck has no GRID", path=made[0].model.files[0])
    table = grids[0]
    for more in grids[1:]:
        table = stacked(table, more)
    _, first, which = np.unique(table.ids, return_index=True, return_inverse=True)
    held = table["PS"].astype("U6")
    seid = table["SEID"].copy()
    # the joined ones
    for row in np.flatnonzero(first[which] != np.arange(which.size)).tolist():
        keeper = first[which[row]]
        held[keeper] = "".join(sorted({*held[keeper], *held[row]}))
        seid[keeper] = 0
    table = table.with_column("PS", held).with_column("SEID", seid).take(np.sort(first))
    out = {"GRID": table}
    scalars = [s.model["SPOINT"] for s in made if "SPOINT" in s.model]
    if scalars:
        ids = np.unique(np.concatenate([t.ragged("ID").values for t in scalars]))
        points = Ragged(ids, np.array([0, ids.size]))
        one = np.array([0])
        out["SPOINT"] = replace(scalars[0].take(one), columns={"ID": points})
    return out


def _matrices(
    sections: Sequence[BulkSection],
    kinds: Mapping[int, _PartKind],
    command: str,
    written: str,
) -> tuple[tuple[float, str], ...]:
    """The terms of K2GG or its like: those that case control takes, and that of each external
    superelement.
    """
    terms = []
    taken = set()
    for section in sections[1:]:
        if "DMIG" not in section.model:
            continue
        have = np.char.upper(section.model["DMIG"]["NAME"].astype(str)).tolist()
        own = [
            (f, name)
            for f, name in getattr(section.model.case, command)
            if name in have
        ]
        if kinds[section.number].external and not own:
            suffixed = f"{written[0]}{section.number}"  # DMIGSFIX=EXTID
            own = [(1.0, name) for name in (written, suffixed) if name in have]
            if not own and command == "k2gg":
                raise DeckError(
                    f"superelement {section.number} holds {', '.join(have)}: name its stiffness "
                    f"{written}, or by K2GG in a subcase with SUPER = {section.number}",
                    path=section.model.files[0],
                    card="DMIG",
                )
        terms += [(factor, _named(name, section.number)) for factor, name in own]
        taken |= {name for _, name in own}
    # a command above all subcases holds for the matrices of each part, too
    table = sections[0].model.tables.get("DMIG")
    mine = np.char.upper(table["NAME"].astype(str)).tolist() if table else []
    asked = getattr(sections[0].model.case, command)
    return (
        *((f, name) for f, name in asked if name in mine or name not in taken),
        *terms,
    )


def _params(sections: Sequence[BulkSection]) -> dict[str, int | float | str]:
    """PARAM of the residual structure; those that make matrices must be those of all sections with
    elements.
    """
    out = dict(sections[0].model.params)
    with_mesh = [s for s in sections if s.elements.size]
    for name, default in _OF_MATRICES.items():
        values = {s.number: s.model.param(name, default) for s in with_mesh}
        if len(set(values.values())) > 1:
            found = ", ".join(
                f"{value:g} in superelement {n}" for n, value in values.items()
            )
            raise DeckError(
                f"PARAM,{name} is {found}: give all the same",
                path=sections[0].model.files[0],
                card="PARAM",
            )
        given = [s.model.params[name] for s in with_mesh if name in s.model.params]
        if given:
            out[name] = given[0]
        elif values:
            out.pop(name, None)
    return out


def _superelement(section: BulkSection, made: Sequence[BulkSection]) -> Superelement:
    """What a part is in the joined model."""
    model = section.model
    modes = component_modes(model)
    elsewhere = np.concatenate([s.points for s in made if s is not section])
    for card in (c for c in KEPT if c in model):
        points, row = model[card].entries("ID")
        inside = ~np.isin(points, elsewhere) & ~np.isin(points, modes.modal.node)
        why = f"it keeps an interior point of superelement {section.number}: join it by SECONCT"
        refuse_rows(model, model[card], row[inside & (section.elements.size > 0)], why)
    return Superelement(section.number, section.elements, modes)
