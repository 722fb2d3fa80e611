"""Errors of modes that strain and move alike: a free row of equal rods, whose energies are known in
closed form.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.updating.uncertainty import (
    effective_freedom,
    energy_shares,
    independent_errors,
    likeness,
)

N, LENGTH = 60, 3.0


@pytest.fixture(scope="module")
def shares(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Of the first three modes of a clamped rod: strain cos², motion sin² of (j − ½)πx/L."""
    cards = [
        f"GRID,{i + 1},,{LENGTH * i / N:.4f},0.0,0.0,,{'123456' if i == 0 else '23456'}"
        for i in range(N + 1)
    ]
    cards += [f"CROD,{i},1,{i},{i + 1}" for i in range(1, N + 1)]
    path = tmp_path_factory.mktemp("rod") / "rod.bdf"
    path.write_text(
        "\n".join(
            [
                "BEGIN BULK",
                *cards,
                "MAT1,1,7.0E10,,0.3,2700.0",
                "PROD,1,1,1.0E-4",
                "ENDDATA",
            ]
        )
    )
    model = read_deck(path)
    with EmbeddedSolver().open(model) as analysis:
        found = analysis.modes(ModesRequest(3))
        vectors = np.asarray(analysis.system.local @ found.modes.shapes)
        return energy_shares(model, analysis.system, vectors)


def test_shares_of_a_clamped_rod_are_those_of_the_closed_form(
    shares: np.ndarray,
) -> None:
    x = (np.arange(N) + 0.5) / N
    wave = (np.arange(3) + 0.5) * np.pi
    strain = np.cos(wave * x[:, None]) ** 2
    assert np.allclose(
        shares[:N], strain / strain.sum(axis=0), atol=1e-4
    )  # lumps along the rod: O(1/n²)
    assert np.allclose(shares.sum(axis=0), 2.0)


def test_likeness_of_a_clamped_rod_is_two_thirds(shares: np.ndarray) -> None:
    """∫cos²(ax)cos²(bx) = 1/4 and ∫cos⁴(ax) = 3/8 over the rod, those of sin² too."""
    expected = np.full((3, 3), 2 / 3) + np.eye(3) / 3
    assert np.allclose(likeness(shares), expected, atol=0.01)  # O(1/n)
    assert effective_freedom(expected) == pytest.approx(9 / (3 + 6 * 4 / 9))


def test_freedom_of_independent_errors_and_of_one_error() -> None:
    assert effective_freedom(np.eye(12)) == pytest.approx(12)
    assert effective_freedom(np.ones((12, 12))) == 1.0


@pytest.mark.parametrize(
    ("of_form", "expected"), [(0.0, 40.0), (1.0, 1.0), (0.5, 1 / (0.5 + 0.5 / 40))]
)
def test_errors_of_a_shape_are_one_where_other_shapes_hold_them_and_many_where_noise_does(
    of_form: float, expected: float
) -> None:
    """Errors of unit size in 20 modes at 40 channels, some of their square in the span of six
    shapes of the model.
    """
    rng, n, k = np.random.default_rng(5), 40, 20
    shapes = np.linalg.qr(rng.standard_normal((n, 6)))[0]
    bent = shapes @ rng.standard_normal((6, k))
    noise = rng.standard_normal((n, k))
    rest = np.sqrt(of_form) * bent / np.linalg.norm(bent, axis=0)
    rest = rest + np.sqrt(1 - of_form) * noise / np.linalg.norm(noise, axis=0)
    found = independent_errors(rest, np.zeros(k, dtype=np.int64), shapes)
    assert 1 / found == pytest.approx(1 / expected, abs=0.05)


def test_intervals_from_errors_that_are_alike_hold_what_they_say() -> None:
    """A value off by the size of the errors, which is estimated from ten of them with a correlation
    of 0.6.
    """
    rng, n = np.random.default_rng(4), 10
    r = np.full((n, n), 0.6) + 0.4 * np.eye(n)
    errors = rng.standard_normal((20_000, n)) @ np.linalg.cholesky(r).T
    size = np.sqrt((errors**2).mean(axis=1))
    off = np.abs(rng.standard_normal(len(size)))
    held = [
        float((off < stdtrit(nu, 0.95) * size).mean())
        for nu in (n, effective_freedom(r))
    ]
    assert held[0] < 0.85 < held[1] < 0.95
