"""What an ambient record allows, and notes on it: bands, references, phases, events, spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.channels import ANGULAR, DERIVATIVE
from ringtrue.core.choice import Choice
from ringtrue.core.modes import ModeSet
from ringtrue.core.notes import Note
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.spectral_bins import SpectralBins
from ringtrue.signal.clock_alignment import channel_phases, in_step
from ringtrue.signal.spectra import Band
from ringtrue.signal.transients import Events

ORDER: dict[str, int] = {
    **DERIVATIVE,
    **{ANGULAR[motion]: n for motion, n in DERIVATIVE.items()},
    "strain": 0,
}


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
        return np.abs(pole) ** self.power[:, None]

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
    duration : float, s
        All stretches together.
    """

    slope: tuple[float, float]
    choice: Choice | None
    impacts: Events
    motion: CommonMotion | None
    duration: float

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
    order = np.array(
        [ORDER.get(c.quantity, ORDER[kind]) - ORDER[kind] for c in channels]
    )
    strain = np.array([c.quantity == "strain" for c in channels])
    return CommonMotion(
        kind,
        np.asarray((-1j) ** order, dtype=np.complex128),
        np.where(strain, 0, -order),
    )


def in_phase(
    history: TimeHistory, *, mend: bool
) -> tuple[TimeHistory, tuple[Note, ...]]:
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
        names = " ".join(ids[late].tolist())
        lag = float(found.delay[late].mean())
        treatment = "moved back" if mend else "they must be aligned first"
        values: dict[str, float | int | str] = {
            "lag": abs(lag),
            "side": "after" if lag > 0 else "before",
            "treatment": treatment,
        }
        notes.append(Note("channel late", "warning", names, values))
    for rate in np.unique(found.drift[found.drift != 0]):
        names = " ".join(ids[found.drift == rate].tolist())
        treatment = "taken out" if mend else "the records must be aligned first"
        values = {"ppm": 1e6 * float(rate), "treatment": treatment}
        notes.append(Note("channel clock", "warning", names, values))
    if found.odd.any():
        notes.append(
            Note("channel phase", "warning", " ".join(ids[found.odd].tolist()))
        )
    moved = mend and bool(found.delay.any() or found.drift.any())
    return (in_step(history, found.delay, found.drift) if moved else history), tuple(
        notes
    )


def nothing_found(history: TimeHistory, bands: tuple[Band, ...]) -> str:
    """A note that no mode was found."""
    return (
        f"no mode found in {bands[-1].low:.3g} .. {bands[0].high:.3g} Hz: {history.duration:.4g} s "
        f"may hold noise only; modes below {50 / history.duration:.3g} Hz need a longer record "
        "(50 cycles)"
    )


def event_notes(events: list[Events], frequencies: Float) -> tuple[str, ...]:
    """A note on the events of all stretches, and on modes (m,), Hz, of few periods between two."""
    count = sum(e.count for e in events)
    if not count:
        return ()
    driven = any(e.driven for e in events)
    level = max(events, key=lambda e: e.count).level
    use = "no correlation reaches across them"
    if driven:
        use = "the decays after them are used"
    if driven and count < 8:
        use += "; so few make the stated deviations rough"
    few = 5.0  # periods: with fewer, stated deviations fall short of the scatter
    slow = frequencies < few / max(e.interval for e in events)
    if driven and slow.any():
        use += (
            f"; modes up to {frequencies[slow].max():.4g} Hz have fewer than {few:.0f} "
            "periods between two, their stated deviations are rough"
        )
    plural = "s" if count > 1 else ""
    return (
        f"{count} event{plural} {level:.0f} dB above the rest (a jump, an impact): {use}",
    )


def noisy_channels(modes: ModeSet, std: Float) -> tuple[Note, ...]:
    """A note on channels whose readings are known far worse than those of the others: a cable or
    sensor that is broken.

    That is to more than a fifth of the RMS of the shapes, and five times worse than the median
    channel. `std` (ch, m) are the standard deviations of the moduli.
    """
    if not len(modes):
        return ()
    rms = np.sqrt((np.abs(modes.shapes) ** 2).mean(axis=0))
    relative = np.median(std / rms, axis=1)
    usual = np.median(relative)
    bad = np.flatnonzero(relative > np.maximum(0.2, 5.0 * usual))
    return tuple(
        Note(
            "channel noisy",
            "warning",
            modes.channels[k],
            {"percent": 100 * float(relative[k]), "usual": 100 * float(usual)},
        )
        for k in bad.tolist()
    )


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
