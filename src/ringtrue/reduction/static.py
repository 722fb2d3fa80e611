"""Static condensation of Guyan (1965) and component modes of Craig and Bampton (1968), over one
sparse factor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Any_, Float, FrozenArrays, Int, freeze_fields
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Factor, Labels, Pencil
from ringtrue.errors import ConfigError, InputError, SingularModel
from ringtrue.shapes import pseudo_inverse

CHUNK = 64  # right-hand sides solved at once
# relative eigenvalue of the flexibility at the channels below which two channels read the same
DEPENDENT = 1e-10
TamMethod = Literal["guyan", "irs", "serep", "hybrid"]


@dataclass(frozen=True, slots=True, eq=False)
class Condensed:
    """K and M over kept DOFs and fixed-interface modes.

    Attributes
    ----------
    stiffness, mass : (r, r) float64, symmetric
        r = b + n: the kept DOFs in the order given, then the modal coordinates.
    transform : (f, r) float64
        All DOFs by the reduced ones.
    kept : (b,) int64
        Rows of the full matrices.
    frequencies : (n,) float64, Hz
        Of the modes with the kept DOFs held; empty for Guyan.
    """

    stiffness: Float
    mass: Float
    transform: Float
    kept: Int
    frequencies: Float

    def __post_init__(self) -> None:
        floats = ("stiffness", "mass", "transform", "frequencies")
        freeze_fields(self, kept=np.int64, **dict.fromkeys(floats, np.float64))


def craig_bampton(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    boundary: Any_,
    count: int,
    *,
    labels: Labels | None = None,
) -> Condensed:
    """Condense onto the DOFs `boundary` and the `count` lowest modes with these held; with none
    the condensation of Guyan, exact in statics.

    Constraint modes Ψ = -K_ii⁻¹ K_ib and normal modes Φ of (K_ii, M_ii); u_i = Ψ u_b + Φ q.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    boundary : (b,) int, rows to keep
    count : int
        Modes, of unit modal mass; fewer where the mass has a lower rank.
    labels : callable, optional
        Names of rows for errors, (k,) int64 -> list of str.

    Raises
    ------
    InputError
        If a row is named twice, or absent, or the count is negative.
    SingularModel
        If the structure can move while `boundary` is held.
    """
    size = int(stiffness.shape[0])
    kept = _rows(boundary, size)
    if count < 0:
        raise InputError(f"{count} modes asked for; at least 0")
    inner = np.setdiff1d(np.arange(size), kept)
    transform = np.zeros((size, kept.size))
    transform[kept, np.arange(kept.size)] = 1.0
    frequencies = np.zeros(0)
    if inner.size:
        K, M = (sparse.csr_array(A)[inner][:, inner] for A in (stiffness, mass))
        names: Labels | None = (
            (lambda rows: labels(inner[rows])) if labels is not None else None
        )
        pencil = Pencil(K, M, labels=names)
        try:
            transform[inner] = _constraint_modes(
                pencil, sparse.csr_array(stiffness)[inner][:, kept]
            )
            if count:
                modes = solve_modes(pencil, count)
                frequencies = modes.frequencies
                normal = np.zeros((size, modes.values.size))
                normal[inner] = modes.vectors
                transform = np.concatenate([transform, normal], axis=1)
        except SingularModel as e:
            why = "it can move while the kept DOFs are held: keep one of these, too"
            raise SingularModel(e.dofs, why) from e
        finally:
            pencil.close()
    k, m = (transform.T @ (A @ transform) for A in (stiffness, mass))
    return Condensed((k + k.T) / 2, (m + m.T) / 2, transform, kept, frequencies)


def _rows(rows: Any_, size: int) -> Int:
    out = np.atleast_1d(np.asarray(rows, dtype=np.int64))
    if out.size and (out.min() < 0 or out.max() >= size):
        raise InputError(
            f"row {out[(out < 0) | (out >= size)][0]} is to be kept; allowed are 0 to {size - 1}"
        )
    if np.unique(out).size != out.size:
        raise InputError("a row to be kept is named twice")
    return out


def _constraint_modes(pencil: Pencil, K_ib: sparse.csr_array) -> Float:
    """-K_ii⁻¹ K_ib, a few columns at a time (K_ib is sparse, its dense copy need not exist at
    once).
    """
    factor = pencil.at(0.0)
    out = np.zeros(K_ib.shape)
    columns = K_ib.tocsc()
    for first in range(0, K_ib.shape[1], CHUNK):  # of right-hand sides
        block = slice(first, first + CHUNK)
        out[:, block] = -factor.solve(columns[:, block].toarray()).reshape(
            K_ib.shape[0], -1
        )
    return out


@dataclass(frozen=True, slots=True, eq=False)
class TestAnalysisModel(FrozenArrays):
    """A model reduced to the channels of a test.

    Attributes
    ----------
    method : str
    mass, stiffness : (channel, channel) float64, symmetric
    transform : (f, channel) float64
        All DOFs by the readings.
    """

    method: str
    mass: Float
    stiffness: Float
    transform: Float

    __test__ = False  # not a pytest class

    @property
    def frequencies(self) -> Float:
        """Hz, ascending, of the reduced model; a SEREP mass has as many as its modes."""
        s, u = linalg.eigh(self.mass)
        keep = s > 1e-9 * s[-1]
        u = u[:, keep] / np.sqrt(s[keep])
        lam = linalg.eigvalsh(u.T @ self.stiffness @ u)
        return np.sign(lam) * np.sqrt(np.abs(lam)) / (2 * np.pi)


class StaticShapes:
    """The motions of least strain energy with given readings: T = A⁻¹Cᵀ(CA⁻¹Cᵀ)⁻¹, A = K + αCᵀC.

    With all readings given, αCᵀC adds the same energy to every candidate and changes nothing; it
    makes A definite for a structure without supports. With sensors on DOFs this is Guyan's
    transform.

    Parameters
    ----------
    stiffness : (f, f) scipy.sparse.csr_array float64
    observe : (channel, f) scipy.sparse.csr_array float64
    labels : callable, optional
        Names of rows for errors, (k,) int64 -> list of str.

    Raises
    ------
    InputError
        If the sizes differ or two channels read the same.
    SingularModel
        If the structure can move without a reading.
    """

    def __init__(
        self,
        stiffness: sparse.csr_array,
        observe: sparse.csr_array,
        *,
        labels: Labels | None = None,
    ) -> None:
        self.observe = sparse.csr_array(observe)
        if self.observe.shape[1] != stiffness.shape[0] or not self.observe.shape[0]:
            raise InputError(
                f"observation {self.observe.shape} for a model of {stiffness.shape[0]} rows"
            )
        self._pencil = Pencil(*_held(stiffness, self.observe), labels=labels)
        self.factor: Factor = self._pencil.at(0.0)
        self.flexible = self.solve(self.observe.T.toarray())  # A⁻¹Cᵀ
        flexibility = self.observe @ self.flexible
        values, vectors = linalg.eigh((flexibility + flexibility.T) / 2)
        size = np.abs(values)  # a dynamic stiffness may be indefinite
        if size.min() <= DEPENDENT * size.max():
            i = int(np.argmax(np.abs(vectors[:, np.argmin(size)])))
            raise InputError(
                f"channel {i} (from 0) reads what others read already; leave it out of the "
                "reduced model"
            )
        self._inverse = (vectors / values) @ vectors.T
        self.transform = np.asarray(self.flexible @ self._inverse)

    def solve(self, load: Float) -> Float:
        """A⁻¹ load, (f, k)."""
        parts = [
            self.factor.solve(load[:, s : s + CHUNK]).reshape(load.shape[0], -1)
            for s in range(0, load.shape[1], CHUNK)
        ]
        return np.concatenate(parts, axis=1) if parts else np.zeros(load.shape)

    def held(self, load: Float) -> Float:
        """The motion (f, k) under `load` with all readings held at zero."""
        free = self.solve(load)
        return free - self.transform @ (self.observe @ free)

    def close(self) -> None:
        """Free the factor."""
        self._pencil.close()


def _held(
    stiffness: sparse.csr_array, observe: sparse.csr_array
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """K + αCᵀC with α of the size of K's diagonal, and a zero mass."""
    gram = sparse.csr_array(observe.T @ observe)
    alpha = float(
        np.median(np.abs(stiffness.diagonal()[gram.diagonal() > 0]))
    ) or float(np.abs(stiffness.data).max())
    alpha /= float(gram.diagonal().max())
    return sparse.csr_array(stiffness + alpha * gram), sparse.csr_array(
        stiffness.shape, dtype=np.float64
    )


