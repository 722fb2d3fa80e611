"""Eigenvector derivatives to many parameters at once, on a free shell with lumped mass: the
equation, column by column.

Rotations have no mass, six modes are rigid motions, and E and thickness of four regions are the
parameters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from eigen_shell import shell
from scipy import sparse

from ringtrue.core.parameters import CardField, Parameter
from ringtrue.eigen import derivatives
from ringtrue.eigen.derivatives import MatrixDerivatives, eigenvector_derivatives
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import NotConverged
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.derivatives import system_derivatives

M, RIGID, REGIONS = 16, 6, 4
TOLERANCE = 1e-6
SOLVED = 1e-7  # what a solve leaves of the load, beside the tolerance


@pytest.fixture(scope="module")
def case() -> tuple[Pencil, EigenModes, list[MatrixDerivatives]]:
    model = shell(16, 12, regions=REGIONS)
    fields = [
        (card, r, f)
        for r in range(1, REGIONS + 1)
        for card, f in (("MAT1", "E"), ("PSHELL", "T"))
    ]
    system = assemble(model)
    slopes = system_derivatives(
        model, [Parameter(f"{t}", (CardField(*t),)) for t in fields], system
    )
    pencil = Pencil(system.stiffness, system.mass)
    return pencil, solve_modes(pencil, M + 4), slopes


def _worst(
    pencil: Pencil, modes: EigenModes, slope: MatrixDerivatives, d: np.ndarray
) -> float:
    """Largest relative residual of the elastic modes' equations, 2-norm."""
    phi, lam = modes.vectors[:, RIGID:M], modes.values[RIGID:M]
    load = slope.stiffness @ phi - (slope.mass @ phi) * lam
    rest = pencil.stiffness @ d - (pencil.mass @ d) * lam + load
    rest -= (pencil.mass @ phi) * np.einsum("fm,fm->m", phi, load)
    return float((np.linalg.norm(rest, axis=0) / np.linalg.norm(load, axis=0)).max())


@pytest.mark.parametrize(("many", "columns"), [(10**6, 190), (0, 190), (0, 13)])
def test_every_column_meets_the_tolerance(case, monkeypatch, many, columns) -> None:
    """With the factor of the modes and with one amid them, in one batch and in batches that cut
    parameters.
    """
    pencil, modes, slopes = case
    pencil.at(modes.shift)
    monkeypatch.setattr(
        derivatives, "SETTINGS", derivatives.ComplementSettings(many=many)
    )
    monkeypatch.setattr(derivatives, "COLUMNS", columns)
    d = eigenvector_derivatives(pencil, modes, slopes, count=M, tolerance=TOLERANCE)
    assert (pencil.shift == modes.shift) == (many > 0)
    for i, s in enumerate(slopes):
        assert _worst(pencil, modes, s, d[:, RIGID:, i]) < TOLERANCE + SOLVED
        phi = modes.vectors[:, :M]
        norm = 2 * np.einsum("fm,fm->m", phi, pencil.mass @ d[:, :, i]) + np.einsum(
            "fm,fm->m", phi, s.mass @ phi
        )
        assert np.abs(norm).max() < 1e-9


@pytest.mark.parametrize("coupled", [False, True])
def test_fields_of_any_mass(coupled) -> None:
    """Products and forces of motions where every third row has no mass, the mass diagonal or
    not.
    """
    rng = np.random.default_rng(7)
    n, massive = 3000, np.arange(3000) % 3 > 0
    mass = sparse.diags_array(massive * rng.uniform(1.0, 2.0, n)).tolil()
    if coupled:
        mass[1, 2] = mass[2, 1] = 0.3
    mass = sparse.csr_array(mass)
    x, y, c = (
        rng.standard_normal((4, n)),
        rng.standard_normal((5, n)),
        rng.standard_normal((4, 5)),
    )
    inertia = derivatives.Inertia(mass)
    a, b = inertia.fields(x), inertia.fields(y)
    np.testing.assert_allclose(a.dot(b), x @ (mass @ y.T), atol=1e-10)
    b.add(c, a)
    np.testing.assert_allclose(
        inertia.forces(b), (mass @ (y + c.T @ x).T).T, atol=1e-12
    )
    a.times(c, b)
    np.testing.assert_allclose(inertia.forces(b), (mass @ (c.T @ x).T).T, atol=1e-12)


