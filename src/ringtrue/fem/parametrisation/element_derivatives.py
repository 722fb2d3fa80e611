"""Derivatives of element matrices to many parameters in few sweeps over the elements.

Fields: a complex step (Squire and Trapp 1998), all parameters whose elements do not meet in one
sweep. Moduli to which an element's stiffness is proportional: the stiffness itself, the real part
of a sweep if there is one. Places of nodes, beam ends and orientations, through which no complex
step passes (norms): central differences of eighth order with a step of half a percent of the
smallest element, whose error is that of rounding (1e-12).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.parameters import (
    CardField,
    Parameter,
    Shape,
    Substructure,
    is_matrix,
)
from ringtrue.errors import InputError
from ringtrue.fem.assembly import WHOLE, Share, turn
from ringtrue.fem.element_cards import (
    MATERIAL,
    PROPERTY,
    mesh,
    pieces,
    with_listed_mass,
)
from ringtrue.fem.elements.lumped import named_matrix
from ringtrue.fem.mesh import ElementMatrices, Mesh, Rows, union
from ringtrue.fem.parametrisation.changed_model import (
    changed,
    moved,
    rows_of,
    rows_of_elements,
    users_of_nodes,
    within,
)
from ringtrue.model.edit import field_value
from ringtrue.model.frames import diagonal
from ringtrue.model.model import Model

COMPLEX_STEP = 1e-40  # nothing is subtracted, so it costs no digits
SPAN = 512  # elements of a chunk, whose matrices stay in the cache
_PLACES = frozenset(["X1", "X2", "X3", "W1A", "W2A", "W3A", "W1B", "W2B", "W3B"])
# of the square that finds the shells which carry an end; of the beam that a spline is
_SIZES = frozenset([("PFAST", "D"), ("PWELD", "D"), ("RSPLINE", "DL")])
# X1-X3 there are an arm, generic in dtype
_SECTION_PLACES = frozenset(["CONM2", "CONM1"])


@dataclass(frozen=True, slots=True, eq=False)
class ElementDerivatives:
    """Derivatives of element matrices, each to one parameter; PARAM,WTMASS is in the mass.

    Attributes
    ----------
    owner : (e,) int64
        Position of the parameter.
    dofs : (e, d) int64
        Full DOFs, -1 for none.
    stiffness : (e, d, d) float64
    mass : (e, d) or (e, d, d) float64
    """

    owner: Int
    dofs: Int
    stiffness: Float
    mass: Float


@dataclass(slots=True, eq=False)
class _Sweep:
    """Targets stepped together, with the rows that each parameter owns; no row feels a step that is
    not its own.
    """

    targets: tuple[CardField, ...]
    rows: list[tuple[int, Rows]] = field(default_factory=list)
    taken: dict[str, Bool] = field(default_factory=dict)

    def take(self, model: Model, rows: Rows) -> None:
        """These rows feel its steps, too."""
        for card, at in rows.items():
            self.taken.setdefault(card, np.zeros(len(model[card]), dtype=bool))[at] = (
                True
            )


def is_place(target: CardField) -> bool:
    """Whether a field is the place of a node or of a beam's end, or a direction."""
    return moves_nodes(target) or (
        target.field in _PLACES and target.card not in _SECTION_PLACES
    )


def moves_nodes(target: CardField) -> bool:
    """Whether nodes, rigid elements and displacement frames may move with a field."""
    return (
        target.card == "GRID"
        or target.card.startswith("CORD")
        or (target.card, target.field) in _SIZES
    )


@dataclass(frozen=True, slots=True)
class Move:
    """A place that moves with a parameter: a field of a card, or nodes along their vectors."""

    name: str
    what: CardField | Shape

    @property
    def of_nodes(self) -> bool:
        """Whether nodes, rigid elements and displacement frames may move."""
        return isinstance(self.what, Shape) or moves_nodes(self.what)

    def applied(self, model: Model, amount: float) -> Model:
        """The model with this place where it is at a = 1 + amount."""
        if isinstance(self.what, Shape):
            return moved(model, self.what, amount)
        return changed(model, self.name, [self.what], 1 + amount)

    def rows(self, model: Model) -> Rows:
        """Rows of the element cards that it changes."""
        if isinstance(self.what, Shape):
            return users_of_nodes(model, np.array(self.what.nodes))
        return within(model, rows_of(model, self.what), self.what.elements)

    def size(self, model: Model) -> float:
        """How far it moves for a change of a by 1."""
        if isinstance(self.what, Shape):
            return float(np.abs(self.what.vectors).max(initial=0.0))
        if self.what.step:
            return abs(self.what.step)
        changed(model, self.name, [self.what], 1.0)  # names a target that is not there
        return abs(float(field_value(model, self.what)))


