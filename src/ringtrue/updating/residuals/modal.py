"""What a model can be compared with a test in: weighted residuals with their sensitivities, in any
mix.

Each kind is a frozen value that is called with a `Point` and gives a `Block`. Those here read the
paired modes of the point; `residuals_frf` its modes, `residuals_static` its matrices and a
rigid-body mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import NumericalError
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.updating.target import Span, Target, match, span_residual

NO_MODE = -1


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
    spans : tuple (k) of Span
        The FE modes that stand for each test mode.
    every : (l, 2) int64
        All pairs, those of modes left out too.
    mac : (l,) float64
    whole : Linearisation
        All modes at all channels that the model can give: more than the test's modes are compared
        with.
    """

    model: ObservedModel
    now: Linearisation
    target: Target
    pairs: Int
    spans: tuple[Span, ...]
    every: Int
    mac: Float
    whole: Linearisation


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
    """A kind of residual; one with `whole = True` reads all modes and channels of the model, not
    the test's alone.
    """

    def __call__(self, at: Point) -> Block:
        """Residuals at a point."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Whole:
    """All modes and channels of a model, and those that the test's modes are compared with.

    Attributes
    ----------
    model : ObservedModel
    rows : (channel,) int64
    modes : int
        The lowest.
    """

    model: ObservedModel
    rows: Int
    modes: int

    def part(self, all_: Linearisation) -> Linearisation:
        """The modes and channels of the test."""
        m, shapes, d_shapes = self.modes, all_.shapes[self.rows], all_.d_shapes[self.rows]
        return replace(
            all_,
            frequencies=all_.frequencies[:m],
            shapes=shapes[:, :m],
            d_lambda=all_.d_lambda[:m],
            d_shapes=d_shapes[:, :m],
        )


def point(
    model: ObservedModel,
    now: Linearisation,
    target: Target,
    held: Int | None = None,
    whole: Linearisation | None = None,
) -> Point:
    """The modes `now` of the model, paired with the test; test modes in `held` keep a partner below
    the gate.
    """
    keep = None if held is None else np.isin(np.arange(target.used.size), held)
    pairs, mac, of = match(target, now, keep)
    used = np.flatnonzero(target.used[pairs[:, 0]])
    stand = tuple(of[i] for i in used.tolist())
    return Point(
        model, now, target, pairs[used], stand, pairs, mac, now if whole is None else whole
    )


def default_terms(target: Target) -> tuple[Term, ...]:
    """Eigenvalues and shapes with the weights of the target: the objective of
    `updating.gauss_newton`.
    """
    w = target.weights
    shapes: tuple[Term, ...] = (Shapes(w.mac, w.shape),) if w.shape > 0 else ()
    return (Eigenvalues(w.frequency), *shapes)


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """A kind of residuals times a factor on its squares."""

    term: Term
    factor: float

    @property
    def whole(self) -> bool:
        """Whether it reads all modes and channels of the model."""
        return bool(getattr(self.term, "whole", False))

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        block, root = self.term(at), np.sqrt(self.factor)
        return replace(block, value=root * block.value, slope=root * block.slope)


def rows_block(value: Float, slope: Float, modes: Int) -> Block:
    """A block of which each row is a datum: values (r,), slopes (r, p), test modes (r,)."""
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
    """1 − λ/λ_test of each pair; `std` (relative, of a frequency) is the model discrepancy, the
    test's own is added.
    """

    std: float = 0.01

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        t, f = at.pairs.T
        root = 0.5 / np.hypot(
            self.std, at.target.std[t]
        )  # a relative deviation of λ is twice that of f
        lam_test, lam = (
            (2 * np.pi * at.target.frequencies[t]) ** 2,
            (2 * np.pi * at.now.frequencies[f]) ** 2,
        )
        return rows_block(
            root * (1 - lam / lam_test), root[:, None] * at.now.d_lambda[f] / lam_test[:, None], t
        )


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
        return rows_block(root * value, (root / by)[:, None] * d_f, t)


OF_FREQUENCY = (Eigenvalues, Frequencies)  # whose `std` is the model discrepancy of a frequency


@dataclass(frozen=True, slots=True)
class Shapes:
    """Differences of shapes, scaled: ψ − Φ(Φ⁺ψ), rotated within close groups; the square sum is 1 −
    MAC.

    Attributes
    ----------
    mac : float
        1 − MAC that the best model of this form is expected to keep.
    factor : float
        On the whole part.
    scaling : {"fit", "largest"}
        "fit": modal scale factor and rotation by least squares. "largest": both shapes are 1 at the
        channel where the test's is largest, the square sum divided by that of the test's: no
        rotation.
    """

    mac: float = 0.05
    factor: float = 1.0
    scaling: Literal["fit", "largest"] = "fit"

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        root, shapes = np.sqrt(self.factor / self.mac), at.target.shapes
        if self.scaling == "fit":
            parts = [
                span_residual(shapes, at.now, t, s)
                for t, s in zip(at.pairs[:, 0].tolist(), at.spans, strict=True)
            ]
        else:
            parts = [_at_largest(shapes, at.now, t, f) for t, f in at.pairs.tolist()]
        return _shapes([(root * r, root * g) for r, g in parts], at)


def _at_largest(shapes: Float, now: Linearisation, t: int, f: int) -> tuple[Float, Float]:
    """ψ/ψ_q − φ/φ_q with q where |ψ| is largest, over ‖ψ/ψ_q‖, and its sensitivity."""
    psi, phi, d_phi = shapes[:, t], now.shapes[:, f], now.d_shapes[:, f]
    q = int(np.argmax(np.abs(psi)))
    if phi[q] == 0.0:
        raise NumericalError(
            f"test mode {t + 1}: the FE shape is zero at channel {q + 1}, which scales it"
        )
    size = float(np.linalg.norm(psi / psi[q]))
    return (psi / psi[q] - phi / phi[q]) / size, (d_phi - np.outer(phi / phi[q], d_phi[q])) / (
        phi[q] * size
    )


@dataclass(frozen=True, slots=True)
class Mac:
    """MAC of each pair, of the subspace where modes are close.

    Attributes
    ----------
    std : float
        Of the residual.
    form : {"difference", "ratio"}
        1 − MAC, or (1 − √MAC)/√MAC (Moaveni et al., 2013), which keeps its slope near 1 and grows
        as MAC goes to 0.
    """

    std: float = 0.05
    form: Literal["difference", "ratio"] = "difference"

    def __call__(self, at: Point) -> Block:
        """See `Term`."""
        t = at.pairs[:, 0]
        value, slope = np.zeros(t.size), np.zeros((t.size, at.now.d_lambda.shape[1]))
        for i, (k, span) in enumerate(
            zip(t.tolist(), at.spans, strict=True)
        ):  # each pair has its own space
            rest, d_inside = span_residual(at.target.shapes, at.now, k, span)
            value[i], slope[i] = rest @ rest, 2 * rest @ d_inside
        if self.form == "ratio":
            # 1 − √m = (1 − m)/(1 + √m) keeps its digits where m is nearly 1
            root = np.sqrt(np.maximum(1 - value, 1e-12))
            slope = slope / (2 * root**3)[:, None]
            value = value / (1 + root) / root
        return rows_block(value / self.std, slope / self.std, t)


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
        d_terms = np.einsum("tc,cmp->tmp", left, d_phi) * turn[:, None] - terms[:, :, None] * (
            d_size / size[:, None]
        )
        same = np.eye(t.size, dtype=np.bool_)
        keep = (same & self.diagonal) | (~same & self.off_diagonal)
        rows = np.broadcast_to(t[:, None], keep.shape)[keep]
        return rows_block((same - terms)[keep] / self.std, d_terms[keep] / self.std, rows)


def reweighed(
    terms: Sequence[Term], frequency: float, mac: float, independent: float = 1.0
) -> tuple[Term, ...]:
    """The kinds with other model discrepancies of a frequency (relative) and of 1 − MAC; the rest
    as it is.

    `independent` is the number of independent errors in a shape.
    """
    out: list[Term] = []
    for t in terms:
        if isinstance(t, OF_FREQUENCY):
            out.append(replace(t, std=frequency))
        elif isinstance(t, Shapes):
            out.append(replace(t, mac=mac, factor=independent * t.factor))
        else:
            out.append(replace(t, std=mac) if isinstance(t, Mac) else t)
    return tuple(out)


def widened(term: Term, by: float) -> Term:
    """A kind of residuals with standard deviations `by` times as large."""
    if isinstance(term, (*OF_FREQUENCY, Mac, CrossOrthogonality)):
        return replace(term, std=by * term.std)
    if isinstance(term, Shapes):
        return replace(term, mac=by**2 * term.mac)
    return (
        replace(term, factor=term.factor / by**2)
        if isinstance(term, Weighted)
        else Weighted(term, by**-2)
    )
