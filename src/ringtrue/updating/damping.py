"""Damping after stiffness and mass: material loss factors and dashpots by region,
from damping ratios.

In the basis of the updated model's mass-normalised modes, D = Σ γ_k D_k and H = Σ γ_k H_k stand
added to Λ. A linear bounded solution to first order starts a bounded nonlinear one on the data
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

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int, freeze_arrays
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
        freeze_arrays(self)
        if not self.lower < self.upper or not self.std > 0:
            raise InputError(
                f"mechanism {self.name}: bounds {self.lower}, {self.upper} must rise, std "
                f"{self.std} > 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class DampingFit(FrozenArrays):
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
    at_bound: Bool
    misfit: float
    viscous: Float
    structural: Float
    ratio: Float

    @property
    def std(self) -> Float:
        """(k,) float64."""
        return np.sqrt(np.diag(self.covariance))

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
        If data and priors leave a coefficient free.
    """
    if not mechanisms:
        raise InputError("no mechanism of damping: give loss factors or dashpots")
    if not (std > 0).all() or np.unique(modes).size != modes.size:
        raise InputError(f"damping: std {std} (> 0), modes {modes} (each once)")
    none = np.zeros((values.size, values.size))
    base = base or (none, none)
    # ζ to first order, for light damping: cᵀD/(2ω) of dashpots, cᵀH/(2ω²) of loss factors
    w = np.sqrt(values[modes])
    below = {"viscous": 2 * w, "structural": 2 * w**2}
    rows = np.array([np.diag(m.matrix)[modes] / below[m.kind] for m in mechanisms])
    d, h = (np.diag(b)[modes] for b in base)
    known = d / below["viscous"] + h / below["structural"]
    start = _linear(rows.T / std[:, None], (damping - known) / std, mechanisms)

    def residual(c: Float) -> tuple[Float, Float]:
        got, slope = _ratios(values, mechanisms, assembled(mechanisms, c, base), modes)
        return (got - damping) / std, slope / std[:, None]

    return _refined(residual, start, mechanisms, base)


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
    zeta, slope = _ratios(values, mechanisms, (fit.viscous, fit.structural), modes)
    return zeta, np.asarray(
        np.sqrt(np.einsum("tk,kl,tl->t", slope, fit.covariance, slope))
    )


def _ratios(
    values: Float,
    mechanisms: Sequence[Mechanism],
    damping: tuple[Float, Float],
    at: Int,
) -> tuple[Float, Float]:
    """ζ (t,) of the modes that descend from the real modes `at`, and ∂ζ/∂c (t, k), with ΦᵀDΦ and
    ΦᵀHΦ.
    """
    found = complex_modes(values, *damping)
    if found.poles.size < values.size:
        raise InputError("a mode is overdamped: lower the bounds of the mechanisms")
    size = np.abs(found.shapes) ** 2
    # the complex mode that each real mode has become, (n,), from shares (real, complex) of the
    # motion
    rows, columns = linear_sum_assignment(-(size / size.sum(axis=0)))
    descendants = np.asarray(columns[np.argsort(rows)])
    mine = descendants[at]
    s = found.poles[mine]
    phi = found.shapes[:, mine]
    slope = np.empty((at.size, len(mechanisms)), dtype=np.complex128)
    for k, m in enumerate(mechanisms):  # ∂s/∂c = −φᵀ(sD' + iH')φ for unit modal A
        load = np.einsum("nm,nm->m", phi, m.matrix @ phi)
        slope[:, k] = -(s if m.kind == "viscous" else 1j) * load
    size_s = np.abs(s)
    d_size = (s.conj()[:, None] * slope).real / size_s[:, None]
    d_zeta = -slope.real / size_s[:, None] + (s.real / size_s**2)[:, None] * d_size
    return np.asarray(-s.real / size_s), np.asarray(d_zeta, dtype=np.float64)


def assembled(
    mechanisms: Sequence[Mechanism], c: Float, base: tuple[Float, Float]
) -> tuple[Float, Float]:
    """ΦᵀDΦ and ΦᵀHΦ, (n, n) each, of coefficients (k,), added to the known ones of `base`."""
    viscous, structural = base
    for m, value in zip(mechanisms, c.tolist(), strict=True):
        if m.kind == "viscous":
            viscous = viscous + value * m.matrix
        else:
            structural = structural + value * m.matrix
    return viscous, structural


