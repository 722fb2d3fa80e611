"""The store of a study: one group of study.h5 a stage, replaced whole or not at all."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import h5py

from ringtrue.errors import DataError
from ringtrue.io import codec


@dataclass(frozen=True, slots=True)
class Store:
    """`study.h5`: stage name -> result, with the key of the inputs that made it."""

    path: Path

    def key(self, stage: str) -> str | None:
        """The key that a stage was stored with; None where it is not there."""
        if not self.path.exists():
            return None
        with h5py.File(self.path, "r") as f:
            return str(f[stage].attrs["key"]) if stage in f else None

    def save(self, stage: str, key: str, result: object) -> None:
        """Write a stage into a copy of the file, then put the copy in its place."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        part = self.path.with_suffix(".part")
        if self.path.exists():
            shutil.copyfile(self.path, part)
        try:
            with h5py.File(part, "a") as f:
                if stage in f:
                    del f[stage]
                group = f.create_group(stage)
                codec.save(group, result)
                group.attrs["key"] = key
            os.replace(part, self.path)
        finally:
            part.unlink(missing_ok=True)

    def load(self, stage: str) -> object:
        """The result of a stage.

        Raises
        ------
        DataError
            If the file or the stage is not there.
        """
        if not self.path.exists():
            raise DataError(f"{self.path}: no such store; run the study first")
        with h5py.File(self.path, "r") as f:
            if stage not in f:
                raise DataError(
                    f"{self.path}: stage {stage!r} is not in the store; it holds {', '.join(f) or 'nothing'}"
                )
            return codec.load(f[stage])

    def stages(self) -> tuple[str, ...]:
        """The stages that are stored."""
        if not self.path.exists():
            return ()
        with h5py.File(self.path, "r") as f:
            return tuple(f)
