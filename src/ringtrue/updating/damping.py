"""Damping after stiffness and mass: modal ratios, material loss factors and dashpots by region,
from damping ratios.

In the basis of the updated model's mass-normalised modes, D = Σ γ_k D_k and H = Σ γ_k H_k stand
beside Λ. A linear bounded solution to first order starts a bounded nonlinear one on the data
themselves, whose Gauss-Newton matrix gives the uncertainty.
Friswell and Mottershead (1995), ch. 8; Pilkey and Inman (1998) on identifying damping matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg
from scipy.optimize import least_squares, linear_sum_assignment, lsq_linear

from ringtrue.core.arrays import Any_, Bool, Float, Int, freeze_fields
from ringtrue.eigen.damped import ComplexModes, complex_modes
from ringtrue.errors import InputError

EDGE = 1e-2  # standard deviations: nearer to a bound is at it
FAINT = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Mechanism:
    """One source of damping with an unknown coefficient.

    Attributes
    ----------
    name : str
    kind : {"viscous", "structural"}
        The coefficient times `matrix` is part of ΦᵀDΦ (a dashpot), or of ΦᵀHΦ (a loss factor on a
        stiffness).
    matrix : (n, n) float64
        ΦᵀD_kΦ or ΦᵀK_kΦ, symmetric.
    lower, upper : float
        Bounds of the coefficient.
    prior, std : float
        What is known of the coefficient beforehand; std inf: nothing.
    """

    name: str
    kind: Literal["viscous", "structural"]
    matrix: Float
    lower: float = 0.0
    upper: float = np.inf
    prior: float = 0.0
    std: float = np.inf

    def __post_init__(self) -> None:
        freeze_fields(self, matrix=np.float64)
        square = self.matrix.ndim == 2 and self.matrix.shape[0] == self.matrix.shape[1]
        if not square or self.kind not in ("viscous", "structural"):
            raise InputError(
                f"mechanism {self.name}: matrix {self.matrix.shape}, kind {self.kind!r}"
            )
        if not self.lower < self.upper or not self.std > 0:
            raise InputError(
                f"mechanism {self.name}: bounds {self.lower}, {self.upper} must rise, std "
                f"{self.std} > 0"
            )


def modal(values: Float, *, upper: float = 0.3) -> tuple[Mechanism, ...]:
    """A damping ratio for each mode: the coefficients are ζ. `values` (n,) are λ, (rad/s)²."""
    n = values.size
    root = np.sqrt(np.maximum(values, 0.0))
    if (root == 0).any():
        raise InputError(
            "a rigid-body mode at 0 Hz has no damping ratio: leave it out or give it a dashpot"
        )
    eye = np.eye(n)
    return tuple(
        Mechanism(f"mode {i + 1}", "viscous", 2 * w * np.outer(e, e), upper=upper)
        for i, (w, e) in enumerate(zip(root.tolist(), eye, strict=True))
    )


def loss_factor(name: str, vectors: Float, stiffness: Any_, *, upper: float = 1.0) -> Mechanism:
    """The loss factor of a region with the stiffness K_k (f, f), seen by modes (f, n)."""
    return Mechanism(name, "structural", _projected(vectors, stiffness), upper=upper)


def dashpot(name: str, vectors: Float, damping: Any_, *, upper: float = np.inf) -> Mechanism:
    """A factor on the dashpots D_k (f, f) of a region, seen by modes (f, n)."""
    return Mechanism(name, "viscous", _projected(vectors, damping), upper=upper)


def _projected(vectors: Float, matrix: Any_) -> Float:
    seen = np.asarray(vectors.T @ (matrix @ vectors))
    return np.asarray((seen + seen.T) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class DampingFit:
    """Identified damping.

    Attributes
    ----------
    names : tuple of str
    coefficients : (k,) float64
    covariance : (k, k) float64
        With the size of the residuals as found (from poles not below the stated one); the bounds
        not counted.
    start : (k,) float64
        The linear solution.
    shift : (n,) float64
        Relative correction δ of each eigenvalue; zeros from poles.
    at_bound : (k,) bool
    misfit : float
        Root mean square of the residuals in units of their standard deviation.
    viscous, structural : (n, n) float64
        ΦᵀDΦ and ΦᵀHΦ with these coefficients.
    ratio : (k,) float64
        Standard deviation over what it would be if this mechanism were alone: > 10, others stand
        for it.
    """

    names: tuple[str, ...]
    coefficients: Float
    covariance: Float
    start: Float
    shift: Float
    at_bound: Bool
    misfit: float
    viscous: Float
    structural: Float
    ratio: Float

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(
            self, coefficients=f, covariance=f, start=f, shift=f, viscous=f, structural=f, ratio=f
        )

    @property
    def std(self) -> Float:
        """(k,) float64."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def modes(self, values: Float) -> ComplexModes:
        """Complex modes with this damping, eigenvalues λ (n,) as given."""
        return complex_modes(values, self.viscous, self.structural)