def select(rows: Any_, size: int) -> sparse.csr_array:
    """The observation (channel, size) of channels that sit on the rows (channel,) int."""
    at = np.asarray(rows, dtype=np.int64)
    if (
        at.ndim != 1
        or (at.size and (at.min() < 0 or at.max() >= size))
        or np.unique(at).size != at.size
    ):
        raise InputError(
            f"rows {at.tolist()[:8]}: must be different rows of a model of {size}"
        )
    ones = (np.ones(at.size), (np.arange(at.size), at))
    return sparse.csr_array(sparse.coo_array(ones, shape=(at.size, size)))


def tam(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    observe: sparse.csr_array,
    method: TamMethod = "guyan",
    *,
    modes: Float | None = None,
    labels: Labels | None = None,
) -> TestAnalysisModel:
    """The mass and stiffness of a model at the channels.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    observe : (channel, f) scipy.sparse.csr_array float64
        Reading of each channel; `select` for sensors on DOFs.
    method : {"guyan", "irs", "serep", "hybrid"}
        "guyan": static shapes; wrong where inertia between the sensors counts. "irs": with the
        inertia of the static model, to first order. "serep": exact for `modes` and blind to all
        else. "hybrid": exact for `modes`, static for what lies outside of their span.
    modes : (f, m) float64, mass-normalised
        Needed by "serep" and "hybrid", m <= channels.
    labels : callable, optional
        Names of rows for errors.

    Raises
    ------
    ConfigError
        Without the modes it needs.
    InputError
        If the channels cannot distinguish the modes, or read the same.
    """
    if modes is None and method in ("serep", "hybrid"):
        raise ConfigError(
            f"a {method} test-analysis model needs the modes of the model"
        )
    observe = sparse.csr_array(observe)
    if method == "serep" and modes is not None:
        return _test_analysis_model(
            method, modes @ pseudo_inverse(observe @ modes), stiffness, mass
        )
    static = StaticShapes(stiffness, observe, labels=labels)
    try:
        transform = static.transform
        if method == "irs":
            # T + S M T M_r⁻¹K_r, where S is the flexibility with the readings held
            inertia = mass @ transform
            m = transform.T @ inertia
            k = transform.T @ (stiffness @ transform)
            change = static.held(inertia) @ linalg.solve(m, k, assume_a="sym")
            transform = np.asarray(transform + change)
        if method == "hybrid" and modes is not None:
            seen = observe @ modes
            transform = transform + (modes - transform @ seen) @ pseudo_inverse(seen)
    finally:
        static.close()
    return _test_analysis_model(method, transform, stiffness, mass)


