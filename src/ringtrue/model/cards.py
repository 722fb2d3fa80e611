"""The bulk data cards that ringtrue reads: one line a card, read by the reader, the writer and the
editor.

Syntax of a line: card name, then its data fields in order (field 2 of the first line onward;
continuation lines simply go on, eight fields a line). A field is NAME[:type][=default]; types are i
(integer, the default type), f (real), s (text) and c (a list of components such as 123456). `_` is
a field that is not used. `A|B:f` is one field that holds an integer (A) or a real (B); the one not
given keeps its default (`A=-1|B:f`). Without a default, i is 0, f is 0.0, s and c are "". The first
column identifies the row.

A tail `*NAME:type` takes all the fields that are left (`THRU` expanded for integers) into a
`Ragged` column. Cards with a pattern of their own are expanded in `decks.nastran.special` and
`.lists`; their columns stand in `SPECIAL`.

PBARL and PBEAML: dimensions of sections, and the PBAR and PBEAM that they make.

Shapes of elements in natural coordinates: corners, edges and shape functions.

Those of the second order are of serendipity: squares times what is linear in the others (Arnold and
Awanou 2011).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import DeckError
from ringtrue.model.model import Table
from ringtrue.model.sections import section

_TRIANGLE = ((0, 0), (1, 0), (0, 1))
_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))
_RING = ((0, 1), (1, 2), (2, 3), (3, 0))


@dataclass(frozen=True, slots=True)
class ElementShape:
    """A triangle, quadrilateral, tetrahedron, wedge or hexahedron.

    Attributes
    ----------
    corners : tuple of tuple of int
        Natural coordinates.
    edges : tuple of (int, int)
        The corners that each midside node lies between, in the order of the cards.
    simplex : int
        How many coordinates are those of a triangle or tetrahedron, from 0 to 1; the others go from
        -1 to 1.
    """

    corners: tuple[tuple[int, ...], ...]
    edges: tuple[tuple[int, int], ...]
    simplex: int

    def nodes(self, order: int) -> Float:
        """Natural coordinates (n, d) of the nodes of an element of the first or second order."""
        corners = np.array(self.corners, dtype=float)
        if order == 1:
            return corners
        return np.vstack([corners, corners[np.array(self.edges)].mean(axis=1)])

    def functions(self, order: int, points: Float) -> tuple[Float, Float]:
        """Shape functions (p, n) at points (p, d), and their derivatives (p, n, d)."""
        powers, coefficients = _polynomials(self, order)
        values = _monomials(points, powers) @ coefficients
        slopes = []
        for axis in range(powers.shape[1]):
            lower = powers.copy()
            lower[:, axis] = np.maximum(lower[:, axis] - 1, 0)
            slopes.append((powers[:, axis] * _monomials(points, lower)) @ coefficients)
        return values, np.stack(slopes, axis=2)


@cache
def _polynomials(shape: ElementShape, order: int) -> tuple[Int, Float]:
    """Powers (t, d) of the terms, and their coefficients (t, n) in each shape function."""
    terms = []
    for powers in product(range(order + 1), repeat=len(shape.corners[0])):
        inside = sum(powers[: shape.simplex])
        squares = sum(p > 1 for p in powers[shape.simplex :])
        if max(inside - 1, 0) + squares < order:
            terms.append(powers)
    every = np.array(terms)
    inverse = np.linalg.inv(_monomials(shape.nodes(order), every))
    return every, np.round(8 * inverse) / 8  # all are eighths


def _monomials(points: Float, powers: Int) -> Float:
    return np.asarray(np.prod(points[:, None, :] ** powers, axis=2))


TRIANGLE = ElementShape(_TRIANGLE, ((0, 1), (1, 2), (2, 0)), simplex=2)
QUADRILATERAL = ElementShape(_SQUARE, _RING, simplex=0)
TETRAHEDRON = ElementShape(
    (*((*p, 0) for p in _TRIANGLE), (0, 0, 1)),
    ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    simplex=3,
)
WEDGE = ElementShape(
    tuple((*p, z) for z in (-1, 1) for p in _TRIANGLE),
    ((0, 1), (1, 2), (2, 0), (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3)),
    simplex=2,
)
HEXAHEDRON = ElementShape(
    tuple((*p, z) for z in (-1, 1) for p in _SQUARE),
    (*_RING, (0, 4), (1, 5), (2, 6), (3, 7), (4, 5), (5, 6), (6, 7), (7, 4)),
    simplex=0,
)


MADE = {"PBARL": "PBAR", "PBEAML": "PBEAM"}
END_A = ("A", "I1", "I2", "I12", "J", "NSM")
END_B = ("AB", "I1B", "I2B", "I12B", "JB", "NSMB")


def properties(
    card: str, kind: str, end_a: tuple[Any, Any], end_b: tuple[Any, Any] | None
) -> dict[str, Any]:
    """Fields of the PBAR or PBEAM; what a section does not tell is left out.

    Parameters
    ----------
    card : {"PBARL", "PBEAML"}
    kind : str
        TYPE of the section.
    end_a, end_b : (dimensions, NSM)
        End B None: as end A.

    Raises
    ------
    ValueError
        If the dimensions do not make a section.
    """
    a = section(kind, end_a[0]) | {"NSM": end_a[1]}
    made = {n: a[n] for n in (*END_A, "K1", "K2") if n in a}
    if card == "PBARL":
        return made
    b = a if end_b is None else section(kind, end_b[0]) | {"NSM": end_b[1]}
    made |= {n: b[m] for m, n in zip(END_A, END_B, strict=True) if m in b}
    for end, ends_section in (("A", a), ("B", b)):
        # neutral axis from shear centre, which a PBARL leaves out
        for n in ("N1", "N2"):
            if n in ends_section:
                made[f"{n}{end}"] = ends_section[n]
    return made


def resectioned(tables: Mapping[str, Table], card: str, ids: Int) -> Table:
    """The table of PBAR or PBEAM with the rows that PBARL or PBEAML `ids` (k,) make computed anew.

    Raises
    ------
    DeckError
        If the dimensions do not make a section.
    """
    given = tables[card]
    made = tables[MADE[card]]
    new: dict[str, NDArray[Any]] = {}
    for i in np.unique(ids).tolist():  # the few that a parameter names
        row, at = (int(t.find(np.array([i]))[0]) for t in (given, made))
        for name, value in _properties(given, row).items():
            column = new.get(name, made[name])
            column = column.astype(np.result_type(column, type(value)))
            column[at] = value
            new[name] = column
    for name, column in new.items():
        made = made.with_column(name, column)
    return made


def _properties(t: Table, row: int) -> dict[str, Any]:
    ends = [(t.ragged("DIM").row(row).tolist(), t["NSM"][row].item()), None]
    if "DIMB" in t.columns and t.ragged("DIMB").row(row).size:
        ends[1] = (t.ragged("DIMB").row(row).tolist(), t["NSMB"][row].item())
    try:
        return properties(t.card, str(t["TYPE"][row]), ends[0], ends[1])  # type: ignore[arg-type]
    except ValueError as e:
        raise DeckError(str(e), card=f"{t.card} {t.ids[row]}") from None


_TEXT = r"""
GRID    ID CP X1:f X2:f X3:f CD PS:c SEID
SPOINT  *ID
EPOINT  *ID
CORD1R  CID G1 G2 G3
CORD1C  CID G1 G2 G3
CORD1S  CID G1 G2 G3
CORD2R  CID RID A1:f A2:f A3:f B1:f B2:f B3:f C1:f C2:f C3:f
CORD2C  CID RID A1:f A2:f A3:f B1:f B2:f B3:f C1:f C2:f C3:f
CORD2S  CID RID A1:f A2:f A3:f B1:f B2:f B3:f C1:f C2:f C3:f
CROD    EID PID G1 G2
CONROD  EID G1 G2 MID A:f J:f C:f NSM:f
CTUBE   EID PID G1 G2
CBAR    EID PID GA GB G0|X1:f X2:f X3:f OFFT:s=GGG PA:c PB:c W1A:f W2A:f W3A:f W1B:f W2B:f W3B:f
CBEAM   EID PID GA GB G0|X1:f X2:f X3:f OFFT:s=GGG PA:c PB:c W1A:f W2A:f W3A:f W1B:f W2B:f W3B:f SA SB
CTRIA3  EID PID G1 G2 G3 MCID=-1|THETA:f ZOFFS:f=nan _ _ TFLAG T1:f=nan T2:f=nan T3:f=nan
CQUAD4  EID PID G1 G2 G3 G4 MCID=-1|THETA:f ZOFFS:f=nan _ TFLAG T1:f=nan T2:f=nan T3:f=nan T4:f=nan
CTRIAR  EID PID G1 G2 G3 MCID=-1|THETA:f ZOFFS:f=nan _ _ TFLAG T1:f=nan T2:f=nan T3:f=nan
CQUADR  EID PID G1 G2 G3 G4 MCID=-1|THETA:f ZOFFS:f=nan _ TFLAG T1:f=nan T2:f=nan T3:f=nan T4:f=nan
CTRIA6  EID PID G1 G2 G3 G4 G5 G6 MCID=-1|THETA:f ZOFFS:f=nan T1:f=nan T2:f=nan T3:f=nan TFLAG
CQUAD8  EID PID G1 G2 G3 G4 G5 G6 G7 G8 T1:f=nan T2:f=nan T3:f=nan T4:f=nan MCID=-1|THETA:f ZOFFS:f=nan TFLAG
CBEND   EID PID GA GB G0|X1:f X2:f X3:f GEOM
CFAST   EID PID TYPE:s IDA IDB GS GA GB XS:f=nan YS:f=nan ZS:f=nan
CSHEAR  EID PID G1 G2 G3 G4
CTETRA  EID PID G1 G2 G3 G4 G5 G6 G7 G8 G9 G10
CPENTA  EID PID G1 G2 G3 G4 G5 G6 G7 G8 G9 G10 G11 G12 G13 G14 G15
CHEXA   EID PID G1 G2 G3 G4 G5 G6 G7 G8 G9 G10 G11 G12 G13 G14 G15 G16 G17 G18 G19 G20
CPYRAM  EID PID G1 G2 G3 G4 G5 G6 G7 G8 G9 G10 G11 G12 G13
CELAS1  EID PID G1 C1 G2 C2
CELAS2  EID K:f G1 C1 G2 C2 GE:f S:f
CELAS3  EID PID S1 S2
CELAS4  EID K:f S1 S2
CBUSH   EID PID GA GB G0|X1:f X2:f X3:f CID=-1 S:f=0.5 OCID=-1 S1:f S2:f S3:f
CBUSH1D EID PID GA GB CID=-1
CGAP    EID PID GA GB G0|X1:f X2:f X3:f CID=-1
CMASS1  EID PID G1 C1 G2 C2
CMASS2  EID M:f G1 C1 G2 C2
CMASS3  EID PID S1 S2
CMASS4  EID M:f S1 S2
CDAMP1  EID PID G1 C1 G2 C2
CDAMP2  EID B:f G1 C1 G2 C2
CDAMP3  EID PID S1 S2
CDAMP4  EID B:f S1 S2
CVISC   EID PID G1 G2
CONM2   EID G CID M:f X1:f X2:f X3:f _ I11:f I21:f I22:f I31:f I32:f I33:f
CONM1   EID G CID M11:f M21:f M22:f M31:f M32:f M33:f M41:f M42:f M43:f M44:f \
        M51:f M52:f M53:f M54:f M55:f M61:f M62:f M63:f M64:f M65:f M66:f
