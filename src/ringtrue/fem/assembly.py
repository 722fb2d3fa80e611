"""Assembly: a model to sparse matrices over its free degrees of freedom, in one process or in
several, each of which does a share of the elements.

Spins are held: chains of bars, rods and springs that turn with neither stiffness nor mass. A
straight chain of CBARs has torsional stiffness and no inertia about its line (MSC Nastran Quick
Reference Guide, CBAR), as have point masses on bushes, so that K - σM is singular wherever nothing
holds the chain against turning. One degree of freedom of such a chain may be held: it takes away no
mode, and no mode can tell at which angle the chain stands.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.errors import InputError
from ringtrue.fem.constraints import EPZERO, Stiffening, eliminate, singular_dofs
from ringtrue.fem.element_cards import ELEMENTS, mesh, pieces, refuse
from ringtrue.fem.elements import lumped
from ringtrue.fem.mesh import ElementMatrices, Mesh, Rows, arm, common
from ringtrue.fem.negative_stiffness import refuse_negative
from ringtrue.model.model import Model

log = logging.getLogger(__name__)


def _alone(a: Any_) -> Any_:
    return a


@dataclass(frozen=True, slots=True)
class Share:
    """One of `size` like shares; all processes call the same functions in the same order.

    Attributes
    ----------
    number : int
        From 0.
    size : int
    summed : callable
        The sum over all shares of float64 arrays of one shape, known to each.
    gathered : callable
        Arrays (k,) of all shares one behind the other, known to each.
    """

    number: int = 0
    size: int = 1
    summed: Callable[[Float], Float] = _alone
    gathered: Callable[[Any_], Any_] = _alone

    def span(self, count: int) -> tuple[int, int]:
        """The first of so many that are its own, and that behind its last."""
        return count * self.number // self.size, count * (self.number + 1) // self.size

    def rows(self, model: Model) -> Rows | None:
        """Its rows of each element card; None for all."""
        if self.size == 1:
            return None
        rows: Rows = {}
        for card in (c for c in ELEMENTS if c in model):
            first, last = self.span(len(model[card]))
            if last > first:
                rows[card] = np.arange(first, last)
        return rows

    def own(self, model: Model, rows: Rows) -> Rows:
        """Those of some rows that are its own."""
        mine = self.rows(model)
        return rows if mine is None else common(rows, mine)

    def joined(self, rows: Rows, cards: Iterable[str]) -> Rows:
        """The rows of some cards that any share has, known to each."""
        none = np.empty(0, dtype=np.int64)
        every = {card: np.unique(self.gathered(rows.get(card, none))) for card in cards}
        return {card: at for card, at in every.items() if at.size}

    def total(self, part: sparse.csr_array) -> sparse.csr_array:
        """The sum of a small matrix over all shares."""
        if self.size == 1:
            return part
        coo = part.tocoo()
        data, row, col = (self.gathered(a) for a in (coo.data, coo.row, coo.col))
        return sparse.csr_array(sparse.coo_array((data, (row, col)), shape=part.shape))


WHOLE = Share()


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """K x + i S x + B ẋ + M ẍ over the free DOFs; nothing is added to hold a DOF, it is eliminated.

    Attributes
    ----------
    stiffness, mass : (f, f) csr float64, symmetric, both halves stored
    viscous : (f, f) csr float64
        Dashpots, B2GG and Rayleigh damping.
    structural : (f, f) csr float64
        Imaginary part of the stiffness: Σ g_e K_e + PARAM,G K.
    transform : (full, f) csr float64
        Motion of every node in the basic frame from that of the free DOFs.
    local : (f, full) csr float64
        Picks the free DOFs, in their displacement frames, from a full motion in basic; `local @
        transform` = 1.
    dofs : DofSet
        The full DOFs: six a GRID in the order of the cards, basic frame, then the scalar points.
    free : DofSet
        The free DOFs; directions are those of the node's displacement frame (CD).
    autospc : DofSet
        DOFs that were held because they have no stiffness, in the displacement frames.
    xyz : (node, 3) float64
        Basic coordinates in the order of the GRID cards.
    rayleigh : (float, float)
        ALPHA1, ALPHA2: `viscous` holds ALPHA1 M + ALPHA2 K.
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    viscous: sparse.csr_array
    structural: sparse.csr_array
    transform: sparse.csr_array
    local: sparse.csr_array
    dofs: DofSet
    free: DofSet
    autospc: DofSet
    xyz: Float
    rayleigh: tuple[float, float] = (0.0, 0.0)

    def expand(self, x: Any_) -> Any_:
        """Motion of all nodes in basic, (full, ...), from that of the free DOFs (f, ...)."""
        return self.transform @ x

    def loose(self) -> DofSet:
        """Translations that AUTOSPC holds at nodes that can move otherwise, in the displacement
        frames.
        """
        a = self.autospc
        at = (a.direction >= 1) & (a.direction <= 3) & np.isin(a.node, self.free.node)
        return a.take(at)

    def rigid_body(self) -> Float:
        """Unit motions along and about the axes of basic, (f, 6) float64."""
        full = np.zeros((len(self.dofs), 6))
        full[: 6 * len(self.xyz)] = arm(self.xyz).reshape(-1, 6)
        return self.local @ full


