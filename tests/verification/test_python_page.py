"""docs/python.md runs from top to bottom, with the assertions that it holds, and names modules that
are there.
"""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs/python.md").read_text(encoding="utf-8")


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec("\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)), {})


def test_the_modules_it_names_are_there() -> None:
    rows = [
        line.split("|")[2] for line in PAGE.splitlines() if line.startswith("| ") and "`" in line
    ]
    assert len(rows) > 8
    for row in rows:
        package = ""
        for name in re.findall(r"`([a-z_.]+)`", row):
            package = name.split(".")[0] if "." in name else package
            full = name if "." in name else f"{package}.{name}"
            assert importlib.util.find_spec(f"ringtrue.{full}"), full
