"""A good test is weighed as good as it is: the prior does not pull what its modes tell to the
percent.

The frame of `localise_twin`, three of its regions wrong, 12 modes with 0.2 % noise on frequencies
and 1 % on shapes. With 1 % of frequency and 0.05 of MAC assumed, a prior of 10 % takes back a part
of each change.
"""

from __future__ import annotations

import json
from pathlib import Path

import localise_twin as twin
import numpy as np
import pytest

from ringtrue.cli.main import run
from ringtrue.study.config import parse_config
from ringtrue.study.results import SetResult, UpdateStage
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
    f'[[candidate]]\nname = "{mid}"\ntargets = ["MAT1 {mid} E"]\nlower = 0.4\nupper = 2.5\nstd = '
    "0.1\n"
    for mid in WRONG
)


def updated(folder: Path, extra: str) -> tuple[SetResult, list[int]]:
    """The set that a study chooses, and the modes that it leaves out, from 1."""
    aim = twin.measured(WRONG, np.random.default_rng(3))
    twin.write_test(
        folder,
        aim.frequencies,
        aim.shapes,
        0.002,
        0.01 * np.abs(aim.shapes).max(axis=0),
    )
    (folder / "study.toml").write_text(STUDY + extra + CANDIDATES)
    stages = run_study(folder / "study.toml", until="update").results
    done: UpdateStage = stages["update"]
    return done.sets[done.chosen], (stages["correlate"].reference.left_out + 1).tolist()


def changes(folder: Path, extra: str) -> dict[str, float]:
    """Factor found over the true one of each wrong region."""
    best, _ = updated(folder, extra)
    return {
        n: a / WRONG[int(n)]
        for n, a in zip(best.parameters, best.factor.tolist(), strict=True)
    }


def test_the_prior_does_not_pull(tmp_path: Path) -> None:
    found = changes(tmp_path, "")
    assert set(found) == {"11", "20", "33"}
    assert list(found.values()) == pytest.approx(
        [1.0] * 3, abs=0.02
    )  # four standard deviations by the noise


def test_the_command_updates_as_the_study_does(tmp_path: Path) -> None:
    """Same data, same end and the same discrepancy, from the last two parts of one function and by
    another path.
    """
    study, left_out = updated(tmp_path, "")
    words = [str(tmp_path / n) for n in ("study.toml", "modes.json")]
    more = [
        "--leave-out",
        ",".join(map(str, left_out)),
        "--json",
        str(tmp_path / "found.json"),
    ]
    assert run(["update", *words, *more]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    factors = {p["name"]: p["factor"] for p in found["parameters"]}
    assert [factors[n] for n in study.parameters] == pytest.approx(
        study.factor.tolist(), rel=2e-4
    )  # of the basis
    std = {p["name"]: p["relative_std"] for p in found["parameters"]}
    assert [std[n] for n in study.parameters] == pytest.approx(
        study.std.tolist(), rel=0.05
    )
    kept = list(found["discrepancy_percent"].values())
    assert kept == pytest.approx((100 * study.discrepancy).tolist(), rel=0.02)
    assert kept[0] < 0.5  # 0.2 % of noise; 1 % is assumed
    path = tmp_path / "study.toml"
    assumed = '[update]\ndiscrepancy = "assumed"\nwrite = "all"\n'
    path.write_text(path.read_text().replace("[update]\n", assumed))
    assert run(["update", *words, *more]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["discrepancy_percent"] == {"frequency": 1.0, "mac": 5.0}
    assert (
        max(abs(p["factor"] / WRONG[int(p["name"])] - 1) for p in found["parameters"])
        > 0.03
    )


def test_errors_that_are_given_hold(tmp_path: Path) -> None:
    worst = max(
        abs(a - 1) for a in changes(tmp_path, "frequency_error = 0.01\n").values()
    )
    assert worst > 0.03
    given = parse_config(STUDY + "frequency_error = 0.01\n", tmp_path)
    asked = parse_config(
        STUDY + 'frequency_error = 0.01\ndiscrepancy = "found"\n', tmp_path
    )
    assert asked.update.sharpened
    assert not given.update.sharpened
    assert not parse_config(STUDY + 'loss = "huber"\n', tmp_path).update.sharpened
