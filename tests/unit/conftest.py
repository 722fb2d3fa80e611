"""A study that was run once for all tests of screens."""

from __future__ import annotations

from pathlib import Path

import pytest

import ringtrue as rt
from ringtrue.demos import frame


@pytest.fixture(scope="session")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with hammer records alone: two seconds up to its correlation."""
    folder = tmp_path_factory.mktemp("frame")
    study = frame.write_study(folder, frame.DEMO, ambient=False)
    rt.run_study(study, until="correlate")
    return folder
