"""A cantilever of PBARL and PBEAML rods (CBAR and CBEAM elements), read and solved; closed sections.

Golden: Simcenter Nastran 2020 (5/9/19), `beam_modes.f06`, page 13: ten frequencies printed with seven digits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.backends.registry import solver
from ringtrue.io.nastran.reader import read_deck
from ringtrue.model.ports import ModesRequest
from ringtrue.model.sections import SECTIONS

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


def same(a: dict[str, float], b: dict[str, float], rel: float = 1e-6) -> None:
    for name in ("A", "I1", "I2", "J"):
        assert a[name] == pytest.approx(b[name], rel=rel), name


def test_closed_sections_that_become_a_box() -> None:
    """A hat without brims on its plate, and two cells parted by next to nothing or by a wall that carries no flow."""
    box = SECTIONS["BOX1"][1]
    same(SECTIONS["HAT1"][1](4.0, 3.0, 4.0 - 2e-9, 0.2, 0.3), box(4.0, 3.0, 0.2, 0.3, 0.2, 0.2))
    thin = SECTIONS["DBOX"][1](6.0, 3.0, 2.0, 0.1, 1e-9, 0.2, 0.3, 0.4, 0.3, 0.4)
    same(thin, box(6.0, 3.0, 0.3, 0.4, 0.2, 0.1))
    even, one = SECTIONS["DBOX"][1](6.0, 3.0, 3.0, *[0.2] * 7), box(6.0, 3.0, *[0.2] * 4)
    web = {"A": 0.2 * 2.6, "I1": 0.2 * 2.6**3 / 12, "I2": 2.6 * 0.2**3 / 12, "J": 0.0}
    same(even, {name: one[name] + more for name, more in web.items()}, 1e-12)
    uneven = SECTIONS["DBOX"][1](6.0, 3.0, 2.0, 0.1, 0.3, 0.2, 0.1, 0.2, 0.3, 0.4)
    plates = 1.75 * 0.1 + 1.75 * 0.2 + 3.65 * 0.3 + 3.65 * 0.4
    assert uneven["A"] == pytest.approx(0.6 * 3 + plates)


def test_blank_dimensions_of_a_double_box(tmp_path: Path) -> None:
    """DIM5 to DIM8 are DIM4, DIM9 and DIM10 are DIM6 (Quick Reference Guide, PBARL, remark 9)."""
    rows = ["PBARL,1,1,,DBOX", "+,6.,3.,2.,.1,,.2", "PBARL,2,1,,DBOX", "+,6.,3.,2.,.1,.1,.2,.1,.1", "+,.2,.2,7."]
    (tmp_path / "m.bdf").write_text("\n".join(rows))
    t = read_deck(tmp_path / "m.bdf")["PBAR"]
    assert t["J"][0] == t["J"][1]
    assert t["A"][0] == t["A"][1]
    assert t["NSM"].tolist() == [0.0, 7.0]
