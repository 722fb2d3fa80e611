"""Sets of FRFs joined to one: roving responses, roving hammers, several references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.blows import joined
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError

_SAME_END = 2e-3  # of the block, by which pulses of other width move its end


def setups_of(columns: Sequence[FrfSet]) -> tuple[FrfSet, ...]:
    """Those with the same responses joined: a set for each place that the sensors had."""
    alike: dict[tuple[str, ...], list[FrfSet]] = {}
    for f in columns:
        alike.setdefault(tuple(c.id for c in f.outputs), []).append(f)
    return tuple(join_frfs(some) for some in alike.values())


def join_frfs(parts: Sequence[FrfSet]) -> FrfSet:
    """One set from several: roving responses (setups) and roving hammers.

    A pair of response and input that was measured several times is averaged, weighted by the number of hits.

    Raises
    ------
    DataError
        If lines, kinds or windows differ, or a pair of response and input was never measured.
    """
    if not parts:
        raise DataError("no FRFs to join")
    first = parts[0]
    for p in parts[1:]:
        if p.freqs.shape != first.freqs.shape or np.abs(p.freqs - first.freqs).max() > 1e-6 * first.freqs[-1]:
            raise DataError(f"{p.source}: other frequency lines than {first.source}")
        if p.kind != first.kind or abs(p.window_decay - first.window_decay) > 1e-9:
            raise DataError(f"{p.source}: {p.kind}, window {p.window_decay:g} 1/s; {first.source} differs")
    kept = np.array([p.kept for p in parts])
    same = bool(np.isfinite(kept).all()) and np.ptp(kept) < _SAME_END * kept.mean()
    outputs = {c.id: c for p in parts for c in p.outputs}
    inputs = {c.id: c for p in parts for c in p.inputs}
    row, column = {k: i for i, k in enumerate(outputs)}, {k: i for i, k in enumerate(inputs)}
    shape = (first.freqs.size, len(outputs), len(inputs))
    data, weight, coherence = np.zeros(shape, dtype=np.complex128), np.zeros(shape[1:]), np.zeros(shape)
    blows = []
    for p in parts:  # a few setups
        at = np.array([row[c.id] for c in p.outputs])[:, None], np.array([column[c.id] for c in p.inputs])
        n = np.broadcast_to(np.where(np.isfinite(p.averages), p.averages, 1.0), (len(p.outputs), len(p.inputs)))
        data[:, at[0], at[1]] += p.data * n
        coherence[:, at[0], at[1]] += p.coherence * n
        weight[at] += n
        if p.blows:
            blows.append(np.zeros((len(p.blows.weight), *shape[1:])))
            blows[-1][:, at[0], at[1]] = p.blows.weight * n
    if (weight == 0).any():
        o, i = np.argwhere(weight == 0)[0]
        raise DataError(
            f"no FRF from {list(inputs)[i]} to {list(outputs)[o]}: {int((weight == 0).sum())} pairs were not measured"
        )
    return replace(
        first,
        data=data / weight,
        outputs=tuple(outputs.values()),
        inputs=tuple(inputs.values()),
        coherence=coherence / weight,
        averages=np.median(weight, axis=0),
        kept=float(kept.mean()) if same else np.inf,
        sharp=all(p.sharp for p in parts),
        blows=joined([p.blows for p in parts], [b / weight for b in blows]),
        source=", ".join(dict.fromkeys(p.source for p in parts if p.source)),
    )
