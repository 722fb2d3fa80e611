"""Static load cases of a deck as vectors: forces, inertia, and supports that are displaced."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ringtrue.checks.materials import unconstrained
from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.decks.nastran.loads import (
    LINE_KINDS,
    LineLoad,
    Load,
    LoadCase,
    Moved,
    Pressure,
)
from ringtrue.errors import InputError
from ringtrue.fem.assembly import assemble
from ringtrue.fem.constraints import supports
from ringtrue.fem.element_cards import SOLIDS, mesh
from ringtrue.fem.elements import bar
from ringtrue.fem.loads import SURFACES, LineLoads, face, face_forces, line_forces
from ringtrue.fem.mesh import CardRows
from ringtrue.model.case_control import taken_sets
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model, card_error

log = logging.getLogger(__name__)
# its nodes, the pressure, and its sign along the normal
_Face = tuple[list[int], Pressure, float]


def load_vectors(model: Model, dofs: DofSet, cases: Sequence[LoadCase]) -> Float:
    """Loads (dof, case) float64 in the basic frame, deck units.

    Raises
    ------
    InputError
        If a load names a node, element or face that is not in the model, or the loads overflow.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        out = _summed(model, dofs, cases)
    if (wild := ~np.isfinite(out).all(axis=0)).any():
        raise InputError(
            f"{cases[int(wild.argmax())].name}: the loads are too large for a number"
        )
    return out


def _summed(model: Model, dofs: DofSet, cases: Sequence[LoadCase]) -> Float:
    out = np.zeros((len(dofs), len(cases)))
    xyz = positions(model)
    gravity = np.zeros((3, len(cases)))
    for j, case in enumerate(cases):
        for ld in case.loads:  # few compared with the elements
            if isinstance(ld, Load) and ld.card == "SLOAD":
                out[_scalar(dofs, case, ld), j] += ld.vector[0]
            elif isinstance(ld, Load) and ld.node:
                first = 4 if ld.card == "MOMENT" else 1
                vector = _vector(model, xyz, case, ld)
                out[dofs.find(np.full(3, ld.node), np.arange(first, first + 3)), j] += (
                    vector
                )
            elif isinstance(ld, Load):
                gravity[:, j] += _vector(model, xyz, case, ld)
        _press(
            out[:, j], model, xyz, [ld for ld in case.loads if isinstance(ld, Pressure)]
        )
        _load_beams(
            out[:, j], model, [ld for ld in case.loads if isinstance(ld, LineLoad)]
        )
    # all masses, those at supports too, which hang on what is free by a consistent mass
    if gravity.any():
        whole = assemble(unconstrained(model))
        out += whole.local.T @ (whole.mass @ (whole.rigid_body()[:, :3] @ gravity))
    return out


def held_by_displacing(
    model: Model, cases: Sequence[LoadCase]
) -> list[tuple[Model, tuple[int, ...]]]:
    """The model as it is held in load cases, and which these are.

    An SPCD at a component of a node that nothing else holds holds it, in its load case alone.
    """
    grid = model["GRID"]
    m = mesh(model)
    held = supports(m)
    groups: dict[frozenset[tuple[int, int]], list[int]] = {}
    for j, case in enumerate(cases):
        free = set()
        for ld in (ld for ld in case.loads if isinstance(ld, Moved)):
            row = int(m.dofs.find(np.array([ld.node]), np.array([ld.component]))[0])
            if row >= 0 and not held[row] and ld.component:
                free.add((ld.node, ld.component))
        groups.setdefault(frozenset(free), []).append(j)
    out = []
    for free_dofs, at in groups.items():
        names = ", ".join(cases[j].name for j in at)
        ps = grid["PS"].tolist()
        for node, component in sorted(free_dofs):
            ps[int(grid.find(np.array([node]))[0])] += str(component)
            what = (
                f"SPCD displaces node {node} component {component}, which no SPC holds"
            )
            log.warning("%s: %s: it is held there", names, what)
        held_there = grid.with_column("PS", np.array(ps, dtype=str))
        tables = {**model.tables, "GRID": held_there}
        out.append((replace(model, tables=tables) if free_dofs else model, tuple(at)))
    return out


