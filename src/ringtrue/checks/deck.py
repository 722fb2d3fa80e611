"""Checks of a deck before anything is computed with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ringtrue.checks import Finding, Severity, at_rows
from ringtrue.checks.elements import (
    check_geometry,
    double_findings,
    edge_findings,
    hinge_findings,
    stiff_findings,
)
from ringtrue.checks.materials import (
    body_findings,
    check_materials,
    check_units,
    wide_findings,
)
from ringtrue.core.arrays import Int
from ringtrue.decks.nastran.case import empty_choices
from ringtrue.decks.nastran.loads import STATIC_LOADS
from ringtrue.model.cards import PRELOADS, TABLES, columns, is_unsupported
from ringtrue.model.case_control import (
    CONSTRAINTS,
    KEPT,
    MODAL,
    OMITTED,
    condenses,
    idle,
    left_out,
    untaken_matrices,
)
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model
from ringtrue.model.references import (
    FRAMES,
    NODES,
    REFERENCES,
    known_ids,
    missing,
    unused,
)

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


def readable(model: Model) -> Model:
    """The model without cards that are not read, without the rows that name what is not in it, and
    without those that name them in turn.
    """
    kept = {card: n for card, n in model.kept.items() if not is_unsupported(card)}
    model = replace(model, kept=kept)
    while lost := list(missing(model)):
        tables = dict(model.tables)
        for card in {m.reference.card for m in lost}:
            rows = np.concatenate([m.rows for m in lost if m.reference.card == card])
            keep = np.setdiff1d(np.arange(len(tables[card])), rows)
            tables[card] = tables[card].take(keep)
        model = replace(model, tables={card: t for card, t in tables.items() if len(t)})
    return model


def check_deck(model: Model, units: str = "", *, partial: bool = False) -> DeckReport:
    """Check connections, shapes, coincidence, leftovers and units of a model.

    Parameters
    ----------
    units : str
        The unit system that the deck is said to be in, "" if unknown; see `checks.materials`.
    partial : bool
        The deck has cards that are not read: nothing is said of what these may connect, name or
        define.

    Raises
    ------
    InputError
        If the unit system is not known.
    """
    checks = [] if partial else list(_missing(model))
    if "GRID" not in model:
        checks.append(Finding("error", "the deck has no GRID"))
    elif not partial:
        alone = np.flatnonzero(~np.isin(model["GRID"].ids, _used_nodes(model)))
        checks += at_rows(
            model, "GRID", alone, "warning", "no element is connected to it"
        )
    checks += _shared_numbers(model)
    lost = [missing_one.reference for missing_one in missing(model)]
    if not any(r.of == FRAMES or r.card in FRAMES for r in lost):  # positions are known
        checks += check_geometry(model)
        checks += [] if partial else _coincident(model)
        checks += check_units(model, units)
        checks += [] if partial else hinge_findings(model)
        checks += wide_findings(model)
        checks += stiff_findings(model)
    for card, rows in [] if partial else sorted(unused(model).items()):
        checks += at_rows(model, card, rows, "info", "nothing uses it")
    checks += _unchosen(model)
    checks += _lost_sets(model)
    checks += unapplied(model)
    checks += check_materials(model)
    checks += body_findings(model)
    checks += [] if partial else edge_findings(model)
    checks += double_findings(model)
    order = {"error": 0, "warning": 1, "info": 2}
    found = tuple(sorted(checks, key=lambda f: order[f.severity]))
    return DeckReport(
        {n: len(t) for n, t in model.tables.items()}, dict(model.kept), found
    )


def _missing(model: Model) -> Iterator[Finding]:
    out = idle(model)
    for lost in missing(model):
        ref = lost.reference
        harmless = np.isin(lost.rows, out.get(ref.card, ())).all()
        severity: Severity = "warning" if harmless else "error"
        what = f"{ref.field} names {ref.names} {lost.ids[0]}: not there"
        yield from at_rows(model, ref.card, np.unique(lost.rows), severity, what)


def _used_nodes(model: Model) -> Int:
    """Ids of the nodes that an element, mass, rigid element, MPC or frame names, (n,) int64."""
    used = [np.empty(0, dtype=np.int64)]
    for ref in REFERENCES:
        if ref.of == NODES and ref.card in model and ref.card not in _NOT_ELEMENTS:
            used.append(model[ref.card].entries(ref.field)[0])
    return np.unique(np.concatenate(used))


def _shared_numbers(model: Model) -> Iterator[Finding]:
    """Elements whose number one of another card has, too."""
    cards = sorted(
        c for c, t in model.tables.items() if len(t) and columns(c)[0].name == "EID"
    )
    for i, card in enumerate(cards):
        for other in cards[:i]:
            rows = np.flatnonzero(np.isin(model[card].ids, model[other].ids))
            what = f"{other} has the same number; Nastran wants numbers of elements to be unique"
            yield from at_rows(model, card, rows, "warning", what)


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
        ids, owner = zip(*(model[card].entries(name) for name in names), strict=True)
        yield np.concatenate(ids), np.concatenate(owner)


def _coincident(model: Model) -> list[Finding]:
    """Pairs of nodes at one place that no element or constraint joins."""
    if "GRID" not in model or len(model["GRID"]) < 2:
        return []
    grid = model["GRID"]
    xyz = positions(model)
    used = np.flatnonzero(np.isin(grid.ids, _used_nodes(model)))
    near = 1e-6 * diagonal(xyz)
    pairs = KDTree(xyz[used]).query_pairs(near, output_type="ndarray").astype(np.int64)
    if not len(pairs):
        return []
    pairs = used[pairs]
    free = pairs[~_joined(model, grid.ids[pairs])]
    if not len(free):
        return []
    free = free[np.lexsort((free[:, 1], free[:, 0]))]
    names = [f"{a} and {b}" for a, b in grid.ids[free[:5]].tolist()]
    if len(free) > 5:
        names.append("...")
    what = (
        f"at one place with another node that nothing joins it to: {', '.join(names)}"
    )
    return at_rows(model, "GRID", np.unique(free[:, 0]), "warning", what)


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
        nodes = np.searchsorted(wanted, ids[keep])
        for o, i in zip(owner[keep].tolist(), nodes.tolist(), strict=True):
            members.setdefault(i, set()).add(o)
        for a, b in at.tolist():  # the few coincident pairs
            if members.get(a, set()) & members.get(b, set()):
                joined.add((a, b))
    edges = np.array(sorted(joined), dtype=np.int64).reshape(-1, 2)
    graph = sparse.coo_array(
        (np.ones(len(edges)), (edges[:, 0], edges[:, 1])),
        shape=(wanted.size, wanted.size),
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
        Finding("warning", f"case control asks for {text}")
        for text in empty_choices(model)
    )
    for name, (_, cards) in CONSTRAINTS.items():
        if getattr(model.case, name.lower()):
            continue
        what = f"it holds nothing: case control chooses no {name}"
        for card in (c for c in cards if c in model):
            yield from at_rows(
                model, card, np.arange(len(model[card])), "warning", what
            )


def _lost_sets(model: Model) -> Iterator[Finding]:
    """SPCADD and MPCADD of sets that are not in the deck."""
    for add, cards in CONSTRAINTS.values():
        if add in model:
            sets, row = model[add].entries("S")
            rows = np.unique(row[~np.isin(sets, known_ids(model, cards))])
            what = "it names a set that is not in the deck"
            yield from at_rows(model, add, rows, "warning", what)


_KEPT = (  # cards that are kept and what becomes of them
    (
        ("BSET", "BSET1", "CSET", "CSET1", "BNDFIX", "BNDFIX1", "BNDFREE", "BNDFREE1"),
        "kept, not applied: component modes are those with all kept DOFs held",
    ),
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
    (
        ("TF",),
        "kept, not applied: transfer functions act in the solutions of responses only",
    ),
)


def unapplied(model: Model) -> Iterator[Finding]:
    """Findings on what is kept in the deck and left out of the modes, or of the damping."""
    for cards, what in _KEPT:
        found = [card for card in cards if card in model.kept]
        if found:
            yield Finding("info", f"{', '.join(found)}: {what}")
    loads = [
        c
        for c in sorted(model.kept)
        if c.startswith(PRELOADS) and c not in STATIC_LOADS
    ]
    if loads:
        what = "loads that are not read: ringtrue static refuses a set with them; no mode changes"
        yield Finding("info", f"{', '.join(loads)}: {what}")
    if condenses(model):
        yield Finding("info", condensation(model))
    for name in ("K2PP", "M2PP", "B2PP"):
        if getattr(model.case, name.lower()):
            yield Finding(
                "info", f"{name} acts on responses (ringtrue frf), not on modes"
            )
    for text in left_out(model):
        yield Finding("warning", text)
    yield from _idle_matrices(model)


def condensation(model: Model) -> str:
    """What of a deck is condensed, and which answers are."""
    listed = [card for card in (*KEPT, *OMITTED, *MODAL) if card in model]
    if "GRID" in model and (model["GRID"]["SEID"] > 0).any():
        listed.append("superelements")
    by = ", ".join(listed)
    return (
        f"{by}: ringtrue modes and frf condense as Nastran does; static is exact, and studies take "
        "the whole mesh"
    )


def _idle_matrices(model: Model) -> Iterator[Finding]:
    """Square DMIG that no command of case control takes."""
    if "DMIG" not in model:
        return
    table = model["DMIG"]
    names = np.char.upper(table["NAME"].astype(str))
    asked = " ".join(model.case.unread).upper()
    for row in untaken_matrices(model).tolist():
        rectangular = table["IFO"][row] == 9  # loads
        if not rectangular and names[row] not in asked:
            text = (
                f"DMIG {names[row]}: it adds nothing: case control takes it by no K2GG, M2GG "
                "or B2GG"
            )
            file, line = model.place(table, row)
            yield Finding("warning", text, file or "", line or 0)
