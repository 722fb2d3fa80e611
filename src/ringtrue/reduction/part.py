"""A part reduced to some of its points, and what that does to its modes.

Sources: Guyan (1965); Craig and Bampton (1968); dynamic condensation at a frequency: Leung (1978),
Paz (1984).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.dofs import DofSet
from ringtrue.eigen.eigenpairs import eigenvalue, frequencies
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil, spectrum
from ringtrue.errors import ConfigError, InputError, did_you_mean
from ringtrue.fem.assembly import System
from ringtrue.fem.massless_rotations import without_massless_rotations
from ringtrue.model.model import Model
from ringtrue.reduction.static import Condensed, craig_bampton

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
            raise ConfigError("a frequency `at`, Hz, belongs to the method dynamic, which needs it")
        if self.modes is not None and self.method != "craig-bampton":
            raise ConfigError(f"{self.modes} modes: only craig-bampton has component modes")


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
    for node, direction in zip(points.node.tolist(), points.direction.tolist(), strict=True):
        here = np.flatnonzero(free.node == node)
        if direction:
            here = here[np.abs(free.direction[here]) == abs(direction)]
        if not here.size:
            name = DofSet(np.array([node]), np.array([direction])).labels()[0]
            raise InputError(f"keep {name}: it is not in the model, held, or moved by others")
        rows.append(here)
    found = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *rows]))
    return np.asarray(found[np.argsort(free.key[found])])


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
        if inside < part.frequencies.size or part.frequencies.size < count or count == most:
            size = kept.size + inside
            return Condensed(
                part.stiffness[:size, :size],
                part.mass[:size, :size],
                part.transform[:, :size],
                kept,
                part.frequencies[:inside],
            )
        count = min(2 * count, most)


def reduction_error(model: Model, system: System, part: Condensed, below: float) -> ReductionError:
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
    return np.asarray(vectors[:, firm] / scale[:, None])