def support_motions(
    model: Model, dofs: DofSet, cases: Sequence[LoadCase]
) -> tuple[Float, Float]:
    """What displaced supports (D of SPC, SPCD) do, deck units.

    Returns
    -------
    loads : (dof, case) float64
        Those that the displaced supports exert on what is free.
    moved : (dof, case) float64
        Motions of the supports and of what rigid elements and MPCs tie to them, added to the answer
        to all loads.

    Raises
    ------
    DeckError
        If an SPCD is at a degree of freedom that is not held.
    """
    loads, moved = (np.zeros((len(dofs), len(cases))) for _ in range(2))
    given = [{**_displaced(model), **_enforced(model, case)} for case in cases]
    if any(given):
        whole = assemble(unconstrained(model))
        q = np.zeros((len(whole.free), len(cases)))
        for j, at in enumerate(given):
            node, component = np.array(list(at), dtype=np.int64).reshape(-1, 2).T
            column = whole.free.find(node, component)
            # of a scalar point
            column = np.where(column < 0, whole.free.find(node, 0 * component), column)
            q[column, j] = list(at.values())
        moved = np.asarray(whole.transform @ q)
        loads = -np.asarray(whole.local.T @ (whole.stiffness @ q))
    return loads, moved


def _displaced(model: Model) -> dict[tuple[int, int], float]:
    """D of SPC by node and component."""
    if not (rows := _displacing(model)).size:
        return {}
    table = model["SPC"]
    return {
        (int(table["G"][i]), int(c)): float(table["D"][i])
        for i in rows.tolist()
        for c in table["C"][i] or "0"
    }


def _displacing(model: Model) -> Int:
    """Rows of SPC whose D displaces a support."""
    if "SPC" not in model:
        return np.empty(0, dtype=np.int64)
    table = model["SPC"]
    return np.flatnonzero(
        np.isin(table["SID"], taken_sets(model, "SPC")) & (table["D"] != 0)
    )


def _enforced(model: Model, case: LoadCase) -> dict[tuple[int, int], float]:
    """SPCD by node and component; those of several sets add up."""
    out: dict[tuple[int, int], float] = {}
    given = [ld for ld in case.loads if isinstance(ld, Moved)]
    if given:
        m = mesh(model)
        held = supports(m)
    for ld in given:
        row = int(m.dofs.find(np.array([ld.node]), np.array([ld.component]))[0])
        if row < 0 or not held[row]:
            raise ld.error(
                f"node {ld.node} component {ld.component or ''} is held by no SPC, SPC1 or PS"
            )
        out[ld.node, ld.component] = out.get((ld.node, ld.component), 0.0) + ld.size
    return out


def refuse_displaced(model: Model) -> None:
    """Refuse supports that D of SPC displaces.

    Raises
    ------
    DeckError
        At the first.
    """
    if (rows := _displacing(model)).size:
        why = "displaces a support (D); forces alone act on one that is at 0"
        raise card_error(model, model["SPC"], int(rows[0]), why)


def _scalar(dofs: DofSet, case: LoadCase, ld: Load) -> int:
    """The row of a scalar point."""
    if (row := int(dofs.find(np.array([ld.node]), np.array([0]))[0])) < 0:
        raise InputError(
            f"{case.name}: SLOAD names {ld.node}, which is no scalar point of the deck"
        )
    return row


def _vector(model: Model, xyz: Float, case: LoadCase, ld: Load) -> Float:
    """A load in basic, (3,)."""
    nodes = [ld.node] * bool(ld.node) + list(ld.ends)
    rows = model["GRID"].find(np.array(nodes, dtype=np.int64))
    if (rows < 0).any():
        raise InputError(
            f"{case.name}: {ld.card} names node {nodes[int(rows.argmin())]}, which is not in the "
            "deck"
        )
    at = xyz[rows]
    if ld.ends:
        along = at[2] - at[1]
        if len(ld.ends) == 4:
            along = np.cross(along, at[4] - at[3])
        if not along.any():
            why = (
                "which are at one place" if len(ld.ends) == 2 else "which span no plane"
            )
            raise InputError(
                f"{case.name}: {ld.card} from node {ld.ends[0]} to "
                f"{', '.join(map(str, ld.ends[1:]))}, {why}"
            )
        return np.asarray(ld.vector[0] * along / np.linalg.norm(along))
    where = at[:1] if ld.node else np.zeros((1, 3))
    return np.asarray(np.asarray(ld.vector) @ axes(model, np.array([ld.cid]), where)[0])


