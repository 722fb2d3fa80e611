"""Parameters: exact polynomial parts against assembling anew, and complex-step derivatives against
the parts.
"""

from __future__ import annotations

import localise_twin as twin
import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged, spc, steel
from fem_slopes import matrix_derivatives
from scipy import sparse

from ringtrue.core.parameters import CardField, Parameter, ParameterSet, Substructure
from ringtrue.errors import InputError, UnsupportedError
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.fem.parametrisation.derivatives import affine_terms
from ringtrue.fem.parametrisation.polynomials import AffineTerm, Product
from ringtrue.model.model import Model

X = np.array(
    [
        [0, 0, 0],
        [1, 0, 0.1],
        [1.1, 1, 0],
        [0, 1, 0.1],
        [0, 0, 1],
        [1, 0, 1.2],
        [1, 1, 1],
        [0, 1, 1],
    ]
)
EXACT = 1e-12  # relative to the largest entry


def mixed(*, residual: str = "YES", **mat: float) -> Model:
    """One element of each kind on the corners of a distorted cube, on a spring, tied to a further
    node; `residual` is PARAM,RESBEND, without which the thickness of a shell is a
    cubic.
    """
    section = {"A": 0.01, "I1": 2e-5, "I2": 1e-5, "J": 3e-5, "NSM": 5.0}
    return model(
        grid(np.vstack([X, [[2, 2, 2]]])),
        steel(**mat),
        cards("CQUAD4", EID=[1], PID=1, G1=1, G2=2, G3=3, G4=4, ZOFFS=0.05),
        cards("CTRIA3", EID=[2], PID=1, G1=5, G2=6, G3=7),
        cards("PSHELL", PID=[1], MID1=1, T=0.01, MID2=1, MID3=1, NSM=3.0),
        cards("CHEXA", EID=[3], PID=4, **{f"G{i}": i for i in range(1, 9)}),
        cards("PSOLID", PID=[4], MID=1),
        cards("CBAR", EID=[5], PID=5, GA=1, GB=7, X1=1.0, W1A=0.1),
        cards("PBAR", PID=[5], MID=1, **section),
        cards("CBEAM", EID=[6], PID=6, GA=2, GB=8, X1=1.0),
        cards(
            "PBEAM",
            PID=[6],
            MID=1,
            **section,
            AB=0.01,
            I1B=2e-5,
            I2B=1e-5,
            JB=3e-5,
            NSMB=5.0,
        ),
        cards("CROD", EID=[7], PID=7, G1=3, G2=5),
        cards("PROD", PID=[7], MID=1, A=0.02),
        cards("CBUSH", EID=[8], PID=8, GA=4, GB=6, CID=0),
        cards("PBUSH", PID=[8], **{f"K{i}": 1e7 * i for i in range(1, 7)}),
        cards("CELAS1", EID=[9], PID=9, G1=1, C1=3),
        cards("PELAS", PID=[9], K=1e6),
        cards("CELAS2", EID=[10], K=2e6, G1=2, C1=3, G2=4, C2=3),
        cards("CONM2", EID=[11], G=9, M=50.0, X1=0.2, I11=3.0, I22=4.0, I33=5.0),
        cards("RBE2", EID=[12], GN=7, CM="123456", GM=ragged([9])),
        spc([5], "123"),
        spc=1,
        WTMASS=0.5,
        RESBEND=residual,
    )


def parameter(*targets: tuple[str, int, str]) -> Parameter:
    return Parameter("p", tuple(CardField(*t) for t in targets))


def close(A: sparse.csr_array, B: sparse.csr_array, tolerance: float) -> None:
    assert abs(A - B).max() <= tolerance * max(abs(A).max(), abs(B).max())


POLYNOMIAL = [
    (("MAT1", 1, "E"),),
    (("MAT1", 1, "RHO"),),
    (("PSHELL", 1, "T"),),
    (("PSHELL", 1, "NSM"),),
    *((("PBAR", 5, f),) for f in ("A", "J", "I1", "I2", "NSM")),
    *((("PBEAM", 6, f),) for f in ("J", "NSM")),
    (("PROD", 7, "A"),),
    *((("PBUSH", 8, f"K{i}"),) for i in (1, 4)),
    (("PELAS", 9, "K"), ("CELAS2", 10, "K")),
    (("CONM2", 11, "M"), ("CONM2", 11, "I22")),
    (("MAT1", 1, "RHO"), ("PSHELL", 1, "T"), ("PBAR", 5, "A")),
]


