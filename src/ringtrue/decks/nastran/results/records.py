"""Records of the data blocks GEOM1 to GEOM4, EPT, MPT and DYNAMICS: which card each is, and what
its words are.

A record begins with three words that name it in its block, of which two are enough. A line below:
these two, the card, and its words in the order of the record, named as in `model.cards`. A line
without words has those of the card. Types are those of the card; others are i (integer), f (real)
and t (four characters). Two lines with the same number are the forms of different versions. Source:
the Quick Reference Guide and the DMAP Programmer's Guide of MSC Nastran, data blocks.

Points and frames of a file without cards are in BGPDT, EQEXIN and CSTM (the same guides, and that
of NX Nastran).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.decks.nastran.results.op2 import Op2Table
from ringtrue.model.cards import CARDS, SPECIAL, columns
from ringtrue.model.model import Ragged, Table, stacked, table
from ringtrue.model.references import FRAMES

_FIXED = r"""
GEOM1
4501 45   GRID    ID CP X1 X2 X3 CD PS SEID
1801 18   CORD1R  CID _ _ G1 G2 G3
1701 17   CORD1C  CID _ _ G1 G2 G3
1901 19   CORD1S  CID _ _ G1 G2 G3
2101 21   CORD2R  CID _ _ RID A1 A2 A3 B1 B2 B3 C1 C2 C3
2001 20   CORD2C  CID _ _ RID A1 A2 A3 B1 B2 B3 C1 C2 C3
2201 22   CORD2S  CID _ _ RID A1 A2 A3 B1 B2 B3 C1 C2 C3
GEOM2
3001 30   CROD
1601 16   CONROD
3701 37   CTUBE
2408 24   CBAR    EID PID GA GB X1 X2 X3 F:i PA PB W1A W2A W3A W1B W2B W3B
5408 54   CBEAM   EID PID GA GB SA SB X1 X2 X3 F:i PA PB W1A W2A W3A W1B W2B W3B
5959 59   CTRIA3
2958 51   CQUAD4
9200 92   CTRIAR
8009 80   CQUADR
4801 48   CTRIA6
4701 47   CQUAD8
4701 47   CQUAD8  EID PID G1 G2 G3 G4 G5 G6 G7 G8 T1 T2 T3 T4 THETA ZOFFS
4601 46   CBEND   EID PID GA GB X1 X2 X3 F:i _ _ _ _ GEOM
3101 31   CSHEAR
5508 55   CTETRA
4108 41   CPENTA
7308 73   CHEXA
17200 172 CPYRAM  EID PID G1 G2 G3 G4 G5 G6 G7 G8 G9 G10 G11 G12 G13 _
601 6     CELAS1  EID PID G1 G2 C1 C2
701 7     CELAS2  EID K G1 G2 C1 C2 GE S
801 8     CELAS3
901 9     CELAS4
2608 26   CBUSH   EID PID GA GB X1 X2 X3 F:i CID S OCID S1 S2 S3
5608 56   CBUSH1D EID PID GA GB CID _ _ _
1908 19   CGAP    EID PID GA GB X1 X2 X3 F:i CID
1001 10   CMASS1  EID PID G1 G2 C1 C2
1101 11   CMASS2  EID M G1 G2 C1 C2
1201 12   CMASS3
1301 13   CMASS4
201 2     CDAMP1  EID PID G1 G2 C1 C2
301 3     CDAMP2  EID B G1 G2 C1 C2
401 4     CDAMP3
501 5     CDAMP4
3901 39   CVISC
1501 15   CONM2   EID G CID M X1 X2 X3 I11 I21 I22 I31 I32 I33
1401 14   CONM1
EPT
902 9     PROD
1602 16   PTUBE   PID MID OD T NSM
1602 16   PTUBE
52 20     PBAR
2302 23   PSHELL
1002 10   PSHEAR
2402 24   PSOLID  PID MID CORDM IN:i STRESS:i ISOP:i FCTN:t
302 3     PELAS
402 4     PMASS
202 2     PDAMP
1802 18   PVISC
MPT
103 1     MAT1
203 2     MAT2
2503 25   MAT8
2603 26   MAT9    MID G11 G12 G13 G14 G15 G16 G22 G23 G24 G25 G26 G33 G34 G35 G36 G44 G45 G46 G55 \
                  G56 G66 RHO A1 A2 A3 A4 A5 A6 TREF GE
