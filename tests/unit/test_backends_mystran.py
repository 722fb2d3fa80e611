"""MYSTRAN, run for real, beside recorded results of MSC Nastran; skipped, saying so, where it is
not installed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
from eigen_shell import shell
from fem_cases import cards, grid, steel
from solid_meshes import box, cut, elements, kind, psolid

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.results.modes import read_nastran_modes
from ringtrue.errors import SolverFailed, SolverMissing
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.mystran import MystranSolver, find_mystran
from ringtrue.solvers.runner import modes_deck, run_program

DATA = Path(__file__).parents[3] / "shared" / "data" / "fe"


@pytest.fixture
def installed() -> None:
    try:
        find_mystran()
    except SolverMissing as e:
        pytest.skip(str(e))


@pytest.mark.solver
@pytest.mark.data
@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("deck", "frequencies"),
    [
        (
            "msc2019/superelements/cantilever_bar/no_super/noReduction.dat",
            (349.729, 2167.32, 6007.803, 11650.23),
        ),
        (
            "msc2019/system_verification/003_svanberg_bar/nastran_runs/modes.dat",
            (46.46440, 146.9333, 279.0229),
        ),
    ],
)
def test_against_recorded_msc_results(
    deck: str, frequencies: tuple[float, ...]
) -> None:
    if not (DATA / deck).is_file():
        pytest.skip(f"reference data not found: {DATA / deck}")
    with MystranSolver().open(read_deck(DATA / deck)) as analysis:
        found = analysis.modes(ModesRequest(len(frequencies))).modes
    np.testing.assert_allclose(
        found.frequencies, frequencies, rtol=1e-3
    )  # its bar masses differ a little


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("place", ["", ",0.5", ",0.25", ",,0,1.,2.,3."])
def test_bushes_between_nodes_apart_have_their_place(
    tmp_path: Path, place: str
) -> None:
    """Three in a row of 10 each, with their springs half way, at a quarter, or where S1 to S3
    say.
    """
    path = tmp_path / "a.bdf"
    lines = [f"GRID,{i + 1},,0.,0.,{10.0 * i}\n" for i in range(4)]
    lines += [f"CBUSH,{i},1,{i},{i + 1},1.,0.,0.\n{place}\n" for i in (1, 2, 3)]
    lines += [f"CONM2,{10 + i},{i},,1.\n,1.,,1.,,,1.\n" for i in (2, 3, 4)]
    path.write_text(
        "".join(lines) + "PBUSH,1,K,100.,200.,300.,400.,500.,600.\nSPC1,1,123456,1\n"
    )
    found = []
    for engine in (EmbeddedSolver(), MystranSolver()):
        with engine.open(read_deck(path)) as analysis:
            found.append(analysis.modes(ModesRequest(6)).modes.frequencies)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("coupled", ["", "PARAM,COUPMASS,1\n"])
def test_coupled_mass_is_lumped_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, coupled: str
) -> None:
    path = tmp_path / "a.bdf"
    path.write_text(GROUNDED.replace("ENDDATA\n", coupled + "ENDDATA\n"))
    with MystranSolver().open(read_deck(path)) as analysis:
        analysis.modes(ModesRequest(2))
    assert ("lumps all masses" in caplog.text) == bool(coupled)


GROUNDED = """BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,7,,2.,0.,0.
CBAR,1,1,1,2,0.,0.,1.
CBAR,2,1,2,7,0.,0.,1.
PBAR,1,1,1.-2,1.-5,1.-5,1.-5
MAT1,1,2.+11,,.3,7850.
CBUSH,12,2,7,,,,,0
PBUSH,2,K,1.+6,1.+6,1.+6,1.+5,1.+5,1.+5
CELAS1,13,3,1,2
PELAS,3,2.+6
CELAS2,14,1.+6,1,3
ENDDATA
"""


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_springs_to_the_ground_get_a_second_node(tmp_path: Path) -> None:
    """MYSTRAN refuses a CELAS1, CELAS2 or CBUSH with one node; the nodes that are added are in no
    result.
    """
    (tmp_path / "bar.bdf").write_text(GROUNDED)
    model = read_deck(tmp_path / "bar.bdf")
    with MystranSolver().open(model) as analysis, EmbeddedSolver().open(model) as own:
        found, want = (
            analysis.modes(ModesRequest(5)).modes,
            own.modes(ModesRequest(5)).modes,
        )
    assert found.labels.node.tolist() == want.labels.node.tolist()
    np.testing.assert_allclose(
        found.frequencies, want.frequencies, rtol=1e-3
    )  # its bar masses differ a little


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("name", ["CTETRA10", "CPENTA15", "CHEXA", "CHEXA20"])
def test_solids_get_their_integration_written_out(name: str) -> None:
    """A steel beam on a clamped face: MYSTRAN refuses a PSOLID with blanks, or one that the element
    does not take.
    """
    xyz, nodes = cut(name, *box(6, 2, 2, (1.0, 0.2, 0.15)))
    clamped = np.where(xyz[:, 0] == 0, "123456", "")
    solid = elements(kind(name)[0], nodes)
    m = Model({t.card: t for t in (grid(xyz, PS=clamped), solid, psolid(), steel())})
    with MystranSolver().open(m) as analysis, EmbeddedSolver().open(m) as own:
        found, want = (
            analysis.modes(ModesRequest(2)).modes,
            own.modes(ModesRequest(2)).modes,
        )
    np.testing.assert_allclose(
        found.frequencies, want.frequencies, rtol=0.04
    )  # other elements, six along the beam


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_a_free_shell_with_drilling_and_a_mass_by_its_place() -> None:
    """MYSTRAN holds rotations to the ground by K6ROT, and knows no CID -1 of a CONM2."""
    m = shell(5, 3)
    mass = cards(
        "CONM2", EID=[900], G=[2], CID=[-1], M=[30.0], X1=[0.3], X2=[0.5], X3=[0.4]
    )
    m = Model({**m.tables, "CONM2": mass}, {"K6ROT": 100.0})
    own, handed = assemble(m), assemble(MystranSolver().adapted(m))
    assert abs(own.mass - handed.mass).max() < 1e-12
    with MystranSolver().open(m) as analysis:
        found = analysis.modes(ModesRequest(7)).modes
    assert np.abs(found.frequencies[:6]).max() < 0.01 < found.frequencies[6]


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_a_fatal_deck_is_an_error_although_it_exits_with_0() -> None:
    lost = shell(3, 2)
    lost = Model(
        {
            **lost.tables,
            "PSHELL": lost["PSHELL"].with_column("MID1", np.array([1, 2, 99])),
        }
    )
    with MystranSolver().open(shell(3, 2)) as analysis:
        deck = modes_deck(lost, ModesRequest(3), MystranSolver())
        with pytest.raises(SolverFailed, match="99"):
            analysis.run(deck)


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_its_two_files_agree(tmp_path: Path) -> None:
    with MystranSolver(keep=tmp_path).open(shell(4, 3, clamped=True)) as analysis:
        analysis.modes(ModesRequest(4))
    run = tmp_path / "run1"
    f06, op2 = (
        read_nastran_modes(run / f"model.{e}", mass_normalised=True)
        for e in ("F06", "OP2")
    )
    np.testing.assert_allclose(op2.frequencies, f06.frequencies, rtol=1e-6)
    np.testing.assert_allclose(
        op2.shapes, f06.shapes, atol=1e-6 * np.abs(f06.shapes).max()
    )


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_a_missing_deck_does_not_wait_for_the_keyboard(tmp_path: Path) -> None:
    done = run_program(
        [find_mystran(), "no.bdf"], tmp_path, name="mystran", timeout=20.0
    )
    assert not done.files(".op2")


def test_not_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RINGTRUE_MYSTRAN", str(tmp_path))
    with pytest.raises(SolverMissing, match="no program there"):
        MystranSolver().open(shell(3, 2))
