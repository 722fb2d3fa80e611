"""Does each setting of the ambient path earn its place? Each is halved and doubled in turn.

    python bench/ablations.py [--quick | --full] [--only TEXT]

Settings are the numbers with which modules of the path from a record to its modes decide: module
constants and defaults of their classes of settings. Records are those of the families
(ambient_families.py, other seeds) and the published ones (records.py). A setting has an effect
where a mode is lost or gained, or becomes doubtful, or an identified frequency moves by more than
a tenth of its standard deviation. Each setting stands in a process of its own. Times are not
measured; this takes hours, and `--quick` tries a tenth of the settings.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import multiprocessing
import pkgutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import ambient_families
import numpy as np
import records
from outcome import arguments

import ringtrue as rt
from ringtrue.core.arrays import Float

PACKAGES = ("ringtrue.identification.ambient", "ringtrue.identification.common", "ringtrue.signal")
OTHER_PATHS = (  # of the hammer test and of several tests
    "ringtrue.signal.frf",
    "ringtrue.signal.frf_sets",
    "ringtrue.signal.impacts",
    "ringtrue.signal.local_rational",
    "ringtrue.signal.clock_alignment",
    "ringtrue.identification.common.merging",
    "ringtrue.identification.common.tracking",
    "ringtrue.identification.common.diagram",
)
FIRST_SEED = 5000
COUNTS = {"mixed": 2, "close": 1, "short": 6, "machine": 1, "decay": 4, "drops": 2}
SMALL = {"mixed": 1, "close": 0, "short": 6, "machine": 1, "decay": 3, "drops": 1}
MOVED = 0.1  # standard deviations


@dataclass(frozen=True, slots=True)
class Setting:
    """A number by which a module decides: where it stands, and its value."""

    module: str
    owner: str  # a class of settings, or nothing for a constant of the module
    name: str
    value: float

    @property
    def label(self) -> str:
        """Module and name, without what all have in common."""
        place = self.module.removeprefix("ringtrue.")
        return f"{place}: {self.owner}.{self.name}" if self.owner else f"{place}: {self.name}"

    def change(self, factor: float) -> None:
        """Multiply it wherever this process holds it; whole numbers stay whole."""
        value = self.value * factor
        if isinstance(self.value, int):
            value = max(round(value), 0)
        module = sys.modules[self.module]
        if self.owner:
            change_default(getattr(module, self.owner), self.name, value)
            return
        for other in loaded():
            if getattr(other, self.name, None) == self.value:
                setattr(other, self.name, value)


def change_default(settings: Any, name: str, value: float) -> None:
    """A new default of a class of settings, also in the instances that modules hold."""
    numbers = [f.name for f in dataclasses.fields(settings) if f.default is not dataclasses.MISSING]
    defaults = list(settings.__init__.__defaults__)
    defaults[numbers.index(name) - len(numbers)] = value
    settings.__init__.__defaults__ = tuple(defaults)
    for module in loaded():
        for held in vars(module).values():
            if type(held) is settings:
                object.__setattr__(held, name, value)


def loaded() -> list[ModuleType]:
    """Modules of ringtrue in this process."""
    return [m for name, m in list(sys.modules.items()) if name.startswith("ringtrue") and m]


def is_number(value: object) -> bool:
    """Whether a value is a number that decides something: neither a flag, nor 0, nor 1."""
    return type(value) in (int, float) and value not in (0, 1)


def settings_of(module: ModuleType) -> Iterator[Setting]:
    """The settings that a module defines."""
    for name, value in vars(module).items():
        if name.isupper() and is_number(value) and f"\n{name}" in source(module):
            yield Setting(module.__name__, "", name, value)
        if isinstance(value, type) and value.__module__ == module.__name__:
            if not dataclasses.is_dataclass(value):
                continue
            for field in dataclasses.fields(value):
                if is_number(field.default):
                    yield Setting(module.__name__, value.__name__, field.name, field.default)


def source(module: ModuleType) -> str:
    """The text of a module."""
    with open(module.__file__ or "", encoding="utf-8") as file:
        return file.read()


def all_settings() -> list[Setting]:
    """Settings of all modules of the path, in order of their modules."""
    found = []
    for package in map(importlib.import_module, PACKAGES):
        for info in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
            if info.name not in OTHER_PATHS:
                found += settings_of(importlib.import_module(info.name))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What is identified of one record: frequencies and standard deviations of natural modes (m,),
    frequencies of doubtful ones; modes of the truth that are found, and others.
    """

    frequency: Float
    deviation: Float
    doubtful: Float
    found: int
    extra: int


