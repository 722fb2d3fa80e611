"""Concrete frames to update: one of two storeys, made here, and the published one where its data
are.

Both have 12 groups of stiffness (columns, girders and slabs), about 2,300 degrees of freedom and 43
measured ones. Among their lowest six modes are some that hardly move these: of a slab in the
published one, of a rod on the roof in the other. The one made here, seen from above, columns at the
joints o:

    y = 5 m  o===========o==========o    storeys of 3.5 and 3.2 m; columns fixed at their feet
             |           |          |    groups of each storey: columns of each line x, girders along x,
    y = 0    o===========o==========o    girders along y, slab
           x = 0        6.0       11.1 m

The published frame (Georgia Tech) is test data under the GPL-3: it is read from ../shared and not
part of this project.
"""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from ringtrue.core.arrays import Int
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.matrices import MatrixModel

PUBLISHED = (
    Path(__file__).parents[2]
    / "shared/data/updating/concrete_frame/ConcreteBuildingFrame.mat"
)
LINES = (0.0, 6.0, 11.1)  # m, of columns
DEPTH = 5.0  # m
FLOORS = (3.5, 6.7)  # m
CELLS = (16, 9)  # of a slab along x and y
PARTS = 4  # elements of a column
YOUNG, POISSON, DENSITY = 3.0e10, 0.2, 2400.0  # Pa, -, kg/m³
COLUMN, GIRDER = (0.40, 0.30), (0.25, 0.45)  # m, width and depth
SLAB = 0.16  # m
# m: section and height of a steel rod of 50 g on the roof
ROD, HEIGHT = (0.003, 0.0045), 0.5
STEEL = 13, 2.1e11, 0.3, 7800.0  # material, Pa, -, kg/m³


def published_frame() -> tuple[MatrixModel, Int]:
    """The published matrices and the measured rows."""
    given = loadmat(PUBLISHED)
    parts = [given[f"E_{i}"] for i in range(1, 13)]
    return MatrixModel(given["K0"], given["M0"], stiffness=parts), given[
        "measDOFs"
    ].ravel().astype(np.int64) - 1


def own_frame() -> tuple[MatrixModel, Int]:
    """The matrices of the frame that is made here and the measured rows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.bdf"
        path.write_text(deck(), encoding="utf-8")
        model = read_deck(path)
    groups = ParameterSet(
        tuple(Parameter(f"E{g}", (CardField("MAT1", g, "E"),)) for g in range(1, 13))
    )
    with EmbeddedSolver().open(model) as analysis:
        system = analysis.system
        slopes = analysis.slopes(groups)
    rows = {
        dof: i
        for i, dof in enumerate(
            zip(system.free.node.tolist(), system.free.direction.tolist(), strict=True)
        )
    }
    parts = [s.stiffness for s in slopes]
    seen = np.array([rows[dof] for dof in measured()], dtype=np.int64)
    return MatrixModel(system.stiffness, system.mass, stiffness=parts), seen


def along_x() -> list[float]:
    """Stations of the slab's grid along x, m: the lines of columns are among them."""
    first = round(CELLS[0] * LINES[1] / LINES[2])
    parts = (
        np.linspace(LINES[0], LINES[1], first + 1),
        np.linspace(LINES[1], LINES[2], CELLS[0] - first + 1),
    )
    return [*parts[0].tolist(), *parts[1][1:].tolist()]


def floor_node(floor: int, i: int, j: int) -> int:
    """The node of a floor (1, 2) at station i along x and j along y."""
    return 1000 * floor + 20 * i + j + 1


def columns() -> list[tuple[int, int]]:
    """Stations (i, j) of the columns."""
    at = [along_x().index(x) for x in LINES]
    return [(i, j) for i in at for j in (0, CELLS[1])]


def column_nodes(storey: int, number: int) -> list[int]:
    """Nodes of a column of a storey (1, 2), from below; its number counts the columns of
    `columns`.
    """
    i, j = columns()[number]
    foot = 9001 + number if storey == 1 else floor_node(storey - 1, i, j)
    between = [5000 + 1000 * storey + 10 * number + k for k in range(1, PARTS)]
    return [foot, *between, floor_node(storey, i, j)]


