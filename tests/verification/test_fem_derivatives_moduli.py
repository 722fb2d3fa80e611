"""Moduli: stiffness is homogeneous of degree one in all moduli of an element's material (Euler),
and in no others.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, steel
from fem_slopes import matrix_derivatives
from scipy import sparse

from ringtrue.core.parameters import CardField, Parameter
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.fem.parametrisation.derivatives import quadratic_forms, system_derivatives
from ringtrue.fem.parametrisation.element_derivatives import sole_material
from ringtrue.model.model import Model

EXACT = 1e-11  # of the largest entry; the element matrices are condensed


def _strip(**section: object) -> Model:
    """Four quads in a row, warped, on PSHELL 1 and 2."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(5), np.arange(2), indexing="ij"))
    at = 2 * np.arange(4)
    return model(
        grid(np.c_[i, 1.1 * j + 0.1 * i, 0.05 * i * j]),
        steel(),
        cards(
            "CQUAD4",
            EID=[1, 2, 3, 4],
            PID=[1, 1, 1, 2],
            G1=at + 1,
            G2=at + 3,
            G3=at + 4,
            G4=at + 2,
        ),
        cards(
            "PSHELL",
            PID=[1, 2],
            T=0.1,
            NSM=3.0,
            **({"MID1": 1, "MID2": 1, "MID3": 1} | section),
        ),
    )


def _with(m: Model, *more: object) -> Model:
    return Model(m.tables | {t.card: t for t in more}, m.params, m.case)


def _near(A: sparse.csr_array, B: sparse.csr_array, tolerance: float = EXACT) -> bool:
    return bool(abs(A - B).max() <= tolerance * abs(B).max())


def _difference(m: Model, p: Parameter, h: float = 1e-4) -> sparse.csr_array:
    up, low = (assemble(scaled(m, p, 1 + x)).stiffness for x in (h, -h))
    return sparse.csr_array((up - low) / (2 * h))


def test_the_modulus_of_the_only_material_scales_the_stiffness() -> None:
    m = _strip()
    s = assemble(m)
    dK, dM = matrix_derivatives(m, Parameter("E", (CardField("MAT1", 1, "E"),)), s)
    assert _near(dK, s.stiffness)
    assert not abs(dM).max() > 0


def test_one_of_two_materials_does_not() -> None:
    """Membrane of MAT1 1, bending of MAT1 2."""
    m = _with(
        _strip(MID2=2), cards("MAT1", MID=[1, 2], E=[2e11, 7e10], NU=0.3, RHO=8000.0)
    )
    assert (sole_material(m, "CQUAD4") == -1).all()
    s, one, two = (
        assemble(m),
        *(Parameter(f"{i}", (CardField("MAT1", i, "E"),)) for i in (1, 2)),
    )
    dK = matrix_derivatives(m, one, s)[0]
    assert not _near(dK, s.stiffness, 1e-4)
    assert _near(_difference(m, one), dK, 1e-7)
    assert _near(dK + matrix_derivatives(m, two, s)[0], s.stiffness)


@pytest.mark.parametrize("both", [False, True])
def test_young_and_shear_modulus_that_are_both_given(both: bool) -> None:
    m = _with(_strip(), steel(G=6e10))
    e, g = CardField("MAT1", 1, "E"), CardField("MAT1", 1, "G")
    s = assemble(m)
    dK = matrix_derivatives(m, Parameter("E", (e, g) if both else (e,)), s)[0]
    assert _near(dK, s.stiffness) == both
    assert _near(
        dK + 0 * s.stiffness
        if both
        else dK + matrix_derivatives(m, Parameter("G", (g,)), s)[0],
        s.stiffness,
    )


def test_moduli_share_the_sweep_of_other_fields() -> None:
    """Overlapping sets of elements, with and without a thickness on them: each as alone, and as
    products.
    """
    m, E, T = _strip(GE=0.0), ("MAT1", 1, "E"), ("PSHELL", 1, "T")
    every = [
        Parameter("E12", (CardField(*E, elements=(2, 1)),)),
        Parameter("E23", (CardField(*E, elements=(2, 3)),)),
        Parameter("E4", (CardField(*E, elements=(4,)),)),
        Parameter("T1", (CardField(*T, elements=(1,)),)),
        Parameter("T", (CardField(*T),)),
        Parameter(
            "ET", (CardField(*E, elements=(1, 3)), CardField(*T, elements=(1, 3)))
        ),
        Parameter("none", (CardField(*T, elements=(4,)),)),
    ]
    s = assemble(m)
    v = np.random.default_rng(1).standard_normal((s.stiffness.shape[0], 3))
    together = system_derivatives(m, every, s)
    products = quadratic_forms(m, every, s, v)
    for i, (p, one) in enumerate(zip(every, together, strict=True)):
        for A, got, of in zip(
            matrix_derivatives(m, p, s),
            products,
            (one.stiffness, one.mass),
            strict=True,
        ):
            assert abs(A - of).max() <= EXACT * abs(s.stiffness).max()
            want = np.einsum("fm,fm->m", v, A @ v)
            assert np.allclose(
                got[:, i], want, rtol=1e-9, atol=1e-9 * np.abs(want).max(initial=1e-3)
            )
    assert not abs(together[-1].stiffness).max() > 0
