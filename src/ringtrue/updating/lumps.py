"""Candidates for masses that a deck lacks: a lump at each of some nodes that cover the structure.

No field of a deck is the mass of what was left out. So the deck gets a CONM2 of no mass at each of
these nodes, which changes nothing, and the candidate is that mass; its factor is that of the mass
of the structure. It is never negative: too much mass is a factor on a density.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Bool, Int
from ringtrue.core.parameters import CardField, Parameter
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, stacked, table
from ringtrue.updating.candidates import Candidate, CandidateSettings

PLACES = 64  # nodes at most
USUAL, MOST = 0.05, 0.4  # of the mass of the structure: prior standard deviation, bound
NONE = 1e-7  # likewise: a bound must not be the nominal value
_FIELDS = ("M", "X1", "X2", "X3", "I11", "I21", "I22", "I31", "I32", "I33")


def places(model: Model, free: Bool, seen: Sequence[int] | Int) -> Int:
    """Nodes that cover the structure, ascending ids (k,): those that are seen, then the one
    farthest from all before.

    Parameters
    ----------
    free : (n,) bool
        Nodes that may move, in the order of GRID.
    seen : (k,) int64
        Ids of the nodes of sensors.
    """
    grid = model["GRID"]
    if (read := grid.file >= 0).any():
        free = free & read  # nodes that a refinement has made are in no file
    ids, xyz = grid.ids[free], positions(model)[free]
    out = np.flatnonzero(np.isin(ids, seen)).tolist()[:PLACES]
    far = np.full(ids.size, np.inf)
    for i in out:
        far = np.minimum(far, np.linalg.norm(xyz - xyz[i], axis=1))
    while len(out) < PLACES and far.max(initial=0.0) > 0:
        out.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(xyz - xyz[out[-1]], axis=1))
    return np.sort(ids[out])


def lumped(
    model: Model, nodes: Int, total: float, settings: CandidateSettings
) -> tuple[Model, tuple[Candidate, ...]]:
    """A copy with a CONM2 of no mass at each node, and what is lacking there as candidates.

    Parameters
    ----------
    nodes : (k,) int64
        Ids.
    total : float
        Mass of the structure as a CONM2 states it: PARAM,WTMASS is not applied.
    """
    first = 1 + max(
        (int(t.ids.max(initial=0)) for t in model.tables.values() if "EID" in t.columns), default=0
    )
    ids, frames = np.arange(first, first + nodes.size), np.zeros(nodes.size, dtype=np.int64)
    made = table(
        "CONM2", EID=ids, G=nodes, CID=frames, **dict.fromkeys(_FIELDS, np.zeros(nodes.size))
    )
    whole = stacked(model["CONM2"], made) if "CONM2" in model else made
    at = positions(model)[model["GRID"].find(nodes)].tolist()
    every = zip(ids.tolist(), nodes.tolist(), at, strict=True)
    found = tuple(_lump(eid, node, x, total, settings) for eid, node, x in every)
    return replace(model, tables={**model.tables, "CONM2": whole}), found


def _lump(eid: int, node: int, x: Sequence[float], total: float, s: CandidateSettings) -> Candidate:
    target = CardField("CONM2", eid, "M", (), total)
    p = Parameter(f"mass lacking at {node}", (target,), 1 - NONE, 1 + MOST, "linear", USUAL)
    unit = f" [{s.unit('mass')}]" if s.unit("mass") else ""
    place = f"({', '.join(f'{v:.3g}' for v in x)}) {s.unit('length')}".strip()
    return Candidate(p, "lump", f"a mass{unit} around {place} that the deck does not have", (eid,))
