"""FRFs from a force that repeats itself: pseudo-random, multisine, sweeps one after the other.

Over a whole number M of periods the force has every M-th line of the transform only, and Y = H U +
T there. The lines between hold the transient T alone: a local rational model of these tells T at
the forced line, and H = (Y - T)/U needs no smoothness of H at all. Source: Pintelon, Schoukens
(2012), System Identification, section 7.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.motions import MOTIONS
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.local_rational import BATCH, DEGREE, SEEN, SPARE, solved, spectra
from ringtrue.signal.spectra import as_input, sorted_channels

ALIKE = (
    0.98  # correlation of a force with itself a period later: noise of a seventh of it is allowed
)
LEAST_LINES = 64  # with a force, in one period; a sine has one
FORCED = 1e-3  # of the strongest line


def period(history: TimeHistory) -> int:
    """Samples after which the forces of a record come again, 0 if they do not, or too few lines
    carry them.
    """
    ordered, q = sorted_channels(history)
    likeness = np.min([_likeness(x) for x in ordered.data[:q]], axis=0)
    low = np.flatnonzero(likeness < 0.5)
    again = np.flatnonzero(likeness > ALIKE)
    again = again[again > low[0]] if low.size else again[:0]
    if not again.size:
        return 0
    near = again[again < 1.01 * again[0] + 2]
    samples = int(near[np.argmax(likeness[near])])
    size = np.abs(spectra(ordered.data[:q, -samples:]))
    return (
        samples if int((size > FORCED * size.max(axis=0)).sum(axis=0).min()) >= LEAST_LINES else 0
    )


def _likeness(x: Any_) -> Float:
    """(lag,) correlation of a signal (sample,) with itself later, of the parts that overlap, to
    half of its length.
    """
    x = np.asarray(x, dtype=np.float64) - np.mean(x)
    n, half = x.size, x.size // 2
    both = irfft(np.abs(rfft(x, m := int(next_fast_len(n + half + 1, real=True)))) ** 2, m)[
        : half + 1
    ]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    lag = np.arange(half + 1)
    return np.asarray(
        both
        / np.sqrt(np.maximum(power[n - lag] * (power[n] - power[lag]), np.finfo(np.float64).tiny))
    )


def periodic_frfs(histories: Sequence[TimeHistory], samples: int) -> tuple[FrfSet, ...]:
    """FRFs against the one force of each record, on the lines of its period.

    Parameters
    ----------
    histories : sequence of TimeHistory
    samples : int
        Period of the force.

    Returns
    -------
    tuple of FrfSet
        One a record, on common lines. `frf.frf_variance` holds with the coherence; `averages` are
        degrees of freedom.

    Raises
    ------
    DataError
        If a record has several forces: at each line they are one; or fewer than three lines carry
        the force of all.
    """
    found = [_frfs(h, samples) for h in histories]
    seen = np.all([s for _, s in found], axis=0)
    if np.count_nonzero(seen) < 3:
        raise DataError(
            f"{histories[0].source}: there are no lines where the force moves something"
        )
    at = np.flatnonzero(seen)
    return tuple(
        replace(f, data=f.data[at], freqs=f.freqs[at], coherence=f.coherence[at]) for f, _ in found
    )


def _frfs(history: TimeHistory, samples: int) -> tuple[FrfSet, Bool]:
    """The FRFs of a record at all lines of the period, and (freq,) where the force moves
    something.
    """
    ordered, q = sorted_channels(history)
    if q > 1:
        raise DataError(
            f"{history.source}: {q} forces that all repeat after {samples / history.rate:.4g} s "
            "are one force at each "
            "line: drive one at a time, or with forces that do not repeat"
        )
    times = ordered.data.shape[1] // samples
    lines = spectra(ordered.data[:, -times * samples :])
    place = times * np.arange(1, (samples + 1) // 2)
    force = np.abs(lines[place, 0])
    transient, variance, freedom = _transients(lines[:, 1:], place, times)
    h = (lines[place, 1:] - transient) / np.where(
        force > FORCED * force.max(), lines[place, 0], np.inf
    )[:, None]
    variance = variance / np.maximum(force, np.finfo(np.float64).tiny)[:, None] ** 2
    power = np.abs(h) ** 2
    coherence = power / np.maximum(power + 2 * freedom * variance, np.finfo(np.float64).tiny)
    seen = (power / np.maximum(2 * variance, np.finfo(np.float64).tiny)).mean(axis=1) > SEEN
    kind = MOTIONS[ordered.channels[1].quantity]
    freqs, inputs = place * (history.rate / (times * samples)), (as_input(ordered.channels[0]),)
    h, coherence = h[:, :, None], coherence[:, :, None]
    averages = np.array([freedom])
    return FrfSet(
        h,
        freqs,
        ordered.channels[1:],
        inputs,
        coherence,
        averages,
        kind,
        0.0,
        history.source,
        sharp=True,
    ), seen


def _transients(lines: Complex, place: Int, times: int) -> tuple[Complex, Float, float]:
    """The transient (line, out) at lines `place`, the variance of a part of Y - T there, and its
    degrees of freedom.

    From the lines (freq, out) around that are no multiple of `times`.
    """
    unknowns, n_out = 2 * DEGREE + 1, lines.shape[1]
    width = times * int(np.ceil(SPARE * unknowns / (times - 1)))
    if width > lines.shape[0] // 2:
        raise DataError(f"{times} periods of {place.size} lines are too short")
    t, variance = np.empty((place.size, n_out), dtype=np.complex128), np.empty((place.size, n_out))
    size = max(1, BATCH // (width * n_out * (DEGREE + 1)))
    for a in range(0, place.size, size):  # all windows at once would not fit in memory
        middle = place[a : a + size, None]
        at = np.clip(middle - width // 2, 1, lines.shape[0] - width) + np.arange(width)
        at = at[at % times != 0].reshape(middle.size, -1)
        powers = ((at - middle) / (0.5 * width))[..., None] ** np.arange(DEGREE + 1)
        found, part, gain = solved(powers.astype(np.complex128), lines[at], powers, 1)
        t[a : a + size], variance[a : a + size] = found[..., 0], part * (1 + gain)
    return t, variance, float(width - width // times - unknowns + DEGREE / n_out)
