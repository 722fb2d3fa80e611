"""Straight chains of bars turn about themselves with neither stiffness nor mass: their modes are
found all the same.

Free beam of length L: f = β²/2π sqrt(EI/mL⁴), β = 4.730041, 7.853205 (Blevins 1979, table 8-1); its
lumped mass is of fourth order inside and of second at its ends.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged, spc, steel

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.errors import SingularModel
from ringtrue.fem.assembly import assemble, massless_rotations
from ringtrue.model.model import Model, Table
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

L, BETA = 2.0, np.array([4.730041, 7.853205])
I1, I2 = 2e-5, 1e-5


def chain(
    n: int, along: Float, first: int = 1, origin: Float | None = None
) -> tuple[Float, Table]:
    """Nodes and n CBARs on a line."""
    axis = np.asarray(along, dtype=float) / np.linalg.norm(along)
    xyz = np.linspace(0, L, n + 1)[:, None] * axis + (
        0 if origin is None else np.asarray(origin)
    )
    i = np.arange(first, first + n)
    return xyz, cards("CBAR", EID=i, PID=1, GA=i, GB=i + 1, X1=0.3, X2=0.5, X3=1.0)


SECTION = cards("PBAR", PID=[1], MID=1, A=1e-2, I1=I1, I2=I2, J=1e-5)


def free(n: int, along: Float, *more: Table, **params: object) -> Model:
    xyz, bars = chain(n, along)
    return model(grid(xyz), bars, SECTION, steel(), *more, **params)


@pytest.mark.parametrize("along", [(1, 0, 0), (1, 2, 3)])
@pytest.mark.parametrize("n", [4, 30, 100])
@pytest.mark.parametrize("coupled", [-1, 1])
def test_free_beam(along: Float, n: int, coupled: int) -> None:
    with EmbeddedSolver().open(free(n, along, COUPMASS=coupled)) as analysis:
        found = analysis.modes(ModesRequest(9))
    f = found.modes.frequencies
    want = (
        np.sort(np.outer(BETA**2, np.sqrt([I1, I2])).ravel())
        / 2
        / np.pi
        / L**2
        * np.sqrt(2e11 / (8000 * 1e-2))
    )
    assert np.abs(f[:5]).max() < 1e-3 * want[0]
    assert found.complete
    if n > 4:
        np.testing.assert_allclose(f[5:], want, rtol=6 / n**2 + 1e-5)


def test_two_beams_on_springs_spin_alone() -> None:
    """Joined by springs along and across, which turn nothing."""
    (a, one), (b, two) = chain(6, (1, 0, 0)), chain(6, (1, 0, 0), 8, (0, 0.5, 0))
    bars = cards(
        "CBAR",
        **{k: np.concatenate([one[k], two[k]]) for k in ("EID", "GA", "GB")},
        PID=1,
        X3=1.0,
    )
    k = np.arange(12)
    springs = cards(
        "CELAS2",
        EID=100 + k,
        K=1e4,
        G1=1 + 6 * (k % 2),
        C1=1 + k // 4,
        G2=8 + 6 * (k % 2),
        C2=1 + k // 4,
    )
    both = model(grid(np.vstack([a, b])), bars, SECTION, steel(), springs)
    system = assemble(both)
    assert [system.free.labels()[i][-2:] for i in massless_rotations(both, system)] == [
        "RX",
        "RX",
    ]
    with EmbeddedSolver().open(both) as analysis:
        assert analysis.modes(ModesRequest(12)).complete


@pytest.mark.parametrize("apart", [0.0, 0.7])
def test_point_masses_on_a_bush(apart: float) -> None:
    """Masses 1 and 3 in a free pair: f = sqrt(K (1/1 + 1/3))/2π along the line, and across where
    the ends coincide.
    """
    masses = cards("CONM2", EID=[2, 3], G=[1, 2], M=[1.0, 3.0])
    bush = cards("CBUSH", EID=[1], PID=1, GA=1, GB=2, X3=1.0)
    stiff = cards(
        "PBUSH", PID=[1], K1=300.0, K2=600.0, K3=900.0, K4=5.0, K5=5.0, K6=5.0
    )
    pair = model(grid(np.array([[0, 0, 0], [apart, 0, 0]])), masses, bush, stiff)
    system = assemble(pair)
    assert massless_rotations(pair, system).size == (1 if apart else 3)
    with EmbeddedSolver().open(pair) as analysis:
        f = analysis.modes(ModesRequest(6)).modes.frequencies
    want = np.sqrt(np.array([300.0, 600.0, 900.0]) * 4 / 3) / 2 / np.pi
    assert np.abs(f - want[0]).min() < 1e-9 * want[0]
    if not apart:
        np.testing.assert_allclose(f[3:], want, rtol=1e-9)


def test_what_is_held_or_heavy_is_left_alone() -> None:
    held = free(5, (1, 2, 3), spc([1], "123456"))
    assert not massless_rotations(
        held, assemble(Model(held.tables, held.params, held.case.__class__(spc=1)))
    ).size
    tip = cards("CONM2", EID=[50], G=6, M=1.0, I11=0.1, I22=0.1, I33=0.1)
    heavy = free(5, (1, 2, 3), tip)
    assert not massless_rotations(heavy, assemble(heavy)).size
    bent = model(
        grid(np.array([[0, 0, 0], [1, 0, 0], [1, 1e-3, 0.0]])),
        chain(2, (1, 0, 0))[1],
        SECTION,
        steel(),
    )
    assert not massless_rotations(bent, assemble(bent)).size
    strict = free(5, (1, 0, 0), AUTOSPC="NO")
    with EmbeddedSolver().open(strict) as analysis:
        assert not analysis.spins


@pytest.mark.parametrize("offset", [(0.2, 0.1, 0.0), (0.2, 0.0, 0.1), (0.2, 0.1, 0.1)])
def test_an_offset_mass_joins_the_turns(offset: Float) -> None:
    """A clamped beam has no spin, whatever its tip mass couples; the mass on a stiff bar in place
    of an offset.
    """
    xyz, bars = chain(8, (1, 0, 0))
    out = dict(zip(("X1", "X2", "X3"), offset, strict=True))
    mass = cards("CONM2", EID=[50], G=9, M=10.0, **out)
    root = spc([1], "123456")
    arm = grid(np.vstack([xyz, xyz[-1] + np.array(offset)]))
    link = cards("RBE2", EID=[60], GN=9, CM="123456", GM=ragged([10]))
    on_arm = cards("CONM2", EID=[50], G=10, M=10.0)
    own = model(grid(xyz), bars, SECTION, steel(), mass, root, spc=1)
    both = [own, model(arm, bars, SECTION, steel(), link, on_arm, root, spc=1)]
    assert not any(massless_rotations(m, assemble(m)).size for m in both)
    found = []
    for m in both:
        with EmbeddedSolver().open(m) as analysis:
            found.append(analysis.modes(ModesRequest(4)).modes.frequencies)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


@pytest.mark.parametrize(
    ("offset", "count"), [((0.2, 0.0, 0.0), 1), ((0.2, 0.1, 0.0), 0)]
)
def test_a_rigid_tip_spins_with_its_line(offset: Float, count: int) -> None:
    """The free node of the rigid element is on no bar; off the line it carries the mass about."""
    xyz, bars = chain(6, (1, 0, 0))
    link = cards("RBE2", EID=[60], GN=8, CM="123456", GM=ragged([7]))
    mass = cards("CONM2", EID=[50], G=8, M=10.0)
    m = model(
        grid(np.vstack([xyz, xyz[-1] + np.array(offset)])),
        bars,
        SECTION,
        steel(),
        link,
        mass,
    )
    assert massless_rotations(m, assemble(m)).size == count
    with EmbeddedSolver().open(m) as analysis:
        f = analysis.modes(ModesRequest(8)).modes.frequencies
    assert (np.abs(f) < 1e-2).sum() == 6 - count


@pytest.mark.parametrize("n", range(2, 9))
def test_a_spin_that_is_not_held_is_named(n: int) -> None:
    """By rounding K - σM can be factorised for some of them."""
    strict = free(n, (1, 2, 3), AUTOSPC="NO")
    with (
        EmbeddedSolver().open(strict) as analysis,
        pytest.raises(SingularModel, match="mechanism"),
    ):
        analysis.modes(ModesRequest(9))


def test_statics_and_derivatives() -> None:
    """A spin has no static answer; λ is proportional to E."""
    parameters = ParameterSet((Parameter("E", (CardField("MAT1", 1, "E"),)),))
    with EmbeddedSolver().open(free(10, (1, 2, 3))) as analysis:
        with pytest.raises(SingularModel, match="mechanism"):
            analysis.static(np.zeros(66))
        modes = analysis.modes(ModesRequest(9)).modes.take(slice(5, 9))
        slope, shape = analysis.derivatives(modes, parameters)
        np.testing.assert_allclose(
            slope[:, 0], (2 * np.pi * modes.frequencies) ** 2, rtol=1e-6
        )
        assert np.abs(shape).max() < 1e-5 * np.abs(modes.shapes).max()


def test_dofs_that_nothing_uses_are_left_out_without_autospc() -> None:
    """A scalar point and the rotations of a node on springs alone, under AUTOSPC,NO; ASING,-1 makes
    them an error.
    """
    k, mass = 4e4, 2.0
    spring = cards("CELAS2", EID=[1, 2, 3], K=k, G1=1, C1=[1, 2, 3])
    parts = (
        grid([[0.0, 0, 0]]),
        spring,
        cards("CONM2", EID=[9], G=1, M=mass),
        cards("SPOINT", ID=ragged([77])),
    )
    with EmbeddedSolver().open(model(*parts, AUTOSPC="NO")) as analysis:
        found = analysis.modes(ModesRequest(9))
        assert sorted(analysis.system.autospc.labels()) == [
            "1+RX",
            "1+RY",
            "1+RZ",
            "77",
        ]
        at = analysis.static(np.eye(len(analysis.dofs))[0])
    np.testing.assert_allclose(found.modes.frequencies, np.sqrt(k / mass) / 2 / np.pi)
    assert found.complete
    assert at[0, 0] == pytest.approx(1 / k)
    with (
        EmbeddedSolver().open(model(*parts, AUTOSPC="NO", ASING=-1)) as analysis,
        pytest.raises(SingularModel),
    ):
        analysis.modes(ModesRequest(9))
