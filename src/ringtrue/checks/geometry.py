"""The shape of the elements: collapsed, warped, stretched, inside out."""

from __future__ import annotations

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.model.frames import positions
from ringtrue.model.model import Model

WARP = 0.05  # out-of-plane height of a corner over the mean side
ASPECT = 20.0  # longest over shortest side
FLAT = 1e-8  # area or volume over that of the square or cube on the longest side
_LINES = {
    "CROD": ("G1", "G2"),
    "CTUBE": ("G1", "G2"),
    "CONROD": ("G1", "G2"),
    "CBAR": ("GA", "GB"),
    "CBEAM": ("GA", "GB"),
}
_CORNERS = {"CTRIA3": 3, "CQUAD4": 4, "CTETRA": 4, "CPENTA": 6, "CHEXA": 8}


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
    for card, count in _CORNERS.items():
        if card in model:
            x, rows = _points(model, xyz, card, tuple(f"G{i + 1}" for i in range(count)))
            found += _surface(model, card, x, rows) if count < 5 and card != "CTETRA" else _solid(model, card, x, rows)
    return found


def _points(model: Model, xyz: Float, card: str, names: tuple[str, ...]) -> tuple[Float, Int]:
    """Corners (e, k, 3) and rows (e,) of the elements with all their nodes present."""
    at = model["GRID"].find(model[card].stack(*names))
    rows = np.flatnonzero((at >= 0).all(axis=1))
    return xyz[at[rows]], rows


def _report(model: Model, card: str, rows: Int, severity: str, what: str) -> list[Finding]:
    return [at_rows(model, card, rows, "error" if severity == "error" else "warning", what)] if rows.size else []


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
    found = _report(model, card, rows[flat], "error", "is collapsed: no area, or two corners at one place")
    good = ~flat
    slender = good & (longest > ASPECT * np.where(good, shortest, 1.0))
    found += _report(model, card, rows[slender], "warning", f"has an aspect ratio over {ASPECT:g}")
    if x.shape[1] == 4:
        found += _quads(model, card, x, rows, normal, good)
    return found


def _quads(model: Model, card: str, x: Float, rows: Int, normal: Float, good: Bool) -> list[Finding]:
    unit = normal / np.where(good, np.linalg.norm(normal, axis=1), 1.0)[:, None]
    height = abs(np.einsum("ij,ij->i", x[:, 1] - x[:, 0], unit)) / 2
    warped = good & (height > WARP * _sides(x).mean(axis=1))
    found = _report(model, card, rows[warped], "warning", f"is warped by more than {WARP:g} of its mean side")
    before, after = np.roll(x, 1, axis=1) - x, np.roll(x, -1, axis=1) - x
    turn = np.einsum("ekj,ej->ek", np.cross(after, before), unit)
    reentrant = good & (turn <= 0).any(axis=1)
    return found + _report(model, card, rows[reentrant], "error", "has a corner of 180 degrees or more")


def _solid(model: Model, card: str, x: Float, rows: Int) -> list[Finding]:
    """Signed volume by the Jacobian in the middle, over the cube on the longest extent."""
    volume = np.linalg.det(_middle(x))
    size = np.ptp(x, axis=1).max(axis=1)
    flat = abs(volume) <= FLAT * size**3
    found = _report(model, card, rows[flat], "error", "is collapsed: no volume")
    return found + _report(model, card, rows[~flat & (volume < 0)], "error", "is inside out: negative volume")


def _middle(x: Float) -> Float:
    """Three vectors (e, 3, 3) through the middle of solids, a right-handed set if the solid is valid."""
    if x.shape[1] == 4:
        return x[:, 1:] - x[:, :1]
    if x.shape[1] == 6:
        low, high = x[:, :3], x[:, 3:]
        mid = (low + high) / 2
        return np.stack([mid[:, 1] - mid[:, 0], mid[:, 2] - mid[:, 0], (high - low).mean(axis=1)], axis=1)
    pairs = (([1, 2, 5, 6], [0, 3, 4, 7]), ([2, 3, 6, 7], [0, 1, 4, 5]), ([4, 5, 6, 7], [0, 1, 2, 3]))
    return np.stack([x[:, a].mean(axis=1) - x[:, b].mean(axis=1) for a, b in pairs], axis=1)
