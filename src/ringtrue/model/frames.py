"""Coordinate frames of a model, resolved to the basic frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import DeckError
from ringtrue.model.model import Model, Table, called, card_error, refuse_rows

_DEGREE = np.pi / 180


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Frames in basic.

    Attributes
    ----------
    cid : (n,) int64
        Ascending; 0, the basic frame, is the first.
    origin : (n, 3) float64
    axes : (n, 3, 3) float64
        Unit vectors as rows.
    kind : (n,) str
        R, C or S (degrees).
    """

    cid: Int
    origin: Float
    axes: Float
    kind: NDArray[np.str_]

    def find(self, cid: Int) -> Int:
        """Row of each frame (k,), -1 where absent."""
        at = np.searchsorted(self.cid, cid).clip(max=self.cid.size - 1)
        return np.where(self.cid[at] == cid, at, -1)

    def to_basic(self, row: Int, x: Float) -> Float:
        """Coordinates (k, 3), each in the frame of its row (k,), to basic (k, 3)."""
        kind = self.kind[row]
        u = x.copy()
        c = np.flatnonzero(kind == "C")
        s = np.flatnonzero(kind == "S")
        r = x[c, 0]
        t = x[c, 1] * _DEGREE
        u[c, 0] = r * np.cos(t)
        u[c, 1] = r * np.sin(t)
        r = x[s, 0]
        t = x[s, 1] * _DEGREE
        p = x[s, 2] * _DEGREE
        u[s] = np.stack(
            [r * np.sin(t) * np.cos(p), r * np.sin(t) * np.sin(p), r * np.cos(t)],
            axis=1,
        )
        return np.asarray(self.origin[row] + np.einsum("ki,kij->kj", u, self.axes[row]))

    def axes_at(self, row: Int, x: Float) -> Float:
        """Local unit vectors as rows (k, 3, 3) at points (k, 3) of basic, each of the frame of its
        row (k,).
        """
        out = self.axes[row]
        kind = self.kind[row]
        round_ = np.flatnonzero(kind != "R")
        if round_.size:
            at = row[round_]
            d = np.einsum("ki,kji->kj", x[round_] - self.origin[at], self.axes[at])
            c, s, _ = _azimuth(d)
            zero = np.zeros(len(d))
            cylindrical = np.stack(
                [c, s, zero, -s, c, zero, zero, zero, zero + 1], axis=1
            ).reshape(-1, 3, 3)
            local = np.where(
                (kind[round_] == "C")[:, None, None], cylindrical, _spherical(d)
            )
            out[round_] = local @ self.axes[at]
        return out


def _spherical(d: Float) -> Float:
    c, s, rho = _azimuth(d)
    r = np.linalg.norm(d, axis=1)
    safe = np.where(r > 0, r, 1.0)
    ct = np.where(r > 0, d[:, 2] / safe, 1.0)
    st = rho / safe
    return np.stack(
        [st * c, st * s, ct, ct * c, ct * s, -st, -s, c, np.zeros(len(d))], axis=1
    ).reshape(-1, 3, 3)


