"""Assembly by shares of the elements: the sum of all is the whole, to rounding."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import constrained_plate
import numpy as np
import pytest

from ringtrue.core.arrays import Int
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.fem.assembly import Share, assemble, moving, without_massless_rotations
from ringtrue.fem.parametrisation.derivatives import affine_terms, share_terms
from ringtrue.fem.parametrisation.element_derivatives import element_derivatives
from ringtrue.fem.parametrisation.polynomials import AffineTerm

Result = TypeVar("Result")
EPS = np.finfo(float).eps


def together(size: int, work: Callable[[Share], Result]) -> list[Result]:
    """What all shares make, each in a thread."""
    meeting = threading.Barrier(size, timeout=60)
    there: list[Any] = [None] * size

    def exchanged(number: int, a: Any, join: Callable[[list[Any]], Any]) -> Any:
        there[number] = a
        meeting.wait()
        joined = join(list(there))
        meeting.wait()
        return joined

    def of(number: int) -> Result:
        return work(
            Share(
                number,
                size,
                lambda a: exchanged(number, a, lambda parts: np.sum(parts, axis=0)),
                lambda a: exchanged(number, a, np.concatenate),
            )
        )

    with ThreadPoolExecutor(size) as pool:
        return list(pool.map(of, range(size)))


@pytest.mark.parametrize("size", [2, 5])
@pytest.mark.parametrize("autospc", ["YES", "NO"])
def test_the_sum_of_shares_is_the_whole(
    tmp_path: Path, size: int, autospc: str
) -> None:
    model = constrained_plate.deck(tmp_path)
    model = replace(model, params={**model.params, "AUTOSPC": autospc})
    whole, spins = without_massless_rotations(model, assemble(model))
    assert autospc == "NO" or spins.labels() == ("904+RZ",)
    rows = np.diff(assemble(model).transform.indptr)
    np.testing.assert_array_equal(moving(model, whole.autospc), rows > 0)
    parts = together(
        size,
        lambda share: without_massless_rotations(model, assemble(model, share), share),
    )
    for system, held in parts:
        assert system.free.labels() == whole.free.labels()
        assert system.autospc.labels() == whole.autospc.labels()
        assert held.labels() == spins.labels()
        assert abs(system.transform - whole.transform).nnz == 0
    for name in ("stiffness", "mass"):
        want = getattr(whole, name)
        got = sum(getattr(system, name) for system, _ in parts)
        assert abs(got - want).max() <= 8 * EPS * abs(want).max()
        assert all(getattr(system, name).nnz < want.nnz for system, _ in parts)


def test_derivatives_of_shares(tmp_path: Path) -> None:
    model = constrained_plate.deck(tmp_path)
    parameters = constrained_plate.parameters().parameters

    def sums(share: Share) -> Any:
        total = np.zeros((len(parameters), 2))
        for piece in element_derivatives(model, parameters, share):
            for k, a in enumerate((piece.stiffness, piece.mass)):
                size = (a.reshape(len(a), -1) ** 2).sum(axis=1)
                np.add.at(total[:, k], piece.owner, size)
        return total

    whole = sums(Share())
    parts = together(3, sums)
    assert (whole.max(axis=1) > 0).all()
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-12)


def test_terms_of_shares(tmp_path: Path) -> None:
    """Over the DOFs of each share, in one order; Poisson's ratio is interpolated."""
    model = constrained_plate.deck(tmp_path)
    ratio = Parameter("nu", (CardField("MAT1", 1, "NU"),), lower=0.8, upper=1.2)
    given = ParameterSet((*constrained_plate.parameters().parameters[1:5], ratio))
    system = assemble(model)

    def made(share: Share) -> tuple[Int, tuple[AffineTerm, ...]]:
        own = assemble(model, share)
        cols = np.unique(np.concatenate([own.stiffness.indices, own.mass.indices]))
        return cols, share_terms(model, given, system.transform[:, cols], share=share)

    parts = together(2, made)
    whole = affine_terms(model, given, system)
    a = np.linspace(0.85, 1.15, len(given))
    for k, want in enumerate(whole):
        (which,) = {terms[k].function.which for _, terms in parts}
        assert which == want.function.which
        for name in ("stiffness", "mass"):
            total = np.zeros(system.stiffness.shape)
            for cols, terms in parts:
                assert terms[k].function.value(a) == pytest.approx(
                    want.function.value(a), rel=1e-9
                )
                total[np.ix_(cols, cols)] += getattr(terms[k], name).toarray()
            there = getattr(want, name).toarray()
            np.testing.assert_allclose(total, there, atol=1e-12 * np.abs(there).max())
