"""`ringtrue update` on the three-storey frame: factors found, deck edited, verdict, resumption, and
refusals.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_study

from ringtrue.checks.materials import whole_mass
from ringtrue.cli.main import run
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.response import frf
from ringtrue.io.frfs import write_frfs
from ringtrue.io.modes import read_modes, write_modes
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study import direct
from ringtrue.study.objective import Minimisation
from ringtrue.updating.problem import Problem
from ringtrue.updating.strategy import Verified

STUDY = '[model]\ndeck = "frame.bdf"\n' + "".join(
    f'[[candidate]]\nname = "storey {i}"\ntargets = ["MAT1 {i} E"]\n'
    for i in small_study.TRUTH
)
READ = ("303+X", "203+X", "103+X")

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "frame.bdf").write_text(small_study.deck())
    (tmp_path / "truth.bdf").write_text(small_study.deck(small_study.TRUTH))
    (tmp_path / "study.toml").write_text(STUDY)
    with EmbeddedSolver().open(read_deck(tmp_path / "truth.bdf")) as analysis:
        modes = analysis.modes(ModesRequest(9)).modes
    seen = modes.rows(small_study.test_model().channels)
    write_modes(tmp_path / "test.json", replace(seen, damping=np.full(9, 0.01)))
    return tmp_path


def call(capsys: Capture, folder: Path, *words: str) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run(
        ["update", str(folder / "study.toml"), str(folder / "test.json"), *words]
    )
    out, err = capsys.readouterr()
    return status, out, err


def test_factors_are_found_and_the_deck_is_edited(
    capsys: Capture, folder: Path
) -> None:
    status, out, err = call(
        capsys, folder, "--leave-out", "3,7", "--out", str(folder / "up"), "--json", "-"
    )
    assert status == 0, err
    found = json.loads(out)
    factors = [p["factor"] for p in found["parameters"]]
    np.testing.assert_allclose(
        factors, list(small_study.TRUTH.values()), rtol=0.01
    )  # the prior pulls
    assert found["basis_error"] < 1e-4
    assert [m["used"] for m in found["modes"]].count(False) == 2
    for m in found["modes"]:
        assert abs(m["deviation_percent"]) < 0.1
    updated = read_deck(folder / "up" / "frame.bdf")
    moduli = updated["MAT1"]["E"][
        updated["MAT1"].find(np.array(list(small_study.TRUTH)))
    ]
    np.testing.assert_allclose(moduli, 2e11 * np.array(factors), rtol=1e-5)


@pytest.mark.parametrize(
    "settings",
    [
        'prior = "evidence"\nloss = "huber"\n',
        "starts = 3\n",
        'residuals = ["frequencies", "mac"]\n',
    ],
)
def test_settings_lead_to_the_same_factors(
    capsys: Capture, folder: Path, settings: str
) -> None:
    (folder / "study.toml").write_text(f'{STUDY}[update]\nwrite = "all"\n{settings}')
    status, out, err = call(capsys, folder, "--seed", "1", "--json", "-")
    assert status == 0, err
    factors = [p["factor"] for p in json.loads(out)["parameters"]]
    np.testing.assert_allclose(factors, list(small_study.TRUTH.values()), rtol=0.01)


def test_an_end_that_lost_modes_gives_way_to_a_lower_one_of_further_starts(
    capsys: Capture, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    well = direct._minimised

    def poor(problem: Problem, how: Minimisation, progress: Progress) -> Verified:
        """From the deck alone, as if it had ended there without any pair."""
        done = well(problem, how, progress)
        if how.settings.starts > 1:
            return done
        c, x = problem.configurations[0], 0 * done.solution.x
        none = replace(
            c, target=replace(c.target, fixed=(np.zeros((0, 2), dtype=np.int64), ()))
        )
        end = replace(problem, configurations=(none,)).evaluate(x)
        return replace(
            done,
            solution=replace(done.solution, x=x, y=x, factors=x + 1, history=(end,)),
        )

    monkeypatch.setattr(direct, "_minimised", poor)
    status, out, err = call(capsys, folder, "--json", "-")
    assert status == 0, err
    factors = [p["factor"] for p in json.loads(out)["parameters"]]
    np.testing.assert_allclose(factors, list(small_study.TRUTH.values()), rtol=0.01)


def test_starts_on_two_workers_end_where_those_of_one_process_do(
    capsys: Capture, folder: Path
) -> None:
    (folder / "study.toml").write_text(f"{STUDY}[update]\nstarts = 3\n")
    one = call(capsys, folder, "--json", "-")
    status, out, err = call(capsys, folder, "--workers", "2", "--json", "-")
    assert (status, out) == one[:2]
    assert "side by side on 2 workers: start 1 of 3, start 2 of 3, start 3 of 3" in err
    status, _, err = call(capsys, folder, "--workers", "two")
    assert status == 2
    assert "workers 'two': a number of processes from 1 on, or the address" in " ".join(
        err.split()
    )


def test_what_no_parameter_mends_is_said_and_ends_with_status_1(
    capsys: Capture, folder: Path
) -> None:
    """Frequencies 4 % off in turns, of which the study states 1 %; it is enough to state 5 %."""
    whole = read_modes(folder / "test.json")
    off = 1 + 0.04 * (-1.0) ** np.arange(len(whole))
    write_modes(
        folder / "test.json", replace(whole, frequencies=whole.frequencies * off)
    )
    status, out, err = call(capsys, folder, "--json", "-")
    assert status == 1
    told = " ".join(err.split())
    assert "not fitted: frequencies deviate by" in told
    assert "test mode" in told
    assert "not to be trusted" not in told
    (found,) = json.loads(out)["misfits"]
    assert found["kind"] == "frequencies"
    assert found["chi_square"] > found["limit"]
    (folder / "study.toml").write_text(STUDY + "[update]\nfrequency_error = 0.05\n")
    status, out, err = call(capsys, folder, "--json", "-")
    assert status == 0, err
    assert json.loads(out)["misfits"] == []


def turned_sheet() -> str:
    """The sensors of the frame in axes of the test's own, turned by 90 degrees about Z and
    moved.
    """
    test, turned = small_study.test_model(), {"X": "Y", "Y": "-X"}
    rows = zip(
        test.channels, test.at.tolist(), test.channel_xyz().tolist(), strict=True
    )
    lines = [
        f"{point},{3 - y},{x - 1},{z},{turned[name[-1]]},{name}"
        for name, point, (x, y, z) in rows
    ]
    return "\n".join(["point,x,y,z,direction,channel", *lines])


def test_the_sheet_is_laid_onto_the_deck_and_channels_are_left_out_as_the_study_says(
    capsys: Capture, folder: Path
) -> None:
    whole = read_modes(folder / "test.json")
    wrong = np.where(np.array(whole.channels) == "303+X", -1.0, 1.0)[:, None]
    write_modes(folder / "test.json", replace(whole, shapes=whole.shapes * wrong))
    (folder / "sensors.csv").write_text(turned_sheet())
    more = '[test]\nsheet = "sensors.csv"\nleave_out = ["303+X"]\n[correlate]\nalign = "points"\n'
    (folder / "study.toml").write_text(STUDY + more)
    status, out, err = call(capsys, folder, "--json", "-")
    assert status == 0, err
    found = json.loads(out)
    factors = [p["factor"] for p in found["parameters"]]
    np.testing.assert_allclose(factors, list(small_study.TRUTH.values()), rtol=0.01)
    assert min(m["mac_percent"] for m in found["modes"]) > 99


def test_a_card_that_is_not_there_is_refused_with_its_neighbours(
    capsys: Capture, folder: Path
) -> None:
    (folder / "study.toml").write_text(STUDY.replace("MAT1 3 E", "MAT1 4 E"))
    status, _, err = call(capsys, folder)
    assert status == 2
    assert (
        "MAT1 4 E: no such card in the model; 4 MAT1, next to it 1, 2, 3, 10"
        in " ".join(err.split())
    )


def test_fields_that_cannot_be_written_are_refused_before_any_work(
    capsys: Capture, folder: Path
) -> None:
    """The PBAR that a PBARL makes stands nowhere in the deck."""
    text = (folder / "frame.bdf").read_text()
    (folder / "frame.bdf").write_text(
        text.replace("ENDDATA", "PBARL,99,1,,BAR\n,.1,.2\nENDDATA")
    )
    (folder / "study.toml").write_text(STUDY.replace("MAT1 3 E", "PBAR 99 A"))
    status, _, err = call(capsys, folder, "--out", str(folder / "up"))
    assert status == 2
    assert "PBAR 99 field A: it was made from a PBARL" in err
    assert "basis" not in err


def test_checkpoint_is_kept_and_the_table_is_printed(
    capsys: Capture, folder: Path
) -> None:
    file = folder / "point.json"
    status, out, _ = call(capsys, folder, "--checkpoint", str(file))
    assert status == 0
    assert "storey 2" in out
    assert "posterior/prior" in out
    assert len(json.loads(file.read_text())["y"]) == 3
    assert call(capsys, folder, "--checkpoint", str(file))[0] == 0


def responses(folder: Path) -> tuple[list[float], FrfSet]:
    """Static deflections under 1 kN at 303+X, and accelerances, of the true deck by all its
    modes.
    """
    with EmbeddedSolver().open(read_deck(folder / "truth.bdf")) as analysis:
        modes = analysis.modes(ModesRequest(40)).modes.rows(READ)
        rows = analysis.system.transform[
            analysis.dofs.align(DofSet.parse(READ))[0]
        ].toarray()
        u = rows @ analysis.pencil.at(0.0).solve(1000.0 * rows[:1].T)
    f, shapes = np.arange(1.0, 18.0, 0.05), np.asarray(modes.shapes.real)
    h = frf(f, modes.frequencies, np.full(40, 0.01), shapes, shapes[:1])
    sides = [
        tuple(Channel(c, "acceleration", "m/s^2") for c in READ),
        (Channel(READ[0], "force", "N"),),
    ]
    return u.ravel().tolist(), FrfSet(
        h, f, sides[0], sides[1], np.full(h.shape, np.nan), np.full(1, np.nan)
    )


def test_what_was_measured_besides_modes_is_fitted_and_shown(
    capsys: Capture, folder: Path
) -> None:
    moved, frfs = responses(folder)
    write_frfs(folder / "frfs.uff", frfs)
    text = "".join(
        f"pull,{c},{1000 if c == READ[0] else ''},{u:.9e}\n"
        for c, u in zip(READ, moved, strict=True)
    )
    (folder / "pull.csv").write_text("case,channel,load,deflection\n" + text)
    mass = whole_mass(read_deck(folder / "truth.bdf")).mass
    (folder / "study.toml").write_text(
        f"""{STUDY}[update]
