"""Threads: numpy, LAPACK and the transforms let others run while they work."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor


def pool() -> ThreadPoolExecutor:
    """As many threads as OMP_NUM_THREADS says or, where it is not set, as there are cores.

    Work is cut alike for any number of them and summed up in order: results do not depend on it.
    """
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return ThreadPoolExecutor(max(int(asked), 1) if asked.isdecimal() else os.cpu_count())
