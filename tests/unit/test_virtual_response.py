"""Response of a modal model to forces: closed forms of one oscillator, and spectra against
|H|²·S.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from test_virtual_system import made_up

from ringtrue.core.modes import ModalModel
from ringtrue.core.signals import Channel
from ringtrue.errors import InputError
from ringtrue.virtual.excitation import (
    Ambient,
    Pulses,
    ambient_forces,
    dropped_weight,
    event_times,
    ground_psd,
    input_psd,
    jumping,
    pulse_spectrum,
    sledge,
)
from ringtrue.virtual.sensors import (
    at_outputs,
    coloured,
    expected_power,
    lines,
    power,
    resonance_power,
    response_spectrum,
    simulate,
)

MASS, F0, ZETA, RATE = 1000.0, 5.0, 0.02, 256.0
W0 = 2 * np.pi * F0
WD = W0 * np.sqrt(1 - ZETA**2)


def oscillator() -> ModalModel:
    """m·x'' + 2ζω₀m·x' + mω₀²·x = f."""
    pole = np.array([-ZETA * W0 + 1j * WD])
    one, none = np.array([[1 / MASS / (2j * WD)]]), np.zeros((1, 1))
    return ModalModel(
        pole,
        np.ones((1, 1)),
        one,
        none,
        none,
        (Channel("1+Z"),),
        (Channel("1+Z"),),
        "receptance",
    )


def test_free_decay_after_a_short_pulse_is_the_closed_form() -> None:
    n, start, width, impulse = 8192, 2.0, 1e-3, 10.0
    force = pulse_spectrum(
        Pulses(
            np.array([start]), np.array([width]), np.array([impulse]), np.array([0])
        ),
        1,
        n,
        RATE,
    )
    x = np.fft.irfft(
        response_spectrum(oscillator(), force, lines(n, RATE), quantity="displacement")[
            0
        ],
        n,
    )
    t = np.arange(n) / RATE - start - width / 2
    want = np.where(
        t > 0, impulse / MASS / WD * np.exp(-ZETA * W0 * t) * np.sin(WD * t), 0.0
    )
    # before it and at the kink the band limit of the pulse rings
    later = (t > 0.2) & (t < 8)
    # 5e-4: the share of the oscillator's response beyond half the rate, (5/128)²
    np.testing.assert_allclose(x[later], want[later], atol=5e-4 * want.max())


def test_harmonic_force_gives_the_steady_state_of_the_accelerance() -> None:
    n, f = 2560, 8.0
    t = np.arange(n) / RATE
    y = simulate(oscillator(), np.cos(2 * np.pi * f * t)[None], RATE, tail=0)[0]
    s = 2j * np.pi * f
    h = s**2 / MASS / (s**2 + 2 * ZETA * W0 * s + W0**2)
    np.testing.assert_allclose(y, np.real(h * np.exp(s * t)), atol=1e-10 * abs(h))


def test_padding_keeps_the_decay_from_wrapping_to_the_start() -> None:
    force = np.zeros((1, 2048))
    force[0, -20:] = np.hanning(20)
    y = simulate(oscillator(), force, RATE, quantity="displacement")[0]
    assert np.abs(y[:1000]).max() < 1e-3 * np.abs(y).max()
    wrapped = simulate(oscillator(), force, RATE, quantity="displacement", tail=0)[0]
    assert np.abs(wrapped[:1000]).max() > 0.5 * np.abs(wrapped).max()


def test_simulated_spectra_are_those_of_the_transfer_functions() -> None:
    rng = np.random.default_rng(3)
    model, n, psd = (
        at_outputs(made_up().modal, ["101+X", "105+Z", "110+Y"]),
        1 << 17,
        4.0,
    )
    inputs = len(model.inputs)
    force = (
        rng.normal(0, np.sqrt(psd * RATE / 2), (inputs, n))
        * (np.arange(inputs) < 6)[:, None]
    )
    f, got = signal.welch(simulate(model, force, RATE, tail=0), RATE, nperseg=4096)
    want = (
        np.abs(
            model.synthesise(f[1:])[:, :, :6]
            * ((2 * np.pi * f[1:]) ** 2)[:, None, None]
        )
        ** 2
    ).sum(axis=2) * psd
    band = slice(160, 1600)  # 10..100 Hz; 63 averages: 13 % a line, 1 % over the band
    ratio = got[:, 1:][:, band] / want.T[:, band]
    assert np.abs(ratio.mean(axis=1) - 1).max() < 0.03
    assert ratio.std() < 0.2


