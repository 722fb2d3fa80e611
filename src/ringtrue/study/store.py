"""The store of a study: one group of study.h5 a stage, replaced whole or not at all."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py

from ringtrue.errors import DataError
from ringtrue.io import codec
from ringtrue.io.atomic import atomic_write


@dataclass(frozen=True, slots=True)
class Store:
    """`study.h5`: stage name -> result, with the key of the inputs that made it."""

    path: Path

    def key(self, stage: str) -> str | None:
        """The key that a stage was stored with; None where it is not there."""
        if not self.path.exists():
            return None
        with self._open() as f:
            return str(f[stage].attrs["key"]) if stage in f else None

    def save(self, stage: str, key: str, result: object, *, drop: Collection[str] = ()) -> None:
        """Write a stage into a copy of the file, without the stages of `drop`, then put the copy in its place.

        The copy is made in memory: HDF5 does not survive a disk that is full.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(self.path.name, "w", driver="core", backing_store=False) as new:
            if self.path.exists():
                with self._open() as old:
                    for name in old:
                        if name != stage and name not in drop:
                            old.copy(name, new)
            group = new.create_group(stage)
            codec.save(group, result)
            group.attrs["key"] = key
            new.flush()
            image = new.id.get_file_image()
        with atomic_write(self.path) as part:
            part.write_bytes(image)

    def load(self, stage: str) -> object:
        """The result of a stage.

        Raises
        ------
        DataError
            If the file or the stage is not there, or was stored by a version with other results.
        """
        if not self.path.exists():
            raise DataError(f"{self.path}: no such store; run the study first")
        with self._open() as f:
            if stage not in f:
                raise DataError(
                    f"{self.path}: stage {stage!r} is not in the store; it holds {', '.join(f) or 'nothing'}"
                )
            try:
                return codec.load(f[stage])
            except DataError as e:
                raise DataError(f"{self.path}: stage {stage!r}: {e}; run the study again") from e

    def stages(self) -> tuple[str, ...]:
        """The stages that are stored."""
        if not self.path.exists():
            return ()
        with self._open() as f:
            return tuple(f)

    @contextmanager
    def _open(self) -> Iterator[h5py.File]:
        try:
            file = h5py.File(self.path, "r")
        except OSError as e:
            raise DataError(
                f"{self.path}: not a readable store ({e}); move it away and the study runs from the beginning"
            ) from e
        with file:
            yield file
