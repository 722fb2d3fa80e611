"""Modes from free decays: step relaxation, ring-down, impacts whose force nobody measured.

Band by band, the decays behind all impacts are fitted together by maximum likelihood. One more mode
is looked for in what is left until noise alone explains it. The standard deviations are those of
the Fisher information (Kay 1993, ch. 3 and 13). ERA (Juang and Pappa 1985) on the same decays says
which poles every model order shows.

Whether a record holds free decays: its power falls by decades behind the impacts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeClass, ModeSet, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.decay_backbone import Backbone
from ringtrue.identification.ambient.decay_band_fit import (
    BandDecays,
    BandFit,
    DecaySettings,
    decays_of,
    fit_band,
)
from ringtrue.identification.ambient.decay_candidates import (
    DecayCandidate,
    DecayMultiple,
    candidates,
    is_remainder,
    sum_of,
)
from ringtrue.identification.ambient.decay_fit import covariance, deviations
from ringtrue.identification.ambient.era import era
from ringtrue.identification.ambient.pipeline import AmbientSettings, bands_for
from ringtrue.identification.ambient.record_bands import MOST_BLOCKS
from ringtrue.identification.ambient.ssi_cov import SsiCov
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram, unit
from ringtrue.signal.channel_checks import bridge_gaps, usable
from ringtrue.signal.spectra import Band
from ringtrue.signal.transients import EVENT, Events, find_events


def decay_bounds(events: Events, history: TimeHistory) -> Int:
    """(decay, 2) first sample of each decay, behind its impact, and the first one behind it.

    Without an event the record is one decay.
    """
    samples = history.data.shape[1]
    at = np.flatnonzero(events.struck)
    if not at.size:
        return np.array([[0, samples]], dtype=np.int64)
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    size = events.window * history.rate
    begin = np.array([(r[-1] + 2 - EVENT.spread) * size for r in runs])
    end = np.array([(r[0] + EVENT.spread) * size for r in runs[1:]] + [float(samples)])
    bounds = np.stack([np.ceil(begin), np.floor(end)], axis=1).astype(np.int64)
    return np.asarray(bounds[bounds[:, 1] > bounds[:, 0] + 64])


def decay_bands(
    rate: float, longest: float, settings: DecaySettings
) -> tuple[Band, ...]:
    """The pyramid for decays of at most `longest` s, from the highest band."""
    low = settings.fmin if settings.fmin else 8.0 / longest
    own = AmbientSettings(fmin=low, fmax=settings.fmax)
    return tuple(b for b in bands_for(rate, longest, own) if b.rate * longest > 96)


@dataclass(frozen=True, slots=True, eq=False)
class DecayResult:
    """What free decays say.

    Attributes
    ----------
    modes : ModeSet
        The natural modes. Unscaled complex shapes, largest component 1; of a nonlinear one, those
        at its smallest amplitude.
    uncertainty : Uncertainty
    evidence : tuple of Note
        One a mode.
    backbones : tuple of (Backbone or None)
        One a mode; None where it decays too fast to have one.
    multiples : tuple of DecayMultiple
        Harmonics: multiples and sums of modes, by nonlinearity or clipping.
    notes : tuple of Note
        Of the record and of what was left out.
    diagrams : tuple of StableDiagram
        ERA, one a band, from the highest.
    starts : (decay,) float64, s
        Where the decays begin.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    evidence: tuple[Note, ...]
    backbones: tuple[Backbone | None, ...]
    multiples: tuple[DecayMultiple, ...]
    notes: tuple[Note, ...]
    diagrams: tuple[StableDiagram, ...]
    starts: Float

    @property
    def others(self) -> OtherCandidates:
        """The multiples as harmonics; their shapes are not known."""
        of = self.multiples
        shapes = np.full((len(self.modes.channels), len(of)), np.nan)
        modes = ModeSet(
            frequencies=np.array([m.frequency for m in of]),
            damping=np.array([m.damping for m in of]),
            shapes=shapes,
            labels=self.modes.labels,
            confidence=np.ones(len(of)),
        )
        std = Uncertainty.independent(
            np.array([m.std_frequency for m in of]),
            np.array([m.std_damping for m in of]),
            shapes,
        )
        classes: list[ModeClass] = ["harmonic" for _ in of]
        return OtherCandidates(modes, std, tuple(classes), tuple(m.note for m in of))

    @property
    def reasons(self) -> tuple[str, ...]:
        """The evidence for each mode as sentences."""
        return tuple(sentence(note) for note in self.evidence)


