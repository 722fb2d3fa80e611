"""Nastran by command: the decks it gets, and what becomes of what it does, on a stand-in that
solves its deck.
"""

from __future__ import annotations

import shutil
import sys
import time
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
from eigen_shell import parameters, shell

from ringtrue.cli.main import run
from ringtrue.core.parameters import CardField, Parameter, ParameterSet, Shape
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, SolverFailed, SolverMissing, UnsupportedError
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, table
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.nastran import (
    NastranSolver,
    design_cards,
    nastran_command,
    nastran_make,
    sensitivity_deck,
)
from ringtrue.solvers.registry import time_limits
from ringtrue.solvers.runner import modes_deck
from ringtrue.testing import check_modal_solver

STUB = Path(__file__).with_name("nastran_stub.py")


def stub(behaviour: str = "success", kind: str = "op2", **more) -> NastranSolver:
    return NastranSolver(
        command=f"{sys.executable} {STUB} {behaviour} {kind} {{deck}}", **more
    )


def turned(model: Model) -> Model:
    """The model with nodes 3 and 20 in a skew displacement frame."""
    grid = model["GRID"].with_column(
        "CD", np.where(np.isin(model["GRID"].ids, (3, 20)), 5, 0)
    )
    points = {"A": (0, 0, 0), "B": (1, 2, 3), "C": (1, -1, 0)}
    frame = table(
        "CORD2R",
        CID=[5],
        RID=[0],
        **{
            f"{p}{i}": [float(v)]
            for p, x in points.items()
            for i, v in zip("123", x, strict=True)
        },
    )
    return Model(
        {**model.tables, "GRID": grid, "CORD2R": frame}, model.params, model.case
    )


@pytest.mark.parametrize("kind", ["h5", "op2", "f06"])
def test_contract(kind: str) -> None:
    model = turned(shell(6, 4, clamped=True))
    result = check_modal_solver(stub(kind=kind), model, count=6)
    assert result.complete
    assert "by Nastran's Sturm count" in result.proof
    with EmbeddedSolver().open(model) as analysis:
        ours = analysis.modes(ModesRequest(6)).modes
    digits = {"h5": 1e-8, "op2": 1e-6, "f06": 1e-6}[
        kind
    ]  # as good as λ, single precision, seven figures
    np.testing.assert_allclose(
        result.modes.frequencies, ours.frequencies, rtol=10 * digits
    )
    sign = np.sign(np.einsum("dm,dm->m", result.modes.shapes, ours.shapes))
    np.testing.assert_allclose(
        result.modes.shapes * sign,
        ours.shapes,
        atol=1e2 * digits * np.abs(ours.shapes).max(),
    )


def test_derivatives_by_sol_200() -> None:
    """Factors on thickness and E (with its blank G), against the embedded solver's."""
    model = turned(shell(4, 3, clamped=True))
    both = (
        CardField("PSHELL", 1, "T"),
        CardField("PSHELL", 2, "T"),
    )  # a field in two parameters: its relation has C0
    chosen = ParameterSet((*parameters().parameters, Parameter("t", both)))
    with EmbeddedSolver().open(model) as analysis:
        modes = analysis.modes(ModesRequest(4)).modes
        ours = analysis.derivatives(modes, chosen)
    with stub(kind="h5").open(model) as analysis:
        theirs = analysis.derivatives(modes, chosen)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(
            b, a, atol=1e-5 * np.abs(a).max()
        )  # the stand-in differences, step 1e-3


def test_derivatives_to_places_of_nodes_by_sol_200() -> None:
    """A shape, and a coordinate in a cylindrical frame together with a thickness, against the
    embedded solver's.
    """
    model = turned(shell(4, 3, clamped=True))
    polar = table(
        "CORD2C",
        CID=[9],
        RID=[0],
        **{f"{p}{i + 1}": [v] for p, x in POINTS.items() for i, v in enumerate(x)},
    )
    grid = model["GRID"]
    at = grid.find(np.array([17]))
    x = positions(model)[at[0]]
    there = {
        "X1": np.hypot(x[0] + 1, x[1] + 1),
        "X2": np.degrees(np.arctan2(x[1] + 1, x[0] + 1)),
        "X3": x[2],
        "CP": 9,
    }
    for name, value in there.items():
        column = grid[name].copy()
        column[at] = value
        grid = grid.with_column(name, column)
    model = Model(
        {**model.tables, "GRID": grid, "CORD2C": polar}, model.params, model.case
    )
    bump = Shape((8, 13), ((0.02, 0.01, 0.05), (0.0, 0.0, 0.04)))
    radius = (
        CardField("GRID", 17, "X1", step=0.1),
        CardField("GRID", 17, "X2", step=5.0),
        CardField("PSHELL", 1, "T"),
    )
    chosen = ParameterSet(
        (Parameter("bump", shapes=(bump,)), Parameter("radius", radius))
    )
    with EmbeddedSolver().open(model) as analysis:
        modes = analysis.modes(ModesRequest(4)).modes
        ours = analysis.derivatives(modes, chosen)
    with stub(kind="h5").open(model) as analysis:
        theirs = analysis.derivatives(modes, chosen)
    assert (np.abs(ours[0]).max(axis=0) > 1e-3 * modes.frequencies.max()).all()
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(
            b, a, atol=5e-4 * np.abs(a).max()
        )  # the stand-in differences, step 1e-3


