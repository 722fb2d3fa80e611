"""Bayesian FFT modal identification of one mode or of a close group within a narrow band (Au 2011,
2012, 2017).

The FFT of the responses within the band is complex Gaussian with covariance

    E_k = Φ H_k S H_kᴴ Φᵀ + S_e I,    h_ik = 1/[1 − β_ik² − 2iζ_i β_ik],
    β_ik = f_i/f_k (accelerations),

with real shapes Φ of unit length, the Hermitian spectral matrix S of the modal forces and noise of
level S_e. With a flat prior the most probable values minimise Σ ln|E_k| + F_kᴴ E_k⁻¹ F_k (Fisher
scoring); the posterior is Gaussian about them with the inverse information, under the unit length
of the shapes, as its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft
from scipy.linalg import null_space

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError, NotConverged
from ringtrue.identification.ssi import prepared

MOST_STEPS = 200
TOLERANCE = 1e-7  # decrease of the negative log-likelihood that is none
_RISE = {"acceleration": 0, "velocity": -1, "displacement": -2, "strain": -2, "unknown": 0}


@dataclass(frozen=True, slots=True, eq=False)
class BayesResult:
    """Most probable values and the posterior.

    Attributes
    ----------
    modes : ModeSet
        Real shapes, largest component 1.
    uncertainty : Uncertainty
        Posterior standard deviations, and the covariance of frequencies and damping as its factor.
    force : (m, m) complex128
        Spectral matrix of the modal forces, unit²/Hz one-sided, for shapes of unit length.
    noise : float
        S_e, one-sided, relative to each channel's own mean square (1/Hz).
    signal_to_noise : (m,) float64
        Modal over noise spectrum at resonance, S_ii/(4 ζ² S_e).
    lines : int
        Of the FFT in the band.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    force: Complex
    noise: float
    signal_to_noise: Float
    lines: int


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """FFT lines of the band: frequencies (k,), spectra (k, ch) with E|F|² one-sided, rise of the
    response.
    """

    freqs: Float
    spectra: Complex
    rise: int


@dataclass(frozen=True, slots=True, eq=False)
class _Values:
    """Parameters in the order of the information: ln f (m,), ln ζ (m,), S (m, m) by its Cholesky
    factor, ln S_e, Φ.
    """

    f: Float
    zeta: Float
    root: Complex
    noise: float
    phi: Float

    @property
    def force(self) -> Complex:
        return np.asarray(self.root @ self.root.conj().T)

    def stepped(self, d: Float) -> _Values:
        """Moved along `d`; shapes go back to unit length, their size goes to the force."""
        m, n = self.f.size, self.phi.shape[0]
        i, j = np.tril_indices(m)
        k, k2 = 2 * m + i.size, 2 * m + i.size + (i > j).sum()
        root = self.root.copy()
        root[i, j] += d[2 * m : k]
        root[i[i > j], j[i > j]] += 1j * d[k:k2]
        phi = self.phi + d[k2 + 1 :].reshape(n, m)
        size = np.linalg.norm(phi, axis=0)
        zeta = np.clip(self.zeta * np.exp(np.clip(d[m : 2 * m], -1, 1)), 1e-5, 0.5)
        f = self.f * np.exp(np.clip(d[:m], -0.05, 0.05))
        noise = self.noise * float(np.exp(np.clip(d[k2], -2, 2)))
        return _Values(f, zeta, root * size[:, None], noise, phi / size)


def _responses(x: _Values, data: _Data) -> tuple[Complex, Complex, Complex]:
    """h (k, m) and its derivatives by ln f and ln ζ."""
    beta = x.f / data.freqs[:, None]
    h = (data.freqs[:, None] / data.freqs.mean()) ** data.rise / (1 - beta**2 - 2j * x.zeta * beta)
    slope = h / (1 - beta**2 - 2j * x.zeta * beta)
    return h, slope * (2 * beta**2 + 2j * x.zeta * beta), slope * 2j * x.zeta * beta


def _covariance(x: _Values, h: Complex, n: int) -> Any_:
    """E (k, ch, ch)."""
    a = (x.phi * h[:, None, :]) @ x.root
    return a @ a.conj().transpose(0, 2, 1) + x.noise * np.eye(n)


def _cost(x: _Values, data: _Data) -> float:
    """Negative log-likelihood up to a constant."""
    e = _covariance(x, _responses(x, data)[0], data.spectra.shape[1])
    sign, logdet = np.linalg.slogdet(e)
    if not (sign.real > 0).all():
        return float(np.inf)
    solved = np.linalg.solve(e, data.spectra[:, :, None])[:, :, 0]
    return float(logdet.sum() + (data.spectra.conj() * solved).real.sum())


