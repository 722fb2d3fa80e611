"""Second-order remainders of K and M to a parameter, for any model."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ringtrue.core.parameters import Parameter
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.fem.parametrisation.derivatives import system_derivatives
from ringtrue.model.model import Model

NAMES = ("stiffness", "mass")
# at least, by halving the step: a first-order error gives 2, a second-order one 4
SECOND = 3.7


def matrix_derivatives(
    model: Model, parameter: Parameter, system: System
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """∂K/∂a and ∂M/∂a at a = 1 of one parameter."""
    (slope,) = system_derivatives(model, [parameter], system)
    return slope.stiffness, slope.mass


def check_slopes(m: Model, p: Parameter) -> None:
    """K(1 + h) − K − hK' is h², or nothing where the dependence is linear; some matrix changes."""
    base = assemble(m)
    (slope,) = system_derivatives(m, [p], base)
    size = {n: float(abs(getattr(base, n)).max()) for n in NAMES}
    left = []
    for h in (0.02, 0.01):
        there = assemble(scaled(m, p, 1 + h))
        left.append(
            [
                float(
                    abs(
                        getattr(there, n) - getattr(base, n) - h * getattr(slope, n)
                    ).max()
                )
                for n in NAMES
            ]
        )
    assert any(abs(getattr(slope, n)).max() > 1e-9 * size[n] for n in NAMES if size[n])
    for a, b, s in zip(*left, size.values(), strict=True):
        assert b <= max(a / SECOND, 1e-12 * s)


def turned(xyz: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The points turned about a random axis, and the turn (3, 3)."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    Q = Q * np.sign(np.linalg.det(Q))
    return np.asarray(xyz, dtype=float) @ Q.T, Q