def _test_analysis_model(
    method: str, transform: Float, stiffness: sparse.csr_array, mass: sparse.csr_array
) -> TestAnalysisModel:
    k, m = (transform.T @ (x @ transform) for x in (stiffness, mass))
    return TestAnalysisModel(method, (m + m.T) / 2, (k + k.T) / 2, transform)


def readings_kept(observe: sparse.csr_array) -> sparse.csr_array:
    """S (f, f) of u = S [z, y]: the readings y = Cu in place of as many degrees of freedom, the
    others z kept.

    Of the degrees of freedom that the channels read, those that a pivoted QR takes first are
    expressed by the readings and the rest: sensors may be skewed or read several nodes, and SᵀKS
    stays sparse.

    Parameters
    ----------
    observe : (channel, f) scipy.sparse.csr_array float64

    Raises
    ------
    InputError
        If two channels read the same, or one reads nothing.
    """
    observe = sparse.csr_array(observe)
    c, f = observe.shape
    read = np.unique(observe.nonzero()[1])
    dense = observe[:, read].toarray()
    _, r, pivot = linalg.qr(dense, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    if read.size < c or size[-1] <= DEPENDENT * size[0]:
        raise InputError(
            f"{c} channels: at least one reads what others read already, or nothing"
        )
    gone = read[pivot[:c]]
    left = read[pivot[c:]]
    inverse = np.linalg.inv(dense[:, pivot[:c]])  # well conditioned by the pivots
    kept = np.setdiff1d(np.arange(f), gone)
    place = np.searchsorted(kept, left)
    values = [np.ones(kept.size)]
    rows = [kept]
    columns = [np.arange(kept.size)]
    for block, at in (
        (-inverse @ dense[:, pivot[c:]], place),
        (inverse, kept.size + np.arange(c)),
    ):
        i, j = np.nonzero(block)
        values = [*values, block[i, j]]
        rows = [*rows, gone[i]]
        columns = [*columns, at[j]]
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(entries, shape=(f, f)))


