"""A shaft whose speed wanders by 2 %: lines at 1, 3 and 6 times its speed beside modes at 2 and 3/2
of the loudest.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.signal.harmonic_evidence import phase_evidence

RATE, SECONDS, SPEED = 20.0, 2400, 0.31
MODES = np.array([0.62, 0.4651])  # 2 and 3/2 of the shaft: 2:3 and 1:2 of the line at 3


def record(seed: int, *, lines: tuple[float, ...] = (1, 3, 6)) -> TimeHistory:
    rng = np.random.default_rng(seed)
    n = int(RATE * SECONDS)
    slow = sosfilt(butter(1, 0.02, fs=RATE, output="sos"), rng.standard_normal(n))
    angle = 2 * np.pi * np.cumsum(SPEED * (1 + 0.02 * slow / slow.std())) / RATE
    parts = [
        a * np.cos(k * angle + rng.uniform(0, 6))
        for k, a in zip(lines, (0.5, 1.5, 0.5), strict=False)
    ]
    for f in MODES:
        s = 2 * np.pi * f * (-0.01 + 1j)
        q = lfilter(
            [1.0], [1.0, -np.exp(s / RATE)], rng.standard_normal(n).astype(complex)
        ).imag
        parts.append(q / q.std())
    y = rng.standard_normal((5, len(parts))) @ np.array(
        parts
    ) + 0.5 * rng.standard_normal((5, n))
    return TimeHistory(y, RATE, tuple(Channel(str(i)) for i in range(5)), "made")


def test_lines_of_a_known_machine_are_told_from_modes_at_ratios_of_it() -> None:
    f = np.array([*MODES[::-1], SPEED, 3 * SPEED, 6 * SPEED])
    z = np.array([0.01, 0.01, 0.004, 0.005, 0.006])
    for seed in range(3):
        told = phase_evidence(record(seed), f, z, [False, False, False, True, False])
        assert [bool(x) for x in told] == [False, False, True, False, True], told
        assert (
            told[4] == "a machine: its phase goes with that of the line at 0.93 Hz, 2:1"
        )


def test_without_a_known_machine_nothing_is_told() -> None:
    assert phase_evidence(
        record(0), 1.0 * MODES, 0.01 * np.ones(2), [False, False]
    ) == ("", "")


def test_another_machine_at_a_whole_ratio_is_none_of_this_one() -> None:
    """Two shafts that wander each by itself."""
    one, two = record(0, lines=(3,)), record(1, lines=(6,))
    both = TimeHistory(one.data + two.data, RATE, one.channels, "made")
    assert phase_evidence(
        both, np.array([3.0, 6.0]) * SPEED, np.array([0.005, 0.006]), [True, False]
    ) == (
        "",
        "",
    )
