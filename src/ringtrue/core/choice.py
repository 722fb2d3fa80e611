"""A choice by hand: what is picked on a stabilisation diagram, what is rejected, what is one mode;
which hits of a hammer count.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ringtrue.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Pick:
    """A mode to take.

    Attributes
    ----------
    frequency : float, Hz
    order : int
        Model order whose pole is meant; 0: the automatic mode or the group of poles there.
    record : str
        Name of the record; empty: every one.
    note : str
    """

    frequency: float
    order: int = 0
    record: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        _positive("pick", self.frequency)
        if self.order < 0:
            raise ConfigError(
                f"pick at {self.frequency:g} Hz: order {self.order} must be 1 or more, or left out"
            )


@dataclass(frozen=True, slots=True)
class Reject:
    """An automatic mode to leave out, and why."""

    frequency: float
    reason: str
    record: str = ""

    def __post_init__(self) -> None:
        _positive("reject", self.frequency)
        if not self.reason.strip():
            raise ConfigError(f"reject at {self.frequency:g} Hz: needs a reason")


@dataclass(frozen=True, slots=True)
class Merge:
    """Modes that are one."""

    frequencies: tuple[float, ...]
    reason: str = ""
    record: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequencies", tuple(self.frequencies))
        for f in self.frequencies:
            _positive("merge", f)
        if len(self.frequencies) < 2:
            raise ConfigError(
                f"merge of {list(self.frequencies)} Hz: needs two frequencies or more"
            )


# so near a frequency, relative, and a time must be to the mode and to the hit that a choice means
SAME_MODE = 0.01
SAME_HIT_S = 0.05


@dataclass(frozen=True, slots=True)
class Hit:
    """A hit of a hammer that is kept or left out, whatever the checks say of it, and why.

    Attributes
    ----------
    record : str
        Name of the record, the file without its ending; `name #2` is its second acquisition.
    time : float, s
        Of the peak of the force in the record.
    keep : bool
    reason : str
    """

    record: str
    time: float
    keep: bool
    reason: str

    def __post_init__(self) -> None:
        where = f"hit of {self.record or 'no record'} at {self.time:g} s"
        if not self.record.strip():
            raise ConfigError(f"{where}: needs the name of its record")
        if not 0 <= self.time < float("inf"):
            raise ConfigError(f"{where}: the time must be 0 or more")
        if not self.reason.strip():
            raise ConfigError(f"{where}: needs a reason")


def _positive(what: str, f: float) -> None:
    if not 0 < f < float("inf"):
        raise ConfigError(f"{what}: frequency {f} Hz must be positive")


@dataclass(frozen=True, slots=True)
class Choice:
    """What a person decided on the modes and hits of one record or several.

    Attributes
    ----------
    picks : tuple of Pick
    rejects : tuple of Reject
    merges : tuple of Merge
    automatic : bool
        The automatic modes stay, but for those rejected or merged; otherwise only what is picked is
        reported.
    source : str
        Where the choice is stored.
    hits : tuple of Hit
    """

    picks: tuple[Pick, ...] = ()
    rejects: tuple[Reject, ...] = ()
    merges: tuple[Merge, ...] = ()
    automatic: bool = True
    source: str = ""
    hits: tuple[Hit, ...] = ()

    def of(self, record: str) -> Choice | None:
        """The part that concerns the modes of a record; None if none does: they are automatic
        then.
        """
        mine = (record, "")
        part = replace(
            self,
            picks=tuple(p for p in self.picks if p.record in mine),
            rejects=tuple(r for r in self.rejects if r.record in mine),
            merges=tuple(m for m in self.merges if m.record in mine),
            hits=(),
        )
        return part if part.picks or part.rejects or part.merges else None

    @property
    def records(self) -> tuple[str, ...]:
        """The records whose modes are named."""
        every: tuple[Pick | Reject | Merge, ...] = (
            *self.picks,
            *self.rejects,
            *self.merges,
        )
        return tuple(dict.fromkeys(x.record for x in every if x.record))
