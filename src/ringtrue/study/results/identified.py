"""What was recorded, and the modes found in it."""

from __future__ import annotations

from dataclasses import dataclass

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.identification.common.poles import StableDiagram


@dataclass(frozen=True, slots=True, eq=False)
class RecordSummary:
    """One raw record as the report shows it."""

    name: str
    test: str  # test (a), (b), (c)
    excitation: str
    file: str
    channels: int
    rate: float
    duration: float  # s
    preview_time: Float  # (k,) s, thinned for drawing
    preview: Float  # (channel<=4, k), SI unit
    preview_channels: tuple[str, ...]
    psd_freqs: Float  # (f,) Hz
    psd: Float  # (channel<=4, f) one-sided, unit²/Hz
    notes: tuple[str, ...]  # harmonics found, channels dropped, band of the sensor correction
    unit: str = ""  # of the previewed channels; empty where they differ
    setup: str = ""  # of a roving test


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedRecord:
    """Modes of one record."""

    record: str
    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    diagrams: tuple[StableDiagram, ...]


@dataclass(frozen=True, slots=True, eq=False)
class IdentifyStage:
    """All identified modes."""

    test: TestModel
    records: tuple[RecordSummary, ...]
    ambient_records: tuple[IdentifiedRecord, ...]
    ambient: ModeSet  # merged over the records; may hold no mode
    ambient_uncertainty: Uncertainty
    ambient_reasons: tuple[str, ...]
    frfs: FrfSet | None
    cmif: Float  # (f, in)
    rejected_hits: tuple[str, ...]
    hammer: ModeSet | None
    hammer_uncertainty: Uncertainty | None
    hammer_reasons: tuple[str, ...]
    hammer_diagrams: tuple[StableDiagram, ...]
    synthesis_error: Float  # (out, in) relative
    frf_notes: tuple[
        str, ...
    ] = ()  # of FRFs that were given as such; those of hammer records are with the records
    merge_notes: tuple[str, ...] = ()  # what was undone in an ambient record before merging
    source: str = (
        "hammer test"  # where the modes in `hammer` come from: also FRFs, or a file of modes
    )
