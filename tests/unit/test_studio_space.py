"""The screens in space: what a click on the model writes, and what is shown of it."""

from __future__ import annotations

import asyncio
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nicegui import ui
from nicegui.testing import User
from simulated import DECK, on, opened, visit, written

import ringtrue as rt
from ringtrue.studio import edits
from ringtrue.studio.screens.sensors import gain

PATIENCE = 300  # tenths of a second: something hangs, not that the machine is busy
PLAN = (
    "\n[plan]\nfmin = 1.0\nfmax = 12.0\nsensors = 4\nreferences = 1\nambient = false\n"
)


@pytest.fixture(scope="module")
def localised(ran: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same study with a plan, run to its localisation."""
    folder = tmp_path_factory.mktemp("localised") / "frame"
    shutil.copytree(ran, folder)
    study = folder / "study.toml"
    study.write_text(study.read_text() + PLAN)
    rt.run_study(study, until="localise")
    return folder


def test_a_part_of_the_model_becomes_a_candidate_region(
    ran: Path, tmp_path: Path
) -> None:
    session = opened(ran, tmp_path)

    async def scenario(user: User) -> None:
        await user.should_see(marker="legend-2", retries=PATIENCE)
        await user.should_see("No findings.", retries=PATIENCE)
        user.find(marker="view").trigger(
            "viewPick", {"kind": "element", "id": 200, "shift": False}
        )
        await user.should_see(marker="connected")
        user.find(marker="connected").click()  # the column, as far as its property goes
        await user.should_see("200, 201")
        user.find(marker="legend-2").click()
        await user.should_see("200, 201, 202, 203, 204, 205 and 2 more")
        user.find(marker="candidate").click()
        await user.should_see(marker="region-name", retries=PATIENCE)
        user.find(marker="region-name").type("second storey")
        user.find(marker="write").click()
        await user.should_see(marker="region-3")
        (view,) = user.find(marker="view").elements
        assert view.props["state"]["select"] == {"property": [2], "element": []}
        (modes,) = user.find(marker="mode").elements
        assert isinstance(modes, ui.select)
        modes.set_value(0)
        assert view.props["state"]["mode"] == "FE 1"
        assert session.selection.pair == (0, 0)
        session.edit("fmax", edits.put(("model", "fmax"), 3.0))  # its modes are others
        await user.should_see(marker="solve", retries=PATIENCE)
        user.find(marker="solve").click()
        await user.should_see(marker="mode", retries=PATIENCE)
        (modes,) = user.find(marker="mode").elements
        assert isinstance(modes, ui.select)
        modes.set_value(max(modes.options))
        rt.run_study(session.path, until="model")
        await session.refresh()
        for _ in range(PATIENCE):  # fewer are known now
            (modes,) = user.find(marker="mode").elements
            assert isinstance(modes, ui.select)
            if modes.value == -1:
                return
            await asyncio.sleep(0.1)
        raise AssertionError("a mode that is no longer known is shown")

    on("model", session, scenario)
    assert session.config is not None
    made = session.config.candidate[-1]
    assert (made.name, made.targets) == ("second storey", ["MAT1 2 E"])
    assert session.selection.region == "second storey"


def test_a_finding_flies_to_its_element_and_units_are_judged(tmp_path: Path) -> None:
    session = written(tmp_path)
    (tmp_path / "tower.bdf").write_text(
        DECK.replace("ENDDATA", "GRID,9,,5000.,0.,0.\nENDDATA")
    )

    async def scenario(user: User) -> None:
        await user.open("/model")
        await user.should_see("GRID 9: no element is connected to it", retries=PATIENCE)
        user.find(marker="finding-0").click()
        (view,) = user.find(marker="view").elements
        assert view.props["aim"]["selection"] == {"node": [9]}
        user.find(marker="solve").click()  # on demand
        await user.should_see(marker="mode", retries=PATIENCE)
        assert view.props["state"]["mode"] == "FE 1"
        (units,) = user.find(marker="units").elements
        assert isinstance(units, ui.select)
        await user.should_see("long in SI, that is 5000 m: is that its unit system?")
        units.set_value("mm-t-s")
        await user.should_not_see("is that its unit system?", retries=PATIENCE)

    visit(session, scenario)
    assert session.config is not None
    assert session.config.model is not None
    assert session.config.model.units == "mm-t-s"


def test_a_candidate_is_ticked_where_it_is_wrong(
    localised: Path, tmp_path: Path
) -> None:
    session = opened(localised, tmp_path)
    before = session.documents.text("study.toml")

    async def scenario(user: User) -> None:
        await user.should_see("Select a candidate.", retries=PATIENCE)
        user.find(marker="view").trigger("viewPick", {"kind": "element", "id": 200})
        assert session.selection.region == "columns 2"
        await user.should_see("MAT1 2 E of 8 CBEAM")
        (tick,) = user.find(marker="tick").elements
        assert isinstance(tick, ui.checkbox)
        assert tick.value
        user.find(marker="tick").click()
        assert session.config is not None
        assert [c.name for c in session.config.candidate] == ["columns 1", "columns 3"]
        await user.should_see(marker="tick")
        user.find(marker="tick").click()
        added = session.config.candidate[-1]
        assert (added.name, added.targets, added.lower) == (
            "columns 2",
            ["MAT1 2 E"],
            0.5,
        )

    on("where", session, scenario)
    session.undo()
    session.undo()
    assert session.documents.text("study.toml") == before


def test_a_sensor_is_dragged_and_flipped(ran: Path, tmp_path: Path) -> None:
    session = opened(ran, tmp_path)
    sheet = session.path.parent / "data" / "sensors.csv"
    before = sheet.read_text()

    async def scenario(user: User) -> None:
        await user.should_see("Click an arrow", retries=PATIENCE)
        view = user.find(marker="view")
        view.trigger(
            "viewDrag",
            {"kind": "sensor", "id": "101+X", "node": 105, "point": [2, 1.5, 3]},
        )
        model = rt.read_sensors(sheet).model
        assert model.xyz[model.points == 101].tolist() == [[2.0, 1.5, 3.0]]
        await user.should_see(marker="flip-gain")
        user.find(marker="flip").click()
        model = rt.read_sensors(sheet).model
        at = model.channels.index("101+X")  # still known by its name
        assert model.axes[at].tolist() == [-1.0, 0.0, 0.0]
        session.undo()
        session.undo()

    on("sensors", session, scenario)
    assert sheet.read_text() == before


def test_the_doctor_says_what_a_change_gains_and_writes_it(
    ran: Path, tmp_path: Path
) -> None:
    """Faults are put into the stored test; mending them gives all of its MAC back."""
    session = opened(ran, tmp_path)
    sheet_path = session.path.parent / "data" / "sensors.csv"
    whole = rt.read_sensors(sheet_path).model

    async def scenario(user: User) -> None:
        stage = session.stage("correlate")
        test = stage.reference.elastic
        row = {c: k for k, c in enumerate(test.channels)}
        shapes = np.array(test.shapes)
        shapes[row["101+X"]] *= -1
        shapes[[row["103+Y"], row["107+X"]]] = shapes[[row["107+X"], row["103+Y"]]]
        wrong = replace(test, shapes=shapes)
        found = rt.correlate(wrong, stage.fe_initial)
        faulty = replace(
            stage,
            reference=replace(stage.reference, elastic=wrong),
            initial=found.table,
            sensors=replace(stage.sensors, mendings=found.mendings),
        )
        assert session.study is not None
        session.study.run.results["correlate"] = faulty
        right = {
            "101+X": ("101+X", -1.0),
            "103+Y": ("107+X", 1.0),
            "107+X": ("103+Y", 1.0),
        }
        seen = gain(session, right)
        assert seen is not None
        assert seen.pairs[1] == len(stage.initial.rows()) > seen.pairs[0]
        assert seen.mac[1] == pytest.approx(
            np.mean([r.mac_percent for r in stage.initial.rows()])
        )
        await user.open("/sensors")
        await user.should_see(marker="mend-0", retries=PATIENCE)
        user.find(marker="mend-0").click()

    visit(session, scenario)
    mended = rt.read_sensors(sheet_path).model
    places = dict(
        zip(whole.channels, zip(whole.at, whole.axes, strict=True), strict=True)
    )
    now = dict(
        zip(mended.channels, zip(mended.at, mended.axes, strict=True), strict=True)
    )
    for name, (at, sign) in {"101+X": ("101+X", -1), "103+Y": ("107+X", 1)}.items():
        assert now[name][0] == places[at][0]
        assert now[name][1] == pytest.approx(sign * places[at][1])


def test_points_of_a_plan_are_added_taken_out_and_forbidden(
    localised: Path, tmp_path: Path
) -> None:
    session = opened(localised, tmp_path)

    async def scenario(user: User) -> None:
        await user.should_see("worst auto-MAC", retries=PATIENCE)
        stored = session.stage("plan")
        points = set(stored.sensors.test.points.tolist())
        view = user.find(marker="view")
        free = next(n for n in (201, 202, 203, 204) if n not in points)
        view.trigger("viewPick", {"kind": "node", "id": free})
        await user.should_see(marker="add")
        user.find(marker="add").click()
        assert session.config is not None
        assert session.config.plan is not None
        assert session.config.plan.fixed == [free]
        await user.should_see(str(len(points) + 1))
        view.trigger(
            "viewPick", {"kind": "sensor", "id": stored.sensors.test.channels[0]}
        )
        await user.should_see(marker="remove")
        user.find(marker="remove").click()
        assert session.config.plan.exclude == [int(stored.sensors.test.at[0])]
        view.trigger(
            "viewBox", {"node": [303, 306], "element": [], "sensor": [], "point": []}
        )
        await user.should_see(marker="forbid")
        user.find(marker="forbid").click()
        assert session.config.plan.keep_out == [
            [3.999, -0.001, 8.999, 4.001, 1.501, 9.001]
        ]

    on("plan", session, scenario)
    trial = rt.trial_plan(session.path)
    assert not {303, 306} & set(trial.nodes.tolist())


SHEET = """\
# of the tower
point;x;y;z;direction;azimuth;elevation
1;0;0;0;Z;;

2;1;0;0;;90;0
2;;;;0.6 0 0.8;;
"""


def test_rows_of_a_sheet_are_edited_where_they_stand(tmp_path: Path) -> None:
    path = tmp_path / "sensors.csv"

    def after(change: edits.Change) -> str:
        text = change(SHEET)
        path.write_text(text)
        return text

    path.write_text(SHEET)
    sheet = rt.read_sensors(path)
    names = sheet.model.channels
    assert names == ("1+Z", "2+Y", "2+Zs")
    text = after(edits.flip(sheet, ["2+Y"]))
    assert [x for x in text.splitlines() if x not in SHEET.splitlines()] == [
        "point;x;y;z;direction;azimuth;elevation;channel",
        "2;1;0;0;-Y;;;2+Y",
    ]
    after(edits.turn(sheet, 2, "Z"))
    assert rt.read_sensors(path).model.axes[1:].round(9).tolist() == [
        [-1, 0, 0],
        [0, 0.6, 0.8],
    ]
    after(edits.remap(sheet, names, {"Y": "-Z", "Z": "Y"}))
    model = rt.read_sensors(path).model
    assert model.channels == names
    assert model.axes[:2].tolist() == [[0, 1, 0], [0, 0, -1]]
    after(edits.swap(sheet, "1+Z", "2+Y"))
    assert rt.read_sensors(path).model.channels == ("2+Y", "1+Z", "2+Zs")
    text = after(edits.relocate(sheet, 2, np.array([1.5, 0.25, 0.0])))
    assert "2;1.5;0.25;0;;90;0\n2;;;;0.6 0 0.8;;\n" in text


def test_a_trial_of_the_planned_points_is_the_plan(localised: Path) -> None:
    stored = rt.open_study(localised).stage("plan")
    trial = rt.trial_plan(localised / "study.toml").at(
        stored.sensors.test.points.tolist()
    )
    # single precision of stored shapes
    assert trial.auto_mac == pytest.approx(stored.sensors.auto_mac, abs=1e-6)
    # of points that a symmetry makes equal either may be named
    assert len(trial.references) == len(stored.excitation.references)
    assert trial.reach == pytest.approx(stored.excitation.reach, abs=1e-6)
    assert trial.frequencies[trial.missed] == pytest.approx(
        stored.target_frequencies[stored.excitation.missed]
    )
    with pytest.raises(rt.InputError, match="1: no candidate of the plan"):
        rt.trial_plan(localised / "study.toml").at([1])
