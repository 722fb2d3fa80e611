"""Independent cases side by side: in processes of this machine, or on the workers of a dask
scheduler.

Both are executors of `concurrent.futures`. A worker computes what this process would have: results
are the same to the last bit where BLAS has as many threads. Large objects that cases have in common
stay out of what is sent for each case, and out of the results.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from io import BytesIO
from multiprocessing import connection, get_context, parent_process
from typing import Any, TypeVar

from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.errors import ConfigError, InputError, SolverError, SolverMissing

Workers = int | str  # processes of this machine, or the address of a dask scheduler
Case = TypeVar("Case")
Result = TypeVar("Result")
# and what takes shared bytes to the workers
Pool = tuple[Executor, Callable[[bytes], Any]]


def checked_workers(given: Workers) -> Workers:
    """The number of processes, also of text, or the address of a scheduler as it is.

    Raises
    ------
    ConfigError
        If it is neither.

    Examples
    --------
    >>> checked_workers("4"), checked_workers("tcp://host:8786")
    (4, 'tcp://host:8786')
    """
    text = str(given)
    if "://" in text:
        return text
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise ConfigError(
        f"workers {given!r}: a number of processes from 1 on, or the address of a dask scheduler "
        "such as tcp://host:8786"
    )


def reached(workers: Workers) -> Workers:
    """The same, once the scheduler of an address answers: that it does not is found before the
    work.

    Raises
    ------
    ConfigError
        If no scheduler answers, or it has no worker.
    SolverMissing
        If dask.distributed is not installed.
    """
    if isinstance(workers, str):
        with _cluster(workers):
            return workers
    return workers


def side_by_side(
    function: Callable[[Case, Progress], Result],
    cases: Mapping[str, Case],
    workers: Workers = 1,
    progress: Progress = quiet,
    shared: Sequence[object] = (),
) -> Iterator[Result]:
    """The results of a function of each case, in order.

    Parameters
    ----------
    function : callable (case, progress) -> result
        Of a module, or a method of what can be pickled.
    cases : mapping of str to case
        By the names that the progress shows.
    workers : int or str
        With 1, and for a single case, all is done in this process.
    progress : callable
    shared : sequence of object
        Large objects that the cases refer to: sent as one piece; results refer to those of this
        process.

    Raises
    ------
    InputError
        If a case cannot be sent.
    ConfigError
        If no scheduler answers.
    SolverMissing
        If dask.distributed is not installed.
    SolverError
        If a worker has ended before its work was done.
    Exception
        What the first case that fails raises, as it would without workers.
    """
    count = len(cases)
    if workers == 1 or count < 2:
        for i, (name, case) in enumerate(cases.items()):
            of_case = part(progress, i / count, (i + 1) / count)
            of_case(0.0, name)
            yield function(case, of_case)
        return
    known = _written(list(shared), (), "what the cases share")
    tasks = [_written((function, case), shared, name) for name, case in cases.items()]
    local = isinstance(workers, int)
    where = f"on {workers} workers" if local else f"at {workers}"
    progress(0.0, f"side by side {where}: {', '.join(cases)}")
    with (
        _processes(min(int(workers), count)) if local else _cluster(str(workers)) as (
            pool,
            share,
        )
    ):
        held = share(known)
        futures = [pool.submit(work_on, held, task) for task in tasks]
        for i, (name, future) in enumerate(zip(cases, futures, strict=True), start=1):
            yield _read(future.result(), shared)
            progress(i / count, f"done: {name}")


def work_on(shared: bytes, task: bytes) -> bytes:
    """One case, in a worker."""
    known = pickle.loads(shared)
    function, case = _read(task, known)
    return _written(function(case, quiet), known, "a result")


@contextmanager
def _processes(count: int) -> Iterator[Pool]:
    """Processes that begin anew, with the environment of this one and so as many threads of BLAS;
    an error or an interrupt ends them at once.
    """
    pool = ProcessPoolExecutor(
        count, get_context("spawn"), initializer=_end_with_parent
    )
    try:
        yield pool, bytes
    except BrokenExecutor as e:
        raise SolverError(
            f"one of {count} workers ended before its work was done: too little memory for as "
            'many at once, or a script that lacks `if __name__ == "__main__":`; try fewer workers'
        ) from e
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """An interrupt is for the process that has begun this one, which ends it; it ends with that
    one.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _cluster(address: str) -> Iterator[Pool]:
    """The workers of a dask scheduler; what was not begun is cancelled by an error or an
    interrupt.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError as e:
        raise SolverMissing(
            f'workers at {address} need dask.distributed: pip install "ringtrue[cluster]"'
        ) from e
    try:
        client: Any = Client(address, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as e:
        raise ConfigError(
            f"workers {address}: no dask scheduler answers there: {e}"
        ) from e
    with client:
        try:
            client.wait_for_workers(1, timeout=30)  # s
        except TimeoutError as e:
            raise ConfigError(f"workers {address}: the scheduler has no worker") from e
        pool = client.get_executor(pure=False)
        try:
            yield pool, lambda data: client.scatter(data, hash=False)
        except KilledWorker as e:
            raise SolverError(f"workers {address}: {e}") from e
        finally:
            pool.shutdown(wait=False)


class _Writer(pickle.Pickler):
    """Writes shared objects as their numbers."""

    def __init__(self, file: BytesIO, shared: Sequence[object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._numbers = {id(one): i for i, one in enumerate(shared)}

    def persistent_id(self, found: object) -> int | None:
        return self._numbers.get(id(found))


class _Reader(pickle.Unpickler):
    """Puts this process's shared objects in the place of their numbers."""

    def __init__(self, file: BytesIO, shared: Sequence[object]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, number: int) -> object:
        return self._shared[number]


def _written(value: object, shared: Sequence[object], what: str) -> bytes:
    file = BytesIO()
    try:
        _Writer(file, shared).dump(value)
    except (pickle.PicklingError, TypeError, AttributeError) as e:
        raise InputError(
            f"{what} cannot be sent between processes: {e}; try workers = 1"
        ) from e
    return file.getvalue()


def _read(data: bytes, shared: Sequence[object]) -> Any:
    return _Reader(BytesIO(data), shared).load()
