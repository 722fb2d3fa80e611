"""FRFs and spectra that modes give where and as the test has its own.

Of the decks of a study; and what the modes of an identification explain of its data, before and
after a choice by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Complex, Float, FrozenArrays
from ringtrue.core.choice import Choice
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet
from ringtrue.correlation.frf import FrfComparison, compare_frfs
from ringtrue.correlation.pairing import Pairing
from ringtrue.identification.common.manual_selection import current_poles
from ringtrue.identification.frf.lines import (
    Lines,
    functions,
    mirrored,
    mirrored_rows,
    prepare,
)
from ringtrue.identification.frf.residues import (
    driving_pairs,
    lsfd,
    noise,
    solve_shapes,
    synthesise_windowed,
)
from ringtrue.study.config import StudyConfig
from ringtrue.study.evidence import ModelModes, frf_band, on_sheet, synthesised
from ringtrue.study.results import (
    CorrelateStage,
    FinalStage,
    IdentifiedModes,
    IdentifyStage,
    ReferenceModes,
)
from ringtrue.study.session import StudyConfiguration

ASSUMED_DAMPING = 0.01  # where no test mode with a ratio is paired


def damping_of(
    modes: ModeSet, elastic: Pairing, rigid: Pairing, reference: ReferenceModes
) -> tuple[Float, tuple[str, ...]]:
    """Damping of each FE mode: its test partner's, or interpolated over frequency."""
    zeta = np.full(len(modes), np.nan)
    source = ["interpolated"] * len(modes)
    for pairing, test, what in (
        (rigid, reference.rigid, "ambient"),
        (elastic, reference.elastic, "test"),
    ):
        for a, b in zip(pairing.a.tolist(), pairing.b.tolist(), strict=True):
            zeta[b] = test.damping[a]
            source[b] = f"{what} mode {a + 1}"
    known = np.isfinite(zeta)
    if not known.any():
        assumed = f"assumed {100 * ASSUMED_DAMPING:g} %"
        return np.full(len(modes), ASSUMED_DAMPING), (assumed,) * len(modes)
    f = modes.frequencies
    zeta[~known] = np.interp(f[~known], f[known], zeta[known])
    return zeta, tuple(source)


def measured_frfs(c: StudyConfiguration) -> FrfSet | None:
    """The FRFs of the test at channels on the sheet, in the range of the model; None where there
    are none.
    """
    first = float(c.reference.elastic.frequencies[0])
    low = min(1.0, 0.5 * first)
    return on_sheet(c.session.get("identify"), low, c.session.fmax)


def initial_modes(c: StudyConfiguration) -> ModelModes:
    """The initial deck with its modes, and damping from the test modes that they pair with."""
    before: CorrelateStage = c.session.get("correlate")
    modes = before.fe_initial
    pairings = before.initial.pairing, before.rigid_initial.pairing
    zeta, _ = damping_of(modes, *pairings, c.reference)
    return ModelModes(c.session.initial, modes, zeta)


def final_modes(c: StudyConfiguration, stage: FinalStage) -> ModelModes:
    """The delivered deck, read back, with its stored modes."""
    folder = c.updated_folder
    parts = Path(stage.files[0]).parts  # stored as seen from where the study was run
    deck = folder.joinpath(*parts[parts.index(folder.name) + 1 :])
    return ModelModes(c.session.opened(deck), stage.observed, stage.damping)


def compared(
    found: IdentifyStage, config: StudyConfig, model: FrfSet
) -> tuple[FrfComparison, tuple[float, float]] | None:
    """All measures of the FRFs of a deck against the test, and the band where they are compared;
    None without modes or lines there.
    """
    band = frf_band(found, config)
    measured = on_sheet(found, *band) if band is not None else None
    if band is None or measured is None:
        return None
    return compare_frfs(measured, model), band


