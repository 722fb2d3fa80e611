"""Poles of all model orders, and the stabilisation diagram made from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int, freeze_fields
from ringtrue.errors import InputError


def unit(psi: Complex) -> Complex:
    """Shapes (ch, k) with their largest component 1."""
    top = np.argmax(np.abs(psi), axis=0)[None] if psi.shape[1] else np.zeros((1, 0), dtype=np.int64)
    return np.asarray(psi / np.take_along_axis(psi, top, axis=0))


def check_orders(ordmin: int, ordmax: int) -> None:
    """Refuse model orders that are no range.

    Raises
    ------
    InputError
        Unless 1 <= ordmin <= ordmax.
    """
    if not 1 <= ordmin <= ordmax:
        raise InputError(f"orders {ordmin}..{ordmax}: must be 1 <= ordmin <= ordmax")


@dataclass(frozen=True, slots=True, eq=False)
class PoleSet:
    """Poles of several model orders in one flat list.

    Attributes
    ----------
    order : (k,) int64
        Model order (number of states) that each pole was found at.
    pole : (k,) complex128, rad/s, Im > 0
    shape : (channel, k) complex128
        Largest component 1.
    std_frequency : (k,) float64, Hz
        Standard deviation, NaN where unknown.
    std_damping : (k,) float64
        Standard deviation of the damping ratio, NaN where unknown.
    """

    order: Int
    pole: Complex
    shape: Complex
    std_frequency: Float
    std_damping: Float

    def __post_init__(self) -> None:
        c = np.complex128
        f = np.float64
        freeze_fields(self, order=np.int64, pole=c, shape=c, std_frequency=f, std_damping=f)
        k = self.pole.size
        if self.order.size != k or self.shape.ndim != 2 or self.shape.shape[1] != k:
            raise InputError(
                f"order {self.order.shape}, pole {k}, shape {self.shape.shape}: unequal numbers "
                "of poles"
            )
        if self.std_frequency.size != k or self.std_damping.size != k:
            raise InputError(
                f"std {self.std_frequency.shape}, {self.std_damping.shape}: must be ({k},)"
            )

    def __len__(self) -> int:
        return int(self.pole.size)

    @property
    def frequencies(self) -> Float:
        """(k,) Hz."""
        return np.abs(self.pole) / (2 * np.pi)

    @property
    def damping(self) -> Float:
        """(k,) fraction of critical."""
        return -self.pole.real / np.abs(self.pole)

    def take(self, at: Int | Bool) -> PoleSet:
        """The chosen poles, in the given order."""
        return PoleSet(
            order=self.order[at],
            pole=self.pole[at],
            shape=self.shape[:, at],
            std_frequency=self.std_frequency[at],
            std_damping=self.std_damping[at],
        )

    def rescaled(self, scale: Float) -> PoleSet:
        """With shapes times `scale` (channel,), their largest component 1."""
        shape = unit(self.shape * scale[:, None])
        return PoleSet(
            order=self.order,
            pole=self.pole,
            shape=shape,
            std_frequency=self.std_frequency,
            std_damping=self.std_damping,
        )

    @property
    def orders(self) -> Int:
        """The different model orders, ascending."""
        return np.unique(self.order)


@dataclass(frozen=True, slots=True, eq=False)
class StableDiagram:
    """A stabilisation diagram: poles, what became of each, and a spectrum to draw behind them.

    Attributes
    ----------
    poles : PoleSet
    stable : (k,) bool
        The pole passed the checks on damping, shape and standard deviation.
    cluster : (k,) int64
        The mode (row of the mode table of the same band) that the pole belongs to, -1 for none.
    freqs : (f,) float64, Hz
    level : (f,) float64, dB
        Spectrum behind the poles; any reference.
    """

    poles: PoleSet
    stable: Bool
    cluster: Int
    freqs: Float
    level: Float

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, stable=np.bool_, cluster=np.int64, freqs=f, level=f)
        if self.stable.size != len(self.poles) or self.cluster.size != len(self.poles):
            raise InputError(
                f"stable {self.stable.shape}, cluster {self.cluster.shape}: must be "
                f"({len(self.poles)},)"
            )
        if self.freqs.shape != self.level.shape:
            raise InputError(
                f"freqs {self.freqs.shape} and level {self.level.shape} must be equal (f,)"
            )
