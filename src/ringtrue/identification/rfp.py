"""Rational fraction polynomials with orthogonal bases: one denominator for all FRFs of a band.

Richardson, Formenti (1982), "Parameter estimation from frequency response measurements using
rational fraction polynomials", IMAC I; bases by the Arnoldi process (Forsythe 1957, J. SIAM 5;
Brubeck, Nakatsukasa, Trefethen 2021, SIAM Review 63); reweighting after Sanathanan, Koerner (1963),
IEEE Trans. Automatic Control 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ringtrue.core.arrays import Complex, Float
from ringtrue.errors import InputError
from ringtrue.identification.definite import lower_factor
from ringtrue.identification.poles import PoleSet, check_orders, unit


@dataclass(frozen=True, slots=True)
class Rfp:
    """Settings of the estimator in one band.

    Attributes
    ----------
    ordmin, ordmax : int
        Orders of the denominator: poles in the band, the mathematical ones included.
    extra : int
        Orders of the numerator above the denominator's, for what modes outside the band add.
    damping_max : float
        Poles above are dropped.
    turns : int
        Times that the weight 1/|denominator| is renewed.
    """

    ordmin: int = 2
    ordmax: int = 20
    extra: int = 2
    damping_max: float = 0.15
    turns: int = 3

    def __post_init__(self) -> None:
        check_orders(self.ordmin, self.ordmax)
        if self.extra < 0 or self.turns < 1:
            raise InputError(f"extra {self.extra}, turns {self.turns}: must be >= 0 and >= 1")


def rfp(data: Complex, freqs: Float, settings: Rfp | None = None) -> PoleSet:
    """Poles of every order, with the participation vectors of their residues.

    The polynomials are complex, in the scaled line number: conjugate poles lie far outside the band
    and belong to the numerator.

    Parameters
    ----------
    data : (freq, out, in) complex128
    freqs : (freq,) float64, Hz; the band
    settings : Rfp, optional

    Returns
    -------
    PoleSet
        `shape` (in, k) holds the participation vectors, largest component 1.

    Raises
    ------
    InputError
        If the band has too few lines for the highest order.
    """
    settings = settings or Rfp()
    if freqs.size < 2 * settings.ordmax + settings.extra + 4:
        raise InputError(
            f"{freqs.size} lines in the band for order {settings.ordmax} of RFP: widen it or "
            "lower ordmax"
        )
    centre, half = 0.5 * (freqs[0] + freqs[-1]), 0.5 * (freqs[-1] - freqs[0])
    x = 1j * (freqs - centre) / half
    h = data.reshape(freqs.size, -1)
    h = h / (np.sqrt(np.mean(np.abs(h) ** 2, axis=0)) + np.finfo(float).tiny)
    found = [
        _order(h, x, n, settings) * 2 * np.pi * half + 2j * np.pi * centre
        for n in _orders(settings)
    ]
    order = np.repeat(_orders(settings), [p.size for p in found])
    shapes = [_participation(data, freqs, p) for p in found]
    pole, part = np.concatenate(found), np.concatenate(shapes, axis=1)
    f, zeta = np.abs(pole) / (2 * np.pi), -pole.real / np.abs(pole)
    inside = (f >= freqs[0]) & (f <= freqs[-1]) & (zeta > 1e-5) & (zeta < settings.damping_max)
    unknown = np.full(pole.size, np.nan)
    return PoleSet(order, pole, part, unknown, unknown).take(inside)


def _orders(settings: Rfp) -> list[int]:
    return list(range(settings.ordmin, settings.ordmax + 1))


def orthogonal(x: Complex, weight: Float, n: int) -> tuple[Complex, Complex]:
    """Polynomials orthonormal on the points `x` under `weight`: values (point, n + 1), Hessenberg
    matrix (n + 1, n).

    x q_j = Σ_i q_i H_ij: orthogonalised twice, so that orders in the hundreds stay exact.
    """
    q = np.zeros((x.size, n + 1), dtype=np.complex128, order="F")
    hess = np.zeros((n + 1, n), dtype=np.complex128)
    q[:, 0] = weight / np.linalg.norm(weight)
    for j in range(n):  # each polynomial stands on those before
        v = x * q[:, j]
        for _ in range(2):
            c = (v.conj() @ q[:, : j + 1]).conj()
            hess[: j + 1, j] += c
            v = v - q[:, : j + 1] @ c
        hess[j + 1, j] = np.linalg.norm(v)
        q[:, j + 1] = v / hess[j + 1, j]
    return q, hess


def _order(h: Complex, x: Complex, n: int, settings: Rfp) -> Complex:
    """Roots (n,) of the denominator of order n in the scaled variable."""
    weight = np.ones(x.size)
    roots: Complex = np.zeros(n, dtype=complex)
    for _ in range(settings.turns):
        q, hess = orthogonal(x, weight, n + settings.extra)
        coefficients = _denominator(h, q, n)
        # d(x) = Σ c_j q_j has its roots where x q = Hᵀ q with q_n taken from the others: the
        # comrade matrix
        square = hess[:n, :n].copy()
        square[:, -1] -= hess[n, n - 1] * coefficients[:n] / coefficients[n]
        roots = np.asarray(np.linalg.eigvals(square), dtype=np.complex128)
        weight = 1 / np.maximum(
            np.abs(q[:, : n + 1] @ coefficients) / np.maximum(np.abs(q[:, 0]), 1e-300), 1e-300
        )
        weight = weight / weight.max()
    return roots


def _denominator(h: Complex, q: Complex, n: int) -> Complex:
    """Coefficients (n + 1,), the last one 1, that leave least of d·h outside the span of the
    numerator.
    """
    basis = q[:, : n + 1]
    power = (np.abs(h) ** 2).sum(axis=1)
    outer = q.conj().T
    normal = outer[: n + 1] @ (basis * power[:, None])
    moments = np.concatenate([outer @ (x[:, None] * basis) for x in h.T])  # a handful of FRFs
    normal -= moments.conj().T @ moments
    low = lower_factor(normal, 1e-14 * np.trace(normal).real)
    free = -solve_triangular(low[:n, :n].conj().T, low[n, :n].conj())
    return np.append(free, 1.0)


def _participation(data: Complex, freqs: Float, poles: Complex) -> Complex:
    """(in, k) right singular vectors of the residues, largest component 1; residual terms up to
    second order.
    """
    s = 2j * np.pi * freqs
    x = (freqs - freqs.mean()) / (freqs[-1] - freqs[0])
    q = np.abs(poles.real) / (s[:, None] - poles)
    a = np.concatenate([q, np.vander(x, 3)], axis=1)
    r = np.linalg.lstsq(a, data.reshape(freqs.size, -1), rcond=1e-12)[0][: poles.size]
    part = np.linalg.svd(r.reshape(poles.size, *data.shape[1:]), full_matrices=False)[2][:, 0].T
    return unit(part)
