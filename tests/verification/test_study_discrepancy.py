"""A good test is weighed as good as it is: the prior does not pull what its modes tell to the percent.

The frame of `localise_twin`, three of its regions wrong, 12 modes with 0.2 % noise on frequencies and 1 % on shapes.
With 1 % of frequency and 0.05 of MAC assumed, a prior of 10 % takes back a part of each change.
"""

from __future__ import annotations

from pathlib import Path

import localise_twin as twin
import numpy as np
import pytest

from ringtrue.study.config import parse_config
from ringtrue.study.results import UpdateStage
from ringtrue.study.run import run_study

WRONG = {11: 0.7, 20: 1.4, 33: 1.3}
STUDY = """
[study]
title = "Frame"
[model]
deck = "frame.bdf"
[test]
sheet = "sensors.csv"
modes = "modes.json"
[update]
left_out = 2
"""
CANDIDATES = "".join(
    f'[[candidate]]\nname = "{mid}"\ntargets = ["MAT1 {mid} E"]\nlower = 0.4\nupper = 2.5\nstd = 0.1\n' for mid in WRONG
)


def changes(folder: Path, extra: str) -> dict[str, float]:
    """Factor found over the true one of each wrong region."""
    aim = twin.measured(WRONG, np.random.default_rng(3))
    twin.write_test(folder, aim.frequencies, aim.shapes, 0.002, 0.01 * np.abs(aim.shapes).max(axis=0))
    (folder / "study.toml").write_text(STUDY + extra + CANDIDATES)
    done: UpdateStage = run_study(folder / "study.toml", until="update").results["update"]
    best = done.sets[done.chosen]
    return {n: a / WRONG[int(n)] for n, a in zip(best.parameters, best.factor.tolist(), strict=True)}


@pytest.mark.parametrize("path", ["", 'step = "trust-region"\n'])
def test_the_prior_does_not_pull(tmp_path: Path, path: str) -> None:
    found = changes(tmp_path, path)
    assert set(found) == {"11", "20", "33"}
    assert list(found.values()) == pytest.approx([1.0] * 3, abs=0.02)  # four standard deviations by the noise


def test_errors_that_are_given_hold(tmp_path: Path) -> None:
    worst = max(abs(a - 1) for a in changes(tmp_path, "frequency_error = 0.01\n").values())
    assert worst > 0.03
    given = parse_config(STUDY + "frequency_error = 0.01\n", tmp_path)
    asked = parse_config(STUDY + 'frequency_error = 0.01\ndiscrepancy = "found"\n', tmp_path)
    assert asked.update.sharpened
    assert not given.update.sharpened
    assert not parse_config(STUDY + 'loss = "tukey"\n', tmp_path).update.sharpened