def moves(p: Parameter) -> list[Move]:
    """The places that move with a parameter."""
    places: list[CardField | Shape] = [t for t in p.targets if is_place(t)]
    return [Move(p.name, what) for what in (*places, *p.shapes)]


def central_differences(size: float, reach: float) -> Iterator[tuple[float, float]]:
    """Steps of a and their weights in the derivative, of eighth order (Fornberg 1988).

    A place that moves by `size` (a - 1) moves by half a percent of `reach` at most in one step.
    """
    h = 5e-3 * min(1.0, reach / (size or 1.0))
    for k, c in ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280)):
        yield k * h, c / h
        yield -k * h, -c / h


def element_derivatives(
    model: Model, parameters: Sequence[Parameter], share: Share = WHOLE
) -> Iterator[ElementDerivatives]:
    """The derivatives at a = 1 of the matrices of all elements of a share that any of the
    parameters changes.

    Raises
    ------
    InputError
        If a target or element is not in the model.
    """
    m = mesh(model)
    own = share.rows(model)
    bundles, moduli = _bundles(model, parameters)
    moduli = [{c: _within(own, c, o) for c, o in layer.items()} for layer in moduli]
    for sweep in _merged(model, bundles):
        yield from _stepped(m, sweep, moduli, own)
    for layer in moduli:
        for card, at, part in pieces(m, _owned(layer), SPAN):
            yield from _proportional(layer, card, at, part)
    for i, p in enumerate(parameters):
        for move in moves(p):
            yield from _by_differences(m, i, move, own)
        for s in p.substructures:
            yield from _common_factor(m, i, p.name, s, own)
        if share.number == 0:
            yield from given_matrix_derivatives(m, i, p)


def _bundles(
    model: Model, parameters: Sequence[Parameter]
) -> tuple[list[_Sweep], list[dict[str, Int]]]:
    """Parameters on the same fields and of disjoint elements share a sweep; and layers of owners of
    moduli.
    """
    made: dict[tuple[CardField, ...], list[_Sweep]] = {}
    layers = list[_Sweep]()
    reach = dict[tuple[CardField, ...], _Reach]()
    for i, p in enumerate(parameters):
        by_elements: dict[tuple[int, ...], list[CardField]] = {}
        for t in p.targets:
            if not (is_place(t) or is_matrix(t.card, t.field)):
                by_elements.setdefault(t.elements, []).append(replace(t, elements=()))
        for elements, found in by_elements.items():
            targets = tuple(found)
            if targets not in reach:
                changed(model, p.name, targets, 1.0)  # names a target that is not there
                reach[targets] = _Reach.of(model, targets)
            rows = reach[targets].within(elements)
            if reach[targets].proportional(rows):
                _join(model, layers, (), i=i, rows=rows)
            else:
                _join(model, made.setdefault(targets, []), targets, i=i, rows=rows)
    sweeps = [s for group in made.values() for s in group]
    for s in sweeps:  # what the steps change, not only what the parameters own
        s.take(model, reach[s.targets].rows)
    return sweeps, [_owners(s) for s in layers]


@dataclass(frozen=True, slots=True, eq=False)
class _Reach:
    """What targets change.

    Attributes
    ----------
    rows : dict
        Rows of each element card.
    order : dict
        Their ids, ascending, and the rows in that order.
    moduli : dict
        Flags of all rows of each card: the targets are all moduli of the one material that the
        element is made of.
    """

    rows: Rows
    order: dict[str, tuple[Int, Int]]
    moduli: dict[str, Bool]

    @classmethod
    def of(cls, model: Model, targets: tuple[CardField, ...]) -> _Reach:
        rows = union(rows_of(model, t) for t in targets)
        order = {}
        for card, at in rows.items():
            ids = model[card].ids[at]
            by_id = np.argsort(ids, kind="stable")
            order[card] = ids[by_id], at[by_id]
        mids = _moduli(model, targets)
        return cls(
            rows,
            order,
            {c: np.isin(sole_material(model, c), mids) for c in rows} if mids else {},
        )

    def within(self, elements: tuple[int, ...]) -> Rows:
        """The rows of those elements; all if none are named."""
        if not elements:
            return self.rows
        wanted = np.unique(np.array(elements, dtype=np.int64))
        out = Rows()
        for card, (ids, at) in self.order.items():
            place = np.searchsorted(ids, wanted).clip(max=ids.size - 1)
            picked = at[place[ids[place] == wanted]]
            if picked.size:
                out[card] = np.sort(picked)
        return out

    def proportional(self, rows: Rows) -> bool:
        """Whether the stiffness of these rows is proportional to what the targets are."""
        return bool(self.moduli) and all(
            self.moduli[c][at].all() for c, at in rows.items()
        )


