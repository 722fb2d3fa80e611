"""The basis of many parameters: random mixtures of their static sensitivities serve as well as all
of them.

A net of 24 x 24 masses, springs between neighbours and to the ground, in 64 fields with a stiffness
factor each.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, sparse

from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.reduction import basis, parametric
from ringtrue.reduction.basis import AffineSystem

SIDE, FIELDS, COUNT = 24, 8, 40


def net() -> AffineSystem:
    at = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    pairs = np.concatenate(
        [
            np.stack([at[:-1].ravel(), at[1:].ravel()]),
            np.stack([at[:, :-1].ravel(), at[:, 1:].ravel()]),
        ],
        1,
    )
    x, y = np.divmod(pairs[0], SIDE)
    field = x * FIELDS // SIDE * FIELDS + y * FIELDS // SIDE
    n, parts = at.size, []
    for f in range(FIELDS**2):
        i, j = pairs[:, field == f]
        ones = np.ones(i.size)
        spring = sparse.coo_array(
            (np.r_[ones, ones, -ones, -ones], (np.r_[i, j, i, j], np.r_[i, j, j, i])),
            shape=(n, n),
        )
        parts.append(sparse.csr_array(1e4 * spring))
    ground = sparse.csr_array(1e2 * sparse.eye_array(n))
    names = ParameterSet(
        tuple(Parameter(f"field {f}", (), 0.2, 5.0) for f in range(FIELDS**2))
    )
    none = sparse.csr_array((n, n))
    terms = tuple(AffineTerm(power(i), k, none) for i, k in enumerate(parts))
    mass = sparse.csr_array(sparse.diags_array(1 + 0.1 * np.cos(np.arange(n))))
    return AffineSystem(
        sparse.csr_array(sum(parts[1:], parts[0]) + ground),
        mass,
        names,
        terms,
        none[:3],
    )


def test_mixtures_of_sensitivities_span_what_all_of_them_span(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    system, solved = net(), []
    plain = basis._responses

    def counted(pencil, modes, load, progress):  # type: ignore[no-untyped-def]
        solved.append(load.shape[1])
        return plain(pencil, modes, load, progress)

    monkeypatch.setattr(basis, "_responses", counted)
    few = parametric.reduced_model(system, COUNT)
    columns = sum(solved)
    monkeypatch.setattr(parametric, "MANY", 10**9)
    every = parametric.reduced_model(system, COUNT)
    assert columns < 0.25 * (sum(solved) - columns) == 0.25 * COUNT * FIELDS**2
    x = np.random.default_rng(2).uniform(-0.5, 0.5, FIELDS**2)
    k, m = system.at(np.exp(x))
    true = np.sqrt(
        linalg.eigvalsh(k.toarray(), m.toarray(), subset_by_index=(0, COUNT - 1))
    ) / (2 * np.pi)
    wrong = [np.abs(r.modes(x).frequencies / true - 1).max() for r in (few, every)]
    start = np.abs(few.modes(0 * x).frequencies / true - 1).max()
    assert wrong[0] < max(2 * wrong[1], 1e-6)
    assert wrong[0] < 0.05 * start
