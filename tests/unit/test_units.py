"""One cantilever in every unit system: each command gives the same answer in SI, and tells of a
system that is not its.

A steel cantilever of 1 m, 20 mm square, its tip node 11:

    1 ====================================== 11 --> X      E = 2.1e11 Pa, rho = 7850 kg/m3
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from ringtrue.checks.materials import check_units
from ringtrue.cli.main import run
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import UnsupportedError
from ringtrue.io.modes import write_modes
from ringtrue.model.edit import in_seconds
from ringtrue.study.direct import with_lumps
from ringtrue.study.opened import Opened
from ringtrue.updating.selection.candidates import CandidateSettings

Capture = pytest.CaptureFixture[str]
ELEMENTS = 10
G_INCH = 386.0886  # in/s2: pounds of weight over pounds-seconds squared per inch
LINE = re.compile(r"^warning: ", re.MULTILINE)


def cantilever(
    units: str, *, weight: float = 1.0, more: str = "", modulus: float = 2.1e11
) -> str:
    """The deck in a unit system; with `weight` its masses are so much larger and PARAM,WTMASS makes
    up for it.
    """
    u = UNIT_SYSTEMS[units]
    side = 0.02 / u.length
    area, bending = side**2, side**4 / 12
    lines = [
        "SOL 103",
        "CEND",
        "SPC = 1",
        "BEGIN BULK",
        f"PARAM,WTMASS,{1 / weight:.9e}",
    ]
    lines += [
        f"GRID,{i + 1},,{i / ELEMENTS / u.length:.9g},0.,0."
        for i in range(ELEMENTS + 1)
    ]
    lines += [f"CBAR,{i + 1},1,{i + 1},{i + 2},0.,1.,0." for i in range(ELEMENTS)]
    lines.append(f"PBAR,1,1,{area:.9e},{bending:.9e},{bending:.9e},{1.7 * bending:.9e}")
    lines.append(
        f"MAT1,1,{modulus / u.modulus:.9e},,.3,{7850 / u.density * weight:.9e}"
    )
    return "\n".join([*lines, more, "SPC1,1,123456,1", "ENDDATA", ""])


def written(path: Path, units: str, **more: object) -> Path:
    path.write_text(cantilever(units, **more))  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("units", [*UNIT_SYSTEMS, "in-lbf-s weighed"])
def test_every_system_gives_the_same_response(
    tmp_path: Path, capsys: Capture, units: str
) -> None:
    """Accelerance and deflection of the tip in SI, from decks whose figures have nothing in
    common.
    """
    name, _, weighed = units.partition(" ")
    deck = written(tmp_path / "d.bdf", name, weight=G_INCH if weighed else 1.0)
    told = []
    for d, u in ((written(tmp_path / "si.bdf", "SI"), "SI"), (deck, name)):
        words = [
            "frf",
            str(d),
            "--force",
            "11+Z",
            "--fmax",
            "200",
            "--lines",
            "50",
            "--damping",
            "0.02",
        ]
        assert run([*words, "--units", u, "--json", "-"]) == 0
        shown = capsys.readouterr()
        assert not LINE.search(shown.err)
        told.append(json.loads(shown.out)["frfs"][0])
        assert (
            run(["static", str(d), "--force", "11+Z=100", "--units", u, "--json", "-"])
            == 0
        )
        told[-1]["static"] = json.loads(capsys.readouterr().out)["cases"][0]["metre"][
            "11+Z"
        ]
    si, here = told
    np.testing.assert_allclose(
        here["re"], si["re"], rtol=1e-6, atol=1e-6 * np.abs(si["re"]).max()
    )
    np.testing.assert_allclose(
        here["im"], si["im"], rtol=1e-6, atol=1e-6 * np.abs(si["im"]).max()
    )
    assert here["static"] == pytest.approx(
        100 / (3 * 2.1e11 * 0.02**4 / 12), rel=1e-4
    )  # F l3 / 3 E I
    assert here["unit"] == si["unit"]


@pytest.mark.parametrize(
    "words",
    [
        ("frf", "--force", "11+Z", "--fmax", "50", "--lines", "5", "--damping", "0.01"),
        ("static", "--force", "11+Z"),
        (
            "plan",
            "--band",
            "1",
            "200",
            "--points",
            "3",
            "--references",
            "1",
            "--out",
            "plan",
        ),
        ("localise", "test.json"),
    ],
)
def test_a_deck_that_is_in_another_system_is_told(
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
) -> None:
    """A deck in mm, t and s that is taken for SI: figures a thousand times too large, without a
    word.
    """
    monkeypatch.chdir(tmp_path)
    deck = written(tmp_path / "d.bdf", "mm-t-s")
    assert run(["modes", str(deck), "-n", "4", "--out", "test.json"]) == 0
    capsys.readouterr()
    run([words[0], str(deck), *words[1:]])
    told = capsys.readouterr().err
    assert (
        "d.bdf:28: MAT1 1: E 210000 with RHO 7.85e-09 (WTMASS applied) are not plausible in SI"
        in told
    )
    assert "they would be in mm-t-s" in told
    run([words[0], str(deck), *words[1:], "--units", "mm-t-s"])
    assert not LINE.search(capsys.readouterr().err)


def test_correlate_judges_the_units_of_a_deck(tmp_path: Path, capsys: Capture) -> None:
    deck = written(tmp_path / "d.bdf", "mm-t-s")
    assert run(["modes", str(deck), "-n", "4", "--out", str(tmp_path / "t.json")]) == 0
    capsys.readouterr()
    assert run(["correlate", str(tmp_path / "t.json"), str(deck)]) == 0
    assert "they would be in mm-t-s" in capsys.readouterr().err


def test_a_deck_that_mixes_two_systems_is_told(tmp_path: Path, capsys: Capture) -> None:
    """A part of mm, t and s merged into a deck in m, kg and s."""
    deck = written(tmp_path / "d.bdf", "SI", more="MAT1,2,70000.,,.3,2.7-9")
    assert run(["check", str(deck)]) == 0
    told = capsys.readouterr().out
    assert (
        "the deck mixes unit systems, its materials fit no one of them: MAT1 1 fits SI; MAT1 2 "
        "fits mm-t-s" in told
    )
    assert run(["static", str(deck), "--force", "11+Z"]) == 0
    assert "the deck mixes unit systems" in capsys.readouterr().err
    alone = read_deck(written(tmp_path / "e.bdf", "SI", more="MAT1,2,7.+10,,.3,2700."))
    assert not check_units(alone)


def test_a_deck_in_milliseconds_has_its_frequencies_in_hertz(tmp_path: Path) -> None:
    """And is judged by the values of its deck."""
    model = read_deck(written(tmp_path / "ms.bdf", "mm-kg-ms"))
    assert in_seconds(model, UNIT_SYSTEMS["mm-t-s"]) is model
    seconds = in_seconds(model, UNIT_SYSTEMS["mm-kg-ms"])
    assert not check_units(seconds, "mm-kg-ms")
    plain = read_deck(written(tmp_path / "si.bdf", "SI"))
    hertz, same = (
        Opened(m, 1.0).modes(300.0).modes.frequencies for m in (seconds, plain)
    )
    np.testing.assert_allclose(hertz, same, rtol=1e-6)  # the decks have nine digits
    damped = read_deck(
        written(tmp_path / "c.bdf", "mm-kg-ms", more="CDAMP2,99,0.1,11,3")
    )
    with pytest.raises(
        UnsupportedError,
        match=r"CDAMP2 B: dashpots of a deck whose unit of time is 0\.001 s",
    ):
        in_seconds(damped, UNIT_SYSTEMS["mm-kg-ms"])


def test_a_mass_that_a_weighed_deck_lacks_is_in_pounds(tmp_path: Path) -> None:
    """PARAM,WTMASS scales the CONM2 that the deck gets, too."""
    pounds = read_deck(written(tmp_path / "d.bdf", "in-lbf-s", weight=G_INCH))
    kilograms = read_deck(written(tmp_path / "si.bdf", "SI"))
    total = [
        with_lumps(Opened(m, 1.0), np.array([11]), CandidateSettings())[1][
            0
        ].parameter.lump
        for m in (pounds, kilograms)
    ]
    assert total[0] * 0.45359237 == pytest.approx(total[1], rel=1e-5)
    named = CandidateSettings(units="in-lbf-s")
    assert named.of(pounds).unit("mass") == ""  # the deck has pounds there
    assert named.of(pounds).unit("modulus") == "psi"
    assert named.of(kilograms).unit("mass") == "lbf s2/in"


STUDY = """[model]
deck = "d.bdf"
units = "{units}"
[test]
sheet = "s.csv"
modes = "modes.json"
[[candidate]]
name = "E"
targets = ["MAT1 1 E"]
[predict]
rotor = 11
mass = 5.0
lines = 40
draws = 20
springs = {{ foot = [58] }}
"""


def _study(folder: Path, units: str, weight: float) -> Path:
    """A cantilever on a spring in the middle of its length; the modes are those of 10 % less
    modulus.
    """
    folder.mkdir()
    u = UNIT_SYSTEMS[units]
    k = 2e4 / (u.force / u.length)
    foot = f"CBUSH,80,58,6,,,,,0\nPBUSH,58,K,{k:.9e},{k:.9e},{k:.9e}"
    (folder / "d.bdf").write_text(cantilever(units, weight=weight, more=foot))
    (folder / "t.bdf").write_text(
        cantilever(units, weight=weight, more=foot, modulus=1.89e11)
    )
    modes = Opened(read_deck(folder / "t.bdf"), 1.0).modes(400.0).modes
    channels = [f"{n}+{a}" for n in range(2, 12) for a in "YZ"]
    row, sign = modes.labels.align(DofSet.parse(channels))
    seen = ModeSet(
        modes.frequencies,
        np.full(len(modes), 0.01),
        modes.shapes[row] * sign[:, None],
        tuple(channels),
    )
    write_modes(folder / "modes.json", seen)
    places = [f"{n},{(n - 1) / 10},0,0,+{a}\n" for n in range(2, 12) for a in "YZ"]
    (folder / "s.csv").write_text("point,x,y,z,direction\n" + "".join(places))
    path = folder / "study.toml"
    path.write_text(STUDY.format(units=units))
    return path


def test_a_study_in_inches_and_pounds_is_that_in_si(
    tmp_path: Path, capsys: Capture
) -> None:
    """Mass in t, factor, and the run-up in m and N: the unbalance is in kg, the deck has pounds and
    PARAM,WTMASS.
    """
    told = []
    for name, units, weight in (("si", "SI", 1.0), ("inch", "in-lbf-s", G_INCH)):
        study = _study(tmp_path / name, units, weight)
        assert run(["run", str(study)]) == 0
        assert not LINE.search(capsys.readouterr().err)
        found = json.loads((study.parent / "summary.json").read_text())
        assert run(["predict", str(study), "--json", "-"]) == 0
        shown = capsys.readouterr()
        assert not LINE.search(shown.err)
        told.append(
            (found["mass_t"], found["parameters"][0]["factor"], json.loads(shown.out))
        )
    (mass, factor, si), (pounds, other, inch) = told
    assert pounds == pytest.approx(mass, rel=1e-5)
    assert (factor, other) == pytest.approx((0.9, 0.9), rel=1e-3)
    peaks = [
        [o["peak"][1] for o in p["outputs"][:2]] for p in (si, inch)
    ]  # the rotor, the most loaded spring
    assert [o["unit"] for o in inch["outputs"]] == [o["unit"] for o in si["outputs"]]
    np.testing.assert_allclose(
        peaks[1], peaks[0], rtol=1e-2
    )  # draws of posteriors that differ in rounding


@pytest.mark.parametrize("command", ["run", "update"])
def test_a_study_that_names_other_units_is_told(
    tmp_path: Path, capsys: Capture, command: str
) -> None:
    study = _study(tmp_path / "si", "SI", 1.0)
    study.write_text(study.read_text().replace('units = "SI"', 'units = "mm-t-s"'))
    more = (
        ["--until", "model"] if command == "run" else [str(study.parent / "modes.json")]
    )
    run([command, str(study), *more])
    assert "are not plausible in mm-t-s; they would be in SI" in capsys.readouterr().err
