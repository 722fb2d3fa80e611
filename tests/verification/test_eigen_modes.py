"""Modes against closed forms and dense solutions: multiplicities, rigid bodies, singular masses,
bands, counts.
"""

from __future__ import annotations

import numpy as np
import pytest
import solid_meshes
from eigen_plate import held, line, plate
from fem_cases import grid, model, steel
from scipy import linalg, sparse

from ringtrue.eigen import lanczos, modes
from ringtrue.eigen.eigenpairs import rounding
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError, SingularModel
from ringtrue.fem.assembly import assemble

RESIDUAL = 1e-8


def test_free_beam_closed_form():
    """Free-free beam EI = 2, m = 3, L = 1.5: λ_k = EI/m (β_k/L)⁴ with β = 0, 0, 4.730041, 7.853205,
    10.995608.
    """
    k2, _, k0 = line(300, 1.5)
    got = solve_modes(Pencil(sparse.csr_array(2 * k2), sparse.csr_array(3 * k0)), 5)
    beta = np.array([4.730040744862704, 7.853204624095838, 10.995607838001671])
    assert np.allclose(got.values[2:], 2 / 3 * (beta / 1.5) ** 4, rtol=1e-7)
    assert np.abs(got.values[:2]).max() < 1e-5 * got.values[2]
    assert got.complete


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e9])
@pytest.mark.parametrize("mesh", [5, 14])
def test_square_free_plate(mesh, scale):
    """Three rigid modes, double elastic ones, whatever the units; dense for the small mesh."""
    k, m = plate(mesh, mesh)
    got = solve_modes(Pencil(k * scale, m), 20)
    want = linalg.eigh(k.toarray() * scale, m.toarray(), eigvals_only=True)[:20]
    assert np.allclose(got.values[3:], want[3:], rtol=1e-6)
    assert np.abs(got.values[:3]).max() < 1e-6 * want[3]
    assert np.isclose(got.values[4], got.values[5], rtol=1e-8)
    assert got.residuals.max() < RESIDUAL
    assert got.orthogonality < 1e-9
    assert got.complete
    top = np.take_along_axis(
        got.vectors, np.abs(got.vectors).argmax(axis=0)[None], axis=0
    )
    assert (top > 0).all()


@pytest.mark.parametrize("copies", [3, 6])
def test_equal_structures_side_by_side(copies):
    """Multiplicity 3 is below the block size, 6 above: the count finds what a block misses."""
    k, m = plate(6, 6)
    free = held(k, 6, 6)
    k, m = k[free][:, free], m[free][:, free]
    many = [sparse.csr_array(sparse.block_diag([a] * copies)) for a in (k, m)]
    got = solve_modes(Pencil(*many), 4 * copies)
    one = linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)[:4]
    assert np.allclose(got.values, np.repeat(one, copies), rtol=1e-8)
    assert got.complete


@pytest.mark.parametrize("apart", [0.0, 1e-7])
@pytest.mark.parametrize("count", [7, 60, 70])
def test_a_root_repeated_more_often_than_a_block_is_wide(count, apart):
    """60 equal oscillators of two modes, or nearly equal ones: what a count misses is sought in the
    lowest gap only.
    """
    copies = 60
    k, m = plate(4, 4)
    free = held(k, 4, 4)
    k, m = k[free][:, free], m[free][:, free]
    stiffer = 1 + apart * np.linspace(0, 1, copies)
    many = [
        sparse.csr_array(sparse.block_diag(a))
        for a in ([c * k for c in stiffer], [m] * copies)
    ]
    got = solve_modes(Pencil(*many), count)
    one = linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)
    assert np.allclose(
        got.values, np.sort(np.outer(stiffer, one).ravel())[:count], rtol=1e-8
    )
    assert got.complete
    assert got.orthogonality < 1e-9


@pytest.fixture(scope="module")
def block() -> tuple[sparse.csr_array, sparse.csr_array, np.ndarray]:
    """K, M and the 20 lowest eigenvalues of a free block of solids, 630 DOFs."""
    xyz, nodes = solid_meshes.box(6, 5, 4, (1.0, 0.7, 0.4))
    s = assemble(
        model(
            grid(xyz),
            solid_meshes.elements("CHEXA", nodes),
            solid_meshes.psolid(),
            steel(),
        )
    )
    k, m = s.stiffness, s.mass
    return (
        k,
        m,
        linalg.eigh(
            k.toarray(), m.toarray(), eigvals_only=True, subset_by_index=(0, 19)
        ),
    )


