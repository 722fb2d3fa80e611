"""How far the frequencies of a deck are from those of an endlessly fine mesh, by refining its mesh
once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.correlation.pairing import pair_modes
from ringtrue.fem.mesh import arm
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModalSolver, ModesRequest
from ringtrue.model.refine import refined

NOTED = 0.02  # of a frequency: mesh errors that are named
NAMED = 8  # modes named
RIGID = 1e-6  # of a shape that is not rigid


@dataclass(frozen=True, slots=True, eq=False)
class MeshErrors:
    """Modes of a mesh and of the same refined once.

    Attributes
    ----------
    frequencies, refined : (m,) float64, Hz
        NaN in `refined` for a rigid-body mode, and where no mode of the refined mesh has the shape.
    nodes : tuple of int
        Of the two meshes.
    """

    frequencies: Float
    refined: Float
    nodes: tuple[int, int]

    @property
    def relative(self) -> Float:
        """(m,) float64, f / f_fine - 1, positive where the mesh is too stiff; extrapolated
        (Richardson 1911).
        """
        # of the error in the size of elements: linear shapes, and lumped masses of any
        order = 2
        fine = self.refined - (self.frequencies - self.refined) / (2**order - 1)
        return np.asarray(self.frequencies / fine - 1)

    @property
    def off(self) -> Int:
        """Positions of the modes that the mesh puts off by more than `NOTED`."""
        return np.flatnonzero(np.abs(np.nan_to_num(self.relative)) > NOTED)

    def in_words(self, numbers: Int | None = None) -> str:
        """What was refined, and the modes that the mesh puts off, by their numbers (m,) if not 1,
        2, ...
        """
        if self.nodes[0] == self.nodes[1]:
            return (
                "no element of the deck would be split in a finer mesh (rods, springs, masses "
                "and rigid elements stay)"
            )
        how = "by refining it once ({} nodes to {})".format(*self.nodes)
        if not self.off.size:
            return f"the mesh puts no frequency off by more than {NOTED:.0%}, {how}"
        number = np.arange(1, self.frequencies.size + 1) if numbers is None else numbers
        names = ", ".join(
            f"{number[i]} ({self.relative[i]:+.0%})" for i in self.off[:NAMED].tolist()
        )
        more = f" and {self.off.size - NAMED} more" if self.off.size > NAMED else ""
        which = f"mode{'s' * (self.off.size > 1)} {names}{more}"
        return (
            f"the mesh puts frequencies of the deck off, {how}: {which}; parameters that are "
            "updated take that up"
        )


def mesh_errors(model: Model, modes: ModeSet, solver: ModalSolver) -> MeshErrors:
    """Refine the mesh once, solve, and pair the modes by their shapes at the nodes that both have.

    Parameters
    ----------
    model : Model
    modes : ModeSet
        Some of the modes of its whole mesh, at DOFs, ascending.
    solver : ModalSolver
        One that takes a model as it stands: embedded.

    Raises
    ------
    UnsupportedError
        If the mesh cannot be refined; see `model.refine.refined`.
    """
    fine = refined(whole_mesh(model))
    f = modes.frequencies
    nodes = model["GRID"].ids
    xyz = positions(model)
    rigid = _rigid(_translations(modes, nodes).shapes, xyz) | (
        f <= 1e-4 * f.max(initial=0.0)
    )
    out = np.full(f.size, np.nan)
    moving = np.flatnonzero(~rigid)
    if moving.size:
        own = modes.take(moving)
        band = (0.6 * float(own.frequencies[0]), 1.25 * float(own.frequencies[-1]))
        with solver.open(fine) as analysis:
            found = analysis.modes(ModesRequest(band=band)).modes
        pairs = pair_modes(_translations(own, nodes), _translations(found, nodes))
        out[moving[pairs.a]] = found.frequencies[pairs.b]
    return MeshErrors(f, out, (len(model["GRID"]), len(fine["GRID"])))


def _rigid(shapes: Any_, xyz: Float) -> Bool:
    """Which translations (3n, m) of points (n, 3) are those of one rigid body: t + ω × r."""
    basis = arm(xyz - xyz.mean(axis=0))[:, :3].reshape(-1, 6)
    u, size, _ = np.linalg.svd(
        basis / np.maximum(np.linalg.norm(basis, axis=0), np.finfo(float).tiny),
        full_matrices=False,
    )
    u = u[:, size > RIGID]  # points in a line turn about it in vain
    rest = shapes - u @ (u.T @ shapes)
    return np.asarray(
        np.linalg.norm(rest, axis=0) < RIGID * np.linalg.norm(shapes, axis=0)
    )


def _translations(modes: ModeSet, nodes: Int) -> ModeSet:
    """The modes at X, Y and Z of some nodes, in order."""
    every = DofSet(np.repeat(nodes, 3), np.tile([1, 2, 3], nodes.size))
    assert isinstance(modes.labels, DofSet)
    at, sign = modes.labels.align(every)
    return ModeSet(
        frequencies=modes.frequencies,
        damping=modes.damping,
        shapes=modes.shapes[at] * sign[:, None],
        labels=every,
        norm=modes.norm,
        source=modes.source,
    )
