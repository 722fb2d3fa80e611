"""The dynamic stiffness Q(s) = s²M + sD + K + iH, factorised at any complex s on one analysis.

Complex modes of a damped structure: projected on its real modes, or of the full quadratic
problem.

s²M + sD + K + iH with viscous damping D and structural damping H; first-order form of Foss (1958).
The full problem is solved by Arnoldi iteration on the linearised problem, shifted and inverted by
one factor of Q(σ): a step costs a solve with n rows, not 2n (Tisseur and Meerbergen 2001, ch. 5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

from ringtrue.core.arrays import Any_, Complex, Float, FrozenArrays
from ringtrue.core.modes import HasPoles
from ringtrue.eigen.engines import Engine, Pattern, choose, factorise
from ringtrue.errors import InputError, NotConverged, SingularModel

# of a solve; what a factor in double precision exceeds only on a pole
RESIDUAL_LIMIT = 1e-6


class DynamicStiffness:
    """K, M, viscous D and structural H on one sparsity pattern; holds one factorisation, which
    moves with s.

    Parameters
    ----------
    stiffness, mass : (f, f) csr_array float64
        Symmetric, both triangles.
    viscous, structural : (f, f) csr_array float64, optional
    """

    def __init__(
        self,
        stiffness: sparse.csr_array,
        mass: sparse.csr_array,
        viscous: sparse.csr_array | None = None,
        structural: sparse.csr_array | None = None,
    ) -> None:
        none = sparse.csr_array(stiffness.shape, dtype=np.float64)
        self.stiffness = stiffness
        self.mass = mass
        self.viscous: sparse.csr_array = none if viscous is None else viscous
        self.structural: sparse.csr_array = none if structural is None else structural
        parts = (stiffness, mass, self.viscous, self.structural)
        self.method = choose("auto", self.size)
        self._pattern = Pattern(*(a for a in parts if a.nnz))
        self._entries = [self._pattern.entries(a) for a in parts]
        self._engine: Engine | None = None
        self._at = complex(np.nan)

    @property
    def size(self) -> int:
        """Number of rows."""
        return int(self.stiffness.shape[0])

    def matrix(self, s: complex) -> sparse.csr_array:
        """Q(s), (f, f) complex128."""
        made = (
            self.stiffness + self.mass * s**2 + self.viscous * s + self.structural * 1j
        )
        return sparse.csr_array(made.astype(np.complex128))

    def product(self, s: complex | Complex, x: Any_) -> Complex:
        """Q(s) x for x (f, k) and one s, or one s a column (k,)."""
        made = self.stiffness @ x + (self.mass @ x) * s**2 + (self.viscous @ x) * s
        return np.asarray(made + 1j * (self.structural @ x), dtype=np.complex128)

    def residuals(self, poles: Complex, shapes: Complex) -> Float:
        """‖Q(s)φ‖ / (‖Kφ‖ + |s|‖Dφ‖ + |s|²‖Mφ‖ + ‖Hφ‖) of poles (m,) with shapes (f, m)."""
        terms = (
            (self.stiffness, np.ones(poles.size)),
            (self.viscous, np.abs(poles)),
            (self.mass, np.abs(poles) ** 2),
            (self.structural, np.ones(poles.size)),
        )
        size = sum(np.linalg.norm(np.asarray(a @ shapes), axis=0) * f for a, f in terms)
        return np.asarray(
            np.linalg.norm(self.product(poles, shapes), axis=0)
            / np.maximum(size, np.finfo(float).tiny)
        )

    def solve(self, s: complex, rhs: Any_) -> Complex:
        """Q(s)⁻¹ rhs, (f, k) complex128, refined once.

        Raises
        ------
        SingularModel
            If s is a pole, or the model a mechanism without mass.
        OutOfMemory
        """
        factor = self._factor(s)
        rhs = np.asarray(rhs, dtype=np.complex128)
        x = factor.solve(rhs)
        x = x + factor.solve(rhs - self.product(s, x))
        rest = np.abs(rhs - self.product(s, x)).max(initial=0.0)
        if not rest <= RESIDUAL_LIMIT * np.abs(rhs).max(initial=np.finfo(float).tiny):
            raise SingularModel(
                (),
                f"the dynamic stiffness at s = {s:.6g} rad/s leaves a residual of {rest:.1e}",
            )
        return x

    def _factor(self, s: complex) -> Engine:
        if self._engine is not None and s == self._at:
            return self._engine

        def values() -> Complex:
            out = np.zeros(self._pattern.indices.size, dtype=np.complex128)
            for (at, data), factor in zip(
                self._entries, (1.0, s**2, s, 1j), strict=True
            ):
                out[at] += factor * data
            return out

        if self._engine is None:
            self._engine = factorise(self.method, self._pattern, values)
        else:
            self._engine.refactor(values)
        self._at = s
        if self._engine.singular:
            raise SingularModel(
                (), f"the dynamic stiffness at s = {s:.6g} rad/s cannot be factorised"
            )
        return self._engine

    def close(self) -> None:
        """Free the factorisation."""
        if self._engine is not None:
            self._engine.close()
        self._engine = None
        self._at = complex(np.nan)


REPEATED = 1e-8  # poles closer than this are made A-orthogonal as a group


@dataclass(frozen=True, slots=True)
class ArnoldiSearch:
    """How the poles of the full problem are sought.

    Attributes
    ----------
    few : int
        Times the poles that are asked for: a problem of that size is solved whole.
    reach : float
        Radius around the shift, in upper ends, that holds all poles with a damping ratio up to
        0.3.
    tolerance : float
        Of Arnoldi, relative.
    rounds : int
        Searches for more poles, each with twice as many.
    """

    few: int = 4
    reach: float = 0.58
    tolerance: float = 1e-10
    rounds: int = 5


ARNOLDI = ArnoldiSearch()

# share of |s| that Im(s) must pass: damping ratios up to 0.99995 count as oscillation
SWING = 0.01
# share of the largest λ sought under which |s|² is a rigid-body motion, which does not oscillate
STILL = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ComplexModes(HasPoles, FrozenArrays):
    """Poles with Im > 0, ascending modulus.

    Attributes
    ----------
    poles : (m,) complex128, rad/s
    shapes : (n, m) complex128
        In the basis that the matrices were given in, scaled to unit modal A: φᵀ(2sM + D)φ = 1.
    """

    poles: Complex
    shapes: Complex


@dataclass(frozen=True, slots=True, eq=False)
class FullModes(FrozenArrays):
    """Complex modes of the full problem.

    Attributes
    ----------
    modes : ComplexModes
        Shapes in the DOFs of the matrices.
    residuals : (m,) float64
        ‖Q(s)φ‖ / (‖Kφ‖ + |s|‖Dφ‖ + |s|²‖Mφ‖ + ‖Hφ‖).
    shift : complex, rad/s
        Where Q was factorised.
    radius : float, rad/s
        All poles nearer than this to the shift were found; inf where all were computed.
    """

    modes: ComplexModes
    residuals: Float
    shift: complex
    radius: float


def full_modes(
    system: DynamicStiffness, upper: float, *, expected: int = 20
) -> FullModes:
    """Poles with 0 < |s| <= `upper` and Im(s) > 0.01 |s|, from the full quadratic problem.

    None with a damping ratio up to 0.3 is missing; of more damped ones those inside the circle that
    was searched.

    Parameters
    ----------
    system : DynamicStiffness
    upper : float, rad/s
    expected : int
        How many there are, about; the search is widened until it has passed `upper`.

    Raises
    ------
    InputError
        If `upper` is not positive.
    NotConverged
        If the poles below `upper` are not all reached.
    SingularModel
        If the shift is a pole, or the model a mechanism without mass.
    """
    if not upper > 0:
        raise InputError(f"upper end {upper:g} rad/s; it must be positive")
    shift = upper * (0.05 + 0.5j)  # right of the axis: no pole stands there
    need = ARNOLDI.reach * upper
    n = 2 * system.size
    count = max(2 * expected, 4) + 8
    count = n if n <= ARNOLDI.few * count else count
    for _ in range(ARNOLDI.rounds):
        count = min(count, n)
        s, shapes = _nearest(system, shift, upper, count)
        radius = np.inf if count >= n - 1 else float(np.abs(s - shift).max(initial=0.0))
        if radius >= need:
            break
        count *= 2
    else:
        raise NotConverged(
            f"{count} poles around {shift:.4g} rad/s do not reach {upper:.4g} rad/s"
        )
    at = np.flatnonzero(
        (s.imag > SWING * np.abs(s))
        & (np.abs(s) <= upper)
        & (s.imag > np.sqrt(STILL) * upper)
    )
    at = at[np.argsort(np.abs(s[at]), kind="stable")]
    s, shapes = s[at], _unit_modal_a(s[at], shapes[:, at], system.viscous, system.mass)
    return FullModes(
        ComplexModes(s, shapes), system.residuals(s, shapes), shift, radius
    )


def _nearest(
    system: DynamicStiffness, shift: complex, scale: float, count: int
) -> tuple[Complex, Complex]:
    """The `count` poles nearest to the shift, or all of a small system, and their shapes (f, k).

    State [φ; sφ/scale], both parts of one size; p solves Q(σ)p = −(M(v + σx) + Dx), then [p; x +
    σp].
    """
    n = system.size

    def apply(z: Complex) -> Complex:
        x = z[:n].reshape(-1)
        v = scale * z[n:].reshape(-1)
        load = np.asarray(system.mass @ (v + shift * x) + system.viscous @ x)
        p = -system.solve(shift, load[:, None])[:, 0]
        return np.concatenate([p, (x + shift * p) / scale])

    if count >= 2 * n - 1:  # more than Arnoldi can have
        return _poles(
            shift,
            n,
            *linalg.eig(
                np.stack([apply(e) for e in np.eye(2 * n, dtype=np.complex128)], axis=1)
            ),
        )
    start = np.random.default_rng(0).standard_normal(2 * n).astype(np.complex128)
    space = min(2 * count + 10, 2 * n)
    try:
        operator = LinearOperator((2 * n, 2 * n), matvec=apply, dtype=np.complex128)
        theta, z = eigs(
            operator,
            count,
            ncv=space,
            v0=apply(start),
            tol=ARNOLDI.tolerance,
            maxiter=200,
        )
    except ArpackNoConvergence as e:
        raise NotConverged(
            f"complex modes: {len(e.eigenvalues)} of {count} poles converged"
        ) from e
    return _poles(shift, n, theta, z)


def _poles(
    shift: complex, n: int, theta: Complex, z: Complex
) -> tuple[Complex, Complex]:
    good = np.abs(theta) > 1e-12 * np.abs(theta).max()
    return shift + 1 / theta[good], z[:n, good]


def project(
    phi: Float, viscous: sparse.csr_array | None, structural: sparse.csr_array | None
) -> tuple[Float, Float]:
    """ΦᵀDΦ and ΦᵀHΦ, (n, n) each; zeros for None."""
    n = phi.shape[1]
    made = [
        np.zeros((n, n)) if a is None else np.asarray(phi.T @ (a @ phi))
        for a in (viscous, structural)
    ]
    return (made[0] + made[0].T) / 2, (made[1] + made[1].T) / 2


def complex_modes(
    values: Float,
    viscous: Float,
    structural: Float | None = None,
    *,
    top: float | None = None,
) -> ComplexModes:
    """Complex modes in the basis of n mass-normalised real modes, without those that do not
    oscillate.

    Parameters
    ----------
    values : (n,) float64, λ, (rad/s)²
    viscous : (n, n) float64, ΦᵀDΦ
    structural : (n, n) float64, ΦᵀHΦ, optional
    top : float, optional, (rad/s)²
        The largest λ sought, where residual vectors of dashpots on little mass stand far above it;
        of all if not given.

    Raises
    ------
    InputError
        If the sizes differ.
    """
    n = values.size
    structural = np.zeros((n, n)) if structural is None else structural
    if viscous.shape != (n, n) or structural.shape != (n, n):
        raise InputError(
            f"{n} modes, viscous {viscous.shape}, structural {structural.shape}: sizes differ"
        )
    stiffness = np.diag(values) + (1j * structural if structural.any() else 0.0)
    zero = np.zeros((n, n))
    eye = np.eye(n)
    s, y = linalg.eig(np.block([[zero, eye], [-stiffness, -viscous]]))
    scale = max(
        np.sqrt(np.abs(values).max(initial=0.0) if top is None else top),
        np.finfo(float).tiny,
    )
    at = np.flatnonzero(
        (s.imag > SWING * np.abs(s)) & (np.abs(s) > np.sqrt(STILL) * scale)
    )
    at = at[np.argsort(np.abs(s[at]), kind="stable")]
    return ComplexModes(s[at], _unit_modal_a(s[at], y[:n, at], viscous, None))


def _unit_modal_a(
    s: Complex,
    phi: Complex,
    viscous: Float | sparse.csr_array,
    mass: sparse.csr_array | None,
) -> Complex:
    """Scale each group of equal poles so that Yᵀ A Y = I; the symmetric root keeps the phase
    convention.
    """
    loaded = phi if mass is None else np.asarray(mass @ phi)
    gram = phi.T @ np.asarray(viscous @ phi) + (s[:, None] + s) * (phi.T @ loaded)
    gap = np.abs(np.diff(s)) > REPEATED * np.abs(s[1:])
    edges = np.concatenate([[0], np.flatnonzero(gap) + 1, [s.size]])
    out = phi.astype(np.complex128)
    # over groups of modes
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        block = gram[a:b, a:b]
        root = np.sqrt(block) if b - a == 1 else linalg.sqrtm((block + block.T) / 2)
        out[:, a:b] = np.linalg.solve(np.asarray(root).T, phi[:, a:b].T).T
    return out
