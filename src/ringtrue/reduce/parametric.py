"""A parametric reduced basis: modes, their static sensitivities and snapshots, projected once, solved many times.

K(a) = K + Σ_i Σ_j (a_i^power − 1) K_ij is affine in powers of the factors, so its projection is too; a point of the
parameter space costs one small dense eigensolution. Sources: Balmès (1996) parametric families of reduced models;
Noor, Peters (1980) reduced basis with path derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float
from ringtrue.core.observation import Observation
from ringtrue.core.parameters import ParameterSet
from ringtrue.eigen.derivatives import modal_coefficients
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.problem import EigenModes, frequencies
from ringtrue.eigen.solve import solve_modes
from ringtrue.errors import InputError, NumericalError
from ringtrue.model.ports import Linearisation

CHUNK = 32  # right-hand sides solved together
AT_ONCE = 800  # sensitivity vectors whose principal directions are taken at once
MASSLESS = 1e-14  # θ = 1/(λ − σ), relative to the largest, from which on a vector of the basis has no mass
Progress = Callable[[float, str], None]


class Term(Protocol):
    """A part of K and M that goes with a power of a parameter's factor."""

    @property
    def power(self) -> int: ...
    @property
    def stiffness(self) -> sparse.csr_array: ...
    @property
    def mass(self) -> sparse.csr_array: ...


