"""Decks and files of results that once gave a traceback, a loop without end or a wrong answer:
tests/corpus/faults.
"""

from __future__ import annotations

import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from ringtrue.decks.nastran.deck import LIMITS, IncludeLimits, other_program
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.results.modes import read_recorded
from ringtrue.decks.nastran.results.printed import fatal_messages
from ringtrue.errors import DataError, DeckError, SolverFailed
from ringtrue.fem.assembly import assemble
from ringtrue.io.matrices import read_op4
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.runner import run_program

FAULTS = Path(__file__).parents[1] / "corpus" / "faults"
REFUSED = {
    "chexa_numbered_row_by_row.bdf": "CHEXA 1: inside out .* round one face, .* not row by row",
    "modulus_of_1e-300.bdf": r"MAT1 1 field E: 1e-300 is beyond .* 1e-50 to 1e\+50",
    "coordinate_of_1e308.bdf": r"GRID 2 field X1: 1.7e\+308 is beyond",
    "wtmass_of_1e-300.bdf": "PARAM WTMASS: 1e-300 is beyond",
    "ply_without_shear.bdf": "PCOMP 1: ply 1 has no stiffness in transverse shear",
    "ply_of_one_direction.bdf": "PCOMP 1: ply 1 has no stiffness in transverse shear",
    "modulus_below_zero.bdf": r"MAT1 1 field E: E is -2e\+11, below 0: it makes a negative stiffness",
    "frame_of_abaqus.inp": "this is a deck of Abaqus or CalculiX; ringtrue reads decks of Nastran",
    "frame_of_calculix.inp": "this is a deck of Abaqus or CalculiX",
    "frame_of_lsdyna.k": "this is a deck of LS-Dyna",
    "frame_of_ansys.cdb": "this is a deck of Ansys",
    "frame_of_ansys.inp": "this is a deck of Ansys",
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_faulty_deck_is_refused_by_name(name: str) -> None:
    with pytest.raises(DeckError, match=REFUSED[name]) as e:
        assemble(read_deck(FAULTS / "deck" / name))
    assert name in str(e.value)


def test_a_stiff_spring_holds_nothing_beside_it() -> None:
    model = read_deck(FAULTS / "deck" / "stiff_spring_beside_a_beam.bdf")
    with EmbeddedSolver().open(model) as analysis:
        assert not len(analysis.modes(ModesRequest(1)).autospc)


@pytest.mark.parametrize(
    "text",
    [
        b"SOL 103\nCEND\nBEGIN BULK\n",
        b"$ *NODE\nGRID,1,,0.,0.,0.\n",
        b"BEGIN BULK\n*N1,2.\n",
    ],
)
def test_decks_of_nastran_are_not_taken_for_others(text: bytes) -> None:
    assert not other_program(text)


def test_includes_that_double_at_each_step_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each file includes the next one twice: 2 ** 40 readings of the last."""
    monkeypatch.setattr("ringtrue.decks.nastran.deck.LIMITS", IncludeLimits(count=500))
    (tmp_path / "d.bdf").write_text("BEGIN BULK\nINCLUDE 'i0.inc'\n")
    for k in range(40):
        (tmp_path / f"i{k}.inc").write_text(f"INCLUDE 'i{k + 1}.inc'\n" * 2)
    (tmp_path / "i40.inc").write_text("GRID,1,,0.,0.,0.\n")
    with pytest.raises(DeckError, match="more than 500 INCLUDEs"):
        read_deck(tmp_path / "d.bdf")


@pytest.mark.parametrize("links", [LIMITS.depth - 2, LIMITS.depth + 2])
def test_includes_have_a_depth(tmp_path: Path, links: int) -> None:
    (tmp_path / "d.bdf").write_text("BEGIN BULK\nINCLUDE 'i0.inc'\n")
    for k in range(links):
        (tmp_path / f"i{k}.inc").write_text(f"INCLUDE 'i{k + 1}.inc'\n")
    (tmp_path / f"i{links}.inc").write_text("GRID,1,,0.,0.,0.\n")
    if links < LIMITS.depth:
        assert read_deck(tmp_path / "d.bdf")["GRID"].ids.tolist() == [1]
        return
    with pytest.raises(DeckError, match=f"more than {LIMITS.depth} deep"):
        read_deck(tmp_path / "d.bdf")


def test_what_is_included_again_has_a_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ringtrue.decks.nastran.deck.LIMITS", IncludeLimits(again=1000))
    (tmp_path / "d.bdf").write_text("BEGIN BULK\n" + "INCLUDE 'a.inc'\n" * 3)
    (tmp_path / "a.inc").write_text("$" + "x" * 400 + "\n")
    (tmp_path / "b.bdf").write_text("BEGIN BULK\n" + "INCLUDE 'a.inc'\n" * 4)
    with pytest.raises(
        DeckError, match="files that were included before make more than"
    ):
        read_deck(tmp_path / "b.bdf")
    assert not read_deck(tmp_path / "d.bdf").tables


@pytest.mark.parametrize(
    "path", sorted((FAULTS / "matrices").glob("*.op4")), ids=lambda p: p.stem
)
def test_damaged_op4_is_refused_in_time_and_memory(path: Path) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match="not an OUTPUT4 file, or cut short"):
            read_op4(path)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


def test_shapes_are_those_of_the_structure() -> None:
    """Beside the motion relative to a moved base (ROUGV1), and in the enhanced format of MSC."""
    names = ("relative_motion_first.op2", "enhanced_format.op2")
    one, two = (read_recorded(FAULTS / "results" / name) for name in names)
    np.testing.assert_array_equal(one.motion, two.motion)
    assert np.ptp(one.motion) > 1  # a rigid body's are all 1


def test_a_large_log_is_read_in_pieces(tmp_path: Path) -> None:
    """Its words are found where pieces of a megabyte meet, and its last lines are kept alone."""
    line = "0  USER INFORMATION MESSAGE 4157 (DFMSYN)  PARAMETERS\n"
    write = f"import sys; sys.stdout.write({line!r} * 40000); print('END OF JOB')"
    done = run_program([sys.executable, "-c", write], tmp_path, name="x", timeout=60.0)
    assert (tmp_path / "ringtrue.log").stat().st_size > 2_000_000
    assert len(done.log) < 100_000
    assert done.log.endswith("END OF JOB\n")
    full = (
        "import sys; sys.stdout.write('x' * (2 ** 20 - 7) + ' No space left on device ' + 'y' "
        "* 2 ** 20)"
    )
    with pytest.raises(SolverFailed, match="is full"):
        run_program([sys.executable, "-c", full], tmp_path, name="x", timeout=60.0)


def test_fatal_messages_where_pieces_meet(tmp_path: Path) -> None:
    line = b" USER INFORMATION MESSAGE\n"
    fatal = b"0*** USER FATAL MESSAGE 4276 (QOPEN)\n     ERROR CODE 1\n"
    for before in range(2**20 - 60, 2**20 + 30, 7):
        padded = line * (before // len(line))
        (tmp_path / "m.f06").write_bytes(
            padded
            + b" " * (before - len(padded))
            + b"\n"
            + fatal
            + line * 50000
            + fatal
        )
        found = fatal_messages(tmp_path / "m.f06")
        assert len(found) == 2
        assert all("4276" in f and "ERROR CODE 1" in f for f in found)
