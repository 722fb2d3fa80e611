"""The element cards, how each builds its matrices, and which cards it refers to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.elements import (
    bar,
    bend,
    bush,
    damper,
    fast,
    gap,
    general,
    hexa,
    mass,
    penta,
    pyramid,
    rod,
    shear,
    shell3,
    shell4,
    shell8,
    spring,
    tetra,
    weld,
)
from ringtrue.fem.elements.solid import alike
from ringtrue.fem.mesh import Matrices, Mesh
from ringtrue.fem.rigid import RIGID
from ringtrue.model.cards import columns, is_unsupported
from ringtrue.model.model import Model

Build = Callable[[Mesh, str, Int], Matrices]

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
    "CQUAD8": shell8.build,
    "CTRIA6": shell8.build,
    "CSHEAR": shear.build,
    "CHEXA": hexa.build,
    "CPENTA": penta.build,
    "CPYRAM": pyramid.build,
    "CTETRA": tetra.build,
    "CBUSH": bush.build,
    "CBUSH1D": gap.build,
    "CGAP": gap.build_gap,
    "CWELD": weld.build,
    "CFAST": fast.build,
    "GENEL": general.build,
    "CELAS1": spring.build,
    "CELAS2": spring.build,
    "CELAS3": spring.build,
    "CELAS4": spring.build,
    "CDAMP1": damper.build,
    "CDAMP2": damper.build,
    "CDAMP3": damper.build,
    "CDAMP4": damper.build,
    "CVISC": damper.build_line,
    "CMASS1": spring.build_mass,
    "CMASS2": spring.build_mass,
    "CMASS3": spring.build_mass,
    "CMASS4": spring.build_mass,
    "CONM1": mass.build_matrix,
    "CONM2": mass.build,
}
SOLIDS = {s.card: s for s in (hexa.HEXA, penta.PENTA, pyramid.PYRAMID, tetra.TETRA)}
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
    found = sorted(c for c in model.kept if is_unsupported(c))
    if found:
        raise UnsupportedCard(
            found[0], why=f"{model.kept[found[0]]} in the deck; replace or remove it"
        )
    for card, table in model.tables.items():
        if (
            len(table)
            and columns(card)[0].name == "EID"
            and card not in ELEMENTS
            and card not in RIGID
        ):
            known = 0 <= table.file[0] < len(model.files)
            path, line = (model.files[table.file[0]], int(table.line[0])) if known else (None, None)
            raise UnsupportedCard(
                card,
                path=path,
                line=line,
                why="it is read, but not assembled; replace or remove it",
            )


def batches(
    model: Model, rows: Mapping[str, Int] | None = None
) -> Iterable[tuple[str, Build, Int]]:
    """(card, builder, rows) of like elements; all rows of all cards, or those given."""
    for card, build in ELEMENTS.items():
        if card not in model:
            continue
        at = (
            np.arange(len(model[card]))
            if rows is None
            else rows.get(card, np.empty(0, dtype=np.int64))
        )
        groups: Iterable[Int] = [at] if at.size else []
        if card in SOLIDS:
            groups = alike(SOLIDS[card], model, at)
        elif card == "GENEL":
            groups = general.alike(model, at)
        yield from ((card, build, group) for group in groups)
