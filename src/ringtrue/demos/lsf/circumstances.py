"""When the tests of a campaign are made, of what, and which channels are at fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from ringtrue.core.modes import ModalModel
from ringtrue.core.testmodel import TestModel
from ringtrue.virtual.joints import SofteningJoints
from ringtrue.virtual.sensors import at_outputs

DATE = "2024-05-13"
EXCITATIONS = ("ambient", "jumping", "drop", "sledge")
AGAIN = "foundation-again"


class TwinView(Protocol):
    """What the campaign may know of the structure."""

    @property
    # outputs: channels of `test`; inputs: force points and `ground…` columns
    def modal(self) -> ModalModel: ...
    @property
    def test(self) -> TestModel: ...
    @property
    def drop_points(self) -> tuple[str, ...]: ...
    @property
    def jump_points(self) -> tuple[str, ...]: ...
    @property
    def sledge_points(self) -> tuple[str, ...]: ...
    @property
    def machine_points(self) -> tuple[str, ...]: ...
    @property
    def joints(self) -> SofteningJoints | None: ...


@dataclass(frozen=True, slots=True)
class Day:
    """When a test is made.

    Attributes
    ----------
    date : str
    temperature : float, optional
        Of the air and of the structure, °C; None: not noted down.
    """

    date: str = DATE
    temperature: float | None = None


@dataclass(frozen=True, slots=True)
class ChannelFaults:
    """What is wrong with channels, and written down nowhere.

    Attributes
    ----------
    reversed : str
        A channel that reads with the opposite sign in all tests.
    swapped : tuple of str
        Two channels, each of which reads the motion of the other in all tests.
    scaled : str
        A channel that reads `gain` times what it should in one `setup` of the hammer test, counted
        from 0.
    """

    reversed: str = ""
    swapped: tuple[str, ...] = ()
    scaled: str = ""
    setup: int = -1
    gain: float = 1.0

    def reads(self, channel: str) -> str:
        """The channel whose motion one reads."""
        if channel in self.swapped:
            return self.swapped[1 - self.swapped.index(channel)]
        return channel

    def factor(self, channel: str, setup: int) -> float:
        """What a channel reads of that motion; `setup` is -1 in the ambient tests."""
        sign = -1.0 if channel == self.reversed else 1.0
        here = channel == self.scaled and setup == self.setup
        return sign * (self.gain if here else 1.0)


@dataclass(frozen=True, slots=True)
class Circumstances:
    """The structure on the days of the tests, and what goes wrong.

    Attributes
    ----------
    twins : mapping of str to TwinView
        The structure by date.
    days : mapping of str to Day
        When tests are made, by name; all on one day where none is named.
    repeated : tuple of str
        Kinds of excitation that test (a) is repeated with, as the test `foundation-again`.
    faults : ChannelFaults
    """

    twins: Mapping[str, TwinView]
    days: Mapping[str, Day] = field(default_factory=dict)
    repeated: tuple[str, ...] = ()
    faults: ChannelFaults = ChannelFaults()

    def day(self, name: str) -> Day:
        """When a test is made."""
        return self.days.get(name, Day())

    def at(self, name: str) -> TwinView:
        """The structure on the day of a test."""
        return self.twins[self.day(name).date]

    def ambient_tests(self) -> dict[str, tuple[str, ...]]:
        """Names of the ambient tests, with the kinds of excitation of their records."""
        again = {AGAIN: self.repeated} if self.repeated else {}
        return {"foundation": EXCITATIONS, "frame": EXCITATIONS} | again

    def seen(self, name: str, channels: Sequence[str], setup: int = -1) -> ModalModel:
        """The structure as channels read it, faults and all; `setup` is that of a hammer test."""
        faults = self.faults
        model = at_outputs(self.at(name).modal, [faults.reads(c) for c in channels])
        factor = np.array([[faults.factor(c, setup)] for c in channels])
        return replace(
            model,
            shapes=model.shapes * factor,
            lower=model.lower * factor,
            upper=model.upper * factor,
            outputs=tuple(
                replace(read, id=c) for read, c in zip(model.outputs, channels, strict=True)
            ),
        )
