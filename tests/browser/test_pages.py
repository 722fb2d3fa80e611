"""The pages of the commands in a browser: drawn offline without complaint, and a click makes a
choice.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import chromium
import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.modes import ModeSet, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.identification.ambient.spectral_bins import SpectrumPeak
from ringtrue.identification.common.diagram import (
    IdentificationDiagram,
    SpectrumAccount,
    identification_diagram,
)
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram
from ringtrue.identification.common.tracking import Stretch, track_modes
from ringtrue.io.choices import read_choice
from ringtrue.plots.correlation import tracking_page
from ringtrue.plots.diagram import picker_page
from ringtrue.plots.signals import frf_page
from ringtrue.signal.tonal_lines import Harmonic

needs_browser = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: the drawing of the pages is NOT tested",
)


def diagram() -> StableDiagram:
    order = np.arange(2, 22, 2)
    f = np.linspace(2.9, 3.1, 10)
    pole = 2 * np.pi * f * (-0.01 + 1j)
    poles = PoleSet(
        order, pole, np.ones((2, 10), complex), np.full(10, 1e-3), np.full(10, np.nan)
    )
    return StableDiagram(
        poles,
        order > 8,
        np.where(order > 14, 0, -1),
        np.linspace(2, 4, 50),
        np.zeros((3, 50)),
        others=(replace(poles.take(order > 16), method="pLSCF"),),
    )


def shown(*, geometry: bool = False) -> IdentificationDiagram:
    """A natural mode and a doubtful one, a machine and a peak that nothing explains."""
    channels = ("1+X", "2+X") if geometry else ("a", "b")

    def set_of(f: float, shape: list[float]) -> ModeSet:
        return ModeSet(np.array([f]), np.array([0.01]), np.array([shape]).T, channels)

    std = Uncertainty.independent(
        np.array([0.003]), np.array([0.001]), np.full((2, 1), 0.01)
    )
    note = Note("candidate orders", "information", "3.5 Hz", {"orders": 3, "tried": 10})
    others = OtherCandidates(set_of(3.5, [1.0, -0.8]), std, ("doubtful",), (note,))
    peak = SpectrumPeak(3.8, 0.05, 2, 12.0)
    account = SpectrumAccount((Harmonic(2.5, "a rotating machine"),), (), (peak,))
    natural = (set_of(3.05, [1.0, 0.5]), std, ("",))
    return identification_diagram([diagram()], natural, others, account)


def mast() -> TestModel:
    points = np.array([1, 2])
    places = np.array([[0.0, 0, 1], [0, 0, 2]])
    axes = np.array([[1.0, 0, 0], [1, 0, 0]])
    return TestModel(
        points,
        places,
        ("1+X", "2+X"),
        at=points,
        axes=axes,
        lines=np.zeros((0, 2), np.int64),
    )


CLICK = "document.getElementById('figure-0').emit('plotly_click', {points: [{customdata: %s}]})"
CHOICE = "document.getElementById('choice').textContent"


@needs_browser
def test_a_click_makes_a_choice(tmp_path: Path) -> None:
    """One click takes a doubtful mode or a pole up, one on what is shown takes it out; the pole of
    another estimator is only shown.
    """
    path = tmp_path / "d.html"
    path.write_text(picker_page("tower </script>", shown()))
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=path.as_uri())
        assert page.until("document.documentElement?.dataset.drawn === 'true'")
        untouched = page.evaluate(CHOICE)
        page.evaluate(CLICK % 1)  # the doubtful mode
        taken = page.evaluate(CHOICE)
        page.evaluate(CLICK % 1)
        back = page.evaluate(CHOICE)
        # the natural one is first shown, then out
        for about in ("1", "0", "0", "[10, 18]", "[6, 2]"):
            page.evaluate(CLICK % about)
        text = page.evaluate(CHOICE)
        named = page.evaluate(
            "document.getElementById('figure-0')._fullData.map((t) => [t.name, t._length])"
        )
        rows = page.evaluate(
            "[...document.querySelectorAll('#rows tr')].map((r) => r.innerText)"
        )
        bars = page.evaluate("document.getElementById('shape').data[0].y")
        assert page.complaints() == []
        assert all(u.startswith(("file:", "data:", "blob:")) for u in page.requests())
    assert untouched == back == "automatic = true\n"
    note = "doubtful: few model orders show it"
    assert tomllib.loads(taken)["pick"] == [{"frequency": 3.5, "note": note}]
    (tmp_path / "c.toml").write_text(text)
    choice = read_choice(tmp_path / "c.toml")
    assert choice.automatic
    assert [(p.frequency, p.order) for p in choice.picks] == [
        (3.5, 0),
        (pytest.approx(2.9, rel=1e-4), 2),
    ]
    assert [r.frequency for r in choice.rejects] == [3.05]
    assert ["unstable pole", 4] in named
    assert ["pole by pLSCF", 2] in named
    assert ["unexplained peak", 1] in named
    assert ["line of a machine", 1] in named
    assert ["doubtful mode", 1] in named
    assert "doubtful" in rows[1]
    assert bars == [1, 1]  # the pole that was clicked last


@needs_browser
def test_the_shape_of_what_is_clicked_moves(tmp_path: Path) -> None:
    path = tmp_path / "d.html"
    path.write_text(picker_page("mast", shown(geometry=True), mast()))
    image = "document.querySelector('#shape canvas').toDataURL().slice(-4000)"
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=path.as_uri())
        assert page.until("document.querySelectorAll('#shape canvas').length > 0")
        first = page.evaluate(image)
        assert page.until(f"({image}) !== {first!r}")
        for about in ("1", "[0, 20]"):
            page.evaluate(CLICK % about)
        title = page.evaluate("document.getElementById('shown').textContent")
        assert page.complaints() == []
    assert title == "Shape: pole of order 16, 3.0557 Hz"


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
    std = Uncertainty.independent(
        np.array([0.003]), np.array([0.001]), np.full((2, 1), 0.01)
    )
    sets = [
        Stretch(
            float(k),
            ModeSet(f[[k]], np.array([0.01]), np.array([[1.0], [0.5]]), ("a", "b")),
            std,
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
    framed = listed.replace(
        "document", "document.querySelector('iframe')?.contentDocument?"
    )
    with chromium.page(tmp_path / "profile") as page:
        for path, names in ((alone, listed), (cell, framed)):
            page.call("Page.navigate", url=path.as_uri())
            assert page.until(f"{names}.length === 3")
            assert page.evaluate(names)[0] == "mode 1: 2.24 Hz"
        assert page.complaints() == []
