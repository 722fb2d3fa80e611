"""A study of the small frame with what was measured beside its modes: statics, a weighing, FRFs and
their zeros.

A factor on all moduli and one on all densities change the frequencies f² ~ E/rho alike: the modes
tell their ratio alone. Each of these data tells the scale as well:

    static deflection u ~ 1/E        mass m ~ rho        accelerance H ~ 1/rho
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
import small_study

from ringtrue.checks.materials import whole_mass
from ringtrue.correlation.sensor_mapping import Alignment
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, DataError
from ringtrue.io.modes import write_modes
from ringtrue.report.build import deliver
from ringtrue.study import candidate_screening, session
from ringtrue.study.config import parse_config
from ringtrue.study.opened import Opened
from ringtrue.study.run import StudyRun, run_study
from ringtrue.study.stages import update
from ringtrue.study.store import Store
from ringtrue.study.summary import summarise
from ringtrue.virtual.measurements import write_sheet

TRUTH = {"stiffness": 0.75, "density": 0.9}
PLAIN = small_study.MODEL + small_study.TEST + small_study.SETTINGS + small_study.WHOLE
STATIC = '[[residual]]\nkind = "static"\nname = "pull"\nfile = "pull.csv"\n'
FRF = '[[residual]]\nkind = "frf"\nname = "hammer"\n'
LOADED, READ = "303+X", ("303+X", "203+X", "103+X")


def truth() -> str:
    text = small_study.deck(dict.fromkeys((1, 2, 3), 0.75)).replace("3.+10", "2.25+10")
    return text.replace("2500.0", "2250.0").replace("7850.0", "7065.0")


def deflections(opened: Opened) -> list[float]:
    """Of 1 kN at the top floor, by the full stiffness matrix."""
    system = opened.analysis.system
    look = opened.observation(small_study.test_model(), 0.01)
    rows = (look.matrix @ system.transform)[
        [look.channels.index(c) for c in READ]
    ].toarray()
    return (
        (rows @ opened.analysis.pencil.at(0.0).solve(1000.0 * rows[:1].T))
        .ravel()
        .tolist()
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the records, identified, and the true deck."""
    at = tmp_path_factory.mktemp("frame")
    (at / "deck").mkdir()
    (at / "deck/frame.bdf").write_text(small_study.deck())
    (at / "truth.bdf").write_text(truth())
    small_study.write_data(at / "data", ambient=False, truth=truth())
    moved = deflections(Opened(read_deck(at / "truth.bdf"), 1.0))
    rows = [
        f"pull,{c},{1000 if c == LOADED else ''},{u:.9e}"
        for c, u in zip(READ, moved, strict=True)
    ]
    (at / "pull.csv").write_text(
        "case,channel,load,deflection\n" + "\n".join(rows) + "\n"
    )
    (at / "study.toml").write_text(PLAIN)
    run_study(at / "study.toml", until="correlate")
    return at


def study(
    made: Path, at: Path, more: str, settings: str = "", plain: str = PLAIN
) -> Path:
    """A copy with further residuals; what was identified is taken from the store."""
    shutil.copytree(made, at / "s")
    (at / "s/study.toml").write_text(
        plain.replace("[update]", f"[update]\n{settings}") + more
    )
    return at / "s/study.toml"


def factors(run: StudyRun) -> dict[str, float]:
    done = run.results["update"]
    best = done.sets[done.chosen]
    assert best.outcome.startswith("converged")
    return dict(zip(best.parameters, best.factor.tolist(), strict=True))


def weighing(made: Path) -> str:
    whole = whole_mass(read_deck(made / "truth.bdf"))
    return f'[[residual]]\nkind = "mass"\nmass = {whole.mass}\ncenter = [2.0, 1.5, {whole.cg[2]}]\n'


