"""Derivatives of eigenvalues and mass-normalised eigenvectors with respect to parameters.

(K − λM) φ' = −(K' − λM' − λ'M) φ with φᵀMφ = 1: the part in the computed modes is modal
superposition, the rest (in their M-orthogonal complement) is iterated with the factor of K − σM
that the modes came from. Sources: Fox, Kapoor (1968); Nelson (1976); Alvin (1997, iteration on the
complement).

Motions as the mass sees them: restricted to the rows that have mass, with their inertia forces.

A motion is a row here: that is the column-major layout of the solvers. Long rows are summed in
tiles, which stay in the cache.

(K − λ_j M) z_j = r_j in the M-orthogonal complement of known modes, for many right-hand sides
and one factor.

With A = K − σM factorised and δ = λ_j − σ, the equation is (I − δ A⁻¹M) z = A⁻¹r. One space V
serves all columns: z = x + U y with x = A⁻¹r, U = A⁻¹MV and y from the Galerkin condition VᵀM(δz −
Vy) = 0, whose residual M(δz − Vy) is exact (full orthogonalisation, Saad 2003, ch. 6.4; shifted
systems: Frommer and Glässner 1998). V grows by the principal directions of δz − Vy over all columns
that are not done, no more of them than the tolerances ask for: inertia loads are smooth, so that
they are fewer than the columns. Residuals are estimated from sketches of the forces until all seem
to be small enough; those that are not so by far are then computed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import linalg, sparse
from scipy.linalg.blas import dgemm

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError, NotConverged

TILE = 1024


def tiles(length: int) -> Iterator[slice]:
    """Slices that cover the length."""
    for start in range(0, length, TILE):
        yield slice(start, start + TILE)


def add(x: Float, *terms: tuple[Float, Float]) -> None:
    """Add to x (k, f) products cᵀy of pairs c (l, k), y (l, f); all of whole rows (contiguous)."""
    for c, y in terms:
        if c.size and x.size:
            # in place: numpy skips the assignment to itself
            x[:] = dgemm(1.0, y.T, c, 1.0, x.T, overwrite_c=True).T


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Motions (k, r) as two arrays with xMyᵀ = x.plain y.loadedᵀ.

    One and the same array, scaled by the root of the mass, where the mass is diagonal.
    """

    plain: Float
    loaded: Float

    @property
    def count(self) -> int:
        """Number of motions."""
        return len(self.plain)

    def dot(self, other: Fields) -> Float:
        """xMyᵀ (k, l)."""
        return self.plain @ other.loaded.T

    def times(self, c: Float, out: Fields) -> None:
        """Write cᵀx (l, r) for c (k, l)."""
        np.matmul(c.T, self.plain, out=out.plain)
        if not self._one:
            np.matmul(c.T, self.loaded, out=out.loaded)

    def add(self, c: Float, other: Fields) -> None:
        """Add cᵀy to x."""
        add(self.plain, (c, other.plain))
        if not self._one:
            add(self.loaded, (c, other.loaded))

    def room(self, count: int) -> Fields:
        """So many like these, not filled: pages that are never written take no memory."""
        plain = np.empty((count, self.plain.shape[1]))
        return Fields(plain, plain if self._one else np.empty_like(plain))

    def cut(self, at: slice) -> Fields:
        """A view of some."""
        plain = self.plain[at]
        return Fields(plain, plain if self._one else self.loaded[at])

    @property
    def _one(self) -> bool:
        return self.loaded is self.plain


