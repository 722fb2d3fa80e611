"""Elements that are stiffer than what they stand for, by their theory and not by their shape."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Float
from ringtrue.model.frames import positions
from ringtrue.model.model import Model

_TRIANGLES = ("CTRIA3", "CTRIAR")
_LINEAR = "has four nodes and constant strain, too stiff in bending: ten nodes bend well"
_THICK = (
    "is thicker than its sides and has no transverse shear flexibility here (MID3 = MID2), as a "
    "thick plate needs: "
    "CQUAD4, CTRIA6 and laminates have it"
)


def stiff_findings(model: Model) -> Iterator[Finding]:
    """Tetrahedra of four nodes, and thick triangles whose PSHELL asks for a shear flexibility that
    they do not have.
    """
    if "CTETRA" in model:
        rows = np.flatnonzero(model["CTETRA"]["G5"] == 0)
        if rows.size:
            yield at_rows(model, "CTETRA", rows, "warning", _LINEAR)
    if "PSHELL" not in model or "GRID" not in model:
        return
    p, xyz = model["PSHELL"], positions(model)
    for card in (c for c in _TRIANGLES if c in model):
        table = model[card]
        at, row = model["GRID"].find(table.stack("G1", "G2", "G3")), p.find(table["PID"])
        there = np.flatnonzero((at >= 0).all(axis=1) & (row >= 0))
        row = row[there]
        sheared = (p["MID3"][row] > 0) & (p["MID3"][row] == p["MID2"][row])
        thick = there[sheared & (p["T"][row] > _longest(xyz[at[there]]))]
        if thick.size:
            yield at_rows(model, card, thick, "warning", _THICK)


def _longest(x: Float) -> Float:
    """The longest side (e,) of triangles (e, 3, 3)."""
    return np.asarray(np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2).max(axis=1))