residuals = ["mac"]
write = "all"
[[residual]]
kind = "mass"
mass = {mass}
[[residual]]
kind = "frf"
file = "frfs.uff"
[[residual]]
kind = "static"
file = "pull.csv"
"""
    )
    status, out, err = call(capsys, folder, "--json", "-")
    assert status == 0, err
    found = json.loads(out)
    factors = [p["factor"] for p in found["parameters"]]
    np.testing.assert_allclose(factors, list(small_study.TRUTH.values()), rtol=0.01)
    told = {(m["name"], m["what"]): m for m in found["measured"]}
    assert len(told) == 1 + 3 + 3
    pulled = told["static", "pull: 103+X"]
    assert abs(pulled["before"] / pulled["measured"] - 1) > 0.1
    assert pulled["after"] == pytest.approx(pulled["measured"], rel=0.01)
    weighed = told["mass", "mass"]
    assert weighed["after"] == pytest.approx(mass, rel=1e-9)
    curve = told["frf", "203+X / 303+X"]
    assert curve["after"] < 0.2 * curve["before"]
    assert call(capsys, folder)[1].count("pull: ") == 3


def test_wrong_options_are_refused(capsys: Capture, folder: Path) -> None:
    status, _, err = call(capsys, folder, "--leave-out", "12")
    assert status == 2
    assert "modes 1 to 9" in err
    (folder / "study.toml").write_text(f"{STUDY}[update]\nstarts = 3\n")
    status, _, err = call(capsys, folder, "--checkpoint", "x.json")
    assert status == 2
    assert "needs one start" in err


def test_test_channels_that_are_no_dofs_are_refused(
    capsys: Capture, folder: Path
) -> None:
    table = json.loads((folder / "test.json").read_text())
    table["channels"][0] = "9999+X"
    (folder / "test.json").write_text(json.dumps(table))
    status, _, err = call(capsys, folder)
    assert status == 2
    assert "9999+X" in err
    (folder / "study.toml").write_text('[model]\ndeck = "frame.bdf"\n')
    assert "at least one [[candidate]]" in call(capsys, folder)[2]


def frequencies_alone(folder: Path) -> list[float]:
    """The test without its shapes; the three storeys' modes, which are well apart."""
    found = read_modes(folder / "test.json").frequencies[:3].tolist()
    (folder / "test.json").write_text(
        json.dumps({"modes": [{"frequency_hz": f} for f in found]})
    )
    return found


