"""The worked example from raw signals to the delivered deck, against the truth that no stage of the
study sees.

One run with short records serves all tests of this module.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ringtrue.demos.lsf import demo, twin
from ringtrue.demos.lsf import examples as worked
from ringtrue.demos.lsf.twin import Twin, twin_hash
from ringtrue.shapes import mac, mpc, realise
from ringtrue.study.store import Store

pytestmark = [pytest.mark.demo, pytest.mark.timeout(1500)]
# of version 1
FROZEN = "1632fa84378e3da7c7e43bb6d23dec3caf3e3ef6ed38b3003df38fd0079bca53"
RIGID_BELOW = 2.5  # Hz, rigid-body and hung modes


@dataclass(frozen=True)
class Example:
    folder: Path
    result: demo.DemoResult
    summary: dict[str, Any]
    twin: Twin


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Example:
    folder = tmp_path_factory.mktemp("lsf")
    made: list[Twin] = []
    keep = worked.make_twin

    def kept(*args: Any, **kwargs: Any) -> Twin:
        made.append(keep(*args, **kwargs))
        return made[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worked, "make_twin", kept)
        result = demo.run_demo(folder, fast=True)
    return Example(
        folder, result, json.loads((folder / "summary.json").read_text()), made[0]
    )


def test_what_must_hold_does(example: Example) -> None:
    assert [c for c in example.result.checks if not c.held] == []


def test_the_deck_is_the_facility(example: Example) -> None:
    s = example.summary
    assert s["mass_t"] == pytest.approx(1600, rel=0.01)
    assert 30_000 <= s["dof"] <= 60_000
    modes = example.result.run.results["model"].modes.frequencies
    rigid = modes[modes < RIGID_BELOW]
    assert rigid.size == 6
    assert rigid[0] > 0.4
    assert (
        rigid[2] / rigid[1] < 1.05 or rigid[1] / rigid[0] < 1.05
    )  # two lateral modes close to each other
    assert 9.5 <= modes[6] <= 11.5


def test_the_twin_is_another_model(example: Example) -> None:
    s, f = example.summary, example.twin.real_modes.frequencies
    assert s["dof_as_built"] >= 2 * s["dof"]
    assert s["twin_hash"] == twin_hash()
    assert (f < RIGID_BELOW).sum() == 8
    elastic = f[f > RIGID_BELOW]
    assert 13 <= elastic[0] <= 16
    assert (elastic < 40).sum() >= 7
    assert (elastic < 95).sum() >= 22
    assert s["best_possible_percent"] >= 0.3
    seen = np.abs(example.twin.modal.poles) < 2 * np.pi * 40
    assert mpc(example.twin.modal.shapes[:, seen]).min() > 0.85


def test_the_twin_is_frozen() -> None:
    assert (twin.VERSION, twin_hash()) == (1, FROZEN)


def test_the_first_correlation_looks_like_the_published_one(example: Example) -> None:
    first = example.summary["initial"]
    deviation = np.array([p["deviation_percent"] for p in first])
    assert ((deviation[:4] > -32) & (deviation[:4] < -27)).all()
    assert deviation.min() > -33
    assert deviation.max() < -6
    assert 17 < np.abs(deviation).mean() < 21


def test_ratios_are_physical() -> None:
    for seed in range(20):
        r = twin.ratios(seed)
        spec = twin.as_built(seed)
        concrete = [
            spec.modulus[k] for k in ("slab", "long walls", "end walls", "haunches")
        ]
        assert 15e9 <= min(concrete) <= max(concrete) <= 42e9
        steel = [
            v
            for k, v in spec.modulus.items()
            if k not in ("slab", "long walls", "end walls", "haunches")
        ]
        assert 199e9 <= min(steel) <= max(steel) <= 213e9
        assert sum(abs(v - 1) > 0.04 for v in r.values()) >= 10


def test_hung_parts_stay_unpaired_with_a_reason(example: Example) -> None:
    lone = example.summary["rigid_body_unpaired"]
    assert all(u["reason"] for u in lone)
    assert all(
        1.5 < u["frequency_hz"] < RIGID_BELOW for u in lone if u["set"] == "test"
    )


def test_damping_is_that_of_the_structure(example: Example) -> None:
    twin, found = example.twin, Store(example.folder / "study.h5").load("identify")
    truth_shapes = twin.real_modes.rows(found.hammer.modes.channels)
    like = mac(realise(found.hammer.modes.shapes), truth_shapes.shapes)
    near = (
        np.abs(truth_shapes.frequencies / found.hammer.modes.frequencies[:, None] - 1)
        < 0.01
    )
    at = np.argmax(np.where(near, like, -1), axis=1)
    sure = found.hammer.modes.confidence >= 0.5
    error = np.abs(found.hammer.modes.damping / truth_shapes.damping[at] - 1)[sure]
    assert np.median(error) < 0.01
    assert error.max() < 0.10
    low = found.ambient.modes.frequencies < 1.6
    rigid = found.ambient.modes.damping[low], found.ambient.uncertainty.damping[low]
    which = [
        int(np.argmin(np.abs(twin.real_modes.frequencies - f)))
        for f in found.ambient.modes.frequencies[low]
    ]
    # three standard deviations, and a twentieth for the bias of damping in records of ten minutes
    tolerance = 3 * rigid[1] + 0.05 * twin.real_modes.damping[which]
    assert (np.abs(rigid[0] - twin.real_modes.damping[which]) < tolerance).all()


def test_only_the_changed_fields_differ(example: Example) -> None:
    final = example.result.run.results["final"]
    changed = {c.split(":")[0] for c in final.changes}
    lines = 0
    for path in (example.folder / "remodelled").glob("*.bdf"):
        old = path.read_text().splitlines()
        new = (example.folder / "updated" / path.name).read_text().splitlines()
        assert len(old) == len(new)
        different = sum(a != b for a, b in zip(old, new, strict=True))
        assert (different > 0) == (path.name in changed)
        lines += different
    assert 0 < lines <= len(final.changes)
