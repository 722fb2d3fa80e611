"""A parametric reduced basis: modes, their static sensitivities and snapshots, projected once,
solved many times.

K(a) = K + Σ_t g_t(a) K_t is a sum of fixed matrices times functions of the factors, so its
projection is too; a point of the parameter space costs one small dense eigensolution. Sources:
Balmès (1996) parametric families of reduced models; Noor, Peters (1980) reduced basis with path
derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.fem.parametrisation.parameter_groups import Pair
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.basis import (
    AffineSystem,
    StaticSensitivities,
    compress,
    inner_product,
    orthonormal_part,
    principal,
    project,
)
from ringtrue.reduction.dense_models import ProjectedModel

MANY = 2400  # static sensitivities from which on random mixtures of them stand for all


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReducedModel(ProjectedModel):
    """A projected model with the full one behind it, to be solved anew where that is asked for.

    Attributes
    ----------
    system : AffineSystem
    pencil : Pencil
        The nominal one, factorised at `shift`; serves `error`.
    """

    system: AffineSystem
    pencil: Pencil

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

    def on(self, vectors: Float) -> ReducedModel:
        """The same model and parameters on another basis, independent vectors (f, r) of the free
        DOFs.
        """
        energy = sparse.csr_array(self.system.stiffness - self.shift * self.system.mass)
        root = linalg.cholesky(vectors.T @ (energy @ vectors), lower=True)
        fresh = np.asarray(linalg.solve_triangular(root, vectors.T, lower=True)).T
        return replace(
            self,
            basis=project(self.system, fresh),
            count=min(self.count, vectors.shape[1]),
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
        terms = [t for i in self.active for t in self.system.terms_of(i)]
        if sensitivities and terms:
            there = StaticSensitivities.of(pencil, modes, self.count)
            s = there.of_each(terms, progress)
            fresh = np.hstack([fresh, compress(there.inner, s, 2 * self.count, 1e-4)])
        pencil.close()
        inner = inner_product(self.system.stiffness, self.system.mass, self.shift)
        fresh = orthonormal_part(inner, self.basis.vectors, fresh)
        basis = project(self.system, np.hstack([self.basis.vectors, fresh]), self.basis)
        seen = np.asarray(self.system.observe @ modes.vectors)
        return replace(self, basis=basis), Linearisation.of_modes(
            x, modes.frequencies, seen
        )


def _static(
    sensitivities: StaticSensitivities,
    terms: Sequence[Pair],
    most: int,
    progress: Progress,
) -> Float:
    """At most `most` principal directions of the static sensitivities: of each, or of random
    mixtures where they are too many.
    """
    count = sensitivities.values.size
    inner = sensitivities.inner
    # share of the largest (strain energy norm) below which directions are left out
    drop = 1e-5
    if len(terms) * count > max(MANY, 4 * most):
        return compress(
            inner, sensitivities.mixed(terms, 2 * most, progress), most, drop
        )
    block = max(1, 800 // max(count, 1))  # what is held in memory
    x = None
    for first in range(0, len(terms), block):
        some = terms[first : first + block]
        share = part(progress, first / len(terms), (first + len(some)) / len(terms))
        fresh = sensitivities.of_each(some, share)
        x = fresh if x is None else np.hstack([principal(inner, x, most, drop), fresh])
    assert x is not None  # there is at least one term
    return compress(inner, x, most, drop)


def basis_vectors(
    modes: Float,
    sensitivities: StaticSensitivities,
    terms: Sequence[Pair],
    progress: Progress = quiet,
) -> Float:
    """Modes and what the static sensitivities add to them, orthonormal in the energy K − σM.

    Parameters
    ----------
    modes : (rows, m) float64
        Of unit energy, in the rows that this process has of all columns.
    terms : sequence of (stiffness, mass)

    Returns
    -------
    (rows, r) float64
    """
    count = modes.shape[1]
    most = max(320, 3 * count // 2) - count
    if not terms or most <= 0:
        return modes
    x = _static(sensitivities, terms, most, progress)
    return np.hstack([modes, orthonormal_part(sensitivities.inner, modes, x)])


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
        modes = solve_modes(
            pencil, wanted, shift=known.shift, progress=part(progress, 0.0, 0.3)
        )
    n = min(count, modes.values.size)
    vectors = basis_vectors(
        modes.vectors / np.sqrt(modes.values - modes.shift),
        StaticSensitivities.of(pencil, modes, n),
        [t for i in range(len(system.parameters)) for t in system.terms_of(i)],
        progress=part(progress, 0.3, 0.8),
    )
    progress(0.8, "projection")
    return ReducedModel(
        system=system,
        basis=project(system, vectors),
        pencil=pencil,
        shift=modes.shift,
        count=n,
        active=tuple(range(len(system.parameters))),
        base=np.zeros(len(system.parameters)),
    )
