"""`ringtrue plan` on a small frame: ranked references, modes that look alike, regions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import small_study

from ringtrue.cli.main import run


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    path = tmp_path / "frame.bdf"
    path.write_text(small_study.deck())
    return path


def test_sets_of_references_are_ranked_and_what_none_reaches_is_said(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "plan",
        str(deck),
        "--modes",
        "1-5",
        "--points",
        "6",
        "--references",
        "3",
        "--json",
        "-",
    ]
    run(words)
    told = json.loads(capsys.readouterr().out)
    sets = told["reference_sets"]
    assert [len(s["references"]) for s in sets] == [1, 2, 3, 3, 3, 4, 5]
    best = sets[2]
    assert sorted(best["references"]) == sorted(told["references"])
    assert best["worst_reach"] == pytest.approx(min(m["reach"] for m in told["modes"]))
    assert best["worst_reach"] >= sets[3]["worst_reach"] >= sets[4]["worst_reach"]
    assert (
        sets[0]["worst_reach"]
        <= sets[1]["worst_reach"]
        <= best["worst_reach"]
        <= sets[5]["worst_reach"]
    )
    # half a storey up a column no floor mode can be struck
    run([*words, "--strike-at", "151"])
    poor = json.loads(capsys.readouterr().out)
    assert poor["missed"]
    run([*words[:-2], "--strike-at", "151"])
    assert "no point that can be struck moves enough in mode" in capsys.readouterr().out
    page = deck.with_name("frame-test").joinpath("report.html").read_text()
    assert "no point that can be struck" in page.lower()
    assert "ranked by the mode that they excite worst" in page


def test_sets_are_ranked_as_they_are_told_where_few_points_can_be_struck(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reach is over the best of all channels; a mode that none of these points reaches ranks no
    set.
    """
    words = [
        "plan",
        str(deck),
        "--modes",
        "1-8",
        "--points",
        "6",
        "--references",
        "2",
        *settings(deck, 'strike = "worst"'),
    ]
    for spots in ("151,102", "105,204,301", "151"):
        run([*words, "--strike-at", spots, "--json", "-"])
        told = json.loads(capsys.readouterr().out)
        worst = {
            n: [
                s["worst_reach"]
                for s in told["reference_sets"]
                if len(s["references"]) == n
            ]
            for n in (1, 2, 3)
        }
        assert worst[2] == sorted(worst[2], reverse=True)
        assert worst[1] <= worst[2][:1] <= worst[3]
        assert sorted(told["reference_sets"][1]["references"]) == sorted(
            told["references"]
        )


def settings(deck: Path, text: str) -> list[str]:
    """The option for a study with such a [plan]."""
    path = deck.with_name("settings.toml")
    path.write_text(f"[plan]\n{text}\n")
    return ["--settings", str(path)]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("boxes = [[0, 0, 0, 1, 1]]", "a box is x0 y0 z0 x1 y1 z1"),
        ("sensor = 3", "did you mean"),
    ],
)
def test_settings_that_are_wrong_are_refused(
    deck: Path, capsys: pytest.CaptureFixture[str], text: str, why: str
) -> None:
    assert run(["plan", str(deck), "--modes", "1-3", *settings(deck, text)]) == 2
    assert why in capsys.readouterr().err


def test_settings_without_a_plan_are_refused(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = deck.with_name("none.toml")
    path.write_text("[study]\n")
    assert run(["plan", str(deck), "--settings", str(path)]) == 2
    assert "no table [plan]" in capsys.readouterr().err


def test_modes_that_the_points_do_not_part_are_named(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At one node of the roof, the sways along x of all storeys look alike."""
    words = [
        "plan",
        str(deck),
        "--modes",
        "1-6",
        "--points",
        "2",
        *settings(deck, "candidates = {roof = [305, 304]}"),
        "--json",
        "-",
    ]
    run(words)
    told = json.loads(capsys.readouterr().out)
    assert told["worst_auto_mac"] > 0.25
    assert any("look the same at the points" in n for n in told["notes"])
    run(["plan", str(deck), "--modes", "1-3", "--points", "9", "--json", "-"])
    told = json.loads(capsys.readouterr().out)
    assert told["worst_auto_mac"] < 0.25
    assert told["notes"] == []


def test_targets_and_points_by_regions(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Points are among the nodes of the regions, which may share some; modes that hardly move one
    are no targets.
    """
    words = [
        "plan",
        str(deck),
        "--band",
        "0.5",
        "18",
        "--points",
        "5",
        "--json",
        "-",
    ]
    base = """
    min_distance = 0.0
    candidates.top = [301, 302, 303, 304, 305, 306, 307, 308, 309]
    candidates.upper = [201, 202, 203, 204, 205, 206, 207, 208, 209, 301, 302, 303, 304, 305, 306]
    """

    def planned(more: str = "") -> dict[str, Any]:
        assert run([*words, *settings(deck, base + more)]) in (0, 1)
        found: dict[str, Any] = json.loads(capsys.readouterr().out)
        return found

    told = planned()
    assert told["candidates"] == 18
    top = set(range(301, 310))
    first = [p in top for p in told["points"]]
    assert first == sorted(
        first, reverse=True
    )  # regions keep their order: the first two have the ambient sensors
    few = [m["mode"] for m in planned("kinetic.top = 0.5")["modes"]]
    assert 0 < len(few) < len(told["modes"])
    heavy = [m["mode"] for m in planned("effective_mass = 0.5")["modes"]]
    assert 0 < len(heavy) <= 3  # two sways and a torsion
