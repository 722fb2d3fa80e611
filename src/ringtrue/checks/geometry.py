"""The shape of the elements: collapsed, warped, stretched, inside out."""

from __future__ import annotations

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.model.frames import positions
from ringtrue.model.model import Model

WARP = 0.05  # out-of-plane height of a corner over the mean side
ASPECT = 20.0  # longest over shortest side
JACOBIAN = 0.1  # smallest over largest determinant at the corners
MIDDLE = 0.25  # a mid-side node must project between this and 1 - this of its edge
FLAT = 1e-8  # area or volume over that of the square or cube on the longest side
_LINES = {
    "CROD": ("G1", "G2"),
    "CTUBE": ("G1", "G2"),
    "CONROD": ("G1", "G2"),
    "CBAR": ("GA", "GB"),
    "CBEAM": ("GA", "GB"),
    "CBEND": ("GA", "GB"),
}
_SURFACES = {
    "CTRIA3": 3,
    "CTRIAR": 3,
    "CTRIA6": 3,
    "CQUAD4": 4,
    "CQUADR": 4,
    "CQUAD8": 4,
    "CSHEAR": 4,
}
_SOLIDS = {"CTETRA": 4, "CPYRAM": 5, "CPENTA": 6, "CHEXA": 8}
# the corners that edges join to each corner, right-handed; the apex of a pyramid has four: left out
_SPOKES = {
    "CTETRA": ((1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1)),
    "CPYRAM": ((1, 3, 4), (2, 0, 4), (3, 1, 4), (0, 2, 4)),
    "CPENTA": ((1, 2, 3), (2, 0, 4), (0, 1, 5), (5, 4, 0), (3, 5, 1), (4, 3, 2)),
    "CHEXA": (
        (1, 3, 4),
        (2, 0, 5),
        (3, 1, 6),
        (0, 2, 7),
        (7, 5, 0),
        (4, 6, 1),
        (5, 7, 2),
        (6, 4, 3),
    ),
}
# corners that each mid-side node stands between, in the order of the nodes behind the corners
_MIDDLES = {
    "CTRIA6": ((0, 1), (1, 2), (2, 0)),
    "CQUAD8": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "CTETRA": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "CPYRAM": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
    "CPENTA": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3)),
    "CHEXA": (
        *((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 5), (2, 6), (3, 7)),
        *((4, 5), (5, 6), (6, 7), (7, 4)),
    ),
}


def check_geometry(model: Model) -> list[Finding]:
    """Findings on the shape of all elements whose nodes are in the model."""
    if "GRID" not in model or not len(model["GRID"]):
        return []
    xyz = positions(model)
    found: list[Finding] = []
    for card, names in _LINES.items():
        if card in model:
            x, rows = _points(model, xyz, card, names)
            length = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
            found += _report(model, card, rows[length == 0], "error", "has no length")
    for card, count in (_SURFACES | _SOLIDS).items():
        if card in model:
            x, rows = _points(model, xyz, card, tuple(f"G{i + 1}" for i in range(count)))
            found += (
                _surface(model, card, x, rows)
                if card in _SURFACES
                else _solid(model, card, x, rows)
            )
            found += _middles(model, xyz, card, count) if card in _MIDDLES else []
    return found


def _middles(model: Model, xyz: Float, card: str, corners: int) -> list[Finding]:
    """Mid-side nodes outside the middle half of their edge: the mapping folds over (Zienkiewicz,
    Taylor, 2000).
    """
    table, grid = model[card], model["GRID"]
    wrong = np.zeros(len(table), dtype=bool)
    for k, (a, b) in enumerate(_MIDDLES[card]):
        at = grid.find(table.stack(f"G{a + 1}", f"G{b + 1}", f"G{corners + k + 1}"))
        rows = np.flatnonzero((at >= 0).all(axis=1))
        p, q, mid = xyz[at[rows]].swapaxes(0, 1)
        edge = q - p
        length = np.einsum("ij,ij->i", edge, edge)
        along = np.einsum("ij,ij->i", mid - p, edge) / np.where(length > 0, length, 1.0)
        wrong[rows] |= (length > 0) & ((along < MIDDLE) | (along > 1 - MIDDLE))
    return _report(
        model,
        card,
        np.flatnonzero(wrong),
        "error",
        "has a mid-side node outside the middle half of its edge",
    )


def _points(model: Model, xyz: Float, card: str, names: tuple[str, ...]) -> tuple[Float, Int]:
    """Corners (e, k, 3) and rows (e,) of the elements with all their nodes present."""
    at = model["GRID"].find(model[card].stack(*names))
    rows = np.flatnonzero((at >= 0).all(axis=1))
    return xyz[at[rows]], rows


def _report(model: Model, card: str, rows: Int, severity: str, what: str) -> list[Finding]:
    return (
        [at_rows(model, card, rows, "error" if severity == "error" else "warning", what)]
        if rows.size
        else []
    )


