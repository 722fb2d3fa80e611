"""Seconds and peak memory of reading a deck of a square of CQUAD4, with pyNastran beside it if it is installed.

    python bench/deck_reading.py [--nodes 1000000] [--format small|large|free|all]

Each reading runs in a process of its own, so that its peak memory is its own. Not covered: decks with many includes,
tables of loads, and the other cards; they take the same path.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

GRID = {
    "small": "GRID    %8d        %8.4f%8.4f%8.4f\n",
    "large": "GRID*   %16d                %16.9f%16.9f*\n*       %16.9f\n",
    "free": "GRID,%d,,%.6g,%.6g,%.6g\n",
}
QUAD = {
    "small": "CQUAD4  %8d%8d%8d%8d%8d%8d\n",
    "large": "CQUAD4* %16d%16d%16d%16d*\n*       %16d%16d\n",
    "free": "CQUAD4,%d,%d,%d,%d,%d,%d\n",
}


def write_square(path: Path, nodes: int, style: str) -> int:
    """A square plate of about `nodes` nodes; returns their number."""
    n = round(nodes**0.5)
    i, j = np.divmod(np.arange(n * n), n)
    k = (i * n + j)[(i < n - 1) & (j < n - 1)] + 1
    with path.open("w") as f:
        f.write("SOL 103\nCEND\nMETHOD = 1\nBEGIN BULK\nEIGRL,1,,,10\nMAT1,1,7.+10,,.3,2700.\nPSHELL,1,1,.01,1\n")
        rows = zip((i * n + j + 1).tolist(), (i * 0.01).tolist(), (j * 0.01).tolist(), strict=True)
        f.writelines(GRID[style] % (a, x, y, 0.0) for a, x, y in rows)
        f.writelines(QUAD[style] % (a, 1, a, a + 1, a + 1 + n, a + n) for a in k.tolist())
        f.write("ENDDATA\n")
    return n * n


def ringtrue_reads(path: str) -> None:
    """The reader under test."""
    from ringtrue.io.nastran.reader import read_deck

    read_deck(path)


def pynastran_reads(path: str) -> None:
    """The field's reader."""
    from pyNastran.bdf.bdf import BDF

    model = BDF(debug=None)
    model.read_bdf(path, xref=False)


def _timed(read: Callable[[str], None], path: str, answer: multiprocessing.Queue[tuple[float, float] | str]) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    try:
        read(path)
    except ImportError as e:
        answer.put(str(e))
        return
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    answer.put((time.perf_counter() - start, used / 1024))


def measure(read: Callable[[str], None], path: Path) -> tuple[float, float] | str:
    """Seconds and MB of one reading in a fresh process, or why it could not be run."""
    context = multiprocessing.get_context("spawn")
    answer: multiprocessing.Queue[tuple[float, float] | str] = context.Queue()
    process = context.Process(target=_timed, args=(read, str(path), answer))
    process.start()
    result = answer.get()
    process.join()
    return result


def main() -> None:
    """Read decks of each format and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", type=int, default=1_000_000)
    parser.add_argument("--format", choices=[*GRID, "all"], default="all")
    chosen = parser.parse_args()
    for style in GRID if chosen.format == "all" else [chosen.format]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "square.bdf"
            count = write_square(path, chosen.nodes, style)
            size = path.stat().st_size / 1e6
            ours, peer = measure(ringtrue_reads, path), measure(pynastran_reads, path)
        if isinstance(ours, str):
            raise SystemExit(ours)
        line = f"{style:6} {count} nodes, {size:.0f} MB: ringtrue {ours[0]:.1f} s, {ours[1]:.0f} MB"
        if isinstance(peer, str):
            print(f"{line}; pyNastran is not here ({peer})")
        else:
            print(f"{line}; pyNastran {peer[0]:.1f} s, {peer[1]:.0f} MB: ratio {peer[0] / ours[0]:.1f}")


if __name__ == "__main__":
    main()
