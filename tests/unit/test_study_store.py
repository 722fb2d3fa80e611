"""The store of a study: whole or not at all; and the driver reruns exactly what an input
changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from errno import ENOSPC
from pathlib import Path

import h5py
import numpy as np
import pytest
import small_study

from ringtrue.cli.main import run
from ringtrue.errors import ConfigError, DataError
from ringtrue.io import hdf5
from ringtrue.study.run import StudyRun, load_study, run_study
from ringtrue.study.stages import STAGES, Stage
from ringtrue.study.store import Store, digest

AFTER = {"final", "uncertainty", "damping"}
ALL = (
    "model",
    "identify",
    "compare",
    "conditions",
    "correlate",
    "localise",
    "sensitivity",
    "update",
    *sorted(AFTER),
)


def held(store: Store, stage: str) -> list[float]:
    return list(np.asarray(store.load(stage)))


def test_an_error_while_saving_keeps_the_last_good_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "study.h5")
    store.save("model", "k1", np.array([1.0, 2.0]))
    before = store.path.read_bytes()
    real = hdf5.save

    def half(group: h5py.Group, obj: object) -> None:
        real(group, obj)
        raise KeyboardInterrupt

    monkeypatch.setattr(hdf5, "save", half)
    with pytest.raises(KeyboardInterrupt):
        store.save("model", "k2", np.array([3.0]))
    assert store.path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["study.h5"]
    monkeypatch.setattr(hdf5, "save", real)
    store.save("plan", "k2", np.array([3.0]))
    assert (held(store, "model"), held(store, "plan"), store.key("model")) == (
        [1.0, 2.0],
        [3.0],
        "k1",
    )


def test_a_full_disk_keeps_the_last_good_store_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path / "study.h5")
    store.save("model", "k1", np.array([1.0, 2.0]))
    before = store.path.read_bytes()

    def full(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        store.save("model", "k2", np.array([3.0]))
    assert store.path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["study.h5"]
    monkeypatch.setattr(
        "ringtrue.cli.main.application",
        lambda _: store.save("model", "k2", np.array([3.0])),
    )
    assert run([]) == 1
    assert "what is stored is whole" in capsys.readouterr().err


def test_large_arrays_are_stored_small_and_come_back_the_same(tmp_path: Path) -> None:
    store = Store(tmp_path / "study.h5")
    triangles = np.arange(60_000, dtype=np.int64).reshape(-1, 3) // 3
    store.save("model", "k", triangles)
    assert store.path.stat().st_size < 0.1 * triangles.nbytes
    np.testing.assert_array_equal(np.asarray(store.load("model")), triangles)


def test_stages_that_went_stale_leave_with_the_new_one(tmp_path: Path) -> None:
    store = Store(tmp_path / "deep" / "study.h5")
    for name in ("model", "correlate", "update"):
        store.save(name, "1", np.array([1.0]))
    store.save("model", "2", np.array([2.0]), drop={"correlate", "update"})
    assert store.stages() == ("model",)
    assert (store.key("model"), store.key("update")) == ("2", None)


def test_a_store_that_is_lost_or_broken_is_named(tmp_path: Path) -> None:
    store = Store(tmp_path / "study.h5")
    assert (store.key("model"), store.stages()) == (None, ())
    with pytest.raises(DataError, match="no such store; run the study first"):
        store.load("model")
    store.path.write_bytes(b"not HDF5")
    with pytest.raises(DataError, match=r"study\.h5: not a readable store"):
        store.key("model")
    store.path.unlink()
    store.save("model", "1", 3.0)
    with pytest.raises(
        DataError, match="stage 'update' is not in the store; it holds model"
    ):
        store.load("update")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    study = small_study.write_study(tmp_path_factory.mktemp("resume"))
    assert run_study(study).loaded == ()
    return study


def rerun(run: StudyRun) -> set[str]:
    return {*ALL} - {*run.loaded}


def test_a_second_run_computes_nothing_and_from_reruns_the_rest(finished: Path) -> None:
    assert rerun(run_study(finished)) == set()
    assert rerun(run_study(finished, first="update")) == {"update"} | AFTER
    assert (
        rerun(run_study(finished, first="compare", until="compare"))
        & {"identify", "model"}
        == set()
    )


def test_a_setting_reruns_exactly_the_stages_that_depend_on_it(finished: Path) -> None:
    text = finished.read_text()
    finished.write_text(
        text.replace("left_out = 2", "left_out = 2\nshape_weight = 0.2")
    )
    assert rerun(run_study(finished)) == {"localise", "sensitivity", "update"} | AFTER
    finished.write_text(text.replace("left_out = 2", "left_out = 1"))
    assert rerun(run_study(finished, until="correlate")) >= {"correlate"}
    finished.write_text(text)
    run_study(finished)
    finished.write_text(
        text.replace("left_out = 2", 'left_out = 2\n[study]\ntitle = "Another"')
    )
    assert rerun(run_study(finished)) == set()  # a title is no input
    assert load_study(finished.with_name("study.h5")).config.study.title == "Another"


def test_a_changed_input_file_reruns_what_reads_it(finished: Path) -> None:
    run_study(finished)
    deck = finished.parent / "deck/frame.bdf"
    deck.write_text(deck.read_text().replace("2500.0", "2501.0"))
    assert (
        rerun(run_study(finished))
        == {"model", "correlate", "localise", "sensitivity", "update"} | AFTER
    )
    sheet = finished.parent / "data/sensors.csv"
    sheet.write_text(sheet.read_text() + "\n")
    assert rerun(run_study(finished)) == {*ALL} - {"model"}


def test_files_that_are_edited_while_a_study_runs_count_as_it_has_read_them(
    finished: Path,
) -> None:
    run_study(finished)
    deck, text = finished.parent / "deck/frame.bdf", finished.read_text()
    before = deck.read_text()

    def edit(_done: float, title: str) -> None:
        if title == "model against test":
            deck.write_text(before.replace("ENDDATA", "$ edited\nENDDATA"))
            finished.write_text(text.replace("left_out = 2", "left_out = 1"))

    run_study(finished, first="correlate", progress=edit)
    assert load_study(finished.with_name("study.h5")).config.update.left_out == 2
    assert {"model", "correlate", "update"} <= rerun(
        run_study(finished)
    )  # it was of the other deck


def test_a_stopped_run_can_be_reported_and_resumes(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = next(s for s in STAGES if s.name == "sensitivity")

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    out = finished.parent / "stopped"
    monkeypatch.setattr(
        "ringtrue.study.run.STAGES",
        tuple(_with_run(s, stop) if s is stage else s for s in STAGES),
    )
    with pytest.raises(KeyboardInterrupt):
        run_study(finished, out=out)
    monkeypatch.undo()
    partial = load_study(out / "study.h5")
    assert set(partial.results) == {
        "model",
        "identify",
        "compare",
        "conditions",
        "correlate",
        "localise",
        "provenance",
    }
    assert [p.name for p in out.iterdir()] == ["study.h5"]
    assert rerun(run_study(finished, out=out)) == {"sensitivity", "update"} | AFTER


def _with_run(stage: Stage, run: Callable[..., None]) -> Stage:
    return replace(stage, run=run)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"first": "updat"}, "no stage 'updat'; did you mean 'update'?"),
        ({"until": "end"}, "no stage 'end'; Allowed: compare"),
        (
            {"first": "update", "until": "model"},
            "--from update comes after --until model",
        ),
        (
            {"first": "tune"},
            r"stage 'tune' does not apply: the study has no section suspension",
        ),
    ],
)
def test_a_stage_that_cannot_be_run_is_refused(
    finished: Path, options: dict[str, str], told: str
) -> None:
    with pytest.raises(ConfigError, match=told):
        run_study(finished, **options)  # type: ignore[arg-type]


def test_a_stage_that_another_version_has_stored_is_run_anew_and_named_for_a_report(
    finished: Path,
) -> None:
    run_study(finished)
    path = finished.with_name("study.h5")
    with h5py.File(path, "a") as f:
        f["correlate"].attrs["class"] = "ringtrue.study.results:OfAnotherVersion"
        f["correlate"].attrs["digest"] = digest(f["correlate"])
    with pytest.raises(
        DataError,
        match=r"stage 'correlate': .*which this version does not have; run the study again",
    ):
        load_study(path)
    assert (
        rerun(run_study(finished))
        == {"correlate", "localise", "sensitivity", "update"} | AFTER
    )
    load_study(path)
