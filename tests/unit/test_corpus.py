"""Every reader takes every file of tests/corpus: a value or a message, in seconds; and a run of
scripts/fuzz.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest
from fuzzing import Job, fuzz
from readers import FAULTS, READERS, kinds, seeds

from ringtrue.errors import RingtrueError
from ringtrue.io.foreign import door

SCRIPT = Path(__file__).parents[2] / "scripts" / "fuzz"
READ = (
    "byte_count_of_5000_digits.uff",
    "latin-1.csv",
    "latin-1.json",
    "utf-16.json",
    "byte_order_mark.json",
)
MINE = [p for kind in READERS for p in sorted((FAULTS / kind).glob("*"))]
LATER = {
    "deck",
    "results",
}  # some of these files are sound, and what is wrong shows in what is made of them
LONGEST = 20.0  # seconds


@pytest.mark.filterwarnings("ignore::Warning")  # NumPy's, on absurd numbers
@pytest.mark.parametrize("path", MINE, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_files_that_once_broke_something(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door, "_SECONDS", 2.0)  # for a parser that does not end
    kind = path.parent.name
    begun = time.monotonic()
    messages = []
    for read in READERS[kind]:
        try:
            read(path)
        except RingtrueError as exc:
            messages.append(str(exc))
    assert all(path.name in message for message in messages)
    assert time.monotonic() - begun < LONGEST * len(READERS[kind])
    if kind not in LATER:
        assert bool(messages) is (path.name not in READ)


@pytest.mark.parametrize(("kind", "ending"), kinds())
def test_intact_files_are_read(kind: str, ending: str) -> None:
    """What is not read when it is whole is no test of damage."""
    for path in seeds(kind, ending):
        if kind != "study":  # which names files that are not here
            READERS[kind][0](path)


def test_the_fuzzer_tells_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader with a traceback, one that ends its process and one that hangs: each is counted and
    kept.
    """
    import os

    import fuzzing

    def faulty(path: Path) -> None:
        size = path.stat().st_size
        if size % 7 == 1:
            raise KeyError("a fault")
        if size % 23 == 2:
            os._exit(3)
        if size % 31 == 3:
            time.sleep(5)

    monkeypatch.setitem(READERS, "statics", (faulty,))
    monkeypatch.setattr(fuzzing, "HANG_S", 0.3)
    found = fuzz(Job("statics", ".csv", 0, False, tmp_path), 120)
    assert found.inputs == 120
    assert found.tracebacks.total() > 0
    assert found.killed > 0
    assert found.hangs > 0
    kept = sorted(p.name.split("-")[1] for p in tmp_path.glob("statics-*"))
    assert kept == ["hang"] * found.hangs + ["killed"] * found.killed


def test_a_short_run_of_the_fuzzer() -> None:
    done = subprocess.run(
        [sys.executable, SCRIPT, "--plain", "--count", "900"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "right: tracebacks: 0" in done.stdout
