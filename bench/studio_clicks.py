"""The studio under random clicks: two tabs on one study, reloads, edits from outside, kill -9.

    python bench/studio_clicks.py [--quick] [--seed N]

The frame of three storeys is run to its correlation and opened in headless Chromium. For 30 minutes
(quick: one) a script clicks, drags, types and presses keys on all screens of either tab, loads
pages again, edits study.toml and the sensor sheet from outside, and kills the studio with signal 9
and opens it anew. After each action study.toml, the choice, the sheet and the history must be
readable, what was written outside must stand there, and the last step of the history must stand in
its file; neither the studio nor a page may meet an exception. Not covered: several users, other
browsers, an editor that writes in the same millisecond.
"""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from outcome import ROOT, Check, Report, arguments, at_least, at_most, sized

import ringtrue as rt
from ringtrue.demos import frame
from ringtrue.errors import RingtrueError
from ringtrue.io.choices import parse_choice
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.studio.documents import HISTORY, Documents
from ringtrue.studio.screens import SCREENS
from ringtrue.study.config import parse_config

sys.path.insert(0, str(ROOT / "tests" / "browser"))
import chromium
from clicks import key, mouse, studio

KEYS = ("n", "p", "a", "r", " ", "Enter", "Escape", "Delete", "ArrowRight", "Tab")
CTRL = 2
WIDE, HIGH = 1280, 713
# NiceGUI asks plotly to fit a plot that was hidden meanwhile, and does not wait for its refusal
NO_FAULT = "Resize must be passed a displayed plot div element"
SETTLED = "new Promise((done) => setTimeout(() => done(true), 250))"
# What can be clicked: in the frame of the page, or on its screen, a dialog, a menu.
PLACES = """((inFrame) => [...document.querySelectorAll('button,.q-item,.q-tab,td,.cursor-pointer,.q-field,.q-slider,canvas,.nsewdrag')]
  .filter((e) => e.checkVisibility() && !!e.closest('.rt-rail,header') === inFrame)
  .map((e) => e.getBoundingClientRect()).map((b) => [b.x + b.width / 2, b.y + b.height / 2]))"""

# Buttons that write a file, or ask for the reason to.
DECIDES = """[...document.querySelectorAll('.q-drawer--right button, .q-dialog button')]
  .filter((e) => e.checkVisibility() && !e.disabled)
  .map((e) => e.getBoundingClientRect()).map((b) => [b.x + b.width / 2, b.y + b.height / 2])"""


@dataclass(slots=True)
class Clicked:
    """Counts.

    Attributes
    ----------
    actions, edits, outside, reloads, kills : int
        What was done: all actions, steps in the history, edits from outside, pages that were
        loaded again, studios that were killed and opened anew.
    faults, errors : int
        Exceptions in the log of the studio, and in a page.
    lost, broken : int
        Edits that do not stand in the files, and files that cannot be read, after an action.
    """

    actions: int = 0
    edits: int = 0
    outside: int = 0
    reloads: int = 0
    kills: int = 0
    faults: int = 0
    errors: int = 0
    lost: int = 0
    broken: int = 0


def nothing_lost(found: Clicked) -> list[Check]:
    """No exception, no lost edit, files that can be read; and something was done."""
    return [
        at_most("exceptions of the studio", found.faults, 0),
        at_most("exceptions of a page", found.errors, 0),
        at_most("edits that were lost", found.lost, 0),
        at_most("files that could not be read", found.broken, 0),
        at_least("edits by clicks", found.edits, 1),
        at_least("edits from outside", found.outside, 1),
        at_least("pages loaded again", found.reloads, 1),
        at_least("studios killed and opened anew", found.kills, 1),
    ]


