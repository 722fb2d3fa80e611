"""Decks in every format that Nastran allows, and what is said of those that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.io.nastran.reader import read_deck, survey
from ringtrue.model.model import Model

DATA = Path(__file__).parents[2].parent / "shared/data/fe"
NODES = "GRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,1.,1.,0.\nGRID,4,,0.,1.,0.\n"
MATERIAL = "MAT1,1,2.1+11,,.3,7850.\n"


def deck(folder: Path, text: str, name: str = "main.bdf") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode("latin-1"))
    return path


def read(folder: Path, text: str) -> Model:
    return read_deck(deck(folder, text))


@pytest.mark.parametrize(
    "card",
    [
        "PBAR           1       1     0.1    0.01    0.02   0.001      5.\n           .1-3     .2-3",
        "PBAR           1       1     0.1    0.01    0.02   0.001      5.        +A\n+A         .1-3     .2-3",
        "PBAR           1       1     0.1    0.01    0.02   0.001      5.        +\n+          .1-3     .2-3",
        "PBAR*                  1               1             0.1            0.01*\n"
        "*                   0.02           0.001              5.                *\n"
        "*                   .1-3            .2-3",
        "PBAR*   1               1               0.1             0.01\n*       0.02            1.D-3           5.\n"
        "        .1-3    .2-3",
        "PBAR,1,1,.1,1.-2,2.E-2,.001,5.,\n,.1-3,.2-3",
        "PBAR,1,1,.1,1.-2,2.E-2,.001,5.,,+\n+,.1-3,.2-3",
        "pbar*,1,1,.1,.01,*q\n*q,.02,.001,5.,,\n*,.1-3,.2-3",
        "PBAR\t1\t1\t0.1\t0.01\t0.02\t0.001\t5.\n\t.1-3\t.2-3",
        "PBAR,1,1,.1,.01,.02,.001,5. $ a comment, with commas\n$ between\n\n+          .1-3     .2-3 $ more",
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_every_field_format_reads_the_same(tmp_path: Path, card: str, newline: str) -> None:
    model = read(tmp_path, (MATERIAL + card + "\nENDDATA\n").replace("\n", newline))
    row = {k: v[0] for k, v in model["PBAR"].columns.items()}
    assert [row[k] for k in ("PID", "MID", "A", "I1", "I2", "J", "NSM")] == [1, 1, 0.1, 0.01, 0.02, 0.001, 5.0]
    assert (row["C1"], row["C2"], row["D1"]) == (1e-4, 2e-4, 0.0)
    assert np.isnan(row["K1"])
    assert model["PBAR"].line[0] == 2


def test_continuations_out_of_order_find_their_parents(tmp_path: Path) -> None:
    model = read(
        tmp_path,
        MATERIAL
        + "PBAR           1       1     0.1    0.01    0.02   0.001      5.        +A\n"
        + "PBAR           2       1     0.2    0.01    0.02   0.001      5.        +B\n"
        + "+B            2.\n+A            1.                                                        +C\n"
        + "+C            .5\n",
    )
    assert model["PBAR"]["C1"].tolist() == [1.0, 2.0]
    assert model["PBAR"]["K1"][0] == 0.5


def test_case_control_of_the_first_subcase(tmp_path: Path) -> None:
    text = (
        "SOL 103\nCEND\nTITLE = A wing $ not this\nSPC = 4\nmethod(structure)=3\nSET 1 = 1,2,\n 3\n"
        "SUBCASE 1\n SPC=5\nSUBCASE 2\n SPC=6\n MPC=7\nBEGIN BULK\n"
    )
    model = read(tmp_path, text + NODES + "PARAM,WTMASS,.00259\nPARAM,GRDPNT,0\nPARAM,autospc,yes\nENDDATA\nrubbish")
    assert (model.case.title, model.case.spc, model.case.method, model.case.mpc) == ("A wing", 5, 3, 0)
    assert dict(model.params) == {"WTMASS": 0.00259, "GRDPNT": 0, "AUTOSPC": "YES"}


def test_includes_nest_relative_to_their_own_folder_then_the_main_one(tmp_path: Path) -> None:
    deck(tmp_path, "INCLUDE '../main_side.bdf'\nGRID,2,,1.,0.,0.\nINCLUDE \"c.bdf\"\n", "sub/dir/b.bdf")
    deck(tmp_path, "GRID,3,,1.,1.,0.\n", "sub/main_side.bdf")
    deck(tmp_path, "$ first\nGRID,4,,0.,1.,0.\n", "c.bdf")
    model = read(
        tmp_path, "BEGIN BULK\nGRID,1,,0.,0.,0.\ninclude 'sub/\n  dir\\\n  b.bdf' $ broken\nGRID,5,,0.,0.,1.\n"
    )
    grid = model["GRID"]
    assert [Path(f).name for f in model.files] == ["main.bdf", "b.bdf", "main_side.bdf", "c.bdf"]
    assert grid.ids.tolist() == [1, 3, 2, 4, 5]
    assert grid.file.tolist() == [0, 2, 1, 3, 0]
    assert grid.line.tolist() == [2, 1, 2, 2, 6]


def test_a_missing_include_says_where_it_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(DeckError, match=r"main\.bdf:2: INCLUDE: .*looked for .*no\.bdf"):
        read(tmp_path, "BEGIN BULK\nINCLUDE 'no.bdf'\n")


def test_a_file_that_includes_itself(tmp_path: Path) -> None:
    with pytest.raises(DeckError, match="includes itself"):
        read(tmp_path, "INCLUDE 'main.bdf'\n")


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("GRID,9,,1.x,0.,0.", r"main\.bdf:6: GRID field X1: '1\.X' is not a real"),
        ("GRID,9.,,1.,0.,0.", r"GRID field ID: '9\.' is not an integer"),
        (
            "CQUAD4,7,1,1,2,3,99",
            r"main\.bdf:6: CQUAD4 7 field G4: names GRID or SPOINT 99, which is not in the deck",
        ),
        ("CQUAD4,7,8,1,2,3,4", r"CQUAD4 7 field PID: names PSHELL 8"),
        ("CQUAD4,7,1,1,2,3", r"CQUAD4 7 field G4: is blank"),
        ("PSHELL,8,77,.1", r"PSHELL 8 field MID1: names MAT1 77"),
        ("GRID,1,,9.,0.,0.", r"main\.bdf:6: GRID: 1 is defined twice, first at .*main\.bdf:2"),
        ("MAT1,1,7.+10,,.3", r"MAT1: 1 is defined twice"),
        ("GRID,9,5,1.,0.,0.", r"GRID 9 field CP: names coordinate frame 5"),
        ("CROD,9,1,1,2,3,4", r"CROD: more than 4 data fields"),
        ("SPC1,1,123,5,THRU,x", r"SPC1 field G: 'X' is not an integer"),
        ("SPC1,1,123,5,THRU,2", "a THRU b needs a <= b"),
        ("CBAR,1,2,3,4,5,6,7,8,+a,9", "at most 8 data fields"),
        ("12345", "'12345' in columns 1-8 is not a card name"),
    ],
)
def test_errors_name_file_line_card_and_field(tmp_path: Path, bad: str, message: str) -> None:
    with pytest.raises(DeckError, match=message):
        read(tmp_path, MATERIAL + NODES + bad + "\nPSHELL,1,1,.1\n")


@pytest.mark.parametrize(
    "card",
    [
        "CQUAD8,1",
        "PCOMP,1",
        "MAT8,1",
        "RBAR,1",
        "DMIG,A",
        "CDAMP1,1",
        "CNEW,1",
        "=,*(1),=",
        "BAROR,,1",
        "CONM1,1,1",
    ],
)
def test_unsupported_cards_stop_the_reader_and_are_listed_by_survey(tmp_path: Path, card: str) -> None:
    path = deck(tmp_path, NODES + card + "\n")
    name = card.split(",")[0]
    with pytest.raises(UnsupportedCard, match=rf"main\.bdf:5: {name} is not supported"):
        read_deck(path)
    found = survey(path)
    assert found.unsupported == {name: f"{path}:5"}
    assert found.cards == {"GRID": 4, name: 1}


def test_a_repeated_identical_node_is_allowed_and_kept_once(tmp_path: Path) -> None:
    assert read(tmp_path, NODES + "GRID,1,,0.,0.,0.\n")["GRID"].ids.tolist() == [1, 2, 3, 4]


def test_other_cards_are_counted(tmp_path: Path) -> None:
    assert dict(read(tmp_path, NODES + "FORCE,1,1,,1.,1.\nFORCE,1,2,,1.,1.\nPLOTEL,1,1,2\n").kept) == {
        "FORCE": 2,
        "PLOTEL": 1,
    }


def test_grdset_fills_blanks_only(tmp_path: Path) -> None:
    frame = "CORD2R,5,,0.,0.,0.,0.,0.,1.,\n,1.,0.,0.\n"
    model = read(
        tmp_path, frame + "GRDSET,,5,,,,5,126\nGRID,1,,0.,0.,0.\nGRID,2,0,0.,0.,1.,0,0\nGRID,3,0,0.,0.,2.,,3\n"
    )
    assert model["GRID"]["CP"].tolist() == [5, 0, 0]
    assert model["GRID"]["CD"].tolist() == [5, 0, 5]
    assert model["GRID"]["PS"].tolist() == ["126", "", "3"]


def test_cards_with_a_pattern_of_their_own(tmp_path: Path) -> None:
    model = read(
        tmp_path,
        NODES
        + MATERIAL
        + "SPC,1,1,123456,0.,2,3,.5\nSPC1,2,3,1,THRU,9\nSPC1,2,12,4,2\nSPCADD,3,1,2\n"
        + "MPC,1,1,1,1.,2,1,-1.\n,,3,2,.5\n"
        + "RBE3,10,,4,123,1.,123,1,2\n,.5,12,3\nRBE2,11,1,123456,2,3,1.-5\n"
        + "PBUSH,1,K,1.,2.,3.,4.,5.,6.\n,,B,.1,.2\n,,GE,.05\n"
        + "CBUSH,20,1,3,,,,,0\nCELAS1,21,2,1,1\nPELAS,2,5.,.01,,3,6.\nPMASS,4,1.5,5,2.5\n"
        + "CBAR,30,1,1,2,3\nCBAR,31,1,1,2,0.,1.,0.\nPBARL,1,1,,TUBE\n,2.,1.\n",
    )
    assert model["SPC"]["G"].tolist() == [1, 2]
    assert model["SPC"]["C"].tolist() == ["123456", "3"]
    assert model["SPC"]["D"].tolist() == [0.0, 0.5]
    assert model["SPC1"].ragged("G").row(0).tolist() == [1, 2, 3, 4]  # THRU passes over nodes that are not there
    assert model["SPC1"].ragged("G").row(1).tolist() == [4, 2]
    assert model["MPC"].ragged("G").row(0).tolist() == [1, 2, 3]
    assert model["MPC"].ragged("A").row(0).tolist() == [1.0, -1.0, 0.5]
    assert model["RBE3"].ragged("WT").row(0).tolist() == [1.0, 1.0, 0.5]
    assert model["RBE3"].ragged("C").row(0).tolist() == ["123", "123", "12"]
    assert model["RBE2"].ragged("GM").row(0).tolist() == [2, 3]
    assert [model["PBUSH"][k][0] for k in ("K1", "K6", "B2", "GE")] == [1.0, 6.0, 0.2, 0.05]
    assert (model["CBUSH"]["GB"][0], model["CBUSH"]["CID"][0]) == (0, 0)
    assert model["PELAS"].ids.tolist() == [2, 3]
    assert model["PELAS"]["K"].tolist() == [5.0, 6.0]
    assert model["PMASS"]["M"].tolist() == [1.5, 2.5]
    assert model["CBAR"]["G0"].tolist() == [3, 0]
    assert model["CBAR"]["X2"].tolist() == [0.0, 1.0]
    np.testing.assert_allclose(model["PBAR"]["J"], np.pi / 2 * (2**4 - 1), rtol=1e-14)


def test_pbeam_end_b(tmp_path: Path) -> None:
    cards = "PBEAM,1,1,4.,1.,2.,,.5\n,0.,0.,0.,0.,0.,0.,0.,0.\n,NO,1.,2.,\n,.8,.9\nPBEAM,2,1,4.,1.,2.,,.5\n"
    t = read(tmp_path, NODES + MATERIAL + cards)["PBEAM"]
    assert t["AB"].tolist() == [2.0, 4.0]
    assert t["I1B"].tolist() == [1.0, 1.0]
    assert t["K1"].tolist() == [0.8, 1.0]
    with pytest.raises(UnsupportedCard, match="straight line"):
        read(tmp_path, NODES + MATERIAL + "PBEAM,1,1,4.,1.,2.\n,\n,NO,.5,9.\n,NO,1.,2.\n")


def test_an_element_without_property_takes_its_own_number(tmp_path: Path) -> None:
    model = read(tmp_path, NODES + MATERIAL + "PROD,7,1,1.\nCROD,7,,1,2\n")
    assert model["CROD"]["PID"].tolist() == [7]


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("msc2019/superelements/cantilever_bar/no_super/noReduction.dat", {"CBAR": 10, "GRID": 11, "SPC": 1}),
        ("msc2019/system_verification/004_72_bar_truss/nastran_runs/modes.dat", {"CROD": 72, "PROD": 16}),
        ("naca_wing/0012_flutter.bdf", {"CQUAD4": 84, "GRID": 117, "RBE2": 1, "CELAS2": 2}),
        ("beam_modes/beam_modes.dat", {"CBEAM": 1, "PBEAM": 1, "PBAR": 1}),
    ],
)
def test_decks_of_others(name: str, count: dict[str, int]) -> None:
    if not (DATA / name).exists():
        pytest.skip(f"needs {DATA / name}")
    model = read_deck(DATA / name)
    assert {card: len(model[card]) for card in count} == count


@pytest.mark.data
def test_survey_of_a_deck_that_cannot_be_used() -> None:
    path = DATA / "bwb/bwb_saero.bdf"
    if not path.exists():
        pytest.skip(f"needs {path}")
    found = survey(path)
    assert set(found.unsupported) == {"MAT8", "PCOMP", "PBARL", "PBEAML"}
    assert found.cards["PCOMP"] == 63
    assert not found.faults