@dataclass(frozen=True, slots=True, eq=False)
class AffineSystem:
    """K(a) and M(a) of a model, and where it is observed.

    Attributes
    ----------
    stiffness, mass : (f, f) csr_array float64
        At a = 1.
    parameters : ParameterSet
    terms : tuple (p,) of tuples of Term
        For each parameter. Terms of different parameters must not share a product (the same field of the same
        elements scaled by two parameters): that would not be affine.
    observe : (channel, f) csr_array float64
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    parameters: ParameterSet
    terms: tuple[tuple[Term, ...], ...]
    observe: sparse.csr_array

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(tuple(t) for t in self.terms))
        if len(self.terms) != len(self.parameters):
            raise InputError(f"{len(self.parameters)} parameters, terms for {len(self.terms)}")

    def at(self, factors: Float) -> tuple[sparse.csr_array, sparse.csr_array]:
        """K and M at the factors a (p,)."""
        k, m = self.stiffness, self.mass
        for a, terms in zip(factors.tolist(), self.terms, strict=True):  # over parameters and their powers
            for t in terms:
                if a != 1.0:
                    k = k + (a**t.power - 1.0) * t.stiffness
                    m = m + (a**t.power - 1.0) * t.mass
        return sparse.csr_array(k), sparse.csr_array(m)


def observed_system(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    transform: sparse.csr_array,
    parameters: ParameterSet,
    terms: Sequence[Sequence[Term]],
    observation: Observation,
) -> AffineSystem:
    """The affine system of an assembled model; `transform` (full, f) goes from free to observed DOFs."""
    if observation.matrix.shape[1] != transform.shape[0]:
        raise InputError(f"the observation has {observation.matrix.shape[1]} DOFs, the model {transform.shape[0]}")
    observe = sparse.csr_array(observation.matrix @ transform)
    return AffineSystem(stiffness, mass, parameters, tuple(tuple(t) for t in terms), observe)


@dataclass(frozen=True, slots=True)
class BasisOptions:
    """What goes into the basis.

    Attributes
    ----------
    extra : float
        Modes computed, as a multiple of those returned.
    size : int
        Most vectors kept at the start; enrichment adds to it.
    drop : float
        Sensitivity vectors below this share of the largest (strain energy norm) are dropped.
    """

    extra: float = 1.3
    size: int = 320
    drop: float = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """The projected system.

    Attributes
    ----------
    vectors : (f, r) float64
        Orthonormal in the nominal energy K − σM.
    stiffness, mass : (r, r) float64
        At a = 1.
    terms : tuple (p,) of tuples of (power, stiffness (r, r), mass (r, r))
    observe : (channel, r) float64
    """

    vectors: Float
    stiffness: Float
    mass: Float
    terms: tuple[tuple[tuple[int, Float, Float], ...], ...]
    observe: Float

    @property
    def size(self) -> int:
        """Number of vectors."""
        return int(self.vectors.shape[1])


def _project(system: AffineSystem, vectors: Float, old: Projection | None = None) -> Projection:
    """Project on `vectors`; the leading ones are those of `old`, whose products are kept."""
    n = 0 if old is None else old.size
    fresh = vectors[:, n:]

    def block(a: sparse.csr_array, kept: Float | None) -> Float:
        rows = np.flatnonzero(np.diff(a.indptr))  # a region touches few DOFs
        some = 2 * rows.size < a.shape[0]
        right = vectors[rows].T @ (a[rows] @ fresh) if some else vectors.T @ (a @ fresh)
        if kept is None:
            return np.asarray((right + right.T) / 2)
        corner = (right[n:] + right[n:].T) / 2
        return np.block([[kept, right[:n]], [right[:n].T, corner]])

    terms = tuple(
        tuple(
            (
                t.power,
                block(t.stiffness, None if old is None else old.terms[i][j][1]),
                block(t.mass, None if old is None else old.terms[i][j][2]),
            )
            for j, t in enumerate(group)
        )
        for i, group in enumerate(system.terms)
    )
    return Projection(
        vectors,
        block(system.stiffness, None if old is None else old.stiffness),
        block(system.mass, None if old is None else old.mass),
        terms,
        np.asarray(system.observe @ vectors),
    )


def _sensitivities(
    pencil: Pencil,
    modes: EigenModes,
    system: AffineSystem,
    at: Sequence[int],
    count: int,
    progress: Progress | None,
) -> Float:
    """(K − σM)⁻¹ (K_ij − λ_k M_ij) φ_k of the chosen parameters, free of the modes, scaled to the mode's energy."""
    factor, phi, lam = pencil.at(modes.shift), modes.vectors, modes.values
    mphi = pencil.mass @ phi
    scale = 1 / np.sqrt(np.maximum(lam[:count] - modes.shift, np.abs(modes.shift)))
    found = []
    todo = [t for i in at for t in system.terms[i]]
    for done, t in enumerate(todo):  # over parameters and their powers
        load = (t.stiffness @ phi[:, :count] - (t.mass @ phi[:, :count]) * lam[:count]) * scale
        load -= mphi @ (phi.T @ load)
        parts = [factor.solve(load[:, s : s + CHUNK]) for s in range(0, count, CHUNK)]
        x = np.concatenate(parts, axis=1)
        found.append(x - phi @ (mphi.T @ x))
        if progress is not None:
            progress((done + 1) / len(todo), "static sensitivities")
    return np.concatenate(found, axis=1) if found else np.zeros((pencil.size, 0))


def _principal(energy: sparse.csr_array, x: Float, most: int, drop: float) -> Float:
    """Principal directions of x in the energy K − σM, at most `most`, above `drop` of the largest, in their size."""
    if not x.shape[1] or most <= 0:
        return x[:, :0]
    gram = x.T @ (energy @ x)
    s, u = linalg.eigh((gram + gram.T) / 2)
    keep = np.flatnonzero(s > drop**2 * s[-1])[::-1][:most]
    return np.asarray(x @ u[:, keep])


def _compress(energy: sparse.csr_array, x: Float, most: int, drop: float) -> Float:
    """The principal directions of x, each of unit energy."""
    x = _principal(energy, x, most, drop)
    return np.asarray(x / np.sqrt(np.einsum("ij,ij->j", x, energy @ x)))


