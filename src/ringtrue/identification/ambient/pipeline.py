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
    reason,
    select,
    surer_groups,
    uncertainty,
)
from ringtrue.identification.ambient.manual_selection import chosen
from ringtrue.identification.ambient.record_bands import (
    SHORTEST,
    STEP,
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
from ringtrue.signal.gaps import bridge_gaps
from ringtrue.signal.harmonic_evidence import amplitude_evidence, phase_evidence
from ringtrue.signal.tonal_lines import Harmonic, harmonics, remove_tonal_lines, unsteady_lines

LEAST_DAMPING = 5e-4  # below what structures have in operation (welded steel: 0.1 %)
LEAST_FALL = 0.1  # of the logarithm of the amplitude, from one impact to the next
HARDLY_FALLS = (
    "it hardly decays between impacts at equal intervals: a line of these; a longer "
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
        low, high = self.fmin or 0.0, self.fmax or np.inf
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
        Why each mode is believed.
    harmonics : tuple of Harmonic
        Lines of machines, left out.
    notes : tuple of str
        What the reader should know: bad channels, left-out poles, nothing found.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    diagrams: tuple[StableDiagram, ...]
    reasons: tuple[str, ...]
    harmonics: tuple[Harmonic, ...]
    notes: tuple[str, ...]


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
        something behind where no mode stands are not either: it would pull at the modes beside it.

    Raises
    ------
    DataError
        If no channel is usable, the first stretch is too short or a channel fails later.
    ConfigError
        If the band of interest is empty.
    """
    settings = settings or AmbientSettings()
    tell = progress or quiet
    coming = iter(stretches)
    if (first := next(coming, None)) is None:
        raise DataError("no stretch of a record to identify")
    coming = (x for x in coming if x.duration >= SHORTEST * first.duration)
    second = next(coming, None)
    part, gaps = bridge_gaps(first)
    raw, states = usable(part)
    kept = unclipped_channels(raw, states)  # of raw samples: they tell what is cut off
    good = remove_drift(raw, lowest(raw.duration, settings))
    factor = unit_factor(good)
    good, late = in_phase(scaled(good, factor), mend=second is None)
    refs = references(good, settings.references)
    bands = long_enough(bands_for(good.rate, good.duration, settings), good)
    tell(0.0, "filtering into bands")
    # an amplitude that is cut off looks steady
    whole = good if kept is raw else kept and good.pick([c.id for c in kept.channels])
    impacts, lags = events_of(good, gaps), 2 * settings.block_rows / bands[0].rate
    good, whole, swept, echo = without_strokes_sweeps_and_echoes(good, whole, impacts, lags)
    sines = steady_sines(good, whole, bands, leave, impacts, once=second is not None)
    places = [h.frequency for h in sines]
    clean = remove_tonal_lines(good, places)
    whole, good = clean if whole is good else whole and remove_tonal_lines(whole, places), clean
    shown = harmonics(whole, low=bands[-1].low) if whole and not impacts.driven else ()
    lines = tuple(h for h in shown if h.frequency < bands[0].high)
    ssi = SsiCov(
        settings.block_rows, settings.order_max, blocks=0 if second is None else BLOCKS_EACH
    )
    more_to_come = (scaled(x, factor) for x in chain(() if second is None else (second,), coming))
    sums, heard = sums_of_stretches(good, gaps, more_to_come, bands, ssi, refs, places, tell)
    found, motion = [], one_motion(good.channels)
    known = RecordFacts(response_slope(good), choice, max(heard, key=lambda e: e.share), motion)
    for k, modes_of in enumerate(
        map_in_threads(lambda x: modes_of_band(x, settings.confidence_min, known), sums)
    ):
        tell((k + 1) / (len(bands) + 2), f"identified {bands[k].low:.3g} .. {bands[k].high:.3g} Hz")
        found.append(modes_of)
    looks, tries = [], settings.order_max // ssi.order_step
    for k, (x, own) in enumerate(zip(sums, found, strict=True)):
        if less := with_fewer_lags(x, fastest_decay(own.table, tries)):
            looks.append((k, less))
        if second is None and not known.driven and dense_set(own.table, tries, x.seconds):
            looks.append((k, with_more_lags(good, gaps, bands[: k + 1], ssi, refs)))
    again = map_in_threads(
        lambda x: modes_of_band(x[1], settings.confidence_min, replace(known, choice=None)), looks
    )
    for (k, _), other in zip(looks, again, strict=True):
        found[k], other = surer_groups(found[k], other, settings.confidence_min)
        found.append(other)
    found = [with_echo_doubt(x, echo) for x in found] if echo else found
    result = _assemble(good, found, lines, places, bands, settings, known, whole)
    if whole is not good:
        sound = {c.id for c in whole.channels} if whole else set()
        clipped = np.array([c.id not in sound for c in good.channels])
        modes, reasons = overtones(
            result.modes, result.uncertainty.frequency, result.reasons, clipped
        )
        result = replace(result, modes=modes, reasons=reasons)
    if second is None and (unsteady := unexplained(result.modes, unsteady_lines(good, places))):
        return identify_stretches(
            (first,), settings, choice=choice, progress=progress, leave=(*leave, *unsteady)
        )
    result = replace(result, harmonics=(*sines, *result.harmonics))
    tell(1.0, f"{len(result.modes)} modes")
    notes = gaps.notes + tuple(s.note for s in states) + late + swept
    if whole is None:
        notes += ("every channel is clipped: machines are not told from modes",)
    if motion:
        notes += (f"channels of different kinds: shapes are those of {motion.kind} in all",)
    noisy = noisy_channels(
        [c.id for c in good.channels], result.modes.shapes, result.uncertainty.shape
    )
    return replace(result, notes=notes + noisy + event_notes(heard) + result.notes)


def _assemble(
    history: TimeHistory,
    found: list[BandModes],
    lines: tuple[Harmonic, ...],
    gone: list[float],
    bands: tuple[Band, ...],
    settings: AmbientSettings,
    heard: RecordFacts,
    whole: TimeHistory | None,
) -> AmbientResult:
    resolution = (
        61 * 4 / history.duration
    )  # main lobe of the window of `harmonics` in 120 half-overlapped segments
    at, left_out = [], []
    rows = select(found, settings.confidence_min)
    f_all, z_all = (
        np.array([getattr(found[b].table, x)[i] for b, i in rows])
        for x in ("frequencies", "damping")
    )
    known = [h.frequency for h in lines]
    machines = (
        amplitude_evidence(whole, f_all, z_all, known, heard.interval)
        if whole
        else ("",) * len(rows)
    )
    edges = filter_edges(history, f_all, z_all)
    standing = [
        machine(f, z, lines, resolution, history.duration)
        for f, z in zip(f_all, z_all, strict=True)
    ]
    running = [bool(h or why) for h, why in zip(standing, machines, strict=True)]
    if whole and not heard.driven:
        every, wide = np.append(f_all, known), np.append(z_all, np.zeros(len(known)))
        kin = phase_evidence(whole, every, wide, running + [True] * len(known))
        machines = tuple(x or y for x, y in zip(machines, kin[: len(rows)], strict=True))
    left = line_remainders(f_all, z_all, np.array(gone), history.duration)
    for (b, i), f, z, h, unsteady, edge, foot in zip(
        rows, f_all, z_all, standing, machines, edges, left, strict=True
    ):
        if h:
            left_out.append(f"pole at {f:.4g} Hz left out: {h.why}{BESIDE}")
        elif z < LEAST_DAMPING:
            left_out.append(
                f"pole at {f:.4g} Hz left out: damping {100 * z:.2g} % is a line, not a structure"
            )
        elif (
            heard.interval
            and heard.impacts.lines_near(f)
            and 2 * np.pi * z * f * heard.interval < LEAST_FALL
        ):
            left_out.append(f"pole at {f:.4g} Hz left out: {HARDLY_FALLS}")
        elif foot:
            left_out.append(
                f"pole at {f:.4g} Hz left out: what the line at {foot:.5g} Hz left whose phase "
                f"wanders{HIDES}"
            )
        elif unsteady:
            left_out.append(f"pole at {f:.4g} Hz left out: {unsteady}{HIDES}")
        elif edge:
            left_out.append(f"pole at {f:.4g} Hz {AT_EDGE}")
        else:
            at.append((b, i))
    at, forced = without_forced(found, at)
    left_out += forced
    by_hand = chosen(found, at, heard.choice, history.source)
    found, at = by_hand.found, by_hand.rows
    left_out += by_hand.notes
    told = np.array([found[b].table.frequencies[i] for b, i in at] + known)
    left_out += [*unresolved(found, told), *unconfirmed(found, np.append(told, f_all))]
    shapes = [found[b].shape[:, i] for b, i in at]
    modes = ModeSet(
        np.array([found[b].table.frequencies[i] for b, i in at]),
        np.array([found[b].table.damping[i] for b, i in at]),
        np.stack(shapes, axis=1) if at else np.empty((len(history.channels), 0), np.complex128),
        tuple(c.id for c in history.channels),
        source=f"{history.source or 'record'}: SSI-cov",
        confidence=np.array([found[b].confidence[i] for b, i in at]),
    )
    return AmbientResult(
        modes,
        uncertainty(found, at, len(history.channels)),
        tuple(x.diagram for x in found[: len(bands)]),
        tuple(
            "; ".join(filter(None, (by_hand.said.get((b, i)), reason(found[b], i)))) for b, i in at
        ),
        lines,
        tuple(with_nothing_found(history, left_out, len(at), bands)),
    )