class Inertia:
    """The mass on the rows that have any.

    Parameters
    ----------
    mass : (f, f) csr_array
        Symmetric, positive semidefinite.
    """

    def __init__(self, mass: sparse.csr_array) -> None:
        self._size = int(mass.shape[0])
        self._rows = np.flatnonzero(abs(mass).sum(axis=1))
        m = mass.diagonal()[self._rows]
        diagonal = np.count_nonzero(mass.data) == self._rows.size and bool(
            (m > 0).all()
        )
        self._root = np.sqrt(m) if diagonal else None
        self._mass = sparse.csr_array(mass[self._rows][:, self._rows])
        self._weight = np.zeros(self._size)
        self._weight[self._rows] = 1.0 if self._root is None else self._root
        # of each row among those with mass
        self._place = np.zeros(self._size, dtype=np.int64)
        self._place[self._rows] = np.arange(self._rows.size)
        self._signs = np.random.default_rng(0).choice([-1.0, 1.0], self._rows.size)

    def fields(self, x: Float, out: Fields | None = None) -> Fields:
        """Of motions (k, f), in `out` if it is given."""
        if out is None:
            plain = np.empty((len(x), self._rows.size))
            out = Fields(
                plain, plain if self._root is not None else np.empty_like(plain)
            )
        # other modes go through a copy
        np.take(x, self._rows, axis=1, out=out.plain, mode="clip")
        if self._root is None:
            out.loaded[:] = (self._mass @ out.plain.T).T
        else:
            out.plain[:] *= self._root
        return out

    def forces(self, x: Fields) -> Float:
        """xM on all rows (k, f)."""
        if not self._rows.size:
            return np.zeros((x.count, self._size))
        out = np.take(x.loaded, self._place, axis=1)
        out *= self._weight
        return out

    def sketch(self, x: Fields) -> Float:
        """Forces (k, TILE), folded with random signs: norms and products are kept within about
        √(2/TILE).

        (Charikar, Chen and Farach-Colton 2002: a count sketch; its buckets are strides here.)
        """
        out = np.zeros((x.count, TILE))
        weight = self._signs if self._root is None else self._signs * self._root
        for t in tiles(self._rows.size):
            part = x.loaded[:, t] * weight[t]
            out[:, : part.shape[1]] += part
        return out

    def gram(
        self, x: Fields, at: Int, factor: Float, *terms: tuple[Float, Fields]
    ) -> Float:
        """Products of the forces of some of x, each times a factor, + Σ cᵀy."""
        out = np.zeros((at.size, at.size))
        for forces in self._forces(x, at, factor, *terms):
            out += forces @ forces.T
        return out

    def squares(
        self, x: Fields, at: Int, factor: Float, *terms: tuple[Float, Fields]
    ) -> Float:
        """Squared 2-norms of the same, the diagonal of `gram`."""
        out = np.zeros(at.size)
        for forces in self._forces(x, at, factor, *terms):
            out += np.einsum("ij,ij->i", forces, forces)
        return out

    def _forces(
        self, x: Fields, at: Int, factor: Float, *terms: tuple[Float, Fields]
    ) -> Iterator[Float]:
        for t in tiles(self._rows.size):
            forces = x.loaded[:, t][at] * factor[:, None]
            for c, y in terms:
                forces += c.T @ y.loaded[:, t]
            if self._root is not None:
                forces *= self._root[t]
            yield forces


# of the square allowed: an estimate below it is 8 standard deviations away
CERTAIN = 1 / (1 + 8 * (2 / TILE) ** 0.5)
# numbers in an array of right-hand sides: less than 32 MB is used again
PIECE = 5 * 2**19
# share of the largest eigenvalue of a projection that one below zero may have by rounding
NEGATIVE = 1e-5
EIGHT = 8  # of them that MKL takes at a time


@dataclass(frozen=True, slots=True)
class ComplementSettings:
    """How far the columns are solved.

    Attributes
    ----------
    runs : int
        At most; in a further run the columns that are left start anew.
    each, spare : int
        Directions of a run for each column, and beyond.
    drop : float
        Share of the residual allowed to a column that a block may leave out of it.
    inertia : float
        Residual allowed at most, in inertia forces of the solution without iteration.
    lowest : float
        Share of the residual allowed to which that lowers it: below is rounding.
    margin : float
        Share of the residual allowed, for one that is estimated.
    many : int
        Columns that pay for a factorisation at a better shift.
    """

    runs: int = 8
    each: int = 2
    spare: int = 60
    drop: float = 0.9
    inertia: float = 1e-4
    lowest: float = 1e-4
    margin: float = 0.93
    many: int = 400


