"""Displacements and frequencies that MSC Nastran recorded, of decks of the public repository of
pyNastran.

One CHEXA of 1 x 1 x 2, E 3e7, ν 0.3, clamped at its lower face; a pressure of 1 on one side. The
displacements are those of models/unit/pload4/chexa.op2. Two CTETRA with ten nodes, one of them
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

TIP = 1e-8 * np.array(  # of the nodes above those of the lower face, in the order of the card
    [
        [96.78333, 4.125000, 39.85000],
        [94.28333, -4.875000, -38.35000],
        [94.28333, 4.875000, -38.35000],
        [96.78333, -4.125000, 39.85000],
    ]
)
PRINTED = 1e-6  # of the largest displacement: seven digits
SPLIT = 0.01  # of a frequency: how MSC splits the mass of a tetrahedron is not published
DECK = Path(__file__).parents[2].parent / "shared/data/fe/corpus/complex/tet10/Simple_Example.bdf"
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


def test_lumped_mass_of_tetrahedra_as_recorded() -> None:
    if not DECK.exists():
        pytest.skip(f"no {DECK}")
    with EmbeddedSolver().open(read_deck(DECK)) as analysis:
        found = analysis.modes(ModesRequest(RECORDED.size)).modes.frequencies
    np.testing.assert_allclose(found, RECORDED, rtol=SPLIT)
