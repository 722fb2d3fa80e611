"""Ambient modes by another method than SSI-cov, in the bands of `identify_ambient`: a second opinion on a record.

The half spectra of pLSCF are those of Peeters and Van der Auweraer (2005), "PolyMAX: a revolution in operational modal
analysis", IOMAC: the correlations at positive lags under an exponential window, whose decay is taken out of the poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress, quiet
from ringtrue.core.signals import TimeHistory
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.identify.ambient import AmbientSettings, bands_for
from ringtrue.identify.ambient_record import AT_EDGE, filter_edges, long_enough
from ringtrue.identify.bayes import bayes_fft
from ringtrue.identify.era import next_era
from ringtrue.identify.fdd import FddSettings, fdd
from ringtrue.identify.fdd import Method as FddMethod
from ringtrue.identify.opinion import SecondOpinion
from ringtrue.identify.pick import modes_of
from ringtrue.identify.plscf import Plscf, cluster_poles, plscf, pole_shapes
from ringtrue.identify.poles import PoleSet, unit
from ringtrue.identify.ssi import SsiCov, choose_references, prepared
from ringtrue.identify.ssi_data import ssi_data
from ringtrue.shapes.complexity import mpc
from ringtrue.shapes.mac import mac
from ringtrue.signal.gaps import bridged
from ringtrue.signal.preprocess import Band, band_signals, usable
from ringtrue.signal.psd import correlations

Method = Literal["plscf", "era", "ssi-data", "fdd", "efdd", "fsdd", "random-decrement", "bayes"]
METHODS: tuple[str, ...] = get_args(Method)
NAMES = {
    "plscf": "pLSCF on half spectra",
    "era": "ERA on correlations (NExT)",
    "ssi-data": "SSI-data",
    "fdd": "FDD",
    "efdd": "EFDD",
    "fsdd": "FSDD",
    "random-decrement": "FDD with random decrement",
    "bayes": "Bayesian FFT",
}
NO_STD = {
    "plscf": "no standard deviations: pLSCF on half spectra has none here",
    "era": "no standard deviations: ERA has none here",
    "efdd": "no standard deviations: EFDD has none here",
    "random-decrement": "no standard deviations: random decrement has none here",
}
_FDD: dict[str, FddMethod] = {
    "fdd": "fsdd",
    "fsdd": "fsdd",
    "efdd": "efdd",
    "random-decrement": "random decrement",
}
LAGS, ENDS_AT = 400, 0.01  # of a half spectrum, and what the exponential window leaves at the last of them
FEWEST_LAGS, SAMPLES_A_LAG = 64, 8
MOST_REFERENCES = 8
ORDERS = {"era": 60, "ssi-data": 40}
SAME_F, SAME_MAC = 0.01, 0.8  # one mode in two overlapping bands


def identify_ambient_by(
    method: str,
    history: TimeHistory,
    settings: AmbientSettings | None = None,
    *,
    near: Sequence[float] = (),
    progress: Progress | None = None,
) -> SecondOpinion:
    """Modes of an ambient record by one of `METHODS`.

    Parameters
    ----------
    method : str
    history : TimeHistory
    settings : AmbientSettings
        Band and references.
    near : sequence of float, Hz
        Peaks of the FDD family; first guesses of the Bayesian FFT, by default the highest peak of the band.
    progress : callable, optional

    Raises
    ------
    ConfigError
        If there is no such method, or the Bayesian FFT has no band.
    DataError
        If no channel is usable or the record is too short.
    """
    if method not in METHODS:
        raise ConfigError(f"method {method!r}{did_you_mean(method, METHODS)}")
    s, tell = settings or AmbientSettings(), progress or quiet
    whole, gaps = bridged(history)
    good, states = usable(whole)
    notes = gaps.notes + tuple(c.note for c in states)
    tell(0.0, NAMES[method])
    if method == "bayes":
        modes, std = _bayes(good, s, near)
    elif method in _FDD:
        found = fdd(good, FddSettings(_FDD[method], fmin=s.fmin or 0.0, fmax=s.fmax or 0.0), near=near)
        modes, std = found.modes, found.uncertainty
    else:
        (modes, std), short = _in_bands(method, good, s, tell)
        notes += short
    edge = np.array(filter_edges(good, modes.frequencies, modes.damping), dtype=bool)
    notes += tuple(f"pole at {f:.4g} Hz {AT_EDGE}" for f in modes.frequencies[edge])
    modes, std = modes.take(np.flatnonzero(~edge)), std.take(np.flatnonzero(~edge))
    modes = replace(modes, source=f"{history.source or 'record'}: {NAMES[method]}")
    reasons = tuple(_reason(method, c) for c in modes.confidence)
    more = (
        (*((NO_STD[method],) if method in NO_STD else ()), "shapes have no standard deviations") if len(modes) else ()
    )
    return SecondOpinion(modes, std, reasons, (*notes, *(more if method != "bayes" else ())))


def _reason(method: str, confidence: float) -> str:
    if method == "bayes":
        return "most probable in its band"
    what = "mean MAC over the bell" if method in _FDD else "share of the orders times MPC"
    return f"{NAMES[method]}: {what} {confidence:.2f}"


def _bayes(history: TimeHistory, s: AmbientSettings, near: Sequence[float]) -> tuple[ModeSet, Uncertainty]:
    if s.fmin is None or s.fmax is None:
        raise ConfigError("the Bayesian FFT needs a narrow band that holds its modes and no other: give fmin and fmax")
    guesses = list(near)
    if not guesses:
        found = fdd(history, FddSettings("efdd", fmin=s.fmin, fmax=s.fmax))
        inside = found.modes.band(s.fmin, s.fmax).frequencies
        if not inside.size:
            at = (found.freqs > s.fmin) & (found.freqs < s.fmax)
            if not at.any():
                raise DataError(f"{history.source}: no line between {s.fmin:g} and {s.fmax:g} Hz")
            inside = found.freqs[at][[found.singular[at, 0].argmax()]]
        guesses = inside[:1].tolist() if inside.size == 1 else inside.tolist()
    result = bayes_fft(history, (s.fmin, s.fmax), guesses)
    return result.modes, result.uncertainty


def _in_bands(
    method: str, history: TimeHistory, s: AmbientSettings, tell: Progress
) -> tuple[tuple[ModeSet, Uncertainty], tuple[str, ...]]:
    """Modes of every band of the pyramid, in overlaps those of more confidence; bands too short for the method."""
    every = long_enough(bands_for(history.rate, history.duration, s), history)
    bands = long_enough(every, history, _fewest(method, len(history.channels), s))
    ids = tuple(c.id for c in history.channels)
    found = []
    for k, band in enumerate(bands):
        tell(k / len(bands), f"{NAMES[method]}: {band.low:.3g} .. {band.high:.3g} Hz")
        data, rate = band_signals(history.data, history.rate, (Band(band.low, band.high, band.rate),))[0]
        part = TimeHistory(np.asarray(data, dtype=np.float64), rate, history.channels, history.source)
        poles = _poles(method, part, band, s)
        modes, std = _clustered(poles, ids, rate / LAGS) if method == "plscf" else modes_of(poles, ids)
        inside = (modes.frequencies >= band.low) & (modes.frequencies <= band.high)
        inside &= modes.confidence >= s.confidence_min
        at = np.flatnonzero(inside)
        found.append((modes.take(at), std.take(at)))
    low = min(b.low for b in bands)
    short = f"below {low:.3g} Hz the record is too short for {NAMES[method]}"
    return _joined(found), (short,) if len(bands) < len(every) else ()


def _fewest(method: str, channels: int, s: AmbientSettings) -> int:
    """Samples of a band that a method needs, and a few that decimation cuts."""
    rows, references = _data_rows(channels, s), len(s.references or ()) or min(channels, MOST_REFERENCES)
    needed = {
        "plscf": SAMPLES_A_LAG * FEWEST_LAGS,
        "era": 8 * s.block_rows,
        "ssi-data": 2 * rows * (channels + references + 1),
    }
    return needed[method] + 16


def _data_rows(channels: int, s: AmbientSettings) -> int:
    return max(4, min(s.block_rows, 400 // max(channels, 1)) // 2)


def _poles(method: str, part: TimeHistory, band: Band, s: AmbientSettings) -> PoleSet:
    references = s.references or None
    if method == "era":
        return next_era(part, SsiCov(s.block_rows, ORDERS["era"]), references=references)
    if method == "ssi-data":
        rows = _data_rows(len(part.channels), s)
        chosen = references or [part.channels[i].id for i in _span(part)]
        return ssi_data(part, SsiCov(rows, ORDERS["ssi-data"]), references=chosen)
    return half_spectra_poles(part, (band.low, band.high), references)


def _clustered(poles: PoleSet, ids: tuple[str, ...], step: float) -> tuple[ModeSet, Uncertainty]:
    """A mode for each cluster that half of the orders show, from its first on."""
    c = cluster_poles(poles, step)
    at = np.flatnonzero(c.support >= 0.5)
    shape = unit(c.participation[:, at])
    sure = np.clip(c.support[at] * np.sqrt(mpc(shape)), 0, 1) if at.size else np.zeros(0)
    pole, none = c.pole[at], np.full(at.size, np.nan)
    modes = ModeSet(np.abs(pole) / (2 * np.pi), -pole.real / np.abs(pole), shape, ids, confidence=sure)
    return modes, Uncertainty.independent(none, none, np.full(shape.shape, np.nan))


def _span(part: TimeHistory) -> Int:
    data, _ = prepared(part)
    return choose_references(data, np.ones(len(data)), MOST_REFERENCES)


def half_spectra_poles(
    history: TimeHistory, band: tuple[float, float], references: Sequence[str] | None = None
) -> PoleSet:
    """Poles of all orders by poly-reference LSCF on the half spectra of a band (Hz); no standard deviations.

    Raises
    ------
    DataError
        If the record is too short for its lags.
    """
    data, scale = prepared(history)
    lags = min(LAGS, data.shape[1] // SAMPLES_A_LAG)
    if lags < FEWEST_LAGS:
        raise DataError(
            f"{history.source}: {data.shape[1]} samples are too few for half spectra; "
            f"needed: {SAMPLES_A_LAG * FEWEST_LAGS}"
        )
    ids = [c.id for c in history.channels]
    refs = _span(history) if references is None else np.array([ids.index(r) for r in references], dtype=np.int64)
    decay = -np.log(ENDS_AT) * history.rate / lags
    r = correlations(data, refs, lags)[1:] * np.exp(-decay * np.arange(1, lags + 1) / history.rate)[:, None, None]
    freqs = np.arange(lags // 2 + 1) * history.rate / lags
    half = np.fft.rfft(r, axis=0) * np.exp(-2j * np.pi * freqs / history.rate)[:, None, None]  # lag 0, noise, is out
    at = (freqs >= 0.9 * band[0]) & (freqs <= min(1.1 * band[1], 0.48 * history.rate)) & (freqs > 0)
    most = 0.2 + decay / (2 * np.pi * freqs[at][0])
    top = max(6, min(40, 120 // refs.size, int(at.sum()) // 3))
    poles = plscf(half[at], freqs[at], Plscf(max(2, top // 4), top, most))
    shape = pole_shapes(poles, half[at], freqs[at], 0)
    true = poles.pole + decay
    keep = true.real < 0
    moved = replace(poles, pole=true, shape=unit(shape * scale[:, None]))
    return moved.take(keep)


def _joined(found: Sequence[tuple[ModeSet, Uncertainty]]) -> tuple[ModeSet, Uncertainty]:
    """All modes ascending; of two alike in bands that overlap the one of more confidence."""
    f, z = (np.concatenate([getattr(m, x) for m, _ in found]) for x in ("frequencies", "damping"))
    shapes = np.concatenate([m.shapes for m, _ in found], axis=1)
    sure = np.concatenate([m.confidence for m, _ in found])
    std = [np.concatenate([getattr(u, x) for _, u in found]) for x in ("frequency", "damping")]
    band = np.repeat(np.arange(len(found)), [len(m) for m, _ in found])
    same = (np.abs(f[:, None] / f - 1) < SAME_F) & (band[:, None] != band)
    same &= mac(shapes, shapes) > SAME_MAC if f.size else same
    better = (sure[None] > sure[:, None]) | ((sure[None] == sure[:, None]) & (band[None] < band[:, None]))
    keep = np.flatnonzero(~(same & better).any(axis=1))
    keep = keep[np.argsort(f[keep], kind="stable")]
    modes = ModeSet(f[keep], z[keep], shapes[:, keep], found[0][0].channels, confidence=sure[keep])
    return modes, Uncertainty.independent(std[0][keep], std[1][keep], np.full(modes.shapes.shape, np.nan))
