"""Modes followed through stretches: drift, a crossing and a veering pair, gaps, new modes; and
their environment.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from test_cli import Capture, call, parsed, refused

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import ConfigError, DataError, InputError
from ringtrue.identification.environment import fit_environment
from ringtrue.identification.gains import with_equal_gains
from ringtrue.identification.inertia import Followed, behind, thermal_lag
from ringtrue.identification.tracking import Stretch, TrackSettings, track_modes, unseen

CHANNELS = tuple(f"{i}+Z" for i in range(1, 7))
PHI = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 4)))[0]


def stretch(
    time: float, f: np.ndarray, phi: np.ndarray, rng: np.random.Generator, rows: slice = slice(None)
) -> Stretch:
    """Modes with noise of 0.1 % in frequency and 3 % in shape, in any order of frequency, with any
    phase.
    """
    f = f * (1 + 1e-3 * rng.standard_normal(f.size))
    order = np.argsort(f)
    psi = (phi + 0.03 * rng.standard_normal(phi.shape)) * np.exp(2j * np.pi * rng.random(f.size))
    psi, f = psi[rows][:, order], f[order]
    modes = ModeSet(f, np.full(f.size, 0.01), psi, CHANNELS[rows])
    return Stretch(
        time,
        modes,
        Uncertainty.independent(1e-3 * f, np.full(f.size, 1e-3), np.full(psi.shape, 0.03)),
    )


def test_drift_crossing_and_a_gap() -> None:
    """Two modes cross at stretch 15, one drifts by 20 %, one is missing for six stretches; stretch
    7 is not there.
    """
    rng = np.random.default_rng(0)
    times = [k for k in range(30) if k != 7]
    truth = {
        k: np.array([2.0 * (1 + 0.2 * k / 30), 5.0 + 0.02 * (k - 15), 5.0 - 0.02 * (k - 15), 9.0])
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


def replaced(fac: float, course: float, hours: int, seed: int) -> list[Stretch]:
    """From stretch 10 on channel 3+Z gives `fac` times as much; shapes have a daily course of so
    much.
    """
    rng, gain, out = np.random.default_rng(seed), np.ones((6, 1)), []
    for k in range(hours):
        gain[2] = fac if k >= 10 else 1.0
        turn = 1 + course * np.sin(2 * np.pi * k / 24) * np.linspace(-1, 1, 6)[
            :, None
        ] * np.linspace(0.5, 1, 4)
        out.append(stretch(k, np.array([2.0, 5.0, 7.0, 9.0]), gain * turn * PHI, rng))
    return out


@pytest.mark.parametrize("fac", [0.5, 10.0])
def test_a_sensor_of_another_sensitivity_is_named(fac: float) -> None:
    """With ten times as much of one channel a shape is like no other one before: the mode is the
    same all the same.
    """
    even, (change,) = with_equal_gains(replaced(fac, 0.03, 24, 2))
    assert (change.channel, change.at) == ("3+Z", 10)
    assert abs(change.factor - fac) < 4 * change.std < 0.2 * fac
    found = track_modes(even)
    assert [t.at.size for t in found.tracks] == [24, 24, 24, 24]
    assert min(t.mac.min() for t in found.tracks) > 0.95


def test_a_course_of_the_day_is_no_other_sensor() -> None:
    sets = replaced(1.0, 0.2, 60, 3)
    even, changes = with_equal_gains(sets)
    assert changes == []
    assert all(a is b for a, b in zip(even, sets, strict=True))


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
        keep = [m for m, here in enumerate((k >= 12, k < 12, k % 3 == 2, k < 19)) if here]
        sets.append(stretch(k, np.array([2.0, 5.0, 7.0, 9.0])[keep], PHI[:, keep], rng))
    found = track_modes(sets)
    told = {round(float(t.frequency.mean())): unseen(found, t) for t in found.tracks}
    assert told == {2: (12, 0), 5: (0, 8), 7: (0, 0), 9: (0, 0)}


def test_stretches_with_other_channels() -> None:
    rng = np.random.default_rng(6)
    f = np.array([2.0, 5.0])
    sets = [
        stretch(k, f, PHI[:, :2], rng, slice(0, 4) if k % 2 else slice(2, 6)) for k in range(10)
    ]
    found = track_modes(sets)
    assert found.channels == (*CHANNELS[2:], *CHANNELS[:2])
    assert [t.at.size for t in found.tracks] == [10, 10]


def test_nothing_in_some_stretches() -> None:
    rng = np.random.default_rng(7)
    none = stretch(1, np.zeros(0), np.zeros((6, 0)), rng)
    full = [stretch(k, np.array([2.0]), PHI[:, :1], rng) for k in (0, 2, 3)]
    assert [t.at.tolist() for t in track_modes([full[0], none, *full[1:]]).tracks] == [[0, 2, 3]]
    assert track_modes([none]).tracks == ()
    with pytest.raises(DataError, match="no stretch"):
        track_modes([])
    with pytest.raises(DataError, match="must ascend"):
        track_modes([full[1], full[0]])
    with pytest.raises(ConfigError, match="mac 2"):
        TrackSettings(mac=2)


# --- environment


def days(n: int, rng: np.random.Generator) -> np.ndarray:
    """Temperature by the hour."""
    return np.asarray(15 + 8 * np.sin(2 * np.pi * np.arange(n) / 24) + 0.5 * rng.standard_normal(n))


def test_slopes_and_their_standard_errors() -> None:
    """f = 5 - 0.004 (T - mean) Hz with scatter twice the stated: 100 records; the root mean square
    of z has 7 %.
    """
    rng, z = np.random.default_rng(0), []
    for _ in range(100):
        t = days(48, rng)
        amplitude = rng.uniform(1, 3, 48)
        f = (
            5
            - 0.004 * (t - t.mean())
            - 0.002 * (amplitude - amplitude.mean())
            + 0.01 * rng.standard_normal(48)
        )
        fit = fit_environment(f, np.full(48, 0.005), {"T": t, "a": amplitude})
        z.append(
            [
                *((fit.slope - [-0.004, -0.002]) / fit.std_slope),
                (fit.reference - 5) / fit.std_reference,
            ]
        )
        assert fit.scatter == pytest.approx(np.sqrt(0.01**2 - 0.005**2), rel=0.5)
    assert np.sqrt((np.array(z) ** 2).mean(axis=0)) == pytest.approx([1.0, 1.0, 1.0], abs=0.2)
    assert fit.names == ("T", "a")
    assert fit.p_value[0] < 1e-3


def test_false_alarms_and_persistent_residuals() -> None:
    """At 1 %: of 60 records with residuals of correlation 0.5 few show a change; the slopes stay
    true.
    """
    rng, z, changes = np.random.default_rng(1), [], 0
    for _ in range(60):
        t = days(168, rng)
        e = lfilter([1], [1, -0.5], rng.standard_normal(168)) * 0.01
        fit = fit_environment(5 - 0.004 * (t - t.mean()) + e, np.full(168, 0.002), {"T": t})
        z.append((fit.slope[0] + 0.004) / fit.std_slope[0])
        changes += bool(fit.changes)
    assert changes <= 4
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_a_change_and_outliers_are_told() -> None:
    rng = np.random.default_rng(2)
    t = days(96, rng)
    f = 5 - 0.004 * (t - t.mean()) + 0.006 * rng.standard_normal(96)
    f[60:] -= 0.03
    f[[10, 80]] += 0.1
    fit = fit_environment(f, np.full(96, 0.005), {"T": t})
    assert np.flatnonzero(fit.outlier).tolist() == [10, 80]
    assert len(fit.changes) == 1
    change = fit.changes[0]
    assert abs(change.at - 60) <= 1
    assert change.shift == pytest.approx(-0.03, abs=4 * change.std)
    assert 0 < change.std < 0.005
    assert change.p_value < 1e-4
    assert fit.corrected[:60].std() > 0.9 * fit.corrected[~fit.outlier][:55].std()
    calm = fit_environment(
        np.delete(f, [10, 80])[:58], np.full(58, 0.005), {"T": np.delete(t, [10, 80])[:58]}
    )
    assert calm.changes == ()
    assert not calm.outlier.any()


def test_regressors_that_tell_nothing() -> None:
    rng = np.random.default_rng(4)
    t = days(40, rng)
    f = 5 - 0.004 * (t - 15) + 0.005 * rng.standard_normal(40)
    gone = np.where(np.arange(40) == 3, np.nan, t)
    fit = fit_environment(
        f, np.full(40, np.nan), {"T": gone, "twice": 2 * t + 1, "same": np.full(40, 3.0)}
    )
    assert fit.slope[0] == pytest.approx(-0.004, abs=4 * fit.std_slope[0])
    assert np.isnan(fit.slope[1:]).all()
    assert np.isnan(fit.residual[3])
    assert np.isnan(fit.corrected[3])
    assert not fit.outlier[3]
    few = fit_environment(f[:5], np.full(5, 0.005), {"T": t[:5]})
    assert np.isnan(few.slope).all()
    assert few.reference == pytest.approx(f[:5].mean(), rel=1e-9)
    with pytest.raises(InputError, match="3 or more"):
        fit_environment(f[:2], np.ones(2), {})


# --- the command

RATE, SECONDS, HOURS = 16.0, 300.0, 10


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two modes at 2 and 5 Hz, the first softer in the heat, channel 5 a thermometer; stretch 4 is
    lost.
    """
    rng, n = np.random.default_rng(0), int(RATE * SECONDS)
    temperature = 15 + 10 * np.sin(2 * np.pi * np.arange(HOURS) / HOURS)
    parts = []
    for t in temperature:
        lam = 2 * np.pi * np.array([2 * (1 - 0.004 * (t - 15)), 5.0]) * (-0.01 + 1j)
        a = np.exp(lam / RATE)
        force = rng.standard_normal((2, n + 500))
        q = [np.real(lfilter([1], [1, -x], y))[500:] for x, y in zip(a, force, strict=True)]
        parts.append(
            np.vstack(
                [PHI[:4, :2] @ np.array(q) + 0.05 * rng.standard_normal((4, n)), np.full(n, t)]
            )
        )
    data = np.hstack(parts)
    data[:4, 4 * n : 5 * n] = np.nan
    path = tmp_path_factory.mktemp("track") / "long.npy"
    np.save(path, data.T)
    return path


