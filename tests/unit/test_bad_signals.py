"""Records and FRFs with faults: a clear refusal, or a result that says what is wrong with it; no
mode is invented.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_files import write_history
from scipy.signal import lfilter
from test_cli import Capture, call, frf, parsed, refused

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.pipeline import (
    AmbientResult,
    AmbientSettings,
    identify_ambient,
)
from ringtrue.signal.channel_checks import check_channels
from ringtrue.signal.harmonic_evidence import amplitude_evidence
from ringtrue.signal.tonal_lines import harmonics

__all__ = ("frf",)  # a fixture

RATE, SECONDS = 64.0, 480.0
F, Z = np.array([2.1, 4.7, 4.9, 9.3]), np.array([1.0, 0.8, 1.0, 0.6]) / 100
PHI = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 4)))[0]
N = int(RATE * SECONDS)
TOLERANCE = 5e-3  # four standard deviations of the lowest mode in eight minutes
QUICK = AmbientSettings(order_max=40)
Change = Callable[[np.ndarray], np.ndarray]


@cache
def made(seconds: float = SECONDS) -> np.ndarray:
    """Accelerations (6, sample) of four modes in white noise, sensor noise 20 dB below."""
    rng, q = np.random.default_rng(0), []
    for s in 2 * np.pi * F * (-Z + 1j * np.sqrt(1 - Z**2)):
        a = np.exp(s / RATE)
        z = lfilter([0, (a - 1) / s], [1, -a], rng.standard_normal(int(RATE * seconds)))
        q.append(2 * np.real(s**2 / (2j * s.imag) * z))
    y = PHI @ np.array(q)
    return y + 0.1 * y.std() * rng.standard_normal(y.shape)


def wrap(y: np.ndarray) -> TimeHistory:
    return TimeHistory(
        y,
        RATE,
        tuple(Channel(f"{i + 1}+Z", "acceleration", "m/s^2") for i in range(len(y))),
        "made",
    )


def found(change: Change) -> AmbientResult:
    return identify_ambient(wrap(change(made().copy())), QUICK)


def put(where: Any, value: Any) -> Change:
    def change(y: np.ndarray) -> np.ndarray:
        y[where] = value
        return y

    return change


def scaled(channel: int, factor: float) -> Change:
    return lambda y: np.where(np.arange(len(y))[:, None] == channel, factor, 1.0) * y


def clipped(rows: Any) -> Change:
    def change(y: np.ndarray) -> np.ndarray:
        limit = y.std(axis=1, keepdims=True)
        y[rows] = np.clip(y, -limit, limit)[rows]
        return y

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            put(2, 1.5),
            "channel 3+Z: at 1.5, with 0 changes of its value: a dead sensor; left out",
        ),
        (put((2, 1000), np.nan), "channel 3+Z: missing samples interpolated: 1"),
        (
            put(2, np.linspace(0, 5, N)),
            "channel 3+Z: a straight line: no signal; left out",
        ),
        (
            scaled(1, 1e3),
            "channel 2+Z: 9.5e+02 of the typical level of its quantity: unit or sensitivity?",
        ),
        (
            scaled(1, 1e-3),
            "channel 2+Z: 1.0e-03 of the typical level of its quantity: unit or sensitivity?",
        ),
        (lambda y: y[[0, 1, 2, 2, 4, 5]], "channel 4+Z: the same samples as 3+Z"),
        (
            lambda y: np.round(y / y.std()),
            "channel 1+Z: coarse: 9 different values only",
        ),
        # swapped: only a model or another record can tell
        (lambda y: y[[1, 0, 2, 3, 4, 5]], ""),
    ],
)
def test_modes_are_found_and_the_fault_is_said(change: Change, told: str) -> None:
    r = found(change)
    assert r.modes.frequencies[:4] == pytest.approx(F, rel=TOLERANCE)
    assert (r.modes.confidence[4:] < 0.5).all()
    assert told in r.notes if told else not r.notes


@pytest.mark.parametrize(
    "drift",
    [
        lambda t: 1e5 * t,
        lambda t: 1e5 * t**2,
        lambda t: 1e4 * np.exp(-20 * t),
        lambda t: 1e4 * np.sin(2 * np.pi * 1.3 * t),
        lambda t: 1e9 + 0 * t,
    ],
    ids=["trend", "parabola", "settling", "day and night", "offset"],
)
@pytest.mark.parametrize("rows", [slice(None), slice(2, 3)], ids=["all", "one"])
def test_what_drifts_below_the_band_loses_no_mode(drift: Change, rows: slice) -> None:
    """Drifts 10,000 times the vibration; warnings of NumPy would be errors here."""

    def drifting(y: np.ndarray) -> np.ndarray:
        y[rows] += y.std() * drift(np.linspace(0, 1, N))
        return y

    still, r = found(lambda y: y), found(drifting)
    np.testing.assert_allclose(
        r.modes.frequencies[:4], still.modes.frequencies[:4], rtol=1e-4
    )
    np.testing.assert_allclose(r.modes.damping[:4], still.modes.damping[:4], rtol=0.02)


@pytest.mark.parametrize("factor", [1e-60, 1e-30, 1e-20, 1e20, 1e60])
def test_the_size_of_a_record_changes_nothing(factor: float) -> None:
    still, r = found(lambda y: y), found(lambda y: factor * y)
    np.testing.assert_allclose(r.modes.frequencies, still.modes.frequencies, rtol=1e-6)
    np.testing.assert_allclose(r.modes.damping, still.modes.damping, rtol=1e-3)


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_records_whose_values_wrap_are_refused(bits: int) -> None:
    """Twice the range of the converter: what is beyond one end comes back at the other."""
    top = 2 ** (bits - 1)

    def wrapped(y: np.ndarray) -> np.ndarray:
        counts = np.round(2 * top * y / np.abs(y).max())
        return (counts + top) % (2 * top) - top

    with pytest.raises(
        ValueError,
        match=r"no usable channel; channel 1\+Z: wraps \d+ times from one end of its range",
    ):
        found(wrapped)
    codes = [n.code for n in check_channels(wrap(wrapped(made().copy())))]
    assert codes == 6 * ["channel wraps"]


def test_sound_signals_with_large_steps_do_not_wrap() -> None:
    rng = np.random.default_rng(2)
    spikes = (
        0.01 * rng.standard_normal(N)
        + 5 * (np.arange(N) % 400 == 7)
        - 5 * (np.arange(N) % 400 == 207)
    )
    telegraph = np.where(np.cumsum(rng.uniform(size=N) < 0.1) % 2, 5.0, -5.0)
    sound = np.stack(
        [
            rng.standard_normal(N),
            rng.uniform(-1, 1, N),
            spikes,
            telegraph + 0.01 * rng.standard_normal(N),
        ]
    )
    assert "channel wraps" not in [n.code for n in check_channels(wrap(sound))]


def test_an_array_of_samples_by_channels_is_refused() -> None:
    data = np.random.default_rng(0).standard_normal((2000, 4))
    channels = tuple(Channel(f"{k + 1}+X") for k in range(2000))
    with pytest.raises(DataError, match=r"2000 channels of 4 samples.*transposed"):
        identify_ambient(TimeHistory(data, 100.0, channels, "record"))


def test_a_channel_of_noise_is_named() -> None:
    noise = 20 * made().std() * np.random.default_rng(5).standard_normal(N)
    r = found(put(2, noise))
    assert r.modes.frequencies[:4] == pytest.approx(F, rel=TOLERANCE)
    assert [n.split(":")[0] for n in r.notes if "broken cable" in n] == ["channel 3+Z"]


@pytest.mark.parametrize("rows", [2, slice(None)], ids=["one", "all"])
def test_modes_of_a_clipped_record_are_no_machines(rows: Any) -> None:
    r = found(clipped(rows))
    assert r.modes.frequencies[:4] == pytest.approx(F, rel=TOLERANCE)
    assert (r.modes.confidence[:4] > 0.7).all()
    assert any(n.startswith("channel 3+Z: clipped at ") for n in r.notes)
    assert (
        "every channel is clipped: machines are not distinguished from modes" in r.notes
    ) == (rows != 2)


@pytest.mark.parametrize(
    "signal",
    [
        lambda rng: rng.standard_normal((6, N)),
        lambda rng: lfilter([1], [1, -0.95], rng.standard_normal((6, N)), axis=1),
        lambda rng: np.cumsum(rng.standard_normal((6, N)), axis=1),
    ],
    ids=["white", "coloured", "walk"],
)
def test_nothing_is_invented(
    signal: Callable[[np.random.Generator], np.ndarray],
) -> None:
    r = identify_ambient(wrap(signal(np.random.default_rng(3))), QUICK)
    assert len(r.modes) == 0
    assert any("no mode found" in n for n in r.notes)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda y: np.outer(np.arange(1, 7), np.arange(N) * 1.0),
            "no usable channel; channel 1+Z: a straight line: no signal;",
        ),
        (lambda y: y * 1e300, "no unit makes that"),
        (lambda y: y * (1e308 / np.abs(y).max()), "no unit makes that"),
        (lambda y: y * 1e-300, "no unit makes that"),
        (lambda y: y[:, :150], "too short for modes above"),
        (lambda y: y[:, :20], "is empty"),
        (lambda y: 0 * y, "a dead sensor"),
        (
            lambda y: np.outer(
                np.ones(6), np.sin(14.6 * np.pi * np.arange(40_000) / RATE)
            ),
            "nothing but steady lines at",
        ),
        (
            lambda y: np.outer(
                np.arange(1, 7), np.sin(10 * np.pi * np.arange(N) / RATE)
            ),
            "nothing but steady lines at 5 Hz",
        ),
    ],
)
def test_what_cannot_be_identified_is_refused(change: Change, told: str) -> None:
    with pytest.raises(ValueError, match=r".") as e:
        found(change)
    assert told in str(e.value)


@pytest.mark.parametrize("ending", [".csv", ".mat", ".uff", ".h5", ".npy"])
def test_files_with_a_bad_channel(ending: str, tmp_path: Path, capsys: Capture) -> None:
    """A dead one is refused by name; one that lost much is left out, one that lost a sample is
    not.
    """
    path = tmp_path / f"bad{ending}"
    y = put((1, 5000), np.nan)(
        put((2, slice(N // 3)), np.nan)(put(4, 2.5)(made().copy()))
    )[:, : N // 2]
    if ending == ".npy":
        np.save(path, y.T)
    else:
        write_history(path, wrap(y))
    rate = ("--rate", RATE) if ending in (".mat", ".npy") else ()
    bad, dead = ("ch3", "ch5") if ending == ".npy" else ("3+Z", "5+Z")
    assert f"channel {dead} is constant: a dead sensor; leave it out" in refused(
        capsys, "oma", path, *rate
    )
    good = parsed(
        capsys, "oma", path, *rate, "--fmin", 7, "--fmax", 11, "--leave-out", dead
    )
    assert len(good["channels"]) == 4
    assert bad not in good["channels"]
    assert min(abs(m["frequency_hz"] - 9.3) for m in good["modes"]) < 0.05
    assert "no such channel; did you mean" in refused(
        capsys, "oma", path, *rate, "--leave-out", bad + "x"
    )


@pytest.mark.parametrize("rate", ["1e-9", "1e12", "nan", "0"])
def test_a_rate_that_cannot_be_right(
    rate: str, tmp_path: Path, capsys: Capture
) -> None:
    np.save(tmp_path / "r.npy", made().T)
    assert "rate" in refused(capsys, "oma", tmp_path / "r.npy", "--rate", rate)


@pytest.mark.parametrize(
    "command", [("oma", "--rate", RATE), ("oma", "--rate", RATE, "--method", "fdd")]
)
def test_values_that_no_unit_makes(
    command: tuple[object, ...], tmp_path: Path, capsys: Capture
) -> None:
    np.save(tmp_path / "r.npy", made().T * (1e308 / np.abs(made()).max()))
    assert "no unit makes that" in refused(
        capsys, command[0], tmp_path / "r.npy", *command[1:]
    )


def test_a_name_twice(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "twice.csv"
    np.savetxt(
        path,
        np.column_stack([np.arange(500) / RATE, *made()[:3, :500]]),
        delimiter=",",
        header="time,a,b,a",
    )
    path.write_text(path.read_text().removeprefix("# "))
    assert "twice.csv: channel a occurs twice" in refused(capsys, "oma", path)


def test_drop_outs_and_spikes_are_listed(tmp_path: Path, capsys: Capture) -> None:
    y = made().copy()
    y[1, 8000:9000] = y[1, 8000]
    y[2, 5000] = 500 * y[2].std()
    np.save(tmp_path / "d.npy", y.T)
    status, out, _ = call(capsys, "oma", tmp_path / "d.npy", "--rate", RATE)
    assert status == 0
    assert (
        "channel ch2: lost stretches: 1 (a value is held), the first at 125 s, 15.6 s in all"
        in out
    )
    assert "channel ch3: spikes, 1 in all, the first at 78.12 s" in out


# --- machines


def line(
    f: float, wander: float, seconds: float = SECONDS, size: float = 0.6
) -> np.ndarray:
    """A sine of steady amplitude whose speed wanders by `wander` (relative, 1 sigma) in some 30 s,
    (6, sample).
    """
    rng, n = np.random.default_rng(7), int(RATE * seconds)
    slow = lfilter([5e-4], [1, -(1 - 5e-4)], rng.standard_normal(n))
    phase = 2 * np.pi * np.cumsum(f * (1 + wander * slow / slow.std())) / RATE
    return size * made().std() * np.outer(rng.uniform(0.5, 1, 6), np.sin(phase))


def test_a_machine_of_unsteady_speed_is_no_mode() -> None:
    """Its line is as wide as a mode of 1 % damping; its amplitude is that of a sine."""
    history = wrap(made(1200.0) + line(7.0, 0.01, 1200.0))
    assert harmonics(history) == ()
    r = identify_ambient(history, QUICK)
    assert r.modes.frequencies == pytest.approx(F, rel=TOLERANCE)
    harmonic = np.array(r.others.classes) == "harmonic"
    assert harmonic.any()
    assert (np.abs(r.others.modes.frequencies[harmonic] - 7.0) < 0.3).all()
    assert amplitude_evidence(history, F, Z) == ("",) * 4


@pytest.mark.parametrize(("f", "on", "off"), [(7.0, 10.0, 20.0), (12.5, 8.0, 12.0)])
def test_a_machine_that_switches_is_no_mode(f: float, on: float, off: float) -> None:
    """A pump, a scanner: bursts look like a mode of 0.1 to 0.3 % damping, whose amplitude is the
    same each time.
    """
    seconds, rng = 1200.0, np.random.default_rng(3)
    t = np.arange(int(RATE * seconds)) / RATE
    burst, start = np.zeros(t.size), 5.0
    while start < seconds:
        length = on * rng.uniform(0.6, 1.4)
        runs = (t >= start) & (t < start + length)
        burst[runs] = np.sin(2 * np.pi * f * t[runs] + rng.uniform(0, 2 * np.pi))
        start += length + off * rng.uniform(0.6, 1.4)
    clean = made(seconds)
    history = wrap(clean + clean.std() * np.outer(rng.standard_normal(6), burst))
    r = identify_ambient(history, QUICK)
    assert r.modes.frequencies == pytest.approx(F, rel=TOLERANCE)
    harmonic = np.array(r.others.classes) == "harmonic"
    assert r.others.modes.frequencies[harmonic] == pytest.approx([f], rel=1e-3)
    assert amplitude_evidence(history, F, Z) == ("",) * 4


@pytest.mark.parametrize(
    ("f", "wander", "size"), [(5.2, 0.01, 0.6), (9.35, 0.0, 0.3), (5.6, 0.01, 1.5)]
)
def test_modes_beside_a_machine_stay(f: float, wander: float, size: float) -> None:
    r = identify_ambient(wrap(made(1200.0) + line(f, wander, 1200.0, size)), QUICK)
    assert r.modes.frequencies == pytest.approx(F, rel=TOLERANCE)


def test_a_channel_that_stands_still_but_for_a_digit_is_dead() -> None:
    """A coarse recorder with nothing connected: its correlations were not finite where the digit
    was not looked at.
    """
    data = made().copy()
    data[2] = 0.0
    data[2, 4321] = 0.01
    r = identify_ambient(wrap(data), QUICK)
    assert r.modes.frequencies == pytest.approx(F, rel=TOLERANCE)
    assert any(
        "at 0, with 2 changes of its value: a dead sensor; left out" in n
        for n in r.notes
    )


def test_channels_are_compared_with_those_of_their_quantity() -> None:
    """Quantities are judged apart: a force of 1000 N beside accelerations of 1 m/s² is no fault."""
    y = made()[:, :4000]
    ids = [Channel(f"{i}", "acceleration") for i in range(3)] + [
        Channel(f"F{i}", "force") for i in range(3)
    ]
    history = TimeHistory(
        y * np.array([1, 1, 1, 1e3, 1e3, 1e3])[:, None], RATE, tuple(ids)
    )
    assert check_channels(history) == ()


def test_fast_signals_are_clipped_for_a_sample_at_a_time() -> None:
    """White noise cut off at 1.5 standard deviations, and the 12 bits of a recorder beside it,
    which are no clip.
    """
    x = np.random.default_rng(0).standard_normal((2, 20_000))
    y = np.stack([np.clip(x[0], -1.5, 1.5), np.round(x[1] * 500)])
    (note,) = check_channels(wrap(y))
    assert (note.code, note.subject) == ("channel clipped", "1+Z")
    assert note.values["samples"] == np.count_nonzero(np.abs(y[0]) == 1.5)


# --- FRFs


def _times(where: Any, factor: float) -> Callable[[Any], Any]:
    def change(h: Any) -> Any:
        h[where] *= factor
        return h

    return change


def _h(frf: Callable[..., Path], change: Callable[[Any], Any]) -> Path:
    with np.load(frf()) as file:
        return frf(H1=change(file["H1"].copy()))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            put((slice(None), 1), 0.0),
            "response out2 is the same at all lines: a dead channel",
        ),
        (put((slice(None), 1), 3.0), "response out2 is the same at all lines"),
        (put(1, 0.0), "reference in2 is the same at all lines"),
        (
            put((slice(None), slice(None), slice(300, 320)), 0.0),
            "20 lines between 16 and 16.95 Hz are zero",
        ),
        (
            put((1, slice(None), slice(300, 320)), 0.0),
            "20 lines between 16 and 16.95 Hz are zero",
        ),
        (lambda h: 0 * h, "no unit makes that"),
        (lambda h: 1e200 * h, "is no measured value"),
        (np.abs, "amplitudes without phase"),
    ],
)
def test_frfs_that_cannot_be_identified(
    frf: Callable[..., Path], change: Callable[[Any], Any], told: str, capsys: Capture
) -> None:
    assert told in refused(capsys, "ema", _h(frf, change))


def test_frfs_of_the_other_sign_of_time_have_the_same_modes(
    frf: Callable[..., Path], capsys: Capture
) -> None:
    given = [
        parsed(capsys, "ema", _h(frf, change))["modes"]
        for change in (lambda h: h, np.conj)
    ]
    one, other = ([(m["frequency_hz"], m["damping"]) for m in modes] for modes in given)
    np.testing.assert_allclose(other, one, rtol=1e-6)


def test_noise_has_no_modes(frf: Callable[..., Path], capsys: Capture) -> None:
    rng = np.random.default_rng(0)
    told = refused(
        capsys,
        "ema",
        _h(
            frf,
            lambda h: rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape),
        ),
    )
    assert "no pole is stable over the orders" in told


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"outputs": ["a", "b", "a", "c"]}, "response a occurs twice"),
        ({"kind": "acelerance"}, "kind 'acelerance'; did you mean 'accelerance'?"),
        (
            {"coherence": np.full((2, 4, 780), 5.0)},
            "coherence 5 of out1/in1 at 1 Hz, and 6239 more beyond 0 to 1",
        ),
        ({"freq": np.arange(-19.0, 20.0, 0.05)}, "the lines begin at -19 Hz"),
    ],
)
def test_frf_files_that_make_no_sense(
    frf: Callable[..., Path], more: dict[str, object], told: str, capsys: Capture
) -> None:
    assert told in refused(capsys, "ema", frf(**more))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            _times((slice(None), 1), 1e6),
            "response out2: 1.1e+06 of the typical level: unit or sensitivity?",
        ),
        (_times((1, 0), -1), "response out1 looks turned under reference in1 or in2: "),
        (
            lambda h: np.stack([h[0], h[1][[3, 1, 2, 0]]]),
            "responses out1 and out4 look swapped under reference in1 or",
        ),
    ],
)
def test_frfs_that_look_wrong(
    frf: Callable[..., Path], change: Callable[[Any], Any], told: str, capsys: Capture
) -> None:
    status, out, _ = call(capsys, "ema", _h(frf, change), "--fmin", 2, "--fmax", 35)
    assert status == 0
    assert told in " ".join(out.split())


def test_a_response_that_does_not_follow_the_force(
    frf: Callable[..., Path], capsys: Capture
) -> None:
    coherence = np.full((2, 4, 780), 0.98)
    coherence[:, 0], coherence[:, 2] = 0.2, 0.1
    status, out, _ = call(
        capsys, "ema", frf(coherence=coherence), "--fmin", 2, "--fmax", 35
    )
    assert status == 0
    assert (
        "channel out1 out3: coherence 0.20, 0.10, 0.98 of the others: does not move"
        in " ".join(out.split())
    )


def test_a_reference_that_does_not_excite_a_mode(
    frf: Callable[..., Path], capsys: Capture
) -> None:
    """One reference at the node of the second mode: the other still shows it; at the node of both
    it is not there.
    """
    node = _h(frf, lambda h: h)
    with np.load(node) as file:
        f = file["freq"]
    w, w0 = 2 * np.pi * f[:, None], 2 * np.pi * np.array([8.0, 15.0, 27.0])
    gain = -(w**2) / (w0**2 - w**2 + 2j * 0.01 * w0 * w)
    shapes = np.array(
        [[1.0, 1.0, 0.5], [0.6, -0.9, 1.0], [0.9, 0.3, -1.0], [0.2, 0.8, 0.9]]
    )
    rng = np.random.default_rng(1)
    for blind, expected in (([1, 0, 1], [8.0, 15.0, 27.0]), ([0, 0, 0], [8.0, 27.0])):
        refs = shapes[:2] * np.array([[1.0, 0.0, 1.0], [1.0, float(blind[0]), 1.0]])
        h = np.einsum("om,fm,im->iof", shapes, gain, refs)
        h += (
            1e-3
            * np.abs(h).mean()
            * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
        )
        modes = parsed(capsys, "ema", frf(H1=h), "--fmin", 2, "--fmax", 35)["modes"]
        assert [m["frequency_hz"] for m in modes] == pytest.approx(expected, rel=1e-3)
    one = parsed(
        capsys,
        "ema",
        frf(),
        "--fmin",
        2,
        "--fmax",
        35,
        "--leave-out",
        "in2",
        "--leave-out",
        "out3",
    )
    assert len(one["channels"]) == 3


def test_a_band_without_modes_says_so(
    frf: Callable[..., Path], capsys: Capture
) -> None:
    status, out, _ = call(capsys, "ema", frf(), "--fmin", 31, "--fmax", 38)
    assert status == 1
    assert "no mode of this band has a confidence above the limit" in out