def fit_poles(
    values: Float,
    mechanisms: Sequence[Mechanism],
    damping: Float,
    std: Float,
    modes: Int,
    *,
    base: tuple[Float, Float] | None = None,
) -> DampingFit:
    """Coefficients from damping ratios of complex modes.

    Parameters
    ----------
    values : (n,) float64, λ, (rad/s)²
        Of all modes in the basis.
    mechanisms : sequence (k)
    damping, std : (t,) float64
        Test ratios −Re(s)/|s| and their standard deviations.
    modes : (t,) int64
        The mode of the basis that each belongs to.
    base : (n, n), (n, n) float64, optional
        ΦᵀDΦ and ΦᵀHΦ that are known and stay; none by default.

    Raises
    ------
    InputError
        If sizes differ, or data and priors leave a coefficient free.
    """
    zeta, sigma = np.asarray(damping, dtype=np.float64), np.asarray(std, dtype=np.float64)
    at = np.asarray(modes, dtype=np.int64)
    check_mechanisms(mechanisms, values.size)
    if (
        not zeta.shape == sigma.shape == at.shape
        or not (sigma > 0).all()
        or np.unique(at).size != at.size
    ):
        raise InputError(
            f"damping {zeta.shape}, std {sigma.shape} (> 0), modes {at.shape} (each once)"
        )
    w = np.sqrt(values[at])
    by = np.array([2 * w if m.kind == "viscous" else 2 * w**2 for m in mechanisms])
    first = (
        np.array([np.diag(m.matrix)[at] for m in mechanisms]) / by
    )  # ζ to first order: light damping
    known = (
        np.zeros(at.size)
        if base is None
        else np.diag(base[0])[at] / (2 * w) + np.diag(base[1])[at] / (2 * w**2)
    )
    linear = _linear(first.T / sigma[:, None], (zeta - known) / sigma, mechanisms)

    def residual(c: Float) -> tuple[Float, Float]:
        got, slope = _ratios(values, mechanisms, assembled(mechanisms, c, values.size, base), at)
        return (got - zeta) / sigma, slope / sigma[:, None]

    return refined(residual, linear, mechanisms, values.size, shift=0.0, least=1.0, base=base)


def mode_damping(
    values: Float, mechanisms: Sequence[Mechanism], fit: DampingFit, modes: Int
) -> tuple[Float, Float]:
    """Damping ratios of complex modes with identified damping, and their standard deviations from
    its covariance.

    Parameters
    ----------
    values : (n,) float64, λ, (rad/s)²
    mechanisms : sequence (k)
        Those of the fit.
    modes : (t,) int64
        Modes of the basis.

    Returns
    -------
    damping, std : (t,) float64
    """
    zeta, slope = _ratios(
        values, mechanisms, (fit.viscous, fit.structural), np.asarray(modes, dtype=np.int64)
    )
    return zeta, np.asarray(np.sqrt(np.einsum("tk,kl,tl->t", slope, fit.covariance, slope)))


def _ratios(
    values: Float, mechanisms: Sequence[Mechanism], damping: tuple[Float, Float], at: Int
) -> tuple[Float, Float]:
    """ζ (t,) of the modes that descend from the real modes `at`, and ∂ζ/∂c (t, k), with ΦᵀDΦ and
    ΦᵀHΦ.
    """
    found = complex_modes(values, *damping)
    if found.poles.size < values.size:
        raise InputError("a mode is overdamped: lower the bounds of the mechanisms")
    size = np.abs(found.shapes) ** 2
    mine = _descendants(size / size.sum(axis=0))[at]
    s, phi = found.poles[mine], found.shapes[:, mine]
    slope = np.empty((at.size, len(mechanisms)), dtype=np.complex128)
    for k, m in enumerate(mechanisms):  # ∂s/∂c = −φᵀ(sD' + iH')φ for unit modal A
        load = np.einsum("nm,nm->m", phi, m.matrix @ phi)
        slope[:, k] = -(s if m.kind == "viscous" else 1j) * load
    size_s = np.abs(s)
    d_size = (s.conj()[:, None] * slope).real / size_s[:, None]
    d_zeta = -slope.real / size_s[:, None] + (s.real / size_s**2)[:, None] * d_size
    return np.asarray(-s.real / size_s), np.asarray(d_zeta, dtype=np.float64)


def _descendants(share: Float) -> Int:
    """The complex mode that each real mode has become, (n,), from shares (real, complex) of the
    motion.
    """
    rows, columns = linear_sum_assignment(-share)
    return np.asarray(columns[np.argsort(rows)])


def assembled(
    mechanisms: Sequence[Mechanism], c: Float, n: int, base: tuple[Float, Float] | None = None
) -> tuple[Float, Float]:
    """ΦᵀDΦ and ΦᵀHΦ, (n, n) each, of coefficients (k,), added to the known ones of `base`."""
    d, h = (
        (np.zeros((n, n)), np.zeros((n, n))) if base is None else (base[0].copy(), base[1].copy())
    )
    for m, value in zip(mechanisms, c.tolist(), strict=True):
        (d if m.kind == "viscous" else h)[...] += value * m.matrix
    return d, h