def test_track(record: Path, tmp_path: Path, capsys: Capture) -> None:
    words = ("track", record, "--rate", RATE, "--hours", SECONDS / 3600, "--fmin", 1, "--fmax", 7)
    files = ("--csv", tmp_path / "t.csv", "--plot", tmp_path / "t.html")
    found = parsed(capsys, *words, "--temperature", "ch5", *files)
    first, second = found["modes"]
    assert len(first["time_h"]) == HOURS - 1
    assert np.mean(second["frequency_hz"]) == pytest.approx(5.0, rel=5e-3)
    slope = first["environment"]["slopes"][0]
    assert slope["hz_per_unit"] == pytest.approx(-0.008, abs=4 * slope["std"])
    assert slope["std"] < 0.001
    assert (
        abs(second["environment"]["slopes"][0]["hz_per_unit"])
        < 4 * second["environment"]["slopes"][0]["std"]
    )
    assert len(found["stretches"]) == HOURS - 1
    assert any("left out: all samples are missing" in n for n in found["notes"])
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[0].startswith("time_h,mode,frequency_hz,")
    assert lines[0].endswith(",ch5")
    assert len(lines) == 1 + sum(len(m["time_h"]) for m in found["modes"])
    page = (tmp_path / "t.html").read_text()
    assert "Mode 2" in page
    assert "http" not in page.split("const figures")[1]
    table = tmp_path / "weather.csv"
    table.write_text("hour,wind\n0,1\n0.8,5\n2,2\n")
    status, out, _ = call(
        capsys, *words, "--environment", table, "--drift", "--leave-out", "ch5", "--starts", "0.5"
    )
    assert status == 0
    assert "wind" in out
    assert "time" in out
    found = parsed(
        capsys, *words, "--environment", table, "--temperature", "wind", "--leave-out", "ch5"
    )
    assert [s["name"] for s in found["modes"][0]["environment"]["slopes"]] == ["wind"]
    assert "no channel 'wind'" in refused(capsys, *words, "--temperature", "wind")