def _orthonormal(energy: sparse.csr_array, old: Float, x: Float) -> Float:
    """Part of x outside `old`, orthonormal in the energy K − σM as `old` is; what is nearly inside is dropped.

    Energy and not mass: a part too small to be seen in the mass may still be too stiff to be left out.
    """
    if not x.shape[1]:
        return x
    x = x / np.sqrt(np.einsum("ij,ij->j", x, energy @ x))
    for _ in range(2):
        x = x - old @ (old.T @ (energy @ x))
    s, u = linalg.eigh(x.T @ (energy @ x))
    keep = s > 1e-13
    q = x @ (u[:, keep] / np.sqrt(s[keep]))
    for _ in range(2):  # what was kept may have been small
        q = q - old @ (old.T @ (energy @ q))
        s, u = linalg.eigh(q.T @ (energy @ q))
        q = q @ (u / np.sqrt(s))
    return np.asarray(q)


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """An `ObservedModel` on a reduced basis.

    Attributes
    ----------
    system : AffineSystem
    basis : Projection
    pencil : Pencil
        The nominal one, factorised at `shift`; serves `error`.
    shift : float
    count : int
        Modes returned, the lowest.
    active : tuple of int
        The parameters that x stands for; the others stay at `base`.
    base : (all parameters,) float64
    """

    system: AffineSystem
    basis: Projection
    pencil: Pencil
    shift: float
    count: int
    active: tuple[int, ...]
    base: Float

    @property
    def parameters(self) -> ParameterSet:
        """The active parameters."""
        return self.system.parameters.take(self.active)

    def with_parameters(self, active: Sequence[int], base: Float | None = None) -> ReducedModel:
        """The same basis with x for the chosen parameters only (positions in `system.parameters`).

        Parameters
        ----------
        active : sequence of int
        base : (all parameters,) float64, optional
            Where the others stay; as they are now if not given.
        """
        lost = [i for i in active if not 0 <= i < len(self.system.parameters)]
        if lost:
            raise InputError(f"parameters {lost}: there are {len(self.system.parameters)}")
        return replace(self, active=tuple(active), base=self.base if base is None else np.array(base, dtype=float))

    def with_count(self, count: int) -> ReducedModel:
        """The same with another number of modes."""
        return replace(self, count=min(count, self.basis.size))

    def full_vector(self, x: Float) -> Float:
        """x of all parameters (P,) from that of the active ones (p,)."""
        x = np.asarray(x, dtype=np.float64)
        if x.shape != (len(self.active),):
            raise InputError(f"x {x.shape}; there are {len(self.active)} active parameters")
        out = self.base.copy()
        out[list(self.active)] = x
        return out

    def linearise(self, x: Float) -> Linearisation:
        """Modes and exact sensitivities of the reduced model at x (p,)."""
        everything = self.full_vector(x)
        lam, y = self._solve(everything, all_modes=True)
        a, slope = self.system.parameters.factors(everything), self.system.parameters.slope(everything)
        m = self.count
        ym = y[:, :m]
        d_lambda = np.empty((m, len(self.active)))
        c = np.empty((len(self.active), lam.size, m))
        for i, which in enumerate(self.active):  # over parameters
            dk, dm = self._derivative(which, float(a[which]), float(slope[which]))
            dk, dm = y.T @ (dk @ ym), y.T @ (dm @ ym)
            d_lambda[:, i] = np.diag(dk) - np.diag(dm) * lam[:m]
            c[i] = modal_coefficients(dk, dm, lam)
        seen = self.basis.observe @ y
        d_shapes = np.moveaxis(seen @ c, 0, -1)
        return Linearisation(np.array(x, dtype=float), frequencies(lam[:m]), seen[:, :m], d_lambda, d_shapes)

    def modes(self, x: Float) -> Linearisation:
        """Modes only (sensitivities with no columns)."""
        lam, y = self._solve(self.full_vector(x), all_modes=False)
        seen = self.basis.observe @ y
        none = (np.zeros((lam.size, 0)), np.zeros((*seen.shape, 0)))
        return Linearisation(np.array(x, dtype=float), frequencies(lam), seen, *none)

    def coordinates(self, x: Float) -> tuple[Float, Float]:
        """λ (m,) and the modes in the basis (r, m) at x."""
        return self._solve(self.full_vector(x), all_modes=False)

    def vectors(self, x: Float) -> tuple[Float, Float]:
        """λ (m,) and φ (f, m) at x, in the free DOFs."""
        lam, y = self.coordinates(x)
        return lam, self.basis.vectors @ y

    def _matrices(self, a: Float) -> tuple[Float, Float]:
        k, m = self.basis.stiffness.copy(), self.basis.mass.copy()
        for factor, terms in zip(a.tolist(), self.basis.terms, strict=True):  # over parameters and powers
            for power, kj, mj in terms:
                if factor != 1.0:
                    k += (factor**power - 1.0) * kj
                    m += (factor**power - 1.0) * mj
        return k, m

    def _derivative(self, which: int, a: float, slope: float) -> tuple[Float, Float]:
        dk, dm = np.zeros_like(self.basis.stiffness), np.zeros_like(self.basis.mass)
        for power, kj, mj in self.basis.terms[which]:
            weight = power * a ** (power - 1) * slope
            dk += weight * kj
            dm += weight * mj
        return dk, dm

    def _solve(self, everything: Float, *, all_modes: bool) -> tuple[Float, Float]:
        """λ ascending and M-orthonormal y, from M y = θ (K − σM) y, which keeps the low modes exact."""
        k, m = self._matrices(self.system.parameters.factors(everything))
        r = k.shape[0]
        some = None if all_modes else (r - self.count, r - 1)
        try:
            theta, y = linalg.eigh(m, k - self.shift * m, subset_by_index=some, check_finite=False)
        except linalg.LinAlgError as e:
            far = float(np.abs(everything).max(initial=0.0))
            raise NumericalError(
                f"reduced model: stiffness not definite at |x| up to {far:.3g}; stay nearer to 0"
            ) from e
        theta, y = theta[::-1], y[:, ::-1]
        theta = np.maximum(theta, MASSLESS * theta[0])  # a motion without mass adds its flexibility, no mode
        y = y / np.sqrt(theta)
        lam = self.shift + 1 / theta
        low = y[:, : self.count]  # far from the shift, 1/θ has lost digits that Rayleigh quotients keep
        low /= np.sqrt(np.einsum("ij,ij->j", low, m @ low))
        lam[: self.count] = np.einsum("ij,ij->j", low, k @ low)
        return lam, y

    def error(self, x: Float, *, modes: int | None = None) -> float:
        """An estimate of the largest relative frequency error at x, from residuals: ½ rᵀ(K₀ − σM₀)⁻¹r / (λ − σ).

        The nominal factor stands for that at x, so it is an estimate, not a bound; `enrich` gives the truth.
        """
        everything = self.full_vector(x)
        lam, phi = self.vectors(x)
        lam, phi = lam[:modes], phi[:, :modes]
        r = self.system.stiffness @ phi - (self.system.mass @ phi) * lam
        for a, terms in zip(self.system.parameters.factors(everything).tolist(), self.system.terms, strict=True):
            for t in terms:
                r += (a**t.power - 1.0) * (t.stiffness @ phi - (t.mass @ phi) * lam)
        energy = np.einsum("ij,ij->j", r, self.pencil.at(self.shift).solve(r))
        return float(0.5 * np.max(energy / (lam - self.shift)))

    def augmented(self, vectors: Float) -> ReducedModel:
        """The same with more vectors (f, k) of the free DOFs in the basis: static answers to loads, say."""
        energy = sparse.csr_array(self.system.stiffness - self.shift * self.system.mass)
        fresh = _orthonormal(energy, self.basis.vectors, np.asarray(vectors, dtype=np.float64))
        return replace(self, basis=_project(self.system, np.hstack([self.basis.vectors, fresh]), self.basis))

    def on(self, vectors: Float) -> ReducedModel:
        """The same model and parameters on another basis, independent vectors (f, r) of the free DOFs."""
        energy = sparse.csr_array(self.system.stiffness - self.shift * self.system.mass)
        root = linalg.cholesky(vectors.T @ (energy @ vectors), lower=True)
        fresh = np.asarray(linalg.solve_triangular(root, vectors.T, lower=True)).T
        return replace(self, basis=_project(self.system, fresh), count=min(self.count, vectors.shape[1]))

    def enrich(
        self, x: Float, *, sensitivities: bool = False, progress: Progress | None = None
    ) -> tuple[ReducedModel, Linearisation]:
        """Solve the full model at x and add its modes to the basis.

        Parameters
        ----------
        x : (p,) float64
        sensitivities : bool
            Add the static sensitivities of the active parameters there, too.

        Returns
        -------
        model : ReducedModel
            Exact at x.
        truth : Linearisation
            The full model's modes at x, without sensitivities: compare with `modes(x)` of the old one.
        """
        everything = self.full_vector(x)
        k, m = self.system.at(self.system.parameters.factors(everything))
        pencil = Pencil(k, m, method=self.pencil.method, labels=self.pencil.labels)
        modes = solve_modes(pencil, self.count, shift=self.shift, progress=progress)
        fresh = modes.vectors
        if sensitivities:
            s = _sensitivities(pencil, modes, self.system, self.active, self.count, progress)
            there = sparse.csr_array(k - modes.shift * m)
            fresh = np.hstack([fresh, _compress(there, s, 2 * self.count, 1e-4)])
        pencil.close()
        energy = sparse.csr_array(self.system.stiffness - self.shift * self.system.mass)
        fresh = _orthonormal(energy, self.basis.vectors, fresh)
        basis = _project(self.system, np.hstack([self.basis.vectors, fresh]), self.basis)
        seen = np.asarray(self.system.observe @ modes.vectors)
        n = modes.values.size
        truth = Linearisation(
            np.array(x, dtype=float), modes.frequencies, seen, np.zeros((n, 0)), np.zeros((seen.shape[0], n, 0))
        )
        return replace(self, basis=basis), truth