PROD    PID MID A:f J:f C:f NSM:f
PTUBE   PID MID OD:f T:f NSM:f OD2:f
PBAR    PID MID A:f I1:f I2:f J:f NSM:f _ C1:f C2:f D1:f D2:f E1:f E2:f F1:f F2:f K1:f=nan K2:f=nan I12:f
PSHELL  PID MID1 T:f MID2 I12T3:f=1.0 MID3 TST:f=0.833333 NSM:f Z1:f=nan Z2:f=nan MID4
PSHEAR  PID MID T:f NSM:f F1:f F2:f
PFAST   PID D:f MCID=-1 MFLAG KT1:f KT2:f KT3:f KR1:f KR2:f KR3:f MASS:f GE:f
PWELD   PID MID D:f _ _ MSET:s _ TYPE:s LDMIN:f=0.2 LDMAX:f=5.0
PSOLID  PID MID CORDM IN:s STRESS:s ISOP:s FCTN:s
PBUSH1D PID K:f C:f M:f _ SA:f SE:f _
PGAP    PID U0:f F0:f KA:f KB:f=nan KT:f=nan MU1:f MU2:f TMAX:f MAR:f TRMIN:f
PMASS   PID M:f
PELAS   PID K:f GE:f S:f
PDAMP   PID B:f
PVISC   PID CE:f CR:f
MAT1    MID E:f=nan G:f=nan NU:f=nan RHO:f A:f TREF:f GE:f ST:f SC:f SS:f MCSID
MAT2    MID G11:f G12:f G13:f G22:f G23:f G33:f RHO:f A1:f A2:f A3:f TREF:f GE:f ST:f SC:f SS:f MCSID
MAT8    MID E1:f E2:f NU12:f G12:f G1Z:f G2Z:f RHO:f A1:f A2:f TREF:f XT:f XC:f YT:f YC:f S:f GE:f F12:f STRN:f
MAT9    MID G11:f G12:f G13:f G14:f G15:f G16:f G22:f G23:f G24:f G25:f G26:f \
        G33:f G34:f G35:f G36:f G44:f G45:f G46:f G55:f G56:f G66:f RHO:f A1:f A2:f A3:f A4:f A5:f A6:f TREF:f GE:f
