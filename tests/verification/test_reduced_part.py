"""A part is reduced, written in the form of EXTSEOUT, read back into a deck and solved with the rest.

A portal of CBARs: a beam of points 11 to 21 between two columns, and a branch of ten CBARs on its
middle, point 16, which is the part: points 16, 31 to 40. Of the branch only point 16 is kept. The
modes of the whole must be those of one mesh within what the reduction says of the part alone, and
in statics exactly those.
"""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.cli.main import run
from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import (
    ConfigError,
    DeckError,
    InputError,
    SingularModel,
    UnsupportedCard,
)
from ringtrue.io.matrices import read_op4, write_op4
from ringtrue.io.modes import write_modes
from ringtrue.model.ports import ModesRequest
from ringtrue.report.build import deliver
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.run import run_study

PROPERTIES = "PBAR,7,1,.01,1.-5,2.-5,2.-5\nMAT1,1,7.+10,,.3,2700.\n"
STUDY = """
[model]
deck = "with_cb.bdf"
[test]
sheet = "sensors.csv"
modes = "test.json"
[[candidate]]
name = "branch K"
targets = ["DMIG 1 A"]
[[candidate]]
name = "branch M"
targets = ["DMIG 2 A"]
"""
BELOW = 200.0  # Hz; five modes of the branch beyond its rigid-body motions


def _grid(number: int, *xyz: float) -> str:
    return f"GRID,{number},," + ",".join(f"{x:.3f}" for x in xyz) + "\n"


def _bars(first: int, points: list[int]) -> str:
    return "".join(
        f"CBAR,{first + i},7,{a},{b},1.,.3,2.\n"
        for i, (a, b) in enumerate(pairwise(points))
    )


FRAME_POINTS = "".join(_grid(11 + i, 0.5 * i, 0.0, 2.0) for i in range(11))
FRAME = (
    FRAME_POINTS
    + _grid(1, 0.0, 0.0, 0.0)
    + _grid(2, 5.0, 0.0, 0.0)
    + _bars(1, list(range(11, 22)))
    + _bars(101, [1, 11])
    + _bars(111, [2, 21])
    + "SPC1,3,123456,1,2\n"
)
BRANCH = "".join(_grid(31 + i, 2.5, 0.3 * (i + 1), 2.0) for i in range(10)) + _bars(
    201, [16, *range(31, 41)]
)
HEAD = "SOL 103\nCEND\nSPC = 3\nBEGIN BULK\n"


def frequencies(path: Path, count: int = 12) -> Float:
    with EmbeddedSolver().open(read_deck(path)) as analysis:
        return analysis.modes(ModesRequest(count)).modes.frequencies


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("parts")
    (here / "whole.bdf").write_text(HEAD + PROPERTIES + FRAME + BRANCH)
    (here / "branch.bdf").write_text(PROPERTIES + _grid(16, 2.5, 0.0, 2.0) + BRANCH)
    for name in ("cb", "guyan", "dynamic"):
        assembled = (
            HEAD
            + f"INCLUDE '{name}.asm'\n"
            + PROPERTIES
            + FRAME
            + f"INCLUDE '{name}.pch'\n"
        )
        (here / f"with_{name}.bdf").write_text(assembled)
    return here


def test_craig_bampton_is_as_near_as_it_says(folder: Path) -> None:
    settings = rt.ReductionSettings(below=BELOW)
    part = rt.reduce_model(folder / "branch.bdf", "16", settings)
    assert len(part.kept) > 6
    assert part.captured.min() > 0.9999
    flexible = part.frequencies > 1.0
    assert flexible.sum() >= 3
    assert (part.deviations[flexible] > 0).all()  # a reduction stiffens
    assert part.deviations.max() < part.bound
    part.write(folder / "cb")
    whole = frequencies(folder / "whole.bdf", 20)
    there = whole < BELOW
    off = 100 * (frequencies(folder / "with_cb.bdf", 20) / whole - 1)[there]
    assert there.sum() >= 14
    assert off.min() > -1e-6
    assert 0.01 * part.bound < off.max() < part.bound
    for f, percent in zip(whole[there], off, strict=True):
        near = rt.reduce_model(
            folder / "branch.bdf", "16", replace(settings, below=float(f), modes=7)
        )
        assert percent < near.bound + 1e-6


@pytest.mark.parametrize("method", ["guyan", "dynamic"])
def test_condensation_without_modes_holds_at_its_frequency(
    folder: Path, method: str
) -> None:
    """Guyan is right at 0 Hz; the dynamic one at the frequency of a mode has that mode."""
    whole = frequencies(folder / "whole.bdf")
    at = float(whole[0]) if method == "dynamic" else None
    settings = rt.ReductionSettings(below=BELOW, method=method, at=at)  # type: ignore[arg-type]
    part = rt.reduce_model(folder / "branch.bdf", "16", settings)
    assert len(part.kept) == 6
    assert np.isnan(part.deviations[6:]).all()
    part.write(folder / method)
    found = frequencies(folder / f"with_{method}.bdf", 4)
    near = abs(found[0] / whole[0] - 1)
    assert near < 1e-7 if method == "dynamic" else 1e-4 < near < 0.5


