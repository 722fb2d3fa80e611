"""Decks in every format that Nastran allows, and what is said of those that are wrong."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck, survey
from ringtrue.decks.nastran.writer import write_bulk
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.edit import FieldChange
from ringtrue.model.frames import positions
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
        "PBAR           1       1     0.1    0.01    0.02   0.001      5.\n           .1-3     "
        ".2-3",
        "PBAR           1       1     0.1    0.01    0.02   0.001      5.        +A\n+A         "
        ".1-3     .2-3",
        "PBAR           1       1     0.1    0.01    0.02   0.001      5.        +\n+          "
        ".1-3     .2-3",
        "PBAR*                  1               1             0.1            0.01*\n"
        "*                   0.02           0.001              5.                *\n"
        "*                   .1-3            .2-3",
        "PBAR*   1               1               0.1             0.01\n*       0.02            "
        "1.D-3           5.\n"
        "        .1-3    .2-3",
        "PBAR,1,1,.1,1.-2,2.E-2,.001,5.,\n,.1-3,.2-3",
        "PBAR,1,1,.1,1.-2,2.E-2,.001,5.,,+\n+,.1-3,.2-3",
        "pbar*,1,1,.1,.01,*q\n*q,.02,.001,5.,,\n*,.1-3,.2-3",
        "PBAR\t1\t1\t0.1\t0.01\t0.02\t0.001\t5.\n\t.1-3\t.2-3",
        "PBAR,1,1,.1,.01,.02,.001,5. $ a comment, with commas\n$ between\n\n+          .1-3     "
        ".2-3 $ more",
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_every_field_format_reads_the_same(
    tmp_path: Path, card: str, newline: str
) -> None:
    model = read(tmp_path, (MATERIAL + card + "\nENDDATA\n").replace("\n", newline))
    row = {k: v[0] for k, v in model["PBAR"].columns.items()}
    assert [row[k] for k in ("PID", "MID", "A", "I1", "I2", "J", "NSM")] == [
        1,
        1,
        0.1,
        0.01,
        0.02,
        0.001,
        5.0,
    ]
    assert (row["C1"], row["C2"], row["D1"]) == (1e-4, 2e-4, 0.0)
    assert np.isnan(row["K1"])
    assert model["PBAR"].line[0] == 2


def test_continuations_out_of_order_find_their_parents(tmp_path: Path) -> None:
    model = read(
        tmp_path,
        MATERIAL
        + "PBAR           1       1     0.1    0.01    0.02   0.001      5.        +A\n"
        + "PBAR           2       1     0.2    0.01    0.02   0.001      5.        +B\n"
        + "+B            2.\n+A            1.                                                    "
        "    +C\n" + "+C            .5\n",
    )
    assert model["PBAR"]["C1"].tolist() == [1.0, 2.0]
    assert model["PBAR"]["K1"][0] == 0.5


def test_case_control_of_the_first_subcase(tmp_path: Path) -> None:
    text = (
        "SOL 103\nCEND\nTITLE = A wing $ not this\nSPC = 4\nmethod(structure)=3\nSET 1 = 1,2,\n 3\n"
        "SUBCASE 1\n SPC=5\nSUBCASE 2\n SPC=6\n MPC=7\nBEGIN BULK\n"
    )
    model = read(
        tmp_path,
        text
        + NODES
        + "SPC1,5,3,1\nPARAM,WTMASS,.00259\nPARAM,GRDPNT,0\nPARAM,autospc,yes\nENDDATA\nrubbish",
    )
    assert (model.case.title, model.case.spc, model.case.method, model.case.mpc) == (
        "A wing",
        5,
        3,
        0,
    )
    assert dict(model.params) == {"WTMASS": 0.00259, "GRDPNT": 0, "AUTOSPC": "YES"}


def test_includes_nest_relative_to_their_own_folder_then_the_main_one(
    tmp_path: Path,
) -> None:
    deck(
        tmp_path,
        "INCLUDE '../main_side.bdf'\nGRID,2,,1.,0.,0.\nINCLUDE \"c.bdf\"\n",
        "sub/dir/b.bdf",
    )
    deck(tmp_path, "GRID,3,,1.,1.,0.\n", "sub/main_side.bdf")
    deck(tmp_path, "$ first\nGRID,4,,0.,1.,0.\n", "c.bdf")
    model = read(
        tmp_path,
        "BEGIN BULK\nGRID,1,,0.,0.,0.\ninclude 'sub/\n  dir\\\n  b.bdf' $ "
        "broken\nGRID,5,,0.,0.,1.\n",
    )
    grid = model["GRID"]
    assert [Path(f).name for f in model.files] == [
        "main.bdf",
        "b.bdf",
        "main_side.bdf",
        "c.bdf",
    ]
    assert grid.ids.tolist() == [1, 3, 2, 4, 5]
    assert grid.file.tolist() == [0, 2, 1, 3, 0]
    assert grid.line.tolist() == [2, 1, 2, 2, 6]


def test_a_missing_include_says_where_it_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(
        DeckError, match=r"main\.bdf:2: INCLUDE: .*looked for .*no\.bdf"
    ):
        read(tmp_path, "BEGIN BULK\nINCLUDE 'no.bdf'\n")


def test_a_missing_include_of_the_executive_control_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    model = read(
        tmp_path,
        "SOL 103\ninclude '/site/alter.v9'\nCEND\nMETHOD=1\nBEGIN BULK\nGRID,1\n",
    )
    assert (model["GRID"].ids.tolist(), model.case.method) == ([1], 1)
    assert "main.bdf:2: INCLUDE: the included file is not there" in caplog.text
    with pytest.raises(DeckError, match=r"main\.bdf:3: INCLUDE"):
        read(tmp_path, "SOL 103\nCEND\nINCLUDE 'case.inc'\nBEGIN BULK\nGRID,1\n")


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
        ("CQUAD4,7,8,1,2,3,4", r"CQUAD4 7 field PID: names PSHELL, PCOMP or PCOMPG 8"),
        ("CQUAD4,7,1,1,2,3", r"CQUAD4 7 field G4: is blank"),
        (
            "PSHELL,8,77,.1\nCTRIA3,9,8,1,2,3",
            r"PSHELL 8 field MID1: names MAT1, MAT2 or MAT8 77",
        ),
        (
            "GRID,1,,9.,0.,0.",
            r"main\.bdf:6: GRID: 1 is defined twice, first at .*main\.bdf:2",
        ),
        ("MAT1,1,7.+10,,.3", r"MAT1: 1 is defined twice"),
        (
            "MAT8,1,7.+10,7.+10,.3,3.+10",
            r"main\.bdf:6: MAT8: 1 is defined twice, first as MAT1 at .*main\.bdf:1",
        ),
        (
            "PCOMP,1\n,1,.1",
            r"main\.bdf:6: PCOMP: 1 is defined twice, first as PSHELL at .*main\.bdf:8",
        ),
        ("GRID,9,5,1.,0.,0.", r"GRID 9 field CP: names coordinate frame 5"),
        ("CROD,9,1,1,2,3,4", r"CROD: more than 4 data fields"),
        (
            "PSHELL,9,1,.1\n,,,,30.",
            r"main\.bdf:6: PSHELL: more than 11 data fields; give THETA",
        ),
        ("SPC1,1,123,5,THRU,x", r"SPC1 field G: 'X' is not an integer"),
        ("SPC1,1,123,5,THRU,2", "a THRU b BY c needs a <= b"),
        (
            "SPC1,1,12a,1",
            r"main\.bdf:6: SPC1 1 field C: '12A' is no list of components; allowed are the digits 1 to 6",
        ),
        ("SPC,1,1,127", r"SPC 1 field C: '127' is no list of components"),
        ("GRID,9,,1.,0.,0.,,x", r"GRID 9 field PS: 'X' is no list of components"),
        ("RBE3,9,,1,12x,1.,123,2,3,4", r"RBE3 9 field REFC: '12X' is no list"),
        ("RBE3,9,,1,123,1.,789,2,3,4", r"RBE3 9 field C: '789' is no list"),
        ("CBAR,1,2,3,4,5,6,7,8,+a,9", "at most 8 data fields"),
        ("12345", "'12345' in columns 1-8 is not a card name"),
        ("PCOMP,9\n,,.1", r"PCOMP field MID1: '' is not an integer"),
        ("PCOMP,9\n,1,", r"PCOMP field T1: '' is not a real"),
        ("PCOMP,9,0.", r"PCOMP field MID1: the laminate has no ply"),
        ("RBE1,9,1,123456", r"RBE1 field UM: the dependent DOFs are missing"),
        ("DMIG,KA,1,1,,1,1,2.", r"DMIG field NAME: 'KA' has no header"),
        ("DMIG,KA,0,6,1\nDMIG,KA,1,1,,1,1,x", r"DMIG field A: 'X' is not a real"),
        (
            "DMIG,KA,0,6,1\nDMIG,KA,0,6,1",
            r"main\.bdf:7: DMIG field NAME: KA has two headers",
        ),
        ("=(200000)", "200000 repetitions; at most 100000"),
        ("=x", "'=X' is no replication"),
        ("=,*(a),==", r"GRID field ID: '\*\(A\)' is not an integer"),
        ("BAROR,,x\nCBAR,1,,1,2,0.,1.,0.", "BAROR field PID: 'X' is not an integer"),
        (
            "BAROR,,1\nBAROR,,2\nCBAR,1,,1,2,0.,1.,0.",
            r"main\.bdf:7: BAROR: there are two of them",
        ),
    ],
)
def test_errors_name_file_line_card_and_field(
    tmp_path: Path, bad: str, message: str
) -> None:
    with pytest.raises(DeckError, match=message):
        read(tmp_path, MATERIAL + NODES + bad + "\nPSHELL,1,1,.1\n")


@pytest.mark.parametrize(
    "card",
    [
        "CSEAM,1",
        "PCOMPS,1",
        "MAT3,1",
        "RSSCON,1",
        "CNEW,1",
        "CRAC2D,1,1",
    ],
)
def test_unsupported_cards_stop_the_reader_and_are_listed_by_survey(
    tmp_path: Path, card: str
) -> None:
    path = deck(tmp_path, NODES + card + "\n")
    name = card.split(",")[0]
    with pytest.raises(UnsupportedCard, match=rf"main\.bdf:5: {name} is not supported"):
        read_deck(path)
    found = survey(path)
    assert list(found.unsupported) == [name]
    assert re.fullmatch(rf"{re.escape(str(path))}:5(: .+)?", found.unsupported[name])
    assert found.cards == {"GRID": 4, name: 1}


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("SESET,1,2", "superelements: give them as parts"),
        ("BEGIN AUXMODEL=1", "auxiliary models"),
        ("AXIC,0", "axisymmetric"),
        ("CPLSTN4,1,1,1,2,3,4", "axisymmetric, plane strain"),
        ("EGRID,1,,0.,0.,0.", "MSGMESH"),
        ("CBEAM3,1,1,1,2,3", "two CBEAM"),
        ("PCOMPS,1", "MAT9, or shells with PCOMP"),
        ("PBMSECT,1,1,CP", "PBEAML"),
        ("PCOMPP,1", "give PCOMP or PCOMPG"),
        ("MATCID,7,1,THRU,9", "CORDM of the PSOLID"),
        ("CFLUID2,1,2,3", "fluids"),
        ("CQUAD1,1,1,1,2,3,4", "old NASTRAN: give CQUAD4"),
        ("TIE,1,2,3", "contact and glue"),
        ("CONTACT,1,FREEZE,2,3", "contact and glue"),
        ("BSCONP,1,2,3,2", "contact and glue"),
        ("JOINTG,1,UNIVERSL,2,3", "RJOINT"),
        ("CIHEX1,1,1,1,2,3,4", "old NASTRAN: give CQUAD4"),
    ],
)
def test_cards_that_are_not_read_say_what_to_do(
    tmp_path: Path, line: str, why: str
) -> None:
    path = deck(tmp_path, "BEGIN BULK\n" + NODES + line + "\n")
    with pytest.raises(UnsupportedCard, match=f"is not supported: .*{why}"):
        read_deck(path)
    assert [w for w in survey(path).unsupported.values() if why in w]


def test_repeated_identical_nodes_and_frames_are_allowed_and_kept_once(
    tmp_path: Path,
) -> None:
    assert read(tmp_path, NODES + "GRID,1,,0.,0.,0.\n")["GRID"].ids.tolist() == [
        1,
        2,
        3,
        4,
    ]
    frame = "CORD2R,5,,0.,0.,0.,0.,0.,1.,\n,1.,0.,0.\n"
    assert read(tmp_path, NODES + 2 * frame)["CORD2R"].ids.tolist() == [5]
    with pytest.raises(DeckError, match="CORD2R: 5 is defined twice"):
        read(tmp_path, NODES + frame + frame.replace(",1.,0.,0.", ",0.,1.,0."))


def test_frames_in_a_circle_have_their_lines(tmp_path: Path) -> None:
    axes = "0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    model = read(tmp_path, NODES + f"CORD2R,5,6,{axes}CORD2C,6,5,{axes}")
    with pytest.raises(
        DeckError,
        match=r"main\.bdf:\d: CORD2. .: CORD2. ., CORD2. . refer to frames .* in a circle",
    ):
        positions(model)


def test_other_cards_are_counted(tmp_path: Path) -> None:
    assert dict(
        read(
            tmp_path, NODES + "FORCE,1,1,,1.,1.\nFORCE,1,2,,1.,1.\nPLOTEL,1,1,2\n"
        ).kept
    ) == {
        "FORCE": 2,
        "PLOTEL": 1,
    }


def test_grdset_fills_blanks_only(tmp_path: Path) -> None:
    frame = "CORD2R,5,,0.,0.,0.,0.,0.,1.,\n,1.,0.,0.\n"
    model = read(
        tmp_path,
        frame
        + "GRDSET,,5,,,,5,126\nGRID,1,,0.,0.,0.\nGRID,2,0,0.,0.,1.,0,0\nGRID,3,0,0.,0.,2.,,3\n",
    )
    assert model["GRID"]["CP"].tolist() == [5, 0, 0]
    assert model["GRID"]["CD"].tolist() == [5, 0, 5]
    assert model["GRID"]["PS"].tolist() == ["126", "", "3"]


def test_an_include_by_a_logical_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`SYMBOL:file`: the environment variable names the folder; without one the file stands beside
    the deck.
    """
    deck(tmp_path, "GRID,1\n", "side.dat")
    assert read(tmp_path, "INCLUDE 'TPLDIR:side.dat'\n")["GRID"].ids.tolist() == [1]
    deck(tmp_path, "GRID,2\n", "far/side.dat")
    monkeypatch.setenv("TPLDIR", str(tmp_path / "far"))
    assert read(tmp_path, "INCLUDE 'TPLDIR:side.dat'\n")["GRID"].ids.tolist() == [2]