def check_mechanisms(mechanisms: Sequence[Mechanism], n: int) -> None:
    """Refuse mechanisms that are none, not of `n` modes, or twice of one name."""
    if not mechanisms:
        raise InputError("no mechanism of damping: give modal ratios, loss factors or dashpots")
    wrong = [m.name for m in mechanisms if m.matrix.shape != (n, n)]
    if wrong or len({m.name for m in mechanisms}) != len(mechanisms):
        raise InputError(
            f"mechanisms need matrices ({n}, {n}) and names of their own; wrong: {' '.join(wrong)}"
        )


def _linear(rows: Float, rhs: Float, mechanisms: Sequence[Mechanism]) -> Float:
    """Bounded least squares with the priors as rows, (k,)."""
    weight = np.array([1 / m.std for m in mechanisms])
    rows = np.concatenate([rows, np.diag(weight)])
    size = np.linalg.norm(rows, axis=0)
    if (size == 0).any():
        lost = mechanisms[int(np.argmin(size))].name
        raise InputError(f"no datum depends on {lost!r}: leave it out, or give it a prior std")
    rhs = np.concatenate([rhs, weight * np.array([m.prior for m in mechanisms])])
    bounds = (
        np.array([m.lower for m in mechanisms]) * size,
        np.array([m.upper for m in mechanisms]) * size,
    )
    return np.asarray(lsq_linear(rows / size, rhs, bounds).x / size)


def refined(
    residual: Callable[[Float], tuple[Float, Float]],
    start: Float,
    mechanisms: Sequence[Mechanism],
    n: int,
    *,
    shift: float,
    least: float,
    base: tuple[Float, Float] | None = None,
) -> DampingFit:
    """Bounded nonlinear least squares from the linear solution, with priors; the covariance at the
    end.

    `least` is the smallest mean square of the residuals that is believed: 1 for a handful of poles.
    """
    k = len(mechanisms)
    prior = np.concatenate([[m.prior for m in mechanisms], np.zeros(start.size - k)])
    weight = np.concatenate(
        [[1 / m.std for m in mechanisms], np.full(start.size - k, 1 / (shift or 1.0))]
    )
    low = np.concatenate([[m.lower for m in mechanisms], np.full(start.size - k, -0.5)])
    high = np.concatenate([[m.upper for m in mechanisms], np.full(start.size - k, 0.5)])
    scale = 1 / np.maximum(np.linalg.norm(residual(np.clip(start, low, high))[1], axis=0), FAINT)
    scale = np.minimum(scale, 1 / np.maximum(weight, FAINT))

    def value(u: Float) -> Float:
        return np.concatenate([residual(u * scale)[0], weight * (u * scale - prior)])

    def slope(u: Float) -> Float:
        return np.asarray(np.concatenate([residual(u * scale)[1], np.diag(weight)]) * scale)

    inside = np.clip(start, low, high) / scale
    found = least_squares(
        value, inside, slope, (low / scale, high / scale), x_scale="jac", method="trf", xtol=1e-12
    )
    c = found.x * scale
    r, g = residual(c)
    covariance, alone, s2 = _uncertainty(r, g, weight, scale, least)
    std = np.sqrt(np.diag(covariance))
    at = (c - low < EDGE * std + FAINT) | (high - c < EDGE * std + FAINT)
    c = np.where(
        c - low < FAINT * (std + scale), low, c
    )  # the search stays inside: a bound that holds is met
    d, h = assembled(mechanisms, c[:k], n, base)
    delta = c[k:] if c.size > k else np.zeros(n)
    return DampingFit(
        tuple(m.name for m in mechanisms),
        c[:k],
        covariance[:k, :k],
        start[:k],
        delta,
        np.asarray(at[:k]),
        float(np.sqrt(s2)),
        d,
        h,
        np.asarray(std / alone)[:k],
    )


def _uncertainty(
    r: Float, g: Float, weight: Float, scale: Float, least: float
) -> tuple[Float, Float, float]:
    """Covariance (c, c), standard deviation of each as if it were alone (c,), and mean square of
    the residuals.

    Parameters
    ----------
    r, g : (r,), (r, c) float64
        Residuals and slopes at the end.
    weight, scale : (c,) float64
        1 over the prior standard deviations; size of each unknown.
    least : float
        Smallest mean square that is believed.
    """
    normal, own = (g.T @ g) * np.outer(scale, scale), np.diag((weight * scale) ** 2)
    total = normal + own
    if np.linalg.matrix_rank(total) < scale.size:
        raise InputError(
            "the data cannot tell the mechanisms apart: leave some out, or give them a prior std"
        )
    inverse = linalg.inv(total)
    s2 = max(float(r @ r) / max(r.size - float(np.trace(inverse @ normal)), 1.0), least)
    covariance = inverse @ (s2 * normal + own) @ inverse * np.outer(scale, scale)
    alone = np.sqrt((s2 if s2 > 0 else 1.0) / np.maximum(np.diag(total), FAINT)) * scale
    return np.asarray(covariance), np.asarray(alone), s2
