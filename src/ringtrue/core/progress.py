"""Progress of long work: a callable of the share done, 0 to 1, and of the work under way."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]


def quiet(fraction: float, text: str) -> None:
    """No progress."""


def part(progress: Progress | None, begin: float, end: float) -> Progress:
    """Progress of the part of a job that takes it from `begin` to `end`."""
    if progress is None:
        return quiet
    return lambda fraction, text: progress(begin + (end - begin) * fraction, text)
