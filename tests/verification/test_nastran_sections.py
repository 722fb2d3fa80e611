"""A cantilever of PBARL and PBEAML rods (CBAR and CBEAM elements), read and solved; closed
sections.

Golden: Simcenter Nastran 2020 (5/9/19), `beam_modes.f06`, page 13: ten frequencies printed with
seven digits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import UnsupportedCard
from ringtrue.model.ports import ModesRequest
from ringtrue.model.sections import SECTIONS
from ringtrue.solvers.registry import solver

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
    """A hat without brims on its plate, and two cells parted by next to nothing or by a wall that
    carries no flow.
    """
    box = SECTIONS["BOX1"][1]
    same(
        SECTIONS["HAT1"][1](4.0, 3.0, 4.0 - 2e-9, 0.2, 0.3),
        box(4.0, 3.0, 0.2, 0.3, 0.2, 0.2),
    )
    thin = SECTIONS["DBOX"][1](6.0, 3.0, 2.0, 0.1, 1e-9, 0.2, 0.3, 0.4, 0.3, 0.4)
    same(thin, box(6.0, 3.0, 0.3, 0.4, 0.2, 0.1))
    even, one = (
        SECTIONS["DBOX"][1](6.0, 3.0, 3.0, *[0.2] * 7),
        box(6.0, 3.0, *[0.2] * 4),
    )
    web = {"A": 0.2 * 2.6, "I1": 0.2 * 2.6**3 / 12, "I2": 2.6 * 0.2**3 / 12, "J": 0.0}
    same(even, {name: one[name] + more for name, more in web.items()}, 1e-12)
    uneven = SECTIONS["DBOX"][1](6.0, 3.0, 2.0, 0.1, 0.3, 0.2, 0.1, 0.2, 0.3, 0.4)
    plates = 1.75 * 0.1 + 1.75 * 0.2 + 3.65 * 0.3 + 3.65 * 0.4
    assert uneven["A"] == pytest.approx(0.6 * 3 + plates)


def test_blank_dimensions_of_a_double_box(tmp_path: Path) -> None:
    """DIM5 to DIM8 are DIM4, DIM9 and DIM10 are DIM6 (Quick Reference Guide, PBARL, remark 9)."""
    rows = [
        "PBARL,1,1,,DBOX",
        "+,6.,3.,2.,.1,,.2",
        "PBARL,2,1,,DBOX",
        "+,6.,3.,2.,.1,.1,.2,.1,.1",
        "+,.2,.2,7.",
    ]
    (tmp_path / "m.bdf").write_text("\n".join(rows))
    t = read_deck(tmp_path / "m.bdf")["PBAR"]
    assert t["J"][0] == t["J"][1]
    assert t["A"][0] == t["A"][1]
    assert t["NSM"].tolist() == [0.0, 7.0]


FOUR = "PBCOMP,7,1,2.-3,9.,9.,9.,3.-6,.5\n+,.8,.9,,,9.,9.,{symmetry}\n"


def composite(tmp_path: Path, text: str) -> dict[str, float]:
    """The PBEAM of a PBCOMP."""
    path = tmp_path / "beam.bdf"
    path.write_text("BEGIN BULK\nMAT1,1,2.+11,,.3,7800.\n" + text + "ENDDATA\n")
    t = read_deck(path)["PBEAM"]
    return {n: float(t[n][0]) for n in t.columns if n != "X" and not n.endswith("X")}


def test_lumped_areas_of_a_pbcomp(tmp_path: Path) -> None:
    """Four corners y = 0.1 +- 0.03, z = +-0.04 of a quarter of A each; I1 and I2 of the card do not
    count.
    """
    corners = [(y, z, 0.25) for y in (0.07, 0.13) for z in (-0.04, 0.04)]
    areas = "".join(
        f"+,{y},{z},{c},{mid}\n+\n"
        for (y, z, c), mid in zip(corners, ("", 1, "", 1), strict=True)
    )
    p = composite(tmp_path, FOUR.format(symmetry=5) + areas.replace("+\n", ""))
    want = {
        "A": 2e-3,
        "I1": 2e-3 * 0.03**2,
        "I2": 2e-3 * 0.04**2,
        "I12": 0,
        "J": 3e-6,
        "NSM": 0.5,
        "K1": 0.8,
        "K2": 0.9,
    }
    for name, value in (want | {"N1A": 0.1, "N2B": 0.0, "I1B": 1.8e-6}).items():
        assert p[name] == pytest.approx(value, abs=1e-15), name


def test_a_quarter_of_a_pbcomp_and_one_without_areas(tmp_path: Path) -> None:
    """Mirrored about both axes; without areas it is a PBEAM, whose points are those of stresses."""
    p = composite(tmp_path, FOUR.format(symmetry=1) + "+,.03,.04,.25\n")
    assert [p[n] for n in ("A", "I1", "I2", "I12", "N1A")] == pytest.approx(
        [2e-3, 1.8e-6, 3.2e-6, 0, 0], abs=1e-15
    )
    p = composite(
        tmp_path, "PBCOMP,7,1,2.-3,4.-6,5.-6,1.-6,3.-6\n+,,,,,.01,.02\n+,.03,.04\n"
    )
    assert [p[n] for n in ("I1", "I2B", "I12", "N1A", "N2B", "K1")] == [
        4e-6,
        5e-6,
        1e-6,
        0.01,
        0.02,
        1.0,
    ]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (FOUR.format(symmetry=5) + "+,.03,.04,1.,2\n", "several materials"),
        (FOUR.format(symmetry=3) + "+,.03,.04,1.\n", "SYMOPT 3; give all areas"),
    ],
)
def test_a_pbcomp_that_is_not_read_says_what_to_do(
    tmp_path: Path, text: str, why: str
) -> None:
    with pytest.raises(UnsupportedCard, match=why):
        composite(tmp_path, "CBEAM,1,7,1,2,0.,0.,1.\nGRID,1\nGRID,2,,1.\n" + text)
