"""The report on paper and as a document of Word, to be edited and filed.

A Chromium without a window, a program of the user's, prints the page and draws its figures as
pictures; it reads the page from a folder of its own and asks no network.
"""

from __future__ import annotations

import base64
import html
import io
import os
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.errors import SolverFailed, SolverMissing
from ringtrue.io.foreign.parsers import json_value
from ringtrue.report.parts import (
    Block,
    Cell,
    Checks,
    Code,
    Columns,
    Diff,
    Facts,
    Fold,
    Heading,
    Items,
    Key,
    Photo,
    Picture,
    Plot,
    ReportTable,
    Scene3D,
    Section,
    Stages,
    Tabs,
    Text,
)
from ringtrue.solvers.runner import run_program

VARIABLE = "RINGTRUE_CHROMIUM"
_NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
)
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
        log = _run(
            page, folder, "", f"--print-to-pdf={printed}", "--no-pdf-header-footer"
        )
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
        log = _run(
            page, Path(name), "#pictures", "--virtual-time-budget=10000", "--dump-dom"
        )
    found = re.search(r'<pre id="pictures">(.+?)</pre>', log, re.DOTALL)
    if found is None:
        raise SolverFailed(
            f"Chromium did not draw the figures of the report: {log[-500:]}"
        )
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


COLORS = {
    "good": "0B6B55",
    "bad": "A4351C",
    "warn": "8A5A00",
    "muted": "5C6B7A",
    "doubt": "A4351C",
}
NOT_DRAWN = "Not drawn: there was no Chromium. The page, report.html, has this figure."


def write_word(
    data: Stages, sections: Sequence[Section], page: str, target: Path
) -> None:
    """Write the document.

    Parameters
    ----------
    data : Stages
        For the title.
    sections : sequence of Section
    page : str
        The same report as a page, which Chromium draws the figures of; where there is none each has
        its caption alone, with a note.
    target : Path

    Raises
    ------
    SolverMissing
        If python-docx is not installed.
    SolverFailed
        If Chromium did not draw the figures.
    InputError
        If a photograph cannot be read.
    """
    try:
        from docx import Document
        from docx.shared import Mm, Pt, RGBColor
    except ImportError as e:
        raise SolverMissing("no python-docx: pip install 'ringtrue[documents]'") from e

    document = Document()
    paper = document.sections[0]
    paper.page_width = Mm(210)
    paper.page_height = Mm(297)
    # margins of the printed page, so that figures have their size
    paper.left_margin = paper.right_margin = Mm(14)
    paper.top_margin = paper.bottom_margin = Mm(16)
    for name, size in (("Normal", 10), ("Caption", 9), ("List Bullet", 9.5)):
        document.styles[name].font.size = Pt(size)
    document.styles["Caption"].font.color.rgb = RGBColor.from_string(COLORS["muted"])

    document.core_properties.title = data.info.title
    document.core_properties.author = data.info.author
    document.add_paragraph(f"{data.kind} report")
    document.add_heading(data.info.title, 0)
    for line in data.meta:
        document.add_paragraph(line)
    drawn = pictures(page) if find_chromium() else []
    writer = WordWriter(document, drawn)
    for number, section in enumerate(sections, start=1):
        document.add_heading(f"{number}  {section.title}", 1)
        writer.blocks(section.blocks)
    document.save(str(target))


@dataclass(frozen=True, slots=True)
class TableRoom:
    """Letters of the size of tables.

    Attributes
    ----------
    line : int
        Across the page.
    margin : int
        That the edges of a cell take.
    """

    line: int = 110
    margin: int = 4


ROOM = TableRoom()


