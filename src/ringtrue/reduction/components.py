"""Systems condensed as a deck asks for it, component by component; a part reduced to some of its
points, and what that does to its modes.

Sources: static condensation, Guyan (1965); component modes, Craig and Bampton (1968); dynamic
condensation at a frequency, Leung (1978), Paz (1984).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.dofs import DofSet
from ringtrue.eigen.eigenpairs import eigenvalue, frequencies
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil, spectrum
from ringtrue.errors import ConfigError, InputError, did_you_mean
from ringtrue.fem.assembly import System, assemble, reduced, without_massless_rotations
from ringtrue.model.case_control import (
    KEPT,
    OMITTED,
    component_modes,
    condenses,
    listed_dofs,
)
from ringtrue.model.model import ComponentModes, Model
from ringtrue.reduction.static import Condensed, craig_bampton

log = logging.getLogger(__name__)


def free_system(model: Model) -> tuple[System, DofSet]:
    """The assembled system of the whole mesh with its spins held, and the DOFs that hold them."""
    return without_massless_rotations(model, assemble(model))


def condensed(model: Model, system: System) -> System:
    """The system as Nastran solves it for modes: superelements first, then the residual structure.

    Raises
    ------
    SingularModel
        If the omitted DOFs of a component can move while the others are held.
    """
    if not condenses(model):
        return system
    seid = model["GRID"]["SEID"]
    parts = {part.number: part for part in model.superelements}
    for number in np.unique(seid[seid > 0]).tolist():
        inner = np.isin(system.free.node, model["GRID"].ids[seid == number])
        modes = parts[number].modes if number in parts else ComponentModes()
        system = _without(system, inner, modes, f"superelement {number}")
    modes = component_modes(model)
    inner = _omitted(model, system.free, modes.modal)
    return _without(system, inner, modes, "the residual structure")


def _omitted(model: Model, free: DofSet, modal: DofSet) -> Bool:
    """Free DOFs (f,) of the residual structure that are condensed: all that ASET does not name
    where it is given, else those of OMIT.
    """
    kept = listed_dofs(model, KEPT)
    if len(kept) or len(modal):
        named = np.concatenate([kept.key, modal.key])
        return ~np.isin(free.key, named)
    return np.isin(free.key, listed_dofs(model, OMITTED).key)


def _without(system: System, inner: Bool, modes: ComponentModes, name: str) -> System:
    """The system with the inner DOFs (f,) of a component condensed onto the DOFs around them."""
    inside = np.flatnonzero(inner)
    if not inside.size:
        return system
    kept = np.flatnonzero(~inner)
    touched = np.zeros(inner.size, dtype=bool)
    for A in (system.stiffness, system.mass):
        touched[A[inside].indices] = True
    around = kept[touched[kept]]
    block = np.concatenate([inside, around])
    K, M = (A[block][:, block] for A in (system.stiffness, system.mass))
    boundary = np.arange(inside.size, block.size)
    labels = system.free.take(block).named
    part = craig_bampton(K, M, boundary, modes.count, labels=labels)
    found = int((part.frequencies <= modes.highest).sum())
    log.info(
        "%s: %d DOFs condensed onto %d and %d component modes",
        name,
        inside.size,
        around.size,
        found,
    )
    columns = np.concatenate(
        [np.searchsorted(kept, around), kept.size + np.arange(found)]
    )
    select = sparse.coo_array(
        (np.ones(kept.size), (kept, np.arange(kept.size))),
        shape=(inner.size, kept.size + found),
    )
    inner_rows = sparse.coo_array(part.transform[: inside.size, : around.size + found])
    motion = sparse.coo_array(
        (inner_rows.data, (inside[inner_rows.row], columns[inner_rows.col])),
        shape=select.shape,
    )
    T = sparse.csr_array(select + motion)
    return _projected(system, T, kept, modes.modal.take(np.arange(found)))


def _projected(system: System, T: sparse.csr_array, kept: Int, modal: DofSet) -> System:
    """The system on other coordinates x = T y: kept ones and, behind them, modal ones."""
    rows = system.dofs.find(modal.node, modal.direction)
    size = len(system.dofs)
    place = (rows, kept.size + np.arange(len(modal)))
    at_points = sparse.coo_array((np.ones(len(modal)), place), shape=(size, T.shape[1]))
    pick = sparse.coo_array(
        (np.ones(len(modal)), (np.arange(len(modal)), rows)), shape=(len(modal), size)
    )
    held = ~np.isin(system.autospc.key, modal.key)
    return replace(
        system,
        stiffness=reduced(T, system.stiffness),
        mass=reduced(T, system.mass),
        viscous=reduced(T, system.viscous),
        structural=reduced(T, system.structural),
        transform=sparse.csr_array(system.transform @ T + at_points),
        local=sparse.csr_array(sparse.vstack([system.local[kept], pick])),
        free=system.free.take(kept).joined(modal),
        autospc=system.autospc.take(held),
    )


Method = Literal["craig-bampton", "guyan", "dynamic"]


@dataclass(frozen=True, slots=True)
class ReductionSettings:
    """How a part is reduced.

    Attributes
    ----------
    method : {"craig-bampton", "guyan", "dynamic"}
        Component modes with the kept points held; none, exact in statics; or none, exact at the
        frequency `at`.
    below : float, Hz
        Up to where the error is stated.
    modes : int, optional
        Component modes; those up to `margin` times `below` if not given.
    at : float, Hz, optional
        Of the dynamic condensation.
    margin : float
        The usual 2 (Craig and Bampton 1968 keep component modes above the band, too).
    """

    below: float
    method: Method = "craig-bampton"
    modes: int | None = None
    at: float | None = None
    margin: float = 2.0

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise ConfigError(
                f"method {self.method!r}{did_you_mean(self.method, get_args(Method))}"
            )
        if not self.below > 0:
            raise ConfigError(f"below {self.below:g} Hz: must be above 0")
        if (self.method == "dynamic") != (self.at is not None):
            raise ConfigError(
                "a frequency `at`, Hz, belongs to the method dynamic, which needs it"
            )
        if self.modes is not None and self.method != "craig-bampton":
            raise ConfigError(
                f"{self.modes} modes: only craig-bampton has component modes"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ReductionError(FrozenArrays):
    """Modes of a part before and after its reduction, in ascending order.

    Attributes
    ----------
    frequencies : (m,) float64, Hz
    reduced : (m,) float64, Hz
        NaN where the reduced part has no further mode.
    captured : (m,) float64
        Share of the mode's kinetic energy that motions of the reduced part have; 1 is all of it.
    """

    frequencies: Float
    reduced: Float
    captured: Float


def kept_rows(free: DofSet, points: DofSet) -> Int:
    """Rows of the free DOFs that are kept, by node and component; a point without a direction
    stands for all of its free DOFs.

    Raises
    ------
    InputError
        If one is not free.
    """
    rows = []
    for node, direction in zip(
        points.node.tolist(), points.direction.tolist(), strict=True
    ):
        here = np.flatnonzero(free.node == node)
        if direction:
            here = here[np.abs(free.direction[here]) == abs(direction)]
        if not here.size:
            name = DofSet(np.array([node]), np.array([direction])).labels()[0]
            raise InputError(
                f"keep {name}: it is not in the model, held, or moved by others"
            )
        rows.append(here)
    found = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *rows]))
    return found[np.argsort(free.key[found])]


def reduce_part(system: System, kept: Int, settings: ReductionSettings) -> Condensed:
    """The matrices of a part over the kept rows (b,) of its free DOFs and its component modes.

    Raises
    ------
    SingularModel
        If the part can move while the kept DOFs are held.
    """
    K, M = system.stiffness, system.mass
    labels = system.free.named
    if settings.at is not None:
        shift = eigenvalue(settings.at)
        T = craig_bampton(K - shift * M, M, kept, 0, labels=labels).transform
        k, m = (T.T @ (A @ T) for A in (K, M))
        return Condensed((k + k.T) / 2, (m + m.T) / 2, T, kept, np.zeros(0))
    if settings.method == "guyan" or settings.modes is not None:
        return craig_bampton(K, M, kept, settings.modes or 0, labels=labels)
    most = K.shape[0] - kept.size
    count = min(16, most)
    while True:
        part = craig_bampton(K, M, kept, count, labels=labels)
        inside = int((part.frequencies <= settings.margin * settings.below).sum())
        if (
            inside < part.frequencies.size
            or part.frequencies.size < count
            or count == most
        ):
            size = kept.size + inside
            return Condensed(
                part.stiffness[:size, :size],
                part.mass[:size, :size],
                part.transform[:, :size],
                kept,
                part.frequencies[:inside],
            )
        count = min(2 * count, most)


def reduction_error(
    model: Model, system: System, part: Condensed, below: float
) -> ReductionError:
    """What the reduction does to the modes of the part up to `below`, Hz, its kept points free."""
    held, _ = without_massless_rotations(model, system)
    pencil = Pencil(held.stiffness, held.mass)
    try:
        whole = solve_modes(pencil, band=(-1.0, below))
    finally:
        pencil.close()
    shapes = np.zeros((part.transform.shape[0], whole.values.size))
    shapes[system.free.find(held.free.node, held.free.direction)] = whole.vectors
    size = [np.abs(A).max(initial=0.0) or 1.0 for A in (part.stiffness, part.mass)]
    basis = _firm(part.stiffness / size[0] + part.mass / size[1])
    k, m = (sparse.csr_array(basis.T @ A @ basis) for A in (part.stiffness, part.mass))
    lam, vectors = spectrum(k, m, -eigenvalue(below))
    reduced = np.full(whole.values.size, np.nan)
    there = min(reduced.size, lam.size)
    reduced[:there] = frequencies(lam[:there])
    overlap = (part.transform @ (basis @ vectors)).T @ (system.mass @ shapes)
    return ReductionError(whole.frequencies, reduced, np.sum(overlap**2, axis=0))


def largest_shift(system: System, part: Condensed, at: float) -> float:
    """Relative change of the frequency of a mode of any whole at `at`, Hz, that the reduction makes
    at most, to first order.

    A whole sees the part by its dynamic stiffness D(ω) at the kept DOFs, and the reduction adds
    E = D_reduced − D, which is not negative. A mode with the motions u there has δλ = uᵀEu over the
    modal mass of the whole, which is that of the part, uᵀGu with G = −∂D/∂λ, and more. So δλ/λ is
    at most the largest eigenvalue of E over ω²G, reached where all of the mass is in the part.
    """
    lam = eigenvalue(at)
    K, M = system.stiffness, system.mass
    T = craig_bampton(K - lam * M, M, part.kept, 0).transform
    exact = T.T @ ((K - lam * M) @ T)
    G = T.T @ (M @ T)
    b = part.kept.size
    D = part.stiffness - lam * part.mass
    reduced = D[:b, :b] - D[:b, b:] @ np.linalg.solve(D[b:, b:], D[b:, :b])
    basis = _firm(G)
    E, G = (basis.T @ A @ basis for A in (reduced - exact, G))
    ratio = linalg.eigvalsh((E + E.T) / 2, lam * (G + G.T) / 2)
    return 0.5 * float(ratio.max(initial=0.0))


def _firm(total: Float) -> Float:
    """A basis (n, k) of what a matrix (n, n) that is not negative does not map to zero."""
    scale = np.sqrt(np.abs(np.diag(total)))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(total / np.outer(scale, scale))
    firm = values > 1e-12 * values.max(initial=0.0)  # below is rounding
    return vectors[:, firm] / scale[:, None]