2603 26   MAT9    MID G11 G12 G13 G14 G15 G16 G22 G23 G24 G25 G26 G33 G34 G35 G36 G44 G45 G46 G55 \
                  G56 G66 RHO A1 A2 A3 A4 A5 A6 TREF GE _ _ _ _
EPT
3101 31   PBUSH1D PID K C M _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _
1402 14   PBUSH   PID K1 K2 K3 K4 K5 K6 B1 B2 B3 B4 B5 B6 GE _ _ _ _
1402 14   PBUSH   PID K1 K2 K3 K4 K5 K6 B1 B2 B3 B4 B5 B6 GE GE2 GE3 GE4 GE5 GE6 _ _ _ _
1402 14   PBUSH   PID K1 K2 K3 K4 K5 K6 B1 B2 B3 B4 B5 B6 GE GE2 GE3 GE4 GE5 GE6 _ _ _ _ M
1402 14   PBUSH   PID K1 K2 K3 K4 K5 K6 B1 B2 B3 B4 B5 B6 GE GE2 GE3 GE4 GE5 GE6 _ _ _ _ M _ _ _
GEOM4
5501 55   SPC     SID G C D
5501 55   SPC     SID G C _ D
6601 66   RBAR    EID GA GB CNA CNB CMA CMB
6601 66   RBAR    EID GA GB CNA CNB CMA CMB _
6601 66   RBAR    EID GA GB CNA CNB CMA CMB _ _
6501 65   RROD    EID GA GB CMA CMB
6501 65   RROD    EID GA GB CMA CMB _
6501 65   RROD    EID GA GB CMA CMB _ _
GEOM3
4201 42   FORCE   SID:i G:i CID:i F:f N1:f N2:f N3:f
4801 48   MOMENT  SID:i G:i CID:i F:f N1:f N2:f N3:f
4401 44   GRAV    SID:i CID:i A:f N1:f N2:f N3:f MB:i
6909 69   PLOAD1  SID:i EID:i KIND:i SCALE:i X1:f P1:f X2:f P2:f
7209 72   PLOAD4  SID:i EID:i P1:f P2:f P3:f P4:f G1:i G3:i CID:i N1:f N2:f N3:f
7209 72   PLOAD4  SID:i EID:i P1:f P2:f P3:f P4:f G1:i G3:i CID:i N1:f N2:f N3:f _ _ _ _
6802 68   PLOAD2  SID:i P:f EID:i
5401 54   SLOAD   SID:i S:i F:f
GEOM4
5110 51   SPCD    SID:i G:i C:i D:f
"""
# Of lengths of their own: `decks.nastran.results.geometry` has a function for each.
LISTED = {
    ("GEOM2", 5551, 49): "SPOINT",
    ("GEOM4", 5481, 58): "SPC1",
    ("GEOM4", 5491, 59): "SPCADD",
    ("GEOM4", 4891, 60): "MPCADD",
    ("GEOM4", 4901, 49): "MPC",
    ("GEOM4", 6901, 69): "RBE2",
    ("GEOM4", 7101, 71): "RBE3",
    ("EPT", 2706, 27): "PCOMP",
    ("EPT", 15006, 150): "PCOMPG",
    ("EPT", 9102, 91): "PBARL",
    ("EPT", 9202, 92): "PBEAML",
    ("EPT", 5402, 54): "PBEAM",
    ("DYNAMICS", 308, 8): "EIGRL",
    ("GEOM3", 4551, 61): "LOAD",
}
# Known by name and not rebuilt.
OTHERS = {
    ("DYNAMICS", 57, 5): "DLOAD",
    ("DYNAMICS", 207, 2): "FREQ2",
    ("DYNAMICS", 1007, 10): "FREQ1",
    ("DYNAMICS", 1307, 13): "FREQ",
    ("DYNAMICS", 307, 3): "EIGR",
    ("DYNAMICS", 707, 7): "EPOINT",
    ("DYNAMICS", 2107, 21): "TABDMP1",
    ("DYNAMICS", 5107, 51): "RLOAD1",
    ("DYNAMICS", 5207, 52): "RLOAD2",
    ("DYNAMICS", 7107, 71): "TLOAD1",
    ("DYNAMICS", 8307, 83): "TSTEP",
    ("EPT", 1302, 13): "PELAST",
    ("EPT", 2502, 25): "PBEND",
    ("EPT", 2102, 21): "PGAP",
    ("GEOM3", 3609, 36): "LSEQ",
    ("GEOM3", 5701, 57): "TEMP",
    ("GEOM3", 5641, 65): "TEMPD",
    ("GEOM4", 2010, 20): "USET",
    ("GEOM4", 5561, 76): "ASET1",
    ("GEOM4", 5571, 77): "ASET",
    ("GEOM4", 5601, 56): "SUPORT",
    ("GEOM4", 6801, 68): "RBE1",
    ("GEOM2", 5201, 52): "PLOTEL",
}


@dataclass(frozen=True, slots=True)
class Word:
    """A word of a record: a field of the card ("_" for none), and its type i, f, c, s or t."""

    name: str
    kind: str


@dataclass(frozen=True, slots=True)
class Layout:
    """A card and the words of each of its rows."""

    card: str
    words: tuple[Word, ...]


Key = tuple[str, int, int]


@cache
def layouts() -> dict[Key, tuple[Layout, ...]]:
    """Layouts by the data block and the first two words of a record."""
    out: dict[Key, tuple[Layout, ...]] = {}
    block = ""
    for line in _FIXED.replace("\\\n", "").strip().splitlines():
        first, *others = line.split()
        if not others:
            block = first
            continue
        second, card, *names = others
        key = (block, int(first), int(second))
        out[key] = (*out.get(key, ()), Layout(card, _words(card, names)))
    return out


def _words(card: str, names: list[str]) -> tuple[Word, ...]:
    specs = columns(card) if card in CARDS or card in SPECIAL else ()
    kinds = {s.name: s.kind for s in specs}
    if not names:
        return tuple(Word(s.name, s.kind) for s in specs)
    out = []
    for text in names:
        name, _, kind = text.partition(":")
        out.append(Word(name, kind or kinds.get(name, "i")))
    return tuple(out)


POINT_BLOCKS = ("BGPDT", "EQEXIN", "CSTM")
# words of a point in BGPDT: its frame and three single-precision coordinates
_SHORT = 4
_KINDS = {1: "CORD2R", 2: "CORD2C", 3: "CORD2S"}
_FRAME = 12  # numbers of a frame: its origin, and by rows the rotation from it to basic


def grids(places: Mapping[str, Op2Table]) -> dict[str, Table]:
    """GRID and SPOINT without GEOM1: displacement frame and basic coordinates of BGPDT, numbers of
    EQEXIN.

    Parameters
    ----------
    places : mapping of str to Op2Table
        The blocks BGPDT and EQEXIN by these names.
    """
    if "BGPDT" not in places or "EQEXIN" not in places:
        return {}
    numbers = places["EQEXIN"].ints(places["EQEXIN"].bodies()[0])
    if numbers.size % 2:
        return {}
    outer, inner = numbers.reshape(-1, 2).T
    if not np.array_equal(np.sort(inner), np.arange(1, inner.size + 1)):
        return {}
    found = _placed(places["BGPDT"], inner.size)
    if found is None:
        return {}
    cd, xyz = (values[inner - 1] for values in found)
    grid = cd >= 0  # -1 for scalar points
    n = int(grid.sum())
    zero = np.zeros(n, dtype=np.int64)
    made: dict[str, Any] = {"ID": outer[grid], "CP": zero}
    made |= {f"X{k + 1}": xyz[grid, k] for k in range(3)}
    made |= {"CD": cd[grid], "PS": np.full(n, ""), "SEID": zero}
    out = {"GRID": table("GRID", **made)}
    if not grid.all():
        scalar = outer[~grid]
        out["SPOINT"] = table("SPOINT", ID=Ragged(scalar, np.array([0, scalar.size])))
    return out


def _placed(block: Op2Table, count: int) -> tuple[Int, Float] | None:
    """Displacement frames (n,) and basic coordinates (n, 3) of so many points of BGPDT; None of a
    form that is not known.

    Older versions give a frame and three reals, newer ones six integers and three numbers of double
    precision.
    """
    body = block.bodies()[0]
    if len(body) == count * _SHORT * block.word:
        reals = block.decimals(block.floats(body)).reshape(count, _SHORT)
        return block.ints(body).reshape(count, _SHORT)[:, 0], reals[:, 1:]
    row = np.dtype(
        [("ints", f"{block.order}i{block.word}", 6), ("xyz", f"{block.order}f8", 3)]
    )
    if len(body) != count * row.itemsize:
        return None
    rows = np.frombuffer(body, row)
    return rows["ints"][:, 0].astype(np.int64), rows["xyz"].astype(np.float64)


def frames(
    places: Mapping[str, Op2Table], given: Mapping[str, Table]
) -> dict[str, Table]:
    """The frames of CSTM that no card defines, as tables of CORD2R, CORD2C and CORD2S.

    Parameters
    ----------
    places : mapping of str to Op2Table
        The block CSTM by this name.
    given : mapping of str to Table
        Cards that are known.

    Returns
    -------
    dict of str to Table
        Of each kind of frame that gains some, those that were given first.
    """
    if "CSTM" not in places:
        return {}
    number, kind, values = _frame_rows(places["CSTM"])
    known = [given[card].ids for card in FRAMES if card in given]
    new = ~np.isin(number, np.concatenate([[0], *known]))
    out = {}
    for code, card in _KINDS.items():
        rows = np.flatnonzero(new & (kind == code))
        if not rows.size:
            continue
        origin = values[rows, :3]
        turned = values[rows, 3:].reshape(-1, 3, 3)
        corners = {
            "A": origin,
            "B": origin + turned[:, :, 2],
            "C": origin + turned[:, :, 0],
        }
        made: dict[str, Any] = {
            "CID": number[rows],
            "RID": np.zeros(rows.size, dtype=np.int64),
        }
        made |= {f"{c}{k + 1}": at[:, k] for c, at in corners.items() for k in range(3)}
        own = table(card, **made)
        out[card] = stacked(given[card], own) if card in given else own
    return out


def _frame_rows(block: Op2Table) -> tuple[Int, Int, Float]:
    """Numbers (n,), kinds (n,), and origins and rotations (n, 12) of CSTM.

    Older versions give number, kind and the values of a frame in one record; newer ones number,
    kind, a word, and where its values of double precision begin in the record behind, from 1.
    """
    bodies = block.bodies()
    ints = block.ints(bodies[0]) if bodies else np.empty(0, dtype=np.int64)
    nothing = np.empty(0, dtype=np.int64)
    if len(bodies) > 1 and ints.size % 4 == 0:
        heads = ints.reshape(-1, 4)
        numbers = block.doubles(bodies[1])
        at = heads[:, 3, None] - 1 + np.arange(_FRAME)
        if (at >= 0).all() and (at < numbers.size).all():
            return heads[:, 0], heads[:, 1], numbers[at]
    elif len(bodies) == 1 and ints.size % (2 + _FRAME) == 0:
        heads = ints.reshape(-1, 2 + _FRAME)
        numbers = block.decimals(block.floats(bodies[0])).reshape(heads.shape)
        return heads[:, 0], heads[:, 1], numbers[:, 2:]
    return nothing, nothing, np.empty((0, _FRAME))
