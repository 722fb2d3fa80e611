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

from ringtrue.core.arrays import Float, Int
from ringtrue.core.choice import Choice
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.progress import Progress, quiet
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.ambient.band_modes import modes_of_band, with_echo_doubt
from ringtrue.identification.ambient.confidence import (
    BandModes,
    dense_set,
    fastest_decay,
    frequencies_and_damping,
    reason,
    select,
    surer_groups,
    uncertainty,
)
from ringtrue.identification.ambient.manual_selection import chosen
from ringtrue.identification.ambient.record_bands import (
    SHORTEST,
    STEP,
    BandSums,
    events_of,
    steady_sines,
    sums_of_stretches,
    with_fewer_lags,
    with_more_lags,
    without_strokes_sweeps_and_echoes,
)
from ringtrue.identification.ambient.record_checks import (
    AT_EDGE,
    RecordFacts,
    event_notes,
    filter_edges,
    in_phase,
    long_enough,
    noisy_channels,
    one_motion,
    references,
    response_slope,
    with_nothing_found,
)
from ringtrue.identification.ambient.spurious_modes import (
    line_remainders,
    machine,
    overtones,
    unconfirmed,
    unexplained,
    unresolved,
    without_forced,
)
from ringtrue.identification.ambient.ssi_cov import SsiCov
from ringtrue.identification.common.poles import StableDiagram
from ringtrue.signal.band_correlations import map_in_threads
from ringtrue.signal.channel_checks import unclipped_channels, usable
from ringtrue.signal.decimation import Band, remove_drift, scaled, unit_factor
from ringtrue.signal.echoes import Echo
from ringtrue.signal.gaps import Gaps, bridge_gaps
from ringtrue.signal.harmonic_evidence import amplitude_evidence, phase_evidence
from ringtrue.signal.tonal_lines import Harmonic, harmonics, remove_tonal_lines, unsteady_lines

LEAST_DAMPING = 5e-4  # below what structures have in operation (welded steel: 0.1 %)
LEAST_FALL = 0.1  # of the logarithm of the amplitude, from one impact to the next
HARDLY_FALLS = (
    "it decays too little between impacts at equal intervals: a line of these; a longer "
    "time between them would show a mode"
)
TOP = 0.34  # of the rate of a decimated band: the skirts of its filter begin at 0.4
BLOCKS_EACH = 4  # of one stretch of a long record
HIDES = "; it may hide a mode beside it, which a record without the machine shows"
BESIDE = "; where a mode may stand beside it, take the line out (oma --remove-harmonics)"


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
    notes : tuple of str
        What the reader should know: bad channels, left-out poles, nothing found.
    channel_notes : tuple of str
        Those of the notes that are about channels.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    diagrams: tuple[StableDiagram, ...]
    reasons: tuple[str, ...]
    harmonics: tuple[Harmonic, ...]
    notes: tuple[str, ...]
    channel_notes: tuple[str, ...] = ()


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
    top = rate / max(int(TOP * rate / high), 1)
    bands = [Band(max(low, 0.06 * top), high, top)]
    while bands[-1].low > low:
        r = bands[-1].rate / STEP
        bands.append(Band(max(low, 0.06 * r), TOP * r, r))
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
    leave: tuple[float, ...] = (),
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
    leave : tuple of float, Hz
        Lines of steady machines that are not to be taken out. Of a single stretch, those that leave
        something behind where no mode stands are not either: it would pull at its neighbours.

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
    record = _prepared(first, settings, leave, single=second is None)
    good = record.good
    report(0.0, "filtering into bands")
    blocks = 0 if second is None else BLOCKS_EACH
    ssi = SsiCov(settings.block_rows, settings.order_max, blocks=blocks)
    later = chain(() if second is None else (second,), coming)
    sums, events = sums_of_stretches(
        good,
        record.gaps,
        coming=(scaled(part, record.factor) for part in later),
        bands=record.bands,
        ssi=ssi,
        refs=record.references,
        places=record.places,
        report=report,
    )
    strongest = max(events, key=lambda e: e.share)
    motion = one_motion(good.channels)
    facts = RecordFacts(response_slope(good), choice, strongest, motion)
    found = _modes_of_bands(record, sums, facts, settings, report)
    found = _second_looks(record, sums, found, facts=facts, settings=settings, ssi=ssi)
    if record.echo:
        found = [with_echo_doubt(band, record.echo) for band in found]
    result = _assembled(record, found, facts, settings)
    if second is None:
        unsteady = unexplained(result.modes, unsteady_lines(good, record.places))
        if unsteady:
            again = (*leave, *unsteady)
            return identify_stretches(
                (first,), settings, choice=choice, progress=progress, leave=again
            )
    report(1.0, f"{len(result.modes)} modes")
    ids = [c.id for c in good.channels]
    noisy = noisy_channels(ids, result.modes.shapes, result.uncertainty.shape)
    of_channels = record.channel_notes + noisy
    if motion:
        of_channels += (f"channels of different kinds: shapes are those of {motion.kind} in all",)
    notes = of_channels + record.notes + event_notes(events) + result.notes
    harmonics_found = (*record.sines, *result.harmonics)
    return replace(result, harmonics=harmonics_found, notes=notes, channel_notes=of_channels)