@pytest.mark.parametrize("count", [2, 6, 8, 20])
@pytest.mark.parametrize("bodies", [1, 2, 3, 9])
def test_free_bodies(block, bodies, count):
    """As many or fewer modes than there are rigid ones, and more; the bodies differ in stiffness by
    3 %.
    """
    k, m, one = block
    stiffer = 1 + 0.03 * np.arange(bodies)
    many = [
        sparse.csr_array(sparse.block_diag(a))
        for a in ([c * k for c in stiffer], [m] * bodies)
    ]
    got = solve_modes(Pencil(*many), count)
    want = np.sort(np.outer(stiffer, one).ravel())[:count]
    assert got.complete
    assert got.values.size == count
    assert np.allclose(got.values, want, rtol=1e-8, atol=1e-9 * one[6])


def test_missing_mode_is_found_by_the_count(monkeypatch):
    """A start that is blind to one of two uncoupled structures: only the inertia count can tell."""
    k, m = plate(7, 7)
    free = held(k, 7, 7)
    k, m = k[free][:, free], m[free][:, free]
    n = k.shape[0]
    both = [sparse.csr_array(sparse.block_diag(a)) for a in ((k, 1.21 * k), (m, m))]
    start, calls = lanczos.Krylov.start, []

    def blind(self, locked, theta):
        start(self, locked, theta)
        calls.append(theta.size)
        if not theta.size:
            self.basis[n:] = 0
            q, self.loaded, _ = self._orthonormal(
                self.basis[:, : self.ahead].copy(), 0.0
            )
            self._put(q, 0)

    monkeypatch.setattr(lanczos.Krylov, "start", blind)
    got = solve_modes(Pencil(*both), 8, shift=-100.0)
    one = linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)[:8]
    assert np.allclose(
        got.values, np.sort(np.concatenate([one, 1.21 * one]))[:8], rtol=1e-8
    )
    assert got.complete
    assert max(calls) > 0


@pytest.mark.parametrize("mesh", [4, 12])
def test_massless_dofs(mesh):
    """Lumped mass without rotations: as the statically condensed model."""
    k, m = plate(mesh, mesh)
    heavy = np.arange(k.shape[0]) % 4 == 0
    lumped = np.where(heavy, m.diagonal(), 0.0)
    got = solve_modes(Pencil(k, sparse.csr_array(sparse.diags_array(lumped))), 10)
    d = k.toarray()
    light = ~heavy
    small = d[np.ix_(heavy, heavy)] - d[np.ix_(heavy, light)] @ np.linalg.solve(
        d[np.ix_(light, light)], d[np.ix_(light, heavy)]
    )
    want = linalg.eigh(small, np.diag(lumped[heavy]), eigvals_only=True)[:10]
    assert np.allclose(got.values[3:], want[3:], rtol=1e-7)
    assert got.residuals.max() < RESIDUAL
    assert got.complete


@pytest.mark.parametrize("count", [1, 40, 320])
def test_a_mechanism_of_many_motions(count):
    """300 masses in a plane, joined along their line only: λ = 4 sin²(jπ/600), and 300 motions
    across it.
    """
    along = sparse.diags_array(
        [-np.ones(299), np.r_[1.0, np.full(298, 2.0), 1.0], -np.ones(299)],
        offsets=(-1, 0, 1),
    )
    k = sparse.csr_array(sparse.block_diag([along, sparse.csr_array((300, 300))]))
    got = solve_modes(Pencil(k, sparse.csr_array(sparse.eye_array(600))), count)
    want = np.r_[np.zeros(300), 4 * np.sin(np.arange(300) * np.pi / 600) ** 2][:count]
    assert got.complete
    assert np.allclose(got.values, want, rtol=1e-8, atol=1e-12)


def test_a_band_with_more_equal_bodies_than_rounding_brings():
    """60 free plates: 180 modes at zero and 60 at the first elastic root."""
    k, m = plate(3, 3)
    many = [sparse.csr_array(sparse.block_diag([a] * 60)) for a in (k, m)]
    one = linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)[:5]
    got = solve_modes(
        Pencil(*many), band=(0.0, np.sqrt((one[3] + one[4]) / 2) / (2 * np.pi))
    )
    assert got.complete
    assert got.values.size == 240
    assert np.allclose(
        got.values, np.repeat(one[:4], 60), rtol=1e-7, atol=1e-7 * one[3]
    )


@pytest.mark.parametrize(("spread", "proved"), [(0.0, True), (2e-2, False)])
def test_a_root_without_end(spread, proved):
    """600 oscillators: what stands below one root is counted, below a crowd without gaps nothing is
    claimed.
    """
    k = sparse.csr_array(sparse.diags_array(1e4 * np.linspace(1.0, 1.0 + spread, 600)))
    got = solve_modes(Pencil(k, sparse.csr_array(sparse.eye_array(600))), 20)
    assert got.complete is proved
    assert np.allclose(got.values, 1e4, rtol=2 * spread + 1e-9)
    assert ("one root" if proved else "not counted") in got.proof


