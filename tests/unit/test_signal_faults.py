"""Faults of channels: each one planted in noise must be found where it is, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.channel_checks import check_pairs, find_faults, flip, mend

RATE = 100.0
N = 6000


def noise(seed: int = 0, count: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    y = rng.standard_normal((count, N + 9))
    return np.stack([np.convolve(x, np.hanning(10), "valid") for x in y])[:, :N]


def history(data: np.ndarray) -> TimeHistory:
    return TimeHistory(
        data,
        RATE,
        tuple(Channel(f"{i + 1}+Z", "acceleration", "m/s^2") for i in range(len(data))),
        "r",
    )


@pytest.mark.parametrize("seed", range(5))
def test_sound_channels_have_no_faults(seed: int) -> None:
    y = noise(seed)
    assert not find_faults(history(y))
    coarse = np.round(y / y.std() * 4)  # a recorder of 5 bits
    assert not find_faults(history(coarse))


def test_hits_are_no_spikes() -> None:
    y = noise()
    t = np.arange(N) / RATE
    for start in (10.0, 31.0):
        y += (
            40
            * y.std()
            * np.where(t > start, np.exp(-3 * (t - start)) * np.sin(60 * (t - start)), 0.0)
        )
    assert not [f for f in find_faults(history(y)) if f.kind == "spike"]


def test_crests_of_a_smooth_signal_are_no_spikes() -> None:
    """A decay sampled finely: the running median leaves it at its crests alone."""
    t = np.arange(N) / RATE
    y = np.exp(-0.2 * t) * (np.sin(2.1 * t) + 0.3 * np.sin(9.7 * t)) + 1e-6 * noise()
    assert not find_faults(history(y))
    y[0, 3000] += 5.0
    assert [(f.kind, f.first) for f in find_faults(history(y))] == [("spike", 3000)]


def test_each_fault_is_found_where_it_is() -> None:
    y = noise(1, 7)
    y[0, 1000:1003] = np.nan
    y[1] = 3.5
    y[2, 2000:2200] = y[2, 1999]
    y[3] = np.clip(y[3], -1.5 * y[3].std(), 1.5 * y[3].std())
    y[4, 4000] += 100 * y[4].std()
    y[5] *= 1e4
    found = find_faults(history(y))
    kinds = {f.id: {g.kind for g in found if g.id == f.id} for f in found}
    assert kinds == {
        "1+Z": {"not finite"},
        "2+Z": {"dead"},
        "3+Z": {"drop-out"},
        "4+Z": {"overload"},
        "5+Z": {"spike"},
        "6+Z": {"level"},
    }
    where = {f.kind: (f.first, f.last) for f in found}
    assert where["not finite"] == (1000, 1002)
    assert where["drop-out"] == (1999, 2199)
    assert where["spike"] == (4000, 4000)
    assert sum(f.samples for f in found if f.kind == "overload") > 0.05 * N


def test_overload_by_the_range() -> None:
    y = noise(2)
    peak = np.abs(y[0]).max()
    assert not find_faults(history(y), {"1+Z": 1.1 * peak})
    (found,) = find_faults(history(y), {"1+Z": 1.0 * peak})
    assert found.kind == "overload"
    assert found.first == np.abs(y[0]).argmax()


def test_mending_bridges_what_is_short_only() -> None:
    y = noise(3)
    true = y.copy()
    y[0, 500] = np.nan
    y[1, 700] += 200 * y[1].std()
    y[2, 900:1400] = 0.0
    record, left = mend(history(y), find_faults(history(y)))
    assert [(f.id, f.kind) for f in left] == [("3+Z", "drop-out")]
    assert record.data[0, 500] == pytest.approx((true[0, 499] + true[0, 501]) / 2)
    assert record.data[1, 700] == pytest.approx((true[1, 699] + true[1, 701]) / 2)
    np.testing.assert_array_equal(record.data[2], y[2])
    assert np.isnan(y[0, 500])  # the caller's array stays


def test_pairs_that_are_flipped_swapped_and_unrelated() -> None:
    a = noise(4, 5)
    b = a + 0.1 * noise(5, 5)
    b[1] *= -1
    b[[2, 3]] = b[[3, 2]]
    b[4] = noise(6, 1)[0]
    channels = tuple(Channel(f"{s}{i}") for s in "ab" for i in range(5))
    record = TimeHistory(np.vstack([a, b]), RATE, channels)
    pairs = [(f"a{i}", f"b{i}") for i in range(5)]
    checks = check_pairs(record, pairs)
    assert [c.verdict for c in checks] == ["ok", "flipped", "swapped", "swapped", "unrelated"]
    assert checks[2].best == "b3"
    assert check_pairs(flip(record, ["b1"]), pairs)[1].verdict == "ok"
    with pytest.raises(DataError, match="no channel"):
        flip(record, ["c"])