@pytest.mark.parametrize("kind", ["static", "mass", "frf", "complex frf"])
def test_scale_is_found(made: Path, tmp_path: Path, kind: str) -> None:
    more = {
        "static": STATIC,
        "mass": weighing(made),
        "frf": FRF,
        "complex frf": FRF + 'form = "complex"\n',
    }[kind]
    run = run_study(study(made, tmp_path, more), until="update")
    found = factors(run)
    for name, value in TRUTH.items():
        assert found[name] == pytest.approx(value, rel=0.02)  # without: 0.85 and 1.02
    (data,) = run.results["update"].data
    if np.isfinite(data.measured).all():
        far, near = (
            np.abs(v - data.measured) / data.error for v in (data.before, data.after)
        )
    else:
        far, near = data.before, data.after
    assert near.max() < 0.3 * far.max()


def test_all_together_with_zeros_reach_the_report_and_the_uncertainty(
    made: Path, tmp_path: Path
) -> None:
    zeros = (
        '[[residual]]\nkind = "anti-resonances"\noutput = "303+X"\ninput = '
        '"303+X"\nfrequencies = [{}]\n'
    )
    held = truth().replace(
        "SPC1,1,123456,", "SPC1,1,1,303\nSPC1,1,123456,"
    )  # zeros: modes with the point held
    (tmp_path / "held.bdf").write_text(held)
    f = (
        Opened(read_deck(tmp_path / "held.bdf"), 1.0)
        .modes(12.0)
        .modes.frequencies[[1, 2, 4]]
    )  # 0 and 3 sway along y
    more = (
        STATIC + weighing(made) + FRF + zeros.format(", ".join(f"{x:.6f}" for x in f))
    )
    settings = 'residuals = ["frequencies", "mac"]\n'
    run = run_study(study(made, tmp_path, more, settings))
    deliver(run)
    for name, value in factors(run).items():
        assert value == pytest.approx(TRUTH[name], rel=0.01)
    told = json.loads((run.folder / "summary.json").read_text())["measured"]
    assert [d["kind"] for d in told] == ["static", "mass", "frf", "anti-resonances"]
    zero = next(d for d in told if d["kind"] == "anti-resonances")["values"]
    for v in zero:
        assert v["after"] == pytest.approx(v["measured"], rel=2e-3)
        assert abs(v["before"] / v["measured"] - 1) > 0.05
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    assert "303+X / 303+X: zero 1" in page
    assert "pull: 203+X" in page
    known = run.results["uncertainty"]
    # the modes alone leave the scale at its prior
    assert (known.posterior.ratio < 0.1).all()
    at = np.array([TRUTH[n] for n in known.posterior.parameters.names])
    assert (np.abs(known.posterior.factor / at - 1) < 4 * known.posterior.std).all()


def test_what_was_measured_on_another_configuration_counts(
    made: Path, tmp_path: Path
) -> None:
    more = weighing(made) + 'configuration = "bare"\n'
    bare = '[[configuration]]\nname = "bare"\ndeck = "deck/frame.bdf"\nmodes = "bare.json"\n'
    path = study(made, tmp_path, more + bare + "[uncertainty]\nfolds = 3\n")
    write_modes(
        path.parent / "bare.json", small_study.measured_modes(made / "truth.bdf", 20.0)
    )
    run = run_study(path, until="uncertainty")
    for name, value in factors(run).items():
        assert value == pytest.approx(TRUTH[name], rel=0.01)
    assert [d.configuration for d in run.results["update"].data] == ["bare"]
    assert (run.results["uncertainty"].posterior.ratio < 0.1).all()


@pytest.mark.parametrize(
    "settings",
    [
        'loss = "huber"\n',
        'prior = "evidence"\ndiscrepancy = "evidence"\n',
        "starts = 3\n",
        'stages = [["stiffness"], ["stiffness", "density"]]\n',
        'residuals = ["frequencies", "mac"]\nfrequency_error = 0.005\n',
    ],
)
def test_ways_to_minimise_lead_to_the_same(
    made: Path, tmp_path: Path, settings: str
) -> None:
    found = factors(run_study(study(made, tmp_path, STATIC, settings), until="update"))
    for name, value in TRUTH.items():
        assert found[name] == pytest.approx(value, rel=0.02)


