"""What a model can be compared with a test in: weighted residuals with their sensitivities, in any mix.

Each kind is a frozen value that is called with a `Point` and gives a `Block`. Those of paired modes read the pairs of
the point; FRFs and anti-resonances read its modes; static deflections its matrices; mass properties a 6 x 6 matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Any_, Complex, Float, Int, freeze_fields
from ringtrue.eigen.responses import modal_frf_derivatives
from ringtrue.errors import InputError, NumericalError
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.reduce.parametric import AffineSystem
from ringtrue.shapes.mac import unit
from ringtrue.update.dense import matrices_at
from ringtrue.update.objective import Target, match, shape_residual, spans

NO_MODE = -1
RIGID = 1e-9  # of the largest eigenvalue: below this a mode does not bound a zero of an FRF


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A model at x with its modes and their partners.

    Attributes
    ----------
    model : ObservedModel
    now : Linearisation
    target : Target
    pairs : (k, 2) int64
        Test mode and FE mode of the used pairs.
    spans : tuple (k) of (g,) int64
        The FE modes that stand for each test mode.
    every : (l, 2) int64
        All pairs, those of modes left out too.
    mac : (l,) float64
    """

    model: ObservedModel
    now: Linearisation
    target: Target
    pairs: Int
    spans: tuple[Int, ...]
    every: Int
    mac: Float


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Weighted residuals of one kind.

    Attributes
    ----------
    value : (r,) float64
        (z_test − z_model)/σ.
    slope : (r, p) float64
        ∂z_model/∂x/σ.
    datum : (r,) int64
        Rows of one datum have the same number: a shape is one, however many channels it has.
    mode : (r,) int64
        Test mode of the row, `NO_MODE` where it belongs to none.
    """

    value: Float
    slope: Float
    datum: Int
    mode: Int

    def __post_init__(self) -> None:
        freeze_fields(self, value=np.float64, slope=np.float64, datum=np.int64, mode=np.int64)


class Term(Protocol):
    """A kind of residual."""

    def __call__(self, at: Point) -> Block:
        """Residuals at a point."""
        ...


def point(model: ObservedModel, now: Linearisation, target: Target, held: Int | None = None) -> Point:
    """The modes `now` of the model, paired with the test; test modes in `held` keep a partner below the gate."""
    keep = None if held is None else np.isin(np.arange(target.used.size), held)
    pairs, mac, groups = match(target, now, keep)
    used = pairs[target.used[pairs[:, 0]]]
    return Point(model, now, target, used, spans(target, used, groups), pairs, mac)


def default_terms(target: Target) -> tuple[Term, ...]:
    """Eigenvalues and shapes with the weights of the target: the objective of `update.objective`."""
    w = target.weights
    shapes: tuple[Term, ...] = (Shapes(w.mac, w.shape),) if w.shape > 0 else ()
    return (Eigenvalues(w.frequency), *shapes)


def _rows(value: Float, slope: Float, modes: Int) -> Block:
    """A datum a row."""
    return Block(value, slope, np.arange(value.size), modes)


def _shapes(parts: Sequence[tuple[Float, Float]], at: Point) -> Block:
    """A datum a pair, with many rows."""
    p = at.now.d_lambda.shape[1]
    n = np.array([r.size for r, _ in parts], dtype=np.int64)
    value = np.concatenate([r for r, _ in parts] or [np.zeros(0)])
    slope = np.concatenate([g for _, g in parts] or [np.zeros((0, p))])
    return Block(value, slope, np.repeat(np.arange(n.size), n), np.repeat(at.pairs[:, 0], n))


@dataclass(frozen=True, slots=True)
class Eigenvalues:
    """1 − λ/λ_test of each pair; `std` (relative, of a frequency) is the model discrepancy, the test's own is added."""

    std: float = 0.01

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        t, f = at.pairs.T
        root = 0.5 / np.hypot(self.std, at.target.std[t])  # a relative deviation of λ is twice that of f
        lam_test, lam = (2 * np.pi * at.target.frequencies[t]) ** 2, (2 * np.pi * at.now.frequencies[f]) ** 2
        return _rows(root * (1 - lam / lam_test), root[:, None] * at.now.d_lambda[f] / lam_test[:, None], t)