def _sides(x: Float) -> Float:
    """Lengths of the sides of polygons (e, k, 3): (e, k)."""
    return np.asarray(np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2))


def _surface(model: Model, card: str, x: Float, rows: Int) -> list[Finding]:
    sides = _sides(x)
    longest, shortest = sides.max(axis=1), sides.min(axis=1)
    if x.shape[1] == 4:
        normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    else:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    flat = (area <= FLAT * longest**2) | (shortest == 0)
    found = _report(
        model, card, rows[flat], "error", "is collapsed: no area, or two corners at one place"
    )
    good = ~flat
    slender = good & (longest > ASPECT * np.where(good, shortest, 1.0))
    found += _report(model, card, rows[slender], "warning", f"has an aspect ratio over {ASPECT:g}")
    if x.shape[1] == 4:
        found += _quads(model, card, x, rows, normal, good)
    return found


def _quads(
    model: Model, card: str, x: Float, rows: Int, normal: Float, good: Bool
) -> list[Finding]:
    unit = normal / np.where(good, np.linalg.norm(normal, axis=1), 1.0)[:, None]
    height = abs(np.einsum("ij,ij->i", x[:, 1] - x[:, 0], unit)) / 2
    warped = good & (height > WARP * _sides(x).mean(axis=1))
    found = _report(
        model, card, rows[warped], "warning", f"is warped by more than {WARP:g} of its mean side"
    )
    before, after = np.roll(x, 1, axis=1) - x, np.roll(x, -1, axis=1) - x
    turn = np.einsum(
        "ekj,ej->ek", np.cross(after, before), unit
    )  # Jacobian at the corners, times 4
    skew = good & (turn > 0).all(axis=1) & (turn.min(axis=1) < JACOBIAN * turn.max(axis=1))
    found += _report(
        model, card, rows[skew], "warning", f"has corner Jacobians of a ratio under {JACOBIAN:g}"
    )
    reentrant = good & (turn <= 0).any(axis=1)
    return found + _report(
        model, card, rows[reentrant], "error", "has a corner of 180 degrees or more"
    )


def _solid(model: Model, card: str, x: Float, rows: Int) -> list[Finding]:
    """Signed volume by the Jacobian in the middle, over the cube on the longest extent."""
    volume = np.linalg.det(_middle(x))
    size = np.ptp(x, axis=1).max(axis=1)
    flat = abs(volume) <= FLAT * size**3
    found = _report(model, card, rows[flat], "error", "is collapsed: no volume")
    good = ~flat & (volume > 0)
    found += _report(
        model, card, rows[~flat & (volume < 0)], "error", "is inside out: negative volume"
    )
    return found + _corners(model, card, x, rows, good)


def _corners(model: Model, card: str, x: Float, rows: Int, good: Bool) -> list[Finding]:
    """Jacobians at the corners, and the ratio of the edges."""
    spokes = np.array(_SPOKES[card])
    edges = x[:, spokes] - x[:, : len(spokes), None]
    corner = np.linalg.det(edges)
    size = np.ptp(x, axis=1).max(axis=1)
    folded = good & (corner.min(axis=1) <= FLAT * size**3)
    found = _report(
        model, card, rows[folded], "error", "is folded: no positive Jacobian at a corner"
    )
    skew = good & ~folded & (corner.min(axis=1) < JACOBIAN * corner.max(axis=1))
    found += _report(
        model, card, rows[skew], "warning", f"has corner Jacobians of a ratio under {JACOBIAN:g}"
    )
    length = np.linalg.norm(edges, axis=3).reshape(len(x), spokes.size)
    slender = good & (length.max(axis=1) > ASPECT * length.min(axis=1))
    return found + _report(
        model, card, rows[slender], "warning", f"has an aspect ratio over {ASPECT:g}"
    )


def _middle(x: Float) -> Float:
    """Three vectors (e, 3, 3) through the middle of solids, a right-handed set if the solid is
    valid.
    """
    if x.shape[1] == 4:
        return x[:, 1:] - x[:, :1]
    if x.shape[1] == 5:
        base = x[:, :4]
        return np.stack(
            [base[:, 1] - base[:, 3], base[:, 2] - base[:, 0], 2 * (x[:, 4] - base.mean(axis=1))],
            axis=1,
        )
    if x.shape[1] == 6:
        low, high = x[:, :3], x[:, 3:]
        mid = (low + high) / 2
        return np.stack(
            [mid[:, 1] - mid[:, 0], mid[:, 2] - mid[:, 0], (high - low).mean(axis=1)], axis=1
        )
    pairs = (
        ([1, 2, 5, 6], [0, 3, 4, 7]),
        ([2, 3, 6, 7], [0, 1, 4, 5]),
        ([4, 5, 6, 7], [0, 1, 2, 3]),
    )
    return np.stack([x[:, a].mean(axis=1) - x[:, b].mean(axis=1) for a, b in pairs], axis=1)
