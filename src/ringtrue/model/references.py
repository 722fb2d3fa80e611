"""Which field of a card names a row of which other card."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.model.model import Model

FRAMES = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
NODES = ("GRID", "SPOINT")
SHELLS = ("CTRIA3", "CQUAD4", "CTRIAR", "CQUADR", "CTRIA6", "CQUAD8")
SHELL_PROPERTIES = ("PSHELL", "PCOMP", "PCOMPG")
PLY_MATERIALS = ("MAT1", "MAT2", "MAT8")
SOLID_MATERIALS = ("MAT1", "MAT9")


@dataclass(frozen=True, slots=True)
class CardReference:
    """Field `card.field` holds ids of one of the cards `of`; `required`: 0 (blank) is no valid
    value.
    """

    card: str
    field: str
    of: tuple[str, ...]
    required: bool = True

    @property
    def names(self) -> str:
        """What the field may name, in words: `MAT1, MAT2 or MAT8`."""
        if self.of == FRAMES:
            return "coordinate frame"
        return " or ".join(x for x in (", ".join(self.of[:-1]), self.of[-1]) if x)


def _nodes(card: str, required: str, optional: str = "") -> list[CardReference]:
    made = [CardReference(card, f, NODES) for f in required.split()]
    return made + [CardReference(card, f, NODES, False) for f in optional.split()]


def _numbered(first: int, last: int) -> str:
    return " ".join(f"G{i}" for i in range(first, last + 1))


REFERENCES: tuple[CardReference, ...] = (
    *(CardReference("GRID", f, FRAMES, False) for f in ("CP", "CD")),
    *(r for k in "RCS" for r in _nodes(f"CORD1{k}", "G1 G2 G3")),
    *(CardReference(f"CORD2{k}", "RID", FRAMES, False) for k in "RCS"),
    *_nodes("CROD", "G1 G2"),
    *_nodes("CTUBE", "G1 G2"),
    *_nodes("CONROD", "G1 G2"),
    *_nodes("CBAR", "GA GB", "G0"),
    *_nodes("CBEAM", "GA GB", "G0 SA SB"),
    *_nodes("CTRIA3", _numbered(1, 3)),
    *_nodes("CQUAD4", _numbered(1, 4)),
    *_nodes("CTRIAR", _numbered(1, 3)),
    *_nodes("CQUADR", _numbered(1, 4)),
    *_nodes("CTRIA6", _numbered(1, 3), _numbered(4, 6)),
    *_nodes("CQUAD8", _numbered(1, 4), _numbered(5, 8)),
    *_nodes("CBEND", "GA GB", "G0"),
    *_nodes("CWELD", "", "GS GA GB GA1 GA2 GA3 GA4 GB1 GB2 GB3 GB4"),
    *_nodes("CFAST", "", "GS GA GB"),
    *_nodes("CSHEAR", _numbered(1, 4)),
    *_nodes("CTETRA", _numbered(1, 4), _numbered(5, 10)),
    *_nodes("CPENTA", _numbered(1, 6), _numbered(7, 15)),
    *_nodes("CHEXA", _numbered(1, 8), _numbered(9, 20)),
    *_nodes("CPYRAM", _numbered(1, 5), _numbered(6, 13)),
    *(
        r
        for numbers, ends in (((1, 2), "G1 G2"), ((3, 4), "S1 S2"))
        for k in ("CELAS", "CMASS", "CDAMP")
        for i in numbers
        for r in _nodes(f"{k}{i}", "", ends)
    ),
    *_nodes("CVISC", "G1 G2"),
    *_nodes("CBUSH", "GA", "GB G0"),
    *_nodes("CBUSH1D", "GA", "GB"),
    *_nodes("CGAP", "GA GB", "G0"),
    *_nodes("GENEL", "", "UI UD"),
    *_nodes("CONM1", "G"),
    *_nodes("CONM2", "G"),
    *_nodes("RBAR", "GA GB"),
    *(r for c in ("RBAR1", "RJOINT", "RROD") for r in _nodes(c, "GA GB")),
    *(r for c in ("RTRPLT", "RTRPLT1") for r in _nodes(c, "GA GB GC")),
    *_nodes("RSPLINE", "G"),
    *_nodes("RBE1", "GN GM"),
    *_nodes("RBE2", "GN GM"),
    *_nodes("RBE3", "REFGRID G"),
    *_nodes("SPC", "G"),
    *_nodes("SPC1", "G"),
    *(
        r
        for c in ("ASET", "OMIT", "QSET")
        for k in ("", "1")
        for r in _nodes(f"{c}{k}", "ID")
    ),
    *_nodes("EXTRN", "ID"),
    *_nodes("MPC", "G"),
    *_nodes("DMIG", "GJ GI"),
    *(CardReference(c, "MCID", FRAMES, False) for c in SHELLS),
    CardReference("PSOLID", "CORDM", FRAMES, False),
    CardReference("CBUSH", "CID", FRAMES, False),
    CardReference("CBUSH", "OCID", FRAMES, False),
    *(
        CardReference(c, "CID", FRAMES, False)
        for c in ("CONM1", "CONM2", "CBUSH1D", "CGAP")
    ),
    CardReference("CROD", "PID", ("PROD",)),
    CardReference("CTUBE", "PID", ("PTUBE",)),
    CardReference("CBAR", "PID", ("PBAR",)),
    CardReference("CBEAM", "PID", ("PBEAM",)),
    *(CardReference(c, "PID", SHELL_PROPERTIES) for c in SHELLS),
    CardReference("CBEND", "PID", ("PBEND",)),
    CardReference("CFAST", "PID", ("PFAST",)),
    CardReference("PFAST", "MCID", FRAMES, False),
    CardReference("CWELD", "PID", ("PWELD",)),
    *(CardReference("CWELD", f"SHID{side}", SHELLS, False) for side in "AB"),
    CardReference("CSHEAR", "PID", ("PSHEAR",)),
    *(
        CardReference(c, "PID", ("PSOLID",))
        for c in ("CTETRA", "CPENTA", "CHEXA", "CPYRAM")
    ),
    *(
        CardReference(f"C{k}{i}", "PID", (f"P{k}",))
        for k in ("ELAS", "MASS", "DAMP")
        for i in (1, 3)
    ),
    CardReference("CVISC", "PID", ("PVISC",)),
    CardReference("CBUSH", "PID", ("PBUSH",)),
    CardReference("CBUSH1D", "PID", ("PBUSH1D",)),
    CardReference("CGAP", "PID", ("PGAP",)),
    *(
        CardReference(c, "MID", ("MAT1",))
        for c in (
            "CONROD",
            "PROD",
            "PTUBE",
            "PBAR",
            "PBEAM",
            "PBEND",
            "PSHEAR",
            "PWELD",
        )
    ),
    CardReference("PSOLID", "MID", SOLID_MATERIALS),
    *(CardReference(c, "MID", PLY_MATERIALS) for c in ("PCOMP", "PCOMPG")),
    *(
        CardReference("PSHELL", f, PLY_MATERIALS, False)
        for f in ("MID1", "MID2", "MID3", "MID4")
    ),
)


def known_ids(model: Model, of: tuple[str, ...]) -> Int:
    """Ids of all rows of these cards, (n,) int64."""
    made = [np.empty(0, dtype=np.int64)]
    for card in of:
        if card in model:
            table = model[card]
            made.append(table.entries(next(iter(table.columns)))[0])
    return np.concatenate(made)


def unused(model: Model) -> dict[str, Int]:
    """Rows of property and material cards that nothing names, by card."""
    named: dict[str, list[Int]] = {}
    for ref in REFERENCES:
        for card in ref.of:
            if card.startswith(("P", "MAT")) and card in model:
                named.setdefault(card, [np.empty(0, dtype=np.int64)])
                if ref.card in model:
                    named[card].append(model[ref.card].entries(ref.field)[0])
    rows = {
        c: np.flatnonzero(~np.isin(model[c].ids, np.concatenate(ids)))
        for c, ids in named.items()
    }
    return {card: at for card, at in rows.items() if at.size}


@dataclass(frozen=True, slots=True, eq=False)
class Missing:
    """Rows of `reference.card` whose field names what is not in the model.

    Attributes
    ----------
    reference : CardReference
    rows : (n,) int64
    ids : (n,) int64
        The ids that are missing; 0 for a blank field.
    """

    reference: CardReference
    rows: Int
    ids: Int


def missing(
    model: Model, elsewhere: Mapping[str, Collection[int]] | None = None
) -> Iterator[Missing]:
    """All references to what is not in the model.

    Parameters
    ----------
    elsewhere : mapping of str to collection of int
        Ids that count as known though the model has no such rows (those of unsupported cards), by
        card.
    """
    known: dict[tuple[str, ...], Int] = {}
    for ref in REFERENCES:
        if ref.card not in model:
            continue
        if ref.of not in known:
            more = [i for c in ref.of for i in (elsewhere or {}).get(c, ())]
            known[ref.of] = np.concatenate(
                [known_ids(model, ref.of), np.array(more, dtype=np.int64)]
            )
        ids, rows = model[ref.card].entries(ref.field)
        wrong = ~np.isin(ids, known[ref.of])
        if not ref.required:
            wrong &= ids > 0
        if ref.card == "DMIG":  # of K2PP and its like
            wrong &= ~np.isin(ids, known_ids(model, ("EPOINT",)))
        if wrong.any():
            yield Missing(ref, rows[wrong], ids[wrong])
