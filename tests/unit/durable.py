"""Faults at the writes of a small study, and flipped bits in its store: made here, judged by those
who ask for them.

The study is that of `small_study` with a file of test modes, a remodelling, a set of its own and a
deck of three files, so that it takes a second and writes all that studies write. It runs in a
forked process, in which one write of `atomic_write` meets its fault:

    before   killed (SIGKILL) when the temporary file is there and empty
    half     killed when half of it is written
    whole    killed when it is written and not in its place
    after    killed when it is in its place
    full     the disk is full when half of it is written: an error, no kill

A write is known by its file and by how many stages and finished sets are stored, which is the same
in the run that resumes.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from errno import ENOSPC
from pathlib import Path

import h5py
import numpy as np
import small_study

from ringtrue.errors import DataError
from ringtrue.io import hdf5
from ringtrue.io.modes import write_modes
from ringtrue.report.build import deliver
from ringtrue.study.run import run_study
from ringtrue.study.store import SETS_FILE as SETS
from ringtrue.study.store import Store, digest
from ringtrue.virtual.measurements import write_sheet

KILLS = ("before", "half", "whole", "after")
FULL = "full"
Write = tuple[str, int, int]  # file, stages and finished parameter sets that are stored
FAILED = 3  # exit status of a run that ended with an error
MODES_TO = 14.0  # Hz, of the test

STUDY = """[model]
deck = "deck/frame.bdf"
fmax = 16.0
[test]
sheet = "sensors.csv"
modes = "modes.json"
[update]
left_out = 1
[damping]
write = true
[[remodel]]
reason = "a mass at the top"
file = "deck/parts.blk"
cards = "mass.bdf"
[[set]]
name = "lower storeys"
candidates = ["columns 1", "columns 2"]
[[set]]
name = "upper storeys"
candidates = ["columns 2", "columns 3"]
"""


def write_inputs(folder: Path) -> Path:
    """The study and all that it reads; its study.toml."""
    (folder / "deck").mkdir(parents=True)
    head, bulk = small_study.deck().split("BEGIN BULK\n")
    grids, rest = bulk.replace("ENDDATA\n", "").split("$ columns of storey 2\n")
    (folder / "deck/parts.blk").write_text(grids)
    (folder / "deck/more.blk").write_text(rest)
    includes = "INCLUDE 'parts.blk'\nINCLUDE 'more.blk'\n"
    (folder / "deck/frame.bdf").write_text(f"{head}BEGIN BULK\n{includes}ENDDATA\n")
    (folder / "mass.bdf").write_text(f"CONM2,9001,{small_study.node(3, 0, 0)},,50.0\n")
    (folder / "truth.bdf").write_text(small_study.deck(small_study.TRUTH))
    seen = small_study.measured_modes(folder / "truth.bdf", MODES_TO)
    (folder / "truth.bdf").unlink()
    test = small_study.test_model()
    damped = type(seen)(
        seen.frequencies,
        np.full(len(seen), small_study.DAMPING),
        seen.shapes,
        seen.labels,
    )
    write_modes(folder / "modes.json", damped)
    write_sheet(folder / "sensors.csv", test, test.channels)
    (folder / "study.toml").write_text(STUDY + small_study.candidates((1, 2, 3)))
    return folder / "study.toml"


def forked(work: Callable[[], None]) -> int:
    """Run in a process of its own: its exit status, or minus the signal that has ended it."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        status = FAILED
        try:
            work()
            status = 0
        except OSError as e:
            status = FAILED if e.errno == ENOSPC else 1
        except BaseException:
            traceback.print_exc()
            status = 1
        os._exit(status)
    _, told = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(told)


def whole_run(study: Path) -> None:
    """The command `ringtrue run`, without its printing."""
    deliver(run_study(study))


