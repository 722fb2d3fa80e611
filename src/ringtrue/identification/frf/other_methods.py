"""Modes of FRFs by another method than pLSCF with refinement: CMIF peaks."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet, Norm, Uncertainty
from ringtrue.core.progress import Progress, quiet
from ringtrue.core.signals import FrfSet
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.identification.ambient.other_methods import SecondOpinion
from ringtrue.identification.frf.cmif import CmifPeaks, cmif_modes
from ringtrue.identification.frf.data_checks import (
    band_limits,
    frf_notes,
    lines_between,
    refuse_bad_frfs,
    refuse_noise,
    sound_pairs,
)
from ringtrue.identification.frf.pipeline import HammerModes
from ringtrue.identification.frf.scaling import mode_scale
from ringtrue.signal.frf_sets import exchange_by_reciprocity

Method = Literal["cmif"]


METHODS: tuple[str, ...] = get_args(Method)


NAMES = {"cmif": "CMIF peaks"}


def identify_frfs_by(
    method: str,
    frfs: FrfSet,
    settings: HammerModes | None = None,
    *,
    progress: Progress | None = None,
) -> SecondOpinion:
    """Modes of FRFs by one of `METHODS`.

    Raises
    ------
    ConfigError
        If there is no such method.
    DataError
        If the FRFs are no FRFs, or noise, or no mode is found.
    """
    if method not in METHODS:
        raise ConfigError(f"method {method!r}{did_you_mean(method, METHODS)}")
    settings, tell = settings or HammerModes(), progress or quiet
    refuse_bad_frfs(frfs)
    frfs, roving = exchange_by_reciprocity(frfs)
    low, high = band_limits(frfs, settings.fmin, settings.fmax)
    refuse_noise(lines_between(frfs, low, settings.fmax or np.inf))
    tell(0.0, NAMES[method])
    model = cmif_modes(frfs, CmifPeaks(low, high))
    told = np.flatnonzero((model.frequencies >= low) & (model.frequencies <= high))
    reasons: tuple[str, ...] = ("peak of the CMIF",) * told.size
    sure = np.ones(model.poles.size)
    told = told[np.argsort(model.frequencies[told], kind="stable")]
    modes = _modes(model, sure, f"{frfs.source or 'FRFs'}: {NAMES[method]}").take(told)
    none = np.full(len(modes), np.nan)
    std = Uncertainty.independent(none, none, np.full(modes.shapes.shape, np.nan))
    notes = (*((roving,) if roving else ()), *frf_notes(frfs, sound_pairs(frfs)))
    return SecondOpinion(
        modes, std, reasons, (f"no standard deviations: {NAMES[method]} states none here", *notes)
    )


def _modes(model: ModalModel, sure: Float, source: str) -> ModeSet:
    norm = Norm.UNSCALED if model.norm is Norm.UNSCALED else Norm.MASS
    labels = tuple(c.id for c in model.outputs)
    return ModeSet(
        model.frequencies,
        model.damping,
        model.shapes * mode_scale(model),
        labels,
        norm,
        source,
        sure,
    )
