"""Channels, time histories, frequency response functions, and the impacts of a hammer behind them.

Of the impacts: what rings on from earlier ones, and the noise on their force. Frequency lines:
those that several axes share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np

from ringtrue.core.arrays import Any_, Complex, Float, FrozenArrays, Int, freeze_arrays
from ringtrue.core.display import Displayed
from ringtrue.errors import DataError

# of a test of signals on noise, or on what it takes for granted: how rarely chance may pass it
FALSE_ALARM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Impacts(FrozenArrays):
    """Impacts, each with those of its record that came before it.

    An earlier impact of impulse a rings on as a e^{λτ}, in the shape of a mode and decaying with
    its pole: it multiplies the residue that an impact of impulse A shows by 1 + a e^{λτ}/A.

    Attributes
    ----------
    delay : (impact, earlier) float64, s
        τ, from the earlier impact on.
    ratio : (impact, earlier) float64
        a/A; 0 where there is none.
    weight : (impact, out, in) float64
        Share of the impact in each FRF.
    freqs : (line,) float64, Hz
    noise : (impact, line) float64
        Power of the noise on the force over that of the force.
    """

    delay: Float
    ratio: Float
    weight: Float
    freqs: Float
    noise: Float

    def each(self, poles: Complex) -> Complex:
        """(impact, m) factors of the residues, impact by impact; poles (m,) in rad/s."""
        rest = self.ratio[:, :, None] * np.exp(self.delay[:, :, None] * poles)
        return np.asarray(1 + rest.sum(axis=1))

    def factors(self, poles: Complex) -> tuple[Complex, Complex]:
        """Factors of the shapes (out, m) and of the participations (m, in), least squares where
        FRFs have their own.
        """
        both = np.tensordot(self.weight, self.each(poles), (0, 0))  # (out, in, m)
        part = both.mean(axis=0)
        shape = (both * part.conj()).sum(axis=1) / (np.abs(part) ** 2).sum(axis=0)
        return np.asarray(shape), np.asarray(part.T)

    def scatter(self, poles: Complex) -> Float:
        """(m, out, in) variance of the factors from impact to impact, over their squared mean: it
        lowers the coherence.
        """
        each = self.each(poles)
        mean = np.abs(np.tensordot(self.weight, each, (0, 0))) ** 2
        power = np.tensordot(self.weight, np.abs(each) ** 2, (0, 0))
        return np.moveaxis(np.maximum(power - mean, 0) / mean, 2, 0)

    def noise_at(self, frequencies: Float) -> Float:
        """(impact, m) noise at the frequencies (m,), Hz."""
        return np.array([np.interp(frequencies, self.freqs, n) for n in self.noise])

    def highest_clear_line(self) -> float:
        """The highest line, Hz, at which the force of the typical impact stands 10 dB out of its
        noise.
        """
        clear = np.flatnonzero(np.median(self.noise, axis=0) < 0.1)
        return float(self.freqs[clear[-1]]) if clear.size else 0.0

    def spread(self, outputs: int) -> Impacts:
        """Of one input, weights (impact, 1, 1) of any sum, for the FRFs of so many outputs."""
        return replace(
            self, weight=np.repeat(self.weight / self.weight.sum(), outputs, axis=1)
        )

    def take(self, outputs: Int, inputs: Int) -> Impacts:
        """Of some of the FRFs."""
        return replace(self, weight=self.weight[:, outputs][:, :, inputs])

    def exchanged(self) -> Impacts:
        """With outputs as inputs."""
        return replace(self, weight=self.weight.swapaxes(1, 2))


def join_impacts(
    parts: Sequence[Impacts | None], weights: Sequence[Float]
) -> Impacts | None:
    """Of FRFs joined from parts with the same lines, `weights` (impact, out, in) each; None if one
    part has none.
    """
    known = [p for p in parts if p is not None]
    if len(known) < len(parts):
        return None
    delay = pad_rows([x for p in known for x in p.delay])
    ratio = pad_rows([x for p in known for x in p.ratio])
    noise = np.concatenate([p.noise for p in known])
    return Impacts(
        delay=delay,
        ratio=ratio,
        weight=np.concatenate(weights),
        freqs=known[0].freqs,
        noise=noise,
    )


def pad_rows(rows: Sequence[Float]) -> Float:
    """(row, longest) the rows with zeros behind."""
    out = np.zeros((len(rows), max((r.size for r in rows), default=0)))
    for row, r in zip(out, rows, strict=True):
        row[: r.size] = r
    return out


Quantity = Literal[
    "acceleration", "velocity", "displacement", "force", "strain", "unknown",
    "rotation", "angular velocity", "angular acceleration", "moment",
]  # fmt: skip
FrfKind = Literal["receptance", "mobility", "accelerance"]


@dataclass(frozen=True, slots=True)
class Channel:
    """One measured quantity.

    Attributes
    ----------
    id : str
        Unique, for instance `101+Z`.
    quantity : str
    unit : str
        SI after import: `m/s^2`, `m/s`, `N`; `rad/s`, `N*m`.
    sensor : str
        Serial number or type of the sensor.
    """

    id: str
    quantity: Quantity = "unknown"
    unit: str = ""
    sensor: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TimeHistory(Displayed):
    """Signals of one recorder.

    Attributes
    ----------
    data : (channel, sample) float32 or float64, in the unit of each channel
        Copied where the samples of a channel are not side by side in memory, as in a table turned
        round.
    rate : float, Hz
    channels : tuple of Channel
    source : str
    """

    UNITS: ClassVar[Mapping[str, str]] = {"rate": "Hz"}

    data: Any_
    rate: float
    channels: tuple[Channel, ...]
    source: str = ""

    def __post_init__(self) -> None:
        data = np.asarray(self.data)
        if data.strides[-1:] != (data.itemsize,):  # all work goes along the channels
            object.__setattr__(self, "data", np.ascontiguousarray(data))
        freeze_arrays(self)
        object.__setattr__(self, "channels", tuple(self.channels))
        if self.data.ndim != 2 or self.data.shape[0] != len(self.channels):
            raise DataError(
                f"data {self.data.shape} must be (channel, sample) with {len(self.channels)} "
                "channels"
            )
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise DataError(f"rate {self.rate} Hz: must be positive")

    @property
    def duration(self) -> float:
        """Length, s."""
        return float(self.data.shape[1] / self.rate)

    def pick(self, ids: Sequence[str]) -> TimeHistory:
        """The named channels, in the given order."""
        here = {c.id: i for i, c in enumerate(self.channels)}
        lost = [i for i in ids if i not in here]
        if lost:
            raise DataError(
                f"{self.source}: no channel {' '.join(lost[:8])}; there are "
                f"{' '.join(list(here)[:40])}"
            )
        at = [here[i] for i in ids]
        return replace(
            self, data=self.data[at], channels=tuple(self.channels[i] for i in at)
        )


@dataclass(frozen=True, slots=True, eq=False)
class FrfSet(Displayed):
    """Frequency response functions.

    Attributes
    ----------
    data : (freq, out, in) complex128, SI
    freqs : (freq,) float64, Hz, ascending; of a stepped sine in uneven steps
    outputs, inputs : tuple of Channel
        The id of an input is a point and direction like that of an output: equal ids mark a driving
        point.
    coherence : (freq, out, in) float64
        NaN where unknown, as all is if not given.
    averages : (in,) float64
        Hits or averages behind each column; NaN where unknown, as all is if not given.
    kind : str
    window_decay : float, 1/s
        Decay rate σ of an exponential window e^{-σt} on the responses, still in the data; 0 for
        none.
    source : str
    kept : float, s
        How long after the impact the response was cut off by the end of the block; inf where it was
        not, or is unknown.
    sharp : bool
        Known to be free of leakage, however few lines a mode has: of a periodic force, or with
        transients estimated.
    impacts : Impacts, optional
        The impacts behind the FRFs, where they are known.
    hann : float, s
        Length of the blocks of noise under a Hann window that the FRFs are of; 0 for none, or
        unknown.
    """

    UNITS: ClassVar[Mapping[str, str]] = {
        "freqs": "Hz",
        "window_decay": "1/s",
        "kept": "s",
        "hann": "s",
    }

    data: Complex
    freqs: Float
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    coherence: Float = field(default_factory=lambda: np.zeros(0))
    averages: Float = field(default_factory=lambda: np.zeros(0))
    kind: FrfKind = "accelerance"
    window_decay: float = 0.0
    source: str = ""
    kept: float = float("inf")
    sharp: bool = False
    impacts: Impacts | None = None
    hann: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "outputs", tuple(self.outputs))
        put(self, "inputs", tuple(self.inputs))
        if not np.size(self.coherence):
            put(self, "coherence", np.full(np.shape(self.data), np.nan))
        if not np.size(self.averages):
            put(self, "averages", np.full(len(self.inputs), np.nan))
        freeze_arrays(self)
        want = (self.freqs.size, len(self.outputs), len(self.inputs))
        if self.data.shape != want or self.coherence.shape != want:
            raise DataError(
                f"FRF data {self.data.shape}, coherence {self.coherence.shape}: must be (freq, "
                f"out, in) = {want}"
            )
        if not np.isfinite(self.data).all():
            raise DataError(
                f"{self.source or 'FRF'}: {int((~np.isfinite(self.data)).sum())} values are not "
                "finite"
            )

    def driving_points(self) -> list[tuple[int, int]]:
        """(output, input) positions with equal ids."""
        at = {c.id: i for i, c in enumerate(self.outputs)}
        return [(at[c.id], j) for j, c in enumerate(self.inputs) if c.id in at]

    def without(self, ids: Sequence[str]) -> FrfSet:
        """The FRFs without some responses and references.

        Raises
        ------
        DataError
            If no response or no reference is left.
        """
        lost = set(ids)
        sides = (self.outputs, self.inputs)
        o, i = (
            np.array(
                [k for k, c in enumerate(side) if c.id not in lost], dtype=np.int64
            )
            for side in sides
        )
        if not o.size or not i.size:
            left = f"{o.size} responses and {i.size} references are left"
            raise DataError(f"{self.source}: without {' '.join(ids)} {left}")
        return self.part(np.arange(self.freqs.size), o, i)

    def part(self, lines: Int, outputs: Int, inputs: Int) -> FrfSet:
        """Some lines, responses and references, by position."""
        at = np.ix_(lines, outputs, inputs)
        return replace(
            self,
            data=self.data[at],
            freqs=self.freqs[lines],
            coherence=self.coherence[at],
            averages=self.averages[inputs],
            impacts=self.impacts.take(outputs, inputs) if self.impacts else None,
            outputs=tuple(self.outputs[k] for k in outputs.tolist()),
            inputs=tuple(self.inputs[k] for k in inputs.tolist()),
        )


def shared_lines(axes: Sequence[Float]) -> list[Int] | None:
    """Where the lines that all axes share stand in each; None where these are no more than half of
    the fewest.

    Parameters
    ----------
    axes : sequence of (f,) float64, Hz, ascending
    """
    distinct = {(a.size, a.tobytes()): a for a in axes}
    fewest = min(distinct.values(), key=lambda a: a.size)
    near = {k: _nearest(a, fewest) for k, a in distinct.items()}
    limit = 1e-6 * max(float(fewest[-1]), 1.0)  # of the last line
    shared = np.all(
        [np.abs(a[near[k]] - fewest) <= limit for k, a in distinct.items()], axis=0
    )
    # 0.5: of the lines of the shortest axis, that must be shared
    if np.count_nonzero(shared) <= 0.5 * fewest.size:
        return None
    return [near[a.size, a.tobytes()][shared] for a in axes]


def _nearest(axis: Float, lines: Float) -> Int:
    """(f,) position in an ascending axis of the line nearest to each of `lines`."""
    middle = 0.5 * (axis[1:] + axis[:-1])
    return np.searchsorted(middle, lines)
