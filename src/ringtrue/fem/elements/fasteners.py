"""CWELD: a short round beam between two patches or surfaces of shells, a patch and a node, or two
nodes.

The end on a patch follows its corners: u = Σ N u_I, and the rotation is that of the surface, θ = Σ
(∇N × n)(n·u_I) + n (n·(∇N × u_I))/2 (MSC Nastran Linear Static Analysis User's Guide, connector
elements: Kirchhoff shell, only the translations of the patch). About its middle a uniform beam is
six springs: EA/Le, GJ/Le, EI/Le, and across 1/(Le/kGA + L² Le/12EI), which holds for a length of 0,
too. Le is the length, not less than LDMIN and not more than LDMAX diameters (PWELD); for TYPE SPOT
between two sheets it is half the sum of their thicknesses.

CFAST: six springs between two surfaces of shells, each end on a square as large as the
fastener.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.algebra import arm, congruent, rotation, unit
from ringtrue.fem.elements.fastener_attachment import (
    SHELLS,
    End,
    Skin,
    merged,
    on_node,
    on_patch,
    on_squares,
)
from ringtrue.fem.mesh import Matrices, Mesh, any_triad, frame, isotropic, lookup, node_dofs
from ringtrue.model.model import Table, card_error

WIDE = ("PARTPAT", "ELPAT")
SHEAR = 0.9  # shear area of a round section over its area


def patches(m: Mesh, card: str, at: Int, side: str) -> tuple[Int, Bool]:
    """Corner nodes (e, 4) of patch A or B by GRIDID or ELEMID, -1 for none, and which rows have
    such a patch.
    """
    t = m.model[card]
    ids = t.stack(*(f"G{side}{i}" for i in range(1, 5)))[at]
    shell = t[f"SHID{side}"][at]
    left = shell > 0
    for name, count in SHELLS.items():
        if name in m.model:
            row = m.model[name].find(shell)
            hit = left & (row >= 0)
            ids[hit, :count] = m.model[name].stack(*(f"G{i}" for i in range(1, count + 1)))[
                row[hit]
            ]
            left = left & ~hit
    if left.any():
        why = f"SHID{side} {shell[left][0]} is none of {', '.join(SHELLS)}"
        raise card_error(m.model, t, int(at[left][0]), why)
    there = ids[:, 0] > 0
    out = np.full(ids.shape, -1)
    used = ids > 0
    out[used] = m.nodes(ids[used], t, np.broadcast_to(at[:, None], ids.shape)[used])
    return out, there


def _wide(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Ends on surfaces of several shells, of a property (PARTPAT) or that of a shell (ELPAT)."""
    t = m.model[card]
    D = m.model["PWELD"]["D"][lookup(m.model, "PWELD", t["PID"][at], table=t, at=at)].real
    return on_squares(
        m,
        t,
        at,
        diameter=D,
        by_shell=t["TYPE"][at] == "ELPAT",
        properties=("PIDA", "PIDB"),
        shells=("SHIDA", "SHIDB"),
    )