def test_a_blank_behind_the_name_of_a_free_line_separates(tmp_path: Path) -> None:
    path = deck(
        tmp_path, NODES + "GRID   11,  , 5., 6.\nCONM2\t12, 11,, 3.\nGRID    13 ,,7.\n"
    )
    model = read_deck(path)
    assert model["GRID"].ids.tolist() == [1, 2, 3, 4, 11, 13]
    assert model["GRID"]["X1"][-2:].tolist() == [5.0, 7.0]
    assert (model["CONM2"].ids[0], model["CONM2"]["G"][0], model["CONM2"]["M"][0]) == (
        12,
        11,
        3.0,
    )
    edit_fields(model, [FieldChange("CONM2", 12, "M", 4.5)], tmp_path / "new")
    assert (tmp_path / "new/main.bdf").read_text() == path.read_text().replace(
        "3.\nGRID    13", "4.5\nGRID    13"
    )


def test_column_73_of_a_continuation_is_free(tmp_path: Path) -> None:
    """Columns 74 to 80 name the continuation; what stands in column 73 does not count."""
    line = (
        "PBAR    1       1       1.      2.      3.                              KBAR"
    )
    model = read(tmp_path, NODES + MATERIAL + line + "\n+BAR    .5      .25\n")
    assert (model["PBAR"]["C1"][0], model["PBAR"]["C2"][0]) == (0.5, 0.25)


