"""What a user of the studio does with mouse and keyboard, in a headless Chromium."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import chromium

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
PATIENCE = 60.0  # s, for a run of stages on a busy machine

# What can be clicked and has a text among its lines, seen and not covered; its middle.
FIND = """((text, all) => {
  const lines = (e) => [e.innerText, ...[...e.querySelectorAll('i')].map((i) => i.innerText)].join('\\n').split('\\n');
  const found = [...document.querySelectorAll('button,.q-item,.q-tab,td,.cursor-pointer')]
    .filter((e) => e.checkVisibility() && !e.disabled && lines(e).some((l) => l.trim() === text));
  if (all) return found.length;
  const e = found.at(-1);
  if (!e) return null;
  e.scrollIntoView({ block: 'nearest' });
  const box = e.getBoundingClientRect(), x = box.x + box.width / 2, y = box.y + box.height / 2;
  const top = document.elementFromPoint(x, y);
  return top && (e.contains(top) || top.contains(e)) ? [x, y] : null;
})"""
# A point of a plot as a place on the page: of a trace, the one nearest to an abscissa; a cell of a matrix.
POINT = """((id, trace, at) => {
  const plot = document.querySelector(id);
  if (!plot?._fullData?.length) return null;
  const { xaxis, yaxis } = plot._fullLayout, box = plot.getBoundingClientRect();
  const d = plot._fullData.find((t) => (t.name === trace || t.type === trace) && (t.yaxis || 'y') === 'y');
  if (!d) return null;
  const heat = d.type === 'heatmap', off = (x) => Math.abs(x - at);
  const k = heat ? 0 : Array.from(d.x.keys()).reduce((best, i) => (off(d.x[i]) < off(d.x[best]) ? i : best), 0);
  const [x, y] = heat ? at : [d.x[k], d.y[k]], to = heat ? 'c2p' : 'd2p';
  return { at: [box.left + xaxis._offset + xaxis[to](x), box.top + yaxis._offset + yaxis[to](y)], x, y };
})"""
# The middle of an element between two nodes in the 3D view, as a place on the page.
MEMBER = """((id) => {
  const view = [...document.querySelectorAll('.view')].map((e) => e.parentElement.ringtrueView).find((v) => v?.drawn && v.body);
  if (!view) return null;
  const { model } = view, e = model.element_id.indexOf(id), l = model.line_element.indexOf(e);
  const [a, b] = [0, 1].map((k) => view.project(view.body, model.lines[2 * l + k])), box = view.canvas.getBoundingClientRect();
  return { at: [box.left + (a[0] + b[0]) / 2, box.top + (a[1] + b[1]) / 2], empty: [box.left + 9, box.bottom - 9] };
})"""


def mouse(page: chromium.Page, *places: tuple[float, float], keys: int = 0) -> None:
    """A click at a place; a drag from the first place to the last one."""
    kinds = [
        "mouseMoved",
        "mousePressed",
        *["mouseMoved"] * (len(places) - 1),
        "mouseReleased",
    ]
    for kind, at in zip(kinds, [places[0], *places, places[-1]], strict=True):
        page.mouse(kind, at, keys, held=kind == "mousePressed" or len(places) > 1)


def found(page: chromium.Page, script: str, seconds: float = PATIENCE) -> Any:
    """What a script gives once it gives something; twice the same, so that it has come to rest."""
    end = time.monotonic() + seconds
    last = None
    while time.monotonic() < end:
        value = page.evaluate(script)
        if value and value == last:
            return value
        last = value
        time.sleep(0.15)
    raise AssertionError(
        f"not there in {seconds:g} s: {script[-200:]}\n{text_of(page)}"
    )


def rest(page: chromium.Page) -> None:
    """Wait until a plot has seen what is under the pointer."""
    page.until("new Promise((done) => setTimeout(() => done(true), 300))")


def text_of(page: chromium.Page) -> str:
    """What is written on the page."""
    return str(page.evaluate("document.body?.innerText"))


def press(page: chromium.Page, text: str) -> None:
    """Click what has a text, or an icon of this name, when it is there."""
    mouse(page, tuple(found(page, f"{FIND}({json.dumps(text)})")))


def go(page: chromium.Page, title: str, name: str) -> None:
    """Open a screen by a click on the list of screens."""
    press(page, title)
    assert page.until(f"location.pathname === '/{name}'", PATIENCE), (
        f"{title} does not open"
    )


def write(page: chromium.Page, button: str, label: str, text: str) -> None:
    """Open the dialog of a button, fill its input, write; once more where no dialog came because
    the button was drawn anew under the pointer.
    """
    for _ in range(5):
        press(page, button)
        if page.until("!!document.querySelector('.q-dialog input')", 3.0):
            break
    fill(page, label, text)
    press(page, "Write")
    found(page, "!document.querySelector('.q-dialog')")


def see(page: chromium.Page, text: str, seconds: float = PATIENCE) -> None:
    """Wait for a text, whatever its case."""
    there = (
        f"document.body?.innerText?.toLowerCase().includes({json.dumps(text.lower())})"
    )
    found(page, there, seconds)


def up_to_date(page: chromium.Page, title: str) -> None:
    """Wait until all stages of a screen are done and nothing runs."""
    script = f"""(() => {{
      const item = [...document.querySelectorAll('.rt-rail .q-item')].find((e) => e.innerText.split('\\n').includes({json.dumps(title)}));
      const icons = [...item.querySelectorAll('.q-item__section--side:last-child i')].map((i) => i.innerText);
      return icons.length > 0 && icons.every((i) => i === 'check_circle') && !document.querySelector('.rt-rail .q-linear-progress:not(.hidden)');
    }})()"""
    found(page, script)


def fill(page: chromium.Page, label: str, text: str) -> None:
    """Click an input and type."""
    script = f"""(() => {{ const e = document.querySelector('input[aria-label="{label}"]');
      if (!e) return null; const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; }})()"""
    mouse(page, tuple(found(page, script)))
    page.call("Input.insertText", text=text)


def key(page: chromium.Page, name: str, keys: int = 0) -> None:
    """Press a key; 2 holds Ctrl."""
    text = {"text": name} if len(name) == 1 and not keys else {}
    if name == "Enter":
        text = {"text": "\r"}
    for kind in ("keyDown", "keyUp"):
        more = text if kind == "keyDown" else {}
        page.call("Input.dispatchKeyEvent", type=kind, key=name, modifiers=keys, **more)


def surroundings(python: str = sys.executable) -> dict[str, str]:
    """The environment of a process of some Python: one thread, and none of this test."""
    # a server that a test has started is none in a test
    own = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    if python != sys.executable:
        own.pop("PYTHONPATH", None)
    return own | dict.fromkeys(THREADS, "1")


@contextmanager
def studio(
    what: Path, log: Path, python: str = sys.executable
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A studio in a process of its own, and its address; what it says of faults is in `log`."""
    command = [python, "-m", "ringtrue", "studio", str(what), "--no-browser"]
    with (
        log.open("a") as said,
        subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
            env=surroundings(python),
        ) as server,
    ):
        assert server.stdout is not None
        try:
            line = server.stdout.readline()
            assert line, log.read_text()
            yield server, line.split()[-1]
        finally:
            if server.poll() is None:
                server.terminate()
            server.wait(60)