def test_named_sets_stand_in_one_table(made: Path, tmp_path: Path) -> None:
    sets = """
[[set]]
name = "stiffness alone"
candidates = ["stiffness"]

[[set]]
name = "by evidence"
prior = "evidence"
starts = 2

[[set]]
name = "frequencies first"
shape_weight = 0.1
frequency_error = 0.001
"""
    run = run_study(study(made, tmp_path, STATIC + sets), until="update")
    done = run.results["update"]
    by = {s.name: s for s in done.sets}
    assert by["stiffness alone"].parameters == ("stiffness",)
    assert by["stiffness alone"].fit.mean_deviation > 1  # the density is wrong, too
    assert by["by evidence"].settings == "prior evidence, starts 2"
    assert by["frequencies first"].settings == "shape weight 0.1, frequency error 0.001"
    for name in ("by evidence", "frequencies first", "best subset"):
        assert dict(
            zip(by[name].parameters, by[name].factor, strict=True)
        ) == pytest.approx(TRUTH, rel=0.02)
    assert done.sets[done.chosen].name != "frequencies first"
    assert "not chosen from" in done.why
    told = {s["name"]: s for s in summarise(run)["sets"]}
    assert told["by evidence"]["settings"] == "prior evidence, starts 2"


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (
            '[[set]]\nname = "a"\ncandidates = ["stifness"]\n',
            "did you mean 'stiffness'",
        ),
        ('[[set]]\nname = "best subset"\n', "names of their own"),
        ('[[residual]]\nkind = "frf"\nfmim = 3.0\n', "did you mean 'fmin'"),
        ('[[residual]]\nkind = "mass"\n', "gives mass, center or inertia"),
        (
            '[[residual]]\nkind = "mass"\nmass = 3.0\nconfiguration = "x"\n',
            "no configuration 'x'",
        ),
        ('[[constraint]]\nterms = { "denisty" = 1.0 }\n', "did you mean 'density'"),
    ],
)
def test_what_the_study_cannot_mean_is_refused(
    tmp_path: Path, more: str, told: str
) -> None:
    with pytest.raises(ConfigError, match=told):
        parse_config(PLAIN + more, tmp_path / "study.toml")


def test_constraint_holds(made: Path, tmp_path: Path) -> None:
    # density factor not below exp(-0.02)
    tie = '[[constraint]]\nterms = { "density" = -1.0 }\nmost = 0.02\n'
    path = study(made, tmp_path, STATIC + tie, 'write = "all"\n')
    found = factors(run_study(path, until="update"))
    assert found["density"] == pytest.approx(np.exp(-0.02), rel=1e-6)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("pull,303+X,1000,\n", "one deflection"),
        (
            "pull,303+X,1e3,1e-3\npull,303+X,,1e-3\n",
            "pull.csv:3: channel 303+X is given twice",
        ),
        ("pull,303+X,much,1e-3\n", "pull.csv:2: load 'much' is not a number"),
        ("pull,99999+X,1e3,1e-3\n", "99999"),
        ("pull,1+X,1e3,1e-3\n", "channel 1+X is not on the sensor sheet"),
    ],
)
def test_static_tables_are_checked(
    made: Path, tmp_path: Path, text: str, told: str
) -> None:
    path = study(made, tmp_path, STATIC)
    (path.parent / "pull.csv").write_text("case,channel,load,deflection\n" + text)
    with pytest.raises(DataError, match=told.replace("+", r"\+")):
        run_study(path, until="update")


def test_pairs_that_the_study_decides_hold_from_the_deck_to_the_delivered_one(
    made: Path, tmp_path: Path
) -> None:
    locks = '[correlate]\nlock = ["4:4"]\nforbid = ["2:2"]\nmac_gate = 0.9\n'
    run = run_study(study(made, tmp_path, locks + STATIC), until="final")
    found, final = run.results["correlate"], run.results["final"]
    for table in (found.initial, final.table):
        pairs = set(
            zip(table.pairing.a.tolist(), table.pairing.b.tolist(), strict=True)
        )
        assert (1, 1) not in pairs
        assert (3, 3) in pairs  # the order of the modes stays: all moduli change alike
    for name, value in factors(run).items():
        assert value == pytest.approx(TRUTH[name], rel=0.02)
    (tmp_path / "s/study.toml").write_text(PLAIN + '[correlate]\nlock = ["4:40"]\n')
    with pytest.raises(
        ConfigError, match=r"correlate\.lock 4:40: there are 9 elastic test modes"
    ):
        run_study(tmp_path / "s/study.toml", until="correlate")
    with pytest.raises(ConfigError, match="'4-3' is no pair"):
        parse_config(
            PLAIN + '[correlate]\nforbid = ["4-3"]\n', tmp_path / "s/study.toml"
        )


