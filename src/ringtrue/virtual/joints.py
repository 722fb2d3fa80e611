"""Joints whose stiffness falls with amplitude, in a modal model that is linear but for them.

What a joint takes less than a linear spring is a force on the structure (a pseudo-force), a
function of the extension. Both are solved for over the whole record, exact at every line of the
spectrum: alternating frequency and time (Cameron and Griffin 1989), by Newton's method whose steps
are found by GMRES (Knoll and Keyes 2004).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.sparse.linalg import LinearOperator, gmres

from ringtrue.core.arrays import Complex, Float, FrozenArrays, Int
from ringtrue.core.modes import ModalModel
from ringtrue.errors import InputError, NumericalError
from ringtrue.virtual.sensors import lines, response_spectrum


@dataclass(frozen=True, slots=True)
class JointIteration:
    """Newton's iteration for the forces in joints.

    Attributes
    ----------
    rounds : int
        At most.
    exact : float
        What is left of the pseudo-forces that ends it, relative.
    step : float
        What GMRES leaves of a step, relative.
    directions : int
        Of GMRES in a step, at most.
    """

    rounds: int = 30
    exact: float = 1e-3
    step: float = 0.05
    directions: int = 16


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
        sizes = {
            len(self.model.outputs),
            self.inputs.size,
            self.loss.size,
            self.slip.size,
        }
        if len(sizes) > 1 or (self.slip <= 0).any() or (self.loss < 0).any():
            raise InputError(
                f"joints: {len(self.model.outputs)} extensions, {self.inputs.size} forces, "
                f"{self.loss.size} losses, {self.slip.size} slips: must be as many, "
                "losses >= 0 and slips > 0"
            )

    def pseudo_force(self, extension: Float) -> Float:
        """(j, sample) force that the linear springs have too much, N, at extensions (j, sample)."""
        slip = self.slip[:, None]
        return self.loss[:, None] * (extension - slip * np.tanh(extension / slip))

    def tangent(self, extension: Float) -> Float:
        """(j, sample) derivative of the pseudo-force by the extension, N/m."""
        return np.asarray(
            self.loss[:, None] * np.tanh(extension / self.slip[:, None]) ** 2
        )

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
        mean = self.loss[:, None] / 2
        free = response_spectrum(self.model, forces, freqs, quantity="displacement")
        alone, receptance = _softened(free, self._receptances(freqs), mean)

        def extension_by(force: Float) -> Float:
            spectrum = np.einsum("ijf,jf->if", receptance, fft.rfft(force))
            return fft.irfft(spectrum, samples)

        start = fft.irfft(alone, samples)
        # what the pseudo-forces have more than the mean loss
        beyond = np.zeros_like(start)
        for _ in range(ITERATION.rounds):
            extension = start + extension_by(beyond)
            wanted = self.pseudo_force(extension)
            left = wanted - mean * extension - beyond
            off = float(np.linalg.norm(left))
            if off <= ITERATION.exact * float(np.linalg.norm(wanted)):
                out = np.array(forces)
                out[self.inputs] += fft.rfft(wanted)
                return out
            beyond = beyond + _step(extension_by, self.tangent(extension) - mean, left)
        raise NumericalError(
            f"joints: pseudo-forces are still off by {off / np.linalg.norm(wanted):.2g} after "
            f"{ITERATION.rounds} rounds; try a smaller loss"
        )

    def _receptances(self, freqs: Float) -> Complex:
        """(j, j, line) of the extensions under unit forces in the joints, m/N."""
        model = self.model
        unit = np.ones((1, freqs.size), dtype=np.complex128)
        out = []
        for i in self.inputs:
            columns = {
                x: getattr(model, x)[:, [i]]
                for x in ("participation", "lower", "upper")
            }
            lone = replace(model, **columns, inputs=(model.inputs[i],))
            out.append(response_spectrum(lone, unit, freqs, quantity="displacement"))
        return np.stack(out, axis=1)


def _softened(
    free: Complex, receptance: Complex, loss: Float
) -> tuple[Complex, Complex]:
    """Extensions (j, line) and receptances (j, j, line) with springs that have lost the mean
    `loss` (j, 1): what is left for the iteration is half as much, up or down.
    """
    per_line = np.moveaxis(receptance, -1, 0)
    both = np.concatenate([free.T[:, :, None], per_line], axis=2)
    solved = np.linalg.solve(np.eye(loss.size) - per_line * loss[:, 0], both)
    by_line = np.ascontiguousarray(np.moveaxis(solved, 0, -1), dtype=np.complex128)
    return by_line[:, 0], by_line[:, 1:]


def _step(extension_by: Callable[[Float], Float], tangent: Float, left: Float) -> Float:
    """Newton's step of the forces (j, sample) that takes away what is `left`."""

    def changed(step: Float) -> Float:
        force = step.reshape(left.shape)
        return (force - tangent * extension_by(force)).ravel()

    operator = LinearOperator((left.size, left.size), matvec=changed, dtype=left.dtype)
    step, _ = gmres(
        operator,
        left.ravel(),
        rtol=ITERATION.step,
        restart=ITERATION.directions,
        maxiter=1,
    )
    return step.reshape(left.shape)
