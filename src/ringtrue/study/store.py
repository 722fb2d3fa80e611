"""The store of a study, the lock on its folder, and the sets of an interrupted updating."""

from __future__ import annotations

import hashlib
import logging
import os
import socket
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import h5py
import numpy as np

from ringtrue.errors import DataError
from ringtrue.io import hdf5
from ringtrue.io.files import atomic_write, keeps_up
from ringtrue.io.foreign.door import DAMAGE
from ringtrue.io.foreign.parsers import open_hdf5, trust_hdf5
from ringtrue.io.recognition import Format, format_of
from ringtrue.study.results import FinishedSet

DIGEST = "digest"  # SHA-256 of all that a stage holds
SECONDS = "seconds"  # of the run that made it
STORE = "study.h5"  # its name in the folder of the results
PROVENANCE = "provenance"  # the stage that every study has
_log = logging.getLogger(__name__)


def is_store(path: Path) -> bool:
    """Whether a file is the store of a study.

    Raises
    ------
    DataError
        If there is no such file, or it is damaged.
    """
    if format_of(path) is not Format.HDF5:
        return False
    with open_hdf5(path) as file:
        return PROVENANCE in file and "key" in file[PROVENANCE].attrs


@dataclass(frozen=True, slots=True)
class Store:
    """`study.h5`: stage name -> result, with the key of the inputs that made it and the seconds
    that it took.

    The metadata of the file and each data set have HDF5's checksums, each stage a digest of its
    content: what has changed since it was written is an error and never a result.
    """

    path: Path

    def key(self, stage: str) -> str | None:
        """The key that a stage was stored with; None where it is not there.

        Raises
        ------
        DataError
            If the stage is damaged.
        """
        if not self.path.exists():
            return None
        with self._open() as f, self._reading(stage):
            return hdf5.text_of(f[stage].attrs["key"]) if stage in f else None

    def timings(self) -> dict[str, float]:
        """Seconds that each stored stage took; one that is damaged has none."""
        out = {}
        for stage in self.stages():
            with suppress(DataError), self._open() as f, self._reading(stage):
                out[stage] = float(f[stage].attrs[SECONDS])
        return out

    def save(
        self,
        stage: str,
        key: str,
        result: object,
        *,
        seconds: float = 0.0,
        drop: Collection[str] = (),
    ) -> None:
        """Write a stage into a copy of the file, without the stages of `drop`, then put the copy in
        its place.

        The copy is made in memory: HDF5 does not survive a disk that is full. A stage that is too
        damaged to be copied is left out.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(
            self.path.name, "w", driver="core", backing_store=False, libver="latest"
        ) as new:
            if self.path.exists():
                with self._open() as old:
                    for name in old:
                        if name != stage and name not in drop:
                            self._copy(old, name, new)
            group = new.create_group(stage)
            hdf5.save(group, result)
            group.attrs["key"] = np.bytes_(key)
            group.attrs[SECONDS] = seconds
            group.attrs[DIGEST] = np.bytes_(digest(group))
            new.flush()
            image = new.id.get_file_image()
        with atomic_write(self.path) as part:
            part.write_bytes(image)
        trust_hdf5(self.path)

    def load(self, stage: str) -> object:
        """The result of a stage.

        Raises
        ------
        DataError
            If the file or the stage is not there, is damaged, or was stored by a version with other
            results.
        """
        if not self.path.exists():
            raise DataError(f"{self.path}: no such store; run the study first")
        with self._open() as f:
            with self._reading(stage):
                there = stage in f
            if not there:
                raise DataError(
                    f"{self.path}: stage {stage!r} is not in the store; it holds "
                    f"{', '.join(f) or 'nothing'}"
                )
            with self._reading(stage):
                if digest(f[stage]) != hdf5.text_of(f[stage].attrs.get(DIGEST, "")):
                    raise ValueError("it holds something else than its digest says")
            try:
                return hdf5.load(f[stage])
            except (DataError, *DAMAGE) as e:
                raise DataError(
                    f"{self.path}: stage {stage!r}: {e}; run the study again"
                ) from e

    def stages(self) -> tuple[str, ...]:
        """The stages that are stored."""
        if not self.path.exists():
            return ()
        with self._open() as f:
            return tuple(f)

    def _copy(self, old: h5py.File, name: str, new: h5py.File) -> None:
        try:
            old.copy(name, new)
        except DAMAGE as e:
            _log.warning(
                "%s: stage %r is damaged and left out (%s)", self.path, name, e
            )
            if name in new:
                del new[name]

    @contextmanager
    def _reading(self, stage: str) -> Iterator[None]:
        """Errors of damaged bytes name the stage."""
        try:
            yield
        except DAMAGE as e:
            raise DataError(
                f"{self.path}: stage {stage!r} is damaged ({e}); run the study again"
            ) from e

    @contextmanager
    def _open(self) -> Iterator[h5py.File]:
        keeps_up(self.path)
        with open_hdf5(
            self.path, "store", "move it away and the study runs from the beginning"
        ) as file:
            yield file


def digest(group: h5py.Group) -> str:
    """SHA-256 of the names, attributes, types, shapes and bytes of all that a group holds, whenever
    it was made.
    """
    total = hashlib.sha256()

    def add(name: str, item: h5py.Group | h5py.Dataset) -> None:
        attributes = {
            k: np.asarray(item.attrs[k])
            for k in sorted(item.attrs)
            if k not in (DIGEST, SECONDS)
        }
        for k, value in attributes.items():
            total.update(f"{name}@{k} {value.dtype.str}".encode() + value.tobytes())
        if isinstance(item, h5py.Dataset):
            a = np.ascontiguousarray(item[()])
            total.update(f"{name} {a.dtype.str} {item.shape} ".encode() + a.tobytes())
            return
        total.update(f"{name} group".encode())
        for child in sorted(item):
            add(f"{name}/{child}", item[child])

    add("", group)
    return total.hexdigest()


LOCK_FILE = "study.h5.lock"  # next to the store while a study runs
_FAR = 1 << 30  # where Windows locks a byte: what stands before it can be read


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Alone in the folder of a study, which is made if need be, and goes again where nothing was
    written.

    The file that a killed process has left is taken over: its lock is gone with it.

    Raises
    ------
    DataError
        If another run has it.
    """
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK_FILE
    handle = _taken(path)
    try:
        os.truncate(handle, 0)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
        yield
    finally:
        with suppress(OSError):  # Windows keeps a file that is open
            path.unlink()
        os.close(handle)
        if new:
            with suppress(OSError):  # it holds results
                folder.rmdir()


