"""How often the truly wrong regions are among the proposed parameters, on twins of a frame with known errors.

    OMP_NUM_THREADS=1 python bench/localisation.py [--seeds 10 --wrong 3 --json FILE]

A region counts as named by a proposed candidate, by a member of its cluster, or by a rival that does as well in its
place, if that candidate changes the region's elements and no others. Beside it: what a draw of as many candidates at
random would name, and how often the largest sensitivities and the orthogonal ones name as many.

Not covered: errors of form (a missing stiffener), wrong sensors, repeated modes, decks of a real size.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
import localise_twin as twin

from ringtrue.update.proposal import Proposal, propose


def regions_of(names: Iterable[str]) -> set[int]:
    """Regions whose elements are those of one of the candidates."""
    at = {c.name: set(c.elements) for c in twin.start().candidates}
    return {r for r in twin.REGIONS if any(at[n] == twin.region_elements(r) for n in names)}


def drawn(rng: np.random.Generator, count: int, wrong: set[int], draws: int = 200) -> float:
    """Share of the wrong regions that `count` candidates at random name."""
    names = [c.name for c in twin.start().candidates]
    picks = [regions_of(rng.choice(names, count, replace=False)) for _ in range(draws)]
    return float(np.mean([len(p & wrong) / len(wrong) for p in picks]))


def one(seed: int, count: int) -> dict[str, object]:
    """A twin, its proposal and the score."""
    rng = np.random.default_rng(seed)
    wrong = twin.truth(rng, count)
    aim = twin.measured(wrong, rng)
    begin = time.process_time()
    found: Proposal = propose(twin.start().reduced, aim)
    seconds = time.process_time() - begin
    strict = {n for m in found.members for n in (m.name, *m.alike)}
    named = {n for m in found.members for n in m.named}
    few = len(found.members)
    return {
        "seed": seed,
        "wrong": {str(k): round(v, 2) for k, v in wrong.items()},
        "proposed": [m.name for m in found.members],
        "members": few,
        "named": len(named),
        "strict": len(regions_of(strict) & set(wrong)) / count,
        "share": len(regions_of(named) & set(wrong)) / count,
        "random": drawn(rng, max(len(named), 1), set(wrong)),
        **{r: len(regions_of(o[:few]) & set(wrong)) / count for r, o in found.orders.items()},
        "seconds": round(seconds, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--wrong", type=int, default=3)
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    rows = []
    for seed in range(a.first, a.first + a.seeds):
        rows.append(one(seed, a.wrong))
        print(json.dumps(rows[-1]), flush=True)
    keys = (
        "members",
        "named",
        "strict",
        "share",
        "random",
        "LASSO",
        "orthogonal sensitivities",
        "largest sensitivities",
        "single gain",
    )
    total = {k: round(float(np.mean([float(str(r[k])) for r in rows])), 3) for k in keys}
    total["all named"] = int(sum(r["share"] == 1 for r in rows))
    print(json.dumps({"candidates": len(twin.start().candidates), **total}))
    if a.json:
        a.json.write_text(json.dumps({"rows": rows, "mean": total}, indent=1) + "\n")


if __name__ == "__main__":
    main()
