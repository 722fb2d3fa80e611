"""(K − λ_j M) z_j = r_j in the M-orthogonal complement of known modes, for many right-hand sides and one factor.

With A = K − σM factorised and δ = λ_j − σ, the equation is (I − δ A⁻¹M) z = A⁻¹r. One space V serves all columns:
z = x + U y with x = A⁻¹r, U = A⁻¹MV and y from the Galerkin condition VᵀM(δz − Vy) = 0, whose residual M(δz − Vy) is
exact (full orthogonalisation, Saad 2003, ch. 6.4; shifted systems: Frommer and Glässner 1998). V grows by the
principal directions of δz − Vy over all columns that are not done, no more of them than the tolerances ask for:
inertia loads are smooth, so that they are fewer than the columns. A column that is done keeps its y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.fields import Fields, Inertia, add
from ringtrue.eigen.problem import EigenModes
from ringtrue.errors import NotConverged

RUNS = 8
EACH, SPARE = 2, 60  # directions of a run for each column and beyond, before the columns that are left start anew
DROP = 0.7  # share of the residual allowed to a column that a block may leave out of it
LEAST = 1e-5  # share of the largest eigenvalue of a projection that one below zero may have by rounding
MANY = 400  # columns that pay for a factorisation at a better shift
_MORE = "compute more modes above those whose derivatives are needed"


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
        self.size, self.room = 0, room
        self._basis, self._inner = like.room(room), like.room(room)
        self._images, self._parts = np.empty((room, rows)), np.empty((known, room))
        self.gram, self.projected = np.zeros((0, 0)), np.zeros((0, 0))

    @property
    def basis(self) -> Fields:
        """V."""
        return self._basis.first(self.size)

    @property
    def inner(self) -> Fields:
        """A⁻¹MV in the complement."""
        return self._inner.first(self.size)

    @property
    def images(self) -> tuple[Float, Float]:
        """A⁻¹MV (k, f) as solved for, and its coefficients along the known modes (n, k)."""
        return self._images[: self.size], self._parts[:, : self.size]

    def add(self, v: Fields, image: Float, inner: Fields, part: Float) -> None:
        """A further block."""
        cut = slice(self.size, self.size + v.count)
        self._basis.put(self.size, v)
        self._inner.put(self.size, inner)
        self._images[cut], self._parts[:, cut] = image, part
        self.size += v.count
        self.gram = _bordered(self.gram, self.basis.dot(v))
        self.projected = _bordered(self.projected, self.basis.dot(inner))

    def change(self, y: Float, delta: Float) -> tuple[tuple[Float, Fields], ...]:
        """δUy − Vy as products cᵀf."""
        return (y * delta, self.inner), (-y, self.basis)

    def defect(self, x: Fields, at: Int, y: Float, delta: Float, turn: Float) -> Fields:
        """δ(x + Uy) − Vy of the columns `at`, times `turn` (columns, r)."""
        first = np.zeros((x.count, turn.shape[1]))
        first[at] = delta[at, None] * turn
        out = x.times(first)
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
        if theta[-1] * delta.max() >= 1 or theta[0] < -LEAST * theta[-1]:
            raise NotConverged(f"a mode below one of those that are differentiated is not among those given; {_MORE}")
        return np.asarray(turn @ ((turn.T @ (b * delta)) / (1 - delta * theta[:, None])))


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
    """

    pencil: Pencil
    modes: EigenModes
    shift: float
    inertia: Inertia
    known: Fields

    @classmethod
    def of(cls, pencil: Pencil, modes: EigenModes, lam: Float, columns: int) -> Complement:
        """Of the modes given, for so many right-hand sides in all, at λ (k,).

        The factor that the modes came from serves if it is still there; if not, or for many right-hand sides, one
        amid the λ is made, which contracts faster.
        """
        there = pencil.shift == modes.shift and columns < MANY
        shift = modes.shift if there else _amid(modes.values, float(lam.max(initial=0.0)), modes.shift)
        inertia = Inertia(pencil.mass)
        return cls(pencil, modes, shift, inertia, inertia.fields(modes.vectors.T))

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
        r = self.balance(self.modes.vectors.T @ loads) + loads.T
        return self.balanced(r, lam, tolerance * np.linalg.norm(loads, axis=0)).T

    def balance(self, part: Float) -> Float:
        """Forces (k, f) that take their part along the modes (n, k) from loads."""
        return self.inertia.forces(self.known.times(-part))

    def balanced(self, r: Float, lam: Float, allowed: Float, along: Float | None = None) -> Float:
        """`solve` (k, f) for r (k, f) without part in the modes, with the residuals allowed (k,).

        The modes times `along` (n, k) are added.
        """
        z, at = np.zeros((0, 0)), np.arange(lam.size)
        for run in range(RUNS):
            if not at.size:
                return z
            step, rest, done = self._run(r, lam[at], allowed[at], None if run else along)
            if run:
                z[at] += step
            else:
                z = step
            at, r = at[~done], rest
        raise NotConverged(f"{at.size} of {lam.size} right-hand sides did not converge; {_MORE}")

    def _solved(self, rhs: Float) -> tuple[Float, Fields, Float]:
        """A⁻¹ rhs (k, f), its fields in the complement, and its coefficients along the modes (n, k)."""
        x = np.ascontiguousarray(self.pencil.at(self.shift).solve(rhs.T).T)
        fields = self.inertia.fields(x)
        part = self.known.dot(fields)
        fields.add(-part, self.known)
        return x, fields, part

    def _run(self, r: Float, lam: Float, allowed: Float, along: Float | None) -> tuple[Float, Float, Bool]:
        """Solution, forces that are left over in the columns not done, and which are done."""
        delta = lam - self.shift
        z, x, part = self._solved(r)
        space = _Space(x, self.pencil.size, self.known.count, EACH * lam.size + SPARE)
        at, y, b = np.arange(lam.size), np.zeros((0, lam.size)), np.zeros((0, lam.size))
        while True:
            gram = self.inertia.gram(x, at, delta[at], *space.change(y[:, at], delta[at]))
            left = ~(np.diag(gram) <= allowed[at] ** 2)
            at, turn = at[left], _principal(gram[left][:, left], allowed[at[left]])
            if not at.size or space.size + turn.shape[1] > space.room:
                break
            v = space.defect(x, at, y, delta, turn)
            space.add(v, *self._solved(self.inertia.forces(v)))
            b = np.vstack([b, v.dot(x)])
            y = np.vstack([y, np.zeros((v.count, lam.size))])
            y[:, at] = space.coefficients(b[:, at], delta[at])
        images, parts = space.images
        part = part + parts @ y
        add(z, (y, images), (-part if along is None else along - part, self.modes.vectors.T))
        done = np.ones(lam.size, dtype=bool)
        done[at] = False
        return z, self.inertia.forces(space.defect(x, at, y, delta, np.eye(at.size))), done