def identify_decay(
    history: TimeHistory,
    settings: DecaySettings | None = None,
    *,
    progress: Progress = quiet,
) -> DecayResult:
    """Modes from a record of free decays.

    Parameters
    ----------
    history : TimeHistory
        Responses (channel, sample). Several impacts are several decays of the same modes; a record
        without an impact is one decay.
    settings : DecaySettings
    progress : callable (fraction, text)

    Raises
    ------
    DataError
        If no channel is usable, or nothing decays.
    ConfigError
        If the band of interest is empty.
    """
    settings = settings or DecaySettings()
    whole, gaps = bridge_gaps(history)
    good, states = usable(whole)
    progress(0.0, "impacts")
    bounds = behind_clipping(
        good, decay_bounds(find_events(good.data, good.rate), good)
    )
    parts = band_decays(good, bounds, settings)
    if not parts:
        raise DataError(
            f"{history.source or 'record'}: nothing decays to the noise in "
            f"{good.duration:.4g} s; an ambient record goes without `decay`"
        )
    fits = []
    for k, part in enumerate(parts):
        progress(
            (k + 1) / (len(parts) + 1),
            f"{part.band.low:.3g} .. {part.band.high:.3g} Hz",
        )
        fits.append(fit_band(part))
    found = _assembled(fits, good)
    of_record = Note(
        "decay record",
        "information",
        good.source or "record",
        {"decays": len(bounds), "first": float(bounds[0, 0] / good.rate)},
    )
    of_channels = (*gaps.notes, *states, of_record)
    progress(1.0, f"{len(found.modes)} modes")
    return replace(
        found, notes=(*of_channels, *found.notes), starts=bounds[:, 0] / good.rate
    )


def band_decays(
    history: TimeHistory, bounds: Int, settings: DecaySettings
) -> list[BandDecays]:
    """The decays of the bands in which something decays."""
    longest = float(np.diff(bounds, axis=1).max()) / history.rate
    bands = decay_bands(history.rate, longest, settings)
    parts = decays_of(history.data, history.rate, bounds, bands) if bands else []
    return [p for p in parts if p.decays]


def behind_clipping(history: TimeHistory, bounds: Int) -> Int:
    """The bounds (decay, 2) without what is cut off by the range of a recorder: samples that equal
    the largest or smallest one of a channel, several times.
    """
    out = bounds.copy()
    cut = np.zeros(history.data.shape[1], dtype=bool)
    for x in history.data:  # a channel at a time in memory
        for limit in (x.max(), x.min()):
            at = x == limit
            if np.count_nonzero(at) > 3:
                cut |= at
    for row in out:  # a few decays
        last = np.flatnonzero(cut[row[0] : row[1]])
        row[0] += int(last[-1]) + 1 if last.size else 0
    return np.asarray(out[out[:, 1] > out[:, 0] + 64])