RBAR    EID GA GB CNA:c CNB:c CMA:c CMB:c _ _
RBAR1   EID GA GB CB:c _ _
RROD    EID GA GB CMA:c CMB:c _ _
RJOINT  EID GA GB CB:c
RTRPLT  EID GA GB GC CNA:c CNB:c CNC:c _ CMA:c CMB:c CMC:c _ _
RTRPLT1 EID GA GB GC CMB:c CMC:c _ _
RBE2    EID GN CM:c *GM
SPC1    SID C:c *G
ASET    ID C:c
OMIT    ID C:c
QSET    ID C:c
EXTRN   ID C:c
ASET1   C:c *ID
OMIT1   C:c *ID
QSET1   C:c *ID
SPCADD  SID *S
MPCADD  SID *S
NSMADD  SID *S
SEBULK  SEID TYPE:s RSEID METHOD:s=AUTO TOL:f=1e-5 LOC:s UNITNO
EIGRL   SID V1:f=nan V2:f=nan ND MSGLVL MAXSET SHFSCL:f NORM:s _ _ _ _ _ _ _ _
EIGRA   SID V1:f=nan V2:f=nan ND MSGLVL AMPFFACT:f SHFSCL:f NORM:s
EIGR    SID METHOD:s F1:f=nan F2:f=nan NE ND _ _ NORM:s G C
"""

SPECIAL = {
    "SPC": "SID G C:c D:f",  # one row a (G, C) pair; two pairs on a card make two rows
    "MPC": "SID *G *C *A:f",  # one row a card; three ragged columns of equal offsets
    # independent pairs share the offsets of GN, dependent ones (UM) those of GM
    "RBE1": "EID *GN *CN:c *GM *CM:c",
    # FSI 0: A, I1, I2, J, K1, K2, DELTAN; else the pipe of RM and T
    "PBEND": "PID MID FSI A:f I1:f I2:f J:f RM:f T:f P:f RB:f THETAB:f K1:f K2:f NSM:f RC:f ZC:f "
    "DELTAN:f=nan",
    # TYPE GRIDID (corners GA1.., GB1..), ELEMID or ELPAT (SHIDA, SHIDB), PARTPAT (PIDA, PIDB) or
    # ALIGN (GA, GB)
    "CWELD": "EID PID GS TYPE:s GA GB SPTYP:s GA1 GA2 GA3 GA4 GB1 GB2 GB3 GB4 SHIDA SHIDB PIDA "
    "PIDB "
    "XS:f=nan YS:f=nan ZS:f=nan",
    # FORM K or Z; KZ by columns of the lower triangle, S by rows
    "GENEL": "EID FORM:s *UI *CI *UD *CD *KZ:f *S:f",
    # one entry a node; without components it is independent
    "RSPLINE": "EID DL:f=0.1 *G *C:c",
    # one entry of G an independent node; GM those of UM
    "RBE3": "EID REFGRID REFC:c *G *C:c *WT:f *GM *CM:c",
    "PBUSH": "PID K1:f K2:f K3:f K4:f K5:f K6:f B1:f B2:f B3:f B4:f B5:f B6:f GE:f "
    # GE is GE1, for all where the others are blank
    "GE2:f=nan GE3:f=nan GE4:f=nan GE5:f=nan GE6:f=nan M:f",
    # the section at end A, at end B (a blank end B equals A), and at the stations between; nan: on
    # the straight line
    "PBEAM": "PID MID A:f I1:f I2:f I12:f J:f NSM:f K1:f=1.0 K2:f=1.0 S1:f S2:f NSIA:f NSIB:f "
    "CWA:f=nan CWB:f=nan "  # nan: of a library section, which has its own
    "M1A:f M2A:f M1B:f M2B:f N1A:f N2A:f N1B:f N2B:f AB:f I1B:f I2B:f I12B:f JB:f NSMB:f "
    "*X:f *AX:f *I1X:f *I2X:f *I12X:f *JX:f *NSMX:f",
    # the dimensions behind a PBAR or PBEAM; end B of a beam where it has a section of its own
    "PBARL": "PID TYPE:s NSM:f *DIM:f",
    "PBEAML": "PID TYPE:s NSM:f NSMB:f=nan *DIM:f *DIMB:f",
    # one entry a ply
    "PCOMP": "PID Z0:f=nan NSM:f SB:f FT:s TREF:f GE:f LAM:s *MID *T:f *THETA:f *SOUT:s",
    "PCOMPG": "PID Z0:f=nan NSM:f SB:f FT:s TREF:f GE:f LAM:s *GPLYID *MID *T:f *THETA:f *SOUT:s",
    # non-structural mass a length or area, in all of the elements for NSML and NSML1; it counts
    # where case control says NSM = SID; one row a pair (NSM, NSML) or a list, in which ID 0 stands
    # for ALL
    "NSM": "SID TYPE:s ID VALUE:f",
    "NSML": "SID TYPE:s ID VALUE:f",
    "NSM1": "SID TYPE:s VALUE:f *ID",
    "NSML1": "SID TYPE:s VALUE:f *ID",
    # one entry a pair of points that are joined
    "SECONCT": "SEIDA SEIDB TOL:f=1e-5 LOC:s *GIDA *GIDB",
    # one row a matrix, ID from 1 on
    "DMIG": "ID NAME:s IFO TIN TOUT POLAR NCOL *GJ *CJ *GI *CI *A:f *B:f",
}

CARDS = {
    line.split()[0]: line.split(maxsplit=1)[1]
    for line in _TEXT.replace("\\\n", "").strip().splitlines()
}


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """One data field of a card: its column, type, default, and the integer column it shares the
    field with.
    """

    name: str
    kind: str = "i"
    default: int | float | str = 0
    other: str = ""
    tail: bool = False
    blank: bool = False
    other_default: int = 0


_ZERO: dict[str, int | float | str] = {"i": 0, "f": 0.0, "s": "", "c": ""}


def _field(text: str) -> FieldSpec:
    if text == "_":
        return FieldSpec("_", blank=True)
    before, _, own = text.lstrip("*").rpartition("|")
    other, _, otherwise = before.partition("=")
    typed, _, default = own.partition("=")
    name, _, kind = typed.partition(":")
    kind = kind or "i"
    value = _ZERO[kind]
    if default:
        value = type(value)(default)
    tail = text.startswith("*")
    return FieldSpec(
        name, kind, value, other, tail=tail, other_default=int(otherwise or 0)
    )


@cache
def columns(card: str) -> tuple[FieldSpec, ...]:
    """The fields of a card in order; for a card of `SPECIAL` the columns of its table."""
    return tuple(_field(t) for t in (CARDS.get(card) or SPECIAL[card]).split())


SYNONYMS = {b"CPYRA": b"CPYRAM"}  # of OptiStruct

# Cards that carry stiffness, mass or constraint (or change what other cards mean) and are not read.
_CARRYING = """
CQUAD CQUADX CTRIAX CTRIAX6 CTRAX3 CTRAX6 CQUADX4 CQUADX8 CPYRA5 CHEX8 CHEX20 CBEAM3 CSEAM CBUSH2D CDAMP5 CBAR3 CINTC
CCONEAX CSLOT3 CSLOT4 CFLUID2 CFLUID3 CFLUID4 CHACAB CHACBR CRAC2D CRAC3D CTWIST CWEDGE PCOMPS PLPLANE PBEAM3
PSEAM PBUSH2D PLSOLID PSHLN1 PSHLN2 PSLDN1 PBMSECT PBRSECT MAT3 MAT11 MATORT MATHP MFLUID RBE2GS RBE2F RSSCON RBAX
DMIGOUT DMIGROT GRIDB EGRID CORD3G CORD3R SPCAX MPCAX MPCD SEELT SEQSET SEQSET1 SESET SEBNDRY SELOC SEMPLN SETREE
CSUPER CSUPEXT RELEASE PCOMPG1 PCOMPP MATCID BCONP BCTABLE BLSEG BSCONP SLBLOAD AXIC PDAMP5 TIE CONTACT JOINTG RBODY
GMBC GMSPC GMBNDC GMBNDS PVAL SKIPON
"""
PRELOADS = (
    "FORCE",
    "MOMENT",
    "PLOAD",
    "GRAV",
    "ACCEL",
    "RFORCE",
    "TEMP",
    "DEFORM",
    "SLOAD",
    "SPCD",
    "LOAD",
)
_REASONS = (  # what cards have in common that are not read, and how their names begin
    ("auxiliary models, and superelements without a number: write BEGIN SUPER=n", ("BEGIN",)),
    ("a part that is moved to its place: give its points and frames where they are in the whole", ("SELOC",)),
    ("the plane of a mirrored part: write the part out, with BEGIN SUPER=n and mirrored points of its own",
     ("SEMPLN",)),
    ("a copy, a mirrored copy or a part in a database: write it out with BEGIN SUPER=n, or give its "
     "matrices by EXTSEOUT with MATOP4 or DMIGPCH",
     ("CSUPER",)),
    ("superelements: give them as parts (BEGIN SUPER=n, with SEBULK and SECONCT), or reduced matrices "
     "as DMIG with K2GG and M2GG",
     ("SE", "CSUP", "RELEASE", "EXTRN")),
    ("axisymmetric, plane strain and plane stress: ringtrue solves structures in space",
     ("AXIC", "CCONEAX", "CSLOT", "CQUADX", "CTRIAX", "CTRAX", "CPLST", "RINGAX", "SPCAX", "MPCAX")),
    ("MSGMESH: give the cards that it makes (ECHO = PUNCH)", ("EGRID", "CGEN", "GRIDB")),
    ("contact and glue: ringtrue solves linear structures; join the parts by RBE2, RBE3, CFAST "
     "or shared nodes",
     ("BLSEG", "BC", "BG", "BSCONP", "SLBLOAD", "RSSCON", "CSEAM", "PSEAM", "TIE", "CONTACT")),
    ("joints of rigid bodies: give RBE2, RJOINT or MPC", ("JOINTG", "RBODY")),
    ("hyperelastic: give the moduli about the state of the test as MAT1 or MAT9",
     ("PLPLANE", "PLSOLID", "MATHP", "PLSHELL", "PSHLN", "PSLDN")),
    ("fluids: give their mass as CONM2 or NSM, or as DMIG with M2GG",
     ("CFLUID", "CHACAB", "CHACBR", "MFLUID", "CAABSF")),
    ("beams of three nodes: give two CBEAM", ("CBEAM3", "PBEAM3", "CBAR3")),
    ("laminates put together from plies of their own: give PCOMP or PCOMPG", ("PCOMPG1", "PCOMPP")),
    ("material axes of solids by element: give CORDM of the PSOLID", ("MATCID",)),
    ("layered solids: give PSOLID with the mean of the layers as MAT9, or shells with PCOMP", ("PCOMPS", "PCOMPLS")),
    ("preload: the modes are those of the unloaded structure; take STATSUB (or the SOL of "
     "prestress) out to have them",
     (*PRELOADS, "BOLTF", "PRETENS", "SPCR")),
    ("a bolt cut in two parts: join TOP and BOTTOM by shared nodes, RBE2 or MPC", ("BOLT",)),
    ("cards that are passed over: take them out, with SKIPON and SKIPOFF", ("SKIPON",)),
    ("elements of order p: give CHEXA, CPENTA and CTETRA with nodes on their edges", ("GM", "PVAL")),
    ("elements of old NASTRAN: give CQUAD4, CTRIA3, CSHEAR, CHEXA, CPENTA or CTETRA",
     ("CQUAD1", "CQUAD2", "CTRIA1", "CTRIA2", "CTRBSC", "CTRPLT", "CTRSHL", "CQDPLT", "CQDMEM", "CTRMEM", "CTRIM6",
      "CTWIST", "CWEDGE", "CHEXA1", "CHEXA2", "CIHEX", "CIS2D8", "CELBOW", "CTRIARG", "CTRAPRG", "CTORDRG")),
    ("sections by their outline: give PBEAM, or PBEAML with one of the sections", ("PBMSECT", "PBRSECT")),
)  # fmt: skip
# what an answer lacks without a card that is not read, and how the names of such cards begin
_EFFECTS = (
    (("constraints",),
     ("RBE", "RSSCON", "RBAX", "SPCAX", "MPCAX", "MPCD", "GMBC", "GMSPC", "GMBND", "SEBNDRY", "JOINTG", "RBODY")),
    (("stiffness", "constraints"),
     ("BLSEG", "BC", "BG", "BSCONP", "SLBLOAD", "CSEAM", "PSEAM", "TIE", "CONTACT", "BOLT")),
    # loads are not read where they are a preload
    (("stiffness",), ("CBUSH2D", "PBUSH2D", "CRAC", "MATT", "PRETENS", "SPCR", *PRELOADS)),
    (("nothing",), ("CDAMP5", "PDAMP5")),
    (("mass",), ("CFLUID", "CHAC", "MFLUID", "CAABSF")),
    (("mass", "stiffness", "constraints", "loads"), ("BEGIN", "SE", "CSUP", "RELEASE", "SKIPON", "/")),
)  # fmt: skip
TABLES = (
    "PBUSHT",
    "PDAMPT",
    "PELAST",
)  # kept: tables over frequency or for nonlinear solutions; nominal values count
NONSTRUCTURAL = ("NSM", "NSM1", "NSML", "NSML1", "NSMADD")
UNSUPPORTED = frozenset(_CARRYING.split())
_HARMLESS_C = (  # names that begin like an element but connect nothing
    "CAERO", "CASE", "CBARAO", "CORD", "CMETHOD", "CSET", "CSCHD", "CSSCHD", "CYJOIN", "CYSYM",
    "CYAX", "CYSUP", "CLOAD", "CREEP", "CON", "CHBDY", "CCRSFIL", "CNGRNT",
)  # fmt: skip


def is_unsupported(card: str) -> bool:
    """Whether a card that is not read must not be passed over: it may carry stiffness, mass or
    constraint.
    """
    if card in CARDS or card in SPECIAL:
        return False
    return card in UNSUPPORTED or (
        card.startswith("C") and not card.startswith(_HARMLESS_C)
    )


def reason(card: str) -> str:
    """What a card that is not read is about and what to do, "" where there is nothing to say."""
    return next((text for text, names in _REASONS if card.startswith(names)), "")


def effects(card: str) -> tuple[str, ...]:
    """What an answer lacks without a card that is not read: mass, stiffness, constraints, loads or
    nothing.
    """
    found = (lacks for lacks, names in _EFFECTS if card.startswith(names))
    return next(found, ("mass", "stiffness"))
