"""A study on two workers is the study of one process, to the last bit.

The small frame with two further configurations, whose tests are read side by side, and three
parameter sets, which are updated side by side.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest
from test_study_configurations import LOADED, OWN, PLAIN, folder

from ringtrue.study.run import run_study
from ringtrue.study.store import DIGEST, Store

AGAIN = OWN.replace('"loaded"', '"loaded again"')
SETS = """
[[set]]
name = "density alone"
candidates = ["density"]

[[set]]
name = "shapes count less"
shape_weight = 0.5
"""


def digests(store: Path) -> dict[str, str]:
    """SHA-256 of all that each stage holds."""
    with h5py.File(store) as file:
        return {name: file[name].attrs[DIGEST] for name in file if name != "provenance"}


def test_all_stages_are_those_of_one_process(tmp_path: Path) -> None:
    study = folder(tmp_path, PLAIN + LOADED + AGAIN + SETS)
    shown: list[str] = []
    run_study(study, until="update", progress=lambda _, text: shown.append(text))
    assert not any("side by side" in text for text in shown)
    store = tmp_path / "study.h5"
    alone = digests(store)
    store.unlink()

    def stop(fraction: float, text: str) -> None:
        shown.append(text)
        if text == "done: updating: density alone":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, until="update", workers=2, progress=stop)
    where = "side by side on 2 workers: "
    assert f"{where}configuration loaded, configuration loaded again" in shown
    assert any(text.startswith(f"{where}updating: best subset") for text in shown)
    assert len(Store(tmp_path / "update.sets.h5").stages()) == 2  # finished, and kept
    study.write_text(f"[study]\nworkers = 2\n{study.read_text()}")
    again = run_study(study, until="update")
    assert "configurations" in again.loaded
    assert digests(store) == alone
