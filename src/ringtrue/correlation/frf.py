"""Comparison of frequency response functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Complex, Float, FrozenArrays, Int
from ringtrue.core.signals import FrfSet
from ringtrue.errors import InputError


def _same(a: Complex, b: Complex) -> None:
    if a.shape != b.shape or a.ndim != 3:
        raise InputError(
            f"FRFs {a.shape} and {b.shape} must be (freq, out, in) on the same lines"
        )


def frac(a: Complex, b: Complex) -> Float:
    """Frequency response assurance criterion, (out, in) 0..1: |Σ a* b|²/(Σ|a|² Σ|b|²) over lines
    (Heylen, 1996).

    Parameters
    ----------
    a, b : (freq, out, in) complex128
    """
    return _share(a, b, axis=0)


def _share(a: Complex, b: Complex, axis: int) -> Float:
    """|Σ a* b|²/(Σ|a|² Σ|b|²) over an axis; 0 where one of the two is 0."""
    _same(a, b)
    below = (np.abs(a) ** 2).sum(axis=axis) * (np.abs(b) ** 2).sum(axis=axis)
    cross = np.abs((a.conj() * b).sum(axis=axis)) ** 2
    return np.asarray(cross / np.where(below > 0, below, 1.0), dtype=np.float64)


def fdac(a: Complex, b: Complex) -> Float:
    """Frequency domain assurance criterion, (freq of a, freq of b) -1..1: cosine of the response
    shapes.

    Parameters
    ----------
    a, b : (freq, out) complex128, one input

    Notes
    -----
    Ridges off the diagonal show a frequency shift (Pascual, Golinval and Razeto, 1997).
    """
    left = np.linalg.norm(a, axis=1, keepdims=True)
    right = np.linalg.norm(b, axis=1, keepdims=True)
    cosine = (a / np.where(left > 0, left, 1.0)) @ (
        b / np.where(right > 0, right, 1.0)
    ).conj().T
    return np.asarray(cosine.real, dtype=np.float64)


def magnitude_deviation(a: Complex, b: Complex) -> Float:
    """Root mean square of the level difference 20 log10|b/a| over the lines, (out, in) dB.

    Lines where either is below 1e-6 of its own peak are left out: there only noise is compared.
    """
    _same(a, b)
    size_a = np.abs(a)
    size_b = np.abs(b)
    use = (size_a > 1e-6 * size_a.max(axis=0)) & (size_b > 1e-6 * size_b.max(axis=0))
    ratio = np.where(use, size_b, 1.0) / np.where(use, size_a, 1.0)
    count = use.sum(axis=0)
    square = (20 * np.log10(ratio)) ** 2
    return np.asarray(
        np.sqrt(square.sum(axis=0) / np.where(count > 0, count, 1)), dtype=np.float64
    )


def shape_correlation(a: Complex, b: Complex) -> Float:
    """Global shape correlation, (freq, in) 0..1: |Σ a* b|²/(Σ|a|² Σ|b|²) over the outputs of a
    line; blind to scale.

    Source: Zang, Grafe and Imregun (2001).

    Parameters
    ----------
    a, b : (freq, out, in) complex128
    """
    return _share(a, b, axis=1)


def amplitude_correlation(a: Complex, b: Complex) -> Float:
    """Global amplitude correlation, (freq, in) 0..1: 2|Σ a* b|/(Σ|a|² + Σ|b|²); 1 only where also
    the size agrees.
    """
    _same(a, b)
    below = (np.abs(a) ** 2).sum(axis=1) + (np.abs(b) ** 2).sum(axis=1)
    return np.asarray(
        2 * np.abs((a.conj() * b).sum(axis=1)) / np.where(below > 0, below, 1.0),
        dtype=np.float64,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Levels(FrozenArrays):
    """Mean response levels in bands.

    Attributes
    ----------
    centre : (band,) float64, Hz
    difference : (band, in) float64, dB
        Of b over a: mean square over the outputs and the lines of a band.
    """

    centre: Float
    difference: Float


def band_levels(a: Complex, b: Complex, freqs: Float) -> Levels:
    """How much louder b is than a, in third octaves with centres 1000·2^(k/3) Hz; for bands too
    dense for modes.

    Parameters
    ----------
    a, b : (freq, out, in) complex128
    freqs : (freq,) float64, Hz, ascending

    Raises
    ------
    InputError
        If the sizes do not fit.
    """
    _same(a, b)
    f = np.asarray(freqs, dtype=np.float64)
    if f.shape != a.shape[:1]:
        raise InputError(f"{f.size} lines for FRFs of {a.shape[0]}")
    live = f > 0
    number = np.rint(3 * np.log2(f[live] / 1000)).astype(np.int64)
    names, band = np.unique(number, return_inverse=True)
    power = np.zeros((2, names.size, a.shape[2]))
    for i, h in enumerate((a, b)):  # of two
        np.add.at(power[i], band, (np.abs(h[live]) ** 2).sum(axis=1))
    heard = (power > 0).all(axis=0)
    ratio = np.where(heard, power[1], 1.0) / np.where(heard, power[0], 1.0)
    return Levels(
        1000 * 2.0 ** (names / 3), np.where(heard, 10 * np.log10(ratio), np.nan)
    )


@dataclass(frozen=True, slots=True)
class InputSummary:
    """FRFs of one input: median and least FRAC (0..1), level difference (dB), mean shape and
    amplitude correlation.
    """

    name: str
    frac: float
    worst_output: str
    least_frac: float
    deviation: float
    shape: float
    amplitude: float

    def worse_than(self, before: InputSummary) -> tuple[str, ...]:
        """Which of "FRAC", "level", "shape" and "amplitude" are worse than before."""
        worse = {
            "FRAC": self.frac < before.frac,
            "level": self.deviation > before.deviation,
            "shape": self.shape < before.shape,
            "amplitude": self.amplitude < before.amplitude,
        }
        return tuple(name for name, held in worse.items() if held)


@dataclass(frozen=True, slots=True)
class OutputSummary:
    """FRFs of one output: FRAC (0..1) and level difference (dB), medians over the inputs."""

    name: str
    frac: float
    deviation: float


@dataclass(frozen=True, slots=True, eq=False)
class FrfComparison(FrozenArrays):
    """Two sets of FRFs on their common outputs, inputs and lines.

    Attributes
    ----------
    freqs : (freq,) float64, Hz
    outputs, inputs : tuple of str
    frac : (out, in) float64
    deviation : (out, in) float64, dB
        Root mean square of the level difference.
    shape, amplitude : (freq, in) float64
        Global shape and amplitude correlation.
    levels : Levels
        In third octaves.
    """

    freqs: Float
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    frac: Float
    deviation: Float
    shape: Float
    amplitude: Float
    levels: Levels

    def by_input(self) -> tuple[InputSummary, ...]:
        """What the measures say of each input."""
        worst = self.frac.argmin(axis=0)
        return tuple(
            InputSummary(
                name=name,
                frac=float(np.median(self.frac[:, j])),
                worst_output=self.outputs[int(worst[j])],
                least_frac=float(self.frac[worst[j], j]),
                deviation=float(np.median(self.deviation[:, j])),
                shape=float(self.shape[:, j].mean()),
                amplitude=float(self.amplitude[:, j].mean()),
            )
            for j, name in enumerate(self.inputs)
        )

    def by_output(self) -> tuple[OutputSummary, ...]:
        """Medians over the inputs of each output, the least FRAC first."""
        middle = np.median(self.frac, axis=1)
        level = np.median(self.deviation, axis=1)
        order = np.argsort(middle, kind="stable").tolist()
        return tuple(
            OutputSummary(self.outputs[i], float(middle[i]), float(level[i]))
            for i in order
        )


def compare_frfs(a: FrfSet, b: FrfSet) -> FrfComparison:
    """All measures of two sets of FRFs of one kind.

    Raises
    ------
    InputError
        If the kinds differ, or no output, input or line is common. FRFs are not interpolated: near
        a resonance that would compare the interpolation. Synthesise those of the model on the lines
        of the test.
    """
    if a.kind != b.kind:
        raise InputError(f"FRFs are {a.kind} and {b.kind}; convert one of them")
    step = float(np.median(np.diff(a.freqs))) if a.freqs.size > 1 else 1.0
    at = np.searchsorted(b.freqs, a.freqs - 1e-4 * step).clip(
        max=max(b.freqs.size - 1, 0)
    )
    line = np.zeros(0, dtype=np.int64)
    if b.freqs.size:
        line = np.flatnonzero(np.abs(b.freqs[at] - a.freqs) < 1e-4 * step)
    outs = _common([c.id for c in a.outputs], [c.id for c in b.outputs])
    ins = _common([c.id for c in a.inputs], [c.id for c in b.inputs])
    if not (line.size and outs[0] and ins[0]):
        raise InputError(
            f"FRFs have {line.size} lines, {len(outs[0])} outputs and {len(ins[0])} inputs in "
            "common; synthesise those of the model on the lines of the test"
        )
    left = a.data[np.ix_(line, outs[1], ins[1])]
    right = b.data[np.ix_(at[line], outs[2], ins[2])]
    f = a.freqs[line]
    return FrfComparison(
        freqs=f,
        outputs=outs[0],
        inputs=ins[0],
        frac=frac(left, right),
        deviation=magnitude_deviation(left, right),
        shape=shape_correlation(left, right),
        amplitude=amplitude_correlation(left, right),
        levels=band_levels(left, right, f),
    )


def _common(a: list[str], b: list[str]) -> tuple[tuple[str, ...], Int, Int]:
    here = {name: i for i, name in enumerate(b)}
    both = [(name, i, here[name]) for i, name in enumerate(a) if name in here]
    at = np.array([(i, j) for _, i, j in both], dtype=np.int64).reshape(-1, 2)
    return tuple(n for n, _, _ in both), at[:, 0], at[:, 1]
