"""Dimensions of PBARL and PBEAML as parameters: slopes of sections and matrices, values in model
and deck.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_slopes import matrix_derivatives
from scipy import sparse

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.writer import write_bulk
from ringtrue.errors import DeckError, InputError
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.model.edit import apply_factors, field_changes
from ringtrue.model.model import Model
from ringtrue.model.sections import FALLBACK, SECTIONS, section

DIMENSIONS = {  # of a possible section each
    "ROD": (2.0,), "TUBE": (2.0, 1.5), "TUBE2": (2.0, 0.3), "BAR": (2.0, 3.0), "BOX": (4.0, 3.0, 0.2, 0.3),
    "BOX1": (4.0, 3.0, 0.2, 0.3, 0.25, 0.35), "I": (5.0, 3.0, 2.0, 0.2, 0.3, 0.4), "I1": (2.0, 0.3, 4.0, 5.0),
    "H": (3.0, 1.0, 4.0, 0.3), "CROSS": (3.0, 0.5, 4.0, 0.4), "T": (3.0, 4.0, 0.3, 0.2), "T1": (4.0, 3.0, 0.3, 0.2),
    "T2": (3.0, 4.0, 0.3, 0.2), "CHAN": (2.0, 4.0, 0.2, 0.3), "CHAN1": (2.0, 0.2, 3.0, 4.0),
    "CHAN2": (0.2, 0.3, 3.0, 4.0), "L": (3.0, 4.0, 0.3, 0.2), "Z": (2.0, 0.3, 3.0, 4.0), "HAT": (3.0, 0.2, 2.0, 1.0),
    "HAT1": (5.0, 3.0, 2.0, 0.2, 0.3), "DBOX": (6.0, 3.0, 2.5, 0.1, 0.2, 0.15, 0.3, 0.25, 0.2, 0.1),
    "HEXA": (1.0, 4.0, 3.0),
}  # fmt: skip
DECK = """MAT1,1,2.+11,,.3,8000.
GRID,1,,0.,0.,0.,,123456
GRID,2,,1.,0.,0.
GRID,3,,2.,.3,0.
CBAR,1,3,1,2,0.,1.,0.
CBAR,2,3,2,3,0.,1.,0.
CBEAM,3,4,1,3,0.,0.,1.
CBEAM,4,5,2,3,0.,0.,1.
PBARL*,3,1,,BOX
*
*,.08,.05,4.-3,5.-3
*,2.5
PBEAML  4       1               CHAN                                    \r
        .06     .1      .004    .006    1.5\r
