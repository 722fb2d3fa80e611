"""Several setups as one structure: how often what is stated of the modes holds, merged and identified as one.

    OMP_NUM_THREADS=1 python bench/identification_setups.py [--sets 40 --minutes 30]

The system is that of `tests/verification/test_oma_setups.py`: four modes, three setups with two references in common
and three sensors that move. `merged`: each setup by `identify_ambient`, put together by `merge_modes` (PoSER). `as
one`: `preger`. Shares are of 95 % intervals that hold the truth. Not covered: frequencies that differ between setups.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
import test_oma_setups as made

from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import TimeHistory
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.identify.ambient import identify_ambient
from ringtrue.identify.merge import merge_modes


def merged(setups: list[TimeHistory]) -> tuple[ModeSet, Uncertainty]:
    """Identified one by one, then put together."""
    each = [identify_ambient(h) for h in setups]
    whole = merge_modes([(r.modes, r.uncertainty, str(k)) for k, r in enumerate(each)])
    return whole.modes, whole.uncertainty


def errors(modes: ModeSet, std: Uncertainty) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of frequencies, dampings and moduli of shapes over their deviations; of a mode that is not found nothing."""
    true, at = made.pairs(modes)
    return (
        (modes.frequencies[at] - made.F[true]) / std.frequency[at],
        (modes.damping[at] - made.Z[true]) / std.damping[at],
        made.errors(modes, std),
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=30.0)
    asked = parser.parse_args()
    sets = [made.recorded(seed, int(60 * asked.minutes * made.RATE)) for seed in range(asked.sets)]
    for name, method in (("merged", merged), ("as one", made.as_one)):
        each = [np.concatenate(e) for e in zip(*(errors(*method(setups)) for setups in sets), strict=True)]
        print(f"{name}: {each[0].size} of {len(sets) * made.F.size} modes found")
        for what, gap in zip(("frequency", "damping", "shapes"), each, strict=True):
            hold, rms = 100 * (np.abs(gap) < 1.96).mean(), np.sqrt((gap**2).mean())
            print(f"  {what:9s} {hold:5.1f} % hold the truth, error over deviation {rms:.2f} rms")


if __name__ == "__main__":
    main()