def measured() -> list[tuple[int, int]]:
    """The 43 measured DOFs (node, direction 1..3): X, Y, Z of the joints; Y beside these on the
    girders along x.
    """
    joints = [floor_node(floor, i, j) for floor in (1, 2) for i, j in columns()]
    beside = [floor_node(2, i + 2, j) for i, j in columns()[:4]] + [
        floor_node(1, i + 2, j) for i, j in columns()[:3]
    ]
    return [(node, d) for node in joints for d in (1, 2, 3)] + [
        (node, 2) for node in beside
    ]


def deck() -> str:
    """The frame as a Nastran deck in SI units; material g belongs to group g."""
    lines = ["SOL 103", "CEND", "BEGIN BULK"]
    lines += [f"MAT1,{g},{YOUNG},,{POISSON},{DENSITY}" for g in range(1, 13)]
    for g in range(1, 11):
        width, depth = COLUMN if g <= 6 else GIRDER
        lines += [f"PBARL,{g},{g},,BAR", f",{width},{depth}"]
    lines += [f"PSHELL,{g},{g},{SLAB},{g}" for g in (11, 12)]
    stations = along_x()
    for floor, height in enumerate(FLOORS, start=1):
        for i, x in enumerate(stations):
            lines += [
                f"GRID,{floor_node(floor, i, j)},,{x},{DEPTH * j / CELLS[1]},{height}"
                for j in range(CELLS[1] + 1)
            ]
    elements: list[str] = []
    for storey in (1, 2):
        below = 0.0 if storey == 1 else FLOORS[storey - 2]
        for number, (i, j) in enumerate(columns()):
            nodes = column_nodes(storey, number)
            y = DEPTH * j / CELLS[1]
            heights = np.linspace(below, FLOORS[storey - 1], PARTS + 1)
            new = nodes[:-1] if storey == 1 else nodes[1:-1]
            of = dict(zip(nodes, heights.tolist(), strict=True))
            lines += [f"GRID,{n},,{stations[i]},{y},{of[n]}" for n in new]
            group = 3 * (storey - 1) + number // 2 + 1
            elements += [
                f"CBAR,{{}},{group},{a},{b},1.,0.,0."
                for a, b in itertools.pairwise(nodes)
            ]
        elements += _floor(storey)
    lines += _rod(elements)
    lines += [e.format(n) for n, e in enumerate(elements, start=1)]
    lines.append("SPC1,1,123456,9001,THRU,9006")
    return "\n".join([*lines, "ENDDATA"]).replace("CEND\n", "CEND\nSPC = 1\n", 1) + "\n"


def _rod(elements: list[str]) -> list[str]:
    """Cards of the rod, and its elements added to the others."""
    i, j = CELLS[0] // 4, CELLS[1] // 2
    nodes = [floor_node(2, i, j), *range(8001, 8001 + PARTS)]
    x, y = along_x()[i], DEPTH * j / CELLS[1]
    elements += [f"CBAR,{{}},13,{a},{b},1.,0.,0." for a, b in itertools.pairwise(nodes)]
    material, young, poisson, density = STEEL
    heights = (FLOORS[1] + HEIGHT * np.arange(1, PARTS + 1) / PARTS).tolist()
    return [
        f"MAT1,{material},{young},,{poisson},{density}",
        f"PBARL,13,{material},,BAR",
        f",{ROD[0]},{ROD[1]}",
        *(f"GRID,{n},,{x},{y},{z}" for n, z in zip(nodes[1:], heights, strict=True)),
    ]


def _floor(floor: int) -> list[str]:
    """Girders and slab of a floor; element numbers are filled in later."""
    out = []
    for j in (0, CELLS[1]):
        for i in range(CELLS[0]):
            ends = floor_node(floor, i, j), floor_node(floor, i + 1, j)
            out.append(f"CBAR,{{}},{6 + floor},{ends[0]},{ends[1]},0.,0.,1.")
    for x in LINES:
        i = along_x().index(x)
        for j in range(CELLS[1]):
            ends = floor_node(floor, i, j), floor_node(floor, i, j + 1)
            out.append(f"CBAR,{{}},{8 + floor},{ends[0]},{ends[1]},0.,0.,1.")
    for i in range(CELLS[0]):
        for j in range(CELLS[1]):
            corners = [
                floor_node(floor, i + a, j + b)
                for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))
            ]
            out.append(f"CQUAD4,{{}},{10 + floor}," + ",".join(str(n) for n in corners))
    return out
