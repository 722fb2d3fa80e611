"""(K − λ_j M) z_j = r_j in the M-orthogonal complement of known modes, for many right-hand sides and one factor.

With A = K − σM factorised and δ = λ_j − σ, the equation is (I − δ A⁻¹M) z = A⁻¹r. One space V serves all columns:
z = x + U y with x = A⁻¹r, U = A⁻¹MV and y from the Galerkin condition VᵀM(δz − Vy) = 0, whose residual M(δz − Vy) is
exact (full orthogonalisation, Saad 2003, ch. 6.4; shifted systems: Frommer and Glässner 1998). V grows by the
principal directions of δz − Vy over all columns that are not done, no more of them than the tolerances ask for:
inertia loads are smooth, so that they are fewer than the columns. A column that is done keeps its y.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.fields import Fields, Inertia, add, summed
from ringtrue.eigen.problem import EigenModes
from ringtrue.errors import NotConverged

RUNS = 40
LEVELS = 60  # blocks of a run, before the columns that are left start anew
DROP = 0.7  # share of the residual allowed to a column that a block may leave out of it
LEAST = 1e-5  # share of the largest eigenvalue of a projection that one below zero may have by rounding
MANY = 400  # columns that pay for a factorisation at a better shift
_MORE = "compute more modes above those whose derivatives are needed"


@dataclass(slots=True, eq=False)
class _Space:
    """V, what A⁻¹M makes of it, and the projections VᵀMV and VᵀM A⁻¹M V, block by block."""

    basis: list[Fields] = field(default_factory=list)
    inner: list[Fields] = field(default_factory=list)  # images in the complement
    images: list[Float] = field(default_factory=list)  # as they were solved for
    parts: list[Float] = field(default_factory=list)  # and their coefficients along the known modes
    gram: Float = field(default_factory=lambda: np.zeros((0, 0)))
    projected: Float = field(default_factory=lambda: np.zeros((0, 0)))

    def add(self, v: Fields, image: Float, inner: Fields, part: Float) -> None:
        self.basis.append(v)
        self.inner.append(inner)
        self.images.append(image)
        self.parts.append(part)
        self.gram = _bordered(self.gram, np.vstack([w.dot(v) for w in self.basis]))
        self.projected = _bordered(self.projected, np.vstack([w.dot(inner) for w in self.basis]))

    def rows(self, y: Float) -> list[Float]:
        """y (k, ...) block by block."""
        return np.split(y, np.cumsum([v.count for v in self.basis])[:-1]) if self.basis else []

    def less(self, y: Float, delta: Float) -> list[tuple[Fields, Float]]:
        """δUy − Vy as a sum of products."""
        c = self.rows(y)
        moved = [(u, part * delta) for u, part in zip(self.inner, c, strict=True)]
        return [*moved, *((v, -part) for v, part in zip(self.basis, c, strict=True))]

    def defect(self, x: Fields, at: Int, y: Float, delta: Float, c: Float) -> Fields:
        """δ(x + Uy) − Vy of the columns `at`, times c (columns, r)."""
        first = np.zeros((x.count, c.shape[1]))
        first[at] = delta[at, None] * c
        return summed([(x, first), *((f, k @ c) for f, k in self.less(y[:, at], delta[at]))])


@dataclass(frozen=True, slots=True, eq=False)
class Complement:
    """The complement of known modes.

    Attributes
    ----------
    pencil : Pencil
    modes : EigenModes
        All from the lowest up.
    shift : float
        Where K − σM is factorised.
    inertia : Inertia
    known : Fields
        Of the modes.
    loaded : (f, n) float64
        M times their vectors.
    """

    pencil: Pencil
    modes: EigenModes
    shift: float
    inertia: Inertia
    known: Fields
    loaded: Float

    @classmethod
    def of(cls, pencil: Pencil, modes: EigenModes, columns: int = 0) -> Complement:
        """Of the modes given, for about so many right-hand sides in all.

        The factor that the modes came from serves if it is still there; if not, or for many columns, one amid the
        modes is made, which contracts faster.
        """
        there = pencil.shift == modes.shift and columns < MANY
        shift = modes.shift if there else _amid(modes.values, modes.shift)
        inertia = Inertia(pencil.mass)
        known = inertia.fields(np.asfortranarray(modes.vectors))
        return cls(pencil, modes, shift, inertia, known, inertia.spread(known))

    def solve(self, loads: Float, lam: Float, tolerance: float) -> Float:
        """z (f, k), M-orthogonal to the modes, for loads (f, k) and λ (k,).

        Parameters
        ----------
        tolerance : float
            ‖r − (K − λM)z‖ / ‖load‖ of each column (2-norm; r is the load without its part in the modes).

        Raises
        ------
        NotConverged
            If a mode below some λ is not among those known, or the residual stays above the tolerance.
        """
        r = self.balance(self.modes.vectors.T @ loads)
        r += loads
        return self.balanced(r, lam, tolerance * np.linalg.norm(loads, axis=0))

    def balance(self, part: Float) -> Float:
        """Forces (f, k), column-major, that take their part along the modes (n, k) from loads."""
        return np.asarray((-part.T @ self.loaded.T).T)

    def balanced(self, r: Float, lam: Float, allowed: Float, along: Float | None = None) -> Float:
        """`solve` for r (f, k) without part in the modes and the residuals allowed (k,); plus modes times `along`."""
        z, at = np.zeros((0, 0)), np.arange(lam.size)
        for run in range(RUNS):
            if not at.size:
                return z
            step, rest, done = self._run(r, lam[at], allowed[at], None if run else along)
            if run:
                z[:, at] += step
            else:
                z = step
            at, r = at[~done], rest
        raise NotConverged(f"{at.size} of {lam.size} right-hand sides did not converge; {_MORE}")

    def _solved(self, rhs: Float) -> tuple[Float, Fields, Float]:
        """A⁻¹ rhs (f, k), its fields in the complement, and its coefficients along the modes (n, k)."""
        x = self.pencil.at(self.shift).solve(rhs)
        fields = self.inertia.fields(x)
        part = self.known.dot(fields)
        return x, fields.less(self.known, part), part

    def _run(self, r: Float, lam: Float, allowed: Float, along: Float | None) -> tuple[Float, Float, Bool]:
        """Solution, forces that are left over in the columns not done, and which are done."""
        delta, space = lam - self.shift, _Space()
        z, x, part = self._solved(r)
        at, y, b = np.arange(lam.size), np.zeros((0, lam.size)), np.zeros((0, lam.size))
        for level in range(LEVELS + 1):
            gram = self.inertia.gram(x, at, delta[at], space.less(y[:, at], delta[at]))
            left = np.flatnonzero(~(np.diag(gram) <= allowed[at] ** 2))
            at, gram = at[left], gram[np.ix_(left, left)]
            if not at.size or level == LEVELS:
                break
            v = space.defect(x, at, y, delta, _principal(gram, allowed[at]))
            space.add(v, *self._solved(self.inertia.spread(v)))
            b = np.vstack([b, v.dot(x)])
            y = np.vstack([y, np.zeros((v.count, lam.size))])
            y[:, at] = _coefficients(space.gram, space.projected, b[:, at], delta[at])
        rest = self.inertia.spread(space.defect(x, at, y, delta, np.eye(at.size)))
        c = space.rows(y)
        for p, block in zip(space.parts, c, strict=True):
            part = part + p @ block
        along = -part if along is None else along - part
        z = add(z, [*zip(space.images, c, strict=True), (self.modes.vectors, along)])
        done = np.ones(lam.size, dtype=bool)
        done[at] = False
        return z, rest, done


def _principal(gram: Float, allowed: Float) -> Float:
    """Coefficients (k, r) of the directions that columns of residual forces with this Gram matrix need most.

    As few as leave at most DROP of the residual that is allowed to each column.
    """
    s, u = np.linalg.eigh(gram / allowed / allowed[:, None])
    s, u = s[::-1].clip(min=0), u[:, ::-1]
    left = np.sqrt(np.cumsum((s * u * u)[:, ::-1], axis=1)).max(axis=0)[::-1]
    rank = max(int((left > DROP).sum()), 1)
    return np.asarray(u[:, :rank] / np.sqrt(s[:rank]) / allowed[:, None])


def _bordered(old: Float, new: Float) -> Float:
    """A symmetric matrix with further columns (k, r), and with them its further rows."""
    k, corner = len(old), new[len(old) :]
    return np.block([[old, new[:k]], [new[:k].T, (corner + corner.T) / 2]])


def _coefficients(gram: Float, projected: Float, b: Float, delta: Float) -> Float:
    """y (k, c) of (G − δT) y = δb for each column.

    Raises
    ------
    NotConverged
        If the projection has a mode below one of the λ.
    """
    theta, turn = linalg.eigh(projected, gram, check_finite=False)
    if theta[-1] * delta.max() >= 1 or theta[0] < -LEAST * theta[-1]:
        raise NotConverged(f"a mode below one of those that are differentiated is not among those given; {_MORE}")
    return np.asarray(turn @ ((turn.T @ (b * delta)) / (1 - delta * theta[:, None])))


def _amid(values: Float, default: float) -> float:
    """The middle of a wide gap near a third of the highest of the eigenvalues."""
    top = float(values.max(initial=0.0))
    marks = np.unique(np.clip(values, 0.0, None))
    middle, width = (marks[1:] + marks[:-1]) / 2, np.diff(marks)
    fair = np.abs(middle - top / 3) < top / 5
    if not fair.any():
        return default
    return float(middle[fair][np.argmax(width[fair])])
