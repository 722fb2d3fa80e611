"""The report as PDF and as a document of Word, from the sections of the page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import chromium
import fake_study
import pytest

from ringtrue.errors import SolverMissing
from ringtrue.report import documents
from ringtrue.report.build import Report, assemble
from ringtrue.report.documents import ROOM, columns, print_page, write_word
from ringtrue.report.parts import (
    Columns,
    Fold,
    Picture,
    Plot,
    ReportTable,
    Scene3D,
    Tabs,
)
from ringtrue.study.config_sections import StudyInfo

try:
    import docx
except ImportError:
    docx = None

needs_docx = pytest.mark.skipif(
    docx is None, reason="no python-docx: documents of Word are NOT tested"
)
needs_browser = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: printing is NOT tested",
)


@pytest.fixture(scope="module")
def report() -> Report:
    info = StudyInfo(title="Spinning <bay>", client="Owner", author="A. Engineer")
    return assemble(fake_study.study(), info=info)


@pytest.fixture(scope="module")
def part(report: Report) -> Report:
    """Sections of some thirty figures: all of them take a minute to draw."""
    sections = []
    figures = 0
    for section in reversed(report.sections):
        sections.append(section)
        figures += sum(isinstance(b, (Plot, Scene3D)) for b in every(section.blocks))
        if figures > 30:
            break
    return Report(report.data, sections[::-1])


def every(blocks: Any) -> list[Any]:
    """Blocks with those inside tabs, folds and columns, in the order of the page."""
    out: list[Any] = []
    for b in blocks:
        out.append(b)
        match b:
            case Tabs():
                out += [x for _, inner in b.tabs for x in every(inner)]
            case Fold():
                out += every(b.blocks)
            case Columns():
                out += [x for column in b.columns for x in every(column)]
    return out


@needs_docx
def test_a_document_without_chromium_has_all_headings_tables_and_captions(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(documents, "find_chromium", lambda: None)
    path = tmp_path / "r.docx"
    write_word(report.data, report.sections, "", path)
    opened = docx.Document(str(path))
    texts = [p.text for p in opened.paragraphs]
    for number, section in enumerate(report.sections, start=1):
        assert f"{number}  {section.title}" in texts
    assert "for Owner · A. Engineer" in texts
    blocks = [b for s in report.sections for b in every(s.blocks)]
    tables = [b for b in blocks if isinstance(b, ReportTable)]
    figures = [b for b in blocks if isinstance(b, (Plot, Scene3D, Picture))]
    assert f"Table {len(tables)}  {tables[-1].caption}" in texts
    assert f"Figure {len(figures)}  {figures[-1].caption}" in texts
    assert texts.count(documents.NOT_DRAWN) == len(figures)
    written = [
        [[c.text for c in row.cells] for row in t.rows]
        for t in opened.tables
        if t.style.name == "Light List Accent 1"
    ]
    assert len(written) == len(tables)
    for table, found in zip(tables, written, strict=True):
        assert found[0] == [h.lstrip("|") for h in table.heads]
        cells = [[str(getattr(c, "text", c)) for c in row] for row in table.rows]
        assert found[1 : 1 + len(cells)] == cells


@needs_docx
@needs_browser
def test_a_document_has_every_figure_as_a_picture(part: Report, tmp_path: Path) -> None:
    path = tmp_path / "r.docx"
    page = part.page()
    write_word(part.data, part.sections, page, path)
    opened = docx.Document(str(path))
    drawn = len(re.findall(r"data-(?:plot|view)=", page))
    assert drawn > 20
    assert len(opened.inline_shapes) >= drawn
    sizes = {len(part.blob) for part in opened.part.package.image_parts}
    assert min(sizes) > 3000  # an empty figure packs into less
    assert documents.NOT_DRAWN not in [p.text for p in opened.paragraphs]


@needs_browser
def test_a_page_is_printed(part: Report, tmp_path: Path) -> None:
    print_page(part.page(), tmp_path / "r.pdf")
    raw = (tmp_path / "r.pdf").read_bytes()
    assert raw.startswith(b"%PDF")
    assert raw.count(b"/Type /Page\n") > 10


def test_what_is_missing_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("RINGTRUE_CHROMIUM", raising=False)
    with pytest.raises(
        SolverMissing, match=r"no Chromium: install .* RINGTRUE_CHROMIUM"
    ):
        print_page("", tmp_path / "r.pdf")
    monkeypatch.setenv("RINGTRUE_CHROMIUM", "nothing-there")
    with pytest.raises(
        SolverMissing, match="RINGTRUE_CHROMIUM=nothing-there: no program there"
    ):
        print_page("", tmp_path / "r.pdf")
    assert not (tmp_path / "r.pdf").exists()


def test_numbers_and_words_of_a_table_stand_in_one_line() -> None:
    heads = ["#", "Change, %", "|Reason"]
    rows = [
        heads,
        [
            "1",
            "−28.00",
            "the two shapes are turned into each other by the springs " * 3,
        ],
    ]
    shares, size = columns(rows, [False, False, True])
    letters = shares * ROOM.line - ROOM.margin
    assert size == 1
    assert shares.sum() == pytest.approx(1)
    assert (letters >= [1, len("Change,"), len("springs")]).all()
    assert letters[2] > letters[:2].sum()  # what remains goes to the long text
    wide = [[f"Number {k}" for k in range(20)], ["1234.567"] * 20]
    shares, size = columns(wide, [False] * 20)
    assert size * (len("1234.567") + ROOM.margin) * 20 == pytest.approx(ROOM.line)
