"""FRFs of the time records of a test with measured forces: blows, or shakers that run all the
time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.progress import Progress
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.signal.channel_checks import clipping, explain_clipping
from ringtrue.signal.frf import estimate_columns
from ringtrue.signal.impacts import Estimator, HammerSettings, ImpactReport
from ringtrue.signal.local_rational import is_continuous, local_frfs, period, periodic_frfs, spacing
from ringtrue.signal.shaker_frf import shaker_frfs
from ringtrue.signal.spectra import Welch

_BEYOND = 1.05  # times the end of the force
_ENDS = 0.45  # of the rate: an anti-aliasing filter ends there too


@dataclass(frozen=True, slots=True, eq=False)
class Forced:
    """FRFs of records, before they are joined.

    Attributes
    ----------
    columns : tuple of FrfSet
        On the same lines.
    hits : tuple of ImpactReport
        The blows; none of shakers.
    notes : tuple of str
        Responses that overload, points at which the force has the other sign, where the FRFs of
        blows end because the force does; how those of shakers were estimated.
    clipped : tuple of str
        Channels that are clipped, a line each.
    """

    columns: tuple[FrfSet, ...]
    hits: tuple[ImpactReport, ...] = ()
    notes: tuple[str, ...] = ()
    clipped: tuple[str, ...] = ()


def forced_frfs(
    records: Sequence[TimeHistory],
    settings: HammerSettings,
    resolution: float | None = None,
    *,
    full_scale: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Forced:
    """FRFs of records as `study.blows` reads them: of shakers where all forces run all the time,
    else of blows.

    Parameters
    ----------
    records : sequence of TimeHistory, SI, equal rates
    settings : HammerSettings
        Of blows; its estimator holds for shakers, too.
    resolution : float, Hz, optional
        Distance of the lines of shakers; they are shakers if it is given.
    full_scale : mapping of str to float, optional
        Range of each channel by id, in its unit; for the detection of overloads.
    progress : callable, optional

    Raises
    ------
    DataError
        As `signal.frf.estimate_columns`, `signal.local_rational.local_frfs` and
        `signal.shaker_frf.shaker_frfs` do.
    """
    clipped = tuple(f"{r.source}: {line}" for r in records for line in clipping(r))
    with explain_clipping(clipped):
        return replace(
            _estimated(records, settings, resolution, full_scale, progress), clipped=clipped
        )


def _estimated(
    records: Sequence[TimeHistory],
    settings: HammerSettings,
    resolution: float | None,
    full_scale: Mapping[str, float] | None,
    progress: Progress | None,
) -> Forced:
    if resolution is None and not all(is_continuous(r) for r in records):
        columns, hits = estimate_columns(
            records, settings, full_scale=full_scale, progress=progress
        )
        lost = dict.fromkeys(c for h in hits for c in h.lost)
        told = (f"response {' '.join(lost)}: overload in most blows, left out",) if lost else ()
        notes = (*told, *_turned(hits), *_force_end(columns, records[0].rate, settings.keep_to))
        return Forced(columns, hits, notes)
    parts = tuple(_shaken(records, resolution, settings.estimator))
    step, averages = float(np.median(np.diff(parts[0].freqs))), parts[0].averages[0]
    said = (
        f"the force runs all the time: lines {step:.3g} Hz apart, {averages:.3g} averages at each"
    )
    return Forced(parts, notes=(said,))


def _turned(hits: Sequence[ImpactReport]) -> tuple[str, ...]:
    """A line where a hammer, which can only push, has forces of one sign at some points and of the
    other elsewhere.
    """
    peaks: dict[str, list[float]] = {}
    for h in hits:
        if h.accepted:
            peaks.setdefault(h.input, []).append(h.peak)
    below = [point for point, peak in peaks.items() if np.median(peak) < 0]
    if not 0 < len(below) < len(peaks):
        return ()
    above = [point for point in peaks if point not in below]
    sign, few = ("negative", below) if len(below) <= len(above) else ("positive", above)
    return (
        f"the force is {sign} at "
        f"{' '.join(few[:8])}{f' and {len(few) - 8} more' if len(few) > 8 else ''}, and of the "
        "other sign elsewhere: unless that is the direction of the blow, the shapes are turned "
        "there",
    )


def _force_end(columns: Sequence[FrfSet], rate: float, keep_to: float | None) -> tuple[str, ...]:
    """A line where the force of blows sampled at `rate`, Hz, ends before the lines that could be or
    are asked for.
    """
    last, heard = (
        columns[0].freqs[-1],
        min((c.impacts.highest_clear_line() for c in columns if c.impacts), default=np.inf),
    )
    if keep_to and min(last, keep_to) > heard * _BEYOND:
        return (
            f"the force ends at about {heard:.3g} Hz: beyond it is noise, and so may be the "
            "modes that are asked for",
        )
    if last > _ENDS * rate or (keep_to and last > keep_to):
        return ()
    return (
        f"the force ends at {last:.4g} Hz: beyond it is noise, and the lines are left out "
        "(--fmax for more)",
    )


def _shaken(
    records: Sequence[TimeHistory], resolution: float | None, estimator: Estimator
) -> Sequence[FrfSet]:
    """FRFs without leakage, on lines of all records, or, where the noise on the force counts, by
    Welch's spectra.

    A force that repeats itself has the lines of its period.
    """
    if (
        resolution is None
        and estimator == "H1"
        and (one := period(records[0]))
        and period(records[-1]) == one
    ):
        return periodic_frfs(records, one)
    if resolution is None:
        resolution = max(spacing(r) for r in records)
    if estimator == "H1":
        return local_frfs(records, resolution)
    return [shaker_frfs(r, Welch(resolution), estimator=estimator).frfs for r in records]
