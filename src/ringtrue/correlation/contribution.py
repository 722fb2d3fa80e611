"""What each channel does to the MAC, and which channels to leave out one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int, freeze_fields
from ringtrue.errors import InputError

MOST = 20  # channels left out unless more are asked for


def _checked(a: Any_, b: Any_) -> tuple[Any_, Any_]:
    a, b = np.asarray(a), np.asarray(b)
    if a.ndim != 2 or a.shape != b.shape:
        raise InputError(
            f"paired shapes {a.shape} and {b.shape} must be (channel, mode) and equal in size"
        )
    return a, b


def mac_contribution(a: Any_, b: Any_) -> Float:
    """Share of each channel in the MAC of paired modes, (n, m) float64; each column sums to the
    MAC.

    Re(ā_i b_i · conj(aᴴb))/(aᴴa · bᴴb); negative where a channel works against the rest.

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
        Column k of one belongs to column k of the other.
    """
    a, b = _checked(a, b)
    part = a.conj() * b
    below = (np.abs(a) ** 2).sum(axis=0) * (np.abs(b) ** 2).sum(axis=0)
    return np.asarray(
        (part * part.sum(axis=0).conj()).real / np.where(below > 0, below, 1.0), dtype=np.float64
    )


def mac_without(a: Any_, b: Any_) -> Float:
    """MAC of paired modes if one channel were left out, (n, m): row i without channel i."""
    a, b = _checked(a, b)
    part, aa, bb = a.conj() * b, np.abs(a) ** 2, np.abs(b) ** 2
    return _mac(part.sum(axis=0) - part, aa.sum(axis=0) - aa, bb.sum(axis=0) - bb)


def _mac(cross: Any_, aa: Float, bb: Float) -> Float:
    below = aa * bb
    return np.asarray(
        (np.abs(cross) ** 2 / np.where(below > 0, below, np.inf)).clip(0.0, 1.0), dtype=np.float64
    )


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """Channels left out one after the other, each the one whose loss raises the mean MAC most.

    Attributes
    ----------
    order : (k,) int64
        Channels, in the order of leaving.
    mac : (k + 1, m) float64
        MAC of the pairs with the first 0..k of them left out.
    """

    order: Int
    mac: Float

    def __post_init__(self) -> None:
        freeze_fields(self, order=np.int64, mac=np.float64)

    @property
    def mean_mac(self) -> Float:
        """(k + 1,)"""
        return np.asarray(self.mac.mean(axis=1))


def eliminate(
    a: Any_, b: Any_, *, most: int | None = None, least_channels: int | None = None
) -> Elimination:
    """Sequential sensor elimination: the channels that spoil the MAC most, the worst first.

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
        Paired shapes.
    most : int, optional
        Channels to leave out; a tenth of them (1 to 20) if not given.
    least_channels : int, optional
        Channels that must stay; twice the number of pairs, at most n − 1, if not given: a MAC over
        fewer tells little.

    Notes
    ----- It shows where two sets differ; leaving these channels out of the comparison does not make
    the model better.
    """
    a, b = _checked(a, b)
    n, m = a.shape
    stay = min(2 * m, n - 1) if least_channels is None else least_channels
    count = max(0, min(min(max(1, n // 10), MOST) if most is None else most, n - stay))
    part, aa, bb = a.conj() * b, np.abs(a) ** 2, np.abs(b) ** 2
    cross, left, right = part.sum(axis=0), aa.sum(axis=0), bb.sum(axis=0)
    here = np.arange(n)
    order, history = [], [_mac(cross, left, right)]
    for _ in range(count):  # greedy: each step rests on the last
        without = _mac(cross - part[here], left - aa[here], right - bb[here])
        k = int(np.argmax(without.mean(axis=1)))
        i = int(here[k])
        cross, left, right = cross - part[i], left - aa[i], right - bb[i]
        here = np.delete(here, k)
        order.append(i)
        history.append(without[k].copy())
    return Elimination(np.array(order, dtype=np.int64), np.array(history))
