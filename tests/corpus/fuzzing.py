"""Readers under damaged files, each kind in a process of its own that is watched
(`scripts/fuzz`).
"""

from __future__ import annotations

import json
import math
import mmap
import os
import random
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mutations import mutated
from readers import READERS, seeds

from ringtrue.errors import RingtrueError
from ringtrue.io.foreign import door

HANG_S = 20.0  # of one input
# bytes, of a process, so that a fault does not take the machine down
ADDRESSES = 8 << 30
# for a parser in its own process, which users give 5 s: damaged files hang in HDF5 by the thousand
PARSER_S = 0.3
BATCH = 20_000  # inputs of one process at most: its memory is that of few
_COUNTERS = struct.Struct(
    "qqqdd"
)  # inputs done, accepted, refused, when the present one began (s), peak (MB)
_LOOKED_AT = 50  # inputs from one look at the memory of a child to the next
_OFTEN = 0.02  # s, from one look at the process to the next
_FAULTS = 200  # of a kind, that are written down
_SCRATCH = "/dev/shm" if Path("/dev/shm").is_dir() else None


@dataclass
class Figures:
    """What came of the inputs of one kind of files."""

    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    hangs: int = 0
    killed: int = 0
    peak_mb: float = 0.0
    tracebacks: Counter[str] = field(default_factory=Counter)

    def __add__(self, other: Figures) -> Figures:
        return Figures(
            self.inputs + other.inputs,
            self.accepted + other.accepted,
            self.refused + other.refused,
            self.hangs + other.hangs,
            self.killed + other.killed,
            max(self.peak_mb, other.peak_mb),
            self.tracebacks + other.tracebacks,
        )


@dataclass(frozen=True)
class Job:
    """Inputs of one kind and ending of files.

    Attributes
    ----------
    kind, ending : str
    seed : int
    guided : bool
        By what they reach (atheris), else blindly.
    keep : Path
        Folder for inputs that fail.
    """

    kind: str
    ending: str
    seed: int
    guided: bool
    keep: Path

    @property
    def name(self) -> str:
        return f"{self.kind}{self.ending}"

    @property
    def faults(self) -> Path:
        return self.keep / f"{self.name}.jsonl"


def fuzz(job: Job, count: float, seconds: float = math.inf) -> Figures:
    """Read `count` damaged files, or as many as `seconds` allow; behind one that ends its process a
    new one goes on.
    """
    figures, first, until = Figures(), 0, time.monotonic() + seconds
    while first < count and time.monotonic() < until:
        size = int(min(count - first, BATCH))
        shared = mmap.mmap(-1, _COUNTERS.size)
        folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir=_SCRATCH))
        pid = os.fork()
        if not pid:
            _process(job, first, size, shared, folder)
        how = _watched(pid, shared, until)
        done, accepted, refused, _, peak = _COUNTERS.unpack(shared[:])
        if how in ("hang", "killed"):
            kept = job.keep / f"{job.kind}-{how}-{job.seed}-{first + done}{job.ending}"
            shutil.copy(folder / f"input{job.ending}", kept)
            done += 1
        shutil.rmtree(folder, ignore_errors=True)
        figures += Figures(
            done, accepted, refused, how == "hang", how == "killed", peak
        )
        first += max(done, 1) if how else size
    if job.faults.exists():
        figures.tracebacks = Counter(
            json.loads(line)["name"] for line in job.faults.read_text().splitlines()
        )
    return figures


def _watched(pid: int, shared: mmap.mmap, until: float) -> str:
    """How the process ended: "" as it should, "late", "hang" or "killed"."""
    while True:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return "killed" if status else ""
        begun = _COUNTERS.unpack(shared[:])[3]
        hangs = begun and time.time() - begun > HANG_S
        if hangs or time.monotonic() > until:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            return "hang" if hangs else "late"
        time.sleep(_OFTEN)


def _process(job: Job, first: int, count: int, shared: mmap.mmap, folder: Path) -> None:
    """All that the forked process does."""
    status = 70
    try:
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        warnings.simplefilter("ignore")
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        door._SECONDS = PARSER_S
        reader = _Reader(job, shared, folder)
        if job.guided:
            _guided(reader, job.seed + first, count)
        for index in range(first, first + count):
            rng = random.Random(f"{job.seed} {job.name} {index}")
            reader.one(mutated(rng.choice(reader.seeds), rng, reader.seeds))
        status = 0
    except SystemExit as end:  # of atheris, behind its last input
        status = int(end.code or 0)
    except BaseException:
        (job.keep / f"{job.name}.stopped.txt").write_text(traceback.format_exc())
    finally:
        os._exit(status)


