"""Models as small dense matrices, seen at channels: on a reduced basis, or of another program.

On a basis a point of the parameter space costs one small dense eigensolution, and no matrix of the
whole model is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, freeze_arrays
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.eigen.derivatives import modal_coefficients
from ringtrue.eigen.eigenpairs import frequencies
from ringtrue.errors import InputError, NumericalError
from ringtrue.model.ports import Analysis, Linearisation
from ringtrue.reduction.basis import ProjectedSystem

# θ = 1/(λ − σ), relative to the largest, below which a vector of the basis has no mass
MASSLESS = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedModel:
    """An `ObservedModel` on a reduced basis.

    Attributes
    ----------
    basis : ProjectedSystem
    shift : float
        σ of the energy K − σM in which the basis is orthonormal, (rad/s)².
    count : int
        Modes returned, the lowest.
    active : tuple of int
        The parameters that x stands for; the others stay at `base`.
    base : (all parameters,) float64
    scale : int
        Of the modes returned, the lowest that set the size of rounding; 0: all.
    """

    basis: ProjectedSystem
    shift: float
    count: int
    active: tuple[int, ...]
    base: Float
    scale: int = 0
    # the lowest modes at the last x; `replace` begins without
    _last: dict[bytes, tuple[Float, Float]] = field(
        default_factory=dict, init=False, repr=False
    )

    @property
    def parameters(self) -> ParameterSet:
        """The active parameters."""
        return self.basis.parameters.take(self.active)

    def with_parameters(self, active: Sequence[int], base: Float | None = None) -> Self:
        """The same basis with x for the chosen parameters only (positions in `basis.parameters`).

        Parameters
        ----------
        active : sequence of int
        base : (all parameters,) float64, optional
            Where the others stay; as they are now if not given.
        """
        return replace(
            self,
            active=tuple(active),
            base=self.base if base is None else np.array(base, dtype=float),
        )

    def full_vector(self, x: Float) -> Float:
        """x of all parameters (P,) from that of the active ones (p,)."""
        x = np.asarray(x, dtype=np.float64)
        if x.shape != (len(self.active),):
            raise InputError(
                f"x {x.shape}; there are {len(self.active)} active parameters"
            )
        out = self.base.copy()
        out[list(self.active)] = x
        return out

    def linearise(self, x: Float) -> Linearisation:
        """Modes and exact sensitivities of the reduced model at x (p,)."""
        everything = self.full_vector(x)
        a = self.basis.parameters.factors(everything)
        slope = self.basis.parameters.derivative(everything)
        m = self.count
        # the slopes first: functions that call element kernels know their values with them
        weights = np.zeros((len(self.active), len(self.basis.terms)))
        for i, which in enumerate(self.active):  # over parameters
            for t in self.basis.of.get(which, []):
                weights[i, t] = (
                    self.basis.terms[t][0].derivative(a, which) * slope[which]
                )
        lam, y = self._solve(everything, all_modes=True)
        dk, dm = (_products(acting, weights, y, m) for acting in self.basis.acting)
        d_lambda = (
            np.einsum("pii->ip", dk[:, :m])
            - np.einsum("pii->ip", dm[:, :m]) * lam[:m, None]
        )
        c = np.empty((len(self.active), lam.size, m))
        for i in range(len(self.active)):
            c[i] = modal_coefficients(dk[i], dm[i], lam, low=self.scale)
        seen = self.basis.observe @ y
        d_shapes = np.moveaxis(seen @ c, 0, -1)
        return Linearisation(
            np.array(x, dtype=float),
            frequencies(lam[:m]),
            seen[:, :m],
            d_lambda,
            d_shapes,
        )

    def modes(self, x: Float) -> Linearisation:
        """Modes only (sensitivities with no columns)."""
        lam, y = self.coordinates(x)
        seen = self.basis.observe @ y
        return Linearisation.of_modes(x, frequencies(lam), seen)

    def coordinates(self, x: Float) -> tuple[Float, Float]:
        """λ (m,) and the modes in the basis (r, m) at x; those of the last x are kept."""
        everything = self.full_vector(x)
        key = everything.tobytes()
        if key not in self._last:
            lam, y = self._solve(everything, all_modes=False)
            lam.flags.writeable = y.flags.writeable = False
            self._last.clear()
            self._last[key] = lam, y
        return self._last[key]

    def vectors(self, x: Float) -> tuple[Float, Float]:
        """λ (m,) and φ (f, m) at x, as the vectors of the basis are given."""
        lam, y = self.coordinates(x)
        return lam, self.basis.vectors @ y

    def projected(self, a: Float) -> tuple[Float, Float]:
        """K and M (r, r) in the basis at the factors a of all parameters."""
        values = [f.value(a) for f, _, _ in self.basis.terms]
        both = self.basis.stiffness.copy(), self.basis.mass.copy()
        for total, acting in zip(both, self.basis.acting, strict=True):
            for t, matrix in acting.items():
                if values[t]:
                    total += values[t] * matrix
        return both

    def derivative(
        self, a: Float, which: int, slope: float = 1.0
    ) -> tuple[Float, Float]:
        """∂K/∂a and ∂M/∂a (r, r) of one parameter, by position, times da/dx, at the factors a of
        all.
        """
        dk = np.zeros_like(self.basis.stiffness)
        dm = np.zeros_like(self.basis.mass)
        for i in self.basis.of.get(which, ()):
            f, kt, mt = self.basis.terms[i]
            weight = f.derivative(a, which) * slope
            dk += weight * kt
            dm += weight * mt
        return dk, dm

    def _solve(self, everything: Float, *, all_modes: bool) -> tuple[Float, Float]:
        """λ ascending and M-orthonormal y, from M y = θ (K − σM) y, which keeps the low modes
        exact.
        """
        k, m = self.projected(self.basis.parameters.factors(everything))
        r = k.shape[0]
        some = None if all_modes else (r - self.count, r - 1)
        try:
            theta, y = linalg.eigh(
                m, k - self.shift * m, subset_by_index=some, check_finite=False
            )
        except linalg.LinAlgError as e:
            far = float(np.abs(everything).max(initial=0.0))
            raise NumericalError(
                f"reduced model: stiffness not definite at |x| up to {far:.3g}; stay nearer to 0"
            ) from e
        theta = theta[::-1]
        y = y[:, ::-1]
        moving = int(np.count_nonzero(theta[: self.count] > MASSLESS * theta[0]))
        # a motion without mass adds its flexibility, no mode
        theta = np.maximum(theta, MASSLESS * theta[0])
        y = y / np.sqrt(theta)
        lam = self.shift + 1 / theta
        # far from the shift, 1/θ has lost digits that Rayleigh quotients keep
        low = y[:, :moving]
        low /= np.sqrt(np.einsum("ij,ij->j", low, m @ low))
        lam[:moving] = np.einsum("ij,ij->j", low, k @ low)
        return lam, y

    def with_basis(self, basis: ProjectedSystem) -> Self:
        """The same model on another projection of its system."""
        return replace(self, basis=basis)

    def whole(self) -> Self:
        """The same with all modes of the basis up to 100 times the highest frequency returned: sums
        over them hold its flexibility, and sensitivities of stiffer ones are rounding.

        They are counted at `base`, so that the number does not change from point to point.
        """
        everything = replace(self, count=self.basis.size)
        lam, _ = everything._solve(self.base, all_modes=False)
        count = int(
            np.searchsorted(lam, 100**2 * abs(lam[self.count - 1]), side="right")
        )
        return replace(self, count=count, scale=self.scale or self.count)


Along = Callable[[Sequence[Parameter], Float], tuple[Float, Float]]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HeldModel(ProjectedModel):
    """A projected model; the vectors of its basis are coordinates (h, r) by h vectors held
    elsewhere.

    Attributes
    ----------
    along : callable
        vᵀ(∂K/∂a)v and vᵀ(∂M/∂a)v, (p, m, m) each, of p parameters along combinations (h, m) of the
        held vectors.
    """

    along: Along


@runtime_checkable
class ReducingAnalysis(Analysis, Protocol):
    """An analysis that reduces its model where its matrices are."""

    def reduced(
        self,
        parameters: ParameterSet,
        readings: sparse.csr_array,
        count: int,
        fmax: float,
    ) -> HeldModel:
        """The reduced model that returns the lowest `count` modes, up to `fmax`, Hz, seen by
        readings (channel, dof).
        """
        ...


AnyProjected = TypeVar("AnyProjected", bound=ProjectedModel)


def _products(acting: dict[int, Float], weights: Float, y: Float, m: int) -> Float:
    """yᵀ (Σ w A) y (p, r, m) of matrices A (r, r) by their terms, weights w (p, t) of these, and
    modes y (r, r).
    """
    out = np.zeros((len(weights), y.shape[1], m))
    for i, own in enumerate(weights):  # over parameters: fewer than terms of several
        if used := [t for t in acting if own[t]]:
            total = own[used[0]] * acting[used[0]]
            for t in used[1:]:
                total += own[t] * acting[t]
            out[i] = y.T @ (total @ y[:, :m])
    return out


def condensed(model: AnyProjected, points: Sequence[Float], size: int) -> AnyProjected:
    """The model on the principal directions of its modes at points x, in the energy K − σM.

    Proper orthogonal decomposition: of all bases of that size the one that leaves the least energy
    of these modes out. Good between the points; away from them it is too stiff.

    Parameters
    ----------
    points : sequence of (p,) float64
        Of the active parameters.
    size : int
        Vectors kept; not fewer than the modes of the model.

    """
    b = model.basis
    if size >= b.size:
        return model
    root = linalg.cholesky(b.stiffness - model.shift * b.mass)
    parts = []
    for x in points:
        lam, y = model.coordinates(x)
        parts.append(root @ (y / np.sqrt(lam - model.shift)))
    u, _, _ = linalg.svd(np.hstack(parts), full_matrices=False)
    v = linalg.solve_triangular(root, u[:, :size])
    terms = tuple((f, v.T @ k @ v, v.T @ m @ v) for f, k, m in b.terms)
    basis = ProjectedSystem(
        parameters=b.parameters,
        vectors=b.vectors @ v,
        stiffness=v.T @ b.stiffness @ v,
        mass=v.T @ b.mass @ v,
        terms=terms,
        observe=b.observe @ v,
    )
    return replace(model, basis=basis)


@dataclass(frozen=True, slots=True, eq=False)
class MatricesAtPoint:
    """A model at one point as small matrices, with their derivatives to x.

    Attributes
    ----------
    stiffness, mass : (n, n) float64
    d_stiffness, d_mass : (p, n, n) float64, ∂K/∂x and ∂M/∂x
    observe : (channel, n) float64
    """

    stiffness: Float
    mass: Float
    d_stiffness: Float
    d_mass: Float
    observe: Float


@dataclass(frozen=True, slots=True, eq=False)
class DenseModel:
    """K(a) = K0 + Σ (a_i − 1) K_i and M(a) = M0 + Σ (a_i − 1) M_i; an `ObservedModel` with exact
    derivatives.

    All modes are solved at each point, so the eigenvector derivatives come from the full modal
    expansion (Fox and Kapoor, 1968). Within repeated eigenvalues the part of the derivative along
    the other members is left out: it is not defined.

    Attributes
    ----------
    stiffness, mass : (n, n) float64, at nominal
    d_stiffness, d_mass : (p, n, n) float64, ∂K/∂a and ∂M/∂a
    observation : (channel, n) float64
    parameters : ParameterSet
    count : int
        Number of modes that are returned.
    """

    stiffness: Float
    mass: Float
    d_stiffness: Float
    d_mass: Float
    observation: Float
    parameters: ParameterSet
    count: int

    def __post_init__(self) -> None:
        freeze_arrays(self)
        n = self.stiffness.shape[0]
        p = len(self.parameters)
        shapes = self.d_stiffness.shape, self.d_mass.shape
        if shapes != ((p, n, n),) * 2 or self.observation.shape[1] != n:
            raise InputError(
                f"{p} parameters and {n} DOFs: got d_stiffness {shapes[0]}, "
                f"d_mass {shapes[1]}, observation {self.observation.shape}"
            )
        if n > 3000:
            raise InputError(
                f"{n} DOFs: dense matrices are for 3000 and less; reduce the model first"
            )

    @classmethod
    def springs(
        cls,
        stiffness: Float,
        mass: Float,
        d_stiffness: Float,
        parameters: ParameterSet,
        channels: Sequence[int] = (),
    ) -> DenseModel:
        """Stiffness parameters only, channels at the given DOFs (all)."""
        eye = np.eye(len(stiffness))
        seen = eye[list(channels)] if len(channels) else eye
        return cls(
            stiffness=stiffness,
            mass=mass,
            d_stiffness=d_stiffness,
            d_mass=np.zeros_like(d_stiffness),
            observation=seen,
            parameters=parameters,
            count=len(stiffness),
        )

    def with_parameters(
        self, active: Sequence[int], base: Float | None = None
    ) -> DenseModel:
        """The model with some of its parameters, by position; the others stay at `base` (p,),
        nominal if not given.
        """
        at = list(active)
        hold = (
            np.zeros(len(self.parameters))
            if base is None
            else np.array(base, dtype=np.float64)
        )
        hold[at] = 0.0
        stiffness, mass = self._at(hold)
        return replace(
            self,
            stiffness=stiffness,
            mass=mass,
            d_stiffness=self.d_stiffness[at],
            d_mass=self.d_mass[at],
            parameters=self.parameters.take(at),
        )

    def _at(self, x: Float) -> tuple[Float, Float]:
        """K and M at x."""
        change = self.parameters.factors(x) - 1.0
        k = self.stiffness + np.tensordot(change, self.d_stiffness, axes=1)
        return k, self.mass + np.tensordot(change, self.d_mass, axes=1)

    def matrices(self, x: Float) -> MatricesAtPoint:
        """K, M and their derivatives at x (p,)."""
        slope = self.parameters.derivative(x)[:, None, None]
        return MatricesAtPoint(
            *self._at(x),
            self.d_stiffness * slope,
            self.d_mass * slope,
            self.observation,
        )

    def modes(self, x: Float) -> Linearisation:
        """Modes at x (p,), without sensitivities."""
        lam, phi = linalg.eigh(*self._at(x))
        seen = self.observation @ phi[:, : self.count]
        return Linearisation.of_modes(x, frequencies(lam[: self.count]), seen)

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x (p,)."""
        lam, phi = linalg.eigh(*self._at(x))
        c = min(self.count, lam.size)
        slope = self.parameters.derivative(x)
        dk = np.einsum(
            "ni,pnk,kj->pij", phi, self.d_stiffness, phi[:, :c], optimize=True
        )
        dm = np.einsum("ni,pnk,kj->pij", phi, self.d_mass, phi[:, :c], optimize=True)
        force = (dk - lam[:c] * dm) * slope[:, None, None]  # (p, all, c)
        kept = np.arange(c)
        d_lambda = force[:, kept, kept].T
        gap = lam[:c] - lam[:, None]
        repeated = np.abs(gap) <= 1e-9 * np.abs(lam).max()  # shapes that mix freely
        mix = np.where(repeated, 0.0, force / np.where(repeated, 1.0, gap))
        mix[:, kept, kept] = -0.5 * dm[:, kept, kept] * slope[:, None]
        seen = self.observation @ phi
        d_shapes = np.einsum("ni,pij->njp", seen, mix, optimize=True)
        return Linearisation(
            np.asarray(x), frequencies(lam[:c]), seen[:, :c], d_lambda, d_shapes
        )


def matrices_at(model: object, x: Float) -> MatricesAtPoint:
    """Small matrices of a model at x (p,): of a `ProjectedModel` in its basis, or those it gives
    itself by `matrices`.

    Raises
    ------
    InputError
        If the model has no small matrices.
    """
    if isinstance(model, ProjectedModel):
        return _reduced(model, x)
    give = getattr(model, "matrices", None)
    if give is None:
        raise InputError(
            f"{type(model).__name__} has no small matrices; reduce the model (reduce.parametric)"
        )
    return give(x)  # type: ignore[no-any-return]


def _reduced(model: ProjectedModel, x: Float) -> MatricesAtPoint:
    """The projected matrices."""
    everything = model.full_vector(x)
    a = model.basis.parameters.factors(everything)
    slope = model.basis.parameters.derivative(everything)
    k, m = model.projected(a)
    both = [model.derivative(a, i, float(slope[i])) for i in model.active]
    dk, dm = (
        np.reshape([pair[j] for pair in both], (len(both), *k.shape)) for j in range(2)
    )
    return MatricesAtPoint(k, m, dk, dm, model.basis.observe)
