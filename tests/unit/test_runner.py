"""A program that is run ends with the process that has started it, and what it has started ends
with it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ringtrue.errors import SolverFailed, SolverMissing
from ringtrue.solvers.runner import run_program

# a launcher and its program, as those of Nastran
SOLVER = "sleep 300 & echo $! $$ > pids; wait"
PARENT = """
import sys
from pathlib import Path
from ringtrue.solvers.runner import run_program
run_program(["sh", "-c", sys.argv[2]], Path(sys.argv[1]), name="solver", timeout=300.0)
"""
PATIENCE = 60.0  # s, on a machine under load

pytestmark = pytest.mark.skipif(
    not hasattr(os, "killpg"), reason="there are no process groups"
)


def waited_for(what: object, folder: Path) -> None:
    end = time.monotonic() + PATIENCE
    while not what(folder):  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.02)


def pids(folder: Path) -> list[int]:
    at = folder / "pids"
    return [int(w) for w in at.read_text().split()] if at.exists() else []


def gone(folder: Path) -> bool:
    """Whether none of them runs; a zombie whose new parent has not asked for it yet does not."""
    for pid in pids(folder):
        status = Path(f"/proc/{pid}/stat")
        if status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z":
            return False
    return True


def test_a_solver_ends_with_its_killed_parent(tmp_path: Path) -> None:
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(tmp_path), SOLVER])
    waited_for(lambda f: len(pids(f)) == 2, tmp_path)
    assert not gone(tmp_path)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    waited_for(gone, tmp_path)


def test_a_solver_that_takes_too_long_ends_with_all_that_it_started(
    tmp_path: Path,
) -> None:
    with pytest.raises(SolverFailed, match="did not end within 1 s"):
        run_program(["sh", "-c", SOLVER], tmp_path, name="solver", timeout=1.0)
    waited_for(gone, tmp_path)


@pytest.mark.parametrize(
    ("line", "status"), [("exit 3", 3), ("exit 127", 127), ("kill -9 $$", 137)]
)
def test_the_exit_status_is_that_of_the_program(
    tmp_path: Path, line: str, status: int
) -> None:
    done = run_program(
        ["sh", "-c", f"echo told; {line}"], tmp_path, name="solver", timeout=60.0
    )
    assert (done.status, done.log) == (status, "told\n")


def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        SolverMissing, match="solver: nowhere cannot be started: No such file"
    ):
        run_program(["nowhere"], tmp_path, name="solver", timeout=60.0)
