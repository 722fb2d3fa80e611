"""Recorded MSC Nastran and Simcenter Nastran frequencies, from ../shared/data (see its README)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_cases import modes

from ringtrue.decks.nastran.reader import read_deck

DATA = Path(__file__).parents[2].parent / "shared/data/fe"
SYSTEM = "msc2019/system_verification"
PRINTED = 2e-6  # seven digits in the f06, six in the README
RUNS = {
    f"{SYSTEM}/001_ten_bar_truss/nastran_runs/modes.dat": [
        *(8.9495, 26.9566, 27.2502, 49.9307, 56.8847),
        *(62.9965, 65.0835, 77.1285),
    ],
    f"{SYSTEM}/002_svanberg_beam/nastran_runs/modes.dat": [
        *(
            46.46440,
            146.9333,
            279.0229,
            752.9903,
            815.3514,
            882.3479,
            1405.450,
            1507.328,
            2059.242,
            2366.242,
        ),
    ],
    f"{SYSTEM}/003_svanberg_bar/nastran_runs/modes.dat": [
        *(
            46.46440,
            146.9333,
            279.0229,
            752.9903,
            815.3514,
            882.3479,
            1405.450,
            2059.242,
            2366.242,
            2381.164,
        ),
    ],
    f"{SYSTEM}/004_72_bar_truss/nastran_runs/modes.dat": [
        25.4557,
        25.4557,
        38.9409,
        68.5554,
    ],
    "msc2019/superelements/cantilever_bar/no_super/noReduction.dat": [
        349.729,
        2167.32,
        6007.803,
        11650.23,
    ],
    "beam_modes/beam_modes.dat": [
        *(
            456.6603,
            456.6603,
            2674.588,
            2674.588,
            3554.923,
            4507.487,
            6626.104,
            6626.104,
            11111.59,
            11111.59,
        ),
    ],
    "naca_wing/0012_flutter.bdf": [2.66709, 10.6282],
}


@pytest.mark.data
@pytest.mark.parametrize("deck", RUNS)
def test_recorded_frequencies(deck: str) -> None:
    if not (DATA / deck).exists():
        pytest.skip(f"reference data not found: {DATA / deck}")
    want = np.array(RUNS[deck])
    np.testing.assert_allclose(
        modes(read_deck(DATA / deck), want.size), want, rtol=PRINTED, atol=6e-5
    )
