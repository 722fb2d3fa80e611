"""Cases side by side: in order, to the last bit, and with the errors of one process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.side_by_side import Workers, checked_workers, reached, side_by_side
from ringtrue.errors import (
    ConfigError,
    InputError,
    SingularModel,
    SolverError,
    SolverMissing,
)


class Large:
    """What the cases have in common."""

    def __init__(self) -> None:
        # in Fortran's order
        self.values = np.random.default_rng(0).normal(size=(40, 60)).T


def product(
    large: Large, case: float, progress: Progress
) -> tuple[Large, np.ndarray, int]:
    if case < 0:
        raise SingularModel(["101 T1", "102 T1"], f"case {case:g}")
    return large, case * large.values @ large.values.T, os.getpid()


def ended(case: int, progress: Progress) -> int:
    os._exit(case)


def waiting(case: int, progress: Progress) -> None:
    threading.Event().wait(120)


CASES = {f"case {i}": 0.3 * i for i in range(1, 5)}


@pytest.fixture(params=["processes", "dask"])
def workers(request: pytest.FixtureRequest) -> Iterator[Workers]:
    if request.param == "processes":
        yield 2
        return
    distributed = pytest.importorskip(
        "distributed", reason='not tested without: pip install "ringtrue[cluster]"'
    )
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


def test_results_are_those_of_one_process_in_order(workers: Workers) -> None:
    large = Large()
    work = partial(product, large)
    shown: list[tuple[float, str]] = []
    alone = list(side_by_side(work, CASES))
    both = list(
        side_by_side(work, CASES, workers, lambda f, t: shown.append((f, t)), [large])
    )
    for (_, here, _), (same, there, process) in zip(alone, both, strict=True):
        np.testing.assert_array_equal(there, here)
        assert same is large  # it has not come back as a copy
        assert process != os.getpid()
    assert shown[-1] == (1.0, "done: case 4")
    assert [f for f, _ in shown] == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_the_first_error_in_order_is_raised_as_it_is(workers: Workers) -> None:
    cases = {"a": 1.0, "b": -2.0, "c": -3.0}
    for where in (1, workers):
        found = side_by_side(partial(product, Large()), cases, where)
        next(found)
        with pytest.raises(SingularModel, match="101 T1 102 T1: case -2") as told:
            next(found)
        assert told.value.dofs == ("101 T1", "102 T1")


def test_a_case_that_cannot_be_sent_is_named(workers: Workers) -> None:
    def local(case: float, progress: Progress) -> float:
        return case

    with pytest.raises(
        InputError, match=r"case 1 cannot be sent between processes.*workers = 1"
    ):
        list(side_by_side(local, CASES, workers))


def test_a_worker_that_dies_is_told() -> None:
    with pytest.raises(
        SolverError, match="one of 2 workers ended before its work was done"
    ):
        list(side_by_side(ended, {"a": 1, "b": 1}, 2))


def test_no_scheduler_and_no_number_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for wrong in ("", "0", "-1", "two", 0):
        with pytest.raises(ConfigError, match="a number of processes from 1 on"):
            checked_workers(wrong)
    monkeypatch.setitem(sys.modules, "distributed", None)
    for ask in (reached, partial(side_by_side, partial(product, Large()), CASES)):
        with pytest.raises(SolverMissing, match=r"pip install .ringtrue\[cluster\]"):
            list(ask("tcp://nowhere:8786"))  # type: ignore[operator]


INTERRUPTED = """
import multiprocessing, sys
sys.path.insert(0, {tests!r})
from test_side_by_side import waiting
from ringtrue.core.side_by_side import side_by_side
def show(fraction, text):
    print("begun", flush=True)
if __name__ == "__main__":
    try:
        list(side_by_side(waiting, {{"a": 1, "b": 2}}, 2, show))
    except KeyboardInterrupt:
        print("left:", len(multiprocessing.active_children()), flush=True)
"""


def test_an_interrupt_ends_all_workers_at_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED.format(tests=str(Path(__file__).parent)))
    # ignored in a background job
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, preexec_fn=heard
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        threading.Event().wait(3.0)  # into the work
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30)[0] == "left: 0\n"


def test_one_case_stays_in_this_process() -> None:
    (found,) = side_by_side(partial(product, Large()), {"only": 1.0}, 8, quiet)
    assert found[2] == os.getpid()
