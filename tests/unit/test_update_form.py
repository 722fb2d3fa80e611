"""Patterns of form and what errors of form leave open, on a clamped beam of bars without shear
flexibility: 12 elements, 0.16 x 0.3 m, 2 m long; half of it has another property.

    |====================-----------------   z up, channels Y and Z at every third node
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.api.improvement import form_findings
from ringtrue.core.notes import sentence
from ringtrue.model.model import Model
from ringtrue.updating.form_uncertainty import quantile
from ringtrue.updating.selection.form import ModeDeviations, form_patterns
from ringtrue.updating.selection.form_changes import FormChange

CHANNELS = [f"{n}+{a}" for n in (4, 7, 10, 13) for a in "YZ"]
STATED = 0.001


def beam(folder: Path, shear: str = "", e: float = 2.1e11, foot: str = "") -> Model:
    lines = ["SOL 103", "CEND", *(() if foot else ("SPC = 1",)), "BEGIN BULK"]
    lines += [f"GRID,{i + 1},,{2 * i / 12:.6f},0.,0." for i in range(13)]
    lines += [f"CBAR,{i + 1},{1 + i // 6},{i + 1},{i + 2},0.,0.,1." for i in range(12)]
    for pid in (1, 2):
        lines.append(f"PBAR,{pid},{pid},0.048,3.6E-4,1.024E-4,2.4E-4")
        lines += [",,,,,,,,", f",{shear},{shear}"] if shear else []
    lines += [f"MAT1,1,{e:.6E},,0.3,7850.", "MAT1,2,2.1E11,,0.3,7850."]
    held = ["SPC1,1,123456,1"]
    if foot:
        held = [
            "CBUSH,99,99,1,,,,,0",
            f"PBUSH,99,K,1.E13,1.E13,1.E13,{foot},{foot},{foot}",
        ]
    path = folder / "beam.bdf"
    path.write_text("\n".join([*lines, *held, "ENDDATA", ""]))
    return rt.read_deck(path)


def measured(model: Model, rng: np.random.Generator) -> rt.FeModes:
    fe = rt.solve_modes(model, count=14)
    seen = fe.at(CHANNELS)
    moved = np.abs(seen.shapes).max(axis=0) > 1e-6  # not torsion and axial modes
    f = fe.frequencies[moved] * (1 + STATED * rng.standard_normal(int(moved.sum())))
    return rt.modes_of_test(
        f, seen.shapes[:, moved], CHANNELS, std_frequency=STATED * f
    )


@pytest.mark.parametrize(
    ("structure", "pattern"),
    [
        ({"shear": "0.5"}, "shear"),
        ({"foot": "1.0E9"}, "supports"),
        ({"e": 1.6e11}, "property"),
        ({}, None),
    ],
)
def test_the_cause_of_the_deviations_is_named(
    structure: dict[str, str], pattern: str | None, tmp_path: Path
) -> None:
    test = measured(beam(tmp_path, **structure), np.random.default_rng(1))
    found = form_findings(beam(tmp_path), test)
    assert [p.pattern for p in found.named] == ([pattern] if pattern else [])
    assert [n.code for n in found.notes] == ([f"form {pattern}"] if pattern else [])
    for note in found.notes:
        assert found.named[0].cause in sentence(note)
        assert found.named[0].explained > 0.95
    # read anew, not the same
    stored = replace(found, named=tuple(replace(p) for p in found.named))
    assert [sentence(n) for n in stored.notes] == [sentence(n) for n in found.notes]


def test_one_mode_alone_and_a_common_ratio_are_told_from_scatter() -> None:
    n = 10
    even = FormChange(
        "common",
        "modulus",
        (),
        np.array([-1.0, 0.0, 1.0]),
        np.outer([-1.0, 0, 1], np.ones(n)),
    )
    noise = 0.002 * np.random.default_rng(0).standard_normal(n)
    std = np.full(n, 0.002)

    def named(change: np.ndarray) -> list[str]:
        at = np.arange(n)
        found = form_patterns(ModeDeviations(at, at, change, std), [even])
        return [p.cause for p in found.named]

    assert named(noise) == []
    assert named(noise + 0.1) == ["modulus"]
    assert named(noise + 0.1 * (np.arange(n) == 3)) == ["test mode 4 alone"]
    assert named(50 * noise) == []  # scatter beyond the stated errors is no pattern


def test_intervals_hold_under_missing_shear_flexibility_and_say_so(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(2)
    test = measured(beam(tmp_path, shear="1.5", e=1.8e11), rng)
    deck = beam(tmp_path)
    parameters = [rt.parameter("left", "MAT1 1 E"), rt.parameter("right", "MAT1 2 E")]
    done = rt.update(deck, test, parameters, leave_out=[4])
    assert "shear" in done.form.flags["left"]
    assert done.low[0] < 1.8 / 2.1 < done.high[0]
    bands = done.form.bands
    assert bands is not None
    assert not bands.used[3]
    near = np.abs(np.sqrt(bands.low * bands.high) / bands.test - 1)
    assert near[3] < np.abs(bands.predicted / bands.test - 1)[3]


def test_nothing_is_flagged_where_the_form_is_right(tmp_path: Path) -> None:
    test = measured(beam(tmp_path, e=1.8e11), np.random.default_rng(3))
    parameters = [rt.parameter("left", "MAT1 1 E"), rt.parameter("right", "MAT1 2 E")]
    done = rt.update(beam(tmp_path), test, parameters)
    assert not done.form.flags
    assert done.low[0] < 1.8 / 2.1 < done.high[0]
    assert np.log(done.high / done.low).max() < 0.1


def test_quantiles_of_a_mixture() -> None:
    weight = np.array([0.5, 0.5])
    far = quantile(weight, np.array([-10.0, 10.0]), np.ones(2), 0.75)
    assert far == pytest.approx(10.0, abs=1e-6)  # the median of the upper half
    one = quantile(np.ones(1), np.zeros(1), np.ones(1), 0.95)
    assert one == pytest.approx(1.6448536, abs=1e-6)
