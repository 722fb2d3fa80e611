"""A parametric reduced basis: modes, their static sensitivities and snapshots, projected once,
solved many times.

K(a) = K + Σ_t g_t(a) K_t is a sum of fixed matrices times functions of the factors, so its
projection is too; a point of the parameter space costs one small dense eigensolution. Sources:
Balmès (1996) parametric families of reduced models; Noor, Peters (1980) reduced basis with path
derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.eigen.derivatives import modal_coefficients
from ringtrue.eigen.eigenpairs import EigenModes, frequencies
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError, NumericalError
from ringtrue.fem.parametrisation.parameter_groups import Pair
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.basis import (
    AffineSystem,
    ProjectedSystem,
    StaticSensitivities,
    compress,
    orthonormal_part,
    principal,
    project,
)

MANY = 2400  # static sensitivities from which on random mixtures of them stand for all
# θ = 1/(λ − σ), relative to the largest, below which a vector of the basis has no mass
MASSLESS = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """An `ObservedModel` on a reduced basis.

    Attributes
    ----------
    system : AffineSystem
    basis : ProjectedSystem
    pencil : Pencil
        The nominal one, factorised at `shift`; serves `error`.
    shift : float
    count : int
        Modes returned, the lowest.
    active : tuple of int
        The parameters that x stands for; the others stay at `base`.
    base : (all parameters,) float64
    scale : int
        Of the modes returned, the lowest that set the size of rounding; 0: all.
    """

    system: AffineSystem
    basis: ProjectedSystem
    pencil: Pencil
    shift: float
    count: int
    active: tuple[int, ...]
    base: Float
    scale: int = 0
    # the lowest modes at the last x; `replace` begins without
    _last: dict[bytes, tuple[Float, Float]] = field(default_factory=dict, init=False, repr=False)

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
        return replace(
            self,
            active=tuple(active),
            base=self.base if base is None else np.array(base, dtype=float),
        )

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
        a = self.system.parameters.factors(everything)
        slope = self.system.parameters.derivative(everything)
        m = self.count
        weights = np.zeros((len(self.active), len(self.basis.terms)))
        for i, which in enumerate(self.active):  # over parameters
            for t in self.basis.of.get(which, []):
                weights[i, t] = self.basis.terms[t][0].derivative(a, which) * slope[which]
        dk, dm = (_products(acting, weights, y, m) for acting in self.basis.acting)
        d_lambda = np.einsum("pii->ip", dk[:, :m]) - np.einsum("pii->ip", dm[:, :m]) * lam[:m, None]
        c = np.empty((len(self.active), lam.size, m))
        for i in range(len(self.active)):
            c[i] = modal_coefficients(dk[i], dm[i], lam, low=self.scale)
        seen = self.basis.observe @ y
        d_shapes = np.moveaxis(seen @ c, 0, -1)
        return Linearisation(
            np.array(x, dtype=float), frequencies(lam[:m]), seen[:, :m], d_lambda, d_shapes
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
        """λ (m,) and φ (f, m) at x, in the free DOFs."""
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

    def derivative(self, a: Float, which: int, slope: float = 1.0) -> tuple[Float, Float]:
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
        k, m = self.projected(self.system.parameters.factors(everything))
        r = k.shape[0]
        some = None if all_modes else (r - self.count, r - 1)
        try:
            theta, y = linalg.eigh(m, k - self.shift * m, subset_by_index=some, check_finite=False)
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
        low = y[:, :moving]  # far from the shift, 1/θ has lost digits that Rayleigh quotients keep
        low /= np.sqrt(np.einsum("ij,ij->j", low, m @ low))
        lam[:moving] = np.einsum("ij,ij->j", low, k @ low)
        return lam, y

    def error(self, x: Float) -> float:
        """An estimate of the largest relative frequency error at x, from residuals: ½ rᵀ(K₀ −
        σM₀)⁻¹r / (λ − σ).

        The nominal factor stands for that at x, so it is an estimate, not a bound; `enrich` gives
        the truth.
        """
        everything = self.full_vector(x)
        lam, phi = self.vectors(x)
        r = self.system.stiffness @ phi - (self.system.mass @ phi) * lam
        a = self.system.parameters.factors(everything)
        for t in self.system.terms:
            if value := t.function.value(a):
                r += value * (t.stiffness @ phi - (t.mass @ phi) * lam)
        energy = np.einsum("ij,ij->j", r, self.pencil.at(self.shift).solve(r))
        return float(0.5 * np.max(energy / (lam - self.shift)))

    def with_basis(self, basis: ProjectedSystem) -> ReducedModel:
        """The same model on another projection of its system."""
        return replace(self, basis=basis)

    def whole(self) -> ReducedModel:
        """The same with all modes of the basis up to 100 times the highest frequency returned: sums
        over them hold its flexibility, and sensitivities of stiffer ones are rounding.

        They are counted at `base`, so that the number does not change from point to point.
        """
        everything = replace(self, count=self.basis.size)
        lam, _ = everything._solve(self.base, all_modes=False)
        count = int(np.searchsorted(lam, 100**2 * abs(lam[self.count - 1]), side="right"))
        return replace(self, count=count, scale=self.scale or self.count)

    def on(self, vectors: Float) -> ReducedModel:
        """The same model and parameters on another basis, independent vectors (f, r) of the free
        DOFs.
        """
        energy = sparse.csr_array(self.system.stiffness - self.shift * self.system.mass)
        root = linalg.cholesky(vectors.T @ (energy @ vectors), lower=True)
        fresh = np.asarray(linalg.solve_triangular(root, vectors.T, lower=True)).T
        return replace(
            self, basis=project(self.system, fresh), count=min(self.count, vectors.shape[1])
        )

    def enrich(
        self, x: Float, *, sensitivities: bool = False, progress: Progress = quiet
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
            The full model's modes at x, without sensitivities: compare with `modes(x)` of the old
            one.
        """
        everything = self.full_vector(x)
        k, m = self.system.at(self.system.parameters.factors(everything))
        pencil = Pencil(k, m, method=self.pencil.method, labels=self.pencil.labels)
        modes = solve_modes(pencil, self.count, shift=self.shift, progress=progress)
        fresh = modes.vectors
        if sensitivities:
            terms = [t for i in self.active for t in self.system.terms_of(i)]
            s = StaticSensitivities(pencil, modes, self.count).of_each(terms, progress)
            there = sparse.csr_array(k - modes.shift * m)
            fresh = np.hstack([fresh, compress(there, s, 2 * self.count, 1e-4)])
        pencil.close()
        energy = sparse.csr_array(self.system.stiffness - self.shift * self.system.mass)
        fresh = orthonormal_part(energy, self.basis.vectors, fresh)
        basis = project(self.system, np.hstack([self.basis.vectors, fresh]), self.basis)
        seen = np.asarray(self.system.observe @ modes.vectors)
        return replace(self, basis=basis), Linearisation.of_modes(x, modes.frequencies, seen)


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


