"""A campaign by clicks alone: from a deck and hammer records to the report, in Chromium without a
network; the files that it leaves say the same without the studio.

The frame of three storeys of `ringtrue.demos.frame`; the sensor 203+X is reversed on the sheet.
$RINGTRUE_PYTHON names another Python, into which ringtrue is installed (scripts/wheel).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import chromium
import pytest
from clicks import (
    FIND,
    MEMBER,
    POINT,
    fill,
    found,
    go,
    key,
    mouse,
    press,
    see,
    studio,
    surroundings,
    text_of,
    up_to_date,
    write,
)

pytest.importorskip("nicegui", reason="the extra `studio` is not installed")

from ringtrue.demos import frame
from ringtrue.io.choices import read_choice
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.study.config import parse_config

pytestmark = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: the studio is NOT tested",
)
PYTHON = os.environ.get("RINGTRUE_PYTHON", sys.executable)
REVERSED = "203+X"
COLUMNS = {"first storey": 100, "second storey": 200}  # an element of each region
NAME = "sway along x"
PROGRESS = "document.querySelector('.q-drawer--right .q-linear-progress')"
NO_NETWORK = "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1"


def written(folder: Path) -> Path:
    """Deck, records, log, and a sheet with one sensor reversed; gives the deck."""
    frame.write_data(folder, ambient=False)
    (folder / "frame.bdf").write_text(frame.deck())
    sheet = folder / "sensors.csv"
    text = sheet.read_text()
    assert f"+X,{REVERSED}" in text
    sheet.write_text(text.replace(f"+X,{REVERSED}", f"-X,{REVERSED}"))
    return folder / "frame.bdf"


def study(folder: Path) -> Any:
    """The study.toml as it is."""
    return parse_config((folder / "study.toml").read_text(), folder / "study.toml")


def began(page: chromium.Page, folder: Path) -> None:
    """A study.toml of what lies in the folder, and its first run."""
    press(page, "Begin the study")
    go(page, "Poles", "poles")
    press(page, "Run up to identify")
    found(page, f"{POINT}('.js-plotly-plot', 'pole of a candidate mode', 2)")
    config = study(folder)
    assert (config.model.deck, config.test.log) == ("frame.bdf", "campaign.json")


def two_poles(page: chromium.Page, folder: Path) -> None:
    """Two poles of the diagram are picked with the mouse."""
    for count, near in enumerate((2.5, 9.4), 1):
        place = found(
            page, f"{POINT}('.js-plotly-plot', 'pole of a candidate mode', {near})"
        )
        mouse(page, tuple(place["at"]))
        see(page, f"picked {place['x']:.5g} Hz, order {place['y']}")
        picks = read_choice(folder / "choice.toml").picks
        assert len(picks) == count
        assert picks[-1].frequency == pytest.approx(place["x"], rel=1e-6)
        assert picks[-1].order == place["y"]


def sensor_repaired(page: chromium.Page, folder: Path) -> None:
    """What the channel doctor found is written into the sheet."""
    go(page, "Sensors", "sensors")
    see(page, "No correlation is stored.")
    press(page, "Correlate")
    press(page, "Write into the sheet")
    see(page, "correlate anew")
    model = read_sensor_sheet(folder / "sensors.csv").model
    axis = model.axes[model.channels.index(REVERSED)]
    assert axis.tolist() == [1.0, 0.0, 0.0]


def pair_locked(page: chromium.Page, folder: Path) -> None:
    """A cell of the matrix is clicked and locked with a reason."""
    go(page, "Correlation", "correlation")
    press(page, "Correlate anew")
    up_to_date(page, "Correlation")
    cell = found(page, f"{POINT}('.js-plotly-plot', 'heatmap', [1, 1])")
    mouse(page, tuple(cell["at"]))
    write(page, "Lock", "Reason", "seen on site")
    see(page, "Locked")
    assert study(folder).correlate.lock == ["2:2"]
    assert "seen on site" in (folder / "study.toml").read_text()


def two_regions(page: chromium.Page, folder: Path) -> None:
    """A column of each of two storeys is clicked in the 3D view; its material becomes a candidate."""
    go(page, "Model", "model")
    see(page, "No findings.")
    mouse(page, tuple(found(page, f"{MEMBER}(100)?.empty")))
    key(page, " ")  # the pair that is selected comes to rest
    for name, element in COLUMNS.items():
        mouse(page, tuple(found(page, f"{MEMBER}({element})?.at")))
        see(page, str(element))
        write(page, "Candidate region", "Name", name)
        found(page, f"{FIND}({json.dumps(name)})")
    chosen = {c.name: c.targets for c in study(folder).candidate}
    assert chosen == {"first storey": ["MAT1 1 E"], "second storey": ["MAT1 2 E"]}


def updated(page: chromium.Page, folder: Path) -> None:
    """The updating is run and watched; the delivered deck is shown."""
    go(page, "Update", "update")
    see(page, "Factors, updated over initial")
    press(page, "Update")
    see(page, "Stop")
    assert page.until(f"!!{PROGRESS}"), text_of(page)
    up_to_date(page, "Update")
    press(page, "Delivered deck")
    see(page, "MAT1")
    found(page, "document.querySelectorAll('.rt-diff .rt-add').length")
    assert list(folder.glob("updated/**/*.bdf"))


def reported(page: chromium.Page, folder: Path) -> None:
    """All stages, a name for a mode, the report."""
    go(page, "Verdict and report", "verdict")
    press(page, "Run the study")
    up_to_date(page, "Verdict and report")
    fill(page, "1: 1.7286 Hz", NAME)
    press(page, "Write the report anew")
    up_to_date(page, "Verdict and report")
    inside = (
        "document.querySelector('iframe.rt-report')?.contentDocument?.body?.innerText"
    )
    found(page, f"{inside}?.includes({json.dumps(NAME)})")


def summary(folder: Path) -> dict[str, Any]:
    """The stored summary without its times."""
    stored = dict(json.loads((folder / "summary.json").read_text()))
    assert stored.pop("timings_s")
    return stored


def test_a_campaign_by_clicks_alone(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    deck = written(folder)
    log = tmp_path / "log"
    steps = (
        began,
        two_poles,
        sensor_repaired,
        pair_locked,
        two_regions,
        updated,
        reported,
    )
    with (
        studio(deck, log, PYTHON) as (_, address),
        chromium.page(tmp_path / "profile", NO_NETWORK) as page,
    ):
        page.call("Page.navigate", url=address)
        for step in steps:
            step(page, folder)
        assert page.complaints() == []
        bare = address.partition("?")[0]
        assert all(
            u.startswith((bare, "data:", "blob:", "ws")) for u in page.requests()
        )
    assert "Traceback" not in log.read_text()

    copied = tmp_path / "copy"
    made = (
        "study.h5",
        "summary.json",
        "report.html",
        "updated",
        ".ringtrue-studio.json",
    )
    shutil.copytree(folder, copied, ignore=shutil.ignore_patterns(*made))
    subprocess.run(
        [PYTHON, "-m", "ringtrue", "run", "study.toml"],
        cwd=copied,
        check=True,
        capture_output=True,
        env=surroundings(PYTHON),
    )
    assert summary(copied) == summary(folder)