def _principal(gram: Float, allowed: Float) -> Float:
    """Coefficients (k, r) of the directions that columns of residual forces with this Gram matrix need most.

    As few as leave at most DROP of the residual that is allowed to each column.
    """
    s, u = np.linalg.eigh(gram / allowed / allowed[:, None])
    s, u = s[::-1].clip(min=0), u[:, ::-1]
    left = np.sqrt(np.cumsum((s * u * u)[:, ::-1], axis=1)).max(axis=0, initial=0.0)[::-1]
    rank = int((left > DROP).sum())
    return np.asarray(u[:, :rank] / np.sqrt(s[:rank]) / allowed[:, None])


def _bordered(old: Float, new: Float) -> Float:
    """A symmetric matrix with further columns (k, r), and with them its further rows."""
    k, corner = len(old), new[len(old) :]
    return np.block([[old, new[:k]], [new[:k].T, (corner + corner.T) / 2]])


def _amid(values: Float, top: float, default: float) -> float:
    """The middle of the widest gap between the eigenvalues near a third of `top`."""
    marks = np.unique(np.clip(values, 0.0, None))
    middle, width = (marks[1:] + marks[:-1]) / 2, np.diff(marks)
    fair = np.abs(middle - top / 3) < top / 5
    return float(middle[fair][np.argmax(width[fair])]) if fair.any() else default
