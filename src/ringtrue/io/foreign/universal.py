"""Universal files written by pyuff; `ringtrue.io.uff` reads them, and knows what vendors make of
the standard.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyuff


def write_sets(path: Path, sets: Iterable[Mapping[str, Any]]) -> None:
    """Write data sets, as pyuff names their parts, one after the other."""
    file = pyuff.UFF(str(path))
    for one in sets:
        file.write_sets(dict(one), "add")
