"""Coordinate frames of a model, resolved to the basic frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import DeckError
from ringtrue.model.model import Model, Table
from ringtrue.model.places import error


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame in basic: origin (3,), axes (3, 3) with the axes as rows, kind R, C or S (degrees)."""

    origin: Float
    axes: Float
    kind: str

    def to_basic(self, x: Float) -> Float:
        """Coordinates (n, 3) of this frame to basic (n, 3)."""
        return self.origin + self._cartesian(x) @ self.axes

    def _cartesian(self, x: Float) -> Float:
        if self.kind == "R":
            return x
        if self.kind == "C":
            t = np.radians(x[:, 1])
            return np.stack([x[:, 0] * np.cos(t), x[:, 0] * np.sin(t), x[:, 2]], axis=1)
        r, t, p = x[:, 0], np.radians(x[:, 1]), np.radians(x[:, 2])
        return np.stack([r * np.sin(t) * np.cos(p), r * np.sin(t) * np.sin(p), r * np.cos(t)], axis=1)

    def axes_at(self, basic: Float) -> Float:
        """Local unit vectors as rows at points (n, 3) of basic: (n, 3, 3)."""
        n = len(basic)
        if self.kind == "R":
            return np.broadcast_to(self.axes, (n, 3, 3))
        d = (basic - self.origin) @ self.axes.T
        rho = np.hypot(d[:, 0], d[:, 1])
        safe = np.where(rho > 0, rho, 1.0)
        c, s = np.where(rho > 0, d[:, 0] / safe, 1.0), np.where(rho > 0, d[:, 1] / safe, 0.0)
        zero = np.zeros(n)
        if self.kind == "C":
            local = np.stack([c, s, zero, -s, c, zero, zero, zero, zero + 1], axis=1)
        else:
            r = np.linalg.norm(d, axis=1)
            safe_r = np.where(r > 0, r, 1.0)
            ct, st = np.where(r > 0, d[:, 2] / safe_r, 1.0), rho / safe_r
            local = np.stack([st * c, st * s, ct, ct * c, ct * s, -st, -s, c, zero], axis=1)
        return np.asarray(local.reshape(n, 3, 3) @ self.axes)


def _from_points(a: Float, b: Float, c: Float, kind: str) -> Frame | None:
    """None where the three points lie on one line."""
    z = b - a
    y = np.cross(z, c - a)
    if np.linalg.norm(z) == 0 or np.linalg.norm(y) <= 1e-12 * np.linalg.norm(z) * np.linalg.norm(c - a):
        return None
    z, y = z / np.linalg.norm(z), y / np.linalg.norm(y)
    return Frame(a, np.stack([np.cross(y, z), y, z]), kind)


def _made(model: Model, t: Table, row: int, points: Float, kind: str) -> Frame:
    """The frame of a card through its three points (3, 3), basic."""
    found = _from_points(points[0], points[1], points[2], kind)
    if found is None:
        raise error(model, t, row, "its three points lie on one line")
    return found


def _definitions(model: Model) -> dict[int, Callable[[dict[int, Frame]], Frame | None]]:
    """For each frame a function that resolves it from those known so far, or returns None."""
    grid = model["GRID"]
    made: dict[int, Callable[[dict[int, Frame]], Frame | None]] = {}
    for kind in "RCS":
        if (card := f"CORD2{kind}") in model:
            t = model[card]
            abc = t.stack("A1", "A2", "A3", "B1", "B2", "B3", "C1", "C2", "C3").reshape(-1, 3, 3)
            for row, (cid, rid, p) in enumerate(zip(t["CID"].tolist(), t["RID"].tolist(), abc, strict=True)):

                def points(
                    known: dict[int, Frame], rid: int = rid, p: Float = p, k: str = kind, t: Table = t, row: int = row
                ) -> Frame | None:
                    if rid not in known:
                        return None
                    return _made(model, t, row, known[rid].to_basic(p), k)

                made[cid] = points
        if (card := f"CORD1{kind}") in model:
            t = model[card]
            for row, (cid, g) in enumerate(zip(t["CID"].tolist(), t.stack("G1", "G2", "G3"), strict=True)):

                def nodes(
                    known: dict[int, Frame], g: Int = g, k: str = kind, t: Table = t, row: int = row
                ) -> Frame | None:
                    at = grid.find(g)
                    if (at < 0).any():
                        raise error(model, t, row, f"node {g[at < 0][0]} is not in the deck")
                    cp = grid["CP"][at]
                    if not all(int(c) in known for c in cp):
                        return None
                    x = grid.stack("X1", "X2", "X3")[at]
                    p = [known[int(c)].to_basic(xi[None])[0] for c, xi in zip(cp, x, strict=True)]
                    return _made(model, t, row, np.array(p), k)

                made[cid] = nodes
    return made


def frames(model: Model) -> dict[int, Frame]:
    """All frames by CID, 0 (basic) among them.

    Raises
    ------
    DeckError
        On a frame that refers to one that is absent or to itself.
    """
    known = {0: Frame(np.zeros(3), np.eye(3), "R")}
    todo = _definitions(model)
    while todo:
        ready = {cid: f for cid, make in todo.items() if (f := make(known)) is not None}
        if not ready:
            raise DeckError(f"coordinate frames {sorted(todo)} refer to frames that are not in the deck")
        known |= ready
        todo = {cid: make for cid, make in todo.items() if cid not in ready}
    return known


def positions(model: Model) -> Float:
    """Basic coordinates of the GRID rows, (n, 3) float64."""
    grid = model["GRID"]
    x, cp = grid.stack("X1", "X2", "X3"), grid["CP"]
    known, out = frames(model), x.copy()
    for cid in np.unique(cp[cp != 0]).tolist():
        if cid not in known:
            raise error(model, grid, int(np.flatnonzero(cp == cid)[0]), f"frame CP {cid} is not in the deck")
        out[cp == cid] = known[cid].to_basic(x[cp == cid])
    return out


def axes(model: Model, cid: Int, basic: Float) -> Float:
    """Unit vectors (rows) of frame `cid` (n,) at points `basic` (n, 3): (n, 3, 3) float64."""
    known = frames(model)
    out = np.broadcast_to(np.eye(3), (len(basic), 3, 3)).copy()
    for c in np.unique(cid[cid > 0]).tolist():
        if c not in known:
            raise DeckError(f"frame {c} is not in the deck")
        out[cid == c] = known[c].axes_at(basic[cid == c])
    return out
