"""Lists of non-structural mass: what they weigh, where it lies, and that it is what the field NSM
would be.

A plate of four quadrilaterals of 1 x 0.5, two triangles, bars, a beam and rods of known lengths.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from fem_slopes import matrix_derivatives

from ringtrue.core.parameters import CardField, Parameter, ParameterSet, Shape
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.writer import write_bulk
from ringtrue.errors import DeckError, InputError, RingtrueError, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.fem.parametrisation.derivatives import affine_terms
from ringtrue.model.edit import FieldChange, apply_factors
from ringtrue.model.model import Model
from ringtrue.solvers.runner import case_control

BULK = """BEGIN BULK
MAT1,1,2.+11,,.3
GRID,1,,0.,0.,0.
GRID,2,,2.,0.,0.
GRID,3,,2.,1.,0.
GRID,4,,0.,1.,0.
GRID,5,,4.,0.,0.
GRID,6,,4.,1.,0.
GRID,7,,3.,0.,0.
CQUAD4,11,1,1,2,3,4
CTRIA3,12,2,2,5,6
CTRIA3,13,1,2,6,3
CTRIA6,14,4,2,5,6,7
CBAR,21,5,1,2,0.,0.,1.
CBEAM,22,6,1,4,0.,0.,1.
CROD,23,7,4,3
CONROD,24,3,6,1,.1,,,2.
CTUBE,25,8,5,6
CBAR,26,5,4,1,0.,0.,1.
,,,0.,.5
PSHELL,1,1,.1,1,,1
PCOMP,2
,1,.1
PSHELL,4,1,.1,1,,1,,3.
PBAR,5,1,.1,.1,.1,.1
PBEAM,6,1,.1,.1,.1,,.1,4.
PROD,7,1,.1
PTUBE,8,1,.2,.1
"""
AREA = {11: 2.0, 12: 1.0, 13: 1.0, 14: 1.0}
LENGTH = {21: 2.0, 22: 1.0, 23: 2.0, 24: 2.0, 25: 1.0, 26: 1.5}
SIZE = AREA | LENGTH
OF_PROPERTY = {"PSHELL 1": (11, 13), "PBAR 5": (21, 26)}
BEFORE = 2.0 * LENGTH[24] + 3.0 * AREA[14] + 4.0 * LENGTH[22]  # NSM of the properties


def read(folder: Path, lists: str, nsm: int = 9, bulk: str = BULK) -> Model:
    (folder / "a.bdf").write_text(f"CEND\nNSM = {nsm}\n" + bulk + lists)
    return read_deck(folder / "a.bdf")


def weight(model: Model) -> float:
    system = assemble(model)
    x = system.rigid_body()[:, 0]
    return float(x @ system.mass @ x)


@pytest.mark.parametrize("coupled", [-1, 1])
@pytest.mark.parametrize(
    ("lists", "expected"),
    [
        ("NSM,9,PSHELL,1,2.,4,.5", 2.0 * 3 + 0.5),
        ("NSM,9,PCOMP,2,2.", 2.0),
        ("NSM,9,ELEMENT,11,1.,12,2.,21,3.\n,24,4.,25,5.", 2 + 2 + 6 + 8 + 5),
        ("NSM,9,PBARL,5,2.\nNSM,9,PBEAM,6,3.", 2 * (2 + LENGTH[26]) + 3),
        ("NSM1,9,PROD,1.5,7\nNSM1,9,CONROD,1.5,24\nNSM1,9,PTUBE,1.5,8", 3 + 3 + 1.5),
        ("NSM1,9,ELEMENT,2.,ALL", 2 * sum(SIZE.values())),
        ("NSM1,9,PSHELL,2.,ALL", 2 * 4),
        ("NSM1,9,ELEMENT,2.,11,THRU,14", 2 * 5),
        ("NSM1,9,ELEMENT,2.,11,THRU,25,BY,2", 2 * (2 + 1 + 2 + 2 + 1)),
        ("NSM1,9,ELEMENT,2.,11,13,11,21\n,THRU,22,24", 2 * (2 + 1 + 2 + 1 + 2)),
        ("NSM1,9,PSHELL,2.,1\nNSM1,9,ELEMENT,1.,11", 2 * 3 + 2),
        ("NSML,9,PSHELL,1,2.,4,.5", 2.5),
        ("NSML,9,ELEMENT,11,1.,21,3.", 4.0),
        ("NSML1,9,ELEMENT,7.,11,12,14", 7.0),
        ("NSML1,9,PBAR,7.,ALL\nNSML1,9,PSHELL,1.,ALL", 8.0),
        (
            "NSMADD,9,3,4\nNSM1,3,PSHELL,2.,1\nNSML1,4,ELEMENT,7.,21,22\nNSM1,9,PSHELL,100.,1\nNSM1,5,PSHELL,50.,1",
            13.0,
        ),
    ],
)
def test_weight(tmp_path: Path, lists: str, expected: float, coupled: int) -> None:
    model = read(tmp_path, f"{lists}\nPARAM,COUPMASS,{coupled}\n")
    assert weight(model) == pytest.approx(BEFORE + expected, rel=1e-12)
    (tmp_path / "b.bdf").write_text(
        "CEND\n" + "\n".join(case_control(model)) + "\nBEGIN BULK\n" + write_bulk(model)
    )
    assert weight(read_deck(tmp_path / "b.bdf")) == pytest.approx(
        BEFORE + expected, rel=1e-12
    )


def test_unchosen_lists_count_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.bdf").write_text(
        "CEND\n" + BULK + "NSM1,9,ELEMENT,2.,ALL\nNSMADD,7,9\n"
    )
    model = read_deck(tmp_path / "a.bdf")
    assert weight(model) == pytest.approx(BEFORE, rel=1e-12)
    assert dict(model.kept) == {"NSM1": 1, "NSMADD": 1}


def test_a_list_is_what_the_property_would_say(tmp_path: Path) -> None:
    plain = BULK.replace("PSHELL,1,1,.1,1,,1\n", "PSHELL,1,1,.1,1,,1,,6.\n").replace(
        ",.1,4.\n", ",.1,4.5\n"
    )
    want = assemble(
        read(tmp_path, "NSM1,9,ELEMENT,0.,ALL\n", bulk=plain)
    ).mass.toarray()
    got = assemble(
        read(tmp_path, "NSM1,9,PSHELL,6.,1\nNSML,9,PBEAML,6,.5\n")
    ).mass.toarray()
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-12 * want.max())


@pytest.mark.parametrize(
    ("lists", "error", "message"),
    [
        ("NSM1,8,PSHELL,2.,1", DeckError, "NSM = 9 in case control"),
        ("NSMADD,9,3,4\nNSM1,3,PSHELL,2.,1", DeckError, "has the number 4"),
        ("NSM1,9,PSHELL,2.,77", DeckError, "none of its PSHELL ids"),
        ("NSM1,9,PSHELL,2.,2", DeckError, "none of its PSHELL ids"),
        ("NSM1,9,ELEMENT,2.,77", DeckError, "none of its elements carries it"),
        ("NSML1,9,ELEMENT,2.,11,21", DeckError, "lines and areas together"),
        ("NSM1,9,ELSET,2.,11", UnsupportedCard, "TYPE ELSET"),
        ("NSML1,9,ELEMENT,2.,11\n,DISTR,VOLUME", UnsupportedCard, "DISTR"),
        ("NSM1,9,ELEMENT,2.", DeckError, "the list is empty"),
        ("NSM1,9,ELEMENT,2.,14,THRU,11", DeckError, "a THRU b BY c"),
    ],
)
def test_refused(
    tmp_path: Path, lists: str, error: type[RingtrueError], message: str
) -> None:
    with pytest.raises(error, match=message):
        assemble(read(tmp_path, lists + "\n"))


def test_case_control_must_name_a_number(tmp_path: Path) -> None:
    (tmp_path / "a.bdf").write_text("CEND\nNSM = ALL\n" + BULK)
    with pytest.raises(DeckError, match="NSM = ALL"):
        read_deck(tmp_path / "a.bdf")


def test_ids_that_are_not_there_are_passed_over_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert weight(read(tmp_path, "NSM1,9,PSHELL,2.,1,77\n")) == pytest.approx(
            BEFORE + 6, rel=1e-12
        )
    assert "[77]" in caplog.text


LISTS = "NSMADD,9,3,4\nNSML1,3,ELEMENT,7.,11,14\nNSM1,4,PBAR,2.,5\n"


@pytest.mark.parametrize(
    "parameter",
    [
        Parameter("mass", (CardField("NSML1", 3, "VALUE"),)),
        Parameter("mass a length", (CardField("NSM1", 4, "VALUE"),)),
        Parameter("shape", shapes=(Shape((1, 4), ((1.0, 0.2, 0.0), (0.5, 0.0, 0.1))),)),
        Parameter("offset", (CardField("CBAR", 26, "W1A"),)),
    ],
    ids=lambda p: p.name,
)
def test_derivatives(tmp_path: Path, parameter: Parameter) -> None:
    """A node that moves changes the share of all elements of a whole mass."""
    bulk = BULK.replace(",,,0.,.5", ",,,.2,.5")
    model = read(
        tmp_path, LISTS + "NSML1,3,PBAR,5.,5\n" * (parameter.name != "mass"), bulk=bulk
    )
    got = matrix_derivatives(model, parameter, assemble(model))[1].toarray()
    h = 1e-5
    up, down = (
        assemble(scaled(model, parameter, 1 + s * h)).mass.toarray() for s in (1, -1)
    )
    np.testing.assert_allclose(got, (up - down) / (2 * h), atol=1e-8 * up.max())
    assert np.abs(got).max() > 1e-3 * up.max()
    if parameter.name == "mass":
        (term,) = affine_terms(model, ParameterSet((parameter,)), assemble(model))
        np.testing.assert_allclose(term.mass.toarray(), got, atol=1e-12 * up.max())


def test_a_value_is_edited_in_its_place(tmp_path: Path) -> None:
    model = read(tmp_path, LISTS)
    parameters = ParameterSet((Parameter("mass", (CardField("NSML1", 3, "VALUE"),)),))
    assert weight(apply_factors(model, parameters, np.array([2.0]))) == pytest.approx(
        weight(model) + 7, rel=1e-12
    )
    edit_fields(model, [FieldChange("NSML1", 3, "VALUE", 9.5)], tmp_path / "new")
    assert (
        (tmp_path / "new/a.bdf").read_text().endswith(LISTS.replace("7.,11", "9.5,11"))
    )
    both = read(tmp_path, LISTS + "NSML1,3,PBAR,5.,5\n")
    with pytest.raises(InputError, match="has several values"):
        apply_factors(both, parameters, np.array([2.0]))