class Sum:
    """A running sum of symmetric element matrices, kept as lower triangles.

    Triangles of like size are merged as the digits of a binary counter are carried, so that an
    entry moves as often as the logarithm of the number of pieces, and the entries of all elements
    are never held at once.
    """

    __slots__ = ("_digits", "_size")

    def __init__(self, size: int) -> None:
        self._size = size
        self._digits: list[sparse.csr_array | None] = []

    def add(self, dofs: Int, block: Any_) -> None:
        """Add dofs (e, d), -1 for none, with values (e, d), diagonal, or (e, d, d), symmetric."""
        i = np.asarray(dofs, dtype=np.int32)
        j = i
        keep = block != 0
        if block.ndim == 3:
            i, j = np.broadcast_arrays(i[:, :, None], i[:, None, :])
            keep &= i >= j
        if dofs.min(initial=0) < 0:
            keep &= j >= 0
            keep &= i >= 0
        carry: sparse.csr_array = sparse.coo_array(
            (block[keep], (i[keep], j[keep])), shape=(self._size, self._size)
        ).tocsr()
        for k, digit in enumerate(self._digits):
            if digit is None:
                self._digits[k] = carry
                return
            carry = sparse.csr_array(digit + carry)
            self._digits[k] = None
        self._digits.append(carry)

    def total(self) -> sparse.csr_array:
        """The sum (n, n) csr, exactly symmetric, both halves stored."""
        lower = sparse.csr_array((self._size, self._size))
        for digit in self._digits:
            lower = lower if digit is None else sparse.csr_array(lower + digit)
        self._digits = []
        return mirrored(lower)


def mirrored(lower: sparse.csr_array) -> sparse.csr_array:
    """The symmetric matrix whose lower triangle is given."""
    upper = lower.T.tocsr()
    strict = upper.indices != np.repeat(
        np.arange(upper.shape[0], dtype=upper.indices.dtype), np.diff(upper.indptr)
    )
    kept = np.concatenate([[0], np.cumsum(strict)]).astype(upper.indptr.dtype)[
        upper.indptr
    ]
    upper = sparse.csr_array(
        (upper.data[strict], upper.indices[strict], kept), shape=upper.shape
    )
    return sparse.csr_array(lower + upper)


def reduced(T: sparse.csr_array, A: sparse.csr_array) -> sparse.csr_array:
    """TᵀAT for a symmetric A, exactly symmetric."""
    if (rows := _selected(T)) is not None:
        return sparse.csr_array(A[rows][:, rows])
    B = sparse.csr_array(T.T.tocsr() @ A @ T)
    return sparse.csr_array((B + B.T) * 0.5)


