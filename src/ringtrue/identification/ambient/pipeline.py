"""Output-only identification in one call: a pyramid of bands, every order in each, modes with their
uncertainty.

A wide band at a high rate spans a fraction of a period of a slow mode with its lags, so the record
is decimated by four again and again; each band keeps 0.06 to 0.34 of its rate and overlaps the
next.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from ringtrue.core.arrays import Bool
from ringtrue.core.channels import SHOWN
from ringtrue.core.choice import Choice
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeClass, ModeSet, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.ambient.band_modes import modes_of_band
from ringtrue.identification.ambient.confidence import (
    LIMITS,
    BandModes,
    ListedCandidates,
    Row,
    carriers,
    doubts,
    in_short,
    line_remainders,
    listed,
    machine,
    reason,
    select,
    uncertainty,
)
from ringtrue.identification.ambient.record_bands import (
    STEP,
    BandSums,
    FirstStretch,
    bands_of_use,
    events_of,
    steady_sines,
    sums_of_stretches,
    too_short,
    without_machines,
)
from ringtrue.identification.ambient.record_checks import (
    RecordFacts,
    event_notes,
    in_phase,
    long_enough,
    noisy_channels,
    nothing_found,
    one_motion,
    response_slope,
)
from ringtrue.identification.ambient.spectral_bins import SpectrumPeak, spectrum_peaks
from ringtrue.identification.ambient.ssi_cov import SsiCov, positions
from ringtrue.identification.common.diagram import SpectrumAccount
from ringtrue.identification.common.manual_selection import chosen, with_evidence
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.shapes import mac
from ringtrue.signal.band_correlations import map_in_threads
from ringtrue.signal.channel_checks import bridge_gaps, unclipped_channels, usable
from ringtrue.signal.channel_quantities import with_learned_quantities
from ringtrue.signal.harmonic_evidence import amplitude_evidence, phase_evidence
from ringtrue.signal.machines import Machine, near_harmonics
from ringtrue.signal.spectra import Band, check_band, remove_drift, scaled, unit_factor
from ringtrue.signal.tonal_lines import Harmonic, harmonics, remove_tonal_lines
from ringtrue.signal.transients import Events

# of candidates by their notes; of other notes: doubtful
CLASSES: dict[str, ModeClass] = {
    "candidate line": "harmonic",
    "candidate harmonic": "harmonic",
    "candidate impacts": "harmonic",
    "candidate remainder": "harmonic",
    "candidate steady": "harmonic",
}


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
        Modes below are doubtful.
    """

    fmin: float | None = None
    fmax: float | None = None
    order_max: int = 80
    block_rows: int = 50
    references: tuple[str, ...] = ()
    confidence_min: float = 0.5

    def __post_init__(self) -> None:
        check_band(self.fmin, self.fmax)


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
    remarks : tuple of str
        What is particular of each mode, in six words; empty for one beyond doubt.
    harmonics : tuple of Harmonic
        Lines of machines.
    machines : tuple of Machine
        With their speed and harmonics, which were taken out.
    others : OtherCandidates
        Doubtful modes and harmonics.
    unexplained : tuple of SpectrumPeak
        Peaks of the singular values of the spectral matrix at which none of these is.
    record_notes : tuple of str
        What the reader should know: machines, events, nothing found.
    channel_notes : tuple of Note
        On channels.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    diagrams: tuple[StableDiagram, ...]
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]
    harmonics: tuple[Harmonic, ...]
    others: OtherCandidates
    record_notes: tuple[str, ...]
    channel_notes: tuple[Note, ...] = ()
    unexplained: tuple[SpectrumPeak, ...] = ()
    machines: tuple[Machine, ...] = ()

    @property
    def account(self) -> SpectrumAccount:
        """What the peaks of the spectrum are besides modes."""
        return SpectrumAccount(self.harmonics, self.machines, self.unexplained)

    @property
    def notes(self) -> tuple[str, ...]:
        """All notes as sentences."""
        highest = sorted(self.unexplained, key=lambda p: -p.prominence)
        peaks = [
            f"{p.frequency:.4g} Hz ({p.prominence:.0f} dB)" for p in highest[:SHOWN]
        ]
        more = f" and {len(highest) - SHOWN} lower ones" if len(highest) > SHOWN else ""
        unexplained = (
            f"peaks of the spectrum that nothing explains: {', '.join(peaks)}{more}"
        )
        of_spectrum = (unexplained,) if peaks else ()
        return (*map(sentence, self.channel_notes), *self.record_notes, *of_spectrum)


