"""Whether a record holds free decays: its power falls by decades behind the impacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.notes import Note
from ringtrue.core.signals import TimeHistory
from ringtrue.identification.ambient.decay_band_fit import DecaySettings
from ringtrue.identification.ambient.free_decays import band_decays, decay_bounds
from ringtrue.signal.transients import find_events

FRAMES = 50  # of a record, whose powers are compared


@dataclass(frozen=True, slots=True)
class DecayEvidence:
    """Whether a record is one of free decays.

    Attributes
    ----------
    decades : float
        That the power falls by behind the impacts: the least of the bands that hold all but a
        hundredth of the energy, the median of the decays.
    early : float
        Share of the energy of the decays in their first halves.
    impacts : int
    """

    decades: float = 0.0
    early: float = 0.0
    impacts: int = 0


def decay_evidence(history: TimeHistory, settings: DecaySettings) -> DecayEvidence:
    """How far the energy of a record falls behind its impacts, band by band.

    A stationary record ends at the first look: its frames are of one power within a decade.
    """
    if history.data.shape[1] < 16 * FRAMES or not np.isfinite(history.data).all():
        return DecayEvidence()
    size = history.data.shape[1] // FRAMES
    frames = history.data[:, : size * FRAMES].reshape(len(history.data), FRAMES, size)
    power = frames.var(axis=2, dtype=np.float64)
    range_ = power.max(axis=1) / np.maximum(np.quantile(power, 0.1, axis=1), 1e-300)
    if np.median(np.log10(np.maximum(range_, 1.0))) < settings.decades:
        return DecayEvidence()
    bounds = decay_bounds(find_events(history.data, history.rate), history)
    parts = band_decays(history, bounds, settings)
    energy = np.array([sum(float(np.square(y).sum()) for y in p.decays) for p in parts])
    if not parts or not energy.sum() > 0:
        return DecayEvidence(impacts=len(bounds))
    chosen = [p for p, e in zip(parts, energy, strict=True) if e > 0.01 * energy.sum()]
    falls = []
    early = []
    for part in chosen:
        each = [_fall(y) for y in part.decays]
        falls.append(float(np.median([e[0] for e in each])))
        early.append(float(np.median([e[1] for e in each])))
    # an impact that leaves nothing to ring is not one of a test of free decays
    heard = min(len(p.decays) for p in chosen) / len(bounds)
    return DecayEvidence(min(falls) if heard > 0.5 else 0.0, min(early), len(bounds))


def _fall(y: Float) -> tuple[float, float]:
    """Decades of the power from the first to the last tenth of a decay (ch, sample), and the share
    of its energy in the first half.
    """
    tenth = max(y.shape[1] // 10, 1)
    square = np.square(y).sum(axis=0)
    last = max(float(square[-tenth:].mean()), 1e-300)
    decades = float(np.log10(max(float(square[:tenth].mean()), 1e-300) / last))
    return decades, float(square[: square.size // 2].sum() / max(float(square.sum()), 1e-300))


def free_decay_note(history: TimeHistory, settings: DecaySettings | None = None) -> Note | None:
    """The note that a record holds free decays and next to nothing else; None for another one."""
    settings = settings or DecaySettings()
    found = decay_evidence(history, settings)
    if found.decades <= settings.decades or found.early <= settings.early:
        return None
    values = {"decades": found.decades, "impacts": found.impacts}
    return Note("decay automatic", "information", history.source or "record", values)
