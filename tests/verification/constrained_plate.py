"""A small deck with everything that joins degrees of freedom: a plate on springs with RBE2, RBE3,
MPC and SPC, a mast whose head is free to turn about its line, and a displacement frame.
"""

from __future__ import annotations

from pathlib import Path

from ringtrue.core.parameters import CardField, Parameter, ParameterSet, Substructure
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.model.model import Model

HEAD = """SOL 103
CEND
SPC = 1
MPC = 1
BEGIN BULK
MAT1,1,2.1+11,,.3,7850.
MAT1,2,7.0+10,,.33,2700.
PSHELL,1,1,.008,1
PSHELL,2,2,.012,2
PBAR,3,1,4.-4,2.-8,3.-8,1.-8
PROD,4,2,1.-4
CORD2R,5,0,0.,0.,0.,.3,.2,1.
,1.,0.,.1
"""
TAIL = """GRID,901,,.3,.25,.4,5
GRID,902,,.3,.25,.8
GRID,903,,1.2,.3,-.2
GRID,904,,.3,.25,1.1
CBAR,801,3,901,902,1.,0.,0.
CBAR,802,3,902,904,1.,0.,0.
,4
GRID,905,,.3,.25,1.3
CBAR,807,3,904,905,1.,0.,0.
CROD,808,4,901,903
CONM2,803,904,,2.5
CONM2,804,903,,4.
RBE2,701,901,123456,14,15,20,21
RBE3,702,,903,123456,1.,123,36,37
,42,43
MPC,1,28,3,1.,29,3,-1.
SPC1,1,123,1,6
SPC1,1,12,904
CELAS2,805,3.+5,31,3
CELAS2,806,3.+5,49,3
ENDDATA
"""


def deck(folder: Path) -> Model:
    """9 by 5 nodes and 32 CQUAD4, of two properties."""
    cards = [
        f"GRID,{1 + 6 * i + j},,{0.2 * i:.1f},{0.12 * j:.2f},{0.02 * i * j:.2f}"
        for i in range(9)
        for j in range(6)
    ]
    for i in range(8):
        for j in range(5):
            a = 1 + 6 * i + j
            cards.append(f"CQUAD4,{a},{1 + i // 4},{a},{a + 6},{a + 7},{a + 1}")
    path = folder / "plate.bdf"
    path.write_text(HEAD + "\n".join(cards) + "\n" + TAIL)
    return read_deck(path)


def parameters() -> ParameterSet:
    """A thickness, moduli, a section, a mass, a spring, and a factor on some elements."""
    fields = [
        ("t", "PSHELL", 1, "T"),
        ("E", "MAT1", 2, "E"),
        ("I1", "PBAR", 3, "I1"),
        ("mass", "CONM2", 804, "M"),
        ("spring", "CELAS2", 805, "K"),
    ]
    made = [Parameter(name, (CardField(*field),)) for name, *field in fields]
    made.append(
        Parameter("corner", substructures=(Substructure("stiffness", (1, 2, 7, 8)),))
    )
    return ParameterSet(tuple(made))
