"""Superelements as matrices, in the form of EXTSEOUT (MSC Nastran Quick Reference Guide, EXTSEOUT):
a file for the main bulk data (.asm: SEBULK, SECONCT, boundary points) and one for the end of the
deck (.pch: BEGIN SUPER, points, matrices as DMIG), or the matrices in an OUTPUT4 file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, FrozenArrays
from ringtrue.core.dofs import DofSet
from ringtrue.decks.nastran.deck import any_case
from ringtrue.decks.nastran.writer import format_card, write_bulk
from ringtrue.errors import DeckError
from ringtrue.io.files import atomic_write, existing, reads, writes
from ringtrue.io.matrices import read_op4, write_op4
from ringtrue.model.case_control import listed_dofs
from ringtrue.model.model import Model, Ragged, Table, table

_ASSIGN = re.compile(
    r"\s*ASSIGN\s+INPUTT4\s*=\s*['\"]([^'\"]+)['\"].*?\bUNIT\s*=\s*(\d+)", re.I
)
# as in punch files, or in the OUTPUT4 files of programs and versions
_OP4_NAMES = {
    "KAAX": ("KAAX", "KAA", "KXX"),
    "MAAX": ("MAAX", "MAA", "MXX"),
    "BAAX": ("BAAX", "BAA", "BXX", "BXX1"),
}


def op4_units(top: Sequence[str], folder: Path) -> dict[int, Path]:
    """OUTPUT4 files by their units, of lines such as ASSIGN INPUTT4='wing.op4', UNIT=101.

    >>> op4_units(["assign inputt4='wing.op4', unit=101", "SOL 103"], Path("/decks"))
    {101: PosixPath('/decks/wing.op4')}
    """
    found = (_ASSIGN.match(line) for line in top)
    return {int(m[2]): folder / m[1].replace("\\", "/") for m in found if m}


def matrices_of_op4(model: Model, path: Path) -> Table:
    """The matrices of an OUTPUT4 file as a table of DMIG; EXTRN of the model names their rows.

    Raises
    ------
    DeckError
        If the file holds no stiffness, or matrices of another size than EXTRN, whose points must
        rise.
    """
    path = existing(path if path.is_file() else any_case(path) or path)
    reads(path)
    held = read_op4(path)
    rows = listed_dofs(model, ("EXTRN",))
    if (np.diff(rows.key) <= 0).any():
        raise DeckError(
            f"EXTRN must name points that rise, as the rows of {path.name} do",
            path=path,
        )
    made = []
    for name, names in _OP4_NAMES.items():
        matrix = next((held[n] for n in names if n in held), None)
        if matrix is None and name == "KAAX":
            raise DeckError(
                f"it holds {', '.join(held) or 'nothing'}, and no KAAX, KAA or KXX",
                path=path,
            )
        if matrix is None or not matrix.count_nonzero():
            continue
        if matrix.shape != (len(rows), len(rows)):
            raise DeckError(
                f"{name} is {matrix.shape[0]} x {matrix.shape[1]}; EXTRN names {len(rows)} DOFs",
                path=path,
            )
        made.append((name, matrix))
    return dmig_table(rows, made)


def dmig_table(
    rows: DofSet, matrices: Sequence[tuple[str, Any_ | sparse.csr_array]]
) -> Table:
    """Symmetric real matrices by name, (n, n) each over the same DOFs, as a table of DMIG."""
    lower = [sparse.coo_array(sparse.tril(sparse.csr_array(m))) for _, m in matrices]
    offsets = np.cumsum([0, *(m.nnz for m in lower)])
    terms: dict[str, Ragged] = {}
    node = rows.node
    component = np.abs(rows.direction).astype(np.int64)
    for end, at in (("J", [m.col for m in lower]), ("I", [m.row for m in lower])):
        where = np.concatenate(at)
        terms[f"G{end}"] = Ragged(node[where], offsets)
        terms[f"C{end}"] = Ragged(component[where], offsets)
    values = np.concatenate([m.data for m in lower])
    count = len(matrices)
    return table(
        "DMIG",
        ID=np.arange(1, count + 1),
        NAME=[name for name, _ in matrices],
        IFO=[6] * count,  # symmetric
        TIN=[2] * count,  # real, double precision
        TOUT=[0] * count,
        POLAR=[0] * count,
        NCOL=[0] * count,
        **terms,
        A=Ragged(values, offsets),
        B=Ragged(np.zeros_like(values), offsets),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ExternalPart(FrozenArrays):
    """A part as matrices over points and modal coordinates.

    Attributes
    ----------
    number : int
        Of the superelement.
    points : Model
        GRID of the boundary, with the frames that they move in.
    rows : DofSet
        What the matrices are over: components of the points in their displacement frames, then
        scalar points.
    stiffness, mass : (r, r) float64, units of the deck
    """

    number: int
    points: Model
    rows: DofSet
    stiffness: Float
    mass: Float

    @property
    def unit(self) -> int:
        """Of an OUTPUT4 file."""
        return 100 + self.number


def write_part(
    part: ExternalPart, stem: str | Path, *, op4: bool = False
) -> tuple[Path, ...]:
    """Write `stem`.asm and `stem`.pch: INCLUDE the one in the main bulk data of a deck, the other
    before its ENDDATA.

    Parameters
    ----------
    part : ExternalPart
    stem : str or Path
    op4 : bool
        The matrices in `stem`.op4, in full precision, in place of DMIG in the punch file; the deck
        assigns it, as in ASSIGN INPUTT4='part.op4', UNIT=101.
    """
    asm, pch, matrices = (
        Path(f"{stem}{ending}") for ending in (".asm", ".pch", ".op4")
    )
    written = (asm, pch, matrices) if op4 else (asm, pch)
    writes(*written)
    scalar = part.rows.node[part.rows.direction == 0].tolist()
    ids = part.points["GRID"].ids.tolist()
    joined = [i for point in (*ids, *scalar) for i in (point, point)]
    own = write_bulk(part.points)
    if scalar:
        own += "".join(
            format_card("SPOINT", scalar[i : i + 8]) for i in range(0, len(scalar), 8)
        )
    number = part.number
    medium = (
        ["EXTOP4", None, "MANUAL", None, None, part.unit]
        if op4
        else ["EXTERNAL", None, "MANUAL"]
    )
    main = format_card("SEBULK", [number, *medium])
    main += format_card("SECONCT", [number, 0, None, "NO", *[None] * 4, *joined])
    kept = part.rows.by_components()
    components = {node: c for c, nodes in kept.items() for node in nodes}
    listed = [x for node, c in sorted(components.items()) for x in (node, c)]
    bulk = format_card("EXTRN", listed)
    bulk += (
        "".join(format_card("ASET1", [c, *nodes]) for c, nodes in kept.items()) + own
    )
    named = {"KAAX": part.stiffness, "MAAX": part.mass}
    if op4:
        write_op4(matrices, named)
    else:
        bulk += write_bulk(Model({"DMIG": dmig_table(part.rows, list(named.items()))}))
    with atomic_write(asm) as file:
        file.write_text(main + own)
    with atomic_write(pch) as file:
        file.write_text(f"BEGIN SUPER={number}\n" + bulk)
    return written
