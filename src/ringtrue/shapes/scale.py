"""Scaling of shapes against each other, and the explicit step from complex to real shapes."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.shapes.complexity import mean_phase

Realisation = Literal["rotate", "amplitude"]


def modal_scale_factor(a: Any_, b: Any_) -> Any_:
    """The factor (m,) on each column of `b` that brings it closest to the same column of `a`:
    bᴴa/(bᴴb).

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
    """
    a, b = np.asarray(a), np.asarray(b)
    length = (np.abs(b) ** 2).sum(axis=0)
    return np.asarray((b.conj() * a).sum(axis=0) / np.where(length > 0, length, 1.0))


def realise(shapes: Any_, method: Realisation = "rotate") -> Float:
    """Real shapes (n, m) from complex ones.

    Parameters
    ----------
    shapes : (n, m) complex128 or float64
    method : {"rotate", "amplitude"}
        "rotate" turns each shape by its mean phase and keeps the real part (least change);
        "amplitude" keeps the modulus and takes the sign of that real part.

    Raises
    ------
    ConfigError
        On another method.
    """
    turned = np.asarray(shapes) * np.exp(-1j * mean_phase(shapes))
    if method == "rotate":
        return np.ascontiguousarray(turned.real, dtype=np.float64)
    if method == "amplitude":
        return np.asarray(np.where(turned.real < 0, -1.0, 1.0) * np.abs(turned), dtype=np.float64)
    raise ConfigError(f"no realisation {method!r}{did_you_mean(method, ('rotate', 'amplitude'))}")


def realise_modes(modes: ModeSet) -> ModeSet:
    """The modes with real shapes, rotated; a unit-modal-A scale has no meaning for them and becomes
    UNSCALED.
    """
    if not np.iscomplexobj(modes.shapes):
        return modes
    norm = modes.norm if modes.norm is Norm.MASS else Norm.UNSCALED
    return replace(modes, shapes=realise(modes.shapes), norm=norm)
