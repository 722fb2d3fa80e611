"""Residuals of static deflections and of mass properties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Any_, Float
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.dense_models import matrices_at
from ringtrue.updating.residuals.modal import (
    NO_MODE,
    Deviations,
    Point,
    ResidualBlock,
    rows_block,
)


@dataclass(frozen=True, slots=True, eq=False)
class StaticDeflections(Deviations):
    """Deflections at channels under static loads at channels, by load case.

    On a reduced basis they are as good as its static content at the loaded channels.

    Attributes
    ----------
    loads : (channel, l) float64, force along each channel
    measured : (channel, l) float64
        NaN where not measured.
    std : float
        Relative to the root mean square of the case.
    """

    loads: Float
    measured: Float
    std: float = 0.02

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        m = matrices_at(at.model, at.now.x)
        p = at.now.d_lambda.shape[1]
        u = linalg.solve(m.stiffness, m.observe.T @ self.loads, assume_a="sym")
        d_u = np.zeros((u.shape[0], u.shape[1], p))
        if p:
            load = np.einsum("pij,jl->ilp", m.d_stiffness, u)
            d_u = -linalg.solve(
                m.stiffness, load.reshape(u.shape[0], -1), assume_a="sym"
            ).reshape(load.shape)
        scale = self.std * np.sqrt(np.nanmean(np.square(self.measured), axis=0))
        value = (self.measured - m.observe @ u) / scale
        slope = np.tensordot(m.observe, d_u, 1) / scale[:, None]
        seen = np.isfinite(self.measured)
        return rows_block(value[seen], slope[seen], np.full(int(seen.sum()), NO_MODE))


@dataclass(frozen=True, slots=True, eq=False)
class MassPropertyDeviations(Deviations):
    """Mass, centre of gravity and inertia of the model against a weighing.

    Attributes
    ----------
    rigid : RigidMass
    measured : (10,) float64
        Mass; x, y, z of the centre of gravity; Ixx, Iyy, Izz, Ixy, Iyz, Izx about it (tensor
        components); NaN where not measured.
    std : (10,) float64
        In the same units.
    """

    rigid: RigidMass
    measured: Float
    std: Float

    def __call__(self, at: Point) -> ResidualBlock:
        """See `Term`."""
        p = at.now.d_lambda.shape[1]
        m6, d_m6 = self.rigid.at(at.now.x)
        value = mass_properties(m6)
        slope = np.zeros((10, p))
        # over parameters: complex step through a rational function of ten numbers
        for i in range(p):
            slope[:, i] = mass_properties(m6 + 1e-40j * d_m6[i]).imag / 1e-40
        seen = np.isfinite(self.measured)
        rest = ((np.asarray(self.measured) - value) / self.std)[seen]
        return rows_block(
            rest,
            (slope / np.asarray(self.std)[:, None])[seen],
            np.full(rest.size, NO_MODE),
        )


@dataclass(frozen=True, slots=True, eq=False)
class RigidMass:
    """The rigid-body mass matrix about the origin as it depends on the parameters.

    Attributes
    ----------
    system : AffineSystem
    vectors : (f, 6) float64
        Unit translations along and rotations about the axes of the origin.
    active : tuple of int
        The parameters that x stands for; empty: all.
    """

    system: AffineSystem
    vectors: Float
    active: tuple[int, ...] = ()

    def at(self, x: Float) -> tuple[Float, Float]:
        """The matrix (6, 6) at x (p,) and its derivatives (p, 6, 6)."""
        r = self.vectors
        parameters = self.system.parameters
        at = list(self.active or range(len(parameters)))
        everything = np.zeros(len(parameters))
        everything[at] = x
        a = parameters.factors(everything)
        slope = parameters.derivative(everything)
        m = r.T @ (self.system.mass @ r)
        d_m = np.zeros((a.size, 6, 6))
        for t in self.system.terms:
            part = r.T @ (t.mass @ r)
            m = m + t.function.value(a) * part
            for i in t.function.which:
                d_m[i] += t.function.derivative(a, i) * slope[i] * part
        return np.asarray(m), d_m[at]


def mass_properties(m6: Any_) -> Any_:
    """Mass, centre of gravity and inertia about it (10,), as in `MassPropertyDeviations`, from
    a rigid-body mass (6, 6).
    """
    mass = (m6[0, 0] + m6[1, 1] + m6[2, 2]) / 3
    x = m6[1, 5] / mass
    y = m6[2, 3] / mass
    z = m6[0, 4] / mass
    i = m6[3:, 3:]
    about = [
        i[0, 0] - mass * (y * y + z * z),
        i[1, 1] - mass * (x * x + z * z),
        i[2, 2] - mass * (x * x + y * y),
    ]
    mixed = [i[0, 1] + mass * x * y, i[1, 2] + mass * y * z, i[2, 0] + mass * z * x]
    return np.array([mass, x, y, z, *about, *mixed])
