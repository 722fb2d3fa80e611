"""What a diagram of an identification shows in one view: poles, spectrum, modes of each class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.display import Displayed
from ringtrue.core.modes import (
    ModeClass,
    ModeSet,
    OtherCandidates,
    Uncertainty,
    joined_modes,
)
from ringtrue.core.notes import summary
from ringtrue.errors import InputError
from ringtrue.identification.ambient.spectral_bins import SpectrumPeak
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.shapes import mac, mpc
from ringtrue.signal.machines import Machine
from ringtrue.signal.tonal_lines import Harmonic

MARGIN = 0.03  # on both sides, of the logarithm of the range


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumAccount:
    """What the peaks of a spectrum are besides modes.

    Attributes
    ----------
    harmonics : tuple of Harmonic
        Lines of machines.
    machines : tuple of Machine
        With their speed and harmonics.
    unexplained : tuple of SpectrumPeak
        Peaks at which nothing is.
    """

    harmonics: tuple[Harmonic, ...] = ()
    machines: tuple[Machine, ...] = ()
    unexplained: tuple[SpectrumPeak, ...] = ()

    @property
    def lines(self) -> Float:
        """(line,) Hz, ascending: of machines, each harmonic once."""
        single = np.array([h.frequency for h in self.harmonics])
        combs = [m.frequency * m.harmonics for m in self.machines]
        return np.unique(np.concatenate([single, *combs]))


@dataclass(frozen=True, eq=False)
class IdentificationDiagram(Displayed):
    """Poles of all bands and orders over the spectrum, and the modes of each class.

    Attributes
    ----------
    diagrams : tuple of StableDiagram
        One a band.
    modes : ModeSet
        Natural, doubtful and harmonic ones, ascending in frequency.
    uncertainty : Uncertainty
    classes : tuple of {"natural", "doubtful", "harmonic"}
    remarks : tuple of str
        What is particular of each mode, in six words; empty for one beyond doubt.
    account : SpectrumAccount
    """

    diagrams: tuple[StableDiagram, ...]
    modes: ModeSet
    uncertainty: Uncertainty
    classes: tuple[ModeClass, ...]
    remarks: tuple[str, ...]
    account: SpectrumAccount = SpectrumAccount()

    def __post_init__(self) -> None:
        m = len(self.modes)
        if len(self.classes) != m or len(self.remarks) != m:
            raise InputError(
                f"{len(self.classes)} classes and {len(self.remarks)} remarks of {m} modes"
            )

    @property
    def auto_mac(self) -> Float:
        """(m, m) float64, 0..1; NaN of shapes that are not known. Channels without a reading count
        as zero.
        """
        shapes = self.modes.shapes
        values = mac(np.nan_to_num(shapes), np.nan_to_num(shapes))
        unknown = np.isnan(shapes).all(axis=0)
        values[unknown] = np.nan
        values[:, unknown] = np.nan
        return values

    @property
    def mpc(self) -> Float:
        """(m,) float64, 0..1: modal phase collinearity; NaN of shapes that are not known."""
        return shape_collinearity(self.modes)

    @property
    def span(self) -> tuple[float, float]:
        """Where poles, modes and unexplained peaks lie, with a margin, Hz; 0 to 1 where there are
        none.
        """
        peaks = [p.frequency for p in self.account.unexplained]
        poles = [d.poles.frequencies for d in self.diagrams]
        f = np.concatenate([self.modes.frequencies, peaks, *poles])
        f = f[f > 0]
        if not f.size:
            return 0.0, 1.0
        margin = max((f.max() / f.min()) ** MARGIN, 1.03)
        return float(f.min() / margin), float(f.max() * margin)

    def singular_value(self, k: int) -> tuple[Float, Float]:
        """One singular value over all bands: lines (f,), Hz, ascending, and level (f,), dB.

        Each band has a reference of its own: the lower ones are shifted to the level that the first
        value has in the next, and each goes as far as the middle of what both have.
        """
        parts = [d for d in self.diagrams if d.level.shape[0] > k and d.freqs.size]
        parts.sort(key=lambda d: -float(d.freqs[-1]))
        low, top = self.span
        freqs = [np.empty(0)]
        level = [np.empty(0)]
        shift = 0.0
        for upper, d, lower in zip(
            [None, *parts], parts, [*parts[1:], None], strict=False
        ):
            if upper is not None:
                shift += _step(d, upper)
            bottom = low
            if lower is not None:  # the middle of what both bands have
                bottom = float(np.sqrt(lower.freqs[-1] * max(d.freqs[0], 1e-300)))
            at = (d.freqs >= bottom) & (d.freqs < top)
            top = bottom
            freqs.insert(0, d.freqs[at])
            level.insert(0, d.level[k, at] + shift)
        return np.concatenate(freqs), np.concatenate(level)


def _step(lower: StableDiagram, upper: StableDiagram) -> float:
    """By how much the first singular value of the upper band is higher where both have it, dB."""
    both = (upper.freqs >= lower.freqs[0]) & (upper.freqs <= lower.freqs[-1])
    if not both.any():
        return 0.0
    there = np.interp(upper.freqs[both], lower.freqs, lower.level[0])
    return float(np.median(upper.level[0, both] - there))


def shape_collinearity(modes: ModeSet) -> Float:
    """(m,) MPC of each mode; NaN where its shape is not known."""
    values = mpc(np.nan_to_num(modes.shapes.astype(np.complex128)))
    values[np.isnan(modes.shapes).all(axis=0)] = np.nan
    return values


def identification_diagram(
    diagrams: Sequence[StableDiagram],
    natural: tuple[ModeSet, Uncertainty, Sequence[str]],
    others: OtherCandidates,
    account: SpectrumAccount | None = None,
) -> IdentificationDiagram:
    """The diagram of natural modes (with deviations and remarks) and other candidates.

    Raises
    ------
    InputError
        If the shapes of both have different channels.
    """
    modes, std, remarks = natural
    if not len(modes):
        modes = others.modes.take([])
        std = others.uncertainty.take([])
    elif not len(others):
        others = OtherCandidates.none(modes.channels)
    joined, deviations = joined_modes(
        [(modes, std), (others.modes, others.uncertainty)]
    )
    rank = np.argsort(joined.frequencies, kind="stable")
    natural_ones: list[ModeClass] = ["natural"] * len(modes)
    kinds = [*natural_ones, *others.classes]
    texts = [*remarks, *map(summary, others.notes)]
    return IdentificationDiagram(
        tuple(diagrams),
        joined.take(rank),
        deviations.take(rank),
        tuple(kinds[k] for k in rank.tolist()),
        tuple(texts[k] for k in rank.tolist()),
        account or SpectrumAccount(),
    )
