"""Which of E, G and NU of a MAT1 an element uses where the three do not agree (MAT1, table of
usage).
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, shells, square, steel, triangles
from solid_meshes import ELEMENTS, box, cut, elements, kind, psolid

from ringtrue.core.arrays import Float
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import Model

AGREES = 2e11 / 2.6  # E / (2 (1 + ν)) of `steel`
EXACT = 1e-12  # of the largest entry


def _stiffness(m: Model) -> Float:
    return np.asarray(assemble(m).stiffness.toarray())


def _plate(make: object, G: float = np.nan, **section: int) -> Float:
    assert callable(make)
    xyz, quads = square(2, 1.0, 1.0)
    shell = cards("PSHELL", PID=[1], T=0.1, MID1=1, MID2=1, **section)
    return _stiffness(model(grid(xyz), make(quads), shell, steel(G=G)))


@pytest.mark.parametrize("make", [shells, triangles])
def test_membranes_and_bending_use_young_and_poisson(make: object) -> None:
    want = _plate(make)
    np.testing.assert_allclose(
        _plate(make, AGREES / 2), want, atol=EXACT * np.abs(want).max()
    )


def test_transverse_shear_uses_the_shear_modulus() -> None:
    want = _plate(shells, MID3=1)
    np.testing.assert_allclose(
        _plate(shells, AGREES, MID3=1), want, atol=EXACT * np.abs(want).max()
    )
    assert (
        np.abs(_plate(shells, AGREES / 2, MID3=1) - want).max()
        > 0.03 * np.abs(want).max()
    )


@pytest.mark.parametrize("name", ELEMENTS)
def test_solids_use_young_and_poisson(name: str) -> None:
    """So that an isotropic solid does not depend on the frame that it stands in."""
    xyz, nodes = cut(name, *box(1, 1, 1, (1.0, 2.0, 3.0)))
    made = [
        model(grid(xyz), elements(kind(name)[0], nodes), psolid(), steel(G=G))
        for G in (np.nan, 0.0, AGREES / 2)
    ]
    want, *others = (_stiffness(m) for m in made)
    for found in others:
        np.testing.assert_allclose(found, want, atol=EXACT * np.abs(want).max())
