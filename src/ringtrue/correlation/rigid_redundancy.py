"""Channels that contradict the rigid-body motion of all others.

In its modes on a soft suspension a structure moves as a rigid body: six numbers a mode, which many
channels overdetermine. Places and directions of the sheet alone say what each must read; no model
is believed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.channel_faults import Suspect, find_faults, mended, suspects_of
from ringtrue.shapes import paired_mac, unit


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


LIMITS = RigidLimits()


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
    motions = np.concatenate([axes, np.cross(arm, axes) / max(np.abs(arm).max(), 1e-300)], axis=1)
    weight = np.ones((len(shapes), 1))
    fitted = np.zeros(shapes.shape)
    for _ in range(LIMITS.rounds):
        amount, *_ = np.linalg.lstsq(motions * weight, shapes * weight, rcond=None)
        fitted = motions @ amount
        off = np.linalg.norm(shapes - fitted, axis=1, keepdims=True)
        limit = max(LIMITS.huber * float(np.median(off)), 1e-300)
        weight = np.sqrt(np.minimum(1.0, limit / np.maximum(off, 1e-300)))
    return np.asarray(fitted)


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
    if len(modes) < LIMITS.modes or len(channels) < LIMITS.channels:
        return ()
    at = [sheet.channels.index(c) for c in channels]
    shapes = np.asarray(unit(modes.shapes.real))
    fitted = rigid_body_motion(shapes, sheet.channel_xyz()[at], sheet.axes[at])
    if np.median(np.abs(shapes - fitted)) > LIMITS.bends * np.sqrt((fitted**2).mean()):
        return ()
    now = float(paired_mac(shapes, fitted).mean())
    out: list[Suspect] = []
    for fault in find_faults(shapes, fitted):
        then = float(paired_mac(mended(shapes, [fault]), fitted).mean())
        out += suspects_of(fault, channels, now, then)
    return tuple(out)
