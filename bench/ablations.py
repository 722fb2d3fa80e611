"""Does each setting of the ambient path earn its place? Each is halved and doubled in turn.

    python bench/ablations.py [--quick | --full] [--only TEXT]

Settings are the numbers with which modules of the path from a record to its modes decide: module
constants and defaults of their classes of settings. Records are those of the families
(ambient_families.py, other seeds, the longest ones cut), the published ones (records.py), and some
with the faults of recorders and machines. A setting has an effect where a mode is found or lost,
becomes doubtful, or moves in frequency by more than a tenth of its standard deviation. Each change
has a process of its own, and the records that read the setting. What is found is the table of
docs/ambient_settings.md. Times are not measured. `--quick` tries a tenth of the settings, `--full`
takes more records of each family.

Not covered: the hammer test, several tests of one structure (merging, tracking), numbers inside of
expressions. What pictures show decides nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import multiprocessing
import pkgutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import ambient_families as families
import numpy as np
import records
from outcome import ROOT, Check, Report, arguments, at_most, sized

import ringtrue as rt
from ringtrue.core.arrays import Float
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.signal.clock_alignment import in_step

CORE = "ringtrue.core.signals"  # of it the constants: its classes are data
PACKAGES = (
    "ringtrue.identification.ambient",
    "ringtrue.identification.common",
    "ringtrue.signal",
)
OTHER_PATHS = (  # of the hammer test, of several tests, and pictures
    "ringtrue.signal.frf",
    "ringtrue.signal.frf_sets",
    "ringtrue.signal.impacts",
    "ringtrue.signal.local_rational",
    "ringtrue.signal.overview",
    "ringtrue.identification.common.merging",
    "ringtrue.identification.common.tracking",
    "ringtrue.identification.common.diagram",
)
# decide nothing: the mean share of two shapes after any turn, how much threads hold at a time, and
# how many samples an interpolation takes
DEFINITIONS = ("ANY_TURN", "UNDER_WAY", "TAPS")
PAGE = ROOT / "docs" / "ambient_settings.md"
FIRST_SEED = 5000
COUNTS = {"short": 4, "decay": 3, "drops": 2, "mixed": 2, "machine": 1, "close": 1}
SAMPLES = {"machine": 120_000, "close": 60_000}  # of longer ones the first so many
MOVED = 0.1  # standard deviations
MOST_SETTINGS = 60  # both as counted last: they fall with every clean-up
MOST_IDLE = 20  # settings without an effect, those among them that no record reads


@dataclass(frozen=True, slots=True)
class Setting:
    """A number by which a module decides, or several of one meaning: where it stands, and its
    value.
    """

    module: str
    owner: str  # a class of settings, or nothing for a constant of the module
    name: str
    value: Any

    @property
    def label(self) -> str:
        """Module and name, without what all have in common."""
        place = self.module.removeprefix("ringtrue.")
        return (
            f"{place}: {self.owner}.{self.name}"
            if self.owner
            else f"{place}: {self.name}"
        )

    def changed(self, factor: float) -> Any:
        """The value times a factor; whole numbers stay whole and positive."""
        if isinstance(self.value, tuple):
            return tuple(times(x, factor) for x in self.value)
        return times(self.value, factor)

    def change(self, factor: float) -> None:
        """Multiply it wherever this process holds it."""
        value = self.changed(factor)
        module = sys.modules[self.module]
        if self.owner:
            change_default(getattr(module, self.owner), self.name, value)
            return
        for other in loaded():
            own = other is module or f"\n{self.name} = " not in source(other)
            if own and self.name in vars(other):
                setattr(other, self.name, value)


def times(value: float, factor: float) -> float:
    """A number times a factor."""
    return max(round(value * factor), 1) if isinstance(value, int) else value * factor


def change_default(settings: Any, name: str, value: Any) -> None:
    """A new default of a class of settings, also in the instances that modules hold."""
    parameters = inspect.signature(settings.__init__).parameters.values()
    named = [p.name for p in parameters if p.default is not inspect.Parameter.empty]
    defaults = list(settings.__init__.__defaults__)
    defaults[named.index(name)] = value
    settings.__init__.__defaults__ = tuple(defaults)
    for module in loaded():
        for held in vars(module).values():
            if type(held) is settings:
                object.__setattr__(held, name, value)


def loaded() -> list[ModuleType]:
    """Modules of ringtrue in this process."""
    return [
        m for name, m in list(sys.modules.items()) if name.startswith("ringtrue") and m
    ]


def is_number(value: object) -> bool:
    """Whether a value is a number that decides something, or several: neither a flag, nor 0 or 1
    alone.
    """
    if isinstance(value, tuple):
        return bool(value) and all(type(x) in (int, float) for x in value)
    return type(value) in (int, float) and value not in (0, 1)


def settings_of(module: ModuleType) -> Iterator[Setting]:
    """The settings that a module defines."""
    for name, value in vars(module).items():
        own = name.isupper() and f"\n{name} = " in source(module)
        if own and is_number(value) and name not in DEFINITIONS:
            yield Setting(module.__name__, "", name, value)
        if isinstance(value, type) and value.__module__ == module.__name__:
            if not dataclasses.is_dataclass(value):
                continue
            for field in dataclasses.fields(value):
                if is_number(field.default):
                    yield Setting(
                        module.__name__, value.__name__, field.name, field.default
                    )


def source(module: ModuleType) -> str:
    """The text of a module."""
    return inspect.getsource(module) if module.__file__ else ""


def all_settings() -> list[Setting]:
    """Settings of all modules of the path, in order of their modules."""
    core = importlib.import_module(CORE)
    found = [s for s in settings_of(core) if not s.owner]
    for package in map(importlib.import_module, PACKAGES):
        for info in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
            if info.name not in OTHER_PATHS:
                found += settings_of(importlib.import_module(info.name))
    return found


# The records


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A record and how it is identified.

    Attributes
    ----------
    identify : callable () -> TestModes
    truth : Made or (m,) float64, Hz
        Its modes: those that were made, or the frequencies of a publication.
    of : str
        Modules that it is there for; empty: all.
    """

    identify: Callable[[], rt.TestModes]
    truth: Any
    of: str = ""


