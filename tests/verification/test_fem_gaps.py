"""CBUSH1D and CGAP against springs written by hand, and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model
from fem_slopes import check_slopes
from test_fem_derivatives import parameter

from ringtrue.core.arrays import Float
from ringtrue.errors import DeckError
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import Model

XYZ = np.array([[0, 0, 0], [1, 0.5, 0.3]])
AXIS = XYZ[1] / np.linalg.norm(XYZ[1])
FRAME = cards("CORD2R", CID=[7], A1=0.3, B1=0.3, B2=0.5, B3=1.0, C1=1.0)


def bush(p: dict[str, float], xyz: Float = XYZ, **more: object) -> Model:
    line = cards("CBUSH1D", EID=[1], PID=1, GA=1, **{"GB": 2, **more})
    return model(grid(xyz), FRAME, line, cards("PBUSH1D", PID=[1], **p), AUTOSPC="NO")


def gap(p: dict[str, float], xyz: Float = XYZ, **more: object) -> Model:
    line = cards("CGAP", EID=[1], PID=1, GA=1, GB=2, X1=1.0, **more)
    return model(grid(xyz), FRAME, line, cards("PGAP", PID=[1], **p), AUTOSPC="NO")


def block(m: Model) -> Float:
    """The translations of node 1; those of node 2 are the same but for the sign."""
    K = assemble(m).stiffness.toarray()
    np.testing.assert_allclose(K[:3, 6:9], -K[:3, :3])
    np.testing.assert_allclose(K[6:9, 6:9], K[:3, :3])
    return K[:3, :3]


def test_bush_along_its_nodes() -> None:
    m = bush({"K": 3e5, "C": 20.0, "M": 4.0})
    s = assemble(m)
    np.testing.assert_allclose(block(m), 3e5 * np.outer(AXIS, AXIS), atol=1e-6)
    np.testing.assert_allclose(
        s.viscous.toarray()[:3, :3], 20 * np.outer(AXIS, AXIS), atol=1e-12
    )
    np.testing.assert_allclose(
        s.mass.diagonal().reshape(2, 6), [[2, 2, 2, 0, 0, 0]] * 2
    )
    assert abs(s.stiffness @ s.rigid_body()).max() < 1e-9


def test_bush_in_a_frame_and_to_ground() -> None:
    """T1 of CID whatever the nodes are; a blank GB is ground."""
    ref = FRAME
    z = np.array([ref["B1"][0] - ref["A1"][0], 0.5, 1.0])
    z /= np.linalg.norm(z)
    c = np.array([0.7, 0, 0])
    T1 = c - (c @ z) * z
    T1 /= np.linalg.norm(T1)
    np.testing.assert_allclose(
        block(bush({"K": 2.0}, CID=7)), 2 * np.outer(T1, T1), atol=1e-12
    )
    s = assemble(bush({"K": 2.0, "M": 4.0}, CID=7, GB=0))
    K = s.stiffness.toarray()
    np.testing.assert_allclose(K[:3, :3], 2 * np.outer(T1, T1), atol=1e-12)
    assert abs(K[6:]).max() == 0
    assert s.mass.diagonal().sum() == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("p", "along", "across"),
    [
        ({"KA": 1e6, "KB": 5.0, "KT": 300.0}, 1e6, 300.0),
        ({"KA": 1e6, "KB": 5.0, "KT": 300.0, "U0": 0.1}, 5.0, 0.0),
        ({"KA": 1e6, "U0": 0.1}, 1e-8, 0.0),
        ({"KA": 1e6, "MU1": 0.25}, 1e6, 2.5e5),
        ({"KA": 1e6, "U0": -0.1}, 1e6, 0.0),
    ],
    ids=["closed", "open", "open by default", "friction", "overlapping"],
)
def test_gap(p: dict[str, float], along: float, across: float) -> None:
    n = np.outer(AXIS, AXIS)
    np.testing.assert_allclose(
        block(gap(p)), along * n + across * (np.eye(3) - n), atol=1e-9 * along
    )


def test_gap_of_coincident_nodes() -> None:
    K = block(gap({"KA": 1e6, "KT": 10.0}, np.zeros((2, 3)), CID=0))
    np.testing.assert_allclose(K, np.diag([1e6, 10, 10]))


@pytest.mark.parametrize(
    ("m", "field"),
    [(bush({"K": 3e5, "C": 20.0, "M": 4.0}), f) for f in "KM"]
    + [(gap({"KA": 1e6, "MU1": 0.3}), f) for f in ("KA", "MU1")]
    + [
        (gap({"KA": 1e6, "KB": 2.0, "KT": 7e4}), "KT"),
        (gap({"KA": 1e6, "KB": 2.0, "U0": 1.0}), "KB"),
    ],
)
def test_derivatives(m: Model, field: str) -> None:
    check_slopes(m, parameter(("PBUSH1D" if "PBUSH1D" in m else "PGAP", 1, field)))


@pytest.mark.parametrize(
    "m",
    [
        bush({"K": 1.0}, np.zeros((2, 3))),
        bush({"K": 1.0}, GB=0),
        gap({}, np.zeros((2, 3))),
    ],
)
def test_an_element_without_an_axis_is_named(m: Model) -> None:
    with pytest.raises(DeckError, match=r"C(BUSH1D|GAP) 1.*give CID"):
        assemble(m)
