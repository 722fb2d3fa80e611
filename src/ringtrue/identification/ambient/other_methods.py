"""Ambient modes by another method than SSI-cov, in the bands of `identify_ambient`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.progress import Progress, quiet
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.identification.ambient.era import next_era
from ringtrue.identification.ambient.fdd import FddSettings, fdd
from ringtrue.identification.ambient.fdd import Method as FddMethod
from ringtrue.identification.ambient.pipeline import AmbientSettings, bands_for, lowest
from ringtrue.identification.ambient.plscf import FEWEST_LAGS, SAMPLES_A_LAG, half_spectra_modes
from ringtrue.identification.ambient.record_checks import AT_EDGE, filter_edges, long_enough
from ringtrue.identification.ambient.ssi_cov import MAX_REFERENCES, SsiCov
from ringtrue.identification.ambient.ssi_data import ssi_data
from ringtrue.identification.common.poles import PoleSet
from ringtrue.identification.common.stabilisation import confirmed, modes_of
from ringtrue.shapes.mac import mac
from ringtrue.signal.channel_checks import usable
from ringtrue.signal.decimation import Band, band_signals, remove_drift, scaled, unit_factor
from ringtrue.signal.gaps import bridge_gaps

Method = Literal["plscf", "era", "ssi-data", "fdd", "efdd", "fsdd", "random-decrement"]
METHODS: tuple[str, ...] = get_args(Method)
NAMES = {
    "plscf": "pLSCF on half spectra",
    "era": "ERA on correlations (NExT)",
    "ssi-data": "SSI-data",
    "fdd": "FDD",
    "efdd": "EFDD",
    "fsdd": "FSDD",
    "random-decrement": "FDD with random decrement",
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
ORDERS = {"era": 60, "ssi-data": 40}
SAME_F, SAME_MAC = 0.01, 0.8  # one mode in two overlapping bands


@dataclass(frozen=True, slots=True, eq=False)
class SecondOpinion:
    """Modes by one method.

    Attributes
    ----------
    modes : ModeSet
    uncertainty : Uncertainty
        NaN where the method states none.
    reasons, notes : tuple of str
    """

    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    notes: tuple[str, ...]


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
        Peaks of the FDD family.
    progress : callable, optional

    Raises
    ------
    ConfigError
        If there is no such method.
    DataError
        If no channel is usable or the record is too short.
    """
    if method not in METHODS:
        raise ConfigError(f"method {method!r}{did_you_mean(method, METHODS)}")
    s, tell = settings or AmbientSettings(), progress or quiet
    whole, gaps = bridge_gaps(history)
    good, states = usable(whole)
    good = remove_drift(good, lowest(good.duration, s))
    good = scaled(good, unit_factor(good))
    notes = gaps.notes + tuple(c.note for c in states)
    tell(0.0, NAMES[method])
    if method in _FDD:
        found = fdd(
            good, FddSettings(_FDD[method], fmin=s.fmin or 0.0, fmax=s.fmax or 0.0), near=near
        )
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
        (*((NO_STD[method],) if method in NO_STD else ()), "shapes have no standard deviations")
        if len(modes)
        else ()
    )
    return SecondOpinion(modes, std, reasons, (*notes, *more))


def _reason(method: str, confidence: float) -> str:
    what = "mean MAC over the bell" if method in _FDD else "share of the orders times MPC"
    if method == "plscf":
        what = "verdict on the fit"
    also = " and agreement of both halves of the record" if method in ("plscf", "era") else ""
    return f"{NAMES[method]}: {what}{also} {confidence:.2f}"


