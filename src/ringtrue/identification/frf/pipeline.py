"""Modes from FRFs in one call: bands, poles, residues, refinement, confidence of each mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, FrozenArrays
from ringtrue.core.choice import Choice
from ringtrue.core.iterate import Outcome, Progress, quiet
from ringtrue.core.modes import ModalModel, ModeSet, Norm, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.identification.common.manual_selection import hand_poles, with_evidence
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram
from ringtrue.identification.frf.confidence import (
    Assessment,
    CandidatePoles,
    DroppedPole,
    as_other_candidates,
    assess_candidates,
    doubtful_candidates,
    dropped,
)
from ringtrue.identification.frf.data_checks import (
    band_limits,
    block_of_noise,
    disagreement_note,
    end_note,
    fit_notes,
    frf_notes,
    hann_note,
    incoherent_responses,
    late_channels,
    lines_between,
    looks_faded,
    odd_channel,
    refuse_bad_frfs,
    sound_pairs,
)
from ringtrue.identification.frf.lines import (
    Lines,
    Noise,
    cmif,
    prepare,
    smooth_rest,
    without,
)
from ringtrue.identification.frf.plscf import band_candidates, choose_bands, merged
from ringtrue.identification.frf.refinement import Refined, refine, shape_deviations
from ringtrue.identification.frf.residues import (
    DrivingPoints,
    blow_factors,
    lsfd,
    noise,
    noise_left,
    synthesise_windowed,
)
from ringtrue.identification.frf.scaling import (
    mode_scale,
    reciprocity_note,
    scale_deviations,
)
from ringtrue.identification.frf.split_modes import (
    joined,
    levelled,
    missed,
    scattered,
    split_modes,
    split_note,
    support,
    twins,
    united,
)
from ringtrue.signal.frf_sets import exchange_by_reciprocity


@dataclass(frozen=True, slots=True)
class FitLimits:
    """How often modes are fitted, and when another model is better.

    Attributes
    ----------
    turns : int
        Most turns of assessment and refinement while modes may be missing.
    iterations : int
        Of the last refinement: modes that overlap take their time.
    ringing : int
        Turns of weights where responses ring on: a coherence takes for noise what does, and the fit
        explains it.
    new : int
        Most candidates of one search for missed modes.
    hann : float
        Of the misfit, that blocks of noise under a Hann window leave as such, if they are.
    split : float
        Times the misfit: of responses that disagree about modes, a mode for each with a pole of its
        own.
    memory : float, bytes
    """

    turns: int = 6
    iterations: int = 60
    ringing: int = 6
    new: int = 6
    hann: float = 0.95
    split: float = 1.05
    memory: float = 2e9


LIMITS = FitLimits()
PAIR = "one of two modes of one frequency: any turn of the two shapes in their plane fits as well"


@dataclass(frozen=True, slots=True)
class HammerModes:
    """Settings of `identify_hammer`.

    Attributes
    ----------
    fmin, fmax : float, Hz, optional
        The modes to report; by default all up to where the FRFs are noise. Lines just outside are
        used where there are such.
    damping_max : float
        Largest damping ratio of a mode.
    confidence_min : float
        Modes below are left out.
    searches : int
        Times to look for missed modes in what the fit leaves.
    """

    fmin: float | None = None
    fmax: float | None = None
    damping_max: float = 0.5
    confidence_min: float = 0.5
    searches: int = 10


@dataclass(frozen=True, slots=True, eq=False)
class HammerResult(FrozenArrays):
    """What `identify_hammer` found.

    Attributes
    ----------
    model : ModalModel
        All poles of the fit, those just outside the reported band too; damping without the
        exponential window.
    modes : ModeSet
        The reported modes, complex shapes, unit modal mass where a driving point was measured.
    uncertainty : Uncertainty
        Of `modes`.
    reasons : tuple of str
        The evidence for and against each mode.
    others : OtherCandidates
        Doubtful modes: candidates of little confidence, with the evidence.
    diagrams : tuple of StableDiagram
        One a band; `cluster` counts the candidates of that band.
    freqs : (f,) float64, Hz
        Lines that were fitted.
    cmif : (f, in) float64
        Singular values of the FRF matrix at those lines, descending.
    synthesis_error : (out, in) float64
        ‖H − H_fit‖/‖H‖ over the lines of the reported band.
    notes : tuple of str
        What the reader should know of the FRFs and of a choice by hand.
    split_note : str
        That of the notes which says so; empty where they agree.
    channel_notes : tuple of Note
        On responses that do not follow the force.
    """

    model: ModalModel
    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    others: OtherCandidates
    diagrams: tuple[StableDiagram, ...]
    freqs: Float
    cmif: Float
    synthesis_error: Float
    notes: tuple[str, ...] = ()
    split_note: str = ""
    channel_notes: tuple[Note, ...] = ()


def identify_hammer(
    frfs: FrfSet,
    settings: HammerModes | None = None,
    *,
    choice: Choice | None = None,
    progress: Progress = quiet,
) -> HammerResult:
    """Modes from frequency response functions, automatically.

    pLSCF of many orders in several overlapping bands; poles that stay in place over the orders
    become candidates; one global LSFD gives their shapes; weighted nonlinear least squares refines
    all of them together; modes that add nothing, double another one or cannot be distinguished from
    noise are left out.

    Parameters
    ----------
    frfs : FrfSet
        Of a roving hammer, with fewer responses than references, shapes are at the points struck,
        by reciprocity.
    settings : HammerModes, optional
    choice : Choice, optional
        What a person decided on the modes; the poles picked are refined together with the others.
    progress : callable (fraction, text)

    Raises
    ------
    DataError
        If there are fewer than 32 lines in the band, the FRFs are no FRFs, or no mode is found.
    """
    settings = settings or HammerModes()
    refuse_bad_frfs(frfs)
    frfs, roving = exchange_by_reciprocity(frfs)
    low, high = band_limits(frfs, settings.fmin, settings.fmax)
    # the refinement sees lines outside the band: a mode left out at its ends would be patched up
    # by broad terms inside
    used = lines_between(frfs, 0.8 * low, 1.25 * high)
    sigma = noise(used)
    curve = cmif(used.data / sigma.response[:, None])
    candidates, diagrams = _candidates(used, sigma, curve, settings, progress)
    if not candidates.pole.size:
        raise DataError(
            f"{frfs.source}: no pole is stable over the orders between {low:g} and {high:g} Hz"
        )
    if 16 * 6 * candidates.pole.size * used.freqs.size > LIMITS.memory:
        raise DataError(
            f"{frfs.source}: {candidates.pole.size} candidates on {used.freqs.size} lines are "
            "too many; narrow the band with fmin, fmax"
        )
    progress(0.65, f"residues of {candidates.pole.size} candidates")
    search = _Fitter(
        lines=prepare(used, sigma),
        points=sound_pairs(used),
        settings=settings,
        sets=[diagram.poles for diagram in diagrams],
        decay=used.window_decay,
        source=frfs.source,
    )
    fit, left_out = _fit(search, candidates, progress)
    used, search, fit, faded = _of_blocks(used, search, fit)
    progress(0.95, "confidence and standard deviations of the modes")
    search, fit, more = _reweighed(search, used, fit)
    left_out += more
    search, fit, split = _whole(search, fit)
    refined = fit.refined
    doubtful = doubtful_candidates(
        left_out, refined.frequencies, refined.shapes, (low, high)
    )
    by_hand: tuple[str, ...] = ()
    if choice:
        fit, doubtful, by_hand = _by_hand(search, fit, doubtful, choice, (low, high))
    modes = _reported(used, search, fit, (low, high))
    reported = lines_between(used, low, high)
    broken = reciprocity_note(modes.model, search.points)
    notes = [
        roving,
        end_note(frfs, settings.fmax, high),
        faded,
        *frf_notes(reported, search.points),
        broken or modes.scale_note,
        *fit_notes(reported, modes.modes, modes.error),
        *late_channels(modes.modes),
        split,
        odd_channel(used, fit.refined.poles),
        disagreement_note(modes.model),
        *by_hand,
    ]
    return HammerResult(
        model=modes.model,
        modes=modes.modes,
        uncertainty=modes.uncertainty,
        reasons=modes.reasons,
        others=as_other_candidates(doubtful, modes.modes),
        diagrams=diagrams,
        freqs=used.freqs,
        cmif=curve,
        synthesis_error=modes.error,
        notes=tuple(note for note in notes if note),
        split_note=split,
        channel_notes=incoherent_responses(reported),
    )


def _candidates(
    used: FrfSet, sigma: Noise, curve: Float, settings: HammerModes, progress: Progress
) -> tuple[CandidatePoles, tuple[StableDiagram, ...]]:
    """Stable poles of all bands, and the diagram of each band."""
    bands = choose_bands(used.freqs, curve)
    found = []
    diagrams = []
    for k, band in enumerate(bands):
        progress(
            0.05 + 0.55 * k / len(bands), f"poles in {band[0]:.3g}-{band[1]:.3g} Hz"
        )
        clusters, diagram = band_candidates(
            used, sigma, curve=curve, band=band, damping_max=settings.damping_max
        )
        found.append(clusters)
        diagrams.append(diagram)
    return merged(found, used.freqs, used.window_decay), tuple(diagrams)


@dataclass(frozen=True, slots=True, eq=False)
class _Assessed:
    refined: Refined
    candidates: CandidatePoles
    assessment: Assessment


@dataclass(frozen=True, slots=True, eq=False)
class _Fitter:
    """What every turn of the fit needs."""

    lines: Lines
    points: DrivingPoints
    settings: HammerModes
    sets: Sequence[PoleSet]
    decay: float
    source: str
    last: bool = False  # deviations are those that will be stated

    def refined(self, c: CandidatePoles) -> _Assessed:
        """The candidates refined; not assessed yet."""
        fit = united(
            self.lines,
            refine(self.lines, c.pole, c.participation, local=self.last),
            self.points,
        )
        return _Assessed(
            fit, c, Assessment(np.abs(c.pole), np.ones(c.pole.size), (), ())
        )

    def assessed(self, fit: _Assessed, *, strict: bool) -> _Assessed:
        """The fit with the confidence of its modes."""
        r = fit.refined
        held = support(r.poles, r.participation, self.sets, self.decay)
        held = held if strict else np.maximum(held, fit.candidates.support)
        c = replace(fit.candidates.at(r), support=held)
        assessment = assess_candidates(
            self.lines, r, c, damping_max=self.settings.damping_max, strict=strict
        )
        return _Assessed(r, c, assessment)

    def pruned(
        self, fit: _Assessed, turns: int, *, strict: bool
    ) -> tuple[_Assessed, list[DroppedPole]]:
        """Assessment and refinement in turns, until no mode is dropped."""
        left_out: list[DroppedPole] = []
        for _ in range(turns):
            fit = self.assessed(fit, strict=strict)
            keep = fit.assessment.confidence >= self.settings.confidence_min
            if keep.all():
                break
            gone = np.flatnonzero(~keep).tolist()
            left_out += [dropped(fit.refined, fit.assessment, k, keep) for k in gone]
            if not keep.any():
                last = "; ".join(fit.assessment.describe(k) for k in gone[-3:])
                raise DataError(
                    f"{self.source}: no mode has enough confidence; the last: {last}"
                )
            fit = self.refined(fit.candidates.take(keep))
        return fit, left_out


def _fit(
    search: _Fitter, start: CandidatePoles, tell: Progress
) -> tuple[_Assessed, list[DroppedPole]]:
    """Refine and prune; then look for modes in what is left over, until none comes to stay."""
    lines = search.lines
    settings = search.settings
    best, left_out = search.pruned(search.refined(start), LIMITS.turns, strict=False)
    for turn in range(settings.searches):
        tell(
            0.7 + 0.25 * turn / settings.searches,
            f"{best.refined.poles.size} modes, looking for missed ones",
        )
        more = missed(
            lines, best.refined, sets=search.sets, decay=search.decay, most=LIMITS.new
        )
        if not more.pole.size:
            break
        both = best.candidates.at(best.refined).joined(more)
        new, why = search.pruned(search.refined(both), LIMITS.turns, strict=False)
        left_out += why
        if (
            new.refined.poles.size < best.refined.poles.size
            or new.refined.cost > 0.99 * best.refined.cost
        ):
            break
        best = new
    # modes that overlap take their time
    if best.refined.outcome is Outcome.MAX_ITERATIONS:
        r = best.refined
        last = refine(lines, r.poles, r.participation, iterations=LIMITS.iterations)
        best = replace(best, refined=united(lines, last, search.points))
    # every turn but the last drops a mode
    best, why = search.pruned(best, best.refined.poles.size + 1, strict=True)
    return best, left_out + why


def _of_blocks(
    frfs: FrfSet, search: _Fitter, fit: _Assessed
) -> tuple[FrfSet, _Fitter, _Assessed, str]:
    """The fit of FRFs that blocks of noise under a Hann window explain better, with a note; else as
    it is.
    """
    length = block_of_noise(frfs)
    r = fit.refined
    trial = replace(search, lines=replace(search.lines, hann=length))
    if not length or not looks_faded(search.lines, r, length):
        return frfs, search, fit, ""
    new = trial.refined(fit.candidates.at(r))
    if new.refined.cost > LIMITS.hann * r.cost:
        return frfs, search, fit, ""
    return (
        replace(frfs, hann=length),
        trial,
        trial.assessed(new, strict=True),
        hann_note(r.poles, new.refined.poles),
    )


def _reweighed(
    search: _Fitter, frfs: FrfSet, fit: _Assessed
) -> tuple[_Fitter, _Assessed, list[DroppedPole]]:
    """The modes refined once more, every line weighed by what the first fit left there: deviations
    rest on that.

    Where responses ring on, in turns, until no frequency moves by a tenth of its deviation.
    """
    left_out: list[DroppedPole] = []
    for _ in range(1 if np.isinf(frfs.kept) else LIMITS.ringing):
        r = fit.refined
        basis = smooth_rest(search.lines, r.poles, r.known.rest)
        left = noise_left(search.lines, without(basis, r.known.rest))
        smooth = max(search.lines.smooth.shape[1], basis.shape[1])
        search = replace(search, lines=prepare(frfs, left, smooth), last=True)
        start = search.refined(fit.candidates.at(r))
        fit, why = search.pruned(start, r.poles.size + 1, strict=True)
        left_out += why
        now = fit.refined
        if now.poles.size == r.poles.size:
            moved = np.abs(now.frequencies - r.frequencies)
            if (moved < 0.1 * now.std_frequency).all():
                break
    return search, fit, left_out


def _whole(search: _Fitter, fit: _Assessed) -> tuple[_Fitter, _Assessed, str]:
    """The fit with one mode for each that it shows twice since the FRFs disagree, and a note on
    that.
    """
    split = split_modes(search.lines, fit.refined)
    if not split:
        return search, fit, ""
    level = replace(search, lines=levelled(search.lines, split))
    new = level.refined(joined(search.lines, fit.candidates, split))
    # modes that overlap: as one mode they fit no longer
    if new.refined.cost > LIMITS.split * fit.refined.cost:
        return search, fit, ""
    refined = scattered(search.lines, fit.refined, new.refined, split)
    return (
        level,
        level.assessed(replace(new, refined=refined), strict=True),
        split_note(refined, len(split)),
    )


def _by_hand(
    search: _Fitter,
    fit: _Assessed,
    doubtful: list[DroppedPole],
    choice: Choice,
    band: tuple[float, float],
) -> tuple[_Assessed, list[DroppedPole], tuple[str, ...]]:
    """The fit after a choice, refined anew where it changes the modes, of which none is dropped;
    the doubtful modes that are left, and notes.
    """
    hand = hand_poles(
        fit.refined,
        search.sets,
        choice,
        band,
        decay=search.decay,
        doubtful=doubtful,
    )
    if hand.changes:
        both = fit.candidates.at(fit.refined).joined(hand.added)
        keep = np.append(hand.keep, np.ones(hand.added.pole.size, dtype=bool))
        if not keep.any():
            raise DataError(
                f"{search.source}: the choice {choice.source} leaves no mode"
            )
        fit = search.assessed(search.refined(both.take(keep)), strict=True)
    each = zip(hand.said, fit.assessment.reason, strict=True)
    reasons = tuple(with_evidence(said, evidence) for said, evidence in each)
    left = [d for k, d in enumerate(doubtful) if k not in hand.taken]
    return (
        replace(fit, assessment=replace(fit.assessment, reason=reasons)),
        left,
        hand.notes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Reported:
    """The modes to report, and the model of all poles of the fit."""

    model: ModalModel
    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    error: Float
    scale_note: str


def _reported(
    frfs: FrfSet, search: _Fitter, fit: _Assessed, band: tuple[float, float]
) -> _Reported:
    """Scaled modes in the band with their standard deviations."""
    lines = search.lines
    points = search.points
    refined = fit.refined
    model = lsfd(
        frfs,
        lines,
        refined.poles,
        refined.participation,
        shapes=refined.shapes,
        points=points,
    )
    f = model.frequencies
    order = np.argsort(f, kind="stable")
    inside = order[(f[order] >= band[0]) & (f[order] <= band[1])]
    shapes = model.shapes * mode_scale(model)
    modes = ModeSet(
        frequencies=f[inside],
        damping=model.damping[inside],
        shapes=shapes[:, inside],
        labels=tuple(c.id for c in frfs.outputs),
        norm=Norm.UNSCALED if model.norm is Norm.UNSCALED else Norm.MASS,
        source=frfs.source or "hammer FRFs, pLSCF",
        confidence=fit.assessment.confidence[inside],
    )
    heard, driven = blow_factors(lines, refined.poles)
    own = replace(
        refined,
        shapes=refined.shapes / heard,
        participation=refined.participation / driven,
    )
    size = np.abs(shapes)
    deviation = shape_deviations(lines, own, points) * size
    repeated = twins(refined.poles)
    for i, j in repeated:  # any turn in their plane is as good
        deviation[:, [i, j]] = np.hypot(
            deviation[:, [i, j]], size[:, [j, i]] / np.sqrt(2)
        )
    fitted = synthesise_windowed(model, lines)
    scale, scale_note = scale_deviations(frfs, fitted, own, points)
    deviation = np.hypot(deviation, size * scale)
    std = Uncertainty(own.std_frequency, own.std_damping, deviation, own.factor)
    at = (frfs.freqs >= band[0]) & (frfs.freqs <= band[1])
    measured = np.linalg.norm(frfs.data[at], axis=0)
    error = np.linalg.norm(frfs.data[at] - fitted[at], axis=0) / np.maximum(
        measured, 1e-300
    )
    pairs_of_modes = {k for both in repeated for k in both}
    reasons = []
    for k in inside.tolist():
        pair = f"; {PAIR}" if k in pairs_of_modes else ""
        reasons.append(fit.assessment.reason[k] + pair)
    return _Reported(
        model=model,
        modes=modes,
        uncertainty=std.take(inside),
        reasons=tuple(reasons),
        error=error,
        scale_note=scale_note,
    )