def test_frequencies_without_shapes_update_what_they_tell(
    capsys: Capture, folder: Path
) -> None:
    frequencies_alone(folder)
    with (folder / "study.toml").open("a") as f:
        f.write('[update]\nwrite = "all"\n')
    assert call(capsys, folder, "--json", "-")[0] == 0
    found = json.loads(call(capsys, folder, "--json", "-")[1])
    assert [p["factor"] for p in found["parameters"]] == pytest.approx(
        [*small_study.TRUTH.values()], rel=0.03
    )
    assert max(abs(m["deviation_percent"]) for m in found["modes"]) < 0.1
    assert all(m["mac_percent"] is None for m in found["modes"])
    assert "by frequency" in found["notes"][0]


def test_a_study_decides_which_mode_a_frequency_is(
    capsys: Capture, folder: Path
) -> None:
    frequencies_alone(folder)
    with (folder / "study.toml").open("a") as f:
        f.write('[correlate]\nlock = ["1:2"]\nforbid = ["2:1"]\n')
    assert (
        "mode 1 for 2,"
        in json.loads(call(capsys, folder, "--json", "-")[1])["notes"][0]
    )


def free_beam(half: float) -> str:
    """A beam of 20 m on no supports, the modulus of one half scaled."""
    cards = ["SOL 103", "CEND", "METHOD=1", "BEGIN BULK", "EIGRL,1,,,14"]
    cards += [f"PBAR,{i},{i},.01,1-4,2-4,2-4" for i in (1, 2)]
    cards += [f"MAT1,{i},{2.1e11 * a:.6E},,.3,7850." for i, a in ((1, 1.0), (2, half))]
    cards += [f"GRID,{i},,{0.1 * i:.1f}" for i in range(1, 202)]
    cards += [f"CBAR,{i},{1 + (i > 100)},{i},{i + 1},0.,0.,1." for i in range(1, 201)]
    return "\n".join([*cards, "ENDDATA", ""])


def test_rigid_body_modes_of_a_free_structure_are_no_error_of_the_basis(
    capsys: Capture, folder: Path
) -> None:
    (folder / "frame.bdf").write_text(free_beam(1.0))
    (folder / "study.toml").write_text(
        '[model]\ndeck = "frame.bdf"\n[[candidate]]\nname = "half"\ntargets = ["MAT1 2 E"]\n'
    )
    (folder / "truth.bdf").write_text(free_beam(1.3))
    with EmbeddedSolver().open(read_deck(folder / "truth.bdf")) as analysis:
        modes = analysis.modes(ModesRequest(12)).modes
    seen = modes.take(np.arange(6, 12)).rows(
        [f"{i}+{a}" for i in range(1, 202, 20) for a in "XYZ"]
    )
    write_modes(folder / "test.json", replace(seen, damping=np.full(6, 0.01)))
    status, out, err = call(capsys, folder, "--json", "-")
    found = json.loads(out)
    assert status == 0, err
    assert found["basis_error"] < direct.AGREE
    assert found["parameters"][0]["factor"] == pytest.approx(1.3, rel=1e-3)
