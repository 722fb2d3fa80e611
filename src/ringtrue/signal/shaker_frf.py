"""FRFs from continuous records with one or several shakers: H1, Hv, coherences, their variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.channels import input_id
from ringtrue.core.motions import FORCES, FRF_KIND, LINEAR, MOTIONS
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.signal.spectra import Welch, csd, window

_ESTIMATORS = ("H1", "H2", "Hv")


@dataclass(frozen=True, slots=True, eq=False)
class ShakerFrfs:
    """FRFs of a record with running excitation.

    Attributes
    ----------
    frfs : FrfSet
        Its coherence is the partial one of each input with the others taken out, the ordinary one
        of a single input; `frf.frf_variance` holds with it. `averages` are independent segments
        less the other inputs.
    ordinary : (freq, out, in) float64
        Coherence of one input alone.
    multiple : (freq, out) float64
        Share of the response that all inputs together explain.
    condition : (freq,) float64
        Condition number of the scaled input spectra; large where two shakers do not act apart.
    """

    frfs: FrfSet
    ordinary: Float
    multiple: Float
    condition: Float


def independent_segments(samples: int, length: int, settings: Welch) -> float:
    """Segments of no overlap that have the variance of the given ones (Welch 1967, eq. 17)."""
    hop = max(1, round(length * (1 - settings.overlap)))
    count = (samples - length) // hop + 1
    w = window(settings.window, length)
    k = np.arange(1, min(count, -(-length // hop)))
    rho = np.array([(w[: length - i * hop] @ w[i * hop :]) / (w @ w) for i in k]) ** 2
    return float(count / (1 + 2 * ((1 - k / count) * rho).sum()))


def shaker_frfs(
    history: TimeHistory,
    settings: Welch,
    *,
    inputs: Sequence[str] = (),
    estimator: Literal["H1", "H2", "Hv"] = "H1",
) -> ShakerFrfs:
    """FRFs of all responses against all forces at once.

    H1 = G_yf G_ff⁻¹ (noise on the responses). Hv takes noise on both: the smallest eigenvector of
    the spectra of all forces and one response, each scaled to unit power; of one input it is the
    geometric mean of H1 and H2. Source: Bendat and Piersol (2010), Random Data, chapters 7 and 9;
    Rocklin, Crowley and Vold (1985) for Hv.

    Parameters
    ----------
    history : TimeHistory
    settings : Welch
    inputs : sequence of str, optional
        Ids of the force channels; by default all channels whose quantity is force.
    estimator : {"H1", "H2", "Hv"}
        H2 of one input only.

    Raises
    ------
    DataError
        If there is no force channel, a channel is constant or not finite, the responses are of
        different kinds, or the record has too few segments for its inputs.
    """
    if estimator not in _ESTIMATORS:
        raise ConfigError(f"estimator {estimator!r}{did_you_mean(estimator, _ESTIMATORS)}")
    ordered, q = sorted_channels(history, inputs)
    if estimator == "H2" and q > 1:
        raise ConfigError(f"H2 of {q} inputs is not determined; take H1 or Hv")
    spectra = csd(ordered, settings)
    length = round(history.rate / settings.resolution)
    n = independent_segments(history.data.shape[1], length, settings) - (q - 1)
    if n < 2:
        raise DataError(f"{history.source}: {n + q - 1:.3g} independent segments for {q} inputs")
    g = spectra.data[1:]  # the mean is taken out, there is nothing at 0 Hz
    h, partial, ordinary, multiple, condition = _estimate(g, q, estimator)
    frfs = FrfSet(
        h,
        spectra.freqs[1:],
        ordered.channels[q:],
        tuple(as_input(c) for c in ordered.channels[:q]),
        partial,
        np.full(q, n),
        MOTIONS[ordered.channels[q].quantity],
        0.0,
        history.source,
    )
    return ShakerFrfs(frfs, ordinary, multiple, condition)


def sorted_channels(history: TimeHistory, inputs: Sequence[str] = ()) -> tuple[TimeHistory, int]:
    """The record with its forces first, and their number.

    Raises
    ------
    DataError
        If there is no force channel, a channel is constant or not finite, or the responses are of
        different kinds.
    """
    forces = list(inputs) or [c.id for c in history.channels if c.quantity in FORCES]
    others = [c for c in history.channels if c.id not in forces and c.quantity not in FORCES]
    kinds = {LINEAR.get(c.quantity, c.quantity) for c in others}
    if not forces or len(kinds) != 1 or not kinds <= set(FRF_KIND):
        raise DataError(
            f"{history.source}: {len(forces)} forces and responses of "
            f"{', '.join(sorted(kinds)) or 'no kind'}; "
            "there must be a force and one kind of motion"
        )
    ordered = history.pick([*forces, *(c.id for c in others)])
    _check(ordered)
    return ordered, len(forces)


def as_input(channel: Channel) -> Channel:
    """The same channel under the name that FRFs have for a reference."""
    return replace(channel, id=input_id(channel.id))


def _check(history: TimeHistory) -> None:
    for channel, x in zip(history.channels, history.data, strict=True):
        low, high = float(x.min()), float(x.max())
        if not (np.isfinite(low) and np.isfinite(high) and high > low):
            raise DataError(
                f"{history.source}: channel {channel.id} is constant or not finite; leave it out"
            )


def _estimate(g: Complex, q: int, estimator: str) -> tuple[Complex, Float, Float, Float, Float]:
    """FRFs (f, out, in), partial and ordinary coherence (f, out, in), multiple (f, out), condition
    (f,).
    """
    power = np.maximum(np.einsum("fii->fi", g).real, np.finfo(np.float64).tiny)
    scale = np.sqrt(power)
    c = g / (
        scale[:, :, None] * scale[:, None, :]
    )  # scaled, so that no unit makes it ill-conditioned
    ff, yf = c[:, :q, :q], c[:, q:, :q]
    values, vectors = np.linalg.eigh(ff)
    condition = values[:, -1] / np.maximum(values[:, 0], np.finfo(np.float64).tiny)
    values = np.maximum(values, 1e-12 * values[:, -1:])
    inverse = (vectors / values[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    h1 = yf @ inverse
    multiple = np.clip(np.einsum("foi,foi->fo", h1, yf.conj()).real, 0.0, 1.0)
    alone = (
        np.abs(h1) ** 2 / np.einsum("fii->fi", inverse).real[:, None, :]
    )  # power of one input, others taken out
    partial = alone / np.maximum(alone + (1 - multiple)[:, :, None], np.finfo(np.float64).tiny)
    h = {"H1": h1, "H2": h1 / np.maximum(multiple, 1e-12)[:, :, None]}.get(estimator)
    h = _total(c, q) if h is None else h
    h = h * scale[:, q:, None] / scale[:, None, :q]
    return h, np.clip(partial, 0.0, 1.0), np.clip(np.abs(yf) ** 2, 0.0, 1.0), multiple, condition


def _total(c: Complex, q: int) -> Complex:
    """Total least squares of each response on all forces, scaled spectra (f, ch, ch) -> (f, out,
    in).
    """
    at = [np.append(np.arange(q), q + k) for k in range(c.shape[1] - q)]
    both = np.stack([c[:, i][:, :, i] for i in at], axis=1)  # (f, out, q + 1, q + 1)
    v = np.linalg.eigh(both)[1][..., 0].conj()
    return np.asarray(-v[..., :q] / v[..., q:])
