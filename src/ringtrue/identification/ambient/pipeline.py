"""Output-only identification in one call: a pyramid of bands, every order in each, modes with their
uncertainty.

A wide band at a high rate spans a fraction of a period of a slow mode with its lags, so the record
is decimated by four again and again; each band keeps 0.06 to 0.34 of its rate and overlaps the
next.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.choice import Choice
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.ambient.band_modes import modes_of_band
from ringtrue.identification.ambient.confidence import (
    BandModes,
    better_groups,
    is_dense,
    line_remainders,
    listed,
    machine,
    reason,
    select,
    uncertainty,
    unconfirmed,
    without_forced,
)
from ringtrue.identification.ambient.record_bands import (
    SHORTEST,
    STEP,
    BandSums,
    FirstStretch,
    events_of,
    steady_sines,
    sums_of_stretches,
    with_more_lags,
    without_machines,
)
from ringtrue.identification.ambient.record_checks import (
    AT_EDGE,
    RecordFacts,
    event_notes,
    filter_edges,
    in_phase,
    long_enough,
    noisy_channels,
    nothing_found,
    one_motion,
    response_slope,
)
from ringtrue.identification.ambient.ssi_cov import SsiCov, positions
from ringtrue.identification.common.manual_selection import chosen
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.signal.band_correlations import map_in_threads
from ringtrue.signal.channel_checks import bridge_gaps, unclipped_channels, usable
from ringtrue.signal.harmonic_evidence import amplitude_evidence, phase_evidence
from ringtrue.signal.spectra import Band, remove_drift, scaled, unit_factor
from ringtrue.signal.tonal_lines import Harmonic, harmonics, remove_tonal_lines


@dataclass(frozen=True, slots=True)
class AmbientSettings:
    """Settings; the defaults need no tuning.

    Attributes
    ----------
    fmin, fmax : float, Hz
        Band of interest; None: 50 cycles in the record, and what the rate allows.
    order_max : int
        Largest model order of each band, half as much again in one that modes crowd.
    block_rows : int
        Block rows, fewer in a band with few samples.
    references : tuple of str
        Reference channels; () lets each band choose at most 8.
    confidence_min : float
        Modes below are not reported.
    """

    fmin: float | None = None
    fmax: float | None = None
    order_max: int = 80
    block_rows: int = 50
    references: tuple[str, ...] = ()
    confidence_min: float = 0.33

    def __post_init__(self) -> None:
        low = self.fmin or 0.0
        high = self.fmax or np.inf
        if low < 0 or not low < high:
            raise ConfigError(f"band {self.fmin} .. {self.fmax} Hz: must be 0 <= fmin < fmax")


@dataclass(frozen=True, slots=True, eq=False)
class AmbientResult:
    """What an ambient record says.

    Attributes
    ----------
    modes : ModeSet
        Unscaled complex shapes, largest component 1; `confidence` 0..1 for each.
    uncertainty : Uncertainty
    diagrams : tuple of StableDiagram
        One for each band, from the highest; clusters are numbered within it.
    reasons : tuple of str
        The evidence for each mode.
    harmonics : tuple of Harmonic
        Lines of machines, left out.
    record_notes : tuple of str
        What the reader should know: machines, left-out poles, nothing found.
    channel_notes : tuple of Note
        On channels.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    diagrams: tuple[StableDiagram, ...]
    reasons: tuple[str, ...]
    harmonics: tuple[Harmonic, ...]
    record_notes: tuple[str, ...]
    channel_notes: tuple[Note, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """All notes as sentences."""
        return (*map(sentence, self.channel_notes), *self.record_notes)


def lowest(duration: float, settings: AmbientSettings) -> float:
    """The lowest frequency of interest, Hz: 50 cycles in the record, unless one is given."""
    return settings.fmin if settings.fmin is not None else 50.0 / duration


def bands_for(rate: float, duration: float, settings: AmbientSettings) -> tuple[Band, ...]:
    """The pyramid, from the highest band.

    Raises
    ------
    ConfigError
        If the band of interest is empty at this rate and length.
    """
    low = lowest(duration, settings)
    high = min(settings.fmax or np.inf, 0.49 * rate)
    if not low < high:
        raise ConfigError(
            f"band {low:.4g} .. {high:.4g} Hz is empty: {duration:.4g} s at {rate:.4g} Hz allow "
            f"{50 / duration:.4g} .. {0.49 * rate:.4g} Hz"
        )
    share = 0.34  # of the rate: the skirts of the filter of a decimated band begin at 0.4
    top = rate / max(int(share * rate / high), 1)
    bands = [Band(max(low, 0.06 * top), high, top)]
    while bands[-1].low > low:
        r = bands[-1].rate / STEP
        bands.append(Band(max(low, 0.06 * r), share * r, r))
    return tuple(bands)


def identify_ambient(
    history: TimeHistory,
    settings: AmbientSettings | None = None,
    *,
    choice: Choice | None = None,
    progress: Progress | None = None,
) -> AmbientResult:
    """Modes of a structure in operation, from its responses alone.

    Parameters
    ----------
    history : TimeHistory
        Responses; (channel, sample).
    settings : AmbientSettings
    choice : Choice, optional
        What a person decided on the modes.
    progress : callable (fraction, text)

    Raises
    ------
    DataError
        If no channel is usable, the record is too short or a choice means a pole that is not there.
    ConfigError
        If the band of interest is empty.
    """
    return identify_stretches((history,), settings, choice=choice, progress=progress)


def identify_stretches(
    stretches: Iterable[TimeHistory],
    settings: AmbientSettings | None = None,
    *,
    choice: Choice | None = None,
    progress: Progress | None = None,
) -> AmbientResult:
    """Modes from a record that comes in stretches: what is kept of each does not grow with the
    record.

    Parameters
    ----------
    stretches : iterable of TimeHistory
        Successive parts of one record, of one length (`ringtrue.io.records.record_blocks`); half an
        hour or more each, 50 cycles of the lowest mode at least. A shorter last one counts for
        less. The first one decides which channels are usable and where machines run.
    settings : AmbientSettings
    choice : Choice, optional
    progress : callable (fraction, text)
        The fraction stays 0 while stretches come, as their number is not known.

    Raises
    ------
    DataError
        If no channel is usable, the first stretch is too short or a channel fails later.
    ConfigError
        If the band of interest is empty.
    """
    settings = settings or AmbientSettings()
    report = progress or quiet
    coming = iter(stretches)
    first = next(coming, None)
    if first is None:
        raise DataError("no stretch of a record to identify")
    coming = (part for part in coming if part.duration >= SHORTEST * first.duration)
    second = next(coming, None)
    record = _first_stretch(first, settings, single=second is None)
    report(0.0, "filtering into bands")
    # four blocks of each stretch of a long record
    ssi = SsiCov(settings.block_rows, settings.order_max, blocks=0 if second is None else 4)
    later = chain(() if second is None else (second,), coming)
    factor = record.factor
    sums, events = sums_of_stretches(record, (scaled(x, factor) for x in later), ssi, report)
    motion = one_motion(record.good.channels)
    strongest = max(events, key=lambda e: e.share)
    facts = RecordFacts(response_slope(record.good), choice, strongest, motion)
    found = _modes_of_bands(record, sums, facts, settings, report)
    if second is None and not facts.driven:
        found = _with_more_lags(record, sums, found, facts=facts, settings=settings)
    result = _assembled(record, found, facts, settings)
    report(1.0, f"{len(result.modes)} modes")
    noisy = noisy_channels(result.modes, result.uncertainty.shape)
    notes = record.notes + event_notes(events) + result.record_notes
    if motion:
        kinds = f"channels of different kinds: shapes are those of {motion.kind} in all"
        notes = (kinds, *notes)
    return replace(
        result,
        harmonics=(*record.sines, *result.harmonics),
        record_notes=notes,
        channel_notes=record.channel_notes + noisy,
    )


def _first_stretch(first: TimeHistory, settings: AmbientSettings, *, single: bool) -> FirstStretch:
    """The usable channels of the first stretch, without what machines leave in it."""
    part, gaps = bridge_gaps(first)
    raw, states = usable(part)
    kept = unclipped_channels(raw, states)  # of raw samples: these show what is cut off
    good = remove_drift(raw, lowest(raw.duration, settings))
    factor = unit_factor(good)
    good, late = in_phase(scaled(good, factor), mend=single)
    references = positions(good, settings.references) if settings.references else None
    bands = long_enough(bands_for(good.rate, good.duration, settings), good)
    unclipped: TimeHistory | None = None
    if kept is raw:
        unclipped = good
    elif kept:  # an amplitude that is cut off looks steady
        unclipped = good.pick([c.id for c in kept.channels])
    impacts = events_of(good, gaps)
    quiet = without_machines(good, unclipped, impacts, 2 * settings.block_rows / bands[0].rate)
    sines = steady_sines(quiet.unclipped, bands, impacts)
    places = [sine.frequency for sine in sines]
    clean = remove_tonal_lines(quiet.good, places)
    notes = quiet.notes
    if quiet.unclipped is quiet.good:
        unclipped = clean
    elif quiet.unclipped:
        unclipped = remove_tonal_lines(quiet.unclipped, places)
    else:
        unclipped = None
        notes += ("every channel is clipped: machines are not distinguished from modes",)
    return FirstStretch(
        good=clean,
        unclipped=unclipped,
        gaps=gaps,
        factor=factor,
        references=references,
        bands=bands,
        sines=sines,
        steady=not impacts.driven,
        notes=notes,
        channel_notes=gaps.notes + states + late,
    )


def _modes_of_bands(
    record: FirstStretch,
    sums: list[BandSums],
    facts: RecordFacts,
    settings: AmbientSettings,
    report: Progress,
) -> list[BandModes]:
    found = []
    results = map_in_threads(lambda x: modes_of_band(x, settings.confidence_min, facts), sums)
    for k, modes in enumerate(results):
        band = record.bands[k]
        share = (k + 1) / (len(record.bands) + 2)
        report(share, f"identified {band.low:.3g} .. {band.high:.3g} Hz")
        found.append(modes)
    return found


def _with_more_lags(
    record: FirstStretch,
    sums: list[BandSums],
    found: list[BandModes],
    *,
    facts: RecordFacts,
    settings: AmbientSettings,
) -> list[BandModes]:
    """The modes of all bands, those of dense ones with more lags where these are more certain."""
    ssi = SsiCov(settings.block_rows, settings.order_max)
    tries = ssi.order_max // ssi.order_step
    least = settings.confidence_min
    dense = [k for k, x in enumerate(found) if is_dense(x.table, tries, sums[k].seconds)]
    more = [with_more_lags(record, record.bands[: k + 1], ssi) for k in dense]
    automatic = replace(facts, choice=None)
    out = list(found)
    again = map_in_threads(lambda x: modes_of_band(x, least, automatic), more)
    for k, other in zip(dense, again, strict=True):
        out[k], better = better_groups(out[k], other, least)
        out.append(better)
    return out


def _assembled(
    record: FirstStretch, found: list[BandModes], facts: RecordFacts, settings: AmbientSettings
) -> AmbientResult:
    """The modes of all bands as one result, after exclusions and the choice by hand."""
    good = record.good
    lines: tuple[Harmonic, ...] = ()
    if record.unclipped and record.steady:
        shown = harmonics(record.unclipped, low=record.bands[-1].low)
        lines = tuple(h for h in shown if h.frequency < record.bands[0].high)
    candidates = select(found, settings.confidence_min)
    possible = listed(found, candidates)
    f = possible.frequency
    why = _exclusions(record, f, possible.damping, lines=lines, facts=facts)
    rows = [row for row, text in zip(candidates, why, strict=True) if not text]
    left_out = [text for text in why if text]
    rows, forced = without_forced(found, rows)
    by_hand = chosen(found, rows, facts.choice, good.source)
    rows = by_hand.rows
    left_out += [*forced, *by_hand.notes]
    reported = listed(found, rows)
    known = np.append(reported.frequency, [h.frequency for h in lines])
    left_out += unconfirmed(found, np.append(known, f))
    if not rows:
        left_out.append(nothing_found(good, record.bands))
    modes = ModeSet(
        frequencies=reported.frequency,
        damping=reported.damping,
        shapes=reported.shape,
        labels=tuple(c.id for c in good.channels),
        source=f"{good.source or 'record'}: SSI-cov",
        confidence=reported.confidence,
    )
    reasons = []
    for row in rows:
        evidence = reason(found[row[0]], row[1])
        said = by_hand.said.get(row)
        reasons.append(f"{said}; {evidence}" if said else evidence)
    return AmbientResult(
        modes=modes,
        uncertainty=uncertainty(found, rows, len(good.channels)),
        diagrams=tuple(band.diagram for band in found[: len(record.bands)]),
        reasons=tuple(reasons),
        harmonics=lines,
        record_notes=tuple(left_out),
    )


def _exclusions(
    record: FirstStretch,
    f: Float,
    damping: Float,
    *,
    lines: tuple[Harmonic, ...],
    facts: RecordFacts,
) -> list[str]:
    """For each pole (m,) why it is no mode of the structure; empty for a mode."""
    good = record.good
    line_f = [h.frequency for h in lines]
    # main lobe of the window of `harmonics` in 120 half-overlapped segments
    resolution = 61 * 4 / good.duration
    on_line = [
        machine(x, z, lines=lines, resolution=resolution, duration=good.duration)
        for x, z in zip(f, damping, strict=True)
    ]
    unsteady = ("",) * f.size
    if record.unclipped:
        unsteady = amplitude_evidence(record.unclipped, f, damping, line_f, facts.interval)
    if record.unclipped and not facts.driven:
        running = [bool(line or text) for line, text in zip(on_line, unsteady, strict=True)]
        every = np.append(f, line_f)
        widths = np.append(damping, np.zeros(len(line_f)))
        locked_to = phase_evidence(record.unclipped, every, widths, running + [True] * len(line_f))
        both = zip(unsteady, locked_to[: f.size], strict=True)
        unsteady = tuple(own or other for own, other in both)
    edges = filter_edges(good, f, damping)
    remainders = line_remainders(f, damping, np.array(record.places), good.duration)
    hides = "; it may hide a mode near it, which a record without the machine shows"
    out = []
    for k, (x, z) in enumerate(zip(f.tolist(), damping.tolist(), strict=True)):
        line = on_line[k]
        decays_by = 2 * np.pi * z * x * facts.interval  # from one impact to the next
        text = ""
        if line:
            text = f"left out: {line.why}"
        elif z < 5e-4:  # below what structures have in operation (welded steel: 0.1 %)
            text = f"left out: damping {100 * z:.2g} % is a line, not a structure"
        elif facts.interval and facts.impacts.lines_near(x) and decays_by < 0.1:
            text = (
                "left out: it decays too little between impacts at equal intervals: a line of "
                "these; a longer time between them would show a mode"
            )
        elif remainders[k]:
            text = (
                f"left out: what the line at {remainders[k]:.5g} Hz left whose phase wanders{hides}"
            )
        elif unsteady[k]:
            text = f"left out: {unsteady[k]}{hides}"
        elif edges[k]:
            text = AT_EDGE
        out.append(f"pole at {x:.4g} Hz {text}" if text else "")
    return out
