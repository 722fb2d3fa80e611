"""The page of a report in a Chromium without a window: on paper, and its figures as pictures.

Chromium is a program of the user's; it reads the page from a folder of its own and asks no network.
"""

from __future__ import annotations

import base64
import html
import os
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ringtrue.errors import SolverFailed, SolverMissing
from ringtrue.io.foreign.parsers import json_value
from ringtrue.solvers.runner import run_program

VARIABLE = "RINGTRUE_CHROMIUM"
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_FLAGS = (
    "--headless",
    "--disable-gpu",
    "--use-angle=swiftshader",  # 3D views without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--log-level=3",
)
_PATIENCE = 600.0  # s, of drawing all figures on a slow machine


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure of the page as a picture.

    Attributes
    ----------
    png : bytes
    width : float
        On paper, inches.
    legend : sequence of (text, colour)
        What the page writes below a 3D view; a colour is `rgb(r, g, b)` or empty.
    modes : sequence of (name, png)
        Of mode shapes each mode.
    """

    png: bytes
    width: float
    legend: Sequence[tuple[str, str]]
    modes: Sequence[tuple[str, bytes]]


def find_chromium() -> str | None:
    """The program that the variable RINGTRUE_CHROMIUM names, or one on the PATH.

    Raises
    ------
    SolverMissing
        If the variable names no program.
    """
    if named := os.environ.get(VARIABLE):
        if (found := shutil.which(named)) is None:
            raise SolverMissing(f"{VARIABLE}={named}: no program there")
        return found
    return next((p for p in map(shutil.which, _NAMES) if p), None)


def print_page(page: str, target: Path) -> None:
    """Print a report to PDF, with all its figures.

    Raises
    ------
    SolverMissing
        If there is no Chromium.
    SolverFailed
        If it did not print.
    """
    with tempfile.TemporaryDirectory(prefix="ringtrue-") as name:
        folder = Path(name)
        printed = folder / "report.pdf"
        log = _run(page, folder, "", f"--print-to-pdf={printed}", "--no-pdf-header-footer")
        if not printed.is_file():
            raise SolverFailed(f"Chromium did not print the report: {log[-500:]}")
        shutil.copyfile(printed, target)


def pictures(page: str) -> list[Drawn]:
    """The figures of a report in their order.

    Raises
    ------
    SolverMissing
        If there is no Chromium.
    SolverFailed
        If it did not draw them.
    """
    with tempfile.TemporaryDirectory(prefix="ringtrue-") as name:
        # virtual time passes while nothing is drawn: it ends once all is
        log = _run(page, Path(name), "#pictures", "--virtual-time-budget=10000", "--dump-dom")
    found = re.search(r'<pre id="pictures">(.+?)</pre>', log, re.DOTALL)
    if found is None:
        raise SolverFailed(f"Chromium did not draw the figures of the report: {log[-500:]}")
    return [_drawn(figure) for figure in json_value(html.unescape(found[1]), "figures")]


def _run(page: str, folder: Path, place: str, *asked: str) -> str:
    """Open the page; returns all that Chromium says."""
    program = find_chromium()
    if program is None:
        raise SolverMissing(
            f"no Chromium: install chromium or google-chrome, or set {VARIABLE} to its program"
        )
    source = folder / "report.html"
    source.write_text(page, encoding="utf-8")
    flags = [*_FLAGS, f"--user-data-dir={folder / 'profile'}", *asked]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        flags.append("--no-sandbox")  # root has none
    command = [program, *flags, source.as_uri() + place]
    run_program(command, folder, name="Chromium", timeout=_PATIENCE)
    return (folder / "ringtrue.log").read_text(encoding="utf-8", errors="replace")


def _drawn(figure: Mapping[str, Any]) -> Drawn:
    return Drawn(
        png=_png(figure["png"]),
        width=figure["width"] / 96,  # pixels an inch, of style sheets
        legend=[(text, color) for text, color in figure["legend"]],
        modes=[(label, _png(address)) for label, address in figure["modes"]],
    )


def _png(address: str) -> bytes:
    return base64.b64decode(address.partition(",")[2])
