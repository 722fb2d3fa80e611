"""Two runs do not share a study: the second is told; the lock of a process that is gone is none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import small_study

from ringtrue.cli.main import run
from ringtrue.errors import DataError
from ringtrue.study.run import run_study
from ringtrue.study.store import LOCK_FILE, locked

HOLDER = """
import sys
from pathlib import Path
from ringtrue.study.store import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""


def test_a_second_run_is_refused_by_name_until_the_first_is_gone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = small_study.write_study(tmp_path, small_study.MODEL)
    words = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "locked\n"
        with pytest.raises(
            DataError, match=f"process {first.pid} on .* runs this study"
        ):
            run_study(study)
        assert run(["run", str(study)]) == 2
        told = " ".join(capsys.readouterr().err.split())
        assert "wait for its end, or write elsewhere with --out" in told
        run_study(study, out=tmp_path / "elsewhere")
        assert not (tmp_path / "study.h5").exists()
        first.kill()
    assert (tmp_path / LOCK_FILE).exists()  # the file is left, its lock is not
    assert run_study(study).results["model"].dof > 0
    assert not (tmp_path / LOCK_FILE).exists()


def test_the_lock_goes_with_an_error_and_can_be_taken_again(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(KeyError), locked(tmp_path / "new"):
            raise KeyError
    assert not (tmp_path / "new").exists()
    with (
        locked(tmp_path),
        pytest.raises(DataError, match="runs this study"),
        locked(tmp_path),
    ):
        pass
