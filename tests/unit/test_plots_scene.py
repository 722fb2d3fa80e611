"""What is drawn and counted of a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import UnsupportedError
from ringtrue.plots.scene import regions
from ringtrue.study.results import Scene
from ringtrue.study.run import run_study
from ringtrue.study.scene import _faces, make_scene
from ringtrue.viewer.scene import model_arrays


def test_a_region_has_the_colour_of_what_changes_it_and_little_else() -> None:
    """A density of all parts does not cover the thickness of one, in whatever order they stand."""
    part = np.arange(3)
    scene = Scene(
        part,
        np.eye(3),
        part[None, :],
        part[:1],
        np.zeros((0, 2), int),
        part[:0],
        ("a", "b", "c"),
    )
    changed = {"thickness of b": [1], "density": [0, 1, 2], "far away": []}
    for order in (list(changed), list(reversed(changed))):
        view = regions(scene, {k: changed[k] for k in order}, {"density": "× 1.1"})
        colour = {x["name"]: x["color"] for x in view.payload["legend"]}
        drawn = view.payload["colors"]
        assert drawn == [colour["density"], colour["thickness of b"], colour["density"]]
        assert list(colour) == [k + ", not drawn" * (k == "far away") for k in order]


def test_cards_are_those_of_the_deck(tmp_path: Path) -> None:
    """A PBARL makes a PBAR that the deck does not have."""
    nodes = [f"GRID,{i},,{i}.,0.,0." for i in range(1, 5)]
    bars = [f"CBAR,{i},{p},{i},{i + 1},0.,0.,1." for i, p in ((1, 1), (2, 1), (3, 2))]
    cards = [
        "PBARL,1,1,,ROD",
        ",.1",
        "PBAR,2,1,.01,1.-5,1.-5,2.-5",
        "MAT1,1,2.1+11,,.3,7850.",
        "SPC1,1,123456,1",
    ]
    deck = [
        "SOL 103",
        "CEND",
        "SPC = 1",
        "BEGIN BULK",
        *nodes,
        *bars,
        *cards,
        "ENDDATA",
    ]
    (tmp_path / "bar.bdf").write_text("\n".join(deck))
    (tmp_path / "study.toml").write_text('[model]\ndeck = "bar.bdf"\n')
    found = run_study(tmp_path / "study.toml", until="model").results["model"].cards
    assert found == {"CBAR": 3, "GRID": 4, "MAT1": 1, "PBAR": 1, "PBARL": 1, "SPC1": 1}


def test_the_skin_of_solids_and_shells_of_every_card(tmp_path: Path) -> None:
    """Two tetrahedra joined at 1, 2, 3, on a pyramid and a shell of the second order."""
    deck = tmp_path / "d.bdf"
    grids = "".join(
        f"GRID,{i + 1},,{x},{y},{z}\n"
        for i, (x, y, z) in enumerate(np.eye(9, 3).tolist())
    )
    solids = "CTETRA,1,1,1,2,3,4\nCTETRA,2,1,1,3,2,5\nCPYRAM,3,1,1,2,6,7,8\n"
    deck.write_text(
        f"BEGIN BULK\n{grids}{solids}CTRIA6,4,2,1,2,9\nPSOLID,1,1\nPSHELL,2,1,1.\nMAT1,1,1.,,.3\n"
    )
    drawn, _ = _faces(read_deck(deck))
    skin = sorted(tuple(sorted(set(q))) for q in drawn.tolist())
    pyramid = [(1, 2, 6, 7), (1, 2, 8), (2, 6, 8), (6, 7, 8), (1, 7, 8)]
    tetrahedra = [(1, 2, 4), (1, 3, 4), (2, 3, 4), (1, 2, 5), (1, 3, 5), (2, 3, 5)]
    assert skin == sorted([*tetrahedra, *pyramid, (1, 2, 9)])


def grids(*places: tuple[float, float, float]) -> list[str]:
    return [f"GRID,{i},,{x},{y},{z}" for i, (x, y, z) in enumerate(places, 1)]


def scene_of(tmp_path: Path, *cards: str) -> Scene:
    (tmp_path / "part.bdf").write_text(
        "\n".join(["BEGIN BULK", *cards, "MAT1,1,2.1+11,,.3,7850.", "ENDDATA"])
    )
    return make_scene(read_deck(tmp_path / "part.bdf"), {})


def test_shells_of_all_kinds_are_drawn(tmp_path: Path) -> None:
    """Four strips of one square metre each; those of second order by their corners."""
    places = [(float(x), float(y), 0.0) for y in (0, 1) for x in range(5)]
    middle = [
        (0.5, 0.0, 0.0),
        (1.0, 0.5, 0.0),
        (0.5, 1.0, 0.0),
        (0.0, 0.5, 0.0),
        (1.5, 0.5, 0.0),
    ]
    cards = [
        "CQUAD8,1,1,1,2,7,6,11,12",
        ",13,14",
        "CTRIA6,2,1,2,3,7,,15,12",
        "CTRIAR,3,1,3,8,7",
        "CQUADR,4,1,3,4,9,8",
    ]
    s = scene_of(
        tmp_path,
        *grids(*places, *middle),
        *cards,
        "CQUAD4,5,1,4,5,10,9",
        "PSHELL,1,1,.01,1",
    )
    a, b, c = (s.xyz[s.triangles[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == 4.0
    assert s.node.tolist() == list(range(1, 11))


def test_the_faces_of_a_pyramid_look_outward(tmp_path: Path) -> None:
    corners = grids((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1))
    s = scene_of(tmp_path, *corners, "CPYRAM,1,1,1,2,3,4,5", "PSOLID,1,1")
    a, b, c = (s.xyz[s.triangles[:, k]] for k in range(3))
    outward = np.einsum(
        "ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3 - s.xyz.mean(axis=0)
    )
    assert (outward > 0).all()
    # the volume they enclose (Gauss)
    assert np.einsum("ij,ij->", np.cross(a, b), c) / 6 == 1 / 3


def test_what_springs_hold_is_drawn_and_a_joint_without_length_is_a_point(
    tmp_path: Path,
) -> None:
    places = grids((0, 0, 0), (1, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0))
    cards = [
        "CROD,1,1,1,2",
        "PROD,1,1,.01",
        "CBUSH,2,2,2,3,,,,0",
        "PBUSH,2,K,1.+6",
        "CBUSH,3,2,3,4,,,,0",
    ]
    cards += [
        "CELAS2,4,1.+6,4,1,1,1",
        "CELAS2,5,1.+6,4,2",
        "CONM2,6,5,,8.",
        "RBE2,7,4,123456,5",
    ]
    # 5 is a mass in the air, which a sensor on 4 sees
    s = scene_of(tmp_path, *places, *cards)
    lines = {tuple(x) for x in s.node[s.lines].tolist()}
    assert lines == {(1, 2), (3, 4), (4, 1), (2, 2), (3, 3), (4, 4)}


def test_what_is_drawn_has_its_element_property_and_material(tmp_path: Path) -> None:
    """Two solids that share a face, a shell, a rod of its own material and a spring without a
    property.
    """
    places = [
        (float(x), float(y), float(z))
        for z in (0, 1)
        for y in (0, 1)
        for x in (0, 1, 2)
    ]
    cards = [
        "CHEXA,11,1,1,2,5,4,7,8",
        ",11,10",
        "CHEXA,12,1,2,3,6,5,8,9",
        ",12,11",
        "CQUAD4,21,2,7,8,11,10",
        "CONROD,31,1,2,9,.01",
        "CELAS2,32,1.+6,1,1",
        "PSOLID,1,1",
        "PSHELL,2,9,.01",
        "MAT1,9,7.+10,,.3",
    ]
    (tmp_path / "all.bdf").write_text(
        "\n".join(["BEGIN BULK", *grids(*places), *cards, "MAT1,1,2.1+11,,.3,7850."])
    )
    deck = read_deck(tmp_path / "all.bdf")
    drawn = model_arrays(make_scene(deck, {}), deck)
    assert drawn["element_id"].tolist() == [11, 12, 21, 31, 32]
    assert drawn["property"].tolist() == [1, 1, 2, 0, 0]
    assert drawn["material"].tolist() == [1, 1, 9, 9, 0]
    # of each solid five faces
    assert np.bincount(drawn["face_element"]).tolist() == [10, 10, 2]
    assert sorted(drawn["line_element"].tolist()) == [3, 4]
    assert [drawn["groups"][g] for g in drawn["group"]] == [
        "property 1",
        "property 1",
        "property 2",
        "no property",
        "no property",
    ]


def test_pairs_are_drawn_with_the_test_on_the_model() -> None:
    """A test whose shapes are those of the model, turned and scaled: drawn it moves with it."""
    fe = rt.solve_modes(rt.read_deck(rt.example_deck()), band=(0, 100))
    names = ["2+X", "3-X"]
    shapes = fe.at(["2+X", "3+X"]).shapes[:, :2] * [[-4.0, 0.3], [4.0, -0.3]]
    test = rt.modes_of_test([2.2, 6.4], shapes, names)
    view = rt.correlate(test, fe).plot(shapes=True).payload
    node = view["scene"]["model"]["node_id"].tolist()
    point = [int(name) for name in view["scene"]["test"]["names"]]
    assert point == [2, 3]
    for mode in view["modes"]:
        moved = [mode[k]["real"] * (mode[k]["peak"] / 32767) for k in ("fe", "test")]
        np.testing.assert_allclose(
            moved[1][:, 0],
            moved[0][[node.index(p) for p in point], 0],
            atol=1e-3 * mode["fe"]["peak"],
        )  # 16 bits
    with pytest.raises(UnsupportedError, match="places of the channels"):
        rt.correlate(test, test).plot(shapes=True)
