"""Residuals of every kind: values against direct solutions, sensitivities against central
differences.

Model: nine masses on a row of springs to ground, in three groups with one stiffness factor each;
masses in the last group change with a fourth parameter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, sparse

from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.errors import InputError, NumericalError
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.dense_models import DenseModel, matrices_at
from ringtrue.reduction.parametric import reduced_model
from ringtrue.updating.residuals.frf import AntiResonances, Frf, zeros
from ringtrue.updating.residuals.modal import (
    Eigenvalues,
    Frequencies,
    Mac,
    ModalMasses,
    Shapes,
    Term,
    point,
)
from ringtrue.updating.residuals.static import (
    MassPropertyDeviations,
    RigidMass,
    StaticDeflections,
    mass_properties,
)
from ringtrue.updating.target import Target

N = 9
X = np.array([0.1, -0.2, 0.15, 0.05])
DIFFERENCE = 1e-6  # central differences of step 1e-5 on smooth functions of order one


def row(count: int = N) -> DenseModel:
    spring = np.zeros((N, N, N))
    for i in range(N):
        v = np.zeros(N)
        v[i] = 1
        if i:
            v[i - 1] = -1
        spring[i] = 4e4 * np.outer(v, v)
    parts = np.array(
        [spring[3 * g : 3 * g + 3].sum(axis=0) for g in range(3)] + [np.zeros((N, N))]
    )
    mass = np.diag(1 + 0.05 * np.arange(N))
    d_mass = np.zeros_like(parts)
    d_mass[3, 6:, 6:] = mass[6:, 6:]
    names = ParameterSet(
        tuple(Parameter(n, (), 0.2, 5.0, "log", 2.0) for n in ("k1", "k2", "k3", "m3"))
    )
    return DenseModel(spring.sum(axis=0), mass, parts, d_mass, np.eye(N), names, count)


def aim(model: DenseModel, modes: int = 5) -> Target:
    at = model.modes(np.array([0.4, -0.2, 0.3, 0.1]))
    rng = np.random.default_rng(3)
    shapes = at.shapes[:, :modes] * (1 + 0.05 * rng.standard_normal((N, modes)))
    return Target(
        at.frequencies[:modes],
        shapes,
        np.full(modes, 0.002),
        np.ones(modes, dtype=bool),
    )


def check(term: Term, model: DenseModel, target: Target, x: np.ndarray = X) -> None:
    """The slope along every parameter is that of the value, sign reversed: Δz = z_test −
    z_model.
    """

    def at(y: np.ndarray) -> np.ndarray:
        return term(point(model, model.linearise(y), target)).value

    block = term(point(model, model.linearise(x), target))
    got = np.stack(
        [(at(x - e) - at(x + e)) / 2e-5 for e in 1e-5 * np.eye(x.size)], axis=1
    )
    assert block.slope.shape == got.shape
    assert block.datum.size == block.mode.size == block.value.size > 0
    np.testing.assert_allclose(block.slope, got, atol=DIFFERENCE * np.abs(got).max())


def frf(model: DenseModel, form: str) -> Frf:
    freqs, out, into = np.array([3.0, 7.5, 16.0]), np.array([0, 4, 8]), np.array([2, 8])
    one = Frf(freqs, np.ones((3, 3, 2)), out, into, 0.02, form=form)  # type: ignore[arg-type]
    there = point(model, model.linearise(np.array([0.4, -0.2, 0.3, 0.1])), aim(model))
    return replace(one, measured=one.response(there)[0])


KINDS = {
    "eigenvalues": lambda m: Eigenvalues(),
    "frequencies": lambda m: Frequencies(),
    "log frequencies": lambda m: Frequencies(scale="log"),
    "shapes": lambda m: Shapes(),
    "shapes at the largest channel": lambda m: Shapes(scaling="largest"),
    "mac": lambda m: Mac(),
    "mac ratio": lambda m: Mac(form="ratio"),
    "log frf": lambda m: frf(m, "log"),
    "complex frf": lambda m: frf(m, "complex"),
    "anti-resonances": lambda m: AntiResonances(
        3, 3, np.array([4.0, 11.0, 17.0, 23.0])
    ),
    "frf at complex frequencies": lambda m: replace(frf(m, "log"), decay=0.1),
    "static": lambda m: StaticDeflections(np.eye(N)[:, [2, 8]], np.full((N, 2), 1e-4)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_sensitivity_is_the_derivative(kind: str) -> None:
    model = row()
    check(KINDS[kind](model), model, aim(model))


@pytest.mark.parametrize("kind", KINDS)
def test_residual_of_the_truth_is_zero_and_blind_to_the_scale_of_test_shapes(
    kind: str,
) -> None:
    model = row()
    x = X * [1, 1, 1, 0]  # cross-orthogonality is with the nominal mass
    at = model.linearise(x)
    target = Target(
        at.frequencies[:5],
        at.shapes[:, :5] * [2, -1, 3, -0.2, 1],
        np.zeros(5),
        np.ones(5, dtype=bool),
    )
    term = KINDS[kind](model)
    if isinstance(term, Frf):
        term = replace(term, measured=term.response(point(model, at, target))[0])
    if isinstance(term, AntiResonances):
        term = replace(term, frequencies=np.sqrt(zeros(at, 3, 3)[0][:4]) / (2 * np.pi))
    if isinstance(term, StaticDeflections):
        term = replace(
            term, measured=linalg.solve(matrices_at(model, x).stiffness, term.loads)
        )
    assert np.abs(term(point(model, at, target)).value).max() < 1e-8


def test_modal_masses_are_those_of_the_scale_of_the_shapes() -> None:
    """Shapes times 1.1 have 1.21 times the modal mass, so that the structure's is less by as much;
    in a deck in tonnes a shape is √1000 times as large.
    """
    model = row()
    here = model.linearise(X)
    target = replace(aim(model), shapes=-1.1 * here.shapes[:, :5])
    got = ModalMasses(0.05)(point(model, here, target))
    np.testing.assert_allclose(got.value, -2 * np.log(1.1) / 0.05)
    tonnes = replace(target, shapes=target.shapes / np.sqrt(1000))
    same = ModalMasses(0.05, 1000.0)(point(model, here, tonnes))
    np.testing.assert_allclose(same.value, got.value)
    check(ModalMasses(), model, aim(model))


def test_mac_residuals_are_those_of_the_mac() -> None:
    model = row()
    target = aim(model)
    at = point(model, model.linearise(X), target)
    np.testing.assert_allclose(Mac(1.0)(at).value, 1 - at.mac, atol=1e-12)
    np.testing.assert_allclose(
        Mac(1.0, "ratio")(at).value, (1 - np.sqrt(at.mac)) / np.sqrt(at.mac), atol=1e-12
    )
    shape = Shapes(1.0)(at)
    np.testing.assert_allclose(
        np.bincount(shape.datum, shape.value**2), 1 - at.mac, atol=1e-12
    )


def test_frf_is_the_direct_solution() -> None:
    model = row()
    m = matrices_at(model, X)
    lam, phi = linalg.eigh(m.stiffness, m.mass)
    d = m.mass @ phi @ np.diag(2 * 0.02 * np.sqrt(lam)) @ phi.T @ m.mass
    term = frf(model, "complex")
    h, _ = term.response(point(model, model.linearise(X), aim(model)))
    for q, w in enumerate((2 * np.pi * term.freqs).tolist()):
        direct = -(w**2) * np.linalg.inv(m.stiffness - w**2 * m.mass + 1j * w * d)
        np.testing.assert_allclose(
            h[q], direct[np.ix_(term.outputs, term.inputs)], rtol=1e-10
        )


def test_a_frf_that_symmetry_or_noise_leaves_nothing_of_does_not_drown_the_others() -> (
    None
):
    """Two masses that do not feel each other: the model's transfer FRF is 0, the measured one noise
    80 dB down.
    """
    names = ParameterSet((Parameter("k", (), 0.2, 5.0),))
    model = DenseModel.springs(
        1e4 * np.diag([1.0, 3.0]), np.eye(2), 1e4 * np.diag([1.0, 3.0])[None], names
    )
    both = np.array([0, 1])
    term = Frf(np.array([5.0, 12.0]), np.ones((2, 2, 2)), both, both, 0.02)
    now = model.linearise(np.array([0.1]))
    target = Target(
        now.frequencies, now.shapes, np.full(2, 0.002), np.ones(2, dtype=bool)
    )
    true, _ = term.response(point(model, now, target))
    noise = (
        1e-4 * np.array([[0, 1], [1, 0]]) * np.abs(true).max(axis=(1, 2), keepdims=True)
    )
    term = replace(term, measured=true + noise)
    # in standard deviations
    assert np.abs(term(point(model, now, target)).value).max() < 0.1
    check(term, model, target, np.array([0.0]))


def test_anti_resonances_of_a_driving_point_are_the_modes_with_it_held() -> None:
    model = row()
    m = matrices_at(model, X)
    rest = np.delete(np.arange(N), 3)
    held = linalg.eigvalsh(m.stiffness[np.ix_(rest, rest)], m.mass[np.ix_(rest, rest)])
    mu, _ = zeros(model.linearise(X), 3, 3)
    np.testing.assert_allclose(mu, held, rtol=1e-8)


def test_anti_resonance_without_a_partner_costs_the_gate_and_has_no_slope() -> None:
    model = row()
    block = AntiResonances(3, 3, np.array([400.0]), std=0.1, gate=0.3)(
        point(model, model.linearise(X), aim(model))
    )
    assert block.value.tolist() == pytest.approx([3.0])
    assert not block.slope.any()


def test_static_deflections_skip_what_was_not_measured() -> None:
    model = row()
    measured = np.full((N, 1), np.nan)
    measured[[2, 8], 0] = 2e-4, 5e-4
    term = StaticDeflections(np.eye(N)[:, [8]], measured, std=1.0)
    block = term(point(model, model.linearise(X), aim(model)))
    u = linalg.solve(matrices_at(model, X).stiffness, np.eye(N)[:, 8])
    size = np.sqrt((2e-4**2 + 5e-4**2) / 2)
    np.testing.assert_allclose(block.value, (np.array([2e-4, 5e-4]) - u[[2, 8]]) / size)


def test_reduced_model_gives_the_same_matrices_projected() -> None:
    dense = row()
    parts = tuple(
        AffineTerm(power(i), sparse.csr_array(k), sparse.csr_array(m))
        for i, (k, m) in enumerate(zip(dense.d_stiffness, dense.d_mass, strict=True))
    )
    system = AffineSystem(
        sparse.csr_array(dense.stiffness),
        sparse.csr_array(dense.mass),
        dense.parameters,
        parts,
        sparse.eye_array(N).tocsr(),
    )
    reduced = reduced_model(system, 4)
    v, small, whole = (
        reduced.basis.vectors,
        matrices_at(reduced, X),
        matrices_at(dense, X),
    )
    np.testing.assert_allclose(small.stiffness, v.T @ whole.stiffness @ v, atol=1e-8)
    np.testing.assert_allclose(small.d_mass[3], v.T @ whole.d_mass[3] @ v, atol=1e-10)
    part = reduced.with_parameters([3], X)
    np.testing.assert_allclose(
        matrices_at(part, X[3:]).d_mass, small.d_mass[3:], atol=1e-12
    )


def test_motions_without_mass_give_a_whole_basis_its_flexibility_in_silence() -> None:
    """A chain of three springs with one mass at its middle: one mode, and two motions that only
    deform it.
    """
    k = 1e4 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    m, names = np.diag([0.0, 2.0, 0.0]), ParameterSet((Parameter("k", (), 0.2, 5.0),))
    every = (AffineTerm(power(0), sparse.csr_array(k), sparse.csr_array((3, 3))),)
    system = AffineSystem(
        sparse.csr_array(k),
        sparse.csr_array(m),
        names,
        every,
        sparse.eye_array(3).tocsr(),
    )
    whole = reduced_model(system, 1).on(np.eye(3)).whole()
    lam, _ = whole.vectors(np.zeros(1))
    assert lam[0] == pytest.approx(1e4 / 2 / 2)  # two springs in series under 2 kg


def masses() -> tuple[AffineSystem, np.ndarray]:
    """Two bodies of 2 and 3 kg at known places, three translations each; a factor on each."""
    xyz = np.array([[1.0, 2, 3], [-1, 0.5, 2]])
    rigid = np.tile(np.eye(3, 6), (2, 1))
    for i, p in enumerate(xyz):  # u = t + θ × r
        rigid[3 * i : 3 * i + 3, 3:] = np.cross(np.eye(3), p).T
    part = [
        sparse.csr_array(np.diag([2.0] * 3 + [0.0] * 3)),
        sparse.csr_array(np.diag([0.0] * 3 + [3.0] * 3)),
    ]
    names = ParameterSet((Parameter("m1"), Parameter("m2")))
    empty = sparse.csr_array((6, 6))
    terms = tuple(AffineTerm(power(i), empty, m) for i, m in enumerate(part))
    return AffineSystem(
        sparse.eye_array(6).tocsr(),
        part[0] + part[1],
        names,
        terms,
        sparse.eye_array(6).tocsr(),
    ), rigid


def test_mass_properties_are_those_of_two_point_masses_and_their_slopes_are_derivatives() -> (
    None
):
    system, vectors = masses()
    rigid = RigidMass(system, vectors)
    got = mass_properties(rigid.at(np.zeros(2))[0])
    xyz, m = np.array([[1.0, 2, 3], [-1, 0.5, 2]]), np.array([2.0, 3.0])
    cg = m @ xyz / m.sum()
    d = xyz - cg
    tensor = sum(
        mi * (r @ r * np.eye(3) - np.outer(r, r)) for mi, r in zip(m, d, strict=True)
    )
    wanted = [5.0, *cg, *np.diag(tensor), tensor[0, 1], tensor[1, 2], tensor[2, 0]]
    np.testing.assert_allclose(got, wanted, atol=1e-12)

    measured = np.array([5.5, *cg, *[np.nan] * 3, 1.0, 1.0, 1.0])
    term = MassPropertyDeviations(rigid, measured, np.full(10, 0.1))
    model = replace(row().with_parameters([0, 1]))

    def value(x: np.ndarray) -> np.ndarray:
        now = replace(model.linearise(np.zeros(2)), x=x)
        return term(point(model, now, aim(row()))).value

    x = np.array([0.2, -0.1])
    block = term(point(model, replace(model.linearise(np.zeros(2)), x=x), aim(row())))
    assert block.value.size == 7
    slope = np.stack(
        [(value(x - e) - value(x + e)) / 2e-5 for e in 1e-5 * np.eye(2)], axis=1
    )
    np.testing.assert_allclose(block.slope, slope, atol=1e-7 * np.abs(slope).max())


def test_input_is_checked() -> None:
    with pytest.raises(InputError, match="FRFs"):
        Frf(np.ones(3), np.ones((2, 1, 1)), np.array([0]), np.array([0]))
    model = row()
    now = model.linearise(X)
    with pytest.raises(InputError, match="no small matrices"):
        matrices_at(object(), X)
    dead = replace(now, shapes=np.where(np.arange(N)[:, None] == 8, 0.0, now.shapes))
    target = aim(model)
    loud = replace(
        target,
        shapes=np.where(np.arange(N)[:, None] == 8, 9.0, target.shapes),
        rule="cost",
        lost=1e9,
    )
    with pytest.raises(NumericalError, match="zero at channel 9"):
        Shapes(scaling="largest")(point(model, dead, loud))


def test_modes_far_above_do_not_drown_the_zeros() -> None:
    model = row()
    now = model.linearise(X)
    stiff = 1e9  # Hz, as a vector of a basis that is nearly without mass
    far = np.full((N, 1), 1e-4)
    wide = replace(
        now,
        frequencies=np.append(now.frequencies, stiff),
        shapes=np.hstack([now.shapes, far]),
        d_lambda=np.vstack([now.d_lambda, np.zeros(4)]),
        d_shapes=np.concatenate([now.d_shapes, np.zeros((N, 1, 4))], axis=1),
    )
    mu, slope = zeros(now, 3, 3)
    got, d_got = zeros(wide, 3, 3, 30.0)
    np.testing.assert_allclose(got, mu, rtol=1e-9)
    np.testing.assert_allclose(d_got, slope, rtol=1e-6, atol=1e-9 * np.abs(slope).max())
