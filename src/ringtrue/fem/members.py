"""Members: rows of bars in one line, between the nodes where they meet others."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.fem.constraints import supports
from ringtrue.fem.element_cards import ELEMENTS
from ringtrue.fem.elements.bar import measure, section
from ringtrue.fem.mesh import Mesh, Rows, unit
from ringtrue.model.references import REFERENCES
from ringtrue.model.refine import LINES

POINT_MASSES = ("CONM1", "CONM2", "CMASS1", "CMASS2", "CMASS3", "CMASS4")
TURNING = [3, 4, 5, 9, 10, 11]  # rotations of a bar's ends among its degrees of freedom
# cosine between the directions of two bars away from their node, in one line
STRAIGHT = -0.99


def end_springs(m: Mesh, rows: Rows, rigid: float) -> Float:
    """Springs about an axis at both ends of bars, `rigid` times EI over the length of the member;
    infinite where a member goes on, or ends freely.

    Parameters
    ----------
    rows : dict
        Of CBAR and CBEAM, in this order.
    rigid : float

    Returns
    -------
    springs : (e, 2) float64
    """
    tables = [m.rows(card, rows[card]) for card in LINES if card in rows]
    nodes = np.concatenate([t.nodes("GA", "GB") for t in tables])
    length = np.concatenate([measure(t) for t in tables])
    kind = np.concatenate([2 * t["PID"] + (t.card == "CBEAM") for t in tables])
    bending = []
    for t in tables:
        material, s = section(t)
        bending.append(material.E * np.maximum(s.I1, s.I2).mean(axis=1))
    near, through = _pairs(m, nodes, kind)
    links = sparse.coo_array(
        (np.ones(len(through)), through.T), shape=(length.size, length.size)
    )
    _, member = connected_components(links, directed=False)
    whole = np.bincount(member, length)[member]
    springs = rigid * np.concatenate(bending) / whole
    return np.where(near, springs[:, None], np.inf)


def on_springs(stiffness: Float, springs: Float) -> Float:
    """Stiffness (e, 12, 12) of bars whose ends turn against their nodes on springs (e, 6), infinite
    where they do not.
    """
    turning = stiffness[:, TURNING][:, :, TURNING]
    rigid = 1e15 * np.abs(turning).max(initial=0.0)
    both = turning + np.where(np.isfinite(springs), springs, rigid)[
        :, :, None
    ] * np.eye(6)
    each = np.linalg.solve(both, stiffness[:, TURNING])
    return stiffness - stiffness[:, :, TURNING] @ each


def _pairs(m: Mesh, nodes: Int, kind: Int) -> tuple[Bool, Int]:
    """Which ends (e, 2) of bars between these nodes meet others, and pairs of bars (k, 2) that are
    one member.
    """
    along = unit(m.xyz[nodes[:, 1]] - m.xyz[nodes[:, 0]])
    away = np.stack([along, -along], axis=1).reshape(-1, 3)
    flat = nodes.ravel()
    ends = np.bincount(flat, minlength=len(m.xyz))
    others = _elsewhere(m)
    order = np.argsort(flat, kind="stable")
    first = order[:-1]
    second = order[1:]
    two = (
        (flat[first] == flat[second]) & (ends[flat[first]] == 2) & ~others[flat[first]]
    )
    line = np.einsum("ki,ki->k", away[first], away[second]) < STRAIGHT
    same = kind[first // 2] == kind[second // 2]
    goes_on = two & line & same
    meets = (ends[flat] > 1) | others[flat]
    meets[first[goes_on]] = False
    meets[second[goes_on]] = False
    return meets.reshape(-1, 2), np.stack([first, second], axis=1)[goes_on] // 2


def _elsewhere(m: Mesh) -> Bool:
    """Nodes that are held against turning, or that other elements than bars and masses join."""
    model = m.model
    out: Bool = np.array(
        supports(m)[: 6 * len(m.xyz)].reshape(-1, 6)[:, 3:].any(axis=1)
    )
    for r in REFERENCES:
        joins = (r.card in ELEMENTS or r.card.startswith("R")) and r.field != "G0"
        if not joins or "GRID" not in r.of or r.card in (*LINES, *POINT_MASSES):
            continue
        if r.card in model and r.field in model[r.card].columns:
            at = model["GRID"].find(model[r.card].entries(r.field)[0])
            out[at[at >= 0]] = True
    return out
