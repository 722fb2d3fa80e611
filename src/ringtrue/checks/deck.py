"""Checks of a deck before anything is computed with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ringtrue.checks import Finding, at_rows
from ringtrue.checks.elements import (
    check_geometry,
    double_findings,
    edge_findings,
    hinge_findings,
    stiff_findings,
)
from ringtrue.checks.mass import body_findings, wide_findings
from ringtrue.checks.materials import check_materials, check_units
from ringtrue.core.arrays import Int
from ringtrue.decks.nastran.case import empty_choices
from ringtrue.model.cards import TABLES, columns
from ringtrue.model.case_control import CONSTRAINTS, idle, left_out, untaken_matrices
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model, Ragged
from ringtrue.model.references import FRAMES, NODES, REFERENCES, missing, unused

NEAR = 1e-6  # of the model's size: closer nodes are coincident
_NOT_ELEMENTS = frozenset(("GRID", "SPC", "SPC1"))


@dataclass(frozen=True, slots=True)
class DeckReport:
    """What a deck holds and what is wrong with it.

    Attributes
    ----------
    cards : mapping of str to int
        Cards that are used, by name.
    kept : mapping of str to int
        Cards that are kept in the deck but not used.
    findings : tuple of Finding
        Errors first, then warnings, then remarks.
    """

    cards: Mapping[str, int]
    kept: Mapping[str, int]
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """No error."""
        return all(f.severity != "error" for f in self.findings)


def check_deck(model: Model, units: str = "") -> DeckReport:
    """Check connections, shapes, coincidence, leftovers and units of a model.

    Parameters
    ----------
    units : str
        The unit system that the deck is said to be in, "" if unknown; see `checks.materials`.

    Raises
    ------
    InputError
        If the unit system is not known.
    """
    checks = [*_missing(model), *_unconnected(model), *_shared_numbers(model)]
    if not _lost_frames(model):
        checks += [
            *check_geometry(model),
            *_coincident(model),
            *check_units(model, units),
            *hinge_findings(model),
        ]
        checks += [*wide_findings(model), *stiff_findings(model)]
    checks += [*_unused(model), *_unchosen(model), *_lost_sets(model), *unapplied(model)]
    checks += [
        *check_materials(model),
        *body_findings(model),
        *edge_findings(model),
        *double_findings(model),
    ]
    order = {"error": 0, "warning": 1, "info": 2}
    found = tuple(sorted(checks, key=lambda f: order[f.severity]))
    return DeckReport({n: len(t) for n, t in model.tables.items()}, dict(model.kept), found)


def _lost_frames(model: Model) -> bool:
    """Whether positions are unknown: a frame is not there, or a node that defines one."""
    references = [lost.reference for lost in missing(model)]
    return any(r.of == FRAMES or r.card in FRAMES for r in references)


def _missing(model: Model) -> Iterator[Finding]:
    out = idle(model)
    for lost in missing(model):
        ref = lost.reference
        harmless = np.isin(lost.rows, out.get(ref.card, ())).all()
        what = f"{ref.field} names {ref.names} {lost.ids[0]}: not there"
        yield at_rows(
            model, ref.card, np.unique(lost.rows), "warning" if harmless else "error", what
        )


def _used_nodes(model: Model) -> Int:
    """Ids of the nodes that an element, mass, rigid element, MPC or frame names, (n,) int64."""
    used = [np.empty(0, dtype=np.int64)]
    for ref in REFERENCES:
        if ref.of == NODES and ref.card in model and ref.card not in _NOT_ELEMENTS:
            column = model[ref.card].columns[ref.field]
            used.append(column.values if isinstance(column, Ragged) else column)
    return np.unique(np.concatenate(used))


def _unconnected(model: Model) -> list[Finding]:
    if "GRID" not in model:
        return [Finding("error", "the deck has no GRID")]
    rows = np.flatnonzero(~np.isin(model["GRID"].ids, _used_nodes(model)))
    return (
        [at_rows(model, "GRID", rows, "warning", "no element is connected to it")]
        if rows.size
        else []
    )


def _shared_numbers(model: Model) -> Iterator[Finding]:
    """Elements whose number one of another card has, too."""
    cards = sorted(c for c, t in model.tables.items() if len(t) and columns(c)[0].name == "EID")
    for i, card in enumerate(cards):
        for other in cards[:i]:
            if (rows := np.flatnonzero(np.isin(model[card].ids, model[other].ids))).size:
                text = (
                    f"{other} has the same number; Nastran wants numbers of elements to be unique"
                )
                yield at_rows(model, card, rows, "warning", text)


def _groups(model: Model) -> Iterator[tuple[Int, Int]]:
    """Node ids with the number of the element or constraint that joins them, card by card."""
    by_card: dict[str, list[str]] = {}
    for ref in REFERENCES:
        if (
            ref.of == NODES
            and ref.card in model
            and ref.card not in _NOT_ELEMENTS
            and ref.field != "G0"
        ):
            by_card.setdefault(ref.card, []).append(ref.field)
    for card, names in by_card.items():
        table, ids, owner = model[card], [], []
        for name in names:
            column = table.columns[name]
            ragged = isinstance(column, Ragged)
            ids.append(column.values if isinstance(column, Ragged) else column)
            count = column.sizes if isinstance(column, Ragged) else 1
            owner.append(
                np.repeat(np.arange(len(table)), count) if ragged else np.arange(len(table))
            )
        yield np.concatenate(ids), np.concatenate(owner)


def _coincident(model: Model) -> list[Finding]:
    """Pairs of nodes at one place that no element or constraint joins."""
    if "GRID" not in model or len(model["GRID"]) < 2:
        return []
    grid, xyz = model["GRID"], positions(model)
    used = np.flatnonzero(np.isin(grid.ids, _used_nodes(model)))
    size = diagonal(xyz)
    pairs = KDTree(xyz[used]).query_pairs(NEAR * size, output_type="ndarray").astype(np.int64)
    if not len(pairs):
        return []
    pairs = used[pairs]
    free = pairs[~_joined(model, grid.ids[pairs])]
    if not len(free):
        return []
    free = free[np.lexsort((free[:, 1], free[:, 0]))]
    names = ", ".join(f"{a} and {b}" for a, b in grid.ids[free[:5]].tolist())
    what = (
        "at one place with another node that nothing joins it to: "
        f"{names}{', ...' if len(free) > 5 else ''}"
    )
    return [at_rows(model, "GRID", np.unique(free[:, 0]), "warning", what)]


def _joined(model: Model, pairs: Int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which pairs of node ids (n, 2) are nodes of one element or constraint, also by way of others
    of them, (n,).
    """
    wanted, at = np.unique(pairs, return_inverse=True)
    at = at.reshape(-1, 2)
    joined: set[tuple[int, int]] = set()
    for ids, owner in _groups(model):
        keep = np.isin(ids, wanted)
        members: dict[int, set[int]] = {}
        for o, i in zip(
            owner[keep].tolist(), np.searchsorted(wanted, ids[keep]).tolist(), strict=True
        ):
            members.setdefault(i, set()).add(o)
        # over the few coincident pairs
        joined.update(
            (a, b) for a, b in at.tolist() if members.get(a, set()) & members.get(b, set())
        )
    edges = np.array(sorted(joined), dtype=np.int64).reshape(-1, 2)
    graph = sparse.coo_array(
        (np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(wanted.size, wanted.size)
    )
    label = connected_components(graph, directed=False)[1]
    return np.asarray(label[at[:, 0]] == label[at[:, 1]])


def _unchosen(model: Model) -> Iterator[Finding]:
    """Supports and equations of a deck whose case control takes none of them, and subcases that are
    not taken.
    """
    if model.case.others:
        numbers = ", ".join(map(str, model.case.others))
        yield Finding(
            "warning",
            f"SUBCASE {numbers}: not taken; the modes are those of the first subcase with a METHOD",
        )
    yield from (
        Finding("warning", f"case control asks for {text}") for text in empty_choices(model)
    )
    for name, (_, cards) in CONSTRAINTS.items():
        chosen = getattr(model.case, name.lower())
        for card in cards:
            if not chosen and card in model and len(model[card]):
                rows = np.arange(len(model[card]))
                yield at_rows(
                    model,
                    card,
                    rows,
                    "warning",
                    f"it holds nothing: case control chooses no {name}",
                )


def _lost_sets(model: Model) -> Iterator[Finding]:
    """SPCADD and MPCADD of sets that are not in the deck."""
    for add, cards in CONSTRAINTS.values():
        if add in model:
            there = np.concatenate(
                [np.empty(0, dtype=np.int64), *(model[c].ids for c in cards if c in model)]
            )
            rows = _naming_none(model[add].ragged("S"), there)
            if rows.size:
                yield at_rows(model, add, rows, "warning", "it names a set that is not in the deck")


def _naming_none(sets: Ragged, there: Int) -> Int:
    return np.unique(sets.owner[~np.isin(sets.values, there)])


def _unused(model: Model) -> list[Finding]:
    return [
        at_rows(model, card, rows, "info", "nothing uses it")
        for card, rows in sorted(unused(model).items())
    ]


_WHOLE = "kept, not applied: the modes here are those of the full model, not of the condensed one"
_KEPT = (  # cards that are kept and what becomes of them
    (("ASET", "ASET1", "OMIT", "OMIT1"), _WHOLE),
    (
        TABLES,
        "kept, not applied: the nominal stiffness and damping hold at all frequencies, as in SOL "
        "103",
    ),
    (
        ("ROTORG", "ROTORD", "ROTORAX", "ROTORSE"),
        "kept, not applied: the modes are those at rest, without gyroscopic terms",
    ),
    (
        ("SNORM",),
        "kept, not applied: normals of shells are the mean of the elements around a node, as "
        "PARAM,SNORM has it",
    ),
    (
        ("MDLPRM",),
        "kept, not applied: with or without OFFDEF, offsets are rigid arms and masses move with "
        "them",
    ),
    (
        ("DESVAR",),
        "kept, not applied: the fields of the cards count as they stand, not the start XINIT",
    ),
    (("TF",), "kept, not applied: transfer functions act in the solutions of responses only"),
)
RECTANGULAR = 9  # form of DMIG that are loads


def unapplied(model: Model) -> Iterator[Finding]:
    """Findings on what is kept in the deck and left out of the modes, or of the damping."""
    for cards, what in _KEPT:
        found = [card for card in cards if card in model.kept]
        if found:
            yield Finding("info", f"{', '.join(found)}: {what}")
    if "GRID" in model and (rows := np.flatnonzero(model["GRID"]["SEID"] > 0)).size:
        yield at_rows(model, "GRID", rows, "info", f"SEID {_WHOLE}")
    for name in ("K2PP", "M2PP", "B2PP"):
        if getattr(model.case, name.lower()):
            yield Finding("info", f"{name} acts on responses (ringtrue frf), not on modes")
    for text in left_out(model):
        yield Finding("warning", text)
    yield from _idle_matrices(model)


def _idle_matrices(model: Model) -> Iterator[Finding]:
    """Square DMIG that no command of case control takes."""
    if "DMIG" not in model:
        return
    table = model["DMIG"]
    names = np.char.upper(table["NAME"].astype(str))
    asked = " ".join(model.case.unread).upper()
    for row in untaken_matrices(model).tolist():
        if table["IFO"][row] != RECTANGULAR and names[row] not in asked:
            text = (
                f"DMIG {names[row]}: it adds nothing: case control takes it by no K2GG, M2GG "
                "or B2GG"
            )
            yield Finding("warning", text, model.files[int(table.file[row])], int(table.line[row]))
