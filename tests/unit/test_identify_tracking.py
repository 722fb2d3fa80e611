"""Modes followed through stretches: drift, a crossing and a veering pair, gaps, new modes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from test_cli import Capture, call, parsed, refused

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import DataError
from ringtrue.identification.common.tracking import Stretch, track_modes, unseen

CHANNELS = tuple(f"{i}+Z" for i in range(1, 7))
PHI = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 4)))[0]


def stretch(
    time: float,
    f: np.ndarray,
    phi: np.ndarray,
    rng: np.random.Generator,
    rows: slice = slice(None),
) -> Stretch:
    """Modes with noise of 0.1 % in frequency and 3 % in shape, in any order of frequency, with any
    phase.
    """
    f = f * (1 + 1e-3 * rng.standard_normal(f.size))
    order = np.argsort(f)
    psi = (phi + 0.03 * rng.standard_normal(phi.shape)) * np.exp(
        2j * np.pi * rng.random(f.size)
    )
    psi, f = psi[rows][:, order], f[order]
    modes = ModeSet(f, np.full(f.size, 0.01), psi, CHANNELS[rows])
    return Stretch(
        time,
        modes,
        Uncertainty.independent(
            1e-3 * f, np.full(f.size, 1e-3), np.full(psi.shape, 0.03)
        ),
    )


def test_drift_crossing_and_a_gap() -> None:
    """Two modes cross at stretch 15, one drifts by 20 %, one is missing for six stretches; stretch
    7 is not there.
    """
    rng = np.random.default_rng(0)
    times = [k for k in range(30) if k != 7]
    truth = {
        k: np.array(
            [
                2.0 * (1 + 0.2 * k / 30),
                5.0 + 0.02 * (k - 15),
                5.0 - 0.02 * (k - 15),
                9.0,
            ]
        )
        for k in times
    }
    sets = []
    for k in times:
        keep = np.array([0, 1, 2]) if 18 <= k < 24 else np.arange(4)
        sets.append(stretch(k, truth[k][keep], PHI[:, keep], rng))
    found = track_modes(sets)
    assert [t.name for t in found.tracks] == ["1", "2", "3", "4"]
    assert [t.at.size for t in found.tracks] == [29, 29, 29, 23]
    assert found.rare == ()
    for t in found.tracks:
        like = np.abs(PHI.T @ t.shape)
        mode = int(like.argmax())
        assert like[mode] > 0.999
        expected = np.array([truth[times[k]][mode] for k in t.at])
        assert np.abs(t.frequency / expected - 1).max() < 5e-3
        assert t.mac.min() > 0.95


def test_branches_of_a_veering_pair_are_followed() -> None:
    """f² are the eigenvalues of [[a, c], [c, b]]: shapes turn into each other over ten stretches,
    branches stay.
    """
    rng, sets, truth = np.random.default_rng(3), [], []
    for k in range(41):
        x = (k - 20) / 5
        w, v = np.linalg.eigh(np.array([[25 - x, 0.8], [0.8, 25 + x]]))
        truth.append(np.sqrt(w))
        sets.append(stretch(k, np.sqrt(w), PHI[:, :2] @ v, rng))
    found = track_modes(sets)
    assert len(found.tracks) == 2
    for t, branch in zip(found.tracks, np.array(truth).T, strict=True):
        np.testing.assert_allclose(t.frequency, branch, rtol=5e-3)


def test_new_and_rare_modes() -> None:
    rng = np.random.default_rng(5)
    sets = []
    for k in range(12):
        keep = [0, 1] + ([3] if k >= 5 else []) + ([2] if k == 4 else [])
        sets.append(stretch(k, np.array([2.0, 5.0, 7.0, 9.0])[keep], PHI[:, keep], rng))
    found = track_modes(sets)
    assert [(t.name, int(t.at[0]), t.at.size) for t in found.tracks] == [
        ("1", 0, 12),
        ("2", 0, 12),
        ("3", 5, 7),
    ]
    assert [(t.name, t.at.tolist()) for t in found.rare] == [("", [4])]


def test_modes_that_come_and_go_are_told_from_those_seen_now_and_then() -> None:
    """Of 20 stretches one mode has the last 8, one the first 12, one each third, one all but the
    last.
    """
    rng, sets = np.random.default_rng(8), []
    for k in range(20):
        keep = [
            m for m, here in enumerate((k >= 12, k < 12, k % 3 == 2, k < 19)) if here
        ]
        sets.append(stretch(k, np.array([2.0, 5.0, 7.0, 9.0])[keep], PHI[:, keep], rng))
    found = track_modes(sets)
    told = {round(float(t.frequency.mean())): unseen(found, t) for t in found.tracks}
    assert told == {2: (12, 0), 5: (0, 8), 7: (0, 0), 9: (0, 0)}


def test_stretches_with_other_channels() -> None:
    rng = np.random.default_rng(6)
    f = np.array([2.0, 5.0])
    sets = [
        stretch(k, f, PHI[:, :2], rng, slice(0, 4) if k % 2 else slice(2, 6))
        for k in range(10)
    ]
    found = track_modes(sets)
    assert found.channels == (*CHANNELS[2:], *CHANNELS[:2])
    assert [t.at.size for t in found.tracks] == [10, 10]


def test_nothing_in_some_stretches() -> None:
    rng = np.random.default_rng(7)
    none = stretch(1, np.zeros(0), np.zeros((6, 0)), rng)
    full = [stretch(k, np.array([2.0]), PHI[:, :1], rng) for k in (0, 2, 3)]
    assert [t.at.tolist() for t in track_modes([full[0], none, *full[1:]]).tracks] == [
        [0, 2, 3]
    ]
    assert track_modes([none]).tracks == ()
    with pytest.raises(DataError, match="no stretch"):
        track_modes([])
    with pytest.raises(DataError, match="must ascend"):
        track_modes([full[1], full[0]])


# --- the command

RATE, SECONDS, HOURS = 16.0, 300.0, 10


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two modes at 2 and 5 Hz, the first softer in the heat, stretch 4 is
    lost.
    """
    rng, n = np.random.default_rng(0), int(RATE * SECONDS)
    temperature = 15 + 10 * np.sin(2 * np.pi * np.arange(HOURS) / HOURS)
    parts = []
    for t in temperature:
        lam = 2 * np.pi * np.array([2 * (1 - 0.004 * (t - 15)), 5.0]) * (-0.01 + 1j)
        a = np.exp(lam / RATE)
        force = rng.standard_normal((2, n + 500))
        q = [
            np.real(lfilter([1], [1, -x], y))[500:]
            for x, y in zip(a, force, strict=True)
        ]
        parts.append(
            np.vstack(
                [
                    PHI[:4, :2] @ np.array(q) + 0.05 * rng.standard_normal((4, n)),
                    np.full(n, t),
                ]
            )
        )
    data = np.hstack(parts)
    data[:4, 4 * n : 5 * n] = np.nan
    path = tmp_path_factory.mktemp("track") / "long.npy"
    np.save(path, data.T)
    return path


