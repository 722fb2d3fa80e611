"""Which modes and channels of a test the model is judged by, where records of other sensors leave
gaps.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import numpy.typing as npt

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.testmodel import TestModel
from ringtrue.io.modes import write_modes
from ringtrue.study.config import parse_config
from ringtrue.study.reference import (
    beyond,
    fewer,
    left_out,
    measured_part,
    reference_modes,
)
from ringtrue.study.results import IdentifiedModes
from ringtrue.study.session import Session
from ringtrue.study.stages.correlate import compare_tests
from ringtrue.study.supplied import supplied_modes


def modes(known: npt.NDArray[np.bool_]) -> ModeSet:
    """Shapes (channel, mode) with gaps where `known` is false."""
    n, m = known.shape
    return ModeSet(
        np.arange(1.0, m + 1),
        np.full(m, 0.01),
        np.where(known, 1.0, np.nan),
        tuple(f"{i}+Z" for i in range(n)),
    )


def test_a_mode_of_one_setup_does_not_cost_the_channels_of_the_other() -> None:
    # 4 common channels and 8 of each of two setups: ten modes in both, one in the first alone, two
    # in the second alone
    known = np.ones((20, 13), dtype=bool)
    known[12:, 4] = False
    known[4:12, [7, 9]] = False
    at, channels = measured_part(modes(known))
    assert at.tolist() == [0, 1, 2, 3, 5, 6, 8, 10, 11, 12]
    assert len(channels) == 20


def test_a_channel_that_few_modes_have_goes_rather_than_the_modes() -> None:
    known = np.ones((20, 6), dtype=bool)
    known[3, 1:] = False
    at, channels = measured_part(modes(known))
    assert at.size == 6
    assert len(channels) == 19
    assert "3+Z" not in channels


def test_nothing_is_lost_without_gaps_or_modes() -> None:
    at, channels = measured_part(modes(np.ones((5, 3), dtype=bool)))
    assert (at.size, len(channels)) == (3, 5)
    at, channels = measured_part(modes(np.ones((5, 0), dtype=bool)))
    assert (at.size, len(channels)) == (0, 5)


def test_a_deck_whose_modes_end_with_the_test_is_told() -> None:
    found = modes(np.ones((3, 10), dtype=bool))  # 1 to 10 Hz
    assert beyond(found, 12.0) == ()
    (note,) = beyond(found, 10.5)
    assert "computed to 10.5 Hz" in note
    assert "fmax to 12 or more" in note
    assert "3 of them above it" in beyond(found, 7.0)[0]


def test_rigid_body_modes_of_a_file_are_those_below_the_edge(tmp_path: Path) -> None:
    """A test that was identified elsewhere has no ambient part, and tunes a suspension all the
    same.
    """
    known = modes(np.ones((6, 9), dtype=bool))  # 1 to 9 Hz
    std = Uncertainty.independent(
        0.01 * known.frequencies, known.damping, np.zeros((6, 9))
    )
    write_modes(tmp_path / "test.json", known, std)
    points = np.arange(6)
    xyz = np.column_stack([points, 0 * points, 0 * points]).astype(float)
    axes = np.tile([0.0, 0.0, 1.0], (6, 1))
    sheet = TestModel(
        points, xyz, known.channels, points, axes, np.zeros((0, 2), dtype=np.int64)
    )
    text = '[model]\ndeck = "a.bdf"\n[correlate]\nrigid_below = 3.5\n'
    text += '[[suspension]]\nname = "springs"\ntargets = ["PBUSH 1 K1"]\n'
    found = reference_modes(
        supplied_modes(tmp_path / "test.json", sheet, ()),
        parse_config(text, tmp_path / "s.toml"),
    )
    np.testing.assert_allclose(found.rigid.frequencies, [1, 2, 3])
    np.testing.assert_allclose(found.rigid_std.frequency, [0.01, 0.02, 0.03])
    np.testing.assert_allclose(found.elastic.frequencies, np.arange(4, 10))


def test_fewer_modes_left_out_than_asked_for_are_told() -> None:
    modes = ModeSet(
        np.arange(1.0, 7.0),
        np.full(6, 0.01),
        np.eye(6),
        tuple("abcdef"),
        confidence=np.ones(6),
    )
    for count, kept, told in (
        (None, 4, False),
        (2, 4, False),
        (4, 2, False),
        (9, 2, True),
    ):
        out = left_out(modes, count, 0.5)
        assert len(modes) - out.size == kept
        assert bool(fewer(count, out)) == told
    assert fewer(9, out)[0].startswith("update.left_out = 9: 4 modes are left out")


def test_two_tests_are_compared_where_neither_has_a_gap(tmp_path: Path) -> None:
    """Modes of a file may be those of several setups, as those of ambient records."""
    rng = np.random.default_rng(0)
    whole = replace(
        modes(np.ones((8, 5), dtype=bool)), shapes=rng.standard_normal((8, 5))
    )
    shapes = np.array(whole.shapes)
    shapes[6:, 1] = np.nan
    std = Uncertainty.independent(
        0.01 * whole.frequencies, whole.damping, np.zeros((8, 5))
    )
    points = np.arange(8)
    xyz, axes = (
        np.column_stack([points, 0 * points, 0 * points]).astype(float),
        np.tile([0.0, 0.0, 1.0], (8, 1)),
    )
    sheet = TestModel(
        points, xyz, whole.channels, points, axes, np.zeros((0, 2), dtype=np.int64)
    )
    write_modes(tmp_path / "test.json", replace(whole, shapes=shapes), std)
    found = replace(
        supplied_modes(tmp_path / "test.json", sheet, ()),
        ambient=IdentifiedModes(whole, std),
    )
    session = SimpleNamespace(
        config=parse_config('[model]\ndeck = "a.bdf"\n', tmp_path / "s.toml"),
        get=lambda _: found,
    )
    stage = compare_tests(cast(Session, session), lambda *_: None)
    assert stage is not None
    # eight channels of four modes are more than six of five
    assert stage.table.mac.shape == (5, 4)
    np.testing.assert_allclose(stage.table.pairing.mac, 1.0, rtol=1e-12)