def cut(made: families.Made, samples: int) -> families.Made:
    """The first so many samples of a record."""
    return replace(
        made, record=replace(made.record, data=made.record.data[:, :samples])
    )


def calm(seed: int, force: str = "") -> families.Made:
    """Eight modes of a chain under white forces; under a `press` besides, or a `crowd`."""
    rng = np.random.default_rng([31, seed])
    f, phi = families.chain(8, rng)
    f = f * rng.uniform(2, 8)
    z = rng.uniform(0.004, 0.015, 8)
    rate = 4 * f[-1]
    seconds = 40_000 / rate
    q, omega = families.responses(f, z, phi, seconds, rate, seed)
    own = (2 * np.pi * f)[:, None]
    stiffness = own**2 - omega**2 + 2j * z[:, None] * own * omega
    if force == "press":
        stamps = np.zeros(2 * omega.size - 2)
        stamps[:: int(seconds * rate / 80)] = 0.015 * np.sqrt(omega.size)
        q = q + phi[[2]].T * np.fft.rfft(stamps) / stiffness
    if force == "crowd":  # a broad peak between the second and the third mode
        nu = omega / (np.pi * (f[1] + f[2]))
        peak = 1 / (1 - nu**2 + 0.16j * nu)
        white = rng.standard_normal((2, omega.size))
        pattern = phi.T @ rng.standard_normal(8)
        q = q + pattern[:, None] * (0.3 * peak * (white[0] + 1j * white[1])) / stiffness
    y = families.signals(-(phi @ q) * omega**2, np.full(8, 40.0), seed)
    return families.Made(families.record(y, rate, "acceleration"), f, z, phi)


def fans(seed: int) -> families.Made:
    """A steady line, one whose phase wanders with its double, and one that is switched."""
    made = calm(seed)
    rng = np.random.default_rng([34, seed])
    y = np.array(made.record.data)
    t = np.arange(y.shape[1]) / made.record.rate
    f = made.frequency
    walk = 0.015 * np.cumsum(rng.standard_normal(t.size)) / (2 * np.pi)
    first = 0.4 * f[1] + 0.6 * f[2]
    on = (t * 12 / t[-1]) % 2 < 1
    tones = [
        np.sin(2 * np.pi * 0.5 * (f[3] + f[4]) * t),
        np.sin(2 * np.pi * (first * t + walk)),
        np.sin(2 * np.pi * (2 * first * t + 2 * walk)),
        on * np.sin(2 * np.pi * (0.5 * (f[5] + f[6]) * t + walk)),
    ]
    push = rng.standard_normal((4, 8, 1))
    y += 0.5 * y.std() * sum(p * tone for p, tone in zip(push, tones, strict=True))
    return replace(made, record=replace(made.record, data=y))


