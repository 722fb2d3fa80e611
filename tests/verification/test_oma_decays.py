"""Free decays simulated from known modes: y = Re Σ φ q e^{λt} behind each impact, in white noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.arrays import Float
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.free_decays import free_decay_note, identify_decay

RATE = 2048.0
FREQUENCIES = np.array([12.0, 31.0, 31.4, 96.0, 240.0, 610.0])
DAMPING = np.array([0.012, 0.004, 0.006, 0.02, 0.0015, 0.003])


def record(
    seed: int,
    *,
    channels: int = 4,
    impacts: int = 2,
    noise: float = 3e-3,
    seconds: float = 6.0,
) -> TimeHistory:
    """Impacts `seconds` apart, after a third of a second of noise."""
    rng = np.random.default_rng(seed)
    poles = 2 * np.pi * FREQUENCIES * (-DAMPING + 1j * np.sqrt(1 - DAMPING**2))
    shapes = rng.standard_normal((channels, poles.size))
    samples = int(seconds * RATE)
    before = int(RATE / 3)
    data = np.zeros((channels, before + impacts * samples))
    for k in range(impacts):
        start = before + k * samples
        time = np.arange(data.shape[1] - start) / RATE
        size = 1 + 0.3 * rng.standard_normal(poles.size)
        data[:, start:] += ((shapes * size) @ np.exp(poles[:, None] * time)).imag
    data += noise * rng.standard_normal(data.shape)
    names = tuple(
        Channel(f"{k + 1}+Z", "acceleration", "m/s^2") for k in range(channels)
    )
    return TimeHistory(data, RATE, names, "decay")


def duffing(seed: int, stiffening: float) -> TimeHistory:
    """x'' + 2ζω x' + ω²(x + stiffening x³) = 0 of 40 Hz and 0.4 %, and a linear mode of 91 Hz."""
    from scipy.integrate import solve_ivp

    rate = 1024.0
    omega = 2 * np.pi * 40
    time = np.arange(int(6 * rate)) / rate

    def motion(_: float, u: Float) -> list[float]:
        return [
            u[1],
            -0.008 * omega * u[1] - omega**2 * (u[0] + stiffening * u[0] ** 3),
        ]

    solved = solve_ivp(
        motion, (0, 6), [0, 0.8 * omega], t_eval=time, rtol=1e-8, atol=1e-10
    )
    linear = (
        0.3 * np.exp(-0.006 * 2 * np.pi * 91 * time) * np.sin(2 * np.pi * 91 * time)
    )
    data = np.array([[1.0, 0.5], [0.7, -0.8]]) @ np.stack([solved.y[0], linear])
    data = np.concatenate([np.zeros((2, 300)), data], axis=1)
    data += 1e-3 * np.random.default_rng(seed).standard_normal(data.shape)
    return TimeHistory(data, rate, (Channel("1+Z"), Channel("2+Z")), "duffing")


def test_all_modes_are_found_and_none_else() -> None:
    off = []
    for seed in range(6):
        found = identify_decay(record(seed, channels=1 + seed, impacts=1 + seed % 3))
        assert len(found.modes) == FREQUENCIES.size
        assert np.abs(found.modes.frequencies / FREQUENCIES - 1).max() < 1e-3
        std = found.uncertainty
        off += ((found.modes.frequencies - FREQUENCIES) / std.frequency).tolist()
        off += ((found.modes.damping - DAMPING) / std.damping).tolist()
    # 72 values: the share within the 95 % interval scatters by 0.026
    assert np.mean(np.abs(off) < 1.96) > 0.87
    assert 0.8 < np.std(off) < 1.25


def test_covariance_factor_has_the_standard_deviations() -> None:
    found = identify_decay(record(11))
    variance = np.square(found.uncertainty.factor).sum(axis=0)
    both = np.concatenate([found.uncertainty.frequency, found.uncertainty.damping])
    np.testing.assert_allclose(variance, both**2, rtol=1e-6)


def test_duffing_mode_has_its_backbone() -> None:
    stiffening = 0.05
    found = identify_decay(duffing(3, stiffening))
    assert len(found.modes) == 2
    backbone = found.backbones[0]
    assert backbone is not None
    assert backbone.nonlinear
    assert found.backbones[1] is not None
    assert not found.backbones[1].nonlinear
    # first order of the averaging method: f = f0 (1 + 3/8 stiffening a²)
    expected = 40 * (1 + 0.375 * stiffening * backbone.fit_amplitude**2)
    assert np.abs(backbone.fit_frequency - expected).max() < 0.005
    np.testing.assert_allclose(backbone.fit_damping, 0.004, rtol=0.02)
    assert len(backbone.plot().data) == 4


def test_square_of_the_motion_makes_harmonics_and_no_modes() -> None:
    linear = duffing(4, 0.0)
    squared = replace(linear, data=linear.data + 0.1 * linear.data**2)
    found = identify_decay(squared)
    np.testing.assert_allclose(found.modes.frequencies, [40, 91], rtol=1e-3)
    of = [tuple(round(f) for f in m.of) for m in found.multiples]
    assert (40, 40) in of
    assert (40, 91) in of or (91, 40) in of


def test_clipped_samples_are_left_out() -> None:
    linear = duffing(5, 0.0)
    clipped = replace(linear, data=np.clip(linear.data, -0.35, 0.35))
    found = identify_decay(clipped)
    np.testing.assert_allclose(found.modes.frequencies, [40, 91], rtol=1e-3)


def test_record_decides_by_itself() -> None:
    decays = record(7)
    note = free_decay_note(decays)
    assert note is not None
    assert note.code == "decay automatic"
    by_itself = rt.identify_ambient(decays)
    asked = rt.identify_ambient(decays, decay=True)
    np.testing.assert_array_equal(by_itself.frequencies, asked.frequencies)
    assert len(by_itself.notes) == len(asked.notes) + 1


def test_noise_driven_record_is_no_decay() -> None:
    rng = np.random.default_rng(0)
    data = np.zeros((2, 20000))
    force = rng.standard_normal(data.shape)
    for k in range(2, data.shape[1]):  # a mode of 0.08 of the rate at 1 %
        data[:, k] = 1.7434 * data[:, k - 1] - 0.99 * data[:, k - 2] + force[:, k]
    ambient = TimeHistory(data, 20.0, (Channel("1"), Channel("2")))
    assert free_decay_note(ambient) is None


def test_decay_goes_with_no_other_method() -> None:
    with pytest.raises(rt.InputError, match="decay"):
        rt.identify_ambient(record(1), decay=True, method="fdd")
