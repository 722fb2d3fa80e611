"""Shapes of close modes as they were paired: turned inside their group towards those of the other
set.

Where two sets of paired shapes differ: by channel.

What each channel does to the MAC, and which channels to leave out one after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Any_, Float, FrozenArrays, Int
from ringtrue.core.modes import ModeSet
from ringtrue.correlation.assignment import ComparedModes, PairingSettings, scores
from ringtrue.correlation.one_criterion import scores_among
from ringtrue.correlation.pairing import Pairing
from ringtrue.errors import DataError, InputError
from ringtrue.shapes import rotation, unit


def paired_shapes(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> tuple[Any_, Any_]:
    """The shapes (n, k) of the pairs; those of B turned inside their close group as far as the
    pairing did so.

    Parameters
    ----------
    a, b : ModeSet
        As they were paired.
    settings : PairingSettings
        Those of the pairing.
    """
    b = b.rows(a.channels)
    left = a.shapes[:, pairing.a]
    if not pairing.subspace.any():
        return left, b.shapes[:, pairing.b]
    return left, b.shapes @ turning(a, b, pairing, settings)[:, pairing.b]


def turning(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> Any_:
    """The matrix U (mb, mb), UᴴU = 1, that turns close modes of B as the pairing did: compare A
    with `b.shapes @ U`.

    Mass-normalised shapes stay orthonormal; what a group holds beyond its pairs takes the
    directions that are left. Where closeness fades, U is as far between no rotation and the whole
    one.

    Parameters
    ----------
    a, b : ModeSet
        As they were paired.
    settings : PairingSettings
        Those of the pairing.
    """
    b = b.rows(a.channels)
    out = np.eye(len(b), dtype=np.result_type(a.shapes, b.shapes, np.float64))
    turned = np.flatnonzero(pairing.subspace)
    if not turned.size:
        return out
    plain = out.copy()
    modes = ComparedModes(a.frequencies, a.shapes, b.frequencies, b.shapes)
    turns = scores(modes, settings).turns
    if pairing.beyond.any():
        left = np.setdiff1d(np.arange(len(b)), pairing.b[~pairing.beyond])
        turns += scores_among(modes, pairing.a[pairing.beyond], left, settings).turns
    for group, weight in turns:
        at = turned[np.isin(pairing.b[turned], group)]
        if at.size:
            inside = np.ix_(list(group), list(group))
            rotated = _rotated(a.shapes, b.shapes, pairing, at=at, group=group)
            far = np.full(len(group), weight.max())
            far[np.searchsorted(group, pairing.b[at])] = weight[pairing.a[at]]
            out[inside] += (rotated - plain[inside]) * far
    out = linalg.polar(out)[0]
    mine = pairing.b[turned]
    out[:, mine] *= _phase(
        ((b.shapes @ out[:, mine]).conj() * a.shapes[:, pairing.a[turned]]).sum(axis=0)
    )
    return np.asarray(out)


def _rotated(
    a: Any_, b: Any_, pairing: Pairing, at: Any_, group: tuple[int, ...]
) -> Any_:
    """The rotation (g, g) of an ascending group of B towards its pairs `at`; each column near the
    mode it replaces.
    """
    turn = rotation(a[:, pairing.a[at]], b[:, list(group)])
    rest = (
        linalg.null_space(turn.conj().T) if turn.shape[1] < len(group) else turn[:, :0]
    )
    columns = [*pairing.b[at].tolist(), *(j for j in group if j not in pairing.b[at])]
    out = np.concatenate([turn, rest], axis=1)[:, np.argsort(columns)]
    return out * _phase(out.diagonal().conj())


def _phase(z: Any_) -> Any_:
    """z/|z|, 1 where z is 0."""
    size = np.abs(z)
    return np.where(size > 0, z / np.where(size > 0, size, 1.0), 1.0)


def comac(a: Any_, b: Any_) -> Float:
    """Coordinate MAC, (n,) 0..1: (Σ|a b|)²/(Σ|a|² Σ|b|²) over paired modes (Lieven and Ewins,
    1988).

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
        Column k of one belongs to column k of the other. Blind to the sign of a channel.
    """
    a = unit(np.asarray(a))
    b = unit(np.asarray(b))
    below = (np.abs(a) ** 2).sum(axis=1) * (np.abs(b) ** 2).sum(axis=1)
    return np.asarray(
        np.abs(a * b).sum(axis=1) ** 2 / np.where(below > 0, below, 1.0),
        dtype=np.float64,
    )


def ecomac(a: Any_, b: Any_) -> Float:
    """Enhanced COMAC, (n,) 0 is best: mean |a − b|/2 of unit shapes in phase (Hunt, 1992); sees
    signs.
    """
    a = unit(np.asarray(a))
    b = unit(np.asarray(b))
    cross = (b.conj() * a).sum(axis=0)
    phase = cross / np.where(np.abs(cross) > 0, np.abs(cross), 1.0)
    return np.asarray(
        np.abs(a - b * phase).sum(axis=1) / (2 * max(a.shape[1], 1)), dtype=np.float64
    )


def _checked(a: Any_, b: Any_) -> tuple[Any_, Any_]:
    a = np.asarray(a)
    b = np.asarray(b)
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
        (part * part.sum(axis=0).conj()).real / np.where(below > 0, below, 1.0),
        dtype=np.float64,
    )


def _mac(cross: Any_, aa: Float, bb: Float) -> Float:
    below = aa * bb
    return np.asarray(
        (np.abs(cross) ** 2 / np.where(below > 0, below, np.inf)).clip(0.0, 1.0),
        dtype=np.float64,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Elimination(FrozenArrays):
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

    @property
    def mean_mac(self) -> Float:
        """(k + 1,)"""
        return np.asarray(self.mac.mean(axis=1))


def eliminate(a: Any_, b: Any_) -> Elimination:
    """Sequential sensor elimination: the channels that spoil the MAC most, the worst first.

    A tenth of the channels, 1 to 20, are left out. Twice as many as there are pairs stay, all but
    one at most: a MAC over fewer says little.

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
        Paired shapes.

    Notes
    -----
    It shows where two sets differ; leaving these channels out of the comparison does not make
    the model better.
    """
    a, b = _checked(a, b)
    n, m = a.shape
    most = min(max(1, n // 10), 20)
    count = max(0, min(most, n - min(2 * m, n - 1)))
    part = a.conj() * b
    aa = np.abs(a) ** 2
    bb = np.abs(b) ** 2
    cross = part.sum(axis=0)
    left = aa.sum(axis=0)
    right = bb.sum(axis=0)
    here = np.arange(n)
    order = []
    history = [_mac(cross, left, right)]
    for _ in range(count):  # greedy: each step rests on the last
        without = _mac(cross - part[here], left - aa[here], right - bb[here])
        k = int(np.argmax(without.mean(axis=1)))
        i = int(here[k])
        cross = cross - part[i]
        left = left - aa[i]
        right = right - bb[i]
        here = np.delete(here, k)
        order.append(i)
        history.append(without[k].copy())
    return Elimination(np.array(order, dtype=np.int64), np.array(history))


@dataclass(frozen=True, slots=True, eq=False)
class ShapeDifference(FrozenArrays):
    """A test shape less an FE shape at the channels that both have.

    Attributes
    ----------
    modes : ModeSet
        One, complex: the test shape in the scale and phase of the FE shape by least squares, less
        the FE shape; in shares of its largest component there.
    worst : str
        The channel where it is largest.
    largest, rms : float
        Of its magnitudes.
    """

    modes: ModeSet
    worst: str
    largest: float
    rms: float


def shape_difference(test: ModeSet, k: int, fe: ModeSet, j: int) -> ShapeDifference:
    """The difference of test mode `k` and FE mode `j`, from 0.

    Raises
    ------
    DataError
        If they have no channel together, or one is at rest there.
    """
    at = {c: i for i, c in enumerate(fe.channels)}
    channels = tuple(c for c in test.channels if c in at)
    here = {c: i for i, c in enumerate(test.channels)}
    a = test.shapes[[here[c] for c in channels], k]
    b = fe.shapes[[at[c] for c in channels], j]
    if not (np.any(a) and np.any(b)):
        raise DataError(
            f"test mode {k + 1} and FE mode {j + 1}: no channel at which both move"
        )
    scale = np.vdot(a, b) / np.vdot(a, a).real
    difference = (scale * a - b) / np.abs(b).max()
    size = np.abs(difference)
    modes = ModeSet(
        frequencies=test.frequencies[[k]],
        damping=test.damping[[k]],
        shapes=difference[:, None].astype(np.complex128),
        labels=channels,
    )
    rms = float(np.sqrt(np.mean(size**2)))
    return ShapeDifference(modes, channels[int(size.argmax())], float(size.max()), rms)
