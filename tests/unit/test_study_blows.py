"""Records of hammers and shakers as a laboratory hands them over, the blows of a point in one
universal file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_study
from record_files import write_history

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.io.records import read_record
from ringtrue.study.hammer_records import rejected_hits
from ringtrue.study.run import run_study
from ringtrue.study.stages.identify import IdentifyStage
from ringtrue.virtual.sensors import simulate

STUDY = small_study.TEST + "[identify]\nhammer_fmin = 1.0\nhammer_fmax = 20.0\n"


def in_universal_files(folder: Path) -> None:
    """Each blow an acquisition of its own; the hammer's name tells no point, the log does, and
    nothing of blocks.
    """
    log = json.loads((folder / "campaign.json").read_text())
    (test,) = log["tests"]
    for record in test["records"]:
        blows, parts = read_record(folder / record["file"]), []
        force, *motions = blows.channels
        for k in range(small_study.HITS):
            data = blows.data[:, k * small_study.BLOCK : (k + 1) * small_study.BLOCK]
            one = folder / "one.uff"
            write_history(
                one,
                replace(
                    blows, data=data, channels=(replace(force, id="hammer"), *motions)
                ),
            )
            parts.append(one.read_bytes())
        record["file"] = str(Path(record["file"]).with_suffix(".uff"))
        del record["setup"]
        (folder / record["file"]).write_bytes(b"".join(parts))
    del test["block_samples"], test["pretrigger_samples"]
    (folder / "campaign.json").write_text(json.dumps(log))


def identified(study: Path) -> IdentifyStage:
    return run_study(study, until="identify").results["identify"]


def in_volts(folder: Path) -> None:
    """Tables of volts without units; the sensitivities, unlike for each channel, stand on the sheet
    alone.
    """
    log = json.loads((folder / "campaign.json").read_text())
    rows = [
        line.split(",") for line in (folder / "sensors.csv").read_text().splitlines()
    ]
    at = {
        name: rows[0].index(name)
        for name in ("channel", "quantity", "unit", "sensitivity")
    }
    gain = {
        r[at["channel"]]: 0.01 * (1 + 0.5 * (-1) ** k) for k, r in enumerate(rows[1:])
    }
    for record in log["tests"][0]["records"]:
        blows = read_record(folder / record["file"])
        record["file"] = str(Path(record["file"]).with_suffix(".csv"))
        data = [
            x * gain.get(c.id, 0.002)
            for x, c in zip(blows.data, blows.channels, strict=True)
        ]
        bare = tuple(
            Channel(c.id, unit="V" if k % 2 else "")
            for k, c in enumerate(blows.channels)
        )
        write_history(
            folder / record["file"], replace(blows, data=np.array(data), channels=bare)
        )
    for row in rows[1:]:
        row[at["unit"]], row[at["sensitivity"]] = (
            "g",
            str(gain[row[at["channel"]]] * 9.80665),
        )
    for r in small_study.REFERENCES:
        row = dict.fromkeys(rows[0], "") | {
            "point": r[:-2],
            "direction": r[-2:],
            "channel": f"F:{r}",
        }
        rows.append(
            list(
                (
                    row | {"quantity": "force", "unit": "N", "sensitivity": "0.002"}
                ).values()
            )
        )
    (folder / "sensors.csv").write_text("\n".join(",".join(r) for r in rows))
    (folder / "campaign.json").write_text(json.dumps(log))


def test_the_sheet_scales_records_in_volts(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, STUDY, ambient=False)
    given = identified(study)
    in_volts(tmp_path / "data")
    found = identified(study)
    assert found.frfs is not None
    assert given.frfs is not None
    assert found.test.channels == given.test.channels
    np.testing.assert_allclose(
        found.frfs.data,
        given.frfs.data,
        rtol=1e-3,
        atol=1e-5 * np.abs(given.frfs.data).max(),
    )
    assert "without a unit taken as the sensor sheet says" in " ".join(
        found.records[0].notes
    )


def test_acquisitions_of_one_blow_each_are_read(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, STUDY, ambient=False)
    blocks = identified(study)
    in_universal_files(tmp_path / "data")
    found = identified(study)
    assert found.hammer is not None
    assert blocks.hammer is not None
    assert [c.id for c in found.frfs.inputs] == list(small_study.REFERENCES)
    np.testing.assert_allclose(
        found.hammer.modes.frequencies, blocks.hammer.modes.frequencies, rtol=1e-3
    )
    assert all(r.hits == (small_study.HITS, small_study.HITS) for r in found.records)
    assert found.records[0].duration == pytest.approx(
        small_study.HITS * small_study.BLOCK / small_study.RATE
    )


def test_a_hit_is_left_out_by_hand(tmp_path: Path) -> None:
    study = small_study.write_study(
        tmp_path, STUDY + 'choice = "choice.toml"\n', ambient=False
    )
    name = "hammer-303pX"
    entry = (
        f'[[hit]]\nrecord = "{name}"\ntime = 20.27\nkeep = false\nreason = "two taps"\n'
    )
    (tmp_path / "choice.toml").write_text(entry)
    found = identified(study)
    assert [h.accepted for h in found.hits if h.source == name] == [True, False, True]
    assert [r.hits for r in found.records] == [(2, 3), (3, 3)]
    assert found.frfs.averages.tolist() == [2.0, 3.0]
    assert "left out by hand: two taps" in rejected_hits(found.hits)[0]
    assert found.hammer is not None
    assert "confirmed by hand" not in found.hammer.reasons[0]
    (tmp_path / "choice.toml").write_text(entry.replace("pX", "pZ"))
    with pytest.raises(
        ConfigError, match="hammer-303pZ': no such record with a hammer"
    ):
        identified(study)


def test_records_of_a_few_seconds_are_shown(tmp_path: Path) -> None:
    """One blow a record is shorter than the resolution that the spectra of long records have."""
    study = small_study.write_study(tmp_path, STUDY, ambient=False)
    path = tmp_path / "data/campaign.json"
    log = json.loads(path.read_text())
    (test,) = log["tests"]
    for record in test["records"]:
        file = tmp_path / "data" / record["file"]
        blow = read_record(file)
        write_history(file, replace(blow, data=blow.data[:, : round(12 * blow.rate)]))
    del test["block_samples"], test["pretrigger_samples"]
    path.write_text(json.dumps(log))
    for shown in identified(study).records:
        assert shown.duration == pytest.approx(12.0)
        assert shown.preview.psd.size
        assert np.isfinite(shown.preview.psd).all()


def shaken(folder: Path, kind: str) -> None:
    """In place of the blows two shakers that run together, at random."""
    rng = np.random.default_rng(8)
    model = small_study.modal(folder, small_study.test_model())
    forces = rng.normal(0, 10.0, (2, int(300 * small_study.RATE)))
    loads = np.zeros((len(model.inputs), forces.shape[1]))
    loads[[[c.id for c in model.inputs].index(r) for r in small_study.REFERENCES]] = (
        forces
    )
    motion = simulate(model, loads, small_study.RATE)[:, : forces.shape[1]]
    motion += rng.normal(0, 0.01 * motion.std(), motion.shape)
    names = [Channel(f"F:{r}", "force", "N") for r in small_study.REFERENCES]
    history = TimeHistory(
        np.vstack([forces, motion]), small_study.RATE, (*names, *model.outputs)
    )
    write_history(folder / "shaken.uff", history)
    record = {"file": "shaken.uff", "excitation": "shaker"}
    log = {"tests": [{"name": "shakers", "kind": kind, "records": [record]}]}
    (folder / "campaign.json").write_text(json.dumps(log))


@pytest.mark.parametrize("kind", ["hammer", "shaker"])
def test_shakers_that_run_together(tmp_path: Path, kind: str) -> None:
    study = small_study.write_study(tmp_path, STUDY, ambient=False)
    blows = identified(study).hammer.modes
    shaken(tmp_path / "data", kind)
    found = identified(study)
    assert blows is not None
    assert found.hammer is not None
    assert [c.id for c in found.frfs.inputs] == list(small_study.REFERENCES)
    np.testing.assert_allclose(
        found.hammer.modes.frequencies, blows.frequencies, rtol=1e-3
    )
    np.testing.assert_allclose(
        found.hammer.modes.damping, small_study.DAMPING, rtol=0.1
    )  # noise of 1 %
    assert any("the force runs all the time" in note for note in found.records[0].notes)
    assert found.source == f"{kind} test"


def without_names(study: Path, names: Callable[[list[str]], list[str]]) -> list[str]:
    """The ambient record as `.npy`, which has neither names nor rate; the log tells them."""
    folder = study.parent / "data"
    record = read_record(folder / "ambient.h5")
    np.save(
        folder / "ambient.npy",
        np.vstack([record.data, np.zeros((1, record.data.shape[1]))]).T,
    )  # one is not used
    log = json.loads((folder / "campaign.json").read_text())
    (entry,) = log["tests"][0]["records"]
    ids = [c.id for c in record.channels]
    entry |= {
        "file": "ambient.npy",
        "rate_hz": record.rate,
        "channels": names([*ids, ""]),
    }
    (folder / "campaign.json").write_text(json.dumps(log))
    return ids


def test_the_log_names_the_channels_of_files_without_names(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, STUDY, hammer=False)
    told = identified(study).ambient.modes
    ids = without_names(study, lambda names: names)
    found = identified(study).ambient.modes
    assert list(found.channels) == ids
    np.testing.assert_allclose(
        found.frequencies, told.frequencies, rtol=2e-3
    )  # the unit is not known: other weights


def test_a_file_without_names_has_those_of_the_sheet(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, STUDY, hammer=False)
    ids = without_names(study, lambda names: names)
    np.save(
        tmp_path / "data/ambient.npy", np.load(tmp_path / "data/ambient.npy")[:, :-1]
    )
    log = json.loads((tmp_path / "data/campaign.json").read_text())
    del log["tests"][0]["records"][0]["channels"]
    (tmp_path / "data/campaign.json").write_text(json.dumps(log))
    found = identified(study)
    assert list(found.ambient.modes.channels) == ids
    assert "the motions of the sensor sheet in its order" in found.records[0].notes[0]


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (lambda names: names[:-1], "`channels` must name all"),
        (lambda names: [names[1], *names[1:]], r"`channels` names 101\+Y twice"),
    ],
)
def test_wrong_names_in_the_log_are_refused(
    tmp_path: Path, names: Callable[[list[str]], list[str]], told: str
) -> None:
    study = small_study.write_study(tmp_path, STUDY, hammer=False)
    without_names(study, names)
    with pytest.raises(DataError, match=told):
        identified(study)
