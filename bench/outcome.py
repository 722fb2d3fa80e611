"""What a benchmark states: figures, peers, and answers that are right or wrong by a stated limit.

A script makes one `Report`, adds a row for each thing that it measures, and ends with
`report.end()`:

    options = arguments(__doc__).parse_args() report = Report(options) report.row("modes of a
    shell", {"s": 4.7}, [at_most("frequency off the closed form", error, 1e-6)],
               [Peer("MYSTRAN 18", {"s": 20.7})])
    report.end()

`end` prints the rows, writes them to `--json FILE` with date, commit and processor, and exits with
status 1 if an answer is wrong. A peer that is not installed is noted by `report.not_run`: that is
no wrong answer. Times are never judged. To put a script onto docs/benchmarks.md add a line to
`RUNS` in write_docs.py and its name to the template.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).resolve().parents[1]
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
Size = TypeVar("Size")
RISK = 1e-3  # chance that a right answer misses a limit of many random cases
ALLOWANCE = 0.2  # by which stated standard deviations may be off
HELD_LEAST = 0.9  # of intervals of 95 % that must hold the truth, in the long run
PEERS = "RINGTRUE_PEERS"  # a folder with a folder for each peer; see `peer_program`


@dataclass(frozen=True, slots=True)
class Check:
    """A value of an answer and the limits between which it is right.

    Attributes
    ----------
    what : str
    value : float
    low, high : float or None
        Both included; None where there is no limit on this side. A value that is not a number is
        wrong.
    unit : str
    """

    what: str
    value: float
    low: float | None
    high: float | None
    unit: str = ""

    @property
    def right(self) -> bool:
        """Whether the value lies between its limits."""
        above = self.low is None or self.value >= self.low
        below = self.high is None or self.value <= self.high
        return math.isfinite(self.value) and above and below

    @property
    def limit(self) -> str:
        """The limits in print."""
        if self.low is None and self.high is not None:
            return with_unit(f"≤ {figure(self.high)}", self.unit)
        if self.high is None and self.low is not None:
            return with_unit(f"≥ {figure(self.low)}", self.unit)
        return with_unit(
            f"{figure(self.low or 0.0)} to {figure(self.high or 0.0)}", self.unit
        )

    @property
    def accuracy(self) -> str:
        """What was found, in print."""
        return (
            f"{self.what}: "
            f"{with_unit(figure(self.value), self.unit)}{'' if self.right else ' (**wrong**)'}"
        )


def at_most(what: str, value: float, limit: float, unit: str = "") -> Check:
    """A value that is right up to the limit."""
    return Check(what, float(value), None, float(limit), unit)


def at_least(what: str, value: float, limit: float, unit: str = "") -> Check:
    """A value that is right from the limit on."""
    return Check(what, float(value), float(limit), None, unit)


def within(what: str, value: float, low: float, high: float, unit: str = "") -> Check:
    """A value that is right between two limits."""
    return Check(what, float(value), float(low), float(high), unit)


def share_at_least(what: str, count: float, of: int, least: float) -> Check:
    """A share of many cases that is right if it may come from a true share of `least`.

    The limit is the binomial quantile at `RISK`, and never less than one case: few cases bear a
    lower share than many. A case counts as independent.
    """
    from scipy.stats import binom  # 29 MB that no measured run needs

    least_count = max(binom.ppf(RISK, of, least), 1) if of else np.nan
    return at_least(
        what,
        100 * count / of if of else np.nan,
        100 * float(least_count) / max(of, 1),
        "%",
    )


def share_at_most(what: str, count: float, of: int, most: float) -> Check:
    """A share of many cases that is right if it may come from a true share of `most`; see
    `share_at_least`.
    """
    from scipy.stats import binom  # 29 MB that no measured run needs

    most_count = min(binom.ppf(1 - RISK, of, most), of - 1) if of else np.nan
    return at_most(
        what,
        100 * count / of if of else np.nan,
        100 * float(most_count) / max(of, 1),
        "%",
    )


def share_within(what: str, count: float, of: int, low: float, high: float) -> Check:
    """A share of many cases that is right if it may come from a true share between two: binomial
    quantiles at `RISK`, as in `share_at_least`.
    """
    from scipy.stats import binom  # 29 MB that no measured run needs

    percent = 100 / (of or np.nan)
    least, most = binom.ppf([RISK, 1 - RISK], of, [low, high]) * percent
    return within(what, count * percent, least, most, "%")


def rms_over_stated(
    what: str,
    errors: npt.ArrayLike,
    low: float = 1 - ALLOWANCE,
    high: float = 1 + ALLOWANCE,
) -> Check:
    """Errors over their stated standard deviations, root mean square: 1 to within the allowance.

    The limits widen by the quantiles of χ² at `RISK`: the mean square of a few errors scatters. NaN
    are left out.
    """
    from scipy.stats import chi2  # 29 MB that no measured run needs

    given = np.asarray(errors, float)
    given = given[np.isfinite(given)]
    if not given.size:
        return within(what, np.nan, low, high)
    least, most = (
        np.sqrt(chi2.ppf(p, given.size) / given.size) for p in (RISK, 1 - RISK)
    )
    return within(what, np.sqrt(np.mean(given**2)), low * least, high * most)


@dataclass(frozen=True, slots=True)
class Peer:
    """What another program took for the same: numbers by unit, as of a row."""

    name: str
    cost: dict[str, float]


@dataclass(frozen=True, slots=True)
class Row:
    """One thing that was measured.

    Attributes
    ----------
    what : str
    cost : dict of str to float
        What ringtrue took, by unit: {"s": 4.7, "GB": 0.35}. Empty where accuracy alone is measured.
    checks : tuple of Check
        At least one.
    peers : tuple of Peer
        Those that ran; compared in the first unit of `cost`.
    """

    what: str
    cost: dict[str, float]
    checks: tuple[Check, ...]
    peers: tuple[Peer, ...] = ()

    def __post_init__(self) -> None:
        if not self.checks:
            raise ValueError(
                f"{self.what}: a row states what is right; give it a check"
            )
        if self.peers and not self.cost:
            raise ValueError(
                f"{self.what}: peers are compared with what ringtrue took; give its cost"
            )

    @property
    def right(self) -> bool:
        """Whether all checks are."""
        return all(c.right for c in self.checks)

    def ratio(self, peer: Peer) -> float:
        """Peer over ringtrue, in the first unit of the row."""
        unit = next(iter(self.cost))
        return peer.cost[unit] / self.cost[unit]


def figure(value: float) -> str:
    """Three digits, without an exponent between a thousandth and a million."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    if 1e-3 <= abs(value) < 1e6:
        digits = max(2 - math.floor(math.log10(abs(value))), 0)
        text = f"{value:,.{digits}f}"
        return text.rstrip("0").rstrip(".") if "." in text else text
    return f"{value:.2g}"


