"""Setups of a test with fewer sensors than points: some stay as references, the others rove.

References join the setups: the scale of a mode in each is told by what they see of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import InputError
from ringtrue.planning.suspension import loaded_frequencies

SEEN = 1.0  # rms of a mode at the references, over that at all points, which is enough
STAY = 0.5  # of the sensors at hand, that stay at most


@dataclass(frozen=True, slots=True, eq=False)
class Setups:
    """Which sensor is where in which setup.

    Attributes
    ----------
    setup : (n,) int64
        Of each planned sensor, 0 to count - 1; -1 where one stays as reference.
    seen : (m,) float64
        Rms of each mode at the references over that at all planned sensors.
    shift : (m,) float64
        Largest relative difference of the loaded frequency between setups; 0 without a mass of the
        sensors.
    """

    setup: Int
    seen: Float
    shift: Float

    def __post_init__(self) -> None:
        freeze_fields(self, setup=np.int64, seen=np.float64, shift=np.float64)

    @property
    def count(self) -> int:
        """Number of setups."""
        return int(self.setup.max(initial=0)) + 1

    @property
    def references(self) -> Int:
        """Sensors that stay, (r,)."""
        return np.flatnonzero(self.setup < 0)

    def roving(self, setup: int) -> Int:
        """Sensors that are there in this setup alone."""
        return np.flatnonzero(self.setup == setup)


def roving_setups(shapes: Float, xyz: Float, at_hand: int, stay: Int | None = None) -> Setups:
    """References that see every mode, and neighbours together in each setup, as many as are at
    hand.

    References are added one at a time, each by the sum over the modes of the logarithm of what the
    references see of it, cut where that is as much as the typical point does; until all modes are
    seen so, or half of the sensors at hand stay. The others are parted along their longest axis
    until each part can be measured at once.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Modes at the planned sensors, d directions each.
    xyz : (n, 3) float64, m
    at_hand : int
        Sensors that can be recorded at once, 2 to n - 1.
    stay : (k,) int64, optional
        Sensors that are references in any case, as far as half of those at hand go: at the points
        struck, so that each setup has driving points of its own.

    Raises
    ------
    InputError
        If there are not more planned sensors than at hand, or fewer than two at hand.
    """
    n = len(shapes)
    if not 2 <= at_hand < n:
        raise InputError(
            f"{at_hand} sensors at hand for {n} planned ones: setups need 2 to {n - 1}"
        )
    square = (np.asarray(shapes, dtype=np.float64) ** 2).sum(axis=1)
    share = square / np.maximum(square.mean(axis=0), 1e-300)
    most = max(1, int(STAY * at_hand))
    chosen = [] if stay is None else list(dict.fromkeys(stay.tolist()))[:most]
    while not chosen or (share[chosen].mean(axis=0).min() < SEEN**2 and len(chosen) < most):
        trial = (share[chosen].sum(axis=0) + share) / (len(chosen) + 1)
        gain = np.log(np.clip(trial, 1e-6, SEEN**2)).sum(axis=1)
        gain[chosen] = -np.inf
        chosen.append(int(gain.argmax()))
    setup = np.full(n, -1, dtype=np.int64)
    rest = np.setdiff1d(np.arange(n), chosen)
    room = at_hand - len(chosen)
    for k, part in enumerate(
        _parts(rest, np.asarray(xyz, dtype=np.float64), -(-rest.size // room))
    ):
        setup[part] = k
    return Setups(setup, np.sqrt(share[chosen].mean(axis=0)), np.zeros(share.shape[1]))


def _parts(at: Int, xyz: Float, count: int) -> list[Int]:
    """Sensors `at` in so many parts of as many neighbours, (each) int64."""
    if count <= 1:
        return [at]
    here = xyz[at] - xyz[at].mean(axis=0)
    axis = np.linalg.svd(here, full_matrices=False)[2][0]
    order = at[np.argsort(here @ axis, kind="stable")]
    sizes = np.full(count, at.size // count) + (np.arange(count) < at.size % count)
    left = count // 2
    cut = int(sizes[:left].sum())
    return _parts(order[:cut], xyz, left) + _parts(order[cut:], xyz, count - left)


def roving_shift(frequencies: Float, shapes: Float, mass: float, setup: Int) -> Float:
    """Largest difference of each loaded frequency between setups of moved sensors, relative, (m,).

    Parameters
    ----------
    frequencies : (m,) float64, Hz
    shapes : (n, d, m) float64, mass-normalised in SI
        All translations at each sensor.
    mass : float, kg
        Of one sensor.
    setup : (n,) int64
        The setup in which each sensor is there; -1 in all.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    there = [(setup == s) | (setup < 0) for s in np.unique(setup[setup >= 0])]
    each = np.stack([loaded_frequencies(f, shapes, mass * here) for here in there])
    return np.asarray(np.ptp(each, axis=0) / np.where(f > 0, f, np.inf))
