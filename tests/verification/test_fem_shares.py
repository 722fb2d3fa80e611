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

from ringtrue.fem.assembly import Share, assemble
from ringtrue.fem.massless_rotations import without_massless_rotations
from ringtrue.fem.parametrisation.element_derivatives import element_derivatives

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
def test_the_sum_of_shares_is_the_whole(tmp_path: Path, size: int, autospc: str) -> None:
    model = constrained_plate.deck(tmp_path)
    model = replace(model, params={**model.params, "AUTOSPC": autospc})
    whole, spins = without_massless_rotations(model, assemble(model))
    assert autospc == "NO" or spins.labels() == ("904+RZ",)
    parts = together(
        size, lambda share: without_massless_rotations(model, assemble(model, share), share)
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
