"""The identified modal model: enough to synthesise the FRFs it came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Complex, Float, freeze_fields
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.motions import POWER
from ringtrue.core.signals import Channel, FrfKind


@dataclass(frozen=True, slots=True, eq=False)
class ModalModel:
    """Poles and residues, receptance form H(s) = Σ_k ψ_k l_kᵀ/(s − s_k) + conj + L/s² + U.

    Attributes
    ----------
    poles : (m,) complex128, rad/s, Im > 0
    shapes : (out, m) complex128
        ψ_k; scaled so that ψ_k l_kᵀ is the residue (m/N·1/s).
    participation : (m, in) complex128
    lower, upper : (out, in) complex128
        Residual terms for the modes below (L/s²) and above (U) the band.
    outputs, inputs : tuple of Channel
    kind : str
        The kind of the FRFs it was fitted to.
    """

    poles: Complex
    shapes: Complex
    participation: Complex
    lower: Complex
    upper: Complex
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    kind: FrfKind = "accelerance"
    norm: Norm = Norm.UNSCALED

    def __post_init__(self) -> None:
        c = np.complex128
        freeze_fields(self, poles=c, shapes=c, participation=c, lower=c, upper=c)

    @property
    def frequencies(self) -> Float:
        """(m,) Hz."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping(self) -> Float:
        """(m,) fraction of critical."""
        return -self.poles.real / np.abs(self.poles)

    def synthesise(self, freqs: Float) -> Complex:
        """(freq, out, in) complex128 in the kind of the model, at `freqs` (f,) Hz, f > 0."""
        s = 2j * np.pi * np.asarray(freqs, dtype=np.float64)
        left = self.shapes[None] / (s[:, None, None] - self.poles)
        right = self.shapes.conj()[None] / (s[:, None, None] - self.poles.conj())
        h = left @ self.participation + right @ self.participation.conj()
        h += self.lower / (s**2)[:, None, None] + self.upper
        return np.asarray(h * (s ** POWER[self.kind])[:, None, None])

    def to_modes(self, source: str = "") -> ModeSet:
        """The modes, complex shapes."""
        return ModeSet(
            frequencies=self.frequencies,
            damping=self.damping,
            shapes=self.shapes,
            labels=tuple(c.id for c in self.outputs),
            norm=self.norm,
            source=source,
        )
