"""What the modes of an identification explain of its data, before and after a choice by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, FrozenArrays
from ringtrue.core.choice import Choice
from ringtrue.core.signals import FrfSet
from ringtrue.identification.ambient.synthesis import fit_spectrum
from ringtrue.identification.common.manual_selection import current_poles
from ringtrue.identification.frf.lines import Lines
from ringtrue.identification.frf.synthesis import fit_poles, weighted_lines
from ringtrue.study.results import IdentifiedModes

MARGIN = 1.2  # of the band, whose lines are fitted too


@dataclass(frozen=True, slots=True, eq=False)
class FittedData(FrozenArrays):
    """Measured data and what modes explain of them.

    Attributes
    ----------
    freqs : (f,) float64, Hz
    measured, fitted : (f,) float64, dB
    """

    freqs: Float
    measured: Float
    fitted: Float


@dataclass(frozen=True, slots=True, eq=False)
class FrfFit:
    """FRFs that are ready for fits of any poles.

    Attributes
    ----------
    frfs : FrfSet
        In the band of the diagrams.
    lines : Lines
    """

    frfs: FrfSet
    lines: Lines

    @classmethod
    def of(cls, found: IdentifiedModes, frfs: FrfSet) -> FrfFit:
        """Those in the band of an identification."""
        low, high = found.diagram.span
        at = (frfs.freqs > 0) & (frfs.freqs >= low / MARGIN) & (frfs.freqs <= high * MARGIN)
        every = (np.arange(len(side)) for side in (frfs.outputs, frfs.inputs))
        part = frfs.part(np.flatnonzero(at), *every)
        return cls(part, weighted_lines(part))

    def at(self, found: IdentifiedModes, choice: Choice | None) -> FrfSet:
        """The FRFs of the modes after a choice.

        Raises
        ------
        DataError
            If a pick means no pole.
        """
        sets = [d.poles for d in found.diagrams]
        poles = current_poles(
            found.modes,
            sets,
            choice,
            decay=self.frfs.window_decay,
            doubtful=found.others.modes,
        )
        return fit_poles(self.frfs, self.lines, poles)


def single(measured: FrfSet, fitted: FrfSet, output: str, input_: str) -> FittedData:
    """One FRF by its channels."""
    i = [c.id for c in measured.outputs].index(output)
    j = [c.id for c in measured.inputs].index(input_)
    a, b = (np.abs(x.data[:, i, j]) ** 2 for x in (measured, fitted))
    return FittedData(measured.freqs, _decibels(a), _decibels(b))


def summed(measured: FrfSet, fitted: FrfSet) -> FittedData:
    """All FRFs as the root of the sum of their squares."""
    a, b = (np.linalg.norm(x.data.reshape(x.freqs.size, -1), axis=1) for x in (measured, fitted))
    return FittedData(measured.freqs, _decibels(a**2), _decibels(b**2))


def fitted_spectra(found: IdentifiedModes, choice: Choice | None) -> tuple[FittedData, ...]:
    """The singular values of each band, summed, and what the modes after a choice explain.

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    sets = [d.poles for d in found.diagrams]
    poles = current_poles(found.modes, sets, choice, doubtful=found.others.modes)
    f = np.abs(poles) / (2 * np.pi)
    out = []
    for d in found.diagrams:
        ok = d.freqs > 0
        freqs, power = d.freqs[ok], (10 ** (d.level[:, ok] / 10)).sum(axis=0)
        near = (f > freqs[0] / MARGIN) & (f < freqs[-1] * MARGIN)
        fitted = fit_spectrum(freqs, power, poles[near])
        floor = 1e-3 * power  # less than nothing cannot be drawn
        out.append(FittedData(freqs, _decibels(power), _decibels(np.maximum(fitted, floor))))
    return tuple(out)


def _decibels(power: Float) -> Float:
    return np.asarray(10 * np.log10(np.maximum(power, np.finfo(float).tiny)))
