"""Beams, shells and bushes that end on nodes of solids, which take no moments."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Bool, Int
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model, Ragged
from ringtrue.model.references import NODES, REFERENCES, SHELLS

_SOLIDS = frozenset(("CTETRA", "CPENTA", "CHEXA", "CPYRAM"))
_STRAIGHT = frozenset(("CROD", "CTUBE", "CONROD", "CVISC", "CBUSH1D"))  # along themselves alone
_MASSES = frozenset(("CONM1", "CONM2", "CMASS1", "CMASS2"))
_BEAMS = ("CBAR", "CBEAM", "CBEND")


def hinge_findings(model: Model) -> Iterator[Finding]:
    """Ends that nothing but solids holds: hinges of beams, bushes of some length that carry no
    force across.
    """
    if "GRID" not in model or not any(card in model for card in _SOLIDS):
        return
    free = _hinges(model)
    for card in (c for c in _BEAMS if c in model):
        rows = np.flatnonzero(free[_rows(model, card, "GA")] | free[_rows(model, card, "GB")])
        if rows.size:
            what = (
                "hinged where it ends on a node of solids, which take no moment; RBE3 or a "
                "beam inside them would"
            )
            yield at_rows(model, card, rows, "info", what)
    for card, rows in _edges_on_solids(model):
        what = (
            "hinged where an edge of it meets solids, whose nodes take no moment; shells over "
            "their faces would"
        )
        yield at_rows(model, card, rows, "info", what)
    if "CBUSH" in model:
        rows = np.flatnonzero(_idle_bushes(model, free))
        if rows.size:
            what = (
                "between nodes of solids, which turn freely, it carries no force across its "
                "length; give it none"
            )
            yield at_rows(model, "CBUSH", rows, "warning", what)


def _hinges(model: Model) -> Bool:
    """Which nodes solids hold and one further card only, (node + 1,); the last row is that of no
    node.
    """
    solid, other = np.zeros((2, len(model["GRID"]) + 1), dtype=np.int64)
    for r in REFERENCES:
        if (
            r.of != NODES
            or r.card not in model
            or r.card in _STRAIGHT | _MASSES
            or r.field in ("G0", "SA", "SB")
        ):
            continue
        np.add.at(solid if r.card in _SOLIDS else other, _rows(model, r.card, r.field), 1)
    solid[-1] = 0
    return np.asarray((solid > 0) & (other == 1))


def _edges_on_solids(model: Model) -> Iterator[tuple[str, Int]]:
    """Shells with two corners or more on solids, where neither a shell over their faces nor another
    card turns them.
    """
    solid, turned = np.zeros((2, len(model["GRID"]) + 1), dtype=bool)
    for r in REFERENCES:
        if (
            r.of == NODES
            and r.card in model
            and r.card not in _STRAIGHT | _MASSES
            and r.card not in SHELLS
        ):
            (solid if r.card in _SOLIDS else turned)[_rows(model, r.card, r.field)] = True
    solid[-1] = False
    corners = {
        card: np.stack(
            [_rows(model, card, f"G{k}") for k in range(1, 4 + ("QUAD" in card))], axis=1
        )
        for card in SHELLS
        if card in model
    }
    for at in corners.values():
        turned[at[solid[at].all(axis=1)]] = True
    for card, at in corners.items():
        if (rows := np.flatnonzero((solid & ~turned)[at].sum(axis=1) > 1)).size:
            yield card, rows


def _rows(model: Model, card: str, field: str) -> Int:
    """Rows of GRID that a field names, -1 for none."""
    column = model[card].columns[field]
    return model["GRID"].find(column.values if isinstance(column, Ragged) else np.asarray(column))


def _idle_bushes(model: Model, free: Bool) -> Bool:
    """Bushes of some length and stiffness in two directions, both ends of which turn freely."""
    t, x = model["CBUSH"], positions(model)
    a, b = _rows(model, "CBUSH", "GA"), _rows(model, "CBUSH", "GB")
    long = np.linalg.norm(x[a] - x[b], axis=1) > 1e-6 * diagonal(x)
    stiff = np.zeros(len(t), dtype=bool)
    if "PBUSH" in model:
        at = model["PBUSH"].find(t["PID"])
        stiff = (at >= 0) & ((model["PBUSH"].stack("K1", "K2", "K3")[at] != 0).sum(axis=1) > 1)
    return np.asarray(free[a] & free[b] & long & stiff & (a >= 0) & (b >= 0))
