"""The parametric reduced model against full solutions of a shell with thickness and stiffness
parameters.
"""

from __future__ import annotations

import numpy as np
import pytest
from eigen_shell import parameters, shell
from scipy import sparse

from ringtrue.core.dofs import DofSet
from ringtrue.core.testmodel import Observation
from ringtrue.errors import InputError
from ringtrue.fem.assembly import assemble
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.observed import FullModel, reduced

COUNT = 14
ROUNDING = (
    # ε|φ|ᵀ|K||φ|/λ of the lowest mode of this thin shell: double precision tells no more
    1e-6
)


@pytest.fixture(scope="module")
def case():
    model = shell(9, 6, clamped=True)
    dofs = assemble(model).dofs
    pick = np.flatnonzero((np.abs(dofs.direction) <= 3) & (dofs.node % 5 == 0))
    matrix = sparse.csr_array(
        (np.ones(pick.size), (np.arange(pick.size), pick)), shape=(pick.size, len(dofs))
    )
    names = DofSet(dofs.node[pick], dofs.direction[pick]).labels()
    observation = Observation(matrix, names, dofs, 1.0, np.zeros(pick.size))
    params = parameters()
    full = FullModel(model, params, observation, ModesRequest(COUNT))
    return full, reduced(model, params, observation, COUNT)


def test_nominal(case):
    full, fast = case
    a, b = full.linearise(np.zeros(3)), fast.linearise(np.zeros(3))
    sign = np.sign(np.einsum("cm,cm->m", a.shapes, b.shapes))
    assert np.allclose(a.frequencies, b.frequencies, rtol=ROUNDING)
    assert np.allclose(a.shapes, b.shapes * sign, atol=1e-7 * np.abs(a.shapes).max())
    assert np.allclose(
        a.d_lambda, b.d_lambda, rtol=1e-6, atol=1e-6 * np.abs(a.d_lambda).max()
    )
    size = np.abs(a.d_shapes).max()
    assert (
        np.abs(a.d_shapes - b.d_shapes * sign[:, None]).max() < 2e-3 * size
    )  # the static part is that at σ, not at λ


@pytest.mark.parametrize(("size", "limit"), [(0.1, 1e-4), (0.5, 1e-2)])
def test_far_from_nominal(case, size, limit):
    """Factors from 1 − size to 1 + size at the corners; the basis was made at nominal only."""
    full, fast = case
    for signs in ((1, 1, 1), (1, -1, 1), (-1, 1, -1)):
        x = np.log(1 + size * np.array(signs))
        truth = full.modes(x).frequencies
        assert np.abs(fast.modes(x).frequencies / truth - 1).max() < limit


def test_enrichment_makes_it_exact_there(case):
    full, fast = case
    x = np.log(1 + 0.5 * np.array([1, -1, 1]))
    before = fast.error(x)
    richer, truth = fast.enrich(x)
    assert np.allclose(truth.frequencies, full.modes(x).frequencies, rtol=ROUNDING)
    assert np.allclose(richer.modes(x).frequencies, truth.frequencies, rtol=ROUNDING)
    was = np.abs(fast.modes(x).frequencies / truth.frequencies - 1).max()
    assert 0.2 < before / was < 5  # an estimate
    assert richer.error(x) < 1e-3 * before
    assert np.allclose(
        richer.modes(np.zeros(3)).frequencies,
        fast.modes(np.zeros(3)).frequencies,
        rtol=ROUNDING,
    )


def test_enrichment_without_parameters_adds_the_modes_alone(case):
    fast = case[1].with_parameters([])
    richer, truth = fast.enrich(np.zeros(0), sensitivities=True)
    assert np.allclose(
        richer.modes(np.zeros(0)).frequencies, truth.frequencies, rtol=ROUNDING
    )


def test_a_solver_reports_its_own_progress():
    said = []
    solver = EmbeddedSolver(progress=lambda _, text: said.append(text))
    with solver.open(shell(18, 12, clamped=True)) as analysis:
        analysis.modes(ModesRequest(COUNT))
    assert any("factorising" in text for text in said)


@pytest.mark.parametrize("which", ["fast", "full"])
def test_sensitivities_are_those_of_what_is_returned(case, which):
    model = case[1] if which == "fast" else case[0]
    x, v = np.array([0.2, -0.1, 0.15]), np.array([0.3, 1.0, -0.6])
    at = model.linearise(x)
    steps, left = (4e-3, 4e-4), []
    for h in steps:
        near = model.modes(x + h * v)
        sign = np.sign(np.einsum("cm,cm->m", at.shapes, near.shapes))
        lam = [(2 * np.pi * f) ** 2 for f in (near.frequencies, at.frequencies)]
        left.append(
            [
                np.abs(lam[0] - lam[1] - h * at.d_lambda @ v).max(),
                np.abs(near.shapes * sign - at.shapes - h * at.d_shapes @ v).max(),
            ]
        )
    slope = np.log10(np.array(left[0]) / np.array(left[1]))
    assert np.allclose(slope, 2, atol=0.15)  # cubic terms bend it


def test_subset_of_parameters(case):
    _, fast = case
    base = np.array([0.1, 0.2, -0.1])
    two = fast.with_parameters([2, 0], base)
    assert two.parameters.names == ("E3", "t1")
    a, b = two.linearise(np.array([-0.1, 0.1])), fast.linearise(base)
    assert np.allclose(a.frequencies, b.frequencies, rtol=1e-12)
    assert np.allclose(a.d_lambda, b.d_lambda[:, [2, 0]])
    with pytest.raises(InputError, match="active"):
        two.linearise(np.zeros(3))