def weld_ends(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Both ends of the rows `at` (e,): on a patch below GS (or GA, GB), else at GS; by ALIGN at GA
    and GB.

    PARTPAT and ELPAT take squares over several shells.
    """
    t = m.model[card]
    wide = np.isin(t["TYPE"][at], WIDE)
    if wide.any():
        both = [(np.flatnonzero(wide), _wide(m, card, at[wide]))]
        both += [(np.flatnonzero(~wide), weld_ends(m, card, at[~wide]))] if not wide.all() else []
        return merged(at.size, [(r, pair[0]) for r, pair in both]), merged(
            at.size, [(r, pair[1]) for r, pair in both]
        )
    align = t["TYPE"][at] == "ALIGN"
    made = []
    for side in "AB":
        corners, there = patches(m, card, at, side)
        given = t[f"G{side}"][at]
        own = np.where(align, given, t["GS"][at])
        if (bare := ~there & (own == 0)).any():
            raise card_error(
                m.model, t, int(at[bare][0]), f"end {side} has neither a patch nor a node"
            )
        point = np.where(there & (given > 0), given, own)
        if (bare := point == 0).any():
            raise card_error(
                m.model, t, int(at[bare][0]), f"no GS or G{side} says where it pierces patch {side}"
            )
        node = m.nodes(point, t, at)
        p = np.flatnonzero(there)
        q = np.flatnonzero(~there)
        parts = (
            [(p, on_patch(m, card, at[p], nodes=corners[p], point=m.xyz[node[p]]))]
            if p.size
            else []
        )
        made.append(merged(at.size, [*parts, *([(q, on_node(m, node[q]))] if q.size else [])]))
    return made[0], made[1]


def lengths(L: Float, D: Any_, least: Float, most: Float) -> Any_:
    """Effective lengths (e,): L, not less and not more than so many diameters."""
    low = least * D
    high = most * D
    return np.where(np.real(low) > L, low, np.where(np.real(high) < L, high, L))


def _sheets(m: Mesh, t: Table, at: Int) -> Any_:
    """Half the thickness of both sheets (e,) of the rows `at` (e,): the effective length of a spot
    weld.
    """
    skin = Skin.of(m)
    order = np.argsort(skin.ids, kind="stable")
    total: Any_ = np.zeros(at.size)
    for side in "AB":
        shell = t[f"SHID{side}"][at]
        named = order[np.searchsorted(skin.ids[order], shell).clip(max=skin.ids.size - 1)]
        pid = np.where(shell > 0, skin.pid[named], t[f"PID{side}"][at])
        row = m.model["PSHELL"].find(pid) if "PSHELL" in m.model else np.full(pid.shape, -1)
        if (bad := row < 0).any():
            why = (
                f"its sheet {side} is no PSHELL, whose thickness is the length of a weld of "
                "TYPE SPOT"
            )
            raise card_error(m.model, t, int(at[bad][0]), why)
        total = total + m.model["PSHELL"]["T"][row] / 2
    return total


def springs(L: Float, length: Any_, D: Any_, E: Any_, G: Any_) -> Any_:
    """Stiffness (e, 6) about the middle: along, across twice, of torsion, of bending twice."""
    area = np.pi / 4 * D**2
    second = np.pi / 64 * D**4
    across = 1 / (length / (SHEAR * G * area) + L**2 * length / (12 * E * second))
    bending = E * second / length
    return np.stack(
        [E * area / length, across, across, 2 * G * second / length, bending, bending], axis=1
    )


def between(a: End, b: End) -> tuple[Float, Float]:
    """Length (e,) and axis (e, 3) from A to B; the normal of A where they are at one place."""
    d = b.place - a.place
    L = np.linalg.norm(d, axis=1)
    return L, np.where((L > 0)[:, None], d / np.where(L > 0, L, 1.0)[:, None], a.normal)


def joined(a: End, b: End, axes: Float, springs: Any_, half: Any_, loss: Any_) -> Matrices:
    """Matrices by springs (e, 6) half way between the ends, along and about `axes` (e, 3, 3); half
    the mass at each.
    """
    middle = (a.place + b.place) / 2
    local = rotation(axes, 1)
    move = [local @ arm(middle - end.place) @ end.follow for end in (a, b)]
    K = congruent(np.concatenate([-move[0], move[1]], axis=2), springs[:, :, None] * np.eye(6))
    d = K.shape[1]
    M = np.zeros((len(K), d, d), dtype=half.dtype)
    first = 0
    for end in (a, b):
        shift = end.follow[:, :3]
        size = end.follow.shape[2]
        M[:, first : first + size, first : first + size] = half[:, None, None] * (
            shift.swapaxes(1, 2) @ shift
        )
        first += size
    nodes = np.concatenate([a.nodes, b.nodes], axis=1)
    dofs = np.where(np.repeat(nodes, 6, axis=1) >= 0, node_dofs(nodes), -1)
    return Matrices(dofs=dofs, stiffness=K, mass=M, loss=loss, viscous=np.empty((0, d, d)))


def build_weld(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CWELD; half the mass at each end.

    Raises
    ------
    DeckError
        If an end is not determined, a foot lies outside of its patch, or a node, property or
        material is absent.
    """
    t = m.model[card]
    row = lookup(m.model, "PWELD", t["PID"][at], table=t, at=at)
    p = m.model["PWELD"]
    iso = isotropic(m.model, p["MID"][row], p, row)
    D = p["D"][row]
    if (bad := (np.real(D) <= 0) | (np.real(iso.G) == 0)).any():
        raise card_error(
            m.model,
            p,
            int(row[bad][0]),
            "D must be greater than 0, and its MAT1 have a shear modulus",
        )
    a, b = weld_ends(m, card, at)
    L, axis = between(a, b)
    length = lengths(L, D, p["LDMIN"][row], p["LDMAX"][row])
    both = (t.stack("SHIDA", "SHIDB")[at] > 0).all(axis=1) | (t["TYPE"][at] == "PARTPAT")
    if (spot := both & (p["TYPE"][row] == "SPOT")).any():
        sheets = _sheets(m, t, at[spot])
        length = length.astype(np.result_type(length, sheets))
        length[spot] = sheets
    k = springs(L, length, D, E=iso.E, G=iso.G)
    return joined(
        a, b, any_triad(axis), springs=k, half=iso.rho * np.pi / 8 * D**2 * L, loss=iso.loss
    )


_STIFFNESS = ("KT1", "KT2", "KT3", "KR1", "KR2", "KR3")


def _axes(axis: Float) -> Float:
    """Frames (e, 3, 3) of MCID -1: x along the axis, y in the plane of it and the axis of basic
    most across it.

    Of two that are equally across the first is taken (MSC Nastran Quick Reference Guide, PFAST).
    """
    b = np.eye(3)[np.round(np.abs(axis), 6).argmin(axis=1)]
    y = unit(b - np.einsum("ei,ei->e", b, axis)[:, None] * axis)
    return np.stack([axis, y, np.cross(axis, y)], axis=1)


def fastener_ends(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Both ends of the rows `at` (e,) of CFAST."""
    t = m.model[card]
    kind = t["TYPE"][at]
    if (bad := ~np.isin(kind, ("PROP", "ELEM"))).any():
        raise card_error(
            m.model, t, int(at[bad][0]), f"type {kind[bad][0]!r}: allowed are PROP, ELEM"
        )
    D = m.model["PFAST"]["D"][lookup(m.model, "PFAST", t["PID"][at], table=t, at=at)].real
    return on_squares(
        m,
        t,
        at,
        diameter=D,
        by_shell=kind == "ELEM",
        properties=("IDA", "IDB"),
        shells=("IDA", "IDB"),
    )


def build_fastener(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CFAST: KT, KR half way between the ends, half of MASS at
    each.

    Raises
    ------
    DeckError
        If an end or its frame is not determined, or a node or property is absent.
    """
    t = m.model[card]
    row = lookup(m.model, "PFAST", t["PID"][at], table=t, at=at)
    p = m.model["PFAST"]
    k = p.stack(*_STIFFNESS)[row]
    a, b = fastener_ends(m, card, at)
    axis = between(a, b)[1]
    cid = p["MCID"][row]
    absolute = p["MFLAG"][row] > 0
    relative = (cid >= 0) & ~absolute & ((k[:, 1] != k[:, 2]) | (k[:, 4] != k[:, 5]))
    if relative.any():
        why = "MFLAG = 0 with a frame and KT2, KT3 or KR2, KR3 that differ; give MFLAG = 1"
        raise card_error(m.model, p, int(row[relative][0]), why)
    fixed = (cid >= 0) & absolute
    own = frame(m, np.where(fixed, cid, 0), (a.place + b.place) / 2)
    axes = np.where(fixed[:, None, None], own, _axes(axis))
    return joined(a, b, axes, springs=k, half=p["MASS"][row] / 2, loss=p["GE"][row])
