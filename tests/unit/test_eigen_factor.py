"""The factorisation port: solves and inertia against closed forms."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from scipy import sparse

from ringtrue.eigen import engines, memory
from ringtrue.eigen.engines import installed
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil, factorise
from ringtrue.errors import InputError, NumericalError, OutOfMemory, SingularModel

ENGINES = installed()
COUNTING = ENGINES


def chain(n: int) -> sparse.csr_array:
    """Fixed chain of springs: eigenvalues 2 − 2 cos(kπ/(n + 1))."""
    side = -np.ones(n - 1)
    return sparse.csr_array(
        sparse.diags_array([2 * np.ones(n), side, side], offsets=[0, 1, -1])
    )


@pytest.mark.parametrize("method", ENGINES)
def test_solve_many_right_hand_sides(method):
    k = chain(200)
    x = np.random.default_rng(1).standard_normal((200, 5))
    assert np.allclose(factorise(k, method=method).solve(k @ x), x, atol=1e-9)
    assert np.allclose(
        factorise(k, method=method).solve(k @ x[:, 0]), x[:, 0], atol=1e-9
    )


@pytest.mark.parametrize("method", COUNTING)
def test_inertia_counts_eigenvalues_below_the_shift(method):
    n = 120
    pencil = Pencil(chain(n), sparse.csr_array(sparse.eye_array(n)), method=method)
    exact = 2 - 2 * np.cos(np.pi * np.arange(1, n + 1) / (n + 1))
    for below in (0, 1, 17, 119, 120):  # refactorises on the same pattern
        shift = exact[below - 1] + 1e-6 if below else -0.1
        assert pencil.at(float(shift)).negatives == below
    pencil.close()


@pytest.mark.skipif("pardiso" not in ENGINES, reason="pymklpardiso is not installed")
@pytest.mark.parametrize("entries", [0, 10**9])
def test_patterns_by_blocks(monkeypatch, entries):
    """A grid of 20 x 15 nodes with three directions each: eigenvalues (a_i + a_j) b_k; by blocks
    and by entries.
    """
    monkeypatch.setattr(engines, "BLOCKS", engines.PardisoBlocks(entries=entries))
    b = np.array([[2.0, 0.5, 0.3], [0.5, 3.0, 0.2], [0.3, 0.2, 5.0]])
    grid = sparse.kron(chain(20), sparse.eye_array(15)) + sparse.kron(
        sparse.eye_array(20), chain(15)
    )
    k = sparse.csr_array(sparse.kron(grid, b))
    a, c = (2 - 2 * np.cos(np.pi * np.arange(1, n + 1) / (n + 1)) for n in (20, 15))
    exact = np.sort(
        np.multiply.outer(np.add.outer(a, c).ravel(), np.linalg.eigvalsh(b)).ravel()
    )
    pencil = Pencil(k, sparse.csr_array(sparse.eye_array(900)), method="pardiso")
    x = np.random.default_rng(2).standard_normal((900, 11))
    for below in (0, 5, 300, 899):
        shift = (exact[below - 1] + exact[below]) / 2 if below else -1.0
        assert pencil.at(float(shift)).negatives == below
        assert np.allclose(
            pencil.at(float(shift)).solve(k @ x - shift * x), x, atol=1e-8
        )
    assert np.allclose(solve_modes(pencil, 12).values, exact[:12], rtol=1e-9)
    hole = sparse.csr_array(sparse.block_diag([k, np.zeros((1, 1))]))
    with pytest.raises(SingularModel, match="row 900"):
        factorise(hole, method="pardiso")


def test_superlu_has_no_inertia_where_it_exchanges_rows():
    swap = sparse.csr_array(
        sparse.kron(sparse.eye_array(5), np.array([[0.0, 1.0], [1.0, 0.0]]))
    )
    assert factorise(swap, method="superlu").negatives == -1


@pytest.mark.parametrize("method", ENGINES)
def test_singular_matrix_is_named(method):
    k = chain(400).tolil()
    k[7, :] = 0
    k[:, 7] = 0
    with pytest.raises(SingularModel, match="row 7"):
        factorise(sparse.csr_array(k), method=method)


def test_bad_input():
    with pytest.raises(InputError, match="allowed are auto"):
        factorise(chain(3), method="qr")
    with pytest.raises(InputError, match="not finite"):
        factorise(chain(3) * np.nan)
    with pytest.raises(InputError, match="square"):
        factorise(sparse.csr_array(np.ones((2, 3))))


@pytest.mark.parametrize("method", ENGINES)
def test_modes_are_those_of_any_engine(method):
    """Chain with every second mass missing."""
    n = 500
    k = chain(n)
    m = sparse.csr_array(
        sparse.diags_array(np.where(np.arange(n) % 2, 0.0, 1.0), format="csr")
    )
    got = solve_modes(Pencil(k, m, method=method), 8)
    heavy = np.arange(0, n, 2)
    light = np.arange(1, n, 2)
    d = k.toarray()
    small = d[np.ix_(heavy, heavy)] - d[np.ix_(heavy, light)] @ (
        d[np.ix_(light, heavy)] / 2
    )
    assert np.allclose(got.values, np.linalg.eigvalsh(small)[:8], rtol=1e-8)
    assert got.residuals.max() < 1e-8
    assert got.complete


def test_lack_of_memory_is_foreseen(monkeypatch: pytest.MonkeyPatch):
    pencil = Pencil(
        chain(1000), sparse.csr_array(sparse.eye_array(1000)), method=COUNTING[0]
    )
    monkeypatch.setattr(memory, "available", lambda: 20_000)
    with pytest.raises(
        OutOfMemory,
        match=r"factorisation of 1000 DOFs needs .* MB of memory; 0\.0 MB are free",
    ) as e:
        pencil.at(-1.0)
    assert e.value.needed > e.value.available == 20_000
    monkeypatch.setattr(memory, "available", lambda: 1_000_000)
    pencil = Pencil(chain(1000), sparse.csr_array(sparse.eye_array(1000)))
    pencil.at(-1.0)
    with pytest.raises(OutOfMemory, match="basis of 306 vectors of 1000 DOFs"):
        solve_modes(pencil, 50)


def test_memory_of_this_machine():
    assert 1e7 < memory.available() < 1e15
    memory.require(1, "nothing")


@pytest.mark.parametrize(
    ("missing", "then"),
    [
        ((), "pardiso"),
        (("pymklpardiso",), "rslab"),
        (("pymklpardiso", "rslab"), "superlu"),
    ],
)
def test_auto_takes_the_first_that_is_installed(monkeypatch, missing, then):
    monkeypatch.setattr(
        engines, "find_spec", lambda name: None if name in missing else object()
    )
    assert engines.choose("auto", 1000) == then
    assert engines.choose("auto", 10) == "dense"
    if missing:
        with pytest.raises(InputError, match="needs the package pymklpardiso"):
            engines.choose("pardiso", 1000)


@pytest.mark.parametrize("n", [60, 500])
def test_masses_that_are_all_negative_are_named(n):
    """PARAM,WTMASS,-1."""
    with pytest.raises(
        NumericalError, match="negative in some direction at row 0 row 1 "
    ):
        solve_modes(Pencil(chain(n), sparse.csr_array(-sparse.eye_array(n))), 4)


@pytest.mark.parametrize(("n", "size"), [(60, 1e9), (500, 3.0)])
@pytest.mark.parametrize("rows", [(7,), (7, 9), (7, 8, 9)])
def test_negative_mass_is_named(n, size, rows):
    """One negative mass, two rows of a negative minor, or three whose minors of two are positive:
    Lanczos would go on for ever.
    """
    m = sparse.eye_array(n, format="lil")
    for i, j in permutations(rows, 2):
        m[i, j] = {2: size, 3: -0.9}[len(rows)]
    if len(rows) == 1:
        m[7, 7] = -size
    with pytest.raises(
        NumericalError,
        match=f"negative in some direction at {' '.join(f'row {i}' for i in rows)}: ",
    ):
        solve_modes(Pencil(chain(n), sparse.csr_array(m)), 4)


@pytest.mark.parametrize("n", [60, 500])
def test_a_mass_that_is_negative_by_rounding_is_none(n):
    m = sparse.eye_array(n, format="lil")
    for i, j in permutations((7, 9), 2):
        m[i, j] = 1 + 1e-10
    m[20, 20] = -1e-10
    assert solve_modes(Pencil(chain(n), sparse.csr_array(m)), 4).complete


def test_a_singular_mass_of_full_blocks_is_not_called_negative():
    """A point mass on arms: all minors of two rows are zero but for rounding, with entries of many
    decades.
    """
    arm = np.array([1.0, 1e3, 1e-4, 0.3, 1e-7])
    m = sparse.csr_array(
        sparse.block_diag([sparse.coo_array(0.7 * np.outer(arm, arm))] * 100)
    )
    assert solve_modes(Pencil(chain(500), m), 3).residuals.max() < 1e-6
