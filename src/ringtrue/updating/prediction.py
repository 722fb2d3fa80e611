"""Harmonic response on the small matrices of a model, with damping as it was found or is drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Any_, Bool, Complex, Float, FrozenArrays, freeze_arrays
from ringtrue.core.iterate import Progress, quiet
from ringtrue.errors import ConfigError, InputError, did_you_mean
from ringtrue.model.ports import ObservedModel
from ringtrue.reduction.dense_models import matrices_at
from ringtrue.updating.uncertainty import covariance_root

Ratios = Callable[[Float, Float], Float]  # λ (m,), M-orthonormal y (r, m) -> ζ (m,)
MASSLESS = 1e-14  # of the largest 1/λ
PLANE = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}  # right-handed about the axis


@dataclass(frozen=True, slots=True, eq=False)
class Damping:
    """Damping ratio over frequency, as a table, with its uncertainty.

    Attributes
    ----------
    frequencies, ratios : (k,) float64
        Hz and fraction of critical; constant beyond the ends.
    std : float
        Standard deviation of ln ζ, common to all modes of a draw.
    """

    frequencies: Float
    ratios: Float
    std: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self)
        rising = self.frequencies.size > 0 and (np.diff(self.frequencies) > 0).all()
        if not rising or (self.ratios < 0).any():
            raise InputError(
                f"damping: {self.frequencies.shape} rising frequencies, {self.ratios.shape} "
                "ratios >= 0"
            )

    def at(self, frequencies: Float) -> Float:
        """ζ at frequencies in Hz, interpolated."""
        return np.interp(frequencies, self.frequencies, self.ratios)

    def drawn(self, rng: np.random.Generator | None) -> Ratios:
        """ζ of modes at the best point, or as drawn."""
        factor = 1.0 if rng is None else float(np.exp(self.std * rng.standard_normal()))
        return lambda lam, y: factor * self.at(np.sqrt(lam) / (2 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class RegionDamping(FrozenArrays):
    """Loss factors and dashpots of regions in the basis of a model's small matrices.

    Attributes
    ----------
    coefficients : (k,) float64
    covariance : (k, k) float64
    matrices : (k, r, r) float64
        What a unit of each coefficient adds to the damping matrix (dashpots) or to the imaginary
        stiffness.
    viscous : (k,) bool
        True for dashpots.
    base : (r, r), (r, r) float64
        Known damping matrix and imaginary stiffness in addition.
    scatter : float
        Standard deviation of ln ζ that each mode has of its own.
    """

    coefficients: Float
    covariance: Float
    matrices: Float
    viscous: Bool
    base: tuple[Float, Float]
    scatter: float = 0.0

    def drawn(self, rng: np.random.Generator | None) -> Ratios:
        """ζ of modes at the best point, or with coefficients and scatter as drawn; none is below
        0.
        """
        c = self.coefficients
        own = np.ones(self.base[0].shape[0])
        if rng is not None:
            c = np.maximum(
                c + covariance_root(self.covariance) @ rng.standard_normal(c.size), 0.0
            )
            own = np.exp(self.scatter * rng.standard_normal(own.size))
        d = self.base[0] + np.tensordot(c * self.viscous, self.matrices, axes=1)
        h = self.base[1] + np.tensordot(c * ~self.viscous, self.matrices, axes=1)

        def ratios(lam: Float, y: Float) -> Float:
            w = np.sqrt(np.maximum(lam, MASSLESS * float(lam.max(initial=1.0))))
            viscous, structural = (np.einsum("rm,rm->m", y, a @ y) for a in (d, h))
            return np.asarray(
                own[: w.size] * (viscous / (2 * w) + structural / (2 * w**2))
            )

        return ratios


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What is looked at, in the basis of the model's small matrices; it may change with the
    parameters.

    Attributes
    ----------
    nominal : (n, r) float64
    slopes : tuple of (position of the parameter, (n, r) float64)
        rows = nominal + Σ (a_i − 1) slope_i: the force in a spring grows with its stiffness.
    """

    nominal: Float
    slopes: tuple[tuple[int, Float], ...] = field(default=())

    def at(self, factors: Float) -> Float:
        """(n, r) at factors (p,) of the parameters."""
        out = self.nominal
        for i, slope in self.slopes:
            out = out + (factors[i] - 1) * slope
        return out


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicLoad:
    """Loads that turn with e^{+iωt}.

    Attributes
    ----------
    freqs : (l,) float64, Hz
    vectors : (r, j) float64
        Unit loads in the basis of the model.
    amplitude : (l, j) complex128
    """

    freqs: Float
    vectors: Float
    amplitude: Complex


