"""Every kind of parameter: derivatives against Taylor remainders of second order, and closed forms
of places.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards
from scipy import sparse
from test_fem_derivatives import mixed, parameter

from ringtrue.core.parameters import CardField, Parameter, Shape, Substructure
from ringtrue.errors import InputError
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.fem.parametrisation.derivatives import quadratic_forms, system_derivatives
from ringtrue.model.model import Model

NAMES = ("stiffness", "mass")
# at least, by halving the step: a first-order error gives 2, a second-order one 4
SECOND = 3.7


def rich(I12: float = 4e-6) -> Model:
    """The mixed model with dashpots, loss factors, I12 (with it a bar has no shear), and a bush on
    an offset.
    """
    m = mixed(GE=0.02)
    bush = {f"K{i}": 1e7 * i for i in range(1, 7)} | {
        f"B{i}": 1e3 * i for i in range(1, 7)
    }
    bar = {
        "A": 0.01,
        "I1": 2e-5,
        "I2": 1e-5,
        "J": 3e-5,
        "NSM": 5.0,
        "I12": I12,
        "K1": 0.8,
        "K2": 0.7,
    }
    tables = {
        **m.tables,
        "PBUSH": cards("PBUSH", PID=[8], **bush, GE=0.05, GE2=0.2, GE5=0.1),
        "CBUSH": cards("CBUSH", EID=[8], PID=8, GA=4, GB=6, CID=0, S=0.3),
        "PBAR": cards("PBAR", PID=[5], MID=1, **bar),
    }
    return Model(tables, m.params, m.case)


def _matrices(m: Model) -> list[sparse.csr_array]:
    s = assemble(m)
    return [getattr(s, n) for n in NAMES]


def _remainder(m: Model, p: Parameter, slope: object, h: float) -> list[float]:
    base, there = _matrices(m), _matrices(scaled(m, p, 1 + h))
    return [
        float(abs(b - a - h * getattr(slope, n)).max())
        for a, b, n in zip(base, there, NAMES, strict=True)
    ]


PLACES = Shape((1, 7), ((0.3, 0.1, -0.2), (0.1, 0.2, 0.3)))
HUB = Shape((9,), ((0.4, -0.3, 0.2),))  # a dependent node: the rigid arm changes
KINDS = {
    **{f"MAT1 {f}": parameter(("MAT1", 1, f)) for f in ("E", "NU", "RHO")},
    **{f"PSHELL {f}": parameter(("PSHELL", 1, f)) for f in ("T", "TST", "NSM")},
    **{
        f"PBAR {f}": parameter(("PBAR", 5, f))
        for f in ("A", "I1", "I2", "I12", "J", "NSM", "K1", "K2")
    },
    **{
        f"PBEAM {f}": parameter(("PBEAM", 6, f))
        for f in ("A", "I1", "I2", "J", "NSM", "K1", "K2")
    },
    **{f"PBUSH {f}": parameter(("PBUSH", 8, f)) for f in ("K2", "K5")},
    **{
        f"{c} {f}": parameter((c, i, f))
        for c, i, f in (("PELAS", 9, "K"), ("CELAS2", 10, "K"), ("CONM2", 11, "M"))
    },
    "CONM2 I22": parameter(("CONM2", 11, "I22")),
    "CONM2 X1": parameter(("CONM2", 11, "X1")),
    "CBUSH S": parameter(("CBUSH", 8, "S")),
    "CBAR W1A": parameter(("CBAR", 5, "W1A")),
    "CQUAD4 ZOFFS": parameter(("CQUAD4", 1, "ZOFFS")),
    "spring moved from 0": Parameter("p", (CardField("CONM2", 11, "X2", step=0.4),)),
    "E of two elements": Parameter("p", (CardField("MAT1", 1, "E", elements=(1, 3)),)),
    "T of one element": Parameter("p", (CardField("PSHELL", 1, "T", elements=(2,)),)),
    "nodes": Parameter("p", shapes=(PLACES,)),
    "dependent node": Parameter("p", shapes=(HUB,)),
    "GRID X2": parameter(("GRID", 7, "X2")),
    "field and nodes": Parameter("p", (CardField("PSHELL", 1, "T"),), shapes=(PLACES,)),
}


@pytest.mark.parametrize("name", KINDS)
def test_second_order_remainder(name: str) -> None:
    """K(1 + h) − K − hK' is h² (or nothing, where the dependence is linear)."""
    m, p = rich(0.0 if name in ("PBAR K1", "PBAR K2") else 4e-6), KINDS[name]
    (slope,) = system_derivatives(m, [p], assemble(m))
    size = [float(abs(a).max()) for a in _matrices(m)]
    coarse, fine = (_remainder(m, p, slope, h) for h in (0.02, 0.01))
    assert any(
        abs(getattr(slope, n)).max() > 1e-9 * s
        for n, s in zip(NAMES, size, strict=True)
        if s
    )
    for a, b, s in zip(coarse, fine, size, strict=True):
        assert b <= max(a / SECOND, 3e-13 * s)