def _static(
    sensitivities: StaticSensitivities,
    terms: Sequence[Pair],
    most: int,
    progress: Progress,
) -> Float:
    """At most `most` principal directions of the static sensitivities: of each, or of random
    mixtures where they are too many.
    """
    pencil = sensitivities.pencil
    count = sensitivities.count
    drop = 1e-5  # share of the largest (strain energy norm) below which directions are left out
    x = np.zeros((pencil.size, 0))
    if most <= 0:
        return x
    energy = sparse.csr_array(pencil.stiffness - sensitivities.modes.shift * pencil.mass)
    if len(terms) * count > max(MANY, 4 * most):
        return compress(energy, sensitivities.mixed(terms, 2 * most, progress), most, drop)
    block = max(1, 800 // max(count, 1))  # what is held in memory
    for first in range(0, len(terms), block):
        some = terms[first : first + block]
        share = part(progress, first / len(terms), (first + len(some)) / len(terms))
        x = np.hstack([x, sensitivities.of_each(some, share)])
        if first + block < len(terms):
            x = principal(energy, x, most, drop)
    return compress(energy, x, most, drop)


def modes_of(count: int) -> int:
    """How many modes of the nominal model a basis that returns `count` holds."""
    return int(np.ceil(1.3 * count)) + 4


@dataclass(frozen=True, slots=True, eq=False)
class KnownModes:
    """What there is already of the nominal model.

    Attributes
    ----------
    pencil : Pencil
        Of its K and M.
    modes : EigenModes, optional
        Its lowest; used where they are as many as `modes_of` asks for.
    shift : float, optional
        A good negative shift, (rad/s)², to find more from; sought if not given.
    """

    pencil: Pencil
    modes: EigenModes | None = None
    shift: float | None = None


def reduced_model(
    system: AffineSystem,
    count: int,
    *,
    known: KnownModes | None = None,
    progress: Progress = quiet,
) -> ReducedModel:
    """Build the basis: modes at x = 0 and static sensitivities to every parameter.

    Parameters
    ----------
    system : AffineSystem
    count : int
        Modes returned by the reduced model, the lowest.
    known : KnownModes, optional
    """
    known = known or KnownModes(Pencil(system.stiffness, system.mass))
    pencil = known.pencil
    modes = known.modes
    wanted = modes_of(count)
    if modes is None or modes.values.size < wanted:
        modes = solve_modes(pencil, wanted, shift=known.shift, progress=part(progress, 0.0, 0.3))
    n = min(count, modes.values.size)
    energy = sparse.csr_array(system.stiffness - modes.shift * system.mass)
    x = _static(
        StaticSensitivities(pencil, modes, n),
        [t for i in range(len(system.parameters)) for t in system.terms_of(i)],
        most=max(320, 3 * modes.values.size // 2) - modes.values.size,
        progress=part(progress, 0.3, 0.8),
    )
    progress(0.8, "projection")
    base_modes = modes.vectors / np.sqrt(modes.values - modes.shift)
    vectors = np.hstack([base_modes, orthonormal_part(energy, base_modes, x)])
    return ReducedModel(
        system,
        basis=project(system, vectors),
        pencil=pencil,
        shift=modes.shift,
        count=n,
        active=tuple(range(len(system.parameters))),
        base=np.zeros(len(system.parameters)),
    )


def condensed(model: ReducedModel, points: Sequence[Float], size: int) -> ReducedModel:
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
        b.vectors @ v, v.T @ b.stiffness @ v, v.T @ b.mass @ v, terms, b.observe @ v
    )
    return replace(model, basis=basis)
