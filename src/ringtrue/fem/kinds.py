"""The element cards, how each builds its matrices, and which cards it refers to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from ringtrue.core.arrays import Bool, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.elements import bar, bush, hexa, mass, penta, rod, shell3, shell4, spring, tetra
from ringtrue.fem.mesh import Matrices, Mesh
from ringtrue.model.cards import is_unsupported
from ringtrue.model.model import Model, Table

Build = Callable[[Mesh, str, Int], Matrices]

ELEMENTS: Mapping[str, Build] = {
    "CROD": rod.build,
    "CONROD": rod.build,
    "CTUBE": rod.build,
    "CBAR": bar.build,
    "CBEAM": bar.build,
    "CQUAD4": shell4.build,
    "CTRIA3": shell3.build,
    "CHEXA": hexa.build,
    "CPENTA": penta.build,
    "CTETRA": tetra.build4,
    "CBUSH": bush.build,
    "CELAS1": spring.build,
    "CELAS2": spring.build,
    "CMASS1": spring.build_mass,
    "CMASS2": spring.build_mass,
    "CONM2": mass.build,
}
PROPERTY = {
    "CROD": "PROD",
    "CTUBE": "PTUBE",
    "CBAR": "PBAR",
    "CBEAM": "PBEAM",
    "CQUAD4": "PSHELL",
    "CTRIA3": "PSHELL",
    "CHEXA": "PSOLID",
    "CPENTA": "PSOLID",
    "CTETRA": "PSOLID",
    "CBUSH": "PBUSH",
    "CELAS1": "PELAS",
    "CMASS1": "PMASS",
}
MATERIAL = {
    "PROD": ("MID",),
    "PTUBE": ("MID",),
    "CONROD": ("MID",),
    "PBAR": ("MID",),
    "PBEAM": ("MID",),
    "PSOLID": ("MID",),
    "PSHELL": ("MID1", "MID2", "MID3"),
}


def refuse(model: Model) -> None:
    """Raise UnsupportedCard if the deck holds a card with stiffness, mass or constraint that is not assembled."""
    found = sorted(c for c in model.kept if is_unsupported(c))
    if found:
        raise UnsupportedCard(found[0], why=f"{model.kept[found[0]]} in the deck; replace or remove it")


def batches(model: Model, rows: Mapping[str, Int] | None = None) -> Iterable[tuple[str, Build, Int]]:
    """(card, builder, rows) of like elements; all rows of all cards, or those given."""
    for card, build in ELEMENTS.items():
        if card not in model:
            continue
        at = np.arange(len(model[card])) if rows is None else rows.get(card, np.empty(0, dtype=np.int64))
        if card == "CTETRA" and "G5" in model[card].columns:
            high = (model[card].stack("G5", "G6", "G7", "G8", "G9", "G10")[at] > 0).any(axis=1)
            if high.any():
                yield card, tetra.build10, at[high]
            at = at[~high]
        if at.size:
            yield card, build, at


def affected(model: Model, ids: Mapping[str, Int]) -> dict[str, Int]:
    """Rows of each element card that use one of the cards `ids` (card: ids), directly or through a property."""
    out = {}
    for card in ELEMENTS:
        if card in model and (at := np.flatnonzero(_uses(model, card, ids))).size:
            out[card] = at
    return out


def _uses(model: Model, card: str, ids: Mapping[str, Int]) -> Bool:
    t = model[card]
    hit: Bool = np.isin(t.ids, ids.get(card, ())) | _materials(t, card, ids)
    name = PROPERTY.get(card)
    if name and name in model:
        p = model[name]
        chosen = np.isin(p.ids, ids.get(name, ())) | _materials(p, name, ids)
        hit |= np.isin(t["PID"], p.ids[chosen])
    return np.asarray(hit)


def _materials(t: Table, card: str, ids: Mapping[str, Int]) -> Bool:
    wanted = ids.get("MAT1", ())
    if card not in MATERIAL:
        return np.zeros(len(t), dtype=bool)
    return np.asarray(np.isin(t.stack(*MATERIAL[card]), wanted).any(axis=1))
