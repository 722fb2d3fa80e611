"""Parameters: exact polynomial parts against assembling anew, and complex-step derivatives against the parts."""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged, spc, steel
from scipy import sparse

from ringtrue.core.parameters import Parameter, Target
from ringtrue.errors import InputError, UnsupportedError
from ringtrue.fem.assembly import assemble
from ringtrue.fem.derivatives import matrix_derivatives, scaled, terms
from ringtrue.model.model import Model

X = np.array([[0, 0, 0], [1, 0, 0.1], [1.1, 1, 0], [0, 1, 0.1], [0, 0, 1], [1, 0, 1.2], [1, 1, 1], [0, 1, 1]])
EXACT = 1e-12  # relative to the largest entry


def mixed(**mat: float) -> Model:
    """One element of each kind on the corners of a distorted cube, on a spring, tied to a further node."""
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
        cards("PBEAM", PID=[6], MID=1, **section, AB=0.01, I1B=2e-5, I2B=1e-5, JB=3e-5, NSMB=5.0),
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
    )


def parameter(*targets: tuple[str, int, str]) -> Parameter:
    return Parameter("p", tuple(Target(*t) for t in targets))


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
def test_parts_add_up_to_the_changed_model(targets: tuple[tuple[str, int, str], ...]) -> None:
    """K(1.7) - K(1) = Σ (1.7^p - 1) K_p, and the derivative at 1 is Σ p K_p."""
    m, p = mixed(), parameter(*targets)
    s, a = assemble(m), 1.7
    changed = assemble(scaled(m, p, a))
    parts = terms(m, p, s)
    assert parts
    close(s.stiffness + sum((a**t.power - 1) * t.stiffness for t in parts), changed.stiffness, EXACT)
    close(s.mass + sum((a**t.power - 1) * t.mass for t in parts), changed.mass, EXACT)
    dK, dM = matrix_derivatives(m, p, s)
    close(sum(t.power * t.stiffness for t in parts), dK, 1e-10)
    close(sum(t.power * t.mass for t in parts), dM, 1e-10)


def test_thickness_has_a_linear_and_a_cubic_part() -> None:
    m = mixed()
    assert [t.power for t in terms(m, parameter(("PSHELL", 1, "T")), assemble(m))] == [1, 3]


def test_shear_modulus_that_is_given() -> None:
    """E alone scales a rod's axial part, G its torsion; a solid's E and G together are linear."""
    m = mixed(G=7e10)
    s = assemble(m)
    (t,) = terms(m, parameter(("MAT1", 1, "E"), ("MAT1", 1, "G")), s)
    assert t.power == 1


@pytest.mark.parametrize(
    "target", [("MAT1", 1, "NU"), ("PBEAM", 6, "I1"), ("PBEAM", 6, "A"), ("PSHELL", 1, "TST")], ids=str
)
def test_complex_step_against_central_differences(target: tuple[str, int, str]) -> None:
    m, p, h = mixed(), parameter(target), 1e-4
    s = assemble(m)
    up, low = (assemble(scaled(m, p, 1 + x)) for x in (h, -h))
    dK, dM = matrix_derivatives(m, p, s)
    close((up.stiffness - low.stiffness) / (2 * h), dK, 1e-6)  # h² of the difference
    assert abs((up.mass - low.mass) / (2 * h) - dM).max() <= 1e-6 * abs(s.mass).max()


def test_what_is_not_polynomial_is_named() -> None:
    m = mixed()
    s = assemble(m)
    for target in (("MAT1", 1, "NU"), ("PBEAM", 6, "I1")):
        with pytest.raises(UnsupportedError, match=" ".join((target[0], target[2]))):
            terms(m, parameter(target), s)
    with pytest.raises(UnsupportedError, match="place or direction"):
        terms(m, parameter(("CONM2", 11, "X1")), s)


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
        terms(m, parameter(target), assemble(m))
