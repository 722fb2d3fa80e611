"""Decks edited in place: the wanted characters change, all other bytes stay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.editor import add_cards, edit_fields, unified_diff
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import DeckError, InputError
from ringtrue.model.edit import (
    FieldChange,
    apply_factors,
    field_changes,
    resolve_target,
)

MAIN = (
    b"$ \xe4\xff bytes of no encoding\r\nBEGIN BULK\r\nINCLUDE 'props/p.bdf'\r\n"
    b"GRID           1              0.      0.      0.\r\nGRID,2,,1.,0.,0. $ two\r\nENDDATA "
    b"tail\r\n"
)
PROPS = (
    b"PBAR           1       1     0.1    0.01    0.02   0.001      5.        comment?\n"
    b"              .1      .1\n"
    b"PBAR*   2               1               0.1             0.01            *\n"
    b"*       0.02            0.001\n"
    b"pbar,3,1,  .1 ,.01,,.001$ free\n"
    b"PBAR\t4\t1\t0.1\t0.01\t\t.001\t$ tabs\n"
    b"MAT1           1  2.1+11              .3   7850.$ no blank before\n"
    b"MAT1    2       2.1+11          .3      7850.   \n"
    b"PBUSH          5       K    1.+61.234567      3.\n"
    b"PBUSH          6       B     .12"
)


@pytest.fixture
def main(tmp_path: Path) -> Path:
    (tmp_path / "deck/props").mkdir(parents=True)
    (tmp_path / "deck/props/p.bdf").write_bytes(PROPS)
    path = tmp_path / "deck/main.bdf"
    path.write_bytes(MAIN)
    return path


def edited(main: Path, *changes: FieldChange) -> tuple[bytes, bytes]:
    """Bytes of main and of the include after the changes; and the values are read back."""
    written = edit_fields(read_deck(main), changes, main.parents[1] / "new")
    again = read_deck(written[0])
    for c in changes:
        got = again[c.card][c.field][resolve_target(again, c)[0]]
        np.testing.assert_allclose(
            got, c.value, rtol=5e-4
        )  # eight characters hold four digits of such numbers
    return written[0].read_bytes(), written[1].read_bytes()


@pytest.mark.parametrize(
    ("change", "old", "new"),
    [
        (
            FieldChange("PBAR", 1, "A", 0.123456789),
            b"       1     0.1    0.01",
            b"       1.1234568    0.01",
        ),
        (
            FieldChange("PBAR", 1, "C2", -1.23456789e-5),
            b".1      .1\n",
            b".1-1.235-5\n",
        ),
        (FieldChange("PBAR", 1, "D1", 2.5), b".1      .1\n", b".1      .1     2.5\n"),
        (
            FieldChange("PBAR", 1, "K1", 0.5),
            b".1      .1\n",
            b".1      .1\n+            0.5\n",
        ),
        (
            FieldChange("PBAR", 2, "I1", 0.0123456789012),
            b" 0.01            *",
            b" 0.0123456789012 *",
        ),
        (
            FieldChange("PBAR", 2, "NSM", 3.0),
            b"0.001\npbar",
            b"0.001" + 24 * b" " + b"3.0\npbar",
        ),
        (FieldChange("PBAR", 3, "A", 7.5), b"  .1 ,.01", b"  7.5 ,.01"),
        (FieldChange("PBAR", 3, "I2", 1 / 3), b".01,,.001", b".01,.3333333,.001"),
        (FieldChange("PBAR", 3, "NSM", 4.0), b".001$ free", b".001,4.0$ free"),
        (FieldChange("PBAR", 3, "C1", 4.0), b".001$ free\n", b".001$ free\n+,4.0\n"),
        (FieldChange("PBAR", 4, "A", 12345.678), b"\t0.1\t0.01", b"\t12345.680.01"),
        (FieldChange("PBAR", 4, "I2", 0.25), b"0.01\t\t.001", b"0.01\t    0.25.001"),
        (FieldChange("MAT1", 1, "E", 2.0654321e11), b"1  2.1+11", b"1206.54+9"),
        (FieldChange("MAT1", 1, "A", 1.2e-5), b"7850.$ no", b"7850.0.000012$ no"),
        (FieldChange("MAT1", 2, "E", 7e10), b"2       2.1+11  ", b"2       7.+10   "),
        (
            FieldChange("MAT1", 2, "G", 8e10),
            b"2.1+11          .3",
            b"2.1+11     8.+10.3",
        ),
        (FieldChange("PBUSH", 5, "K2", 8.0), b"1.234567      3.", b"     8.0      3."),
        (FieldChange("PBUSH", 6, "B2", 8.0), b"     .12", b"     .12     8.0"),
        (
            FieldChange("PBUSH", 6, "K1", 8.0),
            b"     .12",
            b"     .12\n+                      K     8.0\n",
        ),
        (
            FieldChange("PBUSH", 5, "GE", 0.5),
            b"      3.\n",
            b"      3.\n+                     GE     0.5\n",
        ),
    ],
    ids=lambda v: f"{v.card}{v.id}.{v.field}" if isinstance(v, FieldChange) else "",
)
def test_one_field_changes_and_nothing_else(
    main: Path, change: FieldChange, old: bytes, new: bytes
) -> None:
    assert PROPS.count(old) == 1
    assert edited(main, change) == (MAIN, PROPS.replace(old, new))


@pytest.mark.parametrize(
    "card", ["PBUSH,7,K,5.", "PBUSH*                 7               K              5."]
)
def test_damping_gets_lines_of_its_own_on_a_spring(tmp_path: Path, card: str) -> None:
    path = tmp_path / "deck.bdf"
    path.write_text(f"BEGIN BULK\n{card}\n")
    changes = [FieldChange("PBUSH", 7, "GE", 0.1), FieldChange("PBUSH", 7, "B3", 2.0)]
    bush = read_deck(edit_fields(read_deck(path), changes, tmp_path / "new")[0])[
        "PBUSH"
    ]
    assert [bush[f][0] for f in ("K1", "GE", "B1", "B3")] == [5.0, 0.1, 0.0, 2.0]


def test_no_change_is_a_copy(main: Path) -> None:
    assert edited(main) == (MAIN, PROPS)


def test_several_changes_of_a_card_and_its_new_line(main: Path) -> None:
    _, props = edited(
        main, *(FieldChange("MAT1", 2, f, 2.5) for f in ("E", "GE", "SS", "ST"))
    )
    assert props.startswith(PROPS[: PROPS.index(b"MAT1    2")])
    assert props.count(b"\n") == PROPS.count(b"\n") + 1


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            FieldChange("MAT1", 9, "E", 1.0),
            InputError,
            "MAT1 9 is not in the model; did you mean",
        ),
        (FieldChange("MAT1", 1, "RO", 1.0), InputError, "did you mean 'RHO'"),
        (FieldChange("PBAR", 1, "A", float("nan")), InputError, "nan cannot stand"),
        (FieldChange("PBAR", 1, "MID", 1.5), InputError, "must be an integer"),
        (FieldChange("GRID", 1, "CP", 123456789), InputError, "does not fit"),
    ],
)
def test_changes_that_cannot_be_made_write_nothing(
    main: Path, change: FieldChange, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        edit_fields(
            read_deck(main),
            [FieldChange("MAT1", 2, "E", 1.0), change],
            main.parents[1] / "new",
        )
    assert not (main.parents[1] / "new").exists()


def test_a_section_card_is_not_edited_as_the_property_it_makes(tmp_path: Path) -> None:
    (tmp_path / "a.bdf").write_text("MAT1,1,1.,,.3\nPBARL,1,1,,ROD\n,2.\n")
    with pytest.raises(DeckError, match="it was made from a PBARL"):
        edit_fields(
            read_deck(tmp_path / "a.bdf"),
            [FieldChange("PBAR", 1, "A", 1.0)],
            tmp_path / "new",
        )


def test_a_uniform_beam_stays_uniform(tmp_path: Path) -> None:
    text = "MAT1,1,1.,,.3\nPBEAM,1,1,4.,1.,2.\nPBEAM,2,1,4.,1.,2.\n,\n,NO,1.,4.\nPBEAM,3,1,4.,1.,2.\n,\n,NO,1.,3.\n"
    (tmp_path / "a.bdf").write_text(text)
    model = read_deck(tmp_path / "a.bdf")
    parameters = ParameterSet(
        (Parameter("area", tuple(CardField("PBEAM", i, "A") for i in (1, 2, 3))),)
    )
    changed = apply_factors(model, parameters, np.array([1.5]))
    assert changed["PBEAM"]["AB"].tolist() == [6.0, 6.0, 3.0]
    written = edit_fields(
        model, field_changes(model, parameters, np.array([1.5])), tmp_path / "new"
    )
    again = read_deck(written[0])
    for name in ("A", "AB"):
        np.testing.assert_array_equal(again["PBEAM"][name], changed["PBEAM"][name])


def test_inertia_and_eccentricity_of_end_b_follow_those_of_end_a(
    tmp_path: Path,
) -> None:
    """A blank NSI(B), M1(B) or N1(B) is that of end A, in the model at other factors as in the
    deck.
    """
    lines = "PBEAM,1,1,4.,1.,2.\n,\n,NO,1.\n,,,,,3.,,,\n,.1,,,,.2\n"
    (tmp_path / "a.bdf").write_text(f"MAT1,1,1.,,.3\n{lines}")
    model = read_deck(tmp_path / "a.bdf")
    fields = ("NSIA", "M1A", "N1A")
    parameters = ParameterSet(
        tuple(Parameter(f, (CardField("PBEAM", 1, f),)) for f in fields)
    )
    factors = np.array([1.5, 2.0, 3.0])
    changed = apply_factors(model, parameters, factors)
    written = edit_fields(
        model, field_changes(model, parameters, factors), tmp_path / "new"
    )
    again = read_deck(written[0])["PBEAM"]
    for a, value in zip(fields, (4.5, 0.2, 0.6), strict=True):
        for name in (a, a[:-1] + "B"):
            assert again[name][0] == pytest.approx(value)
            assert changed["PBEAM"][name][0] == pytest.approx(value)


def test_a_field_that_names_a_frame_or_node_is_no_angle_or_component(
    tmp_path: Path,
) -> None:
    grids = "".join(
        f"GRID,{i + 1},,{x}.,{y}.,0.\n"
        for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)])
    )
    elements = "CQUAD4,1,1,1,2,3,4,5\nCBAR,2,2,1,2,4\nCQUAD4,3,1,1,2,3,4,30.\n"
    rest = "CORD2R,5,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nPSHELL,1,1,.1\nPBAR,2,1,1.,1.,1.\nMAT1,1,1.,,.3\n"
    (tmp_path / "a.bdf").write_text(grids + elements + rest)
    model = read_deck(tmp_path / "a.bdf")
    for change, told in (
        (FieldChange("CQUAD4", 1, "THETA", 9.0), "MCID 5"),
        (FieldChange("CBAR", 2, "X1", 1.0), "G0 4"),
    ):
        with pytest.raises(
            InputError,
            match=f"has no {change.field}: it stands where the card names {told}",
        ):
            edit_fields(model, [change], tmp_path / "new")
    again = read_deck(
        edit_fields(model, [FieldChange("CQUAD4", 3, "THETA", 9.0)], tmp_path / "new")[
            0
        ]
    )
    assert again["CQUAD4"]["THETA"].tolist() == [0.0, 9.0]


def test_the_edited_deck_is_the_model_with_the_factors(main: Path) -> None:
    model = read_deck(main)
    stiffness = Parameter(
        "stiffness", (CardField("MAT1", 1, "E"), CardField("PBUSH", 5, "K1"))
    )
    area = Parameter(
        "area", (CardField("PBAR", 1, "A"), CardField("MAT1", 1, "E")), scale="linear"
    )
    parameters, factors = ParameterSet((stiffness, area)), np.array([1.1, 0.9])
    changed = apply_factors(model, parameters, factors)
    assert changed["MAT1"]["E"][0] == pytest.approx(2.1e11 * 0.99, rel=1e-15)
    written = edit_fields(
        model, field_changes(model, parameters, factors), main.parents[1] / "new"
    )
    again = read_deck(written[0])
    for card, name in (("MAT1", "E"), ("PBUSH", "K1"), ("PBAR", "A")):
        np.testing.assert_allclose(again[card][name], changed[card][name], rtol=1e-5)


@pytest.mark.parametrize(
    ("field", "message"),
    [("I12T3X", "no field"), ("G", "is blank"), ("MCSID", "no real quantity")],
)
def test_targets_that_hold_no_number(main: Path, field: str, message: str) -> None:
    parameters = ParameterSet((Parameter("p", (CardField("MAT1", 1, field),)),))
    with pytest.raises(InputError, match=message):
        apply_factors(read_deck(main), parameters, np.array([1.1]))


def test_cards_are_added_before_enddata_with_the_files_line_ends(main: Path) -> None:
    new = main.parents[1] / "new"
    written = add_cards(
        read_deck(main), "main.bdf", "GRID,7,,7.,0.,0.\nGRID,8,,8.,0.,0.\n", new
    )
    assert written[0].read_bytes() == MAIN.replace(
        b"ENDDATA", b"GRID,7,,7.,0.,0.\r\nGRID,8,,8.,0.,0.\r\nENDDATA"
    )
    assert written[1].read_bytes() == PROPS
    assert read_deck(new / "main.bdf")["GRID"].ids.tolist() == [1, 2, 7, 8]
    written = add_cards(
        read_deck(main), main.parent / "props/p.bdf", "MAT1,7,1.,,.3", new
    )
    assert written[1].read_bytes() == PROPS + b"\nMAT1,7,1.,,.3\n"
    with pytest.raises(InputError, match="is not a file of the deck"):
        add_cards(read_deck(main), "other.bdf", "", new)


def test_the_difference_is_shown(main: Path) -> None:
    model = read_deck(main)
    shown = unified_diff(
        model.files,
        add_cards(model, main, "GRID,7,,7.,0.,0.\n", main.parents[1] / "new"),
    )
    assert [x for x in shown.splitlines() if x[:1] in "+-"] == [
        "--- main.bdf",
        "+++ main.bdf",
        "+GRID,7,,7.,0.,0.",
    ]
    assert unified_diff(model.files, model.files) == ""


def test_includes_above_the_main_folder_keep_their_layout(tmp_path: Path) -> None:
    (tmp_path / "a/runs").mkdir(parents=True)
    (tmp_path / "a/common.bdf").write_text("MAT1,1,1.,,.3\n")
    (tmp_path / "a/runs/main.bdf").write_text("INCLUDE '../common.bdf'\n")
    model = read_deck(tmp_path / "a/runs/main.bdf")
    written = edit_fields(model, [FieldChange("MAT1", 1, "E", 2.0)], tmp_path / "new")
    assert written == [tmp_path / "new/runs/main.bdf", tmp_path / "new/common.bdf"]
    assert read_deck(written[0])["MAT1"]["E"][0] == 2.0


def test_an_absolute_include_would_miss_the_change(tmp_path: Path) -> None:
    (tmp_path / "common.bdf").write_text("MAT1,1,1.,,.3\n")
    (tmp_path / "main.bdf").write_text(f"INCLUDE '{tmp_path}/common.bdf'\n")
    with pytest.raises(DeckError, match="make the path of that INCLUDE relative"):
        edit_fields(
            read_deck(tmp_path / "main.bdf"),
            [FieldChange("MAT1", 1, "E", 2.0)],
            tmp_path / "new",
        )


LAMINATE = b"PCOMP   1       -.2                                             SYM     comment\r\n"
PLIES = (
    b"        8       .125    45.             8       .125    -45.\r\n"
    + b"+,8,,0.,NO,,.3,9.$\r\n"
)
MAT8 = b"MAT8           8  1.4+11    9.+9      .3    5.+9\r\n"


@pytest.mark.parametrize(
    ("changes", "new"),
    [
        (
            [("T1", 0.1375)],
            PLIES.replace(b"8       .125    45.", b"8       0.1375  45."),
        ),
        ([("THETA2", 31.5)], PLIES.replace(b"-45.", b"    31.5")),
        ([("T4", 0.4), ("THETA4", 10.0)], PLIES.replace(b".3,9.", b"0.4,10.0")),
        # the third ply has no T of its own: it keeps that of the second
        (
            [("T2", 0.2)],
            PLIES.replace(b".125    -45.", b"0.2     -45.").replace(
                b"8,,0.", b"8,0.125,0."
            ),
        ),
    ],
    ids=str,
)
def test_plies_are_edited_one_by_one(
    tmp_path: Path, changes: list[tuple[str, float]], new: bytes
) -> None:
    path = tmp_path / "a.bdf"
    path.write_bytes(LAMINATE + PLIES + MAT8)
    old = read_deck(path)
    written = edit_fields(
        old, [FieldChange("PCOMP", 1, f, v) for f, v in changes], tmp_path / "new"
    )
    assert written[0].read_bytes() == LAMINATE + new + MAT8
    again = read_deck(written[0])
    for name in ("T", "THETA"):
        want = old["PCOMP"].ragged(name).row(0).copy()
        for f, v in changes:
            if f[:-1] == name:
                want[int(f[-1]) - 1] = v
        np.testing.assert_array_equal(again["PCOMP"].ragged(name).row(0), want)


def test_factors_on_plies_and_orthotropic_moduli(tmp_path: Path) -> None:
    path = tmp_path / "a.bdf"
    path.write_bytes(LAMINATE + PLIES + MAT8)
    model = read_deck(path)
    ply = Parameter("ply", tuple(CardField("PCOMP", 1, f"T{k}") for k in (1, 2, 3)))
    parameters = ParameterSet((ply, Parameter("E1", (CardField("MAT8", 8, "E1"),))))
    factors = np.array([1.2, 0.5])
    changed = apply_factors(model, parameters, factors)
    np.testing.assert_allclose(
        changed["PCOMP"].ragged("T").row(0), [0.15, 0.15, 0.15, 0.3], rtol=1e-14
    )
    assert changed["MAT8"]["E1"][0] == 0.7e11
    again = read_deck(
        edit_fields(model, field_changes(model, parameters, factors), tmp_path / "new")[
            0
        ]
    )
    np.testing.assert_allclose(
        again["PCOMP"].ragged("T").row(0), [0.15, 0.15, 0.15, 0.3], rtol=1e-14
    )
    assert again["MAT8"]["E1"][0] == 0.7e11
    with pytest.raises(InputError, match="PCOMP 1 has no T5: it has 4 plies"):
        resolve_target(model, CardField("PCOMP", 1, "T5"))


def test_several_rows_of_one_card(tmp_path: Path) -> None:
    text = "PVISC,9,1.,2.,,10,3.\nPDAMP,6,.1,7,.2\n"
    (tmp_path / "a.bdf").write_text(text)
    changes = [FieldChange("PVISC", 10, "CE", 4.0), FieldChange("PDAMP", 7, "B", 0.5)]
    written = edit_fields(read_deck(tmp_path / "a.bdf"), changes, tmp_path / "new")
    assert written[0].read_text() == text.replace("10,3.", "10,4.0").replace(
        "7,.2", "7,0.5"
    )


@pytest.mark.parametrize("id", [1, 2, 3])
def test_replicated_cards_are_not_edited(tmp_path: Path, id: int) -> None:
    (tmp_path / "a.bdf").write_text(
        "MAT1,1,1.,,.3\n=,*(1),*(1.),==\n=(1)\nMAT1,4,9.,,.3\n"
    )
    model = read_deck(tmp_path / "a.bdf")
    assert model["MAT1"]["E"].tolist() == [1.0, 2.0, 3.0, 9.0]
    with pytest.raises(
        DeckError,
        match=rf"a\.bdf:{id}: MAT1 {id} field E: it is written by replication",
    ):
        edit_fields(model, [FieldChange("MAT1", id, "E", 5.0)], tmp_path / "new")
    edit_fields(model, [FieldChange("MAT1", 4, "E", 5.0)], tmp_path / "new")


@pytest.mark.parametrize("text", ["ALUMINUM", "T2", "+M 1", "+M1"])
def test_a_new_line_finds_a_card_with_a_word_at_its_end(
    tmp_path: Path, text: str
) -> None:
    """Field 10 without a continuation is free for remarks; column 73 is no part of the name that it
    then is.
    """
    deck = tmp_path / "a.bdf"
    deck.write_text(
        f"{'MAT1    1       7.+10           .3      2700.':72}{text}\nMAT1    2       2.+11      "
        "     .3\n"
    )
    (new,) = edit_fields(
        read_deck(deck), [FieldChange("MAT1", 1, "ST", 3e8)], tmp_path / "out"
    )
    there = read_deck(new)["MAT1"]
    assert (there["ST"].tolist(), there["RHO"].tolist()) == ([3e8, 0.0], [2700.0, 0.0])
