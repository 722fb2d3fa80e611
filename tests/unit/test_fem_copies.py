"""Elements at many factors from one call of their kernels, against a call for each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.arrays import Any_
from ringtrue.core.parameters import CardField, Parameter, Substructure
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.mesh import union
from ringtrue.fem.parametrisation.parameter_groups import (
    Region,
    Together,
    groups_of,
    regions,
)

# three shells of a cylinder, whose normals are those of their neighbours; bars of dimensions, a
# beam whose end B follows end A, a spring, masses; numbers of properties and materials in common
DECK = """
CEND
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,2.,0.,-.1
GRID,4,,3.,0.,-.3
GRID,11,,0.,1.,0.
GRID,12,,1.,1.,0.
GRID,13,,2.,1.,-.1
GRID,14,,3.,1.,-.3
CQUAD4,1,1,1,2,12,11
CQUAD4,2,2,2,3,13,12
CQUAD4,3,1,3,4,14,13
PSHELL,1,1,.01,1,,1
PCOMP,2
,1,.005,0.,,2,.004,45.
CBAR,21,7,1,2,0.,0.,1.
CBAR,22,7,2,3,0.,0.,1.
PBARL,7,1,,BAR
,.1,.2
CBEAM,31,8,11,12,0.,0.,1.
PBEAM,8,2,1.-3,2.-6,3.-6,,4.-6
CELAS1,41,9,1,1,11,1
PELAS,9,1.+5
CONM2,51,4,,12.
MAT1,1,7.+10,,.33,2700.
MAT1,2,2.1+11,,.3,7850.
ENDDATA
"""
FIELDS = {
    "t": [CardField("PSHELL", 1, "T")],
    "E": [CardField("MAT1", 1, "E"), CardField("MAT1", 2, "E")],
    "nu": [CardField("MAT1", 2, "NU")],
    "ply": [CardField("PCOMP", 2, "T1")],
    "width": [CardField("PBARL", 7, "DIM1")],
    "beam": [CardField("PBEAM", 8, "A"), CardField("PBEAM", 8, "I1")],
    "spring": [CardField("PELAS", 9, "K")],
    "mass": [CardField("CONM2", 51, "M")],
}


@pytest.fixture(scope="module")
def some(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Together], int]:
    """All elements of the deck, and those alone on which the same parameters act."""
    path = tmp_path_factory.mktemp("deck") / "model.bdf"
    path.write_text(DECK.lstrip())
    model = rt.read_deck(path)
    every = [
        Parameter(name, tuple(targets), 0.5, 2.0) for name, targets in FIELDS.items()
    ]
    every.append(
        Parameter(
            "floor", (), 0.5, 2.0, substructures=(Substructure("stiffness", (1, 22)),)
        )
    )
    groups = [g for i, p in enumerate(every) for g in groups_of(model, i, p)]
    made: list[Region] = regions(groups, union(g.rows for g in groups))
    m = mesh(model)
    return [Together.of(m, made), *(Together.of(m, [r]) for r in made)], len(every)


def test_mass_that_a_list_shares_is_seen_at_each_point(tmp_path: Path) -> None:
    """Its card is no property of an element: nothing is copied."""
    path = tmp_path / "model.bdf"
    listed = DECK.replace("CEND\n", "CEND\nNSM = 5\n").replace(
        "ENDDATA", "NSM1,5,PSHELL,9.,1\nENDDATA"
    )
    path.write_text(listed.lstrip())
    m = mesh(rt.read_deck(path))
    every = (
        Parameter("t", (CardField("PSHELL", 1, "T"),), 0.5, 2.0),
        Parameter("list", (CardField("NSM1", 5, "VALUE"),), 0.5, 2.0),
    )
    groups = [g for i, p in enumerate(every) for g in groups_of(m.model, i, p)]
    (region,) = regions(groups, union(g.rows for g in groups))
    (found,) = Together.of(m, [region]).entries(
        [np.array([1.0, 1.0]), np.array([1.0, 2.0])]
    )
    # a quarter of a cell a node
    assert np.abs(found[1] - found[0]).max() > 0.1 * 9.0 / 4


@pytest.mark.parametrize("step", [0.0, 1e-30])
def test_copies_are_the_elements_at_each_point(
    some: tuple[list[Together], int], step: float
) -> None:
    every, parameters = some
    rng = np.random.default_rng(0)
    points: list[Any_] = list(np.exp(0.3 * rng.normal(size=(18, parameters))))
    points[3][:] = 1.0
    if step:
        points = [
            a + 1j * step * (np.arange(parameters) == k % 9)
            for k, a in enumerate(points)
        ]
    assert len(every) > 5
    for together in every:
        found = together.entries(points)
        for k, a in enumerate(points):
            for of_all, alone in zip(found, together.entries([a]), strict=True):
                assert of_all.shape == (len(points), alone.shape[1])
                near(of_all[k].real, alone[0].real)
                if step:
                    near(
                        of_all[k].imag / step, alone[0].imag / step, np.abs(alone).max()
                    )


def near(found: Any_, true: Any_, size: float = 0.0) -> None:
    """Equal but for rounding."""
    size = max(size, float(np.abs(true).max()))
    np.testing.assert_allclose(found, true, rtol=0, atol=1e-12 * size)