@dataclass(frozen=True, slots=True)
class Frequencies:
    """1 − f/f_test of each pair, or ln(f_test/f); `std` as in `Eigenvalues`."""

    std: float = 0.01
    scale: Literal["relative", "log"] = "relative"

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        t, j = at.pairs.T
        root = 1 / np.hypot(self.std, at.target.std[t])
        f, f_test = at.now.frequencies[j], at.target.frequencies[t]
        d_f = at.now.d_lambda[j] / (8 * np.pi**2 * f[:, None])
        by = f if self.scale == "log" else f_test
        value = np.log(f_test / f) if self.scale == "log" else 1 - f / f_test
        return _rows(root * value, (root / by)[:, None] * d_f, t)


@dataclass(frozen=True, slots=True)
class Shapes:
    """Differences of shapes, scaled: ψ − Φ(Φ⁺ψ), rotated within close groups; the square sum is 1 − MAC.

    Attributes
    ----------
    mac : float
        1 − MAC that the best model of this form is expected to keep.
    factor : float
        On the whole part.
    scaling : {"fit", "largest"}
        "fit": modal scale factor and rotation by least squares. "largest": both shapes are 1 at the channel where the
        test's is largest, the square sum divided by that of the test's: no rotation.
    """

    mac: float = 0.05
    factor: float = 1.0
    scaling: Literal["fit", "largest"] = "fit"

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        root, rule = np.sqrt(self.factor / self.mac), {"fit": shape_residual, "largest": _at_largest}[self.scaling]
        parts = [rule(at.target, at.now, t, s) for t, s in zip(at.pairs[:, 0].tolist(), _spans(self, at), strict=True)]
        return _shapes([(root * r, root * g) for r, g in parts], at)


def _spans(term: Shapes, at: Point) -> tuple[Int, ...]:
    return at.spans if term.scaling == "fit" else tuple(at.pairs[:, [1]])


def _at_largest(target: Target, now: Linearisation, t: int, group: Int) -> tuple[Float, Float]:
    """ψ/ψ_q − φ/φ_q with q where |ψ| is largest, over ‖ψ/ψ_q‖, and its sensitivity."""
    psi, phi, d_phi = target.shapes[:, t], now.shapes[:, group[0]], now.d_shapes[:, group[0]]
    q = int(np.argmax(np.abs(psi)))
    if phi[q] == 0.0:
        raise NumericalError(f"test mode {t + 1}: the FE shape is zero at channel {q + 1}, which scales it")
    size = float(np.linalg.norm(psi / psi[q]))
    return (psi / psi[q] - phi / phi[q]) / size, (d_phi - np.outer(phi / phi[q], d_phi[q])) / (phi[q] * size)


@dataclass(frozen=True, slots=True)
class Mac:
    """MAC of each pair, of the subspace where modes are close.

    Attributes
    ----------
    std : float
        Of the residual.
    form : {"difference", "ratio"}
        1 − MAC, or (1 − √MAC)/√MAC (Moaveni et al., 2013), which keeps its slope near 1 and grows as MAC goes to 0.
    """

    std: float = 0.05
    form: Literal["difference", "ratio"] = "difference"

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        t = at.pairs[:, 0]
        value, slope = np.zeros(t.size), np.zeros((t.size, at.now.d_lambda.shape[1]))
        for i, (k, span) in enumerate(zip(t.tolist(), at.spans, strict=True)):  # each pair has its own subspace
            rest, d_inside = shape_residual(at.target, at.now, k, span)
            value[i], slope[i] = rest @ rest, unit(at.target.shapes[:, [k]])[:, 0] @ d_inside
        if self.form == "ratio":
            # 1 − √m = (1 − m)/(1 + √m) keeps its digits where m is nearly 1
            root = np.sqrt(np.maximum(1 - value, 1e-12))
            slope = slope / (2 * root**3)[:, None]
            value = value / (1 + root) / root
        return _rows(value / self.std, slope / self.std, t)