def _gradients(x: _Values, h: Complex, df: Complex, dz: Complex) -> Any_:
    """∂E (p, k, ch, ch) of the parameters."""
    m, n = x.f.size, x.phi.shape[0]
    i, j = np.tril_indices(m)
    s = x.force
    hs = h[:, :, None] * s * h.conj()[:, None, :]

    def outer(mid: Any_) -> Any_:
        """Φ mid Φᵀ + its adjoint for `mid` (k, m, m)."""
        out = x.phi @ mid @ x.phi.T
        return out + out.conj().transpose(0, 2, 1)

    def of(change: Complex, a: int) -> Any_:
        only = np.zeros_like(h)
        only[:, a] = change[:, a]
        return outer(only[:, :, None] * s * h.conj()[:, None, :])

    def by_root(a: int, b: int, turn: complex) -> Any_:
        part = np.zeros((m, m), dtype=np.complex128)
        part[a, b] = turn
        return outer(h[:, :, None] * (part @ x.root.conj().T) * h.conj()[:, None, :])

    def by_shape(row: int, a: int) -> Any_:
        part = np.zeros((n, m))
        part[row, a] = 1.0
        out = part @ hs @ x.phi.T
        return out + out.conj().transpose(0, 2, 1)

    own = [of(df, a) for a in range(m)] + [of(dz, a) for a in range(m)]
    roots = [by_root(a, b, 1.0) for a, b in zip(i.tolist(), j.tolist(), strict=True)]
    roots += [by_root(a, b, 1j) for a, b in zip(i.tolist(), j.tolist(), strict=True) if a > b]
    noise = [np.broadcast_to(x.noise * np.eye(n), (len(h), n, n))]
    return np.stack(own + roots + noise + [by_shape(r, a) for r in range(n) for a in range(m)])


