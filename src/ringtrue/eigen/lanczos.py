"""Block shift-invert Lanczos with full reorthogonalisation and thick restart.

Sources: Grimes, Lewis, Simon (1994) block shift-invert and inertia counts; Wu, Simon (2000) thick
restart; Nour-Omid, Parlett, Ericsson, Jensen (1987) purification for a singular mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float
from ringtrue.core.iterate import Progress, quiet
from ringtrue.eigen import memory
from ringtrue.eigen.pencil import (
    Factor,
    Labels,
    Pencil,
    named_rows,
    refuse_negative_motion,
)
from ringtrue.errors import NotConverged

# a solve of eight right-hand sides takes MKL 1.3 times that of four (rslab: 1.2 times)
BLOCK = 8


@dataclass(frozen=True, slots=True)
class LanczosSettings:
    """When pairs have converged, and what keeps the basis orthogonal.

    Attributes
    ----------
    tolerance : float
        Error of a Ritz pair in the M norm, relative to θ; purification squares what is left.
    well : float
        Inverse condition of a block's Gram matrix, below which two Cholesky factorisations
        orthonormalise it.
    cancelled : float
        Share of a block that its other columns leave of one, below which it is made orthogonal
        again.
    steps : int
        Blocks at most.
    patience : int
        Restarts without a further pair: more roots stand close together than the basis holds.
    grown : float
        Of a basis vector, in motions that the mass does not see: left out before they overflow.
    """

    tolerance: float = 1e-9
    well: float = 1e-8
    cancelled: float = 1e-4
    steps: int = 1000
    patience: int = 5
    grown: float = 1e40


LANCZOS = LanczosSettings()

ROWS = 8192  # of the basis that are turned at once


@dataclass(frozen=True, slots=True, eq=False)
class RitzPairs:
    """Converged pairs of (K − σM)⁻¹M: θ = 1/(λ − σ), largest |θ| first.

    Attributes
    ----------
    theta : (k,) float64
    vectors : (f, k) float64, M-orthonormal, purified
    exhausted : bool
        The Krylov space filled the range of the operator: there are no further modes.
    """

    theta: Float
    vectors: Float
    exhausted: bool


class Krylov:
    """A growing M-orthonormal basis V with OP·V = V·T + Q·R·Eᵀ, kept exact in all components.

    Parameters
    ----------
    factor : Factor
        Of K − σM.
    mass : (f, f) csr_array
    capacity : int
        Most basis vectors held.
    rng : Generator
        For start vectors.
    labels : callable, optional
        Names of rows for errors.
    """

    def __init__(
        self,
        factor: Factor,
        mass: sparse.csr_array,
        capacity: int,
        rng: np.random.Generator,
        labels: Labels = named_rows,
    ) -> None:
        self.factor = factor
        self.mass = mass
        self.rng = rng
        self.labels = labels
        rows = int(mass.shape[0])
        self.capacity = capacity
        self.basis = np.zeros((rows, capacity + 2 * BLOCK), order="F")
        self.projected = np.zeros((capacity + 2 * BLOCK,) * 2)
        self.held = 0  # columns of V; the block Q stands right behind them
        self.ahead = 0  # columns of Q
        self.loaded = np.zeros((rows, 0))  # M Q
        self.coupling = np.zeros((0, 0))  # R: (ahead, last block)
        self.massless = np.flatnonzero(mass.diagonal() == 0)

    def start(self, locked: Float, theta: Float) -> None:
        """Begin with a random block orthogonal to the converged vectors `locked` (f, k)."""
        k = theta.size
        self.basis[:, :k] = locked
        self.held = k
        self.projected[:] = 0
        self.projected[:k, :k] = np.diag(theta)
        self.coupling = np.zeros((0, 0))
        self.ahead = 0
        self._append(np.zeros((self.basis.shape[0], 0)), 0.0)

    def _orthogonalise(
        self, w: Float, count: int, first: int = 0
    ) -> tuple[Float, Float]:
        """w minus its part in the first `count` columns, and the coefficients; twice is enough
        (Kahan).

        The first time without the columns before `first`, where w has no part but rounding.
        """
        total = np.zeros((count, w.shape[1]))
        for start in (first, 0):
            v = self.basis[:, start:count]
            c = v.T @ (self.mass @ w)
            w = w - v @ c
            total[start:] += c
        return w, total

    def _norms(self, w: Float) -> Float:
        return np.asarray(np.sqrt(np.abs(np.einsum("ij,ij->j", w, self.mass @ w))))

    def _append(self, w: Float, floor: float) -> Float:
        """Put an M-orthonormal basis of w behind V; returns R with w = Q·R. Directions below
        `floor` are roundoff: random ones, decoupled (zero rows of R), take their place until the
        space is exhausted.
        """
        q, mq, r = self._orthonormal(w, floor)
        left = np.linalg.norm(r, axis=1)
        # what rounding left of V grew with the rest
        if left.size and left.min() < LANCZOS.cancelled * left.max():
            q, mq, again = self._orthonormal(self._orthogonalise(q, self.held)[0], 0.0)
            r = again @ r
        if np.abs(q).max(initial=0.0) > LANCZOS.grown:
            q[self.massless] = 0.0
        missing = BLOCK - q.shape[1]
        self._put(q, self.held)
        self.ahead = q.shape[1]
        if missing:
            x = self.rng.standard_normal((self.basis.shape[0], missing))
            x = self.factor.solve(
                self.mass @ self._orthogonalise(x, self.held + self.ahead)[0]
            )
            x = x / np.maximum(self._norms(x), np.finfo(float).tiny)
            x = self._orthogonalise(x, self.held + self.ahead)[0]
            q = self._orthonormal(x, 1e-10)[0]
            # what is left of x may be small
            q = self._orthogonalise(q, self.held + self.ahead)[0]
            q, mx, _ = self._orthonormal(q, 0.0)
            self._put(q, self.held + self.ahead)
            mq = np.hstack([mq, mx])
            self.ahead += q.shape[1]
            r = np.vstack([r, np.zeros((q.shape[1], r.shape[1]))])
        self.loaded = mq
        return r

    def _put(self, q: Float, at: int) -> None:
        self.basis[:, at : at + q.shape[1]] = q

    def _orthonormal(self, w: Float, floor: float) -> tuple[Float, Float, Float]:
        """Gram-Schmidt in the block, in M, each column twice: q, M q and R with w = q R but for
        norms below `floor`.
        """
        mw = self.mass @ w
        quick = _cholesky_twice(w, mw, floor)
        if quick is not None:
            return quick
        q = np.zeros((w.shape[0], 0))
        mq = np.zeros((w.shape[0], 0))
        r = np.zeros((w.shape[1], w.shape[1]))
        for j in range(w.shape[1]):  # at most BLOCK columns
            x = w[:, j]
            mx = mw[:, j]
            rank = q.shape[1]
            for _ in range(2):
                c = q.T @ mx
                x = x - q @ c
                mx = mx - mq @ c
                r[:rank, j] += c
            size = float(np.sqrt(abs(x @ mx)))
            if size > floor:
                # a block spans such a direction as soon as the problem has one that moves
                if x @ mx < 0:
                    refuse_negative_motion(self.mass, x, self.labels)
                r[rank, j] = size
                q = np.column_stack([q, x / size])
                mq = np.column_stack([mq, mx / size])
        return q, mq, r[: q.shape[1]]

    def step(self) -> None:
        """One block: V grows by Q, a new Q is made."""
        k = self.held
        b = self.ahead
        w = self.factor.solve(self.loaded)
        w, c = self._orthogonalise(w, k + b, k - self.coupling.shape[1])
        floor = 1e-13 * float(np.linalg.norm(c, axis=0).max(initial=0.0))
        self.projected[: k + b, k : k + b] = c
        self.projected[k : k + b, :k] = c[:k].T
        self.held = k + b
        self.coupling = self._append(w, floor)

    def grow(self) -> None:
        """Room for twice as many basis vectors."""
        rows = self.basis.shape[0]
        n = self.held + self.ahead
        self.capacity = min(2 * self.capacity, rows)
        memory.require(
            8 * rows * self.capacity,
            f"the basis of {self.capacity} vectors of {rows} DOFs",
        )
        basis = np.zeros((rows, self.capacity + 2 * BLOCK), order="F")
        projected = self.projected[:n, :n]
        basis[:, :n], self.basis = self.basis[:, :n], basis
        self.projected = np.zeros((basis.shape[1],) * 2)
        self.projected[:n, :n] = projected

    def ritz(self) -> tuple[Float, Float, Float]:
        """θ (k,) largest modulus first, y (k, k), error ‖R y_last‖ (k,)."""
        t = self.projected[: self.held, : self.held]
        theta, y = linalg.eigh((t + t.T) / 2, check_finite=False)
        order = np.argsort(-np.abs(theta), kind="stable")
        theta = theta[order]
        y = y[:, order]
        last = self.coupling.shape[1]
        return theta, y, np.linalg.norm(self.coupling @ y[self.held - last :], axis=0)

    def vectors(self, theta: Float, y: Float) -> Float:
        """Purified Ritz vectors OP·V·y/θ, from the recurrence: no further solve."""
        last = self.coupling.shape[1]
        n = self.held + self.coupling.shape[0]
        both = np.vstack([y, self.coupling @ y[self.held - last :] / theta])
        return self.basis[:, :n] @ both

    def restart(self, keep: int) -> None:
        """Thick restart: V becomes its best `keep` Ritz vectors; Q stays."""
        theta, y, _ = self.ritz()
        last = self.coupling.shape[1]
        n = self.held
        q = self.basis[:, n : n + self.ahead].copy()
        self.coupling = self.coupling @ y[n - last :, :keep]
        # a piece at a time: what is made of all is as large as the basis
        for first in range(0, len(self.basis), ROWS):
            piece = self.basis[first : first + ROWS]
            piece[:, :keep] = piece[:, :n] @ y[:, :keep]
        self.basis[:, keep : keep + self.ahead] = q
        self.projected[:] = 0
        self.projected[:keep, :keep] = np.diag(theta[:keep])
        self.held = keep


def _cholesky_twice(
    w: Float, mw: Float, floor: float
) -> tuple[Float, Float, Float] | None:
    """q, M q, R with w = q R by two Cholesky factorisations of the Gram matrix; None if w is not
    far from singular.
    """
    q = w
    mq = mw
    r = np.eye(w.shape[1])
    for first in (True, False):
        gram = q.T @ mq
        gram = (gram + gram.T) / 2
        size = np.sqrt(np.abs(np.diag(gram)))
        if first and (not w.shape[1] or size.min() <= max(floor, 1e-8 * size.max())):
            return None
        values = np.linalg.eigvalsh(gram / (size * size[:, None]))
        if values[0] < LANCZOS.well * values[-1]:
            return None
        upper = np.linalg.cholesky(gram).T
        turn = linalg.solve_triangular(upper, np.eye(size.size))
        q = q @ turn
        mq = mq @ turn
        r = upper @ r
    if floor > 0 and np.abs(np.diag(r)).min() <= floor:
        return None
    return q, mq, r


def begin(
    factor: Factor,
    pencil: Pencil,
    expected: int,
    locked: tuple[Float, Float] | None = None,
) -> Krylov:
    """A space for about so many pairs besides the locked ones, and its start block.

    Parameters
    ----------
    factor : Factor
        Of K − σM.
    pencil : Pencil
    expected : int
        Sets the size of the basis.
    locked : (theta (k,), vectors (f, k)), optional
        Pairs known already; the start block is orthogonal to them.
    """
    theta, vectors = locked or (np.zeros(0), np.zeros((pencil.size, 0)))
    krylov = Krylov(
        factor,
        pencil.mass,
        capacity(pencil.size, expected, theta.size),
        rng=np.random.default_rng(theta.size),
        labels=pencil.labels,
    )
    krylov.start(vectors, theta)
    return krylov


def solve(
    krylov: Krylov,
    enough: Callable[[Float], bool],
    *,
    expected: int,
    known: int = 0,
    progress: Progress = quiet,
) -> RitzPairs:
    """Pairs of the largest |θ|, until `enough(theta)` holds for the leading converged ones.

    Parameters
    ----------
    krylov : Krylov
        A space that was begun.
    enough : callable
        Takes the converged leading θ (k,), says whether they suffice.
    expected : int
        About how many pairs are found besides those that are known.
    known : int
        Pairs that were locked.

    Raises
    ------
    NumericalError
        If the mass is negative in some direction.
    NotConverged
        After `LANCZOS.steps` blocks.
    """
    rows = int(krylov.mass.shape[0])
    idle = 0
    before = 0
    for step in range(LANCZOS.steps):
        if not krylov.ahead:
            return _pairs(krylov, krylov.held, exhausted=True)
        krylov.step()
        exhausted = krylov.ahead == 0
        if (
            step % 2
            and not exhausted
            and krylov.held < min(krylov.capacity, 2 * expected)
        ):
            continue
        theta, _y, error = krylov.ritz()
        good = error <= LANCZOS.tolerance * np.abs(theta)
        count = int(good.size if good.all() else np.argmin(good))
        progress(
            min(count / (known + expected), 0.99),
            f"Lanczos: {count} of about {known + expected} modes",
        )
        if exhausted or enough(theta[:count]):
            return _pairs(krylov, count, exhausted=exhausted)
        if krylov.held + 2 * BLOCK > krylov.capacity:
            idle = 0 if count > before else idle + 1
            before = count
            if idle > LANCZOS.patience and krylov.capacity < rows:
                krylov.grow()
                idle = 0
                continue
            krylov.restart(
                min(max(count, expected) + 2 * BLOCK, krylov.held - 2 * BLOCK)
            )
    raise NotConverged(
        f"Lanczos stopped after {LANCZOS.steps} blocks with {count} of about {known + expected} "
        "modes"
    )


def capacity(rows: int, expected: int, known: int = 0) -> int:
    """Most basis vectors held in a search for `expected` pairs beyond the `known` ones."""
    return min(known + 2 * expected + 6 * BLOCK, rows)


def _pairs(krylov: Krylov, count: int, *, exhausted: bool) -> RitzPairs:
    theta, y, _ = krylov.ritz()
    # θ = 0: infinite λ, no mode
    real = np.abs(theta[:count]) > 1e-13 * np.abs(theta).max(initial=0.0)
    theta = theta[:count][real]
    y = y[:, :count][:, real]
    return RitzPairs(theta, krylov.vectors(theta, y), exhausted)


def rayleigh_ritz(pencil: Pencil, vectors: Float) -> tuple[Float, Float]:
    """Eigenvalues (k,), ascending, and M-orthonormal vectors (f, k) of the problem in the space of
    some vectors.
    """
    k = vectors.T @ (pencil.stiffness @ vectors)
    m = vectors.T @ (pencil.mass @ vectors)
    values, y = linalg.eigh(k, m)
    return values, vectors @ y
