"""Several setups of one structure, merged: how often what is stated of the modes holds.

    python bench/identification_setups.py [--quick | --full]

The system is that of `tests/verification/test_oma_setups.py`: four modes, three setups of half an
hour with two references in common and three sensors that move. Each setup is identified by
`identify_ambient`; `merge_modes` (PoSER) joins them. Shares are of 95 % intervals that hold the
truth. Not covered: frequencies that differ between setups.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from outcome import (
    HELD_LEAST,
    Check,
    Report,
    arguments,
    rms_over_stated,
    share_at_least,
    sized,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
import test_oma_setups as made

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.identification.common.merging import merge_modes

MINUTES = 30
FOUND_LEAST = 0.97  # of the modes


def merged(setups: list[TimeHistory]) -> tuple[ModeSet, Uncertainty]:
    """Identified one by one, then put together."""
    each = [identify_ambient(h) for h in setups]
    whole = merge_modes([(r.modes, r.uncertainty, str(k)) for k, r in enumerate(each)])
    return whole.modes, whole.uncertainty


def errors(modes: ModeSet, std: Uncertainty) -> dict[str, np.ndarray]:
    """Of frequencies, dampings and moduli of shapes over their deviations; of a mode that is not
    found nothing.
    """
    true, at = made.pairs(modes)
    return {
        "frequency": (modes.frequencies[at] - made.F[true]) / std.frequency[at],
        "damping": (modes.damping[at] - made.Z[true]) / std.damping[at],
        "shapes": made.errors(modes, std),
    }


def checks(each: list[dict[str, np.ndarray]]) -> list[Check]:
    """Of the errors of every set."""
    found = sum(e["frequency"].size for e in each)
    out = [share_at_least("modes found", found, len(each) * made.F.size, FOUND_LEAST)]
    for what in ("frequency", "damping", "shapes"):
        gap = np.concatenate([e[what] for e in each])
        held = int((np.abs(gap) < 1.96).sum())
        out.append(share_at_least(f"{what} held", held, gap.size, HELD_LEAST))
        out.append(rms_over_stated(f"error over deviation of {what}, rms", gap))
    return out


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    count = sized(options, 4, 10, 40)
    sets = [made.recorded(seed, int(60 * MINUTES * made.RATE)) for seed in range(count)]
    each = [errors(*merged(setups)) for setups in sets]
    report.row(
        f"{count} sets of three setups, merged: intervals of 95 %", {}, checks(each)
    )
    report.end()


if __name__ == "__main__":
    main()
