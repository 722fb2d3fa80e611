"""Channel faults put into random tests of a plate are named; healthy tests raise no alarm."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.modes import ModeSet
from ringtrue.correlation.channel_faults import find_faults, suspect_channels
from ringtrue.correlation.pairing import pair_modes
from ringtrue.errors import InputError
from ringtrue.shapes import paired_mac

# share of the faults that must be found
LEAST = {
    "reversed": 0.9,
    "dead": 0.85,
    "scaled": 0.9,
    "swapped": 0.75,
    "quarter turn": 0.75,
    "round of three": 0.75,
}


def plate(rng: np.random.Generator, channels: int, modes: int) -> np.ndarray:
    """Shapes sin(iπx) sin(jπy) of a plate at random places."""
    x, y = rng.uniform(0.03, 0.97, (2, channels))
    ij = np.array(
        [
            (1, 1),
            (2, 1),
            (1, 2),
            (2, 2),
            (3, 1),
            (1, 3),
            (3, 2),
            (2, 3),
            (3, 3),
            (4, 1),
            (1, 4),
            (4, 2),
        ]
    )
    return np.sin(np.pi * np.outer(x, ij[:modes, 0])) * np.sin(
        np.pi * np.outer(y, ij[:modes, 1])
    )


def healthy(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A model and a test of it: other modes mixed in (a wrong model), noise, any scale and
    phase.
    """
    n, m = int(rng.integers(10, 60)), int(rng.integers(3, 10))
    whole = plate(rng, n, 12)
    mix = rng.uniform(0, 0.12) * rng.standard_normal((12, m))
    test = whole[:, :m] + whole @ mix
    # calibration, local stiffness
    test = test * np.exp(0.08 * rng.standard_normal(n))[:, None]
    test += rng.uniform(0.0, 0.08) * rng.standard_normal(test.shape)
    return test * rng.uniform(0.1, 10, m) * np.exp(
        2j * np.pi * rng.uniform(size=m)
    ), whole[:, :m]


def alarms(count: int) -> tuple[int, float]:
    """Faults named in healthy tests, and their mean MAC."""
    rng = np.random.default_rng(5)
    tests = [healthy(rng) for _ in range(count)]
    return sum(len(find_faults(a, b)) for a, b in tests), float(
        np.mean([paired_mac(a, b).mean() for a, b in tests])
    )


def spoiled(
    fault: str, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, set[int]]:
    """A test with a fault, its model and the channels of the fault.

    On a channel that moves as much as the median one; swapped ones must also move differently.
    """
    a, b = healthy(rng)
    size = np.linalg.norm(b, axis=1)
    i = int(rng.choice(np.flatnonzero(size >= np.median(size))))
    j = int(np.argmin(b @ b[i] / size))  # the partner that moves most differently
    if fault == "swapped":
        a[[i, j]] = a[[j, i]]
        return a, b, {i, j}
    if fault in ("quarter turn", "round of three"):
        unlike = np.argsort(np.abs(b @ b[i]) / size**2, kind="stable")
        rest = [int(k) for k in unlike if size[k] >= np.median(size) and k != i]
        j, k = (
            rest[0],
            min(rest[1:], key=lambda r: abs(b[r] @ b[rest[0]]) + abs(b[r] @ b[i])),
        )
        if fault == "quarter turn":
            a[[i, j]] = a[[j, i]] * np.array([[1.0], [-1.0]])
            return a, b, {i, j}
        a[[i, j, k]] = a[[j, k, i]]
        return a, b, {i, j, k}
    a[i] *= {"reversed": -1, "dead": 0.01, "scaled": 9.80665}[fault]
    return a, b, {i}


def found(fault: str, count: int) -> tuple[float, int]:
    """Share of tests with a fault in which it is named, and channels without fault that are."""
    rng, named, wrong = np.random.default_rng(6), 0, 0
    for _ in range(count):  # over tests
        a, b, want = spoiled(fault, rng)
        got = find_faults(a, b)
        kind = fault if fault in ("reversed", "dead", "scaled") else "swapped"
        rows = [{f.i, *(row for row, _, _ in f.moved)} for f in got]
        named += any(
            f.fault == kind and r == want for f, r in zip(got, rows, strict=True)
        )
        wrong += sum(not (r & want) for r in rows)
    return named / count, wrong


def test_few_alarms_on_200_healthy_tests() -> None:
    false, mac = alarms(200)
    assert 0.8 < mac < 0.97  # the tests are no easy ones
    assert false <= 2


@pytest.mark.parametrize(("fault", "least"), LEAST.items())
def test_faults_are_found(fault: str, least: float) -> None:
    share, wrong = found(fault, 100)
    assert share >= least
    assert wrong <= 3


def test_a_part_that_is_softer_than_the_models_is_no_faulty_channel() -> None:
    """An end wall that moves as expected in the lowest mode and 6 times as much in the highest."""
    rng = np.random.default_rng(9)
    b = plate(rng, 40, 8)
    read = b + 0.03 * rng.standard_normal(b.shape)
    i = int(np.argmax((b**2).sum(axis=1)))
    read[i] *= np.linspace(1.0, 6.0, 8)
    assert find_faults(read, b) == ()
    read[i] = 2.5 * b[i]  # one factor for all modes: the cable or the amplifier
    assert [(f.i, f.fault) for f in find_faults(read, b)] == [(i, "scaled")]


def test_suspects_carry_names_and_the_mac_if_mended_and_nothing_is_changed() -> None:
    rng = np.random.default_rng(7)
    b = plate(rng, 24, 8)
    read = b + 0.01 * rng.standard_normal(b.shape)
    read[3] *= 9.80665
    read[[5, 6]] = read[[6, 5]]
    channels = tuple(f"c{i}" for i in range(24))
    model = ModeSet(np.arange(1.0, 9), np.zeros(8), b, channels)
    test = ModeSet(model.frequencies, model.damping, read, channels)
    before = test.shapes.copy()
    got = {
        s.channel: s for s in suspect_channels(test, model, pair_modes(model, model))
    }
    assert set(got) == {"c3", "c5", "c6"}
    assert got["c3"].factor == pytest.approx(9.8, rel=0.05)
    assert "g for m/s²" in got["c3"].message
    assert got["c5"].partner == "c6"
    assert got["c3"].mac_mended > got["c3"].mac_now
    assert got["c3"].mac_now == pytest.approx(paired_mac(read, b).mean())
    np.testing.assert_array_equal(test.shapes, before)
    with pytest.raises(InputError, match="at least 3"):
        find_faults(read[:, :2], b[:, :2])