def run_up(seed: int) -> families.Made:
    """A tone that rises through the modes, twice."""
    made = calm(seed)
    y = np.array(made.record.data)
    n = y.shape[1]
    x = np.linspace(0, 1, n // 8)
    turn = 2 * np.pi * np.cumsum(0.05 + 0.3 * x)  # cycles a sample
    for at in (n // 5, 3 * n // 5):
        y[:, at : at + x.size] += 2 * y.std(axis=1, keepdims=True) * np.sin(turn)
    return replace(made, record=replace(made.record, data=y))


def recorder(seed: int) -> families.Made:
    """Clipped, held and missing samples; channels that are dead, too loud, or noise."""
    made = calm(seed)
    rng = np.random.default_rng([32, seed])
    y = np.array(made.record.data)
    top = 2.5 * y[3].std()
    y[3] = np.clip(y[3], -top, top)
    y[4, 9000:9400] = y[4, 9000]
    y[5, 20000:20003] = np.nan
    y[5, 30000:30300] = np.nan
    n = y.shape[1]
    more = np.stack([np.full(n, 0.1), 1e4 * top * rng.standard_normal(n)])
    more[0, : n // 50_000 + 2] += 1
    names = (
        *made.record.channels,
        *(Channel(f"{k}+X", "acceleration", "m/s^2") for k in (9, 10)),
    )
    record = TimeHistory(np.concatenate([y, more]), made.record.rate, names, "made")
    return replace(made, record=record)


def strangers(seed: int) -> families.Made:
    """Velocities beside accelerations without units, a column of noise, and one of strain."""
    made = cut(families.mixed(seed), 30_000)
    rng = np.random.default_rng([33, seed])
    y = made.record.data
    noise = rng.standard_normal((2, y.shape[1])) * [[1.0], [1e4]]
    noise[1] = np.cumsum(noise[1])
    names = (*made.record.channels, Channel("9+X"), Channel("10+X"))
    record = TimeHistory(np.concatenate([y, noise]), made.record.rate, names, "made")
    return replace(made, record=record)


def clocks(seed: int) -> families.Made:
    """Channels of a recorder that started later, and of one whose clock runs fast."""
    made = calm(seed)
    rate = made.record.rate
    delay = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.7, 1.7, 0.0]) / rate
    drift = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5e-5])
    return replace(made, record=in_step(made.record, -delay, -drift))


def of_made(made: families.Made) -> Case:
    """A record with default settings."""
    return Case(lambda: rt.identify_ambient(made.record), made)


def cases(more: int) -> dict[str, Case]:
    """Name of each record -> how it is identified; `more` times as many of each family."""
    made: dict[str, Case] = {}
    for family, count in COUNTS.items():
        make = families.FAMILIES[family][0]
        for k in range(more * count):
            made[f"{family} {k}"] = of_made(
                cut(make(FIRST_SEED + k), SAMPLES.get(family, sys.maxsize))
            )
    for faulty in (run_up, fans, recorder, strangers, clocks):
        made[faulty.__name__] = of_made(faulty(FIRST_SEED))
    for force in ("press", "crowd"):
        made[force] = of_made(calm(FIRST_SEED, force))
    whole = calm(FIRST_SEED + 1)
    parts = [
        replace(whole.record, data=x)
        for x in np.array_split(whole.record.data[:, :39_999], 3, 1)
    ]
    made["stretches"] = Case(lambda: rt.identify_ambient(parts), whole, "record_bands")
    modules = {
        "plscf": "signal.spectra",
        "fdd": "ambient.fdd",
        "era": "ambient.era",
        "ssi-data": "ambient.ssi_cov",
    }
    for method, module in modules.items():
        made[method] = Case(
            lambda m=method: rt.identify_ambient(whole.record, method=m),  # type: ignore[misc]
            whole,
            module,
        )
    if records.DATA.exists():
        for published in records.ambient_records()[:3]:
            record = rt.read_record(records.DATA / published.file, rate=published.rate)
            made[published.name] = Case(
                lambda x=record: rt.identify_ambient(x),  # type: ignore[misc]
                published.frequencies,
            )
    return made


# What is identified of them


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