def _linear(rows: Float, rhs: Float, mechanisms: Sequence[Mechanism]) -> Float:
    """Bounded least squares with the priors as rows, (k,)."""
    low, high, prior, weight = _known(mechanisms)
    rows = np.concatenate([rows, np.diag(weight)])
    size = np.linalg.norm(rows, axis=0)
    if (size == 0).any():
        lost = mechanisms[int(np.argmin(size))].name
        raise InputError(
            f"no datum depends on {lost!r}: leave it out, or give it a prior std"
        )
    rhs = np.concatenate([rhs, weight * prior])
    return np.asarray(lsq_linear(rows / size, rhs, (low * size, high * size)).x / size)


def _known(mechanisms: Sequence[Mechanism]) -> Float:
    """Bounds, priors and 1 over their standard deviations, (4, k)."""
    return np.array([(m.lower, m.upper, m.prior, 1 / m.std) for m in mechanisms]).T


def _refined(
    residual: Callable[[Float], tuple[Float, Float]],
    start: Float,
    mechanisms: Sequence[Mechanism],
    base: tuple[Float, Float],
) -> DampingFit:
    """Bounded nonlinear least squares from the linear solution, with priors; the covariance at the
    end.
    """
    low, high, prior, weight = _known(mechanisms)
    _, first = residual(np.clip(start, low, high))
    scale = 1 / np.maximum(np.linalg.norm(first, axis=0), FAINT)
    scale = np.minimum(scale, 1 / np.maximum(weight, FAINT))

    def value(u: Float) -> Float:
        return np.concatenate([residual(u * scale)[0], weight * (u * scale - prior)])

    def slope(u: Float) -> Float:
        return np.asarray(
            np.concatenate([residual(u * scale)[1], np.diag(weight)]) * scale
        )

    end = least_squares(
        value,
        np.clip(start, low, high) / scale,
        slope,
        (low / scale, high / scale),
        x_scale="jac",
        method="trf",
        xtol=1e-12,
    )
    c = end.x * scale
    r, g = residual(c)
    covariance, single, mean_square = _uncertainty(r, g, weight, scale)
    std = np.sqrt(np.diag(covariance))
    at_bound = (c - low < EDGE * std + FAINT) | (high - c < EDGE * std + FAINT)
    # the search stays inside: a bound that holds is met
    c = np.where(c - low < FAINT * (std + scale), low, c)
    viscous, structural = assembled(mechanisms, c, base)
    return DampingFit(
        names=tuple(m.name for m in mechanisms),
        coefficients=c,
        covariance=covariance,
        start=start,
        at_bound=np.asarray(at_bound),
        misfit=float(np.sqrt(mean_square)),
        viscous=viscous,
        structural=structural,
        ratio=np.asarray(std / single),
    )


def _uncertainty(
    r: Float, g: Float, weight: Float, scale: Float
) -> tuple[Float, Float, float]:
    """Covariance (c, c), standard deviation of each with all others known (c,), and mean square of
    the residuals, at least 1: a handful of ratios does not prove a smaller one.

    Parameters
    ----------
    r, g : (r,), (r, c) float64
        Residuals and slopes at the end.
    weight, scale : (c,) float64
        1 over the prior standard deviations; size of each unknown.
    """
    normal = (g.T @ g) * np.outer(scale, scale)
    own = np.diag((weight * scale) ** 2)
    total = normal + own
    if np.linalg.matrix_rank(total) < scale.size:
        raise InputError(
            "the data cannot distinguish the mechanisms: leave some out, or give them a prior std"
        )
    inverse = linalg.inv(total)
    s2 = max(float(r @ r) / max(r.size - float(np.trace(inverse @ normal)), 1.0), 1.0)
    covariance = inverse @ (s2 * normal + own) @ inverse * np.outer(scale, scale)
    alone = np.sqrt(s2 / np.maximum(np.diag(total), FAINT)) * scale
    return np.asarray(covariance), np.asarray(alone), s2