def _moduli(model: Model, targets: Sequence[CardField]) -> tuple[int, ...]:
    """Materials of which the targets are all moduli that are given; none if they are anything else,
    too.
    """
    if any(t.card != "MAT1" or t.field not in ("E", "G") or t.step for t in targets):
        return ()
    mids = {t.id for t in targets}
    table = model["MAT1"]
    for mid in mids:
        row = table.find(np.array([mid]))
        given = {f for f in ("E", "G") if not np.isnan(table[f][row]).any()}
        if given != {t.field for t in targets if t.id == mid}:
            return ()
    return tuple(sorted(mids))


def _owners(s: _Sweep) -> dict[str, Int]:
    """Position of the parameter that owns each row of each card, -1 for none."""
    owner = {c: np.full(n.size, -1) for c, n in s.taken.items()}
    for i, rows in s.rows:
        for c, at in rows.items():
            owner[c][at] = i
    return owner


def _join(
    model: Model,
    bundle: list[_Sweep],
    targets: tuple[CardField, ...],
    i: int,
    rows: Rows,
) -> None:
    for s in bundle:
        if not any(s.taken[c][at].any() for c, at in rows.items() if c in s.taken):
            break
    else:
        s = _Sweep(targets)
        bundle.append(s)
    s.rows.append((i, rows))
    s.take(model, rows)


def _merged(model: Model, sweeps: list[_Sweep]) -> list[_Sweep]:
    """Sweeps that reach no common element become one (greedy colouring)."""
    out: list[_Sweep] = []
    for s in sweeps:
        for t in out:
            if not any(
                (t.taken[c] & used).any() for c, used in s.taken.items() if c in t.taken
            ):
                t.targets = t.targets + s.targets
                t.rows = t.rows + s.rows
                for c, used in s.taken.items():
                    t.taken[c] = used | t.taken[c] if c in t.taken else used
                break
        else:
            out.append(s)
    return out


def sole_material(model: Model, card: str) -> Int:
    """The material of each row of an element card, -1 where there are several, none, or a
    laminate's.
    """
    t = model[card]
    name = PROPERTY.get(card, card)
    out = np.full(len(t), -1)
    if name not in model or name not in MATERIAL:
        return out
    mids = model[name].stack(*MATERIAL[name])
    top = mids.max(axis=1, initial=0)
    one = ((mids == top[:, None]) | (mids <= 0)).all(axis=1) & (top > 0)
    row = np.arange(len(t)) if name == card else model[name].find(t["PID"])
    out[row >= 0] = np.where(one, top, -1)[row[row >= 0]]
    return out


def _within(own: Rows | None, card: str, owner: Int) -> Int:
    """The owners of rows of a card, -1 where a row is not among one's own."""
    if own is None:
        return owner
    kept = np.full(owner.size, -1)
    if card in own:
        kept[own[card]] = owner[own[card]]
    return kept


def _common(own: Rows | None, rows: Rows) -> Rows:
    """Rows that are among one's own."""
    if own is None:
        return rows
    both = {
        card: np.intersect1d(at, own[card]) for card, at in rows.items() if card in own
    }
    return {card: at for card, at in both.items() if at.size}


def _stepped(
    m: Mesh, sweep: _Sweep, moduli: list[dict[str, Int]], own: Rows | None
) -> Iterator[ElementDerivatives]:
    """Imaginary parts for the sweep; real ones for owners of moduli on the same elements, who are
    struck off.
    """
    owner = {card: _within(own, card, rows) for card, rows in _owners(sweep).items()}
    rows = _owned(owner)
    there = with_listed_mass(
        replace(m, model=changed(m.model, "", sweep.targets, 1 + 1j * COMPLEX_STEP))
    )
    for card, at, part in pieces(there, rows, SPAN):
        yield _derivatives(m, owner[card][at], part, _imaginary)
        for layer in moduli:
            yield from _proportional(layer, card, at, part)


def _owned(owner: dict[str, Int]) -> Rows:
    return {c: np.flatnonzero(o >= 0) for c, o in owner.items()}


