"""Poly-reference least-squares complex exponential (LSCE): poles from impulse responses, all
orders.

Brown, Allemang, Zimmerman, Mergeay (1979), SAE 790221; Vold, Kundrat, Rocklin, Russell (1982), "A
multi-input modal estimation algorithm for mini-computers", SAE 820194.
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
class Lsce:
    """Settings of the estimator in one band.

    Attributes
    ----------
    ordmin, ordmax : int
        Orders of the linear prediction; each order holds order · inputs modes.
    damping_max : float
        Poles above are dropped.
    taper : float
        Share of the band at either end that a cosine takes down to zero; its lines hold no poles.
    """

    ordmin: int = 2
    ordmax: int = 30
    damping_max: float = 0.15
    taper: float = 0.15

    def __post_init__(self) -> None:
        check_orders(self.ordmin, self.ordmax)
        if not 0 < self.taper < 0.5:
            raise InputError(f"taper {self.taper}: must be between 0 and 0.5")


def lsce(data: Complex, freqs: Float, settings: Lsce | None = None) -> PoleSet:
    """Poles and participation vectors of every order.

    The band becomes a complex impulse response of its own rate. What the tapered edges smear over
    the time around zero is left out: from there on the response is a sum of exponentials, and so
    obeys a linear prediction h(t_{k+n}) = −Σ_j h(t_{k+j}) A_j.

    Parameters
    ----------
    data : (freq, out, in) complex128
    freqs : (freq,) float64, Hz, equally spaced; the band
    settings : Lsce, optional

    Returns
    -------
    PoleSet
        `shape` (in, k) holds the participation vectors, largest component 1.

    Raises
    ------
    InputError
        If the band has too few lines for the highest order.
    """
    settings = settings or Lsce()
    lines, _, n_in = data.shape
    skip = int(np.ceil(2 / settings.taper))
    rows = min(lines // 2, 12 * settings.ordmax) - settings.ordmax
    if rows < settings.ordmax:
        raise InputError(
            f"{lines} lines in the band for order {settings.ordmax} of LSCE: "
            f"widen it to {4 * settings.ordmax} or lower ordmax"
        )
    h = impulse(data, settings.taper)[skip : skip + rows + settings.ordmax]
    scale = np.sqrt(np.mean(np.abs(h) ** 2, axis=(0, 1))) + np.finfo(float).tiny
    factor = _factor(h / scale, settings.ordmax)
    orders = np.arange(settings.ordmin, settings.ordmax + 1)
    found = [_order(factor, int(n), n_in) for n in orders]
    rate = lines * (freqs[1] - freqs[0])
    pole = np.concatenate([np.log(z) for z, _ in found]) * rate
    turn = pole.imag / (2 * np.pi) % rate  # the band starts at its first line
    pole = pole.real + 2j * np.pi * (freqs[0] + turn)
    part = unit(np.concatenate([v for _, v in found], axis=1) * scale[:, None])
    order = np.repeat(orders, [z.size for z, _ in found])
    unknown = np.full(pole.size, np.nan)
    edge = settings.taper * (freqs[-1] - freqs[0])
    f, zeta = np.abs(pole) / (2 * np.pi), -pole.real / np.abs(pole)
    inside = (
        (f > freqs[0] + edge)
        & (f < freqs[-1] - edge)
        & (zeta > 1e-5)
        & (zeta < settings.damping_max)
    )
    return PoleSet(order, pole, part, unknown, unknown).take(inside)


def impulse(data: Complex, taper: float) -> Complex:
    """(time, out, in) complex impulse responses of the band, both ends tapered by a cosine."""
    n = data.shape[0]
    edge = np.linspace(0, 1, n)
    edge = np.clip(np.minimum(edge, 1 - edge) / taper, 0, 1)
    return np.asarray(np.fft.ifft(data * (0.5 - 0.5 * np.cos(np.pi * edge))[:, None, None], axis=0))


def _factor(h: Complex, n: int) -> Complex:
    """Lower Cholesky factor of the normal matrix of lags 0..n, ((n+1) in, (n+1) in).

    Its leading blocks are those of the lower orders, with lag n the right-hand side of order n.
    """
    m = h.shape[2]
    rows = h.shape[0] - n
    windows = np.lib.stride_tricks.sliding_window_view(h, n + 1, axis=0)[
        :rows
    ]  # (time, out, in, lag)
    x = windows.transpose(0, 1, 3, 2).reshape(-1, (n + 1) * m)
    normal = x.conj().T @ x
    return lower_factor(normal, 1e-13 * np.trace(normal).real / len(normal))


def _order(factor: Complex, n: int, m: int) -> tuple[Complex, Complex]:
    """Roots z (k,) and participation vectors (m, k): rows of h hold ψ_o z^k lᵀ, so lᵀ A(z) = 0."""
    a = solve_triangular(
        factor[: n * m, : n * m].conj().T,
        factor[n * m : (n + 1) * m, : n * m].conj().T,
        check_finite=False,
    )
    companion = np.eye(n * m, k=m, dtype=np.complex128)
    companion[-m:] = a.T.reshape(
        m, n * m
    )  # of the transposed polynomial: z^n l = Σ a_jᵀ z^j l, with a = −A
    z, vectors = np.linalg.eig(companion)
    keep = (np.abs(z) < 1) & (np.abs(z) > 1e-6)
    return z[keep], vectors[:m, keep]
