"""Where a model is wrong: local error indicators by element, each normalised, and what they say of
a candidate.

Force residual: (K − ω²M)u of the expanded test shapes, by node (Fissette, Stavrinidis and Ibrahim
1988). Error in constitutive relation: with Kv = ω²Mu the energy of u − v by element (Ladevèze and
Reynier 1989), u being the minimum of that error and of the misfit at the sensors. Modal strain
energy change by element (Shi, Law and Zhang 1998). Variation of MAC and frequency: what a single
candidate explains by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.parameters import ParameterSet
from ringtrue.fem.assembly import System
from ringtrue.fem.element_cards import mesh, pieces
from ringtrue.fem.mesh import Mesh
from ringtrue.fem.parametrisation.changed_model import affected_cards
from ringtrue.model.model import Model
from ringtrue.reduction.expansion import ShapeReadings, expand_reduced
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.updating.problem import Residual
from ringtrue.updating.residuals.modal import Quantity
from ringtrue.updating.target import Target

# relative error of a measured shape that its expansion may leave
EXPANSION_MISFIT = 0.02
SCARCE = 1e-4  # share of strain energy below which a concentration says nothing


@dataclass(frozen=True, slots=True, eq=False)
class ElementErrors(FrozenArrays):
    """Local error indicators; each is a share, so that its column sums to 1 over the elements.

    Attributes
    ----------
    elements : (e,) int64
        Ids, in the order of `candidates.elements_of`.
    force : (e,) float64
        Squared force residual over the stiffness of its degree of freedom.
    constitutive : (e,) float64
        Energy of the error in constitutive relation.
    energy : (e,) float64
        Change of the share of modal strain energy between model and test.
    strain : (e,) float64
        Share of strain energy in the expanded test shapes: what the others are held against.
    relative : (m,) float64
        Error in constitutive relation over the strain energy of each test mode.
    """

    elements: Int
    force: Float
    constitutive: Float
    energy: Float
    strain: Float
    relative: Float

    def concentration(self, members: sparse.csr_array) -> dict[str, Float]:
        """Share of the error over share of the strain energy of each candidate, (p,), by indicator:
        1 where the error is spread evenly.

        0 for candidates with less than 1e-4 of the strain energy, of which the test shapes say
        nothing.

        Parameters
        ----------
        members : (p, e) scipy.sparse.csr_array
            As `candidates.membership` gives it.
        """
        strain = members @ self.strain
        kinds = {
            "force": self.force,
            "constitutive": self.constitutive,
            "energy": self.energy,
        }
        over = np.where(strain > SCARCE, strain, np.inf)
        return {name: members @ value / over for name, value in kinds.items()}


def reduced_errors(
    model: Model,
    system: System,
    reduced: ReducedModel,
    readings: ShapeReadings,
    partners: Int,
) -> tuple[ElementErrors, Float]:
    """All indicators with the test shapes expanded in a reduced basis, and their misfit (m,): no
    factorisation.

    Parameters
    ----------
    readings : ShapeReadings
        The test shapes by the basis of the reduced model.
    partners : (m,) int64
        The model's mode of each.
    """
    b = reduced.basis
    energy = b.stiffness - reduced.shift * b.mass
    found = expand_reduced(b.stiffness, b.mass, energy, readings)
    frequencies = readings.frequencies
    _, own = reduced.coordinates(np.zeros(len(reduced.active)))
    u = b.vectors @ np.hstack([found.shapes, own[:, partners]])
    solve = reduced.pencil.at(reduced.shift).solve
    full, mine = np.hsplit(u, [frequencies.size])
    errors = expanded_errors(
        model,
        system,
        frequencies=frequencies,
        shapes=full,
        own=mine,
        solve=solve,
    )
    return errors, found.misfit


def expanded_errors(
    model: Model,
    system: System,
    frequencies: Float,
    shapes: Float,
    own: Float,
    solve: Callable[[Float], Float],
) -> ElementErrors:
    """All indicators of test shapes on all degrees of freedom, each averaged over the modes.

    Parameters
    ----------
    frequencies : (m,) float64, Hz
        Of the test.
    shapes, own : (f, m) float64
        Of the test, expanded, any scale; of the model's partners.
    solve : callable, (f, m) -> (f, m)
        x = A⁻¹b with A the stiffness, held where the structure is free.
    """
    m = mesh(model)
    count = frequencies.size
    u = shapes / np.sqrt(np.einsum("fm,fm->m", shapes, system.mass @ shapes))
    r = system.stiffness @ u - (system.mass @ u) * (2 * np.pi * frequencies) ** 2
    energies, touch = _energies_and_nodes(m, system, np.hstack([u, solve(r), own]))
    of_test, of_error, mine = np.split(energies, [count, 2 * count], axis=1)
    total = np.maximum(of_test.sum(axis=0), 1e-300)
    of_test = of_test / total
    of_error = of_error / total
    mine = mine / np.maximum(mine.sum(axis=0), 1e-300)
    return ElementErrors(
        elements=np.concatenate([model[c].ids for c in affected_cards(model)]),
        force=_share(_by_element(touch, _nodal(m, system, r)).sum(axis=1)),
        constitutive=_share(of_error.sum(axis=1)),
        energy=_share(np.abs(of_test - mine).sum(axis=1)),
        strain=_share(of_test.sum(axis=1)),
        relative=of_error.sum(axis=0),
    )


def _share(x: Float) -> Float:
    total = float(x.sum())
    return x / total if total > 0 else np.zeros_like(x)


def strain_energies(m: Mesh, system: System, vectors: Float) -> Float:
    """uᵀK_e u of each element (in the order of `candidates.elements_of`), (e, k).

    Parameters
    ----------
    vectors : (f, k) float64
    """
    return _energies_and_nodes(m, system, vectors)[0]


def _energies_and_nodes(
    m: Mesh, system: System, vectors: Float
) -> tuple[Float, sparse.csr_array]:
    """uᵀK_e u (e, k), and which nodes each element touches, ones of (e, n): its matrices are made
    once.
    """
    full = system.transform @ vectors
    # DOF -1 is the row of zeros
    full = np.concatenate([full, np.zeros((1, full.shape[1]))])
    first = _first(m)
    grid = 6 * len(m.xyz)
    count = sum(len(m.model[c]) for c in first)
    out = np.zeros((count, vectors.shape[1]))
    none = np.empty(0, dtype=np.int64)
    rows = [none]
    cols = [none]
    for card, at, part in pieces(m):
        u = full[part.dofs]
        out[first[card] + at] = np.einsum("edk,edk->ek", u, part.stiffness @ u)
        node = np.where(part.dofs < grid, part.dofs // 6, part.dofs - grid + len(m.xyz))
        e, d = np.nonzero(part.dofs >= 0)
        rows.append(first[card] + at[e])
        cols.append(node[e, d])
    entries = (
        np.ones(sum(r.size for r in rows)),
        (np.concatenate(rows), np.concatenate(cols)),
    )
    touch = sparse.csr_array(
        sparse.coo_array(entries, shape=(count, len(m.xyz) + m.scalar.size))
    )
    touch.data[:] = 1.0
    return out, touch


def _first(m: Mesh) -> dict[str, int]:
    """Where the elements of each card begin."""
    cards = list(affected_cards(m.model))
    sizes = np.cumsum([0, *(len(m.model[c]) for c in cards)])
    return dict(zip(cards, sizes[:-1].tolist(), strict=True))


def _nodal(m: Mesh, system: System, r: Float) -> Float:
    """Σ r_i²/K_ii over the free DOFs of each node, then of each scalar point, (n, k)."""
    weight = system.stiffness.diagonal()
    weight = np.where(weight > 0, weight, np.inf)
    ids = np.concatenate([m.model["GRID"].ids, m.scalar])
    order = np.argsort(ids, kind="stable")
    node = order[np.searchsorted(ids[order], system.free.node)]
    entries = (np.ones(node.size), (node, np.arange(node.size)))
    gather = sparse.csr_array(sparse.coo_array(entries, shape=(ids.size, node.size)))
    return np.asarray(gather @ (r**2 / weight[:, None]))


def _by_element(touch: sparse.csr_array, nodal: Float) -> Float:
    """What stands at a node is shared equally by its elements, (e, k)."""
    count = np.maximum(touch.sum(axis=0), 1.0)
    return np.asarray(touch @ (nodal / np.asarray(count)[:, None]))


@dataclass(frozen=True, slots=True, eq=False)
class Variation(FrozenArrays):
    """What each candidate explains by itself, at the minimum of J over it alone (linearised, inside
    its bounds).

    Attributes
    ----------
    x : (p,) float64
    frequency : (p,) float64
        Fall of the frequency part of the residual as a share of it; negative where it gets worse.
    mac : (p,) float64
        Likewise of Σ (1 − MAC); 0 where the objective has no shapes.
    gain : (p,) float64
        Fall of J.
    """

    x: Float
    frequency: Float
    mac: Float
    gain: Float


def variation(target: Target, r: Residual, parameters: ParameterSet) -> Variation:
    """Frequencies and MAC by one candidate at a time.

    Parameters
    ----------
    r : Residual
        At x = 0.
    parameters : ParameterSet
        The candidates.
    """
    prior = parameters.std()
    low, high = parameters.bounds()
    g = r.slope
    value = r.value
    size = np.sum(g**2, axis=0) + prior**-2
    x = np.clip(g.T @ value / size, low, high)
    after = (value[:, None] - g * x) ** 2
    before = value[:, None] ** 2

    def fall(quantity: Quantity) -> Float:
        rows = r.quantity == quantity.value
        total = float(before[rows].sum())
        # squared weighted residual below which there is nothing to explain
        if total <= 1e-12:
            return np.zeros(x.size)
        return np.asarray(1 - after[rows].sum(axis=0) / total)

    shapes = np.zeros(x.size)
    if target.weights.shape > 0:
        shapes = fall(Quantity.SHAPE)
    gain = before.sum() - after.sum(axis=0) - (x / prior) ** 2
    return Variation(x, fall(Quantity.FREQUENCY), shapes, gain)
