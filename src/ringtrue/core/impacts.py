"""The impacts of a hammer behind FRFs: what rings on from earlier ones, and the noise on their
force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int, freeze_fields


@dataclass(frozen=True, slots=True, eq=False)
class Impacts:
    """Impacts, each with those of its record that came before it.

    An earlier impact of impulse a rings on as a e^{λτ}, in the shape of a mode and decaying with
    its pole: it multiplies the residue that an impact of impulse A shows by 1 + a e^{λτ}/A.

    Attributes
    ----------
    delay : (impact, earlier) float64, s
        τ, from the earlier impact on.
    ratio : (impact, earlier) float64
        a/A; 0 where there is none.
    weight : (impact, out, in) float64
        Share of the impact in each FRF.
    freqs : (line,) float64, Hz
    noise : (impact, line) float64
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
        """(impact, m) factors of the residues, impact by impact; poles (m,) in rad/s."""
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
        """(m, out, in) variance of the factors from impact to impact, over their squared mean: it
        lowers the coherence.
        """
        each = self.each(poles)
        mean = np.abs(np.tensordot(self.weight, each, (0, 0))) ** 2
        power = np.tensordot(self.weight, np.abs(each) ** 2, (0, 0))
        return np.asarray(np.moveaxis(np.maximum(power - mean, 0) / mean, 2, 0))

    def noise_at(self, frequencies: Float) -> Float:
        """(impact, m) noise at the frequencies (m,), Hz."""
        return np.array([np.interp(frequencies, self.freqs, n) for n in self.noise])

    def highest_clear_line(self) -> float:
        """The highest line, Hz, at which the force of the typical impact stands 10 dB out of its
        noise.
        """
        clear = np.flatnonzero(np.median(self.noise, axis=0) < 0.1)
        return float(self.freqs[clear[-1]]) if clear.size else 0.0

    def spread(self, outputs: int) -> Impacts:
        """Of one input, weights (impact, 1, 1) of any sum, for the FRFs of so many outputs."""
        return replace(self, weight=np.repeat(self.weight / self.weight.sum(), outputs, axis=1))

    def take(self, outputs: Int, inputs: Int) -> Impacts:
        """Of some of the FRFs."""
        return replace(self, weight=self.weight[:, outputs][:, :, inputs])

    def exchanged(self) -> Impacts:
        """With outputs as inputs."""
        return replace(self, weight=self.weight.swapaxes(1, 2))


def join_impacts(parts: Sequence[Impacts | None], weights: Sequence[Float]) -> Impacts | None:
    """Of FRFs joined from parts with the same lines, `weights` (impact, out, in) each; None if one
    part has none.
    """
    known = [p for p in parts if p is not None]
    if len(known) < len(parts):
        return None
    delay = pad_rows([x for p in known for x in p.delay])
    ratio = pad_rows([x for p in known for x in p.ratio])
    noise = np.concatenate([p.noise for p in known])
    return Impacts(
        delay=delay, ratio=ratio, weight=np.concatenate(weights), freqs=known[0].freqs, noise=noise
    )


def pad_rows(rows: Sequence[Float]) -> Float:
    """(row, longest) the rows with zeros behind."""
    out = np.zeros((len(rows), max((r.size for r in rows), default=0)))
    for row, r in zip(out, rows, strict=True):
        row[: r.size] = r
    return out
