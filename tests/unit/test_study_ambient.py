"""Files of a logger that go on with each other are one ambient record of a study."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from ringtrue.core.choice import Choice, Reject
from ringtrue.core.iterate import quiet
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.study.config_sections import IdentifySection
from ringtrue.study.log import read_log
from ringtrue.study.results import IdentifiedRecord, RecordSummary
from ringtrue.study.stages.identify import Campaign, ambient

RATE, F, ZETA = 20.0, np.array([1.3, 2.2, 3.9]), 0.015
SHEET = "point,x,y,z,direction\n" + "".join(f"{k},{k},0,0,Z\n" for k in range(1, 5))


def motion(seed: int, seconds: float) -> np.ndarray:
    """(sample, channel) accelerations of three modes under white forces."""
    rng = np.random.default_rng(seed)
    shapes, y = np.random.default_rng(9).standard_normal((4, 3)), 0.0
    for phi, s in zip(
        shapes.T, 2 * np.pi * F * (-ZETA + 1j * np.sqrt(1 - ZETA**2)), strict=True
    ):
        force, a = rng.standard_normal(int(seconds * RATE)), np.exp(s / RATE)
        z = lfilter([0, (a - 1) / s], [1, -a], force)
        y = y + np.outer(2 * np.real(s**2 / (2j * s.imag) * z) + force, phi)
    return np.asarray(y + 0.02 * rng.standard_normal(np.shape(y)))


def identified(
    folder: Path, records: list[dict[str, object]], choice: Choice | None = None
) -> tuple[list[IdentifiedRecord], list[RecordSummary]]:
    """Ambient records of a log, each a file of the folder."""
    (folder / "sensors.csv").write_text(SHEET)
    rows = [{"excitation": "wind", "rate_hz": RATE, **r} for r in records]
    log = {"tests": [{"name": "tower", "kind": "ambient", "records": rows}]}
    (folder / "log.json").write_text(json.dumps(log))
    listed, sensors = read_log(folder / "log.json")
    sheet = read_sensor_sheet(folder / "sensors.csv")
    campaign = Campaign(sheet, sensors, (), choice or Choice())
    found, shown, _ = ambient(listed, campaign, IdentifySection(), quiet)
    return found, shown


def test_files_that_count_on_are_one_record(tmp_path: Path) -> None:
    for k in range(3):
        np.save(tmp_path / f"tower_{k + 8}.npy", motion(k, 600 if k < 2 else 400))
    files: list[dict[str, object]] = [{"file": f"tower_{k + 8}.npy"} for k in range(3)]
    (one,), (shown,) = identified(tmp_path, files)
    alone, apart = identified(tmp_path, [r | {"setup": k} for k, r in enumerate(files)])
    assert len(alone) == 3
    assert not any("one record" in n for x in apart for n in x.notes)
    assert (one.record, shown.name, shown.duration) == ("tower_8", "tower_8", 1600)
    assert shown.notes[0].startswith(
        "3 files, tower_8.npy to tower_10.npy, are one record"
    )
    assert (np.abs(one.modes.frequencies - F) < 4 * one.uncertainty.frequency).all()
    least = np.min([r.uncertainty.frequency for r in alone], axis=0)
    assert (one.uncertainty.frequency < least).all()  # by the time of all files


def test_what_does_not_go_on_stays_apart(tmp_path: Path) -> None:
    names = ("a1", "a2", "a3", "b4", "a5")
    for k, name in enumerate(names):
        np.save(tmp_path / f"{name}.npy", motion(k, 500 if name != "a2" else 200))
    files: list[dict[str, object]] = [{"file": f"{n}.npy"} for n in names]
    assert [r.name for r in identified(tmp_path, files)[1]] == [
        "a1",
        "a2",
        "b4",
        "a5",
    ]  # too short; another name
    by_hand = Choice(rejects=(Reject(2.2, "a pump", "a3"),))
    found, _ = identified(tmp_path, [files[0], files[2], files[4]], by_hand)
    # a choice of its own; a5 goes on with it
    assert [len(r.modes) for r in found] == [3, 2]
    assert len(identified(tmp_path, [files[4], files[0]])[0]) == 2  # numbers that fall
    assert (
        len(identified(tmp_path, [files[0], files[2] | {"excitation": "crowd"}])[0])
        == 2
    )
