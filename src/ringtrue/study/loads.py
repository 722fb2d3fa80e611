"""Static load cases of a deck as vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.checks.mass import unconstrained
from ringtrue.core.arrays import Float
from ringtrue.core.dofs import DofSet
from ringtrue.errors import InputError
from ringtrue.fem.assembly import assemble
from ringtrue.io.nastran.loads import LoadCase
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model


def load_vectors(model: Model, dofs: DofSet, cases: Sequence[LoadCase]) -> Float:
    """Loads (dof, case) float64 in the basic frame, deck units.

    Raises
    ------
    InputError
        If a load names a node that is not in the model.
    """
    out = np.zeros((len(dofs), len(cases)))
    xyz, grid = positions(model), model["GRID"]
    gravity = np.zeros((3, len(cases)))
    for j, case in enumerate(cases):
        for ld in case.loads:  # few beside the elements
            row = int(grid.find(np.array([ld.node]))[0])
            if ld.node and row < 0:
                raise InputError(f"{case.name}: {ld.card} at node {ld.node}, which is not in the deck")
            at = xyz[row] if ld.node else np.zeros(3)
            vector = np.asarray(ld.vector) @ axes(model, np.array([ld.cid]), at[None])[0]
            if ld.node:
                first = 4 if ld.card == "MOMENT" else 1
                out[dofs.find(np.full(3, ld.node), np.arange(first, first + 3)), j] += vector
            else:
                gravity[:, j] += vector
    if gravity.any():  # all masses, those at supports too, which hang on what is free by a consistent mass
        whole = assemble(unconstrained(model))
        out += whole.local.T @ (whole.mass @ (whole.rigid_body()[:, :3] @ gravity))
    return out
