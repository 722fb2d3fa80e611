"""Sensors on a deck: where two nodes are at one place, and where the test has a frame or unit of
its own.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_study

from ringtrue.cli.main import run
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.sensor_mapping import Alignment
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import DataError
from ringtrue.io.modes import write_modes
from ringtrue.study.opened import Opened
from ringtrue.study.placing import alignment, between_nodes, mesh_points, shared_places
from ringtrue.virtual.measurements import write_sheet

# a bar on two bushes of no length; its middle node 2 and, beside it, node 30 that nothing holds or
# uses
DECK = """BEGIN BULK
GRID,{ground[0]},,0.,0.,0.,,123456
GRID,{hub[0]},,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,30,,1.,0.,0.
GRID,{hub[1]},,2.,0.,0.
GRID,{ground[1]},,2.,0.,0.
SPC1,1,123456,{ground[1]}
GRID,40,,3.,0.,0.,,123456
CBAR,1,1,{hub[0]},2,0.,0.,1.
CBAR,2,1,2,{hub[1]},0.,0.,1.
PBAR,1,1,1.-3,1.-6,1.-6,1.-6
MAT1,1,2.+11,,.3,7850.
CBUSH,11,2,{ground[0]},{hub[0]},,,,0
CBUSH,12,2,{ground[1]},{hub[1]},,,,0
PBUSH,2,K,1.+6,1.+6,1.+6,1.+6,1.+6,1.+6
ENDDATA
"""


@pytest.mark.parametrize(
    ("hub", "ground"), [((1, 3), (101, 103)), ((101, 103), (1, 3))]
)
def test_of_two_nodes_at_one_place_the_sensor_sits_on_the_moving_one(
    tmp_path: Path, hub: tuple[int, int], ground: tuple[int, int]
) -> None:
    (tmp_path / "bar.bdf").write_text(DECK.format(hub=hub, ground=ground))
    opened = Opened(read_deck(tmp_path / "bar.bdf"), 1.0)
    xyz = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    test = TestModel(
        np.arange(4),
        xyz,
        ("a", "b", "c", "d"),
        np.arange(4),
        np.tile([0.0, 0, 1], (4, 1)),
        np.zeros((0, 2), np.int64),
    )
    seen = opened.observation(test, 0.01)
    read = [opened.analysis.dofs.node[row.indices].tolist() for row in seen.matrix]
    # 40 is held, too, but nothing else is there
    assert read == [[hub[0]], [2], [hub[1]], [40]]


def test_sensors_that_stand_between_nodes_are_told(tmp_path: Path) -> None:
    (tmp_path / "bar.bdf").write_text(DECK.format(hub=(1, 3), ground=(101, 103)))
    opened = Opened(read_deck(tmp_path / "bar.bdf"), 1.0)
    xyz = np.array([[0.01, 0, 0], [1.3, 0, 0]])
    test = TestModel(
        np.arange(2),
        xyz,
        ("a", "b"),
        np.arange(2),
        np.tile([0.0, 0, 1], (2, 1)),
        np.zeros((0, 2), int),
    )
    (told,) = between_nodes(opened, opened.observation(test), "nearest")
    assert told.startswith(
        "1 of 2 channels are read at a node up to 0.3 m from their sensor"
    )
    assert not between_nodes(opened, opened.observation(test, method="rigid"), "rigid")
    assert not between_nodes(opened, opened.observation(test.pick(["a"])), "nearest")


@pytest.mark.parametrize("wanted", [2, 30])
def test_of_two_moving_nodes_at_one_place_the_one_with_the_number_of_the_point_is_read(
    tmp_path: Path, wanted: int
) -> None:
    """A hinge: the bar ends at node 2, another one begins at node 30."""
    text = DECK.format(hub=(1, 3), ground=(101, 103)).replace(
        "CBAR,2,1,2,", "CBAR,2,1,30,"
    )
    (tmp_path / "bar.bdf").write_text(
        text.replace("ENDDATA", "CBUSH,13,2,2,30,,,,0\nENDDATA")
    )
    opened = Opened(read_deck(tmp_path / "bar.bdf"), 1.0)
    test = TestModel(
        np.array([wanted]),
        np.array([[1.0, 1e-3, 0]]),
        ("a",),
        np.array([wanted]),
        np.eye(3)[[2]],
        np.zeros((0, 2), int),
    )
    seen = opened.observation(test, 0.01)
    assert opened.analysis.dofs.node[seen.matrix.indices].tolist() == [wanted]


@pytest.mark.parametrize(
    ("point", "x", "spring", "told"),
    [
        (7, 1.0, 1e6, True),
        (2, 1.0, 1e6, False),
        (7, 1.0, 1e12, False),
        (7, 0.5, 1e12, False),
    ],
)
def test_a_place_of_nodes_that_move_apart_is_said(
    tmp_path: Path, point: int, x: float, spring: float, told: bool
) -> None:
    """A soft hinge is; one as good as rigid, a point with the number of a node, and one between two
    nodes are not.
    """
    text = DECK.format(hub=(1, 3), ground=(101, 103)).replace(
        "CBAR,2,1,2,", "CBAR,2,1,30,"
    )
    hinge = (
        f"CBUSH,13,3,2,30,,,,0\nPBUSH,3,K,{','.join([f'{spring:.1E}'] * 6)}\nENDDATA"
    )
    (tmp_path / "bar.bdf").write_text(text.replace("ENDDATA", hinge))
    opened = Opened(read_deck(tmp_path / "bar.bdf"), 1.0)
    test = TestModel(
        np.array([point]),
        np.array([[x, 0, 0]]),
        ("a",),
        np.array([point]),
        np.array([[0.0, 0, 1]]),
        np.zeros((0, 2), np.int64),
    )
    notes = shared_places(opened, test, opened.modes(500.0).modes)
    assert [n.split(", and one")[0] for n in notes] == told * [
        "point 7: nodes that do not move together are at the place (2 and 30 at point 7)"
    ]


TURN = Alignment(
    np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]),
    np.array([2.0, -3, 1]),
    1.0,
    np.zeros(0),
    np.zeros(0, bool),
)


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Opened]:
    path = tmp_path_factory.mktemp("frame") / "frame.bdf"
    path.write_text(small_study.deck())
    return path, Opened(read_deck(path), 1.0)


def test_a_test_in_millimetres_or_with_left_handed_axes_is_not_laid_onto_the_deck(
    frame: tuple[Path, Opened],
) -> None:
    opened = frame[1]
    test = TURN.move(small_study.test_model())
    assert alignment(test, opened, "points").rms < 1e-9
    millimetres = replace(test, xyz=1e3 * test.xyz)
    for how in ("points", "nearest"):
        with pytest.raises(
            DataError, match=f"align {how}: the points of the test span .* times"
        ):
            alignment(millimetres, opened, how)
    with pytest.raises(DataError, match="mirror image"):
        alignment(replace(test, xyz=test.xyz * [1, -1, 1]), opened, "points")
    wrong = np.array(test.xyz)
    wrong[0] += 2.0  # one point is a gross error, no reason to refuse the others
    assert np.flatnonzero(
        ~alignment(replace(test, xyz=wrong), opened, "points").used
    ).tolist() == [0]


def test_correlate_lays_a_sheet_onto_a_deck_and_judges_over_its_mass(
    frame: tuple[Path, Opened], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deck, opened = frame
    test = small_study.test_model()
    modes = opened.modes(20.0).modes
    shapes = opened.observation(test, 0.01)(modes.shapes)
    here = ModeSet(
        0.7 * modes.frequencies, np.full(len(modes), 0.01), shapes, test.channels
    )
    write_modes(tmp_path / "test.json", here.take(np.arange(4)))
    write_sheet(tmp_path / "sensors.csv", TURN.move(test), test.channels)
    words = [
        "correlate",
        str(tmp_path / "test.json"),
        str(deck),
        "--sensors",
        str(tmp_path / "sensors.csv"),
    ]
    assert run(words) == 2
    assert "farther than" in capsys.readouterr().err
    words += ["--align", "points", "--complete", "--json", "-"]
    # the model is 43 % too high
    for options, pairs in ((["--frequency-gate", "40"], 0), ([], 4)):
        run([*words, *options])
        found = json.loads(capsys.readouterr().out)
        assert len(found["pairs"]) == pairs
    assert all(p["mac_percent"] > 99.9 for p in found["pairs"])
    names = [c["name"] for c in found["complete"]["orthogonality"]]
    assert "cross-orthogonality, IRS mass" in names
    for wrong in (["--match", "far"], ["--align", "point"]):
        assert run([*words, *wrong]) == 2
        assert f"{wrong[0]} '{wrong[1]}'" in capsys.readouterr().err


def _plate(
    path: Path, n: int, first: int, *, size: float = 1.0, held: str = ""
) -> Path:
    """A plate of n by n elements, 1.2 by 0.8 times the size."""
    at = {(i, j): first + i + (n + 1) * j for j in range(n + 1) for i in range(n + 1)}
    lines = [
        f"GRID,{k},,{1.2 * size * i / n:.6f},{0.8 * size * j / n:.6f},0.0"
        for (i, j), k in at.items()
    ]
    corners = (
        ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
        for j in range(n)
        for i in range(n)
    )
    lines += [
        f"CQUAD4,{e},1," + ",".join(str(at[c]) for c in q)
        for e, q in enumerate(corners, 1)
    ]
    lines += [held, "PSHELL,1,1,.004,1", "MAT1,1,2.1+11,,.3,7850.", "ENDDATA"]
    path.write_text("\n".join(["BEGIN BULK", *filter(None, lines)]))
    return path


def test_a_deck_is_held_against_one_of_another_mesh(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A free plate in two meshes whose nodes have nothing in common but the places of some."""
    decks = (
        _plate(tmp_path / "plate6.bdf", 6, 1),
        _plate(tmp_path / "plate9.bdf", 9, 5001),
    )
    status = run(["correlate", str(decks[0]), str(decks[1]), "--json", "-"])
    out, err = capsys.readouterr()
    assert status == 0, err
    pairs = json.loads(out)["pairs"]
    assert [(p["test_mode"], p["fe_mode"]) for p in pairs[:6]] == [
        (k, k + 6) for k in range(1, 7)
    ]
    # the coarse mesh has six elements
    assert all(p["mac_percent"] > 97 for p in pairs[:6])
    (tmp_path / "modes.json").write_text("{}")
    assert run(["correlate", str(decks[0]), str(tmp_path / "modes.json")]) == 2
    assert "is a deck: name the modes of the test first" in capsys.readouterr().err
    large = _plate(tmp_path / "mm.bdf", 9, 5001, size=1e3)
    whole = _plate(tmp_path / "whole.bdf", 9, 5001, size=6.0)
    for pair, told in (
        ((decks[0], large), "1.44 m in size, the other 1.44e+03 m"),
        ((large, decks[0]), "1.44e+03 m in size, the other 1.44 m"),
        ((whole, decks[0]), "4 % of the nodes of the one deck"),
    ):
        assert run(["correlate", *map(str, pair)]) == 2
        assert told in capsys.readouterr().err


