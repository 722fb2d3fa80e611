"""Test-analysis models, orthogonality and expansion on a clamped beam of springs and masses with
known modes.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, sparse

from ringtrue.correlation.orthogonality import Gate, judge, verdict_json
from ringtrue.errors import ConfigError, InputError
from ringtrue.reduction.expansion import ShapeReadings, expand_hybrid, expand_serep
from ringtrue.reduction.static import (
    craig_bampton,
    craig_bampton_coordinates,
    craig_bampton_of,
    readings_kept,
    select,
    tam,
)
from ringtrue.shapes import (
    cross_orthogonality,
    mac,
    paired_mac,
    pseudo_inverse,
    self_orthogonality,
    unit,
)

N = 30


def chain(free: bool = False) -> tuple[sparse.csr_array, sparse.csr_array]:
    """N masses in a row, springs between them (and to the ground at both ends), uneven."""
    k = 1e4 * (1 + 0.3 * np.sin(np.arange(N + 1)))
    if free:
        k[[0, N]] = 0.0
    K = sparse.diags_array(
        [-k[1:N], k[:N] + k[1:], -k[1:N]], offsets=[-1, 0, 1]
    ).tocsr()
    return sparse.csr_array(K), sparse.csr_array(
        sparse.diags_array(1 + 0.5 * np.cos(np.arange(N))).tocsr()
    )


def solved(K: sparse.csr_array, M: sparse.csr_array) -> tuple[np.ndarray, np.ndarray]:
    lam, phi = linalg.eigh(K.toarray(), M.toarray())
    return np.sqrt(lam.clip(0)) / (2 * np.pi), phi


SENSORS = np.array([1, 5, 9, 14, 17, 21, 25, 28])


def test_guyan_of_the_observation_is_the_guyan_of_static() -> None:
    K, M = chain()
    one, two = tam(K, M, select(SENSORS, N)), craig_bampton(K, M, SENSORS, 0)
    np.testing.assert_allclose(one.transform, two.transform, atol=1e-9)
    np.testing.assert_allclose(one.mass, two.mass, atol=1e-9)


def test_methods_in_order_of_accuracy_and_serep_exact() -> None:
    K, M = chain()
    f, phi = solved(K, M)
    C = select(SENSORS, N)
    error = {}
    for method in ("guyan", "irs", "serep", "hybrid"):
        t = tam(K, M, C, method, modes=phi[:, :5])
        error[method] = float(np.abs(t.frequencies[:5] / f[:5] - 1).max())
        off = self_orthogonality(phi[SENSORS, :5], t.mass) - np.eye(5)
        if method in ("serep", "hybrid"):
            assert np.abs(off).max() < 1e-9
    assert error["serep"] < 1e-9
    assert error["hybrid"] < 1e-9
    assert error["irs"] < 0.1 * error["guyan"]
    assert 1e-3 < error["guyan"] < 0.2


def test_sensors_off_the_nodes_and_without_supports() -> None:
    """A free chain, sensors half-way between masses and one skewed by a factor: rigid motion is
    kept exactly.
    """
    K, M = chain(free=True)
    C = sparse.csr_array(0.5 * (select(SENSORS, N) + select(SENSORS + 1, N)))
    t = tam(K, M, C, "irs")
    np.testing.assert_allclose(C @ t.transform, np.eye(8), atol=1e-9)
    np.testing.assert_allclose(t.transform @ np.ones(8), 1, atol=1e-8)
    assert np.ones(8) @ t.mass @ np.ones(8) == pytest.approx(M.sum())
    f, _ = solved(K, M)
    np.testing.assert_allclose(t.frequencies[1:4], f[1:4], rtol=5e-3)


def test_craig_bampton_coordinates_make_orthogonality_exact() -> None:
    K, M = chain()
    f, phi = solved(K, M)
    cb = craig_bampton(K, M, SENSORS, N - SENSORS.size)
    q = craig_bampton_coordinates(cb, phi[SENSORS, :9], f[:9])
    np.testing.assert_allclose(cross_orthogonality(q, q, cb.mass), np.eye(9), atol=1e-6)
    assert (
        np.abs(
            self_orthogonality(phi[SENSORS, :8], craig_bampton(K, M, SENSORS, 0).mass)
            - np.eye(8)
        ).max()
        > 0.05
    )
    with pytest.raises(InputError, match="kept DOFs"):
        craig_bampton_coordinates(cb, phi[:3, :2], f[:2])


def test_cross_orthogonality_is_blind_to_scale_and_phase() -> None:
    rng = np.random.default_rng(0)
    M = np.diag(rng.uniform(1, 3, 6))
    a, b = (
        rng.standard_normal((6, 3)),
        rng.standard_normal((6, 2)) + 1j * rng.standard_normal((6, 2)),
    )
    got = cross_orthogonality(a, b * (2 - 3j), M)
    np.testing.assert_allclose(got, cross_orthogonality(a, b, M), rtol=1e-12)
    np.testing.assert_allclose(
        cross_orthogonality(a, b, np.eye(6)) ** 2, mac(a, b), rtol=1e-12
    )


def serep_mass(shapes: np.ndarray) -> np.ndarray:
    """Φ⁺ᵀΦ⁺ of mass-normalised shapes."""
    back = pseudo_inverse(shapes)
    return back.T @ back


def test_poc_is_the_cross_orthogonality_over_the_serep_mass() -> None:
    K, M = chain()
    _, phi = solved(K, M)
    fe = phi[SENSORS, :6]
    rng = np.random.default_rng(1)
    test = fe[:, :4] @ (
        np.eye(4) + 0.1 * rng.standard_normal((4, 4))
    ) + 0.01 * rng.standard_normal((8, 4))
    np.testing.assert_allclose(
        np.abs(unit(pseudo_inverse(fe) @ test)).T,
        cross_orthogonality(test, fe, serep_mass(fe)),
        atol=1e-10,
    )
    np.testing.assert_allclose(pseudo_inverse(fe) @ fe, np.eye(6), atol=1e-9)
    with pytest.raises(InputError, match="8 channels distinguish 8 of 9 shapes"):
        pseudo_inverse(phi[SENSORS, :9])


def test_gate_names_the_entries_beyond_it() -> None:
    x = np.array([[0.95, 0.05, 0.3], [0.02, 0.8, 0.04]])
    pair = np.array([0, 1])
    v = judge(x, Gate(), pair, pair)
    assert not v.passed
    assert [(f.a, f.b, f.diagonal) for f in v.failures] == [(1, 1, True)]
    assert judge(x, Gate(0.75, 0.06, "mine"), pair, pair).passed
    assert not judge(x, Gate(), pair, np.array([2, 1])).passed
    assert verdict_json(v)["failures"][0]["a"] == 2
    assert "failed 90 % / 10 %" in str(v)
    with pytest.raises(ConfigError, match="0 to 1"):
        Gate(90, 10)
    assert not judge(np.zeros((0, 0)), Gate(), pair[:0], pair[:0]).passed


def test_expansions_recover_exact_shapes() -> None:
    K, M = chain()
    f, phi = solved(K, M)
    C = select(SENSORS, N)
    y, true = phi[SENSORS, :4] * np.array([1, -2, 1j, 3]), phi[:, :4]
    assert paired_mac(expand_serep(phi[:, :6], C, y).shapes, true).min() > 1 - 1e-12
    hybrid = expand_hybrid(K, M, ShapeReadings(C, y, f[:4], 1e-9), phi[:, :6])
    assert paired_mac(hybrid.shapes, true).min() > 1 - 1e-9


def test_hybrid_expansion_beats_serep_on_a_wrong_model_with_noise() -> None:
    """Truth: a chain whose springs differ from the model's; the readings carry 5 % noise."""
    K, M = chain()
    wrong = sparse.csr_array(
        K + sparse.diags_array(np.where(np.arange(N) > 20, 8e2, 0.0))
    )
    f, true = solved(wrong, M)
    _, phi = solved(K, M)
    C = select(SENSORS, N)
    rng = np.random.default_rng(2)
    got = np.zeros((2, 20))
    for i in range(20):  # over noise
        y = true[SENSORS, :4].copy()
        e = rng.standard_normal(y.shape)
        y += 0.05 * e * np.linalg.norm(y, axis=0) / np.linalg.norm(e, axis=0)
        shapes = (
            expand_hybrid(K, M, ShapeReadings(C, y, f[:4], 0.05), phi[:, :14]).shapes,
            expand_serep(phi[:, :8], C, y).shapes,
        )
        got[:, i] = [1 - paired_mac(u, true[:, :4]).mean() for u in shapes]
    hybrid, serep = got.mean(axis=1)
    assert hybrid < 0.9 * serep


