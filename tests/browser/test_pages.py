"""The pages of the commands in a browser: drawn offline without complaint, and a click makes a
choice.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import chromium
import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram
from ringtrue.identification.common.tracking import Stretch, track_modes
from ringtrue.io.choices import read_choice
from ringtrue.plots.correlation import tracking_page
from ringtrue.plots.pages import frf_page, picker_page

needs_browser = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: the drawing of the pages is NOT tested",
)


def diagram() -> StableDiagram:
    order = np.arange(2, 22, 2)
    f = np.linspace(2.9, 3.1, 10)
    pole = 2 * np.pi * f * (-0.01 + 1j)
    poles = PoleSet(order, pole, np.ones((2, 10), complex), np.full(10, 1e-3), np.full(10, np.nan))
    return StableDiagram(
        poles, order > 8, np.where(order > 14, 0, -1), np.linspace(2, 4, 50), np.zeros(50)
    )


def modes() -> ModeSet:
    return ModeSet(np.array([3.05]), np.array([0.01]), np.ones((2, 1)), ("a", "b"))


@needs_browser
def test_a_click_makes_a_choice(tmp_path: Path) -> None:
    path = tmp_path / "d.html"
    path.write_text(picker_page("tower </script>", [diagram()], modes()))
    click = (
        "document.getElementById('figure-0').emit('plotly_click', {points: [{customdata: "
        "[%s, %d]}]})"
    )
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=path.as_uri())
        assert page.until("document.querySelectorAll('.main-svg').length > 0")
        for f, order in (("2.9", 2), ("3.05", 0), ("3.1", 20), ("3.1", 20)):
            page.evaluate(click % (f, order))
        text = page.evaluate("document.getElementById('choice').textContent")
        drawn = page.evaluate(
            "document.getElementById('figure-0').data.map((t) => (t.customdata || []).length)"
        )
        assert page.complaints() == []
        assert all(u.startswith(("file:", "data:", "blob:")) for u in page.requests())
    assert tomllib.loads(text)["pick"] == [{"frequency": 2.9, "order": 2}]
    (tmp_path / "c.toml").write_text(text)
    choice = read_choice(tmp_path / "c.toml")
    assert choice.automatic
    assert [r.frequency for r in choice.rejects] == [3.05]
    assert drawn == [0, 4, 3, 3, 1]


@needs_browser
def test_responses_of_a_model_are_drawn(tmp_path: Path) -> None:
    freqs, points = (
        np.linspace(1, 9, 50),
        [Channel(c, "acceleration", "m/s^2") for c in ("1+X", "</script>")],
    )
    h = np.exp(1j * np.outer(freqs, [1.0, 0.0]))[:, :, None] * [
        1.0,
        0.0,
    ]  # a force that moves nothing, too
    forces = (Channel("1+X", "force", "N"), Channel("2+X", "force", "N"))
    path = tmp_path / "f.html"
    path.write_text(frf_page("wing", FrfSet(h, freqs, tuple(points), forces)))
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=path.as_uri())
        assert page.until("document.querySelectorAll('.main-svg').length >= 4")
        drawn = page.evaluate(
            "[0, 1].map((i) => document.getElementById('figure-' + i).data.length)"
        )
        assert page.complaints() == []
        assert all(u.startswith(("file:", "data:", "blob:")) for u in page.requests())
    assert drawn == [4, 4]


@needs_browser
def test_modes_through_time_are_drawn(tmp_path: Path) -> None:
    rng, n = np.random.default_rng(0), 30
    t = np.linspace(5, 25, n)
    f = 3 - 0.01 * (t - 15) + 0.003 * rng.standard_normal(n)
    std = Uncertainty.independent(np.array([0.003]), np.array([0.001]), np.full((2, 1), 0.01))
    sets = [
        Stretch(
            float(k), ModeSet(f[[k]], np.array([0.01]), np.array([[1.0], [0.5]]), ("a", "b")), std
        )
        for k in range(n)
        if k != 4
    ]
    tracked = track_modes(sets)
    path = tmp_path / "t.html"
    path.write_text(tracking_page("days", tracked, ["a <note>"]))
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=path.as_uri())
        assert page.until("document.querySelectorAll('.main-svg').length >= 2")
        assert page.evaluate("document.getElementById('figure-1').data.length") == 1
        assert page.evaluate("document.querySelector('li').textContent") == "a <note>"
        assert page.complaints() == []


@needs_browser
def test_mode_shapes_move_in_a_page_and_in_a_notebook(tmp_path: Path) -> None:
    """The 3D viewer of `.plot()`, alone and in the frame of a notebook's cell."""
    fe = rt.solve_modes(rt.read_deck(rt.example_deck(), units="SI"), band=(0, 100))
    view = fe.plot()
    alone = view.write_html(tmp_path / "modes.html")
    cell = tmp_path / "cell.html"
    cell.write_text(f"<!doctype html><body>{view._repr_html_()}</body>")
    listed = "[...(document.querySelectorAll('select')[1]?.options ?? [])].map((o) => o.text)"
    framed = listed.replace("document", "document.querySelector('iframe')?.contentDocument?")
    with chromium.page(tmp_path / "profile") as page:
        for path, names in ((alone, listed), (cell, framed)):
            page.call("Page.navigate", url=path.as_uri())
            assert page.until(f"{names}.length === 3")
            assert page.evaluate(names)[0] == "mode 1: 2.24 Hz"
        assert page.complaints() == []