@dataclass(frozen=True, slots=True, eq=False)
class CrossOrthogonality:
    """Terms of ψᵀMφ of all pairs against the identity, both sets scaled to unit modal mass.

    Attributes
    ----------
    mass : (channel, channel) float64
        Of a test-analysis model.
    std : float
        Of one term.
    diagonal, off_diagonal : bool
        Which terms are held to 1 and to 0.
    """

    mass: Float
    std: float = 0.05
    diagonal: bool = True
    off_diagonal: bool = True

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        t, f = at.pairs.T
        psi, phi, d_phi = at.target.shapes[:, t], at.now.shapes[:, f], at.now.d_shapes[:, f]
        heavy = self.mass @ phi
        size = np.sqrt(np.einsum("cm,cm->m", phi, heavy))
        d_size = np.einsum("cm,cmp->mp", heavy, d_phi) / size[:, None]
        left = (psi / np.sqrt(np.einsum("cm,cm->m", psi, self.mass @ psi))).T @ self.mass
        turn = np.sign(np.diag(left @ phi)) / size  # shapes have no sign
        terms = left @ phi * turn
        d_terms = np.einsum("tc,cmp->tmp", left, d_phi) * turn[:, None] - terms[:, :, None] * (d_size / size[:, None])
        same = np.eye(t.size, dtype=np.bool_)
        keep = (same & self.diagonal) | (~same & self.off_diagonal)
        rows = np.broadcast_to(t[:, None], keep.shape)[keep]
        return _rows((same - terms)[keep] / self.std, d_terms[keep] / self.std, rows)


def _modal(at: Point, outputs: Int, inputs: Int) -> tuple[Float, Float, Float, Float, Float]:
    """λ (m,), φ and ∂φ/∂x at outputs and inputs."""
    lam, phi, d = (2 * np.pi * at.now.frequencies) ** 2, at.now.shapes, at.now.d_shapes
    return lam, phi[outputs], phi[inputs], d[outputs], d[inputs]


@dataclass(frozen=True, slots=True, eq=False)
class Frf:
    """Frequency response functions at chosen lines, by superposition of the model's modes.

    Attributes
    ----------
    freqs : (q,) float64, Hz
        Chosen lines.
    measured : (q, o, i) complex128
        Receptance, mobility or accelerance, as `order` says.
    outputs, inputs : (o,), (i,) int64
        Channels; an input acts along its channel.
    damping : float or (m,) float64
        Ratio of all modes or of each.
    order : {0, 1, 2}
        Of differentiation: 0 receptance, 1 mobility, 2 accelerance.
    form : {"log", "complex"}
        ln|H|, or H over the root mean square of the measured one, real and imaginary parts.
    std : float
        Of one value: of ln|H|, or of the scaled parts.
    """

    freqs: Float
    measured: Complex
    outputs: Int
    inputs: Int
    damping: float | Float = 0.01
    order: int = 2
    form: Literal["log", "complex"] = "log"
    std: float = 0.2

    def __post_init__(self) -> None:
        freeze_fields(self, freqs=np.float64, measured=np.complex128, outputs=np.int64, inputs=np.int64)
        shape = (self.freqs.size, self.outputs.size, self.inputs.size)
        if self.measured.shape != shape or self.order not in (0, 1, 2) or self.form not in ("log", "complex"):
            raise InputError(
                f"FRFs {self.measured.shape} for (line, output, input) = {shape}; "
                f"order {self.order} (0, 1, 2), form {self.form!r} (log, complex)"
            )

    def response(self, at: Point) -> tuple[Complex, Complex]:
        """H (q, o, i) of the model and ∂H/∂x (q, o, i, p)."""
        lam, out, into, d_out, d_in = _modal(at, self.outputs, self.inputs)
        zeta = np.broadcast_to(np.asarray(self.damping, dtype=np.float64), lam.shape)
        w = 2 * np.pi * self.freqs[:, None]
        g = 1 / (lam - w**2 + 2j * zeta * np.sqrt(lam) * w)
        h = np.einsum("qm,om,im->qoi", g, out, into, optimize=True)
        d_h = modal_frf_derivatives(self.freqs, lam, zeta, out, into, at.now.d_lambda, d_out, d_in)
        by = (1j * w[:, :, None]) ** self.order
        return h * by, d_h * by[..., None]

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        h, d_h = self.response(at)
        d_h = d_h.reshape(h.size, -1)
        if self.form == "log":
            value, slope = np.log(np.abs(self.measured / h)).ravel(), (d_h / h.reshape(-1, 1)).real
            return _rows(value / self.std, slope / self.std, np.full(h.size, NO_MODE))
        scale = self.std * float(np.sqrt(np.mean(np.abs(self.measured) ** 2)))
        rest = (self.measured - h).ravel() / scale
        value = np.concatenate([rest.real, rest.imag])
        slope = np.concatenate([d_h.real, d_h.imag]) / scale
        return Block(value, slope, np.tile(np.arange(h.size), 2), np.full(value.size, NO_MODE))