def test_rows_move_to_their_places() -> None:
    rows, place = (
        np.outer(np.arange(12.0), np.ones(3)),
        np.array([1, 2, 3, 6, 7, 8, 10]),
    )
    derivatives._spread(rows, place)
    assert rows[place, 0].tolist() == [1, 2, 3, 4, 5, 6, 7]


def test_sketches_keep_norms(case) -> None:
    """Within a few √(2/TILE) = 0.04; exactly where there are fewer rows with mass than buckets."""
    pencil, modes, _ = case
    inertia = derivatives.Inertia(pencil.mass)
    exact = np.linalg.norm(pencil.mass @ modes.vectors, axis=0)
    np.testing.assert_allclose(
        np.linalg.norm(inertia.sketch(inertia.fields(modes.vectors.T)), axis=1), exact
    )
    rng = np.random.default_rng(5)
    wide = derivatives.Inertia(
        sparse.diags_array(rng.uniform(1.0, 2.0, 20_000)).tocsr()
    )
    x = wide.fields(rng.standard_normal((30, 20_000)))
    norms = np.linalg.norm(wide.forces(x), axis=1)
    assert 1e-4 < np.abs(np.linalg.norm(wide.sketch(x), axis=1) / norms - 1).max() < 0.1


@pytest.mark.parametrize("buckets", [40, 200])
def test_rough_sketches_cost_no_accuracy(case, monkeypatch, buckets) -> None:
    pencil, modes, slopes = case
    pencil.at(modes.shift)
    monkeypatch.setattr(derivatives, "TILE", buckets)
    d = eigenvector_derivatives(pencil, modes, slopes, count=M, tolerance=TOLERANCE)
    assert (
        max(_worst(pencil, modes, s, d[:, RIGID:, i]) for i, s in enumerate(slopes))
        < TOLERANCE + SOLVED
    )


def test_rigid_motions_stay_rigid(case) -> None:
    pencil, modes, slopes = case
    d = eigenvector_derivatives(pencil, modes, slopes, count=M)
    for i in range(len(slopes)):
        strained = np.linalg.norm(pencil.stiffness @ d[:, :, i], axis=0)
        assert strained[:RIGID].max() < 1e-6 * strained[RIGID:].min()


def test_a_space_that_is_full_starts_anew(case, monkeypatch) -> None:
    """Room for fewer directions than the columns need: what is left over is solved for again."""
    pencil, modes, slopes = case
    pencil.at(modes.shift)
    small = derivatives.ComplementSettings(each=1, spare=0)
    monkeypatch.setattr(derivatives, "SETTINGS", small)
    d = eigenvector_derivatives(
        pencil, modes, slopes[1:2], count=M, tolerance=TOLERANCE
    )
    assert _worst(pencil, modes, slopes[1], d[:, RIGID:, 0]) < TOLERANCE + SOLVED
    monkeypatch.setattr(derivatives, "SETTINGS", replace(small, runs=1))
    with pytest.raises(NotConverged, match="did not converge"):
        eigenvector_derivatives(
            pencil, modes, slopes[1:2], count=M, tolerance=TOLERANCE
        )


def test_one_parameter_or_all(case) -> None:
    pencil, modes, slopes = case
    every = eigenvector_derivatives(pencil, modes, slopes, count=M, tolerance=1e-9)
    alone = eigenvector_derivatives(pencil, modes, slopes[3:4], count=M, tolerance=1e-9)
    assert np.abs(every[:, :, 3] - alone[:, :, 0]).max() < 1e-7 * np.abs(alone).max()