def seen(case: Case) -> Seen:
    """Identify one record and count."""
    test = case.identify()
    if isinstance(case.truth, families.Made):
        ids = [c.id for c in case.truth.record.channels[: len(case.truth.shape)]]
        known = [c for c in test.modes.channels if c in ids]
        made = replace(
            case.truth, shape=case.truth.shape[[ids.index(c) for c in known]]
        )
        found = families.paired(made, replace(test, modes=test.modes.rows(known)))[
            0
        ].size
        extra = len(test) - found
    else:
        counted = records.Counted.of(case.truth, test.frequencies, np.empty(0))
        found, extra = counted.found, counted.extra
    deviation = np.where(np.isfinite(test.std_frequency), test.std_frequency, 1e-3)
    return Seen(
        test.frequencies, deviation, test.others.modes.frequencies, found, extra
    )


def what_is_seen(case: Case) -> Seen | str:
    """The same, or what stops it."""
    try:
        return seen(case)
    except Exception as error:  # a setting out of its range
        return f"{type(error).__name__}: {error}"


class Read:
    """A field of a class of settings that notes that it is read."""

    def __init__(
        self, slot: Any, key: tuple[str, str, str], noted: set[tuple[str, str, str]]
    ):
        self.slot = slot
        self.key = key
        self.noted = noted

    def __get__(self, held: Any, kind: Any = None) -> Any:
        if held is None:
            return self
        self.noted.add(self.key)
        return self.slot.__get__(held, kind)

    def __set__(self, held: Any, value: Any) -> None:
        self.slot.__set__(held, value)


def settings_read(
    case: Case, settings: list[Setting]
) -> tuple[Seen | str, float, set[Setting]]:
    """What is seen of a record, the seconds that it takes, and the settings that it reads; ends
    with a process.
    """
    start = time.process_time()
    before = what_is_seen(case)
    seconds = time.process_time() - start
    noted: set[tuple[str, str, str]] = set()
    for s in settings:
        if s.owner:
            kind = getattr(sys.modules[s.module], s.owner)
            setattr(
                kind,
                s.name,
                Read(vars(kind)[s.name], (s.module, s.owner, s.name), noted),
            )
    named: set[str] = set()

    def note(frame: Any, event: str, _: object) -> None:
        if event == "call" and "ringtrue" in frame.f_code.co_filename:
            named.update(frame.f_code.co_names)

    sys.setprofile(note)
    threading.setprofile(note)
    what_is_seen(case)
    sys.setprofile(None)
    read = {
        s
        for s in settings
        if ((s.module, s.owner, s.name) in noted if s.owner else s.name in named)
        and case.of in s.module
    }
    return before, seconds, read


def changed(cases_: list[Case], setting: Setting, factor: float) -> list[Seen | str]:
    """What is seen of some records with one setting changed; ends with a process."""
    setting.change(factor)
    return [what_is_seen(case) for case in cases_]


def in_own_process(
    work: Callable[..., Any], *arguments_: Any, limit: float | None = None
) -> Any:
    """Of a function in a process that ends with it: settings of this one stay.

    Raises
    ------
    TimeoutError
        If it takes more than `limit` seconds.
    """
    context = multiprocessing.get_context("fork")
    near, far = context.Pipe(duplex=False)
    process = context.Process(target=lambda: far.send(work(*arguments_)))
    process.start()
    far.close()
    try:
        if not near.poll(limit):
            raise TimeoutError
        return near.recv()
    finally:
        process.kill()
        process.join()


@dataclass(frozen=True, slots=True)
class Effect:
    """How a change moves the answers of all records: modes found and extra, doubtful ones, records
    in which a frequency moves; records that stop.
    """

    found: int = 0
    extra: int = 0
    doubtful: int = 0
    moved: int = 0
    stopped: int = 0

    @property
    def text(self) -> str:
        """In print."""
        counts = (
            (self.found, "found"),
            (self.extra, "extra"),
            (self.doubtful, "doubtful"),
        )
        parts = [f"{count:+d} {what}" for count, what in counts if count]
        if self.moved:
            parts.append(f"{self.moved} moved")
        if self.stopped:
            parts.append(f"{self.stopped} stopped")
        return ", ".join(parts) or "none"


def effect_of(
    known: list[Seen | str], some: list[Case], s: Setting, factor: float, cost: float
) -> Effect:
    """What a change does to the records that read the setting, which cost so many seconds as they
    are; all stop where they take twenty times as long.
    """
    try:
        limit = 60 + 20 * cost
        return effect(known, in_own_process(changed, some, s, factor, limit=limit))
    except TimeoutError:
        return Effect(stopped=len(some))


