"""What of a deck is condensed: points that are omitted, interior points of superelements, and the
modal coordinates that stand for them (MSC Nastran Superelements User's Guide).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.dofs import DofSet
from ringtrue.model.case_control import asked_modes
from ringtrue.model.model import ComponentModes, Model

KEPT = ("ASET", "ASET1")
OMITTED = ("OMIT", "OMIT1")
MODAL = ("QSET", "QSET1")


def listed_dofs(model: Model, cards: tuple[str, ...]) -> DofSet:
    """The DOFs that cards such as ASET and ASET1 list, each once; 0 is a scalar point.

    >>> from ringtrue.model.model import table
    >>> listed_dofs(Model({"ASET": table("ASET", ID=[6, 7], C=["26", "0"])}), KEPT).labels()
    ('6+Y', '6+RZ', '7')
    """
    pairs: dict[tuple[int, int], None] = {}
    for card in (c for c in cards if c in model):
        nodes, row = model[card].entries("ID")
        components = model[card]["C"][row]
        for node, text in zip(nodes.tolist(), components.tolist(), strict=True):
            pairs |= {(node, int(c)): None for c in text or "0"}
    node, direction = np.array(list(pairs), dtype=np.int64).reshape(-1, 2).T
    return DofSet(node, direction)


def condenses(model: Model) -> bool:
    """Whether Nastran's modes of the deck are those of a condensed model."""
    listed = any(card in model for card in (*KEPT, *OMITTED, *MODAL))
    return listed or bool("GRID" in model and (model["GRID"]["SEID"] > 0).any())


def whole_mesh(model: Model) -> Model:
    """The model without what condenses it: its modes are those of the whole mesh.

    Studies take it: a condensation is an approximation, and its error would go into the parameters.
    """
    if not condenses(model):
        return model
    tables = {n: t for n, t in model.tables.items() if n not in (*KEPT, *OMITTED, *MODAL)}
    if "GRID" in tables:
        grid = tables["GRID"]
        tables["GRID"] = grid.with_column("SEID", np.zeros_like(grid["SEID"]))
    return replace(model, tables=tables)


def component_modes(model: Model) -> ComponentModes:
    """Those that METHOD of a component asks for, on the coordinates of its QSET."""
    modal = listed_dofs(model, MODAL)
    asked = asked_modes(model)
    if asked is None:
        return ComponentModes(modal, len(modal))
    return ComponentModes(modal, min(len(modal), asked.count or len(modal)), asked.high)