@pytest.mark.parametrize("targets", POLYNOMIAL, ids=str)
def test_parts_add_up_to_the_changed_model(
    targets: tuple[tuple[str, int, str], ...],
) -> None:
    """K(1.7) - K(1) = Σ (1.7^p - 1) K_p, and the derivative at 1 is Σ p K_p: powers, exactly."""
    m, p, a = mixed(residual="NO"), parameter(*targets), np.array([1.7])
    s, changed = assemble(m), assemble(scaled(m, p, 1.7))
    parts = affine_terms(m, ParameterSet((p,)), s)
    assert parts
    assert all(isinstance(t.function, Product) for t in parts)
    close(
        s.stiffness + sum(t.function.value(a) * t.stiffness for t in parts),
        changed.stiffness,
        EXACT,
    )
    close(
        s.mass + sum(t.function.value(a) * t.mass for t in parts), changed.mass, EXACT
    )
    dK, dM = matrix_derivatives(m, p, s)
    close(
        sum(t.function.derivative(np.ones(1), 0) * t.stiffness for t in parts),
        dK,
        1e-10,
    )
    close(sum(t.function.derivative(np.ones(1), 0) * t.mass for t in parts), dM, 1e-10)


def test_thickness_has_a_linear_and_a_cubic_part() -> None:
    m = mixed(residual="NO")
    parts = affine_terms(m, ParameterSet((parameter(("PSHELL", 1, "T")),)), assemble(m))
    assert [t.function for t in parts] == [Product((0,), (1,)), Product((0,), (3,))]


def test_an_element_outside_of_the_sample_has_a_higher_power() -> None:
    """A row of membranes, linear in their thickness, with one shell among them that bends."""
    n = 60
    i = np.arange(n)
    x = [[k, side, 0.0] for k in range(n + 1) for side in (0, 1)]
    bends = cards("PSHELL", PID=[1, 2], MID1=1, T=0.01, MID2=[0, 1])
    quads = cards(
        "CQUAD4",
        EID=i + 1,
        PID=np.where(i == 2, 2, 1),
        G1=2 * i + 1,
        G2=2 * i + 3,
        G3=2 * i + 4,
        G4=2 * i + 2,
    )
    m = model(grid(np.array(x)), steel(), quads, bends, RESBEND="NO")
    p, a = parameter(("PSHELL", 1, "T"), ("PSHELL", 2, "T")), np.array([1.7])
    s = assemble(m)
    parts = affine_terms(m, ParameterSet((p,)), s)
    assert [t.function for t in parts] == [Product((0,), (1,)), Product((0,), (3,))]
    changed = assemble(scaled(m, p, 1.7))
    close(
        s.stiffness + sum(t.function.value(a) * t.stiffness for t in parts),
        changed.stiffness,
        EXACT,
    )


def test_shear_modulus_that_is_given() -> None:
    """E alone scales a rod's axial part, G its torsion; a solid's E and G together are linear."""
    m = mixed(G=7e10)
    (t,) = affine_terms(
        m, ParameterSet((parameter(("MAT1", 1, "E"), ("MAT1", 1, "G")),)), assemble(m)
    )
    assert t.function == Product((0,), (1,))


TOGETHER = [
    [(("MAT1", 1, "E"),), (("PSHELL", 1, "T"),)],
    [(("MAT1", 1, "RHO"),), (("PSHELL", 1, "T"),), (("MAT1", 1, "E"),)],
    [
        (("PSHELL", 1, "T"),),
        (("PSHELL", 1, "T"), ("PROD", 7, "A")),
        (("PSHELL", 1, "NSM"),),
    ],  # one field, twice
    [(("MAT1", 1, "NU"),)],
    [(("MAT1", 1, "NU"),), (("PSHELL", 1, "T"),)],
    [(("PSHELL", 1, "TST"),), (("PBAR", 5, "I1"),)],
    [(("PBEAM", 6, "I1"),), (("PBEAM", 6, "A"),), (("MAT1", 1, "E"),)],
    [(("CONM2", 11, "X1"),), (("CONM2", 11, "M"),)],
    # one field in two sets
    [(("MAT1", 1, "E"),), (("PROD", 7, "A"),), (("PBAR", 5, "A"),)],
]