def effect(before: list[Seen | str], after: list[Seen | str]) -> Effect:
    """Compare all records."""
    found = extra = doubtful = moved = stopped = 0
    for one, two in zip(before, after, strict=True):
        if isinstance(one, str) or isinstance(two, str):
            stopped += isinstance(two, str) and two != one
            continue
        found += two.found - one.found
        extra += two.extra - one.extra
        doubtful += two.doubtful.size - one.doubtful.size
        same = one.frequency.size == two.frequency.size
        same &= one.doubtful.size == two.doubtful.size
        if same:
            off = np.abs(two.frequency - one.frequency) / one.deviation
            same = bool((off < MOVED).all())
        moved += not same
    return Effect(found, extra, doubtful, moved, stopped)


@dataclass(frozen=True, slots=True)
class Ablation:
    """A setting, how many records read it, and the effects of its half and its double."""

    setting: Setting
    records: int
    half: Effect
    double: Effect

    @property
    def idle(self) -> bool:
        """Whether neither has an effect."""
        return self.half == self.double == Effect()

    @property
    def line(self) -> str:
        """A line of the table."""
        value = self.setting.value
        values = value if isinstance(value, tuple) else (value,)
        number = " ".join(f"{x:g}" for x in values)
        half, double = (
            (self.half.text, self.double.text) if self.records else ("not read",) * 2
        )
        return (
            f"| {self.setting.label} | {number} | {self.records} | {half} | {double} |"
        )


def checks(settings: int, idle: int, stopped: int) -> list[Check]:
    """What is right of the settings: few, and few of them without an effect."""
    return [
        at_most("settings", settings, MOST_SETTINGS),
        at_most("without an effect", idle, MOST_IDLE),
        at_most("records that stop as they are", stopped, 0),
    ]


def page(lines: list[str], names: list[str]) -> str:
    """The table in Markdown."""
    head = """# What the settings of the ambient path do

Each number by which the path from an ambient record to its modes decides, halved and doubled alone:
modes found and extra, doubtful ones, and records of which a mode comes, goes or moves in frequency
by more than a tenth of its standard deviation. "Not read": none of the records needs it.
Written by `python bench/ablations.py`.

"""
    table = [
        "| setting | value | records that read it | half | double |",
        "|---|---|---|---|---|",
    ]
    return f"{head}Records: {', '.join(names)}.\n\n" + "\n".join(table + lines) + "\n"


def main() -> None:
    """Change one setting after the other, those first that few records read."""
    parser = arguments(__doc__)
    parser.add_argument("--only", default="", help="settings whose label has this text")
    options: argparse.Namespace = parser.parse_args()
    report = Report(options)
    settings = [x for x in all_settings() if options.only in x.label]
    tried = sized(options, settings[::10], settings, settings)
    every = cases(sized(options, 1, 1, 4))
    before: dict[str, Seen | str] = {}
    cost: dict[Setting, float] = dict.fromkeys(tried, 0.0)
    readers: dict[Setting, list[str]] = {s: [] for s in tried}
    for name, case in every.items():
        before[name], seconds, read = in_own_process(settings_read, case, tried)
        one = before[name]
        print(
            f"{name}: {one if isinstance(one, str) else (one.found, one.extra)}",
            flush=True,
        )
        for s in read:
            readers[s].append(name)
            cost[s] += seconds
    done: dict[Setting, Ablation] = {}
    for s in sorted(tried, key=cost.__getitem__):
        known = [before[name] for name in readers[s]]
        some = [every[name] for name in readers[s]]
        both = [
            effect_of(known, some, s, f, cost[s]) if some else Effect()
            for f in (0.5, 2.0)
        ]
        done[s] = Ablation(s, len(some), *both)
        print(done[s].line, flush=True)
    if tried == all_settings():
        PAGE.write_text(
            page([done[s].line for s in tried], list(every)), encoding="utf-8"
        )
    idle = sum(x.idle for x in done.values())
    stopped = sum(isinstance(x, str) for x in before.values())
    what = f"{len(tried)} settings halved and doubled, {len(every)} records"
    report.row(what, {}, checks(len(settings), idle, stopped))
    report.end()


if __name__ == "__main__":
    main()
