"""CFAST: squares on surfaces of shells that follow linear fields, springs between them, and what
goes wrong.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, square
from fem_slopes import check_slopes, turned
from test_fem_derivatives import parameter

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import Parameter, Shape
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import assemble
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.elements.fasteners import fastener_ends
from ringtrue.model.model import Model

H = 0.1
KT, KR = (3e6, 1e6, 2e6), (5e3, 1e3, 2e3)


def sheets() -> tuple[Float, Float]:
    """Two skewed sheets of 3 x 3 quadrilaterals, H apart, and a node between; quads 1-based."""
    flat, quads = square(3, 1.0, 1.0)
    flat = flat + np.random.default_rng(0).uniform(-0.04, 0.04, flat.shape) * [1, 1, 0]
    return np.vstack(
        [flat, flat + np.array([0.02, 0.03, H]), [[0.48, 0.52, 0.04]]]
    ), np.vstack([quads, quads + len(flat)])


def fast(
    xyz: Float | None = None, p: dict[str, float] | None = None, **more: object
) -> Model:
    x, quads = sheets()
    x = x if xyz is None else xyz
    n = len(quads)
    shells = cards(
        "CQUAD4",
        EID=np.arange(1, n + 1),
        PID=np.repeat([1, 2], n // 2),
        **{f"G{i + 1}": quads[:, i] for i in range(4)},
    )
    line = cards(
        "CFAST",
        EID=[90],
        PID=5,
        **({"TYPE": "PROP", "IDA": 1, "IDB": 2, "GS": len(sheets()[0])} | more),
    )
    k = {f"KT{i + 1}": v for i, v in enumerate(KT)} | {
        f"KR{i + 1}": v for i, v in enumerate(KR)
    }
    table = cards(
        "PFAST", PID=[5], **(k | {"D": 0.6, "MASS": 2.0, "GE": 0.05} | (p or {}))
    )
    # the sheets themselves carry nothing: their material is soft
    skin = cards("PSHELL", PID=[1, 2], MID1=9, T=1e-9)
    return model(
        grid(x),
        shells,
        skin,
        cards("MAT1", MID=[9], E=1e-3, NU=0.3),
        line,
        table,
        AUTOSPC="NO",
    )


def test_ends_follow_linear_fields() -> None:
    """u = A x: the end moves with A x and turns by the mean rotation of its square, (curl of A x)/2
    for a rotation.
    """
    m = fast()
    a, b = fastener_ends(mesh(m).rows("CFAST"))
    x = mesh(m).xyz
    np.testing.assert_allclose(a.place[0], [0.48, 0.52, 0], atol=1e-12)
    np.testing.assert_allclose(b.place[0], [0.48, 0.52, H], atol=1e-12)
    w = np.array([0.3, -0.2, 0.5])
    for end in (a, b):
        u = np.zeros((16, 6))
        u[:, :3] = np.array([1.0, 2, 3]) + np.cross(w, x[end.nodes[0]])
        np.testing.assert_allclose(
            end.follow[0] @ u.ravel(),
            [*(np.array([1.0, 2, 3]) + np.cross(w, end.place[0])), *w],
            atol=1e-12,
        )
        assert len(np.unique(end.nodes)) > 4  # over several shells


def test_springs_between_two_rigid_sheets() -> None:
    """The sheets moved against each other as rigid bodies about the middle: KT along axis z, x and
    y; KR likewise.
    """
    s = assemble(fast())
    K = s.stiffness.toarray()
    n = len(s.xyz)
    middle = np.array([0.48, 0.52, H / 2])
    move = np.zeros((n, 6, 6))
    move[:] = np.eye(6)
    move[:, :3, 3:] = np.cross(np.eye(3), (s.xyz - middle)[:, None, :]).swapaxes(1, 2)
    move[: n // 2] = 0
    move[-1] = 0
    energy = move.reshape(-1, 6).T @ K @ move.reshape(-1, 6)
    # the axis is z, and the second axis the first of basic to which it is across: x
    np.testing.assert_allclose(
        np.diag(energy), [KT[1], KT[2], KT[0], KR[1], KR[2], KR[0]], rtol=1e-6
    )


@pytest.mark.parametrize(
    "more", [{}, {"TYPE": "ELEM", "IDA": 4, "IDB": 14}], ids=["by property", "by shell"]
)
def test_rigid_motions_mass_and_turns(more: dict[str, object]) -> None:
    s = assemble(fast(p={"KT3": KT[1], "KR3": KR[1]}, **more))
    K = s.stiffness.toarray()
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-8 * abs(K).max()
    R = s.rigid_body()[:, :3]
    np.testing.assert_allclose(R.T @ (s.mass @ R), 2.0 * np.eye(3), atol=1e-9)
    there, Q = turned(s.xyz)
    big = np.kron(np.eye(2 * len(there)), Q)
    other = assemble(
        fast(there, {"KT3": KT[1], "KR3": KR[1]}, **more)
    ).stiffness.toarray()
    u, v = (np.random.default_rng(1).normal(size=K.shape[0]) for _ in range(2))
    assert (big @ u) @ other @ (big @ v) == pytest.approx(
        u @ K @ v, rel=0.2
    )  # the square turns with basic


def test_by_place_and_in_an_absolute_frame() -> None:
    one = assemble(fast(p={"MCID": 0, "MFLAG": 1})).stiffness.toarray()
    two = assemble(
        fast(p={"MCID": 0, "MFLAG": 1}, GS=0, XS=0.48, YS=0.52, ZS=0.04)
    ).stiffness.toarray()
    np.testing.assert_allclose(one, two, atol=1e-6)


@pytest.mark.parametrize(
    "p",
    [
        *(parameter(("PFAST", 5, f)) for f in ("KT1", "KT3", "KR2", "MASS")),
        Parameter("node", shapes=(Shape((6,), ((0.01, 0.02, 0.03),)),)),
    ],
    ids=["KT1", "KT3", "KR2", "MASS", "node"],
)
def test_derivatives(p: Parameter) -> None:
    check_slopes(fast(p={"MCID": 0, "MFLAG": 1} if p.shapes else {}), p)


@pytest.mark.parametrize(
    ("p", "more", "message"),
    [
        ({}, {"TYPE": "SHELL"}, "CFAST 90.*allowed are PROP, ELEM"),
        ({}, {"GS": 0}, "CFAST 90.*must say where"),
        ({}, {"IDA": 77}, "CFAST 90.*no foot on the shells of property 77"),
        ({}, {"TYPE": "ELEM", "IDA": 77, "IDB": 12}, "CFAST 90.*77 is no shell"),
        ({"D": 5.0}, {}, "CFAST 90.*D is too large"),
        ({"MCID": 0}, {}, "PFAST 5.*MFLAG"),
    ],
)
def test_wrong_cards_are_named(
    p: dict[str, float], more: dict[str, object], message: str
) -> None:
    with pytest.raises(DeckError, match=message):
        assemble(fast(p=p, **more))


@pytest.mark.parametrize(
    "way",
    [
        {"TYPE": "PARTPAT", "PIDA": 1, "PIDB": 2},
        {"TYPE": "ELPAT", "SHIDA": 4, "SHIDB": 14},
    ],
)
def test_welds_over_several_shells(way: dict[str, object]) -> None:
    """The same squares with the beam of a weld between, beside one that joins two nodes."""
    m = fast()
    line = cards(
        "CWELD",
        EID=[90, 91],
        PID=7,
        **{k: [v, "ALIGN"] if k == "TYPE" else [v, 0] for k, v in way.items()},
        GS=[33, 0],
        GA=[0, 1],
        GB=[0, 2],
    )
    tables = {c: t for c, t in m.tables.items() if c not in ("CFAST", "PFAST", "MAT1")}
    mats = cards("MAT1", MID=[9, 1], E=[1e-3, 2e11], NU=0.3, RHO=[0, 8000.0])
    welds = Model(
        {
            **tables,
            "CWELD": line,
            "PWELD": cards("PWELD", PID=[7], MID=1, D=0.6),
            "MAT1": mats,
        },
        m.params,
    )
    s = assemble(welds)
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-8 * abs(s.stiffness).max()
    lift = np.zeros((len(s.xyz), 6))
    lift[16:32, 2] = 1.0
    area = np.pi / 4 * 0.6**2
    assert lift.ravel() @ s.stiffness @ lift.ravel() == pytest.approx(
        2e11 * area / (0.2 * 0.6)
    )
    check_slopes(welds, parameter(("PWELD", 7, "D")))


@pytest.mark.parametrize("card", ["CFAST", "CWELD"])
def test_two_sheets_of_one_property_are_joined_by_their_shells(card: str) -> None:
    """Named by shells, sheets of one property are told apart: one that is lifted off the other
    takes energy.
    """
    m = fast(TYPE="ELEM", IDA=5, IDB=14)
    one = cards(
        "CQUAD4",
        **{**{c: m["CQUAD4"][c] for c in ("EID", "G1", "G2", "G3", "G4")}, "PID": 1},
    )
    tables = {**m.tables, "CQUAD4": one}
    stiff = KT[0]
    if card == "CWELD":
        stiff = 2e11 * np.pi / 4 * 0.6**2 / (0.2 * 0.6)
        mats = cards("MAT1", MID=[9, 1], E=[1e-3, 2e11], NU=0.3)
        weld = cards("CWELD", EID=[90], PID=7, TYPE="ELPAT", SHIDA=5, SHIDB=14, GS=33)
        tables |= {
            "CWELD": weld,
            "PWELD": cards("PWELD", PID=[7], MID=1, D=0.6),
            "MAT1": mats,
        }
        del tables["CFAST"], tables["PFAST"]
    s = assemble(Model(tables, m.params))
    lift = np.zeros((len(s.xyz), 6))
    lift[16:32, 2] = 1.0
    assert lift.ravel() @ s.stiffness @ lift.ravel() == pytest.approx(stiff)
