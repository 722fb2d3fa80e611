"""A choice by hand: stored, replayed, refused where it is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import small_study
from test_cli import Capture, call, frf, parsed, record, refused

from ringtrue.core.choice import Choice, Hit, Merge, Pick, Reject
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.common.manual_selection import as_choice, match
from ringtrue.identification.frf.pipeline import (
    HammerModes,
    HammerResult,
    identify_hammer,
)
from ringtrue.io.choices import read_choice, write_choice
from ringtrue.io.frfs import read_frfs
from ringtrue.study.config import read_config
from ringtrue.study.session import Session
from ringtrue.study.stages import identify as stage
from ringtrue.study.store import Store

__all__ = ("frf", "record")  # fixtures

EVERYTHING = Choice(
    (Pick(2.5, 40, "tower", 'a "quoted" note'), Pick(3.0)),
    (Reject(4.0, "crane", "tower"),),
    (Merge((5.0, 5.1), "one mode"),),
    automatic=False,
    hits=(
        Hit("impacts", 3.25, False, "the cable was touched"),
        Hit("impacts #2", 0.1, True, "?"),
    ),
)


@pytest.mark.parametrize("name", ["c.toml", "c.json"])
def test_what_is_written_is_read(tmp_path: Path, name: str) -> None:
    write_choice(tmp_path / name, EVERYTHING)
    back = read_choice(tmp_path / name)
    assert (back.picks, back.rejects, back.merges, back.hits) == (
        EVERYTHING.picks,
        EVERYTHING.rejects,
        EVERYTHING.merges,
        EVERYTHING.hits,
    )
    assert not back.automatic
    assert back.source == str(tmp_path / name)


def test_entries_of_a_record() -> None:
    mine = EVERYTHING.of("tower")
    assert mine is not None
    assert (len(mine.picks), len(mine.rejects), len(mine.merges)) == (2, 1, 1)
    other = EVERYTHING.of("bridge")
    assert other is not None
    assert (len(other.picks), len(other.rejects)) == (1, 0)
    assert EVERYTHING.records == ("tower",)
    assert Choice((Pick(2.0, record="tower"),)).of("bridge") is None
    assert Choice(hits=EVERYTHING.hits).of("impacts") is None  # its modes are automatic


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[[pik]]\nfrequency = 1", "unknown key 'pik'; did you mean 'pick'?"),
        (
            "[[pick]]\nfrequenzy = 1",
            "pick 1: unknown key 'frequenzy'; did you mean 'frequency'?",
        ),
        ("[[pick]]\norder = 3", "pick 1: frequency missing"),
        ("[[pick]]\nfrequency = 'two'", "frequency is 'two'; it must be a number, Hz"),
        ("[[pick]]\nfrequency = -2", "must be positive"),
        ("[[pick]]\nfrequency = nan", "must be positive"),
        (
            "[[pick]]\nfrequency = 2\norder = 2.5",
            "order is 2.5; it must be a whole number",
        ),
        ("[[pick]]\nfrequency = 2\norder = -2", "order -2 must be 1 or more"),
        ("[[reject]]\nfrequency = 2", "reject 1: reason missing"),
        ("[[reject]]\nfrequency = 2\nreason = ' '", "needs a reason"),
        ("[[merge]]\nfrequencies = [2]", "two frequencies or more"),
        ("[[merge]]\nfrequencies = 2", "must be a list of numbers"),
        ("pick = 3", "pick must be a list"),
        (
            "[[hit]]\nrecord = 'a'\ntime = 2.0\nkeep = 1",
            "keep is 1; it must be true or false",
        ),
        ("[[hit]]\nrecord = 'a'\ntime = 2.0\nkeep = true", "hit 1: reason missing"),
        (
            "[[hit]]\nrecord = ''\ntime = 2.0\nkeep = true\nreason = 'x'",
            "name of its record",
        ),
        (
            "[[hit]]\nrecord = 'a'\ntime = -2.0\nkeep = true\nreason = 'x'",
            "must be 0 or more",
        ),
        ("automatic = 'yes'", "it must be true or false"),
        ("[[pick", "not TOML"),
    ],
)
def test_a_wrong_choice_is_refused(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"c\.toml") as e:
        read_choice(tmp_path / "c.toml")
    assert told in str(e.value)


def test_frequencies_are_matched_one_to_one() -> None:
    there = np.array([2.0, 5.0, 5.02, 9.0])
    np.testing.assert_array_equal(
        match(np.array([5.019, 5.001, 2.1]), there), [2, 1, -1]
    )
    np.testing.assert_array_equal(
        match(np.array([5.009]), there, np.array([0.0, 1.0, 0.0, 0.0])), [2]
    )


# --- FRFs


def _identified(path: Path, choice: Choice | None = None) -> HammerResult:
    return identify_hammer(read_frfs(path), HammerModes(fmin=2, fmax=35), choice=choice)


def test_frfs_by_hand(frf: Callable[..., Path]) -> None:
    path = frf()
    auto = _identified(path)
    same = _identified(path, as_choice(auto.modes))
    np.testing.assert_array_equal(same.modes.frequencies, auto.modes.frequencies)
    assert all(r.startswith("confirmed by hand; ") for r in same.reasons)
    less = _identified(
        path, Choice(rejects=(Reject(15.0, "a pump"), Reject(20.0, "nothing")))
    )
    assert less.modes.frequencies == pytest.approx([8.0, 27.0], rel=2e-3)
    assert less.notes == (
        f"mode at {auto.modes.frequencies[1]:.5g} Hz rejected by hand: a pump",
        "rejected by hand, but not there: a mode at 20 Hz",
    )
    # a pole of the diagram comes back with the numbers and the standard deviations of the automatic
    # mode
    d = auto.diagrams[-1].poles
    k = int(np.argmin(np.abs(d.frequencies - 27.0)))
    pick = Pick(float(d.frequencies[k]), int(d.order[k]))
    back = _identified(path, Choice((Pick(8.0), Pick(15.0), pick), automatic=False))
    assert back.modes.frequencies == pytest.approx(auto.modes.frequencies, rel=1e-6)
    assert back.uncertainty.frequency == pytest.approx(
        auto.uncertainty.frequency, rel=1e-3
    )
    assert back.uncertainty.shape == pytest.approx(
        auto.uncertainty.shape, rel=1e-2, abs=1e-9
    )
    assert back.reasons[2].startswith(f"chosen by hand, order {pick.order}; ")
    with pytest.raises(DataError, match="pick at 20 Hz"):
        _identified(path, Choice((Pick(20.0, 5),)))


def test_merged_modes_of_frfs(frf: Callable[..., Path]) -> None:
    """A close pair made one by hand: one mode stays, and says so."""
    f = np.arange(1.0, 40.0, 0.05)
    w, rng = 2 * np.pi * f, np.random.default_rng(4)
    shapes = np.array([[1.0, 0.4], [0.6, -0.9], [0.9, 0.3], [0.2, 0.8]])
    gain = -(w**2) / (
        (2 * np.pi * np.array([[15.0], [15.4]])) ** 2
        - w**2
        + 2j * 0.01 * 2 * np.pi * 15.2 * w
    )
    h = np.einsum("om,mf,im->iof", shapes, gain, shapes[:2])
    h = h + 1e-3 * np.abs(h).mean() * (
        rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape)
    )
    path = frf(freq=f, H1=h)
    assert _identified(path).modes.frequencies == pytest.approx([15.0, 15.4], rel=1e-3)
    one = _identified(path, Choice(merges=(Merge((15.0, 15.4), "a pair of hangers"),)))
    assert len(one.modes) == 1
    assert one.reasons[0].startswith(
        "merged by hand from 15, 15.4 Hz (a pair of hangers); "
    )


# --- commands


def test_oma_writes_and_replays(
    record: Callable[..., Path], tmp_path: Path, capsys: Capture
) -> None:
    words = ("oma", record(), "--rate", 64, "--fmin", 3, "--fmax", 10)
    page = tmp_path / "d.html"
    auto = parsed(
        capsys, *words, "--write-choice", tmp_path / "c.toml", "--diagram", page
    )
    again = parsed(capsys, *words, "--choice", tmp_path / "c.toml")
    for a, b in zip(auto["modes"], again["modes"], strict=True):
        assert a["frequency_hz"] == b["frequency_hz"]
        assert a["shape_re"] == b["shape_re"]
        assert b["reason"] == "confirmed by hand; " + a["reason"]
    assert "figure-0" in page.read_text()
    choice = read_choice(tmp_path / "c.toml")
    write_choice(tmp_path / "less.json", Choice(choice.picks[1:], automatic=False))
    less = parsed(capsys, *words, "--choice", tmp_path / "less.json")
    assert [m["frequency_hz"] for m in less["modes"]] == [
        m["frequency_hz"] for m in auto["modes"][1:]
    ]
    write_choice(tmp_path / "none.toml", Choice((Pick(3.3, 6),)))
    assert "pick at 3.3 Hz at order 6: no such pole within 1 %" in refused(
        capsys, *words, "--choice", tmp_path / "none.toml"
    )
    write_choice(tmp_path / "other.toml", Choice((Pick(3.3, record="bridge"),)))
    assert "no entry for the record 'record'; it has bridge" in refused(
        capsys, *words, "--choice", tmp_path / "other.toml"
    )
    assert "did you mean '.toml'?" in refused(
        capsys, *words, "--write-choice", tmp_path / "c.tom"
    )
    assert "no folder" in refused(
        capsys, *words, "--diagram", tmp_path / "no" / "d.html"
    )


def test_ema_writes_and_replays(
    frf: Callable[..., Path], tmp_path: Path, capsys: Capture
) -> None:
    words = ("ema", frf(), "--fmin", 2, "--fmax", 35)
    auto = parsed(capsys, *words, "--write-choice", tmp_path / "c.toml")
    again = parsed(capsys, *words, "--choice", tmp_path / "c.toml")
    assert [m["frequency_hz"] for m in again["modes"]] == [
        m["frequency_hz"] for m in auto["modes"]
    ]
    status, out, _ = call(capsys, *words, "--choice", tmp_path / "c.toml", "--why")
    assert status == 0
    assert "confirmed by" in out


# --- a study


def _desk(path: Path) -> Session:
    return Session(
        read_config(path),
        path.parent,
        path.parent / "out",
        Store(path.parent / "study.h5"),
    )


def test_a_study_replays_a_choice(tmp_path: Path) -> None:
    toml = small_study.MODEL + small_study.TEST + small_study.SETTINGS
    path = small_study.write_study(tmp_path, toml, hammer=False)
    plain = stage.run(_desk(path), lambda f, t: None)
    f = plain.ambient.modes.frequencies
    write_choice(
        tmp_path / "choice.toml",
        Choice(rejects=(Reject(float(f[1]), "crane"),), picks=(Pick(float(f[0])),)),
    )
    path.write_text(
        toml.replace("[identify]\n", '[identify]\nchoice = "choice.toml"\n')
    )
    session = _desk(path)
    assert tmp_path / "choice.toml" in stage.files(session)
    chosen = stage.run(session, lambda f, t: None)
    assert chosen.ambient.modes.frequencies == pytest.approx(np.delete(f, 1), rel=1e-12)
    assert "ambient: confirmed by hand" in chosen.ambient.reasons[0]
    assert any("rejected by hand: crane" in n for n in chosen.records[0].notes)
    write_choice(tmp_path / "choice.toml", Choice((Pick(2.0, record="ambiant"),)))
    with pytest.raises(
        ConfigError, match="no record 'ambiant'; did you mean 'ambient'"
    ):
        stage.run(session, lambda f, t: None)


def test_a_frequency_to_its_digits_means_the_candidate_that_has_it() -> None:
    """A doubtful candidate a thousandth beside a natural mode, which a rough figure means."""
    there = np.array([105.02, 104.91])
    doubtful = np.array([0.01, 1.05])
    assert match(np.array([104.91]), there, doubtful).tolist() == [1]
    assert match(np.array([104.911]), there, doubtful).tolist() == [1]
    assert match(np.array([105.0]), there, doubtful).tolist() == [0]
    assert match(np.array([104.8]), there, doubtful).tolist() == [0]
