"""The 3D viewer as an element of a served page: Python shows, and hears what the mouse does.

The plate of test_viewer.py; NiceGUI serves it from a process of its own, as the studio does.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import chromium
import pytest
from test_viewer import TOP, plate, where

pytest.importorskip("nicegui", reason="the extra `studio` is not installed")
pytestmark = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: the 3D viewer is NOT tested",
)


def serve(port: int, folder: Path) -> None:
    """The page: a view whose events are written down, buttons that show something else."""
    import numpy as np
    from nicegui import ui

    from ringtrue.studio.viewer_element import EVENTS, Viewer

    scene = plate(folder)

    @ui.page("/")
    def page() -> None:
        options = {"drag": True, "pick": ["element", "sensor", "node"]}
        with ui.element("div").style("width: 600px; height: 400px"):
            viewer = Viewer(scene, linked="both", **options)
        with ui.element("div").style("width: 600px; height: 200px"):
            Viewer(scene, linked="both")
        heard = ui.label("").classes("heard")
        for name in EVENTS[:2] + EVENTS[3:5]:
            viewer.on_event(name, lambda e, n=name: heard.set_text(json.dumps([n, e])))
        lifted = np.outer(np.arange(16) == 15, [0.0, 0.0, 2.0])
        viewer.shapes("1", lifted).field("f", np.arange(11.0), of="element", unit="Hz")
        viewer.show(camera=TOP)
        changes: dict[str, dict[str, Any]] = {
            "isolate": {"isolate": {"property": np.array([2])}},
            "clip": {"isolate": None, "clip": {"normal": [1, 0, 0], "offset": 1.4}},
            "all": {"clip": None, "mode": "1", "field": "f"},
        }
        for name, state in changes.items():
            ui.button(name, on_click=lambda s=state: viewer.show(**s)).classes(name)

    ui.run(
        host="127.0.0.1",
        port=port,
        show=False,
        reload=False,
        uvicorn_logging_level="error",
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[chromium.Page]:
    folder = tmp_path_factory.mktemp("element")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, __file__, str(port), str(folder)]
    own = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    with subprocess.Popen(command, cwd=Path(__file__).parent, env=own) as server:
        try:
            while not answers(port):
                assert server.poll() is None, "the server has ended"
                time.sleep(0.1)
            with chromium.page(folder / "profile") as page:
                page.call("Page.navigate", url=f"http://127.0.0.1:{port}/")
                ready = "[...document.querySelectorAll('.view')].every((e) => e.parentElement.ringtrueView?.drawn)"
                assert page.until(
                    f"document.querySelectorAll('.view').length === 2 && {ready}", 60
                )
                page.evaluate(
                    "window.view = document.querySelector('.view').parentElement.ringtrueView; 0"
                )
                assert page.until("view.camera.el > 1.5", 20)
                yield page
                assert page.complaints() == []
        finally:
            server.terminate()


def answers(port: int) -> bool:
    """Whether the server has begun."""
    with socket.socket() as asked:
        return asked.connect_ex(("127.0.0.1", port)) == 0


def heard(page: chromium.Page, *places: tuple[float, float], keys: int = 0) -> Any:
    """What Python heard of a click, or of a drag from the first place of the plate to the last."""

    page.evaluate("window.before = document.querySelector('.heard').textContent; 0")
    at = [where(page, *p) for p in places]
    left, top = page.evaluate(
        "(({x, y}) => [x, y])(view.canvas.getBoundingClientRect())"
    )
    at = [(x + left, y + top) for x, y in at]
    page.mouse("mousePressed", at[0], keys)
    for p in at[1:]:
        page.mouse("mouseMoved", p, keys)
    page.mouse("mouseReleased", at[-1], keys)
    assert page.until("document.querySelector('.heard').textContent !== before", 10), (
        page.complaints()
    )
    return json.loads(page.evaluate("document.querySelector('.heard').textContent"))


def shown(page: chromium.Page, name: str, until: str) -> None:
    """Press a button, until the view shows what it says."""
    page.evaluate(f"document.querySelector('button.{name}').click()")
    assert page.until(until, 20)


def test_python_hears_the_mouse_and_changes_what_is_shown(page: chromium.Page) -> None:
    name, found = heard(page, (2.5, 1.5))
    assert (name, found["kind"], found["id"], found["material"]) == (
        "pick",
        "element",
        23,
        8,
    )
    name, box = heard(page, (0.9, 0.4), (1.5, 1.5), (2.2, 2.3), keys=2)
    assert (name, sorted(box["element"])) == ("box", [11, 12, 13, 21, 22, 23])
    name, moved = heard(page, (4.1, 2.0), (3.0, 1.0), (2.1, 1.05))
    assert (name, moved["id"], moved["node"]) == ("drag", "15+X", 8)
    shown(page, "isolate", "view.state.isolate?.property[0] === 2")
    assert heard(page, (1.5, 0.5)) == ["pick", None]
    shown(page, "clip", "view.state.clip?.offset === 1.4")
    assert heard(page, (1.3, 0.5))[1]["id"] == 12
    assert heard(page, (1.7, 0.5)) == ["pick", None]
    shown(page, "all", "view.moves && view.scale.innerText.startsWith('f, Hz')")
    page.evaluate("view.turned()")
    other = "document.querySelectorAll('.view')[1].parentElement.ringtrueView"
    assert page.evaluate(f"{other}.camera.el") == page.evaluate("view.camera.el")


if __name__ in {"__main__", "__mp_main__"}:
    serve(int(sys.argv[1]), Path(sys.argv[2]))