def _in_bands(
    method: str, history: TimeHistory, s: AmbientSettings, tell: Progress
) -> tuple[tuple[ModeSet, Uncertainty], tuple[str, ...]]:
    """Modes of every band of the pyramid, in overlaps those of more confidence; bands too short for
    the method.
    """
    every = long_enough(bands_for(history.rate, history.duration, s), history)
    bands = long_enough(every, history, _fewest(method, len(history.channels), s))
    ids = tuple(c.id for c in history.channels)
    found = []
    for k, band in enumerate(bands):
        tell(k / len(bands), f"{NAMES[method]}: {band.low:.3g} .. {band.high:.3g} Hz")
        data, rate = band_signals(
            history.data, history.rate, (Band(band.low, band.high, band.rate),)
        )[0]
        part = TimeHistory(
            np.asarray(data, dtype=np.float64), rate, history.channels, history.source
        )
        if method == "plscf":
            modes, std = half_spectra_modes(
                part, (band.low, band.high), s.references or None, s.confidence_min
            )
        else:
            modes, std = modes_of(_poles(method, part, s), ids)
            if method in NO_STD:  # nothing judged the poles
                one, two = (
                    _poles(method, replace(part, data=x), s)
                    for x in np.array_split(part.data, 2, axis=1)
                )
                modes = confirmed(modes, (one, two), part.duration)
        inside = (modes.frequencies >= band.low) & (modes.frequencies <= band.high)
        inside &= modes.confidence >= s.confidence_min
        at = np.flatnonzero(inside)
        found.append((modes.take(at), std.take(at)))
    low = min(b.low for b in bands)
    short = f"below {low:.3g} Hz the record is too short for {NAMES[method]}"
    return _joined(found), (short,) if len(bands) < len(every) else ()


def _fewest(method: str, channels: int, s: AmbientSettings) -> int:
    """Samples of a band that a method needs, and a few that decimation cuts."""
    rows, references = _data_rows(channels, s), len(s.references) or min(channels, MAX_REFERENCES)
    needed = {
        "plscf": SAMPLES_A_LAG * FEWEST_LAGS,
        "era": 8 * s.block_rows,
        "ssi-data": 2 * rows * (channels + references + 1),
    }
    return needed[method] + 16


def _data_rows(channels: int, s: AmbientSettings) -> int:
    return max(4, min(s.block_rows, 400 // max(channels, 1)) // 2)


def _poles(method: str, part: TimeHistory, s: AmbientSettings) -> PoleSet:
    """Poles of all orders; by ERA of half a short record with as many block rows as it has samples
    for.
    """
    if method == "era":
        rows = min(s.block_rows, part.data.shape[1] // 8)
        return next_era(part, SsiCov(rows, ORDERS["era"]), references=s.references or None)
    rows = _data_rows(len(part.channels), s)
    return ssi_data(part, SsiCov(rows, ORDERS["ssi-data"]), references=s.references or None)


def _joined(found: Sequence[tuple[ModeSet, Uncertainty]]) -> tuple[ModeSet, Uncertainty]:
    """All modes ascending; of two alike in bands that overlap the one of more confidence."""
    f, z = (np.concatenate([getattr(m, x) for m, _ in found]) for x in ("frequencies", "damping"))
    shapes = np.concatenate([m.shapes for m, _ in found], axis=1)
    sure = np.concatenate([m.confidence for m, _ in found])
    std = [np.concatenate([getattr(u, x) for _, u in found]) for x in ("frequency", "damping")]
    band = np.repeat(np.arange(len(found)), [len(m) for m, _ in found])
    same = (np.abs(f[:, None] / f - 1) < SAME_F) & (band[:, None] != band)
    same &= mac(shapes, shapes) > SAME_MAC if f.size else same
    better = (sure[None] > sure[:, None]) | (
        (sure[None] == sure[:, None]) & (band[None] < band[:, None])
    )
    keep = np.flatnonzero(~(same & better).any(axis=1))
    keep = keep[np.argsort(f[keep], kind="stable")]
    modes = ModeSet(f[keep], z[keep], shapes[:, keep], found[0][0].channels, confidence=sure[keep])
    return modes, Uncertainty.independent(
        std[0][keep], std[1][keep], np.full(modes.shapes.shape, np.nan)
    )
