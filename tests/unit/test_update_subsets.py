"""What the choice among many candidates rests on: conflicts, screening, a condensed model, an empty
pool.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
import localise_twin as twin

from ringtrue.core.parameters import CardField, Parameter, ParameterSet, Substructure
from ringtrue.errors import ConfigError
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.dense_models import DenseModel, condensed
from ringtrue.reduction.expansion import ShapeReadings, expand_hybrid, expand_reduced
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.updating.identifiability import identifiability
from ringtrue.updating.problem import Residual, residual_at, single
from ringtrue.updating.selection.candidates import CandidateSettings
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.proposal import propose, stated_errors
from ringtrue.updating.selection.screening import (
    SHARP,
    SeenModes,
    conflicts,
    effects,
    explaining,
    misfits,
    of_parameter,
)
from ringtrue.updating.selection.selection_rules import FittedSet
from ringtrue.updating.selection.subset_search import Search, SearchSettings
from ringtrue.updating.target import Target, Weights
from ringtrue.updating.uncertainty import errors_of_shapes


def test_factors_on_one_field_stay_apart_a_product_does_not() -> None:
    model = twin.read(twin.deck())
    found = {c.name: c for c in generate(model, CandidateSettings())}
    names = [
        "MAT1 30 E",
        "MAT1 30 RHO",
        "PSHELL 30 T",
        "PSHELL 30 piece 1 E",
        "MAT1 20 E",
    ]
    names += [
        "PBUSH 900 K",
        "PBUSH 900 K1",
        "PBUSH 900 K2",
        "PBEAM 11 A",
        "PBEAM 11 I1",
        "MAT1 11 E",
    ]
    block = of_parameter(
        model,
        Parameter("block", substructures=(Substructure("stiffness", (310, 312)),)),
    )
    apart = conflicts(model, [*(found[n] for n in names), block])
    names.append("block")
    pairs = {(names[i], names[j]) for i, j in np.argwhere(np.triu(apart)).tolist()}
    assert pairs == {
        ("MAT1 30 E", "PSHELL 30 piece 1 E"),  # the same field of the same elements
        ("PBUSH 900 K", "PBUSH 900 K1"),
        ("PBUSH 900 K", "PBUSH 900 K2"),  # and not K1 with K2: they add up
        ("MAT1 30 E", "block"),  # all stiffness of the same elements
        ("PSHELL 30 T", "block"),
        ("PSHELL 30 piece 1 E", "block"),
    }
    assert (apart == apart.T).all()


def test_a_given_parameter_knows_its_elements() -> None:
    model = twin.read(twin.deck())
    both = of_parameter(
        model,
        Parameter("two", (CardField("MAT1", 11, "E"), CardField("MAT1", 12, "E"))),
    )
    assert both.elements == (100, 101, 102, 103)
    assert both.what == "MAT1 11 E, MAT1 12 E of 4 CBEAM"
    assert both.kind == "material"
    part = of_parameter(
        model, Parameter("part", (CardField("MAT1", 30, "E", (310, 311)),))
    )
    assert part.elements == (310, 311)
    block = of_parameter(
        model,
        Parameter("block", substructures=(Substructure("stiffness", (310, 312)),)),
    )
    assert block.elements == (310, 312)
    springs = of_parameter(
        model,
        Parameter(
            "feet", (CardField("PBUSH", 900, "K1"), CardField("PBUSH", 900, "K2"))
        ),
    )
    assert (springs.what, springs.kind) == ("PBUSH 900 K1,K2 of 4 CBUSH", "spring")


def test_what_explains_the_misfit_comes_first_then_what_tells_most() -> None:
    """A small cause, and what does in its place, before a large column that explains nothing; zeros
    never come.
    """
    g = np.array(
        [
            [10.0, 9.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 2.0, 0.0, 1.9],
            [0.0, 1.0, 0.0, 0.0, 0.2],
        ]
    )
    misfit = np.array([0.0, 3.0, 0.0])
    assert explaining(misfit, g, 1).tolist() == [2]
    assert explaining(misfit, g, 9).tolist() == [2, 4, 0, 1]
    assert explaining(misfit, g[:, [0, 2, 3]], 9).tolist() == [1, 0]
    assert explaining(0 * misfit, g, 2).tolist() == [0, 2]
    assert explaining(0 * misfit, 0 * g, 3).size == 0


def test_the_force_residual_of_exact_shapes_is_what_is_wrong() -> None:
    """Seen at every degree of freedom: two large changes come out of it, linear as it is, too small
    by what the 2 % of the shapes hold that the expansion may leave to the model.
    """
    start = twin.start()
    wrong, names = {11: 1.5, 30: 0.7}, [c.name for c in start.candidates]
    every = EmbeddedSolver().open(start.model).eigen(ModesRequest(90))
    with EmbeddedSolver().open(twin.read(twin.deck(wrong))) as analysis:
        true = analysis.eigen(ModesRequest(12))
    aim = Target(
        true.frequencies[:12],
        true.vectors[:, :12],
        np.zeros(12),
        np.ones(12, dtype=bool),
    )
    at = (
        start.model,
        start.analysis.system,
        start.candidates,
        SeenModes(every.values, every.vectors, every.vectors),
    )
    misfit, slopes = misfits(*at, aim)[1]
    some = [names.index(f"MAT1 {r} E") for r in wrong]
    x = np.linalg.lstsq(slopes[:, some], misfit)[0]
    np.testing.assert_allclose(
        1 + x * start.reduced.parameters.std()[some], list(wrong.values()), atol=0.15
    )


def test_the_paired_residual_is_that_of_the_model_itself() -> None:
    """Sums over all 90 modes of the deck against the derivatives of its reduced model."""
    start = twin.start()
    every = EmbeddedSolver().open(start.model).eigen(ModesRequest(90))
    there = start.observation.matrix @ (start.analysis.system.transform @ every.vectors)
    aim = twin.measured({30: 1.1}, np.random.default_rng(0))
    given = (
        start.model,
        start.analysis.system,
        start.candidates,
        SeenModes(every.values, every.vectors, there),
    )
    misfit, slopes = misfits(*given, aim)[0]
    now = start.reduced.linearise(np.zeros(len(start.candidates)))
    w = Weights(SHARP * 0.01, SHARP**2 * 0.05, independent=errors_of_shapes(aim, now))
    same = residual_at(single(start.reduced, replace(aim, weights=w)), now.x)
    np.testing.assert_allclose(misfit, same.value, atol=1e-3 * np.abs(same.value).max())
    error = np.linalg.norm(
        slopes - same.slope * start.reduced.parameters.std()
    ) / np.linalg.norm(slopes)
    assert error < 0.05  # sixteen modes of ninety


def test_no_candidate_leaves_a_misfit_and_no_slope() -> None:
    start = twin.start()
    lam, phi = start.reduced.vectors(np.zeros(len(start.candidates)))
    there = start.observation.matrix @ (start.analysis.system.transform @ phi)
    aim = twin.measured({}, np.random.default_rng(0))
    modes = SeenModes(lam, phi, there)
    misfit, slopes = misfits(start.model, start.analysis.system, (), modes, aim)[1]
    assert slopes.shape == (misfit.size, 0)
    assert explaining(misfit, slopes, 3).size == 0


def test_what_is_wrong_is_among_the_first_that_explain() -> None:
    """Of 94 candidates over 16 regions two dozen, of six frames with three regions off by half or
    more.
    """
    start, held = twin.start(), list[bool]()
    lam, phi = replace(start.reduced, count=28).vectors(np.zeros(len(start.candidates)))
    there = start.observation.matrix @ (start.analysis.system.transform @ phi)
    for seed in range(200, 206):
        rng = np.random.default_rng(seed)
        aim = twin.measured(wrong := twin.truth(rng, 3), rng)
        left = misfits(
            start.model,
            start.analysis.system,
            start.candidates,
            SeenModes(lam, phi, there),
            aim,
        )[1]
        found = [
            set(start.candidates[i].elements) for i in explaining(*left, 24).tolist()
        ]
        held += [twin.region_elements(region) in found for region in wrong]
    assert np.mean(held) > 0.75


def test_effects_are_the_slopes_of_the_eigenvalues() -> None:
    start = twin.start()
    modes = start.reduced.linearise(np.zeros(len(start.candidates)))
    lam, phi = start.reduced.vectors(np.zeros(len(start.candidates)))
    strain, kinetic = effects(
        start.model, start.analysis.system, start.candidates, lam, phi
    )
    np.testing.assert_allclose(
        (strain - kinetic) * lam[:, None],
        modes.d_lambda,
        rtol=1e-6,
        atol=1e-9 * lam.max(),
    )


def test_a_condensed_model_is_exact_where_it_was_made_and_close_between() -> None:
    model = twin.start().reduced
    p = len(model.parameters)
    at = [model.parameters.names.index(n) for n in ("MAT1 30 E", "MAT1 21 E")]
    few = model.with_parameters(at, np.zeros(p))
    points = [
        np.zeros(2),
        np.array([0.4, 0.0]),
        np.array([0.0, -0.4]),
        np.array([0.4, -0.4]),
    ]
    small = condensed(few, points, 60)
    assert small.basis.size == 60
    for (
        x
        # four times twenty modes in sixty vectors: what is left out carries least energy
    ) in points:
        np.testing.assert_allclose(
            small.modes(x).frequencies[:12], few.modes(x).frequencies[:12], rtol=1e-4
        )
    middle = np.array([0.2, -0.2])
    np.testing.assert_allclose(
        small.modes(middle).frequencies[:12],
        few.modes(middle).frequencies[:12],
        rtol=1e-4,
    )
    here, there = small.linearise(middle), few.linearise(middle)
    np.testing.assert_allclose(
        here.d_lambda[:12],
        there.d_lambda[:12],
        rtol=2e-2,
        atol=1e-3 * there.d_lambda[:12].max(),
    )
    assert (
        small.modes(middle).frequencies >= few.modes(middle).frequencies * (1 - 1e-12)
    ).all()  # Rayleigh and Ritz
    assert condensed(few, points, 10_000) is few


def test_expansion_in_a_basis_is_that_of_the_whole_model_where_it_spans_it() -> None:
    """A chain of ten masses, its basis all ten modes in another frame."""
    n = 10
    k = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    m = np.diag(np.linspace(1.0, 2.0, n))
    lam, phi = np.linalg.eigh(
        np.diag(np.diag(m) ** -0.5) @ k @ np.diag(np.diag(m) ** -0.5)
    )
    phi = np.diag(np.diag(m) ** -0.5) @ phi
    rng = np.random.default_rng(0)
    c = np.eye(n)[[1, 4, 8]]
    y = c @ phi[:, :2] * (1 + 0.02 * rng.standard_normal((3, 2)))
    f = np.sqrt(lam[:2]) / (2 * np.pi) * 1.03
    v = phi @ np.linalg.qr(rng.standard_normal((n, n)))[0]
    q = expand_reduced(
        v.T @ k @ v, v.T @ m @ v, v.T @ k @ v, ShapeReadings(c @ v, y, f, 0.02)
    )
    readings = ShapeReadings(sparse.csr_array(c), y, f, 0.02)
    full = expand_hybrid(sparse.csr_array(k), sparse.csr_array(m), readings, phi)
    # both leave the misfit that was asked for; the norms of the residual differ by what holds the
    # sensors
    np.testing.assert_allclose(q.misfit, 0.02, rtol=1e-2)
    np.testing.assert_allclose(full.misfit, 0.02, rtol=1e-2)
    cosine = np.abs(np.einsum("nm,nm->m", v @ q.shapes, full.shapes))
    cosine /= np.linalg.norm(v @ q.shapes, axis=0) * np.linalg.norm(full.shapes, axis=0)
    assert (cosine > 0.999).all()
    with pytest.raises(ConfigError, match="above 0"):
        ShapeReadings(c, y, f, noise=0.0)


def test_candidates_without_effect_propose_nothing() -> None:
    n = 6
    k = 2e4 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    names = ParameterSet((Parameter("nothing", std=0.5), Parameter("neither", std=0.5)))
    model = DenseModel.springs(k, np.eye(n), np.zeros((2, n, n)), names)
    modes = model.modes(np.zeros(2))
    aim = Target(
        1.01 * modes.frequencies[:4],
        modes.shapes[:, :4],
        np.zeros(4),
        np.ones(4, dtype=bool),
    )
    far = propose(single(model, replace(aim, frequencies=1.1 * modes.frequencies[:4])))
    assert (
        "no change of a candidate explains what is left (mean |Δf| 9.09 %" in far.text()
    )
    found = propose(single(model, aim))
    assert found.members == ()
    np.testing.assert_array_equal(found.paired, 4)
    assert found.insensitive == ("nothing", "neither")
    assert found.before == pytest.approx(0.01, rel=0.02)
    assert "explains the test as well as any change" in found.text()


@pytest.mark.parametrize("groups", [[0, 1, 2], [0, 0, 1]])
def test_the_error_of_a_member_covers_what_the_others_may_be_off_by(
    groups: list[int],
) -> None:
    """Of three candidates only the first is proposed; the truth of all is drawn from the prior,
    unit noise.

    What is of the cluster of a member may be off as well.
    """
    rng, count = np.random.default_rng(0), 500
    g = (
        6
        * np.linalg.qr(rng.standard_normal((12, 3)))[0]
        @ np.array([[1.0, 0.7, 0.5], [0.0, 0.7, 0.5], [0.0, 0.0, 0.7]])
    )
    none, every = np.zeros(0), np.arange(3)
    names = ParameterSet(
        tuple(Parameter(f"p{i}", (), 1e-4, 1e4, "log", 1.0) for i in every)
    )
    model = DenseModel.springs(np.eye(3), np.eye(3), np.zeros((3, 3, 3)), names)
    aim = Target(np.ones(3), np.eye(3), np.zeros(3), np.ones(3, dtype=bool))
    search = Search(
        problem=single(model, aim),
        settings=SearchSettings(),
        assumed=Weights(),
        conflicts=np.zeros((3, 3), dtype=bool),
        pool=every,
        groups=np.array(groups),
        size=np.linalg.norm(g, axis=0),
    )
    held = 0
    for truth in rng.standard_normal((count, 3)):
        z = g @ truth + rng.standard_normal(12)
        x = np.array([g[:, 0] @ z / (g[:, 0] @ g[:, 0] + 1), 0.0, 0.0])
        end = Residual(
            z - g @ x,
            g,
            np.zeros((0, 2), dtype=np.int64),
            none,
            none,
            none.astype(bool),
            every[:0],
        )
        std = stated_errors(search, FittedSet(np.array([0]), x, 0.0), end)[0]
        held += abs(x[0] - truth[0]) < 1.645 * std
    assert 0.88 <= held / count <= 0.98  # by the spread of the member alone 26 %


def test_bounds_of_a_large_survey_need_no_square_of_its_readings() -> None:
    """200 modes at 600 channels are 120 000 residuals: the same as of their triangular factor."""
    g = (
        np.random.default_rng(8).standard_normal((120_000, 3))
        @ np.array([[1.0, 0.4, 0], [0, 1, 0], [0, 0, 1e-3]])
        * 1e-3
    )
    r = np.linalg.qr(g, mode="r")
    np.testing.assert_allclose(
        identifiability(g).together, identifiability(r).together, rtol=1e-6, atol=1e-9
    )
