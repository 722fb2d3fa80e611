"""Channels that read an FRF otherwise in one setup than in the others: a gain, or a sign.

A channel that stays in place over several setups measures the same FRFs in each. Where one setup
has them times a real factor at all lines and of all inputs, its gain, unit or cable was another
there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.signals import Channel, FrfSet


@dataclass(frozen=True, slots=True)
class SetupGainLimits:
    """When a factor is a fault.

    Attributes
    ----------
    spread : float
        Distance from 1 in robust standard deviations of all factors of the test (logarithms).
    ratio : float
        Smallest factor, its inverse below 1: what calibrations, added masses and other temperatures
        make is smaller.
    coherent : float
        Least share of the FRFs of both setups that one factor explains.
    """

    spread: float = 6.0
    ratio: float = 1.1
    coherent: float = 0.9


LIMITS = SetupGainLimits()


@dataclass(frozen=True, slots=True)
class SetupGain:
    """A channel that reads otherwise in one setup.

    Attributes
    ----------
    channel : str
    setup : int
        Position.
    factor : float
        What it reads there over what it reads in the others; negative: with the opposite sign.
    others : int
        Setups that it is compared with.
    """

    channel: str
    setup: int
    factor: float
    others: int


def setup_gains(
    setups: Sequence[FrfSet], limits: SetupGainLimits = LIMITS
) -> tuple[SetupGain, ...]:
    """Channels with another factor in one setup than in two or more others, which agree.

    Parameters
    ----------
    setups : sequence of FrfSet
        One a setup, of one kind and on the same lines.

    Notes
    -----
    A channel in two setups only says that they differ, not which is right; it is not named.
    """
    found = []
    levels = []
    for channel in dict.fromkeys(c.id for s in setups for c in s.outputs):
        here = [k for k, s in enumerate(setups) if channel in (c.id for c in s.outputs)]
        if len(here) < 3:
            continue
        factor, share = _factors([setups[k] for k in here], channel)
        usable = np.isfinite(factor) & (np.abs(factor) > 0)
        levels += np.log(np.abs(factor[usable])).tolist()
        found += [
            SetupGain(channel, here[k], float(factor[k]), len(here) - 1)
            for k in np.flatnonzero(usable & (share >= limits.coherent)).tolist()
        ]
    if not found:
        return ()
    spread = 1.4826 * float(np.median(np.abs(levels)))
    least = max(limits.spread * spread, float(np.log(limits.ratio)))
    return tuple(g for g in found if g.factor < 0 or abs(np.log(g.factor)) > least)


def _factors(setups: Sequence[FrfSet], channel: str) -> tuple[Float, Float]:
    """(k,) factor of each setup over the median of the others, and share of its FRFs that it
    explains.
    """
    common = [i.id for i in setups[0].inputs if all(i.id in _ids(s.inputs) for s in setups)]
    if not common:
        return np.full(len(setups), np.nan), np.zeros(len(setups))
    readings = []
    for s in setups:
        row = _ids(s.outputs).index(channel)
        columns = [_ids(s.inputs).index(i) for i in common]
        readings.append(s.data[:, row, columns].ravel())
    rows = np.array(readings)  # (k, line·input)
    product = (rows.conj() @ rows.T).real
    power = np.maximum(np.diag(product), 1e-300)
    ratio = product / power[:, None]  # what column reads over what row reads
    np.fill_diagonal(ratio, np.nan)
    like = np.abs(product) / np.sqrt(power[:, None] * power)
    np.fill_diagonal(like, np.nan)
    return np.asarray(np.nanmedian(ratio, axis=0)), np.asarray(np.nanmedian(like, axis=0))


def _ids(channels: Sequence[Channel]) -> list[str]:
    return [c.id for c in channels]


def without_gains(frfs: FrfSet, gains: Sequence[SetupGain], setups: Sequence[FrfSet]) -> FrfSet:
    """FRFs of one of the setups with the factors of its channels taken out."""
    mine = [_ids(s.outputs) == _ids(frfs.outputs) for s in setups].index(True)
    factor = {g.channel: g.factor for g in gains if g.setup == mine}
    if not factor:
        return frfs
    rows = np.array([factor.get(c.id, 1.0) for c in frfs.outputs])
    return replace(frfs, data=frfs.data / rows[:, None])