@dataclass(slots=True)
class Files:
    """The files of the study, and what must stand in them."""

    study: Path
    written: list[tuple[Path, str]] = field(default_factory=list)
    steps: int = 0

    @property
    def sheet(self) -> Path:
        """The sensor sheet."""
        return self.study.parent / "data" / "sensors.csv"

    def write_outside(self, number: int, rng: random.Random) -> None:
        """A comment at the head of a file, as an editor writes it."""
        path = rng.choice((self.study, self.sheet))
        line = f"# seen outside {number}\n"
        path.write_text(line + path.read_text())
        self.written.append((path, line))

    def judge(self, found: Clicked) -> None:
        """Count what is lost or cannot be read."""
        folder = self.study.parent
        try:
            parse_config(self.study.read_text(), self.study)
            read_sensor_sheet(self.sheet)
            choice = folder / "choice.toml"
            if choice.exists():
                parse_choice(choice.read_text(), choice.name)
            if (folder / HISTORY).exists():
                json.loads((folder / HISTORY).read_text())
        except (RingtrueError, ValueError) as e:
            print(f"cannot be read: {e}")
            found.broken += 1
            return
        gone = self._gone(found)
        if gone:  # history and file are two files: the studio may be between them
            time.sleep(2.0)
            gone = self._gone(found)
        if gone:
            print(f"lost: {gone}")
        found.lost += len(gone)

    def _gone(self, found: Clicked) -> list[str]:
        """What was written and is not there; counts further steps of the history."""
        gone = [line for path, line in self.written if line not in path.read_text()]
        documents = Documents(self.study)
        found.edits += max(len(documents.steps) - self.steps, 0)
        self.steps = len(documents.steps)
        try:
            for edit in (
                documents.steps[documents.done - 1].edits if documents.done else ()
            ):
                edit.applied((self.study.parent / edit.name).read_text(), back=True)
        except RingtrueError as e:
            gone.append(str(e))
        return gone


class Hands:
    """Random actions on two tabs of one studio."""

    def __init__(self, files: Files, pages: list[chromium.Page], seed: int) -> None:
        self.files = files
        self.pages = pages
        self.rng = random.Random(seed)
        self.found = Clicked()
        self.address = ""

    def opened(self, address: str) -> None:
        """Show a studio in both tabs."""
        self.address = address
        for page in self.pages:
            self.visit(page, address)

    def visit(self, page: chromium.Page, address: str) -> None:
        """Load a page, which must come."""
        page.call("Page.bringToFront")
        page.call("Page.navigate", url=address)
        assert page.until("!!document.querySelector('.rt-rail .q-item')", 60), "no page"

    def act(self) -> None:
        """One action, and what it left."""
        rng, page = self.rng, self.rng.choice(self.pages)
        page.call("Page.bringToFront")
        kinds = (self.click, self.drag, self.press, self.type, self.leave, self.edit)
        does = rng.choices(kinds, (60, 8, 10, 8, 6, 8))[0]
        does(page)
        page.evaluate(SETTLED)
        if not page.evaluate("location.href").startswith(
            self.address.partition("/?")[0]
        ):
            self.visit(page, self.address)
        self.found.actions += 1
        self.files.judge(self.found)
        self.listen(page)

    def place(self, page: chromium.Page) -> tuple[float, float]:
        """Something that can be clicked, or any place."""
        rng = self.rng
        anywhere = (rng.uniform(0, WIDE), rng.uniform(0, HIGH))
        if rng.random() < 0.2:
            return anywhere
        if rng.random() < 0.3 and (there := page.evaluate(DECIDES)):
            x, y = rng.choice(there)
            return x, y
        there = page.evaluate(f"{PLACES}({json.dumps(rng.random() < 0.15)})")
        seen = [(x, y) for x, y in there if 0 < x < WIDE and 0 < y < HIGH]
        return rng.choice(seen) if seen else anywhere

    def click(self, page: chromium.Page) -> None:
        """A click, now and then with Shift."""
        mouse(page, self.place(page), keys=self.rng.choice((0, 0, 0, 8)))

    def drag(self, page: chromium.Page) -> None:
        """From one place to another."""
        mouse(
            page, *(self.place(page) for _ in range(4)), keys=self.rng.choice((0, CTRL))
        )

    def press(self, page: chromium.Page) -> None:
        """Keys, among them undo and redo."""
        if self.rng.random() < 0.3:
            key(page, self.rng.choice("zy"), CTRL)
        else:
            key(page, self.rng.choice(KEYS))

    def type(self, page: chromium.Page) -> None:
        """A text into what has the focus, and Enter."""
        script = (
            "document.querySelector('.q-dialog input, .q-drawer--right input')?.focus()"
        )
        page.evaluate(script)
        page.call(
            "Input.insertText", text=self.rng.choice(("seen on site", "1.4", "ü #\"'"))
        )
        key(page, self.rng.choice(("Enter", "Tab")))

    def leave(self, page: chromium.Page) -> None:
        """The page again, or another screen by its address."""
        base = self.address.partition("/?")[0]
        where = f"{base}/{self.rng.choice(SCREENS).name}"
        self.visit(
            page, where if self.rng.random() < 0.7 else page.evaluate("location.href")
        )
        self.found.reloads += 1

    def edit(self, page: chromium.Page) -> None:
        """From outside, once what was clicked has been written."""
        page.evaluate(SETTLED)
        self.found.outside += 1
        self.files.write_outside(self.found.outside, self.rng)

    def listen(self, page: chromium.Page) -> None:
        """Count exceptions of the page."""
        for event in page.events:
            if event.get("method") != "Runtime.exceptionThrown":
                continue
            text = json.dumps(event["params"]["exceptionDetails"])
            if NO_FAULT not in text:
                print(text)
                self.found.errors += 1
        page.events.clear()


