"""The blows of a hammer behind FRFs: what rings on from earlier ones, and the noise on their
force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int, freeze_fields


@dataclass(frozen=True, slots=True, eq=False)
class Blows:
    """Blows, each with those of its record that came before it.

    An earlier blow of impulse a rings on as a e^{λτ}, in the shape of a mode and decaying with its
    pole: it multiplies the residue that a blow of impulse A shows by 1 + a e^{λτ}/A.

    Attributes
    ----------
    delay : (blow, earlier) float64, s
        τ, from the earlier blow on.
    ratio : (blow, earlier) float64
        a/A; 0 where there is none.
    weight : (blow, out, in) float64
        Share of the blow in each FRF.
    freqs : (line,) float64, Hz
    noise : (blow, line) float64
        Power of the noise on the force over that of the force.
    """

    delay: Float
    ratio: Float
    weight: Float
    freqs: Float
    noise: Float

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, delay=f, ratio=f, weight=f, freqs=f, noise=f)

    def each(self, poles: Complex) -> Complex:
        """(blow, m) factors of the residues, blow by blow; poles (m,) in rad/s."""
        rest = self.ratio[:, :, None] * np.exp(self.delay[:, :, None] * poles)
        return np.asarray(1 + rest.sum(axis=1))

    def factors(self, poles: Complex) -> tuple[Complex, Complex]:
        """Factors of the shapes (out, m) and of the participations (m, in), least squares where
        FRFs have their own.
        """
        both = np.tensordot(self.weight, self.each(poles), (0, 0))  # (out, in, m)
        part = both.mean(axis=0)
        shape = (both * part.conj()).sum(axis=1) / (np.abs(part) ** 2).sum(axis=0)
        return np.asarray(shape), np.asarray(part.T)

    def scatter(self, poles: Complex) -> Float:
        """(m, out, in) variance of the factors from blow to blow, over their squared mean: it
        lowers the coherence.
        """
        each = self.each(poles)
        mean = np.abs(np.tensordot(self.weight, each, (0, 0))) ** 2
        power = np.tensordot(self.weight, np.abs(each) ** 2, (0, 0))
        return np.asarray(np.moveaxis(np.maximum(power - mean, 0) / mean, 2, 0))

    def noise_at(self, frequencies: Float) -> Float:
        """(blow, m) noise at the frequencies (m,), Hz."""
        return np.array([np.interp(frequencies, self.freqs, n) for n in self.noise])

    def heard(self) -> float:
        """The highest line, Hz, at which the force of the typical blow stands 10 dB out of its
        noise.
        """
        clear = np.flatnonzero(np.median(self.noise, axis=0) < 0.1)
        return float(self.freqs[clear[-1]]) if clear.size else 0.0

    def spread(self, outputs: int) -> Blows:
        """Of one input, weights (blow, 1, 1) of any sum, for the FRFs of so many outputs."""
        return replace(self, weight=np.repeat(self.weight / self.weight.sum(), outputs, axis=1))

    def take(self, outputs: Int, inputs: Int) -> Blows:
        """Of some of the FRFs."""
        return replace(self, weight=self.weight[:, outputs][:, :, inputs])

    def exchanged(self) -> Blows:
        """With outputs as inputs."""
        return replace(self, weight=self.weight.swapaxes(1, 2))


def joined(parts: Sequence[Blows | None], weights: Sequence[Float]) -> Blows | None:
    """Of FRFs joined from parts with the same lines, `weights` (blow, out, in) each; None if one
    part has none.
    """
    known = [p for p in parts if p is not None]
    if len(known) < len(parts):
        return None
    delay = padded([x for p in known for x in p.delay])
    ratio = padded([x for p in known for x in p.ratio])
    noise = np.concatenate([p.noise for p in known])
    return Blows(
        delay=delay, ratio=ratio, weight=np.concatenate(weights), freqs=known[0].freqs, noise=noise
    )


def padded(rows: Sequence[Float]) -> Float:
    """(row, longest) the rows with zeros behind."""
    out = np.zeros((len(rows), max((r.size for r in rows), default=0)))
    for row, r in zip(out, rows, strict=True):
        row[: r.size] = r
    return out