def test_track_has_an_example(capsys: Capture) -> None:
    status, out, _ = call(capsys, "track", "--help")
    assert status == 0
    assert "Example: ringtrue track" in " ".join(out.split())


def test_track_refuses(record: Path, tmp_path: Path, capsys: Capture) -> None:
    words = ("track", record, "--rate", RATE)
    assert "--hours 0.0: must be positive" in refused(capsys, *words, "--hours", 0)
    assert "no channel 'ch9'; did you mean" in refused(capsys, *words, "--temperature", "ch9")
    assert "2 hours for 1 records" in refused(capsys, *words, "--starts", "1,2")
    assert "hours, separated by commas" in refused(capsys, *words, "--starts", "noon")
    (tmp_path / "w.csv").write_text("hour,wind\n2,1\n1,5\n")
    assert "rising hours" in refused(capsys, *words, "--environment", tmp_path / "w.csv")
    assert "0.375 s at 16 Hz allow" in refused(capsys, *words, "--hours", 1e-4)
    short = ("--hours", SECONDS / 3600, "--fmin", 1, "--leave-out", "ch5")
    np.save(tmp_path / "lost.npy", np.full((8000, 5), np.nan))
    told = refused(capsys, "track", tmp_path / "lost.npy", "--rate", RATE, *short)
    assert "no stretch could be identified; " in told


