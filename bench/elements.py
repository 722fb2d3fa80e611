"""How good the elements are where they are at their limits: the table of docs/theory/solids.md, limits of shells.md.

    python bench/elements.py

The cases are those of `tests/verification/test_fem_solids_accuracy.py` and `test_fem_shells.py`, which assert bounds.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
from test_fem_shells import hemisphere, twisted
from test_fem_solids_accuracy import cantilever, sliding_cube

SOLIDS = ("CHEXA8", "CHEXA20", "CPENTA6", "CPENTA15", "CPYRAM5", "CPYRAM13", "CTETRA4", "CTETRA10")


def main() -> None:
    """Print."""
    print("element    10 x 1 x 1 cells   leaning by 45°   ω², ν = 0.3   ω², ν = 0.499")
    for name in SOLIDS:
        straight = cantilever(name, (10, 1, 1), (100.0, 1.0, 1.0))
        leaning = cantilever(name, (6, 1, 1), (6.0, 0.1, 0.2), 0.1)
        cubes = [100 * sliding_cube(name, 4, 0.2, nu) for nu in (0.3, 0.499)]
        print(f"{name:10s} {straight:16.3f} {leaning:16.3f} {cubes[0]:11.2f} % {cubes[1]:12.2f} %", flush=True)
    for across in (2, 4):
        low = 100 * (1 - twisted("CTRIA6", 6 * across, across, 0.0032, 3) / 0.005256e6)
        print(f"CTRIA6, thin twisted beam, {6 * across} x {across} cells: {low:.1f} % low")
    for n in (4, 8):
        print(f"CQUAD8, hemisphere, {n} x {n} elements: {100 * (1 - hemisphere('CQUAD8', n) / 0.0924):.1f} % low")


if __name__ == "__main__":
    main()
