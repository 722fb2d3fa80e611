"""The order of the tests."""

from __future__ import annotations

import pytest

# files that take half a minute and more, the longest first, so that no worker is left alone with one
LONG = (
    "test_demo_lsf.py",
    "test_tutorial.py",
    "test_study_localise.py",
    "test_durability.py",
    "test_studio_campaign.py",
    "test_cli.py",
    "test_study_residuals.py",
    "test_study_resume.py",
    "test_study_supplied.py",
    "test_update_proposal.py",
    "test_update_lumps.py",
    "test_study_configurations.py",
    "test_study_small.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    order = {name: at for at, name in enumerate(LONG)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))
