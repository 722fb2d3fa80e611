"""Parameters of laminates, any number of them together, against the deck assembled anew and its
derivatives.

A plate of skewed quadrilaterals, one edge held: two laminates of carbon plies on a core, the second
not symmetrical.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged, shells, spc, square
from fem_slopes import matrix_derivatives
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import CardField, Parameter, ParameterSet, Substructure
from ringtrue.errors import NumericalError
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.fem.parametrisation.derivatives import affine_terms
from ringtrue.fem.parametrisation.polynomials import AffineTerm
from ringtrue.model.model import Model

SIDE = 6  # elements
HOLDS, SLOPES = 1e-8, 1e-6  # relative to the roots of the diagonal entries
LOW, HIGH = 0.5, 2.0


def plate(second: int = 2) -> Model:
    x, quads = square(SIDE, 1.0, 1.0)
    inner = (x[:, :2] > 0).all(axis=1) & (x[:, :2] < 1).all(axis=1)
    x[:, :2] += (
        np.random.default_rng(5).uniform(-0.25, 0.25, (len(x), 2))
        / SIDE
        * inner[:, None]
    )
    skin = {
        "E1": 1.3e11,
        "E2": 9e9,
        "NU12": 0.3,
        "G12": 5e9,
        "G1Z": 5e9,
        "G2Z": 3e9,
        "RHO": 1600.0,
    }
    core = {
        "E1": 1e6,
        "E2": 1e6,
        "NU12": 0.1,
        "G12": 1e6,
        "G1Z": 3e8,
        "G2Z": 2e8,
        "RHO": 50.0,
    }
    thin, thick, angles = 0.0002, 0.01, [0.0, 45.0, 0.0, -45.0]
    half = np.where(np.arange(len(quads)) < len(quads) // 2, 1, second)
    return model(
        grid(x),
        cards("MAT8", MID=[1, 2], **{f: [skin[f], core[f]] for f in skin}),
        shells(quads).with_column("PID", half),
        cards(
            "PCOMP",
            PID=[1, 2],
            MID=ragged([1, 1, 2, 1, 1], [1, 1, 2, 1]),
            T=ragged([thin, thin, thick, thin, thin], [thin, thin, thick, thin]),
            THETA=ragged([0.0, 90.0, 0.0, 90.0, 0.0], angles),
        ),
        spc(np.flatnonzero(x[:, 0] == 0) + 1, "123456"),
        spc=1,
    )


def parameter(
    name: str, *targets: CardField, lower: float = LOW, upper: float = HIGH
) -> Parameter:
    return Parameter(name, targets, lower, upper)


def constants(*fields: str, lower: float = LOW, upper: float = HIGH) -> list[Parameter]:
    return [
        parameter(f, CardField("MAT8", 1, f), lower=lower, upper=upper) for f in fields
    ]


def plies(*elements: int) -> Parameter:
    return parameter(
        "T", *(CardField("PCOMP", 1, f"T{i}", elements) for i in (1, 2, 4, 5))
    )


def close(
    found: sparse.csr_array,
    true: sparse.csr_array,
    size: sparse.csr_array,
    tolerance: float,
) -> None:
    d = size.diagonal()
    s = sparse.diags_array(np.where(d > 0, 1 / np.sqrt(np.where(d > 0, d, 1.0)), 0.0))
    assert abs(s @ (found - true) @ s).max() <= tolerance


def total(
    terms: Sequence[AffineTerm],
    weights: Sequence[float],
    name: str,
    start: sparse.csr_array,
) -> sparse.csr_array:
    return sum(
        (w * getattr(t, name) for w, t in zip(weights, terms, strict=True)), start
    )


def changed(m: Model, parameters: Sequence[Parameter], a: Float) -> Model:
    for p, factor in zip(parameters, a.tolist(), strict=True):
        m = scaled(m, p, factor)
    return m


def as_assembled_anew(
    m: Model, s: System, parameters: Sequence[Parameter], a: Float
) -> tuple[AffineTerm, ...]:
    """K and M are those of the changed deck."""
    terms = affine_terms(m, ParameterSet(tuple(parameters)), s)
    true = assemble(changed(m, parameters, a))
    for name in ("stiffness", "mass"):
        found = total(
            terms, [t.function.value(a) for t in terms], name, getattr(s, name)
        )
        close(found, getattr(true, name), getattr(true, name), HOLDS)
    return terms


def slopes_are_derivatives(
    m: Model, parameters: Sequence[Parameter], terms: Sequence[AffineTerm], a: Float
) -> None:
    """Of the model `m`, in which the parameters are at `a`."""
    s = assemble(m)
    for i, p in enumerate(parameters):
        slopes = [a[i] * t.function.derivative(a, i) for t in terms]
        for name, true in zip(
            ("stiffness", "mass"), matrix_derivatives(m, p, s), strict=True
        ):
            close(total(terms, slopes, name, 0 * true), true, getattr(s, name), SLOPES)


def test_all_of_a_laminate_together() -> None:
    m = plate()
    every = [*constants("E1", "E2", "NU12", "G12", "RHO"), plies()]
    a = np.array([0.8, 1.7, 1.3, 0.6, 1.2, 1.5])
    terms = as_assembled_anew(m, assemble(m), every, a)
    slopes_are_derivatives(changed(m, every, a), every, terms, a)


def test_for_some_elements_only() -> None:
    """The thickness of some elements, moduli of all, and of the core: two regions of one laminate,
    one of the other.
    """
    m = plate()
    every = [
        *constants("E1", "G12"),
        parameter("core", CardField("MAT8", 2, "G1Z")),
        plies(*range(5, 12)),
    ]
    terms = as_assembled_anew(m, assemble(m), every, np.array([0.9, 1.4, 1.2, 0.7]))
    slopes_are_derivatives(m, every, terms, np.ones(4))


def test_one_parameter_by_itself() -> None:
    """Within its bounds and, where the kernels themselves are called, beyond them."""
    m, (g1z,) = plate(second=1), [parameter("core", CardField("MAT8", 2, "G1Z"))]
    for a in (0.7, 1.9, 2.02):
        terms = as_assembled_anew(m, assemble(m), [g1z], np.array([a]))
        slopes_are_derivatives(scaled(m, g1z, a), [g1z], terms, np.array([a]))


def test_entries_that_two_parameters_change_together_alone() -> None:
    """A panel of one square: thickness or a modulus by itself tells of such an entry 1e-9, both
    together 1e-2.
    """
    x, quads = square(1, 50.0, 50.0)
    skin = {
        "E1": 1.35e5,
        "E2": 9e3,
        "NU12": 0.3,
        "G12": 4500.0,
        "G1Z": 4500.0,
        "G2Z": 4500.0,
        "RHO": 1.6e-9,
    }
    core = {
        "E1": 10.0,
        "E2": 10.0,
        "NU12": 0.3,
        "G12": 5.0,
        "G1Z": 220.0,
        "G2Z": 130.0,
        "RHO": 8e-11,
    }
    plies = {
        "MID": [1, 1, 2, 1, 1],
        "T": [0.2, 0.2, 20.0, 0.2, 0.2],
        "THETA": [0.0, 90.0, 0.0, 90.0, 0.0],
    }
    m = model(
        grid(x),
        cards("MAT8", MID=[1, 2], **{f: [skin[f], core[f]] for f in skin}),
        shells(quads),
        cards("PCOMP", PID=[1], **{f: ragged(v) for f, v in plies.items()}),
    )
    densities = [
        parameter(f"RHO {i}", CardField("MAT8", i, "RHO"), lower=2 / 3, upper=1.5)
        for i in (1, 2)
    ]
    thickness = parameter("T", *(CardField("PCOMP", 1, f"T{i}") for i in range(1, 6)))
    every = [*constants("E1", "E2", "G12", lower=0.4, upper=2.5), thickness, *densities]
    terms = as_assembled_anew(
        m, assemble(m), every, np.array([0.5, 1.4, 2.2, 1.7, 0.8, 1.3])
    )
    assert len(terms) <= 16


def test_nominal_is_exact() -> None:
    m = plate()
    terms = affine_terms(
        m, ParameterSet(tuple(constants("E1", "E2", "NU12"))), assemble(m)
    )
    assert all(t.function.value(np.ones(3)) == 0.0 for t in terms)


def test_a_factor_on_element_matrices_and_a_modulus() -> None:
    """E1 and a factor on the stiffness of some elements: the factor multiplies what E1 makes of
    them.
    """
    m, some = (
        plate(),
        Parameter(
            "k", substructures=(Substructure("stiffness", tuple(range(10, 30))),)
        ),
    )
    (e1,) = constants("E1")
    a = np.array([1.6, 0.7])
    s, there = assemble(m), scaled(m, e1, 1.6)
    terms = affine_terms(m, ParameterSet((e1, some)), s)
    true = assemble(there)
    (by_itself,) = affine_terms(there, ParameterSet((some,)), true)
    expected = sparse.csr_array(true.stiffness - 0.3 * by_itself.stiffness)
    found = total(terms, [t.function.value(a) for t in terms], "stiffness", s.stiffness)
    close(found, expected, expected, HOLDS)


def test_bounds_that_not_all_parameters_may_reach_together() -> None:
    """NU12² < E1/E2 holds at the bounds of each by itself, not where all are at theirs. So near to
    a pole the residual bending flexibility would be refused.
    """
    m = replace(plate(second=1), params={"RESBEND": "NO"})
    wide = constants("E1", "NU12", lower=0.15, upper=7.0)
    terms = affine_terms(m, ParameterSet(tuple(wide)), assemble(m))
    with pytest.raises(NumericalError, match="does not allow"):
        terms[0].function.value(np.array([0.15, 7.0]))