def _azimuth(d: Float) -> tuple[Float, Float, Float]:
    """Cosine and sine of the azimuth, 1 and 0 on the axis, and the distance from the axis."""
    rho = np.hypot(d[:, 0], d[:, 1])
    safe = np.where(rho > 0, rho, 1.0)
    return (
        np.where(rho > 0, d[:, 0] / safe, 1.0),
        np.where(rho > 0, d[:, 1] / safe, 0.0),
        rho,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """Cards of one name: their three points (n, 3, 3), in the frames `of` (n, 3)."""

    table: Table
    points: Float
    of: Int


def _given(model: Model) -> list[_Given]:
    made = []
    for kind in "RCS":
        if (card := f"CORD2{kind}") in model:
            t = model[card]
            points = t.stack(
                "A1", "A2", "A3", "B1", "B2", "B3", "C1", "C2", "C3"
            ).reshape(-1, 3, 3)
            made.append(_Given(t, points, np.repeat(t["RID"][:, None], 3, axis=1)))
        if (card := f"CORD1{kind}") in model:
            t = model[card]
            grid = model["GRID"]
            nodes = t.stack("G1", "G2", "G3")
            at = grid.find(nodes)
            if (at < 0).any():
                row, k = np.argwhere(at < 0)[0].tolist()
                raise card_error(
                    model, t, row, f"node {nodes[row, k]} is not in the deck"
                )
            made.append(_Given(t, grid.stack("X1", "X2", "X3")[at], grid["CP"][at]))
    return made


def frames(model: Model) -> Frames:
    """All frames, basic among them.

    Raises
    ------
    DeckError
        On a frame that refers to one that is absent or to itself, or whose three points lie on one
        line.
    """
    known = Frames(
        np.zeros(1, dtype=np.int64), np.zeros((1, 3)), np.eye(3)[None], np.array(["R"])
    )
    given = _given(model)
    todo = [np.ones(len(g.table), dtype=bool) for g in given]
    # as often as the longest chain of frames is long
    while any(left.any() for left in todo):
        ready = [
            left & (known.find(g.of) >= 0).all(axis=1)
            for g, left in zip(given, todo, strict=True)
        ]
        if not any(r.any() for r in ready):
            rows = [
                (g.table, int(i))
                for g, left in zip(given, todo, strict=True)
                for i in np.flatnonzero(left)
            ]
            what = (
                "refer to frames that are not in the deck, or to each other in a circle"
            )
            raise card_error(model, *rows[0], f"{called(model, rows)} {what}")
        new = (_resolved(model, known, g, r) for g, r in zip(given, ready, strict=True))
        known = _joined([known, *new])
        todo = [left & ~r for left, r in zip(todo, ready, strict=True)]
    return known


def _resolved(model: Model, known: Frames, g: _Given, ready: Bool) -> Frames:
    rows = np.flatnonzero(ready)
    of = known.find(g.of[rows].ravel())
    points = known.to_basic(of, g.points[rows].reshape(-1, 3)).reshape(-1, 3, 3)
    a = points[:, 0]
    z = points[:, 1] - points[:, 0]
    side = points[:, 2] - points[:, 0]
    y = np.cross(z, side)
    height = np.linalg.norm(z, axis=1)
    wide = np.linalg.norm(y, axis=1)
    # the sine between them: below that they are one line
    flat = (height == 0) | (wide <= 1e-12 * height * np.linalg.norm(side, axis=1))
    refuse_rows(model, g.table, rows[flat], "its three points lie on one line")
    z = z / height[:, None]
    y = y / wide[:, None]
    kind = np.full(rows.size, g.table.card[-1])
    return Frames(g.table.ids[rows], a, np.stack([np.cross(y, z), y, z], axis=1), kind)


def _joined(parts: list[Frames]) -> Frames:
    cid, origin, axes_, kind = (
        np.concatenate([getattr(p, n) for p in parts])
        for n in ("cid", "origin", "axes", "kind")
    )
    order = np.argsort(cid, kind="stable")
    return Frames(cid[order], origin[order], axes_[order], kind[order])


def positions(model: Model) -> Float:
    """Basic coordinates of the GRID rows, (n, 3) float64.

    Raises
    ------
    DeckError
        If a frame is absent.
    """
    grid = model["GRID"]
    x = grid.stack("X1", "X2", "X3")
    cp = grid["CP"]
    known = frames(model)
    out = x.copy()
    at = np.flatnonzero(cp != 0)
    row = known.find(cp[at])
    lost = at[row < 0]
    if lost.size:
        refuse_rows(model, grid, lost, f"frame CP {cp[lost[0]]} is not in the deck")
    out[at] = known.to_basic(row, x[at])
    return out


def diagonal(xyz: Float) -> float:
    """The diagonal of the box about points (n, 3), 0 without two places."""
    return float(np.linalg.norm(np.ptp(xyz, axis=0))) if len(xyz) else 0.0


def extent(model: Model) -> float:
    """The diagonal of the box about all nodes."""
    return diagonal(positions(model))


def axes(model: Model, cid: Int, basic: Float) -> Float:
    """Unit vectors (rows) of frame `cid` (n,) at points `basic` (n, 3): (n, 3, 3) float64.

    Raises
    ------
    DeckError
        If a frame is absent.
    """
    out = np.broadcast_to(np.eye(3), (len(basic), 3, 3)).copy()
    at = np.flatnonzero(cid > 0)
    if at.size:
        known = frames(model)
        row = known.find(cid[at])
        lost = cid[at[row < 0]]
        if lost.size:
            raise DeckError(f"frame {lost[0]} is not in the deck")
        out[at] = known.axes_at(row, basic[at])
    return out
