"""Where two sets of paired shapes differ: by channel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.pairing import Pairing
from ringtrue.errors import InputError
from ringtrue.shapes.mac import paired_mac, unit
from ringtrue.shapes.scale import modal_scale_factor


def comac(a: Any_, b: Any_) -> Float:
    """Coordinate MAC, (n,) 0..1: (Σ|a b|)²/(Σ|a|² Σ|b|²) over paired modes (Lieven and Ewins, 1988).

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
        Column k of one belongs to column k of the other. Blind to the sign of a channel.
    """
    a, b = unit(np.asarray(a)), unit(np.asarray(b))
    below = (np.abs(a) ** 2).sum(axis=1) * (np.abs(b) ** 2).sum(axis=1)
    return np.asarray(np.abs(a * b).sum(axis=1) ** 2 / np.where(below > 0, below, 1.0), dtype=np.float64)


def ecomac(a: Any_, b: Any_) -> Float:
    """Enhanced COMAC, (n,) 0 is best: mean |a − b|/2 of unit shapes in phase (Hunt, 1992); sees signs."""
    a, b = unit(np.asarray(a)), unit(np.asarray(b))
    cross = (b.conj() * a).sum(axis=0)
    phase = cross / np.where(np.abs(cross) > 0, np.abs(cross), 1.0)
    return np.asarray(np.abs(a - b * phase).mean(axis=1) / 2, dtype=np.float64)


Fault = Literal["reversed", "swapped", "dead"]


@dataclass(frozen=True, slots=True)
class Suspect:
    """A channel whose readings contradict the model; it is named, never mended."""

    channel: str
    fault: Fault
    message: str


def suspect_channels(a: ModeSet, b: ModeSet, pairing: Pairing, *, least_pairs: int = 3) -> tuple[Suspect, ...]:
    """Channels of A that look reversed, swapped with another, or dead, judged by the paired modes of B.

    A channel is *reversed* if its readings over the modes correlate below −0.8 with B and turning it raises the
    mean MAC; two are *swapped* if each reads what the other should (cross-correlation above 0.9 and 0.1 above its
    own) and exchanging them raises the mean MAC; one is *dead* if it reads below 2 % of what B expects.

    Raises
    ------
    InputError
        With fewer than `least_pairs` pairs: no channel could be judged.
    """
    if len(pairing) < least_pairs:
        raise InputError(f"{len(pairing)} pairs: at least {least_pairs} are needed to judge a channel")
    b = b if b.channels == a.channels else b.rows(a.channels)
    left, right = _in_phase(a.shapes[:, pairing.a], b.shapes[:, pairing.b])
    expected = np.linalg.norm(right, axis=1)
    live = expected > 0.05 * np.median(expected)
    dead = live & (np.linalg.norm(left, axis=1) < 0.02 * expected)
    cross = unit(left.T).T @ unit(right.T)  # (channel of A, channel of B)
    own = np.diag(cross)
    start = float(paired_mac(left, right).mean())
    out = [
        Suspect(a.channels[i], "dead", f"reads less than 2 % of what the model expects ({expected[i]:.3g})")
        for i in np.flatnonzero(dead).tolist()
    ]
    for i in np.flatnonzero((own < -0.8) & live & ~dead).tolist():
        turned = left.copy()
        turned[i] *= -1
        gain = float(paired_mac(turned, right).mean()) - start
        if gain > 0:
            text = f"correlation {own[i]:.2f} over {len(pairing)} modes; turning it raises the mean MAC by {gain:.2g}"
            out.append(Suspect(a.channels[i], "reversed", text))
    poor = np.flatnonzero((own < 0.9) & live & ~dead)
    both = np.minimum(np.abs(cross), np.abs(cross.T))
    better = both > np.maximum(0.9, np.maximum.outer(own, own) + 0.1)
    for i, j in ((int(i), int(j)) for i in poor for j in poor if i < j and better[i, j]):
        order = np.arange(left.shape[0])
        order[[i, j]] = j, i
        gain = float(paired_mac(left[order], right).mean()) - start
        if gain > 0:
            for p, q in ((i, j), (j, i)):
                text = f"reads what {a.channels[q]} should (correlation {cross[p, q]:.2f})"
                out.append(Suspect(a.channels[p], "swapped", text))
    return tuple(out)


def _in_phase(a: Any_, b: Any_) -> tuple[Float, Float]:
    """Both sets scaled to unit modes of B and turned in phase; real parts."""
    a, b = np.asarray(a), np.asarray(b)
    phase = modal_scale_factor(b, a)
    length = np.linalg.norm(b, axis=0)
    return np.asarray((a * phase / length).real), np.asarray((b / length).real)