def test_track(record: Path, tmp_path: Path, capsys: Capture) -> None:
    words = (
        "track",
        record,
        "--rate",
        RATE,
        "--hours",
        SECONDS / 3600,
        "--fmin",
        1,
        "--fmax",
        7,
    )
    files = ("--csv", tmp_path / "t.csv", "--plot", tmp_path / "t.html")
    found = parsed(capsys, *words, "--leave-out", "ch5", *files)
    first, second = found["modes"]
    assert len(first["time_h"]) == HOURS - 1
    assert np.ptp(first["frequency_hz"]) > 0.1
    assert np.mean(second["frequency_hz"]) == pytest.approx(5.0, rel=5e-3)
    assert len(found["stretches"]) == HOURS - 1
    assert any("left out: all samples are missing" in n for n in found["notes"])
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[0].startswith("time_h,mode,frequency_hz,")
    assert len(lines) == 1 + sum(len(m["time_h"]) for m in found["modes"])
    page = (tmp_path / "t.html").read_text()
    assert "Damping through time" in page
    assert "http" not in page.split("const figures")[1]
    status, out, _ = call(capsys, *words, "--leave-out", "ch5", "--starts", "0.5")
    assert status == 0
    assert "first seen" in out


def test_track_has_an_example(capsys: Capture) -> None:
    status, out, _ = call(capsys, "track", "--help")
    assert status == 0
    assert "Example: ringtrue track" in " ".join(out.split())


def test_track_refuses(record: Path, tmp_path: Path, capsys: Capture) -> None:
    words = ("track", record, "--rate", RATE)
    assert "hours 0.0: must be positive" in refused(capsys, *words, "--hours", 0)
    assert "no channel 'ch9'; did you mean" in refused(
        capsys, *words, "--leave-out", "ch9"
    )
    assert "2 hours for 1 records" in refused(capsys, *words, "--starts", "1,2")
    assert "hours, separated by commas" in refused(capsys, *words, "--starts", "noon")
    assert "0.375 s at 16 Hz allow" in refused(capsys, *words, "--hours", 1e-4)
    short = ("--hours", SECONDS / 3600, "--fmin", 1, "--leave-out", "ch5")
    np.save(tmp_path / "lost.npy", np.full((8000, 5), np.nan))
    told = refused(capsys, "track", tmp_path / "lost.npy", "--rate", RATE, *short)
    assert "no part of the records could be identified; " in told