def lowest(duration: float, settings: AmbientSettings) -> float:
    """The lowest frequency of interest, Hz: 50 cycles in the record, unless one is given."""
    return settings.fmin if settings.fmin is not None else 50.0 / duration


def bands_for(
    rate: float, duration: float, settings: AmbientSettings
) -> tuple[Band, ...]:
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
    # of the rate: the skirts of the filter of a decimated band begin at 0.4
    share = 0.34
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
    progress: Progress = quiet,
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
    progress: Progress = quiet,
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
    return modes_of_record(
        weighed_candidates(stretches, settings, choice, progress), settings, progress
    )


def modes_of_record(
    weighed: WeighedRecord, settings: AmbientSettings, progress: Progress
) -> AmbientResult:
    """The modes among the weighed candidates of a record, as `identify_stretches` returns them."""
    record = weighed.record
    facts = weighed.facts
    result = _assembled(record, weighed.found, facts, settings)
    if not facts.driven:  # events have lines of their own
        result = replace(result, unexplained=_unexplained(record, weighed.sums, result))
    progress(1.0, f"{len(result.modes)} modes")
    noisy = noisy_channels(result.modes, result.uncertainty.shape)
    notes = (
        record.notes
        + event_notes(weighed.events, result.modes.frequencies)
        + result.record_notes
    )
    if facts.motion:
        kinds = f"channels of different kinds: shapes are those of {facts.motion.kind} in all"
        notes = (kinds, *notes)
    return replace(
        result,
        harmonics=(*record.sines, *result.harmonics),
        machines=record.machines,
        record_notes=notes,
        channel_notes=record.channel_notes + noisy,
    )


@dataclass(frozen=True, slots=True, eq=False)
class WeighedRecord:
    """A record and the candidates of its bands.

    Attributes
    ----------
    record : FirstStretch
    sums : list of BandSums
        One a band, from the highest.
    events : list of Events
        One a stretch.
    facts : RecordFacts
    found : list of BandModes
        One a band.
    """

    record: FirstStretch
    sums: list[BandSums]
    events: list[Events]
    facts: RecordFacts
    found: list[BandModes]


def weighed_candidates(
    stretches: Iterable[TimeHistory],
    settings: AmbientSettings,
    choice: Choice | None,
    progress: Progress,
) -> WeighedRecord:
    """The candidates of all bands with their confidence, as `identify_stretches` weighs them."""
    coming = iter(stretches)
    first = next(coming, None)
    if first is None:
        raise DataError("no stretch of a record to identify")
    coming = (x for x in coming if not too_short(x.duration, first.duration))
    second = next(coming, None)
    record = _first_stretch(first, settings, single=second is None)
    progress(0.0, "filtering into bands")
    # four blocks of each stretch of a long record
    ssi = SsiCov(
        settings.block_rows, settings.order_max, blocks=0 if second is None else 4
    )
    later = chain(() if second is None else (second,), coming)
    factor = record.factor
    sums, events = sums_of_stretches(
        record, (scaled(x, factor) for x in later), ssi, progress
    )
    motion = one_motion(record.good.channels)
    strongest = max(events, key=lambda e: e.share)
    duration = record.good.duration * len(events)
    facts = RecordFacts(
        response_slope(record.good), choice, strongest, motion, duration
    )
    found = _modes_of_bands(record, sums, facts, settings, progress)
    return WeighedRecord(record, sums, events, facts, found)


