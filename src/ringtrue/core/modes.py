"""Modes: natural frequencies, damping ratios and shapes with their labels.

And their standard deviations, and the modal model, enough to synthesise the FRFs that it came from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar, Literal

import numpy as np

from ringtrue.core.arrays import (
    Any_,
    Bool,
    Complex,
    Float,
    FrozenArrays,
    Int,
    freeze_fields,
)
from ringtrue.core.channels import POWER
from ringtrue.core.display import Displayed
from ringtrue.core.dofs import DofSet
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import Channel, FrfKind
from ringtrue.errors import InputError

# of the highest frequency: below is a rigid-body motion, whose frequency is round-off
RIGID = 1e-3


def rigid_below(frequencies: Float) -> float:
    """Up to where natural frequencies (m,), Hz, are those of rigid-body motions."""
    return RIGID * float(frequencies.max(initial=0.0))


def elastic(frequencies: Float) -> Bool:
    """Which natural frequencies (m,), Hz, are not those of rigid-body motions."""
    return frequencies > rigid_below(frequencies)


class Norm(StrEnum):
    """How the shapes are scaled."""

    MASS = "mass"  # unit modal mass
    UNSCALED = "unscaled"  # output-only: no scale
    MODAL_A = "unit modal A"  # complex: φᵀ(2sM + D)φ = 1
    # those of a model's modes that frequencies alone were taken for: not measured
    MODEL_SHAPES = "lent"


@dataclass(frozen=True, slots=True, eq=False)
class ModeSet(Displayed):
    """Modes in ascending frequency.

    Attributes
    ----------
    frequencies : (m,) float64, Hz
        f = sign(λ)·sqrt|λ|/2π for an undamped model; |s|/2π for a pole.
    damping : (m,) float64
        Fraction of critical damping; NaN where unknown, 0 for an undamped model.
    shapes : (n, m) float64 or complex128
    labels : DofSet or tuple of str
        A degree of freedom (FE) or a channel id (test) for each row of `shapes`.
    norm : Norm
    source : str
        What made it: a deck and solver, a record and method.
    """

    UNITS: ClassVar[Mapping[str, str]] = {
        "frequencies": "Hz",
        "damping": "-",
        "confidence": "0..1",
    }

    frequencies: Float
    damping: Float
    shapes: Any_
    labels: DofSet | tuple[str, ...]
    norm: Norm = Norm.UNSCALED
    source: str = ""
    confidence: Float = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        shapes = np.asarray(self.shapes)
        freeze_fields(
            self,
            frequencies=np.float64,
            damping=np.float64,
            shapes=np.complex128 if np.iscomplexobj(shapes) else np.float64,
        )
        m = self.frequencies.size
        if not np.size(self.confidence):
            object.__setattr__(self, "confidence", np.ones(m))
        freeze_fields(self, confidence=np.float64)
        if not isinstance(self.labels, DofSet):
            object.__setattr__(self, "labels", tuple(self.labels))
            if len(set(self.labels)) != len(self.labels):
                raise InputError("a channel occurs twice in a mode set")
        if (
            self.shapes.shape != (len(self.labels), m)
            or self.damping.shape != (m,)
            or self.confidence.shape != (m,)
        ):
            raise InputError(
                f"{m} frequencies, damping {self.damping.shape}, shapes {self.shapes.shape}, "
                f"{len(self.labels)} labels: shapes must be (labels, modes)"
            )

    def __len__(self) -> int:
        return int(self.frequencies.size)

    @property
    def channels(self) -> tuple[str, ...]:
        """The row labels as text."""
        return self.labels.labels() if isinstance(self.labels, DofSet) else self.labels

    @property
    def frequency_only(self) -> bool:
        """Whether frequencies alone were measured, and the shapes are those of a model."""
        return self.norm is Norm.MODEL_SHAPES

    def take(self, modes: Sequence[int] | Int | slice) -> ModeSet:
        """The chosen modes, in the given order."""
        return replace(
            self,
            frequencies=self.frequencies[modes],
            damping=self.damping[modes],
            shapes=self.shapes[:, modes],
            confidence=self.confidence[modes],
        )

    def band(self, low: float, high: float) -> ModeSet:
        """The modes with low <= f <= high, Hz."""
        return self.take(
            np.flatnonzero((self.frequencies >= low) & (self.frequencies <= high))
        )

    def rows(self, channels: Sequence[str]) -> ModeSet:
        """The chosen rows by label, in the given order; the set itself where these are all of its
        rows.

        Raises
        ------
        InputError
            If a label is absent.
        """
        if tuple(channels) == self.channels:
            return self
        here = {c: i for i, c in enumerate(self.channels)}
        lost = [c for c in channels if c not in here]
        if lost:
            raise InputError(
                f"channels not in {self.source or 'the mode set'}: {' '.join(lost[:8])}"
            )
        at = [here[c] for c in channels]
        labels: DofSet | tuple[str, ...] = tuple(channels)
        if isinstance(self.labels, DofSet):
            labels = self.labels.take(np.array(at, dtype=np.int64))
        return replace(self, shapes=self.shapes[at], labels=labels)


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty(FrozenArrays):
    """Standard deviations of identified modes.

    Attributes
    ----------
    frequency : (m,) float64, Hz
    damping : (m,) float64
    shape : (channel, m) float64
        Of the modulus of each component, in the unit of the shape.
    factor : (r, 2 m) float64
        Low-rank factor F of the covariance FᵀF of (frequencies, damping); r may be 0.
    """

    frequency: Float
    damping: Float
    shape: Float
    factor: Float

    @classmethod
    def independent(cls, frequency: Float, damping: Float, shape: Float) -> Uncertainty:
        """Uncorrelated standard deviations."""
        m = np.size(frequency)
        return cls(frequency, damping, shape, np.zeros((0, 2 * m)))

    def take(self, modes: Sequence[int] | Int) -> Uncertainty:
        """The chosen modes, in the given order."""
        at = np.asarray(modes, dtype=np.int64)
        both = np.concatenate([at, at + self.frequency.size])
        return Uncertainty(
            self.frequency[at],
            self.damping[at],
            self.shape[:, at],
            self.factor[:, both],
        )


def joined_modes(
    parts: Sequence[tuple[ModeSet, Uncertainty]],
) -> tuple[ModeSet, Uncertainty]:
    """The modes of one or more sets, one behind the other; those of different sets are not
    correlated.

    Labels, norm and source are those of the first set.

    Raises
    ------
    InputError
        If the sets have different channels.
    """
    first = parts[0][0]
    sets = [modes.rows(first.channels) for modes, _ in parts]
    modes = replace(
        first,
        frequencies=np.concatenate([x.frequencies for x in sets]),
        damping=np.concatenate([x.damping for x in sets]),
        shapes=np.concatenate([x.shapes for x in sets], axis=1),
        confidence=np.concatenate([x.confidence for x in sets]),
    )
    deviations = Uncertainty.independent(
        np.concatenate([std.frequency for _, std in parts]),
        np.concatenate([std.damping for _, std in parts]),
        np.concatenate([std.shape for _, std in parts], axis=1),
    )
    return modes, deviations


ModeClass = Literal["natural", "doubtful", "harmonic"]


@dataclass(frozen=True, slots=True, eq=False)
class OtherCandidates:
    """What identification found besides the natural modes, ascending in frequency.

    Attributes
    ----------
    modes : ModeSet
        With the confidence of each by the scatter and the shape of its poles alone.
    uncertainty : Uncertainty
    classes : tuple of {"doubtful", "harmonic"}
    notes : tuple of Note
        Why each is not among the natural modes.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    classes: tuple[ModeClass, ...]
    notes: tuple[Note, ...]

    def __len__(self) -> int:
        return len(self.modes)

    def sentences(self) -> tuple[str, ...]:
        """One a candidate: what it is, where, and why it is not among the natural modes."""
        both = zip(self.classes, self.modes.confidence, self.notes, strict=True)
        return tuple(
            f"{kind} mode at {note.subject}, confidence {confidence:.2f}: {sentence(note)}"
            for kind, confidence, note in both
        )

    @classmethod
    def none(cls, channels: Sequence[str] = ()) -> OtherCandidates:
        """No candidate."""
        nothing = np.empty(0)
        shapes = np.empty((len(channels), 0), dtype=np.complex128)
        modes = ModeSet(nothing, nothing, shapes, tuple(channels), confidence=nothing)
        return cls(
            modes, Uncertainty.independent(nothing, nothing, shapes.real), (), ()
        )


