"""What case control chooses, what holds without it, and files that are put together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.checks.deck import check_deck
from ringtrue.decks.nastran.reader import read_deck, survey
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.model.case_control import asked_modes
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

SPRING = "GRID,1,,,,,,23456\nCONM2,2,1,,4.\nCELAS2,3,9.,1,1\n"


def write(folder: Path, text: str, name: str = "main.bdf") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def frequencies(path: Path) -> list[float]:
    with EmbeddedSolver().open(read_deck(path)) as analysis:
        return [float(f) for f in analysis.modes(ModesRequest(4)).modes.frequencies]


def test_a_file_name_broken_at_a_blank(tmp_path: Path) -> None:
    write(tmp_path, SPRING, "nodes of/the wing.bdf")
    path = write(tmp_path, "INCLUDE 'nodes of/the\n  wing.bdf'\n")
    assert frequencies(path) == pytest.approx([1.5 / (2 * np.pi)])


def test_a_file_name_in_another_case(tmp_path: Path) -> None:
    write(tmp_path, SPRING, "Wing/Nodes.bdf")
    assert frequencies(write(tmp_path, "INCLUDE 'WING\\nodes.BDF'\n")) == pytest.approx(
        [1.5 / (2 * np.pi)]
    )
    write(tmp_path, SPRING, "Wing/NODES.bdf")
    with pytest.raises(DeckError, match="is not there"):
        read_deck(write(tmp_path, "INCLUDE 'wing/nodes.bdf'\n"))


def test_scalar_points_alone_are_a_model(tmp_path: Path) -> None:
    """Two masses 2 and 1 on springs 50 to ground and 100 between them."""
    path = write(
        tmp_path,
        "SPOINT,1,2\nCELAS2,1,100.,1,,2\nCELAS4,2,50.,1\nCMASS4,3,2.,1\nCMASS2,4,1.,2\n",
    )
    lam = np.linalg.eigvals(np.array([[75.0, -50.0], [-100.0, 100.0]]))
    assert frequencies(path) == pytest.approx(np.sqrt(np.sort(lam)) / (2 * np.pi))


SETS = "GRID,1\nCONM2,2,1,,4.\nCELAS2,3,9.,1,1\nSPC1,5,2356,1\nSPC,6,1,4,0.\n"


@pytest.mark.parametrize(
    ("case", "more", "held"),
    [
        ("SPC = 5\nBEGIN BULK\n", "", {2, 3, 5, 6}),
        ("spc 5 $ blank\nBEGIN BULK\n", "", {2, 3, 5, 6}),
        ("SPC = 8\nBEGIN BULK\n", "SPCADD,8,5,6\n", {2, 3, 4, 5, 6}),
        ("", "SPCADD,8,5,6\n", {2, 3, 4, 5, 6}),
        # goes before the set of its own number
        ("SPC = 5\nBEGIN BULK\n", "SPCADD,5,6\n", {4}),
    ],
)
def test_sets_that_hold(tmp_path: Path, case: str, more: str, held: set[int]) -> None:
    system = assemble(
        read_deck(write(tmp_path, "PARAM,AUTOSPC,NO\n" + case + SETS + more))
    )
    assert set(range(1, 7)) - set(system.free.direction.tolist()) == held


def test_the_only_sets_hold_without_case_control(tmp_path: Path) -> None:
    """A spring of 9 on a mass of 4, which moves twice as far as the spring."""
    deck = "GRID,1\nGRID,2\nCONM2,2,2,,4.\nCELAS2,3,9.,1,1\nSPC1,5,23456,1,2\nMPC,7,2,1,1.,1,1,-2.\n"
    assert frequencies(write(tmp_path, deck)) == pytest.approx([0.75 / (2 * np.pi)])


def test_sets_that_are_not_clear_are_refused(tmp_path: Path) -> None:
    both = write(tmp_path, SETS)
    with pytest.raises(DeckError, match="which of the SPC sets 5, 6 holds"):
        read_deck(both)
    assert [str(f) for f in survey(both).faults] == [str(both) + ": " + _UNCLEAR]
    with pytest.raises(DeckError, match="asks for SPC = 9; the deck has 5, 6"):
        read_deck(write(tmp_path, "SPC = 9\nBEGIN BULK\n" + SETS))


_UNCLEAR = "without case control, which of the SPC sets 5, 6 holds? Write SPC = n above BEGIN BULK"


def test_a_choice_of_what_the_deck_has_none_of_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    model = read_deck(write(tmp_path, "SPC = 5\nMPC = 9\nBEGIN BULK\n" + SETS))
    assert "asks for MPC = 9: the deck has no MPC" in caplog.text
    assert [f.text for f in check_deck(model).findings if "asks for" in f.text] == [
        "case control asks for MPC = 9: the deck has no MPC"
    ]


def test_words_as_values_of_params(tmp_path: Path) -> None:
    model = read_deck(
        write(
            tmp_path,
            "PARAM,COUPMASS,YES\nPARAM,K6ROT,NO\nPARAM,WTMASS\nPARAM,SNORM,ON\n"
            + SPRING,
        )
    )
    assert (
        model.param("COUPMASS", -1),
        model.param("K6ROT", 100.0),
        model.param("G", 0.5),
    ) == (
        1.0,
        0.0,
        0.5,
    )
    for name in ("WTMASS", "SNORM"):
        with pytest.raises(
            DeckError, match=rf"main\.bdf: PARAM field {name}: '.*' is not a number"
        ):
            model.param(name, 1.0)


def test_another_subcase_with_modes_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    case = (
        "CEND\nMETHOD = 1\nSUBCASE 1\n SPC = 5\nSUBCASE 2\n LABEL = b\n SPC=5\nSUBCASE= 7\n "
        "SPC = 6\nBEGIN BULK\n"
    )
    model = read_deck(write(tmp_path, case + SETS))
    assert (model.case.spc, model.case.others) == (5, (7,))
    assert "SUBCASE [7]" in caplog.text
    assert any("SUBCASE 7: not taken" in f.text for f in check_deck(model).findings)
    static = read_deck(
        write(
            tmp_path,
            case.replace("METHOD = 1\n", "").replace("LABEL = b", "METHOD = 1") + SETS,
        )
    )
    assert (static.case.spc, static.case.others) == (5, ())


def test_sets_that_nothing_chooses_are_told(tmp_path: Path) -> None:
    model = read_deck(write(tmp_path, "CEND\nMETHOD = 1\nBEGIN BULK\n" + SETS))
    told = [
        f.text
        for f in check_deck(model).findings
        if "case control chooses no SPC" in f.text
    ]
    assert len(told) == 2


def test_a_choice_that_is_no_number_is_refused(tmp_path: Path) -> None:
    """SPC = ALL held nothing."""
    for kind in ("SPC", "MPC", "NSM"):
        with pytest.raises(
            DeckError,
            match=f"{kind} = ALL in case control: it must be the number of a set",
        ):
            read_deck(write(tmp_path, f"CEND\n{kind} = ALL\nBEGIN BULK\n{SPRING}"))


@pytest.mark.parametrize(
    ("last", "told"),
    [
        (
            "MPC,1,3,1,1.,1,1,-2.",
            "run in a circle: MPC 1 of line 7, MPC 1 of line 8, MPC 1 of line 9; make one",
        ),
        (
            "MPC,1,1,1,1.,3,1,-2.",
            r"DOF 1\+X is dependent more than once \(MPC 1 of line 7, MPC 1 of line 9\)",
        ),
    ],
)
def test_equations_that_contradict_have_their_lines(
    tmp_path: Path, last: str, told: str
) -> None:
    nodes = "GRID,1\nGRID,2,,1.\nGRID,3,,2.\n"
    text = f"CEND\nMPC = 1\nBEGIN BULK\n{nodes}MPC,1,1,1,1.,2,1,-1.\nMPC,1,2,1,1.,3,1,-1.\n{last}\n"
    with pytest.raises(DeckError, match=rf":9: MPC 1: .*{told}"):
        assemble(read_deck(write(tmp_path, text)))


@pytest.mark.parametrize(
    ("taken", "card"),
    [
        ("SPC = 8", "SPC1,8,2,77"),
        ("SPC = 8", "SPC,8,77,2"),
        ("MPC = 8", "MPC,8,77,2,1.,1,2,-1."),
        ("K2GG = KX", "DMIG,KX,0,6,1,0\nDMIG,KX,77,2,,77,2,5."),
    ],
)
def test_what_case_control_does_not_take_may_name_nodes_that_are_not_there(
    tmp_path: Path, taken: str, card: str
) -> None:
    path = write(tmp_path, f"CEND\nMETHOD = 1\nBEGIN BULK\n{SPRING}{card}\n")
    assert frequencies(path) == pytest.approx([1.5 / (2 * np.pi)])
    assert any(
        "77: not there" in f.text and f.severity == "warning"
        for f in check_deck(survey(path).model).findings
    )
    with pytest.raises(
        DeckError, match="names GRID or SPOINT 77, which is not in the deck"
    ):
        read_deck(write(tmp_path, f"CEND\n{taken}\nBEGIN BULK\n{SPRING}{card}\n"))


def test_what_a_check_says_of_sets_and_reductions(tmp_path: Path) -> None:
    model = read_deck(
        write(tmp_path, "SPC = 8\nBEGIN BULK\n" + SETS + "SPCADD,8,5,7\nASET1,1,1\n")
    )
    told = {
        f.severity: f
        for f in check_deck(model).findings
        if "SPCADD" in f.text or "ASET1" in f.text
    }
    assert told["warning"].line == 8
    assert "not in the deck" in told["warning"].text
    assert told["info"].text.startswith("ASET1: ringtrue modes and frf condense")


@pytest.mark.parametrize(
    ("case", "bulk", "told"),
    [
        ("K2PP = KA, KB", "", "K2PP acts on responses (ringtrue frf), not on modes"),
        ("K42GG = KA", "", "case control asks for K42GG = KA: it is left out"),
        ("TFL = 3", "", "case control asks for TFL = 3: it is left out"),
        (
            "M2GG = MX",
            "DMIG,KX,0,6,1,0\nDMIG,KX,1,3,,1,3,5.",
            "DMIG KX: it adds nothing",
        ),
        (
            "SPC = 5",
            "GRID,9,,1.,0.,0.,,,2",
            "superelements: ringtrue modes and frf condense",
        ),
        (
            "SPC = 5",
            "ROTORG,1,1,2",
            "ROTORG: kept, not applied: the modes are those at rest",
        ),
        (
            "SPC = 5",
            "CYSYM,6,ROT",
            "CYSYM: kept, not applied: the modes are those of this segment alone",
        ),
    ],
)
def test_what_is_kept_and_left_out_is_told(
    tmp_path: Path, case: str, bulk: str, told: str
) -> None:
    model = read_deck(write(tmp_path, f"CEND\n{case}\nBEGIN BULK\n{SPRING}{bulk}\n"))
    assert any(told in f.text for f in check_deck(model).findings)


@pytest.mark.parametrize(
    ("card", "told"),
    [("EIGRL,7,,,9", False), ("EIGR,7,LAN,,,,9", False), ("EIGRL,8,,,9", True)],
)
def test_a_method_that_is_not_there_is_told(
    tmp_path: Path, card: str, told: bool, caplog: pytest.LogCaptureFixture
) -> None:
    model = read_deck(
        write(tmp_path, f"CEND\nMETHOD = 7\nBEGIN BULK\n{SPRING}{card}\n")
    )
    text = (
        "case control asks for METHOD = 7: the deck has no EIGRL or EIGR of that number"
    )
    assert any(text in f.text for f in check_deck(model).findings) == told
    assert (text in caplog.text) == told


def test_matrices_that_are_chosen_or_loads_are_not_called_idle(tmp_path: Path) -> None:
    bulk = "DMIG,KX,0,6,1,0\nDMIG,KX,1,3,,1,3,5.\nDMIG,P,0,9,1,0,,,1\nDMIG,P,1,,,1,3,5."
    model = read_deck(write(tmp_path, f"CEND\nK2GG = KX\nBEGIN BULK\n{SPRING}{bulk}\n"))
    assert not [f.text for f in check_deck(model).findings if "DMIG" in f.text]


@pytest.mark.parametrize(
    ("command", "card"),
    [
        ("BGSET = 1", "BGSET,1,2,3"),
        ("BCSET = 1", "BCTSET,1,2,3"),
        ("BCONTACT = 1", "BCBODY1,1"),
        ("STATSUB(PRELOAD) = 1", "FORCE,1,1,,9.,1."),
        ("STATSUB = 1", "BOLTFOR,4,100.,1"),
        ("NLIC STEP 1", "FORCE,1,1,,9.,1."),
    ],
)
def test_glue_contact_and_preload_that_are_chosen_stop(
    tmp_path: Path, command: str, card: str
) -> None:
    bulk = "BEGIN BULK\n" + SPRING + card + "\n"
    assert read_deck(write(tmp_path, "CEND\n" + bulk)).kept == {card.split(",")[0]: 1}
    with pytest.raises(UnsupportedCard, match=rf"main\.bdf:7: {card.split(',')[0]}"):
        read_deck(write(tmp_path, f"CEND\n{command}\n" + bulk))


@pytest.mark.parametrize("solution", ["SOL 182", "SOL LINEAR PRESTRESS MODAL"])
def test_solutions_under_load_stop_at_the_load(tmp_path: Path, solution: str) -> None:
    bulk = f"CEND\nLOAD = 1\nBEGIN BULK\n{SPRING}FORCE,1,1,,9.,1.\n"
    assert read_deck(write(tmp_path, "SOL 103\n" + bulk)).kept == {"FORCE": 1}
    with pytest.raises(UnsupportedCard, match=r"main\.bdf:8: FORCE .* preload"):
        read_deck(write(tmp_path, f"{solution}\n{bulk}"))


def test_a_bolt_that_joins_two_parts_stops_and_one_that_lists_elements_does_not(
    tmp_path: Path,
) -> None:
    assert read_deck(write(tmp_path, f"BEGIN BULK\n{SPRING}BOLT,1,1,5\n")).kept == {
        "BOLT": 1
    }
    with pytest.raises(UnsupportedCard, match=r"main\.bdf:5: BOLT .* shared nodes"):
        read_deck(
            write(tmp_path, f"BEGIN BULK\n{SPRING}BOLT,1,9\n,TOP,1,2\n,BOTTOM,3,4\n")
        )


def test_commands_that_are_skipped_do_not_count(tmp_path: Path) -> None:
    top = "CEND\nSPC = 1\nSKIPON\nSPC = 2\nMPC = 3\nSKIPOFF\nMETHOD = 4\n"
    case = read_deck(
        write(tmp_path, f"{top}BEGIN BULK\n{SPRING}SPC1,1,1,1\nEIGRL,4,,,1\n")
    ).case
    assert (case.spc, case.mpc, case.method) == (1, 0, 4)
    with pytest.raises(UnsupportedCard, match="SKIPON"):
        read_deck(
            write(tmp_path, f"BEGIN BULK\n{SPRING}SKIPON\nCELAS2,9,1.,1,1\nSKIPOFF\n")
        )


def test_a_point_that_is_a_node_too_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        DeckError, match=r"main\.bdf:5: SPOINT: 1 is the number of a GRID, too"
    ):
        read_deck(write(tmp_path, f"BEGIN BULK\n{SPRING}SPOINT,9,1\n"))


def test_what_no_answer_holds_is_said_by_every_command(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_deck(write(tmp_path, f"CEND\nA2GG = KX\nBEGIN BULK\n{SPRING}CYJOIN,1,,1\n"))
    assert "A2GG = KX: it is left out" in caplog.text
    assert (
        "CYJOIN: kept, not applied: the modes are those of this segment alone"
        in caplog.text
    )


CHAIN = "SPOINT,1,THRU,9\n" + "".join(
    f"CELAS4,{i},{1e4 * i * i},{i}\nCMASS4,{10 + i},1.,{i}\n" for i in range(1, 10)
)  # oscillators of 100 i rad/s
UNIT = 50 / np.pi


@pytest.mark.parametrize(
    ("card", "wanted"),
    [
        ("EIGRL,7,,,3", [1, 2, 3]),
        (f"EIGRL,7,{1.5 * UNIT},{5.5 * UNIT}", [2, 3, 4, 5]),
        (f"EIGRL,7,{1.5 * UNIT},,3", [2, 3, 4]),
        (f"EIGRL,7,{-1.0},{4.5 * UNIT},9,,,,MAX", [1, 2, 3, 4]),
        (f"EIGRL,7,{1.5 * UNIT},1.+9,3\n+,NUMS=2", [2, 3, 4]),
        (f"EIGR,7,LAN,{1.5 * UNIT},{3.5 * UNIT}", [2, 3]),
        (f"EIGR,7,SINV,0.,{8.5 * UNIT},,4\n+,MAX", [1, 2, 3, 4]),
        (
            f"EIGR,7,MGIV,0.,{0.1 * UNIT},,3\n+,MAX",
            [1, 2, 3],
        ),  # their range counts where ND is blank
        (f"EIGR,7,HOU,0.,{2.5 * UNIT}", [1, 2]),
        (f"EIGRA,7,{1.5 * UNIT},{5.5 * UNIT}", [2, 3, 4, 5]),
        ("EIGRA,7,,,3", [1, 2, 3]),
        ("EIGRL,7", None),
        ("EIGRL,8,,,3", None),
    ],
)
def test_the_modes_that_the_method_asks_for(
    tmp_path: Path, card: str, wanted: list[int] | None
) -> None:
    model = read_deck(write(tmp_path, f"CEND\nMETHOD = 7\nBEGIN BULK\n{card}\n{CHAIN}"))
    asked = asked_modes(model)
    assert (asked is None) == (wanted is None)
    if asked and wanted:
        with EmbeddedSolver().open(model) as analysis:
            found = asked.of(analysis.modes)
        assert found.modes.frequencies / UNIT == pytest.approx(wanted)
        assert found.residuals.size == len(wanted)
