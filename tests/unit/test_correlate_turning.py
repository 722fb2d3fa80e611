"""Close modes as subspaces: what is told of a pair changes steadily as two modes move apart,
whichever limit they pass.

Two sine shapes are mixed in the test by 36 degrees; the frequencies of the model's move from 0.5 %
apart to beyond all limits in steps of 0.05 %.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlation.paired_shapes import paired_shapes, turning
from ringtrue.correlation.pairing import PairingSettings, pair_modes
from ringtrue.shapes import paired_mac

CHANNELS = tuple("abcdefgh")
STEP = 0.0005
GAPS = np.arange(0.005, 0.16, STEP)
SETTINGS = PairingSettings(mac_gate=0.4)  # all pairs stay


def sines(m: int) -> np.ndarray:
    n = len(CHANNELS)
    return np.sin(np.pi * np.outer(np.arange(1, n + 1), np.arange(1, m + 1)) / (n + 1))


def modes(f: list[float], shapes: np.ndarray) -> ModeSet:
    return ModeSet(np.array(f), np.full(len(f), 0.01), shapes, CHANNELS, Norm.MASS)


def mixed(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    out = sines(4)
    out[:, 1:3] = out[:, 1:3] @ np.array([[c, -s], [s, c]])
    return out


def swept(test: ModeSet, third: float = 40.0) -> np.ndarray:
    """MAC of the four pairs at each gap, (gap, 4)."""
    out = []
    for gap in GAPS:
        found = pair_modes(
            test, modes([10, 20, 20 * (1 + gap), third], sines(4)), SETTINGS
        )
        assert found.a.tolist() == [0, 1, 2, 3]
        out.append(found.mac)
    return np.array(out)


@pytest.mark.parametrize(
    "apart", [0.003, 0.1], ids=["close in the test", "apart in the test"]
)
@pytest.mark.parametrize("third", [40.0, 20.35], ids=["two modes", "three modes"])
def test_mac_of_a_pair_does_not_jump_as_the_model_s_modes_move_apart(
    apart: float, third: float
) -> None:
    mac = swept(modes([10, 20, 20 * (1 + apart), third], mixed(np.pi / 5)), third)
    assert mac[0].min() > 0.999
    assert mac[-1, 1:3].max() < 0.7  # cos² 36° = 0.65
    # of the fade from 2 to 3 %
    steepest = 1.5 / (0.5 * 0.02) * (1 - np.cos(np.pi / 5) ** 2)
    assert np.abs(np.diff(mac, axis=0)).max() < 1.05 * steepest * STEP


def test_mac_of_a_pair_does_not_jump_as_shapes_come_to_match_one_to_one() -> None:
    angles = np.linspace(0.05, 0.6, 300)
    mac = [
        pair_modes(
            modes([10, 20, 20.06, 40], mixed(q)),
            modes([10, 20, 20.1, 40], sines(4)),
            SETTINGS,
        ).mac
        for q in angles
    ]
    assert np.abs(np.diff(mac, axis=0)).max() < 0.01
    assert mac[-1].min() > 0.999


def test_shapes_are_turned_as_far_as_the_pairing_says() -> None:
    """Between the limits the turned shapes stay orthonormal, steady, and near the MAC that is
    told.
    """
    test, last = modes([10, 20, 24, 40], mixed(np.pi / 5)), None
    for gap in np.arange(0.018, 0.032, STEP):
        model = modes([10, 20, 20 * (1 + gap), 40], sines(4))
        found = pair_modes(test, model, SETTINGS)
        turn = turning(test, model, found, SETTINGS)
        np.testing.assert_allclose(turn.T @ turn, np.eye(4), atol=1e-12)
        left, right = paired_shapes(test, model, found, SETTINGS)
        np.testing.assert_allclose(
            paired_mac(left, right), found.mac, atol=0.1
        )  # a chord for the arc of a rotation
        assert last is None or np.abs(turn - last).max() < 0.1
        last = turn
    np.testing.assert_array_equal(last, np.eye(4))


def test_groups_do_not_depend_on_the_order_of_the_modes() -> None:
    test, model = (
        modes([10, 20, 20.1, 40], mixed(np.pi / 5)),
        modes([10, 20, 20.5, 40], sines(4)),
    )
    mix = np.array([2, 0, 3, 1])
    plain = pair_modes(test, model, SETTINGS)
    got = pair_modes(test, replace(model.take(mix)), SETTINGS)
    np.testing.assert_allclose(got.mac, plain.mac, rtol=1e-9)
    back = turning(test, model.take(mix), got, SETTINGS)
    np.testing.assert_allclose(
        back, turning(test, model, plain, SETTINGS)[np.ix_(mix, mix)], atol=1e-9
    )
