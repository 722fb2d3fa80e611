"""The last iterate of each parameter set on disk, so that an interrupted updating goes on from there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.io.atomic import atomic_write
from ringtrue.study.workbench import Workbench
from ringtrue.update.objective import Target

SETTINGS = {"update", "residual", "constraint", "set", "candidate", "configuration", "remodel"}


@dataclass(eq=False)
class Iterates:
    """What the sets of one updating have come to; a file of another study or test is not taken."""

    path: Path
    key: str
    points: dict[str, list[float]] = field(default_factory=dict)

    @classmethod
    def of(cls, desk: Workbench, aim: Target) -> Iterates:
        """Those of an interrupted run, if it was of the same settings and test modes."""
        settings = desk.config.model_dump_json(include=SETTINGS)
        data = (settings.encode(), aim.frequencies.tobytes(), aim.shapes.tobytes(), aim.used.tobytes())
        key = hashlib.sha256(b"".join(data)).hexdigest()
        path = desk.out / "update.iterates.json"
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            same = found["key"] == key
            return cls(path, key, dict(found["points"]) if same else {})
        except (FileNotFoundError, ValueError, KeyError, TypeError):  # none, or a torn one: from the start
            return cls(path, key)

    def start(self, name: str, members: Sequence[str]) -> Float | None:
        """x of a set where it was left; None where it has not begun."""
        x = self.points.get(name)
        return np.array(x) if x is not None and len(x) == len(members) else None

    def keep(self, name: str, x: Float) -> None:
        """Write the point of a set, whole or not at all."""
        self.points[name] = x.tolist()
        with atomic_write(self.path) as part:
            part.write_text(json.dumps({"key": self.key, "points": self.points}), encoding="utf-8")

    def done(self) -> None:
        """The stage is complete: its result takes the place of the iterates."""
        self.path.unlink(missing_ok=True)