def test_held_nodes_are_no_points_of_a_deck(tmp_path: Path) -> None:
    deck = _plate(tmp_path / "held.bdf", 3, 1, held="SPC1,1,123456,1,THRU,4")
    assert mesh_points(Opened(read_deck(deck), 1.0)).points.tolist() == list(
        range(5, 17)
    )


def test_correlate_takes_setups_of_other_sensors_at_the_channels_they_share(
    frame: tuple[Path, Opened], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deck, opened = frame
    test, modes = small_study.test_model(), opened.modes(20.0).modes
    shapes = opened.observation(test)(modes.shapes)[:, :6]
    shapes[:4, 3:5] = np.nan  # the upper modes were seen in one setup
    shapes[1:, 5] = np.nan  # at one channel only
    write_modes(
        tmp_path / "test.json",
        ModeSet(modes.frequencies[:6], np.full(6, 0.01), shapes, test.channels),
    )
    write_sheet(tmp_path / "sensors.csv", test, test.channels)
    words = [
        "correlate",
        str(tmp_path / "test.json"),
        str(deck),
        "--sensors",
        str(tmp_path / "sensors.csv"),
    ]
    for options in ([], ["--complete"]):
        assert run([*words, *options, "--json", "-"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert [p["test_mode"] for p in found["pairs"]] == [1, 2, 3, 4, 5]
    assert run(words) == 0
    told = capsys.readouterr().out
    assert f"Hz: not used, seen at 1 of {len(test.channels)} channels only" in " ".join(
        told.split()
    )
    shapes[1:] = np.nan  # none of them is left: nothing is told of pairs and channels
    write_modes(
        tmp_path / "test.json",
        ModeSet(modes.frequencies[:6], np.full(6, 0.01), shapes, test.channels),
    )
    assert run([*words, "--complete"]) == 1
    told = capsys.readouterr().out
    assert "orthogonality not checked: no mode has a partner" in " ".join(told.split())
    assert "CoMAC" not in told
    assert "collinearity" not in told


def test_strain_is_not_compared_with_motions(
    frame: tuple[Path, Opened], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deck, opened = frame
    test, modes = small_study.test_model(), opened.modes(20.0).modes
    shapes = opened.observation(test)(modes.shapes)[:, :5]
    shapes[3] = np.random.default_rng(0).standard_normal(5)
    write_modes(
        tmp_path / "test.json",
        ModeSet(modes.frequencies[:5], np.full(5, 0.01), shapes, test.channels),
    )
    sheet = tmp_path / "sensors.csv"
    write_sheet(sheet, test, test.channels)
    head, *rows = sheet.read_text().splitlines()
    at = head.split(",").index("quantity"), head.split(",").index("unit")
    row = rows[3].split(",")
    row[at[0]], row[at[1]] = "strain", "ustrain"
    sheet.write_text("\n".join([head, *rows[:3], ",".join(row), *rows[4:]]) + "\n")
    assert (
        run(
            [
                "correlate",
                str(tmp_path / "test.json"),
                str(deck),
                "--sensors",
                str(sheet),
            ]
        )
        == 0
    )
    assert f"not compared, of strain: {test.channels[3]}" in " ".join(
        capsys.readouterr().out.split()
    )
    assert (
        run(
            [
                "localise",
                str(deck),
                str(tmp_path / "test.json"),
                "--sensors",
                str(sheet),
            ]
        )
        == 2
    )
    assert f"channel {test.channels[3]} measures strain" in " ".join(
        capsys.readouterr().err.split()
    )
