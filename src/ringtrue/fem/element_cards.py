"""The element cards, how each builds its matrices, and which cards it refers to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.elements import (
    bar,
    bend,
    curved_shell,
    fasteners,
    lumped,
    rod,
    shear,
    shell3,
    shell4,
    solid,
)
from ringtrue.fem.mesh import CardRows, ElementMatrices, Mesh, nodes_of
from ringtrue.fem.nonstructural_mass import nonstructural_mass
from ringtrue.fem.rigid_elements import RIGID
from ringtrue.model.cards import columns, is_unsupported
from ringtrue.model.model import Model, unsupported_card

Build = Callable[[CardRows], ElementMatrices]

ELEMENTS: Mapping[str, Build] = {
    "CROD": rod.build,
    "CONROD": rod.build,
    "CTUBE": rod.build,
    "CBAR": bar.build,
    "CBEAM": bar.build,
    "CBEND": bend.build,
    "CQUAD4": shell4.build,
    "CQUADR": shell4.build,
    "CTRIA3": shell3.build,
    "CTRIAR": shell3.build,
    "CQUAD8": curved_shell.build,
    "CTRIA6": curved_shell.build,
    "CSHEAR": shear.build,
    "CHEXA": solid.HEXA.build,
    "CPENTA": solid.PENTA.build,
    "CPYRAM": solid.PYRAMID.build,
    "CTETRA": solid.TETRA.build,
    "CBUSH": lumped.build_bush,
    "CBUSH1D": lumped.build_bush1d,
    "CGAP": lumped.build_gap,
    "CWELD": fasteners.build_weld,
    "CFAST": fasteners.build_fastener,
    "GENEL": lumped.build_general,
    "CELAS1": lumped.build_spring,
    "CELAS2": lumped.build_spring,
    "CELAS3": lumped.build_spring,
    "CELAS4": lumped.build_spring,
    "CDAMP1": lumped.build_damper,
    "CDAMP2": lumped.build_damper,
    "CDAMP3": lumped.build_damper,
    "CDAMP4": lumped.build_damper,
    "CVISC": lumped.build_line_damper,
    "CMASS1": lumped.build_scalar_mass,
    "CMASS2": lumped.build_scalar_mass,
    "CMASS3": lumped.build_scalar_mass,
    "CMASS4": lumped.build_scalar_mass,
    "CONM1": lumped.build_mass_matrix,
    "CONM2": lumped.build_point_mass,
}
SOLIDS = {s.card: s for s in (solid.HEXA, solid.PENTA, solid.PYRAMID, solid.TETRA)}
# what separates elements that one call cannot build together, (e, k)
KINDS: Mapping[str, Callable[[Model, Int], Int]] = {
    **{card: s.kinds for card, s in SOLIDS.items()},
    "GENEL": lumped.sizes,
}
SHELLS = ("CQUAD4", "CQUADR", "CTRIA3", "CTRIAR", "CQUAD8", "CTRIA6")
PROPERTY = {
    "CROD": "PROD",
    "CTUBE": "PTUBE",
    "CBAR": "PBAR",
    "CBEAM": "PBEAM",
    "CBEND": "PBEND",
    **dict.fromkeys(SHELLS, "PSHELL"),
    "CSHEAR": "PSHEAR",
    "CHEXA": "PSOLID",
    "CPENTA": "PSOLID",
    "CPYRAM": "PSOLID",
    "CTETRA": "PSOLID",
    "CBUSH": "PBUSH",
    "CBUSH1D": "PBUSH1D",
    "CGAP": "PGAP",
    "CWELD": "PWELD",
    "CFAST": "PFAST",
    "CELAS1": "PELAS",
    "CELAS3": "PELAS",
    "CDAMP1": "PDAMP",
    "CDAMP3": "PDAMP",
    "CVISC": "PVISC",
    "CMASS1": "PMASS",
    "CMASS3": "PMASS",
}
MATERIALS = ("MAT1", "MAT2", "MAT8", "MAT9")
MATERIAL = {
    "PROD": ("MID",),
    "PTUBE": ("MID",),
    "CONROD": ("MID",),
    "PBAR": ("MID",),
    "PBEAM": ("MID",),
    "PBEND": ("MID",),
    "PWELD": ("MID",),
    "PSHEAR": ("MID",),
    "PSOLID": ("MID",),
    "PSHELL": ("MID1", "MID2", "MID3", "MID4"),
}


def refuse(model: Model) -> None:
    """Raise UnsupportedCard if the deck holds a card with stiffness, mass or constraint that is not
    assembled.
    """
    for card in sorted(filter(is_unsupported, model.kept)):
        raise UnsupportedCard(
            card, why=f"{model.kept[card]} in the deck; replace or remove it"
        )
    known = ELEMENTS.keys() | RIGID.keys()
    for card, table in model.tables.items():
        if len(table) and columns(card)[0].name == "EID" and card not in known:
            why = "is read, but not assembled; replace or remove it"
            raise unsupported_card(model, table, 0, why)


def batches(
    model: Model, rows: Mapping[str, Int] | None = None
) -> Iterator[tuple[str, Int]]:
    """(card, rows) of like elements, which one call builds; all rows of all cards, or those
    given.
    """
    for card in ELEMENTS:
        if card not in model or (rows is not None and card not in rows):
            continue
        at = np.arange(len(model[card])) if rows is None else rows[card]
        if card not in KINDS:
            groups = [at]
        else:
            _, kind = np.unique(KINDS[card](model, at), axis=0, return_inverse=True)
            kind = kind.ravel()
            groups = [at[kind == k] for k in np.unique(kind)]
        yield from ((card, group) for group in groups if group.size)


def pieces(
    m: Mesh, rows: Mapping[str, Int] | None = None, size: int = 8192
) -> Iterator[tuple[str, Int, ElementMatrices]]:
    """Card, rows and matrices of elements, all or those given, `size` at a time at most."""
    for card, every in batches(m.model, rows):
        for first in range(0, every.size, size):
            at = every[first : first + size]
            yield card, at, ELEMENTS[card](m.rows(card, at))


def mesh(model: Model) -> Mesh:
    """The nodes of a model, with the non-structural mass of the lists that case control chooses.

    Raises
    ------
    DeckError
        If there is neither GRID nor scalar point, an id occurs twice, a frame is absent, or a list
        names nothing that carries non-structural mass.
    """
    return with_listed_mass(nodes_of(model))


def with_listed_mass(m: Mesh) -> Mesh:
    """A mesh with the non-structural mass of the lists that its case control chooses."""
    if not m.model.case.nsm:
        return m
    return replace(m, added=nonstructural_mass(m))
