"""Further starts: where the updating from the deck leaves a used mode without partner, others are
tried.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_study

from ringtrue.core.iterate import Progress
from ringtrue.study.results import FinishedSet
from ringtrue.study.run import StudyRun, run_study
from ringtrue.study.stages import update


def poor(lost: int, good: str) -> Any:
    """The updating, as if it had ended at the deck with `lost` modes without partner.

    Not so of what is `good`: the further starts, or that from the proposal.
    """
    well = update.update_reduced

    def ended(case: update.SetUpdate, progress: Progress) -> FinishedSet:
        done = well(case, progress)
        if case.name.endswith(good):
            return done
        result = replace(
            done.result,
            factor=np.ones(len(done.result.parameters)),
            fit=replace(done.result.fit, criterion=done.result.fit.criterion + 50.0),
        )
        return replace(done, result=result, lost=lost)

    return ended


def updated(folder: Path) -> StudyRun:
    return run_study(small_study.write_study(folder, ambient=False), until="update")


@pytest.mark.parametrize("good", ["further starts", "proposal"])
def test_a_lower_end_of_other_starts_takes_the_place_of_one_that_lost_modes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, good: str
) -> None:
    monkeypatch.setattr(update, "update_reduced", poor(lost=2, good=good))
    done = updated(tmp_path)
    stage = done.results["update"]
    best = stage.sets[stage.chosen]
    assert set(best.parameters) == {f"columns {k}" for k in small_study.TRUTH}
    for name, factor in zip(best.parameters, best.factor.tolist(), strict=True):
        assert factor == pytest.approx(
            small_study.TRUTH[int(name.split()[1])], rel=0.02
        )  # noise of the signals
    assert not (done.folder / "update.sets.h5").exists()


def test_an_end_with_all_partners_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(update, "update_reduced", poor(lost=0, good="further starts"))
    stage = updated(tmp_path).results["update"]
    np.testing.assert_array_equal(stage.sets[stage.chosen].factor, 1.0)
