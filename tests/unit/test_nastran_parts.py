"""Decks whose superelements have bulk data of their own.

A cantilever of four CBARs in the xy plane, whole or divided at its middle point 3: part 1 holds
points 3, 4, 5, part 2 points 1, 2, 3 and the support.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck, read_loaded_deck, survey
from ringtrue.errors import DeckError, UnsupportedCard, UnsupportedError
from ringtrue.fem.element_cards import mesh
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.edit import FieldChange
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.loads import load_vectors

PROPERTIES = "PBAR,7,1,.01,1.-5,1.-5,2.-5\nMAT1,1,7.+10,,.3,2700.\nGRDSET,,,,,,,1345\n"
CASE = "SOL 103\nCEND\nSPC = 1\nLOAD = 4\n"


def points(first: int, last: int, shift: int = 0) -> str:
    return "".join(f"GRID,{i + shift},,{i}.,0.,0.\n" for i in range(first, last + 1))


def bars(first: int, last: int, shift: int = 0) -> str:
    ends = [(i, i + shift, i + shift + 1) for i in range(first, last + 1)]
    return "".join(f"CBAR,{i},7,{a},{b},0.,1.,0.\n" for i, a, b in ends)


WHOLE = (
    CASE + "BEGIN BULK\n" + PROPERTIES + points(1, 5) + bars(1, 4) + "SPC1,1,123456,1\n"
)
TIP = (
    PROPERTIES
    + points(3, 5)
    + bars(1, 2).replace(",1,2,", ",3,4,").replace(",2,3,", ",4,5,")
)
ROOT = PROPERTIES + points(1, 3) + bars(1, 2) + "SPC1,1,123456,1\n"
PARTS = (
    CASE
    + "BEGIN BULK\nGRID,3,,3.,0.,0.\nBEGIN SUPER=1\n"
    + TIP
    + "BEGIN SUPER=2\n"
    + ROOT
)


def read(folder: Path, text: str) -> Model:
    path = folder / "parts.bdf"
    path.write_text(text)
    return read_deck(path)


def frequencies(model: Model) -> np.ndarray:
    with EmbeddedSolver().open(model) as analysis:
        return analysis.modes(ModesRequest(4)).modes.frequencies


def test_parts_without_condensation_are_the_whole(tmp_path: Path) -> None:
    whole = frequencies(read(tmp_path, WHOLE))
    model = read(tmp_path, PARTS)
    np.testing.assert_allclose(frequencies(whole_mesh(model)), whole, rtol=1e-10)
    assert frequencies(model)[0] > 1.001 * whole[0]  # Guyan's first mode is too high
    assert model["GRID"].ids.tolist() == [3, 4, 5, 1, 2]
    assert model["GRID"]["SEID"].tolist() == [0, 1, 1, 2, 2]


def test_parts_are_joined_to_each_other_and_listed_ones_are_the_same(
    tmp_path: Path,
) -> None:
    """Without a point of the residual structure, and with SEID of GRID in one bulk data section."""
    model = read(tmp_path, PARTS.replace("GRID,3,,3.,0.,0.\n", "", 1))
    assert model["GRID"]["SEID"].tolist() == [0, 1, 1, 2, 2]
    listed = WHOLE
    for point, number in ((1, 2), (2, 2), (4, 1), (5, 1)):
        line = f"GRID,{point},,{point}.,0.,0."
        listed = listed.replace(line, f"{line},,,{number}")
    condensed = frequencies(read(tmp_path, listed))
    assert condensed.size == 2
    np.testing.assert_allclose(frequencies(model), condensed, rtol=1e-10)


def test_case_control_chooses_sets_for_each_superelement(tmp_path: Path) -> None:
    cases = (
        "SUBCASE 1\nSUPER = 2\nSPC = 1\nSUBCASE 2\nSET 7 = 0, 1\nSUPER = 7\nBEGIN BULK"
    )
    text = PARTS.replace("SPC = 1\n", "").replace("BEGIN BULK", cases, 1)
    text = text.replace("BEGIN SUPER=2", "begin bulk super = 2")
    whole = frequencies(read(tmp_path, WHOLE))
    np.testing.assert_allclose(
        frequencies(whole_mesh(read(tmp_path, text))), whole, rtol=1e-10
    )


def test_numbers_that_two_parts_have_get_that_of_their_superelement(
    tmp_path: Path,
) -> None:
    model = read(tmp_path, PARTS)
    assert sorted(model["CBAR"].ids.tolist()) == [1, 2, 2001, 2002]
    assert model["PBAR"].ids.tolist() == [7, 2007]
    assert dict(zip(model["CBAR"].ids, model["CBAR"]["PID"], strict=True))[2002] == 2007
    assert model["PBAR"]["MID"].tolist() == [1, 2001]
    assert [s.elements.tolist() for s in model.superelements] == [[1, 2], [2001, 2002]]


def test_points_that_two_parts_number_alike_stay_apart(tmp_path: Path) -> None:
    """Part 1 numbers its points 1 to 3 from the middle on, as part 2 numbers its own."""
    tip = PROPERTIES + points(3, 5, shift=-2) + bars(1, 2)
    text = PARTS.replace(TIP, tip)
    joints = "SEBULK,1,PRIMARY,,MANUAL\nSECONCT,1,0\n,1,3\nSEBULK,2,,,MANUAL\nSECONCT,2\n,3,3\n"
    model = read(tmp_path, text.replace("GRID,3,,3.", joints + "GRID,3,,3."))
    assert model["GRID"].ids.tolist() == [3, 1002, 1003, 1, 2]
    np.testing.assert_allclose(
        frequencies(whole_mesh(model)), frequencies(read(tmp_path, WHOLE)), rtol=1e-10
    )


GRAV = "GRAV,4,,9.81,0.,-1.,0.\n"
FORCE = "FORCE,4,5,,3.,0.,1.,0.\n"


@pytest.mark.parametrize(("load", "parts"), [(FORCE, (1,)), (GRAV, (1, 2))])
def test_loads_stand_in_the_bulk_data_of_parts(
    tmp_path: Path, load: str, parts: tuple[int, ...]
) -> None:
    moved = []
    divided = PARTS
    for number in parts:
        begin = f"BEGIN SUPER={number}\n"
        divided = divided.replace(begin, begin + load)
    for text in (WHOLE + load, divided):
        path = tmp_path / "loaded.bdf"
        path.write_text(text)
        model, cases = read_loaded_deck(path)
        with EmbeddedSolver().open(model) as analysis:
            found = analysis.static(load_vectors(model, mesh(model).dofs, cases))
            moved.append(found[analysis.dofs.find(np.array([4, 5]), np.array([2, 2]))])
    np.testing.assert_allclose(moved[1], moved[0], rtol=1e-10)
    assert (moved[0] != 0).all()


def test_gravity_on_some_parts_alone_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "loaded.bdf"
    path.write_text(PARTS.replace("BEGIN SUPER=2\n", "BEGIN SUPER=2\n" + GRAV))
    with pytest.raises(DeckError, match="GRAV acts on some parts only"):
        read_loaded_deck(path)


def test_a_field_of_a_part_is_edited_in_place(tmp_path: Path) -> None:
    text = PARTS.replace(
        "MAT1,1,7.+10,,.3,2700.\nGRDSET,,,,,,,1345\nGRID,1",
        "MAT1,1,7.+10,,.3,2800.\nGRDSET,,,,,,,1345\nGRID,1",
    )
    model = read(tmp_path, text)
    out = tmp_path / "out"
    edit_fields(model, [FieldChange("MAT1", 2001, "RHO", 2900.0)], out)
    assert (out / "parts.bdf").read_text() == text.replace("2800.", "2900.0")


def test_the_modulus_of_a_part_is_a_parameter_of_the_whole_mesh(tmp_path: Path) -> None:
    model = read(tmp_path, PARTS)
    root = rt.ParameterSet([rt.parameter("root", "MAT1 2001 E")])
    twin = rt.solve_modes(whole_mesh(rt.at_factors(model, root, [0.7])), count=3)
    found = rt.update(model, twin.at(["2+Y", "4+Y", "5+Y"]), root)
    np.testing.assert_allclose(found.factors, 0.7, rtol=1e-6)
    with (
        EmbeddedSolver().open(model) as analysis,
        pytest.raises(UnsupportedError, match="whole"),
    ):
        analysis.derivatives(analysis.modes(ModesRequest(2)).modes, root)


def test_component_modes_follow_the_case_control_of_their_superelement(
    tmp_path: Path,
) -> None:
    """Two coordinates, of which METHOD of part 1 asks for one mode, and up to 1 Hz for none."""
    modal = "QSET1,0,101,102\nSPOINT,101,102\nEIGRL,10,,{high},{count}\n"
    for count, high, taken in ((1, "", 1), (5, "", 2), (5, "1.", 0)):
        case = (
            CASE
            + "METHOD = 1\nSUBCASE 1\nSUPER = 1\nMETHOD = 10\nSUBCASE 2\nMETHOD = 1\n"
        )
        part = TIP + modal.format(high=high, count=count)
        text = (
            PARTS.replace(CASE, case)
            .replace(TIP, part)
            .replace("GRID,3,,3.", "EIGRL,1,,,9\nGRID,3,,3.")
        )
        with EmbeddedSolver().open(read(tmp_path, text)) as analysis:
            free = analysis.system.free
        assert free.labels() == ("3+Y", "3+RZ", "101", "102")[: 2 + taken]


def test_pairs_and_ranges_of_points_are_joined(tmp_path: Path) -> None:
    """As EXTSEOUT writes them: pairs of boundary points, then ranges of modal coordinates."""
    joints = "SECONCT,1,0\n,3,3,11,13\n,101,THRU,103,201,THRU,203\n"
    table = read(
        tmp_path, "BEGIN BULK\n" + PROPERTIES + points(1, 2) + bars(1, 1) + joints
    )["SECONCT"]
    assert table.ragged("GIDA").row(0).tolist() == [3, 11, 101, 102, 103]
    assert table.ragged("GIDB").row(0).tolist() == [3, 13, 201, 202, 203]
    with pytest.raises(DeckError, match="3 points are joined to 2"):
        read(tmp_path, "BEGIN BULK\n" + joints.replace("203", "202"))


@pytest.mark.parametrize(
    ("old", "new", "error", "told"),
    [
        (
            "GRID,3,,3.",
            "SEBULK,1,OTHER\nGRID,3,,3.",
            UnsupportedCard,
            "PRIMARY, EXTERNAL, EXTOP4",
        ),
        (
            "GRID,3,,3.",
            "SEBULK,9,MIRROR,1\nGRID,3,,3.",
            UnsupportedCard,
            "copies are not made",
        ),
        (
            "GRID,3,,3.",
            "SEBULK,9,EXTOP2\nGRID,3,,3.",
            UnsupportedCard,
            "EXTSEOUT with MATOP4=n",
        ),
        (
            "GRID,3,,3.",
            "SELOC,1,3,4,5,3,4,5\nGRID,3,,3.",
            UnsupportedCard,
            "moved to its place",
        ),
        (
            "GRID,3,,3.",
            "SEMPLN,1,PLANE,3,4,5\nGRID,3,,3.",
            UnsupportedCard,
            "mirrored points",
        ),
        (
            "GRID,3,,3.",
            "CSUPER,1,0,3\nGRID,3,,3.",
            UnsupportedCard,
            "MATOP4 or DMIGPCH",
        ),
        ("GRID,3,,3.", "SEBULK,5\nGRID,3,,3.", UnsupportedCard, "no BEGIN SUPER=5"),
        (
            "GRID,3,,3.",
            "SECONCT,1,0\n,4,9\nGRID,3,,3.",
            DeckError,
            "superelement 0 has no point 9",
        ),
        ("GRID,3,,3.", "SECONCT,7,0\n,4,3\nGRID,3,,3.", DeckError, "no superelement 7"),
        (
            "GRID,3,,3.",
            "SECONCT,1,0\n,4,3\nGRID,3,,3.",
            DeckError,
            "joined to the same point",
        ),
        (
            "GRID,3,,3.",
            "SEBULK,1,,,MANUAL\nSECONCT,1,0\n,3,3\nGRID,3,,3.5",
            DeckError,
            "that lies 0.5 away",
        ),
        (
            "BEGIN SUPER=2",
            "PARAM,WTMASS,2.\nBEGIN SUPER=2",
            DeckError,
            "PARAM,WTMASS is 2 in",
        ),
        ("BEGIN SUPER=2", "ASET1,26,5\nBEGIN SUPER=2", DeckError, "join it by SECONCT"),
        ("BEGIN SUPER=2", "BEGIN SUPER=1", DeckError, "superelement 1 begins twice"),
    ],
)
def test_what_cannot_be_joined_is_refused(
    tmp_path: Path, old: str, new: str, error: type[Exception], told: str
) -> None:
    text = PARTS.replace(old, new, 1)
    if "MANUAL" not in new and "SECONCT,1" in new:
        text = text.replace("SECONCT", "SEBULK,1,,,MANUAL\nSECONCT,1\n,3,3\nSECONCT", 1)
    with pytest.raises(error, match=told):
        read(tmp_path, text)


def test_a_check_counts_the_cards_of_all_parts(tmp_path: Path) -> None:
    path = tmp_path / "parts.bdf"
    path.write_text(PARTS)
    found = survey(path)
    assert (found.cards["CBAR"], found.unsupported, found.faults) == (4, {}, ())
