"""docs/python.md runs from top to bottom, with the assertions that it holds, and names public functions
alone.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import ringtrue as rt

PAGE = (Path(__file__).parents[2] / "docs/python.md").read_text(encoding="utf-8")


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec("\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)), {})


def test_the_functions_it_names_are_public() -> None:
    rows = [line.split("|")[2] for line in PAGE.splitlines() if line.startswith("| ")]
    named = {name for row in rows for name in re.findall(r"`([a-z_]+)`", row)}
    named |= set(re.findall(r"\brt\.([A-Za-z_]+)", PAGE)) - {"__all__"}
    assert len(named) > 20
    assert named <= set(rt.__all__)


def test_it_names_no_private_module() -> None:
    assert re.findall(r"(?:from|import) ringtrue\.", PAGE) == []
