"""What the deck itself asks for: the EIGRL, EIGRA (OptiStruct) or EIGR that case control names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult

METHODS = {
    "EIGRL": ("V1", "V2"),
    "EIGRA": ("V1", "V2"),
    "EIGR": ("F1", "F2"),
}  # and their limits, Hz
# of EIGR: their F1 and F2 count only where ND is blank (MSC Nastran Quick Reference Guide, EIGR)
_BY_COUNT = frozenset(("GIV", "MGIV", "AGIV", "HOU", "MHOU", "AHOU"))
FIRST = 40  # modes asked for at first where a deck limits both their number and their frequency


@dataclass(frozen=True, slots=True)
class AskedModes:
    """The lowest `count` modes (0: all) of those between `low` and `high`, Hz; -inf and inf where
    open.
    """

    low: float
    high: float
    count: int

    def of(self, solve: Callable[[ModesRequest], ModesResult]) -> ModesResult:
        """The modes of a solution; it is asked for more until they are enough or pass the upper
        limit.
        """
        if not self.count:
            return solve(ModesRequest(band=(max(self.low, -1.0), self.high)))
        wanted = min(self.count, FIRST) if np.isfinite(self.high) else self.count
        while True:
            found = solve(ModesRequest(wanted))
            f = found.modes.frequencies
            at = np.flatnonzero((f >= self.low) & (f <= self.high))[: self.count]
            if at.size == self.count or (f > self.high).any() or f.size < wanted:
                return replace(found, modes=found.modes.take(at), residuals=found.residuals[at])
            wanted = min(2 * wanted, wanted + self.count - at.size)


def asked_modes(model: Model) -> AskedModes | None:
    """By the method that case control names, or the only one of a deck that names none; None where
    none asks.
    """
    rows = [(card, i) for card in METHODS if card in model for i in range(len(model[card]))]
    if model.case.method:
        rows = [(card, i) for card, i in rows if model[card].ids[i] == model.case.method]
    if len(rows) != 1:
        return None
    card, i = rows[0]
    table = model[card]
    low, high = (float(table[name][i]) for name in METHODS[card])
    if card == "EIGR" and table["ND"][i] > 0 and str(table["METHOD"][i]).upper() in _BY_COUNT:
        low, high = np.nan, np.nan
    asked = AskedModes(
        low if low > 0 else -np.inf, np.inf if np.isnan(high) else high, int(table["ND"][i])
    )
    return asked if asked.count > 0 or max(asked.low, 0.0) < asked.high < np.inf else None
