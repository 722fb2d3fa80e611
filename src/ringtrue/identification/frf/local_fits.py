"""Batches of FRFs that disagree: local fits of one structure, each mode tracked through all of
them.

Moved accelerometers load the structure with their mass at other places, and days differ in
temperature. One global fit then splits modes in two; here every batch keeps its own poles, and only
the shapes are joined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtrc

from ringtrue.core.arrays import Bool, Complex, Float, FrozenArrays, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModalModel, ModeSet, Norm, Uncertainty
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.errors import InputError
from ringtrue.identification.frf.data_checks import lines_between
from ringtrue.identification.frf.lines import prepare
from ringtrue.identification.frf.pipeline import (
    HammerModes,
    HammerResult,
    identify_hammer,
)
from ringtrue.identification.frf.refinement import refine, shape_deviations
from ringtrue.identification.frf.residues import (
    blow_factors,
    driving_pairs,
    noise,
    normalise,
)
from ringtrue.identification.frf.scaling import mode_scale
from ringtrue.shapes import mac


@dataclass(frozen=True, slots=True)
class LocalFitLimits:
    """When batches disagree, and which of their modes are one.

    Attributes
    ----------
    chance : float
        Of the scatter of a mode over the batches, below which they disagree.
    shift : float
        Half bandwidths that matter.
    strayed : float
        Times what the first fit leaves: poles that went astray from the start of another batch.
    reach : float
        Relative shift of the frequency of a mode in two batches.
    like : float
        Least MAC of its participations.
    """

    chance: float = 1e-6
    shift: float = 0.1
    strayed: float = 1.2
    reach: float = 0.03
    like: float = 0.7


LIMITS = LocalFitLimits()


@dataclass(frozen=True, slots=True, eq=False)
class LocalFit(FrozenArrays):
    """Modes of several batches.

    Attributes
    ----------
    modes : ModeSet
        Weighted means of the poles over the batches; shapes of all responses, scaled to the first
        batch.
    uncertainty : Uncertainty
        Frequency and damping: of the mean, with the scatter over the batches where it is larger
        than stated. Shapes: for the participation vectors as they are; the mass scale adds to it.
    frequency : (batch, m) float64, Hz
    chance : (m,) float64
        Chance of so much scatter in frequency and damping if the batches agreed (χ² test).
    """

    modes: ModeSet
    uncertainty: Uncertainty
    frequency: Float
    chance: Float


def identify_batches(
    batches: Sequence[FrfSet],
    settings: HammerModes | None = None,
    *,
    progress: Progress = quiet,
) -> LocalFit:
    """Modes of a structure measured in several batches that share their inputs.

    The batch with most responses is identified on its own; its modes and participation vectors
    start the refinement in every other batch; where that leaves more than in the first one, from
    the poles that this batch by itself has for them, where it has. Modes that half of such batches
    have besides are sought in all. The participation vector, which all batches share, ties the
    scales of their shapes together.

    Parameters
    ----------
    batches : sequence of FrfSet
        Same inputs in the same order; responses may recur, the one of least deviation then counts.
    settings : HammerModes, optional
    progress : callable (fraction, text)

    Raises
    ------
    InputError
        If there are fewer than two batches or the inputs differ.
    DataError
        If the first batch shows no mode.
    """
    if len(batches) < 2 or len({tuple(c.id for c in b.inputs) for b in batches}) > 1:
        raise InputError(
            "local fits need two or more batches with the same inputs in the same order"
        )
    settings = settings or HammerModes()
    lead = int(np.argmax([b.data.shape[1] for b in batches]))
    first = identify_hammer(
        batches[lead],
        settings,
        progress=lambda share, text: progress(0.6 * share, text),
    )
    band = float(first.freqs[0]), float(first.freqs[-1])
    found = [_local(b, band, first.model) for b in batches]
    alone = dict[int, HammerResult]()
    for i, (batch, fit) in enumerate(zip(batches, found, strict=True)):
        progress(0.6 + 0.4 * i / len(batches), f"batch {i + 1} of {len(batches)}")
        if fit.left > LIMITS.strayed * found[lead].left:
            alone[i] = identify_hammer(batch, settings)
    start = _with_unseen(first.model, list(alone.values()))
    for i in range(len(batches)) if start is not first.model else alone:
        found[i] = _local(
            batches[i], band, tracked(start, alone[i].model) if i in alone else start
        )
    new = np.arange(first.model.poles.size, start.poles.size)
    at = np.append(
        np.abs(first.model.frequencies[:, None] - first.modes.frequencies).argmin(
            axis=0
        ),
        new,
    )
    at = at[np.argsort(start.frequencies[at], kind="stable")]
    return _joined(
        batches, [f.take(at) for f in found], start.participation[at], batches[lead]
    )


def _with_unseen(modes: ModalModel, others: Sequence[HammerResult]) -> ModalModel:
    """With the modes that the batch of `modes` does not see, and half of the others report."""
    grown = modes
    seen = np.zeros(modes.poles.size)
    for own in others:
        here = np.isin(own.model.frequencies, own.modes.frequencies)
        poles = own.model.poles[here]
        part = own.model.participation[here]
        row, column, goes = _assigned(grown, poles, part)
        seen[row[goes]] += 1
        new = np.setdiff1d(np.arange(poles.size), column[goes])
        seen = np.append(seen, np.ones(new.size))
        grown = _appended(grown, poles[new], part[new])
    added = (
        np.flatnonzero(seen[modes.poles.size :] >= max(0.5 * len(others), 2))
        + modes.poles.size
    )
    return (
        _appended(modes, grown.poles[added], grown.participation[added])
        if added.size
        else modes
    )


def _appended(modes: ModalModel, poles: Complex, participation: Complex) -> ModalModel:
    """With more poles, whose shapes are not known."""
    unknown = np.zeros((modes.shapes.shape[0], poles.size), dtype=np.complex128)
    return replace(
        modes,
        poles=np.append(modes.poles, poles),
        participation=np.concatenate([modes.participation, participation]),
        shapes=np.concatenate([modes.shapes, unknown], axis=1),
    )


def tracked(modes: ModalModel, own: ModalModel) -> ModalModel:
    """The modes of one batch with the poles that another has for them by itself, where one goes
    with a mode.
    """
    row, column, goes = _assigned(modes, own.poles, own.participation)
    poles = np.array(modes.poles)
    poles[row[goes]] = own.poles[column[goes]]
    return replace(modes, poles=poles)


def _assigned(
    modes: ModalModel, poles: Complex, participation: Complex
) -> tuple[Int, Int, Bool]:
    """Modes (k,), which of `poles` (m,) with `participation` (m, in) is each (k,), and whether it
    may be.

    The assignment of least Σ 1 - MAC + ½ (Δf/reach)², MAC of the participation vectors: batches
    share their inputs.
    """
    shift = np.log(np.abs(poles) / np.abs(modes.poles)[:, None])
    like = mac(modes.participation.T, participation.T)
    cost = 1 - like + 0.5 * (shift / LIMITS.reach) ** 2
    cost[(like < LIMITS.like) | (np.abs(shift) > 3 * LIMITS.reach)] = 1e6
    row, column = linear_sum_assignment(cost)
    return row, column, cost[row, column] < 1e6


def with_local_fits(
    joint: HammerResult,
    batches: Sequence[FrfSet],
    settings: HammerModes | None = None,
    *,
    progress: Progress = quiet,
) -> HammerResult:
    """The result of one fit of all batches, with the modes of local fits where it is clear that the
    batches disagree.

    That is so where more than half of the modes differ from batch to batch as no chance makes it,
    by a tenth of their half bandwidth or more: one fit of all then splits modes. Model, diagrams
    and synthesis stay those of the joint fit.

    Parameters
    ----------
    joint : HammerResult
        Of all batches together.
    batches : sequence of FrfSet
        One alone, other inputs, the same responses in all or roving hammers leave the joint result
        as it is.
    settings : HammerModes, optional
    progress : callable (fraction, text)
    """
    inputs = {tuple(c.id for c in b.inputs) for b in batches}
    roving = any(b.data.shape[1] < b.data.shape[2] for b in batches)
    moved = len({tuple(c.id for c in b.outputs) for b in batches}) > 1
    if not moved or len(inputs) > 1 or roving:
        return joint
    fit = identify_batches(batches, settings, progress=progress)
    half = fit.modes.damping * fit.modes.frequencies
    clear = (fit.chance < LIMITS.chance) & (
        np.ptp(fit.frequency, axis=0) > LIMITS.shift * half
    )
    if not clear.mean() > 0.5:
        return joint
    reasons = tuple(
        f"in {len(batches)} batches at {' '.join(f'{x:.5g}' for x in f)} Hz; chance of so much "
        f"scatter {c:.1g}"
        for f, c in zip(fit.frequency.T, fit.chance, strict=True)
    )
    note = (
        f"the batches disagree in {int(clear.sum())} of {clear.size} modes: each was "
        "fitted by itself, "
        "frequencies and damping are means, shapes are joined (moved sensors load the structure)"
    )
    notes = (*(n for n in joint.notes if n != joint.split_note), note)
    return replace(
        joint,
        modes=fit.modes,
        uncertainty=fit.uncertainty,
        reasons=reasons,
        notes=notes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """Modes of one batch: poles with deviations (2, m), shapes for the common participation
    vectors, relative std.

    `left` is the power that the fit leaves over that of the noise.
    """

    poles: Complex
    std: Float
    shapes: Complex
    deviation: Float
    left: float

    def take(self, at: Int) -> _Local:
        return _Local(
            self.poles[at],
            self.std[:, at],
            shapes=self.shapes[:, at],
            deviation=self.deviation[:, at],
            left=self.left,
        )


def _local(batch: FrfSet, band: tuple[float, float], start: ModalModel) -> _Local:
    used = lines_between(batch, band[0] * (1 - 1e-9), band[1] * (1 + 1e-9))
    lines = prepare(used, noise(used))
    fit = refine(lines, start.poles, start.participation)
    heard, driven = blow_factors(lines, fit.poles)
    fit = replace(
        fit, shapes=fit.shapes / heard, participation=fit.participation / driven
    )
    # close modes may have changed places
    order = _assigned(start, fit.poles, fit.participation)[1]
    common = start.participation[np.argsort(order)]
    factor = (common.conj() * fit.participation).sum(axis=1) / (
        np.abs(common) ** 2
    ).sum(axis=1)
    std = np.stack([fit.std_frequency, fit.std_damping])
    found = _Local(
        fit.poles,
        std,
        shapes=fit.shapes * factor,
        deviation=shape_deviations(lines, fit, None),
        left=fit.error**2,
    )
    return found.take(order)


def _joined(
    batches: Sequence[FrfSet], found: Sequence[_Local], part: Complex, first: FrfSet
) -> LocalFit:
    poles = np.array([f.poles for f in found])
    std = np.array([f.std for f in found])
    # (batch, 2, m)
    value = np.stack([np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)], axis=1)
    weight = 1 / np.maximum(std, 1e-300) ** 2
    mean = (weight * value).sum(axis=0) / weight.sum(axis=0)
    excess = (weight * (value - mean) ** 2).sum(axis=0)
    n = len(batches) - 1
    spread = np.sqrt(np.maximum(excess / n, 1) / weight.sum(axis=0))
    outputs, rows, which = _best(batches, found)
    shapes = np.array(
        [
            found[b].shapes[r] * found[b].poles.imag
            for b, r in zip(which, rows, strict=True)
        ]
    )
    omega = 2 * np.pi * mean[0]
    pole = omega * (-mean[1] + 1j * np.sqrt(np.maximum(1 - mean[1] ** 2, 0)))
    shapes = shapes / pole.imag  # residues of one modal mass go with 1/ω
    none = np.zeros((len(outputs), part.shape[1]), dtype=np.complex128)
    unscaled = ModalModel(
        poles=pole,
        shapes=shapes,
        participation=part,
        lower=none,
        upper=none,
        outputs=outputs,
        inputs=first.inputs,
        kind=first.kind,
    )
    model = normalise(unscaled, driving_pairs(unscaled))
    scaled = model.shapes * mode_scale(model)
    deviation = np.array(
        [found[b].deviation[r] for b, r in zip(which, rows, strict=True)]
    )
    norm = Norm.UNSCALED if model.norm is Norm.UNSCALED else Norm.MASS
    labels = tuple(c.id for c in outputs)
    modes = ModeSet(
        frequencies=mean[0],
        damping=mean[1],
        shapes=scaled,
        labels=labels,
        norm=norm,
        source=first.source or "hammer FRFs, local fits",
    )
    uncertainty = Uncertainty.independent(
        spread[0], spread[1], deviation * np.abs(scaled)
    )
    chance = chdtrc(2 * n, excess.sum(axis=0))
    return LocalFit(modes, uncertainty, value[:, 0], chance)


def _best(
    batches: Sequence[FrfSet], found: Sequence[_Local]
) -> tuple[tuple[Channel, ...], list[int], list[int]]:
    """All responses in the order of their first appearance, and the row and batch that knows each
    best.
    """
    best: dict[str, tuple[float, int, int, Channel]] = {}
    for b, (batch, f) in enumerate(zip(batches, found, strict=True)):
        doubt = np.median(f.deviation, axis=1)
        for r, c in enumerate(batch.outputs):
            if c.id not in best or doubt[r] < best[c.id][0]:
                best[c.id] = (float(doubt[r]), r, b, c)
    _, rows, which, channels = zip(*best.values(), strict=True)
    return channels, list(rows), list(which)