SETTINGS = ComplementSettings()
_MORE = "compute more modes above those whose derivatives are needed"

Loads = Callable[[slice], Float]  # forces (k, f) of some columns


class _Space:
    """V, what A⁻¹M makes of it, and the projections VᵀMV and VᵀM A⁻¹M V.

    Parameters
    ----------
    like : Fields
        For their size.
    rows, known : int
        Numbers of rows and of known modes.
    room : int
        Most motions held.
    """

    def __init__(self, like: Fields, rows: int, known: int, room: int) -> None:
        self.room = room
        self._basis = like.room(room)
        self._inner = like.room(room)
        self._images = np.empty((room, rows))
        self._parts = np.empty((known, room))
        self._rough = np.empty((2, room, TILE))
        self.clear()

    def clear(self) -> None:
        """Hold nothing."""
        self.size = 0
        self.gram = np.zeros((0, 0))
        self.projected = np.zeros((0, 0))

    @property
    def basis(self) -> Fields:
        """V."""
        return self._basis.cut(slice(self.size))

    @property
    def inner(self) -> Fields:
        """A⁻¹MV in the complement."""
        return self._inner.cut(slice(self.size))

    @property
    def images(self) -> tuple[Float, Float]:
        """A⁻¹MV (k, f) as solved for, and its coefficients along the known modes (n, k)."""
        return self._images[: self.size], self._parts[:, : self.size]

    def next(self, count: int) -> Fields:
        """Where the next so many motions stand."""
        return self._basis.cut(slice(self.size, self.size + count))

    def add(self, v: Fields, of: Complement) -> None:
        """A further block, which has been written to `next`."""
        cut = slice(self.size, self.size + v.count)
        inner = self._inner.cut(cut)
        self._parts[:, cut] = of.solved(
            lambda c: of.inertia.forces(v.cut(c)), self._images[cut], inner
        )
        self._rough[:, cut] = of.inertia.sketch(inner), of.inertia.sketch(v)
        self.size += v.count
        self.gram = _bordered(self.gram, self.basis.dot(v))
        self.projected = _bordered(self.projected, self.basis.dot(inner))

    def sketch(self, y: Float, delta: Float) -> Float:
        """Forces of δUy − Vy, folded."""
        inner, basis = self._rough[:, : self.size]
        return np.asarray((y * delta).T @ inner - y.T @ basis)

    def change(self, y: Float, delta: Float) -> tuple[tuple[Float, Fields], ...]:
        """δUy − Vy as products cᵀf."""
        return (y * delta, self.inner), (-y, self.basis)

    def defect(
        self, x: Fields, at: Int, y: Float, delta: Float, turn: Float, out: Fields
    ) -> Fields:
        """Write δ(x + Uy) − Vy of the columns `at`, times `turn` (columns, r)."""
        first = np.zeros((x.count, turn.shape[1]))
        first[at] = delta[at, None] * turn
        x.times(first, out)
        for c, f in self.change(y[:, at], delta[at]):
            out.add(c @ turn, f)
        return out

    def coefficients(self, b: Float, delta: Float) -> Float:
        """y (k, c) of (G − δT) y = δb for each column.

        Raises
        ------
        NotConverged
            If the projection has a mode below one of the λ.
        """
        theta, turn = linalg.eigh(self.projected, self.gram, check_finite=False)
        if theta[-1] * delta.max() >= 1 or theta[0] < -NEGATIVE * theta[-1]:
            raise NotConverged(
                "a mode below one of those that are differentiated is not among those given; "
                f"{_MORE}"
            )
        return turn @ ((turn.T @ (b * delta)) / (1 - delta * theta[:, None]))


