"""Blocks of a record from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.errors import DataError
from ringtrue.io.record_table import RecordChannel
from ringtrue.io.records import record_blocks, write_record


def test_streams_from_a_file(tmp_path: Path) -> None:
    data = np.random.default_rng(0).standard_normal((3, 5000))
    write_record(
        tmp_path / "r.h5", data, 200.0, [RecordChannel(str(i)) for i in range(3)]
    )
    whole = np.hstack([p.data for p in record_blocks(tmp_path / "r.h5", 777)])
    np.testing.assert_allclose(whole, data, atol=1e-6)  # float32 in the file
    with pytest.raises(DataError, match="1 or more"):
        next(record_blocks(tmp_path / "r.h5", 0))
