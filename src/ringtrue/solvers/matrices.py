"""A model that is only matrices: K(α) = K + Σ α_i K_i, M(α) = M + Σ α_j M_j, D(α) = D + Σ α_k
D_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import NO_DOFS, DofSet
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.eigen.derivatives import MatrixDerivatives
from ringtrue.errors import InputError, did_you_mean
from ringtrue.fem.assembly import System
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation, ModesRequest
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.parametric import ReducedModel, reduced_model
from ringtrue.solvers.embedded import EmbeddedAnalysis

# the cards that targets name; ids count from 1, the field is FACTOR
KINDS = ("STIFFNESS", "MASS", "DAMPING")
Matrix = sparse.csr_array


@dataclass(frozen=True, slots=True, eq=False)
class MatrixModel:
    """Equation (1) of the method as written, with a modal solver's abilities.

    Attributes
    ----------
    K, M : (f, f) sparse or dense
        Stiffness and mass, symmetric, at α = 0.
    D : (f, f), optional
        Viscous damping.
    stiffness, mass, damping : sequences of (f, f)
        K_i, M_j, D_k: what each α multiplies, symmetric.
    dofs : DofSet, optional
        Names of the rows; scalar points 1, 2, ... if not given.
    """

    K: Any
    M: Any
    D: Any = None
    stiffness: Sequence[Any] = ()
    mass: Sequence[Any] = ()
    damping: Sequence[Any] = ()
    dofs: DofSet = NO_DOFS

    def __post_init__(self) -> None:
        n = np.shape(self.K)[0]
        none = sparse.csr_array((n, n))
        for name, a in (
            ("K", self.K),
            ("M", self.M),
            ("D", none if self.D is None else self.D),
        ):
            object.__setattr__(self, name, _checked(a, name, n))
        for name in ("stiffness", "mass", "damping"):
            made = tuple(
                _checked(a, f"{name} {i + 1}", n)
                for i, a in enumerate(getattr(self, name))
            )
            object.__setattr__(self, name, made)
        if not len(self.dofs):
            object.__setattr__(
                self, "dofs", DofSet(np.arange(1, n + 1), np.zeros(n, dtype=np.int8))
            )
        if len(self.dofs) != n:
            raise InputError(f"{len(self.dofs)} names for {n} degrees of freedom")

    @property
    def size(self) -> int:
        """Number of degrees of freedom."""
        return int(self.K.shape[0])

    def parts(self, kind: str) -> tuple[Matrix, ...]:
        """The matrices behind STIFFNESS, MASS or DAMPING."""
        if kind not in KINDS:
            raise InputError(f"no matrices {kind!r}{did_you_mean(kind, KINDS)}")
        return tuple((self.stiffness, self.mass, self.damping)[KINDS.index(kind)])

    def parameters(
        self, lower: float = 0.05, upper: float = 20.0, std: float = 1.0
    ) -> ParameterSet:
        """One linear parameter a matrix, named K1, K2, ... M1, ... D1, ...; x = α, bounds on 1 +
        α.
        """
        made = []
        for letter, kind in zip("KMD", KINDS, strict=True):
            for i in range(1, len(self.parts(kind)) + 1):
                target = CardField(kind, i, "FACTOR")
                p = Parameter(
                    f"{letter}{i}", (target,), lower, upper, scale="linear", std=std
                )
                made.append(p)
        return ParameterSet(tuple(made))

    def slopes(self, parameters: ParameterSet) -> list[MatrixDerivatives]:
        """∂K/∂α, ∂M/∂α, ∂D/∂α of each parameter.

        Raises
        ------
        InputError
            If a target is not one of the matrices.
        """
        out = []
        for p in parameters.parameters:
            total = [sparse.csr_array(self.K.shape) for _ in KINDS]
            for t in p.targets:
                parts = self.parts(t.card)
                if t.field != "FACTOR" or not 1 <= t.id <= len(parts):
                    raise InputError(
                        f"parameter {p.name}: {t.card} {t.id} {t.field}; there are {len(parts)} "
                        "FACTORs"
                    )
                at = KINDS.index(t.card)
                total[at] = sparse.csr_array(total[at] + parts[t.id - 1])
            out.append(MatrixDerivatives(*total))
        return out

    def at(self, parameters: ParameterSet, factors: Float) -> MatrixModel:
        """The model with factors 1 + α (p,) taken into K, M and D; its own parts stay as they
        are.
        """
        total = [self.K, self.M, self.D]
        # over parameters
        for a, s in zip(
            np.asarray(factors).tolist(), self.slopes(parameters), strict=True
        ):
            parts = (s.stiffness, s.mass, s.viscous)
            total = [
                A if B is None else A + (a - 1.0) * B
                for A, B in zip(total, parts, strict=True)
            ]
        return replace(self, K=total[0], M=total[1], D=total[2])

    def open(self, *, progress: Progress = quiet) -> MatrixAnalysis:
        """Modes, derivatives, static solutions, FRFs and complex modes at α = 0, on one
        factorisation.
        """
        return MatrixAnalysis(self, progress=progress)

    def system(self) -> System:
        """As an assembled system: every row is free."""
        identity = sparse.eye_array(self.size, format="csr")
        return System(
            stiffness=self.K,
            mass=self.M,
            viscous=self.D,
            structural=sparse.csr_array(self.K.shape),
            transform=identity,
            local=identity,
            dofs=self.dofs,
            free=self.dofs,
            autospc=NO_DOFS,
            xyz=np.empty((0, 3)),
        )

    def observe(self, rows: Int | Sequence[int]) -> Observation:
        """An observation of the rows as they are."""
        at = np.asarray(rows, dtype=np.int64)
        pick = sparse.csr_array(
            (np.ones(at.size), (np.arange(at.size), at)), shape=(at.size, self.size)
        )
        names = self.dofs.labels()
        return Observation(
            pick,
            tuple(names[i] for i in at.tolist()),
            self.dofs,
            1.0,
            np.zeros(at.size),
        )

    def observed(
        self,
        observation: Observation,
        *,
        parameters: ParameterSet | None = None,
        request: ModesRequest | None = None,
    ) -> ObservedMatrices:
        """An `ObservedModel` that solves anew at each point."""
        p = self.parameters() if parameters is None else parameters
        return ObservedMatrices(self, p, observation, request or ModesRequest())

    def reduced(
        self,
        observation: Observation,
        count: int,
        *,
        parameters: ParameterSet | None = None,
    ) -> ReducedModel:
        """An `ObservedModel` on a reduced basis of stiffness and mass."""
        p = self.parameters() if parameters is None else parameters
        parts = tuple(
            AffineTerm(power(i), s.stiffness, s.mass)
            for i, s in enumerate(self.slopes(p))
        )
        affine = AffineSystem(
            self.K, self.M, p, parts, sparse.csr_array(observation.matrix)
        )
        return reduced_model(affine, count)


def _checked(a: Any, name: str, n: int) -> Matrix:
    """As a real symmetric csr matrix.

    Raises
    ------
    InputError
        If it is not square, of another size, complex or not symmetric.
    """
    A = sparse.csr_array(a)
    if A.shape != (n, n):
        raise InputError(f"matrix {name} is {A.shape}; it must be {(n, n)}")
    if np.iscomplexobj(A.data):
        raise InputError(
            f"matrix {name} is complex; give its real part, damping goes to D"
        )
    A = sparse.csr_array(A.astype(np.float64))
    A.sum_duplicates()
    difference = abs(A - A.T).max() if A.nnz else 0.0
    if difference > 1e-9 * abs(A).max():
        raise InputError(
            f"matrix {name} is not symmetric (by {difference:.3g}); was only one triangle given?"
        )
    return sparse.csr_array((A + A.T) * 0.5) if difference else A


class MatrixAnalysis(EmbeddedAnalysis):
    """A `MatrixModel`, opened; see `ringtrue.model.ports.Analysis`."""

    def __init__(self, matrices: MatrixModel, *, progress: Progress = quiet) -> None:
        super().__init__(Model({}), matrices.system(), progress=progress)
        self.matrices = matrices

    def slopes(self, parameters: ParameterSet) -> Sequence[MatrixDerivatives]:
        """∂K/∂α, ∂M/∂α, ∂D/∂α."""
        return self.matrices.slopes(parameters)


@dataclass(frozen=True, slots=True, eq=False)
class ObservedMatrices:
    """An `ObservedModel` of a `MatrixModel` by full solves.

    Attributes
    ----------
    model : MatrixModel
    parameters : ParameterSet
    observation : Observation
    request : ModesRequest
    """

    model: MatrixModel
    parameters: ParameterSet
    observation: Observation
    request: ModesRequest

    def modes(self, x: Float) -> Linearisation:
        """Modes at x (p,); sensitivities with no columns."""
        with self._open(x) as analysis:
            modes = analysis.modes(self.request).modes
        return Linearisation.of_modes(
            x, modes.frequencies, self.observation(modes.shapes)
        )

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x (p,)."""
        slope = self.parameters.derivative(x)
        with self._open(x) as analysis:
            modes = analysis.modes(self.request).modes
            d_lambda, d_phi = analysis.derivatives(modes, self.parameters)
        seen = np.asarray(self.observation(modes.shapes))
        d_seen = self.observation(d_phi.reshape(d_phi.shape[0], -1))
        d_seen = np.reshape(d_seen, (*seen.shape, slope.size)) * slope
        return Linearisation(
            np.array(x, dtype=float), modes.frequencies, seen, d_lambda * slope, d_seen
        )

    def _open(self, x: Float) -> MatrixAnalysis:
        return self.model.at(self.parameters, self.parameters.factors(x)).open()