def test_the_command_writes_the_part_and_what_each_mode_loses(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "reduce",
        str(folder / "branch.bdf"),
        "--keep",
        "16",
        "--below",
        str(BELOW),
    ]
    assert run([*words, "--out", str(tmp_path / "cb"), "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kept"][:2] == ["16+X", "16+Y"]
    assert np.abs(found["deviations"][:5]).max() < 1e-4  # rigid-body modes
    assert (tmp_path / "cb.asm").read_text().startswith("SEBULK         1EXTERNAL")
    words += ["--method", "dynamic", "--at", "80", "--out", str(tmp_path / "cb")]
    assert run(words) == 0
    said = capsys.readouterr().out
    assert "missing" in said
    assert "one at 80 Hz not at all" in said


def test_matrices_of_an_output4_file_are_those_of_the_punch_file(folder: Path) -> None:
    part = rt.reduce_model(
        folder / "branch.bdf", "16", rt.ReductionSettings(below=BELOW), number=5
    )
    part.write(folder / "cb")
    part.write(folder / "full", op4=True)
    assembly = HEAD + PROPERTIES + FRAME + "INCLUDE 'full.asm'\nINCLUDE 'full.pch'\n"
    text = "ASSIGN INPUTT4='FULL.op4',unit=105\n" + assembly
    (folder / "with_op4.bdf").write_text(text.replace("SUPER=5", "SUPER       5"))
    np.testing.assert_allclose(
        frequencies(folder / "with_op4.bdf"),
        frequencies(folder / "with_cb.bdf"),
        rtol=1e-7,
    )
    held = read_op4(folder / "full.op4")
    np.testing.assert_array_equal(held["KAAX"].toarray(), part.external.stiffness)
    of_msc = {"KXX": held["KAAX"].toarray(), "MXX": held["MAAX"].toarray()}
    write_op4(folder / "msc.op4", of_msc)
    (folder / "with_msc.bdf").write_text(text.replace("FULL.op4", "msc.op4"))
    np.testing.assert_allclose(
        frequencies(folder / "with_msc.bdf"),
        frequencies(folder / "with_op4.bdf"),
        rtol=1e-9,
    )
    (folder / "lost.bdf").write_text(text.replace("unit=105", "unit=72"))
    with pytest.raises(DeckError, match="unit 105: name its file above"):
        read_deck(folder / "lost.bdf")


def test_what_cannot_be_reduced_is_refused(folder: Path, tmp_path: Path) -> None:
    settings = rt.ReductionSettings(below=BELOW)
    with pytest.raises(InputError, match="keep 99: it is not in the model"):
        rt.reduce_model(folder / "branch.bdf", "99", settings)
    with pytest.raises(SingularModel, match="can move while the kept DOFs are held"):
        rt.reduce_model(folder / "branch.bdf", "16+Z", settings)
    with pytest.raises(ConfigError, match="belongs to the method dynamic"):
        rt.ReductionSettings(below=BELOW, method="dynamic")
    bare = tmp_path / "bare.bdf"
    bare.write_text(
        HEAD
        + PROPERTIES
        + FRAME
        + "SEBULK,1,EXTERNAL\nBEGIN SUPER=1\nGRID,16,,2.5,0.,2.\n"
    )
    with pytest.raises(DeckError, match="its bulk data hold no DMIG"):
        read_deck(bare)
    bare.write_text(
        HEAD
        + PROPERTIES
        + FRAME
        + "SEBULK,1,EXTOP2\nBEGIN SUPER=1\nGRID,16,,2.5,0.,2.\n"
    )
    with pytest.raises(UnsupportedCard, match="TYPE EXTOP2"):
        read_deck(bare)


def test_a_factor_on_the_matrices_of_a_part_is_a_parameter(folder: Path) -> None:
    """Stiffness and mass of the branch as matrices: derivatives against central differences, and
    an updating that finds the factors of a twin.
    """
    part = rt.reduce_model(
        folder / "branch.bdf", "16", rt.ReductionSettings(below=BELOW)
    )
    part.write(folder / "cb")
    model = read_deck(folder / "with_cb.bdf")
    assert model["DMIG"]["NAME"].tolist() == ["KAAX@1", "MAAX@1"]
    both = [rt.parameter("branch K", "DMIG 1 A"), rt.parameter("branch M", "DMIG 2 A")]
    parameters = rt.ParameterSet(tuple(both))
    with EmbeddedSolver().open(model) as analysis:
        modes = analysis.modes(ModesRequest(4)).modes
        slopes = [
            analysis.derivatives(modes, parameters.take([i]))[0][:, 0] for i in range(2)
        ]
    lam = (2 * np.pi * modes.frequencies) ** 2
    step = 1e-4
    for i, slope in enumerate(slopes):
        ends = []
        for sign in (1, -1):
            factors = np.ones(2)
            factors[i] += sign * step
            with EmbeddedSolver().open(
                rt.at_factors(model, parameters, factors)
            ) as analysis:
                ends.append(analysis.modes(ModesRequest(4)).modes.frequencies)
        difference = ((2 * np.pi * ends[0]) ** 2 - (2 * np.pi * ends[1]) ** 2) / (
            2 * step
        )
        np.testing.assert_allclose(slope / lam, difference / lam, atol=1e-6)
    twin = rt.solve_modes(
        rt.at_factors(model, parameters, np.array([0.8, 1.2])), count=6
    )
    places = [f"{node}+{axis}" for node in (13, 16, 19) for axis in "XYZ"]
    result = rt.update(model, twin.at(places), parameters)
    np.testing.assert_allclose(result.factors, [0.8, 1.2], rtol=1e-3)


def test_a_study_finds_and_delivers_factors_on_the_matrices_of_a_part(
    folder: Path,
) -> None:
    """The punch file of the delivered deck has the scaled terms, and no other line is changed."""
    part = rt.reduce_model(
        folder / "branch.bdf", "16", rt.ReductionSettings(below=BELOW)
    )
    part.write(folder / "cb")
    model = read_deck(folder / "with_cb.bdf")
    both = (rt.parameter("branch K", "DMIG 1 A"), rt.parameter("branch M", "DMIG 2 A"))
    twin = rt.at_factors(model, rt.ParameterSet(both), np.array([0.8, 1.2]))
    places = [f"{node}+{axis}" for node in (13, 16, 19) for axis in "XYZ"]
    write_modes(folder / "test.json", rt.solve_modes(twin, count=8).at(places))
    sheet = [f"{n},{0.5 * (n - 11)},0,2,{axis}" for n in (13, 16, 19) for axis in "XYZ"]
    (folder / "sensors.csv").write_text("\n".join(["point,x,y,z,direction", *sheet]))
    (folder / "study.toml").write_text(STUDY)
    done = run_study(folder / "study.toml")
    deliver(done)
    found = done.results["update"].updated_values
    assert found["branch K"] == pytest.approx(0.8, rel=1e-3)
    assert found["branch M"] == pytest.approx(1.2, rel=1e-3)
    assert any(
        "(KAAX@1): all terms times 0.8" in line
        for line in done.results["final"].changes
    )
    again = read_deck(done.folder / "updated" / "with_cb.bdf")
    for row, name in enumerate(("branch K", "branch M")):
        before = model["DMIG"].ragged("A").row(row)
        after = again["DMIG"].ragged("A").row(row)
        # of 16 columns
        np.testing.assert_allclose(after, found[name] * before, rtol=1e-8)


def test_scaled_matrices_are_written_in_place(folder: Path, tmp_path: Path) -> None:
    """Small, large and free fields; a matrix of the same name in another section stays."""
    section = "DMIG,KAAX,0,6,1\nDMIG,kaax,11,1,,11,1,2.,,+\n+,11,2,-.5,,12,1,3. $ end\n"
    large = "DMIG*   KAAX                          11               2\n"
    large += "*                     11               2           1.5+3\n"
    small = "DMIG    KAAX          12       1              12       1     4.0\n"
    other = "BEGIN SUPER=1\nGRID,12,,.5,0.,2.\n" + section.replace("11", "12")
    text = (
        HEAD.replace("SPC", "K2GG = KAAX\nSPC")
        + PROPERTIES
        + FRAME
        + section
        + large
        + small
    )
    deck = tmp_path / "deck.bdf"
    deck.write_text(text + "SEBULK,1,EXTERNAL\n" + other)
    model = read_deck(deck)
    assert model["DMIG"]["NAME"].tolist() == ["KAAX", "KAAX@1"]
    halved = rt.at_factors(
        model, rt.ParameterSet((rt.parameter("K", "DMIG 1 A"),)), np.array([0.5])
    )
    (written,) = rt.write_deck(halved, tmp_path / "new")
    lines = deck.read_text().splitlines()
    new = written.read_text().splitlines()
    changed = [b for a, b in zip(lines, new, strict=True) if a != b]
    assert changed == [
        "DMIG,kaax,11,1,,11,1,1.0,,+",
        "+,11,2,-0.25,,12,1,1.5 $ end",
        "*                     11               2           750.0",
        "DMIG    KAAX          12       1              12       1     2.0",
    ]
