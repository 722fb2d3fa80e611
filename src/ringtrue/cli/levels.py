"""One test at several force levels: is the structure linear, and how do frequency and damping
change?
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.api.measurements import TestModes, compare_levels
from ringtrue.cli.show import out, rows, tell, write_json
from ringtrue.core.arrays import Float
from ringtrue.errors import ConfigError
from ringtrue.identification.common.tracking import LevelDependence
from ringtrue.io.modes import modes_to_json


def check_levels(levels: Sequence[float], files: int) -> None:
    """Refuse force levels that are not one a file, positive and different."""
    if len(levels) != files or files < 2:
        raise ConfigError(
            f"--level: {len(levels)} levels for {files} files; two files or more and one level each"
        )
    if not all(0 < x < float("inf") for x in levels) or len(set(levels)) != len(levels):
        raise ConfigError(
            f"--level {' '.join(f'{x:g}' for x in levels)}: must be positive and different"
        )


def print_comparison(
    levels: Sequence[float], files: Sequence[Path], tests: Sequence[TestModes], json: str | None
) -> int:
    """Print or write the modes of the lowest level followed over all levels; the exit status."""
    table = compare_levels(levels, tests)
    lowest = tests[int(np.argmin(levels))]
    if json:
        write_json(modes_to_json(lowest.modes, lowest.uncertainty) | levels_json(table), json)
    if json != "-":
        print_levels(table)
        tell(f"{p}: {note}" for p, test in zip(files, tests, strict=True) for note in test.notes)
    return 0 if len(lowest) else 1


def print_levels(table: LevelDependence) -> None:
    """Frequency and damping at each level, the change with the level, and whether a linear
    structure explains it.
    """
    levels = " ".join(f"{x:g}" for x in table.levels)
    heads = ("#", "f [Hz]", "% a doubling", "damping [%]", "% a doubling")
    body: list[tuple[object, ...]] = []
    for k in range(table.linear.size):
        f, z = table.frequency[:, k], 100 * table.damping[:, k]
        body.append(
            (
                k + 1,
                " ".join(f"{x:.5g}" for x in f),
                _slope(table.slope_frequency[k], table.std_slope_frequency[k]),
                " ".join(f"{x:.3f}" for x in z),
                _slope(table.slope_damping[k], table.std_slope_damping[k]),
            )
        )
    rows(f"at force levels {levels}", heads, body)
    for k in range(table.linear.size):
        out.print(f"{k + 1}: {_verdict(table, k)}")


def _slope(slope: float, std: float) -> str:
    """Per cent for twice the force, from d ln x / d ln F."""
    return f"{100 * (2**slope - 1):+.3g} ± {100 * np.log(2) * std:.2g}"


def _verdict(table: LevelDependence, k: int) -> str:
    if np.isfinite(table.frequency[:, k]).sum() < 2:
        return "found at one level only"
    chance = min(table.chance_frequency[k], table.chance_damping[k])
    return "linear" if table.linear[k] else f"not linear: chance {chance:.1g}"


def levels_json(table: LevelDependence) -> dict[str, Any]:
    """The same for JSON; null where a mode was not found."""

    def plain(x: Float) -> list[float | None]:
        return [float(v) if np.isfinite(v) else None for v in x]

    modes = [
        {
            "frequency_hz": plain(table.frequency[:, k]),
            "damping": plain(table.damping[:, k]),
            "slope_frequency": plain(table.slope_frequency[k : k + 1])[0],
            "std_slope_frequency": plain(table.std_slope_frequency[k : k + 1])[0],
            "slope_damping": plain(table.slope_damping[k : k + 1])[0],
            "std_slope_damping": plain(table.std_slope_damping[k : k + 1])[0],
            "linear": bool(table.linear[k]),
        }
        for k in range(table.linear.size)
    ]
    return {"levels": table.levels.tolist(), "level_dependence": modes}