def test_a_sheet_in_a_frame_of_its_own_is_laid_onto_the_deck(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = study(made, tmp_path, '[correlate]\nalign = "points"\n' + STATIC)
    c, s = np.cos(0.5), np.sin(0.5)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turn = Alignment(
        about_z, np.array([20.0, -3, 1]), 1.0, np.zeros(0), np.zeros(0, dtype=bool)
    )
    turned = turn.move(small_study.test_model())
    write_sheet(path.parent / "data/sensors.csv", turned, turned.channels)
    found: list[str] = []
    real = session.alignment
    monkeypatch.setattr(session, "alignment", lambda *a: found.append(a[2]) or real(*a))
    run = run_study(path, until="update")
    assert set(found) == {
        "points"
    }  # for the deck before and after, and for the places that are shown
    assert "turned by 28.6°" in run.results["correlate"].sensors.alignment
    for name, value in factors(run).items():
        assert value == pytest.approx(TRUTH[name], rel=0.02)
    path.write_text(path.read_text().replace('"points"', '"nearest"'))
    with pytest.raises(DataError, match="the geometry is symmetric"):
        run_study(path, until="correlate")
    path.write_text(path.read_text().replace('align = "nearest"\n', ""))
    with pytest.raises(DataError, match="farther than"):
        run_study(path, until="correlate")


@pytest.mark.parametrize("more", ["", STATIC])
def test_an_interrupted_updating_goes_on_with_the_next_set(
    made: Path, tmp_path: Path, more: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = study(
        made, tmp_path, more, plain=PLAIN.replace("[update]", "[update]\nchoose = 1")
    )
    whole = run_study(
        study(
            made, tmp_path / "whole", more, plain=path.read_text().removesuffix(more)
        ),
        until="update",
    )
    at: list[str] = []

    def stop(fraction: float, text: str) -> None:
        at.extend([text] if text.startswith("updating: ") else [])
        if len(at) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(path, until="update", progress=stop)
    assert len(Store(path.parent / "update.sets.h5").stages()) == 1
    monkeypatch.delattr(
        update, "update_reduced"
    )  # all rules choose the one parameter: nothing is left to be updated
    again = run_study(path, until="update")
    assert not (path.parent / "update.sets.h5").exists()
    assert again.results["sensitivity"].sets == whole.results["sensitivity"].sets
    for a, b in zip(
        again.results["update"].sets, whole.results["update"].sets, strict=True
    ):
        np.testing.assert_array_equal(a.factor, b.factor)
        np.testing.assert_array_equal(a.history.path, b.history.path)


def in_millimetres(text: str) -> str:
    """The deck in mm, t and s."""
    out = []
    for line in text.splitlines():
        f = line.split(" $")[0].split(",")
        if f[0] == "GRID":
            f[3:6] = [f"{1e3 * float(v):.6g}" for v in f[3:6]]
        elif f[0] == "MAT1":
            f[2] = f"{float(f[2].replace('+10', 'e10')) * 1e-6:.8g}"
            f[5] = f"{float(f[5]) * 1e-12:.7E}"
        elif f[0] == "PBEAM":
            f[3] = f"{float(f[3]) * 1e6:.7g}"
            f[4:8] = [f"{float(v.replace('-5', 'e-5')) * 1e12:.7g}" for v in f[4:8]]
        elif f[0] == "PSHELL":
            f[3] = f"{1e3 * float(f[3]):g}"
        out.append(",".join(f))
    return "\n".join(out) + "\n"


def test_a_deck_in_millimetres_gives_the_same(made: Path, tmp_path: Path) -> None:
    more = (
        STATIC
        + weighing(made)
        + "inertia = [nan, nan, 1.0e5, nan, nan, nan]\ninertia_error = 1e3\n"
        + FRF
    )
    plain = PLAIN.replace('frame.bdf"\n', 'frame.bdf"\nunits = "mm-t-s"\n')
    path = study(made, tmp_path, more, plain=plain)
    (path.parent / "deck/frame.bdf").write_text(in_millimetres(small_study.deck()))
    run = run_study(path, until="update")
    for name, value in factors(run).items():
        assert value == pytest.approx(TRUTH[name], rel=0.01)
    static, weighed, frfs = run.results["update"].data
    np.testing.assert_allclose(static.after, static.measured, rtol=0.02)
    np.testing.assert_allclose(weighed.after[:4], weighed.measured[:4], rtol=0.01)
    assert frfs.after.max() < 0.3 * frfs.before.max()


def test_a_sensor_off_the_nodes_reads_the_nodes_around_it(
    made: Path, tmp_path: Path
) -> None:
    run = run_study(
        study(made, tmp_path, '[correlate]\nmatch = "rigid"\n'), until="correlate"
    )
    test = run.results["identify"].test
    # on the rim of the floors
    off = replace(test, xyz=test.xyz + np.array([0.2, 0.1, 0.0]))
    near, around = (
        run.session.initial.observation(off, 1.0, how).matrix
        for how in ("nearest", "rigid")
    )
    assert (np.diff(near.indptr) == 1).all()
    assert (np.diff(around.indptr) >= 4).all()
    np.testing.assert_array_equal(
        run.session.observed(run.session.initial, off, off.channels).matrix.toarray(),
        around.toarray(),
    )


def test_steps_of_a_remodelling_are_told_one_by_one(made: Path, tmp_path: Path) -> None:
    step = '[[remodel]]\nfile = "deck/frame.bdf"\ncards = "{0}.bdf"\nreason = "{0}"\n'
    path = study(made, tmp_path, step.format("tank") + step.format("crane"))
    for number, (name, mass) in enumerate((("tank", 4000.0), ("crane", 900.0))):
        (path.parent / f"{name}.bdf").write_text(f"CONM2,{9001 + number},305,,{mass}\n")
    run = run_study(path, until="correlate")
    deliver(run)
    told = json.loads((run.folder / "summary.json").read_text())["remodelling"]
    assert [s["reason"] for s in told] == ["the initial deck", "tank", "crane"]
    # f is 9.5 % high for E/rho; mass on the top floor lowers the first modes
    assert len({round(s["mean_deviation"], 6) for s in told}) == 3
    found = run.results["correlate"]
    assert told[2]["mean_deviation"] == found.remodelled.mean_deviation()
    assert found.remodelling.reason == "1. tank; 2. crane"
    assert len(read_deck(path.parent / "remodelled/step 1/frame.bdf")["CONM2"]) == 1
    assert len(read_deck(path.parent / "remodelled/frame.bdf")["CONM2"]) == 2
    assert "after each step of the remodelling" in (
        run.folder / "report.html"
    ).read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", ["", "static", "mass", "frf"])
def test_the_proposal_takes_what_was_measured_beside_the_modes(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """The modes tell the ratio of the two factors alone: one of them is proposed, and stands for
    both.
    """
    # so that the search has a basis of its own here, too
    monkeypatch.setattr(
        candidate_screening, "SIZES", replace(candidate_screening.SIZES, vectors=1)
    )
    more = {"": "", "static": STATIC, "mass": weighing(made), "frf": FRF}[kind]
    run = run_study(
        study(made, tmp_path, more, "propose = true\n"), until="sensitivity"
    )
    found = run.results["localise"]
    named = {m.name: m for m in found.proposal.members}
    told = summarise(run)
    if not kind:
        (one,) = named.values()
        assert set(one.named) == set(TRUTH)
        assert "proposed_by" not in told
        return
    assert set(named) == set(TRUTH)
    for name, m in named.items():
        assert m.factor == pytest.approx(TRUTH[name], rel=0.03)
        assert not m.collinear
    assert (
        told["proposed_by"] == {"static": "pull", "mass": "mass", "frf": "hammer"}[kind]
    )
    assert set(run.results["sensitivity"].sets["proposal"]) == set(TRUTH)
    # all candidates free: known beside each other as well as alone only with the data that part
    # them
    assert (found.candidates.all_free < 0.1).all()
