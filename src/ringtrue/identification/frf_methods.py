"""Modes of FRFs by another method than pLSCF with refinement: LSCE, rational fraction polynomials,
CMIF peaks.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from scipy.linalg import qr

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.progress import Progress, quiet
from ringtrue.core.signals import FrfSet
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.identification.bands_hammer import (
    MOST_PEAKS,
    choose_bands,
    grouped,
    merged,
    principal,
)
from ringtrue.identification.frf_band import band_limits, lines_between, refuse_noise
from ringtrue.identification.frf_input import frf_notes, refuse_bad_frfs, sound_pairs
from ringtrue.identification.hammer import HammerModes
from ringtrue.identification.judge import judge
from ringtrue.identification.lsce import Lsce, lsce
from ringtrue.identification.lsfd import lsfd, noise, prepare
from ringtrue.identification.opinion import SecondOpinion
from ringtrue.identification.peaks import CmifPeaks, cmif, cmif_modes, count_peaks
from ringtrue.identification.poles import PoleSet
from ringtrue.identification.refine import refine
from ringtrue.identification.rfp import Rfp, rfp
from ringtrue.identification.scale import mode_scale
from ringtrue.signal.frf_sets import exchange_by_reciprocity

Method = Literal["lsce", "rfp", "cmif"]
METHODS: tuple[str, ...] = get_args(Method)
NAMES = {"lsce": "LSCE", "rfp": "rational fraction polynomials", "cmif": "CMIF peaks"}
WIDER = (
    0.2  # of a band, at either end: LSCE tapers it, and the polynomials know their band best within
)
SPARE = 8  # orders above twice the peaks
PEAKS = 2 * MOST_PEAKS  # of a band that count: more are noise
MOST_RESPONSES = 8  # that the polynomials are fitted to


def identify_frfs_by(
    method: str,
    frfs: FrfSet,
    settings: HammerModes | None = None,
    *,
    progress: Progress | None = None,
) -> SecondOpinion:
    """Modes of FRFs by one of `METHODS`.

    Poles of LSCE and of the polynomials that stay in place over the orders, shapes by one global
    LSFD, and the verdict of `identify_hammer` on each; nothing is refined. CMIF peaks as
    `cmif_modes` finds them.

    Raises
    ------
    ConfigError
        If there is no such method, or LSCE is asked of uneven lines.
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
    if method == "cmif":
        model = cmif_modes(frfs, CmifPeaks(low, high))
        told = np.flatnonzero((model.frequencies >= low) & (model.frequencies <= high))
        reasons: tuple[str, ...] = ("peak of the CMIF",) * told.size
        sure = np.ones(model.poles.size)
    else:
        model, sure, why = _stable(
            method, lines_between(frfs, 0.8 * low, 1.25 * high), settings, tell
        )
        told = np.flatnonzero((model.frequencies >= low) & (model.frequencies <= high))
        reasons = tuple(why[k] for k in told)
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


def _stable(
    method: str, used: FrfSet, settings: HammerModes, tell: Progress
) -> tuple[ModalModel, Float, list[str]]:
    """Modes that stay in place over the orders and pass the verdict, with confidence and
    reasons.
    """
    sigma = noise(used)
    curve = cmif(used.data / sigma.response[:, None])
    bands = choose_bands(used.freqs, curve, float(used.freqs[0]), float(used.freqs[-1]))
    found = []
    for k, (a, b) in enumerate(bands):
        tell(0.8 * k / len(bands), f"{NAMES[method]}: {a:.3g} .. {b:.3g} Hz")
        wide = (used.freqs >= a - WIDER * (b - a)) & (used.freqs <= b + WIDER * (b - a))
        white = used.data[wide] / (
            np.median(sigma.line[wide]) * sigma.response[:, None] * sigma.input
        )
        white = (
            _few(white) if method == "rfp" else principal(white)
        )  # the polynomials take every FRF for as good
        peaks = min(count_peaks(curve[wide]).size, PEAKS)
        most = settings.damping_max + used.window_decay / (2 * np.pi * used.freqs[wide][0])
        poles = _poles(method, white, used.freqs[wide], peaks, most)
        f = poles.frequencies
        poles = poles.take((f >= a) & (f <= b))
        found.append(grouped(poles, white, sigma, used, wide)[1])
    c = merged(found, used.freqs, used.window_decay)
    lines, pairs = prepare(used, sigma), sound_pairs(used)
    while (
        c.pole.size
    ):  # a verdict hangs on the other modes: the worse half of the bad go, and it is taken again
        fit = refine(lines, c.pole, c.participation, iterations=0)
        here = replace(c, pole=fit.poles, participation=fit.participation)
        verdict = judge(lines, fit, here, pairs, damping_max=settings.damping_max)
        bad = np.count_nonzero(verdict.confidence < settings.confidence_min)
        if not bad:
            return (
                lsfd(used, fit.poles, fit.participation, lines, pairs),
                verdict.confidence,
                list(verdict.reason),
            )
        c = c.take(np.sort(np.argsort(verdict.confidence, kind="stable")[(bad + 1) // 2 :]))
    raise DataError(
        f"{used.source}: {NAMES[method]} shows no mode that stays in place over the orders"
    )


def _few(white: Complex) -> Complex:
    """The responses (freq, r, in) that span the others best, by pivoted QR."""
    rows = white.transpose(0, 2, 1).reshape(-1, white.shape[1])
    pivots = qr(rows.conj().T @ rows, mode="r", pivoting=True)[1]
    return np.asarray(white[:, np.sort(pivots[:MOST_RESPONSES])])


def _poles(method: str, white: Complex, freqs: Float, peaks: int, damping_max: float) -> PoleSet:
    n_in, lines = white.shape[2], freqs.size
    if method == "rfp":
        top = max(min(2 * peaks + SPARE, (lines - 8) // 2), 2)
        return rfp(white, freqs, Rfp(max(1, peaks), top, damping_max=damping_max))
    step = np.diff(freqs)
    if np.ptp(step) > 1e-3 * step.mean():
        raise ConfigError(
            "LSCE works on impulse responses, which take lines in equal steps; take plscf or rfp"
        )
    top = max(min(int(np.ceil((4 * peaks + 2 * SPARE) / n_in)), lines // 4), 3)
    return lsce(white, freqs, Lsce(max(1, top // 4), top, damping_max))