def model_frfs(c: StudyConfiguration, model: ModelModes, measured: FrfSet) -> FrfSet:
    """The FRFs of a deck at the outputs, inputs and lines of measured ones."""
    session = c.session
    return synthesised(
        model, c.observed(model.opened), measured, session.unit, session.fmax
    )


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
        at = (
            (frfs.freqs > 0)
            & (frfs.freqs >= low / MARGIN)
            & (frfs.freqs <= high * MARGIN)
        )
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
    a, b = (
        np.linalg.norm(x.data.reshape(x.freqs.size, -1), axis=1)
        for x in (measured, fitted)
    )
    return FittedData(measured.freqs, _decibels(a**2), _decibels(b**2))


def fitted_spectra(
    found: IdentifiedModes, choice: Choice | None
) -> tuple[FittedData, ...]:
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
        out.append(
            FittedData(freqs, _decibels(power), _decibels(np.maximum(fitted, floor)))
        )
    return tuple(out)


def _decibels(power: Float) -> Float:
    return 10 * np.log10(np.maximum(power, np.finfo(float).tiny))


def weighted_lines(frfs: FrfSet) -> Lines:
    """The lines of FRFs (> 0 Hz) as a fit takes them; the same for all poles."""
    return prepare(frfs, noise(frfs))


def fit_poles(frfs: FrfSet, lines: Lines, poles: Complex) -> FrfSet:
    """The FRFs of a modal model of given poles, its residues of rank one and residual terms fitted
    as in an identification.

    Parameters
    ----------
    frfs : FrfSet, lines > 0 Hz
    lines : Lines
        `weighted_lines` of them.
    poles : (m,) complex128, rad/s
        Without the exponential window.
    """
    part = participations(lines, poles)
    shapes = solve_shapes(lines, poles, part)
    model = lsfd(frfs, lines, poles, part, shapes=shapes, points=driving_pairs(frfs))
    fitted = synthesise_windowed(model, lines)
    return replace(frfs, data=fitted, coherence=np.full(fitted.shape, np.nan))


def participations(lines: Lines, poles: Complex) -> Complex:
    """(m, in) participation vectors of poles: of their free residues the part of rank one that
    holds most.
    """
    q = functions(lines, poles)
    normal = mirrored(q.conj().T @ q)
    scale: Float = 1 / np.sqrt(np.maximum(np.diag(normal).real, np.finfo(float).tiny))
    right = scale[:, None] * mirrored_rows(q.conj().T @ lines.y)
    free = np.linalg.pinv(scale[:, None] * normal * scale, hermitian=True) @ right
    residue = (scale[:, None] * free)[:, : poles.size] * lines.response  # (in, m, out)
    left, _, _ = np.linalg.svd(residue.transpose(1, 0, 2), full_matrices=False)
    return np.asarray(left[:, :, 0] / lines.input, dtype=np.complex128)


def fit_spectrum(freqs: Float, power: Float, poles: Complex) -> Float:
    """The sum of spectra as poles explain it, (f,).

    The spectrum of responses to white forces is that of decays with the poles of the structure:
    S(ω) = Σ_k 2 Re(r_k/(iω − λ_k)) (Peeters and Van der Auweraer, 2005, PolyMAX of half
    spectra), with r_k by least squares of relative errors, and a level and a slope of noise.

    Parameters
    ----------
    freqs : (f,) float64, Hz
    power : (f,) float64
        Sum of the spectra of all channels.
    poles : (m,) complex128, rad/s
    """
    s = 2j * np.pi * freqs
    decay = 1 / (s[:, None] - poles)
    mirror = 1 / (s[:, None] - poles.conj())
    # r_k and its conjugate at the conjugate pole, real and imaginary part
    real, imaginary = (decay + mirror).real, (1j * (decay - mirror)).real
    ramp = (freqs / max(float(freqs[-1]), 1e-300)) ** 2
    columns = np.concatenate(
        [real, imaginary, np.ones((freqs.size, 1)), ramp[:, None]], axis=1
    )
    weighted = columns / power[:, None]
    size = np.maximum(np.linalg.norm(weighted, axis=0), np.finfo(float).tiny)
    found, *_ = np.linalg.lstsq(weighted / size, np.ones(freqs.size), rcond=1e-10)
    return np.asarray(columns @ (found / size), dtype=np.float64)
