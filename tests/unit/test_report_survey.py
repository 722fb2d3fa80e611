"""The records of a test in the report: one row a record or setup, and what is to be said of them
below.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.notes import Note
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.report.parts import Fold, Items, ReportTable
from ringtrue.report.sections.system import _tests, grouped
from ringtrue.study.results import RecordSummary
from ringtrue.study.stages.identify import preview

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
    _, notes = _tests(
        (record("a", ("mains hum", "short")), record("b", ("mains hum",)))
    )
    assert isinstance(notes, Items)
    assert notes.items == ["a; b: mains hum", "a: short"]


def test_records_of_a_setup_are_one_row() -> None:
    table, notes, fold = _tests(
        (
            record("a", ("one",), "1"),
            record("b", ("one", "two"), "1"),
            record("c", (), "2"),
        )
    )
    assert isinstance(table, ReportTable)
    assert isinstance(notes, Items)
    assert isinstance(fold, Fold)
    assert [row[1] for row in table.rows] == ["setup 1, 2 records", "c"]
    assert table.rows[0][-1] == "60.0"
    assert notes.items == [
        "setup 1, 2 records: one (2 records)",
        "setup 1, 2 records: two",
    ]
    assert len(fold.blocks) == 2


def test_hits_are_counted_in_the_table() -> None:
    first, second = (
        replace(record(n, (), "1"), hits=h) for n, h in (("a", (8, 11)), ("b", (7, 9)))
    )
    table, _fold = _tests((first, second))
    assert isinstance(table, ReportTable)
    assert table.rows[0][-1] == "15 of 20"
    (quiet,) = _tests((record("a", ()),))
    assert isinstance(quiet, ReportTable)
    assert "Hits kept" not in quiet.heads


def test_a_note_on_many_channels_is_said_once_and_counted() -> None:
    straight = [Note("channel straight", "error", f"{k}+Z") for k in range(1, 6)]
    twice = Note("channel twice", "warning", "9+X", {"other": "8+X"})
    lines = grouped([*straight, twice])
    assert lines == [
        "channel 1+Z: a straight line: no signal; left out (also 4 more: 2+Z, 3+Z, 4+Z, 5+Z)",
        "channel 9+X: the same samples as 8+X",
    ]
    assert len(grouped(straight[:3])) == 3


def test_the_overview_of_a_record_has_neither_offset_nor_trend() -> None:
    t = np.arange(4000) / 100
    moving = np.sin(2 * np.pi * 3 * t)
    record_with_drift = TimeHistory(
        (moving + 50 + 0.2 * t)[None], 100.0, (Channel("1+Z", "acceleration", "m/s^2"),)
    )
    shown = preview(record_with_drift)
    assert np.abs(shown.signal).max() < 1.1
    assert shown.signal.max() > 0.9
    assert shown.signal.min() < -0.9
