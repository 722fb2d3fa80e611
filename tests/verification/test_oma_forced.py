"""Forces with a spectrum of their own beside random ones: what the structure does there is no mode.

A chain of eight storeys under random forces at all floors, and one pattern of forces with a broad
peak between the second and the third mode (people, waves).
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.confidence import carriers
from ringtrue.identification.ambient.pipeline import AmbientResult, identify_ambient

RATE, SECONDS, STOREYS = 30.0, 1200, 8
PEAK, WIDTH = 1.9, 0.08  # Hz, damping of the oscillator that has this spectrum


def chain() -> tuple[np.ndarray, np.ndarray]:
    """Frequencies from 0.5 Hz, and shapes."""
    k = 2 * np.eye(STOREYS) - np.eye(STOREYS, k=1) - np.eye(STOREYS, k=-1)
    k[-1, -1] = 1
    squares, shapes = np.linalg.eigh(k)
    return 0.5 * np.sqrt(squares / squares[0]), shapes


def oscillator(force: np.ndarray, f: float, zeta: float) -> np.ndarray:
    """Acceleration of a unit mass on a spring for forces (.., sample)."""
    s = 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))
    ringing = lfilter([0, np.exp(s / RATE) - 1], [1, -np.exp(s / RATE)], force)
    return np.asarray(
        2 * np.real(s / (2j * s.imag) * ringing)
        + 2 * np.real(s / (2j * s.imag)) * force
    )


def record(crowd: float) -> TimeHistory:
    rng = np.random.default_rng(4)
    force = rng.standard_normal((STOREYS, int(RATE * SECONDS)))
    force += crowd * np.outer(
        rng.standard_normal(STOREYS),
        oscillator(rng.standard_normal(force.shape[1]), PEAK, WIDTH),
    )
    return responses(force, rng)


def jumped(seed: int) -> TimeHistory:
    """Forty groups of three to eight jumps, two in a second, each at one floor."""
    rng = np.random.default_rng(seed)
    force = 0.05 * rng.standard_normal((STOREYS, int(RATE * SECONDS)))
    landing = np.sin(np.pi * np.arange(8) / 8)
    for start in rng.uniform(2, SECONDS - 10, 40):
        floor, height = rng.integers(STOREYS), rng.uniform(20, 60)
        for k in range(rng.integers(3, 9)):
            at = int((start + k / rng.normal(2.1, 0.05)) * RATE)
            force[floor, at : at + landing.size] += height * landing
    return responses(force, rng)


def responses(force: np.ndarray, rng: np.random.Generator) -> TimeHistory:
    """Accelerations of the floors under forces (floor, sample), with noise."""
    f, shapes = chain()
    q = np.array(
        [oscillator(p, x, 0.01) for p, x in zip(shapes.T @ force, f, strict=True)]
    )
    y = shapes @ q
    y += 0.05 * y.std() * rng.standard_normal(y.shape)
    return TimeHistory(
        y,
        RATE,
        tuple(Channel(f"{i + 1}+X", "acceleration") for i in range(STOREYS)),
        "made",
    )


def forced(r: AmbientResult) -> list[float]:
    """Frequencies of the doubtful modes, Hz."""
    return [
        float(f)
        for f, kind in zip(r.others.modes.frequencies, r.others.classes, strict=True)
        if kind == "doubtful"
    ]


@pytest.mark.parametrize("crowd", [0.0, 1.0])
def test_a_peak_of_the_force_is_no_mode(crowd: float) -> None:
    r = identify_ambient(record(crowd))
    assert len(r.modes) == STOREYS, (r.modes.frequencies, r.notes)
    assert np.abs(r.modes.frequencies / chain()[0] - 1).max() < 0.005
    assert len(forced(r)) == (crowd > 0)
    assert not crowd or abs(forced(r)[0] - PEAK) < 0.1


@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_groups_that_jump_leave_the_modes_of_the_structure(seed: int) -> None:
    r = identify_ambient(jumped(seed))
    assert any("the decays after them are used" in n for n in r.notes)
    assert len(r.modes) == STOREYS, (r.modes.frequencies, r.notes)
    assert (
        np.abs(r.modes.frequencies / chain()[0] - 1).max() < 0.01
    )  # decays behind some ten groups


def test_only_a_doubtful_pole_of_a_shape_that_others_span_is_forced() -> None:
    f, z, sure = (
        np.array([1.0, 1.5, 2.0]),
        np.array([0.01, 0.05, 0.01]),
        np.array([5e-4, 5e-3, 5e-4]),
    )
    own = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 3)))[0].astype(
        complex
    )
    mixed = own.copy()
    mixed[:, 1] = own[:, 0] - 0.6 * own[:, 2]
    assert [x.tolist() for x in carriers(f, z, sure, mixed)] == [[], [0, 2], []]
    assert not any(x.size for x in carriers(f, z, sure, own))
    assert not any(
        x.size for x in carriers(f, np.full(3, 0.01), np.full(3, 5e-4), mixed)
    )  # as clear as the others


def test_a_peak_far_sharper_than_the_modes_is_forced() -> None:
    """As well known as its small damping allows: a crowd that jumps to music for a few minutes, and
    again.
    """
    shape = np.random.default_rng(2).standard_normal((12, 3)).astype(complex)
    f, z = np.array([1.0, 1.5, 2.0]), np.array([0.01, 0.0008, 0.015])
    sure = 0.05 * np.sqrt(z / f)
    mixed = np.stack(
        [shape[:, 0], 0.4 * shape[:, 0] + 0.6 * shape[:, 2], shape[:, 2]], axis=1
    )
    assert [x.tolist() for x in carriers(f, z, sure, mixed)] == [[], [0, 2], []]
    assert not any(x.size for x in carriers(f, z, sure, shape))
    z[1] = 0.006
    assert not any(x.size for x in carriers(f, z, 0.05 * np.sqrt(z / f), mixed))


def test_of_a_mode_and_a_wide_peak_that_is_as_well_known_the_peak_is_forced() -> None:
    """Walkers of many paces, whose third harmonic meets a mode: each shape is a sum of the other
    and of a third.
    """
    shape = np.random.default_rng(3).standard_normal((8, 2)).astype(complex)
    f, z = np.array([4.0, 6.2, 7.9]), np.array([0.03, 0.011, 0.01])
    sure = np.array([0.06, 0.065, 0.02]) * np.sqrt(z / f)
    mixed = np.stack(
        [shape[:, 0] + 0.5 * shape[:, 1], shape[:, 0], shape[:, 1]], axis=1
    )
    assert [x.tolist() for x in carriers(f, z, sure, mixed)] == [[1, 2], [], []]


def test_a_peak_below_all_modes_is_carried_by_two_above() -> None:
    """Waves below the modes of a hull: of seven channels one mode of either side counts, and there
    is none below.
    """
    f, z, sure = (
        np.array([0.13, 1.3, 2.6]),
        np.array([0.09, 0.01, 0.01]),
        np.array([0.014, 5e-4, 5e-4]),
    )
    own = np.linalg.qr(np.random.default_rng(0).standard_normal((7, 3)))[0].astype(
        complex
    )
    mixed = own.copy()
    mixed[:, 0] = own[:, 1] + 0.5 * own[:, 2]
    assert [x.tolist() for x in carriers(f, z, sure, mixed)] == [[1, 2], [], []]
    assert not any(x.size for x in carriers(f, z, sure, own))


def test_a_channel_in_another_unit_makes_no_shapes_alike() -> None:
    f, z, sure = (
        np.array([1.0, 1.5, 2.0]),
        np.array([0.01, 0.05, 0.01]),
        np.array([5e-4, 5e-3, 5e-4]),
    )
    own = np.linalg.qr(np.random.default_rng(0).standard_normal((8, 3)))[0].astype(
        complex
    )
    own[0] *= 1e3
    assert not any(x.size for x in carriers(f, z, sure, own))


def test_too_few_sensors_tell_nothing() -> None:
    f, z, sure = (
        np.array([1.0, 1.5, 2.0]),
        np.array([0.01, 0.05, 0.01]),
        np.array([5e-4, 5e-3, 5e-4]),
    )
    any_shape = np.random.default_rng(1).standard_normal((2, 3)).astype(complex)
    assert not any(x.size for x in carriers(f, z, sure, any_shape))
    assert not any(x.size for x in carriers(f[:0], z[:0], sure[:0], any_shape[:, :0]))