def _scores(x: _Values, data: _Data) -> tuple[Float, Float]:
    """Gradient (p,) of the cost and information (p, p); a few lines in memory at a time."""
    n, m = x.phi.shape
    p = 2 * m + m * m + 1 + n * m
    batch = max(1, 2_000_000 // (p * n * n))
    grad, info = np.zeros(p), np.zeros((p, p))
    for a in range(0, data.freqs.size, batch):
        part = _Data(data.freqs[a : a + batch], data.spectra[a : a + batch], data.rise)
        h, df, dz = _responses(x, _Data(part.freqs, part.spectra, 0))
        lift = (part.freqs[:, None] / data.freqs.mean()) ** data.rise
        h, df, dz = h * lift, df * lift, dz * lift
        e = _covariance(x, h, n)
        w = np.linalg.solve(e, _gradients(x, h, df, dz))
        solved = np.linalg.solve(e, part.spectra[:, :, None])[:, :, 0]
        seen = np.einsum("kc,pkc->p", part.spectra.conj(), (w @ solved[:, :, None])[..., 0])
        grad += np.einsum("pkcc->p", w).real - seen.real
        info += (w.reshape(p, -1) @ w.transpose(0, 1, 3, 2).reshape(p, -1).T).real
    return grad, info


def _start(data: _Data, frequencies: Float) -> _Values:
    """Shapes from the lines nearest each frequency, the rest from the levels there."""
    m, n = frequencies.size, data.spectra.shape[1]
    width = max(0.01 * frequencies.mean(), 6 * (data.freqs[1] - data.freqs[0]))
    phi = np.empty((n, m))
    top = np.empty(m)
    for i, f in enumerate(frequencies):
        y = data.spectra[
            np.argsort(np.abs(data.freqs - f))[
                : max(8, int((np.abs(data.freqs - f) < width / 2).sum()))
            ]
        ]
        values, vectors = np.linalg.eigh((y.T @ y.conj()).real / len(y))
        phi[:, i], top[i] = vectors[:, -1], values[-1]
    if (
        m > 1 and np.abs(phi[:, 0] @ phi[:, 1]) > 0.95
    ):  # one line of sight: take the two main directions of the band
        phi = np.linalg.eigh((data.spectra.T @ data.spectra.conj()).real)[1][:, -m:][:, ::-1].copy()
    noise = float(
        np.linalg.eigvalsh((data.spectra.T @ data.spectra.conj()).real / len(data.spectra))[
            : n - m
        ].mean()
    )
    zeta = np.full(m, 0.01)
    return _Values(
        frequencies,
        zeta,
        np.diag(np.sqrt(top * 4 * zeta**2)).astype(complex),
        max(noise, 1e-9),
        phi,
    )


def _maximise(x: _Values, data: _Data) -> _Values:
    """Levenberg-damped Fisher scoring."""
    cost, damp = _cost(x, data), 1e-2
    for _ in range(MOST_STEPS):
        grad, info = _scores(x, data)
        size = np.maximum(np.diag(info), 1e-12 * np.diag(info).max())
        for _ in range(12):
            new = x.stepped(
                np.asarray(-np.linalg.solve(info + damp * np.diag(size), grad), dtype=np.float64)
            )
            if (value := _cost(new, data)) < cost:
                break
            damp *= 5
        else:
            return x
        gain, x, cost, damp = cost - value, new, value, max(damp / 5, 1e-8)
        if gain < TOLERANCE * data.freqs.size:
            return x
    raise NotConverged(
        f"Bayesian FFT in {data.freqs[0]:.4g} .. {data.freqs[-1]:.4g} Hz: {MOST_STEPS} steps"
    )


def _posterior(x: _Values, data: _Data) -> Float:
    """Covariance (p, p) under the unit length of the shapes."""
    n, m = x.phi.shape
    _, info = _scores(x, data)
    fixed = np.zeros((m, len(info)))
    for a in range(m):
        fixed[a, len(info) - n * m + a :: m] = x.phi[:, a]
    free = null_space(fixed)
    return np.asarray(
        free @ np.linalg.pinv(free.T @ info @ free, rcond=1e-13, hermitian=True) @ free.T
    )


def bayes_fft(
    history: TimeHistory, band: tuple[float, float], frequencies: Sequence[float]
) -> BayesResult:
    """Most probable modes of a narrow band, and their posterior standard deviations.

    Parameters
    ----------
    history : TimeHistory
        Accelerations, velocities or displacements, all of one kind.
    band : (float, float), Hz
        Holds these modes and no other; some ten half-power bandwidths to either side where
        neighbours allow.
    frequencies : sequence of float, Hz
        First guess of each mode: one, or a close pair (or more).

    Raises
    ------
    ConfigError
        If a guess is outside the band or channels are fewer than modes.
    DataError
        If the band has too few lines, or a channel is dead.
    NotConverged
    """
    f0 = np.sort(np.asarray(frequencies, dtype=np.float64))
    if not f0.size or f0[0] <= band[0] or f0[-1] >= band[1] or len(history.channels) <= f0.size:
        raise ConfigError(
            f"Bayesian FFT: guesses {f0.tolist()} Hz must be within {band[0]:.4g} .. "
            f"{band[1]:.4g} Hz, and fewer than "
            f"the {len(history.channels)} channels"
        )
    y, scale = prepared(history)
    n = y.shape[1]
    at = np.arange(
        max(1, int(np.ceil(band[0] * n / history.rate))),
        int(min(band[1] * n / history.rate, n // 2 - 1)) + 1,
    )
    if at.size < 4 * f0.size + 8:
        raise DataError(
            f"{history.source}: {at.size} lines in {band[0]:.4g} .. {band[1]:.4g} Hz; needed: "
            f"{4 * f0.size + 8}"
        )
    kinds = {c.quantity for c in history.channels}
    rise = _RISE.get(kinds.pop(), 0) if len(kinds) == 1 else 0
    spectra = np.stack([rfft(c)[at] for c in y], axis=1) * np.sqrt(2 / (n * history.rate))
    data = _Data(at * history.rate / n, spectra, rise)
    x = _maximise(_start(data, f0), data)
    return _result(history, x, _posterior(x, data), scale, data)


def _result(history: TimeHistory, x: _Values, cov: Float, scale: Float, data: _Data) -> BayesResult:
    """In the units of the channels, ascending in frequency."""
    n, m = x.phi.shape
    at = np.argsort(x.f, kind="stable")
    f, z = x.f[at], x.zeta[at]
    both = np.concatenate([at, m + at])
    part = cov[np.ix_(both, both)] * np.outer(np.append(f, z), np.append(f, z))
    values, vectors = np.linalg.eigh(part)
    factor = (vectors * np.sqrt(np.maximum(values, 0))).T
    tail = cov[-n * m :, -n * m :].reshape(n, m, n, m)[:, at][:, :, :, at]
    shape, std = zip(
        *(_scaled(x.phi[:, at[a]], tail[:, a, :, a], scale) for a in range(m)), strict=True
    )
    ids = tuple(c.id for c in history.channels)
    modes = ModeSet(
        f, z, np.stack(shape, axis=1), ids, source=f"{history.source or 'record'}: Bayesian FFT"
    )
    sd = np.sqrt(np.diag(part))
    force = x.force[np.ix_(at, at)]
    ratio = np.diag(force).real / (4 * z**2 * x.noise)
    return BayesResult(
        modes,
        Uncertainty(sd[:m], sd[m:], np.stack(std, axis=1), factor),
        force,
        x.noise,
        ratio,
        data.freqs.size,
    )


def _scaled(phi: Float, cov: Float, scale: Float) -> tuple[Float, Float]:
    """Shape with largest component 1, and the standard deviation of its components."""
    psi = phi * scale
    top = int(np.argmax(np.abs(psi)))
    turn = np.eye(psi.size)
    turn[:, top] -= psi / psi[top]
    turn = turn * scale / psi[top]
    return psi / psi[top], np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", turn, cov, turn), 0))
