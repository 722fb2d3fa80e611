"""The store of a study: one group of study.h5 a stage, replaced whole or not at all, read only as
it was written.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ringtrue.errors import DataError
from ringtrue.io import hdf5
from ringtrue.io.files import atomic_write, keeps_up
from ringtrue.io.foreign.door import DAMAGE
from ringtrue.io.foreign.parsers import open_hdf5, trust_hdf5

DIGEST = "digest"  # SHA-256 of all that a stage holds
SECONDS = "seconds"  # of the run that made it
_log = logging.getLogger(__name__)


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
                raise DataError(f"{self.path}: stage {stage!r}: {e}; run the study again") from e

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
            _log.warning("%s: stage %r is damaged and left out (%s)", self.path, name, e)
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
            k: np.asarray(item.attrs[k]) for k in sorted(item.attrs) if k not in (DIGEST, SECONDS)
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
