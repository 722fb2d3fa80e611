"""Weighted residuals of paired modes with their sensitivities, and what all kinds share.

Each kind is a frozen value that is called with a `Point` and gives a `ResidualBlock`. Kinds of
other data have their own modules: `frf` reads all modes of the point, `static` its matrices and a
rigid-body mass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import ClassVar, Literal, Self

import numpy as np

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.errors import NumericalError
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.updating.target import Span, Target, match, span_residuals

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
class ResidualBlock(FrozenArrays):
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


class Quantity(Enum):
    """What a kind of residuals compares."""

    FREQUENCY = 0
    SHAPE = 1
    OTHER = 2


class Term:
    """A kind of residuals: what it reads at a point, how it is weighed and what it compares.

    Attributes
    ----------
    quantity : Quantity
    called : str
        In messages.
    whole : bool
        True: it reads all modes and channels of the model, not the test's alone.
    """

    __slots__ = ()
    quantity: ClassVar[Quantity] = Quantity.OTHER
    called: ClassVar[str] = "data besides the modes"
    whole: ClassVar[bool] = False

    def __call__(self, at: Point) -> ResidualBlock:
        """Residuals at a point."""
        raise NotImplementedError

    def fit(self, at: Point) -> Float:
        """Squared deviation of each datum (n,) over the square of its stated error."""
        block = self(at)
        return np.asarray(np.bincount(block.datum, block.value**2))

    @property
    def expected(self) -> float:
        """Deviation that the best model is expected to keep: of a frequency (relative) or of
        1 − MAC; NaN where the kind has none.
        """
        return float("nan")

    @property
    def weight(self) -> float:
        """Number of data that a row counts."""
        return 1.0

    def unit(self, std: Float) -> float | None:
        """The residual of a unit deviation, of a frequency (relative) or of √(1 − MAC); None
        where it is not a multiple of these. `std` (m,) are the test's own, of the frequencies.
        """
        return None

    @property
    def highest(self) -> float:
        """Highest frequency, Hz, at which it reads the model besides its modes; 0 for none."""
        return 0.0

    def broadened(self, width: float) -> Term:
        """The kind with its peaks broadened by `width` times their frequency; itself where it has
        none.
        """
        return self

    def reweighed(self, frequency: float, mac: float, independent: float) -> Term:
        """The kind with other model discrepancies of a frequency (relative) and of 1 − MAC.

        `independent` is the number of independent errors in a shape.
        """
        return self

    def widened(self, by: float) -> Term:
        """The kind with standard deviations `by` times as large."""
        raise NotImplementedError


class Deviations(Term):
    """Kinds of residuals with one field of standard deviations, `std`."""

    __slots__ = ()

    def widened(self, by: float) -> Self:
        """With standard deviations `by` times as large."""
        return replace(self, std=by * self.std)  # type: ignore[attr-defined,type-var]


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
        m = self.modes
        shapes = all_.shapes[self.rows]
        d_shapes = all_.d_shapes[self.rows]
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
    stand = tuple(of[i] for i in used)
    return Point(
        model=model,
        now=now,
        target=target,
        pairs=pairs[used],
        spans=stand,
        every=pairs,
        mac=mac,
        whole=now if whole is None else whole,
    )


def default_terms(target: Target) -> tuple[Term, ...]:
    """Eigenvalues and shapes with the weights of the target."""
    w = target.weights
    frequencies = Eigenvalues(w.frequency)
    if not w.shape:
        return (frequencies,)
    return frequencies, Shapes(w.mac, w.shape * w.independent)


@dataclass(frozen=True, slots=True, eq=False)
class Weighted(Term):
    """A kind of residuals times a factor on its squares."""

    term: Term
    factor: float

    @property
    def whole(self) -> bool:  # type: ignore[override]
        """Whether it reads all modes and channels of the model."""
        return self.term.whole

    @property
    def weight(self) -> float:
        """The factor."""
        return self.factor

    @property
    def highest(self) -> float:
        """See `Term`."""
        return self.term.highest

    def broadened(self, width: float) -> Weighted:
        """See `Term`."""
        return replace(self, term=self.term.broadened(width))

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        block = self.term(at)
        root = np.sqrt(self.factor)
        return replace(block, value=root * block.value, slope=root * block.slope)

    def fit(self, at: Point) -> Float:
        """See `Term`: by the error that was stated, whatever the factor."""
        return self.term.fit(at)

    def widened(self, by: float) -> Weighted:
        """See `Term`."""
        return replace(self, factor=self.factor / by**2)


def rows_block(value: Float, slope: Float, modes: Int) -> ResidualBlock:
    """A block of which each row is a datum: values (r,), slopes (r, p), test modes (r,)."""
    return ResidualBlock(value, slope, np.arange(value.size), modes)


class _FrequencyDeviations(Deviations):
    """`std` (relative) is the model discrepancy of a frequency; the test's own is added."""

    __slots__ = ()
    quantity = Quantity.FREQUENCY
    called = "frequencies"
    std: float

    @property
    def expected(self) -> float:
        """See `Term`."""
        return self.std

    def unit(self, std: Float) -> float | None:
        """See `Term`."""
        return float((self.std**2 + np.mean(std**2)) ** -0.5)

    def reweighed(self, frequency: float, mac: float, independent: float) -> Self:
        """See `Term`."""
        return replace(self, std=frequency)  # type: ignore[type-var]