@dataclass(slots=True)
class WordWriter:
    """Writes blocks; figures and tables have the numbers of the page."""

    document: Any
    drawn: Sequence[Drawn]
    figures: int = 0
    tables: int = 0
    scripted: int = 0  # figures so far that the page draws

    @property
    def width(self) -> int:
        """Of the text, in Word's own unit."""
        paper = self.document.sections[0]
        return int(paper.page_width - paper.left_margin - paper.right_margin)

    def blocks(self, blocks: Sequence[Block]) -> None:
        """Blocks one below the other: folds open, tabs and columns in a row."""
        for block in blocks:
            self.block(block)

    def block(self, block: Block) -> None:
        match block:
            case Text():
                self._paragraph(block.text, block.tone)
            case Heading():
                self.document.add_heading(block.text, 2)
            case Items():
                self._title(block.title)
                for item in block.items:
                    self.document.add_paragraph(item, "List Bullet")
            case ReportTable():
                self._report_table(block)
            case Facts():
                self._facts(block)
            case Checks():
                self._checks(block)
            case Key():
                self._marked(block.items)
            case Plot() | Scene3D():
                self._figure(block.caption)
            case Picture():
                self._photo(block.photo)
            case Diff():
                self._caption("Listing", block.caption, above=True)
                self._listing(block.text)
            case Code():
                self._title(block.title)
                self._listing(block.text)
            case Tabs():
                for name, inner in block.tabs:
                    self._title(name)
                    self.blocks(inner)
            case Fold():
                self._title(block.title)
                self.blocks(block.blocks)
            case Columns():
                for column in block.columns:
                    self.blocks(column)

    def _title(self, text: str) -> None:
        if text:
            self.document.add_heading(text, 3)

    def _paragraph(self, text: str, tone: str = "") -> Any:
        from docx.shared import Pt

        paragraph = self.document.add_paragraph()
        run = paragraph.add_run(text)
        if tone.startswith("verdict"):
            run.bold = True
            run.font.size = Pt(14)
        _colour(run, tone.split()[-1] if tone else "")
        return paragraph

    def _caption(self, what: str, text: str, *, above: bool = False) -> None:
        paragraph = self.document.add_paragraph(style="Caption")
        paragraph.paragraph_format.keep_with_next = above
        paragraph.add_run(f"{what}  ").bold = True
        paragraph.add_run(text).bold = False

    def _report_table(self, block: ReportTable) -> None:
        from docx.oxml import OxmlElement

        self.tables += 1
        self._caption(f"Table {self.tables}", block.caption, above=True)
        left = [head.startswith("|") for head in block.heads]
        rows = [[Cell(head.lstrip("|")) for head in block.heads], *block.rows]
        if block.foot:
            # the first cell of the foot stands over the lead columns
            rows.append([""] * (block.lead - 1) + list(block.foot))
        table = self.document.add_table(len(rows), len(left), "Light List Accent 1")
        table.autofit = False
        shares, size = columns(rows, left)
        widths = [round(self.width * share) for share in shares]
        # LibreOffice reads the widths of columns, Word those of cells
        for column, width in zip(table.columns, widths, strict=True):
            column.width = width
        for at, (row, cells) in enumerate(zip(table.rows, rows, strict=True)):
            bold = at == 0 or (bool(block.foot) and at == len(rows) - 1)
            for place, cell, text, width in zip(
                row.cells, cells, left, widths, strict=True
            ):
                place.width = width
                _fill(place, cell, left=text, bold=bold, size=size)
            row._tr.get_or_add_trPr().append(OxmlElement("w:cantSplit"))
        # the heads stand on every page of the table
        table.rows[0]._tr.get_or_add_trPr().append(OxmlElement("w:tblHeader"))
        self.document.add_paragraph()

    def _facts(self, block: Facts) -> None:
        table = self.document.add_table(2, len(block.facts), "Table Grid")
        for fact, label, value in zip(
            block.facts, table.rows[0].cells, table.rows[1].cells, strict=True
        ):
            before = f"{fact.before} → " if fact.before else ""
            _fill(label, Cell(fact.label, "muted"), left=True, bold=False)
            _fill(
                value, f"{before}{fact.value} {fact.unit}".strip(), left=True, bold=True
            )
        self.document.add_paragraph()

    def _checks(self, block: Checks) -> None:
        for check in block.checks:
            paragraph = self.document.add_paragraph()
            tone = "good" if check.held else "bad"
            _colour(paragraph.add_run("✓  " if check.held else "✗  "), tone)
            paragraph.add_run(f"{check.name}: ")
            run = paragraph.add_run(check.got or ("held" if check.held else "failed"))
            run.bold = True
            _colour(run, tone)
            if check.wanted not in ("", check.got):
                paragraph.add_run(f", wanted {check.wanted}")

    def _figure(self, caption: str) -> None:
        from docx.shared import Inches

        self.figures += 1
        if self.drawn:
            drawn = self.drawn[self.scripted]
            self.scripted += 1
            self.document.add_picture(io.BytesIO(drawn.png), width=Inches(drawn.width))
            self.document.paragraphs[-1].paragraph_format.keep_with_next = True
            self._marked(drawn.legend)
            self._modes(drawn)
        else:
            self._paragraph(NOT_DRAWN, "muted")
        self._caption(f"Figure {self.figures}", caption)

    def _marked(self, items: Sequence[tuple[str, str]]) -> None:
        """Names with the colours that they have in a figure."""
        from docx.shared import RGBColor

        if not items:
            return
        paragraph = self.document.add_paragraph()
        for text, color in items:
            if rgb := re.fullmatch(r"rgb\((\d+), (\d+), (\d+)\)", color):
                parts = map(int, rgb.groups())
                paragraph.add_run("■ ").font.color.rgb = RGBColor(*parts)
            elif color:
                shade = RGBColor.from_string(color.removeprefix("#").upper())
                paragraph.add_run("■ ").font.color.rgb = shade
            paragraph.add_run(f"{text}   ")

    def _modes(self, drawn: Drawn) -> None:
        """All modes of a figure, three in a row."""
        from docx.shared import Inches

        if not drawn.modes:
            return
        table = self.document.add_table(-(-len(drawn.modes) // 3), 3)
        places = [place for row in table.rows for place in row.cells]
        for place, (label, png) in zip(places, drawn.modes, strict=False):
            run = place.paragraphs[0].add_run()
            run.add_picture(io.BytesIO(png), width=Inches(0.31 * drawn.width))
            place.add_paragraph(label, "Caption")

    def _photo(self, photo: Photo) -> None:
        from docx.image.exceptions import UnrecognizedImageError

        self.figures += 1
        photo.data_url()  # the errors of the page
        try:
            self.document.add_picture(str(photo.path), width=self.width)
        except UnrecognizedImageError:
            self._paragraph(
                f"{photo.path.name}: Word takes PNG, JPEG and GIF alone.", "muted"
            )
        self._caption(f"Figure {self.figures}", photo.caption)

    def _listing(self, text: str) -> None:
        from docx.shared import Pt

        run = self.document.add_paragraph().add_run(text)
        run.font.name = "Courier New"
        run.font.size = Pt(7.5)


def columns(
    rows: Sequence[Sequence[str | Cell]], left: Sequence[bool]
) -> tuple[Float, float]:
    """Shares of the width of a table for its columns (c,), and its size of letters over the usual
    one.

    Numbers, and the longest words of heads and texts, stand in one line, in smaller letters where
    they have no room; what remains goes to the columns by the length of their texts.
    """
    least, whole = np.zeros((2, len(left)), dtype=int)
    for row in rows:
        for k, (cell, is_text) in enumerate(zip(row, left, strict=True)):
            text = cell if isinstance(cell, str) else cell.text
            words = text.split()
            if row is not rows[0] and not is_text and any(map(str.isdigit, text)):
                words = [text]
            least[k] = max(
                least[k], *(len(word) + ROOM.margin for word in words), ROOM.margin
            )
            whole[k] = max(whole[k], len(text) + ROOM.margin)
    more = whole - least
    wanted = least + max(ROOM.line - least.sum(), 0) * more / max(more.sum(), 1)
    return wanted / wanted.sum(), min(1.0, ROOM.line / float(least.sum()))


def _colour(run: Any, tone: str) -> None:
    from docx.shared import RGBColor

    if tone in COLORS:
        run.font.color.rgb = RGBColor.from_string(COLORS[tone])


def _fill(
    place: Any, cell: str | Cell, *, left: bool, bold: bool, size: float = 1.0
) -> None:
    """Write one cell of a table."""
    from docx.enum.text import WD_ALIGN_PARAGRAPH
    from docx.shared import Pt

    shown = Cell(cell) if isinstance(cell, str) else cell
    paragraph = place.paragraphs[0]
    paragraph.paragraph_format.space_after = Pt(0)
    paragraph.alignment = WD_ALIGN_PARAGRAPH.LEFT if left else WD_ALIGN_PARAGRAPH.RIGHT
    run = paragraph.add_run(shown.text)
    run.font.size = Pt(8 * size)
    run.bold = bold
    _colour(run, shown.tone)