@pytest.mark.parametrize("sharp", [True, False])
def test_a_band_of_many_modes_over_a_singular_mass(monkeypatch, sharp):
    """What the mass does not see grows from step to step; shapes that are left so are not
    proved.
    """
    k, m = plate(14, 14)
    heavy = np.arange(k.shape[0]) % 4 == 0
    lumped = sparse.csr_array(sparse.diags_array(np.where(heavy, m.diagonal(), 0.0)))
    d = k.toarray()
    a, b, c = (
        d[np.ix_(heavy, heavy)],
        d[np.ix_(heavy, ~heavy)],
        d[np.ix_(~heavy, ~heavy)],
    )
    want = linalg.eigh(
        a - b @ np.linalg.solve(c, b.T),
        lumped.toarray()[np.ix_(heavy, heavy)],
        eigvals_only=True,
    )
    f = np.sqrt(np.maximum(want, 0)) / (2 * np.pi)
    if not sharp:
        monkeypatch.setattr(modes, "_sharp", lambda _pencil, pairs, _shift: pairs)
    got = solve_modes(Pencil(k, lumped), band=((f[40] + f[41]) / 2, 1.1 * f[-1]))
    assert got.complete == sharp
    assert np.allclose(got.frequencies, f[41:], rtol=1e-7) == sharp
    assert (got.residuals.max() < 1e-6) == sharp


def test_mass_of_low_rank():
    """Three masses on a large massless plate: three modes exist, more are asked for."""
    k, _ = plate(12, 12)
    free = held(k, 12, 12)
    k = k[free][:, free]
    mass = np.zeros(k.shape[0])
    mass[[100, 200, 300]] = 5.0, 7.0, 9.0
    got = solve_modes(Pencil(k, sparse.csr_array(sparse.diags_array(mass))), 10)
    flexibility = np.linalg.inv(k.toarray())[np.ix_([100, 200, 300], [100, 200, 300])]
    want = np.sort(1 / linalg.eigvals(flexibility * [5.0, 7.0, 9.0]).real)
    assert np.allclose(got.values, want, rtol=1e-7)
    assert got.complete
    assert "rank" in got.proof


@pytest.mark.parametrize(
    "ends", [(-1.0, 200.0), (60.0, 420.0), (300.0, 420.0), (41.0, 55.0)]
)
def test_band(ends):
    k, m = plate(12, 12)
    want = linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)
    f = np.sqrt(np.maximum(want, 0)) / (2 * np.pi)
    inside = want[(f >= ends[0]) & (f <= ends[1])]
    got = solve_modes(Pencil(k, m), band=ends)
    assert got.values.size == inside.size
    assert np.allclose(got.values, inside, rtol=1e-6, atol=1e-3)
    assert got.complete
    assert "Sturm" in got.proof


@pytest.mark.parametrize("mesh", [5, 14])
def test_a_band_from_zero_has_the_rigid_modes(mesh):
    """They stand a little below zero by rounding, here on purpose; dense for the small mesh."""
    k, m = plate(mesh, mesh)
    elastic = linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)[3]
    got = solve_modes(
        Pencil(sparse.csr_array(k - 1e-7 * elastic * m), m),
        band=(0.0, 1.1 * np.sqrt(elastic) / 2 / np.pi),
    )
    assert np.allclose(got.values[:3] / elastic, -1e-7, atol=2e-8)
    assert got.values[3] == pytest.approx(elastic, rel=1e-6)
    assert got.complete


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-9])
def test_copies_with_few_masses(apart):
    """Blocks that run out of directions: 84 copies of six rows of which two have a mass,
    shuffled.
    """
    rng = np.random.default_rng(2)
    k = 1e3 * np.diag([2.0, 3, 3, 2, 4, 2])
    k -= 1e3 * (np.eye(6, k=1) + np.eye(6, k=-1))
    m = np.diag([0, 0.3, 0, 0, 2.0, 0])
    order = rng.permutation(6 * 84)
    stiffer = 1 + apart * rng.uniform(-1, 1, 84)
    K, M = (
        sparse.csr_array(sparse.block_diag(a, format="csr")[order][:, order])
        for a in ([c * k for c in stiffer], [m] * 84)
    )
    held = np.setdiff1d(np.arange(6), [1, 4])
    inner = k[np.ix_([1, 4], [1, 4])] - k[np.ix_([1, 4], held)] @ np.linalg.solve(
        k[np.ix_(held, held)], k[np.ix_(held, [1, 4])]
    )
    one = linalg.eigh(inner, np.diag([0.3, 2.0]), eigvals_only=True)
    for count in (30, 120):
        got = solve_modes(Pencil(K, M), count)
        assert np.allclose(got.values, np.sort(np.repeat(one, 84))[:count], rtol=1e-8)
        assert got.complete