@dataclass(frozen=True, slots=True)
class Eigenvalues(_FrequencyDeviations):
    """1 − λ/λ_test of each pair."""

    std: float = 0.01

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        t, f = at.pairs.T
        # a relative deviation of λ is twice that of f
        root = 0.5 / np.hypot(self.std, at.target.std[t])
        lam_test = (2 * np.pi * at.target.frequencies[t]) ** 2
        lam = (2 * np.pi * at.now.frequencies[f]) ** 2
        value = root * (1 - lam / lam_test)
        slope = (root / lam_test)[:, None] * at.now.d_lambda[f]
        return rows_block(value, slope, t)


@dataclass(frozen=True, slots=True)
class Frequencies(_FrequencyDeviations):
    """1 − f/f_test of each pair, or ln(f_test/f)."""

    std: float = 0.01
    scale: Literal["relative", "log"] = "relative"

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        t, j = at.pairs.T
        root = 1 / np.hypot(self.std, at.target.std[t])
        f = at.now.frequencies[j]
        f_test = at.target.frequencies[t]
        d_f = at.now.d_lambda[j] / (8 * np.pi**2 * f[:, None])
        if self.scale == "log":
            return rows_block(root * np.log(f_test / f), (root / f)[:, None] * d_f, t)
        return rows_block(root * (1 - f / f_test), (root / f_test)[:, None] * d_f, t)


@dataclass(frozen=True, slots=True)
class Shapes(Term):
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
    quantity = Quantity.SHAPE
    called = "shapes"

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        shapes = at.target.shapes
        if self.scaling == "fit":
            rest, slopes = span_residuals(shapes, at.now, at.pairs, at.spans)
        else:
            rest, slopes = _at_largest(shapes, at.now, at.pairs)
        # a datum a pair, with a row a channel
        root = np.sqrt(self.factor / self.mac)
        channels, count = rest.shape
        return ResidualBlock(
            root * rest.T.ravel(),
            root * slopes.swapaxes(0, 1).reshape(rest.size, slopes.shape[2]),
            np.repeat(np.arange(count), channels),
            np.repeat(at.pairs[:, 0], channels),
        )

    def fit(self, at: Point) -> Float:
        """See `Term`: (1 − MAC) over that expected, whatever the factor."""
        return Term.fit(self, at) / self.factor

    @property
    def expected(self) -> float:
        """See `Term`."""
        return self.mac

    def unit(self, std: Float) -> float | None:
        """See `Term`."""
        return float(np.sqrt(self.factor / self.mac))

    def reweighed(self, frequency: float, mac: float, independent: float) -> Shapes:
        """See `Term`."""
        return replace(self, mac=mac, factor=independent * self.factor)

    def widened(self, by: float) -> Shapes:
        """See `Term`."""
        return replace(self, mac=by**2 * self.mac)


