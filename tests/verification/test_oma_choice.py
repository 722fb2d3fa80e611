"""A choice by hand on an ambient record with known modes: what is picked is treated as the
automatic modes are.
"""

from __future__ import annotations

import numpy as np
import pytest
from test_oma_ambient import RATE, record, result, wrap

from ringtrue.core.choice import Choice, Merge, Pick, Reject
from ringtrue.errors import DataError
from ringtrue.identification.ambient.pipeline import (
    AmbientResult,
    AmbientSettings,
    identify_ambient,
)
from ringtrue.identification.common.manual_selection import as_choice

BAND = AmbientSettings(fmin=3.0, order_max=50)  # modes at 5, 11.8 and 26 Hz


def by_hand(choice: Choice | None) -> AmbientResult:
    return identify_ambient(wrap(record(0), RATE), BAND, choice=choice)


@pytest.fixture(scope="module")
def auto() -> AmbientResult:
    return by_hand(None)


def test_replayed_as_it_is_it_changes_nothing(auto: AmbientResult) -> None:
    assert auto.modes.frequencies == pytest.approx([5.0, 11.8, 26.0], rel=5e-3)
    again = by_hand(as_choice(auto.modes, auto.reasons))
    np.testing.assert_array_equal(again.modes.frequencies, auto.modes.frequencies)
    np.testing.assert_array_equal(again.modes.shapes, auto.modes.shapes)
    np.testing.assert_array_equal(again.uncertainty.factor, auto.uncertainty.factor)
    assert again.reasons == tuple(f"confirmed by hand; {r}" for r in auto.reasons)


def test_a_pole_of_an_order_is_taken_as_it_is(auto: AmbientResult) -> None:
    """Its frequency, damping and standard deviations are those of the diagram; the other modes keep
    their numbers.
    """
    d = auto.diagrams[0]
    at = np.flatnonzero(
        (d.cluster >= 0)
        & (np.abs(d.poles.frequencies - 11.8) < 0.1)
        & (d.poles.order >= 30)
    )
    k = int(at[0])
    pick = Pick(float(d.poles.frequencies[k]), int(d.poles.order[k]))
    found = by_hand(Choice((pick,)))
    assert len(found.modes) == 3  # the pick replaces the automatic mode
    assert found.reasons[1].startswith(f"chosen by hand, order {pick.order}; found at ")
    assert found.modes.frequencies[1] == pytest.approx(pick.frequency, rel=1e-12)
    assert found.modes.damping[1] == pytest.approx(d.poles.damping[k], rel=1e-9)
    assert found.uncertainty.frequency[1] == pytest.approx(
        d.poles.std_frequency[k], rel=1e-6
    )
    assert found.uncertainty.damping[1] == pytest.approx(
        d.poles.std_damping[k], rel=1e-6
    )
    assert 0 < np.median(found.uncertainty.shape[:, 1]) < 0.05
    np.testing.assert_array_equal(
        found.modes.frequencies[[0, 2]], auto.modes.frequencies[[0, 2]]
    )


def test_a_pole_that_no_mode_holds_becomes_one(auto: AmbientResult) -> None:
    d = auto.diagrams[0]
    far = (
        np.abs(d.poles.frequencies[:, None] / auto.modes.frequencies - 1).min(axis=1)
        > 0.05
    )
    k = int(np.flatnonzero((d.cluster < 0) & far & (d.poles.order > 20))[0])
    pick = Pick(float(d.poles.frequencies[k]), int(d.poles.order[k]))
    found = by_hand(Choice((pick,)))
    assert len(found.modes) == 4
    i = int(np.abs(found.modes.frequencies - pick.frequency).argmin())
    assert found.modes.frequencies[i] == pytest.approx(pick.frequency, rel=1e-12)
    assert np.isfinite(found.uncertainty.frequency[i])
    assert np.isfinite(found.uncertainty.shape[:, i]).all()
    assert "chosen by hand" in found.reasons[i]
    assert any(
        (x.cluster >= 0).sum() > (d.cluster >= 0).sum() for x in found.diagrams[:1]
    )


def test_rejected_and_merged(auto: AmbientResult) -> None:
    found = by_hand(Choice(rejects=(Reject(11.8, "crane"), Reject(20.0, "nothing"))))
    np.testing.assert_array_equal(
        found.modes.frequencies, auto.modes.frequencies[[0, 2]]
    )
    assert (
        f"mode at {auto.modes.frequencies[1]:.5g} Hz rejected by hand: crane"
        in found.notes
    )
    assert "rejected by hand, but not there: a mode at 20 Hz" in found.notes
    with pytest.raises(
        DataError,
        match="made: pick at 20 Hz at order 2: no such pole within 1 %; the nearest is at",
    ):
        by_hand(Choice((Pick(20.0, 2),)))


def test_of_a_merged_pair_the_best_known_mode_stays() -> None:
    """The close pair at 1.85 and 1.90 Hz made one."""
    auto = result(0)
    pair = np.array([1, 2])
    merge = Merge((1.85, 1.9), "one hanger")
    found = identify_ambient(wrap(record(0), RATE), choice=Choice(merges=(merge,)))
    relative = auto.uncertainty.frequency[pair] / auto.modes.frequencies[pair]
    best = pair[relative.argmin()]
    assert len(found.modes) == 5
    assert found.modes.frequencies[1] == auto.modes.frequencies[best]
    assert found.uncertainty.frequency[1] == auto.uncertainty.frequency[best]
    assert found.reasons[1].startswith("merged by hand from ")
    assert "(one hanger); " in found.reasons[1]
