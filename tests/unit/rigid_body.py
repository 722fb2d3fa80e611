"""A rigid body on springs to the ground: the model of a suspension that needs no deck."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Any_, Float, freeze_fields
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.dense_models import DenseModel


@dataclass(frozen=True, slots=True, eq=False)
class RigidBody:
    """A rigid body on springs to the ground; an `ObservedModel` with exact derivatives.

    Attributes
    ----------
    mass : float
    cg : (3,) float64
    inertia : (3, 3) float64
        About the centre of gravity, the products with a minus: J = Σ m(|r|² − r rᵀ).
    at : (s, 3) float64
        Where the springs act.
    stiffness : (s, 3) float64
        Along x, y, z.
    points, directions : (channel, 3) float64
        Sensors, unit vectors.
    parameters : ParameterSet
    targets : tuple of str
        What each parameter does: `k:3:0,1,2` a factor on the stiffness of springs 0, 1, 2 along z;
        `mass`; `cg:1` moves the centre by (a − 1)·`reach` along x; `inertia:12` a factor on that
        entry, `inertia` on all.
    reach : float
        Length for `cg`.
    """

    mass: float
    cg: Float
    inertia: Float
    at: Float
    stiffness: Float
    points: Float
    directions: Float
    parameters: ParameterSet
    targets: tuple[str, ...]
    reach: float = 1.0

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, cg=f, inertia=f, at=f, stiffness=f, points=f, directions=f)
        if (
            len(self.targets) != len(self.parameters)
            or self.at.shape != self.stiffness.shape
            or not self.mass > 0
        ):
            raise InputError(
                f"{len(self.targets)} targets for {len(self.parameters)} parameters; springs at "
                f"{self.at.shape}, "
                f"stiffness {self.stiffness.shape}; mass {self.mass:g} must be > 0"
            )

    def matrices(self, factors: Any_) -> tuple[Any_, Any_]:
        """K and M (6, 6) at factors (p,), real or complex; motions at the nominal centre of
        gravity.
        """
        k, m, c, j = (
            self.stiffness + 0j,
            self.mass + 0j,
            np.zeros(3, dtype=complex),
            self.inertia + 0j,
        )
        for target, a in zip(self.targets, factors, strict=True):
            what, *where = target.split(":")
            if what == "k":
                k[[int(i) for i in where[1].split(",")], int(where[0]) - 1] *= a
            elif what == "mass":
                m = m * a
            elif what == "cg":
                c[int(where[0]) - 1] += (a - 1) * self.reach
            elif what == "inertia":
                r, s = (int(i) - 1 for i in where[0]) if where else (0, 0)
                j = j * a if not where else _scaled(j, r, s, a)
            else:
                raise InputError(
                    f"target {target!r}: allowed are k:axis:springs, mass, cg:axis, inertia[:ij]"
                )
        arms = _motion(self.at - self.cg)
        stiff = np.einsum("sai,sa,saj->ij", arms, k, arms)
        cross = _cross(c)
        heavy = np.block(
            [[m * np.eye(3), -m * cross], [m * cross, j - m * cross @ cross]]
        )
        return stiff, heavy

    def _dense(self, x: Float) -> DenseModel:
        """The model about x as a linear one: exact in value and slope."""
        a, slope = self.parameters.factors(x), self.parameters.derivative(x)
        k, m = self.matrices(a)
        h = 1e-30
        steps = [self.matrices(a + 1j * h * e) for e in np.eye(a.size)]
        dk = (
            np.array([s[0].imag / h for s in steps]).reshape(-1, 6, 6)
            * slope[:, None, None]
        )
        dm = (
            np.array([s[1].imag / h for s in steps]).reshape(-1, 6, 6)
            * slope[:, None, None]
        )
        linear = ParameterSet(
            tuple(replace(p, scale="linear") for p in self.parameters.parameters)
        )
        seen = np.einsum("ca,cai->ci", self.directions, _motion(self.points - self.cg))
        return DenseModel(k.real, m.real, dk, dm, seen, linear, 6)

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x (p,)."""
        return replace(
            self._dense(x).linearise(np.zeros(len(self.parameters))),
            x=np.asarray(x, dtype=np.float64),
        )

    def modes(self, x: Float) -> Linearisation:
        """Modes at x (p,)."""
        return replace(
            self._dense(x).modes(np.zeros(len(self.parameters))),
            x=np.asarray(x, dtype=np.float64),
        )


def _scaled(j: Any_, r: int, s: int, a: Any_) -> Any_:
    out = j.copy()
    out[r, s] = j[r, s] * a
    out[s, r] = out[r, s]
    return out


def _cross(c: Any_) -> Any_:
    """c× as a matrix (3, 3)."""
    return np.array(
        [[0 * c[0], -c[2], c[1]], [c[2], 0 * c[0], -c[0]], [-c[1], c[0], 0 * c[0]]]
    )


def _motion(r: Float) -> Float:
    """Translations at arms r (k, 3) of a rigid motion, (k, 3, 6)."""
    zero = np.zeros(len(r))
    x, y, z = r.T
    turn = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
    return np.concatenate(
        [np.broadcast_to(np.eye(3), (len(r), 3, 3)), np.moveaxis(turn, -1, 0)], axis=2
    )