def _at_largest(shapes: Float, now: Linearisation, pairs: Int) -> tuple[Float, Float]:
    """ψ/ψ_q − φ/φ_q with q where |ψ| is largest, over ‖ψ/ψ_q‖, and its sensitivity, of all pairs:
    (channel, k) and (channel, k, p).
    """
    t, f = pairs.T
    psi = shapes[:, t]
    each = np.arange(t.size)
    q = np.abs(psi).argmax(axis=0)
    there = now.shapes[q, f]
    for k in np.flatnonzero(there == 0.0).tolist():
        raise NumericalError(
            f"test mode {t[k] + 1}: the FE shape is zero at channel {q[k] + 1}, which scales it"
        )
    psi = psi / psi[q, each]
    phi = now.shapes[:, f] / there
    d_phi = now.d_shapes[:, f]
    size = np.linalg.norm(psi, axis=0)
    slope = (d_phi - phi[:, :, None] * d_phi[q, each]) / (there * size)[:, None]
    return (psi - phi) / size, slope


@dataclass(frozen=True, slots=True)
class Mac(Deviations):
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
    quantity = Quantity.SHAPE
    called = "shapes"

    @property
    def expected(self) -> float:
        """See `Term`."""
        return self.std

    def reweighed(self, frequency: float, mac: float, independent: float) -> Mac:
        """See `Term`."""
        return replace(self, std=mac)

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        rest, d_inside = span_residuals(at.target.shapes, at.now, at.pairs, at.spans)
        value = (rest**2).sum(axis=0)
        slope = 2 * np.einsum("ck,ckp->kp", rest, d_inside)
        if self.form == "ratio":
            # 1 − √m = (1 − m)/(1 + √m) keeps its digits where m is nearly 1
            root = np.sqrt(np.maximum(1 - value, 1e-12))
            slope = slope / (2 * root**3)[:, None]
            value = value / (1 + root) / root
        return rows_block(value / self.std, slope / self.std, at.pairs[:, 0])


@dataclass(frozen=True, slots=True)
class ModalMasses(Deviations):
    """ln of the modal mass of each pair, test over model, at the scale of the test's shape.

    A test shape of unit modal mass is s times the model's. It was scaled by the response of a
    driving point, which separates mass from stiffness where frequencies give their ratio alone.
    Modes that are close to others are left out: a rotation among them is free. Ewins (2000), Modal
    Testing, sec. 2.4.

    Attributes
    ----------
    std : float
        Of a modal mass, relative.
    kilograms : float
        Of the deck's unit of mass.
    """

    std: float = 0.1
    kilograms: float = 1.0
    called = "modal masses"

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        alone = np.array([s.size == 1 for s in at.spans], dtype=np.bool_)
        t, j = at.pairs[alone].T
        psi = at.target.shapes[:, t] * np.sqrt(self.kilograms)
        phi = at.now.shapes[:, j]
        d_phi = at.now.d_shapes[:, j]
        along = np.sum(phi * psi, axis=0)
        size = np.sum(phi**2, axis=0)
        if not along.all() or not size.all():
            raise NumericalError(
                "a test shape is orthogonal to its partner: it has no scale there"
            )
        value = -2 * np.log(np.abs(along) / size)
        first = np.einsum("cmp,cm->mp", d_phi, psi) / along[:, None]
        second = 2 * np.einsum("cmp,cm->mp", d_phi, phi) / size[:, None]
        return rows_block(value / self.std, 2 * (first - second) / self.std, t)