@dataclass(frozen=True, slots=True, eq=False)
class _Record:
    """The first stretch, ready for the bands.

    Attributes
    ----------
    good : TimeHistory
        Usable channels in step, without lines, impulses, sweeps and echo.
    unclipped : TimeHistory, optional
        Those of its channels whose amplitude is not cut off; None if all are.
    gaps : Gaps
    factor : float
        Unit of `good`.
    references : (ref,) int64, optional
    bands : tuple of Band
    echo : Echo, optional
    sines : tuple of Harmonic
        Lines of steady machines that were taken out.
    steady : bool
        Whether no impacts drive it: a steady amplitude then means a machine.
    notes, channel_notes : tuple of str
    """

    good: TimeHistory
    unclipped: TimeHistory | None
    gaps: Gaps
    factor: float
    references: Int | None
    bands: tuple[Band, ...]
    echo: Echo | None
    sines: tuple[Harmonic, ...]
    steady: bool
    notes: tuple[str, ...]
    channel_notes: tuple[str, ...]

    @property
    def places(self) -> list[float]:
        """Frequencies of the lines that were taken out, Hz."""
        return [sine.frequency for sine in self.sines]


def _prepared(
    first: TimeHistory, settings: AmbientSettings, leave: tuple[float, ...], *, single: bool
) -> _Record:
    """The usable channels of the first stretch, without what machines leave in it."""
    part, gaps = bridge_gaps(first)
    raw, states = usable(part)
    kept = unclipped_channels(raw, states)  # of raw samples: these show what is cut off
    good = remove_drift(raw, lowest(raw.duration, settings))
    factor = unit_factor(good)
    good, late = in_phase(scaled(good, factor), mend=single)
    refs = references(good, settings.references)
    bands = long_enough(bands_for(good.rate, good.duration, settings), good)
    # an amplitude that is cut off looks steady
    unclipped = good if kept is raw else kept and good.pick([c.id for c in kept.channels])
    impacts = events_of(good, gaps)
    longest_lag = 2 * settings.block_rows / bands[0].rate
    good, unclipped, swept, echo = without_strokes_sweeps_and_echoes(
        good, unclipped, impacts, longest_lag
    )
    sines = steady_sines(
        good, unclipped, bands=bands, leave=leave, impacts=impacts, once=not single
    )
    places = [sine.frequency for sine in sines]
    clean = remove_tonal_lines(good, places)
    if unclipped is good:
        unclipped = clean
    elif unclipped:
        unclipped = remove_tonal_lines(unclipped, places)
    else:
        swept += ("every channel is clipped: machines are not told from modes",)
    return _Record(
        good=clean,
        unclipped=unclipped,
        gaps=gaps,
        factor=factor,
        references=refs,
        bands=bands,
        echo=echo,
        sines=sines,
        steady=not impacts.driven,
        notes=swept,
        channel_notes=gaps.notes + tuple(state.note for state in states) + late,
    )