def with_unit(text: str, unit: str) -> str:
    """A figure and its unit."""
    return f"{text} {unit}".strip()


def costs(cost: dict[str, float]) -> str:
    """Numbers with their units in print."""
    return ", ".join(with_unit(figure(value), unit) for unit, value in cost.items())


def arguments(text: str | None) -> argparse.ArgumentParser:
    """The options that every benchmark has; the script may add its own."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--quick", action="store_true", help="the smallest case that can still be wrong"
    )
    size.add_argument(
        "--full", action="store_true", help="the largest case, which may take hours"
    )
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    return parser


def sized(options: argparse.Namespace, quick: Size, usual: Size, full: Size) -> Size:
    """The value for the size that was asked for."""
    if options.quick:
        return quick
    return full if options.full else usual


def peer_program(name: str, program: str = "python") -> str | None:
    """Path of a peer's program, $RINGTRUE_PEERS/NAME/bin/PROGRAM, or None if it is not installed.

    The folders are environments of their own, since peers pin other versions of numpy:

        python -m venv $RINGTRUE_PEERS/pyoma-2; $RINGTRUE_PEERS/pyoma-2/bin/pip install pyoma-2

    and likewise `pyoma-toolbox`, `sdynpy` and `pynastran` ("numpy<2" with it).
    """
    folder = os.environ.get(PEERS)
    path = Path(folder) / name / "bin" / program if folder else None
    return str(path) if path and path.exists() else None


class Report:
    """The rows of one run of a script.

    Parameters
    ----------
    options : argparse.Namespace
        Of `arguments`.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self.file: Path | None = options.json
        self.rows: list[Row] = []
        self.missing: dict[str, str] = {}
        self.provenance = _provenance()

    def row(
        self,
        what: str,
        cost: dict[str, float],
        checks: Sequence[Check],
        peers: Sequence[Peer] = (),
    ) -> None:
        """Add a row and print it."""
        row = Row(what, cost, tuple(checks), tuple(peers))
        self.rows.append(row)
        print(f"{row.what}: {costs(row.cost)}".rstrip(": "))
        for peer in row.peers:
            print(
                f"  {peer.name}: {costs(peer.cost)}, {figure(row.ratio(peer))} x ringtrue"
            )
        for check in row.checks:
            print(
                f"  {'right' if check.right else 'WRONG'}: {check.accuracy}, limit {check.limit}",
                flush=True,
            )

    def not_run(self, peer: str, why: str) -> None:
        """Note a peer that is left out."""
        self.missing[peer] = why
        print(f"not run: {peer} ({why})", flush=True)

    def end(self) -> NoReturn:
        """Write what is asked for and leave the program: status 1 if an answer is wrong or there is
        none.
        """
        right = bool(self.rows) and all(row.right for row in self.rows)
        stated: dict[str, Any] = {
            **self.provenance,
            "right": right,
            "not_run": self.missing,
        }
        stated["rows"] = [asdict(row) for row in self.rows]
        if self.file:
            self.file.write_text(
                json.dumps(stated, indent=1, ensure_ascii=False) + "\n",
                encoding="utf-8",
            )
        print("all answers are right" if right else "AN ANSWER IS WRONG")
        raise SystemExit(0 if right else 1)