def test_derivatives_of_repeated_modes_are_refused() -> None:
    with stub().open(shell(4, 3)) as analysis:
        modes = analysis.modes(ModesRequest(7)).modes
        with pytest.raises(UnsupportedError, match="repeated modes"):
            analysis.derivatives(modes, parameters())


def test_fatal_error_with_exit_status_0() -> None:
    with (
        stub("fatal").open(shell(3, 2)) as analysis,
        pytest.raises(SolverFailed, match="EXCESSIVE PIVOT RATIOS"),
    ):
        analysis.modes(ModesRequest(3))


def test_a_hanging_program_is_ended() -> None:
    start = time.monotonic()
    with (
        stub("hang", timeout=4.0).open(shell(3, 2)) as analysis,
        pytest.raises(SolverFailed, match="within 4 s"),
    ):
        analysis.modes(ModesRequest(3))
    assert time.monotonic() - start < 60


def test_the_time_limit_of_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RINGTRUE_NASTRAN", f"{sys.executable} {STUB} hang op2 {{deck}}")
    deck = tmp_path / "beam.bdf"
    deck.write_text(
        "BEGIN BULK\nGRID,1,,0.,0.,0.,,123456\nGRID,2,,1.,0.,0.\nCBAR,1,1,1,2,0.,1.,0.\n"
        "PBAR,1,1,1.-4,1.-8,1.-8,2.-8\nMAT1,1,2.+11,,.3,7800.\nENDDATA\n"
    )
    start = time.monotonic()
    assert (
        run(["modes", str(deck), "-n", "2", "--solver", "nastran", "--time-limit", "2"])
        == 1
    )
    assert time.monotonic() - start < 60
    told = capsys.readouterr().err
    assert (
        "nastran did not end within 2 s and was stopped: give it longer by --time-limit SECONDS"
        in told
    )
    assert run(["modes", str(deck), "--time-limit", "2"]) == 2
    told = capsys.readouterr().err
    assert (
        "'embedded' has no time limit; those that have one: mystran, nastran, slepc"
        in told
    )
    assert run(["modes", str(deck), "--solver", "nastran", "--time-limit", "nan"]) == 2
    assert time_limits() == {"mystran": 3600.0, "nastran": 86400.0, "slepc": 86400.0}


def test_a_command_that_does_not_wait_is_told_to() -> None:
    with (
        stub("background").open(shell(3, 2)) as analysis,
        pytest.raises(SolverFailed, match=r"must wait .*bat=no"),
    ):
        analysis.modes(ModesRequest(3))


def test_a_full_disk_is_named() -> None:
    with (
        stub("full").open(shell(3, 2)) as analysis,
        pytest.raises(SolverFailed, match=r"disk .* is full"),
    ):
        analysis.modes(ModesRequest(3))


@pytest.mark.parametrize("kind", ["op2", "h5"])
def test_results_cut_off(kind: str) -> None:
    with (
        stub("cut", kind).open(shell(3, 2)) as analysis,
        pytest.raises(SolverFailed, match="wrote no modes"),
    ):
        analysis.modes(ModesRequest(3))


def test_no_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RINGTRUE_NASTRAN", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(SolverMissing, match="set RINGTRUE_NASTRAN"):
        NastranSolver().open(shell(3, 2))
    monkeypatch.setenv("RINGTRUE_NASTRAN", "nast20 scr=yes")
    assert nastran_command() == "nast20 scr=yes {deck}"
    with (
        NastranSolver().open(shell(3, 2)) as analysis,
        pytest.raises(SolverMissing, match="nast20 cannot be started"),
    ):
        analysis.modes(ModesRequest(3))
    monkeypatch.setenv("RINGTRUE_NASTRAN_MAKE", "nex")
    with pytest.raises(ConfigError, match="did you mean 'nx'"):
        nastran_make()


def test_folders_are_removed_or_kept(tmp_path: Path) -> None:
    with stub(keep=tmp_path).open(shell(3, 2)) as analysis:
        analysis.modes(ModesRequest(3))
        analysis.modes(ModesRequest(3))  # answered without a run
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["run1"]
    with stub().open(shell(3, 2)) as analysis:
        analysis.modes(ModesRequest(3))
        folder = analysis._folder
        assert folder.is_dir()
    assert not folder.exists()


