"""A free straight line of CBARs, which have no torsional inertia: it spins about itself without
stiffness and mass.

K − σM is singular for every σ, but by rounding it may factorise; AUTOSPC holds one DOF
(test_fem_spins). The same line is regular once it is held at one end, and once it has a corner:
then the spin moves mass.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import SingularModel
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

E, AREA, WEAK, RHO, LENGTH = 2.1e11, 1e-4, 1e-9, 7850.0, 1.0
LINES = [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.3, 0.5, 0.7)]


def bars(
    folder: Path, nodes: np.ndarray, hold: str = "", autospc: str = "YES"
) -> Model:
    """CBARs from node to node (n, 3)."""
    lines = [
        "SOL 103",
        "CEND",
        "SPC = 1",
        "METHOD = 1",
        "BEGIN BULK",
        "EIGRL,1,,,10",
        f"MAT1,1,{E:.1f},,.3,{RHO}",
    ]
    lines += [
        f"PARAM,AUTOSPC,{autospc}",
        f"PBAR,1,1,{AREA},{WEAK},2e-9,3e-9",
        f"SPC1,1,{hold},1" if hold else "$",
    ]
    lines += [
        f"GRID,{k},,{x:.12f},{y:.12f},{z:.12f}"
        for k, (x, y, z) in enumerate(nodes.tolist(), 1)
    ]
    lines += [f"CBAR,{k},1,{k},{k + 1},.3,-.5,.81" for k in range(1, len(nodes))]
    (folder / "line.bdf").write_text("\n".join([*lines, "ENDDATA", ""]))
    return read_deck(folder / "line.bdf")


def straight(axis: tuple[float, float, float], count: int) -> np.ndarray:
    return (
        np.linspace(0, LENGTH, count)[:, None] * np.array(axis) / np.linalg.norm(axis)
    )


@pytest.mark.parametrize("axis", LINES)
def test_free_line_spins(tmp_path, axis):
    """Whether or not rounding lets the matrix factorise, dense (up to 66 nodes) or sparse."""
    for count in (2, 4, 5, 8, 15, 31, 50, 60, 66, 67, 80):
        model = bars(tmp_path, straight(axis, count), autospc="NO")
        with (
            EmbeddedSolver().open(model) as analysis,
            pytest.raises(SingularModel, match="mechanism") as error,
        ):
            analysis.modes(ModesRequest(10))
        assert error.value.dofs
        assert all(name[-2:] in ("RX", "RY", "RZ") for name in error.value.dofs)


@pytest.mark.parametrize("axis", LINES)
def test_held_line(tmp_path, axis):
    """The cantilever's first frequency in its weak plane, (1.8751)² √(EI/ρA)/(2πL²); lumped mass on
    40 bars.
    """
    with EmbeddedSolver().open(
        bars(tmp_path, straight(axis, 41), "123456")
    ) as analysis:
        found = analysis.modes(ModesRequest(4)).modes.frequencies[0]
    assert found == pytest.approx(
        1.8751041**2 * np.sqrt(E * WEAK / (RHO * AREA)) / (2 * np.pi * LENGTH**2),
        rel=2e-3,
    )


@pytest.mark.parametrize("count", [5, 31, 81])
def test_free_line_with_a_corner(tmp_path, count):
    """Six rigid-body modes and no more."""
    nodes = straight((1.0, 0.0, 0.0), count)
    nodes[count // 2 + 1 :, 1] = 0.3 * (
        nodes[count // 2 + 1 :, 0] - nodes[count // 2, 0]
    )
    with EmbeddedSolver().open(bars(tmp_path, nodes)) as analysis:
        f = analysis.modes(ModesRequest(8)).modes.frequencies
    assert np.abs(f[:6]).max() < 1e-2 * f[6]
