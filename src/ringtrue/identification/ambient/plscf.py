"""Ambient modes by poly-reference LSCF on half spectra, refined by least squares.

The half spectra are those of Peeters and Van der Auweraer (2005), "PolyMAX: a revolution in
operational modal analysis", IOMAC: the correlations at positive lags under an exponential window,
whose decay is taken out of the poles. They have the form of FRFs with the references as inputs, so
the poles, whose damping LSCF has too small in noise, are refined and judged as those of FRFs are
(after El-Kafafy, Peeters and Guillaume 2013). Correlations of one record hang together from lag to
lag and noise may fit them well, so both halves of the record must show a mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.era import SAMPLES_A_LAG, fewest_samples
from ringtrue.identification.ambient.pipeline import AmbientSettings
from ringtrue.identification.ambient.ssi_cov import choose_references, prepared
from ringtrue.identification.common.stabilisation import (
    DAMPING_MAX,
    least_deviations,
    unit,
)
from ringtrue.identification.common.uncertainty import by_chance
from ringtrue.identification.frf.confidence import CandidatePoles, assess_candidates
from ringtrue.identification.frf.lines import Noise, prepare
from ringtrue.identification.frf.plscf import Plscf, grouped, merged, plscf
from ringtrue.identification.frf.refinement import Refined, refine
from ringtrue.shapes import mac
from ringtrue.signal.spectra import HALF, correlations, half_spectra


def half_spectra_modes(
    history: TimeHistory, band: tuple[float, float], settings: AmbientSettings
) -> tuple[ModeSet, Uncertainty]:
    """Modes of a band (Hz): poles that stay in place over the orders, refined, and seen in both
    halves of the record.

    Parameters
    ----------
    history : TimeHistory
    band : (float, float), Hz
    settings : AmbientSettings
        References, and the least confidence: modes of less are left out, and the others fitted
        anew.

    Returns
    -------
    ModeSet
        The confidence is that of the fit times the agreement of both halves.
    Uncertainty
        All NaN.

    Raises
    ------
    DataError
        If the record is too short for its lags.
    """
    data, scale = prepared(history)
    refs = choose_references(history, data, settings.references or None)
    lags = _lags(history, settings)
    whole, *halves = (
        _as_frfs(correlations(x, refs, lags), history, band, refs)
        for x in (data, *np.array_split(data, 2, axis=1))
    )
    level = Noise(
        np.sqrt((np.abs(whole.data) ** 2).mean(axis=(1, 2))),
        np.ones(len(data)),
        np.ones(refs.size),
    )
    everywhere = np.ones(whole.freqs.size, dtype=np.bool_)
    # with the window, and participation vectors for shapes
    most = DAMPING_MAX + whole.window_decay / (2 * np.pi * whole.freqs[0])
    top = max(6, min(settings.order_max // len(whole.inputs), whole.freqs.size // 3))
    poles = plscf(whole.data, whole.freqs, Plscf(max(2, top // 4), top, most))
    found = grouped(poles, whole.data, sigma=level, frfs=whole, at=everywhere)[1]
    start = merged([found], whole.freqs, whole.window_decay)
    pole, shape, conf = _settled(
        start,
        whole,
        halves=halves,
        level=level,
        duration=history.duration,
        least=settings.confidence_min,
    )
    rank = np.argsort(np.abs(pole), kind="stable")
    pole = pole[rank]
    shape = unit(shape[:, rank] * scale[:, None])
    ids = tuple(c.id for c in history.channels)
    none = np.full(pole.size, np.nan)
    modes = ModeSet(
        np.abs(pole) / (2 * np.pi),
        -pole.real / np.abs(pole),
        shape,
        ids,
        confidence=conf[rank],
    )
    return modes, Uncertainty.independent(none, none, np.full(shape.shape, np.nan))


def _lags(history: TimeHistory, settings: AmbientSettings) -> int:
    samples = history.data.shape[1]
    if samples < (needed := fewest_samples(settings)):
        raise DataError(
            f"{history.source}: {samples} samples are too few for half spectra; needed: {needed}"
        )
    return int(min(HALF.lags, samples // SAMPLES_A_LAG))


def _as_frfs(
    r: Float, part: TimeHistory, band: tuple[float, float], refs: Int
) -> FrfSet:
    """Half spectra of correlations `r` (lag, ch, ref), with the references as inputs."""
    half = half_spectra(r, part.rate, band)
    inputs = tuple(part.channels[i] for i in refs)
    return FrfSet(
        half.data,
        half.freqs,
        part.channels,
        inputs,
        kind="receptance",
        window_decay=half.decay,
    )


def _settled(
    c: CandidatePoles,
    whole: FrfSet,
    halves: Sequence[FrfSet],
    level: Noise,
    duration: float,
    least: float,
) -> tuple[Complex, Complex, Float]:
    """Refined poles (m,), shapes (ch, m) and confidence of those that have `least` of it.

    The confidence depends on the other modes: the worst goes, and the others are fitted anew.
    """
    lines = prepare(whole, level)
    # a pole may lose its damping in half of the record, and then stops no other where the window
    # keeps it stable
    one, two = (prepare(replace(x, window_decay=0.0), level) for x in halves)
    while c.pole.size:
        fit = refine(lines, c.pole, c.participation)
        c = c.at(fit)
        conf = assess_candidates(lines, fit, c, damping_max=DAMPING_MAX).confidence
        if (conf >= least).all():
            start = c.pole - whole.window_decay, c.participation
            conf = conf * _agreement(
                c.pole, refine(one, *start), refine(two, *start), duration
            )
        if (conf >= least).all():
            return fit.poles, fit.shapes, conf
        c = c.take(np.arange(conf.size) != conf.argmin())
    return c.pole, np.zeros((len(whole.outputs), 0), dtype=np.complex128), np.zeros(0)


def _agreement(pole: Complex, one: Refined, two: Refined, duration: float) -> Float:
    """(m,) 0..1: MAC of the shapes that both halves of the record give, less where their poles
    differ by more than chance makes of them.

    Both parts of the difference of two halves have twice the standard deviation of the record.
    """
    size = np.abs(pole)
    std, _ = least_deviations(size / (2 * np.pi), -pole.real / size, duration)
    reach = 4 * np.pi * by_chance() * std
    near: Float = np.clip(2 - np.abs(one.poles - two.poles) / reach, 0, 1)
    return near * np.diag(mac(one.shapes, two.shapes))
