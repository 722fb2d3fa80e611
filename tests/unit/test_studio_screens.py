"""The screens, each on the study of a frame that was run to its correlation."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest
from nicegui import ui
from nicegui.testing import User
from simulated import on, opened

import ringtrue as rt
from ringtrue.demos import frame
from ringtrue.errors import DataError
from ringtrue.io.choices import read_choice
from ringtrue.studio import edits


def test_a_click_picks_a_pole_and_another_lets_it_go(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    before = session.documents.text("study.toml")
    poles = rt.open_study(ran).stage("identify").hammer.diagrams[-1].poles
    f, order = float(poles.frequencies[-1]), int(poles.order[-1])
    # the page has single precision; a mark of a mode has customdata
    click = {"x": float(np.float32(f)), "y": order}

    async def scenario(user: User) -> None:
        user.find(marker="diagram").trigger("plotly_click", click)
        (pick,) = read_choice(session.path.with_name("choice.toml")).picks
        assert (pick.frequency, pick.order, pick.record) == (f, order, "hammer")
        assert session.config is not None
        assert session.config.identify.choice == "choice.toml"
        await user.should_see(f"order {order}")
        user.find(marker="diagram").trigger("plotly_click", click)
        assert not read_choice(session.path.with_name("choice.toml")).picks
        await session.look()
        assert session.standing("identify") == "stale"
        session.undo()
        session.undo()

    on("poles", session, scenario)
    assert session.documents.text("study.toml") == before
    assert not session.path.with_name("choice.toml").exists()


def test_a_mode_is_rejected_with_a_reason(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    found = rt.open_study(ran).stage("identify").hammer

    async def scenario(user: User) -> None:
        user.find(marker="diagram").trigger(
            "plotly_click", {"x": 1.7, "y": 40.1, "customdata": 2}
        )
        assert session.selection.mode == 2
        await user.should_see(found.reasons[2])
        user.find(marker="reject").click()
        user.find(marker="write").click()  # without a reason nothing is written
        assert not session.path.with_name("choice.toml").exists()
        user.find(marker="reason").type("a crane")
        user.find(marker="write").click()
        await user.should_see(marker="own")
        (own,) = user.find(marker="own").elements
        assert isinstance(own, ui.table)
        assert own.rows[0]["why"] == "a crane"

    on("poles", session, scenario)
    (reject,) = read_choice(session.path.with_name("choice.toml")).rejects
    assert reject.reason == "a crane"
    assert reject.frequency == float(found.modes.frequencies[2])


def test_two_modes_are_merged_with_a_reason(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    there = rt.open_study(ran).stage("identify").hammer.diagram.modes.frequencies
    near = float(there[np.argsort(np.abs(there - there[2]))[1]])

    async def scenario(user: User) -> None:
        user.find(marker="diagram").trigger(
            "plotly_click", {"x": 1.7, "y": 40.1, "customdata": 2}
        )
        await user.should_see(marker="merge")
        (select,) = user.find(marker="merge").elements
        assert isinstance(select, ui.select)
        assert next(iter(select.options)) == near
        select.value = near
        user.find(marker="reason").type("one mode, split by the stabilisation")
        user.find(marker="write").click()
        await user.should_see(marker="unmerge")
        (merge,) = read_choice(session.path.with_name("choice.toml")).merges
        assert merge.frequencies == tuple(sorted((near, float(there[2]))))
        assert merge.reason == "one mode, split by the stabilisation"
        user.find(marker="unmerge").click()

    on("poles", session, scenario)
    assert not read_choice(session.path.with_name("choice.toml")).merges


def test_the_difference_of_shapes_names_the_worst_channel(
    ran: Path, tmp_path: Path
) -> None:
    session = opened(ran, tmp_path)
    stage = rt.open_study(ran).stage("correlate")
    test, fe = stage.reference.elastic, stage.fe_initial
    at = [fe.channels.index(c) for c in test.channels]
    a, b = test.shapes[:, 0], fe.shapes[at, 0]
    scale = np.linalg.lstsq(a[:, None], b.astype(a.dtype), rcond=None)[0]
    off = np.abs(a * scale - b) / np.abs(b).max()

    async def scenario(user: User) -> None:
        session.select(pair=(0, 0))
        (toggle,) = user.find(marker="arrangement").elements
        assert isinstance(toggle, ui.toggle)
        toggle.value = "difference"
        worst = (
            f"worst channel {test.channels[int(off.argmax())]}, {100 * off.max():.1f} %"
        )
        await user.should_see(worst)

    on("correlation", session, scenario)


def test_a_pair_is_locked_in_the_matrix(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    table = rt.open_study(ran).pairs("initial")

    async def scenario(user: User) -> None:
        cell = {
            "x": f"2: {table.all_fe_hz[1]:.2f}",
            "y": f"1: {table.all_test_hz[0]:.2f}",
        }
        user.find(marker="matrix").trigger("plotly_click", cell)
        assert session.selection.pair == (0, 1)
        await user.should_see(f"{100 * table.mac[0, 1]:.1f} %")
        user.find(marker="lock").click()
        user.find(marker="reason").type("seen on site")
        user.find(marker="write").click()
        await user.should_see("seen on site")
        user.find(marker="mac-gate").trigger("change", 0.45)

    on("correlation", session, scenario)
    assert session.config is not None
    assert session.config.correlate.lock == ["1:2"]
    assert session.config.correlate.mac_gate == 0.45
    assert '"1:2", # seen on site' in session.documents.text("study.toml")


def test_a_factor_that_is_tried_moves_the_modes(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    model = rt.trial_model(ran / "study.toml")
    tried = model.at({"columns 1": 0.8}).pairs
    objective = model.objective({"columns 1": 0.8})
    frf = model.frf({"columns 1": 0.8}, "303+X", "303+X")

    async def scenario(user: User) -> None:
        await user.should_see(marker="factor-columns 1", retries=100)
        user.find(marker="factor-columns 1").trigger("update:modelValue", np.log(0.8))
        (modes,) = user.find(marker="modes").elements
        assert isinstance(modes, ui.table)
        shown = [row["df"] for row in modes.rows]
        assert shown == [f"{x:+.2f}" for x in tried.deviation_percent]
        await user.should_see(f"{objective:.4g}")
        (plot,) = user.find(marker="trial-frf").elements
        assert isinstance(plot, ui.plotly)
        curve = next(d for d in plot.figure["data"] if d["name"] == "trial")
        drawn = np.frombuffer(base64.b64decode(curve["y"]["bdata"]), dtype=np.float32)
        np.testing.assert_allclose(drawn, np.abs(frf.data[:, 0, 0]), rtol=1e-6)
        user.find(marker="modes").trigger("rowClick", [{}, {"id": 3}, 2])
        await user.should_see("Test mode 3")
        session.select(region="columns 1")
        user.find(marker="bound-lower").trigger("change", "0.9")  # above what is tried
        session.edit("candidate 2 taken out", edits.remove_entry("candidate", 1))
        await session.refresh()
        await user.should_not_see(marker="factor-columns 2", retries=100)
        await user.should_see("0.900", retries=100)
        user.find(marker="modes").trigger("rowClick", [{}, {"id": 2}, 1])
        await user.should_see("Test mode 2")

    on("update", session, scenario)
    assert session.config is not None
    assert [c.lower for c in session.config.candidate] == [0.9, 0.5]


def test_trials_agree_with_full_solutions(ran: Path) -> None:
    model = rt.trial_model(ran / "study.toml")
    factors = {"columns 1": 0.6, "columns 3": 1.7}
    trial, full = model.at(factors), model.full(factors)
    # a basis of the modes and their sensitivities at the deck; its error far from there is of
    # second order, and the estimate says it
    off = np.abs(trial.modes.frequencies / full.modes.frequencies - 1)
    assert off.max() < 3 * model.error(factors) < 1e-3
    np.testing.assert_allclose(trial.pairs.mac, full.pairs.mac, atol=1e-2)
    with pytest.raises(
        rt.InputError, match="no candidate 'column 1'; did you mean 'columns 1'"
    ):
        model.at({"column 1": 1.0})
    with pytest.raises(rt.InputError, match=r"allowed are 0\.5 to 2"):
        model.at({"columns 1": 3.0})


def test_trials_have_the_objective_shapes_and_frfs(ran: Path) -> None:
    study = rt.open_study(ran)
    model = rt.trial_model(ran / "study.toml")
    truth = {f"columns {k}": factor for k, factor in frame.TRUTH.items()}
    assert model.objective(truth) < 0.1 * model.objective({})
    stored = study.stage("model").modes.shapes[:, 2]
    shape = model.shape({}, 2).shapes[:, 0]
    np.testing.assert_allclose(shape * np.sign(shape @ stored), stored, atol=1e-6)
    whole, one = study.model_frfs("initial"), model.frf({}, "103+Y", "303+X")
    at = (
        [c.id for c in whole.outputs].index("103+Y"),
        [c.id for c in whole.inputs].index("303+X"),
    )
    # the deck's static responses are in the basis
    np.testing.assert_allclose(one.data[:, 0, 0], whole.data[:, *at], rtol=1e-3)
    with pytest.raises(
        DataError, match=r"no FRF 1\+X / 303\+X at channels of the sheet"
    ):
        model.frf({}, "1+X", "303+X")


def test_names_and_reasons_are_written(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)

    async def scenario(user: User) -> None:
        user.find(marker="name-1").trigger("change", "sway along x")

    on("verdict", session, scenario)
    assert session.config is not None
    assert session.config.study.names == {"1": "sway along x"}
