"""Figures of damping: what would spoil an axis is not on it."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.plots.diagram import damping
from ringtrue.plots.predicted import modes
from ringtrue.study.results import DampedModes


def test_rigid_body_modes_are_not_on_a_logarithmic_axis() -> None:
    fig = damping([], (np.array([-1e-5, 6e-6, 2.4, 33.0]), np.full(4, 0.015)))
    assert np.asarray(fig.data[0].x) == pytest.approx([2.4, 33.0])


@pytest.mark.parametrize(("largest", "kind"), [(0.02, None), (0.2, "log")])
def test_an_axis_is_logarithmic_where_the_ratios_ask_for_it(
    largest: float, kind: str | None
) -> None:
    ratios, one = np.array([0.01, largest]), np.ones(2)
    found = DampedModes(
        np.arange(2),
        ("1", "2"),
        one > 0,
        one,
        ratios,
        ratios,
        ratios,
        ratios,
        ratios,
        one,
        one,
    )
    assert modes(found).layout.yaxis.type == kind
