"""Whatever a card names must be in the deck."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.errors import DeckError
from ringtrue.model.model import Model, Ragged, Table

_NODES = {
    "CROD": "G1 G2",
    "CONROD": "G1 G2",
    "CTUBE": "G1 G2",
    "CBAR": "GA GB",
    "CBEAM": "GA GB",
    "CTRIA3": "G1 G2 G3",
    "CQUAD4": "G1 G2 G3 G4",
    "CTETRA": "G1 G2 G3 G4",
    "CPENTA": "G1 G2 G3 G4 G5 G6",
    "CHEXA": "G1 G2 G3 G4 G5 G6 G7 G8",
    "CBUSH": "GA",
    "CONM2": "G",
    "RBE2": "GN",
    "RBE3": "REFGRID",
}
_OPTIONAL = {"CBUSH": "GB G0", "CBAR": "G0", "CBEAM": "G0", "CELAS1": "G1 G2", "CELAS2": "G1 G2"}
_PROPERTY = {
    "CROD": ("PROD",),
    "CTUBE": ("PTUBE",),
    "CBAR": ("PBAR", "PBARL"),
    "CBEAM": ("PBEAM", "PBEAML", "PBCOMP"),
    "CTRIA3": ("PSHELL", "PCOMP", "PCOMPG"),
    "CQUAD4": ("PSHELL", "PCOMP", "PCOMPG"),
    "CTETRA": ("PSOLID",),
    "CPENTA": ("PSOLID",),
    "CHEXA": ("PSOLID",),
    "CBUSH": ("PBUSH",),
    "CELAS1": ("PELAS",),
}
_MATERIAL = {"PROD": "MID", "PTUBE": "MID", "PBAR": "MID", "PBEAM": "MID", "PSOLID": "MID", "CONROD": "MID"}


def _missing(model: Model, t: Table, name: str, known: NDArray[Any], *, zero_ok: bool = False) -> None:
    column = t.columns[name]
    if isinstance(column, Ragged):
        values, row = column.values, np.repeat(np.arange(len(t)), np.diff(column.offsets))
    else:
        values, row = column, np.arange(len(t))
    bad = ~np.isin(values, known)
    if zero_ok:
        bad &= values > 0
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        at = int(row[i])
        raise DeckError(
            f"{int(t.ids[at])} names {int(values[i])}, which is not in the deck",
            path=model.files[int(t.file[at])],
            line=int(t.line[at]),
            card=t.card,
            field=name,
        )


def check_references(model: Model) -> None:
    """Nodes, properties, materials and frames that cards name.

    Raises
    ------
    DeckError
        On the first that is not there, with file, line, card and field.
    """
    points = [model[c].ids for c in ("GRID", "SPOINT") if c in model]
    if "GRID" not in model:
        raise DeckError("the deck has no GRID", path=model.files[0] if model.files else None)
    nodes = np.concatenate(points)
    for card, names in _NODES.items():
        for name in names.split() if card in model else ():
            _missing(model, model[card], name, nodes)
    for card, names in _OPTIONAL.items():
        for name in names.split() if card in model else ():
            _missing(model, model[card], name, nodes, zero_ok=True)
    for card, name in (("RBE2", "GM"), ("RBE3", "G"), ("MPC", "G")):
        if card in model:
            _missing(model, model[card], name, nodes)
    for card, choices in _PROPERTY.items():
        if card in model:
            known = [model[c].ids for c in choices if c in model]
            _missing(model, model[card], "PID", np.concatenate([*known, np.zeros(0, dtype=np.int64)]))
    _materials_and_frames(model)


def _materials_and_frames(model: Model) -> None:
    materials = np.concatenate(
        [np.zeros(0, dtype=np.int64), *(model[c].ids for c in ("MAT1", "MAT2", "MAT8", "MAT9") if c in model)]
    )
    for card, name in _MATERIAL.items():
        if card in model:
            _missing(model, model[card], name, materials)
    for name in ("MID1", "MID2", "MID3", "MID4") if "PSHELL" in model else ():
        _missing(model, model["PSHELL"], name, materials, zero_ok=True)
    kinds = [f"CORD{i}{k}" for i in (1, 2) for k in "RCS"]
    frames = np.concatenate([np.zeros(1, dtype=np.int64), *(model[c].ids for c in kinds if c in model)])
    for card, name in (("GRID", "CP"), ("GRID", "CD"), ("CONM2", "CID"), ("CBUSH", "CID")):
        if card in model:
            _missing(model, model[card], name, frames, zero_ok=True)
