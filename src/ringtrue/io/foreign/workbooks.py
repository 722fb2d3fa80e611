"""Excel workbooks, read by openpyxl: the values of a sheet as they are stored."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import openpyxl

from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.files import existing
from ringtrue.io.foreign.door import MEGABYTE, door

MOST_CELLS = 1_000_000  # of a sheet: 1,000 channels and 1,000 modes; 5 s
_UNPACKED = 64 * MEGABYTE  # of a part of the workbook: a cell takes some 30 bytes
_SAVE_AGAIN = "open it in Excel and save it again, or save the sheet as .csv"


def sheet_names(path: str | Path) -> list[str]:
    """The sheets of a workbook.

    Raises
    ------
    DataError
        If it is none, damaged, or too large.
    """
    with _opened(path) as book:
        return list(book.sheetnames)


def read_sheet(path: str | Path, sheet: str | None = None) -> list[list[object]]:
    """The rows of a sheet, the first if none is named, without empty cells at their ends.

    Raises
    ------
    DataError
        If the workbook is none, damaged or too large, or has no such sheet.
    """
    with _opened(path) as book:
        if sheet is not None and sheet not in book.sheetnames:
            raise DataError(f"{path}: no sheet {sheet!r}{did_you_mean(sheet, book.sheetnames)}")
        if not book.worksheets:
            raise DataError(f"{path}: a workbook without a sheet of cells")
        page = book[sheet] if sheet is not None else book.worksheets[0]
        page.reset_dimensions()  # a stated size may be any
        rows: list[list[object]] = []
        cells = 0
        for row in page.iter_rows(values_only=True):
            cells += len(row) + 1
            if cells > MOST_CELLS:
                raise DataError(
                    f"{path}: sheet {page.title!r} has more than {MOST_CELLS} cells: {_SAVE_AGAIN}"
                )
            values = list(row)
            while values and values[-1] is None:
                values.pop()
            rows.append(values)
        return rows


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    path = existing(path)
    with door(path, "Excel workbook", advice=_SAVE_AGAIN):
        with zipfile.ZipFile(path) as archive:
            for part in archive.infolist():
                if part.filename.lower().endswith((".xml", ".rels")) and part.file_size > _UNPACKED:
                    size = (
                        f"{part.file_size / MEGABYTE:.0f} MB, the file "
                        f"{path.stat().st_size / MEGABYTE:.1f} MB"
                    )
                    raise DataError(f"{path}: {part.filename} unfolds to {size}: {_SAVE_AGAIN}")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            yield book
        finally:
            book.close()
