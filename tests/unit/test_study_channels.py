"""Names of channels: on a sensor sheet alone where there is one, whatever their sign, and never
nodes of the deck.

A column of 4 m, clamped below, with a mass at its head. Its nodes count from below, the points of
the sheet from above:

    z, m     4     3.5   3     2.5   2     1.5   1     0.5   0
    node     9     8     7     6     5     4     3     2     1 (clamped)
    point    1           2           3           4

Point 4 is read at node 3; node 4 is another place. Moduli and densities of the truth are 20 % above
the deck's, so that its frequencies are those of the deck: FRFs alone tell the factors.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringtrue.cli.main import run
from ringtrue.core.channels import match_channels
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, DataError
from ringtrue.fem.response import frf
from ringtrue.io.frfs import write_frfs
from ringtrue.io.modes import write_modes
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.ports import ModesRequest
from ringtrue.report.build import assemble
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.config_sections import StudyInfo
from ringtrue.study.messages import run_messages
from ringtrue.study.run import run_study
from ringtrue.study.summary import summarise
from ringtrue.study.supplied import frfs_by_sheet

TRUTH = 1.2
DAMPING = 0.01
NODE = {1: 9, 2: 7, 3: 5, 4: 3}  # of each point
SHEET = "point,x,y,z,direction,quantity\n" + "".join(
    f"{p},0,0,{0.5 * (n - 1)},{axis},\n" for p, n in NODE.items() for axis in "XY"
)
FORCE = "3,0,0,2,-Z,force\n"  # an excitation point without a sensor
STUDY = """[model]
deck = "column.bdf"
fmax = 400.0
[test]
sheet = "sensors.csv"
{test}
[update]
left_out = 0
discrepancy = "assumed"
[[candidate]]
name = "modulus"
targets = ["MAT1 1 E"]
[[candidate]]
name = "density"
targets = ["MAT1 1 RHO"]
[[residual]]
{residual}
"""
FRFS = 'kind = "frf"\nfile = "frfs.h5"\ndamping = 0.01\nerror = 0.01\n'
MODES = 'modes = "modes.json"'


def deck(factor: float = 1.0) -> str:
    lines = ["SOL 103", "CEND", "SPC = 1", "BEGIN BULK"]
    lines += [f"GRID,{k},,0.,0.,{0.5 * (k - 1)}" for k in range(1, 10)]
    lines += [f"CBAR,{k},1,{k},{k + 1},1.,0.,0." for k in range(1, 9)]
    lines += [
        f"MAT1,1,{2e11 * factor:.6E},,.3,{7850 * factor:.6E}",
        "PBAR,1,1,2.-3,3.-6,2.-6,4.-6",
    ]
    return "\n".join([*lines, "SPC1,1,123456,1", "ENDDATA", ""])


def truth(folder: Path, channels: list[str]) -> ModeSet:
    """The bending modes of the truth at channels, each the sign times the translation of the node
    of its point.
    """
    (folder / "truth.bdf").write_text(deck(TRUTH))
    with EmbeddedSolver().open(read_deck(folder / "truth.bdf")) as analysis:
        modes = analysis.modes(ModesRequest(40)).modes
        bending = modes.rows(
            [f"{n}+{axis}" for n in NODE.values() for axis in "XY"]
        ).shapes
        modes = modes.take(np.flatnonzero(np.abs(bending).max(axis=0) > 1e-6))
    (folder / "truth.bdf").unlink()
    rows = [NODE[int(c[0])] for c in channels]
    sign = np.array([-1.0 if c[1] == "-" else 1.0 for c in channels])
    shapes = (
        modes.rows([f"{n}+{c[2]}" for n, c in zip(rows, channels, strict=True)]).shapes
        * sign[:, None]
    )
    return ModeSet(
        modes.frequencies,
        np.full(len(modes), DAMPING),
        shapes,
        tuple(channels),
        modes.norm,
    )


def frfs(modes: ModeSet, outputs: list[str], inputs: list[str]) -> FrfSet:
    f = np.linspace(2.0, 120.0, 400)
    sides = (modes.rows(names).shapes for names in (outputs, inputs))
    h = frf(f, modes.frequencies, modes.damping, *sides)
    return FrfSet(
        h,
        f,
        tuple(Channel(c, "acceleration", "m/s^2") for c in outputs),
        tuple(Channel(c, "force", "N") for c in inputs),
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "column.bdf").write_text(deck())
    (tmp_path / "sensors.csv").write_text(SHEET)
    there = truth(tmp_path, ["1+X", "2-X", "3+X", "4-X", "1+Y", "2+Y", "3+Y", "4-Y"])
    write_modes(tmp_path / "modes.json", there.band(0.0, 400.0))
    write_frfs(tmp_path / "frfs.h5", frfs(there, ["4-X", "1+X"], ["4-X"]))
    return tmp_path


def study(folder: Path, residual: str = FRFS, test: str = MODES) -> Path:
    (folder / "study.toml").write_text(STUDY.format(test=test, residual=residual))
    return folder / "study.toml"


def updated(
    folder: Path, capsys: pytest.CaptureFixture[str], *words: str
) -> dict[str, object]:
    capsys.readouterr()
    status = run(
        [
            "update",
            str(folder / "study.toml"),
            str(folder / "modes.json"),
            "--json",
            "-",
            *words,
        ]
    )
    out, err = capsys.readouterr()
    assert status == 0, err
    found: dict[str, object] = json.loads(out)
    return found


def factors(found: dict[str, object]) -> list[float]:
    return [p["factor"] for p in found["parameters"]]  # type: ignore[index, attr-defined]


def test_frfs_of_a_sensor_read_the_other_way_find_the_mass(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study(folder)
    found = updated(folder, capsys)
    np.testing.assert_allclose(factors(found), TRUTH, rtol=2e-3)  # the prior pulls
    place = next(s for s in found["sensors"] if s["channel"] == "4-X")  # type: ignore[attr-defined, index]
    assert (place["sensor"], place["sign"], place["point"], place["nodes"]) == (
        "4+X",
        -1,
        4,
        [3],
    )
    assert place["distance_m"] < 1e-9
    told = " ".join(found["notes"])  # type: ignore[arg-type]
    assert "4 -> 3" in told
    assert "4-X is 4+X turned" in told


def test_the_study_finds_the_same_and_shows_the_nodes(folder: Path) -> None:
    done = run_study(study(folder), until="update")
    found = summarise(done)
    np.testing.assert_allclose(
        [p["factor"] for p in found["parameters"]], TRUTH, rtol=2e-3
    )
    assert {s["point"]: s["nodes"] for s in found["sensors"]} == {
        p: [n] for p, n in NODE.items()
    }
    (beside,) = (m["sensors"] for m in found["measured"])
    assert [(s["channel"], s["sensor"], s["sign"], s["nodes"]) for s in beside] == [
        ("1+X", "1+X", 1, [9]),
        ("4-X", "4+X", -1, [3]),
    ]
    text = (
        assemble(done.results, info=StudyInfo(title="column"))
        .write(folder / "report.html")
        .read_text(encoding="utf-8")
    )
    assert "Where the sensors are read (8 channels)" in text
    assert "4-X is 4+X turned" in text


@pytest.mark.parametrize("how", ["update", "run"])
def test_frfs_of_the_test_serve_a_residual_without_a_file(
    folder: Path, capsys: pytest.CaptureFixture[str], how: str
) -> None:
    there = truth(folder, ["1+X", "2-X", "3+X", "4-X"])
    write_frfs(folder / "frfs.h5", frfs(there, ["1+X", "2-X", "3+X", "4-X"], ["4-X"]))
    residual = 'kind = "frf"\ndamping = 0.01\nerror = 0.01\noutputs = ["4-X", "1-X"]\n'
    path = study(folder, residual, 'frfs = ["frfs.h5"]')
    if how == "update":
        assert factors(updated(folder, capsys)) == pytest.approx(
            [TRUTH, TRUTH], rel=2e-3
        )
        return
    found = summarise(run_study(path, until="update"))
    assert [p["factor"] for p in found["parameters"]] == pytest.approx(
        [TRUTH, TRUTH], rel=2e-3
    )


@pytest.mark.parametrize("name", ["6+X", "4+Z", "2-RX", "tip"])
@pytest.mark.parametrize("how", ["update", "run"])
def test_a_channel_that_the_sheet_does_not_have_is_refused_by_name(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, how: str
) -> None:
    """There is a node 6, and 4+Z and 2-RX are degrees of freedom of the deck."""
    first = frfs(truth(folder, ["4+X", "1+X"]), ["1+X", "4+X"], ["4+X"])
    other = replace(
        first, outputs=(first.outputs[0], Channel(name, "acceleration", "m/s^2"))
    )
    write_frfs(folder / "frfs.h5", other)
    path = study(folder)
    told = f"[[residual]] frf: channel {name} is not on the sensor sheet"
    if how == "update":
        assert run(["update", str(path), str(folder / "modes.json")]) == 2
        assert f"channel {name} is not on the sensor sheet" in capsys.readouterr().err
        return
    with pytest.raises(DataError) as refused:
        run_study(path, until="update")
    assert str(refused.value).startswith(told)


def test_static_tests_and_zeros_are_read_at_the_sheet(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The deflection of 4-X under a load along 1-X is that of a cantilever, F z² (3 L − z) / 6 E
    I.
    """
    stiffness, load = 2e11 * TRUTH * 3e-6, 1000.0
    moved = load * 1.0**2 * (3 * 4.0 - 1.0) / (6 * stiffness)
    with (folder / "pull.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerows(
            [
                ("case", "channel", "load", "deflection"),
                ("a", "1-X", load, ""),
                ("a", "4-X", "", moved),
            ]
        )
    study(folder, 'kind = "static"\nfile = "pull.csv"\nerror = 0.001\n')
    assert factors(updated(folder, capsys))[0] == pytest.approx(TRUTH, rel=5e-3)


