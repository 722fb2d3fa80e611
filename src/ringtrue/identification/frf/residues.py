"""Least-squares frequency-domain residues (LSFD), one global problem over all lines and responses.

The residues of a mode are held to rank one, ψ_k l_kᵀ, with the participation vectors l_k given.
Weights are separable (line and input times response), so every response shares one normal matrix,
and all sums over lines are those of scalar functions 1/(s − λ_k): a few dozen columns, whatever the
number of responses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModalModel, Norm
from ringtrue.core.signals import FrfSet
from ringtrue.errors import InputError
from ringtrue.identification.frf.lines import (
    Lines,
    Noise,
    _beside_terms,
    augment,
    functions,
    mirrored,
    mirrored_rows,
    resonances,
)


@dataclass(frozen=True, slots=True, eq=False)
class DrivingPoints:
    """Responses at the points and in the directions of inputs.

    Attributes
    ----------
    output, input : (p,) int64
        Positions of the response and of the input.
    sign : (p,) float64
        -1 where the input acts against the direction of the sensor.
    """

    output: Int
    input: Int
    sign: Float

    def __len__(self) -> int:
        return int(self.output.size)

    def take(self, at: Bool) -> DrivingPoints:
        """The chosen points."""
        return DrivingPoints(self.output[at], self.input[at], self.sign[at])

    def shapes(self, shapes: Complex) -> Complex:
        """(p, m) of shapes (out, m), along the inputs."""
        return shapes[self.output] * self.sign[:, None]


def noise(frfs: FrfSet) -> Noise:
    """The noise of the FRFs: from the coherence, σ² = |H|²(1 − γ²)/(2 n γ²), else from the
    roughness over lines.

    Where the coherence is unknown an error of 2 % of the local level is added, as systematic errors
    then dominate. Where the end of the block is known, what rings on from impact to impact lowers
    the coherence at the modes and is no noise: lines count as their surroundings do.
    """
    h2 = np.abs(frfs.data) ** 2
    if np.isfinite(frfs.coherence).all():
        g = np.clip(frfs.coherence, 1e-3, 1 - 1e-9)
        n = np.where(np.isfinite(frfs.averages), np.maximum(frfs.averages, 1), 1)
        var = h2 * (1 - g) / (2 * n * g) + 1e-8 * h2
    else:
        # the median of squared second differences over the lines, per component
        roughness = np.median(_bends(frfs.data, frfs.freqs), axis=0) / (2 * 0.693)
        var = roughness + (0.02**2) * h2
    var = np.maximum(var, 1e-12 * h2.mean(axis=0) + np.finfo(float).tiny)
    log = np.log(var)
    mean = log.mean()
    line = _smooth(log.mean(axis=(1, 2)))
    if np.isfinite(frfs.kept):
        around = max(31, line.size // 10) | 1
        line = np.minimum(line, median_filter(line, size=around, mode="nearest"))
    response = log.mean(axis=(0, 2)) - mean
    given = log.mean(axis=(0, 1)) - mean
    return Noise(np.exp(0.5 * line), np.exp(0.5 * response), np.exp(0.5 * given))


def _bends(h: Complex, freqs: Float) -> Float:
    """(freq - 2, out, in) squared second differences over the lines, of white noise its power."""
    left = ((freqs[2:] - freqs[1:-1]) / (freqs[2:] - freqs[:-2]))[:, None, None]
    d = np.abs(h[1:-1] - left * h[:-2] - (1 - left) * h[2:]) ** 2
    return d / (1 + left**2 + (1 - left) ** 2)


def line_coherence(h: Complex, freqs: Float) -> Float:
    """(freq,) 1 − power of the second differences over that of the FRFs, median of all: about 0 of
    white noise.
    """
    share = np.minimum(
        _bends(h, freqs) / np.maximum(np.abs(h[1:-1]) ** 2, np.finfo(float).tiny), 1.0
    )
    return np.pad(1 - np.median(share, axis=(1, 2)), 1, mode="edge")


def _smooth(line: Float, width: int = 5) -> Float:
    kernel = np.ones(width) / width
    return np.convolve(np.pad(line, width // 2, mode="edge"), kernel, "valid")


def solve_shapes(lines: Lines, poles: Complex, participation: Complex) -> Complex:
    """Shapes ψ (out, m) complex128, given poles (m,) and participation (m, in)."""
    q = functions(lines, poles)
    qh = q.conj().T
    d = augment(participation * lines.input).T[:, :, None]  # (in, 2 m, 1)
    n = mirrored(qh @ q) * (d.conj() * d.transpose(0, 2, 1)).sum(axis=0)
    b = mirrored_rows(qh @ lines.y)
    rhs = (d.conj() * b).sum(axis=0)
    scale = 1 / np.sqrt(np.maximum(np.diag(n).real, np.finfo(float).tiny))
    psi = scale[:, None] * np.linalg.solve(
        scale[:, None] * n * scale, scale[:, None] * rhs
    )
    return np.asarray(psi[: poles.size].T, dtype=np.complex128)


def lsfd(
    frfs: FrfSet,
    lines: Lines,
    poles: Complex,
    participation: Complex,
    *,
    shapes: Complex,
    points: DrivingPoints,
) -> ModalModel:
    """The modal model of given poles and residues.

    Parameters
    ----------
    frfs : FrfSet, lines > 0 Hz
    lines : Lines
        The same, prepared.
    poles : (m,) complex128, rad/s, without the exponential window
    participation : (m, in) complex128
    shapes : (out, m) complex128
        Of `solve_shapes`.
    points : DrivingPoints

    Returns
    -------
    ModalModel
        Of unit modal A where there are driving points.
    """
    rest = frfs.data - modal_part(lines, poles, shapes, participation)
    # lower and upper residuals of what the modes leave
    terms = np.stack([(lines.s[0] / lines.s) ** 2, np.ones(lines.s.size)], axis=1)
    q, r = np.linalg.qr(lines.weight[:, None] * (lines.kind[:, None] * terms))
    y = lines.weight[:, None] * rest.transpose(2, 0, 1)
    # (in, 2, out)
    residuals = np.asarray(np.linalg.solve(r, q.conj().T @ y), dtype=np.complex128)
    shape, part = blow_factors(lines, poles)
    model = ModalModel(
        poles=poles,
        shapes=shapes / shape,
        participation=participation / part,
        lower=(residuals[:, 0] * lines.s[0] ** 2).T,
        upper=residuals[:, 1].T,
        outputs=frfs.outputs,
        inputs=frfs.inputs,
        kind=frfs.kind,
    )
    return normalise(model, points)


def blow_factors(lines: Lines, poles: Complex) -> tuple[Complex, Complex]:
    """What rings on from earlier impacts makes of the shapes (out, m) and participations (m, in) of
    a fit.
    """
    if lines.impacts is None:
        one = np.ones((1, 1), dtype=np.complex128)
        return one, one
    return lines.impacts.factors(poles)


def modal_part(
    lines: Lines, poles: Complex, shapes: Complex, participation: Complex
) -> Complex:
    """(freq, out, in) what the modes contribute, at the lines and in the kind of the data."""
    residue = (shapes.T[:, :, None] * participation[:, None, :]).reshape(poles.size, -1)
    both = np.concatenate([residue, residue.conj()])
    h = resonances(lines, augment(poles))[0] @ both
    return np.asarray(h.reshape(lines.s.size, shapes.shape[0], participation.shape[1]))


def weighted_rest(
    lines: Lines, poles: Complex, participation: Complex, shapes: Complex
) -> Complex:
    """(in, freq, out) what modes and residual terms leave of the data, in units of the noise.

    `participation` is that of the weighted data.
    """
    part = augment(participation).T[:, :, None] * augment(shapes.T * lines.response)
    # residual terms come out of the fewer columns
    if 2 * poles.size <= part.shape[0] * part.shape[2]:
        modes = functions(lines, poles) @ part
        return np.subtract(lines.y * lines.response, modes, out=modes)
    modes = lines.weight[:, None] * (resonances(lines, augment(poles))[0] @ part)
    return _beside_terms(lines, lines.y * lines.response - modes)


def noise_left(lines: Lines, rest: Complex) -> Noise:
    """The noise that follows from what it leaves, `rest` (in, freq, out) of `weighted_rest`.

    The errors of measured FRFs grow with the response near a mode, whatever the coherence says of a
    typical channel.
    """
    power = np.abs(rest) ** 2 + np.finfo(float).tiny
    response = power.mean(axis=(0, 1))
    given = power.mean(axis=(1, 2))
    response = response / np.exp(np.log(response).mean())
    given = given / np.exp(np.log(given).mean())
    line = (power / (response * given[:, None, None])).mean(axis=(0, 2))
    # five lines, and forty values at least
    wide = max(5, int(np.ceil(40 / (response.size * given.size))) | 1)
    smooth = _smooth(line, min(wide, line.size - 1 + line.size % 2))
    line = np.maximum(smooth, 1e-4 * np.median(line))
    return Noise(
        np.sqrt(line) / lines.weight,
        np.sqrt(response) / lines.response,
        np.sqrt(given) / lines.input,
    )


def synthesise_windowed(model: ModalModel, lines: Lines) -> Complex:
    """(freq, out, in) the FRFs of the model as measured: under the exponential window of the
    data.
    """
    shape, part = blow_factors(lines, model.poles)
    h = modal_part(lines, model.poles, model.shapes * shape, model.participation * part)
    s = lines.s[:, None, None]
    return h + (model.lower / s**2 + model.upper) * lines.kind[:, None, None]


def driving_pairs(model: ModalModel | FrfSet) -> DrivingPoints:
    """The driving points, by the names of the channels: one response for each input at most."""
    try:
        out = DofSet.parse(c.id for c in model.outputs)
        inp = DofSet.parse(c.id for c in model.inputs)
    except InputError:
        at = {c.id: i for i, c in enumerate(model.outputs)}
        found = np.array([at.get(c.id, -1) for c in model.inputs], dtype=np.int64)
        given = np.flatnonzero(found >= 0)
        return DrivingPoints(found[given], given, np.ones(given.size))
    found = out.find(inp.node, inp.direction)
    given = np.flatnonzero(found >= 0)
    along = out.direction[found[given]] * inp.direction[given]
    return DrivingPoints(found[given], given, np.where(along < 0, -1.0, 1.0))


def normalise(model: ModalModel, points: DrivingPoints) -> ModalModel:
    """Shapes of unit modal A where there are driving points, residue = φ φᵀ; else the model as it
    is.
    """
    if not points or not model.poles.size:
        return model
    psi = points.shapes(model.shapes)
    part = model.participation.T[points.input]
    # regressed on l, which all responses fix: ψ has more noise
    overlap = (part.conj() * psi).sum(axis=0)
    square = (np.abs(part) ** 2).sum(axis=0) / np.where(overlap != 0, overlap, 1.0)
    alpha = np.sqrt(np.where(square != 0, square, 1.0))
    return replace(
        model,
        shapes=model.shapes * alpha,
        participation=model.participation / alpha[:, None],
        norm=Norm.MODAL_A,
    )