class Complement:
    """The complement of known modes.

    The factor that the modes came from serves if it is still there; if not, or for many right-hand
    sides, one amid the λ is made, which contracts faster.

    Parameters
    ----------
    pencil : Pencil
    modes : EigenModes
        All from the lowest up.
    lam : (k,) float64
        Where it will be solved for.
    columns : int
        Number of right-hand sides in all.
    """

    def __init__(
        self, pencil: Pencil, modes: EigenModes, lam: Float, columns: int
    ) -> None:
        there = pencil.shift == modes.shift and columns < SETTINGS.many
        self.shift = (
            modes.shift
            if there
            else _amid(modes.values, float(lam.max(initial=0.0)), modes.shift)
        )
        self.pencil = pencil
        self.modes = modes
        self.inertia = Inertia(pencil.mass)
        self._known = self.inertia.fields(modes.vectors.T)
        self._rooms: tuple[Fields, _Space] | None = None

    def columns(
        self,
        loads: Loads,
        lam: Float,
        allowed: Float,
        z: Float,
        along: Float | None = None,
    ) -> None:
        """Write `solve` to z (k, f) with the residuals allowed (k,), and add the modes times
        `along` (n, k).
        """
        at = np.arange(lam.size)
        allowed = allowed.copy()
        for run in range(SETTINGS.runs):
            if not at.size:
                return
            step = np.empty((at.size, self.pencil.size)) if run else z
            rest, left = self._run(
                loads,
                lam[at],
                allowed,
                which=at,
                along=None if run else along,
                z=step,
                first=not run,
            )
            if run:
                z[at] += step
            at = at[left]
            loads = partial(np.ndarray.__getitem__, rest)
        if at.size:
            raise NotConverged(
                f"{at.size} of {lam.size} right-hand sides did not converge; {_MORE}"
            )

    def solved(self, loads: Loads, x: Float, inner: Fields) -> Float:
        """Write x = A⁻¹ loads (k, f) and its fields in the complement; its coefficients along the
        modes (n, k).

        In pieces of like size: larger ones than PIECE would be mapped anew each time.
        """
        part = np.empty((self._known.count, len(x)))
        for cut in _pieces(len(x), max(PIECE // max(self.pencil.size, 1), 32)):
            x[cut] = self.pencil.at(self.shift).solve(loads(cut).T).T
            fields = self.inertia.fields(x[cut], inner.cut(cut))
            part[:, cut] = self._known.dot(fields)
            fields.add(-part[:, cut], self._known)
        return part

    def _room(self, columns: int) -> tuple[Fields, _Space]:
        """Memory for the fields of solutions and a space; that of the last call if it is large
        enough.
        """
        if self._rooms is None or self._rooms[0].count < columns:
            self._rooms = None
            space = _Space(
                self._known,
                self.pencil.size,
                self._known.count,
                SETTINGS.each * columns + SETTINGS.spare,
            )
            self._rooms = self._known.room(columns), space
        inner, space = self._rooms
        space.clear()
        return inner.cut(slice(columns)), space

    def _run(
        self,
        loads: Loads,
        lam: Float,
        limits: Float,
        which: Int,
        along: Float | None,
        z: Float,
        *,
        first: bool,
    ) -> tuple[Float, Int]:
        """Write the solution; forces that are left over in the columns not done, and which these
        are.

        The first run lowers the limits where the inertia of x is small against the loads: forces
        that move almost nothing, as those of nodes that move across a shell, would hide all that
        is left.
        """
        delta = lam - self.shift
        at = np.arange(lam.size)
        x, space = self._room(lam.size)
        part = self.solved(loads, z, x)
        y = np.zeros((0, lam.size))
        b = np.zeros((0, lam.size))
        folded = self.inertia.sketch(x)
        if first:
            inertia = np.linalg.norm(folded * delta[:, None], axis=1)
            limits[:] = np.clip(
                SETTINGS.inertia * inertia, SETTINGS.lowest * limits, limits
            )
        allowed = limits[which]
        while True:
            rough = folded[at] * delta[at, None] + space.sketch(y[:, at], delta[at])
            gram = rough @ rough.T
            limit = SETTINGS.margin * allowed[at]
            if (np.diag(gram) <= limit**2).all():
                at = at[~(np.diag(gram) <= CERTAIN * allowed[at] ** 2)]
                size = self.inertia.squares(
                    x, at, delta[at], *space.change(y[:, at], delta[at])
                )
                at = at[~(size <= allowed[at] ** 2)]
                gram = self.inertia.gram(
                    x, at, delta[at], *space.change(y[:, at], delta[at])
                )
                limit = allowed[at]
            turn = _principal(gram, limit)
            if not at.size or space.size + turn.shape[1] > space.room:
                break
            v = space.defect(x, at, y, delta, turn, space.next(turn.shape[1]))
            space.add(v, self)
            b = np.vstack([b, v.dot(x)])
            y = np.vstack([y, np.zeros((v.count, lam.size))])
            y[:, at] = space.coefficients(b[:, at], delta[at])
        images, parts = space.images
        more = -part - parts @ y if along is None else along - part - parts @ y
        add(z, (y, images), (more, self.modes.vectors.T))
        return self.inertia.forces(
            space.defect(x, at, y, delta, np.eye(at.size), x.room(at.size))
        ), at


def _principal(gram: Float, allowed: Float) -> Float:
    """Coefficients (k, r) of the directions that columns of residual forces with this Gram matrix
    need most.

    As few as leave at most `drop` of the residual that is allowed to each column.
    """
    s, u = np.linalg.eigh(gram / allowed / allowed[:, None])
    s = s[::-1].clip(min=0)
    u = u[:, ::-1]
    left = np.sqrt(np.cumsum((s * u * u)[:, ::-1], axis=1)).max(axis=0, initial=0.0)[
        ::-1
    ]
    rank = int((left > SETTINGS.drop).sum())
    return np.asarray(u[:, :rank] / np.sqrt(s[:rank]) / allowed[:, None])


def _pieces(count: int, most: int) -> Iterator[slice]:
    """Slices of like size, a multiple of EIGHT, that are about `most` at most and cover the
    count.
    """
    step = EIGHT * -(-count // (EIGHT * max(-(-count // most), 1)))
    for start in range(0, count, max(step, 1)):
        yield slice(start, min(start + step, count))


def _bordered(old: Float, new: Float) -> Float:
    """A symmetric matrix with further columns (k, r), and with them its further rows."""
    k = len(old)
    corner = new[len(old) :]
    return np.block([[old, new[:k]], [new[:k].T, (corner + corner.T) / 2]])


def _amid(values: Float, top: float, default: float) -> float:
    """The middle of the widest gap between the eigenvalues near a third of `top`."""
    marks = np.unique(np.clip(values, 0.0, None))
    middle = (marks[1:] + marks[:-1]) / 2
    width = np.diff(marks)
    fair = np.abs(middle - top / 3) < top / 5
    return float(middle[fair][np.argmax(width[fair])]) if fair.any() else default


# relative distance under which eigenvalues are treated as one repeated root
CLOSE = 1e-6
# right-hand sides solved together: more save few solves and cost products
COLUMNS = 320
ROOM = 2**24  # numbers in an array of them, which lessens them in large models
STILL = 1e-9  # share of its terms under which the load of a rigid-body mode is rounding


@dataclass(frozen=True, slots=True, eq=False)
class MatrixDerivatives:
    """K' and M' of one parameter, and D' of viscous damping if there is any; (f, f) csr_array.

    `transform` is T', (full, f), of the motions u = T q of all DOFs, where the parameter moves
    nodes such that T moves.
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    viscous: sparse.csr_array | None = None
    transform: sparse.csr_array | None = None


def groups(values: Float, scale: float | None = None) -> Int:
    """(m,) int64, equal for eigenvalues (ascending) that are repeated within `CLOSE`; rigid-body
    modes are one.

    Differences below 1e-9 of `scale`, the largest if not given, are noise.
    """
    noise = 1e-9 * (np.abs(values).max(initial=0.0) if scale is None else scale)
    separate = np.diff(values) > np.maximum(CLOSE * np.abs(values[1:]), noise)
    return np.concatenate([np.zeros(min(values.size, 1)), np.cumsum(separate)]).astype(
        np.int64
    )


def _product(a: sparse.csr_array, phi: Float) -> tuple[Int, Float]:
    """The rows of a that are not empty, and a times phi (f, m), row-major, on them."""
    rows = np.flatnonzero(np.diff(a.indptr))
    ends = np.append(a.indptr[rows], a.nnz).astype(a.indptr.dtype)
    full = sparse.csr_array((a.data, a.indices, ends), shape=(rows.size, a.shape[1]))
    return rows, np.asarray(full @ phi)


def modal_coefficients(
    stiffness: Float, mass: Float, values: Float, *, low: int = 0
) -> Float:
    """Coefficients C of φ' = Φ C in a complete modal basis.

    Parameters
    ----------
    stiffness, mass : (..., n, m) float64
        Φᵀ K' Φ_m and Φᵀ M' Φ_m for all n modes and the m lowest of them.
    values : (n,) float64, ascending
    low : int
        Modes that must be distinct whatever is above them; 0: m.

    Returns
    -------
    c : (..., n, m) float64
        In a group of repeated roots −½ΦᵀM'Φ: normalisation is kept and the rotation inside the
        group is zero.
    """
    m = stiffness.shape[-1]
    scale = float(np.abs(values[: low or m]).max(initial=0.0))
    # motions almost without mass, as of a bearing's light node, must not set the noise of the low
    # modes
    at = groups(np.minimum(values, 1e4 * scale), scale)
    same = at[:, None] == at[:m]
    gap = np.where(same, 1.0, values[:m] - values[:, None])
    return np.where(same, -0.5 * mass, (stiffness - mass * values[:m]) / gap)


def eigenvector_derivatives(
    pencil: Pencil,
    modes: EigenModes,
    slopes: Sequence[MatrixDerivatives],
    *,
    count: int | None = None,
    tolerance: float = 1e-7,
    progress: Progress = quiet,
) -> Float:
    """∂φ/∂a (f, count, p) of the lowest `count` mass-normalised modes.

    Parameters
    ----------
    pencil : Pencil
        Of the modes.
    modes : EigenModes
        ALL modes from the lowest up; the more there are above `count`, the faster it converges.
    slopes : sequence of MatrixDerivatives
    count : int, optional
        All if not given.
    tolerance : float
        Relative residual ‖(K − λM)φ' + (K' − λM')φ − λ'Mφ‖ / ‖(K' − λM')φ‖.
    progress : callable (fraction, text)

    Raises
    ------
    InputError
        If more modes are asked for than are given.
    NotConverged
        If a mode below the last one is not given, or one above lies too close. Give more modes.
    """
    n = modes.values.size
    m = n if count is None else count
    if m > n:
        raise InputError(f"derivatives of {m} modes asked for; {n} are given")
    phi = np.ascontiguousarray(modes.vectors)
    lam = modes.values
    space = Complement(pencil, modes, lam[:m], m * len(slopes))
    columns = min(max(ROOM // max(pencil.size, 1), 30), COLUMNS)
    runs = -(-len(slopes) // max(columns // max(m, 1), 1))
    # of like size: a small last one costs as many products
    per = -(-len(slopes) // max(runs, 1)) or 1
    out = np.empty((len(slopes), m, pencil.size))
    rows = out.reshape(-1, pencil.size)
    for start in range(0, len(slopes), per):
        loads = [_Load.of(s, phi, lam, m) for s in slopes[start : start + per]]
        owner, mode = np.nonzero([load.live for load in loads])
        for first in range(0, owner.size, columns):
            of = owner[first : first + columns]
            j = mode[first : first + columns]
            place = (start + of) * m + j
            _write(
                space,
                loads,
                of,
                mode=j,
                tolerance=tolerance,
                out=rows[place[0] : place[0] + place.size],
            )
            _spread(rows, place)
        for i, load in enumerate(loads, start):
            still = np.flatnonzero(~load.live)
            out[i, still] = (phi @ load.along[:, still]).T
        progress(min((start + per) / len(slopes), 1.0), "eigenvector derivatives")
    return out.transpose(2, 1, 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Load:
    """λM'φ − K'φ of the modes for one parameter, on the rows where it is not zero.

    Attributes
    ----------
    rows : (r,) int64
    force : (r, m) float64
    along : (n, m) float64
        The part of φ' in the modes.
    live : (m,) bool
        False where there is no load but rounding: rigid-body modes that stay such.
    """

    rows: Int
    force: Float
    along: Float
    live: Bool

    @classmethod
    def of(cls, s: MatrixDerivatives, phi: Float, lam: Float, m: int) -> _Load:
        """Of a slope; phi (f, n) row-major."""
        (rk, dk), (rm, dm) = (_product(a, phi[:, :m]) for a in (s.stiffness, s.mass))
        pk = phi[rk].T @ dk
        pm = phi[rm].T @ dm
        rows = np.union1d(rk, rm)
        force = np.zeros((rows.size, m))
        force[np.searchsorted(rows, rm)] = dm * lam[:m]
        force[np.searchsorted(rows, rk)] -= dk
        size = np.linalg.norm(force, axis=0)
        live = size > 0
        rigid = np.flatnonzero(np.abs(lam[:m]) <= STILL * np.abs(lam).max(initial=0.0))
        if rigid.size:
            terms = np.linalg.norm(
                _product(abs(s.stiffness), np.abs(phi[:, rigid]))[1], axis=0
            )
            terms += np.abs(lam).max() * np.linalg.norm(dm[:, rigid], axis=0)
            live[rigid] &= size[rigid] > STILL * terms
        return cls(rows, force, modal_coefficients(pk, pm, lam), live)


def _spread(rows: Float, at: Int) -> None:
    """Move what stands in rows from at[0] on, without gaps, to `at` (ascending)."""
    ends = np.flatnonzero(np.diff(at, append=-1) != 1) + 1
    # runs between gaps, the last one first
    for a, b in zip(np.append(0, ends[:-1])[::-1], ends[::-1], strict=True):
        if at[a] != at[0] + a:
            rows[at[a] : at[a] + b - a] = rows[at[0] + a : at[0] + b]


def _write(
    space: Complement,
    loads: Sequence[_Load],
    owner: Int,
    mode: Int,
    tolerance: float,
    out: Float,
) -> None:
    """Write φ' (k, f) for pairs of a load and a mode; those of a load stand side by side."""
    pairs = list(zip(owner.tolist(), mode.tolist(), strict=True))
    along = np.stack([loads[i].along[:, j] for i, j in pairs], axis=1)
    size = np.array([np.linalg.norm(loads[i].force[:, j]) for i, j in pairs])

    def forces(c: slice) -> Float:
        r = np.zeros((owner[c].size, space.pencil.size))
        for i in np.unique(owner[c]).tolist():
            at = np.flatnonzero(owner[c] == i)
            r[at[0] : at[-1] + 1, loads[i].rows] += loads[i].force[:, mode[c][at]].T
        return r

    space.columns(forces, space.modes.values[mode], tolerance * size, out, along)
