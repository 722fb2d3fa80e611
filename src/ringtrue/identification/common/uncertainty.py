"""First-order uncertainty of poles and shapes from the scatter of blockwise correlations (Döhler
and Mevel 2013).

With H = U S Vᵀ and O = U, a perturbation ΔH of the block-Hankel matrix gives ΔO = ΔH V S⁻¹ up to a
change of basis, which moves no pole and no shape. So each block of the record needs only T_b = ΔH_b
V S⁻¹, whatever the order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.fft import next_fast_len, rfft
from scipy.linalg import solve_triangular
from scipy.special import ndtri, stdtrit

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.signals import FALSE_ALARM


def by_chance() -> float:
    """Standard deviations of both parts of a pole within which it is from its place by chance: a
    Rayleigh distribution.
    """
    return float(np.sqrt(-2 * np.log(FALSE_ALARM)))


@dataclass(frozen=True, slots=True, eq=False)
class Perturbations:
    """The perturbation of the observability matrix by each block, in the basis of its QR.

    Attributes
    ----------
    up, down : (block, order, order) float32
        Qᵀ ΔO without its last and without its first block row.
    output : (block, ch, order) float32
        First block row of ΔO.
    inner : (block, order, order) float32
        Uᵀ ΔO, for the strength of a mode.
    """

    up: Any_
    down: Any_
    output: Any_
    inner: Any_


def hankel(r: Any_, rows: int) -> Any_:
    """Block-Hankel (rows·ch, rows·ref) of the lags 1 .. 2·rows − 1 of `r` (lag, ch, ref)."""
    by_channel = np.ascontiguousarray(r.transpose(1, 0, 2)[:, 1 : 2 * rows])
    ch, lags, ref = by_channel.shape
    item = by_channel.itemsize  # the strides of axes of length one mean nothing
    view = as_strided(
        by_channel,
        (rows, ch, rows * ref),
        (ref * item, lags * ref * item, item),
        writeable=False,
    )
    return view.reshape(rows * ch, rows * ref)


def deviations(r: Any_, weights: Float) -> tuple[Float, Any_]:
    """Weighted mean (lag, ch, ref) of the block correlations `r` (block, lag, ch, ref), and each
    block's deviation.

    The deviations are scaled so that their sum of squares is the variance of the mean.
    """
    mean = np.tensordot(weights.astype(r.dtype), r, 1)
    n = weights.size
    size = (weights * np.sqrt(n / (n - 1))).astype(r.dtype)
    return mean.astype(np.float64), (r - mean) * size[:, None, None, None]


def perturb(dr: Any_, rows: int, u: Float, vs: Float, q: Float) -> Perturbations:
    """Perturbations by the deviations `dr` (block, lag, ch, ref); `u` left vectors, `vs` = V S⁻¹,
    `q` of O's QR.

    A Hankel matrix times another is a convolution, a product of transforms; only products of it
    with `q` are needed, which are taken of the transforms, too (Parseval), but for the first and
    the last block row.
    """
    nb, _, ch, ref = dr.shape
    n = vs.shape[1]
    size = int(next_fast_len(2 * rows - 1, real=True))
    # a standard deviation needs no more than single precision, which halves the time
    d = dr[:, 1 : 2 * rows].astype(np.float32)
    v = vs.astype(np.float32).reshape(rows, ref, n)
    by = rfft(v, size, axis=0).conj()
    by = np.concatenate([_apart(by), _apart(1j * by)], axis=1)
    left = _spectral(q.reshape(-1, ch, n), size)
    both = np.empty((nb, 2 * n, n), dtype=np.float32)
    for k in range(nb):  # one block at a time stays in the cache
        # (freq, ch, order): real, then imaginary parts
        both[k] = left @ (_apart(rfft(d[k], size, axis=0)) @ by).reshape(-1, n)
    first, last = (
        np.tensordot(d[:, k : k + rows], v, ((1, 3), (0, 1))) for k in (0, rows - 1)
    )
    # Uᵀ ΔO, as U without its last block row is Q R
    inner = (q.T @ u[:-ch]).T.astype(np.float32) @ both[:, :n] + u[-ch:].T.astype(
        np.float32
    ) @ last
    return Perturbations(both[:, :n], both[:, n:], first, inner)


def _apart(z: Any_) -> Any_:
    """Real and imaginary parts, along the last axis."""
    return np.concatenate([z.real, z.imag], axis=-1)


def _spectral(q: Float, size: int) -> Any_:
    """(2 order, freq·ch·2) float32: what times the transforms (freq, ch, part) of x (size, ch) is Σ
    q_i x_i and, below, Σ q_i x_{i+1}, for `q` (row, ch, order).
    """
    spectrum = rfft(q, size, axis=0)
    line = np.arange(len(spectrum))
    spectrum *= np.where((line == 0) | (2 * line == size), 1, 2)[:, None, None] / size
    late = spectrum * np.exp(-2j * np.pi * line / size)[:, None, None]
    both = np.concatenate([spectrum, late], axis=2)
    return (
        np.stack([both.real, both.imag], axis=2)
        .reshape(-1, both.shape[2])
        .T.astype(np.float32)
    )


def _bilinear(left: Complex, mid: Any_, right: Complex) -> Complex:
    """(k, block) values left_i mid_b right_i of `left` (k, n), `mid` (block, n, n) float32, `right`
    (n, k).
    """
    k = left.shape[0]
    half = np.concatenate([left.real, left.imag]).astype(np.float32) @ mid
    full = half[:, :k] + 1j * half[:, k:]
    return np.asarray(
        np.einsum("bkn,nk->kb", full, right.astype(np.complex64)), dtype=np.complex128
    )


def pole_deviations(
    p: Perturbations, row: Complex, mu: Complex, right: Complex
) -> Complex:
    """Δμ (k, block) complex128 of the discrete poles `mu` (k,) of one order.

    `right` (n, k) are eigenvectors; `row` (k, n) left ones, scaled to left @ right = I, times R⁻¹
    of O's QR.
    """
    n = row.shape[1]
    return _bilinear(row, p.down[:, :n, :n], right) - mu[:, None] * _bilinear(
        row, p.up[:, :n, :n], right
    )


def strengths(p: Perturbations, s: Float, left: Complex) -> Float:
    """Signal-to-noise ratio (k,) of the amplitude of each mode in the correlations.

    The amplitude of mode i is ‖c_i‖, c_i = left_i S Vᵀ; its deviation by block b is the component
    of left_i Uᵀ ΔH_b along c_i.
    """
    n = left.shape[1]
    size2 = (np.abs(left * s[:n]) ** 2).sum(1)
    along = (left * s[:n] ** 2).conj().T
    change = (
        _bilinear(left, p.inner[:, :n, :n], np.asarray(along)).real / size2[:, None]
    )
    return np.asarray(1 / np.sqrt((change**2).sum(1)))


def shape_deviations(
    p: Perturbations,
    eigen: tuple[Complex, Complex, Complex],
    c: Float,
    i: int,
    r: Float,
) -> Complex:
    """Δψ (ch, block) of the shape ψ = C φ_i of one mode, its largest component held at 1.

    `eigen` are the eigenvalues μ (n,) of A, right vectors φ (n, n) and left vectors (n, n); `c`
    (ch, n).
    """
    mu, right, left = eigen
    n = r.shape[0]
    phi = right[:, i]
    up = p.up[:, :n, :n]
    load = (p.down[:, :n, :n] - mu[i].real * up) @ phi - 1j * mu[i].imag * (up @ phi)
    gain = mu[i] - mu
    gain[i] = np.inf
    d_phi = right @ ((left @ solve_triangular(r, load.T)) / gain[:, None])
    psi = c @ phi
    d_psi = (p.output[:, :, :n] @ phi).T + c @ d_phi
    top = int(np.argmax(np.abs(psi)))
    return np.asarray(d_psi / psi[top] - np.outer(psi, d_psi[top]) / psi[top] ** 2)


def modulus_std(psi: Complex, d_psi: Complex) -> Float:
    """Standard deviations (ch, m) of |ψ|, its largest component held at 1.

    `psi` (ch, m) are shapes and `d_psi` (m, ch, block) their deviations, both of any one scale. A
    deviation δ across the phase of a component lengthens it, by δ²/2|ψ| where it is small against
    it and by δ where it is not. Of a component that is 0 the modulus has a Rayleigh distribution
    with its 95 % point at 2.45 of the deviation; the factor of |ψ|² makes 1.96 of what is stated
    there reach to 0 as often.
    """
    m = np.arange(psi.shape[1])
    top = np.abs(psi).argmax(0)
    own = psi / psi[top, m]
    d = d_psi / psi[top, m][:, None, None]
    d = d - own.T[:, :, None] * d[m, top][:, None]
    size = np.abs(own)
    phase = np.where(size > 1e-12, own / np.maximum(size, 1e-12), 1.0)
    turned = d * phase.T.conj()[:, :, None]
    along = (turned.real**2).sum(2).T
    across = (turned.imag**2).sum(2).T
    return np.asarray(
        np.sqrt(along + across**2 / np.maximum(across + size**2 / 6, 1e-300))
    )


def frequency_damping(pole: Complex, d_pole: Complex) -> tuple[Float, Float]:
    """Deviations of frequency (Hz) and damping ratio, each (k, block), from those of the poles,
    rad/s.
    """
    size = np.abs(pole)[:, None]
    d_size = (pole.conj()[:, None] * d_pole).real / size
    d_zeta = -d_pole.real / size + pole.real[:, None] * d_size / size**2
    return d_size / (2 * np.pi), d_zeta


def students_factor(free: Any_) -> Any_:
    """Factor on deviations that are known to `free` degrees of freedom: 1.96 of them then hold 95 %
    (Student 1908).
    """
    return stdtrit(free, 0.975) / ndtri(0.975)


def root_sum_square(d: Float) -> Float:
    """Root of the sum of squares over blocks."""
    return np.asarray(np.sqrt((d**2).sum(-1)))


def blocks_for(samples: int, lags: int) -> int:
    """How many blocks: 32, fewer where a block would be shorter than four times the largest lag, at
    least 8.
    """
    return int(np.clip(samples // (4 * lags), 8, 32))