def test_a_rod_that_grows() -> None:
    """EA/L and ρAL/2 of a rod whose end moves along it: −1/L and 1/L of themselves, to rounding."""
    from fem_cases import grid, model, spc, steel

    L, v = 2.0, 0.5
    m = model(
        grid(np.array([[0, 0, 0], [L, 0, 0]])),
        steel(),
        cards("CROD", EID=[1], PID=1, G1=1, G2=2),
        cards("PROD", PID=[1], MID=1, A=1e-3),
        spc([1], "123456"),
        spc=1,
    )
    s = assemble(m)
    (slope,) = system_derivatives(
        m, [Parameter("L", shapes=(Shape((2,), ((v, 0.0, 0.0),)),))], s
    )
    k, dk = s.stiffness.max(), slope.stiffness.min()
    assert np.isclose(dk, -k * v / L, rtol=1e-11)
    assert np.isclose(slope.mass.max(), s.mass.max() * v / L, rtol=1e-11)


def test_plies_of_a_laminate() -> None:
    """The thickness of one ply, for all elements and for one of them; the material behind the list
    of plies.
    """
    from fem_cases import grid, model, ragged, spc, steel

    x = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0.1], [2, 1, 0]],
        dtype=float,
    )
    m = model(
        grid(x),
        steel(),
        cards("CQUAD4", EID=[1, 2], PID=1, G1=[1, 2], G2=[2, 5], G3=[3, 6], G4=[4, 3]),
        cards(
            "PCOMP",
            PID=[1],
            MID=ragged([1, 1, 1]),
            T=ragged([0.01, 0.015, 0.02]),
            THETA=ragged([0.0, 30.0, 0.0]),
        ),
        spc([1], "123456"),
        spc=1,
    )
    s = assemble(m)
    for target in (
        CardField("PCOMP", 1, "T2"),
        CardField("PCOMP", 1, "T3", elements=(2,)),
        CardField("MAT1", 1, "E", elements=(1,)),
    ):
        p = Parameter("p", (target,))
        (slope,) = system_derivatives(m, [p], s)
        assert abs(slope.stiffness).max() > 1e-3 * abs(s.stiffness).max()
        coarse, fine = (_remainder(m, p, slope, h) for h in (0.02, 0.01))
        for a, b, n in zip(coarse, fine, NAMES, strict=True):
            assert b <= max(a / SECOND, 3e-13 * abs(getattr(s, n)).max())
    with pytest.raises(InputError, match="no entry 4"):
        system_derivatives(m, [Parameter("p", (CardField("PCOMP", 1, "T4"),))], s)


def test_factor_on_element_matrices() -> None:
    """A factor on the stiffness of some elements is the derivative to their E where that is linear;
    mass likewise.
    """
    m = rich()
    s = assemble(m)
    pairs = [
        (
            Substructure("stiffness", (7,)),
            CardField("MAT1", 1, "E", elements=(7,)),
            "stiffness",
        ),
        (
            Substructure("mass", (3,)),
            CardField("MAT1", 1, "RHO", elements=(3,)),
            "mass",
        ),
    ]
    for factor, field, which in pairs:
        a, b = system_derivatives(
            m, [Parameter("s", substructures=(factor,)), Parameter("f", (field,))], s
        )
        one, two = getattr(a, which), getattr(b, which)
        assert abs(one - two).max() <= 1e-12 * abs(two).max()
    with pytest.raises(InputError, match="not all of its 2 elements"):
        system_derivatives(
            m, [Parameter("s", substructures=(Substructure("mass", (3, 999)),))], s
        )


def test_many_at_once_is_one_by_one_and_the_products() -> None:
    """Parameters that share elements, fields and names of fields do not feel each other."""
    m = rich()
    s = assemble(m)
    every = [p for n, p in KINDS.items() if n != "CBAR W1A"]
    together = system_derivatives(m, every, s)
    rng = np.random.default_rng(1)
    v = rng.standard_normal((s.stiffness.shape[0], 3))
    products = quadratic_forms(m, every, s, v)
    for i, (p, got) in enumerate(zip(every, together, strict=True)):
        (alone,) = system_derivatives(m, [p], s)
        for n in NAMES:
            a, b = getattr(got, n), getattr(alone, n)
            assert abs(a - b).max() <= 1e-12 * max(abs(b).max(), 1e-300)
        for A, told in zip((alone.stiffness, alone.mass), products, strict=True):
            want = np.einsum("fm,fm->m", v, A @ v)
            assert np.allclose(
                told[:, i], want, rtol=1e-8, atol=1e-9 * max(abs(A).max(), 1e-300)
            )


def test_targets_that_cannot_be_met() -> None:
    m = rich()
    s = assemble(m)
    with pytest.raises(InputError, match="none of its elements"):
        scaled(m, Parameter("p", (CardField("PSHELL", 1, "T", elements=(5,)),)), 2.0)
    with pytest.raises(InputError, match="GRID 99"):
        system_derivatives(
            m, [Parameter("p", shapes=(Shape((99,), ((1.0, 0.0, 0.0),)),))], s
        )
    with pytest.raises(InputError, match="2 vectors for 1"):
        Shape((1,), ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)))
