"""Frequencies followed through time: how often a change is told that is not there, and one that is.

    python bench/tracking.py [--records 200]

Records of `tests/unit/test_identify_tracking.py`: one value an hour, a daily course of the temperature with a slope,
and a scatter that is white or hangs together from hour to hour (`memory`: its correlation). Prints, for three and seven
days, the share of records with a false change, that with a step of twice the scatter told to within three hours, and
the error of the slope over its standard error. Not covered: the identification of the stretches, steady drifts.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit"))
from test_identify_tracking import days

from ringtrue.identify.environment import EnvironmentFit, fit_environment

SLOPE, SCATTER, STATED, LEAD = -0.004, 0.01, 0.002, 100  # Hz/K, Hz, Hz, values left out until the scatter is stationary


def fitted(hours: int, memory: float, step: float, rng: np.random.Generator) -> EnvironmentFit:
    """A frequency with a step in the middle."""
    t = days(hours, rng)
    e = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal(hours + LEAD))[LEAD:]
    f = 5 + SLOPE * (t - t.mean()) + SCATTER * e + step * (np.arange(hours) >= hours // 2)
    return fit_environment(f, np.full(hours, STATED), {"T": t})


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=200)
    records = parser.parse_args().records
    for hours in (72, 168):
        for memory in (0.0, 0.5, 0.8):
            rng = np.random.default_rng(0)
            calm = [fitted(hours, memory, 0.0, rng) for _ in range(records)]
            moved = [fitted(hours, memory, 2 * SCATTER, rng) for _ in range(records)]
            false = 100 * np.mean([bool(r.changes) for r in calm])
            found = 100 * np.mean([any(abs(c.at - hours // 2) <= 3 for c in r.changes) for r in moved])
            z = np.sqrt(np.mean([((r.slope[0] - SLOPE) / r.std_slope[0]) ** 2 for r in calm]))
            print(f"{hours} h, memory {memory}: false {false:4.1f} %, step found {found:5.1f} %, slope {z:.2f}")


if __name__ == "__main__":
    main()