def faults(log: Path) -> int:
    """Exceptions in the log of a studio."""
    text = log.read_text()
    at = text.find("Traceback")
    if at >= 0:
        print(text[at:][-4000:])
    return text.count("Traceback (most recent call last)")


@contextmanager
def tabs() -> Iterator[list[chromium.Page]]:
    """Two of one browser."""
    with ExitStack() as stack:
        folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        page = stack.enter_context(chromium.page(Path(stack.enter_context(folder))))
        yield [page, page.tab()]


def clicked(folder: Path, seconds: float, seed: int) -> Clicked:
    """Random actions for some time; the studio is killed in between."""
    study = frame.write_study(folder, frame.DEMO, ambient=False)
    rt.run_study(study, until="correlate")
    files = Files(study)
    with tabs() as pages:
        hands = Hands(files, pages, seed)
        begin = time.monotonic()
        lives = 2 if seconds < 600 else 10  # the studio is killed in between
        for life in range(lives):
            log = folder / f"log{life}"
            with studio(study, log) as (server, address):
                hands.opened(address)
                while time.monotonic() < begin + seconds * (life + 1) / lives:
                    hands.act()
                if life < lives - 1:
                    # it is killed while it works
                    mouse(pages[0], hands.place(pages[0]))
                    killed(server)
                    hands.found.kills += 1
                    files.judge(hands.found)
            hands.found.faults += faults(log)
    return hands.found


def killed(server: subprocess.Popen[str]) -> None:
    """End a studio without a warning."""
    server.send_signal(signal.SIGKILL)
    server.wait(60)


def main() -> None:
    """Click, and say what was met."""
    parser = arguments(__doc__)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    report = Report(options)
    if chromium.find() is None:
        report.not_run("Chromium", "not installed: nothing was clicked")
        report.end()
    seconds = sized(options, 60.0, 1800.0, 7200.0)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        found = clicked(Path(name), seconds, options.seed)
    what = f"{found.actions} random actions on two tabs"
    report.row(what, {"min": seconds / 60}, nothing_lost(found))
    report.end()


if __name__ == "__main__":
    main()
