"""Harmonic response on the small matrices of a model, with damping as it was found or is drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Any_, Bool, Complex, Float, freeze_fields
from ringtrue.errors import InputError
from ringtrue.model.ports import ObservedModel
from ringtrue.updating.dense import matrices_at
from ringtrue.updating.quadratic import covariance_root

Ratios = Callable[[Float, Float], Float]  # λ (m,), M-orthonormal y (r, m) -> ζ (m,)
MASSLESS = 1e-14  # of the largest 1/λ


@dataclass(frozen=True, slots=True, eq=False)
class Damping:
    """Damping ratio over frequency, as a table, with its uncertainty.

    Attributes
    ----------
    frequencies, ratios : (k,) float64
        Hz and fraction of critical; constant beyond the ends.
    std : float
        Standard deviation of ln ζ, common to all modes of a draw.
    """

    frequencies: Float
    ratios: Float
    std: float = 0.0

    def __post_init__(self) -> None:
        freeze_fields(self, frequencies=np.float64, ratios=np.float64)
        rising = self.frequencies.size > 0 and (np.diff(self.frequencies) > 0).all()
        if (
            self.frequencies.shape != self.ratios.shape
            or not rising
            or (self.ratios < 0).any()
            or self.std < 0
        ):
            raise InputError(
                f"damping: {self.frequencies.shape} rising frequencies, {self.ratios.shape} "
                "ratios >= 0"
            )

    def at(self, frequencies: Float) -> Float:
        """ζ at frequencies in Hz, interpolated."""
        return np.asarray(np.interp(frequencies, self.frequencies, self.ratios))

    def drawn(self, rng: np.random.Generator | None) -> Ratios:
        """ζ of modes at the best point, or as drawn."""
        factor = 1.0 if rng is None else float(np.exp(self.std * rng.standard_normal()))
        return lambda lam, y: factor * self.at(np.sqrt(lam) / (2 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class RegionDamping:
    """Loss factors and dashpots of regions in the basis of a model's small matrices.

    Attributes
    ----------
    coefficients : (k,) float64
    covariance : (k, k) float64
    matrices : (k, r, r) float64
        What a unit of each coefficient adds to the damping matrix (dashpots) or to the imaginary
        stiffness.
    viscous : (k,) bool
        True for dashpots.
    base : (r, r), (r, r) float64
        Known damping matrix and imaginary stiffness beside them.
    scatter : float
        Standard deviation of ln ζ that each mode has of its own.
    """

    coefficients: Float
    covariance: Float
    matrices: Float
    viscous: Bool
    base: tuple[Float, Float]
    scatter: float = 0.0

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, coefficients=f, covariance=f, matrices=f, viscous=np.bool_)
        k, r = self.coefficients.size, self.base[0].shape[0]
        if (
            self.matrices.shape != (k, r, r)
            or self.covariance.shape != (k, k)
            or self.viscous.shape != (k,)
        ):
            raise InputError(
                f"damping of {k} regions: matrices {self.matrices.shape} for {r} vectors"
            )

    def drawn(self, rng: np.random.Generator | None) -> Ratios:
        """ζ of modes at the best point, or with coefficients and scatter as drawn; none is below
        0.
        """
        c, own = self.coefficients, np.ones(self.base[0].shape[0])
        if rng is not None:
            c = np.maximum(c + covariance_root(self.covariance) @ rng.standard_normal(c.size), 0.0)
            own = np.exp(self.scatter * rng.standard_normal(own.size))
        d = self.base[0] + np.tensordot(c * self.viscous, self.matrices, axes=1)
        h = self.base[1] + np.tensordot(c * ~self.viscous, self.matrices, axes=1)

        def ratios(lam: Float, y: Float) -> Float:
            w = np.sqrt(np.maximum(lam, MASSLESS * float(lam.max(initial=1.0))))
            viscous, structural = (np.einsum("rm,rm->m", y, a @ y) for a in (d, h))
            return np.asarray(own[: w.size] * (viscous / (2 * w) + structural / (2 * w**2)))

        return ratios


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What is looked at, in the basis of the model's small matrices; it may change with the
    parameters.

    Attributes
    ----------
    nominal : (n, r) float64
    slopes : tuple of (position of the parameter, (n, r) float64)
        rows = nominal + Σ (a_i − 1) slope_i: the force in a spring grows with its stiffness.
    """

    nominal: Float
    slopes: tuple[tuple[int, Float], ...] = field(default=())

    def at(self, factors: Float) -> Float:
        """(n, r) at factors (p,) of the parameters."""
        out = self.nominal
        for i, slope in self.slopes:
            out = out + (factors[i] - 1) * slope
        return out


def harmonic(
    model: ObservedModel,
    x: Float,
    freqs: Float,
    loads: Float,
    amplitude: Complex,
    rows: Rows,
    ratios: Ratios,
    *,
    scatter: Float | None = None,
) -> Complex:
    """Responses (l, n) to harmonic loads, by superposition of all modes of the model's small
    matrices.

    Parameters
    ----------
    model : ObservedModel
        With small matrices (`update.dense.matrices_at`); static answers to the loads should be in
        its basis.
    x : (p,) float64
    freqs : (l,) float64, Hz
    loads : (r, j) float64
        Unit loads in the basis.
    amplitude : (l, j) complex128
    rows : Rows
    ratios : callable
        Damping ratios of the modes.
    scatter : (r,) float64, optional
        Relative error of each frequency.
    """
    small = matrices_at(model, x)
    lam, y = _all_modes(small.stiffness, small.mass)
    lam = lam * (1.0 if scatter is None else (1 + scatter) ** 2)
    w, wk = 2 * np.pi * np.asarray(freqs)[:, None], np.sqrt(lam)
    below = lam - w**2 + 2j * ratios(lam, y) * wk * w
    q = (amplitude @ (y.T @ loads).T) / below
    return np.asarray(q @ (rows.at(_every(model, x)) @ y).T)


def _all_modes(k: Float, m: Float) -> tuple[Float, Float]:
    """λ >= 0 and M-orthonormal y of small matrices; a motion without mass keeps its flexibility."""
    shift = 1e-3 * float(np.trace(k) / np.trace(m))
    theta, y = linalg.eigh(m, k + shift * m)
    theta = np.maximum(theta, MASSLESS * theta[-1])
    return np.maximum(1 / theta - shift, 0.0), np.asarray(y / np.sqrt(theta))


def _every(model: ObservedModel, x: Float) -> Float:
    """Factors of all parameters of the system that the rows count, held ones too."""
    full = getattr(model, "full_vector", None)
    if full is None:
        return model.parameters.factors(x)
    everything: Any_ = full(x)
    return model.system.parameters.factors(everything)  # type: ignore[attr-defined,no-any-return]