class _Reader:
    def __init__(self, job: Job, shared: mmap.mmap, folder: Path) -> None:
        self.job, self.shared, self.folder = job, shared, folder
        self.path = folder / f"input{job.ending}"
        self.seeds = [path.read_bytes() for path in seeds(job.kind, job.ending)]
        self.done = self.accepted = self.refused = 0
        self.peak = 0.0
        self.faults: Counter[str] = Counter()

    def one(self, data: bytes) -> None:
        """Read one input and count what came of it."""
        data = bytes(data)
        # a file of its own: what is written over looks the same within a tick of the clock
        self.path.unlink(missing_ok=True)
        self.path.write_bytes(data)
        readers = READERS[self.job.kind]
        self._tell(time.time())
        try:
            readers[self.done % len(readers)](self.path)
            self.accepted += 1
        except RingtrueError:
            self.refused += 1
        except Exception as exc:  # the finding
            self._write_down(exc, data)
        self.done += 1
        self._tell(0.0)

    def _tell(self, begun: float) -> None:
        mine = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        its = _children_mb() if self.done % _LOOKED_AT == 0 else 0.0
        self.peak = max(self.peak, mine, its)
        self.shared[:] = _COUNTERS.pack(
            self.done, self.accepted, self.refused, begun, self.peak
        )

    def _write_down(self, exc: Exception, data: bytes) -> None:
        frames = [
            f
            for f in traceback.extract_tb(exc.__traceback__)
            if f"{os.sep}ringtrue{os.sep}" in f.filename
        ]
        place = (
            f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        )
        name = f"{type(exc).__name__} in {place}"
        self.faults[name] += 1
        if self.faults.total() <= _FAULTS:
            told = {"name": name, "said": str(exc)[:200], "hex": data.hex()}
            with self.job.faults.open("a", encoding="utf-8") as file:
                file.write(json.dumps(told) + "\n")


def _children_mb() -> float:
    """The largest that a process which reads for this one has been."""
    peak = 0.0
    for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split():
        try:
            status = Path(f"/proc/{pid}/status").read_text()
        except OSError:  # it has ended
            continue
        lines = [line for line in status.splitlines() if line.startswith("VmHWM")]
        peak = max(peak, *(float(line.split()[1]) / 1024 for line in lines), 0.0)
    return peak


def instrumented() -> bool:
    """Whether atheris is there; what is imported behind this call tells it what an input
    reaches.
    """
    try:
        import atheris
    except ImportError:
        return False
    for name in [n for n in sys.modules if n.split(".")[0] in ("ringtrue", "readers")]:
        del sys.modules[name]
    with atheris.instrument_imports(include=["ringtrue"]):
        import readers as again
    READERS.clear()
    READERS.update(again.READERS)
    global RingtrueError, door
    from ringtrue.errors import RingtrueError as error
    from ringtrue.io.foreign import door as door_again

    RingtrueError, door = error, door_again  # type: ignore[misc]
    return True


def _guided(reader: _Reader, seed: int, count: int) -> None:
    """Inputs that reach something new are changed further. Ends the process."""
    import atheris

    found = reader.folder / "found"
    found.mkdir()
    for k, data in enumerate(reader.seeds):
        (found / str(k)).write_bytes(data)

    def change(data: bytes, most: int, number: int) -> bytes:
        rng = random.Random(f"{seed} {number}")
        if rng.random() < 0.3:
            changed: bytes = atheris.Mutate(data, most)
            return changed
        return mutated(data, rng, reader.seeds)[:most]

    options: list[Any] = [
        f"-atheris_runs={count}",
        f"-seed={seed % (1 << 31) + 1}",
        "-max_len=65536",
        "-len_control=0",
        f"-artifact_prefix={reader.folder}/",
    ]
    options += [
        "-rss_limit_mb=0",
        "-timeout=100000",
        "-handle_segv=0",
        "-handle_abrt=0",
        "-handle_int=0",
        "-handle_term=0",
    ]
    atheris.Setup(["fuzz", *options, str(found)], reader.one, custom_mutator=change)
    atheris.Fuzz()
    os._exit(0)
