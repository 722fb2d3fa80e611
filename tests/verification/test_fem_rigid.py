"""RROD, RBAR1, RJOINT, RTRPLT, RTRPLT1, RSPLINE: rigid motions pass, each is what it is made of,
splines bend.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged
from test_fem_constraints import NODES, XYZ, rigid

from ringtrue.core.arrays import Float
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import Model, Table


def spline(nodes: list[int], comps: list[str], ratio: float = 0.1) -> Table:
    return cards("RSPLINE", EID=[7], DL=ratio, G=ragged(nodes), C=ragged(comps))


def bar1(card: str, cb: str = "") -> Table:
    return cards(card, EID=[1], GA=1, GB=2, CB=cb)


TRIPLE = {"EID": [1], "GA": 1, "GB": 2, "GC": 3}
CASES = {
    "RROD": cards("RROD", EID=[1], GA=2, GB=5, CMA="", CMB="2"),
    "RBAR1": bar1("RBAR1"),
    "RJOINT": bar1("RJOINT", "12356"),
    "RTRPLT": cards("RTRPLT", **TRIPLE, CNA="123", CNB="23", CNC="3"),
    "RTRPLT1": cards("RTRPLT1", **TRIPLE, CMB="123"),
    "RSPLINE": spline([1, 2, 3, 4, 5], ["", "123456", "13", "123456", ""]),
    "two splines": spline([1, 2, 3, 4, 5, 6], ["", "123456", "", "456", "12", ""]),
}


@pytest.mark.parametrize("name", CASES)
def test_rigid_motions_pass(name: str) -> None:
    assert rigid(model(*NODES, CASES[name], AUTOSPC="NO")) < 1e-12


COUNT = {
    "RROD": 1,
    "RBAR1": 6,
    "RJOINT": 5,
    "RTRPLT": 12,
    "RTRPLT1": 9,
    "RSPLINE": 14,
    "two splines": 11,
}


@pytest.mark.parametrize("name", CASES)
def test_so_many_are_dependent(name: str) -> None:
    assert (
        36 - len(assemble(model(*NODES, CASES[name], AUTOSPC="NO")).free) == COUNT[name]
    )


def transform(*tables: Table) -> Float:
    s = assemble(model(*NODES, *tables, AUTOSPC="NO"))
    return np.asarray(s.transform.todense())


@pytest.mark.parametrize("card", ["RBAR1", "RJOINT"])
@pytest.mark.parametrize("cb", ["", "1235"])
def test_bars_are_what_rbar_is(card: str, cb: str) -> None:
    same = cards("RBAR", EID=[1], GA=1, GB=2, CNA="123456", CMB=cb or "123456")
    np.testing.assert_allclose(transform(bar1(card, cb)), transform(same), atol=1e-14)


def test_triangles_are_what_rbe1_is() -> None:
    same = cards("RBE1", EID=[1], GN=ragged([1, 2, 3]), CN=ragged(["123", "23", "3"]))
    dependent = {"GM": ragged([1, 2, 3]), "CM": ragged(["456", "1456", "12456"])}
    same = Table("RBE1", {**same.columns, **dependent}, same.file, same.line)
    np.testing.assert_allclose(transform(CASES["RTRPLT"]), transform(same), atol=1e-12)
    both = cards(
        "RBAR", EID=[1, 2], GA=1, GB=[2, 3], CNA="123456", CMB=["123", "123456"]
    )
    np.testing.assert_allclose(transform(CASES["RTRPLT1"]), transform(both), atol=1e-12)


def test_a_rigid_rod_keeps_its_length_only() -> None:
    s = assemble(model(*NODES, CASES["RROD"], AUTOSPC="NO"))
    u = np.asarray(s.transform.todense()).reshape(len(XYZ), 6, -1)
    axis = XYZ[4] - XYZ[1]
    assert abs(axis @ (u[4, :3] - u[1, :3])).max() < 1e-14
    assert np.linalg.matrix_rank(u[4, :3] - u[1, :3]) == 2


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (cards("RROD", EID=[1], GA=1, GB=2, CMA="1", CMB="2"), "RROD 1.*CMA or CMB"),
        (cards("RROD", EID=[1], GA=1, GB=2, CMA="4"), "RROD 1.*CMA or CMB"),
        (cards("RROD", EID=[1], GA=1, GB=4, CMA="1"), "RROD 1.*across"),
        (cards("RTRPLT", **TRIPLE, CNA="1234"), "RTRPLT 1.*independent"),
        (spline([1, 2, 3], ["", "1", "2"]), "RSPLINE 7.*first and last"),
    ],
)
def test_wrong_cards_are_named(table: Table, message: str) -> None:
    with pytest.raises(DeckError, match=message):
        assemble(model(*NODES, table))


def chain(xyz: Float, ratio: float) -> Model:
    """The spline as real beams: a thin tube with EI = GJ = 1 and EA = 8/D², of steel with E = 1 and
    G = 1.
    """
    length = np.linalg.norm(np.diff(xyz, axis=0), axis=1).sum()
    n = len(xyz) - 1
    section = {"A": 8 / (ratio * length) ** 2, "I1": 1.0, "I2": 1.0, "J": 1.0}
    bars = cards(
        "CBAR",
        EID=np.arange(1, n + 1),
        PID=1,
        GA=np.arange(1, n + 1),
        GB=np.arange(2, n + 2),
        X1=0.1,
        X3=9.0,
    )
    mat = cards("MAT1", MID=[1], E=1.0, G=1.0)
    return model(
        grid(xyz), bars, cards("PBAR", PID=[1], MID=1, **section), mat, AUTOSPC="NO"
    )


@pytest.mark.parametrize("ratio", [0.02, 0.1, 0.7])
def test_a_spline_bends_as_the_tube(ratio: float) -> None:
    """Nodes between two independent ends move as those of the tube, of any shape in space."""
    xyz = np.array(
        [[0, 0, 0], [1, 0.2, 0], [1.5, 1, 0.3], [1.2, 2, 0.1], [2.5, 2.2, 1.0]]
    )
    K = assemble(chain(xyz, ratio)).stiffness.toarray()
    m, n = np.arange(6, 24), np.r_[np.arange(6), np.arange(24, 30)]
    X = -np.linalg.solve(K[np.ix_(m, m)], K[np.ix_(m, n)])
    table = spline([1, 2, 3, 4, 5], ["", *["123456"] * 3, ""], ratio)
    s = assemble(model(grid(xyz), table, AUTOSPC="NO"))
    np.testing.assert_allclose(np.asarray(s.transform.todense())[m], X, atol=1e-9)


def test_a_straight_spline_is_a_cubic() -> None:
    """At the middle of two ends with v = 1 and slope 1 at the second: v = 1/2 − L/8."""
    s = assemble(
        model(
            grid(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]])),
            spline([1, 2, 3], ["", "2", ""]),
            AUTOSPC="NO",
        )
    )
    x = np.zeros(len(s.free))
    x[s.free.labels().index("3+Y")] = x[s.free.labels().index("3+RZ")] = 1.0
    assert s.expand(x)[7] == pytest.approx(0.5 - 2 / 8)