def _first_stretch(
    first: TimeHistory, settings: AmbientSettings, *, single: bool
) -> FirstStretch:
    """The usable channels of the first stretch, without what machines leave in it."""
    channels, samples = first.data.shape
    if channels > samples:
        raise DataError(
            f"{first.source}: {channels} channels of {samples} samples: rows are channels, columns "
            "samples; try the transposed array"
        )
    part, gaps = bridge_gaps(first)
    part, learned = with_learned_quantities(part)
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
    quiet = without_machines(
        good, unclipped, impacts, 2 * settings.block_rows / bands[0].rate
    )
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
        notes += (
            "every channel is clipped: machines are not distinguished from modes",
        )
    events = impacts if clean is good else events_of(clean, gaps)
    bands = bands_of_use(bands, good.duration, events, settings.block_rows)
    return FirstStretch(
        good=clean,
        unclipped=unclipped,
        gaps=gaps,
        events=events,
        factor=factor,
        references=references,
        bands=bands,
        sines=sines,
        machines=quiet.machines,
        steady=not impacts.driven,
        notes=notes,
        channel_notes=gaps.notes + learned + states + late,
    )


def _unexplained(
    record: FirstStretch, sums: list[BandSums], result: AmbientResult
) -> tuple[SpectrumPeak, ...]:
    """Peaks of the spectrum without a mode, a doubtful one or a machine, each once."""
    lines = [h.frequency for h in (*record.sines, *result.harmonics)]
    known = np.concatenate(
        [result.modes.frequencies, result.others.modes.frequencies, lines]
    )
    out: list[SpectrumPeak] = []
    for x, seen in zip(sums, result.diagrams, strict=True):
        for peak in spectrum_peaks(x.bins, seen.level, x.band.low, x.band.high):
            there = np.append(known, [p.frequency for p in out])
            if (np.abs(there - peak.frequency) > peak.width).all():
                out.append(peak)
    return tuple(sorted(out, key=lambda p: p.frequency))


def _modes_of_bands(
    record: FirstStretch,
    sums: list[BandSums],
    facts: RecordFacts,
    settings: AmbientSettings,
    progress: Progress,
) -> list[BandModes]:
    found = []
    results = map_in_threads(
        lambda x: modes_of_band(x, settings.confidence_min, facts), sums
    )
    for k, modes in enumerate(results):
        band = record.bands[k]
        share = (k + 1) / (len(record.bands) + 2)
        progress(share, f"identified {band.low:.3g} .. {band.high:.3g} Hz")
        found.append(modes)
    return found


def _assembled(
    record: FirstStretch,
    found: list[BandModes],
    facts: RecordFacts,
    settings: AmbientSettings,
) -> AmbientResult:
    """The modes of all bands as one result, after the evidence against them and the choice by
    hand.
    """
    good = record.good
    lines: tuple[Harmonic, ...] = ()
    if record.unclipped and record.steady:
        shown = harmonics(record.unclipped, low=record.bands[-1].low)
        lines = tuple(h for h in shown if h.frequency < record.bands[0].high)
    least = min(LIMITS.doubtful, settings.confidence_min)
    candidates = select(found, least)
    notes = _against(record, listed(found, candidates), lines=lines, facts=facts)
    against = dict(zip(candidates, notes, strict=True))
    for row in candidates:
        if (
            against[row] is None
            and found[row[0]].confidence[row[1]] < settings.confidence_min
        ):
            against[row] = doubts(found[row[0]], row[1])
    rows = [row for row in candidates if against[row] is None]
    against |= _forced(found, rows)
    rows = [row for row in rows if against[row] is None]
    by_hand = chosen(found, rows, facts.choice, good.source)
    rows = by_hand.rows
    reported = listed(found, rows)
    taken = _among(listed(found, candidates), reported)
    others = [
        row
        for row, own in zip(candidates, taken, strict=True)
        if against[row] and not own
    ]
    of_record = by_hand.notes
    if not rows:
        of_record = (*of_record, nothing_found(good, record.bands))
    reasons = []
    remarks = []
    for row in rows:
        said = by_hand.said.get(row, "")
        reasons.append(with_evidence(said, reason(found[row[0]], row[1])))
        remarks.append(said or in_short(found[row[0]], row[1]))
    noted = [note for row in others if (note := against[row])]
    return AmbientResult(
        modes=_mode_set(record, reported),
        uncertainty=uncertainty(found, rows, len(good.channels)),
        diagrams=tuple(band.diagram for band in found[: len(record.bands)]),
        reasons=tuple(reasons),
        remarks=tuple(remarks),
        harmonics=lines,
        others=OtherCandidates(
            _mode_set(record, listed(found, others)),
            uncertainty(found, others, len(good.channels)),
            tuple(CLASSES.get(note.code, "doubtful") for note in noted),
            tuple(noted),
        ),
        record_notes=of_record,
    )


