"""The studio in a browser: a pole is picked by a click, its line stands in choice.toml, and no one
without the token sees anything.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import chromium
import pytest
from clicks import POINT, fill, found, mouse, press, rest, see

pytest.importorskip("nicegui", reason="the extra `studio` is not installed")

import ringtrue as rt
from ringtrue.demos import frame
from ringtrue.io.choices import read_choice

pytestmark = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: the studio is NOT tested",
)

POLE = """(() => {
  const plot = document.querySelector('.js-plotly-plot'), { xaxis, yaxis } = plot._fullLayout;
  const trace = plot._fullData.find((d) => d.name === 'pole of a candidate mode' && d.yaxis === 'y');
  const at = Math.floor(trace.x.length / 2), box = plot.getBoundingClientRect();
  return { x: box.left + xaxis._offset + xaxis.d2p(trace.x[at]), y: box.top + yaxis._offset + yaxis.d2p(trace.y[at]),
           hz: trace.x[at], order: trace.y[at] };
})()"""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """The folder of a study with hammer records, and the address of its studio."""
    folder = tmp_path_factory.mktemp("frame")
    study = frame.write_study(
        folder, frame.MODEL + frame.TEST + frame.SETTINGS, ambient=False
    )
    rt.run_study(study, until="identify")
    command = [sys.executable, "-m", "ringtrue", "studio", str(study), "--no-browser"]
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    # a server that a test has started is none in a test
    own = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")} | one
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=own
    ) as server:
        assert server.stdout is not None
        yield folder, server.stdout.readline().split()[-1]
        server.terminate()
        assert server.wait(60) == 130  # as by Ctrl-C


def test_a_pole_is_picked(served: tuple[Path, str], tmp_path: Path) -> None:
    folder, address = served
    bare = address.partition("?")[0]
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(bare)
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=address.replace("/?", "/poles?"))
        assert page.until(
            "!!document.querySelector('.js-plotly-plot')?._fullData?.length"
        )
        place = page.evaluate(POLE)
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            page.mouse(kind, (place["x"], place["y"]), held=kind == "mousePressed")
            rest(page)
        assert page.until("document.body.innerText.includes('picked')", 30)
        # the cookie is enough; the pick is shown again
        page.call("Page.navigate", url=f"{bare}poles")
        assert page.until(
            "document.body?.innerText.includes('order " + str(place["order"]) + "')"
        )
        assert page.complaints() == []
        elsewhere = [
            u
            for u in page.requests()
            if not u.startswith((bare, "data:", "blob:", "ws"))
        ]
        assert elsewhere == []
    (pick,) = read_choice(folder / "choice.toml").picks
    assert pick.order == place["order"]
    assert pick.frequency == pytest.approx(place["hz"], rel=1e-6)
    assert json.loads((folder / ".ringtrue-studio.json").read_text())["done"] == 1


MODES = """(() => {
  const plot = document.querySelector('.js-plotly-plot'), box = plot?.getBoundingClientRect();
  const marks = plot?._fullData?.find((d) => d.name === 'natural mode' && d.customdata && d.yaxis === 'y');
  const { xaxis, yaxis } = plot?._fullLayout || {};
  return marks && [...marks.x].slice(-2).map((x, k) => ({ hz: x, at: [box.left + xaxis._offset + xaxis.d2p(x),
    box.top + yaxis._offset + yaxis.d2p(marks.y[k])] }));
})()"""


def test_a_mode_that_is_drawn_onto_another_is_merged_with_it(
    served: tuple[Path, str], tmp_path: Path
) -> None:
    folder, address = served
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=address.replace("/?", "/poles?"))
        one, other = found(page, MODES)
        for kind, mark in (
            ("Moved", one),
            ("Pressed", one),
            ("Moved", other),
            ("Released", other),
        ):
            page.mouse(f"mouse{kind}", tuple(mark["at"]), held=kind != "Moved")
            rest(page)
        fill(page, "Reason", "one mode, split in two")
        press(page, "Write")
        see(page, "merged")
        assert page.complaints() == []
    (merge,) = read_choice(folder / "choice.toml").merges
    assert merge.frequencies == pytest.approx((one["hz"], other["hz"]), rel=1e-6)


def test_a_pick_under_a_pointer_that_has_moved_on_is_kept(
    served: tuple[Path, str], tmp_path: Path
) -> None:
    """The plot says late what is under the pointer: a quick click elsewhere means what is there."""
    folder, address = served
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=address.replace("/?", "/poles?"))
        one, other = (
            found(page, f"{POINT}('.js-plotly-plot', 'pole of a candidate mode', {f})")
            for f in (2.5, 9.4)
        )
        mouse(page, tuple(one["at"]))
        see(page, f"picked {one['x']:.5g} Hz, order {one['y']}")
        found(page, f"{POINT}('.js-plotly-plot', 'your pick', {one['x']})")
        away, pick = (other["at"][0], other["at"][1] + 30), tuple(one["at"])
        page.mouse("mouseMoved", away, held=False)
        rest(page)
        page.mouse("mouseMoved", pick, held=False)
        mouse(page, tuple(other["at"]))
        see(page, f"picked {other['x']:.5g} Hz, order {other['y']}")
        assert page.complaints() == []
    picks = read_choice(folder / "choice.toml").picks[-2:]
    assert [p.order for p in picks] == [one["y"], other["y"]]
