"""Outputs never replace an input: by what the files are, through links and other ways to them,
before any work.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import small_study
from typer.main import get_command

from ringtrue.cli.main import COMMANDS, OUTPUTS, application, run
from ringtrue.core.modes import ModeSet
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import DeckError, InputError
from ringtrue.io.files import atomic_write, one_run, reads, writes
from ringtrue.io.modes import write_modes
from ringtrue.model.edit import FieldChange
from ringtrue.study.run import run_study

QUICK = '[localise]\nkinds = ["material"]\n'


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.mark.parametrize("way", ["name", "link", "hard link", "folder link", "dots"])
def test_an_input_is_refused_as_target_whatever_leads_to_it(
    tmp_path: Path, way: str
) -> None:
    source = tmp_path / "in.json"
    source.write_text("kept")
    (tmp_path / "sub").mkdir()
    other = {"name": source, "dots": tmp_path / "sub/../in.json"}.get(
        way, tmp_path / "other.json"
    )
    if way == "link":
        other.symlink_to(source)
    elif way == "hard link":
        other.hardlink_to(source)
    elif way == "folder link":
        (tmp_path / "there").symlink_to(tmp_path)
        other = tmp_path / "there/in.json"
    with one_run():
        reads(source)
        with pytest.raises(
            InputError,
            match=r"an input of this run .*would be replaced|an input of this run would",
        ):
            writes(other)
        with (
            pytest.raises(InputError, match="name another file"),
            atomic_write(other) as part,
        ):
            part.write_text("lost")
    with one_run():  # announced first, read later
        writes(other)
        with pytest.raises(InputError, match="would be replaced"):
            reads(source)
    assert source.read_text() == "kept"


def test_what_a_run_has_written_and_what_is_gone_is_no_input(tmp_path: Path) -> None:
    target, scratch = tmp_path / "out.json", tmp_path / "scratch"
    with one_run():
        for text in ("1", "2"):  # a deck is written, read back and written again
            with atomic_write(target) as part:
                part.write_text(text)
            reads(target)
        scratch.write_text("of a solver")
        reads(scratch)
        # its inode is that of another file now
        os.replace(scratch, tmp_path / "new.json")
        writes(tmp_path / "new.json")
    # outside of a run, a script may change its own file
    with atomic_write(target) as part:
        part.write_text("3")
    assert target.read_text() == "3"


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A study, its deck with an INCLUDE, a record, modes: the inputs of commands."""
    small_study.write_study(tmp_path)
    text = (tmp_path / "deck/frame.bdf").read_text()
    head, bulk = text.split("BEGIN BULK\n")
    (tmp_path / "deck/parts.blk").write_text(bulk.replace("ENDDATA\n", ""))
    (tmp_path / "deck/frame.bdf").write_text(
        head + "BEGIN BULK\nINCLUDE 'parts.blk'\nENDDATA\n"
    )
    channels = small_study.test_model().channels
    shapes = np.random.default_rng(0).standard_normal((len(channels), 2))
    write_modes(
        tmp_path / "modes.json",
        ModeSet(np.array([2.0, 5.0]), np.zeros(2), shapes, channels),
    )
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        "oma data/ambient.h5 --json data/ambient.h5",
        "ema data/hammer-303pX.h5 --json data/hammer-303pX.h5",
        "check deck/frame.bdf --json deck/frame.bdf",
        "check deck/frame.bdf --json deck/parts.blk",
        "modes deck/frame.bdf --json ./deck/../deck/parts.blk",
        "convert modes.json modes.json",
        "correlate modes.json modes.json --json modes.json",
        "correlate deck/frame.bdf modes.json --sensors data/sensors.csv --json data/sensors.csv",
        "localise deck/frame.bdf modes.json --sensors data/sensors.csv --json data/sensors.csv",
        "update study.toml modes.json --json study.toml",
        "update study.toml modes.json --checkpoint modes.json",
        "update study.toml modes.json --out deck",
        "run study.toml --json data/campaign.json",
        "run study.toml --json data/ambient.h5",
        "run study.toml --json deck/parts.blk",
        "report study.h5 --out study.h5",
    ],
)
def test_no_command_replaces_what_it_reads(
    files: Path,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(files)
    (files / "study.h5").write_bytes(b"a store") if words.startswith("report") else None
    before = tree(files)
    assert run(words.split()) == 2
    assert "would be replaced" in " ".join(capsys.readouterr().err.split())
    after = tree(files)
    assert {n: after[n] for n in before} == before
    assert set(after) == set(before)


def test_every_option_that_writes_is_known_as_such() -> None:
    for name in COMMANDS:
        for parameter in get_command(application([name])).commands[name].params:
            told = str(getattr(parameter, "help", "") or "")
            if told.startswith(("Write", "What to write", "The HTML", "Keep")):
                assert OUTPUTS & set(parameter.opts), (name, parameter.opts)


@pytest.mark.parametrize("own", ["study.h5", "report.html", "summary.json"])
def test_a_study_whose_input_has_the_name_of_an_output_is_refused(
    files: Path, own: str
) -> None:
    toml = small_study.FULL.replace("data/sensors.csv", own)
    (files / "data/sensors.csv").rename(files / own)
    (files / "study.toml").write_text(toml)
    before = tree(files)
    with pytest.raises(InputError, match="would be replaced"):
        run_study(files / "study.toml")
    assert tree(files) == before


def test_a_second_round_writes_beside_the_first(tmp_path: Path) -> None:
    toml = small_study.FULL + QUICK
    study = small_study.write_study(tmp_path, toml, ambient=False)
    for at in ("deck/frame.bdf", "updated/frame.bdf", "updated-2/frame.bdf"):
        study.write_text(toml.replace("deck/frame.bdf", at))
        before = {n: b for n, b in tree(tmp_path).items() if n.endswith(".bdf")}
        done = run_study(study, until="final").results["final"]
        after = tree(tmp_path)
        assert {n: after[n] for n in before} == before, at
        number = {"deck": "updated", "updated": "updated-2", "updated-2": "updated-3"}[
            at.split("/")[0]
        ]
        assert [Path(f).parent.name for f in done.files] == [number]


def test_a_deck_that_cannot_be_copied_is_refused_before_any_work(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    deck = files / "deck/frame.bdf"
    deck.write_text(
        deck.read_text().replace("'parts.blk'", f"'{files / 'deck/parts.blk'}'")
    )
    before = tree(files)
    monkeypatch.chdir(files)
    told: list[str] = []
    with pytest.raises(DeckError, match="make the path of that INCLUDE relative"):
        run_study(files / "study.toml", progress=lambda _, text: told.append(text))
    assert not told
    assert tree(files) == before
    assert run(["update", "study.toml", "modes.json", "--out", "updated"]) == 2
    assert "make the path of that INCLUDE relative" in " ".join(
        capsys.readouterr().err.split()
    )
    with pytest.raises(DeckError):
        edit_fields(
            read_deck(deck), [FieldChange("MAT1", 1, "E", 1e11)], files / "copy"
        )
    assert tree(files) == before
    assert (
        run_study(files / "study.toml", until="correlate").results["correlate"]
        is not None
    )  # nothing is delivered


def test_a_deck_is_not_edited_into_its_own_folder(files: Path) -> None:
    before = tree(files / "deck")
    (files / "here").symlink_to(files / "deck")
    for folder in (files / "deck", files / "here"):
        with pytest.raises(InputError, match="would be replaced"):
            edit_fields(
                read_deck(files / "deck/frame.bdf"),
                [FieldChange("MAT1", 1, "E", 1e11)],
                folder,
            )
    assert tree(files / "deck") == before


KILLED = """
import os, sys
from pathlib import Path
from ringtrue.io.files import atomic_write
with atomic_write(Path(sys.argv[1])) as part:
    part.write_text("half")
    os.kill(os.getpid(), 9)
"""


def test_what_a_killed_process_leaves_is_swept_and_what_a_living_one_writes_is_not(
    tmp_path: Path,
) -> None:
    target = tmp_path / "out.json"
    subprocess.run([sys.executable, "-c", KILLED, str(target)], check=False)
    (left,) = tmp_path.glob(".*.part")
    shutil.copy(left, tmp_path / left.name.replace("out.json", "other.json"))
    mine = tmp_path / ".notes.part"
    mine.write_text("of the user")
    with atomic_write(tmp_path / "first.json") as outer:
        outer.write_text("1")
        with atomic_write(target) as part:
            part.write_text(json.dumps("whole"))
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        ".notes.part",
        "first.json",
        "out.json",
    ]
