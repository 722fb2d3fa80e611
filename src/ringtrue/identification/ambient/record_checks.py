"""What an ambient record allows, and notes on it: bands, references, phases, events, spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import maximum_filter1d

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.choice import Choice
from ringtrue.core.motions import ANGULAR, DERIVATIVE
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.maximum_likelihood import SpectralBins
from ringtrue.signal.clock_alignment import channel_phases, in_step
from ringtrue.signal.decimation import Band
from ringtrue.signal.spectra import Welch, csd
from ringtrue.signal.transients import Events

FEW = 8  # events
EDGE = 0.35  # of the rate: where filters of recorders begin to end the spectrum
LAST = 0.49  # and where it is looked at
AT_EDGE = "left out: the spectrum ends there: the filter of the recorder"
BROAD = 0.02  # damping that the edge of a filter may have
FALL = 0.4  # of the fall of a mode
# channels and segments of the spectrum in which peaks are looked for; neighbouring lines
EYES = 8
AVERAGES = 64
BESIDE = 12
SURE = 8.0  # standard deviations that a peak stands out by, as of its averages
SHOWN = 3  # how many are named
UNSURE = 0.2  # of the RMS of the shapes
WORSE = 5.0  # times the median channel
ORDER: dict[str, int] = {
    **DERIVATIVE,
    **{ANGULAR[motion]: n for motion, n in DERIVATIVE.items()},
    "strain": 0,
}


def spectrum(bins: SpectralBins, scale: Float, most: int = 4, join: int = 8) -> tuple[Float, Float]:
    """Frequencies and level (dB) of the first singular value of the spectral matrix of up to 4
    channels.
    """
    pick = np.unique(np.linspace(0, scale.size - 1, most).round().astype(np.int64))
    n = bins.freqs.size // join
    if not n:
        return np.empty(0), np.empty(0)
    part = bins.cross[: n * join, pick[:, None], pick] * np.outer(scale[pick], scale[pick])
    mean = part.reshape(n, join, pick.size, pick.size).mean(1)
    top = np.linalg.svd(mean, compute_uv=False, hermitian=True)[:, 0].astype(np.float64)
    return bins.freqs[: n * join].reshape(n, join).mean(1), 10 * np.log10(
        np.maximum(top, np.finfo(np.float64).tiny)
    )


def response_slope(history: TimeHistory) -> tuple[float, float]:
    """Exponent of the frequency in the responses' spectrum under a flat force, and its standard
    deviation.
    """
    kinds = {c.quantity for c in history.channels}
    kind = kinds.pop() if len(kinds) == 1 else "unknown"
    return (2.0 * ORDER[kind], 1.5) if kind in ORDER else (2.0, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class CommonMotion:
    """What makes one motion of channels that measure different kinds of it.

    Attributes
    ----------
    kind : str
        The quantity of the shapes: that of most channels.
    turn : (ch,) complex128
        Phases that take a quarter of a turn away for each derivative.
    power : (ch,) int64
        Of |λ|, that the moduli are multiplied by; strain keeps its own.
    """

    kind: str
    turn: Complex
    power: Int

    def lift(self, pole: Complex) -> Float:
        """(ch, m) factors of the moduli of the shapes of poles (m,), rad/s."""
        return np.asarray(np.abs(pole) ** self.power[:, None])

    def spectra(self, bins: SpectralBins, eyes: Int) -> SpectralBins:
        """The spectra of some channels as those of one motion."""
        t = self.turn[eyes].astype(np.complex64)
        return replace(bins, cross=bins.cross * (t[:, None] * t.conj()))


@dataclass(frozen=True, slots=True)
class RecordFacts:
    """What the bands need to know of a record.

    Attributes
    ----------
    slope : tuple of float
        Of `response_slope`.
    choice : Choice, optional
    impacts : Events
        Of the stretch in which they are most of the motion.
    motion : CommonMotion, optional
    """

    slope: tuple[float, float]
    choice: Choice | None
    impacts: Events
    motion: CommonMotion | None

    @property
    def driven(self) -> bool:
        """By events: its spectra are not those of stationary noise."""
        return self.impacts.driven

    @property
    def interval(self) -> float:
        """Between the events whose decays are most of the motion, s; 0 where it is under forces
        that last.
        """
        return self.impacts.interval if self.driven else 0.0

    @property
    def turn(self) -> Complex | None:
        """(ch,) phases of the channels."""
        return self.motion.turn if self.motion else None


def one_motion(channels: Sequence[Channel]) -> CommonMotion | None:
    """How channels of different kinds become one motion; None where all are of one kind, or not
    known.
    """
    kinds = [str(c.quantity) for c in channels if c.quantity in ORDER]
    if len(set(kinds)) < 2:
        return None
    kind = max(ORDER, key=lambda k: kinds.count(k))
    order = np.array([ORDER.get(c.quantity, ORDER[kind]) - ORDER[kind] for c in channels])
    strain = np.array([c.quantity == "strain" for c in channels])
    return CommonMotion(
        kind, np.asarray((-1j) ** order, dtype=np.complex128), np.where(strain, 0, -order)
    )


def in_phase(history: TimeHistory, *, mend: bool) -> tuple[TimeHistory, tuple[str, ...]]:
    """The record with channels that lag or drift from the others moved back; notes on them and on
    odd phases.
    """
    kind = np.array([ORDER.get(c.quantity, -1) for c in history.channels])
    kind[kind < 0] = np.bincount(kind[kind >= 0], minlength=1).argmax()
    found = channel_phases(history, kind.tolist())
    ids = np.array([c.id for c in history.channels])
    notes = []
    place = np.rint(2 * found.delay * history.rate)
    for k in np.unique(place[found.delay != 0]):
        late = (place == k) & (found.delay != 0)
        lag = found.delay[late].mean()
        done = "moved back" if mend else "they must be aligned first"
        when = f"{abs(lag):.3g} s {'after' if lag > 0 else 'before'} the others"
        notes.append(
            f"channel {' '.join(ids[late].tolist())}: {when} by the phases of the cross spectra; "
            f"{done}"
        )
    for rate in np.unique(found.drift[found.drift != 0]):
        names = " ".join(ids[found.drift == rate].tolist())
        done = "taken out" if mend else "the records must be aligned first"
        notes.append(
            f"channel {names}: a clock {1e6 * rate:+.3g} ppm against that of the others; {done}"
        )
    if found.odd.any():
        notes.append(
            f"channel {' '.join(ids[found.odd].tolist())}: phase to the others neither 0 nor 180 "
            "degrees, and no delay "
            "explains it: another quantity, sensor or filter? Shapes are wrong there, and modes "
            "may be lost"
        )
    moved = mend and bool(found.delay.any() or found.drift.any())
    return (in_step(history, found.delay, found.drift) if moved else history), tuple(notes)


def filter_edges(history: TimeHistory, frequency: Float, damping: Float) -> tuple[bool, ...]:
    """Whether the spectrum above each pole (m,) falls as no mode lets it: the edge of the
    recorder's filter.

    Above a mode a displacement falls most, by what an oscillator does; velocities and accelerations
    fall less.
    """
    high = (frequency > EDGE * history.rate) & (damping > BROAD)
    if not high.any():
        return (False,) * frequency.size
    pick = np.unique(np.linspace(0, len(history.channels) - 1, 8).astype(np.int64))
    some = replace(
        history, data=history.data[pick], channels=tuple(history.channels[i] for i in pick)
    )
    psd = csd(some, Welch(history.rate / 256))
    auto = np.real(np.einsum("fii->fi", psd.data))
    level = (auto / auto.mean(axis=0)).mean(axis=1)
    out = []
    for f, z, asked in zip(frequency.tolist(), damping.tolist(), high.tolist(), strict=True):
        top = min(f * (1 + 3 * z), LAST * history.rate)
        nu = top / f
        mode = 4 * z**2 / ((1 - nu**2) ** 2 + 4 * z**2 * nu**2)
        here, there = np.interp([f, top], psd.freqs, level)
        out.append(asked and bool(there < FALL * mode * here))
    return tuple(out)


def with_nothing_found(
    history: TimeHistory, left_out: list[str], modes: int, bands: tuple[Band, ...]
) -> list[str]:
    """The notes, with a word on what the record is good for where no mode was found."""
    span = f"{bands[-1].low:.3g} .. {bands[0].high:.3g} Hz"
    if modes:
        return left_out
    slower = f"; modes below {50 / history.duration:.3g} Hz need a longer record (50 cycles)"
    found = highest_peaks(history, bands[-1].low, bands[0].high)
    seen = (
        f"peaks at {', '.join(found)} stay without a mode"
        if found
        else f"{history.duration:.4g} s look like noise"
    )
    return [*left_out, f"no mode found in {span}: {seen}{slower}"]


def highest_peaks(history: TimeHistory, low: float, high: float) -> tuple[str, ...]:
    """The highest peaks of the spectrum between two frequencies, Hz, that noise does not make, with
    their heights.
    """
    psd = csd(
        history.pick([c.id for c in history.channels[:EYES]]), Welch(AVERAGES / history.duration)
    )
    if psd.freqs.size < 4 * BESIDE:
        return ()
    auto = np.real(np.einsum("fii->fi", psd.data))
    level = (auto / np.maximum(auto.mean(axis=0), np.finfo(np.float64).tiny)).mean(axis=1)
    sides = np.median(sliding_window_view(level, BESIDE), axis=1)
    height = np.zeros(level.size)
    around = np.maximum(sides[: -BESIDE - 1], sides[BESIDE + 1 :])  # a slope is no peak
    height[BESIDE:-BESIDE] = level[BESIDE:-BESIDE] / np.maximum(around, np.finfo(np.float64).tiny)
    top = height >= maximum_filter1d(height, 2 * BESIDE + 1)
    top &= (height > 1 + SURE / np.sqrt(AVERAGES)) & (psd.freqs > low) & (psd.freqs < high)
    at = np.flatnonzero(top)
    at = np.sort(at[np.argsort(-height[at])[:SHOWN]])
    return tuple(f"{psd.freqs[i]:.4g} Hz ({10 * np.log10(height[i]):.0f} dB)" for i in at.tolist())


def event_notes(heard: list[Events]) -> tuple[str, ...]:
    """A note on the events of all stretches."""
    if not (count := sum(e.count for e in heard)):
        return ()
    level = max(heard, key=lambda e: e.count).level
    use = (
        "the decays after them are used"
        if any(e.driven for e in heard)
        else "no correlation reaches across them"
    )
    few = (
        "; so few make the stated deviations rough"
        if count < FEW and any(e.driven for e in heard)
        else ""
    )
    return (
        f"{count} event{'s' if count > 1 else ''} {level:.0f} dB above the rest (a jump, a "
        f"blow): {use}{few}",
    )


def noisy_channels(ids: Sequence[str], shapes: Complex, std: Float) -> tuple[str, ...]:
    """A note on channels whose readings are known far worse than those of the others: a cable or
    sensor that is broken.

    Parameters
    ----------
    ids : (ch,) sequence of str
    shapes : (ch, m) complex128
    std : (ch, m) float64
        Standard deviations of their moduli.
    """
    if not shapes.size:
        return ()
    rms = np.sqrt((np.abs(shapes) ** 2).mean(axis=0))
    unsure = np.median(std / rms, axis=1)
    bad = unsure > np.maximum(UNSURE, WORSE * np.median(unsure))
    return tuple(
        f"channel {name}: its readings of the shapes are known to {100 * u:.0f} % of their RMS, "
        "those of the median "
        f"channel to {100 * np.median(unsure):.2g} %: noise of a broken cable or sensor? MAC "
        "suffers; leave it out"
        for name, u in zip(np.array(ids)[bad], unsure[bad], strict=True)
    )


def references(history: TimeHistory, names: tuple[str, ...]) -> Int | None:
    """Rows of the reference channels, None where each band is to choose."""
    if not names:
        return None
    ids = [c.id for c in history.channels]
    if lost := [n for n in names if n not in ids]:
        raise DataError(
            f"{history.source}: no usable reference channel {' '.join(lost[:8])}; there are "
            f"{ids[:40]}"
        )
    return np.array([ids.index(n) for n in names], dtype=np.int64)


def long_enough(
    bands: tuple[Band, ...], history: TimeHistory, samples: int = 200
) -> tuple[Band, ...]:
    """The bands with samples enough, by default for ten block rows."""
    long = tuple(b for b in bands if history.duration * b.rate >= samples)
    if not long:
        raise DataError(
            f"{history.source}: {history.duration:.4g} s are too short for modes above "
            f"{bands[-1].low:.3g} Hz; needed are {samples / bands[0].rate:.4g} s"
        )
    return long