def test_power_at_resonance_is_the_expected_one() -> None:
    rng, site, n = (
        np.random.default_rng(5),
        Ambient(correlation=0.0, machine_force=0.0),
        1 << 18,
    )
    model = at_outputs(made_up().modal, made_up().test.channels[:12])
    ids, points = [c.id for c in model.inputs], ("900+Z", "903+Z", "907+X")
    site = replace(site, points=points)
    forces = ambient_forces(ids, site, n, RATE, rng)
    poles = model.poles[8:30]
    got = resonance_power(
        response_spectrum(model, forces, lines(n, RATE)), poles, n, RATE
    )
    want = expected_power(
        model, poles, input_psd(ids, np.abs(poles) / (2 * np.pi), site), "acceleration"
    )
    # a mean over the half-power band of a Lorentzian is π/4 of its peak
    assert 0.8 < np.median(got / want) / (np.pi / 4) < 1.2


def test_ground_motion_has_its_rms_and_its_hump() -> None:
    f = np.geomspace(0.01, 200, 20_000)
    psd = ground_psd(f, 2e-6)
    assert np.sqrt(np.trapezoid(psd, f)) == pytest.approx(2e-6, rel=1e-3)
    hump = f[np.argmax(psd)]
    assert 0.2 < hump < 0.4


def test_ground_displacement_and_velocity_belong_to_one_motion() -> None:
    ids = ("ground+Z", "groundv+Z", "900+Z")
    forces = ambient_forces(ids, Ambient(), 4096, RATE, np.random.default_rng(0))
    f = lines(4096, RATE)
    np.testing.assert_allclose(forces[1], 2j * np.pi * f * forces[0], rtol=1e-12)
    assert not forces[2].any()


def test_coloured_noise_has_its_spectral_density() -> None:
    n = 1 << 16
    psd = 1.0 + np.arange(n // 2 + 1) / n
    got = power(coloured(psd[None], n, RATE, np.random.default_rng(1)), n, RATE)[0]
    assert np.mean(got / psd) == pytest.approx(1.0, abs=0.02)


def test_a_dropped_weight_gives_its_momentum_and_its_rebounds() -> None:
    p = dropped_weight(np.array([10.0]), np.array([0]), np.random.default_rng(2))
    v = np.sqrt(2 * 9.80665 * 1.5)
    e = p.impulse[1] / p.impulse[0]
    np.testing.assert_allclose(-p.impulse, 30 * v * (1 + e) * e ** np.arange(3))
    assert p.start[1] - p.start[0] == pytest.approx(2 * e * v / 9.80665 + p.duration[0])
    force = np.fft.irfft(pulse_spectrum(p, 1, 8192, RATE)[0], 8192)
    assert force.sum() / RATE == pytest.approx(p.impulse.sum(), rel=1e-9)


def test_sledge_blows_stay_within_their_band() -> None:
    p = sledge(np.arange(200.0), np.zeros(200, dtype=int), np.random.default_rng(0))
    assert (-p.peak).min() >= 5e3
    assert (-p.peak).max() <= 25e3 * (1 + 1e-12)
    assert p.duration.min() >= 0.003
    assert p.duration.max() <= 0.008


def test_jumping_leaves_the_constant_weight_out_and_peaks_at_two_hertz() -> None:
    p = jumping(np.arange(10.0, 500, 40), [0, 1, 2], np.random.default_rng(0))
    n = 1 << 17
    spectrum = pulse_spectrum(p, 3, n, RATE)
    f = lines(n, RATE)
    assert abs(p.impulse.sum()) < 1e-9 * np.abs(p.impulse).sum()
    assert 1.7 < f[np.argmax(np.abs(spectrum[0]))] < 2.3


def test_events_are_as_far_apart_as_planned() -> None:
    gaps = np.diff(event_times((20.0, 80.0), 1800.0, np.random.default_rng(0)))
    assert gaps.min() > 18
    assert gaps.max() < 85
    assert gaps.size > 30


def test_wrong_forces_are_refused() -> None:
    with pytest.raises(InputError, match="must be"):
        simulate(oscillator(), np.zeros((2, 100)), RATE)
    with pytest.raises(InputError, match="no output"):
        at_outputs(oscillator(), ["9+Z"])
    with pytest.raises(InputError, match="no input"):
        ambient_forces(
            ("1+Z",), Ambient(points=("2+Z",)), 64, RATE, np.random.default_rng(0)
        )
