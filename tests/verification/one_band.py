"""SSI-cov of a record as it stands: one band, no decimation, as its peers do it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.signals import TimeHistory
from ringtrue.identification.ambient.ssi_cov import (
    MAX_REFERENCES,
    SsiCov,
    all_orders,
    block_power,
    identify_band,
    positions,
    spanning,
    subspace,
)
from ringtrue.identification.common.stabilisation import PoleSet
from ringtrue.identification.common.uncertainty import blocks_for
from ringtrue.signal import band_correlations
from ringtrue.signal.band_correlations import Signals
from ringtrue.signal.spectra import Band, Fir, block_weights


def ssi_cov(
    history: TimeHistory, settings: SsiCov, *, references: Sequence[str] | None = None
) -> PoleSet:
    """Poles of all model orders; `references` are channels, or those that span the motion best."""
    signals = Signals.of(history.data)
    plain = Fir(np.ones(1))
    lags = 2 * settings.block_rows - 1
    blocks = settings.blocks or blocks_for(signals.samples, lags)
    cut = band_correlations.segments(
        signals.samples, blocks, lags, plain, plain, references=8
    )
    if references is None:
        _, lagged = band_correlations.glance(signals, cut, plain)
        refs = spanning(lagged, MAX_REFERENCES)
    else:
        refs = positions(history, references)
    r, _ = band_correlations.run(signals, cut, plain, plain, refs)
    used = band_correlations.pairs(cut, signals.samples)[:, 0]
    scale = np.sqrt(signals.power())
    r /= (scale[:, None] * scale[refs]).astype(np.float32)
    weights = block_weights(block_power(r, refs)) * used
    band = Band(0.0, history.rate / 2, history.rate)
    if len(r) == 1:
        mean = r[0].astype(np.float64)
        whole = subspace(mean, settings, history.rate)
        return all_orders(whole, None, settings, (0.0, band.high))[0].rescaled(scale)
    share = weights / weights.sum()
    found = identify_band(r, share, settings, band)
    return found.poles.rescaled(scale)