def _press(out: Float, model: Model, xyz: Float, pressures: Sequence[Pressure]) -> None:
    """Add the forces of pressures to those of all nodes, (dof,), six a row of GRID."""
    of_kind: dict[tuple[int, int, bool], list[_Face]] = {}
    for nodes, ld, sign in _faces(model, pressures):
        of_kind.setdefault((len(nodes), ld.cid, ld.vector is None), []).append(
            (nodes, ld, sign)
        )
    for (count, cid, normal), faces in of_kind.items():
        ids = np.array([nodes for nodes, _, _ in faces])
        rows = model["GRID"].find(ids)
        if (lost := (rows < 0) & (ids > 0)).any():
            raise faces[int(np.argwhere(lost)[0, 0])][1].error(
                "a node of the face is not in the deck"
            )
        x = np.where((ids > 0)[..., None], xyz[rows], np.nan)
        p = np.array(
            [[sign * size for size in ld.sizes[: count // 2]] for _, ld, sign in faces]
        )
        along = (
            None
            if normal
            else _towards(model, cid, np.array([ld.vector for _, ld, _ in faces]))
        )
        force = face_forces(x, p, along)
        np.add.at(
            out[: 6 * len(xyz)].reshape(-1, 6)[:, :3], rows[ids > 0], force[ids > 0]
        )


def _load_beams(out: Float, model: Model, lines: Sequence[LineLoad]) -> None:
    """Add the forces of loads on beams to those of all nodes, (dof,)."""
    if not lines:
        return
    m = mesh(model)
    left = np.ones(len(lines), dtype=bool)
    ids = np.array([ld.element for ld in lines])
    for card in ("CBAR", "CBEAM"):
        if card not in model:
            continue
        row = model[card].find(ids)
        chosen = [ld for ld, r in zip(lines, row, strict=True) if r >= 0]
        if chosen:
            out += _of_beams(m.rows(card, row[row >= 0]), chosen)
        left &= row < 0
    if left.any():
        ld = lines[int(left.argmax())]
        raise ld.error(
            f"names element {ld.element}, which is no CBAR or CBEAM of the deck"
        )


def _of_beams(t: CardRows, lines: Sequence[LineLoad]) -> Float:
    ends, sizes = (
        np.array([getattr(ld, name) for ld in lines]) for name in ("ends", "sizes")
    )
    own, fraction, projected = (
        np.array(v)
        for v in zip(
            *((ld.kind.endswith("E"), ld.fraction, ld.projected) for ld in lines),
            strict=True,
        )
    )
    length = np.where(fraction, 1.0, bar.measure(t))
    # 1e-6: of the length of a beam: a load that much beyond its end stands there
    if (beyond := ends[:, 1] > length * (1 + 1e-6)).any():
        i = int(beyond.argmax())
        raise lines[i].error(
            f"X2 (or X1) is {ends[i, 1]:g}; the beam ends at {length[i]:g}"
        )
    along = np.eye(6)[[LINE_KINDS.index(ld.kind[:2]) for ld in lines]]
    ends = np.minimum(ends, length[:, None])
    loads = LineLoads(
        ends=ends,
        sizes=sizes,
        along=along,
        own=own,
        fraction=fraction,
        projected=projected,
    )
    return line_forces(t, loads)


def _towards(model: Model, cid: int, vectors: Float) -> Callable[[Float], Float]:
    """Directions in basic at points (e, p, 3) of vectors (e, 3) in a frame, which may be curved."""

    def at(points: Float) -> Float:
        local = axes(model, np.full(points[..., 0].size, cid), points.reshape(-1, 3))
        return np.asarray(
            np.einsum("ei,epij->epj", vectors, local.reshape(*points.shape, 3))
        )

    return at


def _faces(model: Model, pressures: Sequence[Pressure]) -> Iterator[_Face]:
    """Nodes of each loaded face, its pressure, and its sign along the normal; a pressure acts into
    a solid.
    """
    known = [card for card in (*SURFACES, *SOLIDS) if card in model]
    ids = np.concatenate(
        [np.empty(0, dtype=np.int64), *(model[card].ids for card in known)]
    )
    order = np.argsort(ids)
    where = (
        [(card, row) for card in known for row in range(len(model[card]))]
        if pressures
        else []
    )
    for ld in pressures:
        if ld.card == "PLOAD":
            corners = [g for g in ld.nodes if g]
            yield corners + [0] * len(corners), ld, 1.0
            continue
        found = order[
            slice(*np.searchsorted(ids, [ld.first, ld.last + 1], sorter=order))
        ]
        if not found.size:
            raise ld.error(
                f"names element {ld.first}, which is no shell or solid of the deck"
            )
        for card, row in (where[i] for i in found.tolist()):
            nodes = [
                int(model[card][name][row])
                for name in model[card].columns
                if re.fullmatch(r"G\d+", name)
            ]
            if card in SOLIDS:
                try:
                    yield (
                        face(card, nodes, *ld.nodes),
                        ld,
                        -1.0 if ld.vector is None else 1.0,
                    )
                except InputError as e:
                    raise ld.error(f"element {model[card].ids[row]}: {e}") from None
            else:
                sides = 3 if "TRIA" in card else 4
                yield (nodes + [0] * sides)[: 2 * sides], ld, 1.0