@pytest.mark.parametrize("ends", [(0, 30), (30, 59), (30, 99)])
def test_ends_of_a_band_that_are_modes(ends):
    """Of roots that are there 20 times; a mode at an end is in the band."""
    k, m = plate(4, 4)
    free = held(k, 4, 4)
    k, m = k[free][:, free], m[free][:, free]
    many = [sparse.csr_array(sparse.block_diag([a] * 20)) for a in (k, m)]
    one = np.repeat(linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True), 20)
    band = tuple(np.sqrt(one[list(ends)]) / (2 * np.pi))
    got = solve_modes(Pencil(*many), band=band)
    want = one[(one > 0.999 * one[ends[0]]) & (one < 1.001 * one[ends[1]])]
    assert got.complete
    assert np.allclose(got.values, want, rtol=1e-8)


def test_nearly_all_modes_of_equal_structures():
    """The dense solution finds them at once: roots that are there six times, from zero on to the
    last but two.
    """
    k, m = plate(4, 5)
    many = [sparse.csr_array(sparse.block_diag([a] * 6)) for a in (k, m)]
    one = linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)
    top = np.sqrt((one[-3] + one[-2]) / 2) / (2 * np.pi)
    for got in (
        solve_modes(Pencil(*many), 6 * (one.size - 2)),
        solve_modes(Pencil(*many), band=(0.0, top)),
    ):
        assert got.complete
        assert "were computed" in got.proof
        assert np.allclose(
            got.values, np.repeat(one[:-2], 6), rtol=1e-8, atol=1e-9 * one[-1]
        )


def test_bodies_without_any_motion_but_rigid_ones():
    """500 free pairs of rows, one with a mass: nothing but modes at zero."""
    K = sparse.csr_array(
        sparse.block_diag([1e3 * np.array([[1.0, -1], [-1, 1]])] * 500)
    )
    M = sparse.csr_array(sparse.diags_array(np.tile([2.0, 0.0], 500)))
    got = solve_modes(Pencil(K, M), 10)
    assert got.values.size == 10
    assert np.abs(got.values).max() < 1e-6


@pytest.mark.parametrize("held_at", [0.0, 1.0])
@pytest.mark.parametrize("digits", [11, 12, 14, 15])
def test_a_stiffness_that_leaves_no_digits_is_told(digits, held_at):
    """Two of three masses on a spring 10^digits times as stiff as the others, against a rigid
    link.
    """
    big, soft = 0.7 * 10.0**digits, 1 / 3
    k = np.array(
        [[big + soft, -big, 0], [-big, big + soft + 1, -1], [0, -1, 1 + held_at]]
    )
    got = solve_modes(
        Pencil(sparse.csr_array(k), sparse.csr_array(np.diag([1.0, 2.0, 1.0]))), 2
    )
    one = linalg.eigh(
        [[1 + 2 * soft, -1], [-1, 1 + held_at]], np.diag([3.0, 1.0]), eigvals_only=True
    )
    off = np.abs(got.values / one - 1).max()
    share, _, row = rounding(sparse.csr_array(k), got)
    assert off < 2 * share
    assert row < 2
    assert (share > 1e-3) == (digits > 12)


def test_repeatable():
    k, m = plate(12, 12)
    a, b = (solve_modes(Pencil(k, m), 12) for _ in range(2))
    assert np.array_equal(a.values, b.values)
    assert np.array_equal(a.vectors, b.vectors)


def test_bad_requests():
    k, m = plate(2, 2)
    with pytest.raises(InputError, match="at least 1"):
        solve_modes(Pencil(k, m), 0)
    with pytest.raises(InputError, match="empty"):
        solve_modes(Pencil(k, m), band=(3.0, 2.0))
    with pytest.raises(InputError, match="mass matrix is zero"):
        solve_modes(Pencil(k, 0 * m), 2)


@pytest.mark.parametrize("mesh", [3, 12])
def test_mechanism_without_mass(mesh):
    k, m = plate(mesh, mesh)
    k, m = (sparse.csr_array(sparse.block_diag([a, np.zeros((1, 1))])) for a in (k, m))
    last = k.shape[0] - 1
    with pytest.raises(SingularModel, match=rf"at DOF {last}\b.*mechanism"):
        solve_modes(
            Pencil(k, m, labels=lambda rows: [f"DOF {i}" for i in rows.tolist()]), 5
        )