def test_correlate_shows_the_nodes_and_reads_turned_channels(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["correlate", str(folder / "modes.json"), str(folder / "column.bdf")]
    assert (
        run(
            [
                *words,
                "--sensors",
                str(folder / "sensors.csv"),
                "--json",
                str(folder / "c.json"),
            ]
        )
        == 0
    )
    out = capsys.readouterr().out
    found = json.loads((folder / "c.json").read_text())
    assert min(p["mac_percent"] for p in found["pairs"]) > 99.9
    assert {s["point"]: s["nodes"] for s in found["sensors"]} == {
        p: [n] for p, n in NODE.items()
    }
    assert (
        "1 of 4 points are read at the node of their number; point -> node: 1 -> 9, 2 -> 7, 4 -> 3"
        not in out
    )
    assert (
        "0 of 4 points are read at the node of their number; point -> node: 1 -> 9, 2 -> 7, 3 -> "
        "5, 4 -> 3" in out
    )
    assert "2-X is 2+X turned" in out
    assert (
        run(
            [
                "localise",
                str(folder / "column.bdf"),
                words[1],
                "--sensors",
                str(folder / "sensors.csv"),
            ]
        )
        == 0
    )
    assert "4 -> 3" in capsys.readouterr().out


def test_two_sets_of_modes_are_compared_at_sensors_whatever_their_signs(
    folder: Path,
) -> None:
    other = truth(folder, ["1-X", "2-X", "3-X", "4+X", "1+Y", "2-Y", "3+Y", "4+Y"])
    write_modes(folder / "other.json", other.band(0.0, 400.0))
    words = [
        "correlate",
        str(folder / "modes.json"),
        str(folder / "other.json"),
        "--json",
        str(folder / "c.json"),
    ]
    assert run(words) == 0
    assert (
        min(
            p["mac_percent"]
            for p in json.loads((folder / "c.json").read_text())["pairs"]
        )
        > 99.999
    )


def test_records_take_the_names_and_signs_of_the_sheet(folder: Path) -> None:
    sheet = read_sensor_sheet(folder / "sensors.csv")
    data = np.arange(6.0).reshape(2, 3)
    record = TimeHistory(
        data,
        10.0,
        (Channel("4-X", "acceleration", "m/s^2"), Channel("1+X", "velocity", "m/s")),
    )
    found, notes = sheet.scaled(record)
    assert [c.id for c in found.channels] == ["4+X", "1+X"]
    np.testing.assert_array_equal(found.data, data * [[-1.0], [1.0]])
    assert notes == ("channel names on the sensor sheet: 4-X is 4+X turned",)
    both = replace(record, channels=(Channel("4-X"), Channel("4+X")))
    with pytest.raises(
        DataError,
        match=r"channels 4-X and 4[+]X are the same sensor of the sheet, 4[+]X",
    ):
        sheet.scaled(both)


def test_frfs_take_the_names_and_signs_of_the_sheet(folder: Path) -> None:
    """An impact against the direction of a sensor is at its driving point; what is not on the sheet
    keeps its name.
    """
    sheet = read_sensor_sheet(folder / "sensors.csv").model
    there = truth(folder, ["1+X", "4-X"])
    found, notes = frfs_by_sheet(frfs(there, ["1+X", "4-X"], ["1+X", "4-X"]), sheet)
    assert (
        [c.id for c in found.outputs] == [c.id for c in found.inputs] == ["1+X", "4+X"]
    )
    right = truth(folder, ["1+X", "4+X"])
    np.testing.assert_allclose(
        found.data, frfs(right, ["1+X", "4+X"], ["1+X", "4+X"]).data
    )
    assert notes == ("channel names on the sensor sheet: 4-X is 4+X turned",)
    other = replace(found, inputs=(found.inputs[0], Channel("9+X", "force", "N")))
    assert frfs_by_sheet(other, sheet) == (other, ())


def test_an_excitation_point_of_the_sheet_is_found_and_a_name_against_its_direction_is_not(
    folder: Path,
) -> None:
    (folder / "sensors.csv").write_text(SHEET + FORCE + "7,0,0,1,-X,\n")
    text = (
        (folder / "sensors.csv")
        .read_text()
        .replace("direction,quantity", "direction,quantity,channel")
    )
    rows = [
        line + ("," if k < 9 else ",7+X")
        for k, line in enumerate(text.splitlines()[1:])
    ]
    (folder / "sensors.csv").write_text("\n".join([text.splitlines()[0], *rows]) + "\n")
    sheet = read_sensor_sheet(folder / "sensors.csv").model
    assert sheet.forces == ("3-Z",)
    force = sheet.pick(["3+Z"])
    np.testing.assert_array_equal(force.axes, [[0.0, 0.0, 1.0]])
    assert force.at.tolist() == [3]
    # as the sheet says
    np.testing.assert_array_equal(sheet.pick(["7+X"]).axes, [[-1.0, 0.0, 0.0]])
    with pytest.raises(
        DataError,
        match=r"channel 7-X is not on the sensor sheet.* 7\+X is against its name",
    ):
        sheet.pick(["7-X"])


def test_names_are_matched_whatever_their_form() -> None:
    index, sign = match_channels(
        ["4X", "4:-X", "4-x", "12-RZ", "ch1", "5+X"], ["ch1", "12+RZ", "4+X"]
    )
    assert index.tolist() == [2, 2, 2, 1, 0, -1]
    assert sign.tolist() == [1.0, -1.0, -1.0, -1.0, 1.0, 1.0]


def test_frfs_that_are_nowhere_are_asked_for(folder: Path) -> None:
    path = study(folder, 'kind = "frf"\n')
    with pytest.raises(ConfigError, match="the test has no FRFs"):
        run_study(path, until="update")


TURNED = (
    SHEET.replace(",X,", ",Q,").replace(",Y,", ",Z,").replace(",Q,", ",Y,")
)  # X is called Y, and Y Z


def named_as(sheet: str, channels: list[str]) -> str:
    """The sheet with these names in its column `channel`."""
    head, *rows = sheet.splitlines()
    return (
        "\n".join(
            [
                f"{head},channel",
                *(f"{r},{c}" for r, c in zip(rows, channels, strict=True)),
            ]
        )
        + "\n"
    )


@pytest.mark.parametrize("sheet", ["given", "none"])
def test_correlate_tries_turned_axes_before_it_advises(
    folder: Path, capsys: pytest.CaptureFixture[str], sheet: str
) -> None:
    channels = [f"{p}+{axis}" for p in NODE for axis in "XY"]
    modes = truth(folder, channels).band(0.0, 400.0)
    words = []
    if sheet == "given":
        write_modes(folder / "modes.json", modes)
        (folder / "sensors.csv").write_text(named_as(TURNED, channels))
        words = ["--sensors", str(folder / "sensors.csv")]
    else:
        names = tuple(
            f"{NODE[int(c[0])]}{c[1]}{'YZ'['XY'.index(c[2])]}" for c in channels
        )
        write_modes(folder / "modes.json", replace(modes, labels=names))
    status = run(
        [
            "correlate",
            str(folder / "modes.json"),
            str(folder / "column.bdf"),
            *words,
            "--json",
            "-",
        ]
    )
    found = json.loads(capsys.readouterr().out)
    (mending,) = found["mendings"]
    assert mending["axes"] == {"Y": "X", "Z": "Y"}
    now, then = mending["mean_mac_percent"]
    assert then > 99.0
    assert now < 60.0
    assert mending["pairs"][1] == len(modes) > mending["pairs"][0]
    assert status == (0 if found["pairs"] else 1)  # as it is: nothing is mended
    run(["correlate", str(folder / "modes.json"), str(folder / "column.bdf"), *words])
    out = capsys.readouterr().out
    said = out.index(f"rises from {now:.1f} to {then:.1f} %")
    assert said < out.index("has MAC")  # why modes have no partner


def test_a_study_tries_turned_axes_and_shows_them(folder: Path) -> None:
    channels = [f"{p}+{axis}" for p in NODE for axis in "XY"]
    write_modes(folder / "modes.json", truth(folder, channels).band(0.0, 400.0))
    (folder / "sensors.csv").write_text(named_as(TURNED, channels))
    done = run_study(study(folder, 'kind = "mass"\nmass = 60.0\n'), until="correlate")
    (mending,) = summarise(done)["mendings"]
    assert mending["axes"] == {"Y": "X", "Z": "Y"}
    assert mending["text"] in run_messages(done.results)
    text = (
        assemble(done.results, info=StudyInfo(title="column"))
        .write(folder / "report.html")
        .read_text(encoding="utf-8")
    )
    assert "if the sensors along Y read X, Z read Y" in text


def test_two_tests_of_which_one_has_reversed_an_axis(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Modes that move along both axes, as those of a bent structure: without these the sign of an
    axis says nothing.
    """
    channels = [f"{p}+{axis}" for p in NODE for axis in "XY"]
    low = truth(folder, channels).band(0.0, 400.0)
    rotation = np.linalg.qr(
        np.random.default_rng(3).standard_normal((len(low), len(low)))
    )[0]
    modes = replace(low, shapes=low.shapes @ rotation)
    turned = np.array([1.0 if c.endswith("X") else -1.0 for c in channels])
    write_modes(folder / "modes.json", modes)
    write_modes(
        folder / "other.json", replace(modes, shapes=modes.shapes * turned[:, None])
    )
    assert (
        run(["correlate", str(folder / "modes.json"), str(folder / "modes.json")]) == 0
    )
    assert "may be mounted" not in capsys.readouterr().out
    run(
        [
            "correlate",
            str(folder / "modes.json"),
            str(folder / "other.json"),
            "--json",
            "-",
        ]
    )
    (mending,) = json.loads(capsys.readouterr().out)["mendings"]
    # the sign of all sensors says nothing
    assert mending["axes"] in ({"X": "-X"}, {"Y": "-Y"})
    assert mending["mean_mac_percent"][1] > 99.9
