"""The parameter sets that an updating has finished, on disk: after an interruption it goes on with
the next one.
"""

from __future__ import annotations

import hashlib
import logging
from dataclasses import dataclass, field

from ringtrue.errors import DataError
from ringtrue.study.results import FinishedSet
from ringtrue.study.store import Store
from ringtrue.study.workbench import Workbench

_log = logging.getLogger(__name__)

FILE = "update.sets.h5"  # beside the store, gone when the stage is done


@dataclass(frozen=True, slots=True)
class FinishedSets:
    """The result of each set by the name of its group; those of other settings, inputs or versions
    are not taken.
    """

    store: Store
    key: str
    found: dict[str, FinishedSet] = field(default_factory=dict)

    @classmethod
    def of(cls, desk: Workbench) -> FinishedSets:
        """Those of an interrupted run of this study."""
        kept = cls(Store(desk.out / FILE), desk.keys["update"])
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
        return self.found.get(_group(name))

    def put(self, name: str, done: FinishedSet) -> FinishedSet:
        """Keep the result of a set, whole or not at all; it is given back."""
        self.store.save(_group(name), self.key, done)
        return done

    def clear(self) -> None:
        """All are there, and the result of the stage takes their place."""
        self.store.path.unlink(missing_ok=True)


def _group(name: str) -> str:
    """The name of a set may hold any sign."""
    return hashlib.sha256(name.encode()).hexdigest()
