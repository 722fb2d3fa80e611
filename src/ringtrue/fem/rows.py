"""Sets of elements: the rows, ascending, that are meant of each element card's table."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ringtrue.core.arrays import Int

Rows = dict[str, Int]  # card -> (r,) rows of its table


def union(parts: Iterable[Rows]) -> Rows:
    """Rows that are in any of the parts."""
    out: Rows = {}
    for rows in parts:
        for card, at in rows.items():
            out[card] = np.union1d(out[card], at) if card in out else at
    return out


def common(a: Rows, b: Rows) -> Rows:
    """Rows that are in both."""
    both = {card: np.intersect1d(at, b[card]) for card, at in a.items() if card in b}
    return {card: at for card, at in both.items() if at.size}


def without(a: Rows, b: Rows) -> Rows:
    """Rows of the first that are not in the second."""
    rest = {card: np.setdiff1d(at, b.get(card, at[:0])) for card, at in a.items()}
    return {card: at for card, at in rest.items() if at.size}
