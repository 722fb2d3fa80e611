"""The frame: stages, undo, the selection, and what goes wrong."""

from __future__ import annotations

import asyncio
import logging
import re
import sys
from pathlib import Path

import nicegui
import pytest
from nicegui.testing import User
from simulated import STUDY, visit, written

from ringtrue.core.iterate import IterationText
from ringtrue.errors import ConfigError
from ringtrue.studio import edits, theme, work
from ringtrue.studio.session import opened
from ringtrue.studio.work import Job, Work


def test_edits_are_said_and_undone_on_the_page(tmp_path: Path) -> None:
    session = written(tmp_path)

    async def scenario(user: User) -> None:
        await user.should_see("Tower")
        session.edit("gate at 0.7", edits.put(("study", "title"), "Mast"))
        await user.should_see("Mast")
        user.find(marker="history").click()
        await user.should_see("gate at 0.7")
        user.find(marker="undo").click()
        await user.should_see("Tower")
        (tmp_path / "study.toml").write_text(STUDY.replace("[model]", "[modle]"))
        await session.look()
        await user.should_see("did you mean 'model'")

    visit(session, scenario)
    assert session.config is None


def test_a_study_begins_from_a_deck(tmp_path: Path) -> None:
    written(tmp_path)
    (tmp_path / "study.toml").unlink()
    session = opened(tmp_path / "tower.bdf")

    async def scenario(user: User) -> None:
        await user.should_see(marker="begin-modes", retries=50)
        user.find(marker="begin").click()
        await user.should_see(marker="view", retries=50)

    visit(session, scenario)
    assert (tmp_path / "study.toml").read_text() == '[model]\ndeck = "tower.bdf"\n'


def test_a_refusal_is_one_message_and_a_fault_is_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    session = written(tmp_path)

    def refused() -> None:
        raise ConfigError("mac_gate 2: allowed are 0 to 1")

    async def scenario(user: User) -> None:
        session.on_work.subscribe(refused)
        session.on_work.emit()
        assert "mac_gate 2: allowed are 0 to 1" in user.notify.messages
        session.on_work.subscribe(lambda: 1 / 0)
        session.on_work.emit()
        assert any(
            "fault of ringtrue: ZeroDivisionError" in m for m in user.notify.messages
        )

    with caplog.at_level(logging.ERROR):
        visit(session, scenario)
    assert "ZeroDivisionError" in caplog.text


def test_one_selection_runs_through_all_tabs(tmp_path: Path) -> None:
    session = written(tmp_path)
    seen: list[int | None] = []
    session.on_selection.subscribe(lambda selection: seen.append(selection.mode))
    session.select(mode=3)
    session.select(mode=3)
    session.select(channel="101+Z")
    assert seen == [3, 3]
    assert session.selection.mode == 3


def test_what_is_opened(tmp_path: Path) -> None:
    written(tmp_path)
    assert opened(tmp_path).path == tmp_path / "study.toml"
    assert opened(tmp_path / "tower.bdf").source == tmp_path / "tower.bdf"
    with pytest.raises(ConfigError, match="no such file"):
        opened(tmp_path / "mast.toml")


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_run_is_stopped_and_resumed(tmp_path: Path) -> None:
    session = written(tmp_path)

    async def scenario() -> None:
        work = Work(tmp_path / "study.toml", lambda: work.stop())
        assert (await work.run("model")).state == "stopped"
        job = await session.work.run("model")
        assert (job.state, job.fraction) == ("done", 1.0)
        await session.refresh()
        assert session.standing("model") == "done"
        assert session.stage("model").modes.frequencies == pytest.approx(
            [5.0329], rel=1e-4
        )
        session.edit("fmax", edits.put(("model", "fmax"), 50.0))
        await session.refresh()
        assert session.standing("model") == "stale"

    asyncio.run(scenario())
    assert (
        session.work.command("model")
        == f"ringtrue run {tmp_path}/study.toml --until model"
    )


def test_a_run_that_fails_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path)
    (tmp_path / "tower.bdf").unlink()
    monkeypatch.setattr(work, "_watch_parent", lambda: None)
    monkeypatch.setattr(work, "signal", lambda *_: None)
    assert work.main(str(tmp_path / "study.toml")) == work.FAILED
    assert "tower.bdf" in capsys.readouterr().err


def test_the_tour_points_at_screens_and_can_be_closed(tmp_path: Path) -> None:
    session = written(tmp_path)

    async def scenario(user: User) -> None:
        await user.should_not_see(marker="tour")
        user.find(marker="tour-begin").click()
        await user.should_see("The screens follow a study")
        user.find(marker="tour-next").click()
        await user.should_see("Poles: click a pole")
        user.find(marker="tour-close").click()
        await user.should_not_see(marker="tour")

    visit(session, scenario)


def test_every_class_that_a_page_names_has_a_style() -> None:
    sheets = [
        theme.CSS,
        *(Path(nicegui.__file__).parent / "static").glob("quasar.*.prod.css"),
    ]
    known = "".join(path.read_text() for path in sheets).replace("\\", "")
    named = re.findall(r'classes\(\s*"([^"]*)"', _sources())
    missing = {c for text in named for c in text.split() if f".{c}" not in known}
    # what nothing but the tour and tests look for
    assert {c for c in missing if not c.startswith("rt-")} == set()


def _sources() -> str:
    return "".join(p.read_text() for p in theme.CSS.parent.rglob("*.py"))


def test_a_browser_keeps_theme_and_selection_for_the_next_studio(
    tmp_path: Path,
) -> None:
    before = written(tmp_path)
    before.select(pair=(2, 3), mode=2, frequency=4.5, channel="101+Z")
    before.set_dark(True)
    after = opened(tmp_path)
    after.restore(before.kept)
    assert (after.dark, after.selection) == (True, before.selection)
    after.select(mode=1)
    after.restore(before.kept)
    assert after.selection.mode == 1  # another tab of the browser changes nothing
    fresh = opened(tmp_path)
    fresh.restore('[true, {"mode": "many"}]')
    assert not fresh.dark


def test_a_run_says_its_iterations_with_their_values(
    capsys: pytest.CaptureFixture[str],
) -> None:
    said = IterationText("set: iteration 2: 3.5")
    said.values = {"J": 3.5, "columns": 1.2}
    work._report(0.5, said)
    work._report(0.6, "modes at the updated point")
    job = Job("update", "")
    for line in capsys.readouterr().out.splitlines(keepends=True):
        job.heard(line)
    assert job.steps == [{"J": 3.5, "columns": 1.2}]
    assert job.lines == ["set: iteration 2: 3.5", "modes at the updated point"]