def _modes_of_bands(
    record: _Record,
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


def _second_looks(
    record: _Record,
    sums: list[BandSums],
    found: list[BandModes],
    *,
    facts: RecordFacts,
    settings: AmbientSettings,
    ssi: SsiCov,
) -> list[BandModes]:
    """The modes of all bands, with fewer or with more lags where these give more confidence."""
    single = ssi.blocks == 0
    tries = settings.order_max // ssi.order_step
    looks = []
    for k, (band, own) in enumerate(zip(sums, found, strict=True)):
        fewer = with_fewer_lags(band, fastest_decay(own.table, tries))
        if fewer:
            looks.append((k, fewer))
        if single and not facts.driven and dense_set(own.table, tries, band.seconds):
            bands = record.bands[: k + 1]
            more = with_more_lags(record.good, record.gaps, bands, ssi, record.references)
            looks.append((k, more))
    automatic = replace(facts, choice=None)
    again = map_in_threads(lambda x: modes_of_band(x[1], settings.confidence_min, automatic), looks)
    out = list(found)
    for (k, _), other in zip(looks, again, strict=True):
        out[k], other = surer_groups(out[k], other, settings.confidence_min)
        out.append(other)
    return out


def _assembled(
    record: _Record, found: list[BandModes], facts: RecordFacts, settings: AmbientSettings
) -> AmbientResult:
    """The modes of all bands as one result, after exclusions and the choice by hand."""
    good = record.good
    lines: tuple[Harmonic, ...] = ()
    if record.unclipped and record.steady:
        shown = harmonics(record.unclipped, low=record.bands[-1].low)
        lines = tuple(h for h in shown if h.frequency < record.bands[0].high)
    candidates = select(found, settings.confidence_min)
    f, damping = frequencies_and_damping(found, candidates)
    why = _exclusions(record, f, damping, lines=lines, facts=facts)
    rows = [row for row, text in zip(candidates, why, strict=True) if not text]
    left_out = [text for text in why if text]
    rows, forced = without_forced(found, rows)
    by_hand = chosen(found, rows, facts.choice, good.source)
    found = by_hand.found
    rows = by_hand.rows
    left_out += [*forced, *by_hand.notes]
    own_f, own_damping = frequencies_and_damping(found, rows)
    reported = np.append(own_f, [h.frequency for h in lines])
    left_out += [*unresolved(found, reported), *unconfirmed(found, np.append(reported, f))]
    shapes = [found[b].shape[:, i] for b, i in rows]
    none = np.empty((len(good.channels), 0), np.complex128)
    modes = ModeSet(
        frequencies=own_f,
        damping=own_damping,
        shapes=np.stack(shapes, axis=1) if rows else none,
        labels=tuple(c.id for c in good.channels),
        source=f"{good.source or 'record'}: SSI-cov",
        confidence=np.array([found[b].confidence[i] for b, i in rows]),
    )
    std = uncertainty(found, rows, len(good.channels))
    reasons = []
    for b, i in rows:
        chosen_by_hand = by_hand.said.get((b, i))
        evidence = reason(found[b], i)
        reasons.append(f"{chosen_by_hand}; {evidence}" if chosen_by_hand else evidence)
    if record.unclipped is not good:
        sound = {c.id for c in record.unclipped.channels} if record.unclipped else set()
        clipped = np.array([c.id not in sound for c in good.channels])
        modes, reasons = overtones(modes, std.frequency, reasons, clipped)
    return AmbientResult(
        modes=modes,
        uncertainty=std,
        diagrams=tuple(band.diagram for band in found[: len(record.bands)]),
        reasons=tuple(reasons),
        harmonics=lines,
        notes=tuple(with_nothing_found(good, left_out, len(rows), record.bands)),
    )


def _exclusions(
    record: _Record,
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
    out = []
    for k, (x, z) in enumerate(zip(f.tolist(), damping.tolist(), strict=True)):
        line = on_line[k]
        decays_by = 2 * np.pi * z * x * facts.interval  # from one impact to the next
        text = ""
        if line:
            text = f"left out: {line.why}{BESIDE}"
        elif z < LEAST_DAMPING:
            text = f"left out: damping {100 * z:.2g} % is a line, not a structure"
        elif facts.interval and facts.impacts.lines_near(x) and decays_by < LEAST_FALL:
            text = f"left out: {HARDLY_FALLS}"
        elif remainders[k]:
            text = (
                f"left out: what the line at {remainders[k]:.5g} Hz left whose phase wanders{HIDES}"
            )
        elif unsteady[k]:
            text = f"left out: {unsteady[k]}{HIDES}"
        elif edges[k]:
            text = AT_EDGE
        out.append(f"pole at {x:.4g} Hz {text}" if text else "")
    return out