@pytest.mark.parametrize("together", TOGETHER, ids=str)
def test_parameters_on_the_same_elements_multiply(
    together: list[tuple[tuple[str, int, str], ...]],
) -> None:
    """The sum of all parts is the model assembled with all factors; its slope is the derivative of
    that model.
    """
    m, rng = mixed(), np.random.default_rng(3)
    names = [
        Parameter(f"p{i}", parameter(*t).targets, 0.7, 1.4)
        for i, t in enumerate(together)
    ]
    s = assemble(m)
    parts = affine_terms(m, ParameterSet(tuple(names)), s)
    for a in rng.uniform(0.7, 1.4, (1, len(names))):
        there = m
        for p, factor in zip(names, a.tolist(), strict=True):
            there = scaled(there, p, factor)
        K, M = (
            sum(t.function.value(a) * A for t, A in parts_of(parts, n))
            for n in range(2)
        )
        at = assemble(there)
        close(s.stiffness + K, at.stiffness, 1e-9)
        close(s.mass + M, at.mass, 1e-9)
        for i, p in enumerate(names):
            dK, dM = matrix_derivatives(there, p, at)
            own = [
                (t.function.derivative(a, i), t) for t in parts if i in t.function.which
            ]
            # of parameters interpolated together
            rounding = 1e-15 * abs(at.stiffness).max()
            off = abs(a[i] * sum(c * t.stiffness for c, t in own) - dK).max()
            assert off <= max(1e-7 * abs(dK).max(), rounding)
            assert (
                abs(a[i] * sum(c * t.mass for c, t in own) - dM).max()
                <= 1e-6 * abs(at.mass).max()
            )


def test_sections_that_share_nothing() -> None:
    """E, I1 and I2 of two columns: their kernels are called together, and neither feels the other's
    factors.
    """
    m, a = twin.read(twin.deck()), np.array([0.9, 1.2, 0.8, 1.1, 0.75, 1.3])
    fields = [
        (card, n, f)
        for n in (11, 22)
        for card, f in (("MAT1", "E"), ("PBEAM", "I1"), ("PBEAM", "I2"))
    ]
    names = [
        Parameter(f"{n} {f}", parameter((card, n, f)).targets, 0.7, 1.4)
        for card, n, f in fields
    ]
    s, there = assemble(m), m
    for p, factor in zip(names, a.tolist(), strict=True):
        there = scaled(there, p, factor)
    parts = affine_terms(m, ParameterSet(tuple(names)), s)
    close(
        s.stiffness + sum(t.function.value(a) * t.stiffness for t in parts),
        assemble(there).stiffness,
        1e-9,
    )


def parts_of(
    parts: tuple[AffineTerm, ...], which: int
) -> list[tuple[AffineTerm, sparse.csr_array]]:
    return [(t, (t.stiffness, t.mass)[which]) for t in parts]


def test_a_factor_on_element_matrices_and_their_modulus() -> None:
    m = mixed()
    sub = Parameter(
        "shell",
        substructures=(Substructure("stiffness", (1,)), Substructure("mass", (2,))),
    )
    s, a = assemble(m), np.array([0.7, 1.3])
    parts = affine_terms(m, ParameterSet((sub, parameter(("MAT1", 1, "E")))), s)
    (both,) = (t for t in parts if t.function.which == (0, 1))
    (one,) = affine_terms(
        m,
        ParameterSet(
            (Parameter("k", substructures=(Substructure("stiffness", (1,)),)),)
        ),
        s,
    )
    close(both.stiffness, one.stiffness, EXACT)
    assert both.function.value(a) == pytest.approx(-0.3 * 0.3)
    assert abs(both.mass).max() == 0


@pytest.mark.parametrize(
    "target",
    [("MAT1", 1, "NU"), ("PBEAM", 6, "I1"), ("PBEAM", 6, "A"), ("PSHELL", 1, "TST")],
    ids=str,
)
def test_complex_step_against_central_differences(target: tuple[str, int, str]) -> None:
    m, p, h = mixed(), parameter(target), 1e-4
    s = assemble(m)
    up, low = (assemble(scaled(m, p, 1 + x)) for x in (h, -h))
    dK, dM = matrix_derivatives(m, p, s)
    close((up.stiffness - low.stiffness) / (2 * h), dK, 5e-6)  # h² of the difference
    assert abs((up.mass - low.mass) / (2 * h) - dM).max() <= 1e-6 * abs(s.mass).max()


def test_what_has_no_series_is_named() -> None:
    m = mixed()
    s = assemble(m)
    with pytest.raises(
        UnsupportedError, match=r"MAT1 NU, 0\.1 to 10\).*narrow the bounds"
    ):  # 0.5 is inside
        affine_terms(m, ParameterSet((parameter(("MAT1", 1, "NU")),)), s)
    with pytest.raises(UnsupportedError, match="GRID X1 moves nodes"):
        affine_terms(m, ParameterSet((parameter(("GRID", 2, "X1")),)), s)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (("PSHELL", 9, "T"), "no such card"),
        (("PSHELL", 1, "THICK"), "no such field"),
        (("MAT1", 1, "G"), "blank"),
        (("PSHELL", 1, "MID1"), "real number"),
    ],
)
def test_targets_that_are_not_there(target: tuple[str, int, str], message: str) -> None:
    m = mixed()
    with pytest.raises(InputError, match=message):
        affine_terms(m, ParameterSet((parameter(target),)), assemble(m))