PBEAML,5,1,,I
,.1,.06,.05,.004,.006,.005,1.,YES
,1.,.08,.05,.04,.004,.006,.005,2.
"""
TARGETS = [
    ("PBARL", 3, "DIM1"), ("PBARL", 3, "DIM4"), ("PBARL", 3, "NSM"), ("PBEAML", 4, "DIM2"), ("PBEAML", 5, "DIM3"),
    ("PBEAML", 5, "DIMB1"), ("PBEAML", 5, "NSMB"),
]  # fmt: skip


@pytest.fixture
def model(tmp_path: Path) -> Model:
    (tmp_path / "a.bdf").write_bytes(DECK.encode())
    return read_deck(tmp_path / "a.bdf")


@pytest.mark.parametrize("kind", SECTIONS)
def test_a_complex_step_passes_through_each_section(kind: str) -> None:
    """Against central differences of fourth order; blank dimensions follow those that they are
    taken from.
    """
    dims = np.array(DIMENSIONS[kind])
    for blank in ([], list(FALLBACK.get(kind, {}))[-1:]):
        dims[blank] = np.nan
        for k in np.flatnonzero(dims == dims).tolist():
            step = np.eye(dims.size)[k]
            slope = {
                n: v.imag / 1e-40
                for n, v in section(kind, dims + 1e-40j * step).items()
                if np.iscomplexobj(v)
            }
            h = 1e-4 * dims[k]
            near = {j: section(kind, dims + j * h * step) for j in (-2, -1, 1, 2)}
            for name in near[1]:
                want = (
                    8 * (near[1][name] - near[-1][name])
                    - near[2][name]
                    + near[-2][name]
                ) / (12 * h)
                assert slope.get(name, 0.0) == pytest.approx(want, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("target", TARGETS)
def test_slopes_of_the_matrices(model: Model, target: tuple[str, int, str]) -> None:
    p, h = Parameter("p", (CardField(*target),)), 1e-3
    for which, slope in zip(
        ("stiffness", "mass"),
        matrix_derivatives(model, p, assemble(model)),
        strict=True,
    ):
        near = {
            j: getattr(assemble(scaled(model, p, 1 + j * h)), which)
            for j in (-2, -1, 1, 2)
        }
        want = sparse.csr_array(
            (8 * (near[1] - near[-1]) - near[2] + near[-2]) / (12 * h)
        )
        size = abs(getattr(assemble(model), which)).max()
        assert abs(slope - want).max() < 1e-9 * size
        assert abs(slope).max() > 1e-3 * size or (which == "stiffness") == target[
            2
        ].startswith("NSM")


def test_a_dimension_of_one_element(model: Model) -> None:
    whole, first = (
        Parameter("p", (CardField("PBARL", 3, "DIM1", elements=e),)) for e in ((), (1,))
    )
    s = assemble(model)
    own, both = (matrix_derivatives(model, p, s)[0].toarray() for p in (first, whole))
    second = matrix_derivatives(
        model, Parameter("p", (CardField("PBARL", 3, "DIM1", elements=(2,)),)), s
    )[0].toarray()
    np.testing.assert_allclose(own + second, both, atol=1e-9 * np.abs(both).max())
    assert np.abs(own - both).max() > 0.1 * np.abs(both).max()
    moved = (
        assemble(scaled(model, first, 1.001)).stiffness
        - assemble(scaled(model, first, 0.999)).stiffness
    )
    np.testing.assert_allclose(
        moved.toarray() / 0.002, own, atol=1e-5 * np.abs(own).max()
    )


def test_the_deck_holds_what_the_model_has(model: Model, tmp_path: Path) -> None:
    """Each value in its own field, all other bytes as they were; other solvers get the PBAR and
    PBEAM.
    """
    parameters = ParameterSet(
        tuple(Parameter(f"p{k}", (CardField(*t),)) for k, t in enumerate(TARGETS))
    )
    factors = np.linspace(1.02, 1.14, len(TARGETS))
    want = apply_factors(model, parameters, factors)
    (written,) = edit_fields(
        model, field_changes(model, parameters, factors), tmp_path / "new"
    )
    (tmp_path / "b.bdf").write_text(write_bulk(want))
    for found in (read_deck(written), read_deck(tmp_path / "b.bdf")):
        for card in ("PBAR", "PBEAM"):
            a, b = want[card], found[card]
            order = b.find(a.ids)
            for name in ("A", "I1", "I2", "J", "NSM"):
                np.testing.assert_allclose(b[name][order], a[name], rtol=1e-4)
    changed = [
        a != b
        for a, b in zip(
            DECK.splitlines(), written.read_bytes().decode().splitlines(), strict=True
        )
    ]
    assert [i for i, c in enumerate(changed) if c] == [10, 11, 13, 15, 16]
    assert written.read_bytes().count(b"\r\n") == 2


def test_what_dimensions_cannot_do(model: Model) -> None:
    with pytest.raises(InputError, match="PBARL 3 has no DIM5: it has 4 dimensions"):
        apply_factors(
            model,
            ParameterSet((Parameter("p", (CardField("PBARL", 3, "DIM5"),)),)),
            np.ones(1),
        )
    with pytest.raises(
        DeckError, match="PBARL 3: the dimensions do not make a section"
    ):
        scaled(model, Parameter("p", (CardField("PBARL", 3, "DIM4"),)), 20.0)
