"""Springs, dashpots and masses, rigid elements, direct matrices and mechanisms against closed
forms.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_cases import (
    cards,
    grid,
    model,
    modes,
    pshell,
    ragged,
    shells,
    spc,
    square,
    steel,
)

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import DeckError, InputError, SingularModel, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import CaseControl, Model, Table
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

EXACT = 1e-12  # some hundred operations
XYZ = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, 0.2, 0.5], [2, 2, 1.0]]
)
CD = np.array([0, 7, 0, 8, 7, 8])
NODES = (
    grid(XYZ, CD=CD),
    cards("CORD2R", CID=[7], A1=0.3, B1=0.3, B2=0.5, B3=1.0, C1=1.0),
    cards("CORD2C", CID=[8], A1=-1.0, B1=-1.0, B2=0.1, B3=1.0, C1=1.0, C2=0.3),
)


def chain(spring: Table, mass: Table, *more: Table) -> Float:
    """λ of two scalar points on springs of 1: ground - 10 - 11; masses of 1."""
    return (2 * np.pi * modes(model(grid(XYZ[:1]), spring, mass, *more), 2)) ** 2


CHAIN = (3 + np.sqrt(5) * np.array([-1, 1])) / 2


def test_celas_and_cmass_of_scalar_points() -> None:
    """CELAS3/4 and CMASS3/4; their points need no SPOINT."""
    by_property = (
        cards("CELAS3", EID=[1, 2], PID=5, S1=[10, 10], S2=[0, 11]),
        cards("CMASS3", EID=[3, 4], PID=6, S1=[10, 11]),
        cards("PELAS", PID=[5], K=1.0),
        cards("PMASS", PID=[6], M=1.0),
    )
    of_their_own = (
        cards("CELAS4", EID=[1, 2], K=1.0, S1=[10, 10], S2=[0, 11]),
        cards("CMASS4", EID=[3, 4], M=1.0, S1=[10, 11]),
    )
    for tables in (by_property, of_their_own):
        np.testing.assert_allclose(chain(*tables), CHAIN, rtol=EXACT)


def test_dashpots_between_components_and_points() -> None:
    """c (v1 - v2) along y of a turned frame, and between two scalar points."""
    xyz = grid(np.zeros((2, 3)), CD=7)
    pair = {"G1": [1], "C1": 2, "G2": [2], "C2": 2}
    ground = cards("CELAS2", EID=[9], K=1.0, G1=[1], C1=1)
    for tables in (
        (cards("CDAMP1", EID=[1], PID=3, **pair), cards("PDAMP", PID=[3], B=7.0)),
        (cards("CDAMP2", EID=[1], B=7.0, **pair),),
    ):
        s = assemble(model(xyz, NODES[1], ground, *tables, AUTOSPC="NO"))
        want = np.zeros((12, 12))
        want[np.ix_([1, 7], [1, 7])] = 7.0 * np.array([[1, -1], [-1, 1]])
        np.testing.assert_allclose(s.viscous.toarray(), want, atol=EXACT)
    for tables in (
        (
            cards("CDAMP3", EID=[1], PID=3, S1=[10], S2=[11]),
            cards("PDAMP", PID=[3], B=7.0),
        ),
        (cards("CDAMP4", EID=[1], B=7.0, S1=[10], S2=[11]),),
    ):
        s = assemble(model(grid(XYZ[:1]), *tables, AUTOSPC="NO"))
        np.testing.assert_allclose(s.viscous.toarray()[-2:, -2:], [[7, -7], [-7, 7]])


def test_cvisc_acts_along_and_about_its_line() -> None:
    x = np.array([[0, 0, 0], [3.0, 4.0, 0]])
    line = cards("CVISC", EID=[1], PID=2, G1=1, G2=2)
    s = assemble(
        model(grid(x), line, cards("PVISC", PID=[2], CE=5.0, CR=2.0), AUTOSPC="NO")
    )
    e = np.array([0.6, 0.8, 0.0])
    B = s.viscous.toarray()
    np.testing.assert_allclose(B[:3, :3], 5 * np.outer(e, e), atol=EXACT)
    np.testing.assert_allclose(B[3:6, 9:12], -2 * np.outer(e, e), atol=EXACT)
    np.testing.assert_allclose(B @ s.rigid_body(), 0.0, atol=10 * EXACT)


def test_a_damped_oscillator_decays_as_it_should() -> None:
    """m = 2, k = 50, c = 4: ζ = c/(2 sqrt(km))."""
    m = model(
        grid(np.zeros((1, 3)), PS="23456"),
        cards("CELAS2", EID=[1], K=50.0, G1=[1], C1=1),
        cards("CMASS2", EID=[2], M=2.0, G1=[1], C1=1),
        cards("CDAMP2", EID=[3], B=4.0, G1=[1], C1=1),
    )
    with EmbeddedSolver().open(m) as analysis:
        got = analysis.complex_modes(ModesRequest(1)).modes
    assert got.damping[0] == pytest.approx(4 / (2 * np.sqrt(100)), rel=1e-10)


def test_a_dashpot_on_hardly_any_mass_hides_no_low_mode() -> None:
    """A chain of 30 masses; the answer to the dashpot, to a point of 1e-9 kg on 1e6 N/m, is a
    million times as fast.
    """
    points = np.arange(1, 31)
    at, below, one = (
        np.append(points, 99),
        np.append(points - 1, 0),
        np.ones(points.size),
    )
    m = model(
        grid(XYZ[:1]),
        cards("CELAS4", EID=at, K=np.append(1e4 * one, 1e6), S1=at, S2=below),
        cards("CMASS4", EID=100 + at, M=np.append(one, 1e-9), S1=at),
        cards("CDAMP4", EID=[250], B=20.0, S1=[15], S2=[99]),
    )
    with EmbeddedSolver().open(m) as analysis:
        got = analysis.complex_modes(ModesRequest(3)).modes
    # without the dashpot, which moves it by 0.2 %
    lowest = 100 * np.sin(np.pi / 122) / np.pi
    assert got.frequencies[0] == pytest.approx(lowest, rel=0.01)


@pytest.mark.parametrize("dashpot", [0.0, 0.4])
def test_rayleigh_damping(dashpot: float) -> None:
    """PARAM ALPHA1 = 0.3, ALPHA2 = 0.02: ζ = α/2ω + βω/2, and D' = αM' + βK'; a dashpot adds its
    own.
    """
    springs = cards("CELAS4", EID=[1, 2], K=1.0, S1=[10, 10], S2=[0, 11])
    masses = cards("CMASS4", EID=[3, 4], M=1.0, S1=[10, 11])
    damper = cards("CDAMP4", EID=[5], B=dashpot, S1=[10], S2=[11])
    m = model(grid(XYZ[:1]), springs, masses, damper, ALPHA1=0.3, ALPHA2=0.02)
    with EmbeddedSolver().open(m) as analysis:
        got = analysis.complex_modes(ModesRequest(2)).modes
        D = analysis.system.viscous.toarray()
    if not dashpot:
        w = 2 * np.pi * got.frequencies
        np.testing.assert_allclose(got.damping, 0.15 / w + 0.01 * w, rtol=1e-10)
    pair = np.array([[1, -1], [-1, 1]])
    np.testing.assert_allclose(
        D,
        0.3 * np.eye(2) + 0.02 * (pair + np.diag([1, 0])) + dashpot * pair,
        atol=EXACT,
    )


def test_a_model_in_which_nothing_moves_says_what_holds_it() -> None:
    held = grid(np.zeros((1, 3)), PS="123456")
    with pytest.raises(InputError, match=r"check SPC and MPC$"):
        EmbeddedSolver().open(model(held))
    with pytest.raises(InputError, match="check SPC and MPC; 6 have no stiffness"):
        EmbeddedSolver().open(model(grid(np.zeros((1, 3)))))


def test_conm1_in_a_frame_is_conm2() -> None:
    """The 6 x 6 matrix of a rigid body on an arm, given in its own frame."""
    body = {
        "M": 3.0,
        "X1": 0.2,
        "X2": -0.1,
        "X3": 0.4,
        "I11": 0.5,
        "I21": 0.02,
        "I22": 0.7,
        "I31": -0.03,
        "I32": 0.05,
    }
    two = cards("CONM2", EID=[1], G=2, CID=7, **body, I33=0.6)
    spring = cards("CELAS2", EID=[9], K=1.0, G1=[1], C1=1)
    want = assemble(model(*NODES, two, spring, AUTOSPC="NO")).mass.toarray()
    own = want[6:12, 6:12]  # node 2 has the displacement frame 7
    lower = {f"M{i + 1}{j + 1}": own[i, j] for i in range(6) for j in range(i + 1)}
    one = cards("CONM1", EID=[1], G=2, CID=7, **{k: [v] for k, v in lower.items()})
    got = assemble(model(*NODES, one, spring, AUTOSPC="NO")).mass.toarray()
    np.testing.assert_allclose(got, want, atol=EXACT)


def bush(**more: object) -> Float:
    """Stiffness of a bush of K1..K6 = 1..6, CD frames all basic."""
    x = grid(np.array([[2.0, 2.0, 0.0], [2.0, 2.0, 3.0]]))
    k = {f"K{i}": float(i) for i in range(1, 7)} | {"B1": 8.0, "GE": 0.1}
    polar = cards("CORD2C", CID=[8], B3=1.0, C1=1.0)
    m = model(
        x,
        polar,
        cards("CBUSH", EID=[1], PID=1, GA=1, **more),
        cards("PBUSH", PID=[1], **k),
        AUTOSPC="NO",
    )
    s = assemble(m)
    np.testing.assert_allclose(
        s.structural.toarray(), 0.1 * s.stiffness.toarray(), atol=EXACT
    )
    assert s.viscous.toarray().trace() > 7.9
    return s.stiffness.toarray()


def test_a_bush_with_loss_factors_by_direction() -> None:
    """Grounded in the turned frame of its node: H = diag(GEi Ki) in the free DOFs; blanks beside
    GE2 are 0.
    """
    k = {f"K{i}": float(i) for i in range(1, 7)} | {"GE": 0.1, "GE2": 0.2, "GE6": 0.3}
    bush = cards("CBUSH", EID=[1], PID=1, GA=2, CID=7)
    s = assemble(model(*NODES, bush, cards("PBUSH", PID=[1], **k), AUTOSPC="YES"))
    np.testing.assert_allclose(
        s.stiffness.toarray(), np.diag(np.arange(1.0, 7)), atol=EXACT
    )
    np.testing.assert_allclose(
        s.structural.toarray(), np.diag([0.1, 0.4, 0, 0, 0, 1.8]), atol=EXACT
    )


def test_a_bush_in_a_cylindrical_frame_is_turned_to_its_end_a() -> None:
    """GA stands at 45 degrees: radial K1, tangential K2."""
    r, t = np.array([1, 1, 0]) / np.sqrt(2), np.array([-1, 1, 0]) / np.sqrt(2)
    want = np.outer(r, r) + 2 * np.outer(t, t) + 3 * np.diag([0, 0, 1.0])
    np.testing.assert_allclose(bush(CID=8)[:3, :3], want, atol=EXACT)
    np.testing.assert_allclose(bush(GB=2, CID=8)[6:9, :3], -want, atol=EXACT)


def test_where_a_bush_stands() -> None:
    """S from A to B: lateral stiffness k at distance d turns node A by k d²; OCID places it
    anywhere.
    """
    for s, more in ((0.5, {}), (0.25, {"S": 0.25}), (2.0, {"OCID": 0, "S3": 6.0})):
        K = bush(GB=2, CID=0, **more)
        assert K[3, 3] == pytest.approx(4 + 2 * (3 * s) ** 2)
        assert K[9, 9] == pytest.approx(4 + 2 * (3 - 3 * s) ** 2)


def rigid(m: Model) -> float:
    s = assemble(m)
    want = np.zeros((len(XYZ), 6, 6))
    want[:] = np.eye(6)
    want[:, :3, 3:] = np.cross(np.eye(3), XYZ[:, None, :]).swapaxes(1, 2)
    return float(np.abs(s.expand(s.rigid_body()) - want.reshape(-1, 6)).max())


def rbe1(independent: list[tuple[int, str]], dependent: list[tuple[int, str]]) -> Table:
    n, m = zip(*independent, strict=True), zip(*dependent, strict=True)
    (gn, cn), (gm, cm) = (tuple(list(v) for v in pairs) for pairs in (n, m))
    return cards(
        "RBE1", EID=[4], GN=ragged(gn), CN=ragged(cn), GM=ragged(gm), CM=ragged(cm)
    )


@pytest.mark.parametrize(
    "element",
    [
        cards("RBAR", EID=[1], GA=2, GB=5),
        cards("RBAR", EID=[1], GA=4, GB=6, CNA="123456", CMB="123"),
        cards("RBAR", EID=[1], GA=1, GB=4, CNA="1236", CNB="12"),
        rbe1(
            [(1, "123"), (4, "23"), (6, "2")], [(2, "123456"), (5, "135"), (1, "456")]
        ),
        rbe1([(5, "123456")], [(1, "123456"), (4, "123456")]),
    ],
    ids=["bar", "bar part", "bar mixed", "rbe1 mixed", "rbe1 like rbe2"],
)
def test_rigid_elements_keep_rigid_motions(element: Table) -> None:
    m = model(*NODES, element, AUTOSPC="NO")
    assert rigid(m) < 1e-12
    assert len(assemble(m).free) < 36


def rbe3(refc: str, um: list[tuple[int, str]]) -> Table:
    """Node 5 on nodes 1 to 4."""
    gm, cm = zip(*um, strict=True)
    independent = {
        "G": ragged([1, 2, 3, 4]),
        "C": ragged(["123"] * 4),
        "WT": ragged([1.0, 2.0, 1.0, 0.5]),
    }
    return cards(
        "RBE3",
        EID=[8],
        REFGRID=5,
        REFC=refc,
        **independent,
        GM=ragged(list(gm)),
        CM=ragged(list(cm)),
    )


def test_rbe3_solved_for_other_degrees_of_freedom() -> None:
    """The same four equations, whichever DOFs they are solved for: the motions that they allow are
    one space.
    """
    ways = [
        rbe3("1235", [(5, "1235")]),
        rbe3("1235", [(1, "1"), (2, "2"), (3, "3"), (5, "3")]),
        rbe3("1235", [(5, "35"), (3, "3"), (4, "1")]),
    ]
    T = [assemble(model(*NODES, way, AUTOSPC="NO")).transform.toarray() for way in ways]
    free = [
        set(assemble(model(*NODES, way, AUTOSPC="NO")).free.labels()) for way in ways
    ]
    assert {"5+X", "5+Y", "5+RY"} <= free[1]
    assert not {"1+X", "2+Y", "3+Z", "5+Z"} & free[1]
    for other in T[1:]:
        x = np.linalg.lstsq(T[0], other, rcond=None)[0]
        np.testing.assert_allclose(T[0] @ x, other, atol=1e-10)
    assert rigid(model(*NODES, ways[1], AUTOSPC="NO")) < 1e-11


def test_rbe3_um_that_does_not_fit_is_refused() -> None:
    with pytest.raises(
        DeckError,
        match="RBE3 8: UM names 3 components; allowed are as many as REFC has, 4",
    ):
        assemble(model(*NODES, rbe3("1235", [(5, "123")])))
    with pytest.raises(
        DeckError, match="RBE3 8: the components in UM are not determined"
    ):
        assemble(model(*NODES, rbe3("12", [(1, "45")])))


def test_rigid_elements_that_are_one_make_one_elimination() -> None:
    """RBAR, RBE1 and RBE2 from node 5 to node 6 give the same transformation."""
    ways = (
        cards("RBAR", EID=[1], GA=5, GB=6, CNA="123456"),
        rbe1([(5, "123456")], [(6, "123456")]),
        cards("RBE2", EID=[1], GN=5, CM="123456", GM=ragged([6])),
    )
    T = [assemble(model(*NODES, way, AUTOSPC="NO")).transform.toarray() for way in ways]
    np.testing.assert_allclose(T[0], T[2], atol=EXACT)
    np.testing.assert_allclose(T[1], T[2], atol=EXACT)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            (cards("RBAR", EID=[1], GA=1, GB=2, CNA="12345"),),
            "RBAR 1: it has 5 independent components",
        ),
        (
            (cards("RBAR", EID=[1], GA=1, GB=2, CNA="1235", CNB="12"),),
            "leave a rigid motion free",
        ),
        (
            (rbe1([(1, "123456")], [(1, "1"), (2, "123")]),),
            "RBE1 4: a component is both",
        ),
        (
            (
                cards("RBAR", EID=[1], GA=1, GB=2),
                cards("RBE2", EID=[3], GN=3, CM="1", GM=ragged([2])),
            ),
            r"DOF 2\+X is dependent more than once \(RBAR 1, RBE2 3\)",
        ),
    ],
)
def test_contradictions_are_named(tables: tuple[Table, ...], message: str) -> None:
    with pytest.raises(DeckError, match=message):
        assemble(model(grid(XYZ), *tables))


def test_a_chain_of_equations() -> None:
    """u3 = 2 u2 and u2 = 3 u1, each in its own set: u3 = 6 u1."""
    mpc = cards(
        "MPC",
        SID=[1, 2],
        G=ragged([3, 2], [2, 1]),
        C=ragged([1, 1], [1, 1]),
        A=ragged([1.0, -2.0], [1.0, -3.0]),
    )
    add = cards("MPCADD", SID=[9], S=ragged([1, 2]))
    s = assemble(model(grid(XYZ[:3], PS="23456"), mpc, add, mpc=9, AUTOSPC="NO"))
    np.testing.assert_allclose(s.expand(np.ones(1))[[0, 6, 12]], [1, 3, 6])


def dmig(
    name: str, rows: list[int], columns: list[int], values: list[float], form: int = 6
) -> Table:
    """A matrix over component 1 of nodes."""
    one = [1] * len(rows)
    terms = {
        "GJ": ragged(columns),
        "CJ": ragged(one),
        "GI": ragged(rows),
        "CI": ragged(one),
    }
    return cards(
        "DMIG",
        ID=[1],
        NAME=name,
        IFO=form,
        A=ragged(values),
        B=ragged([0.0] * len(rows)),
        **terms,
    )


def direct(table: Table, case: CaseControl, **params: float) -> Model:
    mass = cards("CMASS2", EID=[3, 4], M=1.0, G1=[1, 2], C1=1)
    tables = (grid(np.zeros((2, 3)), PS="23456", CD=7), NODES[1], mass, table)
    return Model({t.card: t for t in tables}, params, case)


@pytest.mark.parametrize(
    "table",
    [
        dmig("KX", [1, 2, 2], [1, 1, 2], [2.0, -1.0, 1.0]),
        dmig("KX", [1, 1, 2, 2], [1, 2, 1, 2], [2.0, -1.0, -1.0, 1.0]),
        dmig("KX", [1, 1, 2, 2], [1, 2, 1, 2], [2.0, -1.0, -1.0, 1.0], form=1),
    ],
    ids=["lower", "both", "square"],
)
def test_dmig_stiffness(table: Table) -> None:
    """The chain of two springs of 1, given as a matrix in a displacement frame; CK2 scales it."""
    lam = (2 * np.pi * modes(direct(table, CaseControl(k2gg=((1.0, "kx"),))), 2)) ** 2
    np.testing.assert_allclose(lam, CHAIN, rtol=EXACT)
    lam = (
        2 * np.pi * modes(direct(table, CaseControl(k2gg=((2.0, "KX"),)), CK2=3.0), 2)
    ) ** 2
    np.testing.assert_allclose(lam, 6 * CHAIN, rtol=EXACT)


def test_dmig_mass_is_not_weight() -> None:
    """PARAM,WTMASS does not apply to M2GG; a matrix that is not chosen does nothing."""
    table = dmig("MX", [1, 2], [1, 2], [5.0, 5.0])
    s = assemble(
        direct(table, CaseControl(m2gg=((1.0, "MX"),)), WTMASS=0.1, AUTOSPC="NO")
    )
    np.testing.assert_allclose(s.mass.diagonal(), 5.1)
    assert assemble(
        direct(table, CaseControl(), AUTOSPC="NO")
    ).mass.diagonal().sum() == pytest.approx(2)


def test_dmig_that_cannot_be_used() -> None:
    with pytest.raises(DeckError, match="PARAM,CK1 scales all elements"):
        assemble(
            direct(
                dmig("KX", [1], [1], [1.0]), CaseControl(k2gg=((1.0, "KX"),)), CK1=2.0
            )
        )
    with pytest.raises(DeckError, match="asks for DMIG KY"):
        assemble(direct(dmig("KX", [1], [1], [1.0]), CaseControl(k2gg=((1.0, "KY"),))))
    with pytest.raises(UnsupportedCard, match="KX is of form 2"):
        assemble(
            direct(
                dmig("KX", [1], [1], [1.0], form=2), CaseControl(k2gg=((1.0, "KX"),))
            )
        )
    with pytest.raises(DeckError, match="KX is not symmetric"):
        assemble(
            direct(
                dmig("KX", [1], [2], [1.0], form=1), CaseControl(k2gg=((1.0, "KX"),))
            )
        )


def test_autospc_takes_epzero() -> None:
    """The drilling stiffness of a plate by its rotational stiffness: no direction is weak until
    EPZERO says so.
    """
    xyz, quads = square(1, 1.0, 1.0)
    tables = grid(xyz), shells(quads), pshell(0.1), steel()
    K = assemble(model(*tables, K6ROT=1.0)).stiffness.diagonal()
    share = K[5] / K[3:6].max()
    assert len(assemble(model(*tables, K6ROT=1.0, EPZERO=share / 3)).autospc) == 0
    held = assemble(model(*tables, K6ROT=1.0, EPZERO=share * 3)).autospc
    assert held.labels() == ("1+RZ", "2+RZ", "3+RZ", "4+RZ")


def test_rbe3_um_is_read(tmp_path: Path) -> None:
    lines = [
        "BEGIN BULK",
        "GRID,1,,0.,0.,0.",
        "GRID,2,,1.,0.,0.",
        "GRID,3,,0.,1.,0.",
        "GRID,4,,0.,0.,1.",
        "GRID,5,,1.,1.,1.",
    ]
    lines += [
        "RBE3,10,,5,1234,1.,123,1,2",
        ",3,4",
        ",UM,5,12,1,3,2,2",
        ",ALPHA,1.-5",
        "ENDDATA",
        "",
    ]
    (tmp_path / "a.bdf").write_text("\n".join(lines))
    t = read_deck(tmp_path / "a.bdf")["RBE3"]
    assert t.ragged("G").row(0).tolist() == [1, 2, 3, 4]
    assert t.ragged("GM").row(0).tolist() == [5, 1, 2]
    assert t.ragged("CM").row(0).tolist() == ["12", "3", "2"]


@pytest.mark.parametrize("nodes", [20, 120])
def test_a_mechanism_without_mass_is_named(nodes: int) -> None:
    """A straight pinned CBAR line spins about itself, has no inertia about it, and no node shows it
    alone.
    """
    i = np.arange(1, nodes)
    xyz = np.arange(nodes)[:, None] * np.array([0.1, 0.05, 0.0])
    bars = cards("CBAR", EID=i, PID=1, GA=i, GB=i + 1, X3=1.0)
    section = cards("PBAR", PID=[1], MID=1, A=1e-2, I1=1e-5, I2=1e-5, J=1e-5)
    line = (grid(xyz), bars, section, steel())
    with EmbeddedSolver().open(model(*line, spc([1, nodes], "123"), spc=1)) as analysis:
        with pytest.raises(SingularModel, match="mechanism") as caught:
            analysis.static(np.zeros((6 * nodes, 1)))
        assert caught.value.dofs
        assert all("R" in label for label in caught.value.dofs)
    spun = cards("SPC1", SID=[1, 1], C=["123", "4"], G=ragged([1, nodes], [1]))
    with EmbeddedSolver().open(model(*line, spun, spc=1)) as analysis:
        lowest = analysis.modes(ModesRequest(2))
    L = 0.1 * np.sqrt(1.25) * (nodes - 1)
    want = np.pi / 2 / L**2 * np.sqrt(2e11 * 1e-5 / (8000 * 1e-2))
    np.testing.assert_allclose(
        lowest.modes.frequencies, want, rtol=1e-4
    )  # lumped mass: fourth order
    assert lowest.complete
