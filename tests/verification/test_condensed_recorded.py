"""Condensed models of MSC Nastran 2019 at the digits that it recorded: frequencies, and shapes at
all points, modal coordinates among them.

A cantilever of ten CBARs in the plane and a ladder of rods, beams and bars, each condensed by ASET
(Guyan) and by ASET with QSET (component modes), or divided into two superelements (BEGIN SUPER) with
and without modes of their own.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.dofs import DofSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

DATA = (
    Path(__file__).parents[3] / "shared" / "data" / "fe" / "msc2019" / "superelements"
)
RECORDED = 3e-9  # of a frequency: component modes as far as Nastran's Lanczos converged
SHAPES = 1e-6  # of the largest component: close modes mix their rounding
DECKS = {
    "cantilever_bar/no_super/guyanReduction.dat": "guyanReduction.h5",
    "cantilever_bar/no_super/dynamicReduction.dat": "dynamicReduction.h5",
    "cantilever_bar/part_super_guyan/guyanSuper.dat": "guyanSuper.h5",
    "cantilever_bar/part_super_cb/cbSuper1Mode.dat": "cbSuper1Mode.h5",
    "cantilever_bar/part_super_cb/cbSuper2Modes.dat": "cbSuper2Modes.h5",
    "cantilever_bar/part_super_cb/cbSuper3Modes.dat": "cbSuper3Modes.h5",
    "three_element_types/no_super/guyanReduction-000.dat": "guyanreduction-000.h5",
    "three_element_types/no_super/dynamicReduction.dat-000.dat": "dynamicreduction.dat-000.h5",
    "three_element_types/part_super_guyan/guyanSuper.dat": "guyansuper.h5",
    "three_element_types/part_super_cb/cbSuper.dat": "cbsuper.h5",
}


@pytest.mark.data
@pytest.mark.parametrize("deck", DECKS)
def test_recorded_modes(deck: str) -> None:
    path = DATA / deck
    if not path.exists():
        pytest.skip(f"reference data not found: {path}")
    with h5py.File(path.with_name(DECKS[deck])) as file:
        values = file["NASTRAN/RESULT/SUMMARY/EIGENVALUE"][()]
        domains = file["NASTRAN/RESULT/DOMAINS"][()]
        shapes = file["NASTRAN/RESULT/NODAL/EIGENVECTOR"][()]
    want = values["FREQ"][values["DOMAIN_ID"] == values["DOMAIN_ID"][0]]
    with EmbeddedSolver().open(read_deck(path)) as analysis:
        found = analysis.modes(ModesRequest(want.size)).modes
    np.testing.assert_allclose(found.frequencies, want, rtol=RECORDED)
    assert isinstance(found.labels, DofSet)
    alone = np.append(np.diff(want) > 1e-6 * want[1:], True)
    alone[1:] &= alone[:-1]
    for mode in np.flatnonzero(alone).tolist():
        rows = shapes[
            np.isin(shapes["DOMAIN_ID"], domains["ID"][domains["MODE"] == mode + 1])
        ]
        recorded = np.stack(
            [rows[c] for c in ("X", "Y", "Z", "RX", "RY", "RZ")], axis=1
        )
        at = found.labels.find(
            np.repeat(rows["ID"], 6), np.tile(np.arange(1, 7), rows.size)
        )
        points = found.labels.find(rows["ID"], np.zeros_like(rows["ID"]))
        here = np.where(at >= 0, found.shapes[at, mode], 0.0).reshape(-1, 6)
        here[points >= 0, 0] = found.shapes[points[points >= 0], mode]
        modal = points >= 0  # each coordinate has a sign of its own
        assert (at >= 0).any()
        np.testing.assert_allclose(
            np.abs(here[modal]),
            np.abs(recorded[modal]),
            atol=SHAPES * np.abs(here[modal]).max(initial=0.0),
        )
        moved = recorded[~modal]
        sign = np.sign(np.sum(here[~modal] * moved))
        np.testing.assert_allclose(
            sign * here[~modal], moved, atol=SHAPES * np.abs(moved).max(), rtol=0
        )


@pytest.mark.data
def test_statics_of_superelements_are_those_of_one_mesh() -> None:
    """Forces of 1 along -Y, and of 1 along -2 Y, at point 6 of the cantilever."""
    parts = DATA / "cantilever_bar/part_super_guyan/guyanSuperStatic.dat"
    if not parts.exists():
        pytest.skip(f"reference data not found: {parts}")
    found = rt.static(parts, responses=["3+Y", "6+Y", "11+Y"])
    one = DATA / "cantilever_bar/no_super/noReduction.dat"
    want = rt.static(one, forces={"6+Y": -1.0}, responses=["3+Y", "6+Y", "11+Y"]).values
    assert found.cases == ("SUBCASE 1", "SUBCASE 2")
    np.testing.assert_allclose(
        found.values, np.concatenate([want, 2 * want]), rtol=1e-9
    )
