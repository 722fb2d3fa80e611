"""The static flexibility at loaded channels in a reduced basis: residual vectors, for FRFs, their
zeros and statics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import elastic
from ringtrue.eigen.eigenpairs import frequencies
from ringtrue.eigen.pencil import Factor, Pencil
from ringtrue.errors import InputError, SingularModel
from ringtrue.reduction.basis import CHUNK, inner_product, orthonormal_part, project
from ringtrue.reduction.dense_models import ProjectedModel
from ringtrue.reduction.parametric import ReducedModel

NEW = 1e-10  # squared share of a vector outside the basis that is kept


def with_responses(
    model: ReducedModel, channels: Int, x: Float, *, sensitivities: bool = False
) -> tuple[ReducedModel, float]:
    """The model with the static responses of the full one to unit loads at channels added to its
    basis.

    A structure that is free has none; the responses are then those of K − σM, which serve FRFs as
    well.

    Parameters
    ----------
    channels : (l,) int64
        Positions among the channels of the model.
    x : (p,) float64
        Of the active parameters: where the full model is solved.
    sensitivities : bool
        Add the derivatives of the responses along the active parameters, too.

    Returns
    -------
    model : ReducedModel
        Its static deflections at x are those of the full model.
    error : float
        Largest error of the old one's flexibility between these channels, relative to the largest
        flexibility.

    Sources: residual vectors, Craig and Kurdila (2006), Fundamentals of Structural Dynamics, sec.
    17.
    """
    a = model.system.parameters.factors(model.full_vector(x))
    pencil = Pencil(
        *model.system.at(a), method=model.pencil.method, labels=model.pencil.labels
    )
    shift, factor = _definite(pencil, model.shift)
    load = model.system.observe[channels].T.toarray()
    u = _solved(factor, load)
    fresh = [u]
    if sensitivities:
        for i in model.active:
            fresh += [
                _solved(factor, k @ u - shift * (m @ u))
                for k, m in model.system.terms_of(i)
            ]
    pencil.close()
    k, m = model.projected(a)
    seen = model.basis.observe[channels]
    true = load.T @ u
    found = seen @ linalg.solve(k - shift * m, seen.T, assume_a="sym")
    largest = max(float(np.abs(true).max(initial=0.0)), 1e-300)
    error = float(np.abs(found - true).max(initial=0.0) / largest)
    new = np.hstack(fresh)
    new = new[:, np.abs(new).max(axis=0) > 0]
    inner = inner_product(model.system.stiffness, model.system.mass, model.shift)
    vectors = np.hstack(
        [model.basis.vectors, orthonormal_part(inner, model.basis.vectors, new)]
    )
    return model.with_basis(project(model.system, vectors, model.basis)), error


def flexibility(model: ProjectedModel, x: Float, outputs: Int, inputs: Int) -> Float:
    """Deflections of outputs (o,) under unit loads at inputs (i,), positions of channels, in the
    basis at x (p,): those of K − σM with the shift of the model, (o, i).
    """
    k, m = model.projected(model.basis.parameters.factors(model.full_vector(x)))
    seen = model.basis.observe
    moved = linalg.solve(k - model.shift * m, seen[inputs].T, assume_a="pos")
    return seen[outputs] @ moved


def responding(model: ReducedModel, channels: Int, x: Float) -> tuple[Float, Float]:
    """λ (r,) and vectors (f, r) of unit modal mass: the modes at x (p,) and, as modes of the space
    that they span together, the static responses to unit loads at channels that are in the basis.
    Held channels have none.

    Of a structure that is free the responses are those of K − σM.
    """
    k, m = model.projected(model.system.parameters.factors(model.full_vector(x)))
    lam, y = model.coordinates(x)
    energy = k if lam[0] > 0 and elastic(frequencies(lam))[0] else k - model.shift * m
    loads = model.basis.observe[channels]
    some = np.hstack(
        [y, linalg.solve(energy, loads[loads.any(axis=1)].T, assume_a="sym")]
    )
    some = some / np.sqrt(np.einsum("ij,ij->j", some, energy @ some))
    size, turn = linalg.eigh(some.T @ energy @ some)
    some = some @ (turn / np.sqrt(size))[:, size > 1e-10]
    inverse, turn = linalg.eigh(some.T @ m @ some)
    some = some @ turn[:, inverse > 1e-11 * inverse.max()]
    values, turn = linalg.eigh(some.T @ k @ some, some.T @ m @ some)
    return values, model.basis.vectors @ (some @ turn)


def _definite(pencil: Pencil, shift: float) -> tuple[float, Factor]:
    """K itself, or K − σM where something is free to move."""
    try:
        factor = pencil.at(0.0)
        if factor.negatives <= 0:
            return 0.0, factor
    except SingularModel:
        pass
    return shift, pencil.at(shift)


def _solved(factor: Factor, load: Float) -> Float:
    n = load.shape[1]
    return np.concatenate(
        [factor.solve(load[:, i : i + CHUNK]) for i in range(0, n, CHUNK)], axis=1
    )


@dataclass(frozen=True, slots=True, eq=False)
class ResponseBasis(FrozenArrays):
    """Vectors and what is left.

    Attributes
    ----------
    vectors : (f, r) float64
        Mass-orthonormal.
    residual : (l,) float64
        Norm of the residual over that of the load at each line, each DOF in the scale of its own
        stiffness.
    lines : tuple of float, Hz
        Where the dynamic stiffness was factorised, in order.
    """

    vectors: Float
    residual: Float
    lines: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ResponseSearch:
    """How the vectors of a response are sought.

    Attributes
    ----------
    loss : float
        Structural loss factor of the response that the residual belongs to, > 0.
    tolerance : float
        Of the residual.
    steps : int
        Krylov steps at a line.
    most : int
        Vectors from which on no more lines are taken, converged or not.
    """

    loss: float
    tolerance: float = 0.02
    steps: int = 20
    most: int = 600


def response_basis(
    pencil: Pencil,
    loads: Float,
    freqs: Float,
    start: Float,
    search: ResponseSearch,
    *,
    progress: Progress = quiet,
) -> ResponseBasis:
    """Vectors that hold the steady response to harmonic loads at all lines.

    Parameters
    ----------
    pencil : Pencil
        Of K and M; it is closed.
    loads : (f, j) float64
    freqs : (l,) float64, Hz
        Lines where the residual is watched; above 0, as close as the resonances are wide or
        somewhat wider.
    start : (f, r) float64
        Vectors to begin with: modes of the lower part of the band.
    search : ResponseSearch

    Raises
    ------
    InputError
        If there is no load, no line above 0 Hz, or no damping.
    """
    f = np.asarray(freqs, dtype=np.float64)
    w2 = (2 * np.pi * np.asarray(freqs)) ** 2
    if not f.size or f.min() <= 0 or not np.any(loads) or not search.loss > 0:
        raise InputError(
            f"response basis: {f.size} lines above 0 Hz, a load and a loss factor "
            f"{search.loss} > 0 are needed"
        )
    at = _HarmonicResidual(pencil.stiffness, pencil.mass, loads, w2, search.loss)
    span = _Span.of(pencil.stiffness, pencil.mass, start).grown(
        pencil.at(-float(w2[0])), loads, 1
    )
    every = np.arange(f.size)
    residual = at.residual(span, every)
    lines = list[float]()
    done = 0.0
    while residual.max() > search.tolerance and span.size < search.most:
        worst = int(np.argmax(residual))
        try:
            factor = pencil.at(float(w2[worst]))
        except SingularModel:  # a mode stands exactly there
            factor = pencil.at(float(w2[worst]) * (1 + 1e-6))
        more = span.grown(factor, loads, search.steps)
        if more.size == span.size:
            break  # round-off: there is nothing left to add
        span = more
        lines.append(float(f[worst]))
        left = np.flatnonzero(residual > search.tolerance)
        residual[left] = at.residual(span, left)
        if residual.max() <= search.tolerance:
            residual = at.residual(span, every)
        done = max(done, float(np.mean(residual <= search.tolerance)))
        progress(done, f"response at {lines[-1]:.4g} Hz")
    pencil.close()
    return ResponseBasis(span.vectors, residual, tuple(lines))


def _orthonormal(mass: sparse.csr_array, x: Float) -> Float:
    """Mass-orthonormal vectors of the same span; what depends on the others is dropped."""
    x = x / np.sqrt(np.einsum("ij,ij->j", x, mass @ x))
    for _ in range(2):  # what was kept may have been small
        s, u = linalg.eigh(x.T @ (mass @ x))
        keep = s > NEW
        x = x @ (u[:, keep] / np.sqrt(s[keep]))
    return x


@dataclass(frozen=True, slots=True, eq=False)
class _Span:
    """Mass-orthonormal vectors (f, r) and VᵀKV (r, r)."""

    k: sparse.csr_array
    m: sparse.csr_array
    vectors: Float
    stiffness: Float

    @classmethod
    def of(cls, k: sparse.csr_array, m: sparse.csr_array, x: Float) -> _Span:
        v = _orthonormal(m, x)
        return cls(k, m, v, v.T @ (k @ v))

    @property
    def size(self) -> int:
        return int(self.vectors.shape[1])

    def outside(self, x: Float) -> Float:
        """The part of x (f, n) that is mass-orthogonal to the vectors."""
        return np.asarray(x - self.vectors @ (self.vectors.T @ (self.m @ x)))

    def grown(self, factor: Factor, loads: Float, steps: int) -> _Span:
        """With the vectors of some Krylov steps from the loads."""
        x = self.outside(_krylov(factor, self.m, loads, steps, self.outside))
        size = np.einsum("ij,ij->j", x, self.m @ x)
        x = x[:, size > NEW]
        if not x.shape[1]:
            return self
        x = _orthonormal(self.m, self.outside(_orthonormal(self.m, x)))
        side = self.vectors.T @ (self.k @ x)
        corner = x.T @ (self.k @ x)
        stiffness = np.block(
            [[self.stiffness, side], [side.T, (corner + corner.T) / 2]]
        )
        return _Span(self.k, self.m, np.hstack([self.vectors, x]), stiffness)


def _krylov(
    factor: Factor,
    mass: sparse.csr_array,
    loads: Float,
    steps: int,
    first: Callable[[Float], Float],
) -> Float:
    """Mass-orthonormal vectors of a block Krylov space, (f, steps · j); `first` is applied to its
    first block.
    """
    x = _orthonormal(mass, first(factor.solve(loads).reshape(loads.shape)))
    blocks = [x]
    for _ in range(steps - 1):  # each needs the one before
        x = factor.solve(mass @ x).reshape(x.shape)
        known = np.hstack(blocks)
        for _ in range(2):
            x = x / np.sqrt(np.einsum("ij,ij->j", x, mass @ x))
            x = x - known @ (known.T @ (mass @ x))
        if np.einsum("ij,ij->j", x, mass @ x).max() < NEW:
            break
        x = _orthonormal(mass, x)
        blocks.append(x)
    return np.hstack(blocks)


@dataclass(frozen=True, slots=True, eq=False)
class _HarmonicResidual:
    """Where the residual is watched."""

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    loads: Float
    w2: Float
    loss: float

    def residual(self, span: _Span, at: Int) -> Float:
        """The largest over the loads at some lines, (l,)."""
        v = span.vectors
        w2 = self.w2[at]
        lossy = 1 + 1j * self.loss
        lam, y = linalg.eigh(span.stiffness)
        dynamic = lam[:, None, None] * lossy - w2[:, None]
        q = (y.T @ (v.T @ self.loads))[:, None] / dynamic  # (r, l, j)
        q = y @ q.reshape(lam.size, -1)
        x = v @ q.real + 1j * (v @ q.imag)  # the vectors stay real
        shape = (v.shape[0], w2.size, -1)
        elastic_force = (self.stiffness @ x * lossy).reshape(shape)
        left = elastic_force - w2[:, None] * (self.mass @ x).reshape(shape)
        scale = 1 / (self.stiffness.diagonal() + self.w2[-1] * self.mass.diagonal())
        wrong = np.einsum("f,flj->lj", scale, np.abs(left - self.loads[:, None]) ** 2)
        return np.asarray(np.sqrt((wrong / (scale @ self.loads**2)).max(axis=1)))
