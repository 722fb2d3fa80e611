"""How alike the errors of modes are: what a model lacks at a place acts on all modes that strain or move there.

Relative frequency errors of modes i and j that come of independent errors of stiffness at all elements and of mass at
all nodes have the covariance Σ_e S_ei S_ej + Σ_n T_ni T_nj, with S and T the shares of strain and kinetic energy.
Errors that are alike tell less of their size than as many independent ones.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.fem.assembly import System
from ringtrue.fem.mesh import mesh
from ringtrue.model.model import Model
from ringtrue.update.localise import strain_energies


def energy_shares(model: Model, system: System, vectors: Float) -> Float:
    """Shares of strain energy of the elements, then of kinetic energy of the nodes, (e + n, m).

    Parameters
    ----------
    vectors : (f, m) float64
        Modes in the free degrees of freedom, any scale.
    """
    strain = np.maximum(strain_energies(mesh(model), system, vectors), 0.0)
    _, node = np.unique(system.free.node, return_inverse=True)
    kinetic = np.zeros((int(node.max(initial=-1)) + 1, vectors.shape[1]))
    np.add.at(kinetic, node, vectors * (system.mass @ vectors))
    return np.concatenate([e / np.maximum(e.sum(axis=0), 1e-300) for e in (strain, np.maximum(kinetic, 0.0))])


def likeness(shares: Float) -> Float:
    """Correlation of the frequency errors of modes, (m, m), from their energy shares (e, m)."""
    covariance = shares.T @ shares
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance / np.outer(size, size))


def effective_freedom(correlation: Float) -> float:
    """Degrees of freedom of the mean square of errors with this correlation, (m, m).

    m²/ΣR² is that of the χ² with the same mean and variance (Satterthwaite 1946): m where the errors are independent,
    1 where they are one and the same.
    """
    m = len(correlation)
    return float(m**2 / (correlation**2).sum()) if m else 1.0
