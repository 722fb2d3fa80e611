"""The exit statuses of all commands."""

from __future__ import annotations

from enum import IntEnum


class ExitStatus(IntEnum):
    """How a command ended; `ringtrue --help` lists the same words."""

    DONE = 0
    FAILED = 1
    REFUSED = 2
    FAULT = 70  # EX_SOFTWARE of sysexits.h
    STOPPED = 130  # 128 + SIGINT, as shells have it


WORDS = {
    ExitStatus.DONE: "done",
    ExitStatus.FAILED: "a result missed its own check or a stated limit, or a computation or "
    "solver failed",
    ExitStatus.REFUSED: "the input or an option is wrong or not supported: nothing was computed",
    ExitStatus.FAULT: "a fault of ringtrue: the message names the file with its details",
    ExitStatus.STOPPED: "stopped by Ctrl-C or by a batch system (SIGTERM)",
}


def in_words() -> str:
    """All of them in one paragraph."""
    return (
        "Exit status: "
        + "; ".join(f"{status.value} {what}" for status, what in WORDS.items())
        + "."
    )
