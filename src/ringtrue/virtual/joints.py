"""Joints whose stiffness falls with amplitude, in a modal model that is linear but for them.

What a joint takes less than a linear spring is a force on the structure (a pseudo-force), a
function of the extension. Both are found by iteration over the whole record, exact at every line of
the spectrum: alternating frequency and time (Cameron and Griffin 1989).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Complex, Float, FrozenArrays, Int
from ringtrue.core.modes import ModalModel
from ringtrue.errors import InputError, NumericalError
from ringtrue.virtual.sensors import lines, response_spectrum


@dataclass(frozen=True, slots=True)
class JointIteration:
    """The fixed-point iteration of the forces in joints.

    Attributes
    ----------
    rounds : int
        At most.
    exact : float
        Change of the pseudo-forces in a round, relative, that ends it.
    depth : int
        Rounds that are mixed.
    """

    rounds: int = 60
    exact: float = 1e-3
    depth: int = 5


ITERATION = JointIteration()


@dataclass(frozen=True, slots=True, eq=False)
class SofteningJoints(FrozenArrays):
    """Springs that lose stiffness: r(d) = k d − loss·(d − slip·tanh(d/slip)).

    The springs have all of their stiffness k in the modal model, for small extensions; for large
    ones k − loss is left. A bolted or grouted joint slips so in its contact (Segalman 2005).

    Attributes
    ----------
    model : ModalModel
        Its outputs are the extensions, receptances in m/N.
    inputs : (j,) int64
        Which of its inputs are the forces in the joints, along the extensions.
    loss : (j,) float64, N/m
    slip : (j,) float64, m
        Extension at which a quarter of `loss` is lost.
    """

    model: ModalModel
    inputs: Int
    loss: Float
    slip: Float

    def __post_init__(self) -> None:
        sizes = {len(self.model.outputs), self.inputs.size, self.loss.size, self.slip.size}
        if len(sizes) > 1 or (self.slip <= 0).any() or (self.loss < 0).any():
            raise InputError(
                f"joints: {len(self.model.outputs)} extensions, {self.inputs.size} forces, "
                f"{self.loss.size} losses, {self.slip.size} slips: must be as many, "
                "losses >= 0 and slips > 0"
            )

    def pseudo_force(self, extension: Float) -> Float:
        """(j, sample) force that the linear springs have too much, N, at extensions (j, sample)."""
        slip = self.slip[:, None]
        return np.asarray(self.loss[:, None] * (extension - slip * np.tanh(extension / slip)))

    def with_forces(self, forces: Complex, samples: int, rate: float) -> Complex:
        """The forces (in, line) with those that the joints add.

        Parameters
        ----------
        forces : (in, line) complex128
            Spectra of all that acts from outside, periodic over the record.
        samples : int
        rate : float, Hz

        Raises
        ------
        NumericalError
            If the iteration does not converge: the joints are too large a part of the stiffness.
        """
        freqs = lines(samples, rate)
        alone = response_spectrum(self.model, forces, freqs, quantity="displacement")
        receptance = self._receptances(freqs)
        now = np.zeros((self.inputs.size, samples))
        mixed = _Mixing()
        for _ in range(ITERATION.rounds):
            moved = alone + np.einsum("ijf,jf->if", receptance, fft.rfft(now))
            new = self.pseudo_force(fft.irfft(moved, samples))
            off = float(np.linalg.norm(new - now))
            if off <= ITERATION.exact * float(np.linalg.norm(new)):
                out = np.array(forces)
                out[self.inputs] += fft.rfft(new)
                return out
            now = mixed.next(now, new)
        raise NumericalError(
            f"joints: pseudo-forces still change by {off / np.linalg.norm(new):.2g} after "
            f"{ITERATION.rounds} rounds; try a smaller loss"
        )

    def _receptances(self, freqs: Float) -> Complex:
        """(j, j, line) of the extensions under forces in the joints, m/N: as the outputs of a model
        with one input.
        """
        model = self.model
        count = self.inputs.size
        into = model.participation[:, self.inputs].T  # (j, m)
        pairs = (model.shapes[:, None, :] * into).reshape(count**2, -1)
        rest = [getattr(model, n)[:, self.inputs].reshape(-1, 1) for n in ("lower", "upper")]
        as_outputs = replace(
            model,
            shapes=pairs,
            participation=np.ones((model.poles.size, 1), dtype=np.complex128),
            lower=rest[0],
            upper=rest[1],
            outputs=model.outputs * count,
            inputs=model.inputs[:1],
        )
        unit = np.ones((1, freqs.size), dtype=np.complex128)
        found = response_spectrum(as_outputs, unit, freqs, quantity="displacement")
        return found.reshape(count, count, -1)


class _Mixing:
    """Anderson's mixing of the last rounds of a fixed-point iteration (Anderson 1965)."""

    def __init__(self) -> None:
        self._points: list[Float] = []
        self._steps: list[Float] = []

    def next(self, point: Float, image: Float) -> Float:
        """The point of the next round, from one and its image."""
        self._points.append(point)
        self._steps.append(image - point)
        self._points = self._points[-ITERATION.depth :]
        self._steps = self._steps[-ITERATION.depth :]
        if len(self._steps) == 1:
            return image
        last = self._steps[-1]
        changes = np.stack([(last - s).ravel() for s in self._steps[:-1]], axis=1)
        share, *_ = np.linalg.lstsq(changes.T @ changes, changes.T @ last.ravel(), rcond=1e-12)
        out = image.copy()
        for c, p, s in zip(share.tolist(), self._points[:-1], self._steps[:-1], strict=True):
            out -= c * (image - p - s)
        return out
