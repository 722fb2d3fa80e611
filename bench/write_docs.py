"""Run the benchmarks and write docs/benchmarks.md from what they state.

    python bench/write_docs.py [--only NAME ...] [--quick | --full]

Each benchmark runs in a process of its own with one thread and leaves its figures, date, commit and
processor in bench/results/NAME.json; the page is made of bench/benchmarks_template.md and these
files. `--only` runs those that are named, and none if no name follows: the page is then written
anew from the results that are there. Status 1 if an answer is wrong or a benchmark ends without
any. Peers: see `peer_program` in outcome.py, and $RINGTRUE_MYSTRAN.

To add a benchmark: a script that ends with `Report.end` of outcome.py, its line in `RUNS`, its name
in the template.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from outcome import ROOT, THREADS, Row, costs, figure, read_rows

RUNS = {  # name of the results: script and its options
    "modes": "bench/modes.py --kinds shell solid",
    "modes_tetra": "bench/modes.py --kinds tetra",
    "derivatives": "bench/derivatives.py",
    "past_one_machine": "bench/past_one_machine.py",
    "elements": "bench/elements.py",
    "deck_reading": "bench/deck_reading.py",
    "nastran_corpus": "bench/nastran_corpus.py",
    "results_files": "bench/results_files.py",
    "ssi_one_band": "bench/identification_peers.py one",
    "ssi_many_channels": "bench/identification_peers.py many",
    "ssi_automatic": "bench/identification_peers.py automatic",
    "ssi_deviations": "bench/identification_peers.py uncertainty",
    "ambient_accuracy": "bench/identification_ambient.py accuracy --full",
    "ambient_frame": "bench/identification_ambient.py frame",
    "ambient_uncertainty": "bench/identification_ambient.py uncertainty",
    "ambient_pairs": "bench/identification_ambient.py pairs",
    "ambient_stream": "bench/identification_ambient.py stream",
    "ambient_mixed": "bench/ambient_families.py mixed",
    "ambient_close": "bench/ambient_families.py close",
    "ambient_short": "bench/ambient_families.py short",
    "ambient_machine": "bench/ambient_families.py machine",
    "ambient_decay": "bench/ambient_families.py decay",
    "ambient_drops": "bench/ambient_families.py drops",
    "ambient_setups": "bench/ambient_families.py setups",
    "ambient_confidence": "bench/confidence.py",
    "ablations": "bench/ablations.py",
    "records": "bench/records.py",
    "setups": "bench/identification_setups.py",
    "hammer_accuracy": "bench/identification_hammer.py accuracy",
    "hammer_single": "bench/identification_hammer.py single",
    "hammer_uncertainty": "bench/identification_hammer.py uncertainty",
    "hammer_peer": "bench/identification_hammer.py peer",
    "correlation": "bench/correlation.py sets",
    "channel_faults": "bench/correlation.py faults",
    "mixed_modes": "bench/correlation.py groups",
    "localisation": "bench/localisation.py",
    "form_patterns": "bench/form_patterns.py",
    "form_coverage": "bench/form_coverage.py --full",
    "updating": "bench/updating.py starts",
    "updating_cost": "bench/updating.py cost",
    "published": "bench/published.py",
    "global_optimum": "bench/global_optimum.py",
    "uncertainty": "bench/uncertainty.py",
    "facility": "bench/facility.py --full",
    "hard_facility": "bench/hard_facility.py --full",
    "kernels": "bench/kernels.py",
    "durability": "bench/durability.py",
    "viewer": "bench/viewer.py",
    "fuzz": "scripts/fuzz",
    "studio": "bench/studio.py",
    "studio_clicks": "bench/studio_clicks.py",
}
BENCH = Path(__file__).resolve().parent
RESULTS = BENCH / "results"
TEMPLATE = BENCH / "benchmarks_template.md"
PAGE = ROOT / "docs" / "benchmarks.md"

PLACE = re.compile(
    r"^\{\{ ([\w ]+) \}\}$", re.MULTILINE
)  # a line of the template: names of results, or "runs"
HEAD = ("what", "ringtrue", "peer", "ratio", "accuracy", "limit", "command")
HEAD_RUNS = ("command", "date", "commit", "processor", "not run")


def run(name: str, size: str) -> bool:
    """Run a benchmark; whether its answers are right."""
    command = [sys.executable, *RUNS[name].split(), *([size] if size else [])]
    made = RESULTS / f"{name}.json.new"
    print(f"\n== {name}: {' '.join(command[1:])}", flush=True)
    environment = os.environ | dict.fromkeys(THREADS, "1")
    done = subprocess.run(
        [*command, "--json", str(made)], cwd=ROOT, env=environment, check=False
    )
    if made.exists():
        made.replace(RESULTS / f"{name}.json")
    else:
        print(
            f"{name} ended with status {done.returncode} and without figures: those of before stay",
            flush=True,
        )
    return done.returncode == 0


def page(read: Callable[[str], dict[str, Any] | None]) -> str:
    """The page from the template and the results that `read` gives by name (None: not run yet)."""
    stated = {name: found for name in RUNS if (found := read(name)) is not None}

    def filled(place: re.Match[str]) -> str:
        names = place[1].split()
        if names == ["runs"]:
            return table(HEAD_RUNS, [run_line(s) for s in stated.values()])
        lines = [
            line for name in names if name in stated for line in row_lines(stated[name])
        ]
        return table(HEAD, lines) if lines else "No results are stored."

    return PLACE.sub(filled, TEMPLATE.read_text(encoding="utf-8"))


def row_lines(stated: dict[str, Any]) -> list[tuple[str, ...]]:
    """The lines of a table for one run: one a row, and one more for each further peer."""
    lines = []
    for row in read_rows(stated):
        accuracy = "<br>".join(c.accuracy for c in row.checks)
        limit = "<br>".join(c.limit for c in row.checks)
        peers = [peer_cells(row, i) for i in range(len(row.peers))] or [("", "")]
        lines.append(
            (
                row.what,
                costs(row.cost),
                *peers[0],
                accuracy,
                limit,
                f"`{stated['command']}`",
            )
        )
        lines += [("", "", *cells, "", "", "") for cells in peers[1:]]
    return lines


def peer_cells(row: Row, i: int) -> tuple[str, str]:
    """Name and cost of a peer, and how many times that of ringtrue it is."""
    peer = row.peers[i]
    return f"{peer.name}: {costs(peer.cost)}", figure(row.ratio(peer))


def run_line(stated: dict[str, Any]) -> tuple[str, ...]:
    """When and where a run was, and what it left out."""
    missing = "; ".join(f"{peer} ({why})" for peer, why in stated["not_run"].items())
    return (
        f"`{stated['command']}`",
        stated["date"],
        stated["commit"],
        stated["processor"],
        missing,
    )


def table(head: tuple[str, ...], lines: list[tuple[str, ...]]) -> str:
    """In Markdown."""
    rule = tuple("---" for _ in head)
    cells = [
        [cell.replace("|", "\\|") for cell in line] for line in (head, rule, *lines)
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


def stored(name: str) -> dict[str, Any] | None:
    """The results of the last run."""
    file = RESULTS / f"{name}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


def main() -> None:
    """Run, write the page, and say what is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", nargs="*", choices=list(RUNS), metavar="NAME", help=", ".join(RUNS)
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--quick", action="store_const", dest="size", const="--quick", default=""
    )
    size.add_argument("--full", action="store_const", dest="size", const="--full")
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    names = list(RUNS) if options.only is None else options.only
    wrong = [name for name in names if not run(name, options.size)]
    PAGE.write_text(page(stored), encoding="utf-8")
    print(f"\n{PAGE.relative_to(ROOT)} is written; wrong: {', '.join(wrong) or 'none'}")
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
