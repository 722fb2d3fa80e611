"""A frame of three storeys whose true twin has some wrong regions, measured with noise at a few
points.

Twelve columns, each with a section and a steel of its own, carry three floors of CQUAD4 (2 x 2
elements, 4.6 x 3 m) with a machine off the middle of each; the feet stand on CBUSH. Sixteen
regions: 12 columns, 3 floors, and the four equal springs of the feet.

        +-----+   z = 9 m     channels: X and Y at three corners of each floor,
        +-----+   z = 6 m     Z at the middle and one edge of each floor
        +-----+   z = 3 m
        B     B   z = 0
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import sparse

from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.testmodel import Observation
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.io.modes import write_modes
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.parametric import ReducedModel, reduced_model
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.updating.selection.candidates import (
    Candidate,
    CandidateSettings,
    parameters,
)
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.screening import effective
from ringtrue.updating.target import Target

Array = npt.NDArray[np.float64]

X, Y = (0.0, 2.0, 4.6), (0.0, 1.5, 3.0)  # m
# of the four columns of a storey, relative; nothing is symmetric
SECTION = (1.0, 1.4, 0.8, 1.8)
CORNERS = ((0, 0), (2, 0), (0, 2), (2, 2))
STOREYS = (1, 2, 3)
FEET = 100  # material-like key of the springs
REGIONS = (
    *[10 * s + c for s in STOREYS for c in range(1, 5)],
    *[10 * s for s in STOREYS],
    FEET,
)
MODES, COUNT = 12, 20


def node(level: int, i: int, j: int) -> int:
    """Number of the node (i, j) of a floor's 3 x 3 grid; level 0 are the feet, + 50 is half a
    storey below.
    """
    return 100 * level + 1 + i + 3 * j


def _storey(level: int, factor: Mapping[int, float]) -> list[str]:
    x, y = X, Y
    lines = [
        f"GRID,{node(level, i, j)},,{x[i]},{y[j]},{3.0 * level}"
        for j in range(3)
        for i in range(3)
    ]
    lines += [
        f"GRID,{node(level, i, j) + 50},,{x[i]},{y[j]},{3.0 * level - 1.5}"
        for i, j in CORNERS
    ]
    for k, (i, j) in enumerate(CORNERS):
        low, middle, high, pid = (
            node(level - 1, i, j),
            node(level, i, j) + 50,
            node(level, i, j),
            10 * level + k + 1,
        )
        lines.append(f"CBEAM,{100 * level + 2 * k},{pid},{low},{middle},1.0,0.0,0.0")
        lines.append(
            f"CBEAM,{100 * level + 2 * k + 1},{pid},{middle},{high},1.0,0.0,0.0"
        )
        lines.append(f"MAT1,{pid},{2e11 * factor.get(pid, 1.0):.7E},,0.3,7850.0")
        a = SECTION[k] * (1.2 - 0.1 * level)
        lines.append(
            f"PBEAM,{pid},{pid},{0.014 * a:.5f},{2.2867e-5 * a:.5E},{1.1667e-5 * a:.5E},0.0,{2.8e-5 * a:.5E}"
        )
    for k, (i, j) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
        ring = [
            node(level, i, j),
            node(level, i + 1, j),
            node(level, i + 1, j + 1),
            node(level, i, j + 1),
        ]
        lines.append(
            f"CQUAD4,{100 * level + 10 + k},{10 * level}," + ",".join(map(str, ring))
        )
    lines.append(f"CONM2,{100 * level + 90},{node(level, 1, 0)},,{800.0 * level}")
    lines.append(
        f"MAT1,{10 * level},{3e10 * factor.get(10 * level, 1.0):.7E},,0.2,2500.0"
    )
    return [*lines, f"PSHELL,{10 * level},{10 * level},0.1,{10 * level},,{10 * level}"]


def deck(factor: Mapping[int, float] | None = None) -> str:
    """The bulk data, the stiffness of each region of `REGIONS` times its factor."""
    factor = factor or {}
    feet = [node(0, i, j) for i, j in CORNERS]
    lines = ["SOL 103", "CEND", "TITLE = Columns and floors", "BEGIN BULK"]
    lines += [
        f"GRID,{n},,{X[i]},{Y[j]},0.0" for n, (i, j) in zip(feet, CORNERS, strict=True)
    ]
    lines += [f"CBUSH,{900 + k},900,{n},,,,,0" for k, n in enumerate(feet)]
    k = [a * factor.get(FEET, 1.0) for a in (3e7, 3e7, 3e8, 5e6, 5e6, 5e6)]
    lines.append("PBUSH,900,K," + ",".join(f"{v:.7E}" for v in k))
    for level in STOREYS:
        lines += _storey(level, factor)
    return "\n".join([*lines, "ENDDATA"]) + "\n"


def channels() -> DofSet:
    """Where the test reads: 24 channels."""
    labels = [
        f"{node(s, i, j)}+{a}" for s in STOREYS for i, j in CORNERS[:3] for a in "XY"
    ]
    return DofSet.parse(
        [*labels, *[f"{node(s, i, 1)}+Z" for s in STOREYS for i in (1, 2)]]
    )


def read(text: str) -> Model:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.bdf"
        path.write_text(text)
        return read_deck(path)


def observation(dofs: DofSet, seen: DofSet) -> Observation:
    at, sign = dofs.align(seen)
    matrix = sparse.csr_array(
        (sign, (np.arange(at.size), at)), shape=(at.size, len(dofs))
    )
    return Observation(matrix, seen.labels(), dofs, 1.0, np.zeros(at.size))


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """The initial deck, its candidates and its reduced model."""

    model: Model
    analysis: EmbeddedAnalysis
    candidates: tuple[Candidate, ...]
    reduced: ReducedModel
    observation: Observation


@cache
def start(
    kinds: tuple[str, ...] = ("material", "property", "region", "spring"),
) -> Start:
    model = read(deck())
    analysis = EmbeddedSolver().open(model)
    modes = analysis.eigen(ModesRequest(COUNT))
    every = generate(model, CandidateSettings(kinds=kinds, units="SI"))
    keep, _ = effective(model, analysis.system, every, modes.values, modes.vectors)
    seen = observation(analysis.dofs, channels())
    return Start(
        model,
        analysis,
        keep,
        reduced_model(
            observed_system(model, analysis.system, parameters(keep), seen), COUNT
        ),
        seen,
    )


def truth(rng: np.random.Generator, wrong: int = 3) -> dict[int, float]:
    """Random regions with a stiffness 25 to 45 % too low or 35 to 80 % too high; the springs by two
    to four.
    """
    chosen = rng.choice(np.array(REGIONS), wrong, replace=False).tolist()
    up = rng.random(wrong) < 0.5
    size = np.where(up, rng.uniform(1.35, 1.8, wrong), rng.uniform(0.55, 0.75, wrong))
    soft = np.where(up, rng.uniform(2, 4, wrong), 1 / rng.uniform(2, 4, wrong))
    return {r: float(soft[k] if r == FEET else size[k]) for k, r in enumerate(chosen)}


def measured(
    wrong: Mapping[int, float],
    rng: np.random.Generator,
    f: float = 0.002,
    shape: float = 0.01,
) -> Target:
    """Modes of the true structure with noise: relative on the frequencies, of the largest component
    on the shapes.
    """
    with EmbeddedSolver().open(read(deck(wrong))) as analysis:
        modes = analysis.modes(ModesRequest(MODES)).modes
        seen = observation(analysis.dofs, channels())(modes.shapes)
    noisy = modes.frequencies * (1 + f * rng.standard_normal(MODES))
    seen = seen + shape * np.abs(seen).max(axis=0) * rng.standard_normal(seen.shape)
    return Target(noisy, seen, np.full(MODES, f), np.ones(MODES, dtype=bool))


def region_elements(region: int) -> set[int]:
    """Ids of the elements of a region."""
    if region == FEET:
        return {900, 901, 902, 903}
    level, column = divmod(region, 10)
    if column == 0:
        return {100 * level + 10 + k for k in range(4)}
    return {100 * level + 2 * (column - 1), 100 * level + 2 * (column - 1) + 1}


def write_test(
    folder: Path, frequencies: Array, shapes: Array, error: float, noise: Array
) -> None:
    """`frame.bdf`, the initial deck, `sensors.csv`, and `modes.json`.

    Stated deviations are the relative `error` of all frequencies and the `noise` (m,) of the
    shapes.
    """
    labels, m = channels().labels(), frequencies.size
    std = Uncertainty.independent(
        error * frequencies, np.full(m, 1e-3), np.broadcast_to(noise, shapes.shape)
    )
    write_modes(
        folder / "modes.json",
        ModeSet(frequencies, np.full(m, 0.01), shapes, labels),
        std,
    )
    (folder / "frame.bdf").write_text(deck())
    model = read(deck())
    at = dict(zip(model["GRID"].ids.tolist(), positions(model).tolist(), strict=True))
    rows = [label.split("+") for label in labels]
    sheet = [
        "point,x,y,z,direction",
        *(f"{n},{','.join(map(str, at[int(n)]))},{axis}" for n, axis in rows),
    ]
    (folder / "sensors.csv").write_text("\n".join(sheet) + "\n")
