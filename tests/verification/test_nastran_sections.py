"""A cantilever of PBARL and PBEAML rods (CBAR and CBEAM elements), read and solved.

Golden: Simcenter Nastran 2020 (5/9/19), `beam_modes.f06`, page 13: ten frequencies printed with seven digits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.backends.registry import solver
from ringtrue.io.nastran.reader import read_deck
from ringtrue.model.ports import ModesRequest

DECK = Path(__file__).parents[2].parent / "shared/data/fe/beam_modes/beam_modes.dat"
RECORDED = [
    *(4.566603e02, 4.566603e02, 2.674588e03, 2.674588e03, 3.554923e03),
    *(4.507487e03, 6.626104e03, 6.626104e03, 1.111159e04, 1.111159e04),
]


@pytest.mark.data
def test_frequencies_of_a_beam_of_rod_sections() -> None:
    if not DECK.exists():
        pytest.skip(f"needs {DECK}")
    with solver("embedded").open(read_deck(DECK)) as analysis:
        got = analysis.modes(ModesRequest(10)).modes.frequencies
    np.testing.assert_allclose(got, RECORDED, rtol=5e-7)  # the last printed digit
