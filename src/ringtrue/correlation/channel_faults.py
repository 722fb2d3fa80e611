"""Channels whose readings contradict the model, or the rigid-body motion of all others: named, with
the MAC if they were mended; never mended.

In its modes on a soft suspension a structure moves as a rigid body: six numbers a mode, which many
channels overdetermine. Places and directions of the sheet alone say what each must read; no model
is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.correlation.paired_shapes import paired_shapes
from ringtrue.correlation.pairing import Pairing
from ringtrue.errors import InputError
from ringtrue.shapes import modal_scale_factor, paired_mac, unit

Fault = Literal["reversed", "swapped", "scaled", "dead"]
MOST_THREES = 60  # the same in rounds of three
USUAL = (
    (9.80665, "g for m/s²"),
    (10.0, "20 dB of gain"),
    (1e3, "a factor 1000 of units"),
    (2.0, "6 dB of gain"),
)


@dataclass(frozen=True, slots=True)
class FaultLimits:
    """When a channel is suspected; strict, for a wrong suspicion costs a day at the test.

    Attributes
    ----------
    gain : float
        Least gain in squared error, in medians of the squared error of a channel.
    explained : float
        Share of the squared error that may stay after mending.
    correlation : float
        Least |correlation| over the modes, after mending, of a reversed or swapped channel.
    scaled_correlation : float
        The same of a mis-scaled one; `correlation` where the factor is beyond `far`.
    ratio : float
        Smallest factor that counts as mis-scaled; 1/ratio below one.
    far : float
        A factor that a part which is softer than the model's does not feign.
    dead : float
        A channel that reads less than this share of what is expected is dead.
    """

    gain: float = 12.0
    explained: float = 0.3
    correlation: float = 0.8
    scaled_correlation: float = 0.95
    ratio: float = 1.25
    far: float = 5.0
    dead: float = 0.1


LIMITS = FaultLimits()


@dataclass(frozen=True, slots=True)
class Suspect:
    """A suspected channel.

    Attributes
    ----------
    channel : str
    fault : {"reversed", "swapped", "scaled", "dead"}
    message : str
    partner : str
        The channel whose motion it reads if swapped, else empty.
    factor : float
        What it reads over what it, or its partner, should; −1 if reversed, ±1 if swapped.
    mac_now, mac_mended : float, 0..1
        Mean MAC of the pairs as measured, and if this fault alone were mended (a dead channel left
        out).
    """

    channel: str
    fault: Fault
    message: str
    partner: str = ""
    factor: float = 1.0
    mac_now: float = float("nan")
    mac_mended: float = float("nan")


@dataclass(frozen=True, slots=True)
class ChannelFault:
    """A fault by row.

    Attributes
    ----------
    i : int
        The row; with a swap the first.
    fault : {"reversed", "swapped", "scaled", "dead"}
    factor : float
        What the row reads over what it should.
    gain : float
        In squared error, by mending it.
    moved : tuple of (int, int, float)
        Of a swap: row, the row whose motion it reads, and with which sign.
    """

    i: int
    fault: Fault
    factor: float
    gain: float = 0.0
    moved: tuple[tuple[int, int, float], ...] = ()


def mended(a: Any_, faults: Sequence[ChannelFault]) -> Any_:
    """A copy of the readings `a` (n, m) as they would be without the faults; dead channels become
    zero.
    """
    out = np.array(a)
    for f in faults:
        if f.fault == "swapped":
            row, real, sign = (np.array(x) for x in zip(*f.moved, strict=True))
            out[real] = sign[:, None] * out[row]
        elif f.fault == "dead":
            out[f.i] = 0.0
        else:
            out[f.i] /= f.factor
    return out


def find_faults(a: Any_, b: Any_) -> tuple[ChannelFault, ...]:
    """Faulty rows of the readings `a`, judged by the shapes `b`; the gravest first.

    The readings are scaled mode by mode to the model by least absolute deviation, which a few wrong
    channels do not move. Then the fault that explains most of the squared error is taken, thought
    away, and the rest is judged anew.

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
        Paired shapes, m >= 3; `b` is believed.

    Notes
    -----
    Fails where the model is so wrong that its error hides the fault, where more than about a
    third of the channels are wrong, or where two channels move equally (exchanging them changes
    nothing). A triaxial sensor turned by a quarter or about its diagonal is two or three swapped
    channels, with signs; one turned by less is not recognised.
    """
    a = np.asarray(a)
    b = np.asarray(b)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] < 3:
        raise InputError(
            f"paired shapes {a.shape} and {b.shape}: at least 3 pairs are needed to judge a channel"
        )
    found: list[ChannelFault] = []
    gone: Int = np.zeros(0, dtype=np.int64)
    # each fault changes what the others look like
    for _ in range(max(1, a.shape[0] // 3)):
        y, expected = scaled_to(mended(a, found), b)
        best = _gravest(y, expected, np.setdiff1d(np.arange(a.shape[0]), gone))
        if best is None:
            break
        found.append(best)
        gone = np.union1d(gone, [best.i, *(row for row, _, _ in best.moved)])
    return tuple(found)


def scaled_to(a: Any_, b: Any_) -> tuple[Float, Float]:
    """Readings and unit shapes, real, each mode of the readings scaled to the model by its weighted
    median ratio.
    """
    length = np.linalg.norm(b, axis=0)
    b = b / np.where(length > 0, length, 1.0)
    turn_b = (
        modal_scale_factor(np.abs(b), b) if np.iscomplexobj(b) else np.ones(b.shape[1])
    )
    b = (b * np.exp(1j * np.angle(turn_b))).real
    y = (a * np.exp(1j * np.angle(modal_scale_factor(b, a)))).real
    live = np.abs(b) > 1e-12
    ratio = np.where(live, y / np.where(live, b, 1.0), np.inf)
    order = np.argsort(ratio, axis=0)
    weight = np.cumsum(np.take_along_axis(np.abs(b), order, axis=0), axis=0)
    middle = (weight >= weight[-1] / 2).argmax(axis=0)
    columns = np.arange(b.shape[1])
    scale = ratio[order[middle, columns], columns]
    usable = np.isfinite(scale) & (np.abs(scale) > 0)
    return np.asarray(y / np.where(usable, scale, 1.0)), np.asarray(b)


def _gravest(y: Float, b: Float, at: Int) -> ChannelFault | None:
    """The fault of greatest gain among the rows `at`."""
    error = ((y - b) ** 2).sum(axis=1)
    size_y = np.linalg.norm(y, axis=1)
    size_b = np.linalg.norm(b, axis=1)
    usual = (
        max(np.median(error[at]), 1e-8 * float((size_b**2).mean())) if at.size else 0.0
    )
    own = (y * b).sum(axis=1)
    live = size_b > 0.1 * np.median(size_b)
    cosine = own / np.where(size_y * size_b > 0, size_y * size_b, 1.0)
    factor = own / np.where(size_b > 0, size_b**2, 1.0)
    silent = live & (size_y < LIMITS.dead * size_b)
    able = np.isin(np.arange(b.shape[0]), at) & live
    dead = np.flatnonzero(silent & able).tolist()
    found = [ChannelFault(i, "dead", 0.0, float(error[i])) for i in dead]
    turned = error - ((y + b) ** 2).sum(axis=1)
    backwards = np.flatnonzero((cosine < -LIMITS.correlation) & able & ~silent).tolist()
    found += [ChannelFault(i, "reversed", -1.0, float(turned[i])) for i in backwards]
    far = (factor > LIMITS.far) | (factor < 1 / LIMITS.far)
    positive = (
        able
        & ~silent
        & (cosine > np.where(far, LIMITS.correlation, LIMITS.scaled_correlation))
    )
    found += _mis_scaled(y, b, error, factor=factor, which=positive)
    poor = np.flatnonzero(
        able & ~silent & (cosine < 0.95) & (error > usual * LIMITS.gain / 4)
    )
    need = usual * LIMITS.gain
    # 500: channels that are tried against each other, the worst of them
    worst = poor[np.argsort(-error[poor], kind="stable")][:500]
    found += _swapped(y, b, error, at=worst, turned=turned[worst] + need)
    grave = [f for f in found if f.gain > (need / 2 if f.fault == "dead" else need)]
    return max(grave, key=lambda f: (f.gain, -f.i), default=None)


def _mis_scaled(
    y: Float, b: Float, error: Float, factor: Float, which: Any_
) -> list[ChannelFault]:
    """Channels whose factor stands out from those of all others that follow the model."""
    if np.count_nonzero(which) < 4:
        return []
    level = np.log(np.where(which, factor, 1.0))
    middle = float(np.median(level[which]))
    spread = 1.4826 * float(np.median(np.abs(level[which] - middle)))
    out = (
        which
        & (np.abs(level) > np.log(LIMITS.ratio))
        & (np.abs(level - middle) > 6 * spread)
    )
    at = np.flatnonzero(out)
    rest = ((y[at] / factor[at, None] - b[at]) ** 2).sum(axis=1)
    gain = error[at] - rest
    good = rest < LIMITS.explained * error[at]
    return [
        ChannelFault(i, "scaled", float(factor[i]), g)
        for i, g in zip(at[good].tolist(), gain[good].tolist(), strict=True)
    ]


def _swapped(
    y: Float, b: Float, error: Float, at: Int, turned: Float
) -> list[ChannelFault]:
    """The best exchange of two of the rows `at`, and the best one round three, some of them
    reversed, too.

    One round three must gain more than the exchange of two of them with the third reversed, by what
    a fault must gain: these are met more often, and two of the three may move nearly the same.
    `turned` (r,) is what reversing each gains, and that.
    """
    if at.size < 2:
        return []
    cross = y[at] @ b[at].T
    size_y = np.linalg.norm(y[at], axis=1)
    size_b = np.linalg.norm(b[at], axis=1)
    left = size_y[:, None] ** 2 + size_b**2 - 2 * np.abs(cross)  # where row p reads ±q
    correlated = np.abs(cross) > LIMITS.correlation * np.maximum(
        size_y[:, None] * size_b, 1e-300
    )
    np.fill_diagonal(correlated, False)
    left = np.where(correlated, left, np.inf)
    few = left[:MOST_THREES, :MOST_THREES]
    out = []
    for gain, order in (_pair(left, error[at]), _three(few, error[at])):
        simpler = 0.0
        if len(order) == 3:
            now = error[at]
            for k in range(3):
                p, q, third = (order[(k + step) % 3] for step in range(3))
                exchange = now[p] + now[q] - left[p, q] - left[q, p]
                simpler = max(simpler, exchange + turned[third])
        if gain > simpler:
            moved = [
                (p, q, float(np.sign(cross[p, q])))
                for p, q in zip(order, (*order[1:], order[0]), strict=True)
            ]
            rows = tuple(sorted((int(at[p]), int(at[q]), sign) for p, q, sign in moved))
            out.append(ChannelFault(rows[0][0], "swapped", rows[0][2], gain, rows))
    return out


def _pair(left: Float, error: Float) -> tuple[float, tuple[int, ...]]:
    """Gain and positions of the best exchange of two; `left` (r, r) is the error of a row that
    reads another.
    """
    now = np.add.outer(error, error)
    then = left + left.T
    gain = np.where(np.triu(then < LIMITS.explained * now, 1), now - then, 0.0)
    at = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return float(gain[at]), tuple(int(k) for k in at)


def _three(left: Float, error: Float) -> tuple[float, tuple[int, ...]]:
    """The same of three that read each other in a round."""
    best: tuple[float, tuple[int, ...]] = (0.0, ())
    for p in range(len(left)):  # tens
        now = error[p] + np.add.outer(error[: len(left)], error[: len(left)])
        then = left[p][:, None] + left + left[:, p]  # p reads q, q reads r, r reads p
        gain = np.where(then < LIMITS.explained * now, now - then, 0.0)
        q, r = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[q, r] > best[0]:
            best = float(gain[q, r]), (p, int(q), int(r))
    return best


def suspect_channels(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    *,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> tuple[Suspect, ...]:
    """Channels of A that look reversed, swapped, mis-scaled or dead, judged by the paired modes of
    B.

    `settings` are those of the pairing: close modes of B are turned first as the pairing did.

    Raises
    ------
    InputError
        With fewer than 3 pairs: no channel could be judged.
    """
    left, right = paired_shapes(a, b, pairing, settings)
    now = float(paired_mac(left, right).mean())
    out: list[Suspect] = []
    for f in find_faults(left, right):
        keep = np.arange(left.shape[0]) != (f.i if f.fault == "dead" else -1)
        then = float(paired_mac(mended(left, [f])[keep], right[keep]).mean())
        if then <= now:
            continue
        out += suspects_of(f, a.channels, now, then)
    return tuple(out)


def suspects_of(
    f: ChannelFault, channels: tuple[str, ...], now: float, then: float
) -> list[Suspect]:
    """A fault in words, a suspect for each channel; `now` and `then` are mean MACs, 0..1."""
    effect = f"mean MAC {100 * now:.1f} % -> {100 * then:.1f} %"
    out = []
    for row, real, factor in f.moved or ((f.i, f.i, f.factor),):
        partner = channels[real] if f.moved else ""
        suspect = Suspect(
            channel=channels[row],
            fault=f.fault,
            message=f"{_looks(f.fault, partner, factor)}: {effect}",
            partner=partner,
            factor=factor,
            mac_now=now,
            mac_mended=then,
        )
        out.append(suspect)
    return out


def _looks(fault: Fault, partner: str, factor: float) -> str:
    """What a channel reads, and how it would be mended."""
    if fault == "dead":
        return "reads next to nothing of what it should; left out"
    if fault == "reversed":
        return "reads with the opposite sign in all modes; turned"
    if fault == "scaled":
        return f"reads {factor:.3g} times what it should{_usual(factor)}; divided by it"
    opposite = " with the opposite sign" if factor < 0 else ""
    return f"reads what {partner} should{opposite}; put right"


def _usual(factor: float) -> str:
    size = abs(np.log(abs(factor) or 1.0))
    near = [text for value, text in USUAL if abs(size - np.log(value)) < 0.015]
    return f" ({near[0]}?)" if near else ""


@dataclass(frozen=True, slots=True)
class RigidLimits:
    """When channels are judged by rigid-body motion.

    Attributes
    ----------
    modes : int
        That a channel is judged by, at least.
    channels : int
        At least: two readings for each rigid-body motion.
    bends : float
        Median deviation of the readings from the motion, over their RMS, above which the structure
        is not rigid.
    huber : float
        Median residuals beyond which a channel weighs less.
    rounds : int
        Of weights.
    """

    modes: int = 3
    channels: int = 12
    bends: float = 0.1
    huber: float = 1.5
    rounds: int = 30


RIGID_LIMITS = RigidLimits()


def rigid_body_motion(shapes: Float, xyz: Float, axes: Float) -> Float:
    """What channels read of the rigid-body motion that most of them follow.

    By least squares in which channels with large residuals weigh less (Huber 1964).

    Parameters
    ----------
    shapes : (n, m) float64
        Readings, one or more modes.
    xyz, axes : (n, 3) float64, m and unit vectors
        Of the channels.

    Returns
    -------
    (n, m) float64
    """
    arm = xyz - xyz.mean(axis=0)
    motions = np.concatenate(
        [axes, np.cross(arm, axes) / max(np.abs(arm).max(), 1e-300)], axis=1
    )
    weight = np.ones((len(shapes), 1))
    fitted = np.zeros(shapes.shape)
    for _ in range(RIGID_LIMITS.rounds):
        amount, *_ = np.linalg.lstsq(motions * weight, shapes * weight, rcond=None)
        fitted = motions @ amount
        off = np.linalg.norm(shapes - fitted, axis=1, keepdims=True)
        limit = max(RIGID_LIMITS.huber * float(np.median(off)), 1e-300)
        weight = np.sqrt(np.minimum(1.0, limit / np.maximum(off, 1e-300)))
    return fitted


def rigid_suspects(modes: ModeSet, sheet: TestModel) -> tuple[Suspect, ...]:
    """Channels that look reversed, swapped, mis-scaled or dead in rigid-body modes.

    Parameters
    ----------
    modes : ModeSet
        Rigid-body modes, real, at channels of the sheet.
    sheet : TestModel

    Returns
    -------
    tuple of Suspect
        None where too few modes or channels are there, or the structure does not move as a rigid
        body.
    """
    channels = modes.channels
    if len(modes) < RIGID_LIMITS.modes or len(channels) < RIGID_LIMITS.channels:
        return ()
    at = [sheet.channels.index(c) for c in channels]
    shapes = np.asarray(unit(modes.shapes.real))
    fitted = rigid_body_motion(shapes, sheet.channel_xyz()[at], sheet.axes[at])
    if np.median(np.abs(shapes - fitted)) > RIGID_LIMITS.bends * np.sqrt(
        (fitted**2).mean()
    ):
        return ()
    now = float(paired_mac(shapes, fitted).mean())
    out: list[Suspect] = []
    for fault in find_faults(shapes, fitted):
        then = float(paired_mac(mended(shapes, [fault]), fitted).mean())
        out += suspects_of(fault, channels, now, then)
    return tuple(out)