def _proportional(
    layer: dict[str, Int], card: str, at: Int, p: ElementMatrices
) -> Iterator[ElementDerivatives]:
    """The stiffness of those rows that have an owner, who is then struck off."""
    if card not in layer:
        return
    mine = np.flatnonzero(layer[card][at] >= 0)
    if not mine.size:
        return
    pick = slice(None) if mine.size == at.size else mine
    owner = layer[card][at][pick]
    layer[card][at[pick]] = -1
    K = np.ascontiguousarray(p.stiffness.real[pick])
    yield ElementDerivatives(owner, p.dofs[pick], K, np.zeros(K.shape[:2]))


def _imaginary(a: Any_) -> Float:
    return (
        np.asarray(a.imag / COMPLEX_STEP) if np.iscomplexobj(a) else np.zeros(a.shape)
    )


def _derivatives(
    m: Mesh, owner: Int, p: ElementMatrices, take: Callable[[Any_], Float]
) -> ElementDerivatives:
    mass = take(p.mass) * m.model.param("WTMASS", 1.0)
    return ElementDerivatives(owner, p.dofs, take(p.stiffness), mass)


def _by_differences(
    m: Mesh, i: int, move: Move, own: Rows | None
) -> Iterator[ElementDerivatives]:
    """Central differences of the elements that a place changes."""
    rows = _common(own, move.rows(m.model))
    size = move.size(m.model)
    if size == 0 or not rows:
        return
    shortest = _shortest_edge(m, rows)
    total: list[ElementDerivatives] = []
    for step, weight in central_differences(size, shortest):
        there = mesh(move.applied(m.model, step))
        parts = [
            _derivatives(m, np.full(at.size, i), part, partial(np.multiply, weight))
            for _, at, part in pieces(there, rows, SPAN)
        ]
        if total:
            parts = [
                replace(a, stiffness=a.stiffness + b.stiffness, mass=a.mass + b.mass)
                for a, b in zip(total, parts, strict=True)
            ]
        total = parts
    yield from total


def _shortest_edge(m: Mesh, rows: Rows) -> float:
    shortest = diagonal(m.xyz) or 1.0
    for _, _, part in pieces(m, rows, SPAN):
        per_node = 6 if part.dofs.shape[1] % 6 == 0 else 3
        node = part.dofs[:, ::per_node] // 6
        node = np.where((node >= 0) & (node < len(m.xyz)), node, -1)
        edge = np.linalg.norm(m.xyz[node] - m.xyz[np.roll(node, 1, axis=1)], axis=2)
        edge = edge[(edge > 0) & (node >= 0) & (np.roll(node, 1, axis=1) >= 0)]
        shortest = min(shortest, float(edge.min(initial=shortest)))
    return shortest


def _common_factor(
    m: Mesh, i: int, name: str, s: Substructure, own: Rows | None
) -> Iterator[ElementDerivatives]:
    """The element matrices themselves: the derivative to a common factor on them."""
    rows = _common(own, rows_of_elements(m.model, name, s.elements))
    for _, at, part in pieces(m, rows, SPAN):
        whole = _derivatives(m, np.full(at.size, i), part, np.asarray)
        if s.matrix == "stiffness":
            yield replace(whole, mass=np.zeros_like(whole.mass))
        else:
            yield replace(whole, stiffness=np.zeros_like(whole.stiffness))


def given_matrix_derivatives(
    m: Mesh, i: int, p: Parameter
) -> Iterator[ElementDerivatives]:
    """The matrices of DMIG that a parameter scales, each as one element over its DOFs in basic.

    Raises
    ------
    InputError
        If the deck has no such matrix, or case control takes it neither by K2GG nor by M2GG.
    """
    for target in (t for t in p.targets if is_matrix(t.card, t.field)):
        changed(m.model, p.name, [target], 1.0)  # names a target that is not there
        table = m.model["DMIG"]
        name = str(table["NAME"][table.find(np.array([target.id]))[0]])
        case = m.model.case
        scales = [
            m.model.param(param, 1.0) * sum(f for f, n in terms if n == name.upper())
            for param, terms in (("CK2", case.k2gg), ("CM2", case.m2gg))
        ]
        if not any(scales):
            raise InputError(
                f"parameter {p.name}: DMIG {name} is taken neither by K2GG nor by M2GG"
            )
        rotation = turn(m)
        whole = sparse.csr_array(rotation @ named_matrix(m, name) @ rotation.T)
        dofs = np.flatnonzero(np.diff(whole.indptr))
        block = whole[dofs][:, dofs].toarray()[None]
        stiffness, mass = (scale * block for scale in scales)
        yield ElementDerivatives(np.array([i]), dofs[None], stiffness, mass)