def seen(name: str, made: Callable[[], Any]) -> Seen:
    """Identify one record and count."""
    case = made()
    if isinstance(case, records.Published):
        test = rt.identify_ambient(rt.read_record(records.DATA / case.file, rate=case.rate))
        counted = records.Counted.of(case.frequencies, test.frequencies, np.empty(0))
        found, extra = counted.found, counted.extra
    else:
        test = rt.identify_ambient(case.record)
        found = ambient_families.paired(case, test)[0].size
        extra = len(test) - found
    return Seen(test.frequencies, test.std_frequency, test.others.modes.frequencies, found, extra)


def cases() -> dict[str, Callable[[], Any]]:
    """Name of each record -> what makes it."""
    made: dict[str, Callable[[], Any]] = {}
    for family, count in COUNTS.items():
        make = ambient_families.FAMILIES[family][0]
        for k in range(count):
            made[f"{family} {k}"] = lambda make=make, k=k: make(FIRST_SEED + k)
    if records.DATA.exists():
        for published in records.ambient_records():
            made[published.name] = lambda published=published: published
    return made


def all_seen(change: tuple[Setting, float] | None) -> dict[str, Seen | str]:
    """All records, with one setting changed; what stops a record instead."""
    if change is not None:
        change[0].change(change[1])
    out: dict[str, Seen | str] = {}
    for name, made in cases().items():
        try:
            out[name] = seen(name, made)
        except Exception as error:  # a setting out of its range
            out[name] = f"{type(error).__name__}: {error}"
    return out


@dataclass(frozen=True, slots=True)
class Effect:
    """How a change moves the answers of all records: modes found and extra, doubtful ones, records
    in which a frequency moves; records that stop.
    """

    found: int
    extra: int
    doubtful: int
    moved: int
    stopped: int

    @property
    def text(self) -> str:
        """In print."""
        parts = [
            f"{count:+d} {what}"
            for count, what in (
                (self.found, "found"),
                (self.extra, "extra"),
                (self.doubtful, "doubtful"),
            )
            if count
        ]
        if self.moved:
            parts.append(f"{self.moved} records move")
        if self.stopped:
            parts.append(f"{self.stopped} records stop")
        return ", ".join(parts) or "none"


def effect(before: dict[str, Seen | str], after: dict[str, Seen | str]) -> Effect:
    """Compare all records."""
    found = extra = doubtful = moved = stopped = 0
    for name, one in before.items():
        two = after[name]
        if isinstance(one, str) or isinstance(two, str):
            stopped += isinstance(two, str)
            continue
        found += two.found - one.found
        extra += two.extra - one.extra
        doubtful += two.doubtful.size - one.doubtful.size
        if one.frequency.size == two.frequency.size:
            off = np.abs(two.frequency - one.frequency) / one.deviation
            moved += bool((off > MOVED).any())
        else:
            moved += 1
    return Effect(found, extra, doubtful, moved, stopped)


def in_own_process(change: tuple[Setting, float] | None) -> dict[str, Seen | str]:
    """`all_seen` in a process that ends with it: settings of this one stay."""
    with multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply(all_seen, (change,))


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--only", default="", help="settings whose label has this text")
    options: argparse.Namespace = parser.parse_args()
    settings = [x for x in all_settings() if options.only in x.label]
    if options.quick:
        settings = settings[::10]
    before = in_own_process(None)
    print(f"{len(settings)} settings, {len(before)} records", flush=True)
    print(
        {
            k: v if isinstance(v, str) else (v.found, v.extra, v.doubtful.size)
            for k, v in before.items()
        },
        flush=True,
    )
    for setting in settings:
        half, double = (effect(before, in_own_process((setting, f))) for f in (0.5, 2.0))
        print(f"{setting.label} = {setting.value:g} | {half.text} | {double.text}", flush=True)


if __name__ == "__main__":
    main()
