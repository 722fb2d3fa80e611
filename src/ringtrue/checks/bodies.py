"""Masses and inertias of nodes that no body has, or none of the size of the model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Float
from ringtrue.model.frames import extent
from ringtrue.model.model import Model, Table

_ZERO = 1e-9  # of the largest entry: rounding of what is written in eight characters
WIDE = 2.0  # a radius of gyration over the size of the model
_PAIRS = tuple((i, j) for i in range(1, 7) for j in range(1, i + 1))


def body_findings(model: Model) -> Iterator[Finding]:
    """CONM2 of negative mass or principal inertia, CONM1 with a negative eigenvalue."""
    for card, matrices in (("CONM2", _bodies), ("CONM1", _matrices)):
        if card in model:
            lowest = [
                np.linalg.eigvalsh(m)[:, 0] + _ZERO * np.abs(m).max(axis=(1, 2))
                for m in matrices(model[card])
            ]
            rows = np.flatnonzero((np.stack(lowest) < 0).any(axis=0))
            if rows.size:
                what = (
                    "no body has this mass or inertia: it is negative in some direction; "
                    "check its signs"
                )
                yield at_rows(model, card, rows, "warning", what)


def wide_findings(model: Model) -> Iterator[Finding]:
    """CONM2 whose radius of gyration is far over the size of the model, as with M and I in
    different units.
    """
    if "CONM2" not in model or "GRID" not in model or not (size := extent(model)):
        return
    mass, inertia = (np.asarray(v) for v in _bodies(model["CONM2"]))
    m, largest = mass[:, 0, 0], np.abs(inertia).max(axis=(1, 2))
    rows = np.flatnonzero((m > 0) & (largest > (WIDE * size) ** 2 * m))
    if rows.size:
        radius = np.sqrt(largest[rows[0]] / m[rows[0]])
        what = (
            f"its radius of gyration is {radius:.3g}, the model {size:.3g} in size: are M and "
            "I in one unit system?"
        )
        yield at_rows(model, "CONM2", rows, "warning", what)


def _bodies(t: Table) -> tuple[Float, Float]:
    """Mass (e, 1, 1) and inertia about the centre (e, 3, 3)."""
    return np.asarray(t["M"], dtype=np.float64)[:, None, None], _symmetric(t, "I", 3, -1)


def _matrices(t: Table) -> tuple[Float]:
    return (_symmetric(t, "M", 6, 1),)


def _symmetric(t: Table, letter: str, n: int, sign: int) -> Float:
    """The matrix (e, n, n) of fields such as I21, those off the diagonal times `sign`."""
    out = np.zeros((len(t), n, n))
    for i, j in (p for p in _PAIRS if p[0] <= n):
        out[:, i - 1, j - 1] = out[:, j - 1, i - 1] = t[f"{letter}{i}{j}"] * (1 if i == j else sign)
    return out
