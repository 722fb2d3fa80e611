"""Runs stages of a study in a process of its own; a line a step of its progress.

    python -m ringtrue.studio.worker study.toml [UNTIL [FROM]]

It ends as by Ctrl-C when the process that started it has gone: its end of standard input is then
closed. What was finished is stored, the next run resumes.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path
from signal import SIGINT, SIGTERM, default_int_handler, raise_signal, signal

import ringtrue as rt
from ringtrue.core.iterate import IterationText

DONE, FAILED, STOPPED = 0, 1, 130


def _report(fraction: float, text: str) -> None:
    words = " ".join(text.split())
    values = json.dumps(dict(text.values)) if isinstance(text, IterationText) else ""
    sys.stdout.write(f"{fraction:.4f}\t{words}\t{values}\n")
    sys.stdout.flush()


def _watch_parent() -> None:
    sys.stdin.buffer.read()
    raise_signal(SIGINT)


def main(study: str, until: str = "", first: str = "") -> int:
    """Run a study; gives the status of the process."""
    for number in (SIGINT, SIGTERM):
        signal(number, default_int_handler)
    threading.Thread(target=_watch_parent, daemon=True).start()
    try:
        rt.run_study(Path(study), until=until or None, first=first or None, progress=_report)
    except KeyboardInterrupt:
        return STOPPED
    except rt.RingtrueError as e:
        sys.stderr.write(f"{e}\n")
        return FAILED
    return DONE


if __name__ == "__main__":
    status = main(*sys.argv[1:4])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # the thread that watches would keep the process from ending
