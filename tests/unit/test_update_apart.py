"""Candidates that the data cannot tell apart, changes that are not worth writing, and candidates
that name no card.

A cantilever whose modulus is 10 % too high, with candidates on E, density and second moments: of
its bending modes all three are one and the same.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.cli.main import run
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Outcome
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.response import frf
from ringtrue.io.frfs import write_frfs
from ringtrue.io.modes import read_modes, write_modes
from ringtrue.study.acceptance import AcceptanceCheck, settles
from ringtrue.study.opened import Opened
from ringtrue.updating.identifiability import least_proven, stood_for, told_apart

Capture = pytest.CaptureFixture[str]
NODES = range(2, 12)
TRUTH = 0.9
STUDY = """[model]
deck = "d.bdf"
[test]
sheet = "s.csv"
modes = "modes.json"
[correlate]
accept_percent = 1.0
accept_mean_percent = 0.5
"""
CANDIDATES = {"E": "MAT1 1 E", "rho": "MAT1 1 RHO", "I": "PBAR 1 I1,I2"}


def deck(modulus: float = 2.1e11, stiff: float = 0.0) -> str:
    """A cantilever of other stiffness in its two planes, with a spring along X at its tip where
    asked for.
    """
    lines = ["SOL 103", "CEND", "SPC = 1", "BEGIN BULK"]
    lines += [f"GRID,{n},,{0.1 * (n - 1):.1f},0.,0." for n in range(1, 12)]
    lines += [f"CBAR,{n},1,{n},{n + 1},0.,1.,0." for n in range(1, 11)]
    lines += [
        "PBAR,1,1,4.-4,1.333-8,1.6-8,2.3-8",
        f"MAT1,1,{modulus:.9e},,.3,7850.",
        "SPC1,1,123456,1",
    ]
    lines += [f"CELAS2,50,{stiff},11,1"] if stiff else []
    return "\n".join([*lines, "ENDDATA", ""])


def candidate(name: str, target: str) -> str:
    return f'[[candidate]]\nname = "{name}"\ntargets = ["{target}"]\n'


def study(
    folder: Path, candidates: dict[str, str] = CANDIDATES, stiff: float = 0.0
) -> Path:
    """The study with the bending modes of the deck whose modulus is right."""
    (folder / "d.bdf").write_text(deck(stiff=stiff))
    (folder / "t.bdf").write_text(deck(TRUTH * 2.1e11, stiff))
    modes = Opened(read_deck(folder / "t.bdf"), 1.0).modes(900.0).modes
    channels = [f"{n}+{a}" for n in NODES for a in "YZ"]
    assert isinstance(modes.labels, DofSet)
    row, sign = modes.labels.align(DofSet.parse(channels))
    seen = ModeSet(
        modes.frequencies,
        np.full(len(modes), 0.01),
        modes.shapes[row] * sign[:, None],
        tuple(channels),
    )
    write_modes(folder / "modes.json", seen)
    places = [f"{n},{(n - 1) / 10},0,0,+{a}\n" for n in NODES for a in "YZ"]
    (folder / "s.csv").write_text("point,x,y,z,direction\n" + "".join(places))
    path = folder / "study.toml"
    path.write_text(STUDY + "".join(candidate(n, t) for n, t in candidates.items()))
    return path


def changed(folder: Path) -> list[str]:
    """Cards of the delivered deck that are not those of the initial one."""
    old, new = (
        (folder / f).read_text().splitlines() for f in ("d.bdf", "updated/d.bdf")
    )
    return [b for a, b in zip(old, new, strict=True) if a != b]


def test_one_of_perfectly_collinear_candidates_is_updated_the_others_are_held(
    tmp_path: Path, capsys: Capture
) -> None:
    """E, density and second moments shared a change out, 0.965 1.036 0.965, under green ticks."""
    assert run(["run", str(study(tmp_path))]) == 0
    told = capsys.readouterr().out
    for name in ("rho", "I"):
        assert (
            f"{name} is held at the deck's value: the data cannot tell it from E"
            in told
        )
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [p["name"] for p in summary["parameters"]] == ["E"]  # as the proposal has it
    assert summary["parameters"][0]["factor"] == pytest.approx(TRUTH, rel=1e-5)
    (line,) = changed(tmp_path)
    assert line.startswith("MAT1")
    assert "rho is held at the deck" in (tmp_path / "report.html").read_text()


def test_the_command_update_has_the_same_rule(tmp_path: Path, capsys: Capture) -> None:
    path = study(tmp_path)
    words = [
        "update",
        str(path),
        str(tmp_path / "modes.json"),
        "--out",
        str(tmp_path / "updated"),
        "--json",
        "-",
    ]
    assert run(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert [p["name"] for p in found["parameters"]] == ["E"]
    assert sum("is held at the deck's value" in n for n in found["notes"]) == 2
    assert len(changed(tmp_path)) == 1


def test_one_candidate_with_both_targets_shares_them_equally(tmp_path: Path) -> None:
    """The way out that the message names."""
    path = study(tmp_path, {"bending": "MAT1 1 E"})
    path.write_text(
        path.read_text().replace('["MAT1 1 E"]', '["MAT1 1 E", "PBAR 1 I1,I2"]')
    )
    assert run(["run", str(path)]) == 0
    (found,) = json.loads((tmp_path / "summary.json").read_text())["parameters"]
    assert found["factor"] == pytest.approx(TRUTH**0.5, rel=1e-5)
    assert len(changed(tmp_path)) == 2


def test_only_what_the_data_leave_to_the_prior_is_held() -> None:
    """A combination of others is held, too; what hardly acts, and what strong data tell apart, is
    not.
    """
    rng = np.random.default_rng(0)
    a, b, other = rng.standard_normal((3, 40)) * 20
    g = np.stack([a, b, a + b, 1e-3 * other, -a], axis=1)
    kept, held = told_apart(g, range(5))
    assert kept.tolist() == [0, 1, 3]
    assert set(held) == {2, 4}
    assert held[4].tolist() == [0]
    near = np.stack(
        [a, a + 1e-3 * b], axis=1
    )  # cosine 1 - 5e-7, but the data share out what they do together
    assert told_apart(near, range(2))[0].tolist() == [0, 1]
    assert told_apart(near / 20, range(2))[0].tolist() == [0]
    assert stood_for(g[:, [0, 4]], ["one", "two"]) == {"two": ("one",)}
    assert stood_for(g[:, [0, 4]], ["one", "two"], first=["two"]) == {"one": ("two",)}


def test_the_least_proven_is_the_one_of_fewest_standard_deviations() -> None:
    """Of a normal distribution 90 % lie within 1.645 standard deviations."""
    std = np.full(3, 0.1)
    assert least_proven(np.array([0.3, -0.164, 0.2]), std, 0.9) == 1
    assert least_proven(np.array([0.3, -0.165, 0.2]), std, 0.9) is None
    assert least_proven(np.array([0.3, -0.165, 0.2]), std, 0.95) == 1
    assert least_proven(np.zeros(0), np.zeros(0), 0.9) is None


WITH_TIP = {"E": CANDIDATES["E"], "tip": "CELAS2 50 K"}


@pytest.mark.parametrize("command", ["run", "update"])
def test_a_change_that_is_not_proven_is_not_written(
    tmp_path: Path, capsys: Capture, command: str
) -> None:
    """A spring that no mode feels: its field was rewritten for a change of 0.00094 %."""
    path = study(tmp_path, WITH_TIP, stiff=1.0)
    words = [
        "update",
        str(path),
        str(tmp_path / "modes.json"),
        "--out",
        str(tmp_path / "updated"),
    ]
    assert run(["run", str(path)] if command == "run" else words) == 0
    (line,) = changed(tmp_path)
    assert line.startswith("MAT1")
    told = " ".join(capsys.readouterr().out.split())
    assert "tip stays as in the deck: the interval of its factor" in told
    if command == "update":
        path.write_text(path.read_text() + '[update]\nwrite = "all"\n')
        assert run(words) == 0
        assert "tip stays" not in capsys.readouterr().out


def tap(folder: Path) -> None:
    """Accelerances of the true deck, 0.9 of the modulus and 1.1 of the density, hit at the tip."""
    text = deck(TRUTH * 2.1e11).replace("7850.", f"{1.1 * 7850.0}")
    (folder / "t.bdf").write_text(text)
    outputs = ("11+Y", "11+Z", "6+Y")
    found = Opened(read_deck(folder / "t.bdf"), 1.0).modes(9000.0).modes.rows(outputs)
    shapes = np.asarray(found.shapes.real)
    freqs = np.arange(10.0, 900.0, 1.0)
    zeta = np.full(len(found), 0.01)
    h = frf(freqs, found.frequencies, zeta, shapes, shapes[:2])
    sides = [
        tuple(Channel(c, quantity, unit) for c in outputs[:count])
        for quantity, unit, count in (("acceleration", "m/s^2", 3), ("force", "N", 2))
    ]
    write_frfs(folder / "frfs.uff", FrfSet(h, freqs, *sides))
    channels = [f"{n}+{a}" for n in NODES for a in "YZ"]
    modes = Opened(read_deck(folder / "t.bdf"), 1.0).modes(900.0).modes.rows(channels)
    write_modes(
        folder / "modes.json", replace(modes, damping=np.full(len(modes), 0.01))
    )


def test_stiffness_and_mass_of_a_region_are_one_to_frequencies_and_two_to_a_driving_point(
    tmp_path: Path, capsys: Capture
) -> None:
    both = {"E": CANDIDATES["E"], "rho": CANDIDATES["rho"]}
    path = study(tmp_path, both)
    tap(tmp_path)
    words = ["update", str(path), str(tmp_path / "modes.json"), "--json", "-"]
    assert run(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert [p["name"] for p in found["parameters"]] == ["E"]
    assert found["parameters"][0]["factor"] == pytest.approx(0.9 / 1.1, rel=1e-3)
    assert any("rho is held at the deck's value" in n for n in found["notes"])
    path.write_text(
        path.read_text()
        + '[[residual]]\nkind = "frf"\nfile = "frfs.uff"\nerror = 0.05\n'
    )
    assert run(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["misfits"] == []
    factors = {p["name"]: p["factor"] for p in found["parameters"]}
    assert factors == pytest.approx({"E": 0.9, "rho": 1.1}, rel=0.02)  # the prior pulls


def test_modal_masses_of_mass_scaled_shapes_tell_both_too(
    tmp_path: Path, capsys: Capture
) -> None:
    path = study(tmp_path, {"E": CANDIDATES["E"], "rho": CANDIDATES["rho"]})
    tap(tmp_path)
    kinds = '[update]\nresiduals = ["eigenvalues", "shapes", "modal masses"]\nmass_error = 0.02\n'
    path.write_text(path.read_text() + kinds)
    words = ["update", str(path), str(tmp_path / "modes.json"), "--json", "-"]
    assert run(words) == 0
    found = json.loads(capsys.readouterr().out)
    factors = {p["name"]: p["factor"] for p in found["parameters"]}
    assert factors == pytest.approx({"E": 0.9, "rho": 1.1}, rel=0.01)
    modes = read_modes(tmp_path / "modes.json")
    write_modes(tmp_path / "modes.json", replace(modes, norm=Norm.UNSCALED))
    assert run(words) == 2
    assert (
        '"modal masses" need test modes of unit modal mass' in capsys.readouterr().err
    )


def test_python_holds_what_the_data_cannot_distinguish(tmp_path: Path) -> None:
    study(tmp_path)
    true = rt.solve_modes(rt.read_deck(tmp_path / "t.bdf"), band=(0.0, 900.0))
    test = true.at([f"{n}+{a}" for n in NODES for a in "YZ"])
    parameters = [rt.parameter(name, text) for name, text in CANDIDATES.items()]
    found = rt.update(rt.read_deck(tmp_path / "d.bdf"), test, parameters)
    factors = dict(zip(found.names, found.factors.tolist(), strict=True))
    assert factors["E"] == pytest.approx(TRUTH, rel=1e-4)
    assert {n: a for n, a in factors.items() if n != "E"} == {"rho": 1.0, "I": 1.0}
    assert set(found.held) == {"rho", "I"}
    low, high = (
        dict(zip(found.names, v.tolist(), strict=True)) for v in (found.low, found.high)
    )
    assert low["rho"] == pytest.approx(0.2)
    assert high["E"] < 1
    assert found.misfits == ()


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ("MAT1 33 E", "MAT1 33 is not in the model; did you mean 1?"),
        ("MAT1 1 EE", "MAT1 has no field EE; did you mean 'E'?"),
        ("MAT11 1 E", "no MAT11 card in the model; did you mean 'MAT1'?"),
    ],
)
def test_a_candidate_that_names_no_card_is_refused_at_the_model(
    tmp_path: Path, capsys: Capture, target: str, told: str
) -> None:
    path = study(tmp_path, CANDIDATES | {"none": target})
    assert run(["run", str(path), "--until", "model"]) == 2
    assert f"[[candidate]] 'none': {told}" in capsys.readouterr().err
    assert not (tmp_path / "study.h5").exists()


def test_where_no_step_lowers_the_objective_the_limits_judge() -> None:
    limit = (AcceptanceCheck("mean |Δf|", "≤ 1 %", "0.04 %", True),)
    assert settles(Outcome.CONVERGED, ())
    assert settles(None, ())
    assert settles(Outcome.STALLED, limit)
    assert not settles(Outcome.STALLED, ())
    assert not settles(Outcome.MAX_ITERATIONS, limit)
