"""Kills at every write of a small study, full disks, and flipped bits in its store.

    python bench/durability.py [--quick | --full]

The study is that of tests/unit/durable.py: 25 writes of stages, parameter sets, decks, summary and
report. Each write meets a kill before, half-way, when it is whole and when it is in its place, from
the beginning of the study each time; the next run must leave what an undisturbed one leaves, to the
last bit, and nothing else. Then bits of study.h5 are flipped, one at a time: a stage that is read
must be what was written, one that is not must be named, and the next run must make it anew. Not
covered: power cuts, disks that lie about what they have written, and several bits at once.
"""

from __future__ import annotations

import signal
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from outcome import ROOT, Check, Report, arguments, at_least, at_most, sized

sys.path.insert(0, str(ROOT / "tests/unit"))
import durable

HANG = 120  # s, after which reading a store ends as wrong


@dataclass(frozen=True, slots=True)
class Faults:
    """Counts of runs that met a fault.

    Attributes
    ----------
    asked, met : int
        Faults that were prepared, and runs that they ended.
    whole : int
        After which the store held whole stages alone, each as an undisturbed run makes it.
    alike : int
        After which the next run left what an undisturbed one leaves, and nothing else.
    """

    asked: int
    met: int
    whole: int
    alike: int


@dataclass(slots=True)
class Flips:
    """Counts of flipped bits.

    Attributes
    ----------
    named : int
        That made a stage unreadable, which was named.
    refused : int
        That made the file unreadable.
    wrong : int
        Results that were read and were not what was written.
    ended : int
        Readers that hung or whose process ended.
    anew, alike : int
        Runs on a damaged store, and those that left what an undisturbed one leaves.
    """

    named: int = 0
    refused: int = 0
    wrong: int = 0
    ended: int = 0
    anew: int = 0
    alike: int = 0


class Case:
    """The inputs of the study, and what an undisturbed run leaves."""

    def __init__(self, root: Path) -> None:
        self.told = root / "told"
        self.inputs, self.folder = root / "inputs", root / "study"
        durable.write_inputs(self.inputs)
        self.study, self.store = self.folder / "study.toml", self.folder / "study.h5"
        durable.copied(self.inputs, self.folder)
        self.writes = durable.writes_of(self.study)
        self.fresh = durable.results(self.study)
        self.image = self.store.read_bytes()

    def resumes(self) -> bool:
        """Whether the next run leaves what an undisturbed one leaves, and nothing else."""
        status = durable.forked(lambda: durable.whole_run(self.study))
        same = status == 0 and durable.results(self.study) == self.fresh
        return same and not durable.leftovers(self.folder)


def struck(case: Case, kinds: tuple[str, ...], every: int) -> Faults:
    """A fault of each kind at each write, or at some of them, from the beginning of the study each
    time.
    """
    asked = [(write, how) for write in case.writes for how in kinds][::every]
    met = whole = alike = 0
    for write, how in asked:
        durable.copied(case.inputs, case.folder)
        met += durable.struck(case.study, write, how) == durable.expected(how)
        whole += durable.stored(case.study).items() <= case.fresh.items()
        alike += case.resumes()
    return Faults(len(asked), met, whole, alike)


def survived(found: Faults) -> list[Check]:
    """Every fault was met, and none left a torn stage, other bits or files of its own."""
    return [
        at_least("faults that ended a run", found.met, max(found.asked, 1)),
        at_most("stores with a torn stage", found.asked - found.whole, 0),
        at_most(
            "resumed to other bits or with leftovers", found.asked - found.alike, 0
        ),
    ]


def flipped(case: Case, bits: list[int], every: int) -> Flips:
    """One bit at a time; after every so many the next run is made, too."""
    case.store.write_bytes(case.image)
    fresh = durable.read_anew(case.store)
    count = Flips()

    def read() -> None:
        signal.alarm(HANG)
        found = durable.read_anew(case.store)
        refused = [name for name, what in found.items() if what.startswith("refused: ")]
        wrong = [
            name
            for name, what in found.items()
            if name not in refused and what != fresh.get(name)
        ]
        lost = [] if "" in found else [name for name in fresh if name not in found]
        case.told.write_text(
            f"{len(wrong)} {len(refused) + len(lost)} {int('' in found)}"
        )

    for i, bit in enumerate(bits):
        case.store.write_bytes(durable.flipped(case.image, bit))
        if durable.forked(read) != 0:
            count.ended += 1
            continue
        wrong, damaged, unreadable = map(int, case.told.read_text().split())
        count.wrong += wrong
        count.refused += unreadable
        count.named += damaged > 0 and not unreadable
        if i % every == 0:
            if unreadable:  # moved away, as the message asks for
                case.store.unlink()
            count.anew += 1
            count.alike += case.resumes()
    return count


def unread(found: Flips) -> list[Check]:
    """No flipped bit is in a result that is read, and what was damaged is made anew."""
    return [
        at_most("wrong results read", found.wrong, 0),
        at_most("readers that ended or hung", found.ended, 0),
        at_least("bits that were seen", found.named + found.refused, 1),
        at_most(
            "runs on a damaged store that gave other bits", found.anew - found.alike, 0
        ),
    ]


def main() -> None:
    """Faults at writes, then flipped bits."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    with tempfile.TemporaryDirectory() as folder:
        case = Case(Path(folder).resolve())
        every = sized(options, 10, 1, 1)
        for name, kinds in (("kills", durable.KILLS), ("full disks", (durable.FULL,))):
            found = struck(case, kinds, every)
            report.row(
                f"{name} at {len(case.writes)} writes of a study",
                {name: found.met},
                survived(found),
            )
        size = sized(options, 40, 200, 5000)
        bits = (
            np.random.default_rng(0)
            .choice(8 * len(case.image), size, replace=False)
            .tolist()
        )
        durable.copied(case.inputs, case.folder)
        case.resumes()
        seen = flipped(case, bits, every=max(1, size // 20))
        report.row(
            f"flipped bits in study.h5 of {len(case.image) / 1e6:.2g} MB",
            {"bits": size, "stages named": seen.named, "files refused": seen.refused},
            unread(seen),
        )
    report.end()


if __name__ == "__main__":
    main()