def test_lists_of_rbe3_may_be_ranges(tmp_path: Path) -> None:
    rbe3 = read(tmp_path, NODES + "RBE3,10,,4,123,1.,123,1,THRU\n,2,.5,12,3\n")["RBE3"]
    assert rbe3.ragged("G").row(0).tolist() == [1, 2, 3]
    assert rbe3.ragged("WT").row(0).tolist() == [1.0, 1.0, 0.5]
    assert rbe3.ragged("C").row(0).tolist() == ["123", "123", "12"]


def test_cards_with_a_pattern_of_their_own(tmp_path: Path) -> None:
    model = read(
        tmp_path,
        NODES
        + MATERIAL
        + "SPC,1,1,123456,0.,2,3,.5\nSPC1,2,3,1,THRU,2000000000\nSPC1,2,12,4,2\nSPCADD,3,1,2\n"
        + "MPC,1,1,1,1.,2,1,-1.\n,,3,2,.5\n"
        + "RBE3,10,,4,123,1.,123,1,2\n,.5,12,3\nRBE2,11,1,123456,2,3,1.-5\n"
        + "PBUSH,1,K,1.,2.,3.,4.,5.,6.\n,,B,.1,.2\n,,GE,.05\n"
        + "CBUSH,20,1,3,,,,,0\nCELAS1,21,2,1,1\nPELAS,2,5.,.01,,3,6.\nPMASS,4,1.5,5,2.5\n"
        + "CBAR,30,1,1,2,3\nCBAR,31,1,1,2,0.,1.,0.\nPBARL,1,1,,TUBE\n,2.,1.\n",
    )
    assert model["SPC"]["G"].tolist() == [1, 2]
    assert model["SPC"]["C"].tolist() == ["123456", "3"]
    assert model["SPC"]["D"].tolist() == [0.0, 0.5]
    assert model["SPC1"].ragged("G").row(0).tolist() == [
        1,
        2,
        3,
        4,
    ]  # THRU passes over nodes that are not there
    assert model["SPC1"].ragged("G").row(1).tolist() == [4, 2]
    assert model["MPC"].ragged("G").row(0).tolist() == [1, 2, 3]
    assert model["MPC"].ragged("A").row(0).tolist() == [1.0, -1.0, 0.5]
    assert model["RBE3"].ragged("WT").row(0).tolist() == [1.0, 1.0, 0.5]
    assert model["RBE3"].ragged("C").row(0).tolist() == ["123", "123", "12"]
    assert model["RBE2"].ragged("GM").row(0).tolist() == [2, 3]
    assert [model["PBUSH"][k][0] for k in ("K1", "K6", "B2", "GE")] == [
        1.0,
        6.0,
        0.2,
        0.05,
    ]
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


