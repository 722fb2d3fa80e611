"""Frequencies followed through time: how often a change is told that is not there, and one that is.

    python bench/tracking.py [--quick | --full]

Records of `tests/unit/test_identify_tracking.py`: one value an hour, a daily course of the
temperature with a slope, and a scatter that is white or hangs together from hour to hour (`memory`:
its correlation). A row for three and for seven days: the share of records with a false change, that
with a step of twice the scatter told to within three hours, and the error of the slope over its
standard error. Not covered: the identification of the stretches, steady drifts.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from outcome import Check, Report, arguments, rms_over_stated, share_at_least, share_at_most, sized
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit"))
from test_identify_tracking import days

from ringtrue.identification.environment import EnvironmentFit, fit_environment

SLOPE, SCATTER, STATED, LEAD = (
    -0.004,
    0.01,
    0.002,
    100,
)  # Hz/K, Hz, Hz, values left out until the scatter is stationary
# By memory, in the long run. The test of changes is one at 1 %; a memory of 0.8 leaves few
# independent values in three days, so that more changes are told that are not there, and fewer that
# are.
FALSE_MOST = {0.0: 0.03, 0.5: 0.04, 0.8: 0.07}
FOUND_LEAST = {0.0: 0.85, 0.5: 0.55, 0.8: 0.25}


@dataclass(frozen=True, slots=True)
class Told:
    """What was told of many records.

    Attributes
    ----------
    records : int
        Without a step, and as many with one.
    false, found : int
        Records with a change that is not there; with the step within three hours.
    slope : tuple of float
        Errors over standard errors.
    """

    records: int
    false: int
    found: int
    slope: tuple[float, ...]


def fitted(hours: int, memory: float, step: float, rng: np.random.Generator) -> EnvironmentFit:
    """A frequency with a step in the middle."""
    t = days(hours, rng)
    e = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal(hours + LEAD))[LEAD:]
    f = 5 + SLOPE * (t - t.mean()) + SCATTER * e + step * (np.arange(hours) >= hours // 2)
    return fit_environment(f, np.full(hours, STATED), {"T": t})


def told(hours: int, memory: float, records: int) -> Told:
    """Of as many records with a step as without one."""
    rng = np.random.default_rng(0)
    calm = [fitted(hours, memory, 0.0, rng) for _ in range(records)]
    moved = [fitted(hours, memory, 2 * SCATTER, rng) for _ in range(records)]
    false = sum(bool(r.changes) for r in calm)
    found = sum(any(abs(c.at - hours // 2) <= 3 for c in r.changes) for r in moved)
    slope = tuple(float((r.slope[0] - SLOPE) / r.std_slope[0]) for r in calm)
    return Told(records, false, found, slope)


def checks(what: Told, memory: float) -> list[Check]:
    """Whether it is what a test at 1 % and honest standard errors should give."""
    return [
        share_at_most("false changes", what.false, what.records, FALSE_MOST[memory]),
        share_at_least("steps found", what.found, what.records, FOUND_LEAST[memory]),
        rms_over_stated("error of the slope over its standard error, rms", what.slope),
    ]


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    records = sized(options, 40, 200, 1000)
    for hours in (72, 168):
        for memory in (0.0, 0.5, 0.8):
            what = f"{records} records of {hours} h, correlation {memory} from hour to hour"
            report.row(what, {}, checks(told(hours, memory, records), memory))
    report.end()


if __name__ == "__main__":
    main()
