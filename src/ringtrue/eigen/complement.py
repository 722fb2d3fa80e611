"""(K − λ_j M) z_j = r_j in the M-orthogonal complement of known modes, for many right-hand sides and one factor.

With A = K − σM factorised and δ = λ_j − σ, the equation is (I − δ A⁻¹M) z = A⁻¹r: the space that A⁻¹M makes from
the block A⁻¹R serves all shifts λ_j at once, so one block Lanczos run solves for all columns (full
orthogonalisation, Saad 2003, ch. 6.4; shifted systems: Frommer and Glässner 1998). Each solution ends with a step of
the fixed point, z = A⁻¹(r + δM z_before), whose solves are already there: its residual δM(z − z_before) is exact and
smooth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Float
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.problem import EigenModes
from ringtrue.errors import NotConverged

BLOCKS = 2  # of a run, before the columns that are left start anew: few columns need more
RUNS = 40
RANK = 1e-14  # least share of a direction in the Gram matrix of a block
_MORE = "compute more modes above those whose derivatives are needed"


@dataclass(frozen=True, slots=True, eq=False)
class Complement:
    """The complement of known modes.

    Attributes
    ----------
    pencil : Pencil
    modes : EigenModes
        All from the lowest up.
    loaded : (f, n) float64
        M times their vectors.
    """

    pencil: Pencil
    modes: EigenModes
    loaded: Float

    @classmethod
    def of(cls, pencil: Pencil, modes: EigenModes) -> Complement:
        """Of the modes given."""
        return cls(pencil, modes, np.asarray(pencil.mass @ modes.vectors))

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
        z, scale = np.zeros_like(loads), np.linalg.norm(loads, axis=0)
        r = loads - self.loaded @ (self.modes.vectors.T @ loads)
        at = np.flatnonzero(np.linalg.norm(r, axis=0) > 0.1 * tolerance * scale)
        for _ in range(RUNS):
            if not at.size:
                return z
            step, r[:, at], done = self._run(r[:, at], lam[at], tolerance * scale[at])
            z[:, at] += step
            at = at[~done]
        raise NotConverged(f"{at.size} of {lam.size} right-hand sides did not converge; {_MORE}")

    def _solved(self, rhs: Float) -> Float:
        x = self.pencil.at(self.modes.shift).solve(rhs)
        return np.asarray(x - self.modes.vectors @ (self.loaded.T @ x))

    def _run(self, r: Float, lam: Float, target: Float) -> tuple[Float, Float, Bool]:
        """Solution, residual and which columns have converged, after at most BLOCKS blocks."""
        delta, first = lam - self.modes.shift, self._solved(r)
        v, mv, start = self._orthonormal(first)
        basis, loaded, images, t = [v], [mv], list[Float](), np.zeros((0, 0))
        while True:
            images.append(self._solved(loaded[-1]))
            w, t = _expanded(images[-1], basis, loaded, t)
            v, mv, last = self._orthonormal(w)
            theta, x = np.linalg.eigh(t)
            if theta.max(initial=0.0) * delta.max() >= 1:
                raise NotConverged(f"a mode below {lam.max():.6g} (rad/s)^2 is not among those given; {_MORE}")
            y = x @ ((x[: len(start)].T @ start) / (1 - delta * theta[:, None]))
            end = last @ y[len(y) - last.shape[1] :] * delta
            size = delta * np.sqrt(np.einsum("ij,ik,kj->j", end, mv.T @ mv, end, optimize=True).clip(min=0))
            if (size <= target).all() or len(basis) == BLOCKS or not v.shape[1]:
                break
            basis.append(v)
            loaded.append(mv)
        z = first + (np.hstack(images) @ y) * delta
        rest = np.asarray(self.pencil.mass @ (z - np.hstack(basis) @ y)) * delta
        return z, rest, np.linalg.norm(rest, axis=0) <= target

    def _orthonormal(self, w: Float) -> tuple[Float, Float, Float]:
        """v, M v and R with w = v R, v M-orthonormal; directions of no weight in any column are left out."""
        mw = self.pencil.mass @ w
        gram = w.T @ mw
        size = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
        s, u = np.linalg.eigh(gram / size / size[:, None])
        keep = s > RANK * max(float(s.max(initial=0.0)), np.finfo(float).tiny)
        back = u[:, keep] / np.sqrt(s[keep]) / size[:, None]
        return w @ back, mw @ back, (np.sqrt(s[keep]) * u[:, keep]).T * size


def _expanded(image: Float, basis: list[Float], loaded: list[Float], t: Float) -> tuple[Float, Float]:
    """A⁻¹M of the last block without its part in the basis, and the projected matrix with its coefficients."""
    w, h = image, np.zeros((sum(b.shape[1] for b in basis), image.shape[1]))
    for _ in range(2):  # once leaves 1e-4 where 1e-6 is asked for
        c = np.vstack([m.T @ w for m in loaded])
        h += c
        start = 0
        for b in basis:
            w = w - b @ c[start : start + b.shape[1]]
            start += b.shape[1]
    old = len(t)
    out = np.zeros((len(h), len(h)))
    out[:old, :old] = t
    out[:, old:], out[old:, :] = h, h.T
    out[old:, old:] = (h[old:] + h[old:].T) / 2
    return w, out
