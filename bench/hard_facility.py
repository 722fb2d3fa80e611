"""The harder worked example over several seeds: its bars, and whether each planted fault is named.

    python bench/hard_facility.py [--quick | --full] [--first N] [--seeds N]

Runs `ringtrue demo --hard` for each seed, one after the other. What was planted is drawn anew from
the seed and the plan of the stored study, and compared with the findings of summary.json: the
reversed channel, the swapped pair, the setup with the wrong gain, the temperature, the amplitude
and the repeated test, and no other channel. A row a seed repeats pairs and deviations of the
delivered deck, and how far ambient and hammer test deviate. Over all seeds nine of ten must name
every fault.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from facility import LARGEST_MOST, MEAN_MOST, PAIRS_LEAST, Delivered, delivered, ran
from outcome import Check, Report, arguments, at_least, at_most, sized

from ringtrue.demos.lsf import examples
from ringtrue.demos.lsf.examples import campaign_plan
from ringtrue.study.store import Store

NAMED_LEAST = 0.9  # of the seeds, in which every fault is named
# %, median |Δf| of ambient and hammer test: as published
APART_LEAST, APART_MOST = 0.1, 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class HardSeed(Delivered):
    """One run.

    Attributes
    ----------
    apart : %
        Median |Δf| of the modes of ambient and hammer test.
    macs : (%, %)
        Smallest and largest MAC of these.
    planted : dict of str to bool
        What was planted, and whether it is named.
    """

    apart: float
    macs: tuple[float, float]
    planted: dict[str, bool]

    @property
    def unnamed(self) -> list[str]:
        """What is not named."""
        return [what for what, named in self.planted.items() if not named]


def run(seed: int, folder: Path) -> HardSeed:
    """The example, and what it came to."""
    _, s = ran(folder, "--hard", "--seed", str(seed))
    tests = s["ambient_vs_hammer"]
    like = [r["mac_percent"] for r in tests]
    plan = campaign_plan(Store(folder / "study.h5").load("plan"))
    return HardSeed(
        **delivered(s),
        apart=float(np.median([abs(r["deviation_percent"]) for r in tests])),
        macs=(min(like), max(like)),
        planted=examples.named(s.get("findings", []), examples.plant(seed, plan)),
    )


def bars(got: HardSeed) -> list[Check]:
    """Of one seed."""
    return [
        at_least("pairs", got.pairs, PAIRS_LEAST),
        at_most("mean |Δf|", got.mean, MEAN_MOST, "%"),
        at_most("largest", got.largest, LARGEST_MOST, "%"),
        Check(
            "ambient and hammer, median |Δf|", got.apart, APART_LEAST, APART_MOST, "%"
        ),
    ]


def all_named(seeds: list[HardSeed]) -> list[Check]:
    """In how many seeds every fault is named."""
    share = np.mean([not s.unnamed for s in seeds])
    return [
        at_least(
            "seeds with every fault named", 100 * float(share), 100 * NAMED_LEAST, "%"
        )
    ]


def main() -> None:
    """Run and state."""
    parser = arguments(__doc__)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, help="how many")
    options = parser.parse_args()
    report = Report(options)
    seeds = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(
            options.first, options.first + (options.seeds or sized(options, 1, 2, 10))
        ):
            got = run(seed, Path(folder) / str(seed))
            seeds.append(got)
            cost = {
                "% mean |Δf|": got.mean,
                "pairs": got.pairs,
                "% mean MAC": got.mac,
                "% least MAC of ambient and hammer": got.macs[0],
                "of 7 named": len(got.planted) - len(got.unnamed),
                "s by the clock": got.seconds,
            }
            report.row(f"harder example, seed {seed}", cost, bars(got), [got.before])
    report.row(f"harder example, {len(seeds)} seeds together", {}, all_named(seeds))
    report.end()


if __name__ == "__main__":
    main()
