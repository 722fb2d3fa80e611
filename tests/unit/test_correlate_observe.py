"""Observation of a model at sensors, and checks of the sensors themselves."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.channel_faults import suspect_channels
from ringtrue.correlation.frf import fdac, frac, magnitude_deviation
from ringtrue.correlation.paired_shapes import comac, ecomac
from ringtrue.correlation.pairing import pair_modes
from ringtrue.correlation.sensor_mapping import at_dofs, default_tolerance, observe
from ringtrue.errors import ConfigError, DataError, InputError


def grid() -> tuple[np.ndarray, np.ndarray, DofSet]:
    """27 nodes of a unit cube mesh (model unit mm here), numbered from 100."""
    xyz = np.stack(
        np.meshgrid(*[[0.0, 500.0, 1000.0]] * 3, indexing="ij"), axis=-1
    ).reshape(-1, 3)
    node = np.arange(100, 127)
    return node, xyz, DofSet(np.repeat(node, 6), np.tile(np.arange(1, 7), 27))


def sensors(xyz: np.ndarray, axes: np.ndarray) -> TestModel:
    n = len(xyz)
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return TestModel(
        np.arange(n),
        xyz,
        tuple(f"s{i}" for i in range(n)),
        np.arange(n),
        axes,
        np.zeros((0, 2), int),
    )


def rigid_motion(xyz: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return shift + np.cross(turn, xyz)


def test_on_node_and_skewed_sensor_reads_its_direction() -> None:
    node, xyz, dofs = grid()
    rng = np.random.default_rng(0)
    axes = rng.standard_normal((4, 3))
    at = [0, 5, 13, 26]
    o = observe(
        sensors(xyz[at] / 1000, axes), node, xyz, dofs, tolerance=1.0, unit=1e-3
    )
    u = rng.standard_normal(len(dofs))
    want = (u.reshape(27, 6)[at, :3] * axes).sum(axis=1) / np.linalg.norm(axes, axis=1)
    np.testing.assert_allclose(o(u), want, rtol=1e-12)
    assert o.distance.max() < 1e-9


def test_signed_and_shuffled_dofs() -> None:
    node, xyz, dofs = grid()
    rng = np.random.default_rng(1)
    order, sign = rng.permutation(len(dofs)), rng.choice([-1, 1], len(dofs))
    other = DofSet(dofs.node[order], dofs.direction[order] * sign)
    test = sensors(xyz[:5] / 1000, rng.standard_normal((5, 3)))
    u = rng.standard_normal(len(dofs))
    one = observe(test, node, xyz, dofs, tolerance=1.0, unit=1e-3)
    two = observe(test, node, xyz, other, tolerance=1.0, unit=1e-3)
    np.testing.assert_allclose(two(u[order] * sign), one(u), rtol=1e-12)


def test_channels_named_as_dofs_may_be_of_one_dof() -> None:
    """A table of a static test, as of a hammer: pulled at 101-Z, read at 101+Z."""
    _, _, dofs = grid()
    seen = at_dofs(("101-Z", "101+Z", "100:RX"), dofs)
    motion = np.arange(float(len(dofs)))
    np.testing.assert_array_equal(seen(motion), [-8.0, 8.0, 3.0])
    np.testing.assert_array_equal(
        at_dofs(("101+Z", "100-RX"), dofs, 1e-3)(motion), [8.0, -3000.0]
    )
    with pytest.raises(
        DataError,
        match=r"must be DOFs of the deck.* 2 DOFs are not in the set, first 8-Z 9\+Y",
    ):
        at_dofs(("8-Z", "101+Z", "9+Y"), dofs)


def test_rigid_interpolation_is_exact_for_rigid_motions() -> None:
    node, xyz, dofs = grid()
    rng = np.random.default_rng(2)
    place = np.concatenate([rng.uniform(0, 1000, (20, 3)), xyz[[4]]])
    axes = rng.standard_normal((21, 3))
    test = sensors(place / 1000, axes)
    o = observe(test, node, xyz, dofs, tolerance=600.0, unit=1e-3, method="rigid")
    shift, turn = rng.standard_normal(3), rng.standard_normal(3) * 1e-3
    u = np.concatenate(
        [rigid_motion(xyz, shift, turn), np.zeros((27, 3))], axis=1
    ).ravel()
    want = (rigid_motion(place, shift, turn) * test.axes).sum(axis=1)
    np.testing.assert_allclose(o(u), want, rtol=1e-9, atol=1e-9)
    on_node = o.matrix[[20]].toarray()[0]
    np.testing.assert_allclose(
        on_node[24:27], test.axes[20], atol=1e-9
    )  # the sensor on a node reads that node


def test_far_sensors_and_missing_dofs_are_named() -> None:
    node, xyz, dofs = grid()
    test = sensors(np.array([[0.0, 0, 0], [5.0, 0, 0]]), np.eye(3)[:2])
    with pytest.raises(DataError, match="s1 is 4000 from node 118"):
        observe(test, node, xyz, dofs, tolerance=10.0, unit=1e-3)
    without = DofSet(dofs.node[1:], dofs.direction[1:])
    with pytest.raises(DataError, match=r"s0 needs DOF 100\+X"):
        observe(test.pick(["s0"]), node, xyz, without, tolerance=10.0, unit=1e-3)
    with pytest.raises(ConfigError, match="did you mean 'nearest'"):
        observe(test, node, xyz, dofs, tolerance=10.0, method="nearst")


def test_how_far_a_sensor_may_be_goes_with_the_model() -> None:
    """27 nodes 500 apart: a mesh width; a fine line of 1001 nodes 1 apart: 3 % of its length; in
    any unit.
    """
    node, xyz, dofs = grid()
    line = np.zeros((1001, 3))
    line[:, 0] = np.arange(1001.0)
    for scale in (1e-4, 1.0, 1e5):
        np.testing.assert_allclose(default_tolerance(scale * xyz), 500 * scale)
        np.testing.assert_allclose(default_tolerance(scale * line), 30 * scale)
    assert default_tolerance(np.zeros((2, 3))) == np.inf
    observe(
        sensors(np.array([[0.25, 0.25, 0.1]]), np.eye(3)[:1]),
        node,
        xyz,
        dofs,
        unit=1e-3,
    )
    with pytest.raises(DataError, match="farther than 500 "):
        observe(
            sensors(np.array([[1.6, 0.0, 0.0]]), np.eye(3)[:1]),
            node,
            xyz,
            dofs,
            unit=1e-3,
        )
    with pytest.raises(
        DataError, match=r"The test is 0\.00[01].* times the model in size"
    ):  # the deck is in mm
        observe(
            sensors(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.5]]), np.eye(3)[:2]),
            node,
            xyz,
            dofs,
            unit=1.0,
        )


@pytest.mark.parametrize(
    ("unit", "told"),
    [
        (1e-3, r"between nodes .* to 0\.22 m"),
        (1.0, "times the model in size"),
        (1e-6, "unit of length"),
    ],
)
def test_sensors_between_nodes_are_told_from_a_wrong_unit(
    unit: float, told: str
) -> None:
    node, xyz, dofs = grid()
    places = 1e-3 * (xyz[::2] + np.array([200, 0, 0]))
    test = sensors(places, np.tile([0, 0, 1.0], (len(places), 1)))
    with pytest.raises(DataError, match=told):
        observe(test, node, xyz, dofs, tolerance=50.0 * 1e-3 / unit, unit=unit)


def test_comac_finds_the_place_ecomac_the_sign() -> None:
    a = np.sin(np.pi * np.outer(np.arange(1, 11), np.arange(1, 6)) / 11)
    b = a.copy()
    b[3] *= -1
    assert comac(a, b) == pytest.approx(1)
    assert int(np.argmax(ecomac(a, b))) == 3
    b[6] = b[6, ::-1]
    assert int(np.argmin(comac(a, b))) == 6


def fault_free() -> ModeSet:
    a = np.sin(np.pi * np.outer(np.arange(1, 11), np.arange(1, 7)) / 11)
    return ModeSet(np.arange(1.0, 7), np.zeros(6), a, tuple("abcdefghij"))


def test_suspects_are_named_and_nothing_else() -> None:
    b = fault_free()
    rng = np.random.default_rng(3)
    read = b.shapes + 0.01 * rng.standard_normal(b.shapes.shape)
    good = ModeSet(b.frequencies, b.damping, read.copy(), b.labels)
    assert suspect_channels(good, b, pair_modes(good, b)) == ()
    read[2] *= -1
    read[[5, 6]] = read[[6, 5]]
    read[8] = 1e-4
    bad = ModeSet(b.frequencies, b.damping, read, b.labels)
    pairing = pair_modes(good, b)
    got = {(s.channel, s.fault) for s in suspect_channels(bad, b, pairing)}
    assert got == {("c", "reversed"), ("f", "swapped"), ("g", "swapped"), ("i", "dead")}
    with pytest.raises(InputError, match="at least 3"):
        suspect_channels(bad.take([0, 1]), b, pair_modes(good.take([0, 1]), b))


def test_frf_measures() -> None:
    w = np.linspace(1, 100, 400)
    h = 1 / (50.0**2 - w**2 + 2j * 0.02 * 50 * w)[:, None, None]
    assert frac(h, -2 * h)[0, 0] == pytest.approx(1)
    assert magnitude_deviation(h, 10 * h)[0, 0] == pytest.approx(20)
    two = np.concatenate([h, h**2], axis=1)[:, :, 0]
    np.testing.assert_allclose(np.diag(fdac(two, two)), 1, rtol=1e-12)
    with pytest.raises(InputError, match="same lines"):
        frac(h, h[1:])
