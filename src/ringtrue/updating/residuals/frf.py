"""Residuals of frequency response functions and of their zeros, by superposition of a model's
modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Complex, Float, Int, freeze_arrays
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.updating.prediction import Damping
from ringtrue.updating.residuals.modal import (
    NO_MODE,
    Deviations,
    Point,
    ResidualBlock,
    rows_block,
)

FAR = 30.0
# of the root mean square of the FRFs at a line: what lies below, by symmetry or noise, has no
# logarithm
FLOOR = 1e-3
# of the largest eigenvalue: below this a mode does not bound a zero of an FRF
RIGID = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Frf(Deviations):
    """Frequency response functions at chosen lines, by superposition of the model's modes.

    Attributes
    ----------
    freqs : (q,) float64, Hz
        Chosen lines.
    measured : (q, o, i) complex128
        Receptance, mobility or accelerance, as `order` says.
    outputs, inputs : (o,), (i,) int64
        Channels; an input acts along its channel.
    damping : float, (m,) float64 or Damping
        Ratio of all modes, of each, or by frequency (its change with the frequency is left out of
        the sensitivity).
    order : {0, 1, 2}
        Of differentiation: 0 receptance, 1 mobility, 2 accelerance.
    form : {"log", "complex"}
        ln √(|H|² + ε²), ε 60 dB below the root mean square of the measured FRFs at that line; or H
        over the root mean square of the measured one, real and imaginary parts.
    std : float
        Of one value: of ln|H|, or of the scaled parts.
    decay : float
        σ/ω: both sides are taken at s = σ + iω. 0 but where `broadened`.
    record : freqs (f,), Hz, and data (f, o, i), optional
        All measured lines, two or more: what `broadened` needs.
    """

    freqs: Float
    measured: Complex
    outputs: Int
    inputs: Int
    damping: float | Float | Damping = 0.01
    order: int = 2
    form: Literal["log", "complex"] = "log"
    std: float = 0.2
    decay: float = 0.0
    record: tuple[Float, Complex] | None = None
    whole = True

    def __post_init__(self) -> None:
        freeze_arrays(self)
        shape = (self.freqs.size, self.outputs.size, self.inputs.size)
        if self.measured.shape != shape:
            raise InputError(
                f"FRFs {self.measured.shape} for (line, output, input) = {shape}"
            )

    @property
    def highest(self) -> float:
        """See `Term`."""
        return float(self.freqs.max(initial=0.0))

    def response(self, at: Point) -> tuple[Complex, Complex]:
        """H (q, o, i) of the model and ∂H/∂x (q, o, i, p)."""
        now = at.whole
        lam = (2 * np.pi * now.frequencies) ** 2
        out, into = now.shapes[self.outputs], now.shapes[self.inputs]
        d_out, d_in = now.d_shapes[self.outputs], now.d_shapes[self.inputs]
        given = self.damping
        if isinstance(given, Damping):
            given = given.at(now.frequencies)
        zeta = np.broadcast_to(given, lam.shape)
        s = 2 * np.pi * self.freqs[:, None] * (self.decay + 1j)
        root = np.sqrt(np.abs(lam))
        g = 1 / (lam + s**2 + 2 * zeta * root * s)
        h = np.einsum("qm,om,im->qoi", g, out, into, optimize=True)
        by_lambda = -(g**2) * (1 + zeta * s / np.where(root > 0, root, np.inf))
        d_h = np.einsum("qm,omp,im->qoip", g, d_out, into, optimize=True)
        d_h += np.einsum("qm,om,imp->qoip", g, out, d_in, optimize=True)
        d_h += np.einsum(
            "qm,mp,om,im->qoip", by_lambda, now.d_lambda, out, into, optimize=True
        )
        by = s[:, :, None] ** self.order
        return h * by, d_h * by[..., None]

    def broadened(self, width: float) -> Frf:
        """The same with the peaks of both sides broadened, so that those that are shifted by less
        still overlap; itself without a record.

        Impulse responses times e^{-σt}, as an exponential window has them, have the transfer
        function H(σ + iω): the mean of H(iω) under the Poisson kernel of width σ, over the lines
        of the record of both signs.
        """
        if self.record is None or self.record[0].size < 2:
            return self
        freqs, data = self.record
        flat = data.reshape(freqs.size, -1)
        at = self.freqs[:, None]
        sigma = width * at
        step = np.gradient(freqs)
        above = step * sigma / (sigma**2 + (freqs - at) ** 2)
        below = step * sigma / (sigma**2 + (freqs + at) ** 2)
        total = (above + below).sum(axis=1, keepdims=True)
        mean = (above @ flat + below @ flat.conj()) / total
        return replace(self, decay=width, measured=mean.reshape(self.measured.shape))

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        h, d_h = self.response(at)
        d_h = d_h.reshape(h.size, -1)
        if self.form == "log":
            square = np.abs(self.measured) ** 2
            floor = FLOOR**2 * np.mean(square, axis=(1, 2), keepdims=True)
            size = np.abs(h) ** 2 + floor
            value = 0.5 * np.log((square + floor) / size).ravel()
            slope = (h.conj().reshape(-1, 1) * d_h).real / size.reshape(-1, 1)
            return rows_block(
                value / self.std, slope / self.std, np.full(h.size, NO_MODE)
            )
        scale = self.std * float(np.sqrt(np.mean(np.abs(self.measured) ** 2)))
        rest = (self.measured - h).ravel() / scale
        value = np.concatenate([rest.real, rest.imag])
        slope = np.concatenate([d_h.real, d_h.imag]) / scale
        return ResidualBlock(
            value, slope, np.tile(np.arange(h.size), 2), np.full(value.size, NO_MODE)
        )

    def fit(self, at: Point) -> Float:
        """See `Term`: an FRF is a datum, its square the mean over the lines."""
        value = self(at).value
        return np.asarray(
            np.mean(value.reshape(-1, self.outputs.size * self.inputs.size) ** 2, 0)
        )


@dataclass(frozen=True, slots=True, eq=False)
class AntiResonances(Deviations):
    """1 − f/f_test of the zeros of one FRF, paired by frequency.

    The zeros are those of the superposed modes: give the model modes well above the highest. A zero
    of a transfer FRF may be complex; it then has no partner here.

    Attributes
    ----------
    output, input : int
        Channels.
    frequencies : (z,) float64, Hz
        Measured.
    std : float
        Relative.
    gate : float
        Largest relative deviation of a pair. A zero without a partner counts as one at the gate.
    """

    output: int
    input: int
    frequencies: Float
    std: float = 0.01
    gate: float = 0.3
    whole = True

    @property
    def highest(self) -> float:
        """See `Term`."""
        return float(np.max(self.frequencies))

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        top = self.highest * (1 + self.gate)
        mu, d_mu = zeros(at.whole, self.output, self.input, top)
        f = np.sqrt(mu) / (2 * np.pi)
        f_test = np.asarray(self.frequencies, dtype=np.float64)
        value = np.full(f_test.size, self.gate)
        slope = np.zeros((f_test.size, d_mu.shape[1]))
        away = np.minimum(np.abs(f[None, :] / f_test[:, None] - 1), self.gate)
        i, j = linear_sum_assignment(away)
        i, j = i[away[i, j] < self.gate], j[away[i, j] < self.gate]
        value[i] = 1 - f[j] / f_test[i]
        slope[i] = d_mu[j] / (8 * np.pi**2 * f[j] * f_test[i])[:, None]
        return rows_block(
            value / self.std, slope / self.std, np.full(f_test.size, NO_MODE)
        )


def zeros(
    now: Linearisation, output: int, into: int, top: float = np.inf
) -> tuple[Float, Float]:
    """Real positive zeros μ (z,), (rad/s)², ascending, of Σ φ_o φ_i/(λ − μ), and ∂μ/∂x (z, p).

    The zeros are the finite eigenvalues of [Λ φ_i; φ_oᵀ −r] against diag(I, 0), r the flexibility
    of the modes far above; the sensitivities follow from the sum by implicit differentiation. He
    and Fu (2001), Modal Analysis, ch. 4.

    Parameters
    ----------
    top : float, Hz
        Up to where zeros are looked for. Modes beyond `FAR` times that are first taken as static:
        the stiffest ones of a reduced basis would drown the zeros in rounding. The zeros are those
        of the whole sum.
    """
    lam = (2 * np.pi * now.frequencies) ** 2
    a = now.shapes[output]
    b = now.shapes[into]
    near = lam <= (2 * np.pi * FAR * top) ** 2
    scale = lam[near].max(initial=0.0)
    if not scale:
        return np.zeros(0), np.zeros((0, now.d_lambda.shape[1]))
    rest = float(np.sum((a * b)[~near] / lam[~near])) * scale
    side = b[near, None]
    pencil = np.block(
        [[np.diag(lam[near] / scale), side], [a[None, near], np.full((1, 1), -rest)]]
    )
    mass = np.diag([*np.ones(int(near.sum())), 0.0])
    high, low = linalg.eig(pencil, mass, right=False, homogeneous_eigvals=True)
    finite = np.abs(low) > 1e-10 * np.abs(high)
    mu = high[finite] / low[finite] * scale
    real = (np.abs(mu.imag) < 1e-9 * np.abs(mu)) & (mu.real > RIGID * scale)
    mu = np.sort(mu.real[real])
    gap = np.abs(lam - mu[:, None]).min(axis=1, initial=np.inf)
    mu = mu[gap > 1e-12 * scale]  # a mode that does not take part
    for _ in range(2 if (~near).any() else 0):  # Newton on the whole sum
        gap = lam - mu[:, None]
        mu = mu - ((a * b) / gap).sum(axis=1) / ((a * b) / gap**2).sum(axis=1)
    gap = lam - mu[:, None]
    square = (a * b) / gap**2
    d_ab = a[:, None] * now.d_shapes[into] + b[:, None] * now.d_shapes[output]
    return mu, (square @ now.d_lambda - (1 / gap) @ d_ab) / square.sum(axis=1)[:, None]