def reduced_model(
    system: AffineSystem,
    count: int,
    *,
    options: BasisOptions | None = None,
    points: Sequence[Float] = (),
    pencil: Pencil | None = None,
    progress: Progress | None = None,
) -> ReducedModel:
    """Build the basis: modes at x = 0, static sensitivities to every parameter, modes at further points.

    Parameters
    ----------
    system : AffineSystem
    count : int
        Modes returned by the reduced model, the lowest.
    options : BasisOptions, optional
    points : sequence of (p,) float64
        Points x where the modes of the full model are added.
    pencil : Pencil, optional
        Of the nominal K and M, if there is one already.
    """
    options = options or BasisOptions()
    pencil = pencil or Pencil(system.stiffness, system.mass)
    modes = solve_modes(pencil, int(np.ceil(options.extra * count)) + 4, progress=progress)
    n = min(count, modes.values.size)
    energy = sparse.csr_array(system.stiffness - modes.shift * system.mass)
    most, x = options.size - modes.values.size, np.zeros((pencil.size, 0))
    block = max(1, AT_ONCE // max(n, 1))
    for first in range(0, len(system.parameters), block):  # principal directions of so many at a time
        some = range(first, min(first + block, len(system.parameters)))
        x = np.hstack([x, _sensitivities(pencil, modes, system, some, n, progress)])
        if some.stop < len(system.parameters):
            x = _principal(energy, x, most, options.drop)
    x = _compress(energy, x, most, options.drop)
    base_modes = modes.vectors / np.sqrt(modes.values - modes.shift)
    vectors = np.hstack([base_modes, _orthonormal(energy, base_modes, x)])
    every = tuple(range(len(system.parameters)))
    base = np.zeros(len(every))
    model = ReducedModel(system, _project(system, vectors), pencil, modes.shift, n, every, base)
    for point in points:  # snapshots
        model, _ = model.enrich(point, progress=progress)
    return model
