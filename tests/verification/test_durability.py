"""A study survives a fault at its writes and a flipped bit in its store; see `durable` for both.

The faults follow one another in one folder, each run going on with what the one before has left:
a full disk, a kill before, half-way or after, one at each third write. `bench/durability.py` has
all of them at every write, begins anew for each, and resumes each to the end.
"""

from __future__ import annotations

import os
import re
import sys
from itertools import cycle
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
import durable

from ringtrue.errors import DataError
from ringtrue.study.run import load_study, run_study
from ringtrue.study.store import Store

pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="the faults need forked processes"
)

FLIPS = 8


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("durable")
    durable.write_inputs(root / "inputs")
    return root


@pytest.fixture(scope="module")
def fresh(home: Path) -> tuple[list[durable.Write], dict[str, object]]:
    """The writes of an undisturbed run, and what it leaves."""
    durable.copied(home / "inputs", home / "study")
    study = home / "study/study.toml"
    writes = durable.writes_of(study)
    assert durable.leftovers(study.parent) == []
    durable.copied(home / "study", home / "done")
    return writes, durable.results(study)


def test_a_fault_at_a_write_leaves_whole_stages_and_the_end_is_the_same(
    home: Path, fresh: tuple[list[durable.Write], dict[str, object]]
) -> None:
    writes, wanted = fresh
    study = home / "study/study.toml"
    durable.copied(home / "inputs", study.parent)
    kinds = cycle((durable.FULL, "before", "half", "after"))
    for write, how in zip(writes[::3], kinds, strict=False):
        assert durable.struck(study, write, how) == durable.expected(how), (write, how)
        assert durable.stored(study).items() <= wanted.items(), (write, how)
        parts = [
            name for name in durable.leftovers(study.parent) if name.endswith(".part")
        ]
        # those of kills before are swept
        assert len(parts) == (how in ("before", "half")), (write, how)
    assert durable.forked(lambda: durable.whole_run(study)) == 0
    assert durable.results(study) == wanted
    assert durable.leftovers(study.parent) == []


def test_no_flipped_bit_is_in_a_result_that_is_read(home: Path, fresh: object) -> None:
    path = home / "done/study.h5"
    image, right = path.read_bytes(), durable.read_anew(path)
    refused = 0
    for bit in (
        np.random.default_rng(1).choice(8 * len(image), FLIPS, replace=False).tolist()
    ):
        path.write_bytes(durable.flipped(image, bit))
        found = durable.read_anew(path)
        wrong = [
            n
            for n, what in found.items()
            if what != right.get(n) and not what.startswith("refused: ")
        ]
        assert wrong == [], bit
        refused += any(what.startswith("refused: ") for what in found.values())
    path.write_bytes(image)
    assert refused > FLIPS / 4


@pytest.mark.parametrize("stage", ["model", "correlate", "update"])
def test_a_damaged_stage_is_named_and_run_anew(
    home: Path,
    fresh: tuple[object, dict[str, object]],
    stage: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    durable.copied(home / "done", home / "study")  # decks are named by where they are
    study = home / "study/study.toml"
    path = study.with_name("study.h5")
    with h5py.File(path) as file:
        name, at = _somewhere(file[stage])
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(bytes(data))
    with pytest.raises(
        DataError, match=rf"stage '{stage}' is damaged .*run the study again"
    ):
        Store(path).load(stage)
    with pytest.raises(DataError, match=rf"stage '{stage}' is damaged"):
        load_study(path)
    run = run_study(study)
    assert stage not in run.loaded, name
    assert re.search(rf"run anew: .*stage '{stage}' is damaged", caplog.text)
    wanted = fresh[1]
    assert durable.stored(study).items() <= wanted.items()
    assert len(durable.stored(study)) == len(durable.stored(home / "done/study.toml"))


def test_a_value_that_is_changed_with_its_checksum_is_seen_by_the_digest(
    home: Path, fresh: object
) -> None:
    durable.copied(home / "done", home / "study")
    path = home / "study/study.h5"
    with h5py.File(path, "a") as file:
        mac = file["final/table/pairing/mac"]
        mac[0] = 1e-3
    with pytest.raises(DataError, match=r"stage 'final' is damaged .*its digest says"):
        Store(path).load("final")


def test_every_data_set_has_its_checksum(home: Path, fresh: object) -> None:
    lacking = []

    def look(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.size and not item.fletcher32:
            lacking.append(name)
        if isinstance(item, h5py.Dataset):
            text = h5py.check_string_dtype(item.dtype)
            # no heap, which has no checksum
            assert text is None or text.length is not None, name

    with h5py.File(home / "done/study.h5") as file:
        file.visititems(look)
    assert lacking == []


def _somewhere(group: h5py.Group) -> tuple[str, int]:
    """A data set of a stage and a place in the file that holds its bytes."""
    found: list[tuple[str, int]] = []

    def look(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.chunks:
            chunk = item.id.get_chunk_info(0)
            found.append((name, chunk.byte_offset + chunk.size // 2))

    group.visititems(look)
    return found[len(found) // 2]
