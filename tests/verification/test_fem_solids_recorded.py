"""Displacements and frequencies that MSC Nastran recorded, of decks of the public repository of
pyNastran.

One CHEXA of 1 x 1 x 2, E 3e7, ν 0.3, clamped at its lower face; a pressure of 1 on one side. The
displacements are those of models/unit/pload4/chexa.op2. One CPENTA, the half of it, under a
pressure on each side and on its upper face: cpenta.op2, beside it. Two CTETRA with ten nodes, one of them
with a curved edge: models/complex/tet10, from ../shared/data.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_cases import grid, model, steel
from solid_meshes import elements, psolid

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.assembly import assemble
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

# of the nodes above those of the lower face, in the order of the card
TIP = 1e-8 * np.array(
    [
        [96.78333, 4.125000, 39.85000],
        [94.28333, -4.875000, -38.35000],
        [94.28333, 4.875000, -38.35000],
        [96.78333, -4.125000, 39.85000],
    ]
)
SIDES = 1e-8 * np.array(  # the same of the wedge, by load
    [
        [
            [-174.6709, 392.0131, -3.951767],
            [-173.1709, 291.6637, 144.3060],
            [-79.32152, 286.6637, -135.8542],
        ],
        [
            [-286.6637, 79.32152, -135.8542],
            [-291.6637, 173.1709, 144.3060],
            [-392.0131, 174.6709, -3.951767],
        ],
        [
            [463.0846, -469.5846, 142.8060],
            [463.0846, -463.0846, -285.6119],
            [469.5846, -463.0846, 142.8060],
        ],
        [[-0.75, -0.75, -6.238096], [0.75, -0.75, -6.238096], [0.75, 0.75, -6.238096]],
    ]
)
PRINTED = 1e-6  # of the largest displacement: seven digits
# of a frequency: how MSC splits the mass of a tetrahedron is not published
SPLIT = 0.01
DECK = (
    Path(__file__).parents[2].parent
    / "shared/data/fe/corpus/complex/tet10/Simple_Example.bdf"
)
RECORDED = np.array(  # Hz
    [
        87278.52,
        91000.03,
        102378.9,
        266860.9,
        283121.7,
        343508.5,
        489763.8,
        501412.0,
        526921.8,
        740855.1,
    ]
)


def test_one_hexahedron_bends_as_recorded() -> None:
    face = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    xyz = np.vstack([np.column_stack([face, np.full(4, z)]) for z in (0.0, 2.0)])
    table = elements("CHEXA", np.arange(8)[None])
    s = assemble(model(grid(xyz), table, psolid(), steel(E=3e7)))
    free = s.free.node > 4
    load = ((s.free.direction == 1) & np.isin(s.free.node, (5, 8)))[free] * 0.5
    K = s.stiffness.toarray()[np.ix_(free, free)]
    moved = np.linalg.solve(K, load).reshape(4, 3)
    np.testing.assert_allclose(moved, TIP, atol=PRINTED * np.abs(TIP).max())


def test_one_wedge_bends_and_twists_as_recorded() -> None:
    corners = np.array([[0, 0], [1, 0], [1, 1.0]])
    xyz = np.vstack([np.column_stack([corners, np.full(3, z)]) for z in (0.0, 2.0)])
    table = elements("CPENTA", np.arange(6)[None])
    s = assemble(model(grid(xyz), table, psolid(), steel(E=3e7)))
    free = s.free.node > 3
    K = s.stiffness.toarray()[np.ix_(free, free)]
    loads = np.zeros((4, 3, 3))
    loads[0, :2, 1] = 0.5
    loads[1, 1:, 0] = -0.5
    loads[2, ::2, :2] = [0.5, -0.5]
    loads[3, :, 2] = -1 / 6
    moved = np.linalg.solve(K, loads.reshape(4, 9).T).T.reshape(4, 3, 3)
    for found, recorded in zip(moved, SIDES, strict=True):
        np.testing.assert_allclose(
            found, recorded, atol=PRINTED * np.abs(recorded).max()
        )


def test_lumped_mass_of_tetrahedra_as_recorded() -> None:
    if not DECK.exists():
        pytest.skip(f"no {DECK}")
    with EmbeddedSolver().open(read_deck(DECK)) as analysis:
        found = analysis.modes(ModesRequest(RECORDED.size)).modes.frequencies
    np.testing.assert_allclose(found, RECORDED, rtol=SPLIT)
