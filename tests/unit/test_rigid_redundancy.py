"""A block of 4 by 3 by 2 m on a soft suspension: what its corners and edges read of six modes."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.channel_faults import rigid_suspects

XYZ = np.array(list(product((0.0, 4.0), (0.0, 3.0), (0.0, 2.0))))
POINTS = np.arange(1, 9)
CHANNELS = tuple(f"{p}+{a}" for p in POINTS for a in "XYZ")
SHEET = TestModel(
    POINTS,
    XYZ,
    CHANNELS,
    np.repeat(POINTS, 3),
    np.tile(np.eye(3), (8, 1)),
    np.zeros((0, 2)),
)


def measured(seed: int = 0, bends: float = 0.0, turns: float = 1.0) -> np.ndarray:
    """(24, 6) readings with noise of 1 %, `bends` of a motion that is not rigid, and rotations of
    the size `turns`.
    """
    rng = np.random.default_rng(seed)
    arm = (XYZ - XYZ.mean(axis=0)).repeat(3, axis=0)
    axes = np.tile(np.eye(3), (8, 1))
    motions = np.concatenate([axes, np.cross(arm, axes)], axis=1)
    shapes = motions @ (rng.normal(size=(6, 6)) * np.repeat([1.0, turns], 3)[:, None])
    return np.asarray(shapes + (0.01 + bends) * rng.normal(size=shapes.shape))


def judged(shapes: np.ndarray) -> list[tuple[str, str, str]]:
    f = np.linspace(0.6, 1.3, shapes.shape[1])
    found = rigid_suspects(ModeSet(f, 0 * f + 0.03, shapes, CHANNELS), SHEET)
    return [(s.channel, s.fault, s.partner) for s in found]


@pytest.mark.parametrize("at", [0, 7, 23])
def test_a_reversed_channel_is_named(at: int) -> None:
    shapes = measured(at)
    shapes[at] *= -1
    assert judged(shapes) == [(CHANNELS[at], "reversed", "")]


def test_two_swapped_channels_and_a_gain_are_named_together() -> None:
    shapes = measured(3)
    shapes[[4, 17]] = shapes[[17, 4]]
    shapes[9] *= 0.4
    assert set(judged(shapes)) == {
        ("2+Y", "swapped", "6+Z"),
        ("6+Z", "swapped", "2+Y"),
        ("4+X", "scaled", ""),
    }


def test_a_reversed_channel_that_moves_like_a_swapped_one_is_no_round_of_three() -> (
    None
):
    shapes = measured(5, turns=0.15)
    shapes[0] *= -1  # 1+X, in nearly all as 3+X
    shapes[[6, 13]] = shapes[[13, 6]]
    assert set(judged(shapes)) == {
        ("1+X", "reversed", ""),
        ("3+X", "swapped", "5+Y"),
        ("5+Y", "swapped", "3+X"),
    }


def test_a_sound_test_a_structure_that_bends_and_few_modes_accuse_nobody() -> None:
    assert [judged(measured(seed)) for seed in range(20)] == [[]] * 20
    bent = measured(1, bends=1.0)
    bent[5] *= -1
    assert judged(bent) == []
    assert judged(measured(1)[:, :2]) == []