def era_diagram(found: BandFit) -> tuple[StableDiagram, Float]:
    """The poles of ERA on all decays of a band in one Hankel matrix, and the share of the orders
    that show each pole (m,) of the fit.
    """
    ch = len(found.scaled[0])
    shortest = min(y.shape[1] for y in found.scaled)
    rows = int(min(np.clip(400 // ch, 12, 60), (shortest - 1) // 2))
    lags = np.stack([y[:, : 2 * rows + 1].T for y in found.scaled], axis=2)
    own = SsiCov(rows, order_max=min(60, rows * len(found.scaled)))
    poles = era(lags, found.part.rate, own)
    model = found.sums.model
    away = np.abs(poles.pole[:, None] - model.poles)
    near = away < 0.02 * np.abs(model.poles)
    near &= away == away.min(axis=1, keepdims=True, initial=np.inf)
    shown = [np.unique(poles.order[at]) for at in near.T]
    after = [np.count_nonzero(poles.orders >= s.min()) if s.size else 1 for s in shown]
    share = np.array([s.size / max(n, 1) for s, n in zip(shown, after, strict=True)])
    cluster = np.where(
        near.any(axis=1), near.argmax(axis=1) if model.poles.size else 0, -1
    )
    y = found.scaled[0]
    power = np.square(np.abs(np.fft.rfft(y, axis=1))).sum(axis=0)
    lines = np.arange(power.size) * found.part.rate / y.shape[1]
    level = 10 * np.log10(np.maximum(power, np.finfo(np.float64).tiny))
    shape = unit(poles.shape * found.scale[:, None])
    full = PoleSet(
        poles.order, poles.pole, shape, poles.std_frequency, poles.std_damping
    )
    return StableDiagram(full, cluster >= 0, cluster, lines, level[None]), share


def _assembled(fits: list[BandFit], history: TimeHistory) -> DecayResult:
    """The candidates of all bands as natural modes, multiples of these and notes."""
    every = candidates(fits)
    notes = []
    decaying = []
    for c in every:
        values = {"frequency": c.frequency}
        if c.steady:
            notes.append(
                Note("decay steady", "information", f"{c.frequency:.5g} Hz", values)
            )
        elif is_remainder(c, every):
            notes.append(
                Note("decay remainder", "information", f"{c.frequency:.5g} Hz", values)
            )
        else:
            decaying.append(c)
    natural: list[DecayCandidate] = []
    multiples = []
    for c in sorted(decaying, key=lambda c: -c.gain):
        of = sum_of(c, natural)
        if of:
            std = c.std.tolist()
            multiples.append(DecayMultiple(c.frequency, std[0], c.damping, std[1], of))
        else:
            natural.append(c)
    natural.sort(key=lambda c: c.frequency)
    multiples.sort(key=lambda m: m.frequency)
    diagrams = {id(found): era_diagram(found) for found in fits}
    rows = [_mode(c, float(diagrams[id(c.found)][1][c.k]), history) for c in natural]
    ch = len(history.channels)
    modes = ModeSet(
        frequencies=np.array([r.frequency for r in rows]),
        damping=np.array([r.damping for r in rows]),
        shapes=np.array([r.shape for r in rows], dtype=np.complex128).reshape(-1, ch).T,
        labels=tuple(c.id for c in history.channels),
        source=f"{history.source or 'record'}: free decays",
        confidence=np.array([r.confidence for r in rows]),
    )
    return DecayResult(
        modes=modes,
        uncertainty=_uncertainty(natural, rows, ch),
        evidence=tuple(r.note for r in rows),
        backbones=tuple(r.backbone for r in rows),
        multiples=tuple(multiples),
        notes=tuple(notes),
        diagrams=tuple(diagrams[id(found)][0] for found in fits),
        starts=np.zeros(0),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One mode of the result."""

    frequency: float
    damping: float
    std: Float
    shape: Complex
    std_shape: Float
    confidence: float
    backbone: Backbone | None
    note: Note


def _mode(c: DecayCandidate, share: float, history: TimeHistory) -> _Row:
    found = c.found
    backbone = c.backbone
    frequency, damping, std = c.frequency, c.damping, c.std
    values: dict[str, float | int | str] = {
        "level": float(10 * np.log10(c.gain)),
        "decays": len(found.scaled),
        "share": 100 * share,
    }
    code = "decay mode"
    if c.bent and backbone is not None and backbone.nonlinear:
        frequency = float(backbone.fit_frequency[0])
        damping = float(backbone.fit_damping[0])
        of_terms = [backbone.std_frequency_terms[0], backbone.std_damping_terms[0]]
        std = np.maximum(std, of_terms)
        largest = np.argmax(np.abs(found.shape(c.k)))
        values["change"] = 100 * (float(backbone.fit_frequency[-1]) / frequency - 1)
        values["amplitude"] = float(backbone.fit_amplitude[-1])
        values["unit"] = history.channels[largest].unit
        code = "decay mode bent"
    sums = found.sums
    each = c.amplitudes * found.scale
    weight = np.linalg.norm(each, axis=1)
    m = sums.gain.size
    blocks = sums.inverse.reshape(-1, m, 2, m, 2)[:, c.k, :, c.k]
    spread = 0.5 * (blocks[:, 0, 0] + blocks[:, 1, 1])
    variance = found.floor.at(np.array([c.frequency]))[:, 0] * found.scale**2
    shape = found.shape(c.k)
    largest_part = np.abs(each).max(axis=1)
    # the shape is the mean over the decays, by the squares of their amplitudes
    relative = float((weight**2 @ spread) / (weight**2).sum() ** 2)
    relative *= float((weight**2).sum() / (largest_part**2).sum())
    likely = c.gain / (c.gain + max(found.critical, 1.0))
    return _Row(
        frequency=frequency,
        damping=damping,
        std=np.asarray(std),
        shape=shape,
        std_shape=np.sqrt(variance * relative),
        confidence=likely if code == "decay mode bent" else likely * 0.5 * (1 + share),
        backbone=backbone,
        note=Note(code, "information", f"{frequency:.5g} Hz", values),
    )


def _uncertainty(
    natural: list[DecayCandidate], rows: list[_Row], ch: int
) -> Uncertainty:
    """Standard deviations, and the covariance of the modes that share a band."""
    m = len(rows)
    std = np.array([r.std for r in rows]).reshape(m, 2)
    joint = np.diag(std.T.ravel() ** 2)
    for i, a in enumerate(natural):
        spread = deviations(
            a.found.sums.model.poles, covariance(a.found.sums, a.found.floor)
        )
        size = len(spread) // 2
        for j, b in enumerate(natural):
            if j == i or b.found is not a.found or a.bent or b.bent:
                continue
            at = np.ix_([a.k, size + a.k], [b.k, size + b.k])
            joint[np.ix_([i, m + i], [j, m + j])] = spread[at]
        if not a.bent:
            own = np.ix_([a.k, size + a.k], [a.k, size + a.k])
            joint[np.ix_([i, m + i], [i, m + i])] = spread[own]
    scale = np.sqrt(np.maximum(np.diag(joint), np.finfo(np.float64).tiny))
    value, vector = np.linalg.eigh(joint / np.outer(scale, scale))
    factor = np.sqrt(np.maximum(value, 0))[:, None] * vector.T * scale
    shapes = np.array([r.std_shape for r in rows]).reshape(m, ch).T
    return Uncertainty(std[:, 0], std[:, 1], shapes, factor)


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

    A stationary record, or one of many impacts, ends at the first look: its blocks are of one power
    within a decade.
    """
    count = MOST_BLOCKS
    size = history.data.shape[1] // count
    if size < 2 or not np.isfinite(history.data).all():
        return DecayEvidence()
    blocks = history.data[:, : size * count].reshape(len(history.data), count, size)
    power = blocks.var(axis=2, dtype=np.float64)
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
    return decades, float(
        square[: square.size // 2].sum() / max(float(square.sum()), 1e-300)
    )


def free_decay_note(
    history: TimeHistory, settings: DecaySettings | None = None
) -> Note | None:
    """The note that a record holds free decays and next to nothing else; None for another one."""
    settings = settings or DecaySettings()
    found = decay_evidence(history, settings)
    # what an exponential that falls so far has in its first half
    early = 1 - 10 ** (-settings.decades / 2)
    if found.decades <= settings.decades or found.early <= early:
        return None
    values = {"decades": found.decades, "impacts": found.impacts}
    return Note("decay automatic", "information", history.source or "record", values)