@pytest.mark.parametrize("known", [0, 3])
def test_a_regressor_that_is_hardly_known_is_left_out(known: int) -> None:
    f = 5 + 0.005 * np.random.default_rng(0).standard_normal(24)
    fit = fit_environment(
        f, np.full(24, 0.005), {"T": np.where(np.arange(24) < known, np.arange(24.0), np.nan)}
    )
    assert np.isnan(fit.slope).all()
    assert fit.reference == pytest.approx(5, abs=4 * 0.005 / np.sqrt(24))
    assert np.isfinite(fit.residual).all()


# --- inertia


def slow(
    hours: int, lag: float, memory: float, rng: np.random.Generator
) -> tuple[list[Followed], np.ndarray, np.ndarray]:
    """Three modes under a body that takes the temperature of the air in `lag` hours; times and
    temperatures.
    """
    t, clock = days(hours, rng) + 3 * np.sin(np.arange(hours) / 9), np.arange(hours) + 0.5
    body = behind(clock, t, lag) if lag else t
    modes = []
    for f, slope in ((1.0, -0.001), (2.0, -0.001), (5.0, -0.004)):
        e = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal(hours)) * 0.002
        modes.append(Followed(f + slope * body + e, np.full(hours, 0.001), np.arange(hours)))
    return modes, clock, t


def test_a_body_behind_a_ramp_and_a_step() -> None:
    t = np.linspace(0, 60, 241)
    np.testing.assert_allclose(behind(t, 2 * t, 3.0)[-1], 2 * (60 - 3.0), rtol=1e-8)
    step = np.where(t > 0, 1.0, 0.0)
    at = np.flatnonzero(t >= 3.0)[0]  # half of the first quarter of an hour is a ramp
    assert behind(t, step, 3.0)[at] == pytest.approx(1 - np.exp(-(3.0 - 0.125) / 3.0), abs=1e-3)
    step[5] = np.nan
    assert np.flatnonzero(np.isnan(behind(t, step, 3.0))).tolist() == [5]


@pytest.mark.parametrize("lag", [2.0, 4.0])
def test_the_inertia_of_a_structure_is_found_and_makes_no_changes(lag: float) -> None:
    rng = np.random.default_rng(7)
    found = []
    for _ in range(10):
        modes, clock, t = slow(72, lag, 0.0, rng)
        found.append(thermal_lag(modes, clock, t))
        fit = fit_environment(modes[2].frequency, modes[2].std, {"T": behind(clock, t, found[-1])})
        assert not fit.changes
        assert fit.slope[0] == pytest.approx(-0.004, rel=0.15)
    assert np.median(found) == lag
    assert np.ptp(found) <= lag


@pytest.mark.parametrize("memory", [0.0, 0.6])
def test_modes_that_follow_at_once_have_no_inertia(memory: float) -> None:
    rng = np.random.default_rng(8)
    found = [thermal_lag(*slow(72, 0.0, memory, rng)) for _ in range(30)]
    assert np.count_nonzero(found) <= 1, found
    none, clock, t = slow(72, 0.0, memory, rng)
    flat = [Followed(m.frequency[::-1], m.std, m.at) for m in none]
    assert (
        thermal_lag([Followed(m.frequency[:8], m.std[:8], m.at[:8]) for m in flat], clock, t) == 0.0
    )  # too few
