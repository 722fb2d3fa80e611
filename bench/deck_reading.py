"""Processor seconds and peak memory of reading a deck of a square of CQUAD4, beside pyNastran if it
is installed.

    python bench/deck_reading.py [--quick | --full]

The deck is written in fixed fields of eight and of sixteen characters and in free ones. Each
reading runs in a process of its own, so that its peak memory is its own. It is right if every node
stands where it was written, with its number, and every element joins the nodes that it was written
with. Not covered: decks with many includes, tables of loads, and the other cards; they take the
same path.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from outcome import Check, Peer, Report, arguments, at_most, peer_program, sized

STEP = 0.01  # m between nodes
DIGITS = 1e-9  # m; places have two decimals, which every format holds

STYLES = {"small": "fields of 8", "large": "fields of 16", "free": "free fields"}
GRID = {
    "small": "GRID    %8d        %8.4f%8.4f%8.4f\n",
    "large": "GRID*   %16d                %16.9f%16.9f*\n*       %16.9f\n",
    "free": "GRID,%d,,%.4f,%.4f,%.4f\n",
}
QUAD = {
    "small": "CQUAD4  %8d%8d%8d%8d%8d%8d\n",
    "large": "CQUAD4* %16d%16d%16d%16d*\n*       %16d%16d\n",
    "free": "CQUAD4,%d,%d,%d,%d,%d,%d\n",
}


# run by each program's own interpreter: seconds and MB, and what was read to a file
TIMED = """
import resource, sys, time
import numpy as np
{imports}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
start = time.process_time()
{read}
seconds = time.process_time() - start
megabytes = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
{arrays}
np.savez(sys.argv[2], nodes=nodes, xyz=xyz, elements=elements, joined=joined)
print("result", seconds, megabytes)
"""
OURS = TIMED.format(
    imports="from ringtrue.decks.nastran.reader import read_deck",
    read="model = read_deck(sys.argv[1])",
    arrays="""
grid, quads = model["GRID"], model["CQUAD4"]
nodes, xyz = grid.ids, np.column_stack([grid["X1"], grid["X2"], grid["X3"]])
elements, joined = quads.ids, np.column_stack([quads["G1"], quads["G2"], quads["G3"], quads["G4"]])
""",
)
PYNASTRAN = TIMED.format(
    imports="from pyNastran.bdf.bdf import BDF",
    read="model = BDF(debug=None)\nmodel.read_bdf(sys.argv[1], xref=False)",
    arrays="""
nodes = np.array(list(model.nodes))
xyz = np.array([n.xyz for n in model.nodes.values()])
elements = np.array(list(model.elements))
joined = np.array([e.nodes for e in model.elements.values()])
""",
)


@dataclass(frozen=True, slots=True, eq=False)
class Square:
    """What a deck holds: numbers and places of nodes, numbers of elements and of their nodes."""

    nodes: np.ndarray
    xyz: np.ndarray
    elements: np.ndarray
    joined: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Seconds, MB, and what was read."""

    seconds: float
    memory: float
    square: Square


def made(nodes: int) -> Square:
    """A square plate of about `nodes` nodes."""
    n = round(nodes**0.5)
    i, j = np.divmod(np.arange(n * n), n)
    first = (i * n + j)[(i < n - 1) & (j < n - 1)] + 1
    joined = np.column_stack([first, first + 1, first + 1 + n, first + n])
    xyz = np.column_stack([i * STEP, j * STEP, np.zeros(n * n)])
    return Square(np.arange(n * n) + 1, xyz, first, joined)


def write(path: Path, square: Square, style: str) -> None:
    """The deck in one of the formats."""
    with path.open("w") as f:
        f.write(
            "SOL 103\nCEND\nMETHOD = 1\nBEGIN "
            "BULK\nEIGRL,1,,,10\nMAT1,1,7.+10,,.3,2700.\nPSHELL,1,1,.01,1\n"
        )
        rows = zip(square.nodes.tolist(), square.xyz.tolist(), strict=True)
        f.writelines(GRID[style] % (number, *place) for number, place in rows)
        quads = zip(square.elements.tolist(), square.joined.tolist(), strict=True)
        f.writelines(QUAD[style] % (number, 1, *corners) for number, corners in quads)
        f.write("ENDDATA\n")


def checks(read: Square, written: Square) -> list[Check]:
    """Whether all of the deck is there, where it belongs."""
    same_nodes = np.array_equal(read.nodes, written.nodes)
    wrong = written.elements.size
    if np.array_equal(read.elements, written.elements):
        wrong = int((read.joined != written.joined).any(axis=1).sum())
    off = np.abs(read.xyz - written.xyz).max() if same_nodes else np.nan
    return [
        at_most("nodes off by", off, DIGITS, "m"),
        at_most("elements wrong", wrong, 0),
    ]


def measure(python: str, text: str, path: Path) -> Reading | str:
    """One reading in a fresh process, or why it could not be run."""
    found = path.with_suffix(".npz")
    done = subprocess.run(
        [python, "-c", text, str(path), str(found)],
        capture_output=True,
        text=True,
        check=False,
    )
    stated = [
        line.split()[1:]
        for line in done.stdout.splitlines()
        if line.startswith("result")
    ]
    if not stated:
        return (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
    with np.load(found) as arrays:
        square = Square(*(arrays[k] for k in ("nodes", "xyz", "elements", "joined")))
    return Reading(float(stated[0][0]), float(stated[0][1]), square)


def case(style: str, nodes: int, report: Report, folder: Path) -> None:
    """Both programs on one deck."""
    path = folder / "square.bdf"
    written = made(nodes)
    write(path, written, style)
    what = (
        f"{STYLES[style]}, {written.nodes.size / 1e6:.2g} million nodes, "
        f"{path.stat().st_size / 1e6:.0f} MB"
    )
    ours = measure(sys.executable, OURS, path)
    if isinstance(ours, str):
        raise SystemExit(ours)
    peers = []
    python = peer_program("pynastran")
    theirs = measure(python, PYNASTRAN, path) if python else "not installed"
    if isinstance(theirs, str):
        report.not_run("pyNastran", theirs)
    else:
        peers = [Peer("pyNastran", {"s": theirs.seconds, "MB": theirs.memory})]
    report.row(
        what,
        {"s": ours.seconds, "MB": ours.memory},
        checks(ours.square, written),
        peers,
    )


def main() -> None:
    """Read decks of each format."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    for style in GRID:
        with tempfile.TemporaryDirectory() as folder:
            case(
                style, sized(options, 20_000, 200_000, 1_000_000), report, Path(folder)
            )
    report.end()


if __name__ == "__main__":
    main()