def test_what_cannot_be_reduced_or_expanded() -> None:
    K, M = chain()
    C = select(SENSORS, N)
    twice = sparse.csr_array(sparse.vstack([C, C[[0]]]))
    with pytest.raises(InputError, match="reads what others read"):
        tam(K, M, twice)
    with pytest.raises(ConfigError, match="needs the modes"):
        tam(K, M, C, "serep")
    with pytest.raises(ConfigError, match="must be above 0"):
        ShapeReadings(C, np.ones((8, 1)), np.ones(1), noise=0.0)
    with pytest.raises(InputError, match="8 channels"):
        ShapeReadings(C, np.ones((7, 1)), np.ones(1), noise=0.1)


@pytest.mark.parametrize("kind", ["dofs", "skewed"])
def test_craig_bampton_of_sensors_anywhere_is_exact(kind: str) -> None:
    K, M = chain(free=True)
    f, phi = solved(K, M)
    observe = select(SENSORS, N)
    if kind == "skewed":  # each reads its node and the next, and a node is read twice
        observe = sparse.csr_array(0.8 * observe - 0.6 * select(SENSORS + 1, N))
        observe = sparse.csr_array(sparse.vstack([observe, select(SENSORS[:1], N)]))
    seen = observe @ phi
    u = readings_kept(observe)
    np.testing.assert_allclose(
        (observe @ u)[:, -len(seen) :].toarray(), np.eye(len(seen)), atol=1e-12
    )
    assert abs(observe @ u)[:, : N - len(seen)].max() < 1e-12
    cb = craig_bampton_of(K, M, observe, N - len(seen))
    q = craig_bampton_coordinates(cb, seen[:, :9], f[:9])
    np.testing.assert_allclose(cross_orthogonality(q, q, cb.mass), np.eye(9), atol=1e-6)
    with pytest.raises(InputError, match="reads what others read"):
        readings_kept(sparse.csr_array(sparse.vstack([observe, observe[:1]])))


@pytest.mark.parametrize("rounding", [1e-15, -1e-15])
def test_rounding_does_not_order_entries_that_are_the_same(rounding: float) -> None:
    """The two halves of a symmetric matrix differ in their last digits, by the processor."""
    matrix = np.eye(3)
    matrix[0, 2] = 0.3 + rounding
    matrix[2, 0] = 0.3
    told = [
        (f.a, f.b) for f in judge(matrix, Gate(), np.arange(3), np.arange(3)).failures
    ]
    assert told == [(0, 2), (2, 0)]
