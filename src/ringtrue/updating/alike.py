"""How alike errors are: those of the frequencies of modes, and those of a shape at its channels.

What a model lacks at a place acts on all modes that strain or move there.

Relative frequency errors of modes i and j that come of independent errors of stiffness at all
elements and of mass at all nodes have the covariance Σ_e S_ei S_ej + Σ_n T_ni T_nj, with S and T
the shares of strain and kinetic energy. Errors that are alike tell less of their size than as many
independent ones. Errors of form bend a shape towards other shapes of the structure, noise bends it
anywhere.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.fem.assembly import System
from ringtrue.fem.mesh import mesh
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation
from ringtrue.shapes.mac import basis
from ringtrue.updating.localise import strain_energies
from ringtrue.updating.objective import Target, match
from ringtrue.updating.spans import span_residual


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
    return np.concatenate(
        [e / np.maximum(e.sum(axis=0), 1e-300) for e in (strain, np.maximum(kinetic, 0.0))]
    )


def likeness(shares: Float) -> Float:
    """Correlation of the frequency errors of modes, (m, m), from their energy shares (e, m)."""
    covariance = shares.T @ shares
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance / np.outer(size, size))


def effective_freedom(correlation: Float) -> float:
    """Degrees of freedom of the mean square of errors with this correlation, (m, m).

    m²/ΣR² is that of the χ² with the same mean and variance (Satterthwaite 1946): m where the
    errors are independent, 1 where they are one and the same.
    """
    m = len(correlation)
    return float(m**2 / (correlation**2).sum()) if m else 1.0


def errors_of_shapes(target: Target, now: Linearisation) -> float:
    """`independent_errors` of the used shapes of a test against a model at a point; 1 without a
    pair.
    """
    pairs, _, of = match(target, now)
    some = [(t, s) for t, s in zip(pairs[:, 0].tolist(), of, strict=True) if target.used[t]]
    rest = [span_residual(target.shapes, now, t, s)[0] for t, s in some]
    return (
        independent_errors(np.stack(rest, axis=1), np.array([s.size for _, s in some]), now.shapes)
        if rest
        else 1.0
    )


def independent_errors(rest: Float, own: Float, shapes: Float) -> float:
    """Number of independent errors in a shape: 1 where they are errors of form, the channels where
    they are noise.

    Of noise the other shapes hold as large a share as the directions they span of all that are
    free; what they hold beyond that is taken for one error, which any parameter may imitate.

    Parameters
    ----------
    rest : (n, k) float64
        Unit test shapes less their part in the span of the modes that stand for them.
    own : (k,) float64
        Number of these modes.
    shapes : (n, m) float64
        Of the model, the lowest first; n/2 of them are looked at.
    """
    n = len(rest)
    total = float((rest**2).sum())
    space = basis(shapes[:, : n // 2])
    if not total > 0 or not space.size:
        return 1.0
    held = float(((space.T @ rest) ** 2).sum()) / total
    size = (rest**2).sum(axis=0)
    by_chance = float(size @ np.clip((space.shape[1] - own) / np.maximum(n - own, 1), 0, 1)) / total
    of_form = float(np.clip((held - by_chance) / (1 - by_chance), 0.0, 1.0))
    return 1 / (of_form + (1 - of_form) / n)