class HasPoles:
    """The base of what has `poles` (m,), rad/s."""

    __slots__ = ()
    poles: Complex

    @property
    def frequencies(self) -> Float:
        """(m,) Hz."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping(self) -> Float:
        """(m,) fraction of critical."""
        return -self.poles.real / np.abs(self.poles)


@dataclass(frozen=True, slots=True, eq=False)
class ModalModel(HasPoles, FrozenArrays):
    """Poles and residues, receptance form H(s) = Σ_k ψ_k l_kᵀ/(s − s_k) + conj + L/s² + U.

    Attributes
    ----------
    poles : (m,) complex128, rad/s, Im > 0
    shapes : (out, m) complex128
        ψ_k; scaled so that ψ_k l_kᵀ is the residue (m/N·1/s).
    participation : (m, in) complex128
    lower, upper : (out, in) complex128
        Residual terms for the modes below (L/s²) and above (U) the band.
    outputs, inputs : tuple of Channel
    kind : str
        The kind of the FRFs it was fitted to.
    """

    poles: Complex
    shapes: Complex
    participation: Complex
    lower: Complex
    upper: Complex
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    kind: FrfKind = "accelerance"
    norm: Norm = Norm.UNSCALED

    def synthesise(self, freqs: Float) -> Complex:
        """(freq, out, in) complex128 in the kind of the model, at `freqs` (f,) Hz, f > 0."""
        s = 2j * np.pi * np.asarray(freqs, dtype=np.float64)
        left = self.shapes[None] / (s[:, None, None] - self.poles)
        right = self.shapes.conj()[None] / (s[:, None, None] - self.poles.conj())
        h = left @ self.participation + right @ self.participation.conj()
        h += self.lower / (s**2)[:, None, None] + self.upper
        return h * (s ** POWER[self.kind])[:, None, None]
