"""The screens of measured data: signals and FRFs."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nicegui.testing import User
from simulated import on, opened

import ringtrue as rt
from ringtrue.io.choices import read_choice

RECORD = "hammer-303pX"


def figure(user: User, marker: str) -> dict[str, Any]:
    """What a plot shows."""
    (plot,) = user.find(marker=marker).elements
    shown: dict[str, Any] = dict(plot.figure)
    traces = [
        {k: plain(v) for k, v in trace.items()} for trace in shown.get("data", ())
    ]
    return shown | {"data": traces}


def plain(value: Any) -> Any:
    """An array as it was before plotly packed it."""
    if not (isinstance(value, dict) and "bdata" in value):
        return value
    return np.frombuffer(base64.b64decode(value["bdata"]), dtype=value["dtype"])


async def shows(
    user: User, marker: str, what: Callable[[dict[str, Any]], bool]
) -> None:
    """Wait until a plot shows something."""
    await user.should_see(marker=marker, retries=200)
    for _ in range(200):
        spec = figure(user, marker)
        if spec.get("data") and what(spec):
            return
        await asyncio.sleep(0.05)
    raise AssertionError(f"{marker} does not show it")


def test_a_record_is_zoomed_to_its_samples(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    record = rt.read_record(ran / f"data/{RECORD}.h5")

    async def scenario(user: User) -> None:
        await shows(user, "signals", lambda s: len(s["data"]) == 3)
        whole = figure(user, "signals")
        assert whole["layout"]["xaxis"]["range"] == [0, record.duration]
        assert len(whole["layout"]["shapes"]) == 3  # the hits
        assert max(t["y"].size for t in whole["data"]) <= 2000
        assert np.nanmax(whole["data"][0]["y"]) == np.float32(record.data[0].max())
        zoom = {"xaxis.range[0]": 20.0, "xaxis.range[1]": 21.0}
        user.find(marker="signals").trigger("plotly_relayout", zoom)
        await shows(user, "signals", lambda s: s["data"][0]["x0"] == 20.0)
        near = figure(user, "signals")["data"][1]
        first = round(20 * record.rate)
        np.testing.assert_allclose(
            near["y"], record.data[1, first : first + near["y"].size]
        )
        assert near["dx"] == 1 / record.rate
        await shows(user, "spectra", lambda s: len(s["data"]) == 4)  # with the modes
        user.find(marker="spectra").trigger("plotly_click", {"x": 2.5, "y": 0.1})
        assert session.selection.frequency == 2.5
        user.find(marker="whole").click()
        await shows(user, "signals", lambda s: s["data"][0]["x0"] == 0.0)

    on("signals", session, scenario)


def test_any_frf_is_shown_with_its_frac(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    study = rt.open_study(ran)
    model = study.model_frfs("initial")

    async def scenario(user: User) -> None:
        await user.should_see(marker="frac", retries=200)
        names = {t["name"] for t in figure(user, "frf")["data"]}
        assert names == {"test", "fit of the test", "initial model"}
        cell = {"x": "203+Y", "y": "303+Y"}
        user.find(marker="frac").trigger("plotly_click", cell)
        assert session.selection.channel == "203+Y"
        await user.should_see("203+Y / 303+Y")
        shown = figure(user, "frf")["data"]
        drawn = next(t for t in shown if t["name"] == "initial model")["y"]
        i = [c.id for c in model.outputs].index("203+Y")
        np.testing.assert_allclose(drawn, np.abs(model.data[:, i, 1]), rtol=1e-5)
        f = float(study.stage("identify").hammer.modes.frequencies[1])
        user.find(marker="frf").trigger("plotly_click", {"x": 1.001 * f, "y": 1})
        assert (session.selection.mode, session.selection.frequency) == (1, f)

    on("frfs", session, scenario)


def test_a_hit_is_left_out_and_taken_back(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)

    async def scenario(user: User) -> None:
        await user.should_see(marker="signals", retries=200)
        (what,) = user.find(marker="what").elements
        what.set_value("impacts")
        await user.should_see(marker="hit", retries=200)
        user.find(marker="leave-out").click()
        user.find(marker="reason").type("struck twice")
        user.find(marker="write").click()
        (hit,) = read_choice(session.path.with_name("choice.toml")).hits
        assert (hit.record, hit.keep, hit.reason) == (RECORD, False, "struck twice")
        await user.should_see("Hit 2 of 3", retries=100)
        user.find(marker="hits").trigger("rowClick", [None, {"id": 0}, 0])
        await user.should_see("left out: struck twice", retries=100)
        user.find(marker="keep").click()
        assert not read_choice(session.path.with_name("choice.toml")).hits

    on("signals", session, scenario)


def test_what_a_rejected_mode_explained_is_missed(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    f = float(rt.open_study(ran).stage("identify").hammer.modes.frequencies[2])

    def missed(shown: dict[str, Any]) -> float:
        """Of the sum of FRFs at the mode that is rejected, dB."""
        measured, fitted = (
            t["y"][np.argmin(np.abs(t["x"] - f))] for t in shown["data"][:2]
        )
        return float(measured - fitted)

    async def scenario(user: User) -> None:
        await shows(user, "fit", lambda s: abs(missed(s)) < 1)
        session.select(record="hammer", frequency=f, order=0)
        user.find(marker="reject").click()
        user.find(marker="reason").type("a crane")
        user.find(marker="write").click()
        await shows(user, "fit", lambda s: missed(s) > 10)

    on("poles", session, scenario)


def test_a_scenario_that_fails_ends(ran: Path, tmp_path: Path) -> None:
    async def scenario(user: User) -> None:
        await user.should_see(marker="signals", retries=200)
        (what,) = user.find(marker="what").elements
        what.set_value("impacts")  # something is sent while the page ends
        raise AssertionError("on purpose")

    with pytest.raises(AssertionError, match="on purpose"):
        on("signals", opened(ran, tmp_path), scenario)
