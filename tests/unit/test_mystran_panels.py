"""Shear panels beside MYSTRAN (no mass and no edge rods there); skipped, saying so, where it is not
installed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
from fem_cases import cards, grid, modes, ragged

from ringtrue.errors import SolverMissing
from ringtrue.model.model import CaseControl, Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.mystran import MystranSolver, find_mystran


@pytest.mark.solver
def test_a_web_of_three_bays() -> None:
    """Rectangular panels between stringers, masses at the nodes, out of the plane on stiff springs
    to node 1.
    """
    try:
        find_mystran()
    except SolverMissing as e:
        pytest.skip(str(e))
    xyz = np.array([[1.2 * i, 0.8 * j, 0] for i in range(4) for j in range(2)])
    webs = np.array([[1, 3, 4, 2], [3, 5, 6, 4], [5, 7, 8, 6]])
    rods = np.array(
        [[a + k, b + k] for k in (0, 2, 4) for a, b in ((1, 3), (2, 4), (3, 4))]
    )
    free = list(range(3, 9))
    tables = (
        grid(xyz),
        cards(
            "CSHEAR",
            EID=[21, 22, 23],
            PID=8,
            **{f"G{j + 1}": webs[:, j] for j in range(4)},
        ),
        cards("PSHEAR", PID=[8], MID=1, T=1e-3),
        cards(
            "CONROD", EID=np.arange(1, 10), G1=rods[:, 0], G2=rods[:, 1], MID=1, A=1e-4
        ),
        cards("CELAS2", EID=[100 + g for g in free], K=1e9, G1=free, C1=3, G2=1, C2=3),
        cards(
            "CONM2", EID=[200 + g for g in free], G=free, M=[10.0, 12, 9, 14, 20, 25]
        ),
        cards("SPC1", SID=[1, 1], C=["123456", "456"], G=ragged([1, 2], free)),
        cards("MAT1", MID=[1], E=7e10, NU=0.33),
    )
    m = Model({t.card: t for t in tables}, {}, CaseControl(spc=1))
    with MystranSolver().open(m) as analysis:
        found = analysis.modes(ModesRequest(6)).modes
    np.testing.assert_allclose(found.frequencies, modes(m, 6), rtol=1e-5)