def _selected(T: sparse.csr_array) -> Int | None:
    """The row that each column of T picks, in order, if T is nothing but such a selection."""
    if T.nnz != T.shape[1] or (T.data != 1).any() or (np.diff(T.indptr) > 1).any():
        return None
    rows = np.flatnonzero(np.diff(T.indptr))
    return rows if (T.indices == np.arange(T.shape[1])).all() else None


def full_matrices(
    m: Mesh, parts: Iterable[ElementMatrices]
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Stiffness and mass (n, n) over the full basic DOFs; PARAM,WTMASS is in the mass."""
    K = Sum(m.size)
    M = Sum(m.size)
    for p in parts:
        K.add(p.dofs, p.stiffness)
        M.add(p.dofs, p.mass)
    return K.total(), sparse.csr_array(M.total() * m.model.param("WTMASS", 1.0))


def turn(m: Mesh) -> sparse.csr_array:
    """Basic motion by motion in the displacement frames, (n, n)."""
    blocks = np.repeat(m.cd.swapaxes(1, 2), 2, axis=0)
    at = np.arange(len(blocks))
    grid = sparse.bsr_array(
        (blocks, at, np.arange(len(blocks) + 1)),
        shape=(3 * len(blocks), 3 * len(blocks)),
    )
    return sparse.csr_array(
        sparse.block_diag([grid, sparse.eye_array(m.scalar.size)], format="csr")
    )


def assemble(model: Model, share: Share = WHOLE) -> System:
    """Assemble a model, or a share of its elements: then K, M and dampings are to be summed over
    the shares; all else is that of the whole model.

    Raises
    ------
    DeckError
        On a card that refers to one that is absent, a distorted element, contradictory constraints,
        or a field that makes a negative stiffness (see `negative_stiffness`).
    UnsupportedCard
        On a card with stiffness, mass or constraint that is not assembled.
    """
    refuse(model)
    refuse_negative(model)
    m = mesh(model)
    rows = share.rows(model)
    K, M, B, S = _totals(m, rows)
    T_local, free = eliminate(m)
    rotation = turn(m)
    direct = None
    given = lumped.given_matrices(m) if share.number == 0 else None
    if given is not None:
        direct, more, damping = (
            sparse.csr_array(rotation @ D @ rotation.T) for D in given
        )
        K = sparse.csr_array(K + direct)
        M = sparse.csr_array(M + more)
        B = sparse.csr_array(B + damping)
    T = sparse.csr_array(rotation @ T_local)
    T.eliminate_zeros()
    stiffness = reduced(T, K)
    del K
    drop = np.zeros(free.size, dtype=bool)
    if str(model.params.get("AUTOSPC", "YES")).upper() != "NO":
        epzero = m.model.param("EPZERO", EPZERO)
        stiffening = Stiffening(pieces(m, rows), direct, epzero, share.summed)
        drop = singular_dofs(stiffness, free, len(m.xyz), T, stiffening)
    keep = np.flatnonzero(~drop)
    if drop.any():
        T = T[:, keep]
        stiffness = stiffness[keep][:, keep]
    names = m.dofs
    held = names.take(free[drop])
    if len(held):
        log.info("AUTOSPC: %d DOFs without stiffness are held", len(held))
    mass, viscous, structural = (reduced(T, A) for A in (M, B, S))
    alpha, beta = rayleigh(model)
    if alpha or beta:
        viscous = sparse.csr_array(viscous + alpha * mass + beta * stiffness)
    g = m.model.param("G", 0.0)
    if g:
        structural = sparse.csr_array(structural + stiffness * g)
    return System(
        stiffness=stiffness,
        mass=mass,
        viscous=viscous,
        structural=structural,
        transform=T,
        local=sparse.csr_array(rotation.T.tocsr()[free[keep]]),
        dofs=names,
        free=names.take(free[keep]),
        autospc=held,
        xyz=m.xyz,
        rayleigh=(alpha, beta),
    )


def moving(model: Model, autospc: DofSet) -> Bool:
    """Which of all DOFs move, (full,), where AUTOSPC holds these: the rows of `System.transform`
    that are not empty, without a matrix of the model.
    """
    m = mesh(model)
    T, free = eliminate(m)
    held = m.dofs.find(autospc.node, autospc.direction)
    T = sparse.csr_array(turn(m) @ T[:, ~np.isin(free, held)])
    T.eliminate_zeros()
    return np.diff(T.indptr) > 0


def refuse_held(system: System) -> None:
    """Refuse a system in which nothing moves.

    Raises
    ------
    InputError
        With what holds it.
    """
    if not system.stiffness.shape[0]:
        why = "the model has no free degree of freedom: check SPC and MPC"
        if len(system.autospc):
            why += f"; {len(system.autospc)} have no stiffness: check moduli and properties"
        raise InputError(why)


def rayleigh(model: Model) -> tuple[float, float]:
    """PARAM ALPHA1 and ALPHA2: D = B + ALPHA1 M + ALPHA2 K."""
    return model.param("ALPHA1", 0.0), model.param("ALPHA2", 0.0)


def _totals(
    m: Mesh, rows: Rows | None
) -> tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array, sparse.csr_array]:
    """Stiffness, mass, viscous damping and Σ g_e K_e (n, n) over the full basic DOFs, each element
    computed once; of all elements, or of some rows of their cards.
    """
    K, M, B, S = (Sum(m.size) for _ in range(4))
    for _, _, p in pieces(m, rows):
        K.add(p.dofs, p.stiffness)
        M.add(p.dofs, p.mass)
        if len(p.viscous):
            B.add(p.dofs, p.viscous)
        if len(structural := p.structural):
            S.add(p.dofs, structural)
    return (
        K.total(),
        sparse.csr_array(M.total() * m.model.param("WTMASS", 1.0)),
        B.total(),
        S.total(),
    )


# cards with rotational stiffness and no inertia of their own, and their nodes
JOINTS = {
    **dict.fromkeys(
        ("CBAR", "CBEND", "CBUSH", "RBAR", "RBAR1", "RJOINT"), ("GA", "GB")
    ),
    "RBE2": ("GN",),
    **dict.fromkeys(("CROD", "CONROD", "CTUBE", "CELAS1", "CELAS2"), ("G1", "G2")),
}
TURNS = 1e-3  # of a unit turn, that a row must move to hold it
NOTHING = 1e-10  # share of the turns' whole energy, and of their whole inertia


def massless_rotations(model: Model, system: System, share: Share = WHOLE) -> Int:
    """Free DOFs (k,), rows of the system, one a spin: the one that turns most with it.

    Turned together about one axis, the nodes of a chain that are joined by rotational stiffness
    take no energy and have no inertia.
    """
    ends = [
        model[card][name]
        for card, names in JOINTS.items()
        if card in model
        for name in names
    ]
    none: Int = np.empty(0, dtype=np.int64)
    turning = np.abs(system.free.direction) >= 4
    at = np.flatnonzero(
        turning & np.isin(system.free.node, np.concatenate([none, *ends]))
    )
    if not at.size:
        return none
    K, M = (share.total(A[at][:, at]) for A in (system.stiffness, system.mass))
    count, label = connected_components(abs(K) + abs(M), directed=False)
    chain: Int = label.astype(np.int64)
    R = _turns(system, at)
    energy, inertia = (_shares(R, A, chain, count) for A in (K, M))
    return at[_pivots(R, chain, *np.linalg.eigh(energy + inertia))]


def _pivots(R: Float, chain: Int, values: Float, axes: Float) -> Int:
    """Rows of R that hold the axes (count, 3, 3), in columns, whose values (count, 3) are nothing;
    ascending.
    """
    found = []
    for k in range(3):
        moved = np.abs(np.einsum("ia,ia->i", R, axes[chain, :, k]))
        rows = np.flatnonzero((values[chain, k] < NOTHING) & (moved > TURNS))
        rows = rows[np.lexsort((rows, -moved[rows], chain[rows]))]
        rows = rows[np.unique(chain[rows], return_index=True)[1]]
        found.append(rows)
        held = (
            R[rows] / np.einsum("ia,ia->i", R[rows], axes[chain[rows], :, k])[:, None]
        )
        # these rows stand still under the other axes then
        for later in range(k + 1, 3):
            share = np.einsum("ia,ia->i", held, axes[chain[rows], :, later])
            axes[chain[rows], :, later] -= share[:, None] * axes[chain[rows], :, k]
    return np.sort(np.concatenate(found))


def _turns(system: System, at: Int) -> Float:
    """Unit turns of all nodes about the axes of basic, without shifts, in rows `at` of the free
    DOFs: (k, 3).
    """
    full = np.zeros((len(system.dofs), 3))
    for a in range(3):
        full[3 + a : 6 * len(system.xyz) : 6, a] = 1.0
    return system.local[at] @ full


def _shares(R: Float, A: sparse.csr_array, chain: Int, count: int) -> Float:
    """RᵀAR of each chain, (count, 3, 3), in shares of what its terms would be without their signs.

    No entry of A joins two chains.
    """
    AR = np.asarray(A @ R)
    whole = np.einsum("ia,ia->i", np.abs(R), np.asarray(abs(A) @ np.abs(R)))
    size = np.bincount(chain, whole, count)
    out = np.zeros((count, 3, 3))
    np.add.at(out, chain, R[:, :, None] * AR[:, None, :])
    return out / np.where(size > 0, size, 1.0)[:, None, None]


def without_massless_rotations(
    model: Model, system: System, share: Share = WHOLE
) -> tuple[System, DofSet]:
    """The system with its spins held, and the DOFs that hold them.

    Under PARAM,AUTOSPC,NO only DOFs that nothing uses are held, among those of `system.autospc`;
    PARAM,ASING,-1 leaves them, too, so that they are an error (MSC Nastran Quick Reference Guide,
    ASING). Of a system that is a share of the elements, by all shares together.
    """
    none: Int = np.empty(0, dtype=np.int64)
    if str(model.params.get("AUTOSPC", "YES")).upper() == "NO":
        rows = _unused(system, share) if model.param("ASING", 0.0) != -1 else none
        held = system.autospc.joined(system.free.take(rows))
        return replace(_held(system, rows), autospc=held), DofSet(none, none)
    rows = massless_rotations(model, system, share)
    held = system.free.take(rows)
    if rows.size:
        log.info(
            "held against spinning without stiffness and mass: %s",
            " ".join(held.labels()),
        )
    return _held(system, rows), held


def _unused(system: System, share: Share) -> Int:
    """Rows of the system without stiffness and mass: scalar points, components that no element
    uses.
    """
    both = (system.stiffness, system.mass)
    k, m = (share.summed(A.diagonal()) for A in both)
    rows = np.flatnonzero((k == 0) & (m == 0))
    sizes = (
        np.asarray(abs(A[rows]).sum(axis=1), dtype=np.float64).ravel() for A in both
    )
    k, m = (share.summed(size) for size in sizes)
    return np.asarray(rows[(k == 0) & (m == 0)])


def _held(system: System, rows: Int) -> System:
    """The system without the free DOFs `rows` (k,)."""
    if not rows.size:
        return system
    keep = np.setdiff1d(np.arange(len(system.free)), rows)
    return replace(
        system,
        **{
            n: getattr(system, n)[keep][:, keep]
            for n in ("stiffness", "mass", "viscous", "structural")
        },
        transform=system.transform[:, keep],
        local=system.local[keep],
        free=system.free.take(keep),
    )
