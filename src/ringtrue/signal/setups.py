"""Sets of FRFs joined to one: roving responses, roving hammers, several references."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.blows import joined
from ringtrue.core.motions import OF_KIND, as_motion, channel
from ringtrue.core.signals import FrfKind, FrfSet, shared_lines
from ringtrue.errors import DataError

log = logging.getLogger(__name__)

_SAME_END = 2e-3  # of the block, by which pulses of other width move its end


def setups_of(columns: Sequence[FrfSet]) -> tuple[FrfSet, ...]:
    """Those with the same responses joined: a set for each place that the sensors had."""
    same: dict[tuple[str, ...], list[FrfSet]] = {}
    for f in columns:
        same.setdefault(tuple(c.id for c in f.outputs), []).append(f)
    return tuple(join_frfs(some) for some in same.values())


def join_frfs(parts: Sequence[FrfSet]) -> FrfSet:
    """One set from several: roving responses (setups) and roving hammers.

    A pair of response and input that was measured several times is averaged, weighted by the number
    of hits.

    Raises
    ------
    DataError
        As `alike` does, or if a pair of response and input was never measured.
    """
    parts = alike(parts)
    first = parts[0]
    kept = np.array([p.kept for p in parts])
    same = bool(np.isfinite(kept).all()) and np.ptp(kept) < _SAME_END * kept.mean()
    outputs = {c.id: c for p in parts for c in p.outputs}
    inputs = {c.id: c for p in parts for c in p.inputs}
    row, column = {k: i for i, k in enumerate(outputs)}, {k: i for i, k in enumerate(inputs)}
    shape = (first.freqs.size, len(outputs), len(inputs))
    data, weight, coherence = (
        np.zeros(shape, dtype=np.complex128),
        np.zeros(shape[1:]),
        np.zeros(shape),
    )
    blows = []
    for p in parts:  # a few setups
        at = (
            np.array([row[c.id] for c in p.outputs])[:, None],
            np.array([column[c.id] for c in p.inputs]),
        )
        n = np.broadcast_to(
            np.where(np.isfinite(p.averages), p.averages, 1.0), (len(p.outputs), len(p.inputs))
        )
        data[:, at[0], at[1]] += p.data * n
        coherence[:, at[0], at[1]] += p.coherence * n
        weight[at] += n
        if p.blows:
            blows.append(np.zeros((len(p.blows.weight), *shape[1:])))
            blows[-1][:, at[0], at[1]] = p.blows.weight * n
    if (weight == 0).any():
        o, i = np.argwhere(weight == 0)[0]
        raise DataError(
            f"no FRF from {list(inputs)[i]} to {list(outputs)[o]}: {int((weight == 0).sum())} "
            "pairs were not measured"
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


def alike(parts: Sequence[FrfSet]) -> tuple[FrfSet, ...]:
    """Sets on the lines that all of them have, all of the kind of the first.

    Raises
    ------
    DataError
        If there is none, they share no more than half of the lines of the shortest, or windows
        differ.
    """
    if not parts:
        raise DataError("no FRFs to join")
    first = parts[0]
    for p in parts[1:]:
        if abs(p.window_decay - first.window_decay) > 1e-9:
            raise DataError(
                f"{p.source}: window of {p.window_decay:g} 1/s, {first.source} "
                f"{first.window_decay:g} 1/s"
            )
    at = shared_lines([p.freqs for p in parts])
    if at is None:
        told = ", ".join(
            f"{p.source} {_axis(p.freqs)}"
            for p in parts
            if not np.array_equal(p.freqs, first.freqs)
        )
        raise DataError(f"{told}: other frequency lines than {first.source}, {_axis(first.freqs)}")
    if lost := max(p.freqs.size - a.size for p, a in zip(parts, at, strict=True)):
        told = _axis(first.freqs[at[0]])
        log.warning(
            "%s: frequency lines differ (%d at most); the shared ones are used, %s",
            first.source,
            lost,
            told,
        )
    return tuple(_part(p, a, first.kind) for p, a in zip(parts, at, strict=True))


def _axis(freqs: Float) -> str:
    return f"{freqs.size} of {freqs[0]:g} to {freqs[-1]:g} Hz"


def _part(p: FrfSet, at: Int, kind: FrfKind) -> FrfSet:
    """The FRFs at some lines, as those of a kind."""
    if p.kind == kind and at.size == p.freqs.size:
        return p
    motion, wanted = OF_KIND[p.kind], OF_KIND[kind]
    data = as_motion(p.data[at], p.freqs[at], motion, wanted, p.window_decay)
    outputs = tuple(replace(channel(c.id, wanted), sensor=c.sensor) for c in p.outputs)
    return replace(
        p, data=data, freqs=p.freqs[at], coherence=p.coherence[at], outputs=outputs, kind=kind
    )
