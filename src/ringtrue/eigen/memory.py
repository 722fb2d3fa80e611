"""How much memory is left, and a refusal in time when a step would need more."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

from ringtrue.errors import OutOfMemory

_GROUPS = (  # limit, use, statistics: control groups v2 and v1
    (
        "/sys/fs/cgroup/memory.max",
        "/sys/fs/cgroup/memory.current",
        "/sys/fs/cgroup/memory.stat",
    ),
    (
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        "/sys/fs/cgroup/memory/memory.usage_in_bytes",
        "/sys/fs/cgroup/memory/memory.stat",
    ),
)


def available() -> int:
    """Bytes that this process may still use: what the machine has free and what its control group
    allows.

    Without /proc (macOS) all physical memory counts; where even that is unknown, sys.maxsize is
    returned.
    """
    free = [_machine()]
    for limit, use, statistics in _GROUPS:
        top = _number(limit)
        used = _number(use)
        if top is not None and used is not None:
            free.append(top - used + _entry(statistics, "inactive_file"))
    return max(min(free), 0)


def require(needed: int, what: str) -> None:
    """Refuse a step that needs more bytes than there are.

    Parameters
    ----------
    needed : int, bytes
    what : str
        The step, as the subject of the message: "the factorisation of 300000 DOFs".

    Raises
    ------
    OutOfMemory
    """
    there = available()
    if needed > there:
        raise OutOfMemory(
            f"{what} needs {_text(needed)} of memory; {_text(there)} are free. Use a machine "
            "with more, "
            "the solver 'slepc' on several of them, or ask for fewer modes",
            needed=needed,
            available=there,
        )


def trim() -> None:
    """Give memory that was freed back to the system, where the C library can (glibc).

    What assembly frees stays with the heap of Python, and the solver, which maps its own, cannot
    use it.
    """
    release = (
        getattr(ctypes.CDLL(None), "malloc_trim", None)
        if sys.platform == "linux"
        else None
    )
    if release is not None:
        release(0)


def _machine() -> int:
    kilobytes = _entry("/proc/meminfo", "MemAvailable:")
    if kilobytes:
        return 1024 * kilobytes
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return sys.maxsize


def _number(path: str) -> int | None:
    try:
        text = Path(path).read_text().strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None


def _entry(path: str, name: str) -> int:
    """The number behind a name in a file of names and numbers; 0 if there is none."""
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return 0
    found = [line.split() for line in lines if line.startswith(name)]
    return int(found[0][1]) if found else 0


def _text(size: int) -> str:
    return f"{size / 1e9:.2f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"