def _taken(path: Path) -> int:
    """The lock file, opened and locked; tried again if its last owner has removed it in between."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(handle)
            if path.exists() and os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        except FileNotFoundError:
            pass
        except BlockingIOError as e:
            owner = os.read(handle, 200).decode(errors="replace") or "another process"
            os.close(handle)
            raise DataError(
                f"{path.parent}: {owner} runs this study; wait for its end, or write elsewhere "
                "with --out"
            ) from e
        except OSError as e:
            _log.warning(
                "%s: its file system has no locks (%s); start no second run on this study",
                path.parent,
                e,
            )
            return handle
        os.close(handle)


def _lock(handle: int) -> None:
    """Take the lock, or raise BlockingIOError."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError as e:
            raise BlockingIOError(str(e)) from e
        finally:
            os.lseek(handle, 0, os.SEEK_SET)
        return
    import fcntl

    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


SETS_FILE = "update.sets.h5"  # next to the store, gone when the stage is done


@dataclass(frozen=True, slots=True)
class FinishedSets:
    """The result of each set by the name of its group; those of other settings, inputs or versions
    are not taken.
    """

    store: Store
    key: str
    found: dict[str, FinishedSet] = field(default_factory=dict)

    @classmethod
    def of(cls, folder: Path, key: str) -> FinishedSets:
        """Those of an interrupted run in a folder, whose updating has this key."""
        kept = cls(Store(folder / SETS_FILE), key)
        try:
            for group in kept.store.stages():
                done = kept.store.load(group)
                if kept.store.key(group) == kept.key and isinstance(done, FinishedSet):
                    kept.found[group] = done
        except DataError as e:
            _log.warning("updated anew: %s", e)
            kept.found.clear()
        if not kept.found:
            kept.clear()
        return kept

    def get(self, name: str) -> FinishedSet | None:
        """The result of a set; None where it is not finished."""
        return self.found.get(_group_name(name))

    def put(self, name: str, done: FinishedSet) -> FinishedSet:
        """Keep the result of a set, whole or not at all; it is given back as the store has it."""
        group = _group_name(name)
        self.store.save(group, self.key, done)
        return cast(FinishedSet, self.store.load(group))

    def clear(self) -> None:
        """All are there, and the result of the stage takes their place."""
        self.store.path.unlink(missing_ok=True)


def _group_name(name: str) -> str:
    """The name of a set may hold any sign."""
    return hashlib.sha256(name.encode()).hexdigest()