def harmonic(
    model: ObservedModel,
    x: Float,
    load: HarmonicLoad,
    rows: Rows,
    ratios: Ratios,
    *,
    scatter: Float | None = None,
) -> Complex:
    """Responses (l, n) to harmonic loads, by superposition of all modes of the model's small
    matrices.

    Parameters
    ----------
    model : ObservedModel
        With small matrices (`matrices_at`); static answers to the loads should be in its basis.
    x : (p,) float64
    load : HarmonicLoad
    rows : Rows
    ratios : callable
        Damping ratios of the modes.
    scatter : (r,) float64, optional
        Relative error of each frequency.
    """
    small = matrices_at(model, x)
    lam, y = _all_modes(small.stiffness, small.mass)
    lam = lam * (1.0 if scatter is None else (1 + scatter) ** 2)
    w = 2 * np.pi * np.asarray(load.freqs)[:, None]
    wk = np.sqrt(lam)
    below = lam - w**2 + 2j * ratios(lam, y) * wk * w
    q = (load.amplitude @ (y.T @ load.vectors).T) / below
    return q @ (rows.at(_every(model, x)) @ y).T


def _all_modes(k: Float, m: Float) -> tuple[Float, Float]:
    """λ >= 0, the lowest first, and M-orthonormal y of small matrices; a motion without mass keeps
    its flexibility.

    What is drawn for the lowest modes does so not depend on how many vectors the basis has.
    """
    shift = 1e-3 * float(np.trace(k) / np.trace(m))
    theta, y = linalg.eigh(m, k + shift * m)
    theta = np.maximum(theta, MASSLESS * theta[-1])[::-1]
    return np.maximum(1 / theta - shift, 0.0), np.asarray(y[:, ::-1] / np.sqrt(theta))


def _every(model: ObservedModel, x: Float) -> Float:
    """Factors of all parameters of the system that the rows count, held ones too."""
    full = getattr(model, "full_vector", None)
    if full is None:
        return model.parameters.factors(x)
    everything: Any_ = full(x)
    return model.system.parameters.factors(everything)  # type: ignore[attr-defined,no-any-return]


@dataclass(frozen=True, slots=True, eq=False)
class Bands(FrozenArrays):
    """Quantiles over draws.

    Attributes
    ----------
    low, median, high : arrays of one shape
    level : float
        Share of the draws between `low` and `high`.
    """

    low: Float
    median: Float
    high: Float
    level: float

    def holds(self, value: Float) -> Bool:
        """Whether the band holds `value`, element by element."""
        return (self.low <= value) & (value <= self.high)


def bands(draws: Float, level: float = 0.9) -> Bands:
    """Central bands of draws (draw, ...); NaN draws are left out.

    Raises
    ------
    InputError
        If the level is not between 0 and 1, or there are too few draws for it.
    """
    if not 0 < level < 1 or draws.shape[0] * (1 - level) < 1:
        raise InputError(
            f"{draws.shape[0]} draws for a band of {level}: level in 0..1, at least 1/(1 - "
            "level) draws"
        )
    # without NaN all columns at once: the same numbers, sooner
    quantile = np.nanquantile if np.isnan(draws).any() else np.quantile
    low, median, high = quantile(draws, [(1 - level) / 2, 0.5, (1 + level) / 2], axis=0)
    return Bands(low, median, high, level)


@dataclass(frozen=True, slots=True)
class Unbalance:
    """A rotor and its balance grade. ISO 21940-11: permissible unbalance U = M G / Ω.

    Attributes
    ----------
    mass : float, kg
    grade : float, mm/s
        G: eccentricity times service speed.
    service : float, Hz
        Service speed.
    """

    mass: float
    grade: float
    service: float

    def __post_init__(self) -> None:
        if not (self.mass > 0 and self.grade > 0 and self.service > 0):
            raise ConfigError(
                f"unbalance: mass {self.mass}, grade {self.grade}, service {self.service} Hz "
                "must be > 0"
            )

    @property
    def moment(self) -> float:
        """U, kg m."""
        return self.mass * self.grade * 1e-3 / (2 * np.pi * self.service)

    def force(self, freqs: Float) -> Float:
        """U ω² at speeds (l,) in Hz, N."""
        return self.moment * (2 * np.pi * np.asarray(freqs)) ** 2


