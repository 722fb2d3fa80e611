"""The order of the tests."""

from __future__ import annotations

import pytest

# files that take minutes: first, so that no worker is left alone with one
LONG = (
    "test_demo_lsf.py",
    "test_durability.py",
    "test_tutorial.py",
    "test_study_localise.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in LONG)