def craig_bampton_of(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    observe: sparse.csr_array,
    count: int,
) -> Condensed:
    """The Craig-Bampton model of the readings of sensors anywhere, and of `count` modes with all
    readings held.

    Its kept coordinates are the readings in the order of the channels (`transform` is over
    `readings_kept`).

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    observe : (channel, f) scipy.sparse.csr_array float64
    count : int

    Raises
    ------
    InputError
        If two channels read the same.
    """
    s = readings_kept(observe)
    c = observe.shape[0]
    k, m = (sparse.csr_array(s.T @ (x @ s)) for x in (stiffness, mass))
    return craig_bampton(k, m, np.arange(k.shape[0] - c, k.shape[0]), count)


def craig_bampton_coordinates(
    condensed: Condensed, shapes: Any_, frequencies: Float
) -> Any_:
    """Coordinates (b + n, m) in a Craig-Bampton model of shapes read at its kept DOFs.

    The modal coordinates that no sensor reads follow from the dynamics at each mode's own
    frequency: q = −(K_qq − ω²M_qq)⁻¹(K_qb − ω²M_qb) y. The cross-orthogonality over
    `condensed.mass` is then taken of these.

    Parameters
    ----------
    condensed : Condensed
        Of `craig_bampton_of`, or of `reduction.static.craig_bampton` with the DOFs of the sensors
        kept.
    shapes : (b, m) float64 or complex128
        In the order of `condensed.kept`.
    frequencies : (m,) float64, Hz

    Raises
    ------
    InputError
        If the sizes do not fit.
    """
    y = np.asarray(shapes)
    f = np.asarray(frequencies, dtype=np.float64)
    b = condensed.kept.size
    if y.shape != (b, f.size):
        raise InputError(
            f"shapes {y.shape} and frequencies {f.shape} for {b} kept DOFs"
        )
    lam = (2 * np.pi * f) ** 2
    load = condensed.stiffness[b:, :b] @ y - (condensed.mass[b:, :b] @ y) * lam
    own = (2 * np.pi * condensed.frequencies) ** 2
    gap = own[:, None] - lam[None, :]  # the modal blocks are diagonal: M_qq = 1
    near = np.abs(gap) < 1e-6 * np.maximum(own[:, None], lam[None, :])
    return np.concatenate([y, -np.where(near, 0.0, load / np.where(near, 1.0, gap))])