def plane(axis: str) -> tuple[int, int]:
    """Directions 0..2 across a rotor's axis, such that a forward whirl goes from the first to the
    second.
    """
    if axis not in PLANE:
        raise ConfigError(f"axis of the rotor {axis!r}{did_you_mean(axis, PLANE)}")
    return PLANE[axis]


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """A quantity of a run-up: amplitudes of complex rows made one number a line.

    Attributes
    ----------
    name, unit : str
    rows : Rows
        n = parts · 3 or any; in groups of `width`.
    width : int
        Rows of one vector: its amplitude is the root of the square sum.
    """

    name: str
    unit: str
    rows: Rows
    width: int = 1

    def amplitude(self, response: Complex) -> Float:
        """(l,): the largest vector of a response (l, n)."""
        parts = np.abs(response).reshape(response.shape[0], -1, self.width)
        return np.asarray(np.sqrt((parts**2).sum(axis=2)).max(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class RunUp(FrozenArrays):
    """A run-up with bands.

    Attributes
    ----------
    freqs : (l,) float64, Hz
        Speeds.
    names, units : tuple (n) of str
    nominal : (n, l) float64
        At the best point.
    amplitude : Bands of (n, l)
    peak : Bands of (n,)
        Of the largest amplitude of each draw.
    peak_speed : Bands of (n,), Hz
    validated : (float, float), Hz
        Outside of it nothing has been checked.
    """

    freqs: Float
    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Float
    amplitude: Bands
    peak: Bands
    peak_speed: Bands
    validated: tuple[float, float] = (0.0, np.inf)

    @property
    def checked(self) -> Bool:
        """Lines inside the validated band, (l,)."""
        return (self.freqs >= self.validated[0]) & (self.freqs <= self.validated[1])

    @property
    def checked_peaks(self) -> Bool:
        """Outputs whose peak lies inside the validated band, with the whole band of its speed,
        (n,).
        """
        low, high = self.validated
        return (self.peak_speed.low >= low) & (self.peak_speed.high <= high)


@dataclass(frozen=True, slots=True, eq=False)
class KnownModel:
    """A model as well as it is known.

    Attributes
    ----------
    model : ObservedModel
    best : (p,) float64
    draws : (draw, p) float64
        Of the posterior.
    damping : Damping or RegionDamping
    discrepancy : float
        Relative standard deviation of each frequency.
    """

    model: ObservedModel
    best: Float
    draws: Float
    damping: Damping | RegionDamping
    discrepancy: float = 0.0


def unbalance_load(freqs: Float, vectors: Float, unbalance: Unbalance) -> HarmonicLoad:
    """Forward whirl: unit forces (r, 2) across the rotor's axis (`plane`), the second a quarter
    turn behind the first.
    """
    amplitude = unbalance.force(freqs)[:, None] * np.array([1.0, -1j])
    return HarmonicLoad(np.asarray(freqs), vectors, amplitude)


def run_up(
    known: KnownModel,
    load: HarmonicLoad,
    outputs: Sequence[Output],
    rng: np.random.Generator,
    *,
    level: float = 0.9,
    progress: Progress = quiet,
) -> RunUp:
    """Steady response to unbalance at each speed, no gyroscopic moments.

    Parameters
    ----------
    known : KnownModel
    load : HarmonicLoad
    outputs : sequence (n) of Output
    rng : Generator
        For discrepancy and damping.
    level : float
        Probability of the bands.
    """
    if not outputs:
        raise InputError("no output: name nodes or springs")
    r = load.vectors.shape[0]
    ends = np.cumsum([0, *(len(o.rows.nominal) for o in outputs)]).tolist()
    every = [slice(a, b) for a, b in pairwise(ends)]
    whole = _joined(outputs, every, ends[-1])

    def one(x: Float, scatter: Float | None, ratios: Ratios) -> Float:
        h = harmonic(known.model, x, load, whole, ratios, scatter=scatter)
        return np.array(
            [o.amplitude(h[:, at]) for o, at in zip(outputs, every, strict=True)]
        )

    found = []
    # an eigensolution each; streams of their own, so that no draw depends on how many modes others
    # have
    for i, (x, own) in enumerate(
        zip(known.draws, rng.spawn(len(known.draws)), strict=True)
    ):
        of_modes, of_damping = own.spawn(2)
        scatter: Float = np.asarray(known.discrepancy * of_modes.standard_normal(r))
        found.append(one(x, scatter, known.damping.drawn(of_damping)))
        progress((i + 1) / len(known.draws), "run-up")
    drawn = np.array(found)
    return RunUp(
        freqs=load.freqs,
        names=tuple(o.name for o in outputs),
        units=tuple(o.unit for o in outputs),
        nominal=one(known.best, None, known.damping.drawn(None)),
        amplitude=bands(drawn, level),
        peak=bands(drawn.max(axis=2), level),
        peak_speed=bands(load.freqs[drawn.argmax(axis=2)], level),
    )


def _joined(outputs: Sequence[Output], places: Sequence[slice], n: int) -> Rows:
    """All rows in one."""
    slopes: dict[int, Float] = {}
    for o, at in zip(outputs, places, strict=True):
        for i, s in o.rows.slopes:
            slopes.setdefault(i, np.zeros((n, s.shape[1])))[at] += s
    nominal = np.concatenate([o.rows.nominal for o in outputs])
    return Rows(nominal, tuple(sorted(slopes.items(), key=lambda v: v[0])))


def validated_band(test_hz: Float, held: Bool) -> tuple[float, float]:
    """From the lowest test mode to the last before the first that the model does not hold, Hz.

    Parameters
    ----------
    test_hz : (m,) float64
        All test modes that are to be believed.
    held : (m,) bool
        Paired and within the limits of acceptance.
    """
    order = np.argsort(test_hz)
    good = test_hz[order][np.logical_and.accumulate(held[order])]
    return (float(good[0]), float(good[-1])) if good.size else (0.0, 0.0)