def _mode_set(record: FirstStretch, of: ListedCandidates) -> ModeSet:
    return ModeSet(
        frequencies=of.frequency,
        damping=of.damping,
        shapes=of.shape,
        labels=tuple(c.id for c in record.good.channels),
        source=f"{record.good.source or 'record'}: SSI-cov",
        confidence=of.confidence,
    )


def _among(of: ListedCandidates, reported: ListedCandidates) -> Bool:
    """(m,) whether candidates are modes that are reported, as after a pick by hand."""
    half = (of.damping * of.frequency)[:, None]
    near = np.abs(of.frequency[:, None] - reported.frequency) < half
    return np.asarray(
        (near & (mac(of.shape, reported.shape) > LIMITS.same)).any(axis=1)
    )


def _doubt(
    code: str, frequency: float, values: Mapping[str, float | int | str]
) -> Note:
    return Note(code, "warning", f"{frequency:.5g} Hz", values)


def _forced(found: list[BandModes], rows: list[Row]) -> dict[Row, Note | None]:
    """For each row the note that it is a peak of the force."""
    c = listed(found, rows)
    of_others = carriers(c.frequency, c.damping, c.std_damping, c.shape)
    out: dict[Row, Note | None] = {}
    for row, f, by in zip(rows, c.frequency.tolist(), of_others, strict=True):
        others = ", ".join(f"{x:.4g}" for x in c.frequency[by])
        out[row] = (
            _doubt("candidate forced", f, {"others": others}) if by.size else None
        )
    return out


def _against(
    record: FirstStretch,
    of: ListedCandidates,
    *,
    lines: tuple[Harmonic, ...],
    facts: RecordFacts,
) -> list[Note | None]:
    """For each candidate (m,) the physical evidence that it is no mode of the structure."""
    f = of.frequency
    damping = of.damping
    line_f = [h.frequency for h in lines]
    on_line = [
        machine(x, z, lines=lines, duration=record.good.duration)
        for x, z in zip(f, damping, strict=True)
    ]
    unsteady = ("",) * f.size
    if record.unclipped:
        unsteady = amplitude_evidence(
            record.unclipped, f, damping, line_f, facts.interval
        )
    if record.unclipped and not facts.driven:
        running = [
            bool(line or text) for line, text in zip(on_line, unsteady, strict=True)
        ]
        every = np.append(f, line_f)
        widths = np.append(damping, np.zeros(len(line_f)))
        locked_to = phase_evidence(
            record.unclipped, every, widths, running + [True] * len(line_f)
        )
        both = zip(unsteady, locked_to[: f.size], strict=True)
        unsteady = tuple(own or other for own, other in both)
    remainders = line_remainders(
        f, damping, np.array(record.places), record.good.duration
    )
    orders = near_harmonics(record.machines, f)
    # after their removal a pole that a machine leaves is as wide as its speed wanders, and half of
    # the width of a normal distribution is 1.18 of its deviation
    away = np.maximum(orders.distance, damping - 2 * of.std_damping)
    left = away < 1.18 * orders.wander
    out: list[Note | None] = []
    for k, (x, z) in enumerate(zip(f.tolist(), damping.tolist(), strict=True)):
        line = on_line[k]
        found: tuple[str, dict[str, float | str]] | None = None
        if line:
            found = "candidate line", {"why": line.why, "line": line.frequency}
        elif left[k]:
            speed = record.machines[orders.machine[k]].frequency
            found = (
                "candidate harmonic",
                {"order": int(orders.order[k]), "speed": speed},
            )
        elif (
            facts.interval and facts.impacts.lines_near(x) and z < 3 * of.std_damping[k]
        ):
            found = "candidate impacts", {}
        elif remainders[k]:
            found = "candidate remainder", {"line": remainders[k]}
        elif unsteady[k]:
            found = "candidate steady", {"why": unsteady[k]}
        elif z < 5e-4:  # below what structures have in operation (welded steel: 0.1 %)
            found = "candidate undamped", {"damping": 100 * z}
        out.append(_doubt(found[0], x, found[1]) if found else None)
    return out
