"""Thermal expansion of elements: the forces that would give a free one its stress-free motion."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.fem.algebra import add_at
from ringtrue.fem.assembly import pieces
from ringtrue.fem.element_cards import PROPERTY, SHELLS, SOLIDS
from ringtrue.fem.elements import bar
from ringtrue.fem.mesh import Mesh
from ringtrue.model.model import Model, card_error, unsupported_card

SPREADS = {  # cards that expand: dimensions in which the temperature of one may vary
    **dict.fromkeys(("CROD", "CTUBE", "CONROD", "CBAR", "CBEAM", "CBEND"), 1),
    **dict.fromkeys(SHELLS, 2),
    **dict.fromkeys(SOLIDS, 3),
}
FLAT = 1e-6  # of the size of an element: no extent in that direction


def thermal_forces(m: Mesh, warm: Float) -> Float:
    """Forces (full,) float64 at the full DOFs of elements at temperatures of their nodes.

    In an isotropic body whose temperature is T = T0 + g·x, the motion u = α [(T0 − TREF) x + (g·x)
    x − g |x|²/2] with the rotation α g × x is free of stress (Boley and Weiner, Theory of Thermal
    Stresses, 1960, section 9.6): an element's stiffness times that motion of its nodes is its
    thermal load, exact for any such temperature.

    Parameters
    ----------
    warm : (node,) float64
        Of the rows of GRID; NaN where it is not given.

    Raises
    ------
    DeckError
        If the temperature of a node of an element that expands is not given.
    UnsupportedCard
        If a laminate or an anisotropic material would expand.
    """
    out = np.zeros(m.size)
    expansion = {card: _expansion(m, card) for card in SPREADS if card in m.model}
    rows = {card: np.flatnonzero(alpha != 0) for card, (alpha, _) in expansion.items()}
    for card, at, p in pieces(m, rows):
        alpha, reference = (v[at, None] for v in expansion[card])
        step = 3 if card in SOLIDS else 6
        used = p.dofs >= 0
        nodes = np.where(used, p.dofs // 6, -1)[:, ::step]
        T = np.where(nodes < 0, 0.0, warm[nodes])
        _refuse_unknown(m, card, at, nodes, T)
        x = m.xyz[nodes]
        arms = bar.offsets(m, card, at, nodes) if card in ("CBAR", "CBEAM") else np.zeros_like(x)
        motion = _free(x + arms, arms, nodes >= 0, T - reference, SPREADS[card])[:, :, :step]
        force = np.einsum(
            "eij,ej->ei", p.stiffness, alpha * np.where(used, motion.reshape(used.shape), 0.0)
        )
        add_at(out, p.dofs, force)
    return out


def _free(x: Float, arms: Float, there: Bool, T: Float, spread: int) -> Float:
    """Stress-free motion (e, k, 6) of nodes, over the coefficient of expansion, x (e, k, 3) at the
    ends of `arms`.
    """
    count = there.sum(axis=1)[:, None, None]
    x = np.where(
        there[..., None], x - (x * there[..., None]).sum(axis=1, keepdims=True) / count, 0.0
    )
    mean = (T * there).sum(axis=1, keepdims=True) / count[..., 0]
    u, s, v = np.linalg.svd(x, full_matrices=False)
    wide = (np.arange(s.shape[1]) < spread) & (s > FLAT * s[:, :1])
    steep = np.where(
        wide,
        np.einsum("eks,ek->es", u, np.where(there, T - mean, 0.0)) / np.where(wide, s, 1.0),
        0.0,
    )
    g = np.einsum("es,esi->ei", steep, v)[:, None]
    moved = (mean[..., None] + (x * g).sum(axis=2, keepdims=True)) * x - g * (x * x).sum(
        axis=2, keepdims=True
    ) / 2
    turned = np.cross(g, x)
    return np.concatenate([moved - np.cross(turned, arms), turned], axis=2)


def _expansion(m: Mesh, card: str) -> tuple[Float, Float]:
    """A and TREF of the material of each row, (e,); 0 where there is none."""
    model, table = m.model, m.model[card]
    mid = table["MID"] if card == "CONROD" else _materials(model, PROPERTY[card], table["PID"])
    row = _rows(model, "MAT1", mid)
    if (other := (row < 0) & (mid != 0)).any():
        why = "would expand: thermal loads are read with MAT1, of shells with PSHELL without MID4"
        raise unsupported_card(model, table, int(other.argmax()), why)
    if "MAT1" not in model:
        return np.zeros(len(table)), np.zeros(len(table))
    alpha, reference = (np.append(model["MAT1"][name], 0.0)[row] for name in ("A", "TREF"))
    return alpha, reference


def _materials(model: Model, card: str, pid: Int) -> Int:
    """Material of the properties (e,), 0 for none, -1 where it is no single one."""
    if card not in model:
        return np.full(pid.size, -1)
    table = model[card]
    mid = np.where(table["MID4"] > 0, -1, table["MID1"]) if card == "PSHELL" else table["MID"]
    return np.asarray(np.append(mid, -1)[_rows(model, card, pid)])


def _rows(model: Model, card: str, ids: Int) -> Int:
    return model[card].find(ids) if card in model else np.full(ids.size, -1)


def _refuse_unknown(m: Mesh, card: str, at: Int, nodes: Int, T: Float) -> None:
    if (lost := np.argwhere(np.isnan(T))).size:
        e, k = lost[0].tolist()
        node = m.model["GRID"].ids[nodes[e, k]]
        raise card_error(
            m.model, m.model[card], int(at[e]), f"node {node} has no temperature (TEMP or TEMPD)"
        )
