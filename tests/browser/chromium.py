"""A headless Chromium spoken to through its DevTools pipe; the standard library is enough."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
)
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
    "--disable-dev-shm-usage", "--window-size=1280,800", "--remote-debugging-pipe",
)  # fmt: skip
# The browser wants its pipe as descriptors 3 (in) and 4 (out); 10 and up keep the two dup2 from
# clashing.
LAUNCH = (
    "import os,sys,fcntl;r,w=(fcntl.fcntl(int(a),fcntl.F_DUPFD,10) for a in sys.argv[1:3]);"
    "os.dup2(r,3);os.dup2(w,4);os.execv(sys.argv[3],sys.argv[3:])"
)


PATIENCE = 300.0  # s: says that something hangs, not that the machine is busy


def find() -> str | None:
    """Path of a Chromium, None where there is none."""
    return next((p for p in map(shutil.which, NAMES) if p), None)


class Page:
    """One page; collects the events of the protocol."""

    def __init__(self, to: int, back: int, buffer: bytearray | None = None) -> None:
        self.to, self.back, self.last, self.session = to, back, 0, ""
        self.buffer = bytearray() if buffer is None else buffer  # of all tabs
        self.events: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call(
            "Target.attachToTarget", targetId=target, flatten=True
        )["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def tab(self) -> Page:
        """Another page of the same browser; events come to the one that is called."""
        return Page(self.to, self.back, self.buffer)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command and wait for its answer."""
        self.last += 1
        message = {"id": self.last, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            answer = self._read(end - time.monotonic())
            if answer.get("id") == self.last:
                assert "error" not in answer, answer["error"]
                return dict(answer["result"])
            self.events.append(answer)
        raise TimeoutError(method)

    def mouse(
        self, kind: str, at: tuple[float, float], keys: int = 0, *, held: bool = True
    ) -> None:
        """An event of the left button, such as "mousePressed"; `held` while the mouse moves."""
        self.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=at[0],
            y=at[1],
            button="left",
            buttons=int(held and kind != "mouseReleased"),
            modifiers=keys,
            clickCount=1,
        )

    def _read(self, wait: float) -> dict[str, Any]:
        while b"\0" not in self.buffer:
            if not select.select([self.back], [], [], max(wait, 0))[0]:
                raise TimeoutError("the browser does not answer")
            piece = os.read(self.back, 1 << 20)
            if not piece:
                raise ConnectionError("the browser has gone")
            self.buffer += piece
        text, _, rest = self.buffer.partition(b"\0")
        self.buffer[:] = rest
        return dict(json.loads(text))

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.call(
            "Runtime.evaluate",
            expression=expression,
            returnByValue=True,
            awaitPromise=True,
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(
        self, expression: str, seconds: float = PATIENCE, *, every: float = 0.2
    ) -> bool:
        """Whether the expression becomes true in time; asked `every` so many seconds."""
        end = time.monotonic() + seconds
        while not self.evaluate(expression):
            if time.monotonic() > end:
                return False
            time.sleep(every)
        return True

    def complaints(self) -> list[str]:
        """Errors of scripts, of the console and of the browser's log."""
        out = []
        for e in self.events:
            p = e.get("params", {})
            if e.get("method") == "Runtime.exceptionThrown":
                out.append(json.dumps(p["exceptionDetails"])[:500])
            elif e.get("method") == "Runtime.consoleAPICalled" and p["type"] in (
                "error",
                "assert",
            ):
                out.append(json.dumps(p["args"])[:500])
            elif e.get("method") == "Log.entryAdded" and p["entry"]["level"] == "error":
                out.append(p["entry"]["text"])
        return out

    def requests(self) -> list[str]:
        """Addresses asked for."""
        sent = [
            e["params"]
            for e in self.events
            if e.get("method") == "Network.requestWillBeSent"
        ]
        return [p["request"]["url"] for p in sent]


@contextmanager
def page(profile: Path, *flags: str) -> Iterator[Page]:
    """A browser with a profile of its own, ended with the block."""
    binary = find()
    assert binary is not None
    in_read, in_write = os.pipe()
    out_read, out_write = os.pipe()
    command = [
        sys.executable,
        "-c",
        LAUNCH,
        str(in_read),
        str(out_write),
        binary,
        *FLAGS,
        *flags,
        f"--user-data-dir={profile}",
    ]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(
        command, pass_fds=(in_read, out_write), stdout=quiet, stderr=quiet
    ) as process:
        os.close(in_read), os.close(out_write)
        try:
            yield Page(in_write, out_read)
        finally:
            os.close(in_write), os.close(out_read)
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