def _known(target: Path, folder: Path) -> Write:
    count, own = (
        len(set(Store(f).stages()) - {"provenance"})
        for f in (folder / "study.h5", folder / SETS)
    )
    return str(target.relative_to(folder)), count, own


def _at_each_write(
    told: Callable[[Path, Path], None], done: Callable[[Path], None]
) -> None:
    """Call `told` with the temporary file and the target before it gets into its place, `done`
    after.
    """
    replace = os.replace

    def replaced(part: str | Path, target: str | Path) -> None:
        temporary = Path(part).suffix == ".part"
        if temporary:
            told(Path(part), Path(target))
        replace(part, target)
        if temporary:
            done(Path(target))

    os.replace = replaced  # type: ignore[assignment]  # of a forked process that ends soon


def writes_of(study: Path) -> list[Write]:
    """All writes of a run, in order."""
    log = study.with_name("writes.json")

    def work() -> None:
        found: list[Write] = []
        _at_each_write(
            lambda _, target: found.append(_known(target, study.parent)), lambda _: None
        )
        whole_run(study)
        log.write_text(json.dumps(found))

    assert forked(work) == 0
    found = [(name, count, own) for name, count, own in json.loads(log.read_text())]
    log.unlink()
    return list(dict.fromkeys(found))


def struck(study: Path, write: Write, how: str) -> int:
    """Run until a write meets its fault; the exit status of the run."""

    def work() -> None:
        hit = []

        def before(part: Path, target: Path) -> None:
            if hit or _known(target, study.parent) != write:
                return
            hit.append(target)
            if how in ("before", "half", FULL):
                os.truncate(part, 0 if how == "before" else part.stat().st_size // 2)
            if how == FULL:
                raise OSError(ENOSPC, "No space left on device")
            if how != "after":
                os.kill(os.getpid(), signal.SIGKILL)

        def after(target: Path) -> None:
            if hit and how == "after":
                os.kill(os.getpid(), signal.SIGKILL)

        _at_each_write(before, after)
        whole_run(study)

    return forked(work)


def expected(how: str) -> int:
    """The exit status of a run that has met a fault."""
    return FAILED if how == FULL else -signal.SIGKILL


def stored(study: Path) -> dict[str, str]:
    """Digest of what each stage holds, from the bytes; without that of where it came from, which
    has a date.
    """
    path = study.with_name("study.h5")
    if not path.exists():
        return {}
    with h5py.File(path) as file:
        return {name: digest(file[name]) for name in file if name != "provenance"}


def results(study: Path) -> dict[str, object]:
    """All that a run leaves: stages, decks and summary; times are those of the run."""
    folder = study.parent
    decks = {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*.b[dl][fk]"))
    }
    summary = json.loads((folder / "summary.json").read_text())
    summary.pop("timings_s")
    return {**stored(study), **decks, "summary": summary}


def leftovers(folder: Path) -> list[str]:
    """What a run must not leave behind."""
    names = ("*.part", "*.lock", "update.sets.h5")
    return [str(p.relative_to(folder)) for n in names for p in sorted(folder.rglob(n))]


def copied(folder: Path, to: Path) -> None:
    """A folder in the place of another."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(folder, to)


def flipped(image: bytes, bit: int) -> bytes:
    """The bytes with one bit changed."""
    data = bytearray(image)
    data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def read_anew(path: Path) -> dict[str, str]:
    """What each stage of a store reads as: the digest of the result that is loaded, or how it is
    refused.
    """
    out = {}
    store = Store(path)
    try:
        names = store.stages()
    except DataError as e:
        return {"": f"refused: {e}"}
    for name in names:
        try:
            out[name] = _digest_of(store.load(name))
        except DataError as e:
            out[name] = f"refused: {e}"
    return out


def _digest_of(result: object) -> str:
    with h5py.File(
        "result", "w", driver="core", backing_store=False, libver="latest"
    ) as file:
        group = file.create_group("x")
        hdf5.save(group, result)
        return digest(group)
