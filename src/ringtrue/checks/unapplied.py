"""What a deck asks for and modes do not hold: condensation, rotor terms, matrices and damping of
other solutions.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.model.cards import TABLES
from ringtrue.model.case_control import left_out, untaken_matrices
from ringtrue.model.model import Model

_WHOLE = "kept, not applied: the modes here are those of the full model, not of the condensed one"
_KEPT = (  # cards that are kept and what becomes of them
    (("ASET", "ASET1", "OMIT", "OMIT1"), _WHOLE),
    (
        TABLES,
        "kept, not applied: the nominal stiffness and damping hold at all frequencies, as in SOL "
        "103",
    ),
    (
        ("ROTORG", "ROTORD", "ROTORAX", "ROTORSE"),
        "kept, not applied: the modes are those at rest, without gyroscopic terms",
    ),
    (
        ("SNORM",),
        "kept, not applied: normals of shells are the mean of the elements around a node, as "
        "PARAM,SNORM has it",
    ),
    (
        ("MDLPRM",),
        "kept, not applied: with or without OFFDEF, offsets are rigid arms and masses move with "
        "them",
    ),
    (
        ("DESVAR",),
        "kept, not applied: the fields of the cards count as they stand, not the start XINIT",
    ),
    (("TF",), "kept, not applied: transfer functions act in the solutions of responses only"),
)
RECTANGULAR = 9  # form of DMIG that are loads


def unapplied(model: Model) -> Iterator[Finding]:
    """Findings on what is kept in the deck and left out of the modes, or of the damping."""
    for cards, what in _KEPT:
        found = [card for card in cards if card in model.kept]
        if found:
            yield Finding("info", f"{', '.join(found)}: {what}")
    if "GRID" in model and (rows := np.flatnonzero(model["GRID"]["SEID"] > 0)).size:
        yield at_rows(model, "GRID", rows, "info", f"SEID {_WHOLE}")
    for name in ("K2PP", "M2PP", "B2PP"):
        if getattr(model.case, name.lower()):
            yield Finding("info", f"{name} acts on responses (ringtrue frf), not on modes")
    for text in left_out(model):
        yield Finding("warning", text)
    yield from _idle_matrices(model)


def _idle_matrices(model: Model) -> Iterator[Finding]:
    """Square DMIG that no command of case control takes."""
    if "DMIG" not in model:
        return
    table = model["DMIG"]
    names = np.char.upper(table["NAME"].astype(str))
    asked = " ".join(model.case.unread).upper()
    for row in untaken_matrices(model).tolist():
        if table["IFO"][row] != RECTANGULAR and names[row] not in asked:
            text = (
                f"DMIG {names[row]}: it adds nothing: case control takes it by no K2GG, M2GG "
                "or B2GG"
            )
            yield Finding("warning", text, model.files[int(table.file[row])], int(table.line[row]))
