"""Hits and FRFs from raw hammer records.

A beam-like structure of four modes, hit six times with half-sine-squared pulses; its response is
made in the frequency domain on twice the length, so that nothing wraps around.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.channels import input_id
from ringtrue.core.choice import Hit
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.io.frfs import read_frfs, write_frfs
from ringtrue.signal.channel_checks import clipping_levels
from ringtrue.signal.frf import estimate_columns, estimate_frf, estimators, frf_variance
from ringtrue.signal.frf_sets import exchange_by_reciprocity, join_frfs
from ringtrue.signal.impacts import HammerSettings
from ringtrue.study.hammer_records import forced_frfs

RATE = 512.0
FN = np.array([12.0, 15.0, 15.3, 55.0])
ZETA = np.array([0.01, 0.008, 0.012, 0.015])
PHI = np.cos(
    np.pi * np.linspace(0, 1, 12)[:, None] * np.arange(1, 5) + 0.3 * np.arange(4)
)
STARTS = 1.0 + 9.0 * np.arange(6)


def receptance(s: np.ndarray, outs: list[int], inp: int) -> np.ndarray:
    w = 2 * np.pi * FN
    terms = 1 / (s[:, None] ** 2 + 2 * ZETA * w * s[:, None] + w**2)
    return np.asarray((terms * PHI[inp]) @ PHI[outs].T)


def pulse(t: np.ndarray, size: float, width: float = 0.006) -> np.ndarray:
    return np.where((t > 0) & (t < width), size * np.sin(np.pi * t / width) ** 2, 0.0)


def record(
    inp: int,
    outs: list[int],
    seed: int = 0,
    *,
    rebound: int = -1,
    noise: float = 1e-3,
    starts: np.ndarray = STARTS,
) -> TimeHistory:
    rng = np.random.default_rng(seed)
    n = int((starts[-1] + 11) * RATE)
    t = np.arange(n) / RATE
    force = np.zeros(n)
    for k, start in enumerate(starts):
        force += pulse(t - start, 100 * (1 + 0.2 * rng.random()))
        force += pulse(t - start - 0.05, 30.0) if k == rebound else 0.0
    s = 2j * np.pi * np.fft.rfftfreq(2 * n, 1 / RATE)
    spectrum = (
        s[:, None] ** 2 * receptance(s, outs, inp) * np.fft.rfft(force, 2 * n)[:, None]
    )
    y = np.fft.irfft(spectrum, axis=0)[:n].T
    y = (
        y + noise * y.std() * rng.standard_normal(y.shape) + 0.5
    )  # an offset, as a DC-coupled sensor has
    channels = [Channel(f"F:{inp + 1}+Z", "force", "N")]
    channels += [Channel(f"{o + 1}+Z", "acceleration", "m/s^2") for o in outs]
    return TimeHistory(
        np.vstack([force + 0.01 * rng.standard_normal(n) - 1.0, y]),
        RATE,
        tuple(channels),
        f"r{inp}",
    )


def test_finds_hits_and_tells_why_some_are_left_out() -> None:
    _, reports = estimate_frf(record(1, [0, 1, 2], rebound=2))
    assert len(reports) == 6
    np.testing.assert_allclose([r.time for r in reports], STARTS + 0.003, atol=2 / RATE)
    assert [r.accepted for r in reports] == [True, True, False, True, True, True]
    assert "double hit" in reports[2].reasons[0]
    assert reports[0].input == "2+Z" == input_id("F:2+Z") == input_id("2+Z")


def test_hits_are_kept_and_left_out_by_hand() -> None:
    r = record(1, [0, 1, 2], rebound=2)
    auto, _ = estimate_frf(r)
    hits = (
        Hit("r1", 1.0, False, "cable"),
        Hit("r1", 19.02, True, "soft"),
        Hit("other", 0.5, True, "x"),
    )
    frfs, reports = estimate_frf(r, HammerSettings(hits=hits))
    assert [x.accepted for x in reports] == [False, True, True, True, True, True]
    assert reports[0].reasons == ("left out by hand: cable",)
    assert reports[2].reasons[-1] == "kept by hand: soft"
    assert "double hit" in reports[2].reasons[0]
    assert frfs.averages.tolist() == auto.averages.tolist() == [5.0]
    assert not np.allclose(frfs.data, auto.data, rtol=1e-9, atol=0.0)
    # the record without its first hit by other means
    later = replace(r, data=r.data[:, int(5 * RATE) :])
    both = HammerSettings(block=8.0, hits=(Hit("r1", 1.0, False, "cable"),))
    alone = HammerSettings(block=8.0)
    np.testing.assert_allclose(
        estimate_frf(r, both)[0].data,
        estimate_frf(later, alone)[0].data,
        rtol=1e-2,
        atol=1e-4,
    )
    with pytest.raises(
        ConfigError, match=r"hit of r1 at 2 s: there is none within .*1\.00 10\.00"
    ):
        estimate_frf(r, HammerSettings(hits=(Hit("r1", 2.0, False, "cable"),)))
    (path,) = (replace(r, source="a/b.c/r1.x.csv #2"),)
    named = HammerSettings(hits=(Hit("r1.x #2", 1.0, False, "cable"),))
    assert not estimate_frf(path, named)[1][0].accepted


def across(history: TimeHistory, count: int) -> TimeHistory:
    """With `count` channels across the direction of the blows, which show the noise of the
    sensors.
    """
    rng = np.random.default_rng(3)
    noise = (
        1e-3
        * history.data[1:].std()
        * rng.standard_normal((count, history.data.shape[1]))
    )
    channels = [Channel(f"{k + 1}+X", "acceleration", "m/s^2") for k in range(count)]
    return TimeHistory(
        np.vstack([history.data, noise]),
        RATE,
        (*history.channels, *channels),
        history.source,
    )


def test_a_single_blow_is_not_held_for_ringing_by_channels_that_show_nothing() -> None:
    one, two = (
        across(record(1, [0, 1, 2], starts=np.array(s)), 6) for s in ([1.0], [1.0, 2.2])
    )
    settings = HammerSettings(block=1.0)
    assert [r.accepted for r in estimate_frf(one, settings)[1]] == [True]
    first, second = estimate_frf(two, settings)[1]
    assert first.accepted
    assert "still ringing" in second.reasons[0]


def test_overloads_with_and_without_a_range() -> None:
    r = record(1, [0, 1])
    top = np.abs(r.data[1] - 0.5).max()
    _, reports = estimate_frf(r, full_scale={"1+Z": top * 0.999})
    assert [any("overload of 1+Z" in x for x in h.reasons) for h in reports].count(
        True
    ) in (
        1,
        2,
        3,
    )
    clipped = r.data.copy()
    clipped[2] = np.clip(clipped[2], -0.1 * clipped[2].max(), 0.1 * clipped[2].max())
    frfs, reports = estimate_frf(replace(r, data=clipped))
    assert all(h.accepted and h.lost == ("2+Z",) for h in reports)
    assert [c.id for c in frfs.outputs] == ["1+Z"]
    with pytest.raises(DataError, match="overload of 2"):
        estimate_frf(replace(r, data=clipped).pick([r.channels[0].id, "2+Z"]))


def test_a_response_clipped_for_a_sample_in_most_blows_is_left_out() -> None:
    """Two tops an acquisition, of one value to rounding; a response that stays within its range has
    none.
    """
    r = record(1, [0, 1, 2], starts=STARTS + 6e-4 * np.arange(6))
    clipped = r.data.copy()
    top = np.sort(
        [np.sort(clipped[3, int(s * RATE) : int((s + 1) * RATE)])[-3] for s in STARTS]
    )[0]
    clipped[3] = np.minimum(clipped[3], top)
    forced = forced_frfs([replace(r, data=clipped)], HammerSettings())
    assert [c.id for c in forced.columns[0].outputs] == ["1+Z", "2+Z"]
    assert "response 3+Z: overload in most blows, left out" in forced.notes
    assert not any(h.lost for h in forced_frfs([r], HammerSettings()).hits)


def test_a_force_clipped_for_a_sample_or_two_is_told_by_its_pulses() -> None:
    """Pulses of 3 samples, unlike each other, that all end at one value; equal pulses of a
    simulation are none.
    """
    r = record(1, [0, 1], starts=STARTS + 6e-4 * np.arange(6))
    clipped = r.data.copy()
    clipped[0] = np.clip(clipped[0], None, 60.0)
    with pytest.raises(
        DataError, match=r"overload of F:2\+Z; .*or measure with a wider range"
    ):
        estimate_frf(replace(r, data=clipped))
    n = int(STARTS[0] * RATE)
    again = np.tile(r.data[:, : 4 * n], 6) + 0.0
    _, reports = estimate_frf(replace(r, data=again))
    assert not any("overload" in x for h in reports for x in h.reasons)


def test_two_clipped_pulses_are_enough_where_each_is_flat() -> None:
    """Of five, at 2.5 times their rate; within the range none clips, 16 bits of a recorder
    included.
    """
    t = np.arange(0, 10, 1 / (2.5 * RATE))
    force = sum(
        pulse(t - start, size)
        for start, size in zip(range(1, 10, 2), (80, 95, 90, 130, 140.0), strict=True)
    )
    noisy = force + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    bits = np.round(noisy * 2**15 / 150) * 150 / 2**15
    for top, clips in ((100.0, {"F": 100.0}), (150.0, {})):
        r = TimeHistory(
            np.clip(bits, None, top)[None],
            2.5 * RATE,
            (Channel("F", "force", "N"),),
            "r",
        )
        assert clipping_levels(r) == clips


def test_frf_is_that_of_the_system_under_the_window() -> None:
    """H is seen at s + σ, by the exponential window; 1e-3 is the noise over five averages."""
    outs = [0, 1, 5]
    frfs, _ = estimate_frf(record(1, outs), HammerSettings(fmax=100.0, exp_end=0.01))
    assert frfs.kind == "accelerance"
    assert frfs.window_decay == pytest.approx(
        -np.log(0.01) / (1 / frfs.freqs[1]), rel=1e-9
    )
    s = 2j * np.pi * frfs.freqs + frfs.window_decay
    exact = s[:, None] ** 2 * receptance(s, outs, 1)
    error = np.linalg.norm(frfs.data[1:, :, 0] - exact[1:]) / np.linalg.norm(exact)
    assert error < 3e-3
    assert np.median(frfs.coherence[10:]) > 0.999


def band_limited(width: float, part: float) -> TimeHistory:
    """The record of a hard or soft tip, force and responses behind a filter that cuts at a part of
    half the rate.
    """
    n, half = 60 * 512, 256.0
    force = sum(
        pulse(np.arange(4 * n) / (4 * RATE) - a, 100.0, width) for a in STARTS + 1e-3
    )
    f = np.fft.rfftfreq(4 * n, 1 / (4 * RATE))
    through = np.fft.rfft(force) * np.clip((1 - f / half) / (1 - part), 0, 1)
    s = 2j * np.pi * f
    both = np.vstack(
        [through, (s[:, None] ** 2 * receptance(s, [0, 1, 5], 1)).T * through]
    )
    data = np.fft.irfft(both, axis=1)[:, ::4]
    return TimeHistory(data, RATE, record(1, [0, 1, 5]).channels, "tip")


def test_lines_at_which_a_simulated_pulse_has_no_force_are_left_out() -> None:
    """A force without noise: sin² over a time T has zeros at 2/T, 3/T, ..., other ones for each
    hammer.
    """
    clean = []
    for inp, width in ((1, 8 / RATE), (2, 12 / RATE)):
        r = record(inp, [0, 1, 2])
        t = np.arange(r.data.shape[1]) / RATE
        force = sum(pulse(t - start, 100.0, width) for start in STARTS)
        clean.append(replace(r, data=np.vstack([force, r.data[1:]])))
    frfs, _ = estimate_frf(clean, HammerSettings(block=8.0))
    for zero in (2 * RATE / 8, 2 * RATE / 12, RATE / 2):
        assert np.abs(frfs.freqs - zero).min() > 0.01
    assert frfs.freqs.size > 0.98 * 8 * RATE / 2


@pytest.mark.parametrize(("width", "part"), [(0.0015, 0.85), (0.06, 0.85)])
def test_the_whole_pulse_counts(width: float, part: float) -> None:
    """A filter rings before a pulse shorter than its samples; a soft one begins before the
    pretrigger.

    An edge through either leaves 1 % and more of error at all lines.
    """
    frfs, _ = estimate_frf(
        band_limited(width, part), HammerSettings(fmax=20.0, exp_end=0.01)
    )
    s = 2j * np.pi * frfs.freqs + frfs.window_decay
    exact = s[:, None] ** 2 * receptance(s, [0, 1, 5], 1)
    assert np.linalg.norm(frfs.data[1:, :, 0] - exact[1:]) < 2e-3 * np.linalg.norm(
        exact
    )


def test_a_record_that_begins_within_the_pulse_says_so() -> None:
    r = record(1, [0, 1, 5])
    at = int(np.abs(r.data[0] + 1).argmax()) - 1
    _, hits = estimate_frf(
        replace(r, data=r.data[:, at : at + 4000]), HammerSettings(block=4.0)
    )
    assert hits[0].accepted
    assert "begins within the pulse" in hits[0].reasons[0]


@pytest.mark.parametrize("before", range(9))
def test_a_trigger_with_few_samples_before_the_pulse(before: int) -> None:
    """The structure was at rest: the FRFs do not depend on what was recorded of that."""
    parts = []
    for seed in range(2):
        whole = record(1, [0, 1, 2], seed, starts=STARTS[:1], noise=1e-6)
        begin = int(STARTS[0] * RATE) + 1 - before
        parts.append(replace(whole, data=whole.data[:, begin : begin + 4096]))
    frfs, _ = estimate_frf(parts, HammerSettings(fmax=60.0))
    s = frfs.window_decay + 2j * np.pi * frfs.freqs
    want = s[:, None] ** 2 * receptance(s, [0, 1, 2], 1)
    assert np.linalg.norm(frfs.data[:, :, 0] - want) < 0.02 * np.linalg.norm(want)


def test_points_at_which_the_force_has_the_other_sign_are_told() -> None:
    """A hammer pushes: its cell was turned at one point, or the blow came from the other side."""
    parts = [record(k, [0, 7], seed=k, starts=STARTS[:2]) for k in (1, 4, 6)]
    assert not any(
        "sign" in n for n in forced_frfs(parts, HammerSettings(fmax=60.0)).notes
    )
    turned = replace(parts[1], data=parts[1].data * np.array([-1.0, 1.0, 1.0])[:, None])
    told = forced_frfs([parts[0], turned, parts[2]], HammerSettings(fmax=60.0)).notes
    assert any(
        n.startswith("the force is negative at 5+Z, and of the other sign elsewhere")
        for n in told
    )


def test_roving_responses_and_hammers_become_one_set() -> None:
    parts = [
        record(i, o, seed=9 * i + k)
        for i in (1, 7)
        for k, o in enumerate(([0, 1, 2, 3], [3, 4, 5]))
    ]
    frfs, reports = estimate_frf(parts, HammerSettings(fmax=60.0))
    assert frfs.data.shape[1:] == (6, 2)
    assert [c.id for c in frfs.inputs] == ["2+Z", "8+Z"]
    assert len(reports) == 24
    with pytest.raises(DataError, match="were not measured"):
        estimate_frf(parts[:3])


def test_earlier_blows_are_known_row_by_row_and_column_by_column() -> None:
    """Two setups of sensors under two points: each FRF has the factor of its own record, also with
    ends exchanged.
    """
    pole = np.array([-0.3 + 2j * np.pi * 11.0])
    gaps = [np.array([1.0, 3.1, 5.3]), np.array([1.0, 3.4, 5.5, 7.9])]
    sensors = [0, 1], [2, 3, 4]
    records = [
        record(hit, sensors[k], k, starts=gaps[k]) for k in (0, 1) for hit in (1, 3)
    ]
    parts = estimate_columns(records)[0]
    joined = join_frfs(parts)
    assert joined.impacts is not None
    np.testing.assert_allclose(joined.impacts.weight.sum(axis=0), 1.0, rtol=1e-12)
    for k, one in enumerate(parts):
        mine = joined.impacts.take(
            np.array(sensors[k // 2]), np.array([k % 2])
        ).factors(pole)
        assert one.impacts is not None
        alone = one.impacts.factors(pole)
        np.testing.assert_allclose(mine[0] * mine[1], alone[0] * alone[1], rtol=1e-12)
    shape, part = joined.impacts.factors(pole)
    turned = joined.impacts.exchanged().factors(pole)
    both = np.tensordot(joined.impacts.weight, joined.impacts.each(pole), (0, 0))[
        ..., 0
    ]
    # of what no product of shape and participation leaves
    least = np.linalg.svd(both)[1][1]
    assert least <= np.linalg.norm(shape @ part - both) < 1.5 * least
    assert least <= np.linalg.norm(turned[0] @ turned[1] - both.T) < 1.5 * least


def test_joining_averages_what_was_measured_twice_and_refuses_unlike_sets() -> None:
    one = FrfSet(
        np.full((4, 1, 1), 1.0 + 0j),
        np.arange(4.0),
        (Channel("1+Z", "acceleration"),),
        (Channel("2+Z", "force"),),
        np.ones((4, 1, 1)),
        np.array([1.0]),
    )
    two = replace(one, data=np.full((4, 1, 1), 4.0 + 0j), averages=np.array([2.0]))
    np.testing.assert_allclose(join_frfs([one, two]).data, 3.0)
    for other in (
        replace(one, freqs=np.arange(4.0) * 2),
        replace(one, window_decay=1.0),
    ):
        with pytest.raises(DataError):
            join_frfs([one, other])


def test_sets_on_other_lines_and_of_other_kinds_become_alike() -> None:
    """A finer set that ends earlier, measured by a laser: the shared lines, as accelerances."""
    point, force = (
        Channel("1+Z", "acceleration", "m/s^2"),
        (Channel("2+Z", "force", "N"),),
    )
    wide, fine = np.arange(0.0, 41.0), np.arange(0.0, 30.25, 0.5)
    first = FrfSet((1.0 + wide)[:, None, None], wide, (point,), force)
    mobility = np.divide(
        1.0 + fine, 2j * np.pi * fine, out=np.zeros(fine.size, complex), where=fine > 0
    )
    laser = (Channel("3+Z", "velocity", "m/s"),)
    got = join_frfs(
        [first, FrfSet(mobility[:, None, None], fine, laser, force, kind="mobility")]
    )
    assert (got.kind, got.outputs[1].unit) == ("accelerance", "m/s^2")
    np.testing.assert_allclose(got.freqs, np.arange(0.0, 31.0))
    np.testing.assert_allclose(
        got.data[1:, :, 0], np.outer(2.0 + np.arange(30.0), [1, 1])
    )


def test_a_roving_hammer_is_read_by_a_sensor_of_turning_too() -> None:
    outputs = (
        Channel("1+Z", "acceleration", "m/s^2"),
        Channel("1-RX", "angular acceleration", "rad/s^2"),
    )
    inputs = (
        *(Channel(f"{k}+Z", "force", "N") for k in range(1, 4)),
        Channel("4+RY", "moment", "N*m"),
    )
    h = np.arange(3 * 2 * 4.0).reshape(3, 2, 4)
    got, note = exchange_by_reciprocity(FrfSet(h, np.arange(1.0, 4.0), outputs, inputs))
    assert "roving hammer" in note
    np.testing.assert_array_equal(got.data, h.swapaxes(1, 2))
    assert [c.unit for c in got.outputs] == ["m/s^2"] * 3 + ["rad/s^2"]
    assert [(c.id, c.unit) for c in got.inputs] == [("1+Z", "N"), ("1-RX", "N*m")]


def test_estimators_bracket_the_truth() -> None:
    """Noise on the response biases H2 up, on the force H1 down; |H1| <= |Hv| <= |H2|."""
    ff, xf, xx = np.array([2.0]), np.array([[3.0 + 1j]]), np.array([[6.0]])
    h = [
        np.abs(estimators(ff, xf, xx, which)[0]).item() for which in ("H1", "Hv", "H2")
    ]
    assert h[0] < h[1] < h[2]
    assert h[0] * h[2] == pytest.approx(h[1] ** 2)
    assert h[2] == pytest.approx(6 / np.sqrt(10))
    assert estimators(ff, xf, xx, "H1")[1].item() == pytest.approx(10 / 12)


def test_variance_from_the_coherence_covers_the_scatter() -> None:
    """The real part over 40 seeds against |H|²(1 − γ²)/(2 n γ²)."""
    runs = [
        estimate_frf(
            record(1, [0], seed=k, noise=0.05), HammerSettings(fmax=40.0, block=8.0)
        )[0]
        for k in range(40)
    ]
    scatter = np.var([r.data.real for r in runs], axis=0, ddof=1)[40:]
    stated = np.mean([frf_variance(r) for r in runs], axis=0)[40:]
    assert (
        0.6 < np.median(scatter / stated) < 1.7
    )  # a handful of averages: the coherence itself scatters


def test_frfs_of_the_other_sign_of_time_are_turned_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """e^{-iωt}: the conjugates; FRFs of e^{+iωt} and noise stay as they are."""
    frfs, _ = estimate_frf(
        record(1, [0, 1, 5], starts=1.0 + 9.0 * np.arange(2), noise=0.02)
    )
    rng = np.random.default_rng(0)
    noise = (
        frfs.data * 0
        + rng.standard_normal(frfs.data.shape)
        + 1j * rng.standard_normal(frfs.data.shape)
    )
    for name, data, kept in (
        ("a", frfs.data, True),
        ("b", frfs.data.conj(), False),
        ("c", noise, True),
    ):
        caplog.clear()
        write_frfs(tmp_path / f"{name}.h5", replace(frfs, data=data))
        read = read_frfs(tmp_path / f"{name}.h5")
        np.testing.assert_array_equal(read.data, data if kept else frfs.data)
        assert ("their conjugates are taken" in caplog.text) is not kept


def test_refusals() -> None:
    r = record(1, [0, 1])
    with pytest.raises(ConfigError, match="Allowed: H1, H2, Hv"):
        HammerSettings(estimator="H3")  # type: ignore[arg-type]
    with pytest.raises(DataError, match="0 force channels"):
        estimate_frf(r.pick(["1+Z", "2+Z"]))
    with pytest.raises(DataError, match="no channel 'F:9'"):
        estimate_frf(r, HammerSettings(force="F:9"))
    with pytest.raises(DataError, match="none of 6 hits"):
        estimate_frf(r, HammerSettings(block=30.0))
    mixed = replace(r, channels=(*r.channels[:2], Channel("2+Z", "strain", "strain")))
    with pytest.raises(DataError, match="all must be motions"):
        estimate_frf(mixed)
    with pytest.raises(DataError, match="different rates"):
        estimate_frf([r, replace(r, rate=256.0)])


@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_noise_on_the_force_beside_the_pulse_is_left_out(noise: float) -> None:
    """Of 2 and 5 % of the peaks: the 4 samples of the pulse hold a tenth of what 16 to each side
    would let in.
    """
    quiet, outs = record(1, [0, 1, 5], noise=1e-4), [0, 1, 5]
    data = quiet.data.copy()
    data[0] += noise * np.random.default_rng(3).standard_normal(data.shape[1])
    s = 2j * np.pi * np.arange(40, 640) / 8.0  # lines of blocks of 8 s, 5 to 80 Hz

    def error(window: float | None) -> float:
        want = HammerSettings(
            block=8.0, pretrigger=0.0, exp_end=0.01, force_window=window
        )
        frfs, _ = estimate_frf(replace(quiet, data=data), want)
        at = np.rint(s.imag / (2 * np.pi) / frfs.freqs[1]).astype(int)
        sigma = s + frfs.window_decay
        exact = sigma[:, None] ** 2 * receptance(sigma, outs, 1)
        return float(np.linalg.norm(np.diff(frfs.data[at, :, 0] / exact, axis=0)))

    assert error(None) < 0.5 * error(16 / RATE)  # from line to line: what moves poles


@pytest.mark.parametrize("blows", [1, 6])
def test_lines_end_where_the_force_sinks_into_its_noise(blows: int) -> None:
    """The spectrum of a sine-squared pulse of 30 ms falls with f³ beyond its first zero at 67
    Hz.
    """
    rng = np.random.default_rng(0)
    t = np.arange(int(10 * blows * RATE)) / RATE
    force = sum(pulse(t - 1.0 - 10 * k, 100.0, 0.03) for k in range(blows))
    channels = (Channel("F:1+Z", "force", "N"), Channel("1+Z", "acceleration", "m/s^2"))
    y = np.convolve(force, np.exp(-np.arange(500) / 50.0))[: t.size]
    data = np.vstack([force, y]) + np.array([[0.5], [1e-3]]) * rng.standard_normal(
        (2, t.size)
    )
    history = TimeHistory(data, RATE, channels, "soft")
    frfs, _ = estimate_frf(history)
    assert 50 < frfs.freqs[-1] < 150
    (end,) = forced_frfs([history], HammerSettings()).notes
    assert (
        f"the force ends at {frfs.freqs[-1]:.4g} Hz: beyond it is noise, and the lines are left out"
        in end
    )
    asked = forced_frfs([history], HammerSettings(keep_to=200.0))
    assert asked.columns[0].freqs[-1] == pytest.approx(200.0, abs=0.2 * blows)
    assert "so may be the modes that are asked for" in asked.notes[0]
