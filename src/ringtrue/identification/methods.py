"""The other methods of identification, by name: a second opinion on a record or on FRFs.

A method is one module and one entry here: the entry is all that commands and pages read. An
ambient method works in the bands of `identify_ambient`, or on the peaks of the whole record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, Uncertainty, joined_modes
from ringtrue.core.notes import sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.identification.ambient import era, fdd, plscf
from ringtrue.identification.ambient.pipeline import AmbientSettings, bands_for, lowest
from ringtrue.identification.ambient.record_checks import long_enough
from ringtrue.identification.ambient.spectral_bins import oscillator_spectrum
from ringtrue.identification.ambient.ssi_cov import SsiCov, ssi_data
from ringtrue.identification.common.stabilisation import modes_of
from ringtrue.shapes import mac
from ringtrue.signal.channel_checks import bridge_gaps, usable
from ringtrue.signal.spectra import (
    Band,
    Welch,
    band_signals,
    psd,
    remove_drift,
    scaled,
    unit_factor,
)

Found = tuple[ModeSet, Uncertainty]
# level above a pole, over that of an oscillator, below which the filter of a recorder keeps it
EDGE_FALL = 0.4


@dataclass(frozen=True, slots=True)
class BandMethod:
    """A method for one band of an ambient record.

    Attributes
    ----------
    title : str
    evidence : str
        What its confidence is.
    identify : callable (part, band in Hz, settings) -> (ModeSet, Uncertainty)
    deviations : bool
        Whether it states standard deviations.
    least : float
        Confidence of its modes, at least.
    """

    title: str
    evidence: str
    identify: Callable[[TimeHistory, tuple[float, float], AmbientSettings], Found]
    deviations: bool = False
    least: float = 0.33


@dataclass(frozen=True, slots=True)
class PeakMethod:
    """A method that takes the peaks of the spectra of the whole record; attributes as above.

    Attributes
    ----------
    identify : callable (history, settings, peaks in Hz) -> (ModeSet, Uncertainty)
    """

    title: str
    evidence: str
    identify: Callable[[TimeHistory, AmbientSettings, Sequence[float]], Found]
    deviations: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SecondOpinion:
    """Modes by one method.

    Attributes
    ----------
    modes : ModeSet
    uncertainty : Uncertainty
        NaN where the method states none.
    reasons, notes : tuple of str
    """

    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    notes: tuple[str, ...]


def _ssi_data_modes(
    part: TimeHistory, band: tuple[float, float], settings: AmbientSettings
) -> Found:
    """Modes of one band (Hz) that most orders show."""
    rows = min(settings.block_rows, part.data.shape[1] // era.SAMPLES_A_LAG)
    full = SsiCov(rows, order_max=40)
    own = full.projected(len(part.channels))
    poles = ssi_data(part, own, references=settings.references or None)
    return modes_of(poles, tuple(c.id for c in part.channels))


ORDERS = "share of the orders times MPC"
BOTH_HALVES = " and agreement of both halves of the record"


AMBIENT_METHODS: Mapping[str, BandMethod | PeakMethod] = {
    "plscf": BandMethod(
        "pLSCF on half spectra",
        "confidence of the fit" + BOTH_HALVES,
        plscf.half_spectra_modes,
    ),
    "era": BandMethod(
        "ERA on correlations (NExT)",
        ORDERS + BOTH_HALVES,
        era.era_modes,
    ),
    "ssi-data": BandMethod(
        "SSI-data",
        ORDERS,
        _ssi_data_modes,
        deviations=True,
    ),
    "fdd": PeakMethod("FDD", "mean MAC over the bell", fdd.fdd_modes, deviations=True),
}
AUTOMATIC_AMBIENT = "ssi"  # `identify_ambient`


def identify_ambient_by(
    method: str,
    history: TimeHistory,
    settings: AmbientSettings | None = None,
    *,
    near: Sequence[float] = (),
    progress: Progress = quiet,
) -> SecondOpinion:
    """Modes of an ambient record by one of `AMBIENT_METHODS`.

    Parameters
    ----------
    method : str
    history : TimeHistory
    settings : AmbientSettings
        Band and references.
    near : sequence of float, Hz
        Peaks for methods that take them; () for all that stand out.
    progress : callable (fraction, text)

    Raises
    ------
    ConfigError
        If there is no such method.
    DataError
        If no channel is usable or the record is too short.
    """
    if method not in AMBIENT_METHODS:
        raise ConfigError(
            f"method {method!r}{did_you_mean(method, tuple(AMBIENT_METHODS))}"
        )
    chosen = AMBIENT_METHODS[method]
    settings = settings or AmbientSettings()
    whole, gaps = bridge_gaps(history)
    good, states = usable(whole)
    good = remove_drift(good, lowest(good.duration, settings))
    good = scaled(good, unit_factor(good))
    notes = tuple(map(sentence, (*gaps.notes, *states)))
    progress(0.0, chosen.title)
    if isinstance(chosen, PeakMethod):
        modes, std = chosen.identify(good, settings, near)
    else:
        modes, std, short = _in_bands(chosen, good, settings, progress)
        notes += short
    edge = filter_edges(good, modes.frequencies, modes.damping)
    notes += tuple(
        f"pole at {f:.4g} Hz left out: the spectrum ends there: the filter of the recorder"
        for f in modes.frequencies[edge]
    )
    inside = np.flatnonzero(~edge)
    modes = replace(
        modes.take(inside), source=f"{history.source or 'record'}: {chosen.title}"
    )
    if len(modes) and not chosen.deviations:
        notes += (f"no standard deviations: {chosen.title} states none",)
    if len(modes):
        notes += ("shapes have no standard deviations",)
    reasons = tuple(
        f"{chosen.title}: {chosen.evidence} {c:.2f}" for c in modes.confidence
    )
    return SecondOpinion(modes, std.take(inside), reasons, notes)


def filter_edges(history: TimeHistory, frequency: Float, damping: Float) -> Bool:
    """(m,) whether the spectrum above each pole falls as no mode lets it: the edge of the
    recorder's filter.

    Above a mode a displacement falls most, by what an oscillator does; velocities and accelerations
    fall less.
    """
    pick = np.unique(np.linspace(0, len(history.channels) - 1, 8).astype(np.int64))
    lines = 256
    excerpt = replace(history, data=history.data[:, : lines**2])
    some = excerpt.pick([history.channels[i].id for i in pick])
    freqs, auto = psd(some, Welch(history.rate / lines))
    level = (auto / auto.mean(axis=1, keepdims=True)).mean(axis=0)
    top = np.minimum(frequency * (1 + 3 * damping), freqs[-1])
    here = np.interp(frequency, freqs, level)
    mode = here * oscillator_spectrum(freqs[:, None] / frequency, damping)
    # all the way up: behind an antiresonance the spectrum comes back
    cut = (level[:, None] < EDGE_FALL * mode) | (freqs[:, None] < top)
    return np.asarray(cut.all(axis=0))


def _in_bands(
    method: BandMethod,
    history: TimeHistory,
    settings: AmbientSettings,
    progress: Progress,
) -> tuple[ModeSet, Uncertainty, tuple[str, ...]]:
    """Modes of every band of the pyramid, and a note where bands are too short for the method."""
    every = long_enough(bands_for(history.rate, history.duration, settings), history)
    # which decimation may cut
    samples = era.fewest_samples(settings) + 16
    bands = long_enough(every, history, samples)
    found = []
    settings = replace(settings, confidence_min=method.least)
    for k, band in enumerate(bands):
        progress(
            k / len(bands), f"{method.title}: {band.low:.3g} .. {band.high:.3g} Hz"
        )
        limits = Band(band.low, band.high, band.rate)
        data, rate = band_signals(history.data, history.rate, (limits,))[0]
        signals = np.asarray(data, dtype=np.float64)
        part = TimeHistory(signals, rate, history.channels, history.source)
        modes, std = method.identify(part, (band.low, band.high), settings)
        inside = (modes.frequencies >= band.low) & (modes.frequencies <= band.high)
        at = np.flatnonzero(inside & (modes.confidence >= method.least))
        found.append((modes.take(at), std.take(at)))
    modes, std = _each_once(found)
    if len(bands) == len(every):
        return modes, std, ()
    low = min(band.low for band in bands)
    return (
        modes,
        std,
        (f"below {low:.3g} Hz the record is too short for {method.title}",),
    )


def _each_once(found: Sequence[Found]) -> Found:
    """All modes ascending; of two in overlapping bands that are one, that of more confidence."""
    modes, std = joined_modes(found)
    f = modes.frequencies
    confidence = modes.confidence
    band = np.repeat(np.arange(len(found)), [len(modes) for modes, _ in found])
    # one mode in two overlapping bands
    same = (np.abs(f[:, None] / f - 1) < 0.01) & (band[:, None] != band)
    if f.size:
        same &= mac(modes.shapes, modes.shapes) > 0.8
    equal = confidence[None] == confidence[:, None]
    better = (confidence[None] > confidence[:, None]) | (
        equal & (band[None] < band[:, None])
    )
    keep = np.flatnonzero(~(same & better).any(axis=1))
    keep = keep[np.argsort(f[keep], kind="stable")]
    kept = modes.take(keep)
    return kept, replace(std.take(keep), shape=np.full(kept.shapes.shape, np.nan))