def test_a_deck_reads_back_as_the_same_model(tmp_path: Path) -> None:
    model = turned(shell(3, 2, clamped=True))
    path = tmp_path / "m.bdf"
    path.write_text(modes_deck(model, ModesRequest(band=(0.0, 123.456)), stub()))
    again = read_deck(path)
    for card, before in model.tables.items():
        for name, column in before.columns.items():
            if isinstance(column, np.ndarray):
                same = (
                    np.allclose(again[card][name], column, rtol=1e-13, equal_nan=True)
                    if column.dtype.kind == "f"
                    else (again[card][name] == column).all()
                )
                assert same, f"{card} {name}"
    assert again.case.spc == 1
    assert again["EIGRL"]["V2"].tolist() == [123.456]
    assert np.isnan(again["EIGRL"]["V1"]).all()


def test_fields_that_sol_200_has_not() -> None:
    model = shell(3, 2)
    grids = np.empty(0, dtype=np.int64)
    for target, why in (
        (CardField("CQUAD4", 3, "THETA"), "cannot be a design variable"),
        (CardField("PSHELL", 1, "NSM"), "is 0"),
    ):
        with pytest.raises(UnsupportedError, match=why):
            sensitivity_deck(
                model, stub(), ParameterSet((Parameter("p", (target,)),)), 3, grids
            )


POINTS = {"A": (-1.0, -1.0, 0.0), "B": (-1.0, -1.0, 1.0), "C": (0.0, -1.0, 0.0)}
CARDS = """MAT8,8,1.+11,1.+10,.3,5.+9
PCOMP,9
+,8,.1,30.,,8,.2,60.
PCOMPG,19
+,70,8,.1,30.
+,71,8,.2,60.
PSHELL,10,8,.1,8,1.2,,.8
PELAS,11,5.,.1
PMASS,12,3.
PBUSH,13,K,1.
+,,GE,.1
PDAMP,14,2.
PVISC,15,1.,2.
CONROD,16,1,2,17,.1
MAT1,17,1.,,.3
GRID,1
GRID,2,,1.
CONM1,18,1,,2.
"""


@pytest.mark.parametrize(
    ("target", "head"),
    [
        (CardField("MAT8", 8, "G12"), "DVMREL1 1 MAT8 8 G12"),
        (CardField("PCOMP", 9, "T2"), "DVPREL1 1 PCOMP 9 T2"),
        (CardField("PCOMP", 9, "THETA1"), "DVPREL1 1 PCOMP 9 THETA1"),
        (CardField("PCOMPG", 19, "T2"), "DVPREL1 1 PCOMP 19 T2"),
        (CardField("PSHELL", 10, "I12T3"), "DVPREL1 1 PSHELL 10 6"),
        (CardField("PSHELL", 10, "TST"), "DVPREL1 1 PSHELL 10 8"),
        (CardField("PELAS", 11, "K"), "DVPREL1 1 PELAS 11 3"),
        (CardField("PMASS", 12, "M"), "DVPREL1 1 PMASS 12 3"),
        (CardField("PBUSH", 13, "GE"), "DVPREL1 1 PBUSH 13 GE1"),
        (CardField("PDAMP", 14, "B"), "DVPREL1 1 PDAMP 14 3"),
        (CardField("PVISC", 15, "CR"), "DVPREL1 1 PVISC 15 4"),
        (CardField("CONROD", 16, "A"), "DVCREL1 1 CONROD 16 A"),
        (CardField("CONM1", 18, "M11"), "DVCREL1 1 CONM1 18 M11"),
    ],
)
def test_names_of_design_fields(tmp_path: Path, target: CardField, head: str) -> None:
    """A name that begins with a digit may stand by its field number only (Quick Reference Guide,
    DVPREL1).
    """
    (tmp_path / "m.bdf").write_text(CARDS)
    _, cards = design_cards(
        read_deck(tmp_path / "m.bdf"), ParameterSet((Parameter("p", (target,)),))
    )
    relation = next(
        line for line in cards.splitlines() if line.startswith("DV") and "REL1" in line
    )
    assert " ".join(relation.replace("*", " ").split()) == head


def test_decks_parse_in_pynastran(tmp_path: Path) -> None:
    """An independent reader of Nastran decks accepts SOL 103 and SOL 200."""
    bdf = pytest.importorskip(
        "pyNastran.bdf.bdf", reason="pyNastran is not installed", exc_type=ImportError
    )
    model = turned(shell(3, 2, clamped=True))
    decks = {
        "SOL103.bdf": modes_deck(model, ModesRequest(5), stub()),
        "SOL200.bdf": sensitivity_deck(
            model, stub(), parameters(), 3, np.asarray(model["GRID"].ids)
        ),
    }
    for name, text in decks.items():
        (tmp_path / name).write_text(text)
        read = bdf.BDF(debug=False)
        read.read_bdf(tmp_path / name, xref=True)
        assert len(read.nodes) == len(model["GRID"])
    assert len(read.desvars) == 3
    assert {r.response_type for r in read.dresps.values()} == {"EIGN", "DISP"}