def test_an_element_without_property_takes_its_own_number(tmp_path: Path) -> None:
    model = read(tmp_path, NODES + MATERIAL + "PROD,7,1,1.\nCROD,7,,1,2\n")
    assert model["CROD"]["PID"].tolist() == [7]


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "count"),
    [
        (
            "msc2019/superelements/cantilever_bar/no_super/noReduction.dat",
            {"CBAR": 10, "GRID": 11, "SPC": 1},
        ),
        (
            "msc2019/system_verification/004_72_bar_truss/nastran_runs/modes.dat",
            {"CROD": 72, "PROD": 16},
        ),
        (
            "naca_wing/0012_flutter.bdf",
            {"CQUAD4": 84, "GRID": 117, "RBE2": 1, "CELAS2": 2},
        ),
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
    assert not {"MAT8", "PCOMP"} & set(found.unsupported)
    assert found.cards["PCOMP"] == 63
    assert [f.card for f in found.faults] == ["PBEAM 5"]  # nothing uses it


def test_replicated_cards(tmp_path: Path) -> None:
    text = (
        "GRID,1,,0.,0.,0.\n=,*(1),=,*(.5),==\n=(3)\nGRID,20,,9.,9.,9.\n"
        "=           *10       =     *-1.      ==\n=2\n"
        "GRID,100,,1.-1,2,,3.\nCROD,1,7,1,2\n=,*(1),=,*(1),*(1)\n=(1)\nPROD,7,1,1.\n"
    ).replace("1.-1,2,", "1.-1,2.,")
    model = read(tmp_path, MATERIAL + text.replace(",,3.", ",3."))
    grid = model["GRID"]
    assert grid.ids.tolist() == [1, 2, 3, 4, 5, 20, 30, 40, 50, 100]
    np.testing.assert_allclose(
        grid["X1"], [0, 0.5, 1, 1.5, 2, 9, 8, 7, 6, 0.1], rtol=0, atol=1e-15
    )
    assert grid["X3"].tolist() == [0.0] * 5 + [9.0] * 4 + [3.0]
    assert grid.line.tolist() == [2, 3, 4, 4, 4, 5, 6, 7, 7, 8]
    assert model["CROD"].stack("EID", "PID", "G1", "G2").tolist() == [
        [1, 7, 1, 2],
        [2, 7, 2, 3],
        [3, 7, 3, 4],
    ]


def test_bars_take_what_baror_says(tmp_path: Path) -> None:
    bars = "CBAR,1,,1,2\nCBAR,2,8,1,2,3\nCBAR,3,,1,2,,1.\nCBAR,4,,1,2,1.,0.,0.,GOO\n"
    sections = "PBAR,7,1\nPBAR,8,1\n"
    by_vector = read(
        tmp_path, NODES + MATERIAL + sections + bars + "BAROR,,7,,,.5,.6,.7,OGG\n"
    )["CBAR"]
    assert by_vector["PID"].tolist() == [7, 8, 7, 7]
    assert by_vector["G0"].tolist() == [0, 3, 0, 0]
    assert by_vector.stack("X1", "X2", "X3").tolist() == [
        [0.5, 0.6, 0.7],
        [0, 0, 0],
        [0.5, 1.0, 0.7],
        [1.0, 0, 0],
    ]
    assert by_vector["OFFT"].tolist() == ["OGG", "OGG", "OGG", "GOO"]
    by_node = read(tmp_path, NODES + MATERIAL + sections + bars + "BAROR,,7,,,4\n")[
        "CBAR"
    ]
    assert by_node["G0"].tolist() == [4, 3, 0, 0]


def test_laminates(tmp_path: Path) -> None:
    plies = "PCOMP,1,-.2,.5,,HILL,,.01,SYM\n,8,.1,45.,YES,,,-45.\n,,.2,,,,,,\n,1,,90.\n"
    glob = "PCOMPG,2\n,101,8,.1,30.,YES\n,102,,,-30.\n"
    mat8 = "MAT8,8,1.4+11,9.+9,.3,5.+9,4.+9,3.+9,1600.\n,1.-6,2.-5,20.,,,,,\n,.002\n"
    model = read(
        tmp_path,
        NODES
        + MATERIAL
        + mat8
        + plies
        + glob
        + "CQUAD4,1,1,1,2,3,4,30.\nCQUAD4,2,2,1,2,3,4\n",
    )
    t = model["PCOMP"]
    assert [t[c][0] for c in ("Z0", "NSM", "FT", "GE", "LAM")] == [
        -0.2,
        0.5,
        "HILL",
        0.01,
        "SYM",
    ]
    assert t.ragged("MID").row(0).tolist() == [8, 8, 8, 1]
    assert t.ragged("T").row(0).tolist() == [0.1, 0.1, 0.2, 0.2]
    assert t.ragged("THETA").row(0).tolist() == [45.0, -45.0, 0.0, 90.0]
    assert t.ragged("SOUT").row(0).tolist() == ["YES", "NO", "NO", "NO"]
    g = model["PCOMPG"]
    assert np.isnan(g["Z0"][0])
    assert g.ragged("GPLYID").row(0).tolist() == [101, 102]
    assert g.ragged("THETA").row(0).tolist() == [30.0, -30.0]
    assert g.ragged("MID").row(0).tolist() == [8, 8]
    assert [model["MAT8"][c][0] for c in ("E1", "G2Z", "RHO", "TREF", "GE")] == [
        1.4e11,
        3e9,
        1600.0,
        20.0,
        0.002,
    ]


def test_matrices_and_their_choice(tmp_path: Path) -> None:
    bulk = (
        "DMIG,KA,0,6,1,0,,,4\nDMIG,KB,0,1,2\nDMIG,KA,1,1,,1,1,2.\n,2,1,-1.5,,3,2,4.+1\n"
        "DMIG*   KB                             2               3\n"
        "*                      2               3    1.23456789D3\n"
    )
    model = read(
        tmp_path, "CEND\nK2GG = KA,\n 2.5*kb\nM2GG=MX\nBEGIN BULK\n" + NODES + bulk
    )
    t = model["DMIG"]
    assert t["NAME"].tolist() == ["KA", "KB"]
    assert t.stack("ID", "IFO", "TIN", "NCOL").tolist() == [[1, 6, 1, 4], [2, 1, 2, 0]]
    assert t.ragged("GJ").row(0).tolist() == [1, 1, 1]
    assert t.ragged("GI").row(0).tolist() == [1, 2, 3]
    assert t.ragged("CI").row(0).tolist() == [1, 1, 2]
    assert t.ragged("A").row(0).tolist() == [2.0, -1.5, 40.0]
    assert t.ragged("A").row(1).tolist() == [1234.56789]
    assert model.case.k2gg == ((1.0, "KA"), (2.5, "KB"))
    assert model.case.m2gg == ((1.0, "MX"),)


def test_rigid_and_scalar_elements(tmp_path: Path) -> None:
    model = read(
        tmp_path,
        NODES
        + "RBE1,1,1,123,2,3,3,23\n,UM,4,123456\nRBE1,2,1,123456\n,UM,2,1,3,2,4,3\n,,2,456\n"
        + "RBAR,3,1,2,123456,,,12\nCELAS4,4,5.,11,12\nCDAMP3,5,6,12,13\nPDAMP,6,.1,7,.2\nCVISC,8,9,1,2\n"
        + "PVISC,9,1.,2.,,10,3.\nCONM1,11,1,,1.,,2.\nSPOINT,12\n",
    )
    assert model["RBE1"].ragged("CN").row(0).tolist() == ["123", "3", "23"]
    assert model["RBE1"].ragged("GM").row(1).tolist() == [2, 3, 4, 2]
    assert model["RBE1"].ragged("CM").row(1).tolist() == ["1", "2", "3", "456"]
    assert (model["RBAR"]["CNA"][0], model["RBAR"]["CMB"][0]) == ("123456", "12")
    assert model["SPOINT"].ragged("ID").values.tolist() == [
        12,
        11,
        13,
    ]  # the last two are named by elements only
    assert model["PDAMP"].stack("PID", "B").tolist() == [[6, 0.1], [7, 0.2]]
    assert model["PVISC"].stack("PID", "CE", "CR").tolist() == [[9, 1, 2], [10, 3, 0]]
    assert [model["CONM1"][c][0] for c in ("M11", "M21", "M22")] == [1.0, 0.0, 2.0]


def test_the_subcase_with_a_method_is_taken(tmp_path: Path) -> None:
    text = (
        "CEND\nMPC = 9\nTITLE = a,\nSUBCASE 1\n SPC = 1\nSUBCASE 2\n METH = 3\n SPC = "
        "2\nAUTOSPC(PRINT)=NO\n"
    )
    sets = "SPC1,2,3,1\nMPC,9,1,2,1.,2,2,-1.\n"
    model = read(
        tmp_path, text + "PARAM,WTMASS,.5\nBEGIN BULK\nPARAM,WTMASS,1.\n" + NODES + sets
    )
    assert (model.case.title, model.case.method, model.case.spc, model.case.mpc) == (
        "a,",
        3,
        2,
        9,
    )
    assert dict(model.params) == {"WTMASS": 0.5, "AUTOSPC": "NO"}


def test_free_fields_in_a_block_and_odd_lines_among_them(tmp_path: Path) -> None:
    long = "GRID,7,,7." + "0" * 90 + ",1.,2.\n"
    model = read(
        tmp_path, NODES + long + " grid , 8 , , 8. , .5-1 , 3. , , , , $ c\nGRID,9\n"
    )
    assert model["GRID"].ids.tolist() == [1, 2, 3, 4, 7, 8, 9]
    assert model["GRID"].stack("X1", "X2", "X3")[4:].tolist() == [
        [7, 1, 2],
        [8, 0.05, 3],
        [0, 0, 0],
    ]


def test_nonstructural_mass_counts_only_where_it_is_chosen(tmp_path: Path) -> None:
    bulk = "BEGIN BULK\n" + NODES + "NSM1,5,PSHELL,2.,1\n"
    assert dict(read(tmp_path, "CEND\n" + bulk).kept) == {"NSM1": 1}
    table = read(tmp_path, "CEND\nNSM = 5\n" + bulk)["NSM1"]
    assert (
        table["SID"][0],
        table["TYPE"][0],
        table["VALUE"][0],
        table.ragged("ID").row(0).tolist(),
    ) == (
        5,
        "PSHELL",
        2.0,
        [1],
    )


def test_a_long_free_deck_reads_as_a_small_field_one(tmp_path: Path) -> None:
    """More lines than are cut at a time, with continuations and comments among them."""
    n = 70_000
    rng = np.random.default_rng(7)
    x = rng.integers(-9999, 9999, size=n)
    small = "".join(
        f"GRID    {i + 1:8d}        {v:7d}.{v / 1000:8.3f}      0.\n"
        for i, v in enumerate(x.tolist())
    )
    free = "".join(
        f"grid, {i + 1},,{v}.,{v / 1000:.3f}$ c,\n,,\n"
        for i, v in enumerate(x.tolist())
    )
    a, b = read(tmp_path, small)["GRID"], read(tmp_path, free)["GRID"]
    np.testing.assert_array_equal(
        a.stack("ID", "X1", "X2", "X3"), b.stack("ID", "X1", "X2", "X3")
    )
    np.testing.assert_array_equal(a["X2"], x / 1000)
    np.testing.assert_array_equal(b.line, 1 + 2 * np.arange(n))


def test_a_frame_through_points_on_one_line_is_named_with_its_place(
    tmp_path: Path,
) -> None:
    model = read(
        tmp_path,
        "BEGIN BULK\nCORD2R,6,,0.,0.,0.,1.,0.,0.\n,2.,0.,0.\nGRID,1,6,0.,0.,0.\n",
    )
    with pytest.raises(
        DeckError, match=r"main\.bdf:2: CORD2R 6: its three points lie on one line"
    ):
        positions(model)


def test_a_fluid_is_told_as_such(tmp_path: Path) -> None:
    square = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    corners = "".join(
        f"GRID,{11 + 4 * z + i},,{x},{y},{z}.\n"
        for z in (0, 1)
        for i, (x, y) in enumerate(square)
    )
    solid = "CHEXA,1,1,11,12,13,14,15,16\n+,17,18\nPSOLID,1,10,,,,,PFLUID\nMAT10,10,2.+9,1000.\n"
    with pytest.raises(
        DeckError, match=r"MAT10 makes a fluid \(fluids: give their mass"
    ):
        read(tmp_path, corners + solid)


def test_ids_of_more_than_eight_digits_are_written_in_large_fields(
    tmp_path: Path,
) -> None:
    rod = "GRID,123456789012,,1.,0.,0.\nCONROD,7,1,123456789012,1,.5\nMAT1,1,1.,,.3\n"
    model = read(tmp_path, NODES + rod)
    again = read(tmp_path, write_bulk(model))
    assert again["CONROD"]["G2"].tolist() == [123456789012]
    assert again["GRID"].ids.tolist() == model["GRID"].ids.tolist()
