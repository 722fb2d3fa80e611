"""The records of a test in the report: one row a record or setup, and what is to be said of them
below.
"""

from __future__ import annotations

from ringtrue.report.parts import Fold, Items, ReportTable
from ringtrue.report.sections.system import _tests
from ringtrue.study.results import RecordSummary

LONG = "pole at 4.375 Hz left out: " + "its shape is a sum of those of modes; " * 20


def record(name: str, notes: tuple[str, ...], setup: str = "") -> RecordSummary:
    what = (name, "bridge", "wind", f"{name}.csv")
    return RecordSummary(*what, 12, 50.0, 1800.0, notes, setup)


def test_notes_stand_below_the_table() -> None:
    """In a column of their own, long ones make rows that are higher than a narrow screen."""
    table, notes = _tests((record("a", ()), record("b", (LONG, "short"))))
    assert isinstance(table, ReportTable)
    assert isinstance(notes, Items)
    assert [row[1] for row in table.rows] == ["a", "b"]
    assert max(len(cell) for row in table.rows for cell in row) < 20
    assert notes.items == [f"b: {LONG}", "b: short"]
    assert len(_tests((record("a", ()),))) == 1
    _, notes = _tests((record("a", ("mains hum", "short")), record("b", ("mains hum",))))
    assert isinstance(notes, Items)
    assert notes.items == ["a; b: mains hum", "a: short"]


def test_records_of_a_setup_are_one_row() -> None:
    table, notes, fold = _tests(
        (record("a", ("one",), "1"), record("b", ("one", "two"), "1"), record("c", (), "2"))
    )
    assert isinstance(table, ReportTable)
    assert isinstance(notes, Items)
    assert isinstance(fold, Fold)
    assert [row[1] for row in table.rows] == ["setup 1, 2 records", "c"]
    assert table.rows[0][-1] == "60.0"
    assert notes.items == ["setup 1, 2 records: one (2 records)", "setup 1, 2 records: two"]
    assert len(fold.blocks) == 2
