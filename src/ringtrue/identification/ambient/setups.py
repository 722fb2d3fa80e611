"""Modes of a structure from several setups: some sensors stay in place, the others move.

Two ways to the poles. PoSER (Döhler, Andersen and Mevel 2010): each setup is identified by itself,
and their modes are merged. PreGER (Mevel, Basseville, Benveniste and Goursat 2002): the references
of all setups, scaled to equal levels, are one record with pauses, which is identified. The shapes
are then read from every setup.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.channels import SHOWN
from ringtrue.core.choice import Choice
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import (
    ModeClass,
    ModeSet,
    OtherCandidates,
    Uncertainty,
    joined_modes,
)
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.confidence import DOUBTS, LIMITS
from ringtrue.identification.ambient.pipeline import (
    AmbientResult,
    AmbientSettings,
    identify_stretches,
    modes_of_record,
    weighed_candidates,
)
from ringtrue.identification.ambient.shape_reading import (
    RecordCorrelations,
    with_joined_shapes,
)
from ringtrue.identification.common.manual_selection import (
    chosen_of_setups,
    with_evidence,
)
from ringtrue.identification.common.merging import Merged, merge_modes
from ringtrue.identification.common.stabilisation import StableDiagram

MergeMethod = Literal["poser", "preger"]


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedSetup:
    """One setup: its modes, and what shapes are read from.

    Attributes
    ----------
    name : str
    result : AmbientResult
    correlations : RecordCorrelations
    """

    name: str
    result: AmbientResult
    correlations: RecordCorrelations


@dataclass(frozen=True, slots=True, eq=False)
class SetupsResult:
    """Modes of several setups.

    Attributes
    ----------
    modes : ModeSet
        Shapes on the channels of all setups; the confidence is the mean over the setups.
    uncertainty : Uncertainty
    reasons, remarks : tuple of str
        One a mode.
    others : OtherCandidates
        What too few setups show, and harmonics.
    notes : tuple of str
    setups : tuple of str
        Names.
    frequency, damping : (setup, m) float64
        Of each mode by each setup, Hz and fraction of critical; NaN where it did not find it.
    diagrams : tuple of StableDiagram
        Poles of all setups, or those of the references.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]
    others: OtherCandidates
    notes: tuple[str, ...]
    setups: tuple[str, ...]
    frequency: Float
    damping: Float
    diagrams: tuple[StableDiagram, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _AllCandidates:
    """Natural, doubtful and harmonic candidates of a setup in one list.

    Attributes
    ----------
    modes : ModeSet
        The confidence is 0 where physical evidence speaks against a candidate.
    uncertainty : Uncertainty
    kinds : tuple of {"natural", "doubtful", "harmonic"}
    against : tuple of Note or None
        That evidence.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    kinds: tuple[ModeClass, ...]
    against: tuple[Note | None, ...]

    @classmethod
    def of(cls, result: AmbientResult) -> _AllCandidates:
        others = result.others
        weak = np.array([note.code in DOUBTS for note in others.notes], dtype=np.bool_)
        counted = replace(
            others.modes, confidence=np.where(weak, others.modes.confidence, 0.0)
        )
        modes, std = joined_modes(
            [(result.modes, result.uncertainty), (counted, others.uncertainty)]
        )
        natural: list[ModeClass] = ["natural"] * len(result.modes)
        physical = [None if note.code in DOUBTS else note for note in others.notes]
        return cls(
            modes,
            std,
            (*natural, *others.classes),
            (*[None] * len(result.modes), *physical),
        )


def identified_setup(
    stretches: Iterable[TimeHistory],
    settings: AmbientSettings,
    name: str,
    choice: Choice | None = None,
) -> IdentifiedSetup:
    """One setup by itself, as `identify_stretches` does it."""
    weighed = weighed_candidates(stretches, settings, choice, quiet)
    result = modes_of_record(weighed, settings, quiet)
    return IdentifiedSetup(name, result, RecordCorrelations.of(weighed))


def identify_setups(
    histories: Iterable[TimeHistory],
    settings: AmbientSettings | None = None,
    *,
    references: Sequence[str] = (),
    merge: MergeMethod = "poser",
    choice: Choice | None = None,
    progress: Progress = quiet,
) -> SetupsResult:
    """Modes of a structure in operation from records of several setups.

    Parameters
    ----------
    histories : iterable of TimeHistory
        One a setup; channels of one id measure the same, and `source` names the setup.
    settings : AmbientSettings
    references : sequence of str
        Channels of all setups that scale them to one another; without, all that they have in
        common.
    merge : {"poser", "preger"}
    choice : Choice, optional
        What a person decided on the modes of all setups.
    progress : callable (fraction, text)

    Raises
    ------
    DataError
        If there are fewer than two setups, one shares no channel with the others, or a pick means
        no candidate.
    """
    settings = settings or AmbientSettings()
    setups: list[IdentifiedSetup] = []
    kept: list[TimeHistory] = []
    for history in histories:
        progress(0.0, f"setup {len(setups) + 1}: {history.source}")
        setups.append(identified_setup((history,), settings, history.source))
        if merge == "preger":
            kept.append(history.pick(references) if references else history)
    _refuse_unconnected(setups, references)
    found = [_AllCandidates.of(x.result) for x in setups]
    records = [
        (c.modes, c.uncertainty, x.name) for c, x in zip(found, setups, strict=True)
    ]
    readers = [x.correlations for x in setups]
    said: list[str] = []
    by_hand: Sequence[str] = ()
    if merge == "poser":
        merged = merge_modes(records)
        members = _members(merged, setups)
        joint = _joint_confidence(members, found)
        kinds = _kinds(members, found, joint, settings.confidence_min)
        keep = np.array([kind == "natural" for kind in kinds], dtype=np.bool_)
        if choice:
            std = merged.uncertainty.frequency
            keep, said, by_hand = chosen_of_setups(
                merged.modes.frequencies, std, keep, choice
            )
            kinds = [
                None if there else kind for there, kind in zip(keep, kinds, strict=True)
            ]
        natural = np.flatnonzero(keep)
        merged = with_joined_shapes(merged, records, readers, natural, references)
        others = _others(merged, members, found, joint, kinds)
        diagrams = _diagrams(setups)
    else:
        of_references = _of_references(kept, settings, choice, progress)
        by_hand = of_references.record_notes if choice else ()
        merged = _at_poles_of(of_references, records)
        joint = of_references.modes.confidence
        natural = np.arange(len(of_references.modes))
        merged = with_joined_shapes(merged, records, readers, natural, references)
        others = _on_channels(of_references.others, merged.modes.channels)
        diagrams = of_references.diagrams
    members = _members(merged, setups)[:, natural]
    frequency, damping = _by_setup(members, found)
    modes = merged.modes.take(natural)
    remarks = []
    reasons = []
    for k, of_mode, of_damping in zip(
        natural.tolist(), frequency.T, damping.T, strict=True
    ):
        count, spread = _scatter(of_mode)
        hand = said[k] if said else ""
        remarks.append(hand or f"{count}/{len(setups)} setups, f ±{spread:.2g} %")
        reasons.append(with_evidence(hand, _reason(of_mode, of_damping)))
    return SetupsResult(
        modes=replace(
            modes, confidence=joint[natural], source=f"{len(setups)} setups: SSI-cov"
        ),
        uncertainty=merged.uncertainty.take(natural),
        reasons=tuple(reasons),
        remarks=tuple(remarks),
        others=others,
        notes=(*_notes(setups), *merged.notes, *by_hand),
        setups=tuple(x.name for x in setups),
        frequency=frequency,
        damping=damping,
        diagrams=diagrams,
    )


def _diagrams(setups: Sequence[IdentifiedSetup]) -> tuple[StableDiagram, ...]:
    """Of all setups; the mean level over those that have the same bands stands behind the poles."""
    first, *others = (x.result.diagrams for x in setups)
    equal = [own for own in others if len(own) == len(first)]
    out = []
    for k, d in enumerate(first):
        levels = [d.level]
        for own in equal:
            levels.append(
                np.stack([np.interp(d.freqs, own[k].freqs, x) for x in own[k].level])
            )
        rows = min(len(x) for x in levels)
        out.append(replace(d, level=np.mean([x[:rows] for x in levels], axis=0)))
    none = np.empty(0)
    return (
        *out,
        *(replace(d, freqs=none, level=none[None]) for own in others for d in own),
    )


def _refuse_unconnected(
    setups: Sequence[IdentifiedSetup], references: Sequence[str]
) -> None:
    if len(setups) < 2:
        raise DataError(f"setups: two or more are needed, got {len(setups)}")
    for k, setup in enumerate(setups):
        own = set(setup.correlations.channels)
        if references:
            own &= set(references)
        others = {
            c for i, x in enumerate(setups) if i != k for c in x.correlations.channels
        }
        if not own & others:
            raise DataError(
                f"{setup.name}: none of its channels is in another setup, so that its shapes have "
                "no scale: at least one reference sensor must stay in place"
            )


def _of_references(
    histories: Sequence[TimeHistory],
    settings: AmbientSettings,
    choice: Choice | None,
    progress: Progress,
) -> AmbientResult:
    """The channels of all setups, at equal levels, identified as one record with pauses."""
    ids = [
        c.id
        for c in histories[0].channels
        if all(c.id in [d.id for d in x.channels] for x in histories)
    ]
    if not ids:
        raise DataError("merge preger: no channel is in all setups; take poser")
    parts = []
    for history in histories:
        part = history.pick(ids)
        level = np.sqrt(np.nanmean(np.nanvar(part.data, axis=1)))
        parts.append(replace(part, data=part.data / level))
    return identify_stretches(parts, settings, choice=choice, progress=progress)


def _on_channels(others: OtherCandidates, channels: tuple[str, ...]) -> OtherCandidates:
    """Candidates of the references on the channels of all setups: NaN where they were not read."""
    at = [channels.index(c) for c in others.modes.channels]
    shapes = np.full((len(channels), len(others)), np.nan, dtype=np.complex128)
    std = np.full(shapes.shape, np.nan)
    shapes[at] = others.modes.shapes
    std[at] = others.uncertainty.shape
    modes = replace(others.modes, shapes=shapes, labels=channels)
    return replace(
        others, modes=modes, uncertainty=replace(others.uncertainty, shape=std)
    )


def _at_poles_of(
    found: AmbientResult, records: Sequence[tuple[ModeSet, Uncertainty, str]]
) -> Merged:
    """The modes of the references with what each setup gives to them."""
    name = "references of all setups"
    merged = merge_modes([(found.modes, found.uncertainty, name), *records])
    place = {
        p.mode: k
        for k, own in enumerate(merged.provenance)
        for p in own
        if p.position == 0
    }
    rows = np.array([place[k] for k in range(len(found.modes))], dtype=np.int64)
    joint = merged.modes.take(rows)
    return replace(
        merged,
        modes=replace(
            joint, frequencies=found.modes.frequencies, damping=found.modes.damping
        ),
        uncertainty=replace(
            merged.uncertainty.take(rows),
            frequency=found.uncertainty.frequency,
            damping=found.uncertainty.damping,
        ),
        provenance=tuple(
            tuple(
                replace(p, position=p.position - 1)
                for p in merged.provenance[k]
                if p.position
            )
            for k in rows.tolist()
        ),
        faults=tuple(
            replace(f, record=f.record - 1) for f in merged.faults if f.record
        ),
    )


def _members(merged: Merged, setups: Sequence[IdentifiedSetup]) -> Int:
    """(setup, m) the candidate of each setup in each mode, -1 for none."""
    out = np.full((len(setups), len(merged.modes)), -1, dtype=np.int64)
    for row, given in enumerate(merged.provenance):
        for one in given:
            out[one.position, row] = one.mode
    return out


def _joint_confidence(members: Int, found: Sequence[_AllCandidates]) -> Float:
    """(m,) mean over the setups of the probability that a candidate is a mode, 0 where a setup does
    not show it: the references move in every setup.
    """
    p = np.zeros(members.shape)
    for k, own in enumerate(members):
        p[k, own >= 0] = found[k].modes.confidence[own[own >= 0]]
    return np.asarray(p.mean(axis=0))


def _kinds(
    members: Int, found: Sequence[_AllCandidates], joint: Float, least: float
) -> list[ModeClass | None]:
    """The class of each candidate (m,); None of what one setup alone doubts."""
    out: list[ModeClass | None] = []
    for own, p in zip(members.T, joint.tolist(), strict=True):
        kinds = [found[k].kinds[i] for k, i in enumerate(own.tolist()) if i >= 0]
        if p >= least:
            out.append("natural")
        elif kinds.count("harmonic") > len(kinds) / 2:
            out.append("harmonic")
        elif p > LIMITS.doubtful or "natural" in kinds:
            out.append("doubtful")
        else:
            out.append(None)
    return out


def _others(
    merged: Merged,
    members: Int,
    found: Sequence[_AllCandidates],
    joint: Float,
    kinds: Sequence[ModeClass | None],
) -> OtherCandidates:
    """Candidates that are no natural modes, each with what most of its setups say against it."""
    at = [k for k, kind in enumerate(kinds) if kind in ("doubtful", "harmonic")]
    notes = []
    for row in at:
        own = members[:, row]
        against = [found[k].against[i] for k, i in enumerate(own.tolist()) if i >= 0]
        physical = [note for note in against if note]
        subject = f"{merged.modes.frequencies[row]:.5g} Hz"
        if 2 * len(physical) > len(against):
            notes.append(replace(physical[0], subject=subject))
        else:
            values: dict[str, float | int | str] = {
                "found": len(against),
                "setups": len(own),
            }
            notes.append(Note("candidate setups", "warning", subject, values))
    return OtherCandidates(
        replace(merged.modes.take(at), confidence=joint[at]),
        merged.uncertainty.take(at),
        tuple(kind for kind in kinds if kind in ("doubtful", "harmonic")),
        tuple(notes),
    )


def _by_setup(members: Int, found: Sequence[_AllCandidates]) -> tuple[Float, Float]:
    """Frequencies and damping (setup, m); NaN where a setup did not find the mode."""
    frequency = np.full(members.shape, np.nan)
    damping = np.full(members.shape, np.nan)
    for k, own in enumerate(members):
        there = own >= 0
        frequency[k, there] = found[k].modes.frequencies[own[there]]
        damping[k, there] = found[k].modes.damping[own[there]]
    return frequency, damping


def _scatter(values: Float) -> tuple[int, float]:
    """How many setups know a value, and its standard deviation over them, %."""
    known = values[np.isfinite(values)]
    if known.size < 2:
        return known.size, np.nan
    return known.size, float(100 * known.std(ddof=1) / known.mean())


def _reason(frequency: Float, damping: Float) -> str:
    count, spread = _scatter(frequency)
    _, of_damping = _scatter(damping)
    read = f"; its shape is read from the other {frequency.size - count}"
    return (
        f"found in {count} of {frequency.size} setups, which scatter by {spread:.2g} % in "
        f"frequency and {of_damping:.2g} % in damping{read if count < frequency.size else ''}"
    )


def _notes(setups: Sequence[IdentifiedSetup]) -> tuple[str, ...]:
    """The notes of all setups, each once: channels of one learned quantity together, others with
    the setups that they hold for.
    """
    learned: dict[str, list[str]] = {}
    holds: dict[str, list[str]] = {}
    for setup in setups:
        own = setup.result
        for note in own.channel_notes:
            if note.code == "channel quantity":
                learned.setdefault(str(note.values["quantity"]), []).extend(
                    note.subject.split()
                )
            else:
                holds.setdefault(sentence(note), []).append(setup.name)
        for text in own.record_notes:
            holds.setdefault(text, []).append(setup.name)
    out = []
    for quantity, ids in learned.items():
        names = " ".join(dict.fromkeys(ids))
        out.append(
            sentence(
                Note("channel quantity", "information", names, {"quantity": quantity})
            )
        )
    for text, names_of in holds.items():
        more = f" and {len(names_of) - SHOWN} more" if len(names_of) > SHOWN else ""
        where = (
            ""
            if len(names_of) == len(setups)
            else f"{', '.join(names_of[:SHOWN])}{more}: "
        )
        out.append(where + text)
    return tuple(out)
