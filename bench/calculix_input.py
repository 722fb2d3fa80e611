"""Decks of solids and shells of isotropic material as input of CalculiX, and its results.

CHEXA become C3D8I and C3D20, CPENTA C3D6 and C3D15, CTETRA C3D4 and C3D10, CQUAD4 S4 and CTRIA3 S3,
which CalculiX expands into solids. Loads are the forces at nodes that ringtrue makes of those of
the deck.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.constraints import equations, supports
from ringtrue.fem.element_cards import ELEMENTS, mesh
from ringtrue.model.model import Model

KINDS = {  # by card and how many nodes there are
    ("CHEXA", 8): "C3D8I",
    ("CHEXA", 20): "C3D20",
    ("CPENTA", 6): "C3D6",
    ("CPENTA", 15): "C3D15",
    ("CTETRA", 4): "C3D4",
    ("CTETRA", 10): "C3D10",
    ("CQUAD4", 4): "S4",
    ("CTRIA3", 3): "S3",
}
# edges between the two ends come before those of the second end in a deck, behind them in CalculiX
MOVED = {"C3D20": np.r_[0:12, 16:20, 12:16], "C3D15": np.r_[0:9, 12:15, 9:12]}
PROPERTIES = {"CQUAD4": "PSHELL", "CTRIA3": "PSHELL"}
CORNERS = {"CHEXA": 8, "CPENTA": 6, "CTETRA": 4, "CQUAD4": 4, "CTRIA3": 3}


class OtherDeck(Exception):
    """A deck that is not translated, and why."""


def written(model: Model) -> str:
    """The input of a model, without its steps.

    Raises
    ------
    OtherDeck
        If it has other elements, materials, constraints or frames than are translated.
    """
    cards = [card for card in ELEMENTS if card in model]
    other = [card for card in cards if card not in CORNERS]
    m = mesh(model)
    grid = model["GRID"]
    if other or not cards or equations(m).dependent.size:
        raise OtherDeck(f"{', '.join(other) or 'rigid elements or MPC'} not translated")
    if grid["CD"].any():
        raise OtherDeck("displacement frames not translated")
    text = "".join(_elements(model, card) for card in cards)
    used = _used(model)
    at = np.flatnonzero(np.isin(grid.ids, used))
    nodes = zip(grid.ids[at].tolist(), m.xyz[at].tolist(), strict=True)
    text = (
        "*NODE,NSET=ALL\n"
        + "".join(f"{i},{x!r},{y!r},{z!r}\n" for i, (x, y, z) in nodes)
        + text
    )
    held = supports(m)[: 6 * len(grid)].reshape(-1, 6)[at]
    for i, fixed in zip(grid.ids[at].tolist(), held, strict=True):
        text += "".join(
            f"*BOUNDARY\n{i},{c + 1}\n" for c in np.flatnonzero(fixed).tolist()
        )
    return text


def _elements(model: Model, card: str) -> str:
    table = model[card]
    columns = [c for c in table.columns if c[0] == "G" and c[1:].isdigit()]
    every = table.stack(*columns)
    middles = (every[:, CORNERS[card] :] > 0).any(axis=1)
    kind_of_property = PROPERTIES.get(card, "PSOLID")
    row = np.array([-1])
    if kind_of_property in model:
        row = model[kind_of_property].find(table["PID"])
    if (row < 0).any():
        raise OtherDeck("laminates not translated")
    text = ""
    for at in np.unique(row).tolist():
        for second in (False, True):
            mine = np.flatnonzero((row == at) & (middles == second))
            kind = KINDS.get((card, len(columns) if second else CORNERS[card]))
            if not mine.size:
                continue
            if kind is None or (second and (every[mine] == 0).any()):
                raise OtherDeck(f"{card} with some of its midside nodes not translated")
            name = f"{card}{at}{int(second)}"
            nodes = every[mine][:, : every.shape[1] if second else CORNERS[card]]
            nodes = nodes[:, MOVED[kind]] if kind in MOVED else nodes
            text += f"*ELEMENT,TYPE={kind},ELSET={name}\n"
            for i, g in zip(table.ids[mine].tolist(), nodes.tolist(), strict=True):
                split = [*map(str, [i, *g[:14]])], [*map(str, g[14:])]
                text += ",\n".join(",".join(part) for part in split if part) + "\n"
            text += _material(model, card, at, name)
    return text


def _material(model: Model, card: str, row: int, name: str) -> str:
    shell = card in PROPERTIES
    properties = model["PSHELL" if shell else "PSOLID"]
    number = properties["MID1" if shell else "MID"][row]
    at = int(model["MAT1"].find(np.array([number]))[0]) if "MAT1" in model else -1
    if at < 0:
        raise OtherDeck("materials other than MAT1 not translated")
    mat = model["MAT1"]
    if np.isnan([mat["E"][at], mat["NU"][at]]).any():
        raise OtherDeck("MAT1 without E or NU not translated")
    density = float(mat["RHO"][at] * model.param("WTMASS", 1.0)) or 1e-30
    section = "SHELL" if shell else "SOLID"
    text = f"*MATERIAL,NAME=M{name}\n*ELASTIC\n{mat['E'][at]!s},{mat['NU'][at]!s}\n"
    text += f"*DENSITY\n{density!r}\n*{section} SECTION,ELSET={name},MATERIAL=M{name}\n"
    return text + (f"{properties['T'][row]!s}\n" if shell else "")


def _used(model: Model) -> Int:
    tables = [model[card] for card in CORNERS if card in model]
    return np.unique(
        np.concatenate(
            [t[c] for t in tables for c in t.columns if c[0] == "G" and c[1:].isdigit()]
        )
    )


def frequency_step(count: int) -> str:
    """The lowest modes."""
    return f"*STEP\n*FREQUENCY\n{count}\n*END STEP\n"


def static_steps(model: Model, acting: Float) -> str:
    """Forces and moments (dof, case) at the nodes, a step a case."""
    ids = model["GRID"].ids
    used = np.isin(ids, _used(model))
    text = ""
    for case in acting.T:
        forces = case[: 6 * ids.size].reshape(-1, 6)
        text += "*STEP\n*STATIC\n*CLOAD,OP=NEW\n"
        for i, c in np.argwhere((forces != 0) & used[:, None]).tolist():
            text += f"{ids[i]},{c + 1},{forces[i, c]:.12e}\n"
        text += "*NODE PRINT,NSET=ALL\nU\n*END STEP\n"
    return text


def run(program: str, folder: Path, text: str) -> str:
    """The table of results, `m.dat`; "" if the program ends without any."""
    (folder / "m.inp").write_text(text)
    subprocess.run(
        [program, "m"], cwd=folder, capture_output=True, check=False, timeout=600
    )
    results = folder / "m.dat"
    return results.read_text() if results.exists() else ""


def frequencies(results: str) -> Float:
    """(m,) Hz; none where Lanczos failed on a small model, all of which are 0 then."""
    rows = (line.split() for line in results.splitlines())
    found = np.array([float(r[3]) for r in rows if len(r) == 5 and r[0].isdigit()])
    return found if found.any() else np.zeros(0)


def displacements(results: str, nodes: Int) -> list[Float]:
    """Translations (node, 3) of each case; 0 at nodes that have none."""
    out = []
    for block in results.split("displacements (vx,vy,vz)")[1:]:
        rows = [line.split() for line in block.splitlines()]
        moved = {
            int(r[0]): [float(x) for x in r[1:]]
            for r in rows
            if len(r) == 4 and r[0].isdigit()
        }
        out.append(np.array([moved.get(i, [0.0] * 3) for i in nodes.tolist()]))
    return out
