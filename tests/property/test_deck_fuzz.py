"""Mutated decks: fields swapped, blanked, of a wrong kind or extreme, lines lost and doubled.

Whatever a deck holds, reading, checking and solving it succeed or end in one of ringtrue's own
errors.
"""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from ringtrue.checks.deck import check_deck
from ringtrue.decks.nastran.reader import read_deck, survey
from ringtrue.errors import RingtrueError
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

NODES = """GRID,1,,0.,0.,0.
GRID,2,,1.,0.,.1
GRID,3,4,1.5,80.,0.,4
GRID,4,,0.,1.,0.
GRID,5,,0.,0.,1.
GRID,6,,1.,0.,1.
GRID,7,,1.,1.,1.
GRID,8,,0.,1.,1.
CORD2C,4,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
MAT1,1,2.+11,,.3,7800.,,,.02
MAT8,2,1.+11,9.+9,.3,5.+9,4.+9,3.+9,1600.
SPC1,1,123456,1,THRU,2
SPC,1,5,12,0.
EIGRL,3,,,4
"""
KINDS = {
    "lines": """CBAR,1,1,1,3,0.,0.,1.,GOO
,,,0.,.1,.05,0.,.1,.05
CBEAM,2,2,3,4,8,,,
,5,,,.1
CBEND,3,3,4,8,0.,1.,0.,3
CROD,4,4,5,6
CONROD,5,6,7,1,.01,1.-6
CTUBE,6,6,7,8
PBARL,1,1,,BOX
,.1,.2,.01,.01,.5
PBEAM,2,1,.01,1.-5,2.-5,0.,1.-5
,YES,.4,.02,2.-5,3.-5
,YES,1.,.01,1.-5,1.-5,0.,1.-5
PBEND,3,1,.01,1.-5,2.-5,3.-5,1.5
PROD,4,1,.01,1.-6
PTUBE,6,1,.1,.01
""",
    "surfaces": """CQUAD4,1,1,1,2,3,4,4,.01
,,1,1.,1.,2.,2.
CTRIA3,2,2,3,4,5,30.
CQUAD8,3,1,5,6,7,8,,
CTRIA6,4,2,5,6,7,,,
CSHEAR,5,5,1,2,6,5
PSHELL,1,1,.01,1,,1,,3.
PCOMP,2,-.01,,,,,,SYM
,2,.005,45.,YES,2,.005
PSHEAR,5,1,.01
NSM1,9,PSHELL,2.,1
""",
    "solids": """CHEXA,1,1,1,2,3,4,5,6
,7,8
CTETRA,2,1,1,3,4,5
CPENTA,3,1,1,2,3,5,6,7
CPYRAM,4,1,1,2,3,4,5
PSOLID,1,1,4
""",
    "joints": """CBUSH,1,1,1,3,,,,4
,.3
PBUSH,1,K,1.+6,2.+6,3.+6,1.+4,1.+4,1.+4
,,B,10.,10.
,,GE,.02
CELAS1,2,2,3,1,4,2
PELAS,2,1.+5,,,3,1.
CELAS4,4,1.+3,101,102
SPOINT,101,102
CMASS4,5,2.,101
CMASS4,6,2.,102
CDAMP2,7,5.,3,3
CONM2,8,4,,2.,.1,0.,0.
,.1,.01,.2,0.,.01,.3
CONM1,9,7,4,1.,,2.,,
,3.
RBE2,10,6,123456,7,8,1.-5
RBE3,11,,4,123456,1.,123,3,5
,6
MPC,5,3,1,1.,5,3,-1.
,,6,2,.5
CGAP,12,12,3,4,,,,0
PGAP,12,,1.,1.+5
GENEL,13,,3,1,4,2
,K,10.,1.,20.
CBUSH1D,14,14,3,4
PBUSH1D,14,1.+4
""",
}
TOP = {
    "surfaces": "CEND\nSPC=1\nNSM=9\nBEGIN BULK\n",
    "joints": "CEND\nSPC=1\nMPC=5\nBEGIN BULK\n",
}
COUNT = 25  # decks a kind
VALUES = (
    *(
        "",
        "abc",
        "1e400",
        "-1",
        "0",
        "0.",
        "99999999",
        "1.5",
        "NaN",
        "inf",
        "1.+3",
        "1",
        "2",
        "123456789012",
        "THRU",
    ),
    *(
        "-1.e-3",
        "1e-300",
        "1e30",
        "SYM",
        "+",
        "*",
        "=",
        ".5",
        "7",
        "3",
        "4",
        "100",
        "123456",
        "1234567",
        "1.0.0",
    ),
)


def mutated(text: str, r: random.Random) -> str:
    """A deck with one to three of its lines changed."""
    lines = text.splitlines()
    for _ in range(r.choice([1, 1, 2, 3])):
        i = r.randrange(len(lines))
        fields, k = lines[i].split(","), r.random()
        if k < 0.7:
            fields[r.randrange(len(fields))] = r.choice(VALUES)
            lines[i] = ",".join(fields)
        elif k < 0.78:
            a, b = r.randrange(len(fields)), r.randrange(len(fields))
            fields[a], fields[b] = fields[b], fields[a]
            lines[i] = ",".join(fields)
        elif k < 0.84:
            lines[i] = ""
        elif k < 0.9:
            lines.insert(i, lines[r.randrange(len(lines))])
        elif k < 0.95:
            lines[i] = lines[i][: r.randrange(len(lines[i]) + 1)]
        else:
            at = r.randrange(len(lines[i]) + 1)
            lines[i] = lines[i][:at] + r.choice('\t"+-,$\x00\xff') + lines[i][at + 1 :]
    return "\n".join(lines) + "\n"


def solved(path: Path) -> int:
    """How many modes of those asked for are found."""
    with EmbeddedSolver().open(read_deck(path)) as analysis:
        return len(analysis.modes(ModesRequest(3)).modes)


@pytest.mark.parametrize("kind", KINDS)
def test_the_decks_themselves_are_sound(tmp_path: Path, kind: str) -> None:
    (tmp_path / "d.bdf").write_text(
        TOP.get(kind, "CEND\nSPC=1\nBEGIN BULK\n") + NODES + KINDS[kind]
    )
    assert solved(tmp_path / "d.bdf") == 3


@pytest.mark.parametrize("kind", KINDS)
def test_mutated_decks_end_in_words(tmp_path: Path, kind: str) -> None:
    path, r, ended = tmp_path / "d.bdf", random.Random(kind), 0
    for _ in range(COUNT):
        top = TOP.get(kind, "CEND\nSPC=1\nBEGIN BULK\n")
        path.write_text(top + mutated(NODES + KINDS[kind], r), encoding="latin-1")
        try:
            check_deck(survey(path).model)
        except RingtrueError:
            ended += 1
        try:
            solved(path)
        except RingtrueError:
            ended += 1
    assert 0 < ended < 2 * COUNT
