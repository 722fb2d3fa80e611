"""Coherence-weighted nonlinear least squares on poles and participations, by variable projection.

The shapes and residual terms are eliminated (Golub, Pereyra 1973; Kaufman's form of the Jacobian
1975). With separable weights the projected Gauss-Newton matrix of every response is one matrix,
scaled entry by entry by products of its shape components, so that a step costs no more than one
LSFD.

Hermitian systems in augmented unknowns (x, conj x) are solved in real numbers: with H of blocks V =
R + iS at (x, x) and W = P + iQ at (x, conj x) the form in (Re x, Im x) is [[R + P, Q − S], [Q + S,
R − P]], of the same eigenvalues (van den Bos 1994, IEE Proc. 141).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.iterate import Outcome
from ringtrue.core.modes import HasPoles
from ringtrue.identification.common.uncertainty import students_factor
from ringtrue.identification.frf.lines import (
    Lines,
    augment,
    condensed,
    functions_slopes,
)
from ringtrue.identification.frf.residues import DrivingPoints, weighted_rest


@dataclass(frozen=True, slots=True)
class RefinementLimits:
    """The steps of a refinement.

    Attributes
    ----------
    iterations : int
    reach : float
        Half bandwidths, farther from its start than which no pole goes.
    near : float
        Of the reach, for which lines are condensed at a time.
    tolerance : float
        Relative fall of the objective, below which it has converged.
    flat : float
        Share of the curvature that is nothing but rounding.
    """

    iterations: int = 20
    reach: float = 2.0
    near: float = 0.5
    tolerance: float = 1e-6
    flat: float = 1e-8


LIMITS = RefinementLimits()


def real_form(v: Complex, w: Complex) -> Float:
    """(2 k, 2 k) form in (Re x, Im x) of the blocks (k, k) at (x, x) and (x, conj x)."""
    return np.block(
        [[v.real + w.real, w.imag - v.imag], [w.imag + v.imag, v.real - w.real]]
    )


def augmented_form(c: Float) -> tuple[Complex, Complex]:
    """Blocks (k, k) at (x, x) and (x, conj x) of a form in (Re x, Im x): `real_form` turned
    round.
    """
    k = c.shape[0] // 2
    a = c[:k, :k]
    b = c[:k, k:]
    d = c[k:, k:]
    value = 0.5 * (a + d + 1j * (b.T - b))
    conjugate = 0.5 * (a - d + 1j * (b.T + b))
    return np.asarray(value), np.asarray(conjugate)


def pseudo_inverse(a: Float, least: float) -> Float:
    """Of a symmetric matrix without the eigenvalues below `least` of the largest: by Cholesky where
    none is.
    """
    low, fails = lapack.dpotrf(a, lower=True)
    if not fails and lapack.dpocon(low, np.linalg.norm(a, 1), uplo="L")[0] > least:
        half = np.tril(lapack.dpotri(low, lower=True)[0])
        return np.asarray(half + np.tril(half, -1).T)
    return np.asarray(np.linalg.pinv(a, rcond=least, hermitian=True))


@dataclass(frozen=True, slots=True, eq=False)
class Refined(HasPoles):
    """Poles and participation vectors that minimise the weighted error.

    Attributes
    ----------
    poles : (m,) complex128, rad/s
    participation : (m, in) complex128
    shapes : (out, m) complex128
    std_frequency : (m,) float64, Hz
    std_damping : (m,) float64
    factor : (2 m, 2 m) float64
        F with FᵀF the covariance of (frequencies, damping).
    error : float
        Weighted rms error; 1 means that the model explains the data down to the noise.
    cost : float
        Weighted sum of squares.
    outcome : Outcome
    known : Known
        What the deviations of the shapes rest on.
    """

    poles: Complex
    participation: Complex
    shapes: Complex
    std_frequency: Float
    std_damping: Float
    factor: Float
    error: float
    cost: float
    outcome: Outcome
    known: Known


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """The fit at its end, in augmented coordinates.

    Attributes
    ----------
    state : FitState
    covariance : (2 m (1 + in), 2 m (1 + in)) complex128
        Zero for the parameters that fix the scales.
    own : (out, m) float64
        Squared weighted errors that the residues see.
    rest : (in, freq, out) complex128
        What the fit leaves of the data, in units of the noise.
    """

    state: FitState
    covariance: Complex
    own: Float
    rest: Complex


@dataclass(frozen=True, slots=True, eq=False)
class FitState:
    """Poles and participations, and what `_evaluate` finds there."""

    poles: Complex
    part: Complex
    shapes: Complex
    cost: float
    hessian: Complex  # at (x, x), of the values (λ, then l of each input)
    conjugate: Complex  # at (x, conj x)
    gradient: Complex
    shape_var: Float
    # of the augmented shapes by each parameter, times the shape of its mode
    slope: Complex
    free: Int  # positions among the values


def refine(
    lines: Lines,
    poles: Complex,
    participation: Complex,
    *,
    iterations: int = LIMITS.iterations,
    local: bool = True,
) -> Refined:
    """Refine all modes at once.

    No pole goes further than a few half bandwidths from its start: measured FRFs that disagree
    among themselves would else turn modes into broad terms that patch up the fit.

    Parameters
    ----------
    lines : Lines
    poles : (m,) complex128, rad/s, start
    participation : (m, in) complex128, start
    iterations : int
    local : bool
        Deviations rest on the error where each mode is seen; else on that of all lines, which takes
        less time.

    Returns
    -------
    Refined
    """
    reach = LIMITS.reach * np.abs(poles.real) + np.diff(lines.s.imag).mean()
    part = participation * lines.input
    part = part / np.linalg.norm(part, axis=1, keepdims=True)
    near = LIMITS.near * reach
    few = condensed(lines, poles, near)
    centre = poles
    state = _evaluate(few, poles, part)
    damping = 1e-3
    outcome = Outcome.MAX_ITERATIONS
    for _ in range(iterations if poles.size else 0):
        trial = _step(state, damping, poles, reach)
        if trial is not None and (np.abs(trial[0] - centre) > near).any():
            few = condensed(lines, trial[0], near)
            centre = trial[0]
        new = None if trial is None else _evaluate(few, *trial)
        if new is None or new.cost > state.cost:
            damping *= 10
            if damping > 1e6:
                outcome = Outcome.STALLED
                break
            continue
        fall = (state.cost - new.cost) / max(state.cost, 1e-300)
        state = new
        damping = max(damping / 10, 1e-9)
        if fall < LIMITS.tolerance:
            outcome = Outcome.CONVERGED
            break
    return _result(lines, state, outcome, local)


def _step(
    state: FitState, damping: float, start: Complex, reach: Float
) -> tuple[Complex, Complex] | None:
    """Poles and participations a Levenberg-Marquardt step on, every pole held within reach of its
    start.

    None if a pole is no longer one of a damped mode, or rounding leaves no step.
    """
    h, scale = _scaled(state)
    slope = scale * state.gradient[state.free]
    h.flat[:: len(h) + 1] += damping
    _, d, fails = lapack.dposv(h, np.concatenate([slope.real, slope.imag]), lower=True)
    if fails:
        return None
    step = np.zeros(state.gradient.size, dtype=np.complex128)
    step[state.free] = scale * (d[: scale.size] + 1j * d[scale.size :])
    d = step.reshape(-1, state.poles.size)
    away = state.poles + d[0] - start
    poles = start + away * np.minimum(1.0, reach / np.maximum(np.abs(away), 1e-300))
    if not np.isfinite(d).all() or (poles.imag <= 0).any() or (poles.real >= 0).any():
        return None
    part = state.part + d[1:].T
    return poles, part / np.linalg.norm(part, axis=1, keepdims=True)


def _scaled(state: FitState) -> tuple[Float, Float]:
    """Gauss-Newton matrix of the free parameters in their (real, imaginary) parts over `scale`, and
    that (free,).
    """
    free = np.ix_(state.free, state.free)
    scale = 1 / np.sqrt(np.maximum(np.diag(state.hessian).real[state.free], 1e-300))
    both = scale[:, None] * scale
    return real_form(state.hessian[free] * both, state.conjugate[free] * both), scale


def _free(part: Complex, moving: Bool) -> Int:
    """Positions of the parameters that are `moving` but the largest participation of each mode: it
    fixes the scale.
    """
    m = len(part)
    mask = moving.reshape(-1, m).copy()
    mask[1 + np.abs(part).argmax(axis=1), np.arange(m)] = False
    return np.flatnonzero(mask.ravel())


def _evaluate(lines: Lines, poles: Complex, part: Complex) -> FitState:
    """Shapes, cost, gradient, Gauss-Newton matrix; augmented coordinates (λ, then l of each input;
    value, conj).

    Rows of conjugates are those of the values, conjugate and turned round: they are left out.
    """
    m, n_in = part.shape
    cc, cd, dd, cy, dy = _products(lines, poles)
    l = augment(part).T[:, :, None]
    ll = (l.conj() * l.transpose(0, 2, 1)).sum(axis=0)
    xx = cc * ll
    xy = (l.conj() * cy).sum(axis=0)
    xg = np.concatenate([cd * ll, *(l.conj() * cc)], axis=1)
    scale = 1 / np.sqrt(np.maximum(np.diag(xx).real, 1e-300))
    # small; its diagonal is needed too
    inverse = scale[:, None] * np.linalg.inv(scale[:, None] * xx * scale) * scale
    psi = inverse @ xy
    slope = -inverse @ xg
    gx = xg.reshape(2 * m, 1 + n_in, 2, m)[:, :, 0].reshape(2 * m, -1).conj().T
    gg = _gram(cc, cd, dd * ll, l)
    core = gg + gx @ slope
    each = np.arange(len(core))
    own = each + each // m * m  # the columns of the values
    # what the shapes do as well: a turn of two modes of one pole
    void = core[each, own].real < LIMITS.flat * gg[each, own].real
    w2 = lines.response**2
    # the shapes of all parameters of a mode are the same
    weighted = psi[:m].conj() * w2
    common = (weighted @ psi.T).reshape(m, 1, 2, m)
    hessian = core.reshape(1 + n_in, m, 1 + n_in, 2, m) * common
    gy = np.concatenate([(l[:, :m].conj() * dy[:, :m]).sum(axis=0), *cy[:, :m]])
    rest = (gy - gx @ psi).reshape(1 + n_in, m, -1)
    cost = float(
        (
            w2 * np.maximum(lines.power - 0.5 * (psi.conj() * xy).sum(axis=0).real, 0)
        ).sum()
    )
    var = 2 * np.diag(inverse).real[:m]
    shape_var = np.maximum(var, 0) / w2[:, None]
    return FitState(
        poles=poles,
        part=part,
        shapes=psi[:m].T,
        cost=cost,
        hessian=hessian[:, :, :, 0].reshape(len(core), -1),
        conjugate=hessian[:, :, :, 1].reshape(len(core), -1),
        gradient=(weighted * rest).sum(axis=2).ravel(),
        shape_var=shape_var,
        slope=slope,
        free=_free(part, ~void),
    )


def _products(
    lines: Lines, poles: Complex
) -> tuple[Complex, Complex, Complex, Complex, Complex]:
    """Products of the functions and slopes, and of both with the data, over lines and their mirror
    images.

    In augmented coordinates; formed with those of the real and imaginary parts of residues, which
    are real.
    """
    m = poles.size
    both = functions_slopes(lines, poles)
    parts = np.concatenate(
        [x for f in both for x in (f[:, :m] + f[:, m:], 1j * (f[:, :m] - f[:, m:]))],
        axis=1,
    )
    z = np.concatenate([parts.real, parts.imag])
    y = np.concatenate([lines.y.real, lines.y.imag], axis=1)
    gram = 2 * (z.T @ z).reshape(2, 2 * m, 2, 2 * m)
    data = 2 * (z.T @ y).reshape(y.shape[0], 2, 2 * m, -1)
    cc, cd, dd = (_augmented_gram(gram[i, :, k]) for i, k in ((0, 0), (0, 1), (1, 1)))
    real, imaginary = data.reshape(len(data), 2, 2, m, -1).transpose(2, 1, 0, 3, 4)
    cy, dy = 0.5 * np.concatenate(
        [real + 1j * imaginary, real - 1j * imaginary], axis=2
    )
    return cc, cd, dd, cy, dy


def _augmented_gram(g: Float) -> Complex:
    """Of products (2 m, 2 m) by the real and imaginary parts of residues, those by the residues and
    their conjugates.
    """
    a, b, c, d = (
        x for row in g.reshape(2, len(g) // 2, 2, -1).transpose(0, 2, 1, 3) for x in row
    )
    value = 0.25 * (a + d + 1j * (c - b))
    conjugate = 0.25 * (a - d + 1j * (b + c))
    return np.block([[value, conjugate], [conjugate.conj(), value.conj()]])


def _gram(cc: Complex, cd: Complex, dd: Complex, l: Complex) -> Complex:
    """Gram matrix of the derivatives with unit shapes, rows of the values alone: pole columns span
    all inputs, participations one each.
    """
    n_in, n = l.shape[:2]
    m = n // 2
    gg = np.zeros((1 + n_in, m, 1 + n_in, n), dtype=np.complex128)
    gg[0, :, 0] = dd[:m]
    for i in range(n_in):  # a handful of inputs
        cross = cd * l[i].T
        gg[1 + i, :, 1 + i] = cc[:m]
        gg[1 + i, :, 0] = cross[:m]
        gg[0, :, 1 + i] = cross[:, :m].conj().T
    return gg.reshape((1 + n_in) * m, -1)


def _result(lines: Lines, state: FitState, outcome: Outcome, local: bool) -> Refined:
    m = state.poles.size
    rest = weighted_rest(lines, state.poles, state.part, state.shapes)
    cov, own, error2 = _covariance(lines, state, rest if local else None)
    slope = _slopes(state.poles)
    a = cov[:m, :m]
    b = cov[:m, m : 2 * m]
    # of (Re, Im) from that of augmented (x, conj x)
    parts = np.block([[(a + b).real, (b - a).imag], [(a + b).imag, (a - b).real]]) / 2
    real = slope @ parts @ slope.T
    values, vectors = np.linalg.eigh((real + real.T) / 2)
    factor = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
    std = np.sqrt(np.maximum(np.diag(real), 0))
    return Refined(
        poles=state.poles,
        participation=state.part / lines.input,
        shapes=state.shapes,
        std_frequency=std[:m],
        std_damping=std[m:],
        factor=factor,
        error=float(np.sqrt(error2)),
        cost=state.cost,
        outcome=outcome,
        known=Known(state, cov, own, rest),
    )


def _covariance(
    lines: Lines, state: FitState, rest: Complex | None
) -> tuple[Complex, Float, float]:
    """Covariance of all augmented parameters, zero for those that fix the scales, and the squared
    weighted errors.

    The errors are those (out, m) that the residues see, and that of all data; without the `rest`
    they are the same.
    """
    free = state.free
    data = 2 * lines.y.size
    error2 = max(state.cost / max(data - 2 * free.size - 2 * state.shapes.size, 1), 0.0)
    h, scale = _scaled(state)
    size = 2 * state.gradient.size
    cov = np.zeros((size, size), dtype=np.complex128)
    both = 2 * scale[:, None] * scale
    inner, turned = (both * x for x in augmented_form(pseudo_inverse(h, LIMITS.flat)))
    value = free + free // state.poles.size * state.poles.size
    conjugate = value + state.poles.size
    cov[np.ix_(value, value)], cov[np.ix_(value, conjugate)] = inner, turned
    cov[np.ix_(conjugate, conjugate)], cov[np.ix_(conjugate, value)] = (
        inner.conj(),
        turned.conj(),
    )
    everywhere = np.full(state.shapes.shape, error2), np.full(state.poles.size, error2)
    own, shared = everywhere if rest is None else _local_error(lines, state, rest)
    each = np.tile(np.sqrt(shared), size // shared.size)
    return cov * each[:, None] * each, own, error2


def _local_error(lines: Lines, state: FitState, rest: Complex) -> tuple[Float, Float]:
    """Squared weighted errors where each mode is seen: (out, m) of its residues, (m,) of its pole
    and participation.

    The errors of measured FRFs grow with the response, in the channels that see a mode most of all:
    so each error counts as much as it moves the parameter, and what the fit takes of it is given
    back. Those that all responses share, as of noise on the force, move a pole together: their sum
    along the shape counts where it is larger. Few lines tell the error of a residue, which has
    Student's factor for it.
    """
    m = state.poles.size
    n_out = state.shapes.shape[0]
    part = (np.abs(state.part) ** 2).T[:, None]
    by_shape, by_pole = (
        part * np.abs(q[:, :m]) ** 2 for q in functions_slopes(lines, state.poles)
    )
    # (in, freq, mode)
    by_shape, by_pole = (w / w.sum(axis=(0, 1)) for w in (by_shape, by_pole))
    early = _early(lines, rest, state.poles)
    seen = state.shapes * lines.response[:, None]
    seen = seen / np.linalg.norm(seen, axis=0)

    def left(weight: Float, responses: int) -> Float:
        return np.asarray(
            np.maximum(
                (weight * (1 - by_shape - by_pole / responses)).sum(axis=(0, 1)), 0.1
            )
        )

    power = 0.5 * np.abs(rest) ** 2
    few = students_factor(2 / (by_shape**2).sum(axis=(0, 1)))
    own = np.tensordot(power, by_shape / left(by_shape, n_out), ([0, 1], [0, 1]))
    own = own * early[0] * few**2
    separate = np.tensordot(power, by_pole / left(by_pole, n_out), ([0, 1], [0, 1]))
    separate = (separate * np.abs(seen) ** 2).sum(axis=0)
    together = (
        0.5
        * (by_pole * np.abs(rest @ seen.conj()) ** 2).sum(axis=(0, 1))
        / left(by_pole, 1)
    )
    return own, np.maximum(separate, together) * early[1]


def _early(lines: Lines, rest: Complex, poles: Complex) -> Float:
    """(2, m) power of the error while a mode rings, over that of the whole block; for residues, and
    for poles.

    An exponential window leaves the noise at the start of the block, where the modes are: lines
    next to each other then have the same error, and there are fewer of them than it seems.
    """
    power = (np.abs(np.fft.ifft(rest, axis=1)) ** 2).sum(axis=(0, 2))
    t = np.arange(power.size) / power.size * 2 * np.pi / np.diff(lines.s.imag).mean()
    ringing = np.exp(-2 * t[:, None] * (lines.s[0].real - poles.real))
    both = np.stack([ringing, ringing * t[:, None] ** 2])
    there = (power @ both) / np.maximum(both.sum(axis=1), 1e-300)
    early = np.maximum(there / max(power.mean(), 1e-300), 1.0)
    terms = lines.terms.shape[1] + lines.smooth.shape[1]
    # by the fit, of the few values at the start
    taken = (early - 1) * (poles.size + terms) / power.size
    return np.asarray(early / (1 - np.minimum(taken, 0.8)))


def shape_deviations(lines: Lines, fit: Refined, points: DrivingPoints | None) -> Float:
    """Standard deviations (out, m) of the moduli of the scaled shape components, as shares of the
    modulus.

    First order, from the noise of the residues and from poles and participation vectors together.
    The scale is unit modal mass by the driving points where there are any, else a largest component
    of 1.

    Parameters
    ----------
    lines : Lines
        Those of the fit.
    fit : Refined
    points : DrivingPoints, optional
        None leaves the scale to the largest participation, held fixed.
    """
    state = fit.known.state
    cov = fit.known.covariance
    # (out, parameter)
    tile = np.tile(augment(state.shapes.T), (1 + fit.participation.shape[1], 1)).T
    own = state.shape_var * fit.known.own
    psi = np.where(state.shapes == 0, np.finfo(float).tiny, state.shapes)
    out = np.empty(psi.shape)
    # (out, parameter) arrays of all modes at once would not fit
    for k in range(fit.poles.size):
        g = tile * state.slope[k] / psi[:, k, None]
        common, noise = _scale_slope(fit, lines, points=points, g=g, psi=psi[:, k], k=k)
        g = g + common
        half = g.reshape(g.shape[0], -1, 2, fit.poles.size)
        g = 0.5 * (half + half[:, :, ::-1].conj()).reshape(g.shape)
        shared = (np.abs(noise) ** 2 * own[:, k]).sum()
        alone = own[:, k] * (
            np.abs(1 / psi[:, k]) ** 2 + 2 * (noise.conj() / psi[:, k]).real
        )
        out[:, k] = ((g @ cov) * g.conj()).real.sum(axis=1) + 0.5 * (shared + alone)
    return np.sqrt(np.maximum(out, 0))


def _scale_slope(
    fit: Refined,
    lines: Lines,
    points: DrivingPoints | None,
    g: Complex,
    psi: Complex,
    k: int,
) -> tuple[Complex, Complex]:
    """Derivatives of the logarithm of the scale of mode k: by the parameters, and by the residue
    noise (out,).
    """
    noise = np.zeros(psi.size, dtype=np.complex128)
    if points is None:
        return np.zeros(g.shape[1], dtype=np.complex128), noise
    if not points:
        top = int(np.abs(psi).argmax())
        noise[top] = -1 / psi[top]
        return -g[top], noise
    o = points.output
    i = points.input
    part = fit.participation[k, i]
    driven = points.sign * psi[o]
    size = (np.abs(part) ** 2).sum()
    overlap = (part.conj() * driven).sum()
    overlap = overlap if overlap != 0 else size * np.finfo(float).tiny
    share = -0.5 * part.conj() * driven / overlap
    np.add.at(noise, o, share / psi[o])
    common = np.zeros(
        (1 + fit.participation.shape[1], 2, fit.poles.size), dtype=np.complex128
    )
    np.add.at(common[1:, 0, k], i, 0.5 * part.conj() / size / lines.input[i])
    np.add.at(
        common[1:, 1, k], i, 0.5 * (part / size - driven / overlap) / lines.input[i]
    )
    common[0, :, k] = np.array([1, -1]) / (4j * fit.poles[k].imag)
    return common.ravel() + share @ g[o], noise


def _slopes(poles: Complex) -> Float:
    """(2 m, 2 m) derivatives of (frequency, damping) by (Re λ, Im λ)."""
    a = poles.real
    b = poles.imag
    r = np.abs(poles)
    d = np.diag
    frequency = [d(a / r), d(b / r)]
    damping = [d(-(b**2) / r**3 * 2 * np.pi), d(a * b / r**3 * 2 * np.pi)]
    return np.block([frequency, damping]) / (2 * np.pi)