@dataclass(frozen=True, slots=True, eq=False)
class AntiResonances:
    """1 − f/f_test of the zeros of one FRF, paired by frequency.

    The zeros are those of the superposed modes: give the model modes well above the highest. A zero of a transfer FRF
    may be complex; it then has no partner here.

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

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        mu, d_mu = zeros(at.now, self.output, self.input)
        f, f_test = np.sqrt(mu) / (2 * np.pi), np.asarray(self.frequencies, dtype=np.float64)
        value, slope = np.full(f_test.size, self.gate), np.zeros((f_test.size, d_mu.shape[1]))
        away = np.minimum(np.abs(f[None, :] / f_test[:, None] - 1), self.gate)
        i, j = linear_sum_assignment(away)
        i, j = i[away[i, j] < self.gate], j[away[i, j] < self.gate]
        value[i] = 1 - f[j] / f_test[i]
        slope[i] = d_mu[j] / (8 * np.pi**2 * f[j] * f_test[i])[:, None]
        return _rows(value / self.std, slope / self.std, np.full(f_test.size, NO_MODE))


def zeros(now: Linearisation, output: int, into: int) -> tuple[Float, Float]:
    """Real positive zeros μ (z,), (rad/s)², ascending, of Σ φ_o φ_i/(λ − μ), and ∂μ/∂x (z, p).

    The zeros are the finite eigenvalues of [Λ φ_i; φ_oᵀ 0] against diag(I, 0); the sensitivities follow from the sum
    by implicit differentiation. He and Fu (2001), Modal Analysis, ch. 4.
    """
    lam = (2 * np.pi * now.frequencies) ** 2
    a, b = now.shapes[output], now.shapes[into]
    scale = lam.max()
    pencil = np.block([[np.diag(lam / scale), b[:, None]], [a[None], np.zeros((1, 1))]])
    mass = np.diag([*np.ones(lam.size), 0.0])
    top, bottom = linalg.eig(pencil, mass, right=False, homogeneous_eigvals=True)
    finite = np.abs(bottom) > 1e-10 * np.abs(top)
    mu = top[finite] / bottom[finite] * scale
    real = (np.abs(mu.imag) < 1e-9 * np.abs(mu)) & (mu.real > RIGID * scale)
    mu = np.sort(mu.real[real])
    gap = lam - mu[:, None]
    mu = mu[np.abs(gap).min(axis=1, initial=np.inf) > 1e-12 * scale]  # a mode that does not take part
    gap = lam - mu[:, None]
    square = (a * b) / gap**2
    d_ab = a[:, None] * now.d_shapes[into] + b[:, None] * now.d_shapes[output]
    return mu, (square @ now.d_lambda - (1 / gap) @ d_ab) / square.sum(axis=1)[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class StaticDeflections:
    """Deflections at channels under static loads at channels, by load case.

    On a reduced basis they are as good as its static content at the loaded channels.

    Attributes
    ----------
    loads : (channel, l) float64, force along each channel
    measured : (channel, l) float64
        NaN where not measured.
    std : float
        Relative to the root mean square of the case.
    """

    loads: Float
    measured: Float
    std: float = 0.02

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        m = matrices_at(at.model, at.now.x)
        p = at.now.d_lambda.shape[1]
        u = linalg.solve(m.stiffness, m.observe.T @ self.loads, assume_a="sym")
        d_u = np.zeros((u.shape[0], u.shape[1], p))
        if p:
            load = np.einsum("pij,jl->ilp", m.d_stiffness, u)
            d_u = -linalg.solve(m.stiffness, load.reshape(u.shape[0], -1), assume_a="sym").reshape(load.shape)
        scale = self.std * np.sqrt(np.nanmean(np.square(self.measured), axis=0))
        value, slope = (self.measured - m.observe @ u) / scale, np.tensordot(m.observe, d_u, 1) / scale[:, None]
        seen = np.isfinite(self.measured)
        return _rows(value[seen], slope[seen], np.full(int(seen.sum()), NO_MODE))


@dataclass(frozen=True, slots=True, eq=False)
class MassProperties:
    """Mass, centre of gravity and inertia of the model against a weighing.

    Attributes
    ----------
    rigid : RigidMass
    measured : (10,) float64
        Mass; x, y, z of the centre of gravity; Ixx, Iyy, Izz, Ixy, Iyz, Izx about it (tensor components); NaN where
        not measured.
    std : (10,) float64
        In the same units.
    """

    rigid: RigidMass
    measured: Float
    std: Float

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        p = at.now.d_lambda.shape[1]
        m6, d_m6 = self.rigid.at(at.now.x)
        value, slope = mass_properties(m6), np.zeros((10, p))
        for i in range(p):  # over parameters: complex step through a rational function of ten numbers
            slope[:, i] = mass_properties(m6 + 1e-40j * d_m6[i]).imag / 1e-40
        seen = np.isfinite(self.measured)
        rest = ((np.asarray(self.measured) - value) / self.std)[seen]
        return _rows(rest, (slope / np.asarray(self.std)[:, None])[seen], np.full(rest.size, NO_MODE))


@dataclass(frozen=True, slots=True, eq=False)
class RigidMass:
    """The rigid-body mass matrix about the origin as it depends on the parameters.

    Attributes
    ----------
    system : AffineSystem
    vectors : (f, 6) float64
        Unit translations along and rotations about the axes of the origin.
    active : tuple of int
        The parameters that x stands for; empty: all.
    """

    system: AffineSystem
    vectors: Float
    active: tuple[int, ...] = ()

    def at(self, x: Float) -> tuple[Float, Float]:
        """The matrix (6, 6) at x (p,) and its derivatives (p, 6, 6)."""
        r, parameters = self.vectors, self.system.parameters
        at = list(self.active or range(len(parameters)))
        everything = np.zeros(len(parameters))
        everything[at] = x
        a, slope = parameters.factors(everything), parameters.slope(everything)
        m, d_m = r.T @ (self.system.mass @ r), np.zeros((a.size, 6, 6))
        for i, terms in enumerate(self.system.terms):  # over parameters and their powers
            for t in terms:
                part = r.T @ (t.mass @ r)
                m = m + (a[i] ** t.power - 1.0) * part
                d_m[i] += t.power * a[i] ** (t.power - 1) * slope[i] * part
        return np.asarray(m), d_m[at]


def mass_properties(m6: Any_) -> Any_:
    """Mass, centre of gravity and inertia about it (10,), as in `MassProperties`, from a rigid-body mass (6, 6)."""
    mass = (m6[0, 0] + m6[1, 1] + m6[2, 2]) / 3
    x, y, z = m6[1, 5] / mass, m6[2, 3] / mass, m6[0, 4] / mass
    i = m6[3:, 3:]
    about = [i[0, 0] - mass * (y * y + z * z), i[1, 1] - mass * (x * x + z * z), i[2, 2] - mass * (x * x + y * y)]
    mixed = [i[0, 1] + mass * x * y, i[1, 2] + mass * y * z, i[2, 0] + mass * z * x]
    return np.array([mass, x, y, z, *about, *mixed])
