"""Threads: numpy, LAPACK and the transforms let others run while they work."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")
ABREAST = 2  # items under way, however many threads there are: all of them are in memory


def threads() -> int:
    """How many work at once: as many as OMP_NUM_THREADS says or, where it is not set, as there are
    cores.
    """
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(max(int(asked), 1) if asked.isdecimal() else os.cpu_count() or 1, ABREAST)


def abreast(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Results in the order of the items; the next item is taken when the result before the last one
    has been given.
    """
    under_way: deque[Future[R]] = deque()
    with ThreadPoolExecutor(threads()) as pool:
        for item in items:
            under_way.append(pool.submit(work, item))
            if len(under_way) == ABREAST:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()
