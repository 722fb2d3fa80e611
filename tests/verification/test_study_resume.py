"""A study that is resumed at any stage gives what one that runs through gives, to the last bit.

Each stage is run anew on the stored results of those before it, in a process's fresh session;
were one of them to rest on anything that is in memory alone, such as a basis that an earlier stage
has enriched, its bytes would differ.
"""

from __future__ import annotations

import sys
from pathlib import Path

import h5py
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
import small_study
from test_study_configurations import LOADED, PLAIN, folder

from ringtrue.study.run import run_study
from ringtrue.study.store import Store, digest

# without fmax the modes of the deck are solved up to one frequency for the plan and up to another
# for the test
OPEN = small_study.FULL.replace(f"fmax = {small_study.FMAX}\n", "", 1)
QUICK = '[localise]\nkinds = ["material"]\n'
PLANNED = OPEN.replace("[model]", "[plan]\nfmax = 14.0\nsensors = 6\n[model]") + QUICK
RIGID = (
    small_study.MODEL
    + small_study.TEST
    + small_study.SETTINGS.replace("[identify]", "[identify]\nconfidence = 0.4")
)
SUSPENDED = (
    RIGID + small_study.candidates((2, 3)) + "[correlate]\nrigid_below = 3.0\n" + QUICK
)
SUSPENDED += '[[suspension]]\nname = "lowest storey"\ntargets = ["MAT1 1 E"]\n[uncertainty]\nsamples = 40\n'
JOINT = PLAIN + LOADED + "\n[uncertainty]\nfolds = 3\n"


def digests(store: Path) -> dict[str, str]:
    """What each stage holds, from the bytes of the file; provenance has dates."""
    with h5py.File(store) as file:
        return {name: digest(file[name]) for name in file if name != "provenance"}


def made(kind: str, at: Path) -> Path:
    if kind == "configurations":
        return folder(at, JOINT)
    return small_study.write_study(
        at, {"planned": PLANNED, "suspended": SUSPENDED}[kind]
    )


@pytest.mark.parametrize("kind", ["planned", "suspended", "configurations"])
def test_every_stage_gives_the_same_bits_from_the_stored_results(
    tmp_path: Path, kind: str
) -> None:
    study = made(kind, tmp_path)
    through = run_study(study)
    store = study.with_name("study.h5")
    fresh = digests(store)
    assert set(fresh) == set(through.timings)
    for stage in fresh:
        again = run_study(study, first=stage, until=stage)
        assert stage not in again.loaded
        assert digests(store) == fresh, stage


def test_timings_of_earlier_stages_are_kept(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, small_study.FULL + QUICK)
    first = run_study(study)
    store = Store(study.with_name("study.h5"))
    assert set(first.timings) == set(first.results) - {"provenance"}
    # as after a kill, which leaves no provenance of the run
    store.save("provenance", "", None)
    resumed = run_study(study, first="uncertainty")
    assert list(resumed.timings) == list(first.timings)
    rerun = {"uncertainty", "damping"}
    assert {n for n, s in resumed.timings.items() if s != first.timings[n]} == rerun
