"""GENEL: a cantilever as flexibility or stiffness, with S given or found, is the beam it stands
for.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged, steel
from fem_slopes import check_slopes

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import CardField, Parameter, Shape
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import Model

XYZ = np.array([[0, 0, 0], [1, 0.5, 0.3], [0.4, 0.1, 2.0]])
FRAMES = (
    cards("CORD2R", CID=[7], A1=0.3, B1=0.3, B2=0.5, B3=1.0, C1=1.0),
    cards("CORD2C", CID=[8], A1=-1.0, B1=-1.0, B2=0.1, B3=1.0, C1=1.0, C2=0.3),
)
NODES = (grid(XYZ, CD=np.array([0, 7, 8])), *FRAMES)


def beam() -> Float:
    """Stiffness (12, 12) of a bar from node 2 to 3, in their displacement frames."""
    section = cards("PBAR", PID=[1], MID=1, A=0.01, I1=2e-5, I2=1e-5, J=3e-5)
    m = model(
        *NODES,
        cards("CBAR", EID=[1], PID=1, GA=2, GB=3, X1=1.0),
        section,
        steel(),
        AUTOSPC="NO",
    )
    return assemble(m).stiffness.toarray()[6:, 6:]


def lower(A: Float) -> Float:
    j, i = np.triu_indices(len(A))
    return A[i, j]


def genel(KZ: Float, form: str, S: Float | None = None, ud: bool = True) -> Model:
    d = {
        "UD": ragged([2] * 6 if ud else np.zeros(0, dtype=int)),
        "CD": ragged(np.arange(1, 7)[: 6 if ud else 0]),
    }
    s = ragged(np.zeros(0) if S is None else S.ravel())
    table = cards(
        "GENEL",
        EID=[5],
        FORM=form,
        UI=ragged([3] * 6),
        CI=ragged(range(1, 7)),
        KZ=ragged(lower(KZ)),
        S=s,
        **d,
    )
    return model(*NODES, table, AUTOSPC="NO")


@pytest.mark.parametrize("form", ["K", "Z"])
@pytest.mark.parametrize("given", [True, False])
def test_it_is_the_beam(form: str, given: bool) -> None:
    K = beam()
    tip = K[6:, 6:] if form == "K" else np.linalg.inv(K[6:, 6:])
    S = -np.linalg.solve(K[6:, 6:], K[6:, :6]) if given else None
    s = assemble(genel((tip + tip.T) / 2, form, S))
    np.testing.assert_allclose(
        s.stiffness.toarray()[6:, 6:], K, atol=1e-7 * abs(K).max()
    )
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-7 * abs(K).max()


def test_without_ud_it_is_held_by_ground() -> None:
    Z = np.diag(np.arange(1.0, 7))
    K = assemble(genel(Z, "Z", ud=False)).stiffness.toarray()
    np.testing.assert_allclose(K[12:, 12:], np.diag(1 / np.arange(1.0, 7)), atol=1e-15)
    assert abs(K[:12]).max() == 0


def test_scalar_points_and_several_sizes() -> None:
    none = np.zeros(0, dtype=int)
    t = cards(
        "GENEL",
        EID=[1, 2],
        FORM=["K", "K"],
        UI=ragged([11, 12], [1]),
        CI=ragged([0, 0], [3]),
        UD=ragged(none, none),
        CD=ragged(none, none),
        KZ=ragged([2.0, -1.0, 3.0], [7.0]),
        S=ragged([], []),
    )
    s = assemble(
        model(grid(XYZ[:1]), cards("SPOINT", ID=ragged([11, 12])), t, AUTOSPC="NO")
    )
    np.testing.assert_allclose(s.stiffness.toarray()[6:, 6:], [[2, -1], [-1, 3]])
    assert s.stiffness.toarray()[2, 2] == 7


@pytest.mark.parametrize(
    "p",
    [
        Parameter("p", (CardField("GENEL", 5, "KZ3"),)),
        Parameter("nodes", shapes=(Shape((3,), ((0.3, 0.1, 0.2),)),)),
    ],
    ids=["KZ3", "nodes"],
)
def test_derivatives(p: Parameter) -> None:
    A = np.random.default_rng(0).normal(size=(6, 6))
    check_slopes(genel(A @ A.T + 3 * np.eye(6), "Z"), p)


def test_what_is_missing_is_named() -> None:
    with pytest.raises(DeckError, match=r"GENEL 5.*Z cannot be inverted"):
        assemble(genel(np.zeros((6, 6)), "Z"))
    m = genel(np.eye(6), "K")
    t = m["GENEL"]
    less = {**t.columns, "UD": ragged([2, 2]), "CD": ragged([1, 2])}
    with pytest.raises(DeckError, match=r"GENEL 5.*S is missing"):
        assemble(Model({**m.tables, "GENEL": cards("GENEL", **less)}, m.params))
