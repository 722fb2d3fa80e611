"""Long work: stages of the study in a process of its own, with progress, stop and resume.

    python -m ringtrue.studio.work study.toml [UNTIL [FROM]]

runs stages in such a process, a line a step of its progress. It ends as by Ctrl-C when the process
that started it has gone: its end of standard input is then closed. What was finished is stored, the
next run resumes.
"""

from __future__ import annotations

import asyncio
import json
import os
import shlex
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from signal import SIGINT, SIGTERM, default_int_handler, raise_signal, signal

from pydantic import TypeAdapter

import ringtrue as rt
from ringtrue.core.iterate import IterationText

MOST_LINES = 400  # of progress that are kept
_VALUES = TypeAdapter(dict[str, float])


@dataclass(slots=True)
class Job:
    """A run of some stages.

    Attributes
    ----------
    until, first : str
        The last stage, and the one from which all is run anew; empty: none is named.
    fraction : float
        Done, 0 to 1.
    lines : list of str
        Of its progress.
    steps : list of dict
        J and the factors at the iterations of the set that is updated.
    state : {"running", "stopping", "done", "stopped", "failed"}
    error : str
        Why it failed.
    """

    until: str
    first: str
    fraction: float = 0.0
    lines: list[str] = field(default_factory=list)
    steps: list[dict[str, float]] = field(default_factory=list)
    state: str = "running"
    error: str = ""

    def heard(self, line: str) -> None:
        """Take a line of its process: fraction, words, and values of an iteration."""
        fraction, text, values = line.rstrip("\r\n").split("\t")
        self.fraction = float(fraction)
        self.lines = [*self.lines, text][-MOST_LINES:]
        if values:
            step = _VALUES.validate_json(values)
            # another set of parameters begins anew
            same = (
                self.steps
                if self.steps and self.steps[-1].keys() == step.keys()
                else []
            )
            self.steps = [*same, step]

    @property
    def running(self) -> bool:
        """Whether its process is there."""
        return self.state in ("running", "stopping")


class Work:
    """The one run of a study at a time.

    Parameters
    ----------
    study : Path
    changed : callable
        Called after each line of progress and at the end.
    """

    def __init__(self, study: Path, changed: Callable[[], None]) -> None:
        self.study = study
        self.job: Job | None = None
        self._changed = changed
        self._process: asyncio.subprocess.Process | None = None

    @property
    def running(self) -> bool:
        """Whether a run is under way."""
        return self.job is not None and self.job.running

    def command(self, until: str = "", first: str = "") -> str:
        """The command that does the same without the studio."""
        words = ["ringtrue", "run", str(self.study)]
        words += ["--from", first] if first else []
        words += ["--until", until] if until else []
        return shlex.join(words)

    async def run(self, until: str = "", first: str = "") -> Job:
        """Run the study up to a stage and wait for its end; what is up to date is not run again."""
        if self.job is not None and self.job.running:
            return self.job
        self.job = job = Job(until, first)
        pipe = asyncio.subprocess.PIPE
        self._process = process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "ringtrue.studio.work",
            # as it was named: results hold paths as they are seen from here
            str(self.study),
            until,
            first,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            # Ctrl-C in the terminal of the studio is not meant for it
            start_new_session=True,
        )
        assert process.stdout is not None
        assert process.stderr is not None
        said = asyncio.create_task(process.stderr.read())
        async for line in process.stdout:
            job.heard(line.decode(errors="replace"))
            self._changed()
        error = (await said).decode(errors="replace").strip()
        status = await process.wait()
        job.state = {DONE: "done", STOPPED: "stopped"}.get(status, "failed")
        job.error = error if job.state == "failed" else ""
        self._changed()
        return job

    def stop(self) -> None:
        """Ask the run to end; what is finished is stored."""
        if (
            self._process is not None
            and self.job is not None
            and self.job.state == "running"
        ):
            self.job.state = "stopping"
            if sys.platform == "win32":
                assert self._process.stdin is not None
                self._process.stdin.close()
            else:
                self._process.send_signal(SIGINT)
            self._changed()


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
        rt.run_study(
            Path(study), until=until or None, first=first or None, progress=_report
        )
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
