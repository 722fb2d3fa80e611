"""Overloads of blows and their responses: by the range of a channel, or by what clipping leaves in
the samples.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager

import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.preprocess import channel_states

_NEAR_FULL = 0.985  # of the range counts as an overload
_ALIKE, _UNLIKE, _FINE = (
    3,
    1e-3,
    1e-4,
)  # peaks that are one; how unlike what is around them; resolution of a peak
_AROUND = 8  # samples
_FLAT = 4  # equal extreme samples in a row that give clipping away where no range is known


def ceilings(record: TimeHistory) -> dict[str, float]:
    """Ranges by id of channels that clip for a sample or two: unlike peaks of a blow or of a
    response are one value.
    """
    out = {}
    for channel, x in zip(record.channels, record.data, strict=True):
        for peak in (max(float(x.max()), 0.0), min(float(x.min()), 0.0)):
            at = np.flatnonzero(x >= (1 - 1e-6) * peak if peak > 0 else x <= (1 - 1e-6) * peak)
            if peak and at.size >= _ALIKE and _clipped(x, at, abs(peak)):
                out[channel.id] = abs(peak)
    return out


def clipping(record: TimeHistory) -> tuple[str, ...]:
    """A line for each channel that is clipped: at what value, and in how many of its samples."""
    cut = {s.id for s in channel_states(record) if s.why.startswith("clipped")}
    out = []
    for channel, x in zip(record.channels, record.data, strict=True):
        if channel.id not in cut:
            continue
        low, high = float(x.min()), float(x.max())
        count = np.count_nonzero((x == low) | (x == high))
        ends = f"±{high:.4g}" if abs(high + low) < 1e-3 * high else f"{low:.4g} and {high:.4g}"
        out.append(
            f"channel {channel.id}: clipped at {ends} {channel.unit} in {count:,} of {x.size:,} "
            "samples"
        )
    return tuple(out)


@contextmanager
def clipping_told(lines: Sequence[str]) -> Iterator[None]:
    """What goes wrong inside with records that are clipped is said to be of that, by the `lines` of
    `clipping`.
    """
    try:
        yield
    except DataError as exc:
        if lines:
            raise DataError(
                f"{'; '.join(lines[:4])}: measure again with a larger range ({exc})"
            ) from exc
        raise


def _clipped(x: Any_, at: Int, peak: float) -> bool:
    """Whether a signal (sample,) is finely resolved, and what is around its equal peaks is
    unlike.
    """
    step = np.diff(np.unique(np.asarray(x[: 1 << 16], dtype=np.float64)))
    if not step.size or step[step > 0].min(initial=np.inf) > _FINE * peak:
        return False
    around = [np.abs(x[max(i - _AROUND, 0) : i + _AROUND + 1]).sum() for i in at.tolist()]
    return bool(np.ptp(around) > _UNLIKE * max(around))


def overloaded(record: TimeHistory, block: Any_, full_scale: Mapping[str, float]) -> list[str]:
    """Ids of the channels of a block (channel, sample) at the end of their range, or where unknown,
    flat at the top.
    """
    peak = np.abs(block).max(axis=1)
    limit = np.array([full_scale.get(c.id, np.inf) for c in record.channels])
    over = peak >= _NEAR_FULL * limit
    unknown = np.isinf(limit)
    if unknown.any():
        flat = np.abs(block[unknown]) >= (1 - 1e-6) * peak[unknown, None]
        runs = np.ones((int(unknown.sum()), block.shape[1] - _FLAT + 1), dtype=bool)
        for i in range(_FLAT):
            runs &= flat[:, i : runs.shape[1] + i]
        over[unknown] = runs.any(axis=1) & (peak[unknown] > 0)
    return [c.id for c, o in zip(record.channels, over, strict=True) if o]


def mostly(responses: Set[str], over: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Ids of the responses that overload in more than half of the blows, none if all do; `over` is
    a list a blow.
    """
    count = Counter(c for ids in over for c in ids if c in responses)
    lost = tuple(c for c, n in count.items() if 2 * n > len(over))
    return lost if len(lost) < len(responses) else ()
