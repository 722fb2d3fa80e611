"""How often what a study states of its result holds, on frames with known errors.

    python bench/uncertainty.py [--quick | --full]

Frames of three storeys with seven candidates, two to four of them 12 to 45 % off, once in the form
of the deck and once with a brace, a mass or a soft column that the deck does not have: a study each
of 14 noisy modes, three of them left out, with default settings. Rows: how many 90 % intervals of
the updated parameters hold the truth, bands the frequencies of modes left out and of all that were
predicted unseen, and how many right and wrong parameters are marked as not proven.

Not covered: other structures, measurement errors that are alike in several modes.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from outcome import Check, Report, arguments, share_at_least, sized
from scipy.special import stdtrit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
import localise_twin as twin

from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.results import UncertaintyStage
from ringtrue.study.run import run_study
from ringtrue.study.store import Store

STATED = ("parameters", "left out", "unseen")
# of intervals of 90 % that must hold the truth, in the long run, where the deck has the form
HELD_LEAST = 0.85
# where it has not: an error of form that moves all modes alike cannot be seen
FORM_LEAST = 0.75
MODES, LEFT_OUT, NOISE, SHAPE_NOISE = 14, 3, 0.002, 0.01
REGIONS = {f"columns {s}": [10 * s + k for k in range(1, 5)] for s in twin.STOREYS}
REGIONS |= {f"floor {s}": [10 * s] for s in twin.STOREYS} | {"feet": [twin.FEET]}
STUDY = f"""
[study]
title = "Twin"
[model]
deck = "frame.bdf"
[test]
sheet = "sensors.csv"
modes = "modes.json"
[update]
left_out = {LEFT_OUT}
"""


def truth(rng: np.random.Generator) -> dict[str, float]:
    """Factors of two to four regions."""
    wrong = rng.choice(list(REGIONS), rng.integers(2, 5), replace=False).tolist()
    return {
        name: float(rng.uniform(1.12, 1.45) ** rng.choice([-1, 1])) for name in wrong
    }


def other_form(rng: np.random.Generator) -> tuple[list[str], dict[int, float]]:
    """Cards that the deck does not have, and factors inside of a region."""
    level, (i, j) = int(rng.choice(twin.STOREYS)), twin.CORNERS[rng.integers(4)]
    kind = rng.integers(3)
    if kind == 0:
        ends = twin.node(level - 1, i, j), twin.node(level, 2 - i, j)
        return [
            f"CONROD,9001,{ends[0]},{ends[1]},1,{rng.uniform(2e-5, 1e-4):.3E}",
            "MAT1,1,2.1E11,,0.3,1.0",
        ], {}
    if kind == 1:
        return [f"CONM2,9001,{twin.node(level, i, j)},,{rng.uniform(200, 800):.1f}"], {}
    return [], {10 * level + int(rng.integers(1, 5)): float(rng.uniform(0.3, 0.6))}


def candidates() -> str:
    """Of the study."""
    fields = {n: [f"MAT1 {i} E" for i in ids] for n, ids in REGIONS.items()}
    fields["feet"] = ["PBUSH 900 K1,K2,K3,K4,K5,K6"]
    return "".join(
        f'[[candidate]]\nname = "{n}"\ntargets = {t}\n' for n, t in fields.items()
    )


def write(
    folder: Path, factors: dict[int, float], cards: list[str], rng: np.random.Generator
) -> None:
    """Deck, sheet, measured modes and study."""
    built = twin.deck(factors).replace("ENDDATA", "\n".join([*cards, "ENDDATA"]))
    channels = twin.channels()
    model = twin.read(built)
    with EmbeddedSolver().open(model) as analysis:
        modes = analysis.modes(ModesRequest(MODES)).modes
        seen = twin.observation(analysis.dofs, channels)(modes.shapes)
    f = modes.frequencies * (1 + NOISE * rng.standard_normal(MODES))
    noise = SHAPE_NOISE * np.abs(seen).max(axis=0)
    seen = seen + noise * rng.standard_normal(seen.shape)
    twin.write_test(folder, f, seen, NOISE, noise)
    (folder / "study.toml").write_text(STUDY + candidates())


def counts(found: UncertaintyStage, true: dict[str, float]) -> Counter[str]:
    """What holds and how much there is of it."""
    out: Counter[str] = Counter()
    right = np.array([true.get(n, 1.0) for n in found.posterior.parameters.names])
    out["parameters"] = right.size
    out["parameters held"] = int(
        (
            (found.posterior.interval[:, 0] <= right)
            & (right <= found.posterior.interval[:, 1])
        ).sum()
    )
    for name, those in (("right", right == 1.0), ("wrong", right != 1.0)):
        out[name], out[f"{name} marked"] = (
            int(those.sum()),
            int((found.unproven & those).sum()),
        )
    left_out = ~found.bands.used & np.isfinite(found.bands.predicted)
    out["left out"], out["left out held"] = (
        int(left_out.sum()),
        int((found.bands.inside & left_out).sum()),
    )
    held, unseen = found.held, np.isfinite(found.held.predicted)
    reach = stdtrit(held.freedom, 0.5 + found.level / 2)
    size = np.sqrt(held.parameter_std**2 + held.test_std**2 + held.model_std**2)
    out["unseen"], out["unseen held"] = (
        int(unseen.sum()),
        int((np.abs(held.error) < reach * size)[unseen].sum()),
    )
    return out


def one(seed: int, form: bool) -> Counter[str]:
    """A structure, its study and what holds."""
    rng = np.random.default_rng([seed, form])
    true = truth(rng)
    factors = {i: a for name, a in true.items() for i in REGIONS[name]}
    cards, inside = other_form(rng) if form else ([], {})
    factors |= {i: a * factors.get(i, 1.0) for i, a in inside.items()}
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), factors, cards, rng)
        run_study(Path(folder) / "study.toml", until="uncertainty")
        found = Store(Path(folder) / "study.h5").load("uncertainty")
    return counts(found, true) if found is not None else Counter()


def checks(n: Counter[str], form: bool) -> list[Check]:
    """Whether intervals hold what they say."""
    least = FORM_LEAST if form else HELD_LEAST
    return [
        share_at_least(f"{what} held", n[f"{what} held"], n[what], least)
        for what in STATED
    ]


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    seeds = range(sized(options, 2, 4, 20))
    for form in (False, True):
        n = sum((one(seed, form) for seed in seeds), Counter())
        marked = {
            f"of {n[w]} {w} marked not proven": float(n[f"{w} marked"])
            for w in ("right", "wrong")
        }
        name = "another form than" if form else "the form of"
        report.row(
            f"{len(seeds)} frames of {name} the deck: intervals of 90 %",
            marked,
            checks(n, form),
        )
    report.end()


if __name__ == "__main__":
    main()
