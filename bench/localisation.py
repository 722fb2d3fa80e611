"""How often the truly wrong regions are among the proposed parameters, on twins of a frame with
known errors.

    python bench/localisation.py [--quick | --full]

Three of sixteen regions are wrong, 94 candidates. A region counts as named by a proposed candidate,
by a member of its cluster, or by a rival that does as well in its place, if that candidate changes
the region's elements and no others. Beside it: what a draw of as many candidates at random would
name, and how often the largest sensitivities and the orthogonal ones name as many. Seeds from 10
on: 0 to 9 were looked at while the method was made.

Not covered: errors of form (a missing stiffener), wrong sensors, repeated modes, decks of a real
size.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from outcome import Check, Peer, Report, arguments, at_least, at_most, sized

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
import localise_twin as twin

from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.selection.proposal import Proposal, propose

WRONG = 3
FIRST = 10
RULES = ("orthogonal sensitivities", "largest sensitivities", "single gain")
NAMED_LEAST = 90.0  # %, of the wrong regions
PROPOSED_MOST = 5.0  # parameters in the mean: naming everything is no answer


@dataclass(frozen=True, slots=True)
class Score:
    """Of one twin.

    Attributes
    ----------
    members, named : int
        Proposed parameters; candidates named with clusters and rivals.
    strict, share, random : float
        Share of the wrong regions named without rivals, with them, and at random.
    rules : dict of str to float
        Share that simple rules name with as many parameters.
    seconds : float
        Processor time.
    """

    members: int
    named: int
    strict: float
    share: float
    random: float
    rules: dict[str, float]
    seconds: float


def regions_of(names: Iterable[str]) -> set[int]:
    """Regions whose elements are those of one of the candidates."""
    at = {c.name: set(c.elements) for c in twin.start().candidates}
    return {
        r for r in twin.REGIONS if any(at[n] == twin.region_elements(r) for n in names)
    }


def drawn(
    rng: np.random.Generator, count: int, wrong: set[int], draws: int = 200
) -> float:
    """Share of the wrong regions that `count` candidates at random name."""
    names = [c.name for c in twin.start().candidates]
    picks = [regions_of(rng.choice(names, count, replace=False)) for _ in range(draws)]
    return float(np.mean([len(p & wrong) / len(wrong) for p in picks]))


def one(seed: int) -> Score:
    """A twin, its proposal and the score."""
    rng = np.random.default_rng(seed)
    wrong = twin.truth(rng, WRONG)
    measured = twin.measured(wrong, rng)
    begin = time.process_time()
    found: Proposal = propose(Problem((Configuration(twin.start().reduced, measured),)))
    seconds = time.process_time() - begin
    strict = {n for m in found.members for n in (m.name, *m.collinear)}
    named = {n for m in found.members for n in m.named}
    few = len(found.members)

    def share(names: Iterable[str]) -> float:
        return len(regions_of(names) & set(wrong)) / WRONG

    rules = {rule: share(found.orders[rule][:few]) for rule in RULES}
    at_random = drawn(rng, max(len(named), 1), set(wrong))
    return Score(
        few, len(named), share(strict), share(named), at_random, rules, seconds
    )


def checks(scores: list[Score]) -> list[Check]:
    """Whether the wrong regions are named, by few parameters, and better than by chance."""
    share = 100 * np.mean([s.share for s in scores])
    at_random = 100 * np.mean([s.random for s in scores])
    return [
        at_least("wrong regions named", share, NAMED_LEAST, "%"),
        at_most(
            "parameters proposed, mean",
            np.mean([s.members for s in scores]),
            PROPOSED_MOST,
        ),
        at_most("as many candidates at random", at_random, share / 2, "%"),
        at_least(
            "named without rivals",
            100 * np.mean([s.strict for s in scores]),
            at_random,
            "%",
        ),
    ]


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    count = sized(options, 2, 5, 50)
    scores = []
    for seed in range(FIRST, FIRST + count):
        scores.append(one(seed))
        print(seed, scores[-1], flush=True)
    share = 100 * float(np.mean([s.share for s in scores]))
    seconds = float(np.median([s.seconds for s in scores]))
    rules = [
        Peer(rule, {"% named": 100 * float(np.mean([s.rules[rule] for s in scores]))})
        for rule in RULES
    ]
    cost = {"% named": share, "s each": seconds}
    report.row(
        f"three wrong regions of sixteen, {count} twins", cost, checks(scores), rules
    )
    report.end()


if __name__ == "__main__":
    main()
