"""How good the elements are where they are at their limits.

    python bench/elements.py

The cases are those of `tests/verification/test_fem_solids_accuracy.py` and `test_fem_shells.py`,
with their closed forms and references. Elements of second order are good; linear ones lock where
they bend, and are bounded on one side alone: an element that passes its patch test is never too
soft, and a consistent mass puts frequencies too high.
"""

from __future__ import annotations

import sys
from pathlib import Path

from outcome import Check, Report, arguments, at_least, at_most, within

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
from test_fem_shells import hemisphere, hook, pinched, roof, twisted
from test_fem_solids_accuracy import cantilever, sliding_cube

# least tip deflection over the beam's: 10 cells of 10 x 1 x 1, and 6 slender cells that lean by 45
# degrees to and fro; largest error of ω² of the shear wave at ν = 0.3, % (linear elements are for
# filling: they have their own)
SOLIDS = {
    "CHEXA8": (0.97, 0.0, 10.0),
    "CHEXA20": (0.97, 0.9, 0.7),
    "CPENTA6": (0.97, 0.0, 20.0),
    "CPENTA15": (0.97, 0.9, 0.7),
    "CPYRAM5": (0.0, 0.0, 10.0),
    "CPYRAM13": (0.97, 0.85, 0.7),
    "CTETRA4": (0.0, 0.0, 50.0),
    "CTETRA10": (0.97, 0.9, 0.8),
}
SOFT = 1.01  # of the beam's deflection: no element is softer
TWISTED = 0.005256e6  # MacNeal and Harder's thin twisted beam
HEMISPHERE = 0.0924  # hemisphere with a hole


def solid(
    name: str, straight: float, leaning: float, wave: float, wave_incompressible: float
) -> list[Check]:
    """Deflections over the beam's, errors of ω² in %, at ν = 0.3 and 0.499."""
    least_straight, least_leaning, most = SOLIDS[name]
    return [
        within("10 cells of 10 x 1 x 1", straight, least_straight, SOFT),
        within("6 cells leaning by 45°", leaning, least_leaning, SOFT),
        within("ω² of a shear wave, ν = 0.3", wave, 0.0, most, "%"),
        at_least("the same, ν = 0.499", wave_incompressible, 0.0, "%"),
    ]


def converges(low: list[float], limit: float) -> list[Check]:
    """How much is missing in % on a mesh and on one twice as fine."""
    return [
        at_most("on the coarse mesh low by", low[0], 50.0, "%"),
        within("on one twice as fine", low[1], -1.0, limit, "%"),
    ]


def shell(card: str) -> list[Check]:
    """Deflections over the references, on a mesh with as many nodes for each card."""
    part = 1 if card in ("CQUAD4", "CTRIA3") else 2
    found = {
        "twisted beam, 12 x 2 cells, in its plane": twisted(card, 12, 2, 0.32, 3)
        / 0.005424,
        "out of its plane": twisted(card, 12, 2, 0.32, 2) / 0.001754,
        f"Scordelis-Lo roof, {16 // part} a side": roof(card, 16 // part) / 0.3024,
        f"pinched cylinder, {32 // part} a side": pinched(card, 32 // part) / 1.8248e-5,
        f"hemisphere, {16 // part} a side": hemisphere(card, 16 // part) / HEMISPHERE,
        f"Raasch's hook, {56 // part} x {8 // part}": hook(card, 56 // part, 8 // part)
        / 5.012,
    }
    least = 0.82 if card == "CTRIA3" else 0.97  # constant strain in the plane
    return [within(what, value, least, 1.03) for what, value in found.items()]


def main() -> None:
    """Run and state."""
    report = Report(arguments(__doc__).parse_args())
    for name in SOLIDS:
        straight = cantilever(name, (10, 1, 1), (100.0, 1.0, 1.0))
        leaning = cantilever(name, (6, 1, 1), (6.0, 0.1, 0.2), 0.1)
        waves = [100 * sliding_cube(name, 4, 0.2, nu) for nu in (0.3, 0.499)]
        report.row(
            f"{name}: tip deflection over that of a beam",
            {},
            solid(name, straight, leaning, *waves),
        )
    for card in ("CQUAD4", "CTRIA3", "CQUAD8", "CTRIA6"):
        report.row(f"{card}: deflection over the reference", {}, shell(card))
    beams = [
        100 * (1 - twisted("CTRIA6", 6 * n, n, 0.0032, 3) / TWISTED) for n in (2, 4)
    ]
    report.row(
        "CTRIA6, very thin twisted beam, 12 x 2 cells", {}, converges(beams, 10.0)
    )
    domes = [100 * (1 - hemisphere("CQUAD8", n) / HEMISPHERE) for n in (4, 8)]
    report.row("CQUAD8, hemisphere, 4 x 4 elements", {}, converges(domes, 1.5))
    report.end()


if __name__ == "__main__":
    main()