def read_rows(stated: dict[str, Any]) -> list[Row]:
    """The rows of a file that `Report.end` wrote."""
    rows = []
    for row in stated["rows"]:
        checks = tuple(Check(**c) for c in row["checks"])
        peers = tuple(Peer(**p) for p in row["peers"])
        rows.append(Row(row["what"], row["cost"], checks, peers))
    return rows


def _provenance() -> dict[str, Any]:
    script = Path(sys.argv[0]).resolve()
    name = (
        script.relative_to(ROOT).as_posix()
        if script.is_relative_to(ROOT)
        else script.name
    )
    options = sys.argv[1:]
    if "--json" in options:
        at = options.index("--json")
        options = options[:at] + options[at + 2 :]
    return {
        "command": " ".join([name, *options]),
        "date": datetime.date.today().isoformat(),
        "commit": _commit(),
        "processor": _processor(),
        "threads": {name: os.environ.get(name, "not set") for name in THREADS},
    }


def _commit() -> str:
    """The short hash, and whether the code has been changed since."""
    git = ["git", "-C", str(ROOT)]
    try:
        found = subprocess.run(
            [*git, "rev-parse", "--short=7", "HEAD"],
            capture_output=True,
            text=True,
            check=True,
        )
        code = ["--", "src", "bench/*.py", "scripts", "tests"]
        changed = subprocess.run(
            [*git, "status", "--porcelain", *code],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return found.stdout.strip() + (" with changes" if changed.stdout.strip() else "")


def _processor() -> str:
    """Name of the processor, and how many of its threads this process may use."""
    cores = (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count()
    )
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    fields = dict(
        tuple(s.strip() for s in line.split(":", 1)) for line in lines if ":" in line
    )
    if "model name" not in fields:
        return f"{platform.machine()}, {cores} threads"
    numbers = (
        f"family {fields.get('cpu family', '?')}, model {fields.get('model', '?')}"
    )
    return f"{fields['model name']} ({numbers}), {cores} threads"
