"""Checks of measured FRFs: driving points (sign), reciprocity, lines that stand out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Complex
from ringtrue.core.motions import POWER
from ringtrue.core.signals import FrfSet

_SURE, _FLIPPED = 0.8, -0.3
_BANDS = 24


@dataclass(frozen=True, slots=True)
class DrivingPoint:
    """A driving point: `passive` is the share of the real part in its mobility at resonances, 1 if
    all is well.

    Attributes
    ----------
    id : str
    passive : float
        1: never negative; -1: sensor or hammer is the other way round.
    verdict : {"ok", "flipped", "doubtful"}
    """

    id: str
    passive: float
    verdict: Literal["ok", "flipped", "doubtful"]


@dataclass(frozen=True, slots=True)
class Reciprocity:
    """H_ab against H_ba.

    Attributes
    ----------
    first, second : str
    correlation : float
        |H_ab* H_ba|² over both powers, over the lines: 1 if they are proportional.
    gain : float
        H_ab over H_ba in the least-squares sense; negative if one is turned.
    """

    first: str
    second: str
    correlation: float
    gain: float


def mobility(frfs: FrfSet) -> Complex:
    """(freq, out, in) velocity over force, m/s/N; 0 at 0 Hz."""
    s = 2j * np.pi * frfs.freqs + frfs.window_decay
    factor = np.where(frfs.freqs > 0, s, 1.0) ** float(1 - POWER[frfs.kind])
    return np.asarray(frfs.data * np.where(frfs.freqs > 0, factor, 0.0)[:, None, None])


def check_driving_points(
    frfs: FrfSet, *, low: float = 0.0, high: float = np.inf
) -> tuple[DrivingPoint, ...]:
    """Does every driving point take power from the force? The real part of its mobility must be
    positive.

    Lines of a band count by their size, so that the resonances decide, between `low` and `high` Hz.
    """
    out = []
    for o, i in frfs.driving_points():
        share = passive(frfs, o, i, low=low, high=high)
        verdict: Literal["ok", "flipped", "doubtful"] = "ok" if share > _SURE else "doubtful"
        out.append(
            DrivingPoint(frfs.inputs[i].id, share, "flipped" if share < _FLIPPED else verdict)
        )
    return tuple(out)


def passive(
    frfs: FrfSet, output: int, reference: int, *, low: float = 0.0, high: float = np.inf
) -> float:
    """Share of the real part of a driving point's mobility in its size at resonances, -1 to 1,
    `low` to `high` Hz.

    Taken in bands of as many lines, each of which counts as far as it has a peak and a sign. A
    drift at the lowest lines, which no weight by size would survive, is one band of many; and of
    lines between resonances, where mobility is all but imaginary, a delay of a sample or less makes
    what sign it likes.
    """
    use = (frfs.freqs > max(low, 0.0)) & (frfs.freqs <= high)
    bands = np.array_split(mobility(frfs)[use, output, reference], min(_BANDS, int(use.sum()) or 1))
    share, peak = np.transpose([_sign_and_peak(h) for h in bands])
    weight = np.abs(share) * peak
    return float((share * weight).sum() / max(weight.sum(), 1e-300))


def _sign_and_peak(h: Complex) -> tuple[float, float]:
    """Share of the real part of lines in its size, and how far the largest lines stand out, 0 to
    1.
    """
    size = np.abs(h)
    power = max(float((size**2).sum()), 1e-300)
    share = (h.real * size).sum() / max((np.abs(h.real) * size).sum(), 1e-300)
    return float(share), float(1 - size.sum() ** 2 / max(size.size, 1) / power)


def check_reciprocity(
    frfs: FrfSet, *, low: float = 0.0, high: float = np.inf
) -> tuple[Reciprocity, ...]:
    """H_ab against H_ba of every pair of inputs that both have a response channel."""
    use = (frfs.freqs >= low) & (frfs.freqs <= high)
    points = frfs.driving_points()
    out = []
    for k, (oa, ia) in enumerate(points):
        for ob, ib in points[k + 1 :]:
            ab, ba = frfs.data[use, oa, ib], frfs.data[use, ob, ia]
            cross, pa, pb = np.vdot(ba, ab), np.vdot(ab, ab).real, np.vdot(ba, ba).real
            share = float(abs(cross) ** 2 / max(pa * pb, 1e-300))
            out.append(
                Reciprocity(
                    frfs.inputs[ia].id,
                    frfs.inputs[ib].id,
                    share,
                    float(cross.real / max(pb, 1e-300)),
                )
            )
    return tuple(out)
